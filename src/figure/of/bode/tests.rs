use super::*;

fn polar(size: f64, degrees: f64) -> Option<Complex64> {
    Some(Complex64::from_polar(size, degrees.to_radians()))
}

#[test]
fn phases_go_on_across_half_turns_and_bands_follow_them() {
    let at = |frequency_hz: f64, degrees: f64, is_line: bool| At {
        frequency_hz,
        value: polar(1.0, degrees),
        magnitude: is_line.then_some([0.5, 2.0]),
        // As a report has them: around the argument, here beyond a half turn.
        phase_deg: is_line.then(|| {
            let own = polar(1.0, degrees).unwrap().arg().to_degrees();
            [own - 10.0, own + 10.0]
        }),
        is_line,
    };
    let estimate = Estimate {
        name: "own".into(),
        ink: Ink::First,
        is_by_lines: false,
        at: vec![at(0.1, -170.0, true), at(0.2, -250.0, false), at(0.3, -330.0, true), at(0.4, -400.0, true)],
    };
    let [gain, phase] = estimate.series();
    let close = |list: &[Option<f64>], expected: &[f64]| {
        assert_eq!(list.len(), expected.len());
        for (found, expected) in list.iter().zip(expected) {
            assert!((found.unwrap() - expected).abs() < 1e-9, "{list:?} {expected}");
        }
    };
    close(&phase[1].y, &[-170.0, -250.0, -330.0, -400.0]);
    assert_eq!(phase[0].x, [0.1, 0.3, 0.4]);
    close(&phase[0].low, &[-180.0, -340.0, -410.0]);
    close(&phase[0].high, &[-160.0, -320.0, -390.0]);
    close(&gain[0].low, &[-20.0 * 2f64.log10(); 3]);
    close(&gain[1].y, &[0.0; 4]);
}

#[test]
fn a_line_without_a_band_breaks_it() {
    let at = |frequency_hz: f64, magnitude| At {
        frequency_hz,
        value: polar(1.0, 0.0),
        magnitude,
        phase_deg: None,
        is_line: true,
    };
    let bands = [Some([0.5, 2.0]), None, Some([0.0, 2.0]), Some([0.5, 2.0])];
    let estimate = Estimate {
        name: "own".into(),
        ink: Ink::First,
        is_by_lines: false,
        at: bands.into_iter().zip([0.1, 0.2, 0.3, 0.4]).map(|(band, frequency)| at(frequency, band)).collect(),
    };
    let [gain, phase] = estimate.series();
    let is_there: Vec<bool> = gain[0].low.iter().map(Option::is_some).collect();
    // A band that reaches zero has no lower end in decibels.
    assert_eq!(is_there, [true, false, false, true]);
    assert_eq!((gain.len(), phase.len()), (2, 1));
}

#[test]
fn the_grid_holds_the_lines() {
    let lines = [0.0, 1.0, 3.0, 10.0];
    let found = grid(&lines);
    assert!(lines[1..].iter().all(|line| found.contains(line)) && !found.contains(&0.0));
    assert!(found.windows(2).all(|pair| pair[0] < pair[1]) && found.len() > 150);
    assert_eq!(grid(&[2.0]), [2.0]);
    assert_eq!(grid(&[]), [0.0; 0]);
}
