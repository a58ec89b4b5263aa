//! Whether the loop is stable, judged with its delay, and by which pole it is not.

use super::closed::{ClosedLoop, Part};
use crate::control::delay::{DelayError, largest_real_part, roots_right_of};
use crate::control::{System, TimeBase, stability};
use crate::num::Polynomial;
use num_complex::Complex64;

/// A mode `e^{λt}` of the loop.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pole {
    /// Re λ in 1/s: negative where the mode decays.
    pub rate_per_s: f64,
    /// |Im λ| in rad/s; `None` where only the rate is known.
    pub frequency_rad_s: Option<f64>,
    /// The pole in the plane of z, of a sampled loop.
    pub z: Option<Complex64>,
}

/// A loop whose error is not bounded.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum Unstable {
    /// By a pole of a controller or of the loop `1 + G Gfb`.
    #[error("{}", words(*.part, .pole))]
    Pole {
        /// The feedforward, or `None` for the loop of plant and feedback.
        part: Option<Part>,
        /// The pole with the largest real part.
        pole: Pole,
    },
    /// It cannot be judged.
    #[error("the loop's stability cannot be judged: {0}")]
    Unjudged(&'static str),
}

fn words(part: Option<Part>, pole: &Pole) -> String {
    let whose = part.map_or("the loop of plant and feedback", Part::name);
    let Pole { rate_per_s, frequency_rad_s, z } = pole;
    let place = match (z, frequency_rad_s) {
        (Some(z), _) if z.im == 0.0 => format!("z = {:.6}", z.re),
        (Some(z), _) => format!("z = {:.6} ± {:.6}j", z.re, z.im.abs()),
        (None, Some(0.0)) => format!("s = {rate_per_s:.6} 1/s"),
        (None, Some(omega)) => format!("s = {rate_per_s:.6} 1/s ± {omega:.6}j rad/s"),
        (None, None) => format!("a real part of {rate_per_s:.6} 1/s"),
    };
    let how = if *rate_per_s > 0.0 { "is unstable" } else { "is not asymptotically stable" };
    format!("{whose} {how}: it has a pole at {place}")
}

/// The root with the largest real part of its exponent; `None` of none (or of poles at z = 0 alone).
fn slowest(roots: &[Complex64], time: &impl TimeBase) -> Option<Pole> {
    let sampled = time.sample_time_s().is_some();
    let of = |root: &Complex64| {
        let exponent = time.exponent(*root);
        let frequency_rad_s = Some(exponent.im.abs());
        Pole { rate_per_s: exponent.re, frequency_rad_s, z: sampled.then_some(*root) }
    };
    let finite = roots.iter().map(of).filter(|pole| pole.rate_per_s.is_finite());
    finite.max_by(|a, b| a.rate_per_s.total_cmp(&b.rate_per_s))
}

fn of_polynomial(polynomial: &Polynomial, time: &impl TimeBase, part: Option<Part>) -> Result<Option<Pole>, Unstable> {
    let roots = polynomial.roots().map_err(|_| Unstable::Unjudged("its poles could not be found"))?;
    let pole = slowest(&roots, time);
    if stability::is_stable(polynomial, time, 0.0) {
        return Ok(pole);
    }
    // The strict test may find a pole on the boundary that rounding has put left of it.
    match pole {
        Some(pole) => Err(Unstable::Pole { part, pole }),
        None => Err(Unstable::Unjudged("its characteristic polynomial is zero")),
    }
}

impl ClosedLoop {
    /// The slowest pole of a stable loop, `Ok(None)` where all is over after some samples.
    ///
    /// Every pole of the feedforward and every root of `D Dfb + N Nfb e^{−sλ}` counts, those that cancel against zeros
    /// included; the delay λ is taken exactly.
    ///
    /// # Errors
    /// [`Unstable`] with the pole farthest to the right.
    pub fn slowest_pole(&self) -> Result<Option<Pole>, Unstable> {
        let forward = match &self.feedforward {
            System::Continuous(tf) => of_polynomial(tf.den(), &tf.time(), Some(Part::Feedforward))?,
            System::Discrete(tf) => of_polynomial(tf.den(), &tf.time(), Some(Part::Feedforward))?,
        };
        let open = self.plant.den().mul(self.feedback.den());
        let gain = self.plant.num().mul(self.feedback.num());
        let around = match &self.plant {
            System::Discrete(tf) => of_polynomial(&open.add(&gain), &tf.time(), None)?,
            System::Continuous(tf) if self.delays.around_s() == 0.0 || gain.is_zero() => {
                of_polynomial(&open.add(&gain), &tf.time(), None)?
            }
            System::Continuous(_) => Some(delayed(&open, &gain, self.delays.around_s())?),
        };
        let slower = forward.into_iter().chain(around).max_by(|a, b| a.rate_per_s.total_cmp(&b.rate_per_s));
        Ok(slower)
    }
}

/// The rightmost root of `D + N e^{−sλ}`.
fn delayed(d: &Polynomial, n: &Polynomial, delay_s: f64) -> Result<Pole, Unstable> {
    let count = |margin: f64| roots_right_of(d.coefficients(), n.coefficients(), delay_s, margin);
    let found = count(0.0).map_err(|error| match error {
        DelayError::NotRetarded => Unstable::Unjudged("it is not strictly proper and has a delay"),
        DelayError::NotFinite => Unstable::Unjudged("a coefficient overflows"),
    })?;
    let is_stable = found == Some(0);
    let edge = edge(d, n, delay_s, is_stable);
    let pole = match edge {
        Some(rate_per_s) => Pole { rate_per_s, frequency_rad_s: frequency(d, n, delay_s, rate_per_s), z: None },
        // A root on the axis leaves no bracket: its rate is zero to working precision.
        None if !is_stable => Pole { rate_per_s: 0.0, frequency_rad_s: frequency(d, n, delay_s, 0.0), z: None },
        None => return Err(Unstable::Unjudged("its slowest pole could not be found")),
    };
    if is_stable { Ok(pole) } else { Err(Unstable::Pole { part: None, pole }) }
}

/// The largest real part of the roots, from a bracket that doubles until it holds it.
fn edge(d: &Polynomial, n: &Polynomial, delay_s: f64, is_stable: bool) -> Option<f64> {
    const MOST_DOUBLINGS: i32 = 60;
    let is_left_of = |edge: f64| {
        let count = roots_right_of(d.coefficients(), n.coefficients(), delay_s, -edge);
        count.map(|count| count == Some(0))
    };
    let step = 0.01 / delay_s;
    for k in 0..MOST_DOUBLINGS {
        let far = step * f64::from(k).exp2();
        let outer = if is_stable { -far } else { far };
        let Ok(left) = is_left_of(outer) else { return None };
        if left != is_stable {
            let inner = if k == 0 { 0.0 } else { outer / 2.0 };
            let bracket = if is_stable { [outer, inner] } else { [inner, outer] };
            let tolerance = 1e-10 * (bracket[1] - bracket[0]).max(1.0);
            return largest_real_part(d.coefficients(), n.coefficients(), delay_s, bracket, tolerance);
        }
    }
    None
}

/// The imaginary part of a root with this real part, by Newton's method from a fan of starts.
fn frequency(d: &Polynomial, n: &Polynomial, delay_s: f64, rate_per_s: f64) -> Option<f64> {
    const STARTS: usize = 400;
    const STEPS: usize = 60;
    let (slope_d, slope_n) = (d.derivative(), n.derivative());
    let turn = std::f64::consts::PI / delay_s;
    // Evenly over the turns of the delay, and logarithmically far beyond them.
    let even = (0..STARTS).map(|i| 0.125 * turn * i as f64);
    let logarithmic = (0..STARTS).map(|i| 1e-3 * turn * (18.0 * i as f64 / STARTS as f64).exp());
    let nearness = 1e-5 * (1.0 + rate_per_s.abs());
    let mut best: Option<Complex64> = None;
    for omega in even.chain(logarithmic) {
        let mut s = Complex64::new(rate_per_s, omega);
        for _ in 0..STEPS {
            let e = (-s * delay_s).exp();
            let f = d.eval(s) + n.eval(s) * e;
            let step = f / (slope_d.eval(s) + (slope_n.eval(s) - n.eval(s) * delay_s) * e);
            if !step.is_finite() {
                break;
            }
            s -= step;
            if step.norm() <= 1e-13 * (1.0 + s.norm()) {
                let off = |root: &Complex64| (root.re - rate_per_s).abs();
                if off(&s) <= nearness && best.is_none_or(|best| off(&s) < off(&best)) {
                    best = Some(s);
                }
                break;
            }
        }
    }
    best.map(|root| if root.im.abs() <= 1e-9 * (1.0 + root.norm()) { 0.0 } else { root.im.abs() })
}
