//! Who learned what: the change with practice of each group, and the difference between groups, with intervals.
//!
//! Two stages. Each person's trials are summarised by a fitted curve ([`shape`]), whose first value, last value and
//! change have standard errors ([`people`]); over people these are averaged by random effects ([`random_effects`]) and
//! compared by exact permutation of people ([`permutation`]), with a mixed model on the trials ([`mixed_model`]) as a
//! second method. Counts are compared by people ([`people_counts`]). People and never trials are what is drawn: trials
//! of one person are not independent.

pub mod counts;
pub mod effect;
pub mod metric;
pub mod mixed_logit;
pub mod mixed_model;
pub mod multiple;
pub mod people;
pub mod people_counts;
pub mod permutation;
pub mod random_effects;
pub mod report;
pub mod series;
pub mod shape;
pub mod study;
pub(crate) mod text;
mod words;

/// Why something was not estimated, in words.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct NotEstimated(pub String);
