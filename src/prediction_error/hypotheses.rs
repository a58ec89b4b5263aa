//! Tests of hypotheses about the controllers, by the procedures whose size was measured (docs/limits.md).
//!
//! Each is a likelihood ratio `D = Σ n_i ln(σ₀ᵢ²/σ₁ᵢ²)` of the free-lag form against the form without what is tested,
//! on the same samples. False feedforward comes from feedback that was cut short, and a criterion with chosen orders
//! prefers a feedforward where there is none: so its test takes at least [`FEEDFORWARD_TEST_LAGS`] lags of the error,
//! and demands `D > k ln n` besides.

use super::design::Form;
use super::estimate::{Estimate, EstimateError, Settings, estimate_form};
use super::lags::{Lags, Sharing};
use super::record::Record;
use super::residuals::{LEVEL, Test, form_without};
use crate::ctl::Ctl;

/// Lags of the error at least, where feedforward is tested.
pub const FEEDFORWARD_TEST_LAGS: usize = 24;

/// Whether a feedforward is needed.
#[derive(Debug, Clone, PartialEq)]
pub struct FeedforwardTest {
    /// The likelihood ratio.
    pub test: Test,
    /// `k ln n`, which it must pass besides.
    pub penalty: f64,
    /// Lags of the error in both forms.
    pub lags: usize,
}

impl FeedforwardTest {
    /// Whether a feedforward is needed: both conditions.
    #[must_use]
    pub fn is_needed(&self) -> bool {
        self.test.p_value < LEVEL && self.test.statistic > self.penalty
    }
}

fn ratio(without: &Estimate, with: &Estimate, degrees: f64) -> Test {
    Test::chi_square(without.deviance - with.deviance, degrees)
}

/// Tests whether the records need a feedback.
///
/// # Errors
/// [`EstimateError`].
pub fn no_feedback(records: &[Record], settings: &Settings, ctl: &Ctl) -> Result<Test, EstimateError> {
    let with = estimate_form(records, settings, &Form::default(), false, ctl)?;
    let without = estimate_form(records, settings, &form_without(false, true), false, ctl)?;
    let each = settings.lags.errors();
    let degrees = if settings.sharing.feedback { each } else { each * records.len() };
    Ok(ratio(&without, &with, degrees as f64))
}

/// Tests whether the records need a feedforward.
///
/// # Errors
/// [`EstimateError`].
pub fn no_feedforward(records: &[Record], settings: &Settings, ctl: &Ctl) -> Result<FeedforwardTest, EstimateError> {
    let [least, largest] = settings.lags.feedback;
    let largest = largest.max(least + FEEDFORWARD_TEST_LAGS - 1);
    let lags = Lags { feedback: [least, largest], ..settings.lags.clone() };
    let longer = Settings { lags, ..settings.clone() };
    let with = estimate_form(records, &longer, &Form::default(), false, ctl)?;
    let without = estimate_form(records, &longer, &form_without(true, false), false, ctl)?;
    let each = with.basis.columns();
    let degrees = (if settings.sharing.feedforward { each } else { each * records.len() }) as f64;
    let samples: usize = with.records.iter().map(|record| record.residuals.len()).sum();
    let penalty = degrees * (samples as f64).ln();
    Ok(FeedforwardTest { test: ratio(&without, &with, degrees), penalty, lags: largest + 1 - least })
}

/// Tests whether the feedback is the same in blocks of records: `blocks[i]` is that of record i, counted from 0.
/// The shape of the noise is one for all blocks, the noise variance that of each record.
///
/// # Errors
/// [`EstimateError`].
pub fn unchanged_feedback(
    records: &[Record],
    blocks: &[usize],
    settings: &Settings,
    ctl: &Ctl,
) -> Result<Test, EstimateError> {
    let sharing = Sharing { noise: true, feedback: true, ..settings.sharing };
    let settings = Settings { sharing, ..settings.clone() };
    let same = estimate_form(records, &settings, &Form::default(), false, ctl)?;
    let form = Form { blocks: Some(blocks.to_vec()), ..Form::default() };
    let changed = estimate_form(records, &settings, &form, false, ctl)?;
    let more = blocks.iter().max().copied().unwrap_or(0) * settings.lags.errors();
    Ok(ratio(&same, &changed, more as f64))
}
