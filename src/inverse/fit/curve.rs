//! The trade-off between fit and condition number.

use super::allowance::Allowance;
use super::barrier::{Bounds, FAR, NEAR, Pair, Point, WARM, minimise};
use super::objective::Objective;
use super::starts::{into_box, random, smallest_cross_term};
use crate::convex::lmi::LmiError;
use crate::ctl::{Ctl, Stopped};
use crate::inverse::gains::Gains;
use crate::inverse::structure::{Structure, StructureError};
use crate::num::rng;
use nalgebra::DMatrix;

/// Spread of the eigenvalues of random starts without bounds.
const FREE_SPREAD: f64 = 1e3;
/// Sizes n + m up to which the cross-term start is computed.
pub const CROSS_TERM: usize = 20;
/// Unknowns of the weights up to which they are fitted: beyond a single step takes longer than a cancel may wait.
const UNKNOWNS: usize = 400;
/// Operations that a fit may take where nothing else is said: some 2 s of one core.
const OPERATIONS: usize = 1_000_000_000;
/// Evaluations at least and at most that follow from it.
const EVALUATIONS: [usize; 2] = [200, 200_000];

/// Rounds of steps without bounds at most.
const ROUNDS: usize = 10;
/// A round that gains less than this share of the value is the last.
const CREEPING: f64 = 1e-6;

/// How a fit is made.
#[derive(Debug, Clone, PartialEq)]
pub struct FitSettings {
    /// What is known of the weights beforehand.
    pub structure: Structure,
    /// Condition numbers κ, increasing, each above 1.
    pub condition_numbers: Vec<f64>,
    /// M, mn×mn: the inverse covariance of vec(K_e); none for the identity.
    pub metric: Option<DMatrix<f64>>,
    /// Random starts beside the fixed ones, for every κ.
    pub random_starts: usize,
    /// Seed of the random starts.
    pub seed: u64,
    /// Evaluations of f at most; by the size of the problem where there is none.
    pub evaluations: Option<usize>,
}

impl Default for FitSettings {
    fn default() -> Self {
        Self {
            structure: Structure::default(),
            condition_numbers: vec![1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8],
            metric: None,
            random_starts: 4,
            seed: 1,
            evaluations: None,
        }
    }
}

/// Whether weights of this structure are fitted at all: not too many unknowns, and no targets that no input reaches.
#[must_use]
pub fn fits(gains: &Gains, structure: &Structure) -> bool {
    structure.unknowns(gains.states(), gains.ports()) <= UNKNOWNS && gains.targets().is_none()
}

/// Evaluations that a problem of n states, m inputs and d unknowns is allowed: a Riccati equation by Newton's method,
/// and a Lyapunov equation for every unknown.
fn allowed(n: usize, m: usize, d: usize) -> usize {
    let operations = n.pow(3) * (1000 + 16 * d) + 2 * d * d * n * m;
    (OPERATIONS / operations.max(1)).clamp(EVALUATIONS[0], EVALUATIONS[1])
}

/// The best weights found under one condition number.
#[derive(Debug, Clone, PartialEq)]
pub struct FitPoint {
    /// κ.
    pub condition_number: f64,
    /// f, the weighted squared distance of the gains.
    pub residual: f64,
    /// Q, n×n.
    pub q: DMatrix<f64>,
    /// R, m×m.
    pub r: DMatrix<f64>,
    /// Its regulator, m×n.
    pub k: DMatrix<f64>,
    /// What another Newton step promises, as a share of f.
    pub stationarity: f64,
    /// Starts that ended within 1e-4 of f, of those that ended.
    pub agreeing_starts: usize,
    /// Starts that ended.
    pub starts: usize,
}

/// The curve f(κ), from the smallest to the largest κ.
#[derive(Debug, Clone, PartialEq)]
pub struct Fit {
    /// A point for every κ; f does not increase.
    pub curve: Vec<FitPoint>,
    /// Without a κ, Q ⪰ 0 and R ≻ 0 alone.
    pub unbounded: Option<Unbounded>,
    /// Evaluations of f that were taken.
    pub evaluations: usize,
    /// Evaluations that were allowed.
    pub allowed: usize,
    /// Whether some part of the fit ended for want of them.
    pub is_exhausted: bool,
}

/// The nearest gain found where only the signs of the weights are held: no more than the last of the curve, and usually
/// an infimum that is not attained, which is followed as long as it falls.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Unbounded {
    /// f.
    pub residual: f64,
    /// Condition number of blkdiag(Q, R) there (of what the structure lets Q weigh); infinite where rounding leaves no
    /// least eigenvalue.
    pub condition_number: f64,
}

/// Why there is no fit.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FitError {
    /// The structure does not fit.
    #[error(transparent)]
    Structure(#[from] StructureError),
    /// Somebody asked to stop.
    #[error(transparent)]
    Stopped(#[from] Stopped),
    /// A condition number of 1 or less, or the list does not increase.
    #[error("the condition numbers must increase and be above 1; there is {0}")]
    ConditionNumber(f64),
    /// No start has a regulator.
    #[error("no start has a regulator: the Riccati equation fails for every weight tried")]
    NoStart,
}

/// Fits weights under each condition number, from the identity, the smallest cross term, the neighbouring fits and
/// random weights.
///
/// The problem is not convex: f is the best value found, and the number of starts that agree says how sure that is.
///
/// # Errors
/// [`FitError`].
pub fn fit(gains: &Gains, settings: &FitSettings, ctl: &Ctl) -> Result<Fit, FitError> {
    let (n, m) = (gains.states(), gains.ports());
    settings.structure.check(n, m)?;
    let mut last = 1.0;
    for kappa in &settings.condition_numbers {
        if !(kappa.is_finite() && *kappa > last) {
            return Err(FitError::ConditionNumber(*kappa));
        }
        last = *kappa;
    }
    if settings.condition_numbers.is_empty() {
        return Err(FitError::ConditionNumber(f64::NAN));
    }
    let objective = Objective::new(gains, settings.metric.as_ref());
    let directions = settings.structure.directions(n, m);
    let total = settings.evaluations.unwrap_or_else(|| allowed(n, m, directions.len()));
    let allowance = Allowance::new(total);
    // The starts without bounds, each κ, and the last descent.
    let mut parts = settings.condition_numbers.len() + 2;
    allowance.begin(parts);
    let weighed = settings.structure.support();
    let free = settings.structure.is_free();
    let mut common = Vec::new();
    if free && n + m <= CROSS_TERM {
        match smallest_cross_term(gains, ctl) {
            Ok(found) => common.push((found.q, found.r)),
            Err(LmiError::Stopped(stopped)) => return Err(stopped.into()),
            Err(LmiError::Infeasible { .. }) => {}
        }
    }
    let mut stream = rng::stream(settings.seed, "inverse fit");
    // Without bounds the descent goes where the bounds would not let it pass.
    let mut unbounded = vec![(DMatrix::identity(n, n), structured_identity(settings, m))];
    unbounded.extend(common.iter().cloned());
    unbounded.extend((0..settings.random_starts).map(|_| random(n, m, FREE_SPREAD, &mut stream)));
    for (mut q, mut r) in unbounded {
        settings.structure.impose(&mut q, &mut r);
        let bounds = Bounds { low: 0.0, high: f64::INFINITY, weighed: weighed.as_deref() };
        if let Some(point) = minimise(&objective, &directions, (q, r), bounds, None, (&allowance, ctl))? {
            common.push((point.q, point.r));
        }
    }
    let mut found: Vec<Vec<Point>> = Vec::new();
    for kappa in &settings.condition_numbers {
        let identity = (DMatrix::identity(n, n) * kappa.sqrt(), structured_identity(settings, m) * kappa.sqrt());
        let mut starts = vec![(FAR, identity)];
        starts.extend(common.iter().map(|(q, r)| (NEAR, into_box(q, r, *kappa, weighed.as_deref()))));
        if let Some(previous) = found.last() {
            starts.extend(different(previous).map(|p| (WARM, into_box(&p.q, &p.r, *kappa, weighed.as_deref()))));
        }
        starts.extend((0..settings.random_starts).map(|_| (NEAR, random(n, m, *kappa, &mut stream))));
        parts -= 1;
        allowance.begin(parts);
        found.push(ends(&objective, &directions, starts, settings, *kappa, (&allowance, ctl))?);
    }
    let mut curve: Vec<FitPoint> = Vec::new();
    for (points, kappa) in found.iter().zip(&settings.condition_numbers) {
        let Some(best) = points.first() else { continue };
        let agreeing = points.iter().filter(|p| p.value <= best.value * (1.0 + 1e-4)).count();
        curve.push(FitPoint {
            condition_number: *kappa,
            residual: best.value,
            q: best.q.clone(),
            r: best.r.clone(),
            k: best.k.clone(),
            stationarity: best.stationarity,
            agreeing_starts: agreeing,
            starts: points.len(),
        });
    }
    if curve.is_empty() {
        return Err(FitError::NoStart);
    }
    let mut starts = common;
    starts.extend(curve.last().map(|best| (best.q.clone(), best.r.clone())));
    allowance.begin(1);
    let unbounded = without_bounds(&objective, &directions, starts, weighed.as_deref(), (&allowance, ctl))?;
    let (evaluations, is_exhausted) = (total - allowance.left(), allowance.is_exhausted());
    Ok(Fit { curve, unbounded, evaluations, allowed: total, is_exhausted })
}

/// The nearest gain with the signs of the weights alone, from the best of these starts on. The value creeps towards an
/// infimum that is not attained, so that it is followed as long as it falls by a share worth mentioning.
fn without_bounds(
    objective: &Objective<'_>,
    directions: &[Pair],
    starts: Vec<Pair>,
    weighed: Option<&[usize]>,
    driven: (&Allowance, &Ctl),
) -> Result<Option<Unbounded>, Stopped> {
    let bounds = Bounds { low: 0.0, high: f64::INFINITY, weighed };
    let valued =
        starts.into_iter().filter_map(|(q, r)| objective.value(&q, &r, None).ok().map(|(value, _)| (value, q, r)));
    let Some((mut value, mut q, mut r)) = valued.min_by(|x, y| x.0.total_cmp(&y.0)) else { return Ok(None) };
    for _ in 0..ROUNDS {
        let Some(point) = minimise(objective, directions, (q.clone(), r.clone()), bounds, None, driven)? else { break };
        let gained = value - point.value;
        if gained > 0.0 {
            (value, q, r) = (point.value, point.q, point.r);
        }
        if gained <= CREEPING * value {
            break;
        }
    }
    Ok(Some(Unbounded { residual: value, condition_number: condition(&q, &r, weighed) }))
}

/// The largest eigenvalue of the weights over the least.
fn condition(q: &DMatrix<f64>, r: &DMatrix<f64>, weighed: Option<&[usize]>) -> f64 {
    let q = weighed.map_or_else(|| q.clone(), |kept| q.select_rows(kept).select_columns(kept));
    let (q, r) = (q.symmetric_eigenvalues(), r.symmetric_eigenvalues());
    let least = q.min().min(r.min());
    if least > 0.0 { q.max().max(r.max()) / least } else { f64::INFINITY }
}

/// The best few local minima that differ.
fn different(points: &[Point]) -> impl Iterator<Item = &Point> {
    let mut last = -1.0;
    points
        .iter()
        .filter(move |p| {
            let new = p.value > last + 1e-4 * f64::abs(last);
            if new {
                last = p.value;
            }
            new
        })
        .take(4)
}

fn structured_identity(settings: &FitSettings, m: usize) -> DMatrix<f64> {
    settings.structure.r.as_ref().map_or_else(
        || DMatrix::identity(m, m),
        |r| r / (r.symmetric_eigenvalues().min() * r.symmetric_eigenvalues().max()).sqrt(),
    )
}

/// Local minima from the starts, best first.
fn ends(
    objective: &Objective<'_>,
    directions: &[Pair],
    starts: Vec<(f64, Pair)>,
    settings: &FitSettings,
    kappa: f64,
    driven: (&Allowance, &Ctl),
) -> Result<Vec<Point>, Stopped> {
    let weighed = settings.structure.support();
    let bounds = Bounds { low: 1.0, high: kappa, weighed: weighed.as_deref() };
    let mut points = Vec::new();
    for (barrier, (mut q, mut r)) in starts {
        settings.structure.impose(&mut q, &mut r);
        if let Some(point) = minimise(objective, directions, (q, r), bounds, Some(barrier), driven)? {
            points.push(point);
        }
    }
    points.sort_by(|x, y| x.value.total_cmp(&y.value));
    Ok(points)
}
