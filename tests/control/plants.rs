//! The catalogue, the commands, and simulated subjects.

use num_complex::Complex64;
use std::io::Read;
use volition::control::simulate::{self, Hold};
use volition::control::{Continuous, Discrete, TransferFunction};
use volition::num::stats;
use volition::plants::Plant;
use volition::simulate::inverse_dynamics::InverseError;
use volition::simulate::reference_signals::{self, Sine};
use volition::simulate::subject::{SubjectError, SubjectParameters};
use volition::simulate::{SimulatedStudy, SimulatedSubject};
use volition::trial::Trial;

fn mean_abs_error(trial: &Trial) -> f64 {
    stats::mean(&trial.error().iter().map(|e| e.abs()).collect::<Vec<_>>()).unwrap()
}

fn largest(values: &[f64]) -> f64 {
    values.iter().fold(0.0, |most, v| v.abs().max(most))
}

#[test]
fn plants_are_found_by_name_and_by_no_other() {
    for plant in Plant::ALL {
        assert_eq!(Plant::by_name(plant.name()), Ok(plant));
        assert_eq!(serde_json::to_value(plant).unwrap(), plant.name());
    }
    let error = Plant::by_name("two mass").unwrap_err().to_string();
    assert!(error.contains("\"two mass\"") && error.contains("two_mass, minimum_phase"), "{error}");
}

#[test]
fn the_plants_of_chapter_five_share_poles_and_static_gain() {
    // Zhang 2015, section 5.3: poles −1.8 ± 0.87j, static gain 1.1, zeros −2.2, 2.2 and 0.8.
    let plants = [(Plant::MinimumPhase, -2.2), (Plant::NonminimumPhase, 2.2), (Plant::SlowNonminimumPhase, 0.8)];
    for (plant, zero) in plants {
        let g = plant.transfer_function();
        assert!(g.poles().unwrap().iter().all(|p| (p.re + 1.8).abs() < 1e-12 && (p.im.abs() - 0.87).abs() < 5e-3));
        assert!((g.response(0.0) - 1.1).norm() < 1e-15);
        assert!((g.zeros().unwrap()[0] - zero).norm() < 1e-12);
    }
}

#[test]
fn the_chirps_have_their_ends_middles_and_symmetries() {
    let chirp = reference_signals::chirp80(0.002);
    assert_eq!(chirp.len(), 40_001);
    assert_eq!(chirp[0], 0.0);
    // The second half is the first backwards, sign changed.
    assert!((0..=40_000).all(|i| (chirp[i] + chirp[40_000 - i]).abs() < 1e-10));
    // A quarter period after the start the sine is at the envelope, 2 − 0.035 t.
    let t = (-0.2 + (0.04_f64 + 0.03).sqrt()) / 0.03;
    assert!((reference_signals::chirp80_at(t) - (2.0 - 0.035 * t)).abs() < 1e-12);

    let chirp = reference_signals::chirp60(0.02);
    assert_eq!(chirp.len(), 3_001);
    assert!((reference_signals::chirp60_at(60.0_f64.sqrt()) - 2.0).abs() < 1e-14, "phase π/2 at t² = 60");
    assert!(chirp[3_000].abs() < 1e-12, "phase 30π at the end");
    assert!(largest(&chirp) <= 2.0);
}

#[test]
fn a_sum_of_sines_is_one() {
    let sines = [
        Sine { amplitude: 2.0, omega_rad_s: 1.0, phase_rad: 0.5 },
        Sine { amplitude: -0.5, omega_rad_s: 3.0, phase_rad: 0.0 },
    ];
    let samples = reference_signals::sum_of_sines(&sines, 0.1, 1.0);
    assert_eq!(samples.len(), 11);
    assert!((samples[10] - (2.0 * 1.5_f64.sin() - 0.5 * 3.0_f64.sin())).abs() < 1e-15);
}

#[test]
fn a_seed_decides_a_trial_and_nothing_else_does() {
    let plant = Plant::MinimumPhase.transfer_function();
    let command = reference_signals::chirp60(0.02);
    let subject = |seed| SimulatedSubject::new(&plant, 0.02, seed).unwrap();
    let first = subject(7).trial(3, &command, None).unwrap();
    let again = subject(7);
    // Trials in between change nothing.
    again.trial(1, &command, None).unwrap();
    assert_eq!(again.trial(3, &command, None).unwrap().content_sha256(), first.content_sha256());
    assert_ne!(again.trial(4, &command, None).unwrap(), first);
    assert_ne!(subject(8).trial(3, &command, None).unwrap(), first);
    assert_ne!(subject(8).parameters(), subject(7).parameters());
}

#[test]
fn a_trial_is_complete_and_its_output_is_the_plants() {
    let plant = Plant::TwoMass.transfer_function();
    let subject = SimulatedSubject::new(&plant, 0.002, 5).unwrap();
    let command = reference_signals::chirp80(0.002);
    let disturbance =
        reference_signals::sum_of_sines(&[Sine { amplitude: 0.3, omega_rad_s: 5.0, phase_rad: 0.0 }], 0.002, 80.0);
    let trial = subject.trial(10, &command, Some(&disturbance)).unwrap();
    assert_eq!((trial.samples(), trial.sample_time_s), (40_001, 0.002));
    let signals = &trial.signals;
    assert_eq!(signals.time_s.as_ref().unwrap().len(), 40_001);
    assert_eq!(signals.time_s.as_ref().unwrap()[40_000], 80.0);
    assert_eq!(signals.command, command);
    assert_eq!(signals.disturbance.as_ref(), Some(&disturbance));
    let input: Vec<f64> = signals.control.iter().zip(&disturbance).map(|(u, d)| u + d).collect();
    let y = simulate::sampled_response(&plant, &input, Discrete::new(0.002).unwrap(), Hold::Zero).unwrap();
    let error = y.iter().zip(&signals.output).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(error < 1e-9, "{error}");
    assert!(largest(&signals.control) < 40.0, "no kick at either end: {}", largest(&signals.control));
}

#[test]
fn practice_makes_the_error_smaller_on_every_plant() {
    let command = reference_signals::chirp60(0.02);
    for plant in Plant::ALL {
        for seed in 0..20 {
            let subject = SimulatedSubject::new(&plant.transfer_function(), 0.02, seed).unwrap();
            let mean_of = |numbers: std::ops::RangeInclusive<u32>| {
                let errors: Vec<f64> =
                    numbers.map(|n| mean_abs_error(&subject.trial(n, &command, None).unwrap())).collect();
                stats::mean(&errors).unwrap()
            };
            let blocks = [mean_of(1..=3), mean_of(9..=11), mean_of(38..=40)];
            let name = plant.name();
            assert!(blocks[0] > blocks[1] && blocks[1] > blocks[2], "{name}, seed {seed}: {blocks:?}");
            let last = subject.trial(40, &command, None).unwrap();
            assert!(largest(&last.signals.output) < 4.0, "{name}, seed {seed}: the display ends at 8");
            assert!(largest(&last.signals.control) < 40.0, "{name}, seed {seed}");
        }
    }
}

/// The feedback loop forgets: a burst of disturbance has died away, and the trial goes on as without it.
#[test]
fn the_feedback_loop_is_stable() {
    let command = reference_signals::chirp60(0.02);
    let burst: Vec<f64> = (0..command.len()).map(|k| if (50..100).contains(&k) { 5.0 } else { 0.0 }).collect();
    for plant in Plant::ALL {
        for seed in 0..20 {
            let subject = SimulatedSubject::new(&plant.transfer_function(), 0.02, seed).unwrap();
            let (with, without) =
                (subject.trial(1, &command, Some(&burst)).unwrap(), subject.trial(1, &command, None).unwrap());
            let difference: Vec<f64> =
                with.signals.output.iter().zip(&without.signals.output).map(|(a, b)| a - b).collect();
            assert!(largest(&difference) > 0.5, "{}", plant.name());
            assert!(largest(&difference[2_500..]) < 1e-6, "{}, seed {seed}", plant.name());
        }
    }
}

/// Without noise, a long sinusoid is answered as the subject's own frequency responses say.
#[test]
fn a_subject_does_what_its_frequency_responses_say() {
    for plant in [Plant::MinimumPhase, Plant::NonminimumPhase, Plant::DampedDoubleIntegrator] {
        let mut parameters = SubjectParameters::draw(3, plant == Plant::NonminimumPhase);
        parameters.remnant = 0.0;
        let subject = SimulatedSubject::with_parameters(&plant.transfer_function(), 0.02, 3, parameters).unwrap();
        let omega = std::f64::consts::PI * 0.3;
        let command = reference_signals::sum_of_sines(
            &[Sine { amplitude: 1.0, omega_rad_s: omega, phase_rad: 0.0 }],
            0.02,
            120.0,
        );
        let trial = subject.trial(8, &command, None).unwrap();
        let g = subject.plant_response(omega);
        let (ff, fb) = (subject.feedforward_response(8, omega), subject.feedback_response(omega));
        let expected = g * (ff + fb) / (1.0 + g * fb);
        // The last but one stretch of three whole periods (20 s), clear of the transient and of the end of the preview.
        let (mut y, mut r) = (Complex64::new(0.0, 0.0), Complex64::new(0.0, 0.0));
        for (k, (output, command)) in trial.signals.output.iter().zip(&command).enumerate().take(5_000).skip(4_000) {
            let turn = Complex64::from_polar(1.0, -omega * 0.02 * k as f64);
            y += output * turn;
            r += command * turn;
        }
        let error = (y / r - expected).norm();
        assert!(error < 1e-9, "{}: {} {expected}", plant.name(), y / r);
    }
}

#[test]
fn the_feedforward_approaches_the_inverse_dynamics() {
    let distance = |subject: &SimulatedSubject, number: u32| {
        let omegas = [0.3, 0.8, 1.5, 2.2, 3.0];
        let at = |w: &f64| (subject.feedforward_response(number, *w) * subject.plant_response(*w) - 1.0).norm();
        omegas.iter().map(at).sum::<f64>() / omegas.len() as f64
    };
    for seed in 0..10 {
        let minimum = SimulatedSubject::new(&Plant::MinimumPhase.transfer_function(), 0.02, seed).unwrap();
        let nonminimum = SimulatedSubject::new(&Plant::NonminimumPhase.transfer_function(), 0.02, seed).unwrap();
        assert!(distance(&minimum, 40) < 0.25 && distance(&minimum, 1) > 0.4);
        assert!(distance(&nonminimum, 40) < distance(&nonminimum, 1));
        assert!(distance(&nonminimum, 40) > distance(&minimum, 40));
    }
}

#[test]
fn what_no_subject_can_do_is_refused() {
    let unstable = TransferFunction::new(&[1.0], &[1.0, -0.5], Continuous).unwrap();
    assert_eq!(
        SimulatedSubject::new(&unstable, 0.02, 1).unwrap_err(),
        SubjectError::UnstablePlant { re: 0.5, im: 0.0 }
    );
    let double = TransferFunction::new(&[1.0], &[1.0, 0.0, 0.0], Continuous).unwrap();
    assert!(matches!(SimulatedSubject::new(&double, 0.02, 1), Err(SubjectError::UnstablePlant { .. })));
    let blocked = TransferFunction::new(&[1.0, 0.0], &[1.0, 2.0, 1.0], Continuous).unwrap();
    let error = SimulatedSubject::new(&blocked, 0.02, 1).unwrap_err();
    assert_eq!(error, SubjectError::Inverse(InverseError::ZeroOnAxis { re: 0.0, im: 0.0 }));
    let plant = Plant::Integrator.transfer_function();
    assert!(matches!(SimulatedSubject::new(&plant, 0.0, 1), Err(SubjectError::SampleTime(_))));
    let subject = SimulatedSubject::new(&plant, 0.02, 1).unwrap();
    assert_eq!(subject.trial(1, &[1.0], None).unwrap_err(), SubjectError::ShortCommand(1));
    assert!(matches!(subject.trial(1, &[1.0, 2.0], Some(&[0.0])), Err(SubjectError::Simulation(_))));
    let mut parameters = SubjectParameters::draw(1, false);
    parameters.sensitivity_peak = 0.9;
    let error = SimulatedSubject::with_parameters(&plant, 0.02, 1, parameters).unwrap_err();
    assert!(matches!(error, SubjectError::Parameter { name: "sensitivity_peak", .. }), "{error}");
}

#[test]
fn a_plant_with_negative_gain_is_held_with_negative_feedback() {
    let plant = TransferFunction::new(&[-2.0, -4.4], &[1.0, 3.6, 4.0], Continuous).unwrap();
    let subject = SimulatedSubject::new(&plant, 0.02, 4).unwrap();
    assert!(subject.feedback_gain() < 0.0);
    let command = reference_signals::chirp60(0.02);
    let errors = [1, 40].map(|n| mean_abs_error(&subject.trial(n, &command, None).unwrap()));
    assert!(errors[1] < 0.5 * errors[0], "{errors:?}");
}

#[test]
fn a_study_has_two_groups_that_learn_differently() {
    let study = SimulatedStudy::two_groups(8, 40, 11).unwrap();
    assert_eq!(study.groups.iter().map(|g| g.name).collect::<Vec<_>>(), ["minimum_phase", "nonminimum_phase"]);
    let mean = |group: usize, number: u32| {
        let members = &study.groups[group].members;
        let errors: Vec<f64> = members.iter().map(|m| mean_abs_error(&study.trial(m, number).unwrap())).collect();
        stats::mean(&errors).unwrap()
    };
    for group in 0..2 {
        assert_eq!(study.groups[group].members.len(), 8);
        assert!(mean(group, 40) < 0.75 * mean(group, 1));
    }
    assert!(mean(0, 40) < mean(1, 40));
    let codes: Vec<&str> = study.groups.iter().flat_map(|g| g.members.iter().map(|m| m.code.as_str())).collect();
    assert_eq!((codes[0], codes[8], codes.len()), ("MP01", "NP01", 16));
    let again = SimulatedStudy::two_groups(3, 40, 11).unwrap();
    // A subject does not depend on how many others there are.
    assert_eq!(again.groups[1].members[2].subject.parameters(), study.groups[1].members[2].subject.parameters());
}

/// The virtual subjects (made by another simulator) use the same commands and plants.
#[test]
fn shared_virtual_subjects_have_our_commands_and_plants() {
    let folder = crate::virtual_subjects::folder();
    let truth = std::fs::read(folder.join("truth.json")).unwrap();
    let truth: Vec<serde_json::Value> = serde_json::from_slice(&truth).unwrap();
    let mut seen = std::collections::BTreeSet::new();
    for entry in truth {
        let group = entry["group"].as_str().unwrap().to_owned();
        if !seen.insert(group.clone()) {
            continue;
        }
        let (plant, command) = match group.as_str() {
            "msd2" => (Plant::TwoMass, reference_signals::chirp80(0.002)),
            "gm" => (Plant::MinimumPhase, reference_signals::chirp60(0.02)),
            "gn" => (Plant::NonminimumPhase, reference_signals::chirp60(0.02)),
            "gsn" => (Plant::SlowNonminimumPhase, reference_signals::chirp60(0.02)),
            other => panic!("group {other}"),
        };
        let g = plant.transfer_function();
        for (name, ours) in [("plant_num", g.num()), ("plant_den", g.den())] {
            let theirs: Vec<f64> = serde_json::from_value(entry[name].clone()).unwrap();
            assert_eq!(theirs.len(), ours.coefficients().len());
            assert!(
                theirs.iter().zip(ours.coefficients()).all(|(a, b)| (a - b).abs() < 1e-14 * a.abs()),
                "{group} {name}"
            );
        }
        let file = std::fs::File::open(folder.join(entry["file"].as_str().unwrap())).unwrap();
        let mut text = String::new();
        flate2::read::GzDecoder::new(file).read_to_string(&mut text).unwrap();
        let theirs: Vec<f64> =
            text.lines().skip(1).map(|line| line.split(',').nth(1).unwrap().parse().unwrap()).collect();
        assert_eq!(theirs.len(), command.len(), "{group}");
        // Written with five decimals.
        assert!(theirs.iter().zip(&command).all(|(a, b)| (a - b).abs() < 5.1e-6), "{group}");
    }
    assert_eq!(seen.len(), 4);
}
