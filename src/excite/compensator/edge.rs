//! Edges of the box that hold an answer.

use schemars::JsonSchema;
use serde::Serialize;
use std::fmt;

/// What an edge bounds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
#[schemars(rename = "CompensatorUnknown")]
pub enum Unknown {
    /// K.
    Gain,
    /// f_z.
    ZeroHz,
    /// f_p.
    PoleHz,
    /// ζ_z.
    ZeroDamping,
    /// ζ_p.
    PoleDamping,
    /// Both corners: f_z ≤ f_p.
    ZeroBelowPole,
}

/// Which end of its range.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
#[schemars(rename = "CompensatorEdgeEnd")]
pub enum End {
    /// The least value.
    Lower,
    /// The largest value.
    Upper,
    /// f_z = f_p.
    Equal,
}

/// An edge of the box that holds the answer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, JsonSchema)]
#[schemars(rename = "CompensatorEdge")]
pub struct Edge {
    /// What is at its end.
    pub unknown: Unknown,
    /// Which end.
    pub end: End,
    /// Of which section, from 0; absent where there is but one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub section: Option<usize>,
}

impl fmt::Display for Edge {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let unknown = match self.unknown {
            Unknown::Gain => "gain",
            Unknown::ZeroHz => "zero_hz",
            Unknown::PoleHz => "pole_hz",
            Unknown::ZeroDamping => "zero_damping",
            Unknown::PoleDamping => "pole_damping",
            Unknown::ZeroBelowPole => "zero_below_pole",
        };
        let end = match self.end {
            End::Lower => "lower",
            End::Upper => "upper",
            End::Equal => "equal",
        };
        match self.section {
            Some(section) => write!(f, "{unknown} of section {section} ({end})"),
            None => write!(f, "{unknown} ({end})"),
        }
    }
}
