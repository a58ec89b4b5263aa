//! Do bands hold the truth where the data are recordings, and not responses with noise of known variance?
//!
//! Simulated trials with a coloured disturbance at the plant's input go through the estimate of the frequency response
//! with few segments, whose scatter is all that is known of the noise. The refinement starts at the truth: the bands
//! are about the local optimum, not about the search.
//!
//! Measured once with four times the noise (0.12): bands of the closed loop held the truth in 94 – 95 %, those of the
//! controllers in 91.5 % (2 and 4 segments) and 93.3 % (8), since first order is too little where they are that
//! uncertain.

use num_complex::Complex64;
use rand_distr::{Distribution, StandardNormal};
use serde_json::json;
use std::f64::consts::TAU;
use volition::control::{Discrete, System, TransferFunction};
use volition::ctl::Ctl;
use volition::identify::identifiability::Structure;
use volition::identify::problem::{Lines, Problem};
use volition::identify::refine::{Band, Noise, Refinement, Setup, Start};
use volition::num::rng;
use volition::person::two_degrees_of_freedom::TwoDegreesOfFreedom;
use volition::response::{FrequencySettings, estimate};
use volition::trial::{Signals, Trial};

const PERIOD: usize = 400;
const TRIALS: u64 = 500;

fn tf(num: &[f64], den: &[f64]) -> TransferFunction<Discrete> {
    TransferFunction::new(num, den, Discrete::new(0.05).unwrap()).unwrap()
}

#[derive(Default)]
struct Coverage {
    held: usize,
    given: usize,
    missing: usize,
}

impl Coverage {
    fn count(&mut self, band: &Band, truth: Complex64) {
        let (Some(magnitude), Some(phase)) = (band.magnitude_band, band.phase_band_deg) else {
            self.missing += 1;
            return;
        };
        let apart = (truth.arg().to_degrees() - band.phase_deg + 540.0).rem_euclid(360.0) - 180.0;
        self.given += 2;
        self.held += usize::from((magnitude[0]..=magnitude[1]).contains(&truth.norm()));
        self.held += usize::from((phase[0]..=phase[1]).contains(&(band.phase_deg + apart)));
    }
}

#[test]
fn bands_from_recordings_hold_the_truth() {
    let (plant, feedforward, feedback) =
        (tf(&[0.2], &[1.0, -0.85]), tf(&[0.9, -0.5], &[1.0, -0.6]), tf(&[0.8], &[1.0, -0.5]));
    let closed = TwoDegreesOfFreedom::new(plant.clone(), feedforward.clone(), feedback.clone()).unwrap();
    let [g, ff, fb] = [plant, feedforward, feedback].map(System::Discrete);
    let lines: Vec<usize> = (1..=24).map(|k| 2 * k + 1).collect();
    let structure = Structure {
        feedforward_numerator: 1,
        feedforward_denominator_is_free: true,
        feedforward_denominator: 1,
        feedback_numerator: 0,
        feedback_denominator: 1,
        held: None,
    };
    for (segments, size) in [(2_usize, 0.03), (4, 0.03)] {
        // A period before the first segment lets the start die away.
        let samples = (segments + 1) * PERIOD;
        let command: Vec<f64> = (0..samples)
            .map(|i| {
                let angle = TAU * i as f64 / PERIOD as f64;
                lines.iter().map(|k| (*k as f64 * angle + 2.1 * (*k * *k) as f64).sin()).sum()
            })
            .collect();
        let settings: FrequencySettings = serde_json::from_value(json!({
            "lines": {"frequency_hz": lines.iter().map(|k| *k as f64 / (PERIOD as f64 * 0.05)).collect::<Vec<_>>()},
            "segments": {"length_s": PERIOD as f64 * 0.05, "start_s": PERIOD as f64 * 0.05},
        }))
        .unwrap();
        let mut coverage: [Coverage; 4] = Default::default();
        for seed in 0..TRIALS {
            let mut random = rng::stream(seed, "coverage of recordings");
            let mut state = 0.0;
            let disturbance: Vec<f64> = (0..samples)
                .map(|_| {
                    let white: f64 = StandardNormal.sample(&mut random);
                    state = 0.8 * state + size * white;
                    state
                })
                .collect();
            let response = closed.simulate(&command, Some(&disturbance)).unwrap();
            // The disturbance is not recorded: it is the person's remnant.
            let signals = Signals {
                time_s: None,
                command: command.clone(),
                control: response.control.unwrap(),
                output: response.output,
                disturbance: None,
            };
            let trial = Trial::new(0.05, signals).unwrap();
            let estimated = estimate(&[&trial], &settings).unwrap();
            assert_eq!(estimated.segments.len(), segments);
            let data = estimated.data();
            let problem = Problem::new(&Lines::new(&g, &data.omega_rad_s, &data.h, None), 1).unwrap();
            let noise = Noise {
                variance: data.variance.unwrap(),
                degrees_of_freedom: 2.0 * (segments as f64 - 1.0),
                are_independent: true,
            };
            let setup = Setup { problem: &problem, plant: &g, structure, margin_per_s: 0.0 };
            let refinement = Refinement::new(setup, &Start::of(&ff, &fb), &Ctl::new()).unwrap();
            let found = refinement.uncertainty(&noise).unwrap();
            for (k, omega) in data.omega_rad_s.iter().enumerate() {
                let (g, ff, fb) = (g.response(*omega), ff.response(*omega), fb.response(*omega));
                let truths = [ff, fb, g * ff, g * (ff + fb) / (1.0 + g * fb)];
                let bands = [&found.feedforward, &found.feedback, &found.feedforward_plant, &found.closed_loop];
                for ((coverage, bands), truth) in coverage.iter_mut().zip(bands).zip(truths) {
                    coverage.count(&bands[k], truth);
                }
            }
        }
        for (coverage, name) in coverage.iter().zip(["Gff", "Gfb", "Gff·G", "closed loop"]) {
            let share = coverage.held as f64 / coverage.given as f64;
            eprintln!(
                "{segments} segments, noise {size}, {name}: {share:.4} of {} bands hold, {} lines without",
                coverage.given, coverage.missing
            );
            assert!((0.93..=0.97).contains(&share), "{segments} segments, {name}: {share}");
            assert!(coverage.missing * 10 < coverage.given, "{name}: {} lines without a band", coverage.missing);
        }
    }
}
