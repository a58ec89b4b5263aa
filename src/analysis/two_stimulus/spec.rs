//! How it is estimated: as written, and checked.

use crate::analysis::contract::Part;
use crate::analysis::inputs::frequency_problem;
use crate::analysis::problem::{Code, Problem};
use crate::analysis::reading::wrong_spec as wrong;
use crate::identify::pool::{Degrees, PoolSpec, Recipe};
use crate::response::{CheckedSettings, FrequencySettings};
use crate::two_stimulus::fit::Channel;
use crate::two_stimulus::structure::Structure;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// Structures fitted at most, and starts of each.
const MOST_STRUCTURES: usize = 20;
const MOST_STARTS: usize = 200;

/// Candidates of a pool where the spec does not say otherwise.
const MAX_CANDIDATES: u64 = 100_000_000;

/// How it is estimated.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct TwoStimulusSpec {
    /// The structures that are fitted. Default: McRuer's ladder, that is error feedback with lead, lag and delay; the
    /// same with feedforward by the plant's inverse with gain, lag and a delay of its own; the same with a
    /// neuromuscular lag; the same with a neuromuscular system of second order in its place. An empty list fits none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub structures: Option<Vec<Structure>>,
    /// How trials are transformed. Default: the excited lines of the whole record. Must be absent with responses in the
    /// request; `average` has no effect (trials are combined by least squares).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frequency: Option<FrequencySettings>,
    /// A pool that is searched for the candidate nearest to both responses, exactly. Default: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pool: Option<PoolSpec>,
    /// Degree of the pool's feedforward numerator. Default: by the pool.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub feedforward_numerator_degree: Option<usize>,
    /// Degree of the pool's feedforward denominator. Default: by the pool.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub feedforward_denominator_degree: Option<usize>,
    /// Degree of the pool's feedback numerator. Default: by the pool.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub feedback_numerator_degree: Option<usize>,
    /// Degree of the pool's feedback denominator. Default: by the pool.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub feedback_denominator_degree: Option<usize>,
    /// Larger pools are refused. Default: 1e8, where there is a pool.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_candidates: Option<u64>,
    /// Which responses are fitted. Default: those of the control for trials, those of the output for responses in the
    /// request.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub channel: Option<Channel>,
    /// The range in which the feedback's delay is sought. Default: 0.02 to 1 s.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub delay_s: Option<[f64; 2]>,
    /// The range in which the feedforward's delay is sought; a negative one looks ahead, as who sees the command coming
    /// can. Default: from -0.5 s to the feedback's longest.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub feedforward_delay_s: Option<[f64; 2]>,
    /// Starts of each fit. Default: 8.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub starts: Option<usize>,
    /// The seed of the starts. Default: 0.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,
    /// Whether the estimate without structure is shrunk towards the best structure and predicts the trials of
    /// `validate_on`; trials only, and few enough that their excited lines together are at most 1000. Default: false.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub regularise: Option<bool>,
}

impl Part for TwoStimulusSpec {
    fn read(value: &Value, at: &str) -> Result<Self, Problem> {
        frequency_problem::read_spec(value, at)
    }
}

/// A checked spec.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct CheckedSpec {
    /// With every default filled in.
    pub used: TwoStimulusSpec,
    recipe: Option<Recipe>,
    /// How trials are transformed; `None` where the request carries responses.
    pub frequency: Option<CheckedSettings>,
    /// The structures that are fitted.
    pub structures: Vec<Structure>,
    /// Which responses are fitted.
    pub channel: Channel,
    /// The range in which the feedback's delay is sought, in seconds.
    pub delay_s: [f64; 2],
    /// The range in which the feedforward's is.
    pub feedforward_delay_s: [f64; 2],
    /// Starts of each fit.
    pub starts: usize,
    /// The seed of the starts.
    pub seed: u64,
    /// Whether the estimate without structure is shrunk towards the best structure.
    pub regularise: bool,
}

impl CheckedSpec {
    /// Checks a spec.
    pub(super) fn new(written: TwoStimulusSpec, is_responses: bool) -> Result<Self, Problem> {
        let frequency = match (written.frequency, is_responses) {
            (Some(_), true) => {
                return Err(wrong(
                    "there are frequency settings, but no trial that they could apply to",
                    "/spec/frequency",
                )
                .mend("Leave them out: the request carries its responses."));
            }
            (None, true) => None,
            (settings, false) => {
                Some(frequency_problem::check_settings(&settings.unwrap_or_default(), "/spec/frequency")?)
            }
        };
        let degrees = Degrees {
            feedforward_numerator: written.feedforward_numerator_degree,
            feedforward_denominator: written.feedforward_denominator_degree,
            feedback_numerator: written.feedback_numerator_degree,
            feedback_denominator: written.feedback_denominator_degree,
        };
        let recipe = match &written.pool {
            None => None,
            Some(pool) => Some(pool.check(degrees).map_err(|error| {
                let code = if error.too_large { Code::Unaffordable } else { Code::Invalid };
                Problem::new(code, "unusable candidate pool", error.message.clone())
                    .at(format!("/spec/{}", error.field))
            })?),
        };
        let stray = [
            ("feedforward_numerator_degree", written.feedforward_numerator_degree.is_some()),
            ("feedforward_denominator_degree", written.feedforward_denominator_degree.is_some()),
            ("feedback_numerator_degree", written.feedback_numerator_degree.is_some()),
            ("feedback_denominator_degree", written.feedback_denominator_degree.is_some()),
            ("max_candidates", written.max_candidates.is_some()),
        ];
        if let Some((name, _)) = stray.iter().find(|(_, is_given)| *is_given && recipe.is_none()) {
            return Err(wrong("it belongs to a pool, and there is none", format!("/spec/{name}")));
        }
        let structure = recipe.as_ref().map(Recipe::structure);
        let structures = written.structures.unwrap_or_else(|| Structure::ladder().to_vec());
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
        let feedforward_delay_s = written.feedforward_delay_s.unwrap_or([-0.5, delay_s[1]]);
        let [low, high] = feedforward_delay_s;
        if !(low >= -10.0 && low < high && high <= 10.0) {
            return Err(wrong(
                format!("delays from {low} to {high} s are no range within -10 to 10 s"),
                "/spec/feedforward_delay_s",
            ));
        }
        let starts = written.starts.unwrap_or(8);
        if !(1..=MOST_STARTS).contains(&starts) {
            return Err(wrong(format!("there are {starts} starts; 1 to {MOST_STARTS} are made"), "/spec/starts"));
        }
        let regularise = written.regularise.unwrap_or(false);
        if regularise && is_responses {
            return Err(wrong("responses in the request are no trials to learn changes from", "/spec/regularise")
                .mend("Leave it out, or give trials."));
        }
        let default = if is_responses { Channel::Output } else { Channel::Control };
        let (channel, seed) = (written.channel.unwrap_or(default), written.seed.unwrap_or(0));
        let used = TwoStimulusSpec {
            structures: Some(structures.clone()),
            frequency: frequency.as_ref().map(|f| f.settings().clone()),
            max_candidates: recipe.as_ref().map(|_| written.max_candidates.unwrap_or(MAX_CANDIDATES)),
            pool: written.pool,
            feedforward_numerator_degree: structure.map(|s| s.feedforward_numerator),
            feedforward_denominator_degree: structure.map(|s| s.feedforward_denominator),
            feedback_numerator_degree: structure.map(|s| s.feedback_numerator),
            feedback_denominator_degree: structure.map(|s| s.feedback_denominator),
            channel: Some(channel),
            delay_s: Some(delay_s),
            feedforward_delay_s: Some(feedforward_delay_s),
            starts: Some(starts),
            seed: Some(seed),
            regularise: Some(regularise),
        };
        Ok(Self {
            used,
            recipe,
            frequency,
            structures,
            channel,
            delay_s,
            feedforward_delay_s,
            starts,
            seed,
            regularise,
        })
    }

    /// The pool, with the most candidates that are searched.
    pub(super) fn pool(&self) -> Option<(&Recipe, u64)> {
        self.recipe.as_ref().zip(self.used.max_candidates)
    }
}
