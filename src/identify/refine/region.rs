//! The stability margin as smooth inequalities.
//!
//! A polynomial that leaves the region through its edge has a zero there: the first coefficient of the mapped
//! polynomial vanishes (a root at the far end of the real axis, in sampled time), or the last (a real root), or the
//! last but one entry of Routh's first column (a pair, by Orlando's formula). These are smooth in the coefficients
//! wherever the polynomial is stable, double roots included.

use super::variable::Variable;
use nalgebra::{DMatrix, DVector};

/// How far inside the edge answers stay, in units of the mapped coefficients' sum.
const INSIDE: f64 = 1e-9;

/// A polynomial whose mapped coefficients are affine in the unknowns.
#[derive(Debug, Clone)]
pub(super) struct Margin {
    /// Mapped coefficients at unknowns 0.
    base: DVector<f64>,
    /// Their derivatives by the unknowns.
    slope: DMatrix<f64>,
    /// Which entries of the first column are kept, their signs and units, and how far above zero.
    kept: Vec<usize>,
    scale: f64,
    inside: Vec<f64>,
}

/// Routh's first column, and its derivatives if those of the coefficients are given.
fn first_column(coefficients: &DVector<f64>, slope: Option<&DMatrix<f64>>) -> (DVector<f64>, Option<DMatrix<f64>>) {
    let mut c = coefficients.clone();
    let mut d = slope.cloned();
    let length = c.len();
    for k in 0..length.saturating_sub(1) {
        let factor = c[k] / c[k + 1];
        let factor_slope = d.as_ref().map(|d| (d.row(k) - d.row(k + 1) * factor) / c[k + 1]);
        let mut i = k + 2;
        while i + 1 < length {
            if let (Some(d), Some(factor_slope)) = (&mut d, &factor_slope) {
                let change = d.row(i + 1) * factor + factor_slope * c[i + 1];
                let row = d.row(i) - change;
                d.set_row(i, &row);
            }
            c[i] -= factor * c[i + 1];
            i += 2;
        }
    }
    (c, d)
}

impl Margin {
    /// Of the polynomial `base + Σ unknownⱼ · termⱼ` in powers of x, around a start.
    ///
    /// `None` where the start is not inside the region.
    pub(super) fn new(
        variable: &Variable,
        margin_per_s: f64,
        base: &[f64],
        terms: &[Option<Vec<f64>>],
        degree: usize,
        start: &[f64],
    ) -> Option<Self> {
        let map = |p: &[f64]| DVector::from_vec(variable.map(margin_per_s, p, degree));
        let base = map(base);
        let mut slope = DMatrix::zeros(degree + 1, terms.len());
        for (j, term) in terms.iter().enumerate() {
            if let Some(term) = term {
                slope.set_column(j, &map(term));
            }
        }
        let at_start = &base + &slope * DVector::from_column_slice(start);
        let scale = at_start.iter().map(|c| c.abs()).sum::<f64>().copysign(at_start[0]);
        let (column, _) = first_column(&(&at_start / scale), None);
        let is_inside = column.iter().all(|entry| *entry > 0.0);
        let mut kept = vec![0, degree.saturating_sub(1), degree];
        kept.dedup();
        let inside = kept.iter().map(|i| INSIDE.min(0.5 * column[*i])).collect();
        is_inside.then_some(Self { base, slope, kept, scale, inside })
    }

    /// The number of inequalities.
    pub(super) fn len(&self) -> usize {
        self.kept.len()
    }

    fn mapped(&self, unknowns: &[f64]) -> DVector<f64> {
        (&self.base + &self.slope * DVector::from_column_slice(unknowns)) / self.scale
    }

    /// Whether every root is inside.
    pub(super) fn holds(&self, unknowns: &[f64]) -> bool {
        first_column(&self.mapped(unknowns), None).0.iter().all(|entry| *entry > 0.0)
    }

    /// The inequalities, and their derivatives by the unknowns.
    pub(super) fn evaluate(&self, unknowns: &[f64], with_slope: bool) -> (Vec<f64>, Option<DMatrix<f64>>) {
        let slope = with_slope.then(|| &self.slope / self.scale);
        let (column, slope) = first_column(&self.mapped(unknowns), slope.as_ref());
        let values = self.kept.iter().zip(&self.inside).map(|(i, inside)| column[*i] - inside).collect();
        (values, slope.map(|slope| slope.select_rows(&self.kept)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::Discrete;
    use crate::identify::problem::Line;
    use crate::identify::time::Time;
    use crate::num::Polynomial;
    use crate::num::rng;
    use num_complex::Complex64;
    use rand::RngExt;

    #[test]
    fn it_agrees_with_roots_and_differences() {
        let one = Complex64::new(1.0, 0.0);
        let lines = [Line { omega_rad_s: 1.3, plant: one, response: one, weight: 1.0 }];
        let mut random = rng::stream(3, "region");
        let (mut inside, mut outside) = (0, 0);
        for time in [Time::Continuous, Time::Sampled(Discrete::new(0.3).unwrap())] {
            let variable = Variable::new(time, &lines);
            for degree in 1..=6 {
                // Around (x + 0.6)^degree, which is stable in both.
                let mut start = Polynomial::new(vec![1.0]);
                for _ in 0..degree {
                    start = start.mul(&Polynomial::new(vec![1.0, 0.6]));
                }
                let base: Vec<f64> = std::iter::once(1.0).chain(std::iter::repeat_n(0.0, degree)).collect();
                let terms: Vec<Option<Vec<f64>>> = (0..degree)
                    .map(|j| Some(std::iter::once(1.0).chain(std::iter::repeat_n(0.0, degree - 1 - j)).collect()))
                    .collect();
                let start = &start.coefficients()[1..];
                let margin = Margin::new(&variable, 0.1, &base, &terms, degree, start).unwrap();
                for _ in 0..40 {
                    let point: Vec<f64> = start.iter().map(|c| c * (0.2 + 1.6 * random.random::<f64>())).collect();
                    let p = variable.leave(&[&[1.0], point.as_slice()].concat());
                    let slowest = time.slowest_exponent(&Polynomial::new(p).roots().unwrap()).unwrap();
                    let holds = margin.holds(&point);
                    assert_eq!(holds, slowest < -0.1, "{slowest} {point:?}");
                    *(if holds { &mut inside } else { &mut outside }) += 1;
                    if !holds {
                        continue;
                    }
                    let (values, slope) = margin.evaluate(&point, true);
                    let slope = slope.unwrap();
                    for j in 0..degree {
                        let moved = |by: f64| {
                            let mut moved = point.clone();
                            moved[j] += by;
                            margin.evaluate(&moved, false).0
                        };
                        let (up, down) = (moved(1e-6), moved(-1e-6));
                        for i in 0..values.len() {
                            let difference = (up[i] - down[i]) / 2e-6;
                            assert!((difference - slope[(i, j)]).abs() < 1e-4 * (1.0 + difference.abs()));
                        }
                    }
                }
            }
        }
        assert!(inside > 100 && outside > 30, "{inside} {outside}");
    }
}
