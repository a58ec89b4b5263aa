//! The candidate pool: grids for the coefficients of the feedback's matrix fraction.

use crate::control::time_base::TimeBase;
use crate::control::{Discrete, LeftFraction, PolynomialMatrix};
use crate::identify::pool::recipe::Ingredients;
use crate::identify::pool::spec::{Axis, Coefficients, Degrees, Grid, GridPool};
use crate::identify::pool::{PoolSpec, PoolSpecError};
use crate::num::Polynomial;

/// Feedback controllers `Gfb = Dfb⁻¹ Nfb` with m controls and l fed-back outputs whose coefficients lie on grids.
///
/// Row i of Dfb is `z^{d_i}` on the diagonal plus terms of lower degree, so that Dfb is row reduced; Zhang 2015,
/// section 4.3, has all `d_i` equal. Candidates are counted with the first coefficient outermost: row by row; within a
/// row the entries of Nfb from left to right, then those of Dfb, each in descending powers.
#[derive(Debug, Clone, PartialEq)]
pub struct FeedbackPool {
    rows: Vec<Row>,
    fed_back: usize,
    margin: f64,
}

/// One row of both matrices.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    /// Degree of the diagonal entry of Dfb.
    pub degree: usize,
    /// Free coefficients, the outermost first.
    pub coefficients: Vec<Coefficient>,
}

/// A free coefficient of a row.
#[derive(Debug, Clone, PartialEq)]
pub struct Coefficient {
    /// Which entry it belongs to.
    pub of: Entry,
    /// Power of z that it multiplies.
    pub power: usize,
    /// Its values.
    pub values: Vec<f64>,
}

/// An entry of a row.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Entry {
    /// Of Nfb, in this column.
    Numerator(usize),
    /// Of Dfb, in this column.
    Denominator(usize),
}

/// The number of controls that a pool may have at most: its determinants are expanded.
pub const MOST_CONTROLS: usize = 4;

/// The number of fed-back outputs that a pool may have at most.
pub const MOST_FED_BACK: usize = 6;

fn wrong(field: impl Into<String>, message: impl Into<String>) -> PoolSpecError {
    PoolSpecError { field: field.into(), message: message.into(), too_large: false }
}

/// The numbers of an axis, without repeats.
fn values(axis: &Axis, field: &str) -> Result<Vec<f64>, PoolSpecError> {
    // As the last coefficient of a denominator of degree one.
    let grid = Grid {
        feedforward_denominator: None,
        feedback_numerator: Coefficients::Axes(vec![Axis::Values(vec![1.0])]),
        feedback_denominator: Coefficients::Axes(vec![axis.clone()]),
    };
    let recipe = PoolSpec::Grid(Box::new(GridPool { grid, stability_margin: 0.0, time: None }))
        .check(Degrees::default())
        .map_err(|error| PoolSpecError { field: field.to_owned(), ..error })?;
    match recipe.feedback_denominators {
        Ingredients::Coefficients(rows) => Ok(rows.into_iter().filter_map(|row| row.last().copied()).collect()),
        Ingredients::Power(_) | Ingredients::Roots(_) => Err(wrong(field, "the axis holds no numbers")),
    }
}

/// Axes for each entry of a matrix, row by row, each entry in descending powers.
pub type AxisMatrix = Vec<Vec<Vec<Axis>>>;

fn check_shape(matrix: &AxisMatrix, rows: usize, columns: usize, field: &str) -> Result<(), PoolSpecError> {
    if matrix.len() != rows {
        return Err(wrong(field, format!("the matrix has {} rows, and must be {rows}x{columns}", matrix.len())));
    }
    for (i, row) in matrix.iter().enumerate() {
        if row.len() != columns {
            return Err(wrong(
                format!("{field}/{i}"),
                format!("row {i} (counted from 0) has {} columns, and the matrix must be {rows}x{columns}", row.len()),
            ));
        }
    }
    Ok(())
}

impl FeedbackPool {
    /// From the axes of Nfb (m×l; an entry without axes is 0) and of Dfb (m×m; `z^d` with the d axes of a diagonal
    /// entry, at most d axes beside it; `None`: the identity). `margin` is the stability margin in 1/s.
    ///
    /// # Errors
    /// [`PoolSpecError`], with field names `feedback_numerator/ROW/COLUMN/COEFFICIENT` behind `field`.
    pub fn new(
        numerator: &AxisMatrix,
        denominator: Option<&AxisMatrix>,
        margin: f64,
        field: &str,
    ) -> Result<Self, PoolSpecError> {
        let controls = numerator.len();
        let fed_back = numerator.first().map_or(0, Vec::len);
        let (of_numerator, of_denominator) =
            (format!("{field}/feedback_numerator"), format!("{field}/feedback_denominator"));
        if controls == 0 || fed_back == 0 || controls > MOST_CONTROLS || fed_back > MOST_FED_BACK {
            return Err(wrong(
                of_numerator,
                format!(
                    "the matrix is {controls}x{fed_back} (controls times fed-back outputs); \
                     1 to {MOST_CONTROLS} controls and 1 to {MOST_FED_BACK} fed-back outputs are taken"
                ),
            ));
        }
        check_shape(numerator, controls, fed_back, &of_numerator)?;
        if let Some(denominator) = denominator {
            check_shape(denominator, controls, controls, &of_denominator)?;
        }
        let axes = |axes: &[Axis], of: Entry, field: String, into: &mut Vec<Coefficient>| {
            for (at, axis) in axes.iter().enumerate() {
                let field = format!("{field}/{at}");
                let values = values(axis, &field)?;
                into.push(Coefficient { of, power: axes.len() - 1 - at, values });
            }
            Ok(())
        };
        let mut rows = Vec::new();
        for (i, entries) in numerator.iter().enumerate() {
            let mut coefficients = Vec::new();
            for (j, entry) in entries.iter().enumerate() {
                axes(entry, Entry::Numerator(j), format!("{of_numerator}/{i}/{j}"), &mut coefficients)?;
            }
            let mut degree = 0;
            if let Some(denominator) = denominator {
                degree = denominator[i][i].len();
                for (j, entry) in denominator[i].iter().enumerate() {
                    let field = format!("{of_denominator}/{i}/{j}");
                    if entry.len() > degree {
                        let message = format!(
                            "the entry has {} coefficients, and the diagonal entry of its row {degree}: the diagonal \
                             must have the highest power",
                            entry.len()
                        );
                        return Err(wrong(field, message));
                    }
                    axes(entry, Entry::Denominator(j), field, &mut coefficients)?;
                }
            }
            rows.push(Row { degree, coefficients });
        }
        if !(margin.is_finite() && margin >= 0.0) {
            return Err(wrong(
                "pool/stability_margin",
                format!("the stability margin {margin} must be finite and not negative"),
            ));
        }
        Ok(Self { rows, fed_back, margin })
    }

    /// The number of controls, m.
    #[must_use]
    pub fn controls(&self) -> usize {
        self.rows.len()
    }

    /// The number of fed-back outputs, l.
    #[must_use]
    pub fn fed_back(&self) -> usize {
        self.fed_back
    }

    /// The rows.
    #[must_use]
    pub fn rows(&self) -> &[Row] {
        &self.rows
    }

    /// The stability margin in 1/s: closed-loop poles lie within `|z| < e^{−margin T}`.
    #[must_use]
    pub fn margin(&self) -> f64 {
        self.margin
    }

    /// The number of candidates before any is tested for stability.
    #[must_use]
    pub fn listed(&self) -> u128 {
        self.rows.iter().fold(1, |product: u128, row| product.saturating_mul(row.count()))
    }

    /// The number of free coefficients.
    #[must_use]
    pub fn unknowns(&self) -> usize {
        self.rows.iter().map(|row| row.coefficients.len()).sum()
    }

    /// The sum of the row degrees: the degree of det Dfb.
    #[must_use]
    pub fn states(&self) -> usize {
        self.rows.iter().map(|row| row.degree).sum()
    }

    /// The coefficients of a listed candidate, row by row.
    ///
    /// # Panics
    /// If there is no such candidate, which is a mistake of the caller.
    #[must_use]
    pub fn candidate(&self, index: u64) -> Vec<Vec<f64>> {
        assert!(u128::from(index) < self.listed(), "candidate {index} of {}", self.listed());
        let mut rest = index;
        let mut rows: Vec<Vec<f64>> = Vec::new();
        for row in self.rows.iter().rev() {
            // The count of every row divides the number of listed candidates, which a u64 holds here.
            let count = row.count() as u64;
            rows.push(row.candidate(rest % count));
            rest /= count;
        }
        rows.reverse();
        rows
    }

    /// The fraction with these coefficients.
    ///
    /// # Panics
    /// If the coefficients are not those of this pool, which is a mistake of the caller.
    #[must_use]
    pub fn fraction(&self, coefficients: &[Vec<f64>], time: Discrete) -> LeftFraction<Discrete> {
        let entry = |i: usize, of: Entry| {
            let row = &self.rows[i];
            let mut ascending = vec![0.0; row.degree + row.numerator_degree() + 1];
            if of == Entry::Denominator(i) {
                ascending[row.degree] = 1.0;
            }
            for (coefficient, value) in row.coefficients.iter().zip(&coefficients[i]) {
                if coefficient.of == of {
                    ascending[coefficient.power] = *value;
                }
            }
            ascending.reverse();
            Polynomial::new(ascending)
        };
        let m = self.controls();
        let denominator = PolynomialMatrix::from_fn(m, m, |i, j| entry(i, Entry::Denominator(j)));
        let numerator = PolynomialMatrix::from_fn(m, self.fed_back, |i, j| entry(i, Entry::Numerator(j)));
        LeftFraction::new(denominator, numerator, time).unwrap_or_else(|_| unreachable!("both have m rows"))
    }

    /// The axes at whose ends a candidate lies, in words; axes of one value have none.
    #[must_use]
    pub fn edges(&self, coefficients: &[Vec<f64>]) -> Vec<String> {
        let mut edges = Vec::new();
        for (i, row) in self.rows.iter().enumerate() {
            for (coefficient, value) in row.coefficients.iter().zip(&coefficients[i]) {
                let lowest = coefficient.values.iter().copied().fold(f64::INFINITY, f64::min);
                let highest = coefficient.values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
                if lowest < highest && (*value == lowest || *value == highest) {
                    let (name, j) = match coefficient.of {
                        Entry::Numerator(j) => ("numerator", j),
                        Entry::Denominator(j) => ("denominator", j),
                    };
                    edges.push(format!(
                        "the coefficient of z^{} in row {i}, column {j} of the feedback's {name} is {value}, at the \
                         end of its axis",
                        coefficient.power
                    ));
                }
            }
        }
        edges
    }

    /// The closed-loop poles allowed have moduli below this.
    #[must_use]
    pub fn radius(&self, time: Discrete) -> f64 {
        (-self.margin * time.sample_time_s().unwrap_or(1.0)).exp()
    }
}

impl Row {
    /// The number of combinations of its coefficients.
    #[must_use]
    pub fn count(&self) -> u128 {
        self.coefficients.iter().fold(1, |product: u128, c| product.saturating_mul(c.values.len() as u128))
    }

    /// One of these combinations, the first coefficient outermost.
    #[must_use]
    pub fn candidate(&self, index: u64) -> Vec<f64> {
        let mut values = vec![0.0; self.coefficients.len()];
        let mut rest = index;
        for (value, coefficient) in values.iter_mut().zip(&self.coefficients).rev() {
            let length = coefficient.values.len() as u64;
            *value = coefficient.values[(rest % length) as usize];
            rest /= length;
        }
        values
    }

    /// The highest power in its entries of Nfb.
    #[must_use]
    pub fn numerator_degree(&self) -> usize {
        let of_numerator = |c: &&Coefficient| matches!(c.of, Entry::Numerator(_));
        self.coefficients.iter().filter(of_numerator).map(|c| c.power).max().unwrap_or(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn pool(numerator: serde_json::Value, denominator: serde_json::Value) -> Result<FeedbackPool, PoolSpecError> {
        let matrix = |value| serde_json::from_value::<AxisMatrix>(value).unwrap();
        let denominator = (!denominator.is_null()).then(|| matrix(denominator));
        FeedbackPool::new(&matrix(numerator), denominator.as_ref(), 0.0, "pool/matrix_grid")
    }

    #[test]
    fn candidates_run_with_the_first_coefficient_outermost() {
        let pool = pool(
            json!([[[[1, 2], [3]], []], [[[0]], [{"from": 0.1, "to": 0.3, "step": 0.1}]]]),
            json!([[[[7, 8]], [[9]]], [[], []]]),
        )
        .unwrap();
        assert_eq!((pool.listed(), pool.unknowns(), pool.states()), (2 * 2 * 3, 6, 1));
        let all: Vec<_> = (0..12).map(|i| pool.candidate(i)).collect();
        assert_eq!(all[0], [vec![1.0, 3.0, 7.0, 9.0], vec![0.0, 0.1]]);
        assert_eq!(all[1], [vec![1.0, 3.0, 7.0, 9.0], vec![0.0, 0.2]]);
        assert_eq!(all[3], [vec![1.0, 3.0, 8.0, 9.0], vec![0.0, 0.1]]);
        assert_eq!(all[6], [vec![2.0, 3.0, 7.0, 9.0], vec![0.0, 0.1]]);
        let fraction = pool.fraction(&all[5], Discrete::new(1.0).unwrap());
        assert_eq!(fraction.numerator().to_nested(), [[vec![1.0, 3.0], vec![0.0]], [vec![0.0], vec![0.3]]]);
        assert_eq!(fraction.denominator().to_nested(), [[vec![1.0, 8.0], vec![9.0]], [vec![0.0], vec![1.0]]]);
        assert_eq!(pool.edges(&all[5]).len(), 3, "{:?}", pool.edges(&all[5]));
        assert_eq!(pool.edges(&all[1]).len(), 2);
    }

    #[test]
    fn what_is_no_pool_is_refused_by_its_field() {
        for (numerator, denominator, field, words) in [
            (json!([]), json!(null), "pool/matrix_grid/feedback_numerator", "0x0"),
            (json!([[[[1]]], []]), json!(null), "pool/matrix_grid/feedback_numerator/1", "must be 2x1"),
            (json!([[[[1]]]]), json!([[[], []]]), "pool/matrix_grid/feedback_denominator/0", "must be 1x1"),
            (json!([[[[1]]]]), json!([]), "pool/matrix_grid/feedback_denominator", "0 rows"),
            (json!([[[[1], []]]]), json!(null), "pool/matrix_grid/feedback_numerator/0/0/1", "empty"),
            (
                json!([[[{"from": 2, "to": 1, "step": 1}]]]),
                json!(null),
                "pool/matrix_grid/feedback_numerator/0/0/0",
                "reversed",
            ),
            (
                json!([[[[1]]], [[[1]]]]),
                json!([[[], [[1]]], [[], []]]),
                "pool/matrix_grid/feedback_denominator/0/1",
                "diagonal",
            ),
        ] {
            let error = pool(numerator, denominator).unwrap_err();
            assert_eq!(error.field, field, "{error}");
            assert!(error.message.contains(words), "{error}");
        }
    }
}
