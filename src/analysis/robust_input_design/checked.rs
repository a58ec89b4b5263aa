//! The population and the experiments, checked.

use super::refusal::wrong;
use super::spec::{PopulationInput, RobustInputDesignInputs, RobustInputDesignSpec, SubjectSpec};
use crate::analysis::problem::{Code, Problem};
use crate::control::Discrete;
use crate::ctl::Ctl;
use crate::excite::robust::cost::AVERAGED;
use crate::excite::robust::search::expected_evaluations;
use crate::excite::robust::{GAMMA, Setting, THETA};
use crate::plants::head_neck::{Axis, Population};

/// Samples of a record, draws, iterations and rounds at most.
const MAX_SAMPLES: usize = 20_000;
const MAX_DRAWS: usize = 2_000;
const MAX_ITERATIONS: usize = 200;
const MAX_ROUNDS: usize = 20;
/// Simulated samples of the whole search at most: hours of one processor.
const MAX_WORK: u64 = 20_000_000_000;

/// A checked request.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Checked {
    pub inputs: RobustInputDesignInputs,
    pub spec: RobustInputDesignSpec,
    pub setting: Setting,
    pub gamma_box: [[f64; 2]; 2],
    pub average: [f64; 4],
    pub start: [f64; 2],
}

fn positive(value: f64, at: &str) -> Result<f64, Problem> {
    if value > 0.0 && value < 1e9 {
        Ok(value)
    } else {
        Err(wrong(format!("{value} must be positive, and no astronomical number"), at))
    }
}

fn range(range: [f64; 2], at: &str) -> Result<[f64; 2], Problem> {
    positive(range[0], at)?;
    positive(range[1], at)?;
    if range[0] < range[1] {
        Ok(range)
    } else {
        Err(wrong(format!("from {} to {} there is nothing", range[0], range[1]), at).mend("Give [least, largest]."))
    }
}

/// The population that differs from the tables of an axis in this.
fn population(written: &PopulationInput, axis: Axis) -> Result<Population, Problem> {
    let at = "/inputs/population";
    let mut population = axis.population();
    let ranges = &written.controller;
    for (i, given) in [ranges.k_p, ranges.k_d, ranges.k_i, ranges.tau].into_iter().enumerate() {
        if let Some(given) = given {
            population.controller[i] = range(given, &format!("{at}/controller/{}", THETA[i]))?;
        }
    }
    let numbers = [
        ("inertia", written.inertia, &mut population.body[0]),
        ("torque_nm", written.torque_nm, &mut population.torque_nm),
        ("angle_rad", written.angle_rad, &mut population.angle_rad),
        ("acceleration_rad_s2", written.acceleration_rad_s2, &mut population.acceleration_rad_s2),
    ];
    for (name, given, into) in numbers {
        if let Some(given) = given {
            *into = positive(given, &format!("{at}/{name}"))?;
        }
    }
    let [_, damping, stiffness] = &mut population.body;
    let numbers = [
        ("damping", written.damping, damping),
        ("stiffness", written.stiffness, stiffness),
        ("noise_nm", written.noise_nm, &mut population.noise_nm),
    ];
    for (name, given, into) in numbers {
        if let Some(given) = given {
            if !(0.0..1e9).contains(&given) {
                return Err(wrong(format!("{given} must not be negative"), format!("{at}/{name}")));
            }
            *into = given;
        }
    }
    if let Some(weights) = written.weights {
        if !weights.iter().all(|w| (0.0..1e9).contains(w)) {
            return Err(wrong("a weight must not be negative", format!("{at}/weights")));
        }
        population.weights = weights;
    }
    Ok(population)
}

impl Checked {
    /// Checks everything.
    ///
    /// # Errors
    /// A [`Problem`] with the JSON pointer of what is wrong.
    pub(super) fn new(inputs: RobustInputDesignInputs, mut spec: RobustInputDesignSpec) -> Result<Self, Problem> {
        let population = population(&inputs.population, inputs.axis)?;
        let experiment = &spec.experiment;
        let at = |field: &str| format!("/spec/experiment/{field}");
        let gamma_box = [range(experiment.edge_hz, &at("edge_hz"))?, range(experiment.width_m, &at("width_m"))?];
        let time =
            Discrete::new(experiment.sample_time_s).map_err(|error| wrong(error.to_string(), at("sample_time_s")))?;
        for (value, field) in [
            (experiment.duration_s, "duration_s"),
            (experiment.distance_m, "distance_m"),
            (experiment.noise_rms, "noise_rms"),
        ] {
            positive(value, &at(field))?;
        }
        let nyquist_hz = 0.5 / experiment.sample_time_s;
        if experiment.edge_hz[1] + 0.5 >= nyquist_hz {
            return Err(wrong(
                format!(
                    "the stop band of an edge at {} Hz begins at {} Hz, at or above the Nyquist frequency of \
                     {nyquist_hz} Hz",
                    experiment.edge_hz[1],
                    experiment.edge_hz[1] + 0.5
                ),
                at("edge_hz"),
            )
            .mend("Lower the largest edge, or sample faster."));
        }
        let samples = experiment.duration_s / experiment.sample_time_s;
        if !(20.0..=MAX_SAMPLES as f64).contains(&samples) {
            return Err(wrong(
                format!("a record has {samples} samples; 20 to {MAX_SAMPLES} are taken"),
                at("duration_s"),
            ));
        }
        positive(spec.muscle_lag_s, "/spec/muscle_lag_s")?;
        positive(spec.derivative_filter_s, "/spec/derivative_filter_s")?;
        if !(0.0..1.0).contains(&spec.body_spread) {
            return Err(wrong(
                format!("the spread is {}, and must be from 0 to below 1", spec.body_spread),
                "/spec/body_spread",
            ));
        }
        let counts = [
            ("draws", spec.draws, 2, MAX_DRAWS),
            ("fresh_draws", spec.fresh_draws, 4, MAX_DRAWS),
            ("max_iterations", spec.max_iterations, 1, MAX_ITERATIONS),
            ("rounds", spec.rounds, 0, MAX_ROUNDS),
        ];
        for (field, count, least, most) in counts {
            if !(least..=most).contains(&count) {
                return Err(wrong(
                    format!("it is {count}, and must be from {least} to {most}"),
                    format!("/spec/{field}"),
                ));
            }
        }
        let evaluations = expected_evaluations(spec.max_iterations, spec.rounds);
        let work = (evaluations * spec.draws as u64 + 12 * spec.fresh_draws as u64) * samples as u64;
        if work > MAX_WORK {
            return Err(Problem::new(
                Code::Unaffordable,
                "too large a search",
                format!("the search simulates about {work} samples, and at most {MAX_WORK} are"),
            )
            .at("/spec")
            .mend("Take fewer draws, iterations or samples."));
        }
        if let Some(given) = &spec.given {
            positive(given.edge_hz, "/spec/given/edge_hz")?;
            positive(given.width_m, "/spec/given/width_m")?;
            if given.edge_hz + 0.5 >= nyquist_hz {
                let detail =
                    format!("the stop band of an edge at {} Hz begins above the Nyquist frequency", given.edge_hz);
                return Err(wrong(detail, "/spec/given/edge_hz").mend("Lower the edge, or sample faster."));
            }
        }
        let setting = Setting {
            population,
            body_spread: spec.body_spread,
            muscle_lag_s: spec.muscle_lag_s,
            derivative_filter_s: spec.derivative_filter_s,
            time,
            duration_s: experiment.duration_s,
            distance_m: experiment.distance_m,
            noise_rms: experiment.noise_rms,
            target_seed: experiment.target_seed,
        };
        let population = &setting.population;
        let average = match spec.average_subject {
            Some(SubjectSpec { k_p, k_d, k_i, tau }) => [k_p, k_d, k_i, tau],
            // Eight records of at most so many samples: nothing that must be stopped.
            None => setting.average_subject(spec.seed, &Ctl::new()).unwrap_or([f64::NAN; 4]),
        };
        for ((name, value), [lower, upper]) in THETA.into_iter().zip(average).zip(population.controller) {
            if !(lower..=upper).contains(&value) {
                return Err(wrong(
                    format!("{name} is {value}, outside the population's {lower} to {upper}"),
                    format!("/spec/average_subject/{name}"),
                ));
            }
        }
        let start = spec.start.unwrap_or(gamma_box.map(|[lower, upper]| 0.5 * (lower + upper)));
        for (i, (value, [lower, upper])) in start.into_iter().zip(gamma_box).enumerate() {
            if !(lower..=upper).contains(&value) {
                return Err(wrong(
                    format!("{} starts at {value}, outside its range of {lower} to {upper}", GAMMA[i]),
                    format!("/spec/start/{i}"),
                ));
            }
        }
        spec.start = Some(start);
        let checked = Self { inputs, spec, setting, gamma_box, average, start };
        checked.check_stability()?;
        Ok(checked)
    }

    /// Every corner of the population, bodies included, must be stable: a loop that is not has no cost.
    fn check_stability(&self) -> Result<(), Problem> {
        let population = &self.setting.population;
        for corner in 0..64_usize {
            let mut theta = self.average;
            for (i, (theta, range)) in theta.iter_mut().zip(population.controller).take(3).enumerate() {
                *theta = range[corner >> i & 1];
            }
            let spread = self.setting.body_spread;
            let body =
                std::array::from_fn(|i| population.body[i] * [1.0 - spread, 1.0 + spread][corner >> (3 + i) & 1]);
            let poles = self.setting.model(&theta, body, false).and_then(|m| m.value.model.poles().ok());
            let is_stable = poles.is_some_and(|poles| poles.iter().all(|p| p.norm() < 1.0));
            if !is_stable {
                let [inertia, damping, stiffness] = body;
                return Err(wrong(
                    format!(
                        "the loop with k_p {}, k_d {}, k_i {}, inertia {inertia}, damping {damping} and stiffness \
                         {stiffness} is not stable",
                        theta[0], theta[1], theta[2]
                    ),
                    "/inputs/population",
                )
                .mend("Narrow the population, or lower muscle_lag_s and derivative_filter_s."));
            }
        }
        Ok(())
    }

    /// Everything that is assumed beyond the source.
    pub(super) fn assumptions(&self) -> Vec<String> {
        let spec = &self.spec;
        let experiment = &spec.experiment;
        let SubjectSpec { k_p, k_d, k_i, tau } = SubjectSpec::from(self.average);
        vec![
            format!(
                "muscle: a first-order lag of {} s between the PID law and the torque (the source's block is not \
                 printed)",
                spec.muscle_lag_s
            ),
            format!(
                "derivative: filtered with a time constant of {} s (the source prints an ideal one)",
                spec.derivative_filter_s
            ),
            "delay: of the target alone, by shift with straight lines between samples; nothing is approximated"
                .to_owned(),
            format!(
                "sampling: every {} s for {} s, target and muscle noise held between samples",
                experiment.sample_time_s, experiment.duration_s
            ),
            format!(
                "target: white Gaussian noise through the Butterworth low-pass of least order with 3 dB at its edge \
                 and 40 dB 0.5 Hz above, of standard deviation {} before it is cut to ±0.5, on a screen {} m away, \
                 with a Tukey taper of 10 % at each end; one realisation, seed {}, for all experiments",
                experiment.noise_rms, experiment.distance_m, experiment.target_seed
            ),
            format!(
                "subjects' bodies: inertia, damping and stiffness drawn independently and uniformly within {} % of \
                 their means; fits take the means",
                100.0 * spec.body_spread
            ),
            "muscle noise: uniform between -T_v and T_v, a new value every sample, added to the torque".to_owned(),
            format!(
                "draws: {} in the search, the same for every subject and experiment; {} others for the figures under \
                 `fresh`, of which the first half chooses the worst subject and the other half says its cost",
                spec.draws, spec.fresh_draws
            ),
            "cost: penalties averaged over the draws and summed over the samples (the source sums over both); W_e = 1"
            .to_owned(),
            "nominal experiment: the best for the average subject in the whole range, by a grid and a compass search"
                .to_owned(),
            "fits: by Levenberg-Marquardt from the true parameters within the population's box (the source: a bounded \
             simplex search)"
                .to_owned(),
            if spec.average_subject.is_some() {
                format!("average subject: k_p {k_p}, k_d {k_d}, k_i {k_i}, tau {tau} s, as given")
            } else {
                format!(
                    "average subject: k_p {k_p}, k_d {k_d}, k_i {k_i}, tau {tau} s, which fits the mean response of \
                     {AVERAGED} subjects drawn from the population best while the target steps by half the largest \
                     angle of linear motion every 2.5 s (the source's θ_A, the best fit to the mean of 8 preliminary \
                     trials, is not printed)"
                )
            },
            format!(
                "experiments: edges of {} to {} Hz and widths of {} to {} m (the source's Γ is not printed), searched \
                 from {} Hz and {} m",
                experiment.edge_hz[0],
                experiment.edge_hz[1],
                experiment.width_m[0],
                experiment.width_m[1],
                self.start[0],
                self.start[1]
            ),
            "min-max: Table A.1 with projections on the boxes in place of its tests, which are printed reversed, first \
             steps of a quarter of each range and first tolerances of 5 %; then refined against the worst subjects met"
                .to_owned(),
        ]
    }
}
