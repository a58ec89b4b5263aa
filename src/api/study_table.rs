//! A study as one tidy table.

use super::etag::IfNoneMatch;
use super::extract::{FromQuery, Id, Params, QueryText, off_thread};
use super::forms::{self, AcceptForm, Form, FormQuery};
use super::learning_inputs::{everything, spec_sha256};
use super::problem::{ApiResult, internal};
use super::state::AppState;
use super::studies::StudyPath;
use crate::analysis::ids::{AnalysisId, PlantId, StudyId, TrialId};
use crate::analysis::{Kind, Problem, registry};
use crate::exchange::tables::Record;
use crate::exchange::tables::study::{self, AnalysisFacts, TRIAL_COLUMNS, TrialFacts};
use crate::store::{
    Plant, ReportFilter, StoredTrust, Study, StudyReport, Subject, TrialFilter, TrialRecord, TrustFilter,
};
use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::Response;
use serde_json::{Map, Value};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use time::format_description::well_known::Rfc3339;
use utoipa::IntoParams;

/// Reports read at once: a row keeps little of one.
const AT_ONCE: u32 = 50;

/// Which trials, and which analyses of them.
#[derive(Debug, Clone, IntoParams)]
#[into_params(parameter_in = Query)]
pub(crate) struct TableQuery {
    /// Only analyses of this kind. Trials without one keep their row.
    #[param(nullable = false, inline)]
    kind: Option<Kind>,
    /// Only analyses with this `spec_sha256`.
    #[param(nullable = false, pattern = "^[0-9a-f]{64}$")]
    spec: Option<String>,
    /// Only subjects of this group.
    #[param(nullable = false)]
    group: Option<String>,
    /// Only trials on this plant.
    #[param(nullable = false)]
    plant: Option<PlantId>,
    /// Only trials of this session.
    #[param(nullable = false, minimum = 0, maximum = 1000000000)]
    session: Option<i64>,
}

impl FromQuery for TableQuery {
    fn from_query(query: &mut QueryText) -> Result<Self, Problem> {
        Ok(Self {
            kind: query.one_of("kind", &registry::names(), |text| text.parse().ok())?,
            spec: spec_sha256(query)?,
            group: query.take("group")?,
            plant: query.id("plant")?,
            session: query.integer("session", 0, super::trials::MAX_NUMBER)?,
        })
    }
}

/// What rows are made from, beside reports.
struct Lab {
    study: Study,
    subjects: BTreeMap<String, Subject>,
    plants: BTreeMap<String, Plant>,
    trials: Vec<TrialRecord>,
    /// The place of each trial in that list.
    places: BTreeMap<TrialId, usize>,
    trust: BTreeMap<(TrialId, AnalysisId), Vec<StoredTrust>>,
}

/// A row with what it is sorted by: the trial's place, the kind, the analysis.
type Sorted = ((usize, &'static str, Option<AnalysisId>), Record);

impl Lab {
    fn facts<'a>(&'a self, trial: &'a TrialRecord) -> Option<TrialFacts<'a>> {
        // Made after the lists were read.
        let subject = self.subjects.get(&trial.subject.to_string())?;
        let plant = self.plants.get(&trial.plant.to_string())?;
        let key = trial.session.map_or_else(|| trial.number.to_string(), |s| format!("{s}/{}", trial.number));
        let columns: Option<&Map<String, Value>> =
            subject.attributes.get(TRIAL_COLUMNS).and_then(|all| all.get(&key)).and_then(Value::as_object);
        Some(TrialFacts {
            study: &self.study.name,
            subject: &subject.code,
            group: subject.group.as_deref(),
            attributes: &subject.attributes,
            of_trial: columns,
            session: trial.session,
            number: trial.number,
            trial: trial.id.to_string(),
            plant: &plant.name,
            sample_time_s: trial.sample_time_s,
            samples: trial.samples,
            divergent: trial.divergent,
            sha256: &trial.sha256,
            metrics: &trial.metrics,
            warnings: trial.warnings.iter().map(|warning| warning.code.as_str()).collect(),
        })
    }

    /// The rows of an analysis: one for each of its trials that is asked for.
    fn rows(&self, own: &StudyReport) -> Vec<Sorted> {
        let created_at = own.created_at.format(&Rfc3339).unwrap_or_default();
        let trials = own.trials.iter().enumerate();
        let row = |(position, id): (usize, &TrialId)| {
            let place = *self.places.get(id)?;
            let trial = self.trials.get(place)?;
            let facts = self.facts(trial)?;
            let found = self.trust.get(&(*id, own.analysis)).into_iter().flatten().map(|own| {
                let mut quantity = own.quantity.clone();
                quantity.trust = quantity.trust.in_trial(trial.divergent);
                quantity
            });
            let analysis = AnalysisFacts {
                analysis: own.analysis.to_string(),
                trials: own.trials.len(),
                position,
                created_at: created_at.clone(),
                report: &own.report,
                quantities: found.collect(),
            };
            Some(((place, own.report.kind.name(), Some(own.analysis)), study::row(&facts, Some(&analysis))))
        };
        trials.filter_map(row).collect()
    }
}

async fn lab(state: &AppState, id: StudyId, query: &TableQuery) -> ApiResult<Lab> {
    let study = state.store.study(id).await?;
    let filter = TrialFilter {
        group: query.group.clone(),
        plant: query.plant,
        session: query.session,
        include_divergent: true,
        ..TrialFilter::default()
    };
    let trials = state.store.matching_trials(id, &filter).await?;
    let plants = everything(|page| state.store.plants(id, page), |plant| plant.id.0).await?;
    let subjects =
        everything(|page| state.store.subjects(id, query.group.as_deref(), page), |subject| subject.id.0).await?;
    let mut trust: BTreeMap<_, Vec<StoredTrust>> = BTreeMap::new();
    for own in state.store.trust_of_study(id, &TrustFilter::default()).await? {
        trust.entry((own.trial, own.analysis)).or_default().push(own);
    }
    Ok(Lab {
        study,
        subjects: subjects.into_iter().map(|subject| (subject.id.to_string(), subject)).collect(),
        plants: plants.into_iter().map(|plant| (plant.id.to_string(), plant)).collect(),
        places: trials.iter().enumerate().map(|(place, trial)| (trial.id, place)).collect(),
        trials,
        trust,
    })
}

/// A study as one tidy table: a row for each trial and succeeded analysis, and for each trial that has none.
///
/// Who, which trial, on what; attributes of the subject (`attribute_…`) and of the trial (`trial_…`); measures in time;
/// what the analysis found, each value with the ends of its 95 % interval (`…_low`, `…_high`) and how far it may be
/// used (`trust_…`: `ok`, `read`, `do_not_use`, `not_identified`); the controllers' coefficients by their power
/// (`feedback_num_0`); codes of warnings, separated by spaces; hashes and versions. What a refinement found begins with
/// `refined_`. Divergent trials are there, and say so. Columns depend on what there is; the first eleven are always the
/// same. As NDJSON every line has every column.
#[utoipa::path(get, path = "/v1/studies/{study}/table", tag = "studies", operation_id = "read_study_table",
    params(StudyPath, TableQuery, FormQuery, AcceptForm, IfNoneMatch),
    responses((status = 200, description = "The table, as CSV unless NDJSON is asked for.",
            content((String = "text/csv"), (String = "application/x-ndjson"))),
        (status = 406, description = "Neither text/csv nor application/x-ndjson is acceptable.")))]
pub(crate) async fn read(
    State(state): State<AppState>,
    Id(id): Id<StudyId>,
    Params((query, form)): Params<(TableQuery, FormQuery)>,
    headers: HeaderMap,
) -> ApiResult<Response> {
    let form = form.choose(&headers, &[Form::Csv, Form::Ndjson])?;
    let lab = Arc::new(lab(&state, id, &query).await?);
    let filter = ReportFilter { kind: query.kind, spec_sha256: query.spec.clone() };
    let (mut rows, mut after): (Vec<Sorted>, _) = (Vec::new(), None);
    loop {
        let some = state.store.reports_of_study(id, &filter, after, AT_ONCE).await?;
        for (analysis, why) in &some.damaged {
            tracing::warn!(%analysis, why, "a damaged report is left out of a table");
        }
        let lab = Arc::clone(&lab);
        let found = off_thread(move || some.found.iter().flat_map(|own| lab.rows(own)).collect::<Vec<_>>()).await?;
        rows.extend(found);
        after = some.last;
        if after.is_none() {
            break;
        }
    }
    let bytes = off_thread(move || {
        let analysed: BTreeSet<usize> = rows.iter().map(|((place, ..), _)| *place).collect();
        for (place, trial) in lab.trials.iter().enumerate().filter(|(place, _)| !analysed.contains(place)) {
            let Some(facts) = lab.facts(trial) else { continue };
            rows.push(((place, "", None), study::row(&facts, None)));
        }
        rows.sort_by(|a, b| a.0.cmp(&b.0));
        let table = study::table(rows.into_iter().map(|(_, row)| row).collect());
        match form {
            Form::Csv => Some(table.csv()),
            Form::Ndjson => Some(table.ndjson()),
            _ => None,
        }
    })
    .await?;
    let bytes = bytes.ok_or_else(internal)?;
    Ok(forms::file(&headers, form, &format!("study-{id}"), bytes))
}
