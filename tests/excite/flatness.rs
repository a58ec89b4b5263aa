//! Flatness against the paper's numbers and its closed forms, and what a way through a system does to it.

use crate::support::{close, design, gamma, golden, made, prts, spectrum};
use num_complex::Complex64;
use serde_json::json;
use std::f64::consts::PI;
use volition::control::{Continuous, Discrete, System, TransferFunction};
use volition::ctl::Ctl;
use volition::excite::compensator::Compensator;
use volition::excite::flatness::{Band, band_flatness, flatness};
use volition::excite::path::{Discretisation, Path, SampledPlant, mass_damper_pulse};
use volition::excite::spectrum::Spectrum;

#[test]
fn the_flatness_of_the_reference_is_that_of_the_paper() {
    let golden = golden();
    let sequence = prts(0.001);
    for (band, expected) in &golden.gamma_r2 {
        let found = gamma(&sequence, band.parse().unwrap());
        close(found, expected["value"].as_f64().unwrap(), 1e-12);
        let lines = Band::UpTo(band.parse().unwrap()).of(sequence.harmonics.as_ref().unwrap(), 1.0 / 48.4).unwrap();
        assert_eq!(lines.len() as u64, expected["count"].as_u64().unwrap());
        assert!((found - expected["printed"].as_f64().unwrap()).abs() <= 5e-5);
    }
    close(gamma(&sequence, 2.5), golden.gamma_r2_2p5["value"].as_f64().unwrap(), 1e-12);
    let coarse = prts(0.02);
    close(gamma(&coarse, 2.5), golden.gamma_r2_2p5["T002"].as_f64().unwrap(), 1e-12);
    for (band, expected) in &golden.gamma_t002 {
        close(gamma(&coarse, band.parse().unwrap()), *expected, 1e-12);
    }
    // Without the first line past the end, as the paper does not count.
    for (band, expected) in &golden.gamma_r2_strict_below {
        let spectrum = spectrum(&sequence);
        let below: Vec<usize> = sequence
            .harmonics
            .clone()
            .unwrap()
            .into_iter()
            .filter(|n| *n as f64 / 48.4 < band.parse().unwrap())
            .collect();
        close(flatness(below.iter().map(|n| spectrum.power[*n])), *expected, 1e-12);
    }
    for (key, sequence) in [("T0_001", &sequence), ("T0_02", &coarse)] {
        for band in ["2.5", "5", "10"] {
            let lines = sequence.harmonics.as_ref().unwrap();
            let found = band_flatness(&spectrum(sequence), lines, Some(Band::UpTo(band.parse().unwrap()))).unwrap();
            // The reference stops at the band's end, the flatness at the first line past it: energy is of the same
            // lines.
            let spectrum = spectrum(sequence);
            let to_hz: f64 = band.parse().unwrap();
            let past = (found.highest_hz > to_hz * (1.0 + 1e-9)).then(|| (found.highest_hz * 48.4).round() as usize);
            let whole: f64 = (1..spectrum.power.len()).map(|n| spectrum.share(n)).sum();
            let added = past.map_or(0.0, |n| spectrum.share(n) / whole);
            close(found.energy_fraction - added, golden.energy_fraction[key][band].as_f64().unwrap(), 1e-12);
            close(found.geometric_mean / found.arithmetic_mean, found.sfm, 1e-14);
            close(found.arithmetic_mean * found.lines as f64 / whole, found.energy_fraction, 1e-12);
        }
        // Where 80 % are passed: with the line at 2.665 Hz, and not within 2.5 Hz, as the paper has it.
        let share = |to_hz: f64| {
            let lines = sequence.harmonics.as_ref().unwrap();
            band_flatness(&spectrum(sequence), lines, Some(Band::UpTo(to_hz))).unwrap().energy_fraction
        };
        assert!(share(2.623) < 0.8 && share(2.625) > 0.8);
    }
}

#[test]
fn figure_3_is_reproduced_in_all_three_ways_of_sampling() {
    let golden = golden();
    let sequence = prts(0.02);
    let spectrum = spectrum(&sequence);
    let lines = sequence.harmonics.clone().unwrap();
    let time = Discrete::new(0.02).unwrap();
    for (name, bands) in &golden.figure_3 {
        let parts: Vec<&str> = name.split('_').collect();
        let zeta: f64 = parts[0].trim_start_matches("zeta").parse().unwrap();
        let natural = 2.0 * PI * parts[1].trim_start_matches("fn").parse::<f64>().unwrap();
        let how = match parts[2] {
            "continuous" => Discretisation::Continuous,
            "zoh" => Discretisation::ZeroOrderHold,
            _ => Discretisation::Tustin,
        };
        let den = [1.0, 2.0 * zeta * natural, natural * natural];
        let system = System::from(TransferFunction::new(&[natural * natural], &den, Continuous).unwrap());
        let path = Path::open(SampledPlant::new(&system, how, time).unwrap()).unwrap();
        for (band, expected) in bands {
            let inside = Band::UpTo(band.parse().unwrap()).of(&lines, spectrum.spacing_hz()).unwrap();
            let out = inside.iter().map(|n| spectrum.power[*n] * path.response(spectrum.omega_rad_s(*n)).norm_sqr());
            let own = inside.iter().map(|n| spectrum.power[*n]);
            close(flatness(out) / flatness(own), *expected, 1e-9);
        }
    }
}

#[test]
fn the_gain_of_a_whole_spectrum_is_its_leading_coefficient_times_the_ratio_of_powers() {
    // (13): SFG = b_m² R_xx(0)/R_yy(0), for the loop of K = 9000; and with a zero outside the circle its mirror image
    // counts.
    let golden = golden();
    let sequence = prts(0.001);
    let spectrum = spectrum(&sequence);
    let lines = sequence.harmonics.clone().unwrap();
    let time = Discrete::new(0.001).unwrap();
    let gain = |response: &dyn Fn(f64) -> Complex64| {
        let own = || lines.iter().map(|n| spectrum.power[*n]);
        let out = || lines.iter().map(|n| spectrum.power[*n] * response(spectrum.omega_rad_s(*n)).norm_sqr());
        (flatness(out()) / flatness(own()), own().sum::<f64>() / out().sum::<f64>())
    };
    let plant = SampledPlant::mass_damper(10.0, 50.0, time).unwrap();
    let path = Path::closed(plant, &System::from(TransferFunction::new(&[9000.0], &[1.0], time).unwrap())).unwrap();
    let (direct, ratio) = gain(&|w| path.response(w));
    let leading = 9000.0 * mass_damper_pulse(10.0, 50.0, 0.001)[0];
    let expected: Vec<f64> = serde_json::from_value(golden.closed_loop["SFG_full_K9000"].clone()).unwrap();
    close(direct, expected[0], 1e-9);
    close(leading * leading * ratio, expected[1], 1e-9);
    let den = TransferFunction::new(
        &[0.7, -1.4, 0.3],
        &[1.0, -0.5 - 1.6 * 1.0_f64.cos(), 0.64 + 0.8 * 1.0_f64.cos(), -0.32],
        time,
    );
    let system = den.unwrap();
    let (direct, ratio) = gain(&|w| system.response(w));
    close(direct / ratio, 1.510_810_367_098_085, 1e-9);
    let system = TransferFunction::new(&[0.7, -0.3, 0.1], system.den().coefficients(), time).unwrap();
    let (direct, ratio) = gain(&|w| system.response(w));
    close(direct / ratio, 0.49, 1e-9);
}

#[test]
fn the_steady_state_of_a_simulation_has_the_computed_flatness() {
    let sequence = made(json!({
        "generator": {"kind": "prts", "order": 5, "chip_s": 0.2}, "sample_time_s": 0.001, "periods": 3
    }));
    let n = sequence.period.unwrap().samples.unwrap();
    let lines = sequence.harmonics.clone().unwrap();
    let time = Discrete::new(0.001).unwrap();
    for (band, gain, first) in [(5.0, 9_051.916_234_351_42, 1.9746), (10.0, 38_343.507_417_795_35, 2.3711)] {
        let plant = SampledPlant::mass_damper(10.0, 50.0, time).unwrap();
        let path = Path::closed(plant, &System::from(TransferFunction::new(&[gain], &[1.0], time).unwrap())).unwrap();
        let out = path.carry(&sequence.values, &Ctl::new()).unwrap().output;
        let of = |period: &[f64]| {
            let spectrum = Spectrum::new(period, n, 0.001, &Ctl::new()).unwrap();
            band_flatness(&spectrum, &lines, Some(Band::UpTo(band))).unwrap().sfm
        };
        let own = of(&sequence.values[..n]);
        assert!((of(&out[..n]) / own - first).abs() < 5e-5);
        let design = design(band);
        close(of(&out[n..2 * n]) / own, design.blsfg(&Compensator::proportional(gain)), 1e-12);
        close(of(&out[2 * n..]) / own, design.blsfg(&Compensator::proportional(gain)), 1e-12);
    }
}
