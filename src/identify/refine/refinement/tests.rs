use super::*;
use crate::control::Discrete;
use crate::identify::identifiability::Structure;
use crate::identify::problem::Lines;
use crate::identify::refine::{Delay, Delays, Noise, refine_with_delays};
use crate::num::rng;
use rand_distr::{Distribution, StandardNormal};

struct World {
    plant: System,
    feedforward: System,
    feedback: System,
    structure: Structure,
    omega: Vec<f64>,
}

fn continuous(num: &[f64], den: &[f64]) -> System {
    System::Continuous(TransferFunction::new(num, den, Continuous).unwrap())
}

fn sampled(num: &[f64], den: &[f64]) -> System {
    System::Discrete(TransferFunction::new(num, den, Discrete::new(0.1).unwrap()).unwrap())
}

/// Example of section 2.6 of Zhang 2015.
fn first_order() -> World {
    World {
        plant: continuous(&[4.0], &[1.0, 2.0]),
        feedforward: continuous(&[2.1, 3.0], &[1.0, 6.5]),
        feedback: continuous(&[5.4], &[1.0, 7.1]),
        structure: Structure {
            feedforward_numerator: 1,
            feedforward_denominator_is_free: true,
            feedforward_denominator: 1,
            feedback_numerator: 0,
            feedback_denominator: 1,
            held: None,
        },
        omega: (1..=20).map(|k| 0.2 * std::f64::consts::PI * f64::from(k)).collect(),
    }
}

/// An FIR feedforward on a sampled plant.
fn fir() -> World {
    World {
        plant: sampled(&[0.02, 0.018], &[1.0, -1.9, 0.91]),
        feedforward: sampled(&[5.0, -7.0, 2.5], &[1.0, 0.0, 0.0]),
        feedback: sampled(&[0.5, -0.35], &[1.0, -1.1, 0.3]),
        structure: Structure {
            feedforward_numerator: 2,
            feedforward_denominator_is_free: false,
            feedforward_denominator: 2,
            feedback_numerator: 1,
            feedback_denominator: 2,
            held: None,
        },
        omega: (0..31).map(|k| 0.3 * f64::from(k)).collect(),
    }
}

impl World {
    fn problem(&self, noise: f64, seed: u64) -> Problem {
        let mut random = rng::stream(seed, "refine tests");
        let mut normal = || -> f64 { StandardNormal.sample(&mut random) };
        let h: Vec<Complex64> = self
            .omega
            .iter()
            .map(|w| {
                let (g, ff, fb) = (self.plant.response(*w), self.feedforward.response(*w), self.feedback.response(*w));
                g * (ff + fb) / (1.0 + g * fb) + noise * Complex64::new(normal(), normal())
            })
            .collect();
        let lines = Lines::new(&self.plant, &self.omega, &h, None);
        Problem::new(&lines, self.structure.feedforward_numerator).unwrap()
    }

    /// The truth with its free coefficients changed by these factors.
    fn start(&self, factors: [f64; 3]) -> Start {
        let mut start = Start::of(&self.feedforward, &self.feedback);
        let scale = |p: &mut [f64], factor: f64| p.iter_mut().for_each(|c| *c *= factor);
        scale(&mut start.feedforward_denominator[1..], factors[0]);
        scale(&mut start.feedback_numerator, factors[1]);
        scale(&mut start.feedback_denominator[1..], factors[2]);
        start
    }

    fn setup<'a>(&'a self, problem: &'a Problem, margin_per_s: f64) -> Setup<'a> {
        Setup { problem, plant: &self.plant, structure: self.structure, margin_per_s }
    }
}

fn close(a: &System, b: &System, tolerance: f64) -> bool {
    let near = |a: &Polynomial, b: &Polynomial| {
        a.degree() == b.degree()
            && a.coefficients().iter().zip(b.coefficients()).all(|(a, b)| (a - b).abs() < tolerance * (1.0 + b.abs()))
    };
    near(a.num(), b.num()) && near(a.den(), b.den())
}

#[test]
fn the_truth_is_recovered_without_noise() {
    for (world, factors) in [(first_order(), [1.3, 0.8, 0.9]), (fir(), [1.0, 1.2, 0.97])] {
        let problem = world.problem(0.0, 1);
        let refinement = Refinement::new(world.setup(&problem, 0.0), &world.start(factors), &Ctl::new()).unwrap();
        let refined = refinement.refined().unwrap();
        assert!(refined.stop.is_converged(), "{refined:?}");
        assert!(refined.start_cost > 1e-6 && refined.cost < 1e-26, "{refined:?}");
        assert!(close(&refined.feedforward, &world.feedforward, 1e-7), "{refined:?}");
        assert!(close(&refined.feedback, &world.feedback, 1e-7), "{refined:?}");
        assert!(refined.active.is_empty());
    }
}

#[test]
fn with_noise_the_optimum_is_stationary_and_written_coefficients_have_its_cost() {
    for (world, factors) in [(first_order(), [1.1, 0.9, 1.1]), (fir(), [1.0, 1.1, 0.98])] {
        let problem = world.problem(0.01, 2);
        let refinement = Refinement::new(world.setup(&problem, 0.0), &world.start(factors), &Ctl::new()).unwrap();
        let refined = refinement.refined().unwrap();
        assert_eq!(refined.stop, Stop::Converged, "{refined:?}");
        assert!(refined.gradient_cosine < 1e-7 && refined.cost < refined.start_cost);
        assert!((refined.cost_of_coefficients / refined.cost - 1.0).abs() < 1e-8, "{refined:?}");
        // From another start the same optimum.
        let other = Refinement::new(world.setup(&problem, 0.0), &world.start([1.0; 3]), &Ctl::new()).unwrap();
        assert!((other.refined().unwrap().cost / refined.cost - 1.0).abs() < 1e-9);
    }
}

/// A margin that the true loop or feedforward does not keep: the optimum lies on it, and says so.
#[test]
fn an_optimum_on_the_margin_is_named() {
    // The loop's poles are a pair with real part −4.55; the feedforward's pole is at −6.5, or at −1.
    let slow = World { feedforward: continuous(&[2.1, 3.0], &[1.0, 1.0]), ..first_order() };
    for (world, margin, factors, active) in [
        (slow, 2.0, [3.0, 1.0, 1.0], ActiveConstraint::FeedforwardMargin),
        (first_order(), 5.0, [1.0, 1.0, 1.3], ActiveConstraint::LoopMargin),
    ] {
        let problem = world.problem(0.01, 3);
        let free = Refinement::new(world.setup(&problem, 0.0), &world.start([1.0; 3]), &Ctl::new()).unwrap();
        let free = free.refined().unwrap();
        let refinement = Refinement::new(world.setup(&problem, margin), &world.start(factors), &Ctl::new()).unwrap();
        let refined = refinement.refined().unwrap();
        assert_eq!((refined.stop, refined.active.as_slice()), (Stop::Converged, &[active][..]), "{refined:?}");
        assert!(refined.cost > free.cost && refined.cost < refined.start_cost);
        let slowest = refined.slowest_exponent.unwrap();
        assert!(slowest <= -margin && slowest > -margin - 1e-5, "{slowest}");
    }
}

#[test]
fn no_feedback_to_start_from_finds_the_feedback() {
    let world = first_order();
    let problem = world.problem(0.0, 4);
    let start = world.start([1.0, 0.0, 1.0]);
    let refined = Refinement::new(world.setup(&problem, 0.0), &start, &Ctl::new()).unwrap().refined().unwrap();
    assert!(refined.cost < 1e-20, "{refined:?}");
}

#[test]
fn a_start_outside_the_margin_is_refused() {
    let world = first_order();
    let problem = world.problem(0.0, 5);
    let error = Refinement::new(world.setup(&problem, 7.0), &world.start([1.0; 3]), &Ctl::new()).err().unwrap();
    assert_eq!(error, RefineError::OnTheEdge("feedforward"));
    let mut start = world.start([1.0; 3]);
    start.feedback_denominator = vec![1.0, 2.0, 3.0];
    let error = Refinement::new(world.setup(&problem, 0.0), &start, &Ctl::new()).err().unwrap();
    assert_eq!(error, RefineError::Degree("feedback denominator"));
}

/// The first-order loop with delays in both controllers.
fn delayed(world: &World, delays: [f64; 2]) -> Problem {
    let h: Vec<Complex64> = world
        .omega
        .iter()
        .map(|w| {
            let (g, ff, fb) = (world.plant.response(*w), world.feedforward.response(*w), world.feedback.response(*w));
            let turned = |delay: f64| Complex64::from_polar(1.0, -delay * w);
            g * (ff * turned(delays[1]) + fb * turned(delays[0])) / (1.0 + g * fb * turned(delays[0]))
        })
        .collect();
    Problem::new(&Lines::new(&world.plant, &world.omega, &h, None), world.structure.feedforward_numerator).unwrap()
}

#[test]
fn delays_are_recovered_from_a_start_without_them() {
    let world = first_order();
    for truth in [[0.12, 0.0], [0.15, 0.08]] {
        let problem = delayed(&world, truth);
        let delays = Delays {
            feedback: Delay::Range([0.0, 0.4]),
            feedforward: if truth[1] > 0.0 { Delay::Range([0.0, 0.3]) } else { Delay::Grid(vec![0.0]) },
        };
        let setup = world.setup(&problem, 0.1);
        let (refinement, scan) =
            refine_with_delays(setup, &world.start([1.2, 0.9, 1.1]), &delays, &Ctl::new()).unwrap();
        let refined = refinement.refined().unwrap();
        assert!(refined.stop.is_converged() && refined.cost < 1e-16, "{refined:?} {scan:?}");
        assert!((refined.feedback_delay_s - truth[0]).abs() < 1e-6, "{refined:?}");
        assert!((refined.feedforward_delay_s - truth[1]).abs() < 1e-6, "{refined:?}");
        assert!(close(&refined.feedback, &world.feedback, 1e-4), "{refined:?}");
        assert!(refined.cost_of_coefficients < 1e-16 && refined.slowest_exponent.unwrap() < -0.1);
        assert_eq!(scan.len(), if truth[1] > 0.0 { 81 } else { 9 });
        // The band of a delay holds it.
        let noise =
            Noise { variance: vec![1e-6; world.omega.len()], degrees_of_freedom: f64::INFINITY, are_independent: true };
        let uncertainty = refinement.uncertainty(&noise).unwrap();
        let delay = uncertainty.parameters.iter().find(|p| p.name == "feedback_delay_s").unwrap();
        let [low, high] = delay.interval.unwrap_or_else(|| panic!("{uncertainty:?}"));
        assert!(low < truth[0] && truth[0] < high, "{delay:?}");
    }
}

#[test]
fn sampled_delays_are_whole_samples_and_their_poles_are_listed() {
    let world = World { plant: sampled(&[0.02, 0.018], &[1.0, -1.5, 0.56]), ..fir() };
    let problem = delayed(&world, [0.2, 0.1]);
    let delays =
        Delays { feedback: Delay::Grid(vec![0.0, 0.1, 0.2, 0.3]), feedforward: Delay::Grid(vec![0.0, 0.1, 0.2]) };
    let setup = world.setup(&problem, 0.0);
    let (refinement, scan) = refine_with_delays(setup, &world.start([1.0, 0.7, 1.0]), &delays, &Ctl::new()).unwrap();
    let refined = refinement.refined().unwrap();
    assert!(refined.cost < 1e-20, "{refined:?} {scan:?}");
    assert_eq!([refined.feedback_delay_s, refined.feedforward_delay_s], [0.2, 0.1]);
    // Two of the feedforward, two of the plant, two of the feedback, two of the delay.
    assert_eq!(refined.closed_loop_poles.len(), 8);
    assert!(refined.slowest_exponent.unwrap() < 0.0);
}

/// A loop that is stable without its delay and not with it is no answer.
#[test]
fn stability_is_judged_with_the_delay() {
    let world = first_order();
    // With a delay of 1.2 s the true loop is unstable; its response is fitted as well as a stable loop can.
    let problem = delayed(&world, [1.2, 0.0]);
    let refinement = refine_with_delays(
        world.setup(&problem, 0.05),
        &world.start([1.0; 3]),
        &Delays { feedback: Delay::Grid(vec![1.2]), feedforward: Delay::Grid(vec![0.0]) },
        &Ctl::new(),
    );
    let (plant, fb) = (&world.plant, &world.feedback);
    let stable = |fb: &System| {
        let (d, n) = (plant.den().mul(fb.den()), plant.num().mul(fb.num()));
        crate::control::delay::is_stable_continuous(d.coefficients(), n.coefficients(), 1.2, 0.0).unwrap()
    };
    assert!(!stable(fb));
    let refined = refinement.unwrap().0.refined().unwrap();
    assert!(stable(&refined.feedback) && refined.slowest_exponent.unwrap() <= -0.05, "{refined:?}");
}
