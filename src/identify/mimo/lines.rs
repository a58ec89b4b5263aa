//! The lines of a multivariable problem, and what of them does not depend on the candidate.

use crate::control::{Discrete, Multivariable};
use crate::identify::problem::{Dropped, Unusable};
use nalgebra::DMatrix;
use num_complex::Complex64;

/// Frequency data of a closed loop: one n×l response per line, from l commands to n measured outputs.
#[derive(Debug, Clone, PartialEq)]
pub struct MatrixFrequencyData {
    /// Angular frequencies in rad/s.
    pub omega_rad_s: Vec<f64>,
    /// The response at each, n×l.
    pub h: Vec<DMatrix<Complex64>>,
    /// Variance of each line, the same for all channels; only weights by inverse variance need it.
    pub variance: Option<Vec<f64>>,
}

/// A frequency at which the closed loop was measured.
#[derive(Debug, Clone, PartialEq)]
pub struct Line {
    /// Angular frequency in rad/s.
    pub omega_rad_s: f64,
    /// The point `e^{jωT}`.
    pub z: Complex64,
    /// Gy there, n×m, of full column rank where it has as many rows as columns.
    pub measured: DMatrix<Complex64>,
    /// Gv there, l×m.
    pub fed_back: DMatrix<Complex64>,
    /// Measured response, n×l.
    pub response: DMatrix<Complex64>,
    /// Weight of its squared residual, positive.
    pub weight: f64,
    /// R of `√weight Gy = Q R`, m×m; `√weight Gy` itself where it has fewer rows than columns.
    pub root: DMatrix<Complex64>,
    /// `√weight Q* H`, m×l; `√weight H` where Gy has fewer rows than columns.
    pub target: DMatrix<Complex64>,
}

/// The usable lines.
#[derive(Debug, Clone, PartialEq)]
pub struct Lines {
    /// In the given order.
    pub used: Vec<Line>,
    /// The others.
    pub dropped: Vec<Dropped>,
    /// `Σ weight ‖(I − Q Q*) H‖²`: what no controller can explain, since Gy does not reach it.
    pub unreachable: f64,
}

/// A plant response above the typical one by this factor counts as a pole on the line.
const POLE: f64 = 1e10;

/// A plant whose smallest gain at a line is below this share of its largest one there is singular at the line.
const SINGULAR: f64 = 1e-8;

impl Lines {
    /// From plant and data; `weights` are relative, all 1 if not given.
    ///
    /// # Panics
    /// If sizes disagree, which is a mistake of the caller.
    #[must_use]
    pub fn new(
        plant: &Multivariable<Discrete>,
        measured: &[usize],
        fed_back: &[usize],
        data: &MatrixFrequencyData,
        weights: Option<&[f64]>,
    ) -> Self {
        assert_eq!(data.omega_rad_s.len(), data.h.len(), "a response for every line");
        assert!(weights.is_none_or(|w| w.len() == data.h.len()), "a weight for every line");
        let period = plant.time().period_s();
        let nyquist = std::f64::consts::PI / period * (1.0 + 1e-9);
        let point = |omega: f64| Complex64::from_polar(1.0, omega * period);
        let values: Vec<Option<DMatrix<Complex64>>> = data.omega_rad_s.iter().map(|w| plant.eval(point(*w))).collect();
        let size = |value: &DMatrix<Complex64>| value.iter().map(|v| v.norm_sqr()).sum::<f64>().sqrt();
        let mut sizes: Vec<f64> = values.iter().flatten().map(size).filter(|s| s.is_finite() && *s > 0.0).collect();
        sizes.sort_by(f64::total_cmp);
        let typical = sizes.get(sizes.len() / 2).copied().unwrap_or(1.0);
        let mut lines = Self { used: Vec::new(), dropped: Vec::new(), unreachable: 0.0 };
        for (k, (omega, h)) in data.omega_rad_s.iter().zip(&data.h).enumerate() {
            let weight = weights.map_or(1.0, |w| w[k]);
            let value = values[k].as_ref().filter(|v| size(v) < typical * POLE);
            let mut drop = |why| lines.dropped.push(Dropped { omega_rad_s: *omega, why });
            if *omega > nyquist {
                drop(Unusable::AboveNyquist);
            } else if h.iter().any(|v| !(v.re.is_finite() && v.im.is_finite())) {
                drop(Unusable::NoResponse);
            } else if !(weight.is_finite() && weight > 0.0) {
                drop(Unusable::NoWeight);
            } else if let Some(value) = value {
                let (gy, gv) = (value.select_rows(measured), value.select_rows(fed_back));
                let scale = Complex64::new(weight.sqrt(), 0.0);
                if gy.nrows() < gy.ncols() {
                    // Nothing to separate: every response is reached, and whether by one feedforward alone is judged
                    // over all lines together.
                    if size(&gy) <= typical * SINGULAR {
                        drop(Unusable::PlantZero);
                        continue;
                    }
                    lines.used.push(Line {
                        omega_rad_s: *omega,
                        z: point(*omega),
                        root: &gy * scale,
                        target: h * scale,
                        measured: gy,
                        fed_back: gv,
                        response: h.clone(),
                        weight,
                    });
                    continue;
                }
                let decomposed = gy.clone().qr();
                let (q, root) = (decomposed.q(), decomposed.r());
                if is_singular(&root, typical) {
                    drop(Unusable::PlantZero);
                    continue;
                }
                let (root, weighted) = (root * scale, h * scale);
                let target = q.adjoint() * &weighted;
                // With as many controls as outputs every response is reached.
                if gy.nrows() > gy.ncols() {
                    lines.unreachable += (weighted - q * &target).iter().map(|v| v.norm_sqr()).sum::<f64>();
                }
                lines.used.push(Line {
                    omega_rad_s: *omega,
                    z: point(*omega),
                    measured: gy,
                    fed_back: gv,
                    response: h.clone(),
                    weight,
                    root,
                    target,
                });
            } else {
                drop(Unusable::PlantPole);
            }
        }
        lines
    }

    /// Whether fewer outputs are measured than there are controls.
    #[must_use]
    pub fn is_wide(&self) -> bool {
        self.used.first().is_some_and(|line| line.root.nrows() < line.root.ncols())
    }

    /// Real equations: two per line and entry of the response, one where everything is real.
    #[must_use]
    pub fn equations(&self) -> usize {
        let of = |line: &Line| line.response.len() * if line.z.im.abs() < 1e-12 { 1 } else { 2 };
        self.used.iter().map(of).sum()
    }
}

/// Whether a triangular factor is singular to working precision, or vanishes beside the plant's typical size.
fn is_singular(root: &DMatrix<Complex64>, typical: f64) -> bool {
    let m = root.ncols();
    // The real form [re −im; im re] has every singular value twice.
    let real = DMatrix::from_fn(2 * m, 2 * m, |i, j| {
        let v = root[(i % m, j % m)];
        match (i < m, j < m) {
            (true, true) | (false, false) => v.re,
            (true, false) => -v.im,
            (false, true) => v.im,
        }
    });
    match crate::num::linalg::singular_values(&real) {
        Ok(values) => {
            let (largest, smallest) = (values.first().copied().unwrap_or(0.0), values.last().copied().unwrap_or(0.0));
            // Written so that NaN fails too.
            let is_regular = smallest > SINGULAR * largest && largest > typical / POLE;
            !is_regular
        }
        Err(_) => true,
    }
}
