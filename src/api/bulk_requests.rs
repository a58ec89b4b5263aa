//! The requests of a bulk request: one for each trial, subject, session or earlier analysis.

use super::extract::off_thread;
use super::problem::ApiResult;
use super::state::AppState;
use crate::analysis::ids::{AnalysisId, StudyId, SubjectId, TrialId};
use crate::analysis::inputs::earlier::Earlier;
use crate::analysis::{Code, Kind, Problem, Request, registry};
use crate::store::{ReportFilter, TrialRecord};
use schemars::JsonSchema;
use serde::Deserialize;
use serde_json::{Map, Value, json};
use std::collections::{BTreeMap, BTreeSet};

/// Reports that are held at once.
const AT_ONCE: u32 = 20;

/// What one analysis of a bulk request is made of.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub(crate) enum BulkEach {
    /// One trial.
    #[default]
    Trial,
    /// All trials of a subject that match.
    Subject,
    /// All trials of a subject in one session that match; those without a session count as one.
    Session,
    /// What an earlier analysis found.
    Analysis,
}

impl BulkEach {
    /// What there are several of, for messages.
    pub(super) const fn plural(self) -> &'static str {
        match self {
            Self::Trial => "trials",
            Self::Subject => "subjects",
            Self::Session => "sessions",
            Self::Analysis => "analyses",
        }
    }
}

/// Which earlier analyses.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(crate) struct BulkOf {
    /// Of this kind.
    kind: Kind,
    /// Done in this way, by the `spec_sha256` of their spec. Default: in any.
    #[serde(default)]
    #[schemars(regex(pattern = "^[0-9a-f]{64}$"))]
    spec_sha256: Option<String>,
}

/// What every request of a bulk request has.
pub(super) struct Alike {
    pub kind: String,
    pub inputs: Map<String, Value>,
    pub spec: Value,
}

impl Alike {
    fn request(&self, name: &str, value: Value) -> Request {
        let mut inputs = self.inputs.clone();
        inputs.insert(name.to_owned(), value);
        Request { kind: self.kind.clone(), inputs: Value::Object(inputs), spec: self.spec.clone() }
    }

    /// A request that stands for all of them, to check the spec even where there is nothing to compute; `None` where
    /// only a report can tell.
    pub(super) fn sample(&self, each: BulkEach) -> Option<Request> {
        let nobody = TrialId(uuid::Uuid::nil());
        match each {
            BulkEach::Trial => Some(self.request("trial", json!(nobody))),
            BulkEach::Subject | BulkEach::Session => Some(self.request("trials", json!([nobody]))),
            BulkEach::Analysis => None,
        }
    }

    /// One request for each trial, subject or session, in the order of the trials.
    pub(super) fn of_trials(&self, each: BulkEach, trials: &[TrialRecord]) -> Vec<Request> {
        if each == BulkEach::Trial {
            return trials.iter().map(|trial| self.request("trial", json!(trial.id))).collect();
        }
        /// A subject, or one of its sessions.
        type Group = (SubjectId, Option<i64>);
        let mut groups: Vec<(Group, Vec<TrialId>)> = Vec::new();
        for trial in trials {
            let key = (trial.subject, trial.session.filter(|_| each == BulkEach::Session));
            match groups.iter_mut().find(|(own, _)| *own == key) {
                Some((_, own)) => own.push(trial.id),
                None => groups.push((key, vec![trial.id])),
            }
        }
        groups.into_iter().map(|(_, trials)| self.request("trials", json!(trials))).collect()
    }
}

/// What came of looking at earlier analyses.
#[derive(Default)]
pub(super) struct OfAnalyses {
    pub requests: Vec<Request>,
    /// Analyses whose report has no answer to what is asked, with their first trial and the reason.
    pub refused: Vec<(AnalysisId, TrialId, Problem)>,
}

/// One request for the newest of the earlier analyses of each set of trials, all of which must match.
pub(super) async fn of_analyses(
    state: &AppState,
    study: StudyId,
    of: &BulkOf,
    alike: Alike,
    trials: &[TrialRecord],
) -> ApiResult<OfAnalyses> {
    type Made = (AnalysisId, Result<Request, Problem>);
    let matching: BTreeSet<TrialId> = trials.iter().map(|trial| trial.id).collect();
    let filter = ReportFilter { kind: Some(of.kind), spec_sha256: of.spec_sha256.clone() };
    let alike = std::sync::Arc::new(alike);
    // The newest come last, and take the place of older ones.
    let mut newest: BTreeMap<Vec<TrialId>, Made> = BTreeMap::new();
    let mut after = None;
    loop {
        let some = state.store.reports_of_study(study, &filter, after, AT_ONCE).await?;
        for (analysis, why) in &some.damaged {
            tracing::warn!(%analysis, why, "a damaged report is left out of a bulk request");
        }
        let own: Vec<_> =
            some.found.into_iter().filter(|own| own.trials.iter().all(|id| matching.contains(id))).collect();
        let alike = std::sync::Arc::clone(&alike);
        let made = off_thread(move || {
            own.into_iter()
                .map(|own| {
                    let earlier = Earlier { analysis: own.analysis, report: &own.report, explanation: None };
                    let request = registry::of_earlier(&alike.kind, &earlier).map(|found| {
                        let spec = found.completed(&alike.spec);
                        let mut inputs = alike.inputs.clone();
                        inputs.extend(found.inputs);
                        Request { kind: alike.kind.clone(), inputs: Value::Object(inputs), spec }
                    });
                    (own.trials, (own.analysis, request))
                })
                .collect::<Vec<_>>()
        })
        .await?;
        newest.extend(made.into_iter().filter(|(trials, _)| !trials.is_empty()));
        after = some.last;
        if after.is_none() {
            break;
        }
    }
    let mut all = OfAnalyses::default();
    let place = |id: &TrialId| trials.iter().position(|trial| trial.id == *id);
    let mut in_order: Vec<_> = newest.into_iter().collect();
    in_order.sort_by_key(|(own, _)| own.first().and_then(place));
    for (own, (analysis, made)) in in_order {
        match (made, own.first()) {
            (Ok(request), _) => all.requests.push(request),
            (Err(problem), Some(first)) => all.refused.push((analysis, *first, problem)),
            (Err(problem), None) => return Err(problem.into()),
        }
    }
    Ok(all)
}

/// The earlier analyses of a request, or what is missing.
///
/// # Errors
/// A [`Problem`] where `of` is missing, or is given without need.
pub(super) fn named(each: BulkEach, of: Option<BulkOf>) -> Result<Option<BulkOf>, Problem> {
    match (each, of) {
        (BulkEach::Analysis, None) => {
            Err(Problem::new(Code::Invalid, "which analyses", "each is \"analysis\", and of is missing")
                .at("/of")
                .mend("Say which earlier analyses: \"of\": {\"kind\": \"gain_fit\"}."))
        }
        (BulkEach::Analysis, Some(of)) => Ok(Some(of)),
        (_, None) => Ok(None),
        (_, Some(_)) => Err(Problem::new(Code::Invalid, "which analyses", "of is given, and each is no \"analysis\"")
            .at("/of")
            .mend("Leave of out, or ask with \"each\": \"analysis\".")),
    }
}
