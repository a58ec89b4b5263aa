//! The columns of the regression of a record, and where its parameters are.

use super::feedforward::FeedforwardBasis;
use super::lags::{Lags, Sharing};
use super::record::Record;
use crate::ctl::{Ctl, Stopped};
use nalgebra::{DMatrix, DVector};
use std::ops::Range;

/// What the regression leaves out, and what it adds: the forms that hypotheses compare.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Form {
    /// There is no feedforward.
    pub no_feedforward: bool,
    /// There is no feedback.
    pub no_feedback: bool,
    /// The block of each record: those after the first have lags of e that are added to the shared ones.
    pub blocks: Option<Vec<usize>>,
}

/// Where the parameters of a record are among its own and the shared ones, in this order.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Layout {
    /// Of F.
    pub feedforward: Range<usize>,
    /// a₁, a₂, ….
    pub autoregressive: Range<usize>,
    /// Of E.
    pub feedback: Range<usize>,
    /// c₁, c₂, ….
    pub moving_average: Range<usize>,
    /// What each block's E has beyond that of the first.
    pub blocks: Range<usize>,
    /// How many are the record's own.
    pub own: usize,
    /// All of them.
    pub all: usize,
}

impl Layout {
    pub(super) fn new(lags: &Lags, sharing: Sharing, feedforward_columns: usize, form: &Form) -> Self {
        let feedforward = if form.no_feedforward { 0 } else { feedforward_columns };
        let feedback = if form.no_feedback { 0 } else { lags.errors() };
        let more = form.blocks.as_ref().and_then(|b| b.iter().max()).map_or(0, |last| last * feedback);
        let mut at = 0;
        let mut take = |count: usize, now: bool, range: &mut Range<usize>| {
            if now {
                *range = at..at + count;
                at += count;
            }
        };
        let (mut ff, mut ar, mut fb, mut ma, mut blocks) = (0..0, 0..0, 0..0, 0..0, 0..0);
        let mut own = 0;
        for shared in [false, true] {
            take(feedforward, sharing.feedforward == shared, &mut ff);
            take(lags.autoregressive, sharing.noise == shared, &mut ar);
            take(feedback, sharing.feedback == shared, &mut fb);
            take(lags.moving_average, sharing.noise == shared, &mut ma);
            take(more, shared, &mut blocks);
            if !shared {
                own = [&ff, &ar, &fb, &ma].iter().map(|r| r.end).max().unwrap_or(0);
            }
        }
        let all = [&ff, &ar, &fb, &ma, &blocks].iter().map(|r| r.end).max().unwrap_or(0);
        Self { feedforward: ff, autoregressive: ar, feedback: fb, moving_average: ma, blocks, own, all }
    }
}

/// A record's regression: `target ≈ columns · parameters`.
#[derive(Debug, Clone)]
pub(super) struct Columns {
    /// One column a parameter, in the order of the [`Layout`].
    pub columns: DMatrix<f64>,
    /// The control.
    pub target: DVector<f64>,
}

impl Columns {
    /// The columns of a record; those of the moving average, which depend on the residuals, are zero.
    ///
    /// # Errors
    /// [`Stopped`].
    pub(super) fn new(
        record: &Record,
        lags: &Lags,
        basis: &FeedforwardBasis,
        layout: &Layout,
        block: usize,
        ctl: &Ctl,
    ) -> Result<Self, Stopped> {
        let rows = lags.rows(record.samples());
        let mut columns = DMatrix::zeros(rows.len(), layout.all);
        if !layout.feedforward.is_empty() {
            let design = basis.design(&record.command, &rows, ctl)?;
            columns.columns_mut(layout.feedforward.start, layout.feedforward.len()).copy_from(&design);
        }
        let mut lagged = |column: usize, signal: &[f64], lag: usize| {
            ctl.check()?;
            let from = rows.start - lag;
            columns.column_mut(column).copy_from_slice(&signal[from..from + rows.len()]);
            Ok(())
        };
        for (k, column) in layout.autoregressive.clone().enumerate() {
            lagged(column, &record.control, k + 1)?;
        }
        for (k, column) in layout.feedback.clone().enumerate() {
            lagged(column, &record.error, lags.feedback[0] + k)?;
        }
        if block > 0 {
            for k in 0..lags.errors() {
                let column = layout.blocks.start + (block - 1) * lags.errors() + k;
                lagged(column, &record.error, lags.feedback[0] + k)?;
            }
        }
        Ok(Self { columns, target: DVector::from_column_slice(&record.control[rows]) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn own_parameters_come_before_shared_ones() {
        let lags = Lags { autoregressive: 2, moving_average: 1, feedback: [4, 6], ahead: 1, behind: 4, terms: 3 };
        let feedback = Sharing { noise: true, feedback: true, feedforward: false };
        let layout = Layout::new(&lags, feedback, 3, &Form::default());
        assert_eq!((layout.feedforward.clone(), layout.own, layout.all), (0..3, 3, 9));
        assert_eq!((layout.autoregressive.clone(), layout.feedback.clone(), layout.moving_average), (3..5, 5..8, 8..9));
        let feedforward = Sharing { noise: true, feedback: false, feedforward: true };
        let layout = Layout::new(&lags, feedforward, 3, &Form::default());
        assert_eq!((layout.feedback, layout.feedforward, layout.own), (0..3, 3..6, 3));
        let nothing = Sharing { noise: false, feedback: false, feedforward: false };
        assert_eq!(Layout::new(&lags, nothing, 3, &Form::default()).own, 9);
        let blocks = Form { blocks: Some(vec![0, 1, 2]), ..Form::default() };
        let layout = Layout::new(&lags, feedback, 3, &blocks);
        assert_eq!((layout.blocks, layout.all), (9..15, 15));
    }
}
