//! Candidates for certificates, by a cutting plane over R.
//!
//! `max t` with `Q ⪰ tW`, `R ⪰ ρI`, `tr R = m`: `BᵀP = RK` leaves only those R for which `R·KB` (in sampled time
//! `R·K(A − BK)⁻¹B`) is symmetric, m to m(m + 1)/2 unknowns, and `Q ⪰ tW` is the frequency inequality
//! `φ(s)ᴴ M₀(R) φ(s) ⪰ tI` of [`Reduced`]. It is asked at a few frequencies, and at those where the best R violates
//! it, until there are none.

use super::distance;
use super::dual::{Coupling, Dual, DualTest, Prepared};
use super::primal::{CLEAR, FLOOR, Primal, PrimalTest, asymmetry_map};
use super::reduced::Reduced;
use crate::control::lyapunov::Clock;
use crate::convex::lmi::{self, Block, LmiError, Problem, Solution};
use crate::convex::svec;
use crate::ctl::{Ctl, Stopped};
use crate::inverse::reach::Core;
use crate::num::linalg::{self, NoConvergence, symmetric};
use nalgebra::{DMatrix, DVector};
use num_complex::Complex64;
use std::cell::OnceCell;

/// Rounds at most.
const ROUNDS: usize = 30;
/// Frequencies added in a round.
const ADDED: usize = 4;
/// Relative duality gap of a round.
const GAP: f64 = 1e-9;
/// Runs with margins in other units of the states at most, the first included.
const REWEIGHTS: usize = 3;
/// Shares of the best margin at which P is looked for.
const LEVELS: [f64; 3] = [0.5, 0.1, 0.01];
/// How far the frequencies of an exciting multiplier reach beyond those of the loop.
const SPREAD: f64 = 30.0;
/// Least cost of a direction at a frequency, as a share of `σᴴσ + vᴴv`.
const CHEAPEST: f64 = 1e-3;
/// Steps of its design.
const DESIGN_STEPS: usize = 20;
/// Shares of an exciting multiplier mixed into a dual, as powers of ten.
const MIXED: std::ops::RangeInclusive<i32> = -12..=0;

/// A certificate, if there is one.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Outcome {
    Primal(Primal),
    /// The multiplier and the frequencies that it is made of, in rad per unit of time.
    Dual(Dual, Vec<f64>),
    /// No R at all satisfies its equality.
    Coupling(Coupling),
    Neither,
}

/// What a search found.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Found {
    /// Its certificate.
    pub outcome: Outcome,
    /// The best margin t as the programs have it, or a bound of it below zero: where to look next, and no proof.
    pub margin: Option<f64>,
}

impl From<Outcome> for Found {
    fn from(outcome: Outcome) -> Self {
        Self { outcome, margin: None }
    }
}

/// Why there is no outcome.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum PlaneError {
    Stopped(Stopped),
    NoConvergence(NoConvergence),
}

impl From<Stopped> for PlaneError {
    fn from(stopped: Stopped) -> Self {
        Self::Stopped(stopped)
    }
}

impl From<NoConvergence> for PlaneError {
    fn from(error: NoConvergence) -> Self {
        Self::NoConvergence(error)
    }
}

/// R in m to m(m + 1)/2 unknowns, and what follows from it.
struct Plane<'a> {
    core: &'a Core,
    reduced: Reduced,
    dual: DualTest<'a>,
    /// `tr R = m`: R₀ and the directions.
    weights: Vec<DMatrix<f64>>,
    /// M₀ of them, over `scale`.
    constants: Vec<DMatrix<f64>>,
    scale: f64,
    /// A multiplier that excites every state, where it was asked for.
    exciting: OnceCell<DMatrix<f64>>,
}

/// A frequency inequality: φᴴ M₀ φ of R₀ and the directions, as real matrices of twice the size.
struct Cut {
    omega: f64,
    direction: DMatrix<Complex64>,
    terms: Vec<DMatrix<f64>>,
}

fn complex(m: &DMatrix<f64>) -> DMatrix<Complex64> {
    m.map(|v| Complex64::new(v, 0.0))
}

/// The real symmetric matrix [X −Y; Y X] of a Hermitian X + jY.
fn doubled(m: &DMatrix<Complex64>) -> DMatrix<f64> {
    let d = m.nrows();
    DMatrix::from_fn(2 * d, 2 * d, |i, j| {
        let v = 0.5 * (m[(i % d, j % d)] + m[(j % d, i % d)].conj());
        match (i < d, j < d) {
            (true, true) | (false, false) => v.re,
            (true, false) => -v.im,
            (false, true) => v.im,
        }
    })
}

/// The Hermitian Z with `⟨D, [X −Y; Y X]⟩ = Re tr(Zᴴ(X + jY))`.
fn halved(d: &DMatrix<f64>) -> DMatrix<Complex64> {
    let m = d.nrows() / 2;
    DMatrix::from_fn(m, m, |i, j| Complex64::new(d[(i, j)] + d[(i + m, j + m)], d[(i + m, j)] - d[(i, j + m)]))
}

fn combine(terms: &[DMatrix<f64>], z: &DVector<f64>) -> DMatrix<f64> {
    let mut sum = terms[0].clone();
    for (term, factor) in terms[1..].iter().zip(z.iter()) {
        sum += term * *factor;
    }
    sum
}

/// A certificate for the core, or none.
///
/// # Errors
/// [`PlaneError`] when stopped, or where a decomposition fails.
pub(super) fn search(core: &Core, reduced: &Reduced, ctl: &Ctl) -> Result<Found, PlaneError> {
    let Some((primal, dual)) = PrimalTest::new(core).zip(DualTest::new(core)) else {
        return Ok(Outcome::Neither.into());
    };
    let m = core.ports();
    let product = reduced.gain() * &core.b;
    let (_, values, v) = linalg::svd(&asymmetry_map(&product))?;
    let rounding = &core.rounding;
    let moved = (&rounding.k * core.b.abs() + core.k.abs() * &rounding.b).norm() * 2.0;
    let moved = moved * if core.clock == Clock::Sampled { reduced.gain().norm() / core.k.norm() } else { 1.0 };
    let free = values.iter().filter(|s| **s <= moved).count() + svec::length(m) - values.len();
    let basis: Vec<DMatrix<f64>> = v
        .columns(svec::length(m) - free.max(m), free.max(m))
        .column_iter()
        .map(|c| svec::smat(c.clone_owned().as_slice(), m))
        .collect();
    let traces = DVector::from_iterator(basis.len(), basis.iter().map(DMatrix::trace));
    if traces.norm() <= 1e-10 {
        // No R of positive trace at all: T = I is orthogonal to all of them.
        if let Some(found) = dual.coupling(&DMatrix::identity(m, m)) {
            return Ok(Outcome::Coupling(found).into());
        }
        let found = dual.turned(&DMatrix::zeros(m, core.states()), &DMatrix::identity(m, m));
        let plane = Plane {
            core,
            reduced: reduced.clone(),
            dual,
            weights: Vec::new(),
            constants: Vec::new(),
            scale: 1.0,
            exciting: OnceCell::new(),
        };
        return Ok(plane.certified(&found, Vec::new()).into());
    }
    let sum = |z: &DVector<f64>| basis.iter().zip(z.iter()).fold(DMatrix::zeros(m, m), |s, (b, f)| s + b * *f);
    let mut weights = vec![sum(&(&traces * (m as f64 / traces.norm_squared())))];
    let complement = crate::inverse::margin::complement(&traces);
    weights.extend(complement.column_iter().map(|c| sum(&c.clone_owned())));
    let (a, b, k) = (core.a.norm(), core.b.norm(), core.k.norm().max(f64::MIN_POSITIVE));
    let plant = if core.clock == Clock::Continuous { a } else { 1.0 };
    let scale = k * k + plant * k / b;
    let constants = weights.iter().map(|r| reduced.constant(r) / scale).collect();
    let mut plane =
        Plane { core, reduced: reduced.clone(), dual, weights, constants, scale, exciting: OnceCell::new() };
    let mut found = Found::from(Outcome::Neither);
    for round in 0..REWEIGHTS {
        let (Found { outcome, margin }, moved) = plane.run(&primal, ctl)?;
        found.outcome = outcome;
        if round == 0 {
            found.margin = margin;
        }
        // Definite, but not by as much as rounding moves: margins in units of that.
        let (Outcome::Neither, Some(moved)) = (&found.outcome, moved) else { break };
        plane.reduced = reduced.weighed(&moved);
    }
    Ok(found)
}

impl Plane<'_> {
    fn r(&self, z: &DVector<f64>) -> DMatrix<f64> {
        symmetric(&combine(&self.weights, z))
    }

    fn cut(&self, omega: f64) -> Option<Cut> {
        let direction = self.reduced.direction(omega)?;
        let inner = |m0: &DMatrix<f64>| doubled(&(direction.adjoint() * complex(m0) * &direction));
        let terms: Vec<_> = self.constants.iter().map(inner).collect();
        terms.iter().all(|t| t.iter().all(|v| v.is_finite())).then_some(Cut { omega, direction, terms })
    }

    /// The outcome; where definite weights were found whose margin is within rounding also what that makes of Q.
    fn run(&self, primal: &PrimalTest<'_>, ctl: &Ctl) -> Result<(Found, Option<DVector<f64>>), PlaneError> {
        let unknowns = self.weights.len() - 1;
        let m = self.core.ports();
        let mut start = DVector::zeros(unknowns);
        if unknowns > 0 {
            let solution = maximise(&[(&self.weights, 1.0, 0.0)], unknowns, &start, ctl)?;
            let Some(solution) = solution else { return Ok((Outcome::Neither.into(), None)) };
            let best = solution.z[unknowns];
            if best <= FLOOR * 1.01 {
                let wanted = &solution.duals[0] - DMatrix::identity(m, m) * (best / m as f64);
                if let Some(found) = self.dual.coupling(&wanted) {
                    return Ok((Outcome::Coupling(found).into(), None));
                }
                let found = self.dual.turned(&DMatrix::zeros(m, self.core.states()), &wanted);
                return Ok((self.certified(&found, Vec::new()).into(), None));
            }
            start = solution.z.rows(0, unknowns).into_owned();
        }
        let mut cuts: Vec<Cut> = self.first_frequencies()?.into_iter().filter_map(|omega| self.cut(omega)).collect();
        let mut fallback = Outcome::Neither;
        let mut margin = None;
        let mut closest: Option<(f64, DVector<f64>)> = None;
        for _ in 0..ROUNDS {
            ctl.check()?;
            let mut blocks: Vec<(&[DMatrix<f64>], f64, f64)> = vec![(&self.weights, 0.0, FLOOR)];
            blocks.extend(cuts.iter().map(|cut| (&cut.terms[..], 1.0, 0.0)));
            let Some(solution) = maximise(&blocks, unknowns, &start, ctl)? else { break };
            let z = solution.z.rows(0, unknowns).into_owned();
            let (low, high) = (solution.z[unknowns], -solution.dual_objective);
            margin = Some(low.min(high));
            if high.max(low) <= 0.0 || low <= 0.0 {
                let (n, frequencies) = self.multiplier(&solution, &cuts, &z);
                let found = self.certified(&n, frequencies);
                if found != Outcome::Neither || high.max(low) <= 0.0 {
                    return Ok((Found { outcome: found, margin }, None));
                }
            }
            let r = self.r(&z);
            let m0 = combine(&self.constants, &z);
            let mut violated = self.violated(&m0, LEVELS[0] * low);
            if violated.is_empty() {
                for level in LEVELS {
                    let shifted = (&m0 - &self.reduced.unit * (level * low)) * self.scale;
                    let Some(p) = self.reduced.solve(&shifted, &r) else { continue };
                    let Some(found) = primal.check_within(&p, &r, &self.core.rounding.k) else { continue };
                    if found.ratio > CLEAR {
                        return Ok((Found { outcome: Outcome::Primal(found), margin }, None));
                    }
                    if found.ratio > 0.0 && closest.as_ref().is_none_or(|(ratio, _)| found.ratio > *ratio) {
                        closest = Some((found.ratio, found.moved));
                    }
                }
                // Solvable on paper, and not within rounding: closer to the boundary than the data say.
                let (n, frequencies) = self.multiplier(&solution, &cuts, &z);
                fallback = self.certified(&n, frequencies);
                break;
            }
            violated.retain(|omega| cuts.iter().all(|cut| (cut.omega - omega).abs() > 1e-12 * omega.abs()));
            let before = cuts.len();
            cuts.extend(violated.into_iter().filter_map(|omega| self.cut(omega)));
            if cuts.len() == before {
                let (n, frequencies) = self.multiplier(&solution, &cuts, &z);
                fallback = self.certified(&n, frequencies);
                break;
            }
            start = z;
        }
        Ok((Found { outcome: fallback, margin }, closest.map(|(_, moved)| moved)))
    }

    /// Zero, infinity, and some of the sizes of the eigenvalues.
    fn first_frequencies(&self) -> Result<Vec<f64>, NoConvergence> {
        let mut sizes: Vec<f64> = self.reduced.eigenvalues()?.iter().map(|v| v.norm()).filter(|v| *v > 0.0).collect();
        sizes.sort_by(f64::total_cmp);
        let mut all = vec![f64::INFINITY, 0.0];
        all.extend((0..4).filter_map(|i| sizes.get(i * sizes.len().saturating_sub(1) / 3).copied()));
        all.dedup();
        Ok(all)
    }

    /// Frequencies where the inequality falls below a level, worst first.
    fn violated(&self, m0: &DMatrix<f64>, level: f64) -> Vec<f64> {
        let shifted = m0 - &self.reduced.unit * level;
        let Some(crossings) = self.reduced.crossings(&shifted) else { return vec![f64::INFINITY] };
        let mut places = vec![0.0];
        for pair in crossings.windows(2) {
            places.extend([pair[0], 0.5 * (pair[0] + pair[1])]);
        }
        if let Some(last) = crossings.last() {
            places.extend([*last, 2.0 * last + f64::MIN_POSITIVE, 20.0 * last]);
        }
        let least = |omega: f64| -> Option<f64> {
            let direction = self.reduced.direction(omega)?;
            let inner = direction.adjoint() * shifted.map(|v| Complex64::new(v, 0.0)) * &direction;
            Some(doubled(&inner).symmetric_eigenvalues().min())
        };
        let values: Vec<(f64, f64)> = places.into_iter().filter_map(|w| least(w).map(|v| (v, w))).collect();
        let mut found: Vec<(f64, f64)> = (0..values.len())
            .filter(|i| {
                let neighbour = |j: Option<usize>| j.and_then(|j| values.get(j)).is_none_or(|v| v.0 >= values[*i].0);
                values[*i].0 < -1e-3 * level.abs() && neighbour(i.checked_sub(1)) && neighbour(Some(i + 1))
            })
            .map(|i| values[i])
            .collect();
        found.sort_by(|x, y| x.0.total_cmp(&y.0));
        found.into_iter().take(ADDED).map(|(_, omega)| omega).collect()
    }

    /// x, v and σ = v + Kx of the columns of φ at a frequency that is finite or of sampled time.
    fn signals(&self, cut: &Cut) -> Option<[DMatrix<Complex64>; 3]> {
        let states = complex(&self.reduced.coordinates) * &cut.direction;
        // B v = (s − A) x.
        let moved = states.map(|v| v * self.reduced.point(cut.omega)) - complex(&self.core.a) * &states;
        let inputs = complex(&self.core.b.clone().pseudo_inverse(0.0).ok()?) * moved;
        let sigma = &inputs + complex(&self.core.k) * &states;
        Some([states, inputs, sigma])
    }

    /// N of directions Z at a frequency.
    fn at_frequency(&self, cut: &Cut, z: &DMatrix<Complex64>) -> DMatrix<f64> {
        let closed = self.reduced.closed_loop();
        if cut.omega.is_infinite() && self.reduced.clock() == Clock::Continuous {
            let states = complex(&self.reduced.coordinates) * &cut.direction;
            let Ok(pseudo) = self.core.b.clone().pseudo_inverse(0.0) else { return DMatrix::zeros(0, 0) };
            let inputs = complex(&pseudo) * &states;
            return (inputs * z * (complex(closed) * states).adjoint()).map(|v| v.re);
        }
        let Some([states, _, sigma]) = self.signals(cut) else { return DMatrix::zeros(0, 0) };
        let plain = -(&sigma * z * states.adjoint()).map(|v| v.re);
        match self.reduced.clock() {
            Clock::Continuous => plain,
            Clock::Sampled => {
                let square = (&sigma * z * sigma.adjoint()).map(|v| v.re);
                match closed.clone().lu().solve(&self.core.b) {
                    Some(solved) => plain - symmetric(&square) * solved.transpose() * 0.5,
                    None => plain,
                }
            }
        }
    }

    /// A multiplier that excites every state at the least cost: the D-optimal one among directions at frequencies over
    /// the range of the loop, each at the cost `|σᴴσ − vᴴv|`. No X of the same cost exceeds n times its X in any
    /// direction (Kiefer and Wolfowitz, Can. J. Math. 12, 363–366, 1960).
    fn exciting(&self) -> DMatrix<f64> {
        let (m, n) = (self.core.ports(), self.core.states());
        let poles = self.reduced.eigenvalues().unwrap_or_default();
        let (low, high) =
            poles.iter().map(|v| v.norm()).filter(|v| *v > 0.0).fold((1.0, 1.0), |(l, h), v| (v.min(l), v.max(h)));
        let (low, high): (f64, f64) = (SPREAD.recip() * low, SPREAD * high);
        let count = 2 * n / m + 12;
        let mut designs = Vec::new();
        for i in 0..count {
            let omega = low * (high / low).powf(i as f64 / (count - 1) as f64);
            let Some(direction) = self.reduced.direction(omega) else { continue };
            let cut = Cut { omega, direction, terms: Vec::new() };
            let Some([states, inputs, sigma]) = self.signals(&cut) else { continue };
            let (out, back) = (sigma.adjoint() * &sigma, inputs.adjoint() * &inputs);
            let floor = (out.trace().re + back.trace().re) * CHEAPEST / m as f64;
            let eigen = (out - back).symmetric_eigen();
            let costs = eigen.eigenvalues.map(|v| v.abs() + floor);
            let mut turned = states * &eigen.eigenvectors;
            for (mut column, cost) in turned.column_iter_mut().zip(costs.iter()) {
                column.scale_mut(cost.sqrt().recip());
            }
            designs.push((cut, eigen.eigenvectors, costs, turned));
        }
        let mut shares = vec![DVector::from_element(m, 1.0 / (m * count) as f64); designs.len()];
        for _ in 0..DESIGN_STEPS {
            let mut x = DMatrix::zeros(n, n);
            for ((_, _, _, turned), share) in designs.iter().zip(&shares) {
                let weighed = DMatrix::from_fn(n, m, |i, j| turned[(i, j)] * share[j].sqrt());
                x += (&weighed * weighed.adjoint()).map(|v| v.re);
            }
            let Some(inverse) = symmetric(&x).cholesky().map(|c| complex(&c.inverse())) else { break };
            for ((_, _, _, turned), share) in designs.iter().zip(&mut shares) {
                let reached = &inverse * turned;
                for (j, share) in share.iter_mut().enumerate() {
                    *share *= turned.column(j).dotc(&reached.column(j)).re / n as f64;
                }
            }
        }
        let mut sum = DMatrix::zeros(m, n);
        for ((cut, vectors, costs, _), share) in designs.iter().zip(&shares) {
            let weights = DMatrix::from_diagonal(&share.component_div(costs).map(|v| Complex64::new(v, 0.0)));
            sum += self.at_frequency(cut, &(vectors * weights * vectors.adjoint()));
        }
        self.dual.turned(&sum, &DMatrix::zeros(m, m))
    }

    /// The multiplier of a solution's duals, with the frequencies that it is made of.
    fn multiplier(&self, solution: &Solution, cuts: &[Cut], z: &DVector<f64>) -> (DMatrix<f64>, Vec<f64>) {
        let (m, n) = (self.core.ports(), self.core.states());
        let mut sum = DMatrix::zeros(m, n);
        let mut frequencies = Vec::new();
        for (cut, dual) in cuts.iter().zip(&solution.duals[1..]) {
            if dual.trace() > 1e-9 {
                frequencies.push(self.reduced.frequency(cut.omega));
            }
            sum += self.at_frequency(cut, &halved(dual)) / self.scale;
        }
        frequencies.sort_by(f64::total_cmp);
        let r = self.r(z);
        let t = self.dual.inputs(&sum, &self.dual.states(&sum));
        let mu = (r.dot(&t) - r.dot(&solution.duals[0])) / m as f64;
        let wanted = &solution.duals[0] + DMatrix::identity(m, m) * mu;
        (self.dual.turned(&sum, &wanted), frequencies)
    }

    /// The dual certificate of a multiplier with a little of one that excites every state.
    fn certified(&self, n: &DMatrix<f64>, frequencies: Vec<f64>) -> Outcome {
        let exciting = self.exciting.get_or_init(|| self.exciting());
        let inputs = |n: &DMatrix<f64>| self.dual.inputs(n, &self.dual.states(n));
        let (mut t, mut t_exciting) = (inputs(n), inputs(exciting));
        let own = t.norm().max(n.norm() * self.core.k.norm());
        let other = t_exciting.norm().max(exciting.norm() * self.core.k.norm());
        if !(own.is_finite() && own > 0.0 && other > 0.0) {
            return Outcome::Neither;
        }
        t /= own;
        t_exciting /= other;
        // Of those that hold the one that holds with the largest ratio.
        let mut best: Option<(f64, Prepared)> = None;
        for power in MIXED {
            let share = 10f64.powi(power);
            if DualTest::margin(&(&t + &t_exciting * share)) <= 0.0 {
                break;
            }
            let Some(mixed) = self.dual.prepared(&(n / own + exciting * (share / other))) else { continue };
            let by_gain = self.dual.moved_by_gain(&mixed, &self.core.rounding.k);
            let ratio = self.dual.ratio(&mixed, &self.core.rounding.k, &by_gain).unwrap_or(0.0);
            if best.as_ref().is_none_or(|(best, _)| ratio > *best) {
                best = Some((ratio, mixed));
            } else if best.as_ref().is_some_and(|(best, _)| *best > CLEAR) {
                break;
            }
        }
        match best.filter(|(ratio, _)| *ratio > CLEAR) {
            Some((ratio, mixed)) => {
                let change = distance::dual(self.core, &self.dual, &mixed);
                Outcome::Dual(Dual { n: mixed.n, ratio, change }, frequencies)
            }
            None => Outcome::Neither,
        }
    }
}

/// A block `Σ z_i T_i` (T_0 the constant) that must exceed `share·t + floor`.
type Asked<'a> = (&'a [DMatrix<f64>], f64, f64);

/// `max t` over z from a start; `None` where that violates a block without t.
fn maximise(
    asked: &[(impl AsRef<[DMatrix<f64>]>, f64, f64)],
    unknowns: usize,
    start: &DVector<f64>,
    ctl: &Ctl,
) -> Result<Option<Solution>, Stopped> {
    let asked: Vec<Asked<'_>> = asked.iter().map(|(terms, share, floor)| (terms.as_ref(), *share, *floor)).collect();
    let block = |(terms, share, floor): &Asked<'_>| {
        let d = terms[0].nrows();
        let mut all: Vec<DMatrix<f64>> = terms[1..].to_vec();
        all.push(DMatrix::identity(d, d) * -share);
        Block::new(&terms[0] - DMatrix::identity(d, d) * *floor, all.iter())
    };
    let mut cost = DVector::zeros(unknowns + 1);
    cost[unknowns] = -1.0;
    let least = asked
        .iter()
        .filter(|(_, share, _)| *share > 0.0)
        .map(|(terms, _, _)| combine(terms, start).symmetric_eigenvalues().min())
        .fold(f64::INFINITY, f64::min);
    let mut z = DVector::zeros(unknowns + 1);
    z.rows_mut(0, unknowns).copy_from(start);
    z[unknowns] = least - least.abs().max(1e-3);
    let problem =
        Problem { cost, quadratic: None, objective_scale: 1e-6, gap: GAP, blocks: asked.iter().map(block).collect() };
    match lmi::solve(&problem, &z, ctl) {
        Ok(solution) => Ok(Some(solution)),
        Err(LmiError::Stopped(stopped)) => Err(stopped),
        Err(LmiError::Infeasible { .. }) => Ok(None),
    }
}
