//! Distribution functions of normal-theory statistics, from the incomplete gamma and beta functions (Press et al. 2007,
//! ch. 6).

use super::roots::root;

/// The bound z with `P(|X| ≤ z) = 0.95` of the standard normal distribution.
pub(crate) const NORMAL_95: f64 = 1.959_963_984_540_054;

/// Lanczos's series for `ln Γ(x)`, x > 0, good to about 1e-14 (g = 7, nine terms; Godfrey 2001).
#[must_use]
pub(crate) fn ln_gamma(x: f64) -> f64 {
    const TERMS: [f64; 8] = [
        676.520_368_121_885_1,
        -1_259.139_216_722_402_8,
        771.323_428_777_653_1,
        -176.615_029_162_140_6,
        12.507_343_278_686_905,
        -0.138_571_095_265_720_12,
        9.984_369_578_019_572e-6,
        1.505_632_735_149_311_6e-7,
    ];
    if x < 0.5 {
        // Reflection: Γ(x) Γ(1 − x) = π / sin πx.
        return (std::f64::consts::PI / (std::f64::consts::PI * x).sin()).ln() - ln_gamma(1.0 - x);
    }
    let x = x - 1.0;
    let sum: f64 =
        TERMS.iter().enumerate().fold(0.999_999_999_999_809_9, |sum, (i, term)| sum + term / (x + i as f64 + 1.0));
    let t = x + 7.5;
    0.5 * (2.0 * std::f64::consts::PI).ln() + (x + 0.5) * t.ln() - t + sum.ln()
}

/// The regularised lower incomplete gamma function `P(a, x)`, a > 0, x ≥ 0.
#[must_use]
pub(crate) fn gamma_p(a: f64, x: f64) -> f64 {
    if x <= 0.0 {
        return 0.0;
    }
    let lead = (a * x.ln() - x - ln_gamma(a)).exp();
    if x < a + 1.0 {
        let (mut term, mut sum, mut n) = (1.0 / a, 1.0 / a, a);
        for _ in 0..10_000 {
            n += 1.0;
            term *= x / n;
            sum += term;
            if term < 1e-17 * sum {
                break;
            }
        }
        lead * sum
    } else {
        // The continued fraction of Q by Lentz's method.
        let fraction = lentz(x + 1.0 - a, |i| (-i * (i - a), x + 2.0 * i + 1.0 - a));
        1.0 - lead / fraction
    }
}

/// The regularised incomplete beta function `I_x(a, b)`, a, b > 0, 0 ≤ x ≤ 1.
#[must_use]
pub(crate) fn beta_i(a: f64, b: f64, x: f64) -> f64 {
    if x <= 0.0 {
        return 0.0;
    }
    if x >= 1.0 {
        return 1.0;
    }
    if x > (a + 1.0) / (a + b + 2.0) {
        return 1.0 - beta_i(b, a, 1.0 - x);
    }
    let lead = (ln_gamma(a + b) - ln_gamma(a) - ln_gamma(b) + a * x.ln() + b * (-x).ln_1p()).exp();
    let fraction = lentz(1.0, |i| {
        let m = (i / 2.0).floor();
        let numerator = if (i as u64).is_multiple_of(2) {
            m * (b - m) * x / ((a + i - 1.0) * (a + i))
        } else {
            -(a + m) * (a + b + m) * x / ((a + i - 1.0) * (a + i))
        };
        (numerator, 1.0)
    });
    lead / (a * fraction)
}

/// `b₀ + a₁/(b₁ + a₂/(b₂ + …))` by the modified method of Lentz; `term(i)` gives `(aᵢ, bᵢ)`.
fn lentz(first: f64, term: impl Fn(f64) -> (f64, f64)) -> f64 {
    const TINY: f64 = 1e-300;
    let safe = |v: f64| if v.abs() < TINY { TINY } else { v };
    let mut f = safe(first);
    let (mut c, mut d) = (f, 0.0);
    for i in 1..10_000 {
        let (a, b) = term(f64::from(i));
        d = 1.0 / safe(b + a * d);
        c = safe(b + a / c);
        f *= c * d;
        if (c * d - 1.0).abs() < 1e-16 {
            break;
        }
    }
    f
}

/// `P(X ≤ x)` of chi-square with these degrees of freedom.
#[must_use]
pub(crate) fn chi_square_cdf(x: f64, degrees: f64) -> f64 {
    gamma_p(0.5 * degrees, 0.5 * x)
}

/// `P(X ≤ x)` of Fisher's F; infinite degrees of the denominator give chi-square over its degrees.
#[must_use]
pub fn f_cdf(x: f64, numerator: f64, denominator: f64) -> f64 {
    if denominator.is_infinite() {
        return chi_square_cdf(x * numerator, numerator);
    }
    beta_i(0.5 * numerator, 0.5 * denominator, numerator * x / (numerator * x + denominator))
}

/// `P(X ≤ x)` of the standard normal distribution.
#[must_use]
pub(crate) fn normal_cdf(x: f64) -> f64 {
    0.5 * (1.0 + gamma_p(0.5, 0.5 * x * x).copysign(x))
}

/// `P(|X| ≥ |t|)` of Student's distribution: the two-sided p-value of a t statistic.
#[must_use]
pub(crate) fn student_t_two_sided(t: f64, degrees: f64) -> f64 {
    beta_i(0.5 * degrees, 0.5, degrees / (degrees + t * t))
}

/// The x with `P(X ≤ x) = p` of chi-square, 0 < p < 1.
#[must_use]
pub(crate) fn chi_square_quantile(p: f64, degrees: f64) -> f64 {
    let mut high = degrees.max(1.0);
    while chi_square_cdf(high, degrees) < p && high < 1e12 {
        high *= 2.0;
    }
    root(|x| chi_square_cdf(x, degrees) - p, 0.0, high).unwrap_or(high)
}

/// The x with `I_x(a, b) = p`, 0 < p < 1.
#[must_use]
pub(crate) fn beta_quantile(p: f64, a: f64, b: f64) -> f64 {
    root(|x| beta_i(a, b, x) - p, 0.0, 1.0).unwrap_or(f64::NAN)
}

/// The x with `P(X ≤ x) = p` of Fisher's F, 0 < p < 1, both degrees finite: with `I_y(a/2, b/2) = p`, `x = b y/(a (1 −
/// y))`.
#[must_use]
pub(crate) fn f_quantile(p: f64, numerator: f64, denominator: f64) -> f64 {
    let y = beta_quantile(p, 0.5 * numerator, 0.5 * denominator);
    denominator * y / (numerator * (1.0 - y))
}

/// The two-sided bound t of Student's distribution: `P(|X| ≤ t) = level`; infinite degrees give the normal one.
#[must_use]
pub(crate) fn student_t(level: f64, degrees: f64) -> f64 {
    let inside = |t: f64| {
        if degrees.is_infinite() {
            gamma_p(0.5, 0.5 * t * t)
        } else {
            1.0 - beta_i(0.5 * degrees, 0.5, degrees / (degrees + t * t))
        }
    };
    let mut high = 1.0;
    while inside(high) < level && high < 1e12 {
        high *= 2.0;
    }
    let mut low = if high > 1.0 { 0.5 * high } else { 0.0 };
    while high - low > 1e-12 * high {
        let middle = 0.5 * (low + high);
        if inside(middle) < level {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.5 * (low + high)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn near(a: f64, b: f64, tolerance: f64) {
        assert!((a - b).abs() < tolerance * (1.0 + b.abs()), "{a} {b}");
    }

    #[test]
    fn gamma_at_known_points() {
        near(ln_gamma(5.0), 24.0_f64.ln(), 1e-14);
        near(ln_gamma(0.5), std::f64::consts::PI.sqrt().ln(), 1e-14);
        near(ln_gamma(0.1), 2.252_712_651_734_206, 1e-13);
        near(ln_gamma(100.0), 359.134_205_369_575_4, 1e-14);
    }

    /// Closed forms: an exponential, a Cauchy and a t with two degrees.
    #[test]
    fn closed_forms() {
        for x in [0.1, 0.7, 1.0, 3.0, 20.0] {
            near(chi_square_cdf(x, 2.0), 1.0 - (-0.5 * x).exp(), 1e-13);
            // F(2, 4): 1 − (1 + x/2)^{−2}.
            near(f_cdf(x, 2.0, 4.0), 1.0 - (1.0 + 0.5 * x).powi(-2), 1e-13);
        }
        for level in [0.5, 0.95, 0.99] {
            near(student_t(level, 1.0), (std::f64::consts::FRAC_PI_2 * level).tan(), 1e-9);
            near(student_t(level, 2.0), (2.0 * level * level / (1.0 - level * level)).sqrt(), 1e-9);
        }
    }

    /// Printed tables: 1.959964, 2.228139 (10), 2.570582 (5); chi-square 18.307 at 0.95 (10), F 3.3258 at 0.95 (5, 10).
    #[test]
    fn printed_tables() {
        near(student_t(0.95, f64::INFINITY), 1.959_963_985, 1e-8);
        near(student_t(0.95, 10.0), 2.228_138_852, 1e-8);
        near(student_t(0.95, 5.0), 2.570_581_836, 1e-8);
        near(chi_square_cdf(18.307_038, 10.0), 0.95, 1e-7);
        near(f_cdf(3.325_835, 5.0, 10.0), 0.95, 1e-6);
        near(f_quantile(0.95, 5.0, 10.0), 3.325_834_530, 1e-9);
        near(f_quantile(0.95, 11.0, 15.0), 2.506_805_7, 1e-7);
        near(f_cdf(1.830_703_8, 10.0, f64::INFINITY), 0.95, 1e-7);
        near(normal_cdf(1.0), 0.841_344_746_068_543, 1e-14);
        near(normal_cdf(-NORMAL_95), 0.025, 1e-14);
        near(student_t_two_sided(-2.228_138_852, 10.0), 0.05, 1e-9);
        near(chi_square_quantile(0.95, 10.0), 18.307_038_053_275_146, 1e-12);
        near(chi_square_quantile(0.95, 1.0), NORMAL_95 * NORMAL_95, 1e-12);
        // Uniform order statistics: I_x(1, n) = 1 − (1 − x)ⁿ.
        near(beta_quantile(0.975, 1.0, 3.0), 1.0 - 0.025_f64.cbrt(), 1e-13);
    }
}
