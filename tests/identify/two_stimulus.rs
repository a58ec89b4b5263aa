//! The two-stimulus estimate on simulated people, whose controllers are known.

use num_complex::Complex64;
use rand::RngExt;
use rand_distr::StandardNormal;
use std::f64::consts::TAU;
use volition::control::{Continuous, Discrete, System, TransferFunction};
use volition::ctl::Ctl;
use volition::num::rng;
use volition::response::stimuli::{StimulusLines, stimulus_lines};
use volition::response::{Detrend, FrequencySettings, LengthSegments, Segments};
use volition::simulate::subject::{SimulatedSubject, SubjectParameters};
use volition::trial::Trial;
use volition::two_stimulus::controllers::{Controllers, controllers};
use volition::two_stimulus::fit::{Channel, FitError, FitSettings, fit};
use volition::two_stimulus::responses::{LineResponse, NoiseSource, responses};
use volition::two_stimulus::simulate::{accounted_for, simulate};
use volition::two_stimulus::structure::{FeedbackLaw, FeedforwardLaw, Muscles, Person, RationalLaw, Structure};

const EVEN: [u32; 6] = [2, 5, 11, 17, 23, 31];
const ODD: [u32; 5] = [3, 7, 13, 19, 29];
const STEP_HZ: f64 = 0.05;

/// A sum of sinusoids on multiples of 0.05 Hz, amplitude 1/f, phases from a seed; a ramp of 5 s, then whole periods of
/// 20 s.
fn multisine(lines: &[u32], seed: u64, sample_time_s: f64, samples: usize) -> Vec<f64> {
    let mut stream = rng::stream(seed, "phases");
    let phases: Vec<f64> = lines.iter().map(|_| TAU * stream.random::<f64>()).collect();
    (0..samples)
        .map(|i| {
            let t = i as f64 * sample_time_s;
            let ramp = (t / 5.0).min(1.0);
            let sum: f64 = lines
                .iter()
                .zip(&phases)
                .map(|(k, p)| 0.8 / f64::from(*k) * (TAU * STEP_HZ * f64::from(*k) * t + p).cos())
                .sum();
            ramp * sum
        })
        .collect()
}

fn plant(den: &[f64]) -> TransferFunction<Continuous> {
    TransferFunction::new(&[1.0], den, Continuous).unwrap()
}

fn quiet() -> SubjectParameters {
    SubjectParameters { remnant: 0.0, learning_scatter: 0.0, ..SubjectParameters::draw(3, false) }
}

fn settings(start_s: f64) -> volition::response::CheckedSettings {
    let segments = Some(Segments::Length(LengthSegments { length_s: 20.0, start_s }));
    FrequencySettings { segments, detrend: Some(Detrend::Mean), ..FrequencySettings::default() }.check().unwrap()
}

fn lines_of(trials: &[Trial], start_s: f64) -> StimulusLines {
    let refs: Vec<&Trial> = trials.iter().collect();
    stimulus_lines(&refs, &settings(start_s), &Ctl::new()).unwrap()
}

/// 85 s: the last 20 s are cut off by the reader of the test, since the subject looks ahead of the command's end.
const SAMPLES: usize = 8500;
const DT: f64 = 0.01;

fn cut(trial: &Trial, samples: usize) -> Trial {
    let mut signals = trial.signals.clone();
    signals.time_s = None;
    for column in [&mut signals.command, &mut signals.control, &mut signals.output] {
        column.truncate(samples);
    }
    if let Some(d) = &mut signals.disturbance {
        d.truncate(samples);
    }
    Trial::new(trial.sample_time_s, signals).unwrap()
}

fn relative(a: Complex64, b: Complex64) -> f64 {
    (a - b).norm() / b.norm()
}

#[test]
fn without_noise_both_controllers_are_exact_where_both_stimuli_were() {
    for den in [&[1.0, 0.0][..], &[1.0, 1.0, 0.0]] {
        let subject = SimulatedSubject::with_parameters(&plant(den), DT, 3, quiet()).unwrap();
        let (a, b) = (multisine(&EVEN, 1, DT, SAMPLES), multisine(&ODD, 2, DT, SAMPLES));
        let trials =
            [cut(&subject.trial(5, &a, Some(&b)).unwrap(), 6500), cut(&subject.trial(5, &b, Some(&a)).unwrap(), 6500)];
        let lines = lines_of(&trials, 45.0);
        assert_eq!(lines.frequency_hz.len(), 11, "{:?}", lines.frequency_hz);
        let found = controllers(&responses(&lines));
        for line in &found.lines {
            let omega = line.response.omega_rad_s;
            let (fb, ff) = (line.feedback.unwrap(), line.feedforward.unwrap());
            assert!(!fb.interpolated);
            let (true_fb, true_ff) = (subject.feedback_response(omega), subject.feedforward_response(5, omega));
            assert!(relative(fb.value, true_fb) < 1e-6, "{omega}: {} {true_fb}", fb.value);
            assert!(relative(ff.value, true_ff) < 1e-6, "{omega}: {} {true_ff}", ff.value);
        }
        assert!(found.ambiguous_phase_hz.is_empty());
    }
}

#[test]
fn between_interleaved_lines_the_feedback_is_interpolated_with_its_error_stated_and_never_beyond() {
    let subject = SimulatedSubject::with_parameters(&plant(&[1.0, 0.0]), DT, 3, quiet()).unwrap();
    let (a, b) = (multisine(&EVEN, 1, DT, SAMPLES), multisine(&ODD, 2, DT, SAMPLES));
    let trials = [cut(&subject.trial(5, &a, Some(&b)).unwrap(), 6500)];
    let found = controllers(&responses(&lines_of(&trials, 45.0)));
    let mut interpolated = 0;
    for line in &found.lines {
        let omega = line.response.omega_rad_s;
        let k = (omega / TAU / STEP_HZ).round() as u32;
        let outside = !(3..=29).contains(&k);
        assert_eq!(line.feedback.is_none(), outside, "{k}");
        let Some(fb) = line.feedback else { continue };
        let error = relative(fb.value, subject.feedback_response(omega));
        if ODD.contains(&k) {
            assert!(error < 1e-6 && line.feedforward.is_none());
            continue;
        }
        interpolated += 1;
        let stated = fb.interpolation_error.unwrap();
        assert!(fb.interpolated && error <= 1.5 * stated && stated < 0.5, "{k}: {error} {stated}");
        let ff = line.feedforward.unwrap();
        let error = relative(ff.value, subject.feedforward_response(5, omega));
        assert!(error <= 1.5 * ff.interpolation_error.unwrap(), "{k}: {error} {ff:?}");
    }
    assert_eq!(interpolated, 4, "5, 11, 17, 23");
}

#[test]
fn one_stimulus_alone_says_no_more_than_it_can() {
    let subject = SimulatedSubject::with_parameters(&plant(&[1.0, 0.0]), DT, 3, quiet()).unwrap();
    let wave = multisine(&EVEN, 1, DT, SAMPLES);
    let r_alone = [cut(&subject.trial(5, &wave, None).unwrap(), 6500)];
    let found = controllers(&responses(&lines_of(&r_alone, 45.0)));
    assert!(found.lines.iter().all(|l| l.feedback.is_none() && l.feedforward.is_none()));
    let person =
        Person::new(&System::Continuous(plant(&[1.0, 0.0])), Structure::mcruer(true, Muscles::None), [0.0, 1.0], 3.0)
            .unwrap();
    let how = FitSettings { channel: Channel::Control, starts: 2, seed: 1 };
    let refused = fit(&responses(&lines_of(&r_alone, 45.0)), &person, &how, &Ctl::new());
    assert_eq!(refused.unwrap_err(), FitError::NoDisturbance);

    let zero = vec![0.0; SAMPLES];
    let d_alone = [cut(&subject.trial(5, &zero, Some(&wave)).unwrap(), 6500)];
    let lines = responses(&lines_of(&d_alone, 45.0));
    let found = controllers(&lines);
    for line in &found.lines {
        let truth = subject.feedback_response(line.response.omega_rad_s);
        assert!(relative(line.feedback.unwrap().value, truth) < 1e-6 && line.feedforward.is_none());
    }
    assert_eq!(fit(&lines, &person, &how, &Ctl::new()).unwrap_err(), FitError::NoCommand);
}

#[test]
fn a_shared_line_needs_trials_in_which_the_proportion_differs() {
    let subject = SimulatedSubject::with_parameters(&plant(&[1.0, 0.0]), DT, 3, quiet()).unwrap();
    let all: Vec<u32> = EVEN.into_iter().chain(ODD).collect();
    let (a, b) = (multisine(&all, 1, DT, SAMPLES), multisine(&all, 2, DT, SAMPLES));
    let minus: Vec<f64> = b.iter().map(|x| -x).collect();
    let first = cut(&subject.trial(5, &a, Some(&b)).unwrap(), 6500);
    let lines = responses(&lines_of(std::slice::from_ref(&first), 45.0));
    assert!(lines.iter().all(|line| line.confounded && line.command.is_none() && line.disturbance.is_none()));
    // The disturbance turned round, the command as before.
    let second = cut(&subject.trial(5, &a, Some(&minus)).unwrap(), 6500);
    let found = controllers(&responses(&lines_of(&[first, second], 45.0)));
    for line in &found.lines {
        let omega = line.response.omega_rad_s;
        assert!(relative(line.feedback.unwrap().value, subject.feedback_response(omega)) < 1e-6);
        assert!(relative(line.feedforward.unwrap().value, subject.feedforward_response(5, omega)) < 1e-6);
    }
}

/// A person of McRuer's ladder on 1/s behind a hold, and the loop's responses with circular noise.
struct Virtual {
    person: Person,
    truth: Vec<f64>,
    omega: Vec<f64>,
}

impl Virtual {
    fn new(neuromuscular_lag: bool) -> Self {
        let time = Discrete::new(1.0 / 60.0).unwrap();
        let plant = System::Discrete(TransferFunction::new(&[1.0 / 60.0, 0.0], &[1.0, -1.0], time).unwrap());
        let muscles = if neuromuscular_lag { Muscles::Lag } else { Muscles::None };
        let person = Person::new(&plant, Structure::mcruer(true, muscles), [0.05, 0.8], 3.0).unwrap();
        let omega = EVEN.iter().chain(&ODD).map(|k| TAU * STEP_HZ * f64::from(*k)).collect();
        let mut omega: Vec<f64> = omega;
        omega.sort_by(f64::total_cmp);
        // gain, lead, lag, delay; gain, lag, delay; neuromuscular lag
        let mut truth = vec![3.0, 0.15, 0.9, 0.18, 0.8, 0.12, 0.25, 0.08];
        truth.truncate(person.parameters().len());
        Self { person, truth, omega }
    }

    /// Estimates from `trials` repetitions with both stimuli at every line, as a reader of trials would make them.
    fn lines(&self, trials: usize, noise: f64, seed: u64) -> StimulusLines {
        use volition::response::stimuli::SegmentLines;
        let mut stream = rng::stream(seed, "line noise");
        let mut circular = |size: f64| {
            let (a, b): (f64, f64) = (stream.sample(StandardNormal), stream.sample(StandardNormal));
            Complex64::new(a, b) * size * std::f64::consts::FRAC_1_SQRT_2
        };
        let segments = (0..trials)
            .map(|trial| {
                let mut s = SegmentLines {
                    trial,
                    command: Vec::new(),
                    disturbance: Vec::new(),
                    control: Vec::new(),
                    output: Vec::new(),
                    noise: vec![None; self.omega.len()],
                    variance: [0.0; 2],
                };
                for omega in &self.omega {
                    let amplitude = 1.0 / omega;
                    let r = Complex64::from(amplitude);
                    // In every other trial turned round, so that shared lines separate.
                    let d = Complex64::from(if trial % 2 == 0 { amplitude } else { -amplitude });
                    let h = self.person.closed_loop(&self.truth, *omega);
                    let g = self.person.plant().response(*omega);
                    let n = circular(noise * amplitude);
                    s.command.push(r);
                    s.disturbance.push(d);
                    s.control.push(h[0] * r + h[2] * d + n);
                    s.output.push(h[1] * r + h[3] * d + g * n);
                }
                s
            })
            .collect();
        StimulusLines {
            frequency_hz: self.omega.iter().map(|w| w / TAU).collect(),
            omega_rad_s: self.omega.clone(),
            trials,
            segments,
            warnings: Vec::new(),
        }
    }
}

#[test]
fn bands_without_structure_hold_the_truth_as_often_as_they_say() {
    let person = Virtual::new(true);
    let (mut held, mut all) = ([0; 4], 0);
    for seed in 0..500 {
        let found: Controllers = controllers(&responses(&person.lines(8, 0.1, seed)));
        for line in &found.lines {
            let omega = line.response.omega_rad_s;
            assert_eq!(line.response.source, Some(NoiseSource::Trials));
            let truth = person.person.response(&person.truth, omega);
            all += 1;
            for (i, (estimate, truth)) in
                [(line.feedback, truth.feedback), (line.feedforward, truth.feedforward)].into_iter().enumerate()
            {
                let estimate = estimate.unwrap();
                let width = estimate.half_width(0.95).unwrap();
                let ratio = (estimate.value / truth).ln();
                held[i] += i32::from(ratio.re.abs() <= width);
                held[i + 2] += i32::from(ratio.im.abs() <= width);
            }
        }
    }
    for count in held {
        let share = f64::from(count) / f64::from(all);
        assert!((0.93..=0.97).contains(&share), "{held:?} of {all}");
    }
}

#[test]
fn parametric_bands_hold_the_truth_and_agree_with_those_without_structure() {
    let person = Virtual::new(false);
    let how = FitSettings { channel: Channel::Control, starts: 1, seed: 5 };
    let (mut held, mut all, mut agree, mut compared, mut edges) = ([0; 4], 0, 0, 0, 0);
    for seed in 0..500 {
        let data = responses(&person.lines(12, 0.05, 1000 + seed));
        let found = fit(&data, &person.person, &how, &Ctl::new()).unwrap();
        edges += i32::from(found.parameters.iter().any(|p| p.at_edge));
        let free = controllers(&data);
        for line in &free.lines {
            let omega = line.response.omega_rad_s;
            let truth = person.person.response(&person.truth, omega);
            let bands = found.bands(omega);
            all += 1;
            for (i, truth) in [truth.feedback, truth.feedforward].into_iter().enumerate() {
                let ratio = (bands[i].value / truth).ln();
                let [size, phase] = bands[i].deviation.unwrap();
                held[i] += i32::from(ratio.re.abs() <= found.quantile(0.95) * size);
                held[i + 2] += i32::from(ratio.im.abs() <= found.quantile(0.95) * phase);
            }
            for (estimate, band) in [(line.feedback, bands[0]), (line.feedforward, bands[1])] {
                let estimate = estimate.unwrap();
                let ratio = (estimate.value / band.value).ln();
                let [size, phase] = band.deviation.unwrap();
                let width = estimate.half_width(0.95).unwrap();
                compared += 2;
                agree += i32::from(ratio.re.abs() <= width.hypot(found.quantile(0.95) * size));
                agree += i32::from(ratio.im.abs() <= width.hypot(found.quantile(0.95) * phase));
            }
        }
    }
    let shares: Vec<f64> = held.iter().map(|h| f64::from(*h) / f64::from(all)).collect();
    let agreeing = f64::from(agree) / f64::from(compared);
    eprintln!("held {shares:?}, agreeing {agreeing}, {edges} of 500 with a parameter at an edge");
    assert!(shares.iter().all(|s| (0.93..=0.97).contains(s)), "{shares:?}");
    assert!(agreeing > 0.93, "{agreeing}");
}

#[test]
fn without_noise_the_structure_is_recovered_from_h_yr_and_h_yd() {
    let person = Virtual::new(true);
    let data: Vec<LineResponse> = person
        .omega
        .iter()
        .map(|omega| {
            let h = person.person.closed_loop(&person.truth, *omega);
            LineResponse::from_output(*omega, person.person.plant().response(*omega), Some(h[1]), Some(h[3]), None)
        })
        .collect();
    for channel in [Channel::Control, Channel::Output] {
        let how = FitSettings { channel, starts: 4, seed: 5 };
        let found = fit(&data, &person.person, &how, &Ctl::new()).unwrap();
        assert!(found.cost < 1e-12, "{channel:?} {found:?}");
        for (value, truth) in found.values.iter().zip(&person.truth) {
            assert!((value / truth - 1.0).abs() < 1e-4, "{channel:?} {:?} {:?}", found.values, person.truth);
        }
        assert!(found.person.is_stable(&found.values));
    }
}

#[test]
fn a_rational_law_with_delay_is_recovered() {
    let law = |delay| RationalLaw { numerator_degree: 1, denominator_degree: 2, delay };
    let structure = Structure {
        feedback: FeedbackLaw::Rational(law(true)),
        feedforward: FeedforwardLaw::Rational(law(false)),
        neuromuscular_lag: false,
        neuromuscular_second_order: false,
    };
    let plant = System::Continuous(plant(&[1.0, 1.0, 0.0]));
    let person = Person::new(&plant, structure, [0.0, 0.5], 3.0).unwrap();
    // N0 + N1 x over x² + a x + b, delay; x = s/3.
    let truth = [2.0, 1.5, 1.8, 1.2, 0.12, 0.7, 0.9, 1.0, 2.0];
    assert!(person.is_stable(&truth));
    let data: Vec<LineResponse> = (1..=14)
        .map(|k| {
            let omega = 0.4 * f64::from(k);
            let h = person.closed_loop(&truth, omega);
            LineResponse::from_output(omega, plant.response(omega), Some(h[1]), Some(h[3]), Some([1e-4; 2]))
        })
        .collect();
    let how = FitSettings { channel: Channel::Output, starts: 6, seed: 5 };
    let found = fit(&data, &person, &how, &Ctl::new()).unwrap();
    assert!(found.cost < 1e-6, "{found:?}");
    for omega in [0.5, 2.0, 5.0] {
        let (a, b) = (person.response(&found.values, omega), person.response(&truth, omega));
        assert!(relative(a.feedback, b.feedback) < 1e-3 && relative(a.feedforward, b.feedforward) < 1e-3);
    }
}

#[test]
fn a_simulation_from_responses_agrees_with_one_in_time() {
    // G = 1/s behind a hold, feedback K with 12 samples of delay, no feedforward: stepped sample by sample.
    let dt = 1.0 / 60.0;
    let time = Discrete::new(dt).unwrap();
    let plant = System::Discrete(TransferFunction::new(&[dt, 0.0], &[1.0, -1.0], time).unwrap());
    let person = Person::new(&plant, Structure::mcruer(false, Muscles::None), [0.0, 1.0], 3.0).unwrap();
    let values = [2.0, 1e-9, 1e-9, 12.0 * dt];
    let (r, d) = (multisine(&EVEN, 1, dt, 2700), multisine(&ODD, 2, dt, 2700));
    let simulated = simulate(|w| person.closed_loop(&values, w), &r, Some(&d), dt, 1e3).unwrap();
    let (mut u, mut y) = (Vec::new(), Vec::<f64>::new());
    for k in 0..2700 {
        let own = if k >= 12 { 2.0 * (r[k - 12] - y[k - 12]) } else { 0.0 };
        u.push(own);
        y.push(y.last().copied().unwrap_or(0.0) + dt * (own + d[k]));
    }
    let signals = volition::trial::Signals { time_s: None, command: r, control: u, output: y, disturbance: Some(d) };
    let vaf = accounted_for(&Trial::new(dt, signals).unwrap(), &simulated);
    assert!(vaf.iter().all(|v| v.unwrap() > 0.999_999), "{vaf:?}");
}

#[test]
fn the_best_candidate_of_a_pool_is_that_of_brute_force() {
    use volition::identify::both_stimuli::{DisturbanceLine, PoolSearchError, search};
    use volition::identify::pool::{Degrees, PoolSpec};
    use volition::identify::problem::{Lines, Problem};
    use volition::identify::search::exact;
    let spec: PoolSpec = serde_json::from_value(serde_json::json!({"grid": {
        "feedforward_denominator": [{"from": 1.0, "to": 9.0, "step": 0.5}],
        "feedback_numerator": [{"from": -2.0, "to": 8.0, "step": 0.4}],
        "feedback_denominator": [{"from": 0.5, "to": 9.0, "step": 0.5}]
    }, "stability_margin": 0.0}))
    .unwrap();
    let degrees = Degrees {
        feedforward_numerator: Some(1),
        feedforward_denominator: Some(1),
        feedback_numerator: Some(0),
        feedback_denominator: Some(1),
    };
    let recipe = spec.check(degrees).unwrap();
    let plant = System::Continuous(TransferFunction::new(&[4.0], &[1.0, 2.0], Continuous).unwrap());
    let pool = recipe.build(&plant, &Ctl::new()).unwrap();
    let mut stream = rng::stream(11, "pool");
    for noise in [0.0, 0.05, 0.3] {
        let mut circular = || -> Complex64 {
            let (a, b): (f64, f64) = (stream.sample(StandardNormal), stream.sample(StandardNormal));
            noise * Complex64::new(a, b)
        };
        let (mut omega, mut h_yr, mut disturbance) = (Vec::new(), Vec::new(), Vec::new());
        for k in 1..=14 {
            let w = 0.5 * f64::from(k);
            let (g, s) = (plant.response(w), Complex64::new(0.0, w));
            let (ff, fb) = ((2.1 * s + 3.0) / (s + 6.5), 2.4 / (s + 3.0));
            if k % 3 == 0 {
                let response = g / (1.0 + g * fb) + circular();
                disturbance.push(DisturbanceLine { omega_rad_s: w, plant: g, response, weight: 1.0 + 0.1 * w });
            } else {
                omega.push(w);
                h_yr.push(g * (ff + fb) / (1.0 + g * fb) + circular());
            }
        }
        let problem = Problem::new(&Lines::new(&plant, &omega, &h_yr, None), 1).unwrap();
        let found = search(&problem, &disturbance, &pool, 1_000_000, &Ctl::new()).unwrap();
        let mut best = (f64::INFINITY, u64::MAX);
        for index in 0..pool.size() {
            let candidate = pool.candidate(pool.position(index));
            let own: f64 = disturbance
                .iter()
                .map(|line| {
                    let s = Complex64::new(0.0, line.omega_rad_s);
                    let eval = |p: &[f64]| p.iter().fold(Complex64::default(), |sum, c| sum * s + c);
                    let fb = candidate.feedback_gain * eval(&candidate.feedback_numerator)
                        / eval(&candidate.feedback_denominator);
                    line.weight * (line.plant / (1.0 + line.plant * fb) - line.response).norm_sqr()
                })
                .sum();
            let cost = own + exact::cost(&problem, &candidate);
            if cost < best.0 {
                best = (cost, index);
            }
        }
        assert_eq!(found.index, best.1, "{noise}: {found:?} {best:?}");
        assert!((found.cost - best.0).abs() <= 1e-12 + 1e-10 * best.0);
        assert!(found.evaluated < pool.size(), "some are proven no better without being solved");
        if noise == 0.0 {
            assert!(found.cost < 1e-12, "{found:?}");
        }
        let refused = search(&problem, &disturbance, &pool, 10, &Ctl::new()).unwrap_err();
        assert!(matches!(refused, PoolSearchError::Unaffordable { limit: 10, .. }));
        assert_eq!(search(&problem, &[], &pool, 1_000_000, &Ctl::new()).unwrap_err(), PoolSearchError::NoDisturbance);
    }
}
