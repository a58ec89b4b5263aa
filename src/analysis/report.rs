//! What an analysis answers, and the proof of how it came about.

use super::kind::Kind;
use crate::num::hexadecimal::hexadecimal;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;

/// Something that a scientist must read before using the result.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Warning {
    /// A stable name, in `snake_case`.
    pub code: String,
    /// The finding, in words and numbers.
    pub message: String,
}

impl Warning {
    /// A warning.
    #[must_use]
    pub fn new(code: impl Into<String>, message: impl Into<String>) -> Self {
        Self { code: code.into(), message: message.into() }
    }
}

/// Where a report comes from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Provenance {
    /// Version of the program.
    pub product_version: String,
    /// The spec as used, with every default filled in.
    #[schemars(with = "serde_json::Map<String, serde_json::Value>")]
    pub spec: serde_json::Value,
    /// SHA-256 of that spec: reports with equal hashes were computed in the same way.
    pub spec_sha256: String,
    /// SHA-256 of each input, by the name it has in the request (`/inputs/trial`).
    pub inputs_sha256: BTreeMap<String, String>,
    /// The seed of every random number drawn; null where none is.
    pub seed: Option<u64>,
    /// SHA-256 of kind, schema, result and warnings: equal for equal inputs, spec, seed and version.
    pub result_sha256: String,
    /// Elapsed time in seconds. Not part of the hash.
    pub wall_time_s: Option<f64>,
    /// Processor time of all compute threads in seconds. Not part of the hash.
    pub cpu_time_s: Option<f64>,
    /// What a search by bounds did, which depends on which thread found what first. Not part of the hash.
    pub effort: Option<Effort>,
}

/// What a search did to prove that its answer is the best.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Effort {
    /// Pairs of clusters of candidates that were bounded from below.
    pub pairs_bounded: u64,
    /// Candidates evaluated one by one; all others of the pool are proven worse by the bounds.
    pub candidates_evaluated: u64,
    /// How many of these rounding could not tell from the best one, so that QR decided. What bounds exclude in one run,
    /// another run may have to evaluate before it knows a good candidate.
    #[serde(default)]
    pub candidates_decided_by_qr: u64,
}

/// The answer to a [`Request`](super::Request).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// The kind of analysis.
    pub kind: Kind,
    /// Name and version of the result's form, such as `volition.ssid/1`.
    pub schema: String,
    /// The result; its form is documented with the kind.
    pub result: serde_json::Value,
    /// What must be read before using it.
    pub warnings: Vec<Warning>,
    /// Where it comes from.
    pub provenance: Provenance,
}

impl Report {
    /// A report without times, which the caller with a clock adds.
    ///
    /// Objects are hashed with their keys sorted, so the hash does not depend on the order of fields.
    #[must_use]
    pub fn new(
        kind: Kind,
        version: u32,
        result: serde_json::Value,
        warnings: Vec<Warning>,
        spec: serde_json::Value,
        inputs_sha256: BTreeMap<String, String>,
        seed: Option<u64>,
    ) -> Self {
        let schema = result_schema(kind, version);
        let result_sha256 = sha256_json(&serde_json::json!([kind, schema, result, warnings]));
        let provenance = Provenance {
            product_version: env!("CARGO_PKG_VERSION").to_owned(),
            spec_sha256: sha256_json(&spec),
            spec,
            inputs_sha256,
            seed,
            result_sha256,
            wall_time_s: None,
            cpu_time_s: None,
            effort: None,
        };
        Self { kind, schema, result, warnings, provenance }
    }
}

/// Name and version of the form of a kind's result.
pub(super) fn result_schema(kind: Kind, version: u32) -> String {
    format!("volition.{kind}/{version}")
}

/// SHA-256, in hexadecimal, of a JSON value with its keys sorted (`serde_json`'s own map order).
#[must_use]
pub fn sha256_json(value: &serde_json::Value) -> String {
    hexadecimal(&Sha256::digest(value.to_string()))
}
