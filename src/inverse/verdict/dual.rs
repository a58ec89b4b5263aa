//! Dual certificates, which alone decide "infeasible" for several inputs. Whatever found them is not believed.
//!
//! For any N (m×n) let X solve `A_cX + XA_cᵀ = BN + NᵀBᵀ` (`X = A_cXA_cᵀ − BNA_cᵀ − A_cNᵀBᵀ`), A_c = A − BK, and
//! `T = KXKᵀ + NKᵀ + KNᵀ`. Then `⟨X, Q⟩ = −⟨R, T⟩` for all weights that satisfy the equalities. Where X ≻ 0 and
//! `ρ tr T + m(1 − ρ)λ_min(T) > 0`, no Q ⪰ 0 goes with any `R ⪰ ρI` of trace m.
//!
//! X is close to singular where a few states alone show that the gain is not optimal: the box of the data counts by
//! majorants that are small where X is small, and X itself to twice the digits of a double.

use super::distance;
use super::majorant;
use super::primal::{CLEAR, FLOOR};
use super::residual::{ExactLoop, is_definite};
use super::structured::Completion;
use crate::control::lyapunov::{Clock, Lyapunov};
use crate::inverse::reach::Core;
use crate::inverse::rounding::UNIT;
use crate::num::linalg::{self, symmetric};
use nalgebra::{DMatrix, DVector};

/// Corrections of X by its exact residual.
const CORRECTIONS: usize = 2;
/// Ratios are told up to this, to so many halvings of its logarithm.
const LARGEST_RATIO: f64 = 1e15;
const RATIO_HALVINGS: usize = 12;

/// A multiplier that proves "infeasible", in the units of the core.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Dual {
    /// N, m×n.
    pub n: DMatrix<f64>,
    /// `ρ tr T + m(1 − ρ)λ_min(T)` over what rounding moves it.
    pub ratio: f64,
    /// The relative change of K up to which it holds.
    pub change: Option<f64>,
}

/// A multiplier with what its test needs.
pub(super) struct Prepared {
    pub n: DMatrix<f64>,
    x: DMatrix<f64>,
    /// X, completed where a structure leaves entries free, and what it lacks.
    definite: DMatrix<f64>,
    left: DMatrix<f64>,
    /// `KX + N`, m×n.
    sigma: DMatrix<f64>,
    /// What ΔK meets in the equation of X: X, in sampled time `A_cX − BN`, n×n.
    meets: DMatrix<f64>,
    /// Cholesky's factor of X and its inverse: the metric in which majorants are sought.
    root: DMatrix<f64>,
    whiten: DMatrix<f64>,
    /// Majorant of how far A, B and the evaluation move X.
    moved: DMatrix<f64>,
    /// Majorant of the error of T.
    own: DMatrix<f64>,
    inputs: Inputs,
    /// T, completed likewise, how far its least product may be rounded, and the metric of its majorants.
    t: DMatrix<f64>,
    slack: f64,
    root_t: DMatrix<f64>,
    whiten_t: DMatrix<f64>,
    /// The least `⟨R, T⟩` over all R of trace m.
    pub margin: f64,
}

/// The R of trace m that a multiplier must contradict.
enum Inputs {
    /// All with `R ⪰ ρI`.
    Any,
    /// This one.
    Given(DMatrix<f64>),
}

impl Inputs {
    /// The least `⟨R, T⟩`: `ρ tr T + m(1 − ρ)λ_min(T)` over all.
    fn least(&self, t: &DMatrix<f64>) -> f64 {
        match self {
            Self::Any => FLOOR * t.trace() + t.nrows() as f64 * (1.0 - FLOOR) * t.symmetric_eigenvalues().min(),
            Self::Given(r) => r.dot(t),
        }
    }

    /// The greatest.
    fn most(&self, t: &DMatrix<f64>) -> f64 {
        -self.least(&-t)
    }
}

/// What a dual test needs of the loop.
pub(super) struct DualTest<'a> {
    core: &'a Core,
    closed: DMatrix<f64>,
    exact: ExactLoop,
    lyapunov: Lyapunov,
    /// H of `A_cH + HA_cᵀ + I = 0` (`H = A_cHA_cᵀ + I`).
    unit: DMatrix<f64>,
}

impl<'a> DualTest<'a> {
    pub(super) fn new(core: &'a Core) -> Option<Self> {
        let closed = core.closed_loop();
        let lyapunov = Lyapunov::new(&closed, core.clock).ok()?;
        let n = core.states();
        let unit = lyapunov.solve_adjoint(&DMatrix::identity(n, n));
        Some(Self { exact: ExactLoop::new(core), core, closed, lyapunov, unit })
    }

    /// The right side of the equation of X.
    fn source(&self, n: &DMatrix<f64>) -> DMatrix<f64> {
        let half = match self.core.clock {
            Clock::Continuous => &self.core.b * n,
            Clock::Sampled => &self.core.b * n * self.closed.transpose(),
        };
        -(&half + half.transpose())
    }

    /// X of a multiplier.
    pub(super) fn states(&self, n: &DMatrix<f64>) -> DMatrix<f64> {
        self.lyapunov.solve_adjoint(&self.source(n))
    }

    /// T of a multiplier with its X.
    pub(super) fn inputs(&self, n: &DMatrix<f64>, x: &DMatrix<f64>) -> DMatrix<f64> {
        let k = &self.core.k;
        let half = n * k.transpose();
        symmetric(&(k * x * k.transpose() + &half + half.transpose()))
    }

    /// The least `⟨R, T⟩` of a T.
    pub(super) fn margin(t: &DMatrix<f64>) -> f64 {
        Inputs::Any.least(t)
    }

    /// X and T of a multiplier with majorants of their errors; `None` where X is not definite.
    pub(super) fn prepared(&self, n: &DMatrix<f64>) -> Option<Prepared> {
        self.of_multiplier(n, None)
    }

    /// The same where a structure leaves entries of X and T free.
    pub(super) fn completed(&self, n: &DMatrix<f64>, completion: &Completion<'_>) -> Option<Prepared> {
        self.of_multiplier(n, Some(completion))
    }

    fn of_multiplier(&self, n: &DMatrix<f64>, completion: Option<&Completion<'_>>) -> Option<Prepared> {
        let Core { a, b, k, clock, rounding } = self.core;
        let closed = &self.closed;
        let (order, ports) = (a.nrows(), k.nrows());
        let gamma = |terms: usize| (2 * terms + 8) as f64 * UNIT;
        let abs_c = a.abs() + b.abs() * k.abs();
        let mut x = self.states(n);
        for _ in 0..CORRECTIONS {
            x = symmetric(&(&x + self.lyapunov.solve_adjoint(&self.exact.residual(self.core, n, &x))));
        }
        let residual = self.exact.residual(self.core, n, &x);
        // What is left of X, and how far that is known.
        let left = self.lyapunov.solve_adjoint(&residual);
        let sizes = |n: &DMatrix<f64>, x: &DMatrix<f64>| match clock {
            Clock::Continuous => symmetric(&(&abs_c * x.abs() + b.abs() * n.abs())) * 2.0,
            Clock::Sampled => {
                let inner = b.abs() * n.abs() * abs_c.transpose();
                &abs_c * x.abs() * abs_c.transpose() + x.abs() + &inner + inner.transpose()
            }
        };
        let unsolved = match clock {
            Clock::Continuous => symmetric(&(closed * &left)) * 2.0 + &residual,
            Clock::Sampled => closed * &left * closed.transpose() - &left + &residual,
        };
        let unknown = unsolved.abs()
            + sizes(&DMatrix::zeros(ports, order), &left) * gamma(order)
            + sizes(n, &x) * (gamma(order) * UNIT);
        let definite_x = completion.map_or_else(|| x.clone(), |c| c.states(&x));
        let left = completion.map_or_else(|| left.clone(), |c| c.allowed(&left));
        let root = definite_x.clone().cholesky()?.l();
        let whiten = root.clone().try_inverse()?;
        let sigma = k * &x + n;
        let meets = match clock {
            Clock::Continuous => x.clone(),
            Clock::Sampled => closed * &x - b * n,
        };
        let meets_b = match clock {
            Clock::Continuous => sigma.clone(),
            Clock::Sampled => k * meets.transpose() + n * closed.transpose(),
        };
        let bound = majorant::products(&rounding.a, &whiten, &(&whiten * &meets))
            + majorant::products(&rounding.b, &whiten, &(&whiten * meets_b.transpose()))
            + majorant::entries(&symmetric(&unknown), &whiten);
        let back = |bound: DMatrix<f64>| symmetric(&(&root * bound * root.transpose()));
        let moved = self.lyapunov.solve_adjoint(&back(bound));
        let t = self.inputs(n, &x);
        let half = (k.abs() * x.abs() + n.abs() * 2.0) * k.abs().transpose();
        let error = symmetric(&half) * gamma(order);
        let t = completion.map_or_else(|| t.clone(), |c| c.inputs(&t));
        let inputs = completion.and_then(|c| c.r.clone()).map_or(Inputs::Any, Inputs::Given);
        let slack = ports as f64 * gamma(ports) * t.norm();
        let margin = inputs.least(&t) - slack;
        // Small where T is: what moves T between its large part and its small one counts by its square there.
        let scale = symmetric(&(&t + DMatrix::identity(ports, ports) * margin.abs()));
        let whiten_t = scale.cholesky().map(|c| c.l()).and_then(|root| root.try_inverse());
        let (root_t, whiten_t) = whiten_t
            .and_then(|w| Some((w.clone().try_inverse()?, w)))
            .unwrap_or_else(|| (DMatrix::identity(ports, ports), DMatrix::identity(ports, ports)));
        let own = &root_t * majorant::entries(&error, &whiten_t) * root_t.transpose();
        Some(Prepared {
            n: n.clone(),
            x,
            definite: definite_x,
            left,
            sigma,
            meets,
            root,
            whiten,
            moved,
            own,
            inputs,
            t,
            slack,
            root_t,
            whiten_t,
            margin,
        })
    }

    /// Majorant of how far a box of K moves X, to first order.
    pub(super) fn moved_by_gain(&self, of: &Prepared, box_k: &DMatrix<f64>) -> DMatrix<f64> {
        let Prepared { meets, root, whiten, .. } = of;
        let bound = majorant::products(box_k, &(whiten * &self.core.b), &(whiten * meets));
        self.lyapunov.solve_adjoint(&symmetric(&(root * bound * root.transpose())))
    }

    /// The margin of a multiplier over its rounding, with a box of K and what that makes of X; `None` where X is not
    /// definite for all of it.
    pub(super) fn ratio(&self, of: &Prepared, box_k: &DMatrix<f64>, by_gain: &DMatrix<f64>) -> Option<f64> {
        let Core { b, k, clock, rounding, .. } = self.core;
        let ports = k.nrows();
        let Prepared {
            n, x, definite: definite_x, left, sigma, meets, moved, own, inputs, t, root_t, whiten_t, ..
        } = of;
        let (slack, margin) = (of.slack, of.margin);
        let (change_b, change_k) = (rounding.b.norm(), box_k.norm());
        let change_c = (&rounding.a + b.abs() * box_k + &rounding.b * (k.abs() + box_k)).norm();
        // The equation of the loop as it may be, in place of that of the loop at hand, and the second order.
        let (through, second) = match clock {
            Clock::Continuous => (2.0 * change_c, 2.0 * change_b * change_k * x.norm()),
            Clock::Sampled => (
                (2.0 * self.closed.norm() + change_c) * change_c,
                change_c * change_c * x.norm() + 2.0 * change_b * (n.norm() * change_c + change_k * meets.norm()),
            ),
        };
        let drift = through * self.unit.norm();
        if drift >= 0.5 {
            return None;
        }
        let first = moved + by_gain + &self.unit * second;
        let of_x = (&first + &self.unit * (through * first.norm() / (1.0 - drift))) * (1.0 + 8.0 * UNIT);
        is_definite(definite_x, &(left - &of_x)).then_some(())?;
        let of_t = symmetric(&(k * &of_x * k.transpose()))
            + root_t * majorant::products(box_k, whiten_t, &(whiten_t * sigma)) * root_t.transpose()
            + own
            + DMatrix::identity(ports, ports)
                * (change_k * (change_k * (x.norm() + of_x.norm()) + 2.0 * k.norm() * of_x.norm()));
        let least = |share: f64| inputs.least(&(t - &of_t * share)) - slack;
        if least(1.0) <= 0.0 {
            return Some(margin / inputs.most(&of_t));
        }
        // The largest share that the multiplier bears.
        let (mut low, mut high) = (0.0_f64, LARGEST_RATIO.log2());
        for _ in 0..RATIO_HALVINGS {
            let middle = 0.5 * (low + high);
            if least(middle.exp2()) > 0.0 { low = middle } else { high = middle }
        }
        Some(low.exp2())
    }

    /// `Ω` for which `ΩMᵀ − MΩ` comes nearest to a wanted matrix, with `M = KB` (`K(A − BK)⁻¹B`), and the rows that
    /// take it to a multiplier: `N = Ω·(A_c⁻¹B)ᵀ`, or `ΩBᵀ`.
    fn antisymmetric(&self, wanted: &DMatrix<f64>) -> Option<(DMatrix<f64>, DMatrix<f64>)> {
        let m = self.core.ports();
        let shift = match self.core.clock {
            Clock::Continuous => self.core.b.transpose(),
            Clock::Sampled => self.closed.clone().lu().solve(&self.core.b)?.transpose(),
        };
        let product = &shift * self.core.k.transpose();
        let pairs: Vec<(usize, usize)> = (0..m).flat_map(|j| (0..j).map(move |i| (i, j))).collect();
        if pairs.is_empty() {
            return None;
        }
        let image = |&(i, j): &(usize, usize)| {
            let mut omega = DMatrix::zeros(m, m);
            omega[(i, j)] = 1.0;
            omega[(j, i)] = -1.0;
            let half = omega * &product;
            (&half + half.transpose()).as_slice().to_vec()
        };
        let columns: Vec<f64> = pairs.iter().flat_map(image).collect();
        let matrix = DMatrix::from_vec(m * m, pairs.len(), columns);
        let (u, values, v) = linalg::svd(&matrix).ok()?;
        let right = u.tr_mul(&DVector::from_column_slice(wanted.as_slice()));
        let mut omega = DMatrix::<f64>::zeros(m, m);
        for (at, value) in values.iter().enumerate().filter(|(_, v)| **v > 1e-14 * values[0].max(f64::MIN_POSITIVE)) {
            for (row, (i, j)) in pairs.iter().enumerate() {
                let entry = v[(row, at)] * right[at] / value;
                omega[(*i, *j)] += entry;
                omega[(*j, *i)] -= entry;
            }
        }
        Some((omega, shift))
    }

    /// N with an antisymmetric Ω more, which leaves X as it is, so that T comes as near as possible to a wanted one.
    pub(super) fn turned(&self, n: &DMatrix<f64>, wanted: &DMatrix<f64>) -> DMatrix<f64> {
        let missing = wanted - self.inputs(n, &self.states(n));
        self.antisymmetric(&missing).map_or_else(|| n.clone(), |(omega, shift)| n + omega * shift)
    }

    /// The certificate that no R ⪰ ρI makes `R·M` symmetric: `T = ΩMᵀ − MΩ` is orthogonal to all that do.
    pub(super) fn coupling(&self, wanted: &DMatrix<f64>) -> Option<Coupling> {
        let (omega, shift) = self.antisymmetric(wanted)?;
        let half = &omega * &shift * self.core.k.transpose();
        let t = symmetric(&(&half + half.transpose()));
        let m = t.nrows() as f64;
        let margin = FLOOR * t.trace() + m * (1.0 - FLOOR) * t.symmetric_eigenvalues().min();
        let found = Coupling { omega, ratio: 0.0, change: None };
        let ratio = |box_k: &DMatrix<f64>| {
            let Core { a, b, k, clock, rounding } = self.core;
            let moved = match clock {
                Clock::Continuous => box_k * b.abs() + k.abs() * &rounding.b,
                Clock::Sampled => {
                    let solved = shift.transpose().abs();
                    let gain = self.closed.transpose().lu().solve(&k.transpose())?.transpose().abs();
                    let change = &rounding.a + b.abs() * box_k + &rounding.b * k.abs();
                    box_k * &solved + &gain * change * &solved + gain * &rounding.b
                }
            };
            let own = 8.0 * a.nrows() as f64 * UNIT * (k.abs() * shift.transpose().abs()).norm();
            Some(margin / (m * 2.0 * found.omega.norm() * (moved.norm() + own)))
        };
        let own = ratio(&self.core.rounding.k).filter(|ratio| *ratio > CLEAR)?;
        let is_clear = |entry| ratio(&self.core.uniform(entry)).is_some_and(|ratio| ratio > CLEAR);
        let change = distance::largest(self.core, is_clear);
        Some(Coupling { ratio: own, change, ..found })
    }
}

/// An antisymmetric Ω that proves "infeasible" by the equality of R alone.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Coupling {
    pub omega: DMatrix<f64>,
    pub ratio: f64,
    pub change: Option<f64>,
}
