//! Sequences are what they say, chip by chip and line by line.

use crate::support::{close, golden, made, prts, spectrum};
use serde_json::{Value, json};
use std::f64::consts::PI;
use volition::ctl::Ctl;
use volition::excite::flatness::flatness;
use volition::excite::sequence::{correlation, field::Base};
use volition::excite::spectrum::Spectrum;

#[test]
fn the_primitive_polynomials_and_the_sequence_are_those_of_the_reference() {
    let golden = golden();
    let ctl = Ctl::new();
    let found: Vec<Vec<u8>> = (0..22).map(|i| Base::Three.primitive(5, i, &ctl).unwrap().unwrap()).collect();
    assert_eq!(found, golden.primitive);
    let chips = made(json!({"generator": {"kind": "prts", "order": 5, "chip_s": 0.2, "polynomial": golden.sequence_c},
            "sample_time_s": 0.2}));
    assert_eq!(chips.values, golden.sequence);
    let prbs = made(json!({
        "generator": {"kind": "prbs", "order": 6, "chip_s": 0.5, "amplitude": 6, "polynomial": [1, 1, 0, 0, 0, 0]},
        "sample_time_s": 0.1, "duration_s": 30
    }));
    let expected: Vec<f64> = serde_json::from_value(golden.prbs["u0"].clone()).unwrap();
    assert_eq!(prbs.values, expected);
}

#[test]
fn every_polynomial_has_the_closed_form_of_the_spectrum() {
    // S(n) = 324 [sin(πn/242)/sin(πn/48400)]², for odd n, and nothing elsewhere.
    for index in 0..22 {
        let sequence = made(json!({
            "generator": {"kind": "prts", "order": 5, "chip_s": 0.2, "polynomial": index}, "sample_time_s": 0.02
        }));
        let (n_samples, spectrum) = (2420.0, spectrum(&sequence));
        let lines = sequence.harmonics.clone().unwrap();
        assert_eq!(lines.len(), 605);
        let largest = spectrum.power.iter().copied().fold(0.0, f64::max);
        for n in 0..spectrum.power.len() {
            let angle = PI * n as f64;
            let expected =
                if n % 2 == 1 { 324.0 * ((angle / 242.0).sin() / (angle / n_samples).sin()).powi(2) } else { 0.0 };
            assert!((spectrum.power[n] - expected).abs() <= 1e-12 * largest, "{index} {n}");
        }
        let closed = flatness(lines.iter().map(|n| {
            let angle = PI * *n as f64;
            ((angle / 242.0).sin() / (angle / n_samples).sin()).powi(2)
        }));
        close(flatness(lines.iter().map(|n| spectrum.power[*n])), closed, 1e-12);
    }
    // At the paper's own rate, amplitude by amplitude.
    let (sequence, n_samples) = (prts(0.001), 48_400.0);
    let (lines, spectrum) = (sequence.harmonics.clone().unwrap(), spectrum(&sequence));
    let amplitude = |n: usize| {
        let angle = PI * n as f64;
        if n % 2 == 1 { 18.0 * ((angle / 242.0).sin() / (angle / n_samples).sin()).abs() } else { 0.0 }
    };
    assert_eq!((lines.len(), spectrum.power.len()), (12_100, 24_201));
    for (n, power) in spectrum.power.iter().enumerate() {
        assert!((power.sqrt() - amplitude(n)).abs() <= 1e-12 * amplitude(1), "{n}");
    }
    let closed = flatness(lines.iter().map(|n| amplitude(*n).powi(2)));
    close(flatness(lines.iter().map(|n| spectrum.power[*n])), closed, 1e-12);
}

#[test]
fn maximum_length_sequences_repeat_after_their_length_and_not_before() {
    for (kind, order, length) in [("prts", 2, 8), ("prts", 4, 80), ("prbs", 3, 7), ("prbs", 9, 511)] {
        for seed in [1, 2, 3] {
            let sequence = made(json!({
                "generator": {"kind": kind, "order": order, "chip_s": 1, "seed": seed}, "sample_time_s": 1, "periods": 2
            }));
            assert_eq!(sequence.values.len(), 2 * length);
            let (one, two) = sequence.values.split_at(length);
            assert_eq!(one, two);
            let mut shorter = (1..length).filter(|shift| length % shift == 0);
            assert!(shorter.all(|shift| (0..length).any(|k| one[k] != one[(k + shift) % length])));
            let r = correlation::periodic_autocorrelation(one, length, &Ctl::new()).unwrap();
            if kind == "prbs" {
                assert!(r[1..].iter().all(|r| (r + 1.0 / length as f64).abs() < 1e-12));
            } else {
                // Zero but at half the period, where the sign is turned.
                assert!((1..length).filter(|j| *j != length / 2).all(|j| r[j].abs() < 1e-12));
                assert!((r[length / 2] + r[0]).abs() < 1e-12);
            }
        }
    }
    // Equal seeds give equal sequences, other seeds others.
    let seeded = |seed: u64| {
        made(json!({"generator": {"kind": "prts", "order": 5, "chip_s": 1, "seed": seed}, "sample_time_s": 1}))
    };
    assert_eq!(seeded(4), seeded(4));
    assert_ne!(seeded(4).values, seeded(5).values);
}

#[test]
fn holds_keep_the_lines_and_shape_the_spectrum() {
    let of = |hold: &str| {
        made(json!({"generator": {"kind": "prts", "order": 3, "chip_s": 0.5, "hold": hold}, "sample_time_s": 0.1}))
    };
    let (held, linear, integrated) = (of("zero"), of("linear"), of("integrated"));
    let (s0, s1, s2) = (spectrum(&held), spectrum(&linear), spectrum(&integrated));
    let (n, ratio) = (held.values.len() as f64, 5.0_f64);
    for line in held.harmonics.clone().unwrap() {
        let kernel = ((PI * line as f64 / 26.0).sin() / (PI * line as f64 / n).sin()).powi(2);
        close(s1.power[line] / s0.power[line], kernel / (ratio * ratio), 1e-10);
        // The integral's difference over a sample is the held velocity times the sample time.
        let step = 4.0 * (PI * line as f64 / n).sin().powi(2);
        close(s2.power[line] * step, s0.power[line] * 0.01, 1e-9);
    }
    let off: Vec<usize> = (0..s0.power.len()).filter(|n| n % 2 == 0).collect();
    assert!(off.iter().all(|n| s0.power[*n] < 1e-20 && s1.power[*n] < 1e-20 && (*n == 0 || s2.power[*n] < 1e-20)));
    // A rate at which chips are not whole numbers of samples.
    let uneven = made(json!({"generator": {"kind": "prts", "order": 3, "chip_s": 0.5}, "sample_time_s": 0.07}));
    assert_eq!(uneven.period.unwrap().samples, None);
    let chips = made(json!({"generator": {"kind": "prts", "order": 3, "chip_s": 0.5}, "sample_time_s": 0.5})).values;
    assert!(uneven.values.iter().enumerate().all(|(k, x)| *x == chips[k * 7 / 50]));
}

#[test]
fn multisines_have_their_lines_and_nothing_else() {
    let spec = |extra: Value| {
        let mut generator = json!({"kind": "multisine", "base_hz": 0.05, "harmonics": {"primes": [0.1, 2.5]}});
        generator.as_object_mut().unwrap().extend(extra.as_object().unwrap().clone());
        json!({"generator": generator, "sample_time_s": 0.02})
    };
    let primes = vec![2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31, 37, 41, 43, 47];
    let random = made(spec(json!({})));
    assert_eq!(random.harmonics.clone().unwrap(), primes);
    let found = spectrum(&random);
    assert_eq!(found.excited(1e-12), primes);
    for n in &primes {
        close(found.share(*n), 0.5, 1e-12);
    }
    let (even, odd) = (
        made(spec(json!({"interleave": {"part": 0, "of": 2}}))),
        made(spec(json!({"interleave": {"part": 1, "of": 2}}))),
    );
    assert_eq!(even.harmonics.unwrap(), [2, 5, 11, 17, 23, 31, 41, 47]);
    assert_eq!(odd.harmonics.unwrap(), [3, 7, 13, 19, 29, 37, 43]);
    let reduced = made(spec(json!({"power": {"reduced": {"above_hz": 0.7, "power_ratio": 0.04}}})));
    let shares = spectrum(&reduced);
    for n in &primes {
        close(shares.share(*n), if *n <= 14 { 0.5 } else { 0.02 }, 1e-12);
    }
    // Off the grid of samples the sum is the same function of time.
    let fine = made(spec(json!({"seed": 9})));
    let mut coarse = spec(json!({"seed": 9}));
    coarse["sample_time_s"] = json!(0.06);
    let coarse = made(coarse);
    assert!(coarse.period.unwrap().samples.is_none());
    assert!(coarse.values.iter().enumerate().all(|(k, x)| (x - fine.values[(3 * k) % 1000]).abs() < 1e-10));
    // The crest's optimisation is worth its time, and lower than Schroeder's for lines far from equal steps.
    let crest = |phases: &str| made(spec(json!({"phases": phases}))).details.continuous_crest_factor.unwrap();
    let (optimised, schroeder, random) = (crest("crest_optimised"), crest("schroeder"), crest("random"));
    assert!(optimised < 1.75 && optimised < schroeder && optimised < random, "{optimised} {schroeder} {random}");
}

#[test]
fn chirps_and_noise_are_what_they_say() {
    let chirp =
        made(json!({"generator": {"kind": "chirp", "preset": "zhang2015_section_3_2"}, "sample_time_s": 0.002}));
    assert_eq!((chirp.values.len(), &chirp.values), (40_001, &volition::simulate::reference_signals::chirp80(0.002)));
    let chirp = made(json!({"generator": {"kind": "chirp", "preset": "zhang2015_section_5_2"}, "sample_time_s": 0.02}));
    assert_eq!(chirp.values, volition::simulate::reference_signals::chirp60(0.02));
    // 2 sin(π t²/120) is at t/120 Hz.
    let general = made(json!({
        "generator": {"kind": "chirp", "from_hz": 0, "to_hz": 0.5, "duration_s": 60, "amplitude": 2},
        "sample_time_s": 0.02
    }));
    assert!(general.values.iter().zip(&chirp.values).all(|(a, b)| (a - b).abs() < 1e-10));
    let sweep = made(json!({
        "generator": {"kind": "chirp", "from_hz": 0.1, "to_hz": 10, "duration_s": 20, "sweep": "logarithmic"},
        "sample_time_s": 0.001
    }));
    // Zero crossings near the middle are half a period of 1 Hz apart.
    let crossings: Vec<usize> =
        (9_000..11_000).filter(|k| sweep.values[*k] < 0.0 && sweep.values[k + 1] >= 0.0).collect();
    assert!((1000.0 / (crossings[1] - crossings[0]) as f64 - 1.0).abs() < 0.25, "{crossings:?}");

    let noise = json!({"kind": "filtered_noise", "edge_hz": 1, "duration_s": 1000, "limit": null, "taper": 0,
        "rms": 0.3, "seed": 5});
    let plain = made(json!({"generator": noise, "sample_time_s": 0.02}));
    let rms = (plain.values.iter().map(|x| x * x).sum::<f64>() / 50_000.0).sqrt();
    assert!((rms / 0.3 - 1.0).abs() < 0.05, "{rms}");
    let whole = Spectrum::new(&plain.values, 50_000, 0.02, &Ctl::new()).unwrap();
    let share = |from: usize, to: usize| (from..to).map(|n| whole.share(n)).sum::<f64>();
    assert!(share(1_500, 25_000) < 1e-3 * share(1, 1_500), "40 dB down from 1.5 Hz on");
    let shown = made(json!({
        "generator": {"kind": "filtered_noise", "edge_hz": 1, "duration_s": 60,
                      "screen": {"width_m": 2, "distance_m": 3}, "seed": 5},
        "sample_time_s": 0.02
    }));
    let most = (2.0_f64 * 0.5).atan2(3.0);
    assert!(shown.values.iter().all(|x| x.abs() <= most) && shown.values.iter().any(|x| x.abs() == most));
    assert_eq!((shown.values[0], shown.values[2999]), (0.0, 0.0));
}

#[test]
fn scale_offset_clip_and_taper_come_in_this_order() {
    let with = |extra: Value| {
        let mut spec =
            json!({"generator": {"kind": "prts", "order": 3, "chip_s": 0.5, "amplitude": 0.7}, "sample_time_s": 0.1});
        spec.as_object_mut().unwrap().extend(extra.as_object().unwrap().clone());
        made(spec)
    };
    let (plain, scaled) = (with(json!({})), with(json!({"scale": {"peak": 3}})));
    assert_eq!((plain.values.len(), scaled.period, &scaled.harmonics), (130, plain.period, &plain.harmonics));
    assert!(plain.values.iter().zip(&scaled.values).all(|(x, y)| (y - x / 0.7 * 3.0).abs() < 1e-15 * 3.0));
    let rms = with(json!({"scale": {"rms": 0.5}}));
    close(rms.values.iter().map(|x| x * x).sum::<f64>() / 130.0, 0.25, 1e-14);
    // 18 of 26 chips are not zero.
    close(rms.values.iter().fold(0.0, |peak: f64, x| peak.max(x.abs())), 0.5 * (26.0_f64 / 18.0).sqrt(), 1e-14);
    let all = json!({"scale": {"peak": 3}, "offset": 0.5, "clip": [-2, 3.2], "taper": 0.1});
    let (clipped, tapered) = (with(json!({"scale": {"peak": 3}, "offset": 0.5, "clip": [-2, 3.2]})), with(all));
    for (x, y) in scaled.values.iter().zip(&clipped.values) {
        assert_eq!(*y, (x + 0.5).clamp(-2.0, 3.2));
    }
    // Cutting puts power on other lines, and a taper leaves no period; a limit that nothing reaches changes nothing.
    assert_eq!((clipped.harmonics.clone(), clipped.period), (None, plain.period));
    assert!(spectrum(&clipped).excited(1e-9).iter().any(|n| n % 2 == 0));
    assert_eq!(with(json!({"clip": [-1, 1]})), plain);
    assert_eq!(
        (tapered.values[0], tapered.values[129], tapered.period, tapered.harmonics.clone()),
        (0.0, 0.0, None, None)
    );
    for (k, (x, y)) in clipped.values.iter().zip(&tapered.values).enumerate() {
        let from_end = (k as f64).min(129.0 - k as f64);
        let window = if from_end < 12.9 { 0.5 - 0.5 * (PI * from_end / 12.9).cos() } else { 1.0 };
        assert!((y - x * window).abs() < 1e-15);
    }
}
