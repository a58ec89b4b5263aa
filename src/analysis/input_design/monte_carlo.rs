//! Simulated records, and whether they say what was predicted.

use super::result::{MonteCarloParameter, MonteCarloResult};
use super::task::{Reached, Task, overflow};
use crate::analysis::contract::Failure;
use crate::analysis::report::Warning;
use crate::ctl::Ctl;
use crate::excite::design::refit::{Setting, refit};
use crate::num::distributions::f_cdf;

/// The level at which all intervals of a simulation hold together.
const JOINT_LEVEL: f64 = 0.95;

/// Simulates records with both inputs and fits them anew.
pub(super) fn monte_carlo(
    task: &Task<'_>,
    best: &Reached,
    warnings: &mut Vec<Warning>,
    ctl: &Ctl,
) -> Result<Option<MonteCarloResult>, Failure> {
    let Some(asked) = &task.spec.used.monte_carlo else { return Ok(None) };
    let inputs = [&best.start, &best.climb.input];
    let predicted = inputs.map(|u| task.information.fisher(u).deviations());
    let [Some(before), Some(after)] = predicted else {
        warnings.push(Warning::new(
            "not_simulated",
            "no records were simulated: a combination of parameters is not determined, and no fit would converge",
        ));
        return Ok(None);
    };
    let model = |theta: &[f64]| task.model.sampled(theta, task.time).ok();
    let noise = task.spec.covariance.clone().cholesky().map(|factor| factor.l()).unwrap_or_default();
    let setting = Setting {
        model: &model,
        theta: &task.theta,
        bounds: task.model.limits(),
        channel: task.spec.used.input,
        first: task.responses.first,
        measured: &task.spec.measured,
        noise,
    };
    let mut refits = Vec::new();
    for (u, name) in inputs.into_iter().zip(["start", "best"]) {
        let found = refit(&setting, u, asked.replicates, asked.seed, name, ctl)?;
        refits.push(found.ok_or_else(|| overflow("the model is not defined at its own parameters"))?);
    }
    let failed = [refits[0].failed, refits[1].failed];
    let (spread, means) = (refits.iter().map(|r| r.deviations()), refits.iter().map(|r| r.means()));
    let (Some(spread), Some(means)) = (spread.collect::<Option<Vec<_>>>(), means.collect::<Option<Vec<_>>>()) else {
        warnings.push(Warning::new("not_simulated", "fewer than two simulated records could be fitted"));
        return Ok(None);
    };
    let names = task.model.names();
    let level = 1.0 - (1.0 - JOINT_LEVEL) / names.len() as f64;
    let freedom = refits.iter().map(|r| r.parameters.len() as f64 - 1.0).collect::<Vec<_>>();
    let tail = 0.5 * (1.0 - level);
    let quantiles = [1.0 - tail, tail].map(|p| f_quantile(p, freedom[1], freedom[0]));
    let parameters: Vec<MonteCarloParameter> = names
        .into_iter()
        .enumerate()
        .filter(|(i, _)| spread.iter().all(|s| s[*i] > 0.0))
        .map(|(i, name)| {
            let ratio = (spread[1][i] / spread[0][i]).powi(2);
            let interval = quantiles.map(|q| ratio / q);
            let predicted_ratio = (after[i] / before[i]).powi(2);
            MonteCarloParameter {
                name,
                bias: [means[0][i] - task.theta[i], means[1][i] - task.theta[i]],
                standard_deviation: [spread[0][i], spread[1][i]],
                over_predicted: [spread[0][i] / before[i], spread[1][i] / after[i]],
                variance_ratio: ratio,
                interval,
                predicted_ratio,
                within: interval[0] <= predicted_ratio && predicted_ratio <= interval[1],
            }
        })
        .collect();
    let all_within = parameters.iter().all(|p| p.within);
    if !all_within {
        let outside: Vec<&str> = parameters.iter().filter(|p| !p.within).map(|p| p.name.as_str()).collect();
        warnings.push(Warning::new(
            "prediction_missed",
            format!(
                "the simulated variance ratios of {} do not agree with the predicted ones: at this noise the \
                 parameters' distribution is not that of the first order",
                outside.join(", ")
            ),
        ));
    }
    if failed != [0, 0] {
        warnings.push(Warning::new(
            "refits_failed",
            format!("{} and {} of {} fits did not converge and are left out", failed[0], failed[1], asked.replicates),
        ));
    }
    Ok(Some(MonteCarloResult {
        replicates: asked.replicates,
        failed,
        joint_level: JOINT_LEVEL,
        parameters,
        all_within,
    }))
}

/// The value that F with these degrees of freedom stays below with probability p.
fn f_quantile(p: f64, numerator: f64, denominator: f64) -> f64 {
    let (mut low, mut high) = (0.0, 1.0);
    while f_cdf(high, numerator, denominator) < p && high < 1e12 {
        high *= 2.0;
    }
    for _ in 0..100 {
        let middle = 0.5 * (low + high);
        if f_cdf(middle, numerator, denominator) < p { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}
