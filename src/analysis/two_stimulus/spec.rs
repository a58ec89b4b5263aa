//! How it is estimated: as written, and checked.

use crate::analysis::frequency_problem;
use crate::analysis::problem::{Code, Problem};
use crate::identify::frequency::{CheckedSettings, FrequencySettings};
use crate::identify::two_stimulus::fit::Channel;
use crate::identify::two_stimulus::structure::Structure;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use utoipa::ToSchema;

/// Structures fitted at most, and starts of each.
const MOST_STRUCTURES: usize = 20;
const MOST_STARTS: usize = 200;

/// The spec.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct TwoStimulusSpec {
    /// The structures that are fitted. Default: McRuer's ladder, that is error feedback with lead, lag and delay; the same with feedforward by
    /// the plant's inverse with gain, lag and delay; the same with a neuromuscular lag. An empty list fits none.
    pub structures: Vec<Structure>,
    /// How trials are transformed. Default: the excited lines of the whole record. Must be absent with responses in the request; `average` has no
    /// effect (trials are combined by least squares).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frequency: Option<FrequencySettings>,
    /// Which responses are fitted. Default: those of the control for trials, those of the output for responses in the request.
    pub channel: Channel,
    /// The range in which delays are sought. Default: 0.02 to 1 s.
    pub delay_s: [f64; 2],
    /// Starts of each fit. Default: 8.
    pub starts: usize,
    /// The seed of the starts. Default: 0.
    pub seed: u64,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Written {
    structures: Option<Vec<Structure>>,
    frequency: Option<Map<String, Value>>,
    channel: Option<Channel>,
    delay_s: Option<[f64; 2]>,
    starts: Option<usize>,
    seed: Option<u64>,
}

/// A checked spec.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct CheckedSpec {
    written: TwoStimulusSpec,
    frequency: Option<CheckedSettings>,
}

fn wrong(detail: impl Into<String>, location: impl Into<String>) -> Problem {
    Problem::new(Code::Invalid, "unusable spec", detail).at(location)
}

impl CheckedSpec {
    /// Checks the `spec` of a request.
    pub(super) fn parse(spec: &Value, is_responses: bool) -> Result<Self, Problem> {
        let Value::Object(members) = spec else {
            return Err(wrong("the spec is no object", "/spec"));
        };
        // One at a time first, since the deserialiser does not say where it stopped.
        for (name, value) in members {
            let alone = Value::Object(Map::from_iter([(name.clone(), value.clone())]));
            if let Err(error) = serde_json::from_value::<Written>(alone) {
                let location = format!("/spec/{}", name.replace('~', "~0").replace('/', "~1"));
                return Err(wrong(error.to_string(), location));
            }
        }
        let written: Written =
            serde_json::from_value(spec.clone()).map_err(|error| wrong(error.to_string(), "/spec"))?;
        let frequency = match (written.frequency, is_responses) {
            (Some(_), true) => {
                return Err(wrong(
                    "there are frequency settings, but no trial that they could apply to",
                    "/spec/frequency",
                )
                .mend("Leave them out: the request carries its responses."));
            }
            (None, true) => None,
            (members, false) => {
                Some(frequency_problem::parse_settings(members.unwrap_or_default(), "/spec/frequency")?)
            }
        };
        let structures = written.structures.unwrap_or_else(|| {
            vec![Structure::mcruer(false, false), Structure::mcruer(true, false), Structure::mcruer(true, true)]
        });
        if structures.len() > MOST_STRUCTURES {
            let detail = format!("there are {} structures, and {MOST_STRUCTURES} are fitted at most", structures.len());
            return Err(wrong(detail, "/spec/structures"));
        }
        let delay_s = written.delay_s.unwrap_or([0.02, 1.0]);
        let is_range = delay_s[0] >= 0.0 && delay_s[0] < delay_s[1] && delay_s[1] <= 10.0;
        if !is_range {
            return Err(wrong(
                format!("delays from {} to {} s are no range within 0 to 10 s", delay_s[0], delay_s[1]),
                "/spec/delay_s",
            ));
        }
        let starts = written.starts.unwrap_or(8);
        if !(1..=MOST_STARTS).contains(&starts) {
            return Err(wrong(format!("there are {starts} starts; 1 to {MOST_STARTS} are made"), "/spec/starts"));
        }
        let default = if is_responses { Channel::Output } else { Channel::Control };
        let written = TwoStimulusSpec {
            structures,
            frequency: frequency.as_ref().map(|f| f.settings().clone()),
            channel: written.channel.unwrap_or(default),
            delay_s,
            starts,
            seed: written.seed.unwrap_or(0),
        };
        Ok(Self { written, frequency })
    }

    /// With its defaults filled in.
    pub(super) fn written(&self) -> &TwoStimulusSpec {
        &self.written
    }

    /// How trials are transformed; `None` where the request carries responses.
    pub(super) fn frequency(&self) -> Option<&CheckedSettings> {
        self.frequency.as_ref()
    }
}
