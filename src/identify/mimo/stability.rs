//! Closed-loop stability of candidates by the determinant polynomial.
//!
//! With `X = [Dfb Nfb]` (m×(m+l)) and `Y = [D; Nv]` ((m+l)×m) the closed loop's polynomial is
//! `ψ = det(Dfb D + Nfb Nv) = det(X Y)` (Zhang 2015, assumption A3.3), and by Cauchy and Binet
//! `ψ = Σ_S det X_S · det Y_S` over all choices S of m columns of X. The minors of Y belong to the plant alone.
//! Expanding det X_S along its last row makes ψ, with the upper rows fixed, an affine function of the last row's
//! coefficients, which is how candidates are tested. For a plant in state space `a det([I; Gv]_S)` stands in for det
//! Y_S, with `a = det(zI − A)`; it is a polynomial as well, the determinant of a system matrix.
//!
//! Every coefficient carries a bound of its rounding error, so that a root on the boundary to working precision is not
//! stable.

use super::pool::{Entry, FeedbackPool};
use crate::control::stability::is_schur_within_errors;
use crate::control::{Discrete, Multivariable, RightFraction, StateSpace};
use nalgebra::DMatrix;
use num_complex::Complex64;

/// A polynomial in ascending powers; each coefficient errs by at most the tester's unit times its bound.
#[derive(Debug, Clone, PartialEq)]
struct Bounded {
    value: Vec<f64>,
    bound: Vec<f64>,
}

impl Bounded {
    fn zero(length: usize) -> Self {
        Self { value: vec![0.0; length], bound: vec![0.0; length] }
    }

    fn given(ascending: Vec<f64>) -> Self {
        let bound = ascending.iter().map(|c| c.abs()).collect();
        Self { value: ascending, bound }
    }

    fn is_zero(&self) -> bool {
        self.bound.iter().all(|b| *b == 0.0)
    }

    /// Adds `sign · a · b`; lengths must suffice.
    fn add_product(&mut self, a: &Self, b: &Self, sign: f64) {
        for (i, (x, dx)) in a.value.iter().zip(&a.bound).enumerate() {
            for (j, (y, dy)) in b.value.iter().zip(&b.bound).enumerate() {
                if *dx != 0.0 && *dy != 0.0 {
                    self.value[i + j] += sign * x * y;
                    self.bound[i + j] += dx * dy;
                }
            }
        }
    }
}

/// All subsets of `0..n` with `k` members, each as a bit mask.
fn subsets(n: usize, k: usize) -> Vec<u32> {
    (0..1_u32 << n).filter(|mask| mask.count_ones() as usize == k).collect()
}

fn members(mask: u32) -> Vec<usize> {
    (0..32).filter(|i| mask & (1 << i) != 0).collect()
}

/// Tests candidates of a pool on a plant.
#[derive(Debug, Clone)]
pub struct Tester<'a> {
    pool: &'a FeedbackPool,
    /// Minors of Y by their rows.
    plant: Vec<(u32, Bounded)>,
    /// Degree of ψ.
    degree: usize,
    radius: f64,
    unit: f64,
}

/// The tester with all rows but the last one fixed: ψ is affine in the last row's coefficients.
#[derive(Debug, Clone)]
pub struct LastRow {
    base: Bounded,
    /// By coefficient.
    slopes: Vec<Bounded>,
    radius: f64,
    unit: f64,
    /// Scratch, descending.
    value: Vec<f64>,
    error: Vec<f64>,
}

impl<'a> Tester<'a> {
    /// For a plant whose outputs `fed_back` are fed back.
    #[must_use]
    pub fn new(pool: &'a FeedbackPool, plant: &Multivariable<Discrete>, fed_back: &[usize]) -> Self {
        let (m, l) = (plant.inputs(), fed_back.len());
        let choices = subsets(m + l, m);
        let degree = plant.states() + pool.states();
        let unit = f64::EPSILON * (16 + 8 * m + choices.len() * (degree + 1)) as f64;
        let minors = match plant {
            Multivariable::Fraction(fraction) => {
                choices.iter().map(|s| fraction_minor(fraction, fed_back, *s)).collect()
            }
            Multivariable::StateSpace(model) => state_space_minors(model, fed_back, &choices, unit),
        };
        let kept = choices.into_iter().zip(minors).filter(|(_, minor): &(u32, Bounded)| !minor.is_zero()).collect();
        Self { pool, plant: kept, degree, radius: pool.radius(plant.time()), unit }
    }

    /// With the upper rows fixed at these coefficients.
    #[must_use]
    pub fn last_row(&self, upper: &[Vec<f64>]) -> LastRow {
        let rows = self.pool.rows();
        let (m, l) = (rows.len(), self.pool.fed_back());
        let (upper_rows, last) = (&rows[..m - 1], &rows[m - 1]);
        // Entries of the upper rows of X.
        let entries: Vec<Vec<Bounded>> = upper_rows
            .iter()
            .zip(upper)
            .enumerate()
            .map(|(i, (row, values))| {
                let length = 1 + row.degree.max(row.numerator_degree());
                let mut entries = vec![vec![0.0; length]; m + l];
                entries[i][row.degree] = 1.0;
                for (coefficient, value) in row.coefficients.iter().zip(values) {
                    entries[column(coefficient.of, m)][coefficient.power] = *value;
                }
                entries.into_iter().map(Bounded::given).collect()
            })
            .collect();
        let span: usize = entries.iter().map(|row| row[0].value.len() - 1).sum();
        let minors: Vec<(u32, Bounded)> = subsets(m + l, m - 1)
            .into_iter()
            .map(|u| (u, minor(&entries, 0, &members(u), span)))
            .filter(|(_, minor)| !minor.is_zero())
            .collect();
        // Cofactors of the last row: the sum over S that hold the column.
        let length = 1 + span + self.plant.iter().map(|(_, p)| p.value.len() - 1).max().unwrap_or(0);
        let cofactors: Vec<Bounded> = (0..m + l)
            .map(|c| {
                let mut cofactor = Bounded::zero(length);
                for (s, of_plant) in self.plant.iter().filter(|(s, _)| s & (1 << c) != 0) {
                    let rest = s & !(1 << c);
                    if let Some((_, of_rows)) = minors.iter().find(|(u, _)| *u == rest) {
                        let position = (s & ((1 << c) - 1)).count_ones() as usize;
                        let sign = if (m - 1 + position).is_multiple_of(2) { 1.0 } else { -1.0 };
                        cofactor.add_product(of_plant, of_rows, sign);
                    }
                }
                cofactor
            })
            .collect();
        let shifted = |c: usize, power: usize| {
            let mut sum = Bounded::zero(self.degree + 1);
            for i in 0..length.min((self.degree + 1).saturating_sub(power)) {
                sum.value[i + power] = cofactors[c].value[i];
                sum.bound[i + power] = cofactors[c].bound[i];
            }
            sum
        };
        LastRow {
            base: shifted(m - 1, last.degree),
            slopes: last.coefficients.iter().map(|c| shifted(column(c.of, m), c.power)).collect(),
            radius: self.radius,
            unit: self.unit,
            value: vec![0.0; self.degree + 1],
            error: vec![0.0; self.degree + 1],
        }
    }
}

impl LastRow {
    fn fill(&mut self, last: &[f64]) {
        let n = self.value.len();
        for i in 0..n {
            let (mut value, mut bound) = (self.base.value[i], self.base.bound[i]);
            for (x, slope) in last.iter().zip(&self.slopes) {
                value += x * slope.value[i];
                bound += x.abs() * slope.bound[i];
            }
            self.value[n - 1 - i] = value;
            self.error[n - 1 - i] = self.unit * bound;
        }
    }

    /// Whether every closed-loop pole lies within the pool's radius, whatever rounding did.
    #[must_use]
    pub fn is_stable(&mut self, last: &[f64]) -> bool {
        self.fill(last);
        is_schur_within_errors(&self.value, &self.error, self.radius)
    }

    /// ψ in descending powers.
    #[must_use]
    pub fn polynomial(&mut self, last: &[f64]) -> Vec<f64> {
        self.fill(last);
        self.value.clone()
    }
}

/// The column of X of an entry.
fn column(of: Entry, controls: usize) -> usize {
    match of {
        Entry::Denominator(j) => j,
        Entry::Numerator(j) => controls + j,
    }
}

/// The determinant of `rows[first..]` at these columns, by expansion along the first of the rows.
fn minor(rows: &[Vec<Bounded>], first: usize, columns: &[usize], span: usize) -> Bounded {
    let mut sum = Bounded::zero(span + 1);
    if columns.is_empty() {
        (sum.value[0], sum.bound[0]) = (1.0, 1.0);
        return sum;
    }
    let own = rows[first][0].value.len() - 1;
    for (at, c) in columns.iter().enumerate() {
        let entry = &rows[first][*c];
        if entry.is_zero() {
            continue;
        }
        let rest: Vec<usize> = columns.iter().copied().filter(|other| other != c).collect();
        sum.add_product(entry, &minor(rows, first + 1, &rest, span - own), if at % 2 == 0 { 1.0 } else { -1.0 });
    }
    sum
}

/// det Y_S of a right fraction.
fn fraction_minor(fraction: &RightFraction<Discrete>, fed_back: &[usize], rows: u32) -> Bounded {
    let m = fraction.denominator().columns();
    let entries: Vec<Vec<Bounded>> = members(rows)
        .into_iter()
        .map(|row| {
            let of = |j: usize| {
                if row < m {
                    fraction.denominator().entry(row, j)
                } else {
                    fraction.numerator().entry(fed_back[row - m], j)
                }
            };
            let length = 1 + (0..m).map(|j| of(j).degree()).max().unwrap_or(0);
            (0..m)
                .map(|j| {
                    let mut ascending: Vec<f64> = of(j).coefficients().iter().rev().copied().collect();
                    ascending.resize(length, 0.0);
                    Bounded::given(ascending)
                })
                .collect()
        })
        .collect();
    let span = entries.iter().map(|row| row[0].value.len() - 1).sum();
    let all: Vec<usize> = (0..m).collect();
    let mut minor = minor(&entries, 0, &all, span);
    // A proper fraction: no minor exceeds the degree of det D; what is above has cancelled.
    let kept = fraction.states() + 1;
    minor.value.truncate(kept);
    minor.bound.truncate(kept);
    minor
}

/// `a det([I; Gv]_S)` for all S, by interpolation on the unit circle of the determinants of the system matrices
/// `[zI − A, −B; T₂ Cv, T₁ + T₂ Dv]`, T₁ and T₂ choosing the rows of I and of Gv. Two sets of points show the error.
fn state_space_minors(model: &StateSpace<Discrete>, fed_back: &[usize], choices: &[u32], unit: f64) -> Vec<Bounded> {
    let model = model.balanced();
    let (n, m) = (model.states(), model.inputs());
    let count = n + 1;
    let determinant = |rows: &[usize], z: Complex64| {
        let complex = |v: f64| Complex64::new(v, 0.0);
        DMatrix::from_fn(n + m, n + m, |i, j| match (i < n, j < n) {
            (true, true) => complex(-model.a()[(i, j)]) + if i == j { z } else { complex(0.0) },
            (true, false) => complex(-model.b()[(i, j - n)]),
            (false, is_state) => match (rows[i - n], is_state) {
                (row, true) if row < m => complex(0.0),
                (row, false) if row < m => complex(f64::from(u8::from(row == j - n))),
                (row, true) => complex(model.c()[(fed_back[row - m], j)]),
                (row, false) => complex(model.d()[(fed_back[row - m], j - n)]),
            },
        })
        .lu()
        .determinant()
    };
    let interpolate = |rows: &[usize], turn: f64| {
        let angle = |k: usize| std::f64::consts::TAU * (k as f64 + turn) / count as f64;
        let values: Vec<Complex64> =
            (0..count).map(|k| determinant(rows, Complex64::from_polar(1.0, angle(k)))).collect();
        let coefficient = |i: usize| {
            let sum: Complex64 =
                values.iter().enumerate().map(|(k, v)| v * Complex64::from_polar(1.0, -angle(k) * i as f64)).sum();
            sum.re / count as f64
        };
        let largest = values.iter().map(|v| v.norm()).fold(0.0, f64::max);
        ((0..count).map(coefficient).collect::<Vec<f64>>(), largest)
    };
    choices
        .iter()
        .map(|s| {
            let rows = members(*s);
            let ((value, largest), (again, _)) = (interpolate(&rows, 0.0), interpolate(&rows, 0.37));
            let apart = value.iter().zip(&again).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            let error = 8.0 * apart + 16.0 * (n + m) as f64 * f64::EPSILON * largest;
            let bound = value.iter().map(|v| v.abs() + error / unit).collect();
            Bounded { value, bound }
        })
        .collect()
}
