//! How far a value may be used.
//!
//! Trust belongs to a quantity of a trial, not to the trial: a recording may tell the feedforward and not the feedback.
//! The whole rule is here. [`mod@rule`] has its constants and its rows as a table that is shown and documented;
//! [`mod@judge`] is the pure function from what is known of a quantity ([`Evidence`], [`Estimate`]) to a [`Trust`].
//! What a report says is read elsewhere, so that the rule knows no form of a report.

mod judge;
mod level;
mod rule;

pub use judge::{Agreement, Estimate, Evidence, LeftOut, Sort, judge, measured, not_identified, worst_of};
pub use level::{Level, MeanTrust, Reason, Trust, of_mean};
pub use rule::{CONSTANTS, Constants, ROWS, RULE_VERSION, Row, RuleRow, TrustRule, advice, rule};
