//! What a recording must satisfy before anything is made of it.
//!
//! With the plant known, control and output are no two independent columns: `y = G (u + d)` from some initial state.
//! The share of y that the best initial state leaves explained,
//!
//! `1 − Σ (y − ŷ)² / Σ (y − mean y)²`, `ŷ = C Φⁱ x₀ + (G (u + d))ᵢ`, x₀ by least squares,
//!
//! tells a recording whose columns are exchanged, scaled, shifted or of another plant. Between samples the control is
//! held or goes straight on; the better of the two counts. A plant with a growing mode is judged piece by piece, each
//! from its own initial state, no longer than the mode takes to grow ten thousandfold.

use crate::control::discretise::{first_order_hold_state_space, zero_order_hold_state_space};
use crate::control::{Discrete, Model, StateSpace, System, conversion};
use crate::num::linalg;
use crate::trial::Trial;
use nalgebra::{DMatrix, DVector};

/// Of less than this the output does not follow from the control through the plant.
const EXPLAINED: f64 = 0.8;

/// Of less than this more is left over than the noise of a sensor should leave.
const MOSTLY_EXPLAINED: f64 = 0.95;

/// Two columns stand in each other's place if they explain this much, and leave less than this share of what is left as
/// they are named.
const EXCHANGED: f64 = 0.95;
const CLEARLY: f64 = 0.2;

/// Where more than this is explained nothing is doubted. Less than all may still be exchanged columns: where a person
/// tracks well, the command through the plant is nearly the output.
const UNDOUBTED: f64 = 0.999;

/// Sample times and durations, in seconds, outside of which no human motion is recorded: slower than 2 Hz a movement of
/// a second is two samples, and no device samples people at 100 kHz.
const SAMPLE_TIME_S: std::ops::RangeInclusive<f64> = 1e-5..=0.5;
const DURATION_S: std::ops::RangeInclusive<f64> = 1.0..=14_400.0;

/// How much a mode may grow within a piece.
const GROWTH: f64 = 1e4;

/// Beside columns of length 1: modes that nothing sees have no direction of their own, and stay at rest.
const RIDGE: f64 = 1e-13;

/// Samples of a piece at least, beyond ten for each state; of fewer nothing but the sample time is judged, a handful of
/// samples being seen for what it is.
const PIECE: usize = 50;

/// A finding about a recording.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Doubt {
    /// A stable name, in `snake_case`.
    pub code: &'static str,
    /// The finding, in words and numbers, and what to do.
    pub message: String,
}

fn doubt(code: &'static str, message: String) -> Doubt {
    Doubt { code, message }
}

/// What is doubtful about a trial recorded on `plant`.
#[must_use]
pub fn doubts(trial: &Trial, plant: Option<&Model>) -> Vec<Doubt> {
    let mut doubts = implausible_times(trial);
    if trial.samples() < PIECE {
        return doubts;
    }
    let signals = &trial.signals;
    let disturbance = signals.disturbance.as_deref().filter(|d| moves(d));
    let still: Vec<&str> = [
        ("r", !moves(&signals.command) && disturbance.is_none()),
        ("u", !moves(&signals.control)),
        ("y", !moves(&signals.output)),
    ]
    .into_iter()
    .filter_map(|(name, is_still)| is_still.then_some(name))
    .collect();
    for name in &still {
        let message = format!(
            "{name} is constant throughout{}: look whether the right column was read, and whether the device \
             recorded it",
            if *name == "r" { " and there is no disturbance" } else { "" }
        );
        doubts.push(doubt("constant_channel", message));
    }
    if let Some(plant) = plant {
        doubts.extend(mismatch(trial, plant));
    }
    doubts
}

fn moves(column: &[f64]) -> bool {
    column.iter().any(|x| *x != column[0])
}

fn implausible_times(trial: &Trial) -> Vec<Doubt> {
    let mut doubts = Vec::new();
    let step = trial.sample_time_s;
    let duration = step * trial.samples() as f64;
    if !SAMPLE_TIME_S.contains(&step) {
        let guess = if trial.signals.time_s.is_some() && step >= 1.0 {
            ": a time column in samples, milliseconds or microseconds reads like this; give it in seconds"
        } else {
            ": give it in seconds"
        };
        doubts.push(doubt(
            "implausible_sample_time",
            format!("the sample time is {step} s, which is none of human motion{guess}"),
        ));
    }
    if !DURATION_S.contains(&duration) && trial.samples() >= PIECE {
        doubts.push(doubt(
            "implausible_duration",
            format!("the recording takes {duration} s, which is no trial of a person: look at the unit of time"),
        ));
    }
    doubts
}

fn mismatch(trial: &Trial, plant: &Model) -> Option<Doubt> {
    let signals = &trial.signals;
    if !moves(&signals.output) {
        return None;
    }
    let models = sampled(plant, trial.sample_time_s)?;
    let disturbance = signals.disturbance.as_deref();
    let share = |input: &[f64], output: &[f64]| {
        models.iter().filter_map(|model| explained(model, input, disturbance, output)).reduce(f64::max)
    };
    let own = share(&signals.control, &signals.output)?;
    if own >= UNDOUBTED {
        return None;
    }
    let others = [
        ("r and u", &signals.command, &signals.output),
        ("u and y", &signals.output, &signals.control),
        ("r and y", &signals.control, &signals.command),
    ];
    for (names, input, output) in others {
        if !(moves(input) && moves(output)) {
            continue;
        }
        let Some(other) =
            share(input, output).filter(|other| *other >= EXCHANGED && 1.0 - *other <= CLEARLY * (1.0 - own))
        else {
            continue;
        };
        let message = format!(
            "{names} look exchanged: through the plant they explain {:.1} % of each other in this order, and {:.1} % \
             as they are named",
            100.0 * other,
            100.0 * own.max(0.0)
        );
        return Some(doubt("channels_exchanged", message));
    }
    let with = if disturbance.is_some() { "u and d" } else { "u" };
    if own >= EXPLAINED {
        let message = || {
            format!(
                "{with} through the plant explain {:.1} % of y, from the best initial state: more is left over than \
                 noise should leave",
                100.0 * own
            )
        };
        return (own < MOSTLY_EXPLAINED).then(|| doubt("output_loosely_from_control", message()));
    }
    Some(doubt(
        "output_not_from_control",
        format!(
            "{with} through the plant explain {:.1} % of y, from the best initial state: the plant, the units, a \
             column or a delay of the recording is not what it is taken for",
            100.0 * own.max(0.0)
        ),
    ))
}

/// The share of y that the plant explains with `u` and `d`; `None` where that cannot be judged (several channels, a
/// plant that cannot be sampled, an output that never moves).
#[must_use]
pub fn explained_output(trial: &Trial, plant: &Model) -> Option<f64> {
    predicted_output(trial, plant).map(|found| found.explained)
}

/// What the plant makes of a trial's control and disturbance.
#[derive(Debug, Clone, PartialEq)]
pub struct PredictedOutput {
    /// ŷ = G (u + d) from the initial states that fit best, one value for each sample, in the unit of y.
    pub output: Vec<f64>,
    /// `1 − Σ (y − ŷ)² / Σ (y − mean y)²`.
    pub explained: f64,
    /// In how many pieces the recording was judged, each from its own initial state.
    pub pieces: usize,
}

/// The output that follows from the control through the plant; `None` as of [`explained_output`].
#[must_use]
pub fn predicted_output(trial: &Trial, plant: &Model) -> Option<PredictedOutput> {
    let signals = &trial.signals;
    let models = sampled(plant, trial.sample_time_s)?;
    let fit = |model| fitted(model, &signals.control, signals.disturbance.as_deref(), &signals.output);
    let best = models.iter().filter_map(fit).reduce(|a, b| if b.explained > a.explained { b } else { a })?;
    let output = signals.output.iter().zip(&best.residual).map(|(y, missed)| y - missed).collect();
    Some(PredictedOutput { output, explained: best.explained, pieces: best.pieces })
}

/// The plant between samples: with its input held, and with its input going straight on.
fn sampled(plant: &Model, sample_time_s: f64) -> Option<Vec<StateSpace<Discrete>>> {
    let time = Discrete::new(sample_time_s).ok()?;
    match plant.check().ok()? {
        System::Continuous(system) => {
            let model = conversion::to_state_space(&system).ok()?;
            let held = zero_order_hold_state_space(&model, time).ok();
            let straight = first_order_hold_state_space(&model, time).ok();
            let models: Vec<_> = held.into_iter().chain(straight).collect();
            (!models.is_empty()).then_some(models)
        }
        System::Discrete(system) => conversion::to_state_space(&system).ok().map(|model| vec![model]),
    }
}

fn explained(model: &StateSpace<Discrete>, input: &[f64], disturbance: Option<&[f64]>, output: &[f64]) -> Option<f64> {
    fitted(model, input, disturbance, output).map(|fit| fit.explained)
}

/// A model's output fitted to a recording.
struct FittedOutput {
    /// y − ŷ.
    residual: Vec<f64>,
    explained: f64,
    pieces: usize,
}

fn fitted(
    model: &StateSpace<Discrete>,
    input: &[f64],
    disturbance: Option<&[f64]>,
    output: &[f64],
) -> Option<FittedOutput> {
    let states = model.states();
    let fastest = model.poles().ok()?.iter().map(|p| p.norm()).fold(0.0, f64::max);
    let least = PIECE + 10 * states;
    let growing = fastest > 1.0 + 1e-9;
    let length = if growing { (GROWTH.ln() / fastest.ln()) as usize } else { output.len() };
    let length = length.min(output.len());
    if length < least {
        return None;
    }
    let mean = output.iter().sum::<f64>() / output.len() as f64;
    let variation: f64 = output.iter().map(|y| (y - mean).powi(2)).sum();
    let mut missed = 0.0;
    let mut residual = Vec::with_capacity(output.len());
    let pieces = (output.len() / length).max(1);
    for piece in 0..pieces {
        // The last one takes what is left over: less than as much again.
        let end = if piece + 1 == pieces { output.len() } else { (piece + 1) * length };
        let own = missed_by(model, input, disturbance, output, piece * length..end)?;
        missed += own.norm_squared();
        residual.extend_from_slice(own.as_slice());
    }
    let explained = 1.0 - missed / variation;
    explained.is_finite().then_some(FittedOutput { residual, explained, pieces })
}

/// `y − ŷ` with the initial state of a piece that makes `Σ (y − ŷ)²` least.
fn missed_by(
    model: &StateSpace<Discrete>,
    input: &[f64],
    disturbance: Option<&[f64]>,
    output: &[f64],
    piece: std::ops::Range<usize>,
) -> Option<DVector<f64>> {
    let states = model.states();
    let (a, b, c, d) = (model.a(), model.b().column(0), model.c().row(0), model.d()[(0, 0)]);
    let samples = piece.len();
    let mut state = DVector::<f64>::zeros(states);
    let mut free = c.clone_owned();
    let mut columns = DMatrix::<f64>::zeros(samples, states);
    let mut left = DVector::<f64>::zeros(samples);
    for (row, i) in piece.enumerate() {
        let driven = input[i] + disturbance.map_or(0.0, |d| d[i]);
        left[row] = output[i] - (c * &state)[(0, 0)] - d * driven;
        columns.row_mut(row).copy_from(&free);
        state = a * &state + b * driven;
        free = &free * a;
    }
    if states == 0 {
        return Some(left);
    }
    let scale = DVector::from_fn(states, |j, _| columns.column(j).norm().max(f64::MIN_POSITIVE));
    for j in 0..states {
        columns.column_mut(j).unscale_mut(scale[j]);
    }
    let gram = columns.transpose() * &columns + DMatrix::identity(states, states) * RIDGE;
    let right = columns.transpose() * &left;
    let start = linalg::solve_symmetric(&gram, &DMatrix::from_column_slice(states, 1, right.as_slice()));
    let residual = &left - &columns * start.column(0);
    let missed = residual.norm_squared();
    // Where rounding spoils the fit, the state of rest is the better one.
    missed.is_finite().then(|| if missed <= left.norm_squared() { residual } else { left })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trial::Signals;

    fn plant(num: &[f64], den: &[f64]) -> Model {
        serde_json::from_value(serde_json::json!({"num": num, "den": den})).unwrap()
    }

    fn recording(model: &Model, start: f64, swap: bool) -> Trial {
        let step = 0.02;
        let sampled = sampled(model, step).unwrap();
        let model = &sampled[0];
        let mut state = DVector::from_element(model.states(), start);
        let (mut r, mut u, mut y) = (Vec::new(), Vec::new(), Vec::new());
        for i in 0..1500 {
            let t = step * f64::from(i);
            y.push((model.c() * &state)[(0, 0)]);
            r.push((2.1 * t).sin() + (0.7 * t).cos());
            u.push(3.0 * (r[r.len() - 1] - y[y.len() - 1]) + 0.2 * (9.0 * t).sin());
            state = model.a() * &state + model.b().column(0) * u[u.len() - 1];
        }
        let (command, control) = if swap { (u, r) } else { (r, u) };
        Trial::new(step, Signals { time_s: None, command, control, output: y, disturbance: None }).unwrap()
    }

    fn codes(trial: &Trial, plant: &Model) -> Vec<&'static str> {
        doubts(trial, Some(plant)).iter().map(|doubt| doubt.code).collect()
    }

    #[test]
    fn whatever_the_initial_state_a_plant_explains_its_output() {
        for model in [plant(&[1.0], &[1.0, 0.0]), plant(&[2.0, 4.4], &[1.0, 3.6, 4.0]), plant(&[4.0], &[1.0, -1.5])] {
            for start in [0.0, 0.4, -2.0] {
                let trial = recording(&model, start, false);
                let share = explained_output(&trial, &model).unwrap();
                assert!(share > 1.0 - 1e-9, "{model:?} {start}: {share}");
                assert!(codes(&trial, &model).is_empty(), "{model:?} {start}");
            }
        }
    }

    #[test]
    fn exchanged_constant_and_foreign_columns_are_told() {
        let own = plant(&[2.0, 4.4], &[1.0, 3.6, 4.0]);
        assert_eq!(codes(&recording(&own, 0.4, true), &own), ["channels_exchanged"]);
        let mut trial = recording(&own, 0.4, false);
        trial.signals.control.fill(0.0);
        assert_eq!(codes(&trial, &own), ["constant_channel", "output_not_from_control"]);
        let other = plant(&[-1.0], &[1.0, 0.2, 9.0]);
        assert_eq!(codes(&recording(&own, 0.0, false), &other), ["output_not_from_control"]);
    }

    /// Plants of orders 1 to 3, stable or with an integrator, from any initial state: their own output is theirs, and
    /// with the other sign, of another unit or from exchanged columns it is not.
    #[test]
    fn any_plant_knows_its_own_recording() {
        use crate::num::rng::stream;
        use rand::RngExt;
        let mut random = stream(20_261_130, "recordings");
        for case in 0..60 {
            let mut uniform = |low: f64, high: f64| low + (high - low) * random.random::<f64>();
            let mut den = vec![1.0];
            for k in 0..=(case % 3) {
                let pole = if k == 0 && case % 2 == 0 { 0.0 } else { uniform(0.3, 5.0) };
                let longer: Vec<f64> = (0..=den.len())
                    .map(|i| den.get(i).copied().unwrap_or(0.0) + if i > 0 { pole * den[i - 1] } else { 0.0 })
                    .collect();
                den = longer;
            }
            let model = plant(&[uniform(0.5, 3.0)], &den);
            let sampled = sampled(&model, 0.02).unwrap();
            let mut state = DVector::from_fn(sampled[0].states(), |_, _| uniform(-0.02, 0.02));
            let waves: Vec<[f64; 2]> = (0..4).map(|_| [uniform(0.5, 8.0), uniform(0.0, 6.0)]).collect();
            let (mut r, mut u, mut y) = (Vec::new(), Vec::new(), Vec::new());
            for i in 0..2000 {
                let t = 0.02 * f64::from(i);
                y.push((sampled[0].c() * &state)[(0, 0)]);
                r.push((1.1 * t).sin());
                u.push(waves.iter().map(|[w, phase]| (w * t + phase).sin()).sum::<f64>());
                state = sampled[0].a() * &state + sampled[0].b().column(0) * u[u.len() - 1];
            }
            let trial = |r: &[f64], u: &[f64], y: &[f64]| {
                let [command, control, output] = [r, u, y].map(<[f64]>::to_vec);
                Trial::new(0.02, Signals { time_s: None, command, control, output, disturbance: None }).unwrap()
            };
            let own = trial(&r, &u, &y);
            assert!(explained_output(&own, &model).unwrap() > 1.0 - 1e-6, "case {case}: {model:?}");
            assert!(doubts(&own, Some(&model)).is_empty(), "case {case}: {:?}", doubts(&own, Some(&model)));
            assert_eq!(codes(&trial(&u, &r, &y), &model), ["channels_exchanged"], "case {case}");
            let turned: Vec<f64> = y.iter().map(|y| -3.0 * y).collect();
            assert_eq!(codes(&trial(&r, &u, &turned), &model), ["output_not_from_control"], "case {case}");
        }
    }

    #[test]
    fn times_that_are_none_of_a_person_are_told() {
        let own = plant(&[1.0], &[1.0, 1.0]);
        let base = recording(&own, 0.0, false).signals;
        for (step, expected) in [
            (20.0, &["implausible_sample_time", "implausible_duration"][..]),
            (0.6, &["implausible_sample_time"]),
            (1e-6, &["implausible_sample_time", "implausible_duration"]),
            (0.01, &[]),
        ] {
            let trial = Trial::new(step, base.clone()).unwrap();
            let found: Vec<&str> = implausible_times(&trial).iter().map(|d| d.code).collect();
            assert_eq!(found, expected, "{step}");
        }
    }
}
