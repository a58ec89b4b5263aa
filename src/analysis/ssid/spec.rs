//! How it is identified: as written, and checked.

use super::delay_spec::DelaySpec;
use super::equivalent::EquivalentSpec;
use super::held::{self, holding};
use super::inputs::several_channels;
use super::refined::{BootstrapSpec, MAX_DRAWS};
use super::structures::{MAX_STRUCTURES, StructureSpec};
use crate::analysis::contract::Part;
use crate::analysis::inputs::frequency_problem;
use crate::analysis::problem::{Code, Problem};
use crate::analysis::reading::wrong_spec as wrong;
use crate::identify::held::Held;
use crate::identify::pool::{Degrees, PoolName, PoolSpec, PoolSpecError, Recipe};
use crate::identify::refine::Delays;
use crate::identify::search::Method;
use crate::identify::ssid::Weights;
use crate::response::{CheckedSettings, FrequencySettings, Lines};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// Candidates searched where the spec does not say otherwise.
const MAX_CANDIDATES: [u64; 2] = [1_000_000_000_000, 2_000_000_000];

/// How it is identified.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
#[schemars(extend("required" = ["pool"]))]
pub struct SsidSpec {
    /// The candidate pool.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pool: Option<PoolSpec>,
    /// Degree of the feedforward numerator. Default: by the pool.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub feedforward_numerator_degree: Option<usize>,
    /// Degree of the feedforward denominator; the order of an FIR feedforward. Default: by the pool.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub feedforward_denominator_degree: Option<usize>,
    /// Degree of the feedback numerator. Default: by the pool.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub feedback_numerator_degree: Option<usize>,
    /// Degree of the feedback denominator. Default: by the pool.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub feedback_denominator_degree: Option<usize>,
    /// The controller that is held at zero, for the fit of a person without feedback or without feedforward: its
    /// degrees must be absent, and its part of the pool is not looked at. Default: none is.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub held_at_zero: Option<Held>,
    /// Controllers that are held at zero, each in a fit of its own that is compared with the one of both. Default:
    /// none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub restrictions: Option<Vec<Held>>,
    /// How frequency data are made from trials. Default: as Zhang 2015 does for the named pools (`zhang2015_chapter_3`
    /// with appendix B, `zhang2015_chapter_5` with appendix C), the excited lines for others. Must be absent with
    /// frequency data.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frequency: Option<FrequencySettings>,
    /// How lines are weighted. Default: uniform.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub weights: Option<Weights>,
    /// How the best candidate is found; all ways give the same answer. Default: `branch_and_bound`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub search: Option<Method>,
    /// Larger pools are refused. Default: 1e12, or 2e9 candidate by candidate.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub max_candidates: Option<u64>,
    /// The sample time of sampled controllers on a continuous plant. Default: that of the trial.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub sample_time_s: Option<f64>,
    /// The band of the norms in `metrics`. Default: that of the named pools (0.1 to 0.4 Hz with appendix B, 0 to 0.5 Hz
    /// with appendix C), from the lowest to the highest line used for others.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub band_hz: Option<[f64; 2]>,
    /// Whether the best candidate is refined, and its uncertainty computed where the noise is known. Default: true.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub refine: Option<bool>,
    /// A parametric bootstrap that checks the bands. Default: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bootstrap: Option<BootstrapSpec>,
    /// Pure delays of the person, in the refinement and, if asked, in the search of the pool. Default: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub delay: Option<DelaySpec>,
    /// What is found out about the candidates that the data cannot tell from the best one. Default: `automatic`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub equivalent: Option<EquivalentSpec>,
    /// Structures to compare over the same pool family. Default: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub structures: Option<Vec<StructureSpec>>,
}

impl Part for SsidSpec {
    fn read(value: &Value, at: &str) -> Result<Self, Problem> {
        if value.pointer("/pool/matrix_grid").is_some() {
            return Err(several_channels("a matrix_grid is a pool", format!("{at}/pool/matrix_grid")));
        }
        frequency_problem::read_spec(value, at)
    }
}

/// A checked spec.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct CheckedSpec {
    /// With every default filled in.
    pub used: SsidSpec,
    /// The pool.
    pub recipe: Recipe,
    /// How frequency data are made; `None` where the request carries them.
    pub frequency: Option<CheckedSettings>,
    /// The person's delays, in the refinement.
    pub delays: Option<Delays>,
    /// The pools of the structures to compare.
    pub structures: Vec<Recipe>,
    /// The controllers to hold at zero, one after the other.
    pub restrictions: Vec<Held>,
    /// How lines are weighted.
    pub weights: Weights,
    /// How the best candidate is found.
    pub search: Method,
    /// Larger pools are refused.
    pub max_candidates: u64,
    /// Whether the best candidate is refined.
    pub refine: bool,
}

fn pool_problem(error: &PoolSpecError) -> Problem {
    let code = if error.too_large { Code::Unaffordable } else { Code::Invalid };
    let problem =
        Problem::new(code, "unusable candidate pool", error.message.clone()).at(format!("/spec/{}", error.field));
    if error.too_large { problem.mend("Use coarser grids.") } else { problem }
}

impl CheckedSpec {
    /// Checks a spec.
    pub(super) fn new(written: SsidSpec, is_frequency_data: bool) -> Result<Self, Problem> {
        let Some(pool) = written.pool else {
            return Err(wrong("there is no pool of candidates", "/spec")
                .mend("Add \"pool\": \"zhang2015_appendix_b\", \"zhang2015_appendix_c\", or a grid of one's own."));
        };
        let held_at_zero = written.held_at_zero;
        let degrees = Degrees {
            feedforward_numerator: written.feedforward_numerator_degree,
            feedforward_denominator: written.feedforward_denominator_degree,
            feedback_numerator: written.feedback_numerator_degree,
            feedback_denominator: written.feedback_denominator_degree,
        };
        held::refuse_degrees(held_at_zero, degrees, "/spec")?;
        let recipe =
            pool.check(degrees).map(|recipe| holding(recipe, held_at_zero)).map_err(|error| pool_problem(&error))?;
        let name = match &pool {
            PoolSpec::Name(name) => Some(*name),
            PoolSpec::Thinned(thinned) => Some(thinned.name),
            PoolSpec::Grid(_) | PoolSpec::Roots(_) => None,
        };
        let frequency = match (written.frequency, is_frequency_data) {
            (Some(_), true) => {
                return Err(wrong(
                    "there are frequency settings, but no trial that they could apply to",
                    "/spec/frequency",
                )
                .mend("Leave them out: the request carries its frequency data."));
            }
            (None, true) => None,
            (Some(settings), false) => Some(frequency_problem::check_settings(&settings, "/spec/frequency")?),
            (None, false) => {
                let lines = match name {
                    Some(PoolName::Zhang2015AppendixB) => Lines::Zhang2015Chapter3,
                    Some(PoolName::Zhang2015AppendixC) => Lines::Zhang2015Chapter5,
                    None => Lines::Excited,
                };
                let settings = FrequencySettings { lines, ..FrequencySettings::default() };
                Some(frequency_problem::check_settings(&settings, "/spec/frequency")?)
            }
        };
        let search = written.search.unwrap_or_default();
        let [by_bounds, one_by_one] = MAX_CANDIDATES;
        let most = if search == Method::Exhaustive { one_by_one } else { by_bounds };
        let max_candidates = written.max_candidates.unwrap_or(most);
        if max_candidates == 0 {
            return Err(wrong("at least one candidate must be allowed", "/spec/max_candidates"));
        }
        if let Some(period) = written.sample_time_s.filter(|t| !(t.is_finite() && *t > 0.0)) {
            return Err(wrong(format!("the sample time {period} s is not positive"), "/spec/sample_time_s"));
        }
        let band_hz = written.band_hz.or(match name {
            Some(PoolName::Zhang2015AppendixB) => Some([0.1, 0.4]),
            Some(PoolName::Zhang2015AppendixC) => Some([0.0, 0.5]),
            None => None,
        });
        if let Some([low, high]) = band_hz.filter(|[low, high]| !(*low >= 0.0 && low < high && high.is_finite())) {
            return Err(wrong(format!("the band from {low} to {high} Hz is none"), "/spec/band_hz"));
        }
        let refine = written.refine.unwrap_or(true);
        if let Some(bootstrap) = written.bootstrap {
            if !refine {
                return Err(wrong("the bootstrap repeats a refinement, and there is none", "/spec/bootstrap")
                    .mend("Leave it out, or set refine to true."));
            }
            if bootstrap.draws == 0 || bootstrap.draws > MAX_DRAWS {
                let detail = format!("there are {} draws; 1 to {MAX_DRAWS} are taken", bootstrap.draws);
                return Err(wrong(detail, "/spec/bootstrap/draws"));
            }
        }
        let delays = written.delay.as_ref().map(DelaySpec::check).transpose()?;
        if delays.is_some() && !refine {
            return Err(wrong("delays belong to the refinement, and there is none", "/spec/delay")
                .mend("Leave them out, or set refine to true."));
        }
        if let Some(delays) = &delays {
            held::refuse_delay(held_at_zero, delays)?;
        }
        let restrictions = written.restrictions.clone();
        held::check_restrictions(restrictions.as_deref(), held_at_zero, delays.is_some())?;
        let structure = recipe.structure();
        let listed = written.structures.as_deref().unwrap_or_default();
        if written.structures.is_some() && (listed.is_empty() || listed.len() > MAX_STRUCTURES) {
            let detail = format!("there are {} structures; 1 to {MAX_STRUCTURES} are compared", listed.len());
            return Err(wrong(detail, "/spec/structures"));
        }
        let mut structures = Vec::with_capacity(listed.len());
        for (i, own) in listed.iter().enumerate() {
            let degrees = Degrees {
                feedforward_numerator: own.feedforward_numerator_degree.or(written.feedforward_numerator_degree),
                feedforward_denominator: own.feedforward_denominator_degree.or(written.feedforward_denominator_degree),
                feedback_numerator: own.feedback_numerator_degree.or(written.feedback_numerator_degree),
                feedback_denominator: own.feedback_denominator_degree.or(written.feedback_denominator_degree),
            };
            held::refuse_degrees(held_at_zero, degrees, &format!("/spec/structures/{i}"))?;
            let checked = pool.check(degrees).map(|recipe| holding(recipe, held_at_zero));
            structures.push(checked.map_err(|error| pool_problem(&error).at(format!("/spec/structures/{i}")))?);
        }
        let weights = written.weights.unwrap_or_default();
        let restricted = restrictions.clone().unwrap_or_default();
        let of = |controller: Held, degree: usize| (held_at_zero != Some(controller)).then_some(degree);
        let used = SsidSpec {
            pool: Some(pool),
            feedforward_numerator_degree: of(Held::Feedforward, structure.feedforward_numerator),
            feedforward_denominator_degree: of(Held::Feedforward, structure.feedforward_denominator),
            feedback_numerator_degree: of(Held::Feedback, structure.feedback_numerator),
            feedback_denominator_degree: of(Held::Feedback, structure.feedback_denominator),
            held_at_zero,
            restrictions,
            frequency: frequency.as_ref().map(|f| f.settings().clone()),
            weights: Some(weights),
            search: Some(search),
            max_candidates: Some(max_candidates),
            sample_time_s: written.sample_time_s,
            band_hz,
            refine: Some(refine),
            bootstrap: written.bootstrap,
            delay: written.delay,
            equivalent: Some(written.equivalent.unwrap_or_default()),
            structures: written.structures,
        };
        Ok(Self {
            used,
            recipe,
            frequency,
            delays,
            structures,
            restrictions: restricted,
            weights,
            search,
            max_candidates,
            refine,
        })
    }
}
