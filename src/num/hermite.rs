//! Gauss–Hermite quadrature.

/// Newton steps for one node; a handful suffices.
const STEPS: usize = 100;

/// Nodes and weights with `∫ e^{−t²} f(t) dt ≈ Σ wᵢ f(tᵢ)`, exact for polynomials of a degree below 2n (Press et al.
/// 2007, section 4.6: Newton's method on the normalised Hermite function). Nodes fall.
///
/// Good for n up to some 150, where the outermost weights vanish.
pub(crate) fn nodes(n: usize) -> Vec<(f64, f64)> {
    let size = n as f64;
    let mut found = vec![(0.0, 0.0); n];
    let mut z = 0.0_f64;
    for i in 0..n.div_ceil(2) {
        z = match i {
            0 => (2.0 * size + 1.0).sqrt() - 1.855_75 * (2.0 * size + 1.0).powf(-1.0 / 6.0),
            1 => z - 1.14 * size.powf(0.426) / z,
            2 => 1.86 * z - 0.86 * found[0].0,
            3 => 1.91 * z - 0.91 * found[1].0,
            _ => 2.0 * z - found[i - 2].0,
        };
        let mut slope = 1.0;
        for _ in 0..STEPS {
            let (mut p1, mut p2) = (std::f64::consts::PI.powf(-0.25), 0.0);
            for j in 0..n {
                let j = j as f64;
                (p1, p2) = (z * (2.0 / (j + 1.0)).sqrt() * p1 - (j / (j + 1.0)).sqrt() * p2, p1);
            }
            slope = (2.0 * size).sqrt() * p2;
            let step = p1 / slope;
            z -= step;
            if step.abs() < 1e-15 * (1.0 + z.abs()) {
                break;
            }
        }
        let weight = 2.0 / (slope * slope);
        found[i] = (z, weight);
        found[n - 1 - i] = (-z, weight);
    }
    found
}

#[cfg(test)]
mod tests {
    use super::nodes;

    /// `∫ e^{−t²} t^{2m} dt = Γ(m + ½)`.
    #[test]
    fn moments_are_exact() {
        for n in [1, 2, 7, 31, 61] {
            let rule = nodes(n);
            let mut exact = std::f64::consts::PI.sqrt();
            for m in 0..n.min(20) {
                let sum: f64 = rule.iter().map(|(t, w)| w * t.powi(2 * m as i32)).sum();
                assert!((sum / exact - 1.0).abs() < 1e-12, "{n} nodes, power {}: {sum} {exact}", 2 * m);
                exact *= m as f64 + 0.5;
            }
            assert!(rule.windows(2).all(|pair| pair[0].0 > pair[1].0), "{n}");
        }
    }
}
