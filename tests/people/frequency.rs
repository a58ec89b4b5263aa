//! The lines of the commands and the disturbances are found in the recordings.

use crate::recordings::{folder, read};
use volition::ctl::Ctl;
use volition::response::{
    Bounds, Channels, FrequencyError, FrequencySettings, Response, Segments, Stimulus, estimate_between,
};

#[test]
fn the_lines_of_the_people_experiment_are_found() {
    let folder = folder();
    let primes = [2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31_usize];
    // Interleaved sets: every other prime, from the first (E) and from the second (O); A is both.
    let set = |name: char, plant: &str| -> Vec<usize> {
        let highest = if plant == "1/s" { 31 } else { 17 };
        let wanted = |i: usize| match name {
            'E' => i.is_multiple_of(2),
            'O' => !i.is_multiple_of(2),
            _ => true,
        };
        primes.iter().enumerate().filter(|(i, k)| wanted(*i) && **k <= highest).map(|(_, k)| *k).collect()
    };
    let settings = FrequencySettings {
        segments: Some(Segments::Bounds(vec![
            Bounds { start_s: 5.0, end_s: 25.0 },
            Bounds { start_s: 25.0, end_s: 45.0 },
        ])),
        ..Default::default()
    };
    let settings = settings.check().unwrap();
    let index = std::fs::read_to_string(folder.join("index.csv")).unwrap();
    let (mut estimated, mut silent) = (0, 0);
    for row in index.lines().skip(1) {
        let cells: Vec<&str> = row.split(',').collect();
        let (file, plant, reference, disturbance) = (cells[0], cells[4], cells[5], cells[6]);
        let recording = read(&folder.join(file)).trial;
        for (stimulus, name) in [(Stimulus::Command, reference), (Stimulus::Disturbance, disturbance)] {
            let channels = Channels { input: stimulus, output: Response::Output };
            let found = estimate_between(&[&recording], &settings, channels, &Ctl::new());
            if name.ends_with("zer") {
                let error = found.unwrap_err();
                assert!(matches!(error, FrequencyError::NoPower { other_has_power: true, .. }), "{file}: {error}");
                silent += 1;
                continue;
            }
            let found = found.unwrap_or_else(|error| panic!("{file}: {error}"));
            let lines: Vec<usize> = found.frequency_hz.iter().map(|f| (f / 0.05).round() as usize).collect();
            assert_eq!(lines, set(name.chars().last().unwrap(), plant), "{file} {name}");
            assert!(found.frequency_hz.iter().all(|f| ((f / 0.05).round() * 0.05 - f).abs() < 1e-6));
            let codes: Vec<_> = found.warnings.iter().map(|warning| warning.code).collect();
            // What transients leave, and lines that they drown, are told of each recording.
            assert!(codes.contains(&"few_averages"), "{file}: {:?}", found.warnings);
            let told = ["leakage", "line_not_usable", "few_averages"];
            assert!(codes.iter().all(|code| told.contains(code)), "{file}: {:?}", found.warnings);
            assert!(found.h.iter().all(|h| h.unwrap().is_finite()) && found.variance.iter().all(Option::is_some));
            estimated += 1;
        }
    }
    assert_eq!(estimated + silent, 240);
    assert!(silent > 0 && estimated > 120);
}
