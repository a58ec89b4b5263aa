//! Frequency responses: known systems come back, variances hold against simulation, doubts are named.

use num_complex::Complex64;
use rand::RngExt;
use rand_distr::StandardNormal;
use std::f64::consts::PI;
use std::path::Path;
use volition::ctl::Ctl;
use volition::num::rng::{Stream, stream};
use volition::response::{
    Average, Bounds, Channels, CountSegments, Detrend, EndSample, Estimate, FrequencyError, FrequencySettings,
    LengthSegments, Lines, Response, Segments, Stimulus, Transients, Window, direct_transform, estimate,
    estimate_between,
};
use volition::trial::csv::Options;
use volition::trial::gzip::GzipReader;
use volition::trial::{Signals, Trial, csv};

/// `H(z) = (b0 + b1 z⁻¹)/(1 + a1 z⁻¹ + a2 z⁻²)`, at rest before the first sample.
pub struct Filter {
    b: [f64; 2],
    a: [f64; 2],
}

impl Filter {
    /// A resonance with a decay of a few tens of samples.
    pub const LOOP: Self = Self { b: [0.05, 0.04], a: [-1.72, 0.80] };

    pub fn run(&self, r: &[f64]) -> Vec<f64> {
        let mut y: Vec<f64> = Vec::with_capacity(r.len());
        let at = |x: &[f64], i: usize, back: usize| if i >= back { x[i - back] } else { 0.0 };
        for i in 0..r.len() {
            let next = self.b[0] * r[i] + self.b[1] * at(r, i, 1) - self.a[0] * at(&y, i, 1) - self.a[1] * at(&y, i, 2);
            y.push(next);
        }
        y
    }

    pub fn response(&self, frequency_hz: f64, dt: f64) -> Complex64 {
        let d = Complex64::from_polar(1.0, -2.0 * PI * frequency_hz * dt);
        (self.b[0] + self.b[1] * d) / (1.0 + self.a[0] * d + self.a[1] * d * d)
    }
}

/// Sum of sinusoids at the lines `k/period` with amplitudes `1/k` and fixed phases.
pub fn multisine(lines: &[usize], period: usize, samples: usize) -> Vec<f64> {
    (0..samples)
        .map(|i| {
            lines
                .iter()
                .map(|k| (2.0 * PI * (k * i % period) as f64 / period as f64 + (k * k) as f64).sin() / *k as f64)
                .sum()
        })
        .collect()
}

pub fn trial(dt: f64, r: Vec<f64>, y: Vec<f64>, d: Option<Vec<f64>>) -> Trial {
    let signals = Signals { time_s: None, control: vec![0.0; r.len()], command: r, output: y, disturbance: d };
    Trial::new(dt, signals).unwrap()
}

pub fn normal(random: &mut Stream) -> f64 {
    random.sample::<f64, _>(StandardNormal)
}

pub fn codes(estimate: &Estimate) -> Vec<&'static str> {
    estimate.warnings.iter().map(|warning| warning.code).collect()
}

pub fn warning<'a>(estimate: &'a Estimate, code: &str) -> &'a str {
    let found = estimate.warnings.iter().find(|warning| warning.code == code);
    &found.unwrap_or_else(|| panic!("no {code} in {:?}", estimate.warnings)).message
}

pub fn between(
    trials: &[&Trial],
    settings: &FrequencySettings,
    channels: Channels,
) -> Result<Estimate, FrequencyError> {
    estimate_between(trials, &settings.check().unwrap(), channels, &Ctl::new())
}

pub const LINES: [usize; 6] = [2, 5, 11, 17, 23, 31];
pub const PERIOD: usize = 600;
pub const DT: f64 = 0.02;

/// Five periods of a multisine through the filter, the first of which holds the transient.
pub fn periodic_trial() -> Trial {
    let r = multisine(&LINES, PERIOD, 5 * PERIOD);
    let y = Filter::LOOP.run(&r);
    trial(DT, r, y, None)
}

pub fn after_transient() -> Segments {
    Segments::Length(LengthSegments { length_s: PERIOD as f64 * DT, start_s: 2.0 * PERIOD as f64 * DT })
}

#[test]
fn a_known_filter_comes_back_from_periodic_data() {
    let recording = periodic_trial();
    let named: Vec<f64> = LINES.iter().map(|k| *k as f64 / (PERIOD as f64 * DT)).collect();
    for lines in [Lines::Excited, Lines::FrequencyHz(named.clone())] {
        for average in [Average::Ratios, Average::CrossSpectra] {
            for (window, detrend) in [
                (Window::Rectangular, Some(Detrend::None)),
                (Window::Rectangular, None),
                (Window::Rectangular, Some(Detrend::Mean)),
                (Window::Hann, Some(Detrend::None)),
                (Window::Hamming, Some(Detrend::Mean)),
                (Window::Blackman, Some(Detrend::None)),
            ] {
                // Windows spread a line onto its neighbours, where "excited" finds it too.
                if window != Window::Rectangular && lines == Lines::Excited {
                    continue;
                }
                let lines = lines.clone();
                let segments = Some(after_transient());
                let settings = FrequencySettings { lines, segments, window, detrend, average, ..Default::default() };
                let found = estimate(&[&recording], &settings).unwrap();
                assert_eq!(found.frequency_hz.len(), LINES.len(), "{settings:?}: {:?}", found.frequency_hz);
                for (i, h) in found.h.iter().enumerate() {
                    assert!((found.frequency_hz[i] - named[i]).abs() < 1e-12);
                    let error = (h.unwrap() - Filter::LOOP.response(named[i], DT)).norm();
                    assert!(error < 1e-9, "{settings:?} at {} Hz: {error:e}", named[i]);
                    let amplitude = 1.0 / LINES[i] as f64;
                    assert!((found.input_power[i] - amplitude * amplitude / 2.0).abs() < 1e-12);
                    assert!(found.variance[i].unwrap() < 1e-18);
                    assert!((found.coherence[i].unwrap() - 1.0).abs() < 1e-12);
                }
                assert_eq!(found.averages, [3; 6]);
                assert_eq!(codes(&found), ["few_averages"], "{settings:?}");
            }
        }
    }
}

#[test]
fn the_naive_sum_agrees() {
    let recording = periodic_trial();
    let settings = FrequencySettings {
        lines: Lines::FrequencyHz(vec![0.1, 0.3777]),
        segments: Some(Segments::Bounds(vec![Bounds { start_s: 3.0, end_s: 17.0 }])),
        end_sample: Some(EndSample::Included),
        detrend: Some(Detrend::None),
        transients: Some(Transients::Keep),
        ..Default::default()
    };
    let found = estimate(&[&recording], &settings).unwrap();
    assert_eq!(found.segments[0].samples, 701);
    for (frequency, h) in [0.1, 0.3777].iter().zip(&found.h) {
        let sum = |x: &[f64]| -> Complex64 {
            (150..=850).map(|i| x[i] * Complex64::from_polar(1.0, -2.0 * PI * frequency * i as f64 * DT)).sum()
        };
        let expected = sum(&recording.signals.output) / sum(&recording.signals.command);
        assert!((h.unwrap() - expected).norm() < 1e-11 * expected.norm());
    }
}

#[test]
fn other_channels_are_reached() {
    // d drives u through the filter, e = r − y with y = r delayed, and r is silent where d is not.
    let period = 400;
    let r = multisine(&[4, 9], period, 3 * period);
    let d = multisine(&[6, 13], period, 3 * period);
    let u = Filter::LOOP.run(&d);
    let y: Vec<f64> = (0..r.len()).map(|i| if i > 0 { r[i - 1] } else { 0.0 }).collect();
    let signals = Signals { time_s: None, command: r, control: u, output: y, disturbance: Some(d) };
    let recording = Trial::new(0.01, signals).unwrap();
    let settings = FrequencySettings {
        segments: Some(Segments::Length(LengthSegments { length_s: 4.0, start_s: 4.0 })),
        ..Default::default()
    };
    let channels = Channels { input: Stimulus::Disturbance, output: Response::Control };
    let found = between(&[&recording], &settings, channels).unwrap();
    assert_eq!(found.frequency_hz, [1.5, 3.25]);
    for (f, h) in found.frequency_hz.iter().zip(&found.h) {
        assert!((h.unwrap() - Filter::LOOP.response(*f, 0.01)).norm() < 1e-9);
    }
    let channels = Channels { input: Stimulus::Command, output: Response::Error };
    let found = between(&[&recording], &settings, channels).unwrap();
    assert_eq!(found.frequency_hz, [1.0, 2.25]);
    for (f, h) in found.frequency_hz.iter().zip(&found.h) {
        let expected = 1.0 - Complex64::from_polar(1.0, -2.0 * PI * f * 0.01);
        assert!((h.unwrap() - expected).norm() < 1e-11);
    }
}

// ---- variances

/// Response errors and estimated variances at every line over many realisations of white output noise.
struct MonteCarlo {
    errors: Vec<Vec<Complex64>>,
    variances: Vec<Vec<f64>>,
}

const SIGMA: f64 = 0.05;

fn monte_carlo(segments: usize, average: Average, realisations: usize, name: &str) -> MonteCarlo {
    let r = multisine(&LINES, PERIOD, (segments + 1) * PERIOD);
    let clean = Filter::LOOP.run(&r);
    let settings = FrequencySettings {
        segments: Some(Segments::Length(LengthSegments { length_s: PERIOD as f64 * DT, start_s: PERIOD as f64 * DT })),
        average,
        ..Default::default()
    };
    let mut random = stream(17, name);
    let mut all = MonteCarlo { errors: vec![Vec::new(); LINES.len()], variances: vec![Vec::new(); LINES.len()] };
    for _ in 0..realisations {
        let y = clean.iter().map(|y| y + SIGMA * normal(&mut random)).collect();
        let found = estimate(&[&trial(DT, r.clone(), y, None)], &settings).unwrap();
        assert_eq!(found.h.len(), LINES.len());
        for i in 0..LINES.len() {
            all.errors[i].push(found.h[i].unwrap() - Filter::LOOP.response(found.frequency_hz[i], DT));
            all.variances[i].push(found.variance[i].unwrap());
        }
    }
    all
}

#[test]
fn variances_hold_against_simulation() {
    const REALISATIONS: usize = 1500;
    for (segments, average, name) in [
        (1, Average::Ratios, "nearby lines"),
        (6, Average::Ratios, "ratios"),
        (6, Average::CrossSpectra, "cross spectra"),
    ] {
        let runs = monte_carlo(segments, average, REALISATIONS, name);
        let count = REALISATIONS as f64;
        // Complex degrees of freedom of the estimated variance: segments less one, or the twelve lines it comes from.
        let freedom = if segments == 1 { 12.0 } else { segments as f64 - 1.0 };
        let mut covered = 0;
        for (i, k) in LINES.iter().enumerate() {
            // E|Y noise|² = N σ², |R| = N/(2k), and n segments.
            let theory = 4.0 * (k * k) as f64 * SIGMA * SIGMA / (PERIOD * segments) as f64;
            let actual = runs.errors[i].iter().map(|e| e.norm_sqr()).sum::<f64>() / count;
            let estimated = runs.variances[i].iter().sum::<f64>() / count;
            // Both are means of exponential-like quantities: 5 standard errors.
            let tolerance = 5.0 / count.sqrt();
            assert!((actual / theory - 1.0).abs() < tolerance, "{name}, line {k}: {actual:e}, theory {theory:e}");
            assert!((estimated / theory - 1.0).abs() < tolerance, "{name}, line {k}: {estimated:e}, theory {theory:e}");
            let bias = runs.errors[i].iter().sum::<Complex64>() / count;
            assert!(bias.norm() < 5.0 * (theory / count).sqrt(), "{name}, line {k}: bias {bias}");
            // |error|²/variance is F(2, 2ν), whose 95 % point is ν(0.05^{−1/ν} − 1).
            let limit = freedom * (0.05_f64.powf(-1.0 / freedom) - 1.0);
            covered +=
                runs.errors[i].iter().zip(&runs.variances[i]).filter(|(e, v)| e.norm_sqr() <= limit * *v).count();
        }
        let coverage = covered as f64 / (count * LINES.len() as f64);
        // Binomial standard error 0.0023.
        assert!((coverage - 0.95).abs() < 0.0115, "{name}: coverage {coverage}");
    }
}

#[test]
fn lines_of_the_other_stimulus_are_no_noise() {
    // Without noise the variance from nearby lines is zero only if those of the disturbance are left out.
    let r = multisine(&LINES, PERIOD, 2 * PERIOD);
    let d = multisine(&[3, 7, 13, 19, 29], PERIOD, 2 * PERIOD);
    let driven: Vec<f64> = r.iter().zip(&d).map(|(r, d)| r + 0.5 * d).collect();
    let y = Filter::LOOP.run(&driven);
    let settings = FrequencySettings {
        segments: Some(Segments::Bounds(vec![Bounds { start_s: 12.0, end_s: 24.0 }])),
        ..Default::default()
    };
    let with = estimate(&[&trial(DT, r.clone(), y.clone(), Some(d))], &settings).unwrap();
    assert!(with.variance.iter().all(|v| v.unwrap() < 1e-20), "{:?}", with.variance);
    let without = estimate(&[&trial(DT, r, y, None)], &settings).unwrap();
    assert!(without.variance.iter().all(|v| v.unwrap() > 1e-8), "{:?}", without.variance);
}

// ---- end samples

fn chirp_60() -> Vec<f64> {
    (0..=3000).map(|i| 2.0 * (PI / 120.0 * (f64::from(i) * 0.02).powi(2)).sin()).collect()
}

#[test]
fn the_end_sample_matters_little_for_a_chirp_and_all_for_a_period() {
    // A loop with poles at −3 ± 4j rad/s, as in the module's description.
    let (radius, angle) = ((-3.0 * 0.02_f64).exp(), 4.0 * 0.02_f64);
    let a = [-2.0 * radius * angle.cos(), radius * radius];
    let gain = 1.0 + a[0] + a[1];
    let filter = Filter { b: [0.3 * gain, 0.7 * gain], a };
    let r = chirp_60();
    let y = filter.run(&r);
    let recording = trial(0.02, r, y, None);
    let mut means = Vec::new();
    let mut all = Vec::new();
    for end_sample in [EndSample::Excluded, EndSample::Included] {
        let settings =
            FrequencySettings { lines: Lines::Zhang2015Chapter5, end_sample: Some(end_sample), ..Default::default() };
        let found = estimate(&[&recording], &settings).unwrap();
        let errors: Vec<f64> =
            (0..31).map(|k| (found.h[k].unwrap() - filter.response(k as f64 / 60.0, 0.02)).norm()).collect();
        means.push(errors.iter().sum::<f64>() / 31.0);
        all.push(found.h);
    }
    assert!((means[0] - 0.0265).abs() < 1e-3 && (means[1] - 0.0233).abs() < 1e-3, "{means:?}");
    for (a, b) in all[0].iter().zip(&all[1]) {
        assert!((a.unwrap() - b.unwrap()).norm() < 0.01);
    }

    // For a periodic signal, the end sample spoils an exact answer.
    let recording = periodic_trial();
    let named: Vec<f64> = LINES.iter().map(|k| *k as f64 / 12.0).collect();
    let error = |end_sample| {
        let settings = FrequencySettings {
            lines: Lines::FrequencyHz(named.clone()),
            segments: Some(Segments::Bounds(vec![Bounds { start_s: 24.0, end_s: 36.0 }])),
            end_sample: Some(end_sample),
            transients: Some(Transients::Keep),
            detrend: Some(Detrend::None),
            ..Default::default()
        };
        let found = estimate(&[&recording], &settings).unwrap();
        let errors = named.iter().zip(&found.h).map(|(f, h)| (h.unwrap() - Filter::LOOP.response(*f, DT)).norm());
        errors.fold(0.0, f64::max)
    };
    assert!(error(EndSample::Excluded) < 1e-9);
    assert!(error(EndSample::Included) > 1e-3);
}

// ---- presets

#[test]
fn the_presets_are_those_of_the_paper() {
    let third = FrequencySettings { lines: Lines::Zhang2015Chapter3, ..Default::default() }.check().unwrap();
    assert_eq!(
        third.settings().segments,
        Some(Segments::Bounds(vec![Bounds { start_s: 0.0, end_s: 40.0 }, Bounds { start_s: 40.0, end_s: 80.0 }]))
    );
    assert_eq!(third.settings().average, Average::Ratios);
    let r: Vec<f64> = (0..=40_000)
        .map(|i| {
            let t = f64::from(i) * 0.002;
            let phase = |t: f64| (0.2 * PI * t + 0.015 * PI * t * t).sin();
            if t <= 40.0 { (2.0 - 0.035 * t) * phase(t) } else { (0.8 - 0.035 * t) * phase(80.0 - t) }
        })
        .collect();
    let recording = trial(0.002, r.clone(), r, None);
    let found = estimate(&[&recording], third.settings()).unwrap();
    let expected: Vec<f64> = (0..13).map(|k| 0.1 + 0.025 * f64::from(k)).collect();
    assert_eq!(found.frequency_hz.len(), 13);
    assert!(found.frequency_hz.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-15));
    assert_eq!(found.segments.iter().map(|s| s.samples).collect::<Vec<_>>(), [20_001, 20_001]);
    assert!(found.h.iter().all(|h| (h.unwrap() - 1.0).norm() < 1e-12));
    // What answers without memory has no transient.
    assert_eq!(codes(&found), ["few_averages"]);

    let recording = trial(0.02, chirp_60(), chirp_60(), None);
    let found =
        estimate(&[&recording], &FrequencySettings { lines: Lines::Zhang2015Chapter5, ..Default::default() }).unwrap();
    assert_eq!(found.frequency_hz.len(), 31);
    assert!(found.omega_rad_s.iter().enumerate().all(|(k, w)| (w - PI / 30.0 * k as f64).abs() < 1e-14));
    assert_eq!(found.segments[0].samples, 3001);
    assert_eq!(codes(&found), ["few_averages", "variance_unknown"]);
    assert_eq!(found.data().variance, None);
    assert_eq!(found.data().h.len(), 31);
    // An 80-s preset has no place in a 60-s record.
    let settings = FrequencySettings { lines: Lines::Zhang2015Chapter3, ..Default::default() };
    let error = estimate(&[&recording], &settings).unwrap_err();
    assert!(matches!(error, FrequencyError::SegmentOutside { segment: 1, .. }), "{error}");
    assert_eq!(error.to_string(), "segment 2 runs from 40 s to 80 s, and the record of trial 1 ends at 60.02 s");
}

#[test]
fn a_record_without_its_end_sample_is_taken_and_said() {
    let mut r = chirp_60();
    r.pop();
    let recording = trial(0.02, r.clone(), r, None);
    let settings = FrequencySettings { lines: Lines::Zhang2015Chapter5, ..Default::default() };
    let found = estimate(&[&recording], &settings).unwrap();
    assert_eq!(found.segments[0].samples, 3000);
    assert!(warning(&found, "segment_truncated").contains("end sample of segment 1"));
}

#[test]
fn settings_survive_json() {
    for (text, lines, segments) in [
        (r#"{}"#, Lines::Excited, None),
        (r#"{"lines": "zhang2015_chapter_3"}"#, Lines::Zhang2015Chapter3, None),
        (
            r#"{"lines": {"frequency_hz": [0.1, 0.2]}, "segments": {"count": 3}}"#,
            Lines::FrequencyHz(vec![0.1, 0.2]),
            Some(Segments::Count(CountSegments { count: 3 })),
        ),
        (
            r#"{"segments": [{"start_s": 5, "end_s": 25}]}"#,
            Lines::Excited,
            Some(Segments::Bounds(vec![Bounds { start_s: 5.0, end_s: 25.0 }])),
        ),
        (
            r#"{"segments": {"length_s": 20}}"#,
            Lines::Excited,
            Some(Segments::Length(LengthSegments { length_s: 20.0, start_s: 0.0 })),
        ),
    ] {
        let settings: FrequencySettings = serde_json::from_str(text).unwrap();
        assert_eq!((settings.lines.clone(), settings.segments.clone()), (lines, segments), "{text}");
        let checked = settings.check().unwrap();
        let canonical = serde_json::to_value(checked.settings()).unwrap();
        let again: FrequencySettings = serde_json::from_value(canonical).unwrap();
        assert_eq!(again.check().unwrap(), checked);
    }
    let error = serde_json::from_str::<FrequencySettings>(r#"{"segments": {"lenght_s": 20}}"#).unwrap_err();
    assert!(error.to_string().contains("segments are a list of"), "{error}");
}

#[test]
fn transforms_keep_their_precision_over_long_records() {
    // A million samples of an off-grid sinusoid against the closed form of the geometric sum.
    let n = 1_000_000;
    let cycles = 0.012_345_678_9;
    let x: Vec<f64> = (0..n).map(|i| (2.0 * PI * (0.1 * i as f64).fract()).cos()).collect();
    let found = direct_transform(&[&x], cycles)[0];
    let sum = |turns: f64| {
        let ratio = Complex64::from_polar(1.0, 2.0 * PI * turns);
        (1.0 - Complex64::from_polar(1.0, 2.0 * PI * (turns * n as f64).fract())) / (1.0 - ratio)
    };
    let expected = 0.5 * (sum(0.1 - cycles) + sum(-0.1 - cycles));
    assert!((found - expected).norm() < 1e-8, "{found} {expected}");
}

// ---- recordings

fn read_file(path: &Path) -> Trial {
    let file = std::fs::File::open(path).unwrap();
    csv::read(GzipReader::new(file), &Options::default()).unwrap().trial
}

#[test]
fn virtual_subjects_have_frequency_data_by_the_presets() {
    let folder = crate::virtual_subjects::folder();
    let mut counted = 0;
    for entry in std::fs::read_dir(&folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        if !name.ends_with(".csv.gz") {
            continue;
        }
        let (lines, count) =
            if name.starts_with("chirp80") { (Lines::Zhang2015Chapter3, 13) } else { (Lines::Zhang2015Chapter5, 31) };
        let found = estimate(&[&read_file(&path)], &FrequencySettings { lines, ..Default::default() }).unwrap();
        assert_eq!(found.data().h.len(), count, "{name}");
        assert!(codes(&found).contains(&"leakage"), "{name}: {:?}", found.warnings);
        assert!(!codes(&found).contains(&"command_without_power"), "{name}: {:?}", found.warnings);
        counted += 1;
    }
    assert_eq!(counted, 60);
}
