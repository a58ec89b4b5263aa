//! The compensator of the linear drive: peaks, limits, and what the drive goes through.

use crate::support::{DRIVE, SIGNAL, close, design, golden, prts, run, spectrum};
use num_complex::Complex64;
use serde_json::{Value, json};
use std::f64::consts::PI;
use volition::control::{Discrete, simulate};
use volition::ctl::Ctl;
use volition::excite::compensator::{Compensator, Design, DesignLimits, SearchBox, search};
use volition::excite::motion::{Motion, MotionLimits};
use volition::excite::path::{SampledPlant, mass_damper_pulse};

#[test]
fn proportional_control_has_the_peaks_of_the_reference() {
    let golden = golden();
    let beta: Vec<f64> = serde_json::from_value(golden.closed_loop["beta"].clone()).unwrap();
    let found = mass_damper_pulse(10.0, 50.0, 0.001);
    close(found[0], beta[0], 1e-13);
    close(found[1], beta[1], 1e-13);
    for band in [5.0, 10.0] {
        let expected = &golden.closed_loop["P"][&format!("{band},inc=True")];
        let number = |name: &str| expected[name].as_f64().unwrap();
        let report = run(
            "compensator_design",
            json!({"plant": DRIVE(), "signal": SIGNAL()}),
            json!({"structure": "proportional", "band_hz": band}),
        )
        .unwrap();
        let result = &report.result;
        let found = |name: &str| result[name].as_f64().unwrap();
        close(found("gain"), number("Kp"), 1e-5);
        close(found("blsfg"), number("blsfg"), 1e-7);
        close(found("resonance_hz"), number("fres"), 1e-5);
        close(found("resonance_gain"), number("peak"), 1e-5);
        // The reference gives those of the loop in continuous time, √(K/m) and c/(2√(Km)); the hold takes off some
        // damping.
        let gain = found("gain");
        close((gain / 10.0).sqrt() / (2.0 * PI), number("fn"), 1e-5);
        close(25.0 / (10.0 * gain).sqrt(), number("zeta"), 1e-5);
        close(found("natural_hz"), number("fn"), 1e-3);
        assert!(found("damping_ratio") < number("zeta") && found("damping_ratio") > 0.5 * number("zeta"));
        // The reference took ‖SP‖∞ from a grid of frequencies, which passes a sharp peak by: ours is larger by up to
        // 1.1e-5. A fine scan decides.
        let decay = (-50.0_f64 * 0.001 / 10.0).exp();
        let through = |i: u32| {
            let z = Complex64::from_polar(1.0, 2.0 * PI * number("fres") * (0.97 + 3e-7 * f64::from(i)) * 0.001);
            let plant = (z * beta[0] + beta[1]) / ((z - 1.0) * (z - decay));
            (plant / (1.0 + plant * gain)).norm()
        };
        close(found("disturbance_norm"), (0..200_000).map(through).fold(0.0, f64::max), 1e-9);
        assert!(found("disturbance_norm") >= number("SPinf"));
        close(found("disturbance_norm"), number("SPinf"), 2e-5);
        close(found("output_sfm"), number("gamma_x2"), 1e-7);
        assert!(found("spectral_radius") < 1.0 && result["action"] == "proportional" && result["zero_hz"].is_null());
        // Where the gain in flatness begins: the first of the reference's gains above one. They lie 0.1034 % apart
        // (those of its four cases are whole steps from each other), and the one before is below.
        let design = design(band);
        let begins = expected["K_gt1"][0].as_f64().unwrap();
        assert!(design.blsfg(&Compensator::proportional(begins / 1.001_034_6)) < 1.0);
        assert!(design.blsfg(&Compensator::proportional(begins)) > 1.0);
        landscape(&design, expected);
    }
    let design = design(5.0);
    let stable = |gain| design.is_stable(&Compensator::proportional(gain), 0.0);
    assert!(stable(100_083.3) && !stable(100_083.5) && !stable(-1.0));
}

/// Local maxima over the gain as many as the reference has, and a gain in flatness from where it begins to the end of
/// its range.
fn landscape(design: &Design, expected: &Value) {
    let gain = |i: u32| 100.0 * (990.0_f64).powf(f64::from(i) / 3999.0);
    let values: Vec<f64> = (0..4000).map(|i| design.blsfg(&Compensator::proportional(gain(i)))).collect();
    let tops = (1..3999).filter(|i| values[*i] > values[i - 1] && values[*i] > values[i + 1]).count() as u64;
    assert_eq!(tops, expected["localmax"].as_u64().unwrap());
    let range: [f64; 2] = serde_json::from_value(expected["K_gt1"].clone()).unwrap();
    assert!((gain(3999) - range[1]).abs() < 1e-9 * range[1]);
    for (i, value) in (0..).zip(&values) {
        assert!(if gain(i) >= range[0] { *value > 1.0 } else { *value < 1.0 || gain(i) > range[0] / 1.001_034_6 });
    }
}

#[test]
fn a_band_without_the_line_past_its_end_has_the_references_other_peaks() {
    let golden = golden();
    let sequence = prts(0.001);
    let spectrum = spectrum(&sequence);
    for band in [5.0, 10.0] {
        let expected = &golden.closed_loop["P"][&format!("{band},inc=False")];
        let number = |name: &str| expected[name].as_f64().unwrap();
        let lines = sequence.harmonics.as_ref().unwrap();
        let inside: Vec<usize> = lines.iter().copied().filter(|n| *n as f64 / 48.4 < band).collect();
        let omegas: Vec<f64> = inside.iter().map(|n| spectrum.omega_rad_s(*n)).collect();
        let powers: Vec<f64> = inside.iter().map(|n| spectrum.power[*n]).collect();
        let plant = SampledPlant::mass_damper(10.0, 50.0, Discrete::new(0.001).unwrap()).unwrap();
        let design = Design::new(plant, &omegas, &powers, sequence.values.clone());
        let region = SearchBox { gain: [100.0, 99_000.0], sections: Vec::new(), zero_below_pole: false };
        let limits = DesignLimits::default();
        let found = search(&design, &region, &limits, &Ctl::new()).unwrap();
        let judged = design.judge(&found.compensator, &limits, &Ctl::new()).unwrap();
        let (gain, resonance) = (found.compensator.gain, judged.resonance.unwrap());
        close(gain, number("Kp"), 1e-5);
        close(found.blsfg, number("blsfg"), 1e-7);
        close(judged.output_sfm, number("gamma_x2"), 1e-7);
        close(resonance.at / (2.0 * PI), number("fres"), 1e-5);
        close(resonance.value, number("peak"), 1e-5);
        close((gain / 10.0).sqrt() / (2.0 * PI), number("fn"), 1e-5);
        close(25.0 / (10.0 * gain).sqrt(), number("zeta"), 1e-5);
        assert!(judged.disturbance.value >= number("SPinf"), "a grid's maximum");
        close(judged.disturbance.value, number("SPinf"), 2e-5);
        landscape(&design, expected);
    }
}

#[test]
fn limited_compensators_are_those_of_another_search() {
    let golden: Value = serde_json::from_str(include_str!("../golden/excitation_limited.json")).unwrap();
    for (i, expected) in golden["answers"].as_array().unwrap().iter().enumerate() {
        let number = |name: &str| expected[name].as_f64().unwrap();
        let signal = json!({
            "generator": {"kind": "prts", "order": 5, "chip_s": 0.2, "amplitude": 0.02},
            "sample_time_s": number("sample_time_s")
        });
        let ask = |mut spec: Value| {
            spec["structure"] = json!("lead");
            spec["band_hz"] = expected["band_hz"].clone();
            run("compensator_design", json!({"plant": DRIVE(), "signal": signal}), spec).unwrap().result
        };
        // The other search's answer by itself: every number that it is judged by.
        let (gain, zero, pole) = (number("gain"), number("zero_hz"), number("pole_hz"));
        let fixed = ask(json!({"gain": gain, "zero_hz": zero, "pole_hz": pole, "limits": {"decay_per_s": 0}}));
        let found = |result: &Value, name: &str| result[name].as_f64().unwrap();
        close(found(&fixed, "blsfg"), number("blsfg"), 1e-9);
        close(found(&fixed, "disturbance_norm"), number("disturbance_norm"), 1e-6);
        close(found(&fixed, "slowest_decay_per_s"), number("slowest_decay_per_s"), 1e-6);
        close(fixed["motion"]["force"]["peak"].as_f64().unwrap(), number("force"), 1e-8);
        // The whole box where that is quick; beside the other search's pole elsewhere.
        let mut spec = json!({"limits": expected["limits"]});
        if i > 1 {
            spec["pole_hz"] = json!(pole);
        }
        let ours = ask(spec);
        close(found(&ours, "blsfg"), number("blsfg"), 1e-5);
        let limits = &expected["limits"];
        let within = |name: &str, reached: f64| limits[name].as_f64().is_none_or(|limit| reached <= limit);
        assert!(within("disturbance_norm", found(&ours, "disturbance_norm")));
        assert!(within("force", ours["motion"]["force"]["peak"].as_f64().unwrap() * (1.0 - 1e-12)));
        assert!(found(&ours, "slowest_decay_per_s") >= limits["decay_per_s"].as_f64().unwrap() * (1.0 - 1e-9));
    }
}

#[test]
fn the_best_compensator_is_a_lag_and_a_lead_cannot_beat_proportional_control() {
    let golden: Value = serde_json::from_str(include_str!("../golden/excitation_lead.json")).unwrap();
    for expected in golden["answers"].as_array().unwrap() {
        let strict = expected["zero_below_pole"].as_bool().unwrap();
        // Without the decay that is asked by default, as the reference.
        let spec = json!({
            "structure": "lead", "band_hz": expected["band_hz"], "zero_below_pole": strict, "limits": {"decay_per_s": 0}
        });
        let report = run("compensator_design", json!({"plant": DRIVE(), "signal": SIGNAL()}), spec).unwrap();
        let result = &report.result;
        let found = |name: &str| result[name].as_f64().unwrap();
        let codes: Vec<&str> = report.warnings.iter().map(|w| w.code.as_str()).collect();
        let improvement = result["proportional"]["improvement"].as_f64().unwrap();
        close(found("blsfg"), expected["blsfg"].as_f64().unwrap(), if strict { 5e-6 } else { 1e-6 });
        if strict {
            assert!(
                (improvement - 1.0).abs() < 1e-6 && codes.contains(&"proportional_is_as_good"),
                "{improvement} {codes:?}"
            );
        } else {
            assert!(improvement > 1.04 && result["action"] == "lag", "{improvement}");
            assert!(codes.contains(&"edge_of_the_box") && codes.contains(&"weak_against_disturbance"), "{codes:?}");
        }
    }
}

#[test]
fn by_default_no_resonance_hides_between_the_lines() {
    // Without the default the best loop at 10 Hz rings at 9.997 Hz, between two lines, with a damping ratio of 5e-8.
    let signal = json!({"generator": {"kind": "prts", "order": 3, "chip_s": 0.2}, "sample_time_s": 0.005});
    let inputs = json!({"plant": DRIVE(), "signal": signal});
    let report = run("compensator_design", inputs.clone(), json!({"structure": "lead", "band_hz": 5})).unwrap();
    let found = |name: &str| report.result[name].as_f64().unwrap();
    // The odd lines are 2/5.2 Hz apart.
    close(found("required_decay_per_s"), PI * 2.0 / 5.2, 1e-9);
    assert!(found("slowest_decay_per_s") >= found("required_decay_per_s") * (1.0 - 1e-9));
    let free = json!({"structure": "lead", "band_hz": 5, "limits": {"decay_per_s": 0}});
    let free = run("compensator_design", inputs, free).unwrap();
    assert!(free.result["blsfg"].as_f64().unwrap() >= found("blsfg") * (1.0 - 1e-9));
}

#[test]
fn limits_are_kept_and_contradictions_named() {
    let signal =
        json!({"generator": {"kind": "prts", "order": 3, "chip_s": 0.2, "amplitude": 0.02}, "sample_time_s": 0.005});
    let inputs = json!({"plant": DRIVE(), "signal": signal});
    let free = run("compensator_design", inputs.clone(), json!({"structure": "lead", "band_hz": 5})).unwrap();
    let force = free.result["motion"]["force"]["peak"].as_f64().unwrap();
    let norm = free.result["disturbance_norm"].as_f64().unwrap();
    for limits in [json!({"force": 0.6 * force}), json!({"disturbance_norm": 0.5 * norm}), json!({"decay_per_s": 4.0})]
    {
        let spec = json!({"structure": "lead", "band_hz": 5, "limits": limits});
        let report = run("compensator_design", inputs.clone(), spec).unwrap();
        let result = &report.result;
        assert!(result["blsfg"].as_f64().unwrap() <= free.result["blsfg"].as_f64().unwrap());
        if limits["force"].is_f64() {
            assert_eq!(result["motion"]["within_limits"], true);
        }
        assert!(limits["disturbance_norm"].as_f64().is_none_or(|l| result["disturbance_norm"].as_f64().unwrap() <= l));
        let radius = (-limits["decay_per_s"].as_f64().unwrap_or(0.0) * 0.005).exp();
        assert!(result["spectral_radius"].as_f64().unwrap() <= radius);
    }
    let contradiction =
        json!({"structure": "lead", "band_hz": 5, "limits": {"force": 0.02 * force, "disturbance_norm": 0.1 * norm}});
    let problem = run("compensator_design", inputs, contradiction).unwrap_err();
    assert_eq!(problem.location.as_deref(), Some("/spec/limits"));
    assert!(problem.detail.contains("force") && problem.detail.contains("disturbance_norm"), "{problem}");
}

#[test]
fn a_sampled_plant_gives_what_its_continuous_form_gives() {
    let [b1, b2] = mass_damper_pulse(10.0, 50.0, 0.001);
    let decay = (-0.005_f64).exp();
    let sampled = json!({"num": [b1, b2], "den": [1.0, -1.0 - decay, decay], "sample_time_s": 0.001});
    let continuous = json!({"num": [1], "den": [10, 50, 0], "sample_time_s": null});
    let spec =
        json!({"structure": "proportional", "band_hz": 5, "sweep": {"count": 40, "zero_hz": [1, 4], "pole_hz": 50}});
    let answers: Vec<Value> = [DRIVE(), sampled, continuous]
        .into_iter()
        .map(|plant| {
            run("compensator_design", json!({"plant": plant, "signal": SIGNAL()}), spec.clone()).unwrap().result
        })
        .collect();
    for other in &answers[1..] {
        close(other["blsfg"].as_f64().unwrap(), answers[0]["blsfg"].as_f64().unwrap(), 1e-7);
        close(other["gain"].as_f64().unwrap(), answers[0]["gain"].as_f64().unwrap(), 1e-5);
        close(
            other["motion"]["force"]["peak"].as_f64().unwrap(),
            answers[0]["motion"]["force"]["peak"].as_f64().unwrap(),
            1e-4,
        );
    }
    let curves = answers[0]["sweep"].as_array().unwrap();
    assert_eq!((curves.len(), curves[0]["gain"].as_array().unwrap().len()), (2, 40));
    assert!(curves[0]["blsfg"].as_array().unwrap().iter().any(Value::is_null), "the range reaches into instability");
    // Every point of figure 5 is that of the loop judged by itself.
    let design = design(5.0);
    for (curve, zero_hz) in curves.iter().zip([1.0, 4.0]) {
        let column = |name: &str| -> Vec<Option<f64>> { serde_json::from_value(curve[name].clone()).unwrap() };
        let (gains, blsfg, resonance, norm) =
            (column("gain"), column("blsfg"), column("resonance_hz"), column("disturbance_norm"));
        for (k, gain) in gains.iter().enumerate() {
            let compensator = Compensator::lead(gain.unwrap(), zero_hz, 50.0);
            let judged = design.judge(&compensator, &DesignLimits::default(), &Ctl::new()).ok();
            assert_eq!(judged.is_some(), design.is_stable(&compensator, 0.0));
            let near = |found: Option<f64>, own: Option<f64>| match (found, own) {
                (Some(found), Some(own)) => close(found, own, 1e-12),
                (found, own) => assert_eq!(found, own),
            };
            near(blsfg[k], judged.as_ref().map(|j| j.blsfg));
            near(norm[k], judged.as_ref().map(|j| j.disturbance.value));
            assert_eq!(resonance[k], judged.as_ref().and_then(|j| j.resonance).map(|peak| peak.at / (2.0 * PI)));
        }
    }
}

#[test]
fn motion_from_states_agrees_with_differences_and_with_newton() {
    let time = Discrete::new(0.001).unwrap();
    let plant = SampledPlant::mass_damper(10.0, 50.0, time).unwrap();
    let force: Vec<f64> = (0..4000).map(|k| if (k / 200) % 2 == 0 { 30.0 } else { -20.0 }).collect();
    let path = simulate::filter(plant.sampled(), &force).unwrap();
    let states = Motion::of_plant(&plant, &path, &force, &Ctl::new()).unwrap().summary(&MotionLimits {
        velocity: Some(1e3),
        force: Some(29.0),
        ..MotionLimits::default()
    });
    let differences = Motion::of_samples(&path, Some(&force), 0.001).summary(&MotionLimits::default());
    let of = |extent: Option<volition::excite::motion::Extent>| extent.unwrap();
    close(of(states.position).peak, of(differences.position).peak, 1e-9);
    close(of(states.velocity).rms, of(differences.velocity).rms, 1e-2);
    close(of(states.acceleration).rms, of(differences.acceleration).rms, 1e-2);
    // m a + c v = F, at the first sample from rest.
    assert!(of(states.acceleration).peak >= 3.0);
    assert_eq!(
        (states.within_limits, of(states.force).within_limit, of(states.velocity).within_limit),
        (Some(false), Some(false), Some(true))
    );
    assert_eq!(differences.within_limits, None);
}
