//! Which other gains explain the same records.
//!
//! Not told the disturbance, K and L are seen through the compensator alone, and other pairs have the same one
//! ([`twins`](crate::control::twins)). Whether a twin is somebody that the design allows is a linear question: with K
//! given, `P = A_cᵀPA_c + Q + KᵀRK` is linear in the coefficients of Q, and K is optimal where `BᵀPA_c = RK`. The
//! filter's is its dual. A twin that is missed by little is climbed from, so that a second hill is found where the
//! structure allows no exact twin.

use super::climb::{Climbed, climb};
use super::design::{Design, Member, Role, Term, Timing};
use super::inference::{Inference, local};
use super::recursion::Problem;
use super::starts::Fit;
use crate::control::lyapunov::{Clock, Lyapunov};
use crate::control::twins::{Twin, TwinsError, filter_twins, twins};
use crate::ctl::{Ctl, Stopped};
use crate::num::linalg::least_squares;
use nalgebra::{DMatrix, DVector};

/// Explanations whose log likelihoods differ by less are not told apart.
pub const WITHIN: f64 = 2.0;
/// A twin whose gains the design misses by less, relative to their norms, is climbed from.
const NEAR: f64 = 0.3;
/// A coefficient that is not positive is started at this share of the largest.
const LEAST_SHARE: f64 = 1e-3;
/// Two answers are on one hill where the parabola of the best explains their difference up to this.
const SAME_HILL: f64 = 0.5;
/// Nor are they two where no logarithm differs by more.
const SAME: f64 = 0.02;

/// A person who explains the records.
#[derive(Debug, Clone, PartialEq)]
pub struct Explanation {
    /// θ.
    pub theta: Vec<f64>,
    /// The person, with derivatives.
    pub member: Member,
    /// The log likelihood.
    pub log_likelihood: f64,
    /// The covariance of θ there, zero for parameters at a bound.
    pub covariance: DMatrix<f64>,
}

/// Climbs from the twins of the best answer.
#[derive(Debug, Clone, PartialEq)]
pub struct Hills {
    /// Where they ended.
    pub climbs: Vec<Climbed>,
    /// Twins that are optimal for nothing that the design allows, not even nearly.
    pub outside: usize,
    /// Why no twins were looked for.
    pub missing: Option<NoTwins>,
}

/// Why twins were not looked for.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NoTwins {
    /// The splits of the poles could not be gone through.
    #[error(transparent)]
    Splits(#[from] TwinsError),
    /// Delays, targets, horizons, noise of the control and the like.
    #[error(
        "they are only known of a plant that the person knows, without a delay, a target, an end or noise of the \
             control, with fixed scales"
    )]
    NotPlain,
}

/// Coefficients of the terms, in their order, for which K (m×n) is nearest to optimal for the plant (A, B) and R, in
/// the sense of `BᵀPA_c = RK`; they may be negative. `None` where K does not stabilise, or there are more terms than
/// equations.
fn coefficients([a, b, r, k]: [&DMatrix<f64>; 4], free: &[&DMatrix<f64>], held: &DMatrix<f64>) -> Option<Vec<f64>> {
    let closed = a - b * k;
    let operator = Lyapunov::new(&closed, Clock::Sampled).ok().filter(Lyapunov::is_stable)?;
    let of = |weight: &DMatrix<f64>| b.tr_mul(&operator.solve(weight)) * &closed;
    let right = r * k - of(&(held + k.tr_mul(&(r * k))));
    let columns: Vec<DVector<f64>> =
        free.iter().map(|shape| DVector::from_column_slice(of(shape).as_slice())).collect();
    let norms: Vec<f64> = columns.iter().map(DVector::norm).collect();
    if columns.is_empty() || norms.iter().any(|v| *v <= 0.0 || !v.is_finite()) {
        return None;
    }
    let scaled: Vec<DVector<f64>> = columns.iter().zip(&norms).map(|(column, norm)| column / *norm).collect();
    let (found, _) = least_squares(&DMatrix::from_columns(&scaled), &DVector::from_column_slice(right.as_slice()))?;
    Some(found.iter().zip(&norms).map(|(value, norm)| value / norm).collect())
}

/// The shapes of a role's free terms, and the sum of those that are held.
fn parts(design: &Design, role: Role) -> (Vec<&DMatrix<f64>>, DMatrix<f64>) {
    let [n, ..] = design.sizes();
    let of_role = || design.terms.iter().filter(move |term| term.role == role);
    let free = of_role().filter(|term| term.held.is_none()).map(|term| &term.shape).collect();
    let held = of_role()
        .filter_map(|term: &Term| Some(&term.shape * term.held?))
        .fold(DMatrix::zeros(n, n), |sum, m: DMatrix<f64>| sum + m);
    (free, held)
}

/// Coefficients of Q's free terms for which K is nearest to optimal.
pub(super) fn coefficients_of_regulator(design: &Design, k: &DMatrix<f64>) -> Option<Vec<f64>> {
    let (free, held) = parts(design, Role::StateWeight);
    coefficients([&design.plant.a, &design.plant.b, &design.control_weight, k], &free, &held)
}

/// Coefficients of W_p's free terms for which the predictor's gain L is nearest to optimal.
pub(super) fn coefficients_of_filter(design: &Design, l: &DMatrix<f64>) -> Option<Vec<f64>> {
    let (free, held) = parts(design, Role::PerceivedProcessNoise);
    let [a, c] = [design.plant.a.transpose(), design.plant.c.transpose()];
    coefficients([&a, &c, &design.perceived_measurement_noise, &l.transpose()], &free, &held)
}

/// A pair of gains with the compensator of a person.
#[derive(Debug, Clone, PartialEq)]
pub struct TwinPerson {
    /// K, m×n.
    pub k: DMatrix<f64>,
    /// L, n×p, by [`Timing`].
    pub l: DMatrix<f64>,
    /// The parameters whose gains these are, or nearly: the costs and beliefs for which the twin is optimal, and the
    /// person's own noises. `None` where the design has none.
    pub theta: Option<Vec<f64>>,
}

/// The twins of the person at θ, who must be defined there.
///
/// # Errors
/// [`TwinsError`].
pub fn twin_persons(design: &Design, theta: &[f64]) -> Result<Vec<TwinPerson>, TwinsError> {
    let Some(member) = design.member(theta, false) else { return Ok(Vec::new()) };
    let plant = [&design.plant.a, &design.plant.b, &design.plant.c];
    let found = match design.timing {
        Timing::Predictor => twins(plant, &member.k, &member.l),
        Timing::Filter => filter_twins(plant, &member.k, &member.l),
    }?;
    let one = |Twin { k, l, .. }: Twin| {
        let theta = parameters(design, theta, &k, &l);
        TwinPerson { k, l, theta }
    };
    Ok(found.into_iter().map(one).collect())
}

/// How the coefficients of a role's terms follow from a gain, where they do.
type Coefficients<'a> = &'a dyn Fn() -> Option<Vec<f64>>;

/// The parameters whose gains come near to these, with the noises of θ.
fn parameters(design: &Design, theta: &[f64], k: &DMatrix<f64>, l: &DMatrix<f64>) -> Option<Vec<f64>> {
    let predictor = if design.timing == Timing::Filter { &design.plant.a * l } else { l.clone() };
    let mut theta = theta.to_vec();
    let regulator = || coefficients_of_regulator(design, k);
    let filter = || coefficients_of_filter(design, &predictor);
    let roles: [(Role, Coefficients<'_>); 2] =
        [(Role::StateWeight, &regulator), (Role::PerceivedProcessNoise, &filter)];
    for (role, find) in roles {
        let of_role = design.free().enumerate().filter(|(_, term)| term.role == role);
        let places: Vec<usize> = of_role.map(|(i, _)| i).collect();
        // Where all terms are held the twin must happen to suit them.
        if places.is_empty() {
            continue;
        }
        let found = find()?;
        let largest = found.iter().copied().fold(0.0, f64::max);
        for (i, value) in places.into_iter().zip(found) {
            theta[i] = value.max(LEAST_SHARE * largest).ln();
        }
    }
    let member = design.member(&theta, false).filter(|_| theta.iter().all(|v| v.is_finite()))?;
    let is_near = |found: &DMatrix<f64>, wanted: &DMatrix<f64>| (found - wanted).norm() <= NEAR * wanted.norm();
    (is_near(&member.k, k) && is_near(&member.l, l)).then_some(theta)
}

/// Climbs from the twins of an answer, where the records leave room for any.
///
/// # Errors
/// [`Stopped`] when `ctl` says so.
pub fn hills(problem: &Problem<'_>, best: &Climbed, bounds: &[[f64; 2]], ctl: &Ctl) -> Result<Hills, Stopped> {
    let design = problem.design();
    let mut hills = Hills { climbs: Vec::new(), outside: 0, missing: None };
    if design.is_told && problem.is_disturbed() {
        return Ok(hills);
    }
    if !design.is_plain() {
        hills.missing = Some(NoTwins::NotPlain);
        return Ok(hills);
    }
    let found = match twin_persons(design, &best.theta) {
        Ok(found) => found,
        Err(error) => {
            hills.missing = Some(error.into());
            return Ok(hills);
        }
    };
    let free = vec![true; best.theta.len()];
    ctl.set_total(found.len() as u64);
    for twin in found {
        ctl.check()?;
        ctl.advance(1);
        let climbed = match twin.theta {
            Some(theta) => climb(problem, &theta, &free, bounds, ctl)?,
            None => None,
        };
        match climbed {
            Some(climbed) => hills.climbs.push(climbed),
            None => hills.outside += 1,
        }
    }
    Ok(hills)
}

/// The best answer, and all others within [`WITHIN`] of it that are hills of their own, the likeliest first.
///
/// # Errors
/// [`Stopped`] when `ctl` says so.
pub fn explanations(
    problem: &Problem<'_>,
    fit: &Fit,
    hills: &Hills,
    best: &Climbed,
    known: &Inference,
    ctl: &Ctl,
) -> Result<Vec<Explanation>, Stopped> {
    let top = best.evaluation.log_likelihood;
    // What a start came to may be the same hill, flat as it is; what a twin came to is known to be another.
    let of_starts = fit.climbs.iter().map(|c| (c, false));
    let mut others: Vec<(&Climbed, bool)> = of_starts
        .chain(hills.climbs.iter().map(|c| (c, true)))
        .filter(|(c, _)| c.is_converged && top - c.evaluation.log_likelihood <= WITHIN)
        .collect();
    others.sort_by(|(x, _), (y, _)| y.evaluation.log_likelihood.total_cmp(&x.evaluation.log_likelihood));
    let mut found: Vec<Explanation> = Vec::new();
    for (climbed, is_twin) in std::iter::once((best, true)).chain(others) {
        let is_known = found.iter().any(|other| {
            let difference: Vec<f64> = climbed.theta.iter().zip(&other.theta).map(|(x, y)| x - y).collect();
            let falls = (other.log_likelihood - climbed.evaluation.log_likelihood).max(0.0);
            difference.iter().all(|v| v.abs() <= SAME) || (!is_twin && known.parabola(&difference) <= falls + SAME_HILL)
        });
        if is_known {
            continue;
        }
        let Some(member) = problem.design().member(&climbed.theta, true) else { continue };
        let covariance =
            if found.is_empty() { known.covariance.clone() } else { local(problem, climbed, ctl)?.covariance };
        let log_likelihood = climbed.evaluation.log_likelihood;
        found.push(Explanation { theta: climbed.theta.clone(), member, log_likelihood, covariance });
    }
    Ok(found)
}

impl Explanation {
    /// Standard errors of the entries of K and of L, to first order.
    #[must_use]
    pub fn gain_errors(&self) -> [DMatrix<f64>; 2] {
        let errors = |like: &DMatrix<f64>, of: &dyn Fn(usize) -> Option<DMatrix<f64>>| {
            let slopes: Vec<_> = (0..self.theta.len()).map(|i| of(i).unwrap_or_else(|| like * 0.0)).collect();
            DMatrix::from_fn(like.nrows(), like.ncols(), |row, column| {
                let v = DVector::from_iterator(slopes.len(), slopes.iter().map(|slope| slope[(row, column)]));
                v.dot(&(&self.covariance * &v)).max(0.0).sqrt()
            })
        };
        let Member { k, l, k_slopes, l_slopes, .. } = &self.member;
        [errors(k, &|i| k_slopes[i].clone()), errors(l, &|i| l_slopes[i].clone())]
    }
}
