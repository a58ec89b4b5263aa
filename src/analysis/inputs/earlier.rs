//! Inputs that are made of stored things by whoever has them: of an earlier report, or of all trials of a subject.
//!
//! A server replaces these shorthands before a request is checked, so that an analysis carries everything that it is
//! computed from, and can be repeated without the report.

use crate::analysis::ids::{AnalysisId, SubjectId};
use crate::analysis::report::Report;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

/// In place of a kind's inputs: what an earlier analysis found. A server reads its report; the request is stored with
/// the numbers themselves, and with the analysis as `found_by`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "EarlierAnalysis")]
pub struct EarlierAnalysis {
    /// An analysis that succeeded: of kind `gain_fit`.
    pub analysis: AnalysisId,
    /// Which pair of gains, where no record tells several apart: 0 for the estimate, k for its k-th twin. It must be
    /// given where there are twins. Default: the estimate, where it is the only one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub explanation: Option<usize>,
    /// Other weights, as in the kind's own inputs. Default: none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub compare_with: Option<Map<String, Value>>,
    /// A recorded trajectory, as in the kind's own inputs. Default: none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub trajectory: Option<Map<String, Value>>,
}

/// In place of a kind's inputs: all trials of a subject, but those that were excluded or diverged. The request is
/// stored with the trials themselves.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "TrialsOfSubject")]
pub struct TrialsOfSubject {
    /// The subject.
    pub subject: SubjectId,
    /// Only those of this session. Default: of all sessions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub session: Option<i64>,
    /// The plant, for kinds whose inputs have one beside stored trials, as there. Default: none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub plant: Option<Map<String, Value>>,
}

/// An earlier report, and what is asked about it.
#[derive(Debug, Clone, Copy)]
pub struct Earlier<'a> {
    /// The analysis.
    pub analysis: AnalysisId,
    /// Its report.
    pub report: &'a Report,
    /// [`EarlierAnalysis::explanation`].
    pub explanation: Option<usize>,
}

/// What an earlier report stands for.
#[derive(Debug, Clone, PartialEq)]
pub struct FromEarlier {
    /// Members of the inputs.
    pub inputs: Map<String, Value>,
    /// Settings that it brings along, by the names on the way to them in the spec: they apply where nothing is written
    /// there, and where nothing on the way is null.
    pub settings: Vec<(Vec<&'static str>, Value)>,
}

impl FromEarlier {
    /// The spec with the settings that it does not have.
    #[must_use]
    pub fn completed(&self, spec: &Value) -> Value {
        let mut spec = spec.clone();
        for (path, value) in &self.settings {
            put(&mut spec, path, value);
        }
        spec
    }
}

/// Writes a value at the end of a path, unless something is there or the way is barred.
fn put(at: &mut Value, path: &[&str], value: &Value) {
    let (Some((name, rest)), Some(members)) = (path.split_first(), at.as_object_mut()) else { return };
    if rest.is_empty() {
        members.entry(*name).or_insert_with(|| value.clone());
    } else {
        put(members.entry(*name).or_insert_with(|| Value::Object(Map::new())), rest, value);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn settings_apply_where_nothing_else_is_written() {
        let from = FromEarlier { inputs: Map::new(), settings: vec![(vec!["fit", "gain_covariance"], json!([[1.0]]))] };
        for (written, completed) in [
            (json!({}), json!({"fit": {"gain_covariance": [[1.0]]}})),
            (json!({"fit": {"seed": 2}}), json!({"fit": {"seed": 2, "gain_covariance": [[1.0]]}})),
            (json!({"fit": {"gain_covariance": [[2.0]]}}), json!({"fit": {"gain_covariance": [[2.0]]}})),
            (json!({"fit": {"gain_covariance": null}}), json!({"fit": {"gain_covariance": null}})),
            (json!({"fit": null}), json!({"fit": null})),
            (json!([]), json!([])),
        ] {
            assert_eq!(from.completed(&written), completed);
        }
    }
}
