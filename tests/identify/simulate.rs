//! Simulated loops against closed forms, the other simulators, and what identification makes of their signals.

use num_complex::Complex64;
use rand::RngExt;
use serde_json::{Value, json};
use volition::analysis::{Failure, Library, Plan, Problem, Report, Request};
use volition::control::{Continuous, Discrete, System, TransferFunction};
use volition::ctl::Ctl;
use volition::num::rng;
use volition::person::TwoDegreesOfFreedom;
use volition::plants::catalogue;
use volition::simulate::closed_loop::{ClosedLoop, Delays, Drive, Simulated, Simulator, Unstable, coloured};
use volition::simulate::reference_signals::chirp60;
use volition::two_stimulus::simulate::simulate as by_frequency;

const STEP: f64 = 0.02;

fn continuous(num: &[f64], den: &[f64]) -> System {
    System::Continuous(TransferFunction::new(num, den, Continuous).unwrap())
}

fn sampled(num: &[f64], den: &[f64]) -> System {
    System::Discrete(TransferFunction::new(num, den, Discrete::new(STEP).unwrap()).unwrap())
}

fn simulate(closed: &ClosedLoop, drive: &Drive) -> Simulated {
    let time = Discrete::new(STEP).unwrap();
    let samples = drive.command.len();
    let mut simulator = Simulator::new(closed, time, samples).unwrap();
    let (found, error) = simulator.refine(drive, &Ctl::new()).unwrap();
    assert!(error.is_within_tolerance, "{error:?}");
    found
}

fn farthest(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).fold(0.0, |largest, (a, b)| largest.max((a - b).abs()))
}

/// `y' = k (1 − y)`: a step, and the way back from an initial value.
#[test]
fn a_first_order_loop_has_its_closed_form() {
    for k in [0.3, 2.0, 40.0] {
        let none = continuous(&[0.0], &[1.0]);
        let closed =
            ClosedLoop::new(continuous(&[1.0], &[1.0, 0.0]), none, continuous(&[k], &[1.0]), Delays::default())
                .unwrap();
        let ones = vec![1.0; 500];
        let step = simulate(&closed, &Drive { command: &ones, ..Drive::default() });
        let zeros = vec![0.0; 500];
        let free = simulate(&closed, &Drive { command: &zeros, initial: &[-1.5], ..Drive::default() });
        let decay: Vec<f64> = (0..500).map(|i| (-k * STEP * f64::from(i)).exp()).collect();
        let risen: Vec<f64> = decay.iter().map(|d| 1.0 - d).collect();
        assert!(farthest(&step.output, &risen) < 1e-12);
        assert!(farthest(step.control.as_ref().unwrap(), &decay.iter().map(|d| k * d).collect::<Vec<_>>()) < 1e-11);
        assert!(farthest(&free.output, &decay.iter().map(|d| -1.5 * d).collect::<Vec<_>>()) < 1e-12);
        assert!((closed.slowest_pole().unwrap().unwrap().rate_per_s + k).abs() < 1e-9 * k);
    }
}

/// `y'(t) = k (1 − y(t − τ))`, `y = Σⱼ (−1)^{j−1} kʲ (t − jτ)ʲ/j!` over the j with jτ < t: the method of steps.
#[test]
fn an_integrator_with_a_delay_has_its_closed_form() {
    // A delay of whole samples, of whole steps within a sample, and of neither.
    for tau in [0.2, 0.13, 0.1 * std::f64::consts::SQRT_2] {
        for (plant_s, feedback_s) in [(0.0, tau), (tau, 0.0), (0.25 * tau, 0.75 * tau)] {
            let k = 2.5;
            let none = continuous(&[0.0], &[1.0]);
            let delays = Delays { plant_s, feedback_s, ..Delays::default() };
            let closed =
                ClosedLoop::new(continuous(&[1.0], &[1.0, 0.0]), none, continuous(&[k], &[1.0]), delays).unwrap();
            let ones = vec![1.0; 200];
            let time = Discrete::new(STEP).unwrap();
            let mut simulator = Simulator::new(&closed, time, 200).unwrap();
            let drive = Drive { command: &ones, ..Drive::default() };
            let (found, error) = simulator.refine(&drive, &Ctl::new()).unwrap();
            let exact = |t: f64| {
                let (mut sum, mut j, mut factorial) = (0.0, 1_i32, 1.0);
                while f64::from(j) * tau < t {
                    factorial *= f64::from(j);
                    sum -= (-k * (t - f64::from(j) * tau)).powi(j) / factorial;
                    j += 1;
                }
                sum
            };
            let wanted: Vec<f64> = (0..200).map(|i| exact(STEP * f64::from(i))).collect();
            let off = farthest(&found.output, &wanted);
            // The step itself is a jump, which a delay of no whole steps smears over one of them.
            let is_whole = tau < 0.14;
            let allowed = if is_whole { 2e-5 } else { 4e-3 };
            assert!(off < allowed, "{tau} {plant_s}: {off} {error:?}");
            assert!(!is_whole || off <= 2.0 * error.output + 1e-12, "{tau} {plant_s}: {off} {error:?}");
            // The control is the gain times the error that was seen, a delay of the feedback ago.
            let u = found.control.unwrap();
            for i in 20..200 {
                let t = STEP * f64::from(i) - feedback_s;
                let wanted = k * (1.0 - exact(t));
                assert!(
                    (u[i as usize] - wanted).abs() < 5.0 * allowed,
                    "{tau} {plant_s} {i}: {} {wanted}",
                    u[i as usize]
                );
            }
        }
    }
}

/// The pole that a delayed loop is refused by solves its characteristic equation, and lies to the right of all others.
#[test]
fn unstable_loops_are_named_by_their_pole() {
    let k = 9.0;
    let delays = Delays { feedback_s: 0.2, ..Delays::default() };
    let none = continuous(&[0.0], &[1.0]);
    let closed =
        ClosedLoop::new(continuous(&[1.0], &[1.0, 0.0]), none.clone(), continuous(&[k], &[1.0]), delays).unwrap();
    let Err(Unstable::Pole { part: None, pole }) = closed.slowest_pole() else { panic!("it is unstable") };
    let s = Complex64::new(pole.rate_per_s, pole.frequency_rad_s.unwrap());
    assert!((s + k * (-s * 0.2).exp()).norm() < 1e-6 && s.re > 0.4, "{s}");
    // Just below the limit kτ = π/2 it is stable, with a pole near j k.
    let k = std::f64::consts::FRAC_PI_2 / 0.2 * 0.999;
    let closed = ClosedLoop::new(continuous(&[1.0], &[1.0, 0.0]), none, continuous(&[k], &[1.0]), delays).unwrap();
    let pole = closed.slowest_pole().unwrap().unwrap();
    assert!(pole.rate_per_s < 0.0 && pole.rate_per_s > -0.02, "{pole:?}");
    assert!((pole.frequency_rad_s.unwrap() - k).abs() < 0.05, "{pole:?}");
    // Sampled loops have their pole in the plane of z too.
    let closed = ClosedLoop::new(
        sampled(&[STEP], &[1.0, -1.0]),
        sampled(&[0.0], &[1.0]),
        sampled(&[110.0], &[1.0]),
        Delays::default(),
    );
    let Err(Unstable::Pole { pole, .. }) = closed.unwrap().slowest_pole() else { panic!("it is unstable") };
    assert!((pole.z.unwrap() - Complex64::from(-1.2)).norm() < 1e-9, "{pole:?}");
}

/// Random stable loops: the simulators of Zhang's equations (5.8) in continuous and in sampled time.
#[test]
fn without_delay_it_agrees_with_the_other_simulators() {
    let mut random = rng::stream(4, "loops");
    let time = Discrete::new(STEP).unwrap();
    let mut compared = [0; 2];
    for case in 0..60 {
        let mut uniform = |low: f64, high: f64| low + (high - low) * random.random::<f64>();
        let r: Vec<f64> = (0..300).map(|_| uniform(-1.0, 1.0)).collect();
        let d: Vec<f64> = (0..300).map(|_| uniform(-1.0, 1.0)).collect();
        let n: Vec<f64> = (0..300).map(|_| uniform(-0.3, 0.3)).collect();
        if case % 2 == 0 {
            // Half of the feedforwards have two zeros and one pole.
            let zeros = if case % 4 == 0 { vec![uniform(0.0, 2.0), uniform(0.0, 2.0)] } else { vec![] };
            let num = [zeros.as_slice(), &[uniform(-2.0, 2.0)]].concat();
            let parts = [
                TransferFunction::new(
                    &[uniform(-1.0, 2.0), 1.0],
                    &[1.0, uniform(0.0, 3.0), uniform(0.0, 4.0)],
                    Continuous,
                ),
                TransferFunction::new(&num, &[1.0, uniform(0.5, 3.0)], Continuous),
                TransferFunction::new(&[uniform(0.0, 3.0), uniform(0.0, 3.0)], &[uniform(0.05, 1.0), 1.0], Continuous),
            ];
            let [plant, forward, back] = parts.map(Result::unwrap);
            let two = TwoDegreesOfFreedom::new(plant.clone(), forward.clone(), back.clone()).unwrap();
            let closed = ClosedLoop::new(plant.into(), forward.into(), back.into(), Delays::default()).unwrap();
            assert_eq!(closed.slowest_pole().is_ok(), two.is_stable(0.0), "{closed:?}");
            if closed.slowest_pole().is_err() {
                continue;
            }
            compared[0] += 1;
            let ours = simulate(&closed, &Drive { command: &r, disturbance: &d, ..Drive::default() });
            let theirs = two.simulate(&r, Some(&d), STEP).unwrap();
            assert!(farthest(&ours.output, &theirs.output) < 1e-9, "{closed:?}");
            assert_eq!(ours.control.is_some(), case % 4 != 0);
            match (&ours.control, &theirs.control) {
                (Some(a), Some(b)) => assert!(farthest(a, b) < 1e-8, "{closed:?}"),
                (a, b) => assert_eq!(a.is_some(), b.is_some(), "{closed:?}"),
            }
        } else {
            let parts = [
                TransferFunction::new(&[uniform(0.0, 0.2), uniform(0.0, 0.2)], &[1.0, -uniform(0.7, 1.0)], time),
                TransferFunction::new(&[uniform(-1.0, 1.0), uniform(-1.0, 1.0)], &[1.0, uniform(-0.9, 0.9)], time),
                TransferFunction::new(&[uniform(0.0, 2.0)], &[1.0, uniform(-0.9, 0.9), 0.0, 0.0], time),
            ];
            let [plant, forward, back] = parts.map(Result::unwrap);
            let two = TwoDegreesOfFreedom::new(plant.clone(), forward.clone(), back.clone()).unwrap();
            let closed =
                ClosedLoop::new(plant.clone().into(), forward.into(), back.clone().into(), Delays::default()).unwrap();
            if closed.slowest_pole().is_err() {
                continue;
            }
            compared[1] += 1;
            let ours = simulate(&closed, &Drive { command: &r, disturbance: &d, ..Drive::default() });
            let theirs = two.simulate(&r, Some(&d)).unwrap();
            assert!(farthest(&ours.output, &theirs.output) < 1e-12);
            assert!(farthest(&ours.control.unwrap(), &theirs.control.unwrap()) < 1e-12);
            // An error of perception is a command, turned round, of the feedback alone.
            let none = TransferFunction::new(&[0.0], &[1.0], time).unwrap();
            let alone = TwoDegreesOfFreedom::new(plant, none, back).unwrap();
            let zeros = vec![0.0; 300];
            let ours = simulate(&closed, &Drive { command: &zeros, perception: &n, ..Drive::default() });
            let minus: Vec<f64> = n.iter().map(|n| -n).collect();
            assert!(farthest(&ours.output, &alone.simulate(&minus, None).unwrap().output) < 1e-12);
        }
    }
    assert!(compared[0] > 15 && compared[1] > 15, "{compared:?}");
}

/// Delays in all places and a preview, against the loop's frequency responses, for a command that is over before the
/// end.
#[test]
fn with_delays_it_agrees_with_the_frequency_responses() {
    let time = Discrete::new(STEP).unwrap();
    let bell = |k: usize, from: f64, omega: f64| {
        let t = (k as f64 * STEP - from) / 3.0;
        if (0.0..1.0).contains(&t) {
            (std::f64::consts::PI * t).sin().powi(4) * (omega * k as f64 * STEP).sin()
        } else {
            0.0
        }
    };
    let r: Vec<f64> = (0..1000).map(|k| bell(k, 2.0, 5.0)).collect();
    let d: Vec<f64> = (0..1000).map(|k| bell(k, 4.0, 3.0)).collect();
    for delays in [
        Delays { plant_s: 0.04, feedforward_s: 0.1, feedback_s: 0.16, preview_s: 0.0 },
        Delays { plant_s: 0.0, feedforward_s: 0.05, feedback_s: 0.173, preview_s: 0.3 },
        Delays { plant_s: 0.033, feedforward_s: 0.0, feedback_s: 0.0, preview_s: 0.011 },
    ] {
        let closed = ClosedLoop::new(
            continuous(&[2.0, 4.4], &[1.0, 3.6, 4.0]),
            continuous(&[25.0, 90.0, 100.0], &[1.0, 52.2, 110.0]),
            continuous(&[0.9], &[0.1, 1.0]),
            delays,
        )
        .unwrap();
        assert!(closed.slowest_pole().unwrap().unwrap().rate_per_s < 0.0);
        let mut simulator = Simulator::new(&closed, time, 1000).unwrap();
        let drive = Drive { command: &r, disturbance: &d, ..Drive::default() };
        let (ours, _) = simulator.refine(&drive, &Ctl::new()).unwrap();
        let responses = |omega: f64| {
            let h = closed.responses(omega);
            let sensitivity = 1.0 / (1.0 + h.loop_gain);
            let h_ur = (h.feedforward + h.feedback) * sensitivity;
            [h_ur, h.command_to_output, -h.loop_gain * sensitivity, h.plant * sensitivity]
        };
        let theirs = by_frequency(responses, &r, Some(&d), STEP, std::f64::consts::PI / STEP).unwrap();
        let samples = ours.output.len();
        // Samples of a smooth signal that goes straight between them miss it by a share of (ω T)²/12 on average, which
        // the feedforward passes on with its gain at high frequency, 25.
        let missed = (5.0 * STEP).powi(2) / 12.0;
        let (y, u) = (farthest(&ours.output, &theirs.output[..samples]), ours.control.unwrap());
        let u = farthest(&u, &theirs.control[..samples]);
        assert!(y < 3.0 * missed && u < 1.5 * 25.0 * missed, "{delays:?}: y {y}, u {u}");
    }
}

fn request(inputs: Value, spec: Value) -> Request {
    Request { kind: "simulate".to_owned(), inputs, spec }
}

fn report(inputs: Value, spec: Value) -> Report {
    Plan::parse(&request(inputs, spec)).unwrap().run(&Library::default(), &Ctl::new()).unwrap()
}

fn refused(inputs: Value) -> Problem {
    match Plan::parse(&request(inputs, json!({}))).map(|plan| plan.run(&Library::default(), &Ctl::new())) {
        Ok(Err(Failure::Problem(problem))) | Err(problem) => problem,
        other => panic!("{other:?}"),
    }
}

fn mean_abs_error(inputs: Value) -> f64 {
    report(inputs, json!({"every": 100})).result["metrics"]["mean_abs_error"].as_f64().unwrap()
}

/// The strategies of Zhang 2015, figures 3.4 and 5.10 to 5.12, with the errors in the order that section 5.5 states.
#[test]
fn strategies_of_the_thesis() {
    let chirp = |section: &str| {
        let preset = format!("zhang2015_section_{section}");
        json!({"generator": {"kind": "chirp", "preset": preset}, "sample_time_s": STEP})
    };
    let five = |plant: &str, name: &str, controller: Value| {
        let mut inputs = json!({"plant": plant, "command": chirp("5_2")});
        inputs[name] = controller;
        inputs
    };
    let three = |name: &str, controller: Value| {
        let mut inputs = json!({"plant": "two_mass", "command": chirp("3_2")});
        inputs[name] = controller;
        inputs
    };
    // Figure 3.4: high gain, and 900 G⁻¹/(s + 30)² of the two masses.
    let g = catalogue::two_mass();
    let den = g.num().mul(&volition::num::Polynomial::new(vec![1.0, 60.0, 900.0]));
    let inverse = json!({"num": g.den().scale(900.0).coefficients(), "den": den.coefficients()});
    let alone = mean_abs_error(json!({"plant": "two_mass", "command": chirp("3_2")}));
    for small in [three("feedback", json!({"num": [30], "den": [1]})), three("feedforward", inverse)] {
        assert!(mean_abs_error(small) < 0.25 * alone);
    }
    // Figure 5.10, on the minimum-phase plant: Gfb = 30, and 50 G⁻¹/(s + 50). Figure 5.11, on the nonminimum-phase
    // plant: a gain, and a feedforward of second order. Figure 5.12: controllers of fourth order. Beside each the mean
    // |e| of the command's Fourier transform times (1 − Gff G)/(1 + Gfb G), computed apart from this program.
    let times = |factors: &[&[f64]], gain: f64| {
        let one = volition::num::Polynomial::new(vec![gain]);
        let product = factors.iter().fold(one, |p, f| p.mul(&volition::num::Polynomial::new(f.to_vec())));
        product.coefficients().to_vec()
    };
    let gain = |plant: &str, k: f64| five(plant, "feedback", json!({"num": [k], "den": [1]}));
    let fourth_feedback = json!({
        "num": times(&[&[1.0, 2.03], &[1.0, 4.47, 15.42]], 1.99e8),
        "den": times(&[&[1.0, 0.73, 5.2], &[1.0, 607.1, 2.98e8]], 1.0),
    });
    let fourth_feedforward = json!({
        "num": times(&[&[1.0, 2.91, 2.88], &[1.0, 3.37, 13.21]], 4.69e4),
        "den": times(&[&[1.0, 40.0], &[1.0, 40.0], &[1.0, 40.0], &[1.0, 40.0]], 1.0),
    });
    let second = json!({"num": [742.8, 1025.9, 1597.4], "den": [1, 2, 2500]});
    let inverse = json!({"num": [25, 90, 100], "den": [1, 52.2, 110]});
    let errors: Vec<f64> = [
        (gain("minimum_phase", 30.0), 0.046_422_54),
        (five("minimum_phase", "feedforward", inverse), 0.039_924_94),
        (gain("nonminimum_phase", -0.0535), 1.218_162_3),
        (five("nonminimum_phase", "feedforward", second), 0.514_963_56),
        (json!({"plant": "nonminimum_phase", "command": chirp("5_2")}), 1.223_751_7),
    ]
    .into_iter()
    .map(|(inputs, expected)| {
        let found = mean_abs_error(inputs.clone());
        assert!((found / expected - 1.0).abs() < 2e-3, "{inputs}: {found} {expected}");
        found
    })
    .collect();
    // The feedforward of fourth order has a gain of 47,000 far above the band: 0.02 s between samples are too many for
    // it, which is said. What section 5.5 says of the others: the same sort of control does worse on the
    // nonminimum-phase plant, and better with controllers of higher order.
    let mut fast = five("nonminimum_phase", "feedforward", fourth_feedforward);
    let coarse = report(fast.clone(), json!({"every": 100}));
    assert!(coarse.warnings.iter().any(|w| w.code == "kinks_between_samples"), "{:?}", coarse.warnings);
    fast["command"]["sample_time_s"] = json!(0.002);
    let fine = report(fast, json!({"every": 100}));
    assert!(fine.warnings.is_empty(), "{:?}", fine.warnings);
    let of = |report: &Report| report.result["metrics"]["mean_abs_error"].as_f64().unwrap();
    assert!((of(&fine) / 0.248_711_78 - 1.0).abs() < 1e-4, "{}", of(&fine));
    let [high_gain, inverse, low_gain, second] = errors[..4] else { panic!("five errors") };
    assert!(low_gain > high_gain && second > of(&fine) && of(&fine) > inverse);
    // The feedback of fourth order, with the digits that are printed, loses the plant: s⁴ of its loop has the
    // coefficient 2.98e8 − 2 · 1.99e8 < 0.
    let problem = refused(five("nonminimum_phase", "feedback", fourth_feedback));
    assert!(problem.detail.contains("is unstable: it has a pole at s = 9700.99"), "{problem}");
    // A gain as high as on the other plant loses this one, and is refused by the pole on the right.
    let problem = refused(gain("nonminimum_phase", 30.0));
    assert_eq!(problem.location.as_deref(), Some("/inputs/feedback"));
    assert!(problem.detail.contains("is unstable: it has a pole at s = 5"), "{problem}");
}

/// Simulated with a remnant, and identified from the signals: the intervals hold the simulated controllers.
#[test]
fn the_direct_method_finds_the_simulated_controllers() {
    let truth = json!({
        "plant": "minimum_phase",
        "feedforward": {"num": [0.6], "den": [0.15, 1]},
        "feedback": {"num": [0.8], "den": [1], "delay_s": 0.2},
        "command": {"generator": {"kind": "chirp", "preset": "zhang2015_section_5_2"}, "sample_time_s": STEP},
        "noise": {"remnant": {"sd": 0.15}},
    });
    let simulated = report(truth, json!({"realisations": 1, "norm_band_hz": [0.05, 0.5], "seed": 11})).result;
    let signals = &simulated["signals"];
    let trial = json!({"sample_time_s": STEP, "r": signals["r"], "u": signals["u"], "y": signals["y"]});
    let plant = json!({"num": [2, 4.4], "den": [1, 3.6, 4]});
    let request = Request {
        kind: "prediction_error".to_owned(),
        inputs: json!({"trial": trial, "plant": plant}),
        spec: json!({"band_hz": [0.05, 0.5]}),
    };
    let found = Plan::parse(&request).unwrap().run(&Library::default(), &Ctl::new()).unwrap().result;
    for name in ["norm_feedback", "norm_feedforward_plant_minus_one"] {
        let truth = simulated["norms"][name].as_f64().unwrap();
        let norm = &found["trials"][0]["metrics"][name];
        let [low, high] = [0, 1].map(|i| norm["nominal_interval"][i].as_f64().unwrap());
        assert!(low <= truth && truth <= high, "{name}: {truth} outside of {norm}");
    }
}

/// Simulated in sampled time without noise, and searched for in a pool that holds the controllers: they are found.
#[test]
fn the_pool_finds_the_simulated_controllers() {
    let time = Discrete::new(STEP).unwrap();
    let plant = volition::control::discretise::zero_order_hold(&catalogue::minimum_phase(), time).unwrap();
    let closed = ClosedLoop::new(
        plant.into(),
        sampled(&[0.9, -0.2], &[1.0, -0.3]),
        sampled(&[0.5], &[1.0, -0.6]),
        Delays::default(),
    )
    .unwrap();
    let command = chirp60(STEP);
    let found = simulate(&closed, &Drive { command: &command, ..Drive::default() });
    let request = Request {
        kind: "ssid".to_owned(),
        inputs: json!({
            "trial": {"sample_time_s": STEP, "r": command, "u": found.control, "y": found.output},
            "plant": {"num": [2, 4.4], "den": [1, 3.6, 4]},
        }),
        spec: json!({
            "pool": {"time": "sampled", "grid": {
                "feedforward_denominator": {"listed": [[-0.3], [-0.7]]},
                "feedback_numerator": {"listed": [[0.3], [0.5], [0.8]]},
                "feedback_denominator": {"listed": [[-0.8], [-0.6]]}}},
            "feedforward_numerator_degree": 1,
        }),
    };
    let report = Plan::parse(&request).and_then(|plan| match plan.run(&Library::default(), &Ctl::new()) {
        Ok(report) => Ok(report),
        Err(Failure::Problem(problem)) => Err(problem),
        Err(other) => panic!("{other}"),
    });
    let result = report.unwrap().result;
    assert_eq!(result["feedback"]["den"], json!([1.0, -0.6]));
    let num: Vec<f64> = serde_json::from_value(result["feedforward"]["num"].clone()).unwrap();
    assert!((num[0] - 0.9).abs() < 0.02 && (num[1] + 0.2).abs() < 0.02, "{num:?}");
}

/// White remnant on an integrator with a gain is AR(1) in its output: `y[k+1] = (1 − kT) y[k] + T w[k]`.
#[test]
fn noise_in_the_loop_has_the_variance_that_the_loop_gives_it() {
    let k = 5.0;
    let closed = ClosedLoop::new(
        sampled(&[STEP], &[1.0, -1.0]),
        sampled(&[0.0], &[1.0]),
        sampled(&[k], &[1.0]),
        Delays::default(),
    )
    .unwrap();
    let w = coloured(9, "remnant", 200_000, 1.0, 0.0, STEP);
    let zeros = vec![0.0; 200_000];
    let found = simulate(&closed, &Drive { command: &zeros, remnant: &w, ..Drive::default() });
    let variance = found.output.iter().map(|y| y * y).sum::<f64>() / 2e5;
    let a = 1.0 - k * STEP;
    let expected = STEP * STEP / (1.0 - a * a);
    // The variance of an AR(1) process is known to √(2 (1 + a²)/(1 − a²)/n).
    let error = expected * (2.0 * (1.0 + a * a) / (1.0 - a * a) / 2e5).sqrt();
    assert!((variance - expected).abs() < 4.0 * error, "{variance} {expected}");
}
