//! Which lags the regression has, and what trials share.

use std::ops::Range;

/// Largest orders and counts that are taken.
pub const MOST_AUTOREGRESSIVE: usize = 20;
/// The largest order of the moving average.
pub const MOST_MOVING_AVERAGE: usize = 4;
/// The most lags of the error, and the most columns of the feedforward.
pub const MOST_LAGS: usize = 200;
/// The longest window of the feedforward in samples.
pub const LONGEST_WINDOW: usize = 2000;

/// The lags of a regression, in samples of its sample time.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Lags {
    /// Lags of the control: 1 to this.
    pub autoregressive: usize,
    /// Order of the moving average of the noise.
    pub moving_average: usize,
    /// The least and the largest lag of the error, both included.
    pub feedback: [usize; 2],
    /// How many samples ahead the feedforward looks.
    pub ahead: usize,
    /// How many samples back it looks, the present one included.
    pub behind: usize,
    /// Columns of its window: the polynomials of degrees 0 to this less one in the lag.
    pub terms: usize,
}

/// What all trials of an estimate have in common. Noise variances are always those of each trial.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sharing {
    /// The poles A and the moving average C: the shape of the noise.
    pub noise: bool,
    /// E, and with A the feedback.
    pub feedback: bool,
    /// F, and with A the feedforward.
    pub feedforward: bool,
}

/// Why lags cannot be used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum LagsError {
    /// The regressors are collinear, or nearly so.
    #[error(
        "{autoregressive} lags of the control reach beyond the least lag of the error, {least}: since the plant makes \
         y of u, lags of both are then nearly collinear, and the negative inverse of the plant passes for a feedback"
    )]
    InverseOfThePlant {
        /// Lags of the control.
        autoregressive: usize,
        /// The least lag of the error.
        least: usize,
    },
    /// The person would act on what it has not seen.
    #[error("the least delay is less than one sample")]
    NoDelay,
    /// The range is reversed.
    #[error("the largest delay, {largest} samples, is below the least, {least}")]
    Reversed {
        /// The least lag of the error.
        least: usize,
        /// The largest.
        largest: usize,
    },
    /// More than are taken.
    #[error("there are {count} {what}, and {most} at most are taken")]
    TooMany {
        /// What there are too many of.
        what: &'static str,
        /// How many.
        count: usize,
        /// How many are taken.
        most: usize,
    },
    /// No window.
    #[error("the feedforward has no column")]
    NoFeedforward,
}

impl Lags {
    /// Refuses lags that tell nothing apart.
    ///
    /// With y = G u of order n there is an exact relation between u(t−d−1) … u(t−d−n) and y(t−d) … y(t−d−n), so that
    /// lags of u beyond the least lag d of e approach it: refused are more lags of u than d.
    ///
    /// # Errors
    /// [`LagsError`].
    pub fn check(&self) -> Result<(), LagsError> {
        let [least, largest] = self.feedback;
        if least == 0 {
            return Err(LagsError::NoDelay);
        }
        if largest < least {
            return Err(LagsError::Reversed { least, largest });
        }
        for (what, count, most) in [
            ("lags of the control", self.autoregressive, MOST_AUTOREGRESSIVE),
            ("terms of the moving average", self.moving_average, MOST_MOVING_AVERAGE),
            ("lags of the error", self.errors(), MOST_LAGS),
            ("columns of the feedforward", self.terms, MOST_LAGS),
            ("samples in the feedforward's window", self.window(), LONGEST_WINDOW),
        ] {
            if count > most {
                return Err(LagsError::TooMany { what, count, most });
            }
        }
        if self.autoregressive > least {
            return Err(LagsError::InverseOfThePlant { autoregressive: self.autoregressive, least });
        }
        if self.terms == 0 || self.behind == 0 {
            return Err(LagsError::NoFeedforward);
        }
        if self.terms > self.window() {
            return Err(LagsError::TooMany {
                what: "columns of the feedforward",
                count: self.terms,
                most: self.window(),
            });
        }
        Ok(())
    }

    /// Lags of the error.
    #[must_use]
    pub fn errors(&self) -> usize {
        self.feedback[1] + 1 - self.feedback[0]
    }

    /// Samples of the feedforward's window.
    #[must_use]
    pub fn window(&self) -> usize {
        self.ahead + self.behind
    }

    /// The samples of a record that can be written by its other samples.
    #[must_use]
    pub fn rows(&self, samples: usize) -> Range<usize> {
        let first = self.autoregressive.max(self.feedback[1]).max(self.behind.saturating_sub(1));
        first..samples.saturating_sub(self.ahead).max(first)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lags() -> Lags {
        Lags { autoregressive: 2, moving_average: 0, feedback: [4, 17], ahead: 10, behind: 25, terms: 8 }
    }

    #[test]
    fn more_lags_of_u_than_the_least_delay_are_refused() {
        assert_eq!(lags().check(), Ok(()));
        assert_eq!(Lags { autoregressive: 4, ..lags() }.check(), Ok(()));
        let refused = Lags { autoregressive: 5, ..lags() }.check();
        assert_eq!(refused, Err(LagsError::InverseOfThePlant { autoregressive: 5, least: 4 }));
        assert_eq!(Lags { feedback: [0, 17], ..lags() }.check(), Err(LagsError::NoDelay));
        assert_eq!(Lags { feedback: [9, 8], ..lags() }.check(), Err(LagsError::Reversed { least: 9, largest: 8 }));
        assert_eq!(Lags { terms: 0, ..lags() }.check(), Err(LagsError::NoFeedforward));
    }

    #[test]
    fn rows_have_all_their_lags_within_the_record() {
        assert_eq!(lags().rows(100), 24..90);
        assert!(lags().rows(20).is_empty());
    }
}
