//! The noncentral t distribution: that of an effect size, and of the power of a t test.

use super::distributions::{ln_gamma, normal_cdf};
use super::roots::root;

/// Nodes in (0, 1) and weights of the 16-point Gauss–Legendre rule on (−1, 1), symmetric (standard tables).
const GAUSS_LEGENDRE: [(f64, f64); 8] = [
    (0.095_012_509_837_637_44, 0.189_450_610_455_068_5),
    (0.281_603_550_779_258_9, 0.182_603_415_044_923_6),
    (0.458_016_777_657_227_4, 0.169_156_519_395_002_54),
    (0.617_876_244_402_643_7, 0.149_595_988_816_576_73),
    (0.755_404_408_355_003, 0.124_628_971_255_533_87),
    (0.865_631_202_387_831_7, 0.095_158_511_682_492_78),
    (0.944_575_023_073_232_6, 0.062_253_523_938_647_894),
    (0.989_400_934_991_649_9, 0.027_152_459_411_754_095),
];

/// How many standard deviations around a bend of the integrand are cut into pieces of one.
const REACH: i32 = 9;

/// `P(T ≤ t)` for `T = (Z + δ)/S`, Z standard normal and `ν S²` chi-square with ν degrees of freedom:
/// `∫ Φ(t s − δ) f_S(s) ds`, to about 1e-13.
///
/// The integrand bends where the density of S has its mode (width `1/√(2ν)`) and where `t s = δ` (width `1/|t|`); the
/// range is cut there, and every piece is smooth.
pub(crate) fn cdf(t: f64, degrees: f64, noncentrality: f64) -> f64 {
    let nu = degrees;
    let constant = std::f64::consts::LN_2 + 0.5 * nu * (0.5 * nu).ln() - ln_gamma(0.5 * nu);
    let density = |s: f64| (constant + (nu - 1.0) * s.ln() - 0.5 * nu * s * s).exp();
    // Beyond: a chi-square above ν + 10√(2ν) + 100, which has no probability in double precision.
    let end = ((nu + 10.0 * (2.0 * nu).sqrt() + 100.0) / nu).sqrt();
    let mut cuts = vec![0.0, end];
    let mut around = |centre: f64, width: f64| {
        cuts.extend((-REACH..=REACH).map(|j| centre + f64::from(j) * width).filter(|s| *s > 0.0 && *s < end));
    };
    around(1.0, 1.0 / (2.0 * nu).sqrt());
    if t != 0.0 {
        around(noncentrality / t, 1.0 / t.abs());
    }
    cuts.sort_by(f64::total_cmp);
    let piece = |pair: &[f64]| {
        let (centre, half) = (0.5 * (pair[0] + pair[1]), 0.5 * (pair[1] - pair[0]));
        let at = |s: f64| normal_cdf(t * s - noncentrality) * density(s);
        half * GAUSS_LEGENDRE.iter().map(|(x, w)| w * (at(centre - half * x) + at(centre + half * x))).sum::<f64>()
    };
    cuts.windows(2).filter(|pair| pair[1] > pair[0]).map(piece).sum::<f64>().clamp(0.0, 1.0)
}

/// The δ for which `P(T ≤ t) = p`; the limits of an interval of δ are those of p = 0.975 and 0.025.
pub(crate) fn noncentrality(t: f64, degrees: f64, p: f64) -> Option<f64> {
    // P falls with δ. The spread of T grows with |t|/√ν.
    let step = 1.0 + t.abs() / (2.0 * degrees).sqrt();
    let f = |delta: f64| cdf(t, degrees, delta) - p;
    let (mut low, mut high) = (t, t);
    for _ in 0..100 {
        if f(low) > 0.0 {
            break;
        }
        low -= step;
    }
    for _ in 0..100 {
        if f(high) < 0.0 {
            break;
        }
        high += step;
    }
    root(f, low, high)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::num::distributions::student_t_two_sided;

    /// With δ = 0 it is Student's distribution, at t = 0 it is Φ(−δ) for any ν; the rest is compared with the same
    /// integral in 30 digits (mpmath 1.3) and with `scipy.stats.nct.cdf`, which agree to 14.
    #[test]
    fn special_cases_and_values_of_another_program() {
        for nu in [1.0, 2.0, 5.0, 20.0, 200.0] {
            for t in [0.1, 1.0, 3.0] {
                let expected = 1.0 - 0.5 * student_t_two_sided(t, nu);
                assert!((cdf(t, nu, 0.0) - expected).abs() < 1e-12, "{nu} {t}");
                assert!((cdf(-t, nu, 0.0) - (1.0 - expected)).abs() < 1e-12, "{nu} {t}");
                // P(T ≤ t | δ) = 1 − P(T ≤ −t | −δ).
                assert!((cdf(t, nu, 1.7) + cdf(-t, nu, -1.7) - 1.0).abs() < 1e-12, "{nu} {t}");
            }
            assert!((cdf(0.0, nu, 1.3) - normal_cdf(-1.3)).abs() < 1e-12, "{nu}");
        }
        for (t, nu, delta, expected) in [
            (2.5, 4.0, 1.0, 0.848_112_399_755_286_9),
            (6.0, 20.0, 4.5, 0.850_324_469_105_952_3),
            (0.8, 10.0, -1.0, 0.960_250_833_293_811_1),
            (30.0, 3.0, 20.0, 0.720_708_965_721_581_3),
            (1.0, 1.0, 2.0, 0.151_113_446_915_623),
            (3.2, 1000.0, 3.0, 0.578_747_737_410_546_3),
        ] {
            assert!((cdf(t, nu, delta) - expected).abs() < 1e-12, "{t} {nu} {delta}");
        }
    }

    #[test]
    fn the_noncentrality_is_the_inverse() {
        for (t, nu) in [(0.3, 4.0), (-2.0, 20.0), (12.0, 20.0), (400.0, 4.0)] {
            for p in [0.025, 0.5, 0.975] {
                let delta = noncentrality(t, nu, p).unwrap();
                assert!((cdf(t, nu, delta) - p).abs() < 1e-11, "{t} {nu} {p}");
            }
        }
    }
}
