//! The refined controllers of a result, with how far they can be trusted.

use super::result::{Stability, TrialVaf};
use crate::analysis::report::Warning;
use crate::control::{Model, System};
use crate::ctl::{Ctl, Phase, Stopped};
use crate::identify::identifiability::{Identifiability, Structure, judge};
use crate::identify::problem::{Lines, Problem};
use crate::identify::refine::{
    ActiveConstraint, Bootstrap, Delays, Noise, RefineError, Refined, Refinement, ResidualTests, ScanPoint, Setup,
    Start, Uncertainty, refine_with_delays,
};
use crate::identify::ssid::Identified;
use crate::identify::time::Time;
use crate::learning::frequency_domain::{ControllerMetrics, controller_metrics_delayed};
use crate::num::least_squares::Stop;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Draws of a bootstrap at most.
pub(super) const MAX_DRAWS: usize = 100_000;

/// Significance below which a residual test becomes a warning.
const SIGNIFICANT: f64 = 0.01;

/// Below these degrees of freedom, weights by inverse estimated variance are themselves mostly noise.
const FEW_DEGREES: f64 = 10.0;

/// A parametric bootstrap.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BootstrapSpec {
    /// Responses drawn and refined again.
    pub draws: usize,
    /// Seed of the draws.
    pub seed: u64,
}

/// Why the refinement stopped.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum RefinementStop {
    /// The gradient is zero to its tolerance, as far as no constraint holds it.
    Converged,
    /// The residuals are nothing but rounding.
    PerfectFit,
    /// No step decreases the cost measurably, though the gradient is above its tolerance.
    Precision,
    /// Every step is refused by the test of stability with a delay.
    Blocked,
    /// The evaluations ran out.
    EvaluationLimit,
}

impl From<Stop> for RefinementStop {
    fn from(stop: Stop) -> Self {
        match stop {
            Stop::Converged => Self::Converged,
            Stop::PerfectFit => Self::PerfectFit,
            Stop::Precision => Self::Precision,
            Stop::Blocked => Self::Blocked,
            Stop::EvaluationLimit => Self::EvaluationLimit,
        }
    }
}

/// A local optimum of all coefficients, from the pool's best candidate, the stability margin kept.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct RefinedResult {
    /// Gff.
    pub feedforward: Model,
    /// Gfb.
    pub feedback: Model,
    /// The feedback's delay, `Gfb e^{−sτ}`.
    pub feedback_delay_s: f64,
    /// The feedforward's delay.
    pub feedforward_delay_s: f64,
    /// J at every pair of delays tried; empty without delays.
    pub delay_scan: Vec<ScanPoint>,
    /// J, refined.
    pub cost: f64,
    /// J of the pool's best candidate, where the refinement began.
    pub pool_cost: f64,
    /// J once more, from the coefficients of the transfer functions as written here.
    pub cost_of_coefficients: f64,
    /// Whether it is a local optimum: the gradient vanishes, or the fit is perfect.
    pub converged: bool,
    /// Why it stopped.
    pub stop: RefinementStop,
    /// Largest cosine between the residual and a column of its derivatives, as far as no active constraint holds it: 0
    /// at a local optimum.
    pub gradient_norm: f64,
    /// What holds the optimum back: with any, a better fit would leave the stability margin.
    pub active_constraints: Vec<ActiveConstraint>,
    /// Steps.
    pub iterations: usize,
    /// Evaluations of the residuals.
    pub evaluations: usize,
    /// Poles of the closed loop as `[re, im]`: of the feedforward, then of the feedback loop.
    pub closed_loop_poles: Vec<[f64; 2]>,
    /// Closed-loop stability.
    pub stability: Stability,
    /// Norms over the band of the result's `metrics`, of the controllers with their delays.
    pub metrics: ControllerMetrics,
    /// How well the lines tell the coefficients apart, at the refined optimum.
    pub identifiability: Identifiability,
    /// Simulation on the trials that were fitted; empty without trials.
    pub simulated_vaf: Vec<TrialVaf>,
    /// Covariance and pointwise 95 % bands; null where the noise is not known.
    pub uncertainty: Option<Uncertainty>,
    /// Why `uncertainty` is null.
    pub uncertainty_reason: Option<String>,
    /// The residuals against the noise; null where the noise is not known or no equation is left over.
    pub residual_tests: Option<ResidualTests>,
    /// Where the spec asks for it and the noise is known.
    pub bootstrap: Option<Bootstrap>,
}

/// What the noise of the lines is, as far as it is known.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct KnownNoise {
    /// By angular frequency in rad/s.
    pub variance: Vec<(f64, f64)>,
    /// Real degrees of freedom of each; infinite if given as known.
    pub degrees_of_freedom: f64,
    /// Whether they are independent estimates.
    pub are_independent: bool,
}

impl KnownNoise {
    /// At the lines of an identification.
    pub(super) fn at_lines(&self, found: &Identified) -> Option<Noise> {
        self.at(found.lines.iter().map(|(line, _)| line.omega_rad_s))
    }

    /// At the lines used.
    fn at(&self, omega: impl Iterator<Item = f64>) -> Option<Noise> {
        let find = |omega: f64| self.variance.iter().find(|(line, _)| *line == omega).map(|(_, v)| *v);
        let variance: Option<Vec<f64>> = omega.map(find).collect();
        let variance = variance.filter(|v| v.iter().all(|v| v.is_finite() && *v > 0.0))?;
        Some(Noise { variance, degrees_of_freedom: self.degrees_of_freedom, are_independent: self.are_independent })
    }
}

/// What a refinement is asked for.
pub(super) struct Questions<'a> {
    pub structure: Structure,
    pub noise: Option<&'a KnownNoise>,
    /// Whether lines are weighted by the inverse of the noise's variance.
    pub is_weighted_by_noise: bool,
    pub bootstrap: Option<BootstrapSpec>,
    /// The band of the norms.
    pub band_rad_s: [f64; 2],
    pub delays: Option<&'a Delays>,
    /// Gff and Gfb to start from instead of the best candidate.
    pub start: Option<&'a [System; 2]>,
}

/// The least-squares problem of an identification.
pub(super) fn problem_of(found: &Identified, structure: Structure) -> Result<Problem, String> {
    let used = found.lines.iter().map(|(line, _)| *line).collect();
    let lines = Lines { time: Time::of(&found.plant), used, dropped: Vec::new() };
    Problem::holding(structure.held, &lines, structure.feedforward_numerator).map_err(|error| error.to_string())
}

/// Refines what was identified; the text says why there is no refinement.
pub(super) fn refine(
    found: &Identified,
    questions: &Questions<'_>,
    warnings: &mut Vec<Warning>,
    ctl: &Ctl,
) -> Result<Result<(Refined, RefinedResult), String>, Stopped> {
    let problem = match problem_of(found, questions.structure) {
        Ok(problem) => problem,
        Err(reason) => return Ok(Err(reason)),
    };
    let setup = Setup {
        problem: &problem,
        plant: &found.plant,
        structure: questions.structure,
        margin_per_s: found.stability_margin,
    };
    let [feedforward, feedback] = questions.start.map_or([&found.feedforward, &found.feedback], |[ff, fb]| [ff, fb]);
    let start = Start::of(feedforward, feedback);
    let draws = questions.bootstrap.map_or(0, |bootstrap| bootstrap.draws) as f64;
    ctl.enter(Phase::Fit, 1.0 / (1.0 + draws));
    let refinement = match questions.delays {
        None => Refinement::new(setup, &start, ctl).map(|refinement| (refinement, Vec::new())),
        Some(delays) => refine_with_delays(setup, &start, delays, ctl),
    };
    let (refinement, delay_scan) = match refinement {
        Ok(found) => found,
        Err(RefineError::Stopped(stopped)) => return Err(stopped),
        Err(error) => return Ok(Err(error.to_string())),
    };
    let refined = match refinement.refined() {
        Ok(refined) => refined,
        Err(error) => return Ok(Err(error.to_string())),
    };
    let noise = questions.noise.and_then(|noise| noise.at_lines(found));
    let uncertainty = noise.as_ref().and_then(|noise| refinement.uncertainty(noise));
    let residual_tests = noise.as_ref().and_then(|noise| refinement.residual_tests(noise));
    ctl.enter(Phase::Intervals, 1.0);
    let bootstrap = match (&noise, questions.bootstrap) {
        (Some(noise), Some(spec)) => Some(refinement.bootstrap(noise, spec.draws, spec.seed, ctl)?),
        _ => None,
    };
    let uncertainty_reason = match (&noise, &uncertainty) {
        (None, _) => Some(
            "the variance of the response is not known at every line: give it, use two segments or more, or lines with \
             dark ones nearby"
                .to_owned(),
        ),
        (_, None) => Some("the derivatives at the optimum have no singular value decomposition".to_owned()),
        _ => None,
    };
    // ‖Gff e^{−jωτ} G − 1‖ is that of the plant with the feedforward's delay; a delay leaves ‖Gfb‖ as it is.
    let (plant, [low, high]) = (&found.plant, questions.band_rad_s);
    let delay_s = refined.feedforward_delay_s;
    let metrics = controller_metrics_delayed(plant, delay_s, &refined.feedforward, &refined.feedback, (low, high));
    let metrics = match metrics {
        Ok(metrics) => metrics,
        Err(error) => return Ok(Err(error.to_string())),
    };
    let time = Time::of(&found.plant);
    let result = RefinedResult {
        feedforward: refined.feedforward.to_model(),
        feedback: refined.feedback.to_model(),
        feedback_delay_s: refined.feedback_delay_s,
        feedforward_delay_s: refined.feedforward_delay_s,
        delay_scan,
        cost: refined.cost,
        pool_cost: found.optimum.cost,
        cost_of_coefficients: refined.cost_of_coefficients,
        converged: refined.stop.is_converged(),
        stop: refined.stop.into(),
        gradient_norm: refined.gradient_cosine,
        active_constraints: refined.active.clone(),
        iterations: refined.iterations,
        evaluations: refined.evaluations,
        closed_loop_poles: refined.closed_loop_poles.iter().map(|p| [p.re, p.im]).collect(),
        stability: Stability {
            largest_exponent_per_s: refined.slowest_exponent,
            spectral_radius: time
                .sample_time_s()
                .map(|_| refined.closed_loop_poles.iter().map(|p| p.norm()).fold(0.0, f64::max)),
            margin_per_s: found.stability_margin,
        },
        metrics,
        identifiability: judge(&problem, questions.structure, &refined.feedforward, &refined.feedback),
        simulated_vaf: Vec::new(),
        uncertainty,
        uncertainty_reason,
        residual_tests,
        bootstrap,
    };
    warn(&result, questions, noise.as_ref(), warnings);
    Ok(Ok((refined, result)))
}

fn warn(result: &RefinedResult, questions: &Questions<'_>, noise: Option<&Noise>, warnings: &mut Vec<Warning>) {
    let mut say = |code: &'static str, message: String| warnings.push(Warning::new(code, message));
    if !result.converged {
        say(
            "refinement_not_converged",
            format!(
                "the refinement stopped ({:?}) before a local optimum: its cost {:.6e} is an upper bound, and it has \
                 no bands",
                result.stop, result.cost
            ),
        );
    }
    if !result.active_constraints.is_empty() {
        say(
            "stability_margin_active",
            format!(
                "the stability margin of {} /s holds the refined optimum ({:?}): a loop outside of it would fit \
                 better, and estimates on a constraint have no bands",
                result.stability.margin_per_s, result.active_constraints
            ),
        );
    }
    if let Some(tests) = &result.residual_tests {
        if tests.power_p_value < SIGNIFICANT {
            say(
                "residuals_exceed_noise",
                format!(
                    "the residuals have {:.2} times the power that the noise explains (p = {:.1e}): the structure \
                     misses something, and the bands, which take it as right, are too narrow",
                    tests.power_ratio, tests.power_p_value
                ),
            );
        }
        if let (Some(correlation), Some(p)) = (tests.neighbour_correlation, tests.whiteness_p_value)
            && p < SIGNIFICANT
        {
            say(
                "residuals_not_white",
                format!(
                    "residuals of neighbouring lines are correlated ({correlation:.2}, p = {p:.3}): the structure \
                     misses something"
                ),
            );
        }
    }
    if let Some(noise) = noise.filter(|n| questions.is_weighted_by_noise && n.degrees_of_freedom < FEW_DEGREES) {
        say(
            "weights_from_few_segments",
            format!(
                "the weights are inverse variances with {} degrees of freedom each: they are mostly noise, which the \
                 bands do not know; use uniform weights or more segments",
                noise.degrees_of_freedom
            ),
        );
    }
    if questions.bootstrap.is_some() && noise.is_none() {
        say("no_bootstrap", "there is no bootstrap, because the variance of the response is not known".to_owned());
    }
}
