//! The name of a kind of analysis, and the document that asks for one.

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use std::fmt;

/// What is computed, by the name that it has in documents: `ssid`, `inverse_lqr`.
///
/// Each kind states its own name once, as [`Analysis::KIND`](super::Analysis::KIND); which names there are, the
/// [registry](super::registry) knows, and only it makes a kind from a text.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Kind(&'static str);

impl Kind {
    /// A kind that is about to be registered.
    pub(super) const fn named(name: &'static str) -> Self {
        Self(name)
    }

    /// The name in documents.
    #[must_use]
    pub const fn name(self) -> &'static str {
        self.0
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.0)
    }
}

impl Serialize for Kind {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.0)
    }
}

/// A request for an analysis, as people and scripts write it: `{"kind", "inputs", "spec"}`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Request {
    /// The kind, by name.
    pub kind: String,
    /// What it is computed from: stored things by id, or the data itself.
    pub inputs: Value,
    /// How it is computed; what is left out takes its documented default.
    #[serde(default = "empty_object")]
    pub spec: Value,
}

fn empty_object() -> Value {
    Value::Object(Map::new())
}
