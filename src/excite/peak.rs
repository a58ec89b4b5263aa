//! Where a frequency response is largest.

use crate::control::bode::log_grid;

/// Points of the first look per decade.
const PER_DECADE: usize = 60;
/// Decades below the Nyquist frequency that are looked at.
const DECADES: f64 = 6.0;
/// The golden section's shrinking factor.
const GOLDEN: f64 = 0.618_033_988_749_894_8;
/// Steps of the golden section: the bracket shrinks to 1e-9 of itself.
const STEPS: usize = 45;

/// A maximum.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Peak {
    /// Where, rad/s (or in whatever unit the function takes).
    pub at: f64,
    /// The value there.
    pub value: f64,
}

/// The largest value of `f` between two points where it is unimodal, by golden section.
pub fn golden(f: impl FnMut(f64) -> f64, low: f64, high: f64) -> Peak {
    golden_in(f, low, high, STEPS)
}

/// [`golden`] with so many steps.
pub(super) fn golden_in(mut f: impl FnMut(f64) -> f64, mut low: f64, mut high: f64, steps: usize) -> Peak {
    let (mut a, mut b) = (high - GOLDEN * (high - low), low + GOLDEN * (high - low));
    let (mut fa, mut fb) = (f(a), f(b));
    for _ in 0..steps {
        if fa >= fb {
            (high, b, fb) = (b, a, fa);
            a = high - GOLDEN * (high - low);
            fa = f(a);
        } else {
            (low, a, fa) = (a, b, fb);
            b = low + GOLDEN * (high - low);
            fb = f(b);
        }
    }
    if fa >= fb { Peak { at: a, value: fa } } else { Peak { at: b, value: fb } }
}

/// The supremum of a gain over 0 … Nyquist (`h∞` of a stable sampled system), where `gain(ω)` is its magnitude.
///
/// The gain is looked at on a logarithmic grid and around `hints` (the angular frequencies of lightly damped poles,
/// with their decay rates), and every local maximum among these points is refined by golden section.
pub fn supremum(gain: impl Fn(f64) -> f64, nyquist_rad_s: f64, hints: &[[f64; 2]]) -> Peak {
    let points = grid(nyquist_rad_s, hints);
    let values: Vec<f64> = points.iter().map(|w| gain(*w)).collect();
    let mut best = Peak { at: 0.0, value: f64::NEG_INFINITY };
    for i in 0..points.len() {
        let lower = i.saturating_sub(1);
        let upper = (i + 1).min(points.len() - 1);
        if values[i] > best.value {
            best = Peak { at: points[i], value: values[i] };
        }
        if values[i] >= values[lower] && values[i] >= values[upper] {
            let refined = golden(&gain, points[lower], points[upper]);
            if refined.value > best.value {
                best = refined;
            }
        }
    }
    best
}

/// The resonance: the largest maximum of a gain strictly between 0 and Nyquist that exceeds the gain at 0 Hz; `None`
/// where there is none.
pub fn resonance(gain: impl Fn(f64) -> f64, nyquist_rad_s: f64, hints: &[[f64; 2]]) -> Option<Peak> {
    let at_zero = gain(0.0);
    let peak = supremum(&gain, nyquist_rad_s, hints);
    let inside = peak.at > 0.0 && peak.at < nyquist_rad_s * (1.0 - 1e-9);
    // A flat gain peaks nowhere; what exceeds it by rounding is no resonance.
    (inside && peak.value > at_zero * (1.0 + 1e-9)).then_some(peak)
}

/// Points of the first look, increasing: a logarithmic grid with 0, and around the hints.
pub(in crate::excite) fn grid(nyquist: f64, hints: &[[f64; 2]]) -> Vec<f64> {
    let count = (DECADES * PER_DECADE as f64) as usize;
    let mut points = log_grid(nyquist * 10_f64.powf(-DECADES), nyquist, count);
    points.push(0.0);
    for [omega, decay] in hints {
        for k in -4_i32..=4 {
            points.push(omega + 0.5 * f64::from(k) * decay);
        }
    }
    points.retain(|w| (0.0..=nyquist).contains(w));
    points.sort_by(f64::total_cmp);
    points.dedup();
    points
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_narrow_resonance_is_found_by_its_pole() {
        // |1/(ω0² − ω² + 2ζω0 jω)|·ω0², whose peak is 1/(2ζ√(1−ζ²)) at ω0√(1−2ζ²).
        for zeta in [0.3, 1e-2, 1e-4, 1e-6] {
            let w0: f64 = 29.9;
            let gain = |w: f64| w0 * w0 / ((w0 * w0 - w * w).powi(2) + (2.0 * zeta * w0 * w).powi(2)).sqrt();
            let found = resonance(gain, 3141.6, &[[w0 * (1.0_f64 - zeta * zeta).sqrt(), zeta * w0]]).unwrap();
            let expected = 0.5 / (zeta * (1.0_f64 - zeta * zeta).sqrt());
            assert!((found.value / expected - 1.0).abs() < 1e-6, "{zeta} {found:?}");
            assert!((found.at / (w0 * (1.0_f64 - 2.0 * zeta * zeta).sqrt()) - 1.0).abs() < 1e-6);
        }
        assert!(resonance(|w| 1.0 / (1.0 + w), 100.0, &[]).is_none());
        assert!(resonance(|_| 2.0, 100.0, &[]).is_none());
        assert_eq!(supremum(|w| 1.0 / (1.0 + w), 100.0, &[]), Peak { at: 0.0, value: 1.0 });
    }
}
