//! Time columns: rounding passes, every defect is named with its place.

use super::readers::{defect, with_times};
use volition::trial::{Signals, TimeDefect, Trial, TrialError};

fn printed(rate_hz: f64, decimals: i32, samples: usize, offset_s: f64) -> Vec<f64> {
    let unit = 10_f64.powi(decimals);
    (0..samples).map(|i| ((offset_s + i as f64 / rate_hz) * unit).round() / unit).collect()
}

#[test]
fn rounding_of_the_time_column_passes() {
    for (rate, decimals, samples, offset) in [
        (60.0, 5, 2702, 0.0),
        (60.0, 3, 2702, 0.0),
        (500.0, 3, 40_001, 0.0),
        (500.0, 3, 40_001, 0.0003),
        (1000.0 / 3.0, 3, 20_000, 0.0),
        (50.0, 2, 3001, 12.34),
        (144.0, 4, 5000, 0.1),
        (1.0, 0, 100, 0.0),
        (100.0, 6, 1000, 1_700_000_000.0),
        (60.0, 5, 20, 0.0),
    ] {
        let times = printed(rate, decimals, samples, offset);
        let trial = with_times(&times).unwrap_or_else(|error| panic!("{rate} Hz, {decimals} decimals: {error}"));
        let drift = (trial.sample_time_s - 1.0 / rate).abs() * samples as f64;
        assert!(drift <= 1.01 * 10_f64.powi(-decimals) + 1e-6, "{rate} Hz: {}", trial.sample_time_s);
    }
    // Computed, not printed.
    let computed: Vec<f64> = (0..5000).map(|i| f64::from(i) * 0.002).collect();
    assert!((with_times(&computed).unwrap().sample_time_s - 0.002).abs() < 1e-15);
}

#[test]
fn a_given_sample_time_settles_what_rounding_left_open() {
    let times = printed(60.0, 5, 2702, 0.0);
    let signals = |times: Vec<f64>| Signals {
        command: vec![0.0; times.len()],
        control: vec![0.0; times.len()],
        output: vec![0.0; times.len()],
        time_s: Some(times),
        disturbance: None,
    };
    let trial = Trial::from_signals(Some(1.0 / 60.0), signals(times.clone())).unwrap();
    assert_eq!(trial.sample_time_s, 1.0 / 60.0);
    let error = Trial::from_signals(Some(0.01667), signals(times)).unwrap_err();
    assert!(matches!(error, TrialError::Time(TimeDefect::Disagrees { .. })), "{error}");
}

#[test]
fn defects_of_the_time_column_are_found_on_every_kind_of_grid() {
    for times in [printed(60.0, 5, 2702, 0.0), printed(500.0, 3, 4000, 0.0), printed(50.0, 3, 3001, 5.0)] {
        let step = times[1] - times[0];
        let edit = |change: &dyn Fn(&mut Vec<f64>)| {
            let mut edited = times.clone();
            change(&mut edited);
            defect(&edited)
        };
        assert!(matches!(edit(&|t| t.swap(700, 701)), TimeDefect::Reversed { sample: 701, .. }));
        assert!(matches!(edit(&|t| t[700] = t[699]), TimeDefect::Repeated { sample: 700, .. }));
        assert!(matches!(edit(&|t| t.retain(|x| *x != times[700])), TimeDefect::Gap { sample: 700, missing: 1, .. }));
        assert!(matches!(edit(&|t| drop(t.drain(700..900))), TimeDefect::Gap { sample: 700, missing: 200, .. }));
        for jitter in [0.03, -0.1, 0.45, 0.7] {
            // Printed as finely as needed to hold the jitter.
            let found = edit(&|t| t[700] += jitter * step);
            let TimeDefect::Jitter { sample: 700, rows: 1, deviation_s, .. } = found else {
                panic!("{jitter}: {found}")
            };
            assert!((deviation_s - jitter * step).abs() < 2e-5, "{deviation_s}");
        }
        // The first and the last row are not above suspicion.
        assert!(matches!(edit(&|t| t[0] -= 0.2 * step), TimeDefect::Jitter { sample: 0, rows: 1, .. }));
        let last = times.len() - 1;
        let found = edit(&|t| t[last] += 0.2 * step);
        assert!(matches!(found, TimeDefect::Jitter { sample, rows: 1, .. } if sample == last), "{found}");
        let reversed: Vec<f64> = times.iter().rev().copied().collect();
        assert!(matches!(defect(&reversed), TimeDefect::Reversed { sample: 1, .. }));
    }
}

#[test]
fn jitter_below_two_percent_passes_and_above_does_not() {
    let jittered = |share: f64| -> Vec<f64> {
        (0..1000).map(|i| (f64::from(i) + if i % 7 == 3 { share } else { 0.0 }) * 0.01).collect()
    };
    assert_eq!(with_times(&jittered(0.019)).map(|trial| trial.samples()).ok(), Some(1000));
    assert!(matches!(defect(&jittered(0.021)), TimeDefect::Jitter { sample: 3, rows: 143, .. }));
}

#[test]
fn a_slow_clock_change_is_no_uniform_grid() {
    let chirped: Vec<f64> = (0..2000).map(|i| 0.01 * f64::from(i) + 1e-7 * f64::from(i).powi(2)).collect();
    assert!(matches!(defect(&chirped), TimeDefect::Jitter { .. }));
}

#[test]
fn a_column_too_coarse_to_judge_says_so() {
    let times = printed(70.0, 2, 500, 0.0);
    assert!(matches!(defect(&times), TimeDefect::TooCoarse { .. } | TimeDefect::Repeated { .. }), "{}", defect(&times));
    assert!(matches!(defect(&printed(1000.0, 2, 500, 0.0)), TimeDefect::Repeated { sample: 1, .. }));
}

#[test]
fn extreme_times_are_refused_without_panic() {
    for times in [[-1e308, 1e308], [0.0, f64::MIN_POSITIVE / 4.0], [-1.7e308, 1.7e308]] {
        assert!(matches!(defect(&times), TimeDefect::NoSpan { .. }), "{times:?}");
    }
    assert!(matches!(
        defect(&[0.0, 1e-3, 1e300]),
        TimeDefect::Gap { missing: u64::MAX.., .. } | TimeDefect::Gap { .. }
    ));
}
