use super::super::setup::{Setup, Start};
use super::*;
use crate::control::{Continuous, System, TransferFunction};
use crate::ctl::Ctl;
use crate::identify::identifiability::Structure;
use crate::identify::problem::{Lines, Problem};
use crate::num::rng;
use rand_distr::{Distribution, StandardNormal};

struct World {
    plant: System,
    feedforward: System,
    feedback: System,
    structure: Structure,
    omega: Vec<f64>,
    deviation: Vec<f64>,
}

fn tf(num: &[f64], den: &[f64]) -> System {
    System::Continuous(TransferFunction::new(num, den, Continuous).unwrap())
}

/// A loop whose lines tell feedback and feedforward apart, with noise that differs from line to line.
fn world(noise: f64) -> World {
    let omega: Vec<f64> = (1..=24).map(|k| 0.35 * f64::from(k)).collect();
    let deviation = omega.iter().map(|w| noise * (0.4 + 0.15 * w)).collect();
    World {
        plant: tf(&[4.0], &[1.0, 2.0]),
        feedforward: tf(&[1.2, 2.0], &[1.0, 3.5]),
        feedback: tf(&[6.4], &[1.0, 3.1]),
        structure: Structure {
            feedforward_numerator: 1,
            feedforward_denominator_is_free: true,
            feedforward_denominator: 1,
            feedback_numerator: 0,
            feedback_denominator: 1,
            held: None,
        },
        omega,
        deviation,
    }
}

impl World {
    fn truth(&self) -> Vec<Complex64> {
        self.omega
            .iter()
            .map(|w| {
                let (g, ff, fb) = (self.plant.response(*w), self.feedforward.response(*w), self.feedback.response(*w));
                g * (ff + fb) / (1.0 + g * fb)
            })
            .collect()
    }

    /// The mean of `segments` noisy responses, whose variance is `deviation²` together, with the variance that they
    /// show.
    fn draw(&self, seed: u64, segments: usize) -> (Vec<Complex64>, Vec<f64>) {
        let mut random = rng::stream(seed, "coverage");
        let mut normal = || -> f64 { StandardNormal.sample(&mut random) };
        self.truth()
            .iter()
            .zip(&self.deviation)
            .map(|(h, deviation)| {
                let each = deviation * (segments as f64 / 2.0).sqrt();
                let all: Vec<Complex64> =
                    (0..segments).map(|_| h + each * Complex64::new(normal(), normal())).collect();
                let mean = all.iter().sum::<Complex64>() / segments as f64;
                let scatter: f64 = all.iter().map(|h| (h - mean).norm_sqr()).sum();
                (mean, scatter / (segments as f64 * (segments as f64 - 1.0)))
            })
            .unzip()
    }

    fn uncertainty(&self, h: &[Complex64], weights: Option<&[f64]>, noise: &Noise) -> Uncertainty {
        let lines = Lines::new(&self.plant, &self.omega, h, weights);
        let problem = Problem::new(&lines, self.structure.feedforward_numerator).unwrap();
        let setup = Setup { problem: &problem, plant: &self.plant, structure: self.structure, margin_per_s: 0.0 };
        let start = Start::of(&self.feedforward, &self.feedback);
        Refinement::new(setup, &start, &Ctl::new()).unwrap().uncertainty(noise).unwrap()
    }
}

impl World {
    fn refined<T>(&self, h: &[Complex64], ask: impl Fn(&Refinement<'_>) -> Option<T>) -> Option<T> {
        let lines = Lines::new(&self.plant, &self.omega, h, None);
        let problem = Problem::new(&lines, self.structure.feedforward_numerator).unwrap();
        let setup = Setup { problem: &problem, plant: &self.plant, structure: self.structure, margin_per_s: 0.0 };
        let start = Start::of(&self.feedforward, &self.feedback);
        ask(&Refinement::new(setup, &start, &Ctl::new()).unwrap())
    }
}

/// Hits and counts of the bands of one controller.
#[derive(Default, Debug)]
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
        let turned = (truth.arg().to_degrees() - band.phase_deg + 540.0).rem_euclid(360.0) - 180.0 + band.phase_deg;
        self.given += 2;
        self.held += usize::from((magnitude[0]..=magnitude[1]).contains(&truth.norm()));
        self.held += usize::from((phase[0]..=phase[1]).contains(&turned));
    }

    fn share(&self) -> f64 {
        self.held as f64 / self.given as f64
    }
}

/// Draws trials, and counts how often the bands of Gff, Gfb, Gff·G and the closed loop hold the truth.
fn coverage(world: &World, trials: u64, segments: usize, is_weighted: bool, is_known: bool) -> [Coverage; 4] {
    let mut coverage: [Coverage; 4] = Default::default();
    let truth = world.truth();
    for seed in 0..trials {
        let (h, shown) = world.draw(seed, segments);
        let known: Vec<f64> = world.deviation.iter().map(|d| d * d).collect();
        let noise = if is_known {
            Noise { variance: known.clone(), degrees_of_freedom: f64::INFINITY, are_independent: true }
        } else {
            Noise { variance: shown.clone(), degrees_of_freedom: 2.0 * (segments as f64 - 1.0), are_independent: true }
        };
        let weights: Vec<f64> = noise.variance.iter().map(|v| 1e-4 / v).collect();
        let found = world.uncertainty(&h, is_weighted.then_some(weights.as_slice()), &noise);
        for (k, omega) in world.omega.iter().enumerate() {
            let (g, ff, fb) =
                (world.plant.response(*omega), world.feedforward.response(*omega), world.feedback.response(*omega));
            let truths = [ff, fb, g * ff, truth[k]];
            let bands = [&found.feedforward, &found.feedback, &found.feedforward_plant, &found.closed_loop];
            for ((coverage, band), truth) in coverage.iter_mut().zip(bands).zip(truths) {
                coverage.count(&band[k], truth);
            }
        }
    }
    coverage
}

#[test]
fn bands_hold_the_truth_in_95_of_100_trials_with_known_variance() {
    for (noise, is_weighted) in [(0.01, false), (0.02, true)] {
        let coverage = coverage(&world(noise), 500, 2, is_weighted, true);
        for (coverage, name) in
            coverage.iter().zip(["feedforward", "feedback", "feedforward times plant", "closed loop"])
        {
            assert!((0.93..=0.97).contains(&coverage.share()), "{name}: {coverage:?}");
            assert!(coverage.missing * 20 < coverage.given, "{name}: {coverage:?}");
        }
    }
}

#[test]
fn bands_hold_with_variances_from_few_segments() {
    for segments in [2, 4] {
        let coverage = coverage(&world(0.01), 500, segments, false, false);
        for (coverage, name) in
            coverage.iter().zip(["feedforward", "feedback", "feedforward times plant", "closed loop"])
        {
            assert!((0.93..=0.97).contains(&coverage.share()), "{segments} segments, {name}: {coverage:?}");
        }
    }
}

/// Under a right model the p-values are uniform; under a wrong one they are small.
#[test]
fn residual_tests_reject_a_right_model_as_often_as_they_say() {
    let world = world(0.01);
    let known: Vec<f64> = world.deviation.iter().map(|d| d * d).collect();
    for (segments, is_known) in [(2, true), (4, false)] {
        let (mut power, mut white, trials) = (0, 0, 300);
        for seed in 0..trials {
            let (h, shown) = world.draw(1000 + seed, segments);
            let noise = if is_known {
                Noise { variance: known.clone(), degrees_of_freedom: f64::INFINITY, are_independent: true }
            } else {
                Noise { variance: shown, degrees_of_freedom: 2.0 * (segments as f64 - 1.0), are_independent: true }
            };
            let tests = world.refined(&h, |refinement| refinement.residual_tests(&noise)).unwrap();
            power += usize::from(tests.power_p_value < 0.1);
            white += usize::from(tests.whiteness_p_value.unwrap() < 0.1);
        }
        // 30 are expected, with a standard deviation of 5.2.
        assert!((15..=46).contains(&power) && (15..=46).contains(&white), "{power} {white}");
    }
    // A resonance that the structure does not have.
    let noise = Noise { variance: known, degrees_of_freedom: f64::INFINITY, are_independent: true };
    let (mut h, _) = world.draw(5, 2);
    h.iter_mut().zip(&world.omega).for_each(|(h, w)| {
        let s = Complex64::new(0.0, *w);
        *h += 0.05 * s / (s * s + 0.8 * s + 9.0);
    });
    let tests = world.refined(&h, |refinement| refinement.residual_tests(&noise)).unwrap();
    assert!(tests.power_p_value < 1e-3 && tests.whiteness_p_value.unwrap() < 0.01, "{tests:?}");
}

#[test]
fn the_bootstrap_agrees_with_the_bands() {
    let world = world(0.01);
    let (h, _) = world.draw(3, 2);
    let variance: Vec<f64> = world.deviation.iter().map(|d| d * d).collect();
    let noise = Noise { variance, degrees_of_freedom: f64::INFINITY, are_independent: true };
    let (bands, drawn, again) = world
        .refined(&h, |refinement| {
            let run = || refinement.bootstrap(&noise, 400, 7, &Ctl::new()).unwrap();
            Some((refinement.uncertainty(&noise)?, run(), run()))
        })
        .unwrap();
    assert_eq!(drawn, again);
    assert!(drawn.converged > 380, "{drawn:?}");
    for (bands, drawn) in [(&bands.feedforward, &drawn.feedforward), (&bands.feedback, &drawn.feedback)] {
        for (band, drawn) in bands.iter().zip(drawn) {
            let width = |b: [f64; 2]| b[1] - b[0];
            let magnitude = width(drawn.magnitude_band) / width(band.magnitude_band.unwrap());
            let phase = width(drawn.phase_band_deg) / width(band.phase_band_deg.unwrap());
            // A quantile of 400 draws has a relative error of about 7 %.
            assert!((0.75..1.3).contains(&magnitude) && (0.75..1.3).contains(&phase), "{band:?} {drawn:?}");
        }
    }
}

#[test]
fn what_cannot_be_known_gets_no_band() {
    let world = world(0.01);
    let (h, _) = world.draw(3, 2);
    let noise = |scale: f64| Noise {
        variance: world.deviation.iter().map(|d| scale * d * d).collect(),
        degrees_of_freedom: f64::INFINITY,
        are_independent: true,
    };
    // A margin that holds the optimum.
    let lines = Lines::new(&world.plant, &world.omega, &h, None);
    let problem = Problem::new(&lines, 1).unwrap();
    let setup = Setup { problem: &problem, plant: &world.plant, structure: world.structure, margin_per_s: 3.0 };
    let start = Start {
        feedforward_denominator: vec![1.0, 3.5],
        feedback_numerator: vec![6.4],
        feedback_denominator: vec![1.0, 6.0],
    };
    let held = Refinement::new(setup, &start, &Ctl::new()).unwrap().uncertainty(&noise(1.0)).unwrap();
    assert_eq!(held.unavailable, Some(Unavailable::OnConstraint));
    assert!(held.feedback.iter().all(|b| b.magnitude_band.is_none() && b.unavailable.is_some()));
    // Noise so large that the margin is near.
    let near = world.refined(&h, |refinement| refinement.uncertainty(&noise(1e4))).unwrap();
    assert_eq!(near.unavailable, Some(Unavailable::NearStabilityMargin), "{:?}", near.deviations_to_margin);
    // More coefficients than the loop has: a zero and a pole of the feedforward that cancel.
    let structure = Structure { feedforward_numerator: 2, feedforward_denominator: 2, ..world.structure };
    let problem = Problem::new(&Lines::new(&world.plant, &world.omega, &world.truth(), None), 2).unwrap();
    let setup = Setup { problem: &problem, plant: &world.plant, structure, margin_per_s: 0.0 };
    let start =
        Start { feedforward_denominator: vec![1.0, 5.5, 7.0], ..Start::of(&world.feedforward, &world.feedback) };
    let many = Refinement::new(setup, &start, &Ctl::new()).unwrap().uncertainty(&noise(1.0)).unwrap();
    let of = |name: &str| many.parameters.iter().find(|p| p.name == name).unwrap().unavailable;
    assert_eq!(of("feedforward_denominator[1]"), Some(Unavailable::NotIdentifiable), "{:?}", many.parameters);
    assert_eq!(of("feedback_denominator[1]"), None, "{:?}", many.parameters);
    assert!(many.feedback.iter().chain(&many.feedforward).all(|b| b.magnitude_band.is_some()));
}

/// `(θ̂ − θ)ᵀ C⁻¹ (θ̂ − θ)` has the mean and the spread of χ² with as many degrees as there are coefficients.
#[test]
fn the_covariance_is_that_of_the_estimates() {
    let world = world(0.004);
    let truth = DVector::from_vec(vec![1.2, 2.0, 3.5, 6.4, 3.1]);
    let variance: Vec<f64> = world.deviation.iter().map(|d| d * d).collect();
    let noise = Noise { variance, degrees_of_freedom: f64::INFINITY, are_independent: true };
    let draws = 300;
    let mut distances = Vec::new();
    for seed in 0..draws {
        let (h, _) = world.draw(1000 + seed, 2);
        let found = world.refined(&h, |refinement| refinement.uncertainty(&noise)).unwrap();
        let rows = found.covariance.unwrap();
        let covariance = DMatrix::from_fn(5, 5, |i, j| rows[i][j]);
        assert_eq!(covariance, covariance.transpose());
        for (i, own) in found.parameters.iter().enumerate() {
            let deviation = own.standard_deviation.unwrap();
            assert!((covariance[(i, i)].sqrt() / deviation - 1.0).abs() < 1e-12, "{}", own.name);
        }
        let off = DVector::from_iterator(5, found.parameters.iter().map(|own| own.value)) - &truth;
        distances.push(off.dot(&covariance.cholesky().unwrap().solve(&off)));
    }
    let mean = distances.iter().sum::<f64>() / draws as f64;
    // The mean of so many has a standard deviation of √(10/300) = 0.18.
    assert!((mean - 5.0).abs() < 0.75, "{mean}");
    // Above the 95 % point of χ² with five degrees lie 5 of 100.
    let above = distances.iter().filter(|distance| **distance > 11.0705).count();
    assert!((4..=29).contains(&above), "{above} of {draws}");
}
