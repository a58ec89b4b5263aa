//! The cost of a fit: misfits of the lines, whitened by their covariance.

use crate::num::least_squares::LeastSquares;
use crate::two_stimulus::responses::{LineResponse, UD, UR, YD, YR};
use crate::two_stimulus::structure::{Parameter, Person};
use nalgebra::{DMatrix, DVector};
use num_complex::Complex64;

/// Which responses are fitted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Channel {
    /// H_ur and H_ud.
    Control,
    /// H_yr and H_yd.
    Output,
}

/// Lines that the noise of a line is smoothed over.
const NEIGHBOURS: usize = 7;

/// A misfit `e` at a line: the values, and the inverse of the Cholesky factor of their covariance.
pub(super) struct Target {
    pub(super) omega: f64,
    /// Positions in `[H_ur, H_yr, H_ud, H_yd]`, with the data.
    pub(super) wanted: Vec<(usize, Complex64)>,
    /// Rows of the whitening, lower triangular.
    pub(super) whitening: Vec<Vec<Complex64>>,
}

/// The misfits of all lines as a least-squares problem in the internal unknowns: the parameters, or their logarithms.
pub(super) struct Cost<'a> {
    pub(super) person: &'a Person,
    pub(super) targets: &'a [Target],
    pub(super) equations: usize,
}

/// The parameter that an internal unknown stands for.
pub(super) fn outside(parameter: &Parameter, x: f64) -> f64 {
    if parameter.logarithmic { x.exp() } else { x }
}

/// The internal unknown of a parameter.
pub(super) fn inside(parameter: &Parameter, value: f64) -> f64 {
    if parameter.logarithmic { value.ln() } else { value }
}

impl Cost<'_> {
    pub(super) fn values(&self, x: &[f64]) -> Vec<f64> {
        self.person.parameters().iter().zip(x).map(|(p, x)| outside(p, *x)).collect()
    }

    fn residuals(&self, x: &[f64], into: &mut DVector<f64>) -> bool {
        let values = self.values(x);
        let mut row = 0;
        for target in self.targets {
            let model = self.person.closed_loop(&values, target.omega);
            let e: Vec<Complex64> = target.wanted.iter().map(|(i, data)| data - model[*i]).collect();
            for weights in &target.whitening {
                let sum: Complex64 = weights.iter().zip(&e).map(|(w, e)| w * e).sum();
                // The real and the imaginary part have half of the variance each.
                into[row] = std::f64::consts::SQRT_2 * sum.re;
                into[row + 1] = std::f64::consts::SQRT_2 * sum.im;
                row += 2;
            }
        }
        into.iter().all(|v| v.is_finite())
    }
}

/// Step of the central differences, in internal units.
pub(super) const STEP: f64 = 1e-6;

impl LeastSquares for Cost<'_> {
    fn unknowns(&self) -> usize {
        self.person.parameters().len()
    }

    fn equations(&self) -> usize {
        self.equations
    }

    fn evaluate(&self, x: &[f64], residuals: &mut DVector<f64>, jacobian: Option<&mut DMatrix<f64>>) -> bool {
        if !self.residuals(x, residuals) {
            return false;
        }
        let Some(jacobian) = jacobian else { return true };
        let mut moved = x.to_vec();
        let (mut above, mut below) = (residuals.clone(), residuals.clone());
        for j in 0..x.len() {
            let step = STEP * x[j].abs().max(1.0);
            moved[j] = x[j] + step;
            let is_fine = self.residuals(&moved, &mut above);
            moved[j] = x[j] - step;
            if !(is_fine && self.residuals(&moved, &mut below)) {
                return false;
            }
            moved[j] = x[j];
            jacobian.set_column(j, &((&above - &below) / (2.0 * step)));
        }
        true
    }

    fn bounds(&self) -> Vec<[f64; 2]> {
        self.person.parameters().iter().map(|p| p.range.map(|value| inside(p, value))).collect()
    }

    fn is_feasible(&self, x: &[f64]) -> bool {
        self.person.is_stable(&self.values(x))
    }
}

/// What each line's covariance is multiplied by, to have the smoothed noise; 1 where its noise was given.
fn smoothing(responses: &[LineResponse], channel: Channel) -> Vec<f64> {
    let which = usize::from(channel == Channel::Output);
    // (position, ln ω, ln σ² without bias, weight)
    let known: Vec<(usize, f64, f64, f64)> = responses
        .iter()
        .enumerate()
        .filter_map(|(i, line)| {
            let noise = line.noise?[which];
            (noise > 0.0).then(|| (i, line.omega_rad_s.ln(), noise.ln() + 0.5 / line.freedoms, line.freedoms))
        })
        .collect();
    let mut factors = vec![1.0; responses.len()];
    for (i, x, _, _) in &known {
        let mut distances: Vec<f64> = known.iter().map(|(_, other, _, _)| (other - x).abs()).collect();
        distances.sort_by(f64::total_cmp);
        // The farthest of the neighbours still counts a little.
        let reach = 1.1 * distances[(NEIGHBOURS - 1).min(distances.len() - 1)];
        let mut sums = [0.0; 5];
        for (_, other, level, weight) in &known {
            let distance = if reach > 0.0 { (other - x).abs() / reach } else { 0.0 };
            if distance < 1.0 {
                let w = weight * (1.0 - distance.powi(3)).powi(3);
                let t = other - x;
                for (sum, term) in sums.iter_mut().zip([1.0, t, t * t, *level, t * level]) {
                    *sum += w * term;
                }
            }
        }
        let [n, t, tt, level, t_level] = sums;
        let determinant = n * tt - t * t;
        let smooth = if determinant > 1e-9 * n * tt { (tt * level - t * t_level) / determinant } else { level / n };
        if let Some(noise) = responses[*i].noise {
            factors[*i] = smooth.exp() / noise[which];
        }
    }
    factors
}

/// The misfits to weigh, of the lines that have a response.
pub(super) fn targets(responses: &[LineResponse], channel: Channel, weighted: bool) -> Vec<Target> {
    let factors = smoothing(responses, channel);
    let (r, d) = if channel == Channel::Control { (UR, UD) } else { (YR, YD) };
    let mut targets = Vec::new();
    for (line, factor) in responses.iter().zip(factors) {
        let pick = |pair: [Complex64; 2]| if channel == Channel::Control { pair[0] } else { pair[1] };
        let wanted: Vec<(usize, Complex64)> = [(r, line.command), (d, line.disturbance)]
            .into_iter()
            .filter_map(|(i, pair)| Some((i, pick(pair?))))
            .collect();
        if wanted.is_empty() {
            continue;
        }
        let one = Complex64::from(1.0);
        let whitening = match (&line.covariance, weighted) {
            (Some(c), true) => {
                let c = DMatrix::from_fn(wanted.len(), wanted.len(), |a, b| c[(wanted[a].0, wanted[b].0)] * factor);
                let Some(factor) = c.cholesky() else { continue };
                let n = wanted.len();
                let Some(inverse) = factor.l().solve_lower_triangular(&DMatrix::identity(n, n)) else { continue };
                (0..n).map(|a| (0..n).map(|b| inverse[(a, b)]).collect()).collect()
            }
            _ => (0..wanted.len())
                .map(|a| (0..wanted.len()).map(|b| if a == b { one } else { 0.0.into() }).collect())
                .collect(),
        };
        targets.push(Target { omega: line.omega_rad_s, wanted, whitening });
    }
    targets
}
