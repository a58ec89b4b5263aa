//! Does the experiment tell what it promises? Simulated records, fitted anew.

use super::responses::Response;
use crate::control::Discrete;
use crate::control::parametric::Differentiated;
use crate::ctl::{Ctl, Stopped};
use crate::num::least_squares::{LeastSquares, LeastSquaresError, Options, minimise};
use crate::num::rng::stream;
use crate::num::stats::{mean, standard_deviation};
use nalgebra::{DMatrix, DVector};
use rand_distr::{Distribution as _, StandardNormal};
use rayon::prelude::*;

/// A model at any parameters, sampled and with its derivatives; `None` where it is not defined.
pub type At<'a> = dyn Fn(&[f64]) -> Option<Differentiated<Discrete>> + Sync + 'a;

/// What is simulated and fitted.
pub struct Setting<'a> {
    /// The model.
    pub model: &'a At<'a>,
    /// The true parameters, from which every fit starts.
    pub theta: &'a [f64],
    /// Between which values a fit may move each.
    pub bounds: Vec<[f64; 2]>,
    /// The column of the model's input that is driven.
    pub channel: usize,
    /// 1 where the record begins with y₁; see [`Responses`](super::Responses).
    pub first: usize,
    /// The outputs that are measured.
    pub measured: &'a [usize],
    /// The lower Cholesky factor of the noise's covariance.
    pub noise: DMatrix<f64>,
}

/// Parameters fitted to simulated records.
#[derive(Debug, Clone, PartialEq)]
pub struct Refits {
    /// One row for each record whose fit converged.
    pub parameters: Vec<Vec<f64>>,
    /// Records whose fit did not converge.
    pub failed: usize,
}

impl Refits {
    /// Standard deviation of each parameter over the records; `None` with fewer than two.
    #[must_use]
    pub fn deviations(&self) -> Option<Vec<f64>> {
        self.by_parameter().map(|values| standard_deviation(&values)).collect()
    }

    /// Mean of each parameter.
    #[must_use]
    pub fn means(&self) -> Option<Vec<f64>> {
        self.by_parameter().map(|values| mean(&values)).collect()
    }

    fn by_parameter(&self) -> impl Iterator<Item = Vec<f64>> {
        let count = self.parameters.first().map_or(0, Vec::len);
        (0..count).map(|i| self.parameters.iter().map(|row| row[i]).collect())
    }
}

struct Fit<'a> {
    setting: &'a Setting<'a>,
    input: DMatrix<f64>,
    record: DVector<f64>,
    /// Inverse of the noise's factor.
    white: DMatrix<f64>,
}

impl Fit<'_> {
    /// Whitens one sample of all measured outputs after another.
    fn whitened(&self, outputs: &DMatrix<f64>, into: &mut [f64]) {
        let p = self.setting.measured.len();
        for (k, part) in into.chunks_mut(p).enumerate() {
            let row = DVector::from_fn(p, |o, _| outputs[(k + self.setting.first, self.setting.measured[o])]);
            for (into, value) in part.iter_mut().zip((&self.white * row).iter()) {
                *into = *value;
            }
        }
    }
}

impl LeastSquares for Fit<'_> {
    fn unknowns(&self) -> usize {
        self.setting.theta.len()
    }

    fn equations(&self) -> usize {
        self.record.len()
    }

    fn evaluate(&self, x: &[f64], residuals: &mut DVector<f64>, jacobian: Option<&mut DMatrix<f64>>) -> bool {
        let Some(mut model) = (self.setting.model)(x) else { return false };
        if jacobian.is_none() {
            model.slopes.clear();
        }
        let Ok(found) = model.respond(&self.input) else { return false };
        self.whitened(&found.output, residuals.as_mut_slice());
        *residuals -= &self.record;
        if let Some(jacobian) = jacobian {
            for (slope, mut column) in found.slopes.iter().zip(jacobian.column_iter_mut()) {
                self.whitened(slope, column.as_mut_slice());
            }
        }
        true
    }

    fn bounds(&self) -> Vec<[f64; 2]> {
        self.setting.bounds.clone()
    }
}

/// Simulates `replicates` records of an input with independent noise and fits each by maximum likelihood, `min_θ Σ_k
/// (ỹ_k − y_k(θ))ᵀ Σ⁻¹ (ỹ_k − y_k(θ))`. `name` and `seed` determine the noise. Progress advances by one for each
/// record.
///
/// `None` where the model is not defined at its own parameters or the noise has no inverse.
///
/// # Errors
/// [`Stopped`] when `ctl` says so.
pub fn refit(
    setting: &Setting<'_>,
    u: &[f64],
    replicates: usize,
    seed: u64,
    name: &str,
    ctl: &Ctl,
) -> Result<Option<Refits>, Stopped> {
    let p = setting.measured.len();
    let Some(white) = setting.noise.solve_lower_triangular(&DMatrix::identity(p, p)) else { return Ok(None) };
    let Some(mut truth) = (setting.model)(setting.theta) else { return Ok(None) };
    truth.slopes.clear();
    let inputs = truth.value.model.inputs();
    let mut input = DMatrix::zeros(u.len() + setting.first, inputs);
    for (k, u) in u.iter().enumerate() {
        input[(k, setting.channel)] = *u;
    }
    let Ok(exact) = truth.respond(&input) else { return Ok(None) };
    let fits: Vec<Option<Vec<f64>>> = (0..replicates)
        .into_par_iter()
        .map(|replicate| {
            let mut random = stream(seed, &format!("excite/design/refit/{name}/{replicate}"));
            let mut fit =
                Fit { setting, input: input.clone(), record: DVector::zeros(u.len() * p), white: white.clone() };
            let mut record = vec![0.0; u.len() * p];
            fit.whitened(&exact.output, &mut record);
            // Whitened noise is of unit variance.
            for value in &mut record {
                let noise: f64 = StandardNormal.sample(&mut random);
                *value += noise;
            }
            fit.record = DVector::from_vec(record);
            let options = Options { gradient_tolerance: 1e-6, max_evaluations: 200, ..Options::default() };
            let found = match minimise(&fit, setting.theta, &options, ctl) {
                Ok(found) => found.stop.is_converged().then_some(found.x),
                Err(LeastSquaresError::Stopped(stopped)) => return Err(stopped),
                Err(_) => None,
            };
            ctl.advance(1);
            Ok(found)
        })
        .collect::<Result<_, Stopped>>()?;
    let failed = fits.iter().filter(|fit| fit.is_none()).count();
    Ok(Some(Refits { parameters: fits.into_iter().flatten().collect(), failed }))
}

/// Peak and root mean square of a response.
#[must_use]
pub fn peak_and_rms(response: &Response, u: &[f64]) -> [f64; 2] {
    let y = response.to(u);
    let peak = y.iter().fold(0.0, |peak: f64, y| peak.max(y.abs()));
    [peak, (y.iter().map(|y| y * y).sum::<f64>() / y.len().max(1) as f64).sqrt()]
}
