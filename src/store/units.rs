//! The units of a lab's signals.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The units of signals, as figures write them at their axes.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct SignalUnits {
    /// Of the command r and the output y, such as `cm`; null where nobody said.
    #[serde(default)]
    pub output: Option<String>,
    /// Of the control u and the disturbance d, such as `N`; null where nobody said.
    #[serde(default)]
    pub control: Option<String>,
}

impl SignalUnits {
    /// These, and what they lack from others.
    #[must_use]
    pub fn or(&self, others: &Self) -> Self {
        Self {
            output: self.output.clone().or_else(|| others.output.clone()),
            control: self.control.clone().or_else(|| others.control.clone()),
        }
    }

    /// These with some changed: `None` leaves one as it is.
    #[must_use]
    pub fn changed(&self, change: &UnitsChange) -> Self {
        Self {
            output: change.output.clone().unwrap_or_else(|| self.output.clone()),
            control: change.control.clone().unwrap_or_else(|| self.control.clone()),
        }
    }
}

/// Changes of units; `None` leaves one as it is, `Some(None)` takes it away.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct UnitsChange {
    /// Of the output.
    pub output: Option<Option<String>>,
    /// Of the control.
    pub control: Option<Option<String>>,
}
