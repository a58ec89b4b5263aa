//! The fit of one record: `min_{θ̂ ∈ Θ} Σ_k (ŷ_k − y_k)²` with the mean body and without noise.
//!
//! Levenberg and Marquardt's method with projection on the box. Normal equations are summed while the loop is
//! simulated, so that an evaluation touches each sample once and keeps nothing: four unknowns of like size lose no
//! digits by that, and a search fits a hundred thousand records.

use super::cost::{Setting, seen};
use super::sampled::{Sampled, State};
use crate::ctl::{Ctl, Stopped};
use nalgebra::{Matrix4, Vector4};

/// Damping that counts as no step at all.
const LARGEST_DAMPING: f64 = 1e12;
/// Evaluations at most.
const EVALUATIONS: usize = 60;
/// A residual that is nothing but rounding, as a share of the record.
const ROUNDING: f64 = 1e-13;

/// Parameters found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Fitted {
    pub theta: [f64; 4],
    pub converged: bool,
}

/// The sums at a point.
struct Sums {
    cost: f64,
    gradient: Vector4<f64>,
    normal: Matrix4<f64>,
}

fn sums(setting: &Setting, target: &[f64], record: &[f64], theta: &[f64; 4]) -> Option<Sums> {
    let gains = [theta[0], theta[1], theta[2]];
    let model = Sampled::new(gains, setting.population.body, setting.times(), setting.time, true)?;
    let slopes = model.slopes.as_ref()?;
    let (seen, turned) = seen(target, theta[3], setting.time.period_s());
    let mut state = State::zeros();
    // ∂x/∂K_p, ∂x/∂K_d, ∂x/∂K_i and ∂x/∂τ; the angle is a state, so that C has no derivative.
    let mut moved = [State::zeros(); 4];
    let mut found = Sums { cost: 0.0, gradient: Vector4::zeros(), normal: Matrix4::zeros() };
    for (k, y) in record.iter().enumerate() {
        let error = state[0] - y;
        let row = Vector4::new(moved[0][0], moved[1][0], moved[2][0], moved[3][0]);
        found.cost += error * error;
        found.gradient += row * error;
        found.normal += row * row.transpose();
        let (r, turn) = (seen[k], turned[k]);
        for (moved, (a, b)) in moved.iter_mut().zip(slopes) {
            *moved = model.a * *moved + a * state + b * r;
        }
        moved[3] = model.a * moved[3] + model.b[0] * turn;
        state = model.a * state + model.b[0] * r;
    }
    (found.cost.is_finite() && found.normal.iter().all(|v| v.is_finite())).then_some(found)
}

/// Fits from a start within the box; where it does not converge, the best that it found. `None` where the loop is not
/// defined at the start.
///
/// # Errors
/// [`Stopped`].
pub(super) fn fit(
    setting: &Setting,
    target: &[f64],
    record: &[f64],
    start: [f64; 4],
    tolerance: f64,
    ctl: &Ctl,
) -> Result<Option<Fitted>, Stopped> {
    let bounds = setting.population.controller;
    let size: f64 = record.iter().map(|y| y * y).sum();
    let mut theta = start;
    let Some(mut at) = sums(setting, target, record, &theta) else { return Ok(None) };
    let mut scale = Vector4::zeros();
    let (mut damping, mut growth) = (1e-3, 2.0);
    for _ in 1..EVALUATIONS {
        ctl.check()?;
        scale = scale.zip_map(&at.normal.diagonal(), f64::max);
        if at.cost <= ROUNDING * ROUNDING * size {
            return Ok(Some(Fitted { theta, converged: true }));
        }
        // What the box holds does not move.
        let held = |j: usize| {
            let [lower, upper] = bounds[j];
            (theta[j] <= lower && at.gradient[j] > 0.0) || (theta[j] >= upper && at.gradient[j] < 0.0)
        };
        let cosine = (0..4)
            .filter(|j| !held(*j) && at.normal[(*j, *j)] > 0.0)
            .map(|j| at.gradient[j].abs() / (at.normal[(j, j)] * at.cost).sqrt())
            .fold(0.0, f64::max);
        if cosine <= tolerance {
            return Ok(Some(Fitted { theta, converged: true }));
        }
        let (mut matrix, mut right) = (at.normal, -at.gradient);
        for j in 0..4 {
            matrix[(j, j)] += damping * scale[j].max(f64::MIN_POSITIVE);
            if held(j) {
                matrix.row_mut(j).fill(0.0);
                matrix.column_mut(j).fill(0.0);
                (matrix[(j, j)], right[j]) = (1.0, 0.0);
            }
        }
        let step = matrix.cholesky().map(|factor| factor.solve(&right));
        let next: Option<[f64; 4]> = step
            .map(|step| std::array::from_fn(|j| (theta[j] + step[j]).clamp(bounds[j][0], bounds[j][1])))
            .filter(|next| *next != theta);
        match next.and_then(|next| Some((next, sums(setting, target, record, &next)?))) {
            Some((next, found)) if found.cost < at.cost => {
                let moved = Vector4::from_fn(|j, _| next[j] - theta[j]);
                let predicted = -(2.0 * at.gradient.dot(&moved) + (moved.transpose() * at.normal * moved)[(0, 0)]);
                let ratio = (at.cost - found.cost) / predicted.max(f64::MIN_POSITIVE);
                damping *= f64::max(1.0 / 3.0, 1.0 - (2.0 * ratio.min(2.0) - 1.0).powi(3));
                damping = damping.max(1e-12);
                growth = 2.0;
                (theta, at) = (next, found);
            }
            _ => {
                damping *= growth;
                growth *= 2.0;
                if damping > LARGEST_DAMPING {
                    break;
                }
            }
        }
    }
    Ok(Some(Fitted { theta, converged: false }))
}

#[cfg(test)]
mod tests {
    use super::super::cost::{draws, tests::setting};
    use super::*;
    use crate::num::least_squares::{LeastSquares, Options, minimise};
    use nalgebra::{DMatrix, DVector};

    /// The same fit by the general method, the loop sampled by the general way.
    struct General<'a> {
        setting: &'a Setting,
        target: &'a [f64],
        record: &'a [f64],
    }

    impl LeastSquares for General<'_> {
        fn unknowns(&self) -> usize {
            4
        }
        fn equations(&self) -> usize {
            self.record.len()
        }
        fn bounds(&self) -> Vec<[f64; 2]> {
            self.setting.population.controller.to_vec()
        }
        fn evaluate(&self, x: &[f64], residuals: &mut DVector<f64>, jacobian: Option<&mut DMatrix<f64>>) -> bool {
            let value = |x: &[f64]| {
                let model = self.setting.model(x, self.setting.population.body, false)?;
                let (seen, _) = seen(self.target, x[3], self.setting.time.period_s());
                let input = DMatrix::from_fn(seen.len(), 2, |k, j| if j == 0 { seen[k] } else { 0.0 });
                Some(model.respond(&input).ok()?.output.column(0).into_owned())
            };
            let Some(found) = value(x) else { return false };
            for (k, y) in self.record.iter().enumerate() {
                residuals[k] = found[k] - y;
            }
            if let Some(jacobian) = jacobian {
                for j in 0..4 {
                    let h = 1e-6 * x[j];
                    let (mut up, mut down) = (x.to_vec(), x.to_vec());
                    (up[j], down[j]) = (x[j] + h, x[j] - h);
                    let (Some(up), Some(down)) = (value(&up), value(&down)) else { return false };
                    jacobian.set_column(j, &((up - down) / (2.0 * h)));
                }
            }
            true
        }
    }

    #[test]
    fn both_fits_find_the_same() {
        let mut setting = setting();
        setting.body_spread = 0.2;
        let target = setting.target([0.8, 0.6], &Ctl::new()).unwrap();
        // Off the grid of samples, where the delayed target has corners.
        let truth = [2.5, 0.25, 16.0, 0.2713];
        for draw in draws(&setting, 3, 11, "fit") {
            let record = setting.angle(truth, &target, &draw).unwrap();
            let own = fit(&setting, &target, &record, truth, 1e-7, &Ctl::new()).unwrap().unwrap();
            let general = General { setting: &setting, target: &target, record: &record };
            let options = Options { gradient_tolerance: 1e-6, max_evaluations: 200, ..Options::default() };
            let found = minimise(&general, &truth, &options, &Ctl::new()).unwrap();
            assert!(own.converged, "{own:?}");
            let cost = |theta: &[f64; 4]| sums(&setting, &target, &record, theta).unwrap().cost;
            let theirs: [f64; 4] = std::array::from_fn(|j| found.x[j]);
            assert!(cost(&own.theta) <= cost(&theirs) * (1.0 + 1e-6), "{own:?} {theirs:?}");
            for (j, [lower, upper]) in setting.population.controller.into_iter().enumerate() {
                assert!((own.theta[j] - theirs[j]).abs() < 2e-3 * (upper - lower), "{j}: {own:?} {theirs:?}");
            }
        }
    }

    #[test]
    fn the_sampled_loop_and_its_slopes_are_those_of_the_general_way() {
        let setting = setting();
        for theta in [[1.95, 0.11, 12.9, 0.24], [3.6, 0.42, 20.0, 0.3], [2.5, 0.25, 16.0, 0.27]] {
            let body = setting.population.body.map(|v| 1.1 * v);
            let general = setting.model(&theta, body, true).unwrap();
            let gains = [theta[0], theta[1], theta[2]];
            let own = Sampled::new(gains, body, setting.times(), setting.time, true).unwrap();
            let near = |found: f64, expected: f64, size: f64| assert!((found - expected).abs() < 1e-11 * size);
            let model = &general.value.model;
            for i in 0..5 {
                near(own.b[0][i], model.b()[(i, 0)], model.b().norm());
                near(own.b[1][i], model.b()[(i, 1)], model.b().norm());
                for j in 0..5 {
                    near(own.a[(i, j)], model.a()[(i, j)], model.a().norm());
                    for (slope, expected) in own.slopes.as_ref().unwrap().iter().zip(&general.slopes) {
                        near(slope.0[(i, j)], expected.a[(i, j)], 1.0 + expected.a.norm());
                        near(slope.1[i], expected.b[(i, 0)], 1.0 + expected.b.norm());
                    }
                }
            }
            assert_eq!(own.noise_to_acceleration, model.d()[(2, 1)]);
        }
    }
}
