//! The noise drawn, once for the signals and anew for the spread of their metrics.

use super::assembly::Assembly;
use super::inputs::{NoiseInput, SimulateInputs};
use super::result::{RealisationsResult, Spread};
use super::{Failure, failure};
use crate::analysis::problem::{Code, Problem};
use crate::ctl::Ctl;
use crate::learning::time_domain::{self, TimeDomainMetrics};
use crate::num::distributions::student_t;
use crate::num::stats::{mean, standard_deviation};
use crate::simulate::closed_loop::{Drive, Simulated, Simulator, coloured};
use crate::trial;
use crate::trial::Trial;
use rayon::prelude::*;

/// Why the control has no samples.
pub(super) const NO_CONTROL: &str = "a controller has more zeros than poles: it differentiates, and its control has \
    no samples; give it poles above the frequencies that matter to see what the control does";

/// Steps of one run at most.
const MOST_STEPS_OF_A_RUN: usize = 8_000_000;

/// Steps of all draws together at most.
const MOST_STEPS: usize = 200_000_000;

/// Draws from which quantiles are taken.
const FEWEST_FOR_RANGE: usize = 40;

/// What drives the loop, with one draw of the noise.
#[derive(Clone)]
pub(super) struct Draw<'a> {
    assembly: &'a Assembly,
    noise: NoiseInput,
    seed: u64,
    /// Whether any noise is drawn.
    pub is_noisy: bool,
    remnant: Vec<f64>,
    perception: Vec<f64>,
    measurement: Vec<f64>,
}

/// Signals as a trial would record them.
pub(super) struct Signals {
    /// u.
    pub control: Option<Vec<f64>>,
    /// y with measurement noise.
    pub output: Vec<f64>,
}

impl<'a> Draw<'a> {
    /// Without noise so far.
    pub(super) fn new(inputs: &SimulateInputs, seed: u64, assembly: &'a Assembly) -> Self {
        let noise = inputs.noise.unwrap_or_default();
        let (remnant, perception, measurement) = Default::default();
        Self { assembly, is_noisy: noise.is_drawn(), noise, seed, remnant, perception, measurement }
    }

    /// Draws the noise of a realisation, counted from 0.
    pub(super) fn noise(&mut self, realisation: usize, samples: usize) {
        let period = self.assembly.time.period_s();
        let [remnant, perception, measurement] = self.noise.sources().map(|(name, source)| {
            let name = format!("{name} of realisation {realisation}");
            source.map_or_else(Vec::new, |s| coloured(self.seed, &name, samples, s.sd, s.time_constant_s, period))
        });
        (self.remnant, self.perception, self.measurement) = (remnant, perception, measurement);
    }

    /// What drives the loop.
    pub(super) fn drive(&self) -> Drive<'_> {
        Drive {
            command: &self.assembly.command,
            disturbance: &self.assembly.disturbance,
            remnant: &self.remnant,
            perception: &self.perception,
            initial: &self.assembly.initial,
        }
    }
}

impl Signals {
    pub(super) fn new(found: Simulated, draw: &Draw) -> Self {
        let mut output = found.output;
        output.iter_mut().zip(&draw.measurement).for_each(|(y, n)| *y += n);
        Self { control: found.control, output }
    }
}

/// Refuses a run that takes more memory than there may be: many samples, each of many steps.
pub(super) fn runs(simulator: &Simulator) -> Result<(), Problem> {
    let steps = simulator.samples().saturating_mul(simulator.steps_of_a_sample());
    if steps <= MOST_STEPS_OF_A_RUN {
        return Ok(());
    }
    let detail = format!(
        "{} samples of {} steps each, which the delays take, are more than {MOST_STEPS_OF_A_RUN} steps",
        simulator.samples(),
        simulator.steps_of_a_sample()
    );
    Err(Problem::new(Code::Unaffordable, "too many steps", detail)
        .at("/inputs/command")
        .mend("Shorten the command, or give delays that are whole samples."))
}

/// Refuses more draws than can be computed.
pub(super) fn affordable(count: usize, simulator: &Simulator) -> Result<(), Problem> {
    let one = simulator.samples() * simulator.steps_of_a_sample();
    if count.saturating_mul(one) <= MOST_STEPS {
        return Ok(());
    }
    let detail = format!("{count} draws of {one} steps are more than the {MOST_STEPS} steps that are taken at most");
    Err(Problem::new(Code::Unaffordable, "too many draws", detail)
        .at("/spec/realisations")
        .mend(format!("Ask for {} or fewer, or shorten the command.", MOST_STEPS / one.max(1))))
}

/// The metrics of a trial with these signals.
pub(super) fn metrics(signals: &Signals, assembly: &Assembly) -> Result<TimeDomainMetrics, Problem> {
    let samples = signals.output.len();
    // Without a control zeros stand for it, and what is said of them is taken back.
    let columns = trial::Signals {
        time_s: None,
        command: assembly.command[..samples].to_vec(),
        control: signals.control.clone().unwrap_or_else(|| vec![0.0; samples]),
        output: signals.output.clone(),
        disturbance: None,
    };
    let trial = Trial::new(assembly.time.period_s(), columns).map_err(|error| {
        Problem::new(Code::Numerical, "the simulation makes no trial", error.to_string()).at("/inputs")
    })?;
    let mut metrics = time_domain::metrics(&trial, &assembly.closed.plant().to_model());
    if signals.control.is_none() {
        metrics.right_control_undetermined = Some(NO_CONTROL.to_owned());
    }
    Ok(metrics)
}

/// How the metrics spread over `count` draws; `None` of no draw.
pub(super) fn spread(
    draw: &Draw,
    simulator: &Simulator,
    assembly: &Assembly,
    count: usize,
    ctl: &Ctl,
) -> Result<Option<RealisationsResult>, Failure> {
    if count == 0 {
        return Ok(None);
    }
    ctl.set_total(count as u64);
    let all: Vec<TimeDomainMetrics> = (0..count)
        .into_par_iter()
        .map(|realisation| -> Result<TimeDomainMetrics, Failure> {
            ctl.check()?;
            let mut draw = draw.clone();
            draw.noise(realisation, simulator.samples());
            let found = simulator.run(&draw.drive(), ctl).map_err(failure)?;
            let metrics = metrics(&Signals::new(found, &draw), assembly)?;
            ctl.advance(1);
            Ok(metrics)
        })
        .collect::<Result<_, _>>()?;
    let of = |metric: fn(&TimeDomainMetrics) -> f64| spread_of(all.iter().map(metric).collect());
    let jerks: Option<Vec<f64>> = all.iter().map(|m| m.control_log_dimensionless_jerk).collect();
    Ok(Some(RealisationsResult {
        count,
        mean_abs_error: of(|m| m.mean_abs_error),
        rms_error: of(|m| m.rms_error),
        max_abs_output: of(|m| m.max_abs_output),
        control_log_dimensionless_jerk: jerks.map(spread_of),
    }))
}

fn spread_of(mut values: Vec<f64>) -> Spread {
    let centre = mean(&values).unwrap_or_default();
    let sd = standard_deviation(&values);
    let n = values.len() as f64;
    let interval_95 = sd.map(|sd| {
        let half = student_t(0.95, n - 1.0) * sd / n.sqrt();
        [centre - half, centre + half]
    });
    values.sort_by(f64::total_cmp);
    // The quantile of order p at the place p (n + 1), as for the median of odd counts.
    let quantile = |p: f64| {
        let place = (p * (n + 1.0) - 1.0).clamp(0.0, n - 1.0);
        let (below, part) = (place.floor() as usize, place.fract());
        let above = (below + 1).min(values.len() - 1);
        values[below] + part * (values[above] - values[below])
    };
    let range_95 = (values.len() >= FEWEST_FOR_RANGE).then(|| [quantile(0.025), quantile(0.975)]);
    Spread { mean: centre, sd, range_95, interval_95 }
}
