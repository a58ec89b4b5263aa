//! Roots of a function of one variable.

/// Ridders's method halves the bracket at least every step, so that this many reach any double.
const STEPS: usize = 200;

/// Whether the signs differ; a product would vanish where both are tiny.
fn differ(a: f64, b: f64) -> bool {
    a > 0.0 && b < 0.0 || a < 0.0 && b > 0.0
}

/// A root of `f` between two points where its signs differ, to rounding (Ridders 1979); `None` where they do not, or
/// where a value is not a number.
pub(crate) fn root(f: impl Fn(f64) -> f64, low: f64, high: f64) -> Option<f64> {
    let (mut a, mut b) = (low, high);
    let (mut at_a, mut at_b) = (f(a), f(b));
    for (x, value) in [(a, at_a), (b, at_b)] {
        if value == 0.0 {
            return Some(x);
        }
    }
    if !differ(at_a, at_b) {
        return None;
    }
    for _ in 0..STEPS {
        let middle = 0.5 * (a + b);
        if (b - a).abs() <= 2.0 * f64::EPSILON * middle.abs() || middle == a || middle == b {
            break;
        }
        let at_middle = f(middle);
        if at_middle == 0.0 {
            return Some(middle);
        }
        if at_middle.is_nan() {
            return None;
        }
        let size = at_middle.abs().max(at_a.abs()).max(at_b.abs());
        let (m, p, q) = (at_middle / size, at_a / size, at_b / size);
        let guess = middle + (middle - a) * (p - q).signum() * m / (m * m - p * q).sqrt();
        let at_guess = f(guess);
        if at_guess == 0.0 {
            return Some(guess);
        }
        // Of the four points, the two neighbours with different signs.
        let mut points = [(a, at_a), (middle, at_middle), (guess, at_guess), (b, at_b)];
        if (guess < middle) == (a < b) {
            points.swap(1, 2);
        }
        let Some(pair) = points.windows(2).find(|pair| differ(pair[0].1, pair[1].1)) else { break };
        ((a, at_a), (b, at_b)) = (pair[0], pair[1]);
    }
    Some(if at_a.abs() < at_b.abs() { a } else { b })
}

#[cfg(test)]
mod tests {
    use super::root;

    #[test]
    fn roots_are_found_to_rounding_and_only_where_the_signs_differ() {
        assert!((root(|x| x * x - 2.0, 0.0, 2.0).unwrap() - 2.0_f64.sqrt()).abs() < 1e-15);
        assert!((root(|x| (x - 1e-9).powi(3), -1.0, 2.0).unwrap() - 1e-9).abs() < 1e-6);
        assert!((root(|x: f64| 1.0 - x.exp(), 3.0, -4.0).unwrap()).abs() < 1e-15);
        assert!((root(|x: f64| x.signum() - 1e-3, -1.0, 7.0).unwrap()).abs() < 1e-15);
        assert!((root(|x| 1e-200 * (x - 0.3), 0.0, 1.0).unwrap() - 0.3).abs() < 1e-15);
        assert_eq!(root(|x| x, 0.0, 1.0), Some(0.0));
        assert_eq!(root(|x| x * x + 1.0, -1.0, 1.0), None);
        assert_eq!(root(|_| f64::NAN, -1.0, 1.0), None);
    }
}
