//! What residuals say about the form.
//!
//! - Whiteness, which the identification of the feedback hangs on, since the noise model carries it: an interval means
//!   what it says only where the residuals are white. Two tests, at the level 5 % each:
//!   `Q = n (n + 2) Σ_{k ≤ m} ρ_k²/(n − k)` (Ljung and Box, *Biometrika* 65, 1978), chi-square with m less the noise
//!   parameters as degrees of freedom; and the score test `n R²` of the residuals' regression on their own past and all
//!   columns of the form, chi-square with as many degrees of freedom as lags (Breusch, *Australian Economic Papers* 17,
//!   1978; Godfrey, *Econometrica* 46, 1978). Beside lags of the control the first has little power: of people with a
//!   sum of two noises whose interval failed it saw 15 %, the second 97 %, at a size of 5 % (docs/limits.md).
//! - What further lags of the command, or of the error, would explain: the same score test on these lags (Ljung,
//!   *System Identification*, section 16.6, tests the correlations themselves, which for a slow command are nearly
//!   equal).

use super::design::{Columns, Form};
use super::estimate::{Estimate, RecordEstimate};
use super::feedforward::{FeedforwardBasis, recursion};
use super::lags::Lags;
use super::orthonormal::orthonormalise;
use super::record::Record;
use super::tall::{rows as rows_of, subtract};
use crate::ctl::{Ctl, Stopped};
use crate::num::distributions::f_cdf;
use nalgebra::{DMatrix, DVector};

/// Lags of the test by Ljung and Box.
pub const WHITENESS_LAGS: usize = 25;

/// Lags of the score test of serial correlation.
pub const SERIAL_LAGS: usize = 4;

/// The level of both.
pub const LEVEL: f64 = 0.05;

/// Columns that a window of later lags of the command is described with.
const LATER_COMMAND: usize = 4;

/// A test's outcome.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Test {
    /// The statistic, chi-square where the hypothesis holds.
    pub statistic: f64,
    /// Its degrees of freedom.
    pub degrees: f64,
    /// The probability of a larger one where the hypothesis holds.
    pub p_value: f64,
}

impl Test {
    /// A statistic that is chi-square where the hypothesis holds.
    #[must_use]
    pub fn chi_square(statistic: f64, degrees: f64) -> Self {
        let p_value = 1.0 - f_cdf(statistic.max(0.0) / degrees, degrees, f64::INFINITY);
        Self { statistic, degrees, p_value: p_value.clamp(0.0, 1.0) }
    }
}

/// The Ljung–Box statistic of residuals at [`WHITENESS_LAGS`] lags.
#[must_use]
pub fn ljung_box(residuals: &[f64]) -> f64 {
    let n = residuals.len() as f64;
    let power: f64 = residuals.iter().map(|w| w * w).sum();
    let sum: f64 = (1..=WHITENESS_LAGS.min(residuals.len().saturating_sub(1)))
        .map(|lag| {
            let product: f64 = residuals[lag..].iter().zip(residuals).map(|(a, b)| a * b).sum();
            (product / power).powi(2) / (n - lag as f64)
        })
        .sum();
    n * (n + 2.0) * sum
}

/// Both tests of whiteness.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Whiteness {
    /// That of Ljung and Box.
    pub ljung_box: Test,
    /// The score test.
    pub serial: Test,
}

impl Whiteness {
    /// Whether neither test refuses.
    #[must_use]
    pub fn is_white(&self) -> bool {
        self.ljung_box.p_value >= LEVEL && self.serial.p_value >= LEVEL
    }
}

/// What the residuals of an estimate say.
#[derive(Debug, Clone, PartialEq)]
pub struct ResidualTests {
    /// Whiteness of each record's residuals.
    pub whiteness: Vec<Whiteness>,
    /// Of all together.
    pub all_white: Whiteness,
    /// What later lags of the command would explain, of all records together.
    pub later_command: Test,
    /// What later lags of the error would.
    pub later_error: Test,
}

impl Estimate {
    /// Tests the residuals.
    ///
    /// # Errors
    /// [`Stopped`].
    pub fn residual_tests(&self, records: &[Record], ctl: &Ctl) -> Result<ResidualTests, Stopped> {
        let noise = (self.lags.autoregressive + self.lags.moving_average) as f64;
        let count = self.records.len() as f64;
        // Of shared parameters each record has its share.
        let each = if self.sharing.noise { noise / count } else { noise };
        let test = |statistic: f64, records: f64| {
            Test::chi_square(statistic, (records * (WHITENESS_LAGS as f64 - each)).max(1.0))
        };
        let portmanteau: Vec<f64> = self.records.iter().map(|r| ljung_box(&r.residuals)).collect();
        let serial = self.serial(records, ctl)?;
        let all_serial = serial.iter().fold([0.0; 2], |[s, d], (statistic, degrees)| [s + statistic, d + degrees]);
        let (later_command, later_error) = self.later(records, ctl)?;
        Ok(ResidualTests {
            whiteness: portmanteau
                .iter()
                .zip(&serial)
                .map(|(q, (statistic, degrees))| Whiteness {
                    ljung_box: test(*q, 1.0),
                    serial: Test::chi_square(*statistic, degrees.max(1.0)),
                })
                .collect(),
            all_white: Whiteness {
                ljung_box: test(portmanteau.iter().sum(), count),
                serial: Test::chi_square(all_serial[0], all_serial[1].max(1.0)),
            },
            later_command,
            later_error,
        })
    }

    /// The score statistics of serial correlation of each record's residuals, with their degrees of freedom.
    fn serial(&self, records: &[Record], ctl: &Ctl) -> Result<Vec<(f64, f64)>, Stopped> {
        let of = |(record, estimated): (&Record, &RecordEstimate)| {
            let mut columns = Columns::new(record, &self.lags, &self.basis, &self.layout, 0, ctl)?.columns;
            let w = DVector::from_column_slice(&estimated.residuals);
            let past = |t: usize, k: usize| t.checked_sub(k).map_or(0.0, |t| w[t]);
            // With a moving average the derivatives of w are the filtered columns.
            let c = self.moving_average(0);
            if !c.is_empty() {
                let c: Vec<f64> = std::iter::once(1.0).chain(c).collect();
                for j in 0..columns.ncols() {
                    ctl.check()?;
                    let filtered = match self.layout.moving_average.contains(&j) {
                        true => {
                            let lag = j - self.layout.moving_average.start + 1;
                            let lagged: Vec<f64> = (0..w.len()).map(|t| past(t, lag)).collect();
                            recursion(&c, &lagged)
                        }
                        false => recursion(&c, columns.column(j).as_slice()),
                    };
                    columns.column_mut(j).copy_from_slice(&filtered);
                }
            }
            let lagged = DMatrix::from_fn(w.len(), SERIAL_LAGS, |t, k| past(t, k + 1));
            explained(&columns, &lagged, &w, ctl)
        };
        records.iter().zip(&self.records).map(of).collect()
    }

    /// Score tests of later lags, summed over records.
    fn later(&self, records: &[Record], ctl: &Ctl) -> Result<(Test, Test), Stopped> {
        let lags = &self.lags;
        let window = lags.behind.max(LATER_COMMAND);
        let later = Lags { ahead: 0, behind: window, terms: LATER_COMMAND, ..lags.clone() };
        let later_basis = FeedforwardBasis::new(&later, vec![1.0]);
        let (mut command, mut error) = ([0.0; 2], [0.0; 2]);
        for (record, estimated) in records.iter().zip(&self.records) {
            let rows = lags.rows(record.samples());
            // Rows for which the later lags are in the record.
            let skip = lags.behind.max(lags.errors());
            if rows.len() <= skip + 3 * self.layout.all {
                continue;
            }
            let columns = Columns::new(record, lags, &self.basis, &self.layout, 0, ctl)?.columns;
            let count = rows.len() - skip;
            let inside = rows_of(&columns, skip, count, ctl)?;
            drop(columns);
            let w = DVector::from_column_slice(&estimated.residuals[skip..]);
            let from = rows.start + skip;
            let shifted: Vec<f64> = record.command[..record.samples() - lags.behind].to_vec();
            // The window of the command behind that of the form.
            let of_command = later_basis.design(&shifted, &(from - lags.behind..from - lags.behind + count), ctl)?;
            let mut of_error = DMatrix::zeros(count, lags.errors());
            for (k, mut column) in of_error.column_iter_mut().enumerate() {
                ctl.check()?;
                let earliest = from - lags.feedback[1] - 1 - k;
                column.copy_from_slice(&record.error[earliest..earliest + count]);
            }
            for (sums, more) in [(&mut command, of_command), (&mut error, of_error)] {
                let (explained, degrees) = explained(&inside, &more, &w, ctl)?;
                sums[0] += explained;
                sums[1] += degrees;
            }
        }
        let test = |[statistic, degrees]: [f64; 2]| Test::chi_square(statistic, degrees.max(1.0));
        Ok((test(command), test(error)))
    }
}

/// `n R²` of what columns explain of residuals beyond those of the form, and how many they are.
fn explained(inside: &DMatrix<f64>, more: &DMatrix<f64>, w: &DVector<f64>, ctl: &Ctl) -> Result<(f64, f64), Stopped> {
    let found = orthonormalise(&[inside, more], ctl)?;
    let before = found.kept.iter().filter(|j| **j < inside.ncols()).count();
    let mut rest = w.clone();
    let mut part = subtract(&found.q, &DVector::zeros(found.q.ncols()), &mut rest, ctl)?;
    // What the form's own columns explain is taken off, and the others are asked what they explain of the rest.
    part.rows_mut(before, found.q.ncols() - before).fill(0.0);
    let left = subtract(&found.q, &part, &mut rest, ctl)?;
    let new = left.rows(before, found.q.ncols() - before);
    Ok((w.len() as f64 * new.norm_squared() / rest.norm_squared(), new.len() as f64))
}

/// The form whose columns the tests of hypotheses leave out; here so that a caller sees one door.
pub(super) fn form_without(feedforward: bool, feedback: bool) -> Form {
    Form { no_feedforward: feedforward, no_feedback: feedback, blocks: None }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::num::rng;
    use rand::RngExt;
    use rand_distr::StandardNormal;

    /// The statistic of white noise is chi-square: of 400 samples, seed 1, about one in twenty is refused; coloured
    /// noise always is.
    #[test]
    fn white_noise_passes_and_coloured_noise_does_not() {
        let mut stream = rng::stream(1, "whiteness");
        let mut refused = [0, 0];
        for _ in 0..400 {
            let white: Vec<f64> = (0..600).map(|_| stream.sample(StandardNormal)).collect();
            let coloured: Vec<f64> = white.windows(2).map(|w| w[1] + 0.4 * w[0]).collect();
            for (count, w) in refused.iter_mut().zip([&white, &coloured]) {
                *count += usize::from(Test::chi_square(ljung_box(w), WHITENESS_LAGS as f64).p_value < 0.05);
            }
        }
        assert!((8..=36).contains(&refused[0]) && refused[1] == 400, "{refused:?}");
    }
}
