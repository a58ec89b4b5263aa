//! The fit of records: `min_{θ̂ ∈ Θ} Σ_k (ŷ_k − y_k)²` with the mean body and without noise.
//!
//! Levenberg and Marquardt's method with projection on the box, a record in every lane of the processor. Normal
//! equations are summed while the loops are simulated, so that an evaluation touches each sample once and keeps
//! nothing: four unknowns of like size lose no digits by that, and a search fits a hundred thousand records.
//!
//! With Y the response to the target without its delay, all derivatives are read off two simulations. The loop's
//! sensitivity filters the error e, its integral and its filtered slope alike, so that with the states' derivatives
//! with respect to K_p at hand
//!
//! ```text
//! ∂y/∂K_i = ∫ ∂y/∂K_p = −∂(∫e)/∂K_p,   ∂y/∂K_d = −∂((e − ξ)/T_f)/∂K_p = (∂y/∂K_p + ∂ξ/∂K_p)/T_f.
//! ```
//! The target is straight between samples; with τ = (D − f) T, D whole and 0 ≤ f < 1, the response to the delayed one
//! is `y_k = (1 − f) Y_{k−D} + f Y_{k−D+1}`, and `∂y_k/∂τ = −(Y_{k−D+1} − Y_{k−D})/T`.

use super::cost::{Setting, delay};
use super::lanes::{MOST, lanes, load, values};
use super::sampled::{Continuous, STATES, WITH_TARGET, next, sampled};
use crate::ctl::{Ctl, Stopped};
use nalgebra::{Matrix4, Vector4};
use pulp::{Simd, WithSimd};

/// Damping that counts as no step at all.
const LARGEST_DAMPING: f64 = 1e12;
/// Evaluations at most.
const EVALUATIONS: usize = 60;
/// A residual that is nothing but rounding, as a share of the record.
const ROUNDING: f64 = 1e-13;
/// The normal equations' entries on and above the diagonal.
const PAIRS: [[usize; 2]; 10] = [[0, 0], [0, 1], [0, 2], [0, 3], [1, 1], [1, 2], [1, 3], [2, 2], [2, 3], [3, 3]];

/// Parameters found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Fitted {
    pub theta: [f64; 4],
    pub converged: bool,
}

/// The sums at a point.
#[derive(Debug, Clone, Copy)]
struct Sums {
    cost: f64,
    gradient: Vector4<f64>,
    normal: Matrix4<f64>,
}

/// A record and what is tried for it.
#[derive(Clone, Copy)]
struct Trial<'a> {
    record: &'a [f64],
    theta: [f64; 4],
}

/// The sums of as many trials as there are lanes, or fewer; `None` where a loop is not defined or runs away.
#[inline(always)]
#[allow(clippy::needless_range_loop, reason = "chains of iterators are not inlined into code for vectors")]
fn sums<S: Simd>(simd: S, setting: &Setting, target: &[f64], trials: &[Trial<'_>]) -> [Option<Sums>; MOST] {
    let mut found = [None; MOST];
    let (period, times) = (setting.time.period_s(), setting.times());
    let continuous = |trial: &Trial<'_>| {
        let [k_p, k_d, k_i, _] = trial.theta;
        Continuous::new([k_p, k_d, k_i], setting.population.body, times, setting.time)
    };
    let defined: Vec<(usize, Continuous)> =
        trials.iter().enumerate().filter_map(|(l, trial)| Some((l, continuous(trial)?))).collect();
    if defined.is_empty() {
        return found;
    }
    let (places, loops): (Vec<usize>, Vec<Continuous>) = defined.into_iter().unzip();
    let own = |l: usize| &trials[places[l.min(places.len() - 1)]];
    let (rows, slopes) = sampled::<S, WITH_TARGET>(simd, &loops, true);
    let mut delays = [(0, 0.0); MOST];
    for (l, into) in delays.iter_mut().enumerate() {
        *into = delay(own(l).theta[3], period);
    }
    let shares = lanes(simd, |l| delays[l].1);
    let zero = simd.splat_f64s(0.0);
    let (mut state, mut moved) = ([zero; STATES], [zero; STATES]);
    let (mut cost, mut gradient, mut normal) = (zero, [zero; 4], [zero; PAIRS.len()]);
    // Raw derivatives without their factors, and the angle, at the last sample.
    let (mut angle, mut before) = (zero, [zero; 3]);
    // The records from where the target is seen.
    let mut rest = [&[][..]; MOST];
    for (l, rest) in rest.iter_mut().enumerate() {
        *rest = own(l).record.get(delays[l].0..).unwrap_or(&[]);
    }
    let lengths = rest.map(<[f64]>::len);
    let shortest = lengths.iter().copied().min().unwrap_or(0);
    for m in 0..target.len().min(lengths.iter().copied().max().unwrap_or(0)) {
        // The states at m + 1, then the record at m + D.
        let r = simd.splat_f64s(target[m]);
        moved = next(simd, &rows, &moved, &[]);
        let through = next(simd, &slopes, &state, &[r]);
        for i in 0..STATES {
            moved[i] = simd.add_f64s(moved[i], through[i]);
        }
        state = next(simd, &rows, &state, &[r]);
        let turn = simd.sub_f64s(state[0], angle);
        let now = [moved[0], simd.add_f64s(moved[0], moved[4]), moved[3]];
        let mut row = [turn; 4];
        for j in 0..3 {
            row[j] = simd.mul_add_f64s(shares, simd.sub_f64s(now[j], before[j]), before[j]);
        }
        let mut recorded = [0.0; MOST];
        for l in 0..S::F64_LANES {
            recorded[l] = *rest[l].get(m).unwrap_or(&0.0);
        }
        let mut error = simd.sub_f64s(simd.mul_add_f64s(shares, turn, angle), load(simd, &recorded));
        if m >= shortest {
            // A lane whose record has ended adds nothing.
            let weight = lanes(simd, |l| f64::from(u8::from(m < rest[l].len())));
            error = simd.mul_f64s(error, weight);
            for j in 0..4 {
                row[j] = simd.mul_f64s(row[j], weight);
            }
        }
        cost = simd.mul_add_f64s(error, error, cost);
        for j in 0..4 {
            gradient[j] = simd.mul_add_f64s(row[j], error, gradient[j]);
        }
        for pair in 0..PAIRS.len() {
            let [i, j] = PAIRS[pair];
            normal[pair] = simd.mul_add_f64s(row[i], row[j], normal[pair]);
        }
        (angle, before) = (state[0], now);
    }
    let (cost, gradient, normal) =
        (values(simd, cost), gradient.map(|v| values(simd, v)), normal.map(|v| values(simd, v)));
    // ∂y/∂K_p, ∂y/∂K_d, ∂y/∂K_i and ∂y/∂τ of the raw ones.
    let factors = [1.0, times[1].recip(), -1.0, -period.recip()];
    for (l, place) in places.iter().enumerate() {
        // Before the target is seen nothing moves.
        let unseen: f64 = trials[*place].record.iter().take(delays[l].0).map(|y| y * y).sum();
        let mut sums = Sums { cost: cost[l] + unseen, gradient: Vector4::zeros(), normal: Matrix4::zeros() };
        for j in 0..4 {
            sums.gradient[j] = factors[j] * gradient[j][l];
        }
        for ([i, j], of) in PAIRS.into_iter().zip(&normal) {
            sums.normal[(i, j)] = factors[i] * factors[j] * of[l];
            sums.normal[(j, i)] = sums.normal[(i, j)];
        }
        let is_finite = sums.cost.is_finite() && sums.normal.iter().all(|v| v.is_finite());
        found[*place] = is_finite.then_some(sums);
    }
    found
}

/// The way to the fit of one record.
struct Climb<'a> {
    place: usize,
    record: &'a [f64],
    size: f64,
    theta: [f64; 4],
    at: Option<Sums>,
    scale: Vector4<f64>,
    damping: f64,
    growth: f64,
    evaluations: usize,
    tried: [f64; 4],
}

/// What comes next.
enum Next {
    /// The sums at `tried`.
    Evaluate,
    /// Nothing.
    Done(Option<Fitted>),
}

impl<'a> Climb<'a> {
    fn new(place: usize, record: &'a [f64], start: [f64; 4]) -> Self {
        Self {
            place,
            record,
            size: record.iter().map(|y| y * y).sum(),
            theta: start,
            at: None,
            scale: Vector4::zeros(),
            damping: 1e-3,
            growth: 2.0,
            evaluations: 1,
            tried: start,
        }
    }

    /// Takes the sums at what was tried.
    fn take(&mut self, found: Option<Sums>, bounds: &[[f64; 2]; 4], tolerance: f64) -> Next {
        match (self.at, found) {
            (None, None) => return Next::Done(None),
            (None, Some(found)) => self.at = Some(found),
            (Some(at), Some(found)) if found.cost < at.cost => {
                let moved = Vector4::from_fn(|j, _| self.tried[j] - self.theta[j]);
                let predicted = -(2.0 * at.gradient.dot(&moved) + (moved.transpose() * at.normal * moved)[(0, 0)]);
                let ratio = (at.cost - found.cost) / predicted.max(f64::MIN_POSITIVE);
                self.damping *= f64::max(1.0 / 3.0, 1.0 - (2.0 * ratio.min(2.0) - 1.0).powi(3));
                self.damping = self.damping.max(1e-12);
                self.growth = 2.0;
                (self.theta, self.at) = (self.tried, Some(found));
            }
            _ => self.dampen(),
        }
        self.step(bounds, tolerance)
    }

    fn dampen(&mut self) {
        self.damping *= self.growth;
        self.growth *= 2.0;
    }

    /// The next point to try, or the end.
    fn step(&mut self, bounds: &[[f64; 2]; 4], tolerance: f64) -> Next {
        let done = |theta, converged| Next::Done(Some(Fitted { theta, converged }));
        let Some(at) = self.at else { return Next::Done(None) };
        let theta = self.theta;
        while self.evaluations < EVALUATIONS && self.damping <= LARGEST_DAMPING {
            self.evaluations += 1;
            self.scale = self.scale.zip_map(&at.normal.diagonal(), f64::max);
            if at.cost <= ROUNDING * ROUNDING * self.size {
                return done(theta, true);
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
                return done(theta, true);
            }
            let (mut matrix, mut right) = (at.normal, -at.gradient);
            for j in 0..4 {
                matrix[(j, j)] += self.damping * self.scale[j].max(f64::MIN_POSITIVE);
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
            if let Some(next) = next {
                self.tried = next;
                return Next::Evaluate;
            }
            self.dampen();
        }
        done(theta, false)
    }
}

/// Fits of records, one after the other in every lane.
struct Fits<'a> {
    setting: &'a Setting,
    target: &'a [f64],
    records: &'a [&'a [f64]],
    start: [f64; 4],
    tolerance: f64,
    ctl: &'a Ctl,
}

impl WithSimd for Fits<'_> {
    type Output = Result<Vec<Option<Fitted>>, Stopped>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        let bounds = &self.setting.population.controller;
        let mut found = vec![None; self.records.len()];
        let mut waiting = self.records.iter().enumerate().map(|(place, record)| Climb::new(place, record, self.start));
        let mut climbs: Vec<Climb<'_>> = waiting.by_ref().take(S::F64_LANES.min(MOST)).collect();
        let mut trials: Vec<Trial<'_>> = Vec::with_capacity(climbs.len());
        while !climbs.is_empty() {
            self.ctl.check()?;
            trials.clear();
            trials.extend(climbs.iter().map(|climb| Trial { record: climb.record, theta: climb.tried }));
            let sums = sums(simd, self.setting, self.target, &trials);
            let mut going = Vec::with_capacity(climbs.len());
            for (mut climb, sums) in climbs.into_iter().zip(sums) {
                match climb.take(sums, bounds, self.tolerance) {
                    Next::Evaluate => going.push(climb),
                    Next::Done(fitted) => {
                        found[climb.place] = fitted;
                        going.extend(waiting.next());
                    }
                }
            }
            climbs = going;
        }
        Ok(found)
    }
}

/// Fits each record from a start within the box; where one does not converge, the best that it found. `None` where the
/// loop is not defined at the start.
///
/// # Errors
/// [`Stopped`].
pub(super) fn fits(
    setting: &Setting,
    target: &[f64],
    records: &[&[f64]],
    start: [f64; 4],
    tolerance: f64,
    ctl: &Ctl,
) -> Result<Vec<Option<Fitted>>, Stopped> {
    pulp::Arch::new().dispatch(Fits { setting, target, records, start, tolerance, ctl })
}

#[cfg(test)]
mod tests {
    use super::super::cost::{draws, seen, tests::setting};
    use super::super::sampled::{Rows, WITH_NOISE, acceleration};
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
                let seen = seen(self.target, x[3], self.setting.time.period_s());
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

    fn one(setting: &Setting, target: &[f64], record: &[f64], theta: [f64; 4]) -> Sums {
        sums(pulp::Scalar::new(), setting, target, &[Trial { record, theta }])[0].unwrap()
    }

    #[test]
    fn both_fits_find_the_same() {
        let mut setting = setting();
        setting.body_spread = 0.2;
        let target = setting.target([0.8, 0.6], &Ctl::new()).unwrap();
        // Off the grid of samples, where the delayed target has corners.
        let truth = [2.5, 0.25, 16.0, 0.2713];
        // More than there are lanes, so that lanes take a second record.
        let records: Vec<Vec<f64>> =
            draws(&setting, 11, 11, "fit").iter().map(|draw| setting.angle(truth, &target, draw).unwrap()).collect();
        let borrowed: Vec<&[f64]> = records.iter().map(Vec::as_slice).collect();
        let all = fits(&setting, &target, &borrowed, truth, 1e-7, &Ctl::new()).unwrap();
        for (i, (record, own)) in records.iter().zip(&all).enumerate() {
            let own = own.unwrap();
            assert!(own.converged, "{own:?}");
            let alone = fits(&setting, &target, &[record], truth, 1e-7, &Ctl::new()).unwrap();
            assert_eq!(alone, [Some(own)], "neighbours do not matter");
            if i >= 3 {
                continue;
            }
            let general = General { setting: &setting, target: &target, record };
            let options = Options { gradient_tolerance: 1e-6, max_evaluations: 200, ..Options::default() };
            let found = minimise(&general, &truth, &options, &Ctl::new()).unwrap();
            let cost = |theta: [f64; 4]| one(&setting, &target, record, theta).cost;
            let theirs: [f64; 4] = std::array::from_fn(|j| found.x[j]);
            assert!(cost(own.theta) <= cost(theirs) * (1.0 + 1e-6), "{own:?} {theirs:?}");
            for (j, [lower, upper]) in setting.population.controller.into_iter().enumerate() {
                assert!((own.theta[j] - theirs[j]).abs() < 2e-3 * (upper - lower), "{j}: {own:?} {theirs:?}");
            }
        }
    }

    /// Costs, gradients and normal equations of lanes that differ in their delays, against differences of the general
    /// model's responses.
    #[test]
    fn the_sums_are_those_of_the_general_model_in_every_lane() {
        let setting = setting();
        let target = setting.target([0.9, 0.6], &Ctl::new()).unwrap();
        let draw = &draws(&setting, 1, 5, "sums")[0];
        let record = setting.angle([2.5, 0.25, 16.0, 0.2713], &target, draw).unwrap();
        let tried = [[2.4, 0.2, 15.0, 0.2413], [3.1, 0.3, 17.0, 0.3033], [2.0, 0.12, 13.0, 0.2711]];
        let trials: Vec<Trial<'_>> = tried.iter().map(|theta| Trial { record: &record, theta: *theta }).collect();
        struct All<'a>(&'a Setting, &'a [f64], &'a [Trial<'a>]);
        impl WithSimd for All<'_> {
            type Output = Vec<Sums>;
            #[inline(always)]
            fn with_simd<S: Simd>(self, simd: S) -> Vec<Sums> {
                let groups = self.2.chunks(S::F64_LANES);
                groups.flat_map(|group| sums(simd, self.0, self.1, group).into_iter().flatten()).collect()
            }
        }
        let together = pulp::Arch::new().dispatch(All(&setting, &target, &trials));
        assert_eq!(together.len(), tried.len());
        for (theta, found) in tried.into_iter().zip(together) {
            let alone = one(&setting, &target, &record, theta);
            assert_eq!((alone.cost, alone.gradient, alone.normal), (found.cost, found.gradient, found.normal));
            let general = General { setting: &setting, target: &target, record: &record };
            let mut residuals = DVector::zeros(record.len());
            let mut jacobian = DMatrix::zeros(record.len(), 4);
            assert!(general.evaluate(&theta, &mut residuals, Some(&mut jacobian)));
            assert!((found.cost - residuals.norm_squared()).abs() < 1e-11 * found.cost);
            let (gradient, normal) = (jacobian.tr_mul(&residuals), jacobian.tr_mul(&jacobian));
            for i in 0..4 {
                let size = jacobian.column(i).norm();
                assert!((found.gradient[i] - gradient[i]).abs() < 1e-6 * size * residuals.norm(), "{i} {found:?}");
                for j in 0..4 {
                    let both = size * jacobian.column(j).norm();
                    assert!((found.normal[(i, j)] - normal[(i, j)]).abs() < 1e-6 * both, "{i} {j} {found:?}");
                }
            }
        }
    }

    #[test]
    fn the_sampled_loop_and_its_slope_are_those_of_the_general_way() {
        let setting = setting();
        for theta in [[1.95, 0.11, 12.9, 0.24], [3.6, 0.42, 20.0, 0.3], [2.5, 0.25, 16.0, 0.27]] {
            let body = setting.population.body.map(|v| 1.1 * v);
            let general = setting.model(&theta, body, true).unwrap();
            let gains = [theta[0], theta[1], theta[2]];
            let own = Continuous::new(gains, body, setting.times(), setting.time).unwrap();
            let simd = pulp::Scalar::new();
            let (rows, slope): (Rows<pulp::Scalar, WITH_NOISE>, _) = sampled(simd, std::slice::from_ref(&own), true);
            let near = |found: f64, expected: f64, size: f64| assert!((found - expected).abs() < 1e-11 * size);
            let model = &general.value.model;
            for i in 0..STATES {
                for j in 0..2 {
                    near(rows[i][STATES + j], model.b()[(i, j)], model.b().norm());
                    near(slope[i][STATES + j], general.slopes[0].b[(i, j)], 1.0 + general.slopes[0].b.norm());
                }
                for j in 0..STATES {
                    near(rows[i][j], model.a()[(i, j)], model.a().norm());
                    near(slope[i][j], general.slopes[0].a[(i, j)], 1.0 + general.slopes[0].a.norm());
                }
            }
            assert_eq!(acceleration(simd, &[own])[STATES], model.d()[(2, 1)]);
        }
    }
}
