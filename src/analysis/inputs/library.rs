//! Stored things that an analysis refers to, and how it gets them.

use crate::analysis::ids::{AnalysisId, PlantId, TrialId};
use crate::analysis::problem::{Code, Problem};
use crate::analysis::report::Warning;
use crate::control::Model;
use crate::identify::search::{KeepNothing, PreparedPools};
use crate::trial::Trial;
use std::collections::BTreeMap;
use std::sync::Arc;

/// The stored things that a request names.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct References {
    /// Trials, in the order named, without repeats.
    pub trials: Vec<TrialId>,
    /// Plants named on their own; a trial brings its plant along.
    pub plants: Vec<PlantId>,
    /// Earlier analyses whose answers the request carries: what they were computed from is used here too.
    pub analyses: Vec<AnalysisId>,
}

impl References {
    /// Whether the request carries all of its data itself.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.trials.is_empty() && self.plants.is_empty()
    }
}

/// Trials that a repeated finding names at most.
const NAMED: usize = 5;

/// A stored trial with the plant it was recorded on.
#[derive(Debug, Clone, PartialEq)]
pub struct StoredTrial {
    /// The recording.
    pub trial: Trial,
    /// SHA-256 of its content, in hexadecimal.
    pub sha256: String,
    /// The plant it was recorded on.
    pub plant: Model,
    /// Whether |y| passed the study's display limit.
    pub divergent: bool,
    /// Why somebody excluded it; `None` where nobody did.
    pub excluded: Option<String>,
    /// What must be read before the trial is used, found at its upload.
    pub warnings: Vec<Warning>,
}

/// Everything that a request refers to, fetched before the computation starts.
#[derive(Debug, Clone)]
pub struct Library {
    /// Trials by id.
    pub trials: BTreeMap<TrialId, Arc<StoredTrial>>,
    /// Plants by id.
    pub plants: BTreeMap<PlantId, Model>,
    /// Where searches get candidate pools and what they prepare on them: the caller may keep these from one analysis to
    /// the next.
    pub pools: Arc<dyn PreparedPools>,
}

impl Default for Library {
    fn default() -> Self {
        Self { trials: BTreeMap::new(), plants: BTreeMap::new(), pools: Arc::new(KeepNothing) }
    }
}

impl Library {
    /// The trial with this id.
    ///
    /// # Errors
    /// A `not_found` problem, where the trial was deleted after the request was made.
    pub fn trial(&self, id: TrialId) -> Result<&Arc<StoredTrial>, Problem> {
        self.trials.get(&id).ok_or_else(|| {
            Problem::new(Code::NotFound, "no such trial", format!("there is no trial {id}")).at("/inputs")
        })
    }

    /// What was found at the upload of the trials that are referred to, each finding with the trials that it is about.
    #[must_use]
    pub fn warnings(&self, references: &References) -> Vec<Warning> {
        let mut found: Vec<(Warning, Vec<String>)> = Vec::new();
        for id in &references.trials {
            for warning in self.trials.get(id).iter().flat_map(|trial| &trial.warnings) {
                match found.iter_mut().find(|(known, _)| known == warning) {
                    Some((_, trials)) => trials.push(id.to_string()),
                    None => found.push((warning.clone(), vec![id.to_string()])),
                }
            }
        }
        let repeated = |(warning, trials): (Warning, Vec<String>)| {
            let more = trials.len().saturating_sub(NAMED);
            let more = if more > 0 { format!(" and {more} more") } else { String::new() };
            let named = trials[..trials.len().min(NAMED)].join(", trial ");
            Warning::new(warning.code, format!("trial {named}{more}: {}", warning.message))
        };
        found.into_iter().map(repeated).collect()
    }

    /// The plant with this id.
    ///
    /// # Errors
    /// A `not_found` problem, where the plant was deleted after the request was made.
    pub fn plant(&self, id: PlantId) -> Result<&Model, Problem> {
        self.plants.get(&id).ok_or_else(|| {
            Problem::new(Code::NotFound, "no such plant", format!("there is no plant {id}")).at("/inputs")
        })
    }
}
