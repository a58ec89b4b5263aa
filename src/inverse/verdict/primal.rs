//! Primal certificates, which alone decide "feasible" for several inputs. Whatever found them is not believed.
//!
//! For symmetric P and R ≻ 0 the gain `K' = R⁻¹BᵀP` (`(R + BᵀPB)⁻¹BᵀPA`) is optimal for `Q' = K'ᵀRK' − AᵀP − PA`
//! (`P − AᵀPA + K'ᵀ(R + BᵀPB)K'`). Where K' lies within the rounding of K and Q' ≻ 0 by more than the rounding of the
//! data moves it, weights exist.

use super::distance;
use super::giving::{Giving, Response};
use crate::control::lyapunov::Clock;
use crate::convex::svec;
use crate::inverse::reach::Core;
use crate::inverse::rounding::UNIT;
use crate::inverse::space::state_weight;
use crate::num::linalg::{self, solve_symmetric, symmetric};
use nalgebra::{DMatrix, DVector};
use std::f64::consts::SQRT_2;

/// R counts as definite where its least eigenvalue is above this share of its mean (in balanced inputs).
pub(super) const FLOOR: f64 = 1e-6;
/// How much a margin must exceed what rounding moves.
pub(super) const CLEAR: f64 = 1.0;

/// Weights that prove "feasible", in the units of the core.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Primal {
    pub p: DMatrix<f64>,
    pub r: DMatrix<f64>,
    pub q: DMatrix<f64>,
    /// How many times its rounding the margin of Q is.
    pub ratio: f64,
    /// What rounding makes of each row of Q at most: `|ΔQ| ⪯ diag` of these.
    pub moved: DVector<f64>,
}

/// The equality in one of its forms: `BᵀPM = WK` with W = R and M = I (A − BK in sampled time), or in sampled time
/// with W = R + BᵀPB and M = A. Each loses digits where its M is nearly singular.
struct Form {
    /// |M⁻¹|.
    inverse: DMatrix<f64>,
    /// |KM⁻¹|.
    gain: DMatrix<f64>,
    /// KM⁻¹B, with which W is symmetric.
    product: DMatrix<f64>,
    /// Whether W is R + BᵀPB.
    is_sum: bool,
}

/// What is needed of the data to bound ΔQ.
pub(super) struct PrimalTest<'a> {
    core: &'a Core,
    /// |B⁺|ᵀ, n×m.
    pseudo: DMatrix<f64>,
    forms: Vec<Form>,
}

/// K or one near it, and how far W and the equality are from exact ones.
struct Standing {
    gain: DMatrix<f64>,
    /// A bound of the change of W.
    moved: f64,
    /// What the equality misses, entry by entry.
    missing: DMatrix<f64>,
}

impl<'a> PrimalTest<'a> {
    pub(super) fn new(core: &'a Core) -> Option<Self> {
        let pseudo = core.b.clone().pseudo_inverse(UNIT * core.b.norm()).ok()?.transpose().abs();
        let n = core.states();
        let form = |m: DMatrix<f64>, is_sum: bool| {
            let inverse = m.try_inverse()?;
            let gain = &core.k * &inverse;
            Some(Form { inverse: inverse.abs(), product: &gain * &core.b, gain: gain.abs(), is_sum })
        };
        let forms: Vec<Form> = match core.clock {
            Clock::Continuous => form(DMatrix::identity(n, n), false).into_iter().collect(),
            Clock::Sampled => form(core.closed_loop(), false).into_iter().chain(form(core.a.clone(), true)).collect(),
        };
        (!forms.is_empty()).then_some(Self { core, pseudo, forms })
    }

    /// How far W is from one that `W·M = Mᵀ·W` holds for exactly, M the product of the form: the symmetric matrices go
    /// onto the antisymmetric ones under `W ↦ WM − MᵀW` where M has distinct eigenvalues.
    fn asymmetry(&self, form: &Form, weight: &DMatrix<f64>) -> Option<f64> {
        if weight.nrows() == 1 {
            return Some(0.0);
        }
        let (n, m) = self.core.b.shape();
        let values = linalg::singular_values(&asymmetry_map(&form.product)).ok()?;
        let half = weight * &form.product;
        // Of this product, and of that in the form.
        let own = (m + 2) as f64 * (weight.abs() * form.product.abs()).norm();
        let inner = (n + 2) as f64 * (weight.abs() * (&form.gain * self.core.b.abs())).norm();
        let rounded = UNIT * (own + inner);
        let least = *values.last()?;
        (least > 0.0).then(|| ((&half - half.transpose()).norm() + rounded) / least)
    }

    /// The certificate of P and R; `None` where they prove nothing.
    pub(super) fn check(&self, p: &DMatrix<f64>, r: &DMatrix<f64>) -> Option<Primal> {
        self.check_within(p, r, &self.core.rounding.k).filter(|found| found.ratio > CLEAR)
    }

    /// The same with another box of K, in the form that proves most; the ratio may be below 1.
    pub(super) fn check_within(&self, p: &DMatrix<f64>, r: &DMatrix<f64>, box_k: &DMatrix<f64>) -> Option<Primal> {
        let found = self.check_forms(p, r, box_k);
        if found.as_ref().is_some_and(|found| found.ratio > CLEAR) {
            return found;
        }
        let other = self.giving(p, r, box_k).map(|(giving, response)| {
            let ratio = giving.ratio(&response, box_k);
            let moved = giving.q.diagonal() / ratio;
            Primal { p: p.clone(), r: r.clone(), q: giving.q, ratio, moved }
        });
        found.into_iter().chain(other).max_by(|x, y| x.ratio.total_cmp(&y.ratio))
    }

    fn check_forms(&self, p: &DMatrix<f64>, r: &DMatrix<f64>, box_k: &DMatrix<f64>) -> Option<Primal> {
        let found = self.forms.iter().filter_map(|form| self.check_form(form, p, r, box_k));
        found.max_by(|x, y| x.ratio.total_cmp(&y.ratio))
    }

    /// The weights as they give way direction by direction: with R held where that proves them, and otherwise jointly.
    fn giving(&self, p: &DMatrix<f64>, r: &DMatrix<f64>, box_k: &DMatrix<f64>) -> Option<(Giving<'a>, Response)> {
        let values = r.symmetric_eigenvalues();
        if values.min() < FLOOR * values.mean() {
            return None;
        }
        let giving = Giving::new(self.core, p, r)?;
        // With R held only for a gain of the box: else P would have to be what no symmetric matrix is.
        let is_there = || {
            let (standing, _) = self.standing(self.forms.first()?, p, r)?;
            (standing.moved == 0.0).then_some(())
        };
        let held = is_there().and_then(|()| giving.held());
        match held {
            Some(held) if giving.ratio(&held, box_k) > CLEAR => Some((giving, held)),
            held => {
                let response = giving.joint().or(held)?;
                Some((giving, response))
            }
        }
    }

    /// The relative change of K up to which weights remain definite, by the certificate that proves them.
    pub(super) fn change(&self, p: &DMatrix<f64>, r: &DMatrix<f64>) -> Option<f64> {
        let is_clear = |found: Option<Primal>| found.is_some_and(|found| found.ratio > CLEAR);
        if is_clear(self.check_forms(p, r, &self.core.rounding.k)) {
            return distance::largest(self.core, |entry| is_clear(self.check_forms(p, r, &self.core.uniform(entry))));
        }
        let (giving, response) = self.giving(p, r, &self.core.rounding.k)?;
        distance::largest(self.core, |entry| giving.ratio(&response, &self.core.uniform(entry)) > CLEAR)
    }

    /// How far P and R are from exact ones for K, or for a gain within its rounding.
    fn standing(&self, form: &Form, p: &DMatrix<f64>, r: &DMatrix<f64>) -> Option<(Standing, DMatrix<f64>)> {
        let Core { a, b, k, clock, rounding } = self.core;
        let values = r.symmetric_eigenvalues();
        if values.min() < FLOOR * values.mean() {
            return None;
        }
        let bp = b.tr_mul(p);
        let (weight, right) = match clock {
            Clock::Continuous => (r.clone(), bp),
            Clock::Sampled => (symmetric(&(r + &bp * b)), &bp * a),
        };
        weight.clone().cholesky()?;
        let k_there = solve_symmetric(&weight, &right);
        if (&k_there - k).iter().zip(rounding.k.iter()).all(|(d, bound)| d.abs() <= *bound) {
            let missing = DMatrix::zeros(k.nrows(), k.ncols());
            return Some((Standing { gain: k_there, moved: 0.0, missing }, weight));
        }
        // Otherwise K itself, with W moved so that P exists exactly, and P with it.
        let moved = self.asymmetry(form, if form.is_sum { &weight } else { r })?;
        let in_r = if form.is_sum { moved * (1.0 + form.product.norm()) } else { moved };
        let missing = (right - &weight * k).abs();
        let is_small = in_r <= 0.1 * values.min() && missing.iter().all(|v| v.is_finite());
        is_small.then_some((Standing { gain: k.clone(), moved, missing }, weight))
    }

    fn check_form(&self, form: &Form, p: &DMatrix<f64>, r: &DMatrix<f64>, box_k: &DMatrix<f64>) -> Option<Primal> {
        let Core { a, b, k, clock, rounding } = self.core;
        let (Standing { gain, moved: moved_w, missing }, weight) = self.standing(form, p, r)?;
        let q = state_weight(a, b, &gain, p, r, *clock);
        let (abs_p, abs_k, abs_w, abs_a, abs_b) = (p.abs(), k.abs(), weight.abs(), a.abs(), b.abs());
        let from_plant = match clock {
            Clock::Continuous => rounding.b.tr_mul(&abs_p),
            Clock::Sampled => abs_b.tr_mul(&(&abs_p * &rounding.a)) + rounding.b.tr_mul(&(&abs_p * &abs_a)),
        };
        // What is missing in BᵀP, and so in P.
        let e = (&abs_w * box_k + from_plant + missing) * &form.inverse
            + DMatrix::from_fn(r.nrows(), a.nrows(), |_, j| moved_w * form.gain.column(j).norm());
        let dp = &self.pseudo * e;
        let dp = &dp + dp.transpose();
        let twice = |m: DMatrix<f64>| &m + m.transpose();
        let direct = twice(box_k.tr_mul(&(&abs_w * &abs_k))) + abs_k.tr_mul(&abs_k) * (moved_w * r.nrows() as f64);
        let moved = direct
            + match clock {
                Clock::Continuous => twice(rounding.a.tr_mul(&abs_p) + abs_a.tr_mul(&dp)),
                Clock::Sampled => {
                    let closed = (a - b * k).abs();
                    let through_b = abs_b.tr_mul(&(&dp * &abs_b)) + twice(rounding.b.tr_mul(&(&abs_p * &abs_b)));
                    twice(rounding.a.tr_mul(&(&abs_p * &abs_a)))
                        + &dp
                        + closed.tr_mul(&(&dp * &closed))
                        + abs_k.tr_mul(&(through_b * &abs_k))
                }
            };
        let d = q.diagonal();
        if d.iter().any(|v| v.is_nan() || *v <= 0.0) {
            return None;
        }
        let scaled = |m: &DMatrix<f64>, d: &DVector<f64>| {
            DMatrix::from_fn(d.len(), d.len(), |i, j| m[(i, j)] / (d[i] * d[j]).sqrt())
        };
        let least = |d: &DVector<f64>| scaled(&q, d).symmetric_eigenvalues().min();
        let rows = moved.column_sum();
        // Against a unit diagonal, and against a diagonal that dominates what rounding moves; either bound holds.
        let ratio = (least(&d) / symmetric(&scaled(&moved, &d)).symmetric_eigenvalues().max()).max(least(&rows));
        Some(Primal { p: p.clone(), r: r.clone(), q, ratio, moved: rows })
    }
}

/// The matrix of `R ↦ RM − MᵀR` from the coordinates of symmetric matrices (√2 off the diagonal) to those of
/// antisymmetric ones.
pub(super) fn asymmetry_map(product: &DMatrix<f64>) -> DMatrix<f64> {
    let m = product.nrows();
    let mut map = DMatrix::zeros(m * (m - 1) / 2, svec::length(m));
    for at in 0..svec::length(m) {
        let mut unit = vec![0.0; svec::length(m)];
        unit[at] = 1.0;
        let half = svec::smat(&unit, m) * product;
        let mut row = 0;
        for j in 0..m {
            for i in 0..j {
                map[(row, at)] = SQRT_2 * (half[(i, j)] - half[(j, i)]);
                row += 1;
            }
        }
    }
    map
}
