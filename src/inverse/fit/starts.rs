//! Where fits start.

use crate::control::lyapunov::{Clock, Lyapunov};
use crate::convex::lmi::{self, Block, LmiError, Problem};
use crate::ctl::Ctl;
use crate::inverse::gains::Gains;
use crate::num::linalg::symmetric;
use crate::num::rng::Stream;
use nalgebra::{DMatrix, DVector};
use rand::RngExt;

/// Weights with a cross term for which the gain is optimal exactly.
#[derive(Debug, Clone, PartialEq)]
pub struct CrossTerm {
    /// Q, n×n.
    pub q: DMatrix<f64>,
    /// R ⪰ I, m×m.
    pub r: DMatrix<f64>,
    /// S, n×m.
    pub s: DMatrix<f64>,
    /// `‖S‖_F`.
    pub norm: f64,
}

/// The weights with the smallest cross term S, Priess 2015, eq. (3.20), with `R ⪰ I` (without a normalisation the
/// infimum is 0): `min ‖S‖_F` with `Sᵀ = RK − BᵀP`, `Q = KᵀRK − AᵀP − PA`, `[Q S; Sᵀ R] ⪰ 0`, `P ⪰ 0`; in sampled time
/// `Sᵀ = RK − BᵀP(A − BK)`, `Q = P − AᵀPA + Kᵀ(BᵀPB + R)K`.
///
/// # Errors
/// [`LmiError`] when stopped.
pub fn smallest_cross_term(gains: &Gains, ctl: &Ctl) -> Result<CrossTerm, LmiError> {
    let (n, m) = (gains.states(), gains.ports());
    // As for the exact problem: B' = sB, K' = K/s, P = s²P', S = sS', Q = s²Q'.
    let scale = gains.k.norm();
    let (a, b, k) = (&gains.a, &gains.b * scale, &gains.k / scale);
    let closed = a - &b * &k;
    let parts = |p: &DMatrix<f64>, r: &DMatrix<f64>| {
        let rk = r * &k;
        match gains.clock {
            Clock::Continuous => {
                let pa = p * a;
                (symmetric(&(k.tr_mul(&rk) - &pa - pa.transpose())), (rk - b.tr_mul(p)).transpose())
            }
            Clock::Sampled => {
                let weight = b.tr_mul(&(p * &b)) + r;
                let q = p - a.tr_mul(&(p * a)) + k.tr_mul(&(weight * &k));
                (symmetric(&q), (rk - b.tr_mul(&(p * &closed))).transpose())
            }
        }
    };
    let mut unknowns = Vec::new();
    for (order, is_p) in [(n, true), (m, false)] {
        for j in 0..order {
            for i in 0..=j {
                let mut e = DMatrix::zeros(order, order);
                e[(i, j)] = 1.0;
                e[(j, i)] = 1.0;
                unknowns.push(if is_p { (e, DMatrix::zeros(m, m)) } else { (DMatrix::zeros(n, n), e) });
            }
        }
    }
    let terms: Vec<_> = unknowns.iter().map(|(p, r)| parts(p, r)).collect();
    let block = |q: &DMatrix<f64>, s: &DMatrix<f64>, r: &DMatrix<f64>| {
        let mut whole = DMatrix::zeros(n + m, n + m);
        whole.view_mut((0, 0), (n, n)).copy_from(q);
        whole.view_mut((0, n), (n, m)).copy_from(s);
        whole.view_mut((n, 0), (m, n)).copy_from(&s.transpose());
        whole.view_mut((n, n), (m, m)).copy_from(r);
        whole
    };
    let whole: Vec<_> = terms.iter().zip(&unknowns).map(|((q, s), (_, r))| block(q, s, r)).collect();
    let count = unknowns.len();
    // The cost (u + Kx)ᵀR(u + Kx) has the gain K, and a little of xᵀx makes it definite: a start within the cone. With
    // P = εP₁ and P₁ that of xᵀx it is definite for ε‖P₁B‖² (in sampled time ε‖…‖²) below R.
    let no_start = LmiError::Infeasible { block: 0 };
    let one = Lyapunov::new(&closed, gains.clock).map_err(|_| no_start.clone())?.solve(&DMatrix::identity(n, n));
    let coupling = match gains.clock {
        Clock::Continuous => b.tr_mul(&one),
        Clock::Sampled => b.tr_mul(&(&one * &closed)),
    };
    let epsilon = 1.0 / (coupling.norm_squared() + b.tr_mul(&(&one * &b)).norm()).max(1e-12);
    let (start_p, start_r) = (&one * epsilon, DMatrix::<f64>::identity(m, m) * 2.0);
    let mut start = DVector::zeros(count);
    let mut at = 0;
    for (matrix, order) in [(&start_p, n), (&start_r, m)] {
        for j in 0..order {
            for i in 0..=j {
                start[at] = matrix[(i, j)];
                at += 1;
            }
        }
    }
    let (_, s0) = parts(&start_p, &start_r);
    let size = s0.norm_squared().max(f64::MIN_POSITIVE);
    let problem = Problem {
        cost: DVector::zeros(count),
        quadratic: Some(DMatrix::from_fn(count, count, |i, j| 2.0 * terms[i].1.dot(&terms[j].1) / size)),
        objective_scale: 1e-4,
        gap: lmi::GAP,
        blocks: vec![
            Block::new(DMatrix::zeros(n + m, n + m), whole.iter()),
            Block::new(-DMatrix::identity(m, m), unknowns.iter().map(|(_, r)| r)),
            Block::new(DMatrix::zeros(n, n), unknowns.iter().map(|(p, _)| p)),
        ],
    };
    let z = lmi::solve(&problem, &start, ctl)?.z;
    let mut q = DMatrix::zeros(n, n);
    let mut s = DMatrix::zeros(n, m);
    let mut r = DMatrix::zeros(m, m);
    for (((dq, ds), (_, dr)), z) in terms.iter().zip(&unknowns).zip(z.iter()) {
        q += dq * (z * scale * scale);
        s += ds * (z * scale);
        r += dr * *z;
    }
    Ok(CrossTerm { q: symmetric(&q), r: symmetric(&r), norm: s.norm(), s })
}

/// Weights with their eigenvalues moved into `(1, κ)`, the geometric mean of the extremes in the middle; Q on the
/// states that are weighed, all where none are named.
pub(super) fn into_box(
    q: &DMatrix<f64>,
    r: &DMatrix<f64>,
    kappa: f64,
    weighed: Option<&[usize]>,
) -> (DMatrix<f64>, DMatrix<f64>) {
    if let Some(kept) = weighed {
        let (part, r) = into_box(&q.select_rows(kept).select_columns(kept), r, kappa, None);
        let mut whole = DMatrix::zeros(q.nrows(), q.ncols());
        for (i, row) in kept.iter().enumerate() {
            for (j, column) in kept.iter().enumerate() {
                whole[(*row, *column)] = part[(i, j)];
            }
        }
        return (whole, r);
    }
    let (eq, er) = (symmetric(q).symmetric_eigen(), symmetric(r).symmetric_eigen());
    let largest = eq.eigenvalues.amax().max(er.eigenvalues.amax()).max(f64::MIN_POSITIVE);
    let floor = |v: f64| v.max(largest * 1e-3 / kappa);
    let least = eq.eigenvalues.iter().chain(er.eigenvalues.iter()).map(|v| floor(*v)).fold(f64::INFINITY, f64::min);
    let scale = (kappa / (least * largest)).sqrt();
    let margin = kappa.powf(0.02);
    let clip = |v: f64| (floor(v) * scale).clamp(margin, kappa / margin);
    let back = |e: &nalgebra::SymmetricEigen<f64, nalgebra::Dyn>| {
        symmetric(&(&e.eigenvectors * DMatrix::from_diagonal(&e.eigenvalues.map(clip)) * e.eigenvectors.transpose()))
    };
    (back(&eq), back(&er))
}

/// Weights with random axes and eigenvalues spread evenly over the magnitudes from 1 to κ.
pub(super) fn random(n: usize, m: usize, kappa: f64, stream: &mut Stream) -> (DMatrix<f64>, DMatrix<f64>) {
    let mut weight = |order: usize| {
        let axes = DMatrix::from_fn(order, order, |_, _| stream.random_range(-1.0..1.0)).qr().q();
        let values = DVector::from_fn(order, |_, _| kappa.powf(stream.random_range(0.03..0.97)));
        symmetric(&(&axes * DMatrix::from_diagonal(&values) * axes.transpose()))
    };
    (weight(n), weight(m))
}
