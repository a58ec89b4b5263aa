//! The largest value of `|N|²/|D|²` over a band, in closed form.

/// A quadratic `c0 + c1 x + c2 x²`.
pub(super) type Quadratic = [f64; 3];

fn value(q: &Quadratic, x: f64) -> f64 {
    q[0] + x * (q[1] + x * q[2])
}

/// The largest value of `N(x)/D(x)` over `[low, high]`, where D is positive.
///
/// The stationary points are the roots of the quadratic `N'D − ND'`, so it is the largest of at most four values
/// (for N linear in x this is the closed form `x* = −z² + √(z⁴ + a0² + 2 z² a0 − z² a1²)`).
pub(super) fn largest_ratio(n: &Quadratic, d: &Quadratic, low: f64, high: f64) -> f64 {
    let ratio = |x: f64| value(n, x) / value(d, x);
    let (a, half_b, c) = (n[2] * d[1] - n[1] * d[2], n[2] * d[0] - n[0] * d[2], n[1] * d[0] - n[0] * d[1]);
    let mut largest = ratio(low).max(ratio(high));
    let discriminant = half_b * half_b - a * c;
    if discriminant >= 0.0 {
        // The root without cancellation first, the other by the product of both.
        let q = -(half_b + discriminant.sqrt().copysign(half_b));
        for x in [q / a, c / q] {
            if x > low && x < high {
                largest = largest.max(ratio(x));
            }
        }
    }
    largest
}

#[cfg(test)]
mod tests {
    use super::super::roots::RootPair;
    use super::*;

    /// The largest value on a fine grid, which is below the supremum by at most its curvature.
    fn on_a_grid(n: &Quadratic, d: &Quadratic, low: f64, high: f64) -> f64 {
        (0..=200_000)
            .map(|i| low + (high - low) * f64::from(i) / 200_000.0)
            .map(|x| value(n, x) / value(d, x))
            .fold(0.0, f64::max)
    }

    #[test]
    fn agrees_with_a_fine_grid() {
        let numerators = [
            RootPair::None,
            RootPair::One(-3.0),
            RootPair::Two(-1.0, 0.4),
            RootPair::Complex { natural_frequency: 1.0, damping: 0.1 },
        ];
        let denominators = [
            RootPair::Two(-0.1, -25.0),
            RootPair::Complex { natural_frequency: 1.5, damping: 0.05 },
            RootPair::Complex { natural_frequency: 0.4, damping: -0.3 },
            RootPair::Complex { natural_frequency: 20.0, damping: 0.9 },
        ];
        let (low, high) = (0.04 * std::f64::consts::PI.powi(2), 0.64 * std::f64::consts::PI.powi(2));
        for n in numerators {
            for d in denominators {
                let exact = largest_ratio(&n.square(), &d.square(), low, high);
                let grid = on_a_grid(&n.square(), &d.square(), low, high);
                assert!(exact >= grid && exact <= grid * (1.0 + 1e-6), "{n:?}/{d:?}: {exact} and {grid}");
            }
        }
    }
}
