//! The kinds `excitation_quality` and `compensator_design` as requests and reports.

use crate::contract::contract;
use crate::support::{DRIVE, SIGNAL, close, design, made, run};
use serde_json::{Value, json};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use volition::analysis::{Failure, Library, Plan, Request};
use volition::control::{Discrete, System, TransferFunction};
use volition::ctl::{Ctl, StopReason, Stopped};
use volition::excite::compensator::{Compensator, DesignLimits};
use volition::excite::flatness::{Band, flatness};
use volition::excite::path::{Path, SampledPlant};
use volition::excite::spectrum::Spectrum;

#[test]
fn the_report_has_the_shape_that_scripts_rely_on() {
    let inputs =
        json!({"signal": SIGNAL(), "plant": DRIVE(), "controller": {"num": [9_051.916_234_351_42], "den": [1]}});
    let spec = json!({"band_hz": [5, 10, [1, 8]], "limits": {"force": 1e5, "position": 2.0}, "include_samples": true});
    let report = run("excitation_quality", inputs, spec).unwrap();
    assert_eq!(report.kind.name(), "excitation_quality");
    let result = &report.result;
    close(result["flatness"][0]["sfm"].as_f64().unwrap(), 0.389_552_157_552_938_1, 1e-12);
    close(result["flatness"][0]["blsfg"].as_f64().unwrap(), 2.001_525_756, 1e-7);
    assert_eq!(result["flatness"][0]["band_hz"], 5.0);
    assert_eq!(result["flatness"][2]["band_hz"], json!([1.0, 8.0]));
    assert_eq!(result["lines"]["rule"], "sequence");
    assert_eq!(result["lines"]["count"], 12_100);
    assert_eq!(result["persistent_excitation_order"], 24_200);
    close(result["path"]["disturbance_norm"].as_f64().unwrap(), 7.330_308e-4, 1e-5);
    assert_eq!(result["motion"]["within_limits"], false, "{}", result["motion"]);
    assert_eq!(result["samples"]["signal"].as_array().unwrap().len(), 48_400);
    let csv = volition::analysis::samples::csv(&report).unwrap();
    assert!(csv.starts_with("t,signal,force,output\r\n0.0,0.0,"), "{}", &csv[..60]);
    assert_eq!(csv.lines().count(), 48_401);
    // A person who reacts after a chip cannot predict what comes.
    let ahead = &result["predictability"][1];
    assert!(ahead["r_squared"].as_f64().unwrap() < 0.3, "{ahead}");
    assert!((result["autocorrelation"]["value"][1].as_f64().unwrap()).abs() < 1e-9);
    let codes: Vec<&str> = report.warnings.iter().map(|w| w.code.as_str()).collect();
    assert!(codes.contains(&"limits_broken"), "{codes:?}");
}

#[test]
fn what_the_device_did_is_judged_from_the_trial() {
    // Three periods of a loop's output with white noise on it.
    use rand_distr::{Distribution as _, StandardNormal};
    let sequence =
        made(json!({"generator": {"kind": "prts", "order": 4, "chip_s": 0.2}, "sample_time_s": 0.01, "periods": 5}));
    let time = Discrete::new(0.01).unwrap();
    let plant = SampledPlant::mass_damper(10.0, 50.0, time).unwrap();
    let path = Path::closed(plant, &System::from(TransferFunction::new(&[2500.0], &[1.0], time).unwrap())).unwrap();
    let carried = path.carry(&sequence.values, &Ctl::new()).unwrap();
    let mut random = volition::num::rng::stream(2, "device");
    let noise: Vec<f64> = (0..carried.output.len()).map(|_| StandardNormal.sample(&mut random)).collect();
    let y: Vec<f64> = carried.output.iter().zip(&noise).map(|(y, e)| y + 0.01 * e).collect();
    let trial = json!({"sample_time_s": 0.01, "r": sequence.values, "u": carried.effort, "y": y});
    let signal = json!({
        "trial": trial, "channel": "r", "to": "y", "start_s": 16,
        "generator": {"kind": "prts", "order": 4, "chip_s": 0.2}
    });
    let report = run("excitation_quality", json!({"signal": signal}), json!({"band_hz": [4]})).unwrap();
    let result = &report.result;
    assert_eq!((result["signal"]["periods"].as_u64(), result["lines"]["rule"].as_str()), (Some(4), Some("sequence")));
    let n = sequence.period.unwrap().samples.unwrap();
    let spectrum = Spectrum::new(&sequence.values[..n], n, 0.01, &Ctl::new()).unwrap();
    let inside = Band::UpTo(4.0).of(sequence.harmonics.as_ref().unwrap(), spectrum.spacing_hz()).unwrap().to_vec();
    let out = inside.iter().map(|n| spectrum.power[*n] * path.response(spectrum.omega_rad_s(*n)).norm_sqr());
    let expected = flatness(out) / flatness(inside.iter().map(|n| spectrum.power[*n]));
    close(result["flatness"][0]["blsfg"].as_f64().unwrap(), expected, 0.02);
    // Noise of standard deviation σ has the mean square 2σ²/N at a line.
    let output_snr = result["lines"]["output_snr_db"][0].as_f64().unwrap();
    let ratio = result["lines"]["output_power"][0].as_f64().unwrap() / (2.0 * 1e-4 / n as f64);
    assert!((output_snr - 10.0 * ratio.log10()).abs() < 6.0, "{output_snr} {ratio}");
    // Over all lines its mean is known to 1/√(3·lines): four times that.
    let column = |name: &str| -> Vec<f64> { serde_json::from_value(result["lines"][name].clone()).unwrap() };
    let (power, snr) = (column("output_power"), column("output_snr_db"));
    let noise = power.iter().zip(&snr).map(|(p, db)| p / 10.0_f64.powf(0.1 * db)).sum::<f64>() / power.len() as f64;
    assert!(power.len() >= 395, "{}", power.len());
    close(noise, 2.0 * 1e-4 / n as f64, 4.0 / (3.0 * power.len() as f64).sqrt());
    // The command has no noise: no ratio, rather than an infinite one; and the period is exact.
    assert!(result["lines"]["snr_db"].as_array().unwrap().iter().all(|db| db.as_f64().is_none_or(|db| db > 250.0)));
    assert_eq!((result["signal"]["period_s"].as_f64(), n), (Some(16.0), 1600));
    // Any column, by its own lines; noise does not count as excitation.
    let signal = json!({"trial": trial, "channel": "y", "start_s": 16, "period_s": 16});
    let own = run("excitation_quality", json!({"signal": signal}), json!({})).unwrap();
    let harmonics: Vec<usize> = serde_json::from_value(own.result["lines"]["harmonic"].clone()).unwrap();
    let odd = harmonics.iter().filter(|n| *n % 2 == 1).count();
    assert!(odd > 30 && harmonics.len() - odd <= 1, "{harmonics:?}");
    let missing = json!({"trial": trial, "channel": "d"});
    let problem = run("excitation_quality", json!({"signal": missing}), json!({})).unwrap_err();
    assert_eq!(problem.location.as_deref(), Some("/inputs/signal/channel"));
}

#[test]
fn impossible_requests_are_named() {
    let with = |generator: Value| json!({"signal": {"generator": generator, "sample_time_s": 0.01}});
    let prts = |extra: Value| {
        let mut generator = json!({"kind": "prts", "order": 3, "chip_s": 0.2});
        generator.as_object_mut().unwrap().extend(extra.as_object().unwrap().clone());
        with(generator)
    };
    let whole = |extra: Value| {
        let mut inputs = prts(json!({}));
        inputs["signal"].as_object_mut().unwrap().extend(extra.as_object().unwrap().clone());
        inputs
    };
    let (around, at) = ("/inputs/signal", "/inputs/signal/generator");
    let cases = [
        (prts(json!({"order": 0})), json!({}), format!("{at}/order"), "order is 0"),
        (prts(json!({"order": -1})), json!({}), format!("{at}/order"), "invalid value"),
        (prts(json!({"order": 13})), json!({}), format!("{at}/order"), "from 2 to 12"),
        (prts(json!({"chip_s": 0.001})), json!({}), format!("{at}/chip_s"), "shorter than the sample time"),
        (prts(json!({"chip_s": 0})), json!({}), format!("{at}/chip_s"), "positive"),
        (prts(json!({"polynomial": 99})), json!({}), format!("{at}/polynomial"), "there are 4"),
        (prts(json!({"polynomial": [1, 0, 0]})), json!({}), format!("{at}/polynomial"), "not primitive"),
        (prts(json!({"polynomial": [1, 0]})), json!({}), format!("{at}/polynomial"), "2 coefficients"),
        (prts(json!({"polynomial": [1, 3, 0]})), json!({}), format!("{at}/polynomial"), "0 to 2"),
        (prts(json!({"phase_chips": 26})), json!({}), format!("{at}/phase_chips"), "the sequence has 26"),
        (prts(json!({"phase": 2})), json!({}), format!("{at}/phase"), "unknown field"),
        (prts(json!({"hold": "cubic"})), json!({}), format!("{at}/hold"), "unknown variant"),
        (
            with(json!({"kind": "prbs", "order": 5, "chip_s": 0.1, "hold": "integrated"})),
            json!({}),
            format!("{at}/hold"),
            "drifts",
        ),
        (with(json!({"kind": "sweep"})), json!({}), format!("{at}/kind"), "no generator"),
        (with(json!({"order": 5})), json!({}), format!("{at}/kind"), "no kind"),
        (
            with(json!({"kind": "multisine", "base_hz": 0.1, "harmonics": [700]})),
            json!({}),
            format!("{at}/harmonics"),
            "Nyquist",
        ),
        (
            with(json!({"kind": "multisine", "base_hz": 0.1, "harmonics": [3, 2]})),
            json!({}),
            format!("{at}/harmonics"),
            "increase",
        ),
        (
            with(json!({"kind": "multisine", "base_hz": 0.1, "harmonics": {"primes": [0.8, 1.0]}})),
            json!({}),
            format!("{at}/harmonics"),
            "no line",
        ),
        (
            with(json!({"kind": "multisine", "base_hz": 0.1, "harmonics": {"odd": [2, 1]}})),
            json!({}),
            format!("{at}/harmonics"),
            "empty",
        ),
        (
            with(json!({"kind": "chirp", "from_hz": 1, "to_hz": 60, "duration_s": 9})),
            json!({}),
            format!("{at}/to_hz"),
            "Nyquist",
        ),
        (
            with(json!({"kind": "filtered_noise", "edge_hz": 30, "transition_hz": 30, "duration_s": 9})),
            json!({}),
            format!("{at}/edge_hz"),
            "Nyquist",
        ),
        (
            with(json!({"kind": "filtered_noise", "edge_hz": 30, "transition_hz": 0.01, "duration_s": 9})),
            json!({}),
            format!("{at}/transition_hz"),
            "order",
        ),
        (
            with(json!({"kind": "multisine", "base_hz": 0.1, "harmonics": [2, 3], "interleave": {"part": 0, "of": 0}})),
            json!({}),
            format!("{at}/interleave/of"),
            "positive",
        ),
        (
            with(json!({"kind": "multisine", "base_hz": 0.1, "harmonics": [2, 3], "interleave": {"part": 2, "of": 2}})),
            json!({}),
            format!("{at}/interleave/part"),
            "from 0 to 1",
        ),
        (
            with(json!({"kind": "multisine", "base_hz": 0.1, "harmonics": [2, 3], "phases": {"rad": [0]}})),
            json!({}),
            format!("{at}/phases/rad"),
            "1 entries for 2 lines",
        ),
        (
            with(json!({"kind": "chirp", "preset": "zhang2015_section_5_2", "to_hz": 1})),
            json!({}),
            format!("{at}/to_hz"),
            "together with preset",
        ),
        (whole(json!({"scale": {"peak": -1}})), json!({}), format!("{around}/scale/peak"), "positive"),
        (whole(json!({"scale": {"rms": 0}})), json!({}), format!("{around}/scale/rms"), "positive"),
        (whole(json!({"clip": [1, -1]})), json!({}), format!("{around}/clip"), "empty"),
        (whole(json!({"taper": 0.6})), json!({}), format!("{around}/taper"), "0 to 0.5"),
        (whole(json!({"periods": 0})), json!({}), format!("{around}/periods"), "positive"),
        (whole(json!({"periods": 2, "duration_s": 9})), json!({}), format!("{around}/duration_s"), "together"),
        (prts(json!({})), json!({"band_hz": [60]}), "/spec/band_hz/0".to_owned(), "Nyquist"),
        (prts(json!({})), json!({"band_hz": [[3, 2]]}), "/spec/band_hz/0".to_owned(), "empty"),
        (prts(json!({})), json!({"band_hz": [0]}), "/spec/band_hz/0".to_owned(), "empty"),
        (prts(json!({})), json!({"band_hz": [0.1]}), "/spec/band_hz/0".to_owned(), "1 of the signal's lines"),
        (prts(json!({})), json!({"limits": {"force": -1}}), "/spec/limits/force".to_owned(), "positive"),
        (prts(json!({})), json!({"limits": {"speed": 1}}), "/spec/limits/speed".to_owned(), "unknown field"),
        (prts(json!({})), json!({"lines": {"harmonics": [1, 300]}}), "/spec/lines/harmonics/1".to_owned(), "Nyquist"),
        (json!({}), json!({}), "/inputs/signal".to_owned(), "no signal"),
        (json!({"signal": {"sample_time_s": 1}}), json!({}), "/inputs/signal".to_owned(), "no generator"),
        (
            json!({"signal": {"samples": [1, 2], "sample_time_s": 1}}),
            json!({}),
            "/inputs/signal/samples".to_owned(),
            "4 to",
        ),
        (
            json!({"signal": {"samples": [1, 2, 1, 3, 1, 2], "sample_time_s": 1, "period_s": 5.5}}),
            json!({}),
            "/inputs/signal/period_s".to_owned(),
            "no whole number",
        ),
        (
            json!({"signal": {"samples": [1, 1, 1, 1, 1, 1], "sample_time_s": 1}}),
            json!({}),
            "/inputs/signal".to_owned(),
            "0 of the signal's lines",
        ),
        (
            json!({"signal": {"generator": {"kind": "prts", "order": 3, "chip_s": 0.2}, "sample_time_s": 1e-9}}),
            json!({}),
            "/inputs/signal/sample_time_s".to_owned(),
            "samples",
        ),
        (
            json!({"signal": {"generator": {"kind": "prts", "order": 3, "chip_s": 0.2}, "sample_time_s": 0}}),
            json!({}),
            "/inputs/signal/sample_time_s".to_owned(),
            "positive",
        ),
    ];
    for (inputs, spec, location, words) in cases {
        let problem = run("excitation_quality", inputs.clone(), spec.clone()).unwrap_err();
        assert_eq!(problem.location.as_deref(), Some(location.as_str()), "{inputs} {spec}: {problem}");
        assert!(problem.detail.contains(words), "{inputs} {spec}: {problem}");
    }
    let mut unstable = prts(json!({}));
    unstable["plant"] = DRIVE();
    let problem = run("excitation_quality", unstable.clone(), json!({})).unwrap_err();
    assert_eq!((problem.location.as_deref(), problem.title.as_str()), (Some("/inputs/plant"), "unstable plant"));
    unstable["controller"] = json!({"num": [1e7], "den": [1]});
    let problem = run("excitation_quality", unstable, json!({})).unwrap_err();
    assert_eq!(problem.location.as_deref(), Some("/inputs/controller"));
    let inputs = json!({"plant": DRIVE(), "signal": SIGNAL()});
    for (spec, location) in [
        (json!({"band_hz": 5}), "/spec/structure"),
        (json!({"structure": "lead"}), "/spec/band_hz"),
        (json!({"structure": "lead", "band_hz": 600}), "/spec/band_hz"),
        (json!({"structure": "proportional", "band_hz": 5, "zero_hz": 1}), "/spec/zero_hz"),
        (json!({"structure": "lead", "band_hz": 5, "gain_range": [2, 1]}), "/spec/gain_range"),
        (json!({"structure": "lead", "band_hz": 5, "gain": 3, "gain_range": [1, 2]}), "/spec/gain_range"),
        (
            json!({"structure": "lead", "band_hz": 5, "zero_hz": 9, "pole_hz": 3, "zero_below_pole": true}),
            "/spec/zero_below_pole",
        ),
        (json!({"structure": "lead", "band_hz": 5, "pole_range_hz": [1, 900]}), "/spec/pole_range_hz"),
        (json!({"structure": "lead", "band_hz": 5, "limits": {"force": 0}}), "/spec/limits/force"),
        (json!({"structure": "proportional", "band_hz": 5, "gain_range": [2e5, 3e5]}), "/spec"),
        (json!({"structure": "lead", "band_hz": 5, "sweep": {"zero_hz": [1]}}), "/spec/sweep"),
    ] {
        let problem = run("compensator_design", inputs.clone(), spec.clone()).unwrap_err();
        assert_eq!(problem.location.as_deref(), Some(location), "{spec}: {problem}");
    }
    let problem = run(
        "compensator_design",
        json!({"plant": {"mass_kg": 0, "damping_ns_per_m": 1}, "signal": SIGNAL()}),
        json!({"structure": "lead", "band_hz": 5}),
    )
    .unwrap_err();
    assert_eq!(problem.location.as_deref(), Some("/inputs/plant/mass_kg"));
}

#[test]
fn it_stops_when_asked_and_repeats_to_the_byte() {
    let request = Request {
        kind: "compensator_design".to_owned(),
        inputs: json!({"plant": DRIVE(), "signal": {
            "generator": {"kind": "prts", "order": 3, "chip_s": 0.2, "seed": 8}, "sample_time_s": 0.005}}),
        spec: json!({"structure": "lead", "band_hz": 5}),
    };
    let plan = Plan::parse(&request).unwrap();
    let ctl = Ctl::new();
    ctl.stop(StopReason::Cancelled);
    assert!(matches!(plan.run(&Library::default(), &ctl), Err(Failure::Stopped(_))));
    let one = contract().run(&request, &Library::default(), &Ctl::new()).unwrap();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let two = pool.install(|| plan.run(&Library::default(), &Ctl::new()).unwrap());
    assert_eq!((one.provenance.result_sha256, one.provenance.seed), (two.provenance.result_sha256, Some(8)));
    // The judge's findings are those of the limits that it is given.
    let judged = design(5.0).judge(&Compensator::proportional(9051.9), &DesignLimits::default(), &Ctl::new()).unwrap();
    assert_eq!(judged.motion.within_limits, None);
}

#[test]
fn every_kind_stops_when_asked_and_counts_to_its_end() {
    let signal = json!({"generator": {"kind": "prts", "order": 3, "chip_s": 0.2, "seed": 8}, "sample_time_s": 0.005});
    let oscillator =
        json!({"parameters": [{"name": "k", "value": 4}], "a": [[0, 1], ["-k", -1]], "b": [[0], [1]], "c": [[1, 0]]});
    let start =
        json!({"generator": {"kind": "prbs", "order": 4, "chip_s": 0.4}, "sample_time_s": 0.2, "duration_s": 12});
    let short = json!({
        "experiment": {"duration_s": 6, "sample_time_s": 0.06}, "draws": 2, "fresh_draws": 4, "max_iterations": 2,
        "rounds": 1, "seed": 6
    });
    let cases = [
        ("excitation_quality", json!({"signal": signal}), json!({"band_hz": [2]}), 8),
        (
            "compensator_design",
            json!({"plant": DRIVE(), "signal": signal}),
            json!({"structure": "proportional", "band_hz": 5, "sweep": {"count": 5}}),
            8,
        ),
        (
            "input_design",
            json!({"model": oscillator, "starts": [start]}),
            json!({"samples": 60, "sample_time_s": 0.2, "noise_covariance": [[1e-4]], "limits": {"input": 2},
                "max_steps": 9, "monte_carlo": {"replicates": 10, "seed": 7}}),
            7,
        ),
        ("robust_input_design", json!({"axis": "axial_rotation"}), short, 6),
    ];
    for (kind, inputs, spec, seed) in cases {
        let request = Request { kind: kind.to_owned(), inputs, spec };
        let plan = Plan::parse(&request).unwrap();
        let ctl = Ctl::new();
        ctl.stop(StopReason::Cancelled);
        let stopped = plan.run(&Library::default(), &ctl);
        assert!(matches!(stopped, Err(Failure::Stopped(Stopped(StopReason::Cancelled)))), "{kind}");
        let ctl = Ctl::new();
        let report = contract().run(&request, &Library::default(), &ctl).unwrap();
        let progress = ctl.progress();
        assert!(progress.fraction > 0.999, "{kind} {progress:?}");
        assert_eq!(report.provenance.seed, Some(seed), "{kind}");
        let again = plan.run(&Library::default(), &Ctl::new()).unwrap();
        assert_eq!(again.provenance.result_sha256, report.provenance.result_sha256, "{kind}");
    }
}

#[test]
fn long_searches_stop_on_their_way() {
    let wobble = json!({"model": {"name": "seated_balance", "initial": [0.01, 0, 0, 0]}, "starts": [
        {"generator": {"kind": "prbs", "order": 6, "chip_s": 0.5, "amplitude": 6}, "sample_time_s": 0.1,
         "duration_s": 120}]});
    let cases = [
        (
            "compensator_design",
            json!({"plant": DRIVE(), "signal": SIGNAL()}),
            json!({"structure": "lead", "band_hz": 10}),
        ),
        (
            "input_design",
            wobble,
            json!({"samples": 1200, "sample_time_s": 0.1, "scale_to_fit": true, "max_steps": 2000, "tolerance": 1e-9,
                "limits": {"input": 20, "outputs": {"lower_angle": 0.192, "upper_angle": 0.078},
                           "autocorrelation": {}}}),
        ),
        ("robust_input_design", json!({"axis": "flexion_extension"}), json!({"draws": 500, "max_iterations": 100})),
    ];
    for (kind, inputs, spec) in cases {
        let plan = Plan::parse(&Request { kind: kind.to_owned(), inputs, spec }).unwrap();
        let (ctl, is_over) = (Ctl::new(), AtomicBool::new(false));
        let outcome = std::thread::scope(|scope| {
            scope.spawn(|| {
                while ctl.progress().done == 0 && !is_over.load(Ordering::Relaxed) {
                    std::thread::sleep(Duration::from_millis(1));
                }
                ctl.stop(StopReason::Cancelled);
            });
            let outcome = plan.run(&Library::default(), &ctl);
            is_over.store(true, Ordering::Relaxed);
            outcome
        });
        assert!(matches!(outcome, Err(Failure::Stopped(Stopped(StopReason::Cancelled)))), "{kind}");
        let progress = ctl.progress();
        assert!(progress.fraction > 0.0 && progress.fraction < 1.0, "{kind} {progress:?}");
    }
}

#[test]
fn the_order_of_persistent_excitation_is_that_of_the_signal_whichever_lines_are_judged() {
    let signal = json!({"generator": {"kind": "prts", "order": 3, "chip_s": 0.2}, "sample_time_s": 0.02});
    let order = |signal: &Value, lines: Value| {
        let report = run("excitation_quality", json!({"signal": signal}), json!({"lines": lines})).unwrap();
        report.result["persistent_excitation_order"].as_u64().unwrap()
    };
    // The 65 odd lines below the Nyquist frequency, which is line 130, on both sides of 0 Hz.
    for lines in [json!("auto"), json!("excited"), json!("odd"), json!({"harmonics": [1, 3, 5]}), json!("all")] {
        assert_eq!(order(&signal, lines), 130);
    }
    // A device that follows two lines of what was played is excited by two.
    let slow: Vec<f64> = (0..520)
        .map(|k| 2.0 * std::f64::consts::PI * f64::from(k) / 260.0)
        .map(|t| t.sin() + 0.5 * (3.0 * t).cos())
        .collect();
    let played = json!({
        "samples": slow, "sample_time_s": 0.02, "generator": {"kind": "prts", "order": 3, "chip_s": 0.2}
    });
    assert_eq!((order(&played, json!("auto")), order(&played, json!("excited"))), (4, 4));
}

#[test]
fn a_limit_that_nothing_can_judge_is_said_to_be_so() {
    let signal = json!({"generator": {"kind": "prts", "order": 3, "chip_s": 0.2}, "sample_time_s": 0.02});
    let ask = |inputs: Value, spec: Value| {
        let report = run("excitation_quality", inputs, spec).unwrap();
        let warnings = report.warnings.into_iter().filter(|w| w.code == "limit_not_judged").map(|w| w.message);
        (report.result["motion"]["within_limits"].clone(), warnings.collect::<Vec<String>>())
    };
    let limits = json!({"limits": {"position": 2, "force": 5, "power": 9}});
    let (within, said) = ask(json!({"signal": signal}), limits.clone());
    assert!(within.is_null() && said.len() == 1 && said[0].contains("force and the power"), "{said:?}");
    let (within, said) =
        ask(json!({"signal": signal}), json!({"quantity": "force", "limits": {"force": 5, "velocity": 1}}));
    assert!(within.is_null() && said.len() == 1 && said[0].contains("the velocity of"), "{said:?}");
    let loop_ = json!({"signal": signal, "plant": DRIVE(), "controller": {"num": [2000], "den": [1]}});
    let (within, said) = ask(loop_, json!({"limits": {"position": 1e3, "force": 1e5, "power": 1e7}}));
    assert_eq!((within, said), (json!(true), vec![]));
    let (within, said) = ask(json!({"signal": signal}), json!({"limits": {"position": 2}}));
    assert_eq!((within, said), (json!(true), vec![]));
}
