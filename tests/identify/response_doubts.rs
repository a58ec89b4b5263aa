//! Frequency responses: what is doubtful is named, what cannot be is refused.

use super::response::{
    DT, Filter, LINES, PERIOD, after_transient, between, codes, multisine, periodic_trial, trial, warning,
};
use std::f64::consts::PI;
use volition::ctl::{Ctl, StopReason};
use volition::response::{
    Bounds, Channels, CountSegments, FrequencyError, FrequencySettings, LengthSegments, Lines, Response, Segments,
    Stimulus, Transients, Window, estimate, estimate_between,
};

#[test]
fn lines_without_power_are_named() {
    let recording = periodic_trial();
    let settings = |lines: Vec<f64>| FrequencySettings {
        lines: Lines::FrequencyHz(lines),
        segments: Some(after_transient()),
        ..Default::default()
    };
    // 0.25 Hz is line 3, where there is nothing at all.
    let found = estimate(&[&recording], &settings(vec![2.0 / 12.0, 0.25])).unwrap();
    assert!(found.h[0].is_some() && found.h[1].is_none() && found.variance[1].is_none());
    assert!(warning(&found, "command_without_power").contains("no power at 0.25 Hz"));
    assert_eq!(found.data().h.len(), 1);
    let error = estimate(&[&recording], &settings(vec![0.25])).unwrap_err();
    assert!(matches!(error, FrequencyError::NoPower { trial: 0, other_has_power: false, .. }), "{error}");

    // A little power is not none, and is named too.
    let mut weak = recording.clone();
    for (i, r) in weak.signals.command.iter_mut().enumerate() {
        *r += 0.01 * (2.0 * PI * 3.0 * i as f64 / 600.0).sin();
    }
    let found = estimate(&[&weak], &settings(vec![2.0 / 12.0, 0.25])).unwrap();
    assert!(found.h[1].is_some());
    assert!(warning(&found, "command_without_power").contains("less than 0.001 of the power"));
}

#[test]
fn a_segment_without_power_is_named() {
    // The second half of the record lacks line 5.
    let mut r = multisine(&[2, 5], 600, 600);
    r.extend(multisine(&[2], 600, 600));
    let recording = trial(DT, r.clone(), r, None);
    let lines = Lines::FrequencyHz(vec![2.0 / 12.0, 5.0 / 12.0]);
    let segments = Some(Segments::Count(CountSegments { count: 2 }));
    let transients = Some(Transients::Keep);
    let settings = FrequencySettings { lines, segments, transients, ..Default::default() };
    let found = estimate(&[&recording], &settings).unwrap();
    // There the power is nil, so its ratio is left out of the mean.
    assert_eq!(found.averages, [2, 1]);
    assert_eq!(found.variance[1], None);
    assert!(warning(&found, "variance_unknown").contains("only one segment has power"));
    let mut weak = recording.clone();
    for (i, r) in weak.signals.command.iter_mut().enumerate().skip(600) {
        *r += 1e-4 * (2.0 * PI * 5.0 * i as f64 / 600.0).sin();
    }
    let found = estimate(&[&weak], &settings).unwrap();
    assert!(warning(&found, "command_without_power").contains("in segment 2 the command has less"));
}

#[test]
fn a_trial_that_informs_only_the_disturbance_response_says_so() {
    let good = periodic_trial();
    let d = multisine(&LINES, PERIOD, 5 * PERIOD);
    let silent = trial(DT, vec![0.0; d.len()], Filter::LOOP.run(&d), Some(d));
    for lines in [Lines::Excited, Lines::FrequencyHz(vec![2.0 / 12.0])] {
        let settings = FrequencySettings { lines, segments: Some(after_transient()), ..Default::default() };
        let error = estimate(&[&good, &silent], &settings).unwrap_err();
        assert!(matches!(error, FrequencyError::NoPower { trial: 1, other_has_power: true, .. }), "{error}");
        assert!(error.to_string().contains("this trial informs only the response to the disturbance"), "{error}");
        let channels = Channels { input: Stimulus::Disturbance, output: Response::Output };
        let found = between(&[&silent], &settings, channels).unwrap();
        assert!((found.h[0].unwrap() - Filter::LOOP.response(2.0 / 12.0, DT)).norm() < 1e-9);
        let error = between(&[&good], &settings, channels).unwrap_err();
        assert_eq!(error, FrequencyError::NoDisturbance { trial: 0 });
    }
    // A command that stands still excites nothing, either.
    let constant = trial(DT, vec![3.0; 600], vec![3.0; 600], None);
    let error = estimate(&[&constant], &FrequencySettings::default()).unwrap_err();
    assert!(matches!(error, FrequencyError::NoPower { other_has_power: false, .. }), "{error}");
}

#[test]
fn shared_lines_leakage_and_close_lines_are_named() {
    let r = multisine(&LINES, PERIOD, 2 * PERIOD);
    let d = multisine(&[5], PERIOD, 2 * PERIOD);
    let recording = trial(DT, r.clone(), r.clone(), Some(d));
    let whole = Some(Segments::Bounds(vec![Bounds { start_s: 0.0, end_s: 12.0 }]));
    let settings = FrequencySettings { segments: whole.clone(), ..Default::default() };
    let found = estimate(&[&recording], &settings).unwrap();
    assert!(warning(&found, "other_stimulus_on_line").contains("disturbance has power at 0.416667 Hz"));
    assert!(!codes(&found).contains(&"leakage"));

    let lines = Lines::FrequencyHz(vec![0.2, 0.21]);
    let settings = FrequencySettings { lines, segments: whole, ..Default::default() };
    let error = estimate(&[&recording], &settings).unwrap_err();
    assert!(matches!(error, FrequencyError::LinesTooClose { line: 1, named: true, windowed: false, .. }), "{error}");

    // Segments that are no whole period.
    let segments = Some(Segments::Length(LengthSegments { length_s: 10.0, start_s: 0.0 }));
    let kept = FrequencySettings { segments, transients: Some(Transients::Keep), ..Default::default() };
    let filtered = trial(DT, r.clone(), Filter::LOOP.run(&r), None);
    let found = estimate(&[&filtered], &kept).unwrap();
    assert!(warning(&found, "leakage").contains("transients"));
    assert!(warning(&found, "segment_truncated").contains("last 4 s"));
    let lines = Lines::FrequencyHz(vec![0.2, 0.4]);
    let hann = FrequencySettings { window: Window::Hann, lines, transients: None, ..kept };
    let hann = estimate(&[&recording], &hann).unwrap();
    assert!((hann.noise_bandwidth_hz - 0.15).abs() < 1e-12 && (hann.resolution_hz - 0.1).abs() < 1e-12);
}

#[test]
fn what_cannot_be_is_refused() {
    let recording = periodic_trial();
    let refused = |settings: FrequencySettings| estimate(&[&recording], &settings).unwrap_err();
    let at = |frequency| FrequencySettings { lines: Lines::FrequencyHz(vec![frequency]), ..Default::default() };
    assert!(matches!(refused(at(25.0)), FrequencyError::LineAboveNyquist { line: 0, nyquist_hz: 25.0, .. }));
    assert!(matches!(refused(at(-1.0)), FrequencyError::Settings(_)));
    let segments = |segments| FrequencySettings { segments: Some(segments), ..Default::default() };
    let long = segments(Segments::Length(LengthSegments { length_s: 61.0, start_s: 0.0 }));
    assert!(matches!(refused(long), FrequencyError::SegmentOutside { .. }));
    assert!(matches!(
        refused(segments(Segments::Count(CountSegments { count: 2000 }))),
        FrequencyError::SegmentTooShort { samples: 1, .. }
    ));
    let unequal = vec![Bounds { start_s: 0.0, end_s: 12.0 }, Bounds { start_s: 12.0, end_s: 36.0 }];
    assert!(matches!(
        refused(segments(Segments::Bounds(unequal))),
        FrequencyError::UnequalSegments { segment: 1, samples: 1200, first: 600, .. }
    ));
    let outside_band = FrequencySettings { band_hz: Some([5.0, 6.0]), ..segments(after_transient()) };
    assert!(matches!(refused(outside_band), FrequencyError::NothingExcited { band_hz: Some([5.0, 6.0]), .. }));
    assert_eq!(estimate(&[], &FrequencySettings::default()).unwrap_err(), FrequencyError::NoTrial);
    let other = trial(0.021, vec![1.0; 100], vec![1.0; 100], None);
    let error = estimate(&[&recording, &other], &FrequencySettings::default()).unwrap_err();
    assert!(matches!(error, FrequencyError::SampleTimesDiffer { trial: 1, .. }), "{error}");
    let ctl = Ctl::new();
    ctl.stop(StopReason::Deadline);
    let settings = FrequencySettings::default().check().unwrap();
    let stopped = estimate_between(&[&recording], &settings, Channels::default(), &ctl).unwrap_err();
    assert!(matches!(stopped, FrequencyError::Stopped(_)));
}

#[test]
fn trials_are_averaged_whatever_the_sign_and_size_of_their_command() {
    let base = periodic_trial();
    let flipped = trial(
        DT,
        base.signals.command.iter().map(|r| -2.0 * r).collect(),
        base.signals.output.iter().map(|y| -2.0 * y).collect(),
        None,
    );
    let settings = FrequencySettings { segments: Some(after_transient()), ..Default::default() };
    let found = estimate(&[&base, &flipped], &settings).unwrap();
    assert_eq!(found.averages, [6; 6]);
    assert_eq!(found.segments.iter().filter(|s| s.trial == 1).count(), 3);
    for (f, h) in found.frequency_hz.iter().zip(&found.h) {
        assert!((h.unwrap() - Filter::LOOP.response(*f, DT)).norm() < 1e-9);
    }
    // Powers 1 and 4 average to 2.5 times that of the first.
    assert!((found.input_power[0] - 2.5 / 8.0).abs() < 1e-12);
    assert!((found.input_power_minimum[0] - 1.0 / 8.0).abs() < 1e-12);
}
