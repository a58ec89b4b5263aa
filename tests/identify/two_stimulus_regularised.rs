//! McRuer's ladder with muscles and look-ahead, and the estimate that is shrunk towards it, on people who are known.

use nalgebra::DMatrix;
use num_complex::Complex64;
use rand::RngExt;
use rand_distr::StandardNormal;
use std::f64::consts::TAU;
use volition::control::{Discrete, System, TransferFunction};
use volition::ctl::Ctl;
use volition::num::rng;
use volition::response::stimuli::{NearbyNoise, SegmentLines, StimulusLines};
use volition::two_stimulus::fit::{Channel, FitError, FitSettings, Fitted, fit};
use volition::two_stimulus::regularised::{Regularised, Sizes, default_sizes};
use volition::two_stimulus::responses::{LineResponse, responses};
use volition::two_stimulus::structure::{Muscles, Person, Structure, StructureError};

const LINES: [u32; 11] = [2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31];

fn omegas() -> Vec<f64> {
    LINES.iter().map(|k| TAU * 0.05 * f64::from(*k)).collect()
}

/// 1/s as the experiment stepped it.
fn plant() -> System {
    let time = Discrete::new(1.0 / 60.0).unwrap();
    System::Discrete(TransferFunction::new(&[1.0 / 60.0, 0.0], &[1.0, -1.0], time).unwrap())
}

fn person(muscles: Muscles) -> Person {
    let person = Person::new(&plant(), Structure::mcruer(true, muscles), [0.05, 0.8], 3.0).unwrap();
    person.with_feedforward_delay([-0.5, 0.8])
}

/// A neuromuscular system of second order, a delay of the feedback of its own, and a feedforward that looks ahead.
#[test]
fn the_ladder_finds_muscles_of_second_order_and_a_look_ahead() {
    let person = person(Muscles::SecondOrder);
    let names: Vec<&str> = person.parameters().iter().map(|p| p.name.as_str()).collect();
    assert_eq!(names[7..], ["neuromuscular_frequency_rad_s", "neuromuscular_damping"]);
    // gain, lead, lag, delay; gain, lag, delay; frequency, damping
    let truth = [2.0, 0.15, 0.9, 0.18, 0.8, 0.12, -0.25, 9.0, 0.4];
    assert!(person.is_stable(&truth));
    // 81/(s² + 7.2 s + 81) at the frequency of the muscles themselves: 1/(2 ζ j).
    let (with, without) = (person.response(&truth, 9.0), self::person(Muscles::None).response(&truth[..7], 9.0));
    assert!((with.feedback / without.feedback - 1.0 / Complex64::new(0.0, 0.8)).norm() < 1e-12);
    let data: Vec<LineResponse> = omegas()
        .into_iter()
        .map(|omega| {
            let h = person.closed_loop(&truth, omega);
            LineResponse::from_output(omega, plant().response(omega), Some(h[1]), Some(h[3]), None)
        })
        .collect();
    let found =
        fit(&data, &person, &FitSettings { channel: Channel::Control, starts: 6, seed: 5 }, &Ctl::new()).unwrap();
    assert!(found.cost < 1e-12, "{found:?}");
    for (value, truth) in found.values.iter().zip(&truth) {
        assert!((value / truth - 1.0).abs() < 1e-3, "{:?} {truth:?}", found.values);
    }
    // The lag alone does not describe them.
    let lag = self::person(Muscles::Lag);
    let misfit = fit(&data, &lag, &FitSettings { channel: Channel::Control, starts: 6, seed: 5 }, &Ctl::new()).unwrap();
    assert!(misfit.cost > 1e-4, "{}", misfit.cost);
    let both = Structure { neuromuscular_lag: true, ..Structure::mcruer(true, Muscles::SecondOrder) };
    assert_eq!(Person::new(&plant(), both, [0.05, 0.8], 3.0).unwrap_err(), StructureError::TwoMuscles);
}

/// A smooth Gaussian process over ln ω with standard deviation 1, at the lines: correlated draws.
fn deviations(reach: f64, stream: &mut rng::Stream) -> Vec<Complex64> {
    let logs: Vec<f64> = omegas().iter().map(|w| w.ln()).collect();
    let n = logs.len();
    let kernel = DMatrix::from_fn(n, n, |i, j| {
        let distance = (logs[i] - logs[j]) / reach;
        (-0.5 * distance * distance).exp() + if i == j { 1e-9 } else { 0.0 }
    });
    let root = kernel.cholesky().unwrap().l();
    let white: Vec<Complex64> = (0..n)
        .map(|_| {
            let (a, b): (f64, f64) = (stream.sample(StandardNormal), stream.sample(StandardNormal));
            Complex64::new(a, b) * std::f64::consts::FRAC_1_SQRT_2
        })
        .collect();
    (0..n).map(|i| (0..n).map(|j| root[(i, j)] * white[j]).sum()).collect()
}

/// A person whose responses differ smoothly from those of the ladder, recorded in trials of three groups.
struct Deviating {
    lines: StimulusLines,
    groups: Vec<usize>,
    /// Gfb and Gff of the trials with both stimuli, line by line.
    truth: Vec<[Complex64; 2]>,
}

const NOISE: f64 = 0.1;

fn deviating(seed: u64) -> Deviating {
    let mut stream = rng::stream(seed, "deviating person");
    let law = person(Muscles::Lag);
    let values = [2.5, 0.15, 0.9, 0.18, 0.8, 0.12, 0.05, 0.08];
    let omega = omegas();
    let base: Vec<[Complex64; 4]> = omega.iter().map(|w| law.closed_loop(&values, *w)).collect();
    // The same for all trials, of each group, of each trial.
    let mut pair = |size: f64| -> [Vec<Complex64>; 2] {
        [0, 1].map(|_| deviations(0.4, &mut stream).into_iter().map(|d| size * d).collect())
    };
    let shared = pair(0.2);
    let of_groups: Vec<[Vec<Complex64>; 2]> = (0..3).map(|_| pair(0.1)).collect();
    let groups: Vec<usize> = (0..12).map(|trial| trial % 3).collect();
    let of_trials: Vec<[Vec<Complex64>; 2]> = groups.iter().map(|_| pair(0.1)).collect();
    let response = |group: usize, trial: Option<usize>, k: usize, which: usize| {
        let own = trial.map_or(Complex64::default(), |trial| of_trials[trial][which][k]);
        base[k][2 * which] * (1.0 + shared[which][k] + of_groups[group][which][k] + own)
    };
    let g: Vec<Complex64> = omega.iter().map(|w| plant().response(*w)).collect();
    let mut noise = rng::stream(seed, "line noise");
    let segments = groups
        .iter()
        .enumerate()
        .map(|(trial, group)| {
            let mut s = SegmentLines {
                trial,
                command: Vec::new(),
                disturbance: Vec::new(),
                control: Vec::new(),
                output: Vec::new(),
                noise: Vec::new(),
                variance: [1.0; 2],
            };
            for k in 0..omega.len() {
                let size = 1.0 / omega[k];
                let sign = if (trial / 3) % 2 == 0 { 1.0 } else { -1.0 };
                let r = Complex64::from(if *group == 1 { 0.0 } else { size });
                let d = Complex64::from(if *group == 0 { 0.0 } else { sign * size });
                let (a, b): (f64, f64) = (noise.sample(StandardNormal), noise.sample(StandardNormal));
                let n = Complex64::new(a, b) * (NOISE * size * std::f64::consts::FRAC_1_SQRT_2);
                let u = response(*group, Some(trial), k, 0) * r + response(*group, Some(trial), k, 1) * d + n;
                s.command.push(r);
                s.disturbance.push(d);
                s.control.push(u);
                s.output.push(g[k] * (u + d));
                let control = (NOISE * size).powi(2);
                let (output, cross) = (g[k].norm_sqr() * control, g[k].conj() * control);
                s.noise.push(Some(NearbyNoise { control, output, cross, lines: 8 }));
            }
            s
        })
        .collect();
    let truth = (0..omega.len())
        .map(|k| {
            let (ur, ud) = (response(2, None, k, 0), response(2, None, k, 1));
            let feedback = -ud / (g[k] * (1.0 + ud));
            [feedback, ur / (1.0 + ud) - feedback]
        })
        .collect();
    let lines = StimulusLines {
        frequency_hz: omega.iter().map(|w| w / TAU).collect(),
        omega_rad_s: omega,
        trials: groups.len(),
        segments,
        warnings: Vec::new(),
    };
    Deviating { lines, groups, truth }
}

/// The law fitted to them; `None` where no start of the fit has a stable loop.
fn fitted_law(lines: &StimulusLines) -> Option<Fitted> {
    let how = FitSettings { channel: Channel::Control, starts: 1, seed: 1 };
    match fit(&responses(lines), &person(Muscles::Lag), &how, &Ctl::new()) {
        Ok(found) => Some(found),
        Err(FitError::NoStart) => None,
        Err(error) => panic!("{error}"),
    }
}

fn law(lines: &StimulusLines) -> Fitted {
    fitted_law(lines).unwrap()
}

#[test]
fn bands_of_the_regularised_controllers_hold_the_truth_as_often_as_the_docs_say() {
    let (mut held, mut all) = ([0; 4], 0);
    let (mut ours, mut theirs) = ([0.0; 2], [0.0; 2]);
    let (mut within, mut predicted) = (0, 0);
    let mut refused = 0;
    for seed in 0..60 {
        let Deviating { lines, groups, truth } = deviating(seed);
        let Some(fitted) = fitted_law(&lines) else {
            refused += 1;
            continue;
        };
        let learned = Regularised::new(&lines, &groups, &fitted, &default_sizes(), &Ctl::new()).unwrap();
        for (k, truth) in truth.iter().enumerate() {
            let omega = lines.omega_rad_s[k];
            let found = learned.posterior(omega, Some(2));
            let parametric = fitted.person.response(&fitted.values, omega);
            all += 1;
            for (i, law) in [parametric.feedback, parametric.feedforward].into_iter().enumerate() {
                let band = found.controllers[i];
                let [size, phase] = band.deviation.unwrap();
                let ratio = (band.value / truth[i]).ln();
                held[i] += i32::from(ratio.re.abs() <= 1.96 * size);
                held[i + 2] += i32::from(ratio.im.abs() <= 1.96 * phase);
                ours[i] += (band.value / truth[i] - 1.0).norm_sqr();
                theirs[i] += (law / truth[i] - 1.0).norm_sqr();
            }
        }
        // Trials predicted from the others.
        for (trial, group) in groups.iter().enumerate().take(3) {
            let s = &lines.segments[trial];
            let rest: Vec<usize> = (0..12).filter(|i| *i != trial).collect();
            let mut known = lines.clone();
            known.segments = rest.iter().map(|i| lines.segments[*i].clone()).collect();
            for (i, segment) in known.segments.iter_mut().enumerate() {
                segment.trial = i;
            }
            known.trials = rest.len();
            let of_rest: Vec<usize> = rest.iter().map(|i| groups[*i]).collect();
            let learned = Regularised::new(&known, &of_rest, &fitted, &[learned.sizes()], &Ctl::new()).unwrap();
            for (k, omega) in lines.omega_rad_s.iter().enumerate() {
                let found = learned.predicted(*omega, *group, s.command[k], s.disturbance[k]);
                assert_eq!(found.value, learned.control(*omega, *group, s.command[k], s.disturbance[k]));
                let radius = (20.0_f64.ln() * (found.variance + found.noise.unwrap())).sqrt();
                predicted += 1;
                within += i32::from((s.control[k] - found.value).norm() <= radius);
            }
        }
    }
    let shares: Vec<f64> = held.iter().map(|h| f64::from(*h) / f64::from(all)).collect();
    let share = f64::from(within) / f64::from(predicted);
    let rms = |sum: [f64; 2]| sum.map(|s| (s / f64::from(all)).sqrt());
    eprintln!("held {shares:?}; errors {:?}, of the law alone {:?}; predicted {share}", rms(ours), rms(theirs));
    assert!(refused <= 6, "{refused} people without a fit");
    // The law is fitted to the same data and the sizes are chosen by them, which the bands take for granted: of the
    // feedback, a difference of two responses, they hold 83 % (size) and 76 % (phase), of the feedforward 92 %. The
    // docs say so.
    assert!(shares[0] > 0.75 && shares[2] > 0.68, "{shares:?}");
    assert!(shares[1] > 0.86 && shares[3] > 0.86, "{shares:?}");
    assert!((0.9..=0.99).contains(&share), "{share}");
    assert!((0..2).all(|i| ours[i] < 0.7 * theirs[i]), "{:?} {:?}", rms(ours), rms(theirs));
}

#[test]
fn without_deviations_the_regularised_controllers_are_those_of_the_law() {
    let Deviating { lines, groups, .. } = deviating(3);
    let fitted = law(&lines);
    let none = Sizes { reach: 0.4, shared: 1e-6, group: 1e-6, trial: 1e-6 };
    let learned = Regularised::new(&lines, &groups, &fitted, &[none], &Ctl::new()).unwrap();
    for omega in omegas() {
        for group in [None, Some(0), Some(1), Some(2)] {
            let found = learned.posterior(omega, group);
            let parametric = fitted.person.response(&fitted.values, omega);
            let pairs = [(found.controllers[0], parametric.feedback), (found.controllers[1], parametric.feedforward)];
            for (band, law) in pairs {
                assert!((band.value - law).norm() < 1e-6 * law.norm() && band.deviation.unwrap()[0] < 1e-4);
            }
        }
    }
}

/// Two trials, one line, and a formula by hand: the posterior of a Gaussian process with one kernel value.
#[test]
fn the_posterior_is_that_of_conditioning_by_hand() {
    let Deviating { mut lines, .. } = deviating(5);
    let fitted = law(&lines);
    // A command alone at the first line alone.
    lines.segments = vec![lines.segments[0].clone()];
    lines.segments[0].command.iter_mut().skip(1).for_each(|r| *r = Complex64::default());
    lines.trials = 1;
    let sizes = Sizes { reach: 0.4, shared: 0.3, group: 0.2, trial: 0.1 };
    let learned = Regularised::new(&lines, &[0], &fitted, &[sizes], &Ctl::new()).unwrap();
    let omega = lines.omega_rad_s[0];
    let h = fitted.closed_loop(omega);
    let (r, u) = (lines.segments[0].command[0], lines.segments[0].control[0]);
    let noise = (NOISE / omega).powi(2);
    let (prior, known) = (0.3_f64.powi(2) + 0.2_f64.powi(2), 0.3_f64.powi(2) + 0.2_f64.powi(2) + 0.1_f64.powi(2));
    let drive = (h[0] * r).norm_sqr();
    // Of this group the deviation of H_ur is learned, that of H_ud is not.
    let found = learned.posterior(omega, Some(0));
    let mean = h[0] + h[0] * prior * (h[0] * r).conj() * (u - h[0] * r) / (known * drive + noise);
    assert!((found.responses[0] - mean).norm() < 1e-12, "{:?} {mean}", found.responses[0]);
    let variance = h[0].norm_sqr() * (prior - prior * prior * drive / (known * drive + noise));
    assert!((found.response_variances[0] - variance).abs() < 1e-12);
    assert!((found.response_variances[1] - h[2].norm_sqr() * prior).abs() < 1e-12);
    // Of all trials only the shared part is.
    let all = learned.posterior(omega, None);
    let shared = 0.3_f64.powi(2);
    let variance = h[0].norm_sqr() * (shared - shared * shared * drive / (known * drive + noise));
    assert!((all.response_variances[0] - variance).abs() < 1e-12);
}
