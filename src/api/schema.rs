//! The schemas of bodies: made by schemars from the types that serde reads and writes, and named for the routes.
//!
//! Types of requests are described as they are read (a field with a default may be left out), types of answers as they are written; a type
//! of both is described as it is read, which what is written keeps to as well.

use super::analyses::AnalysisView;
use super::cursor::List;
use super::events::AnalysisEvent;
use super::kinds::KindList;
use super::ops::Health;
use super::plants::{NewPlantBody, PlantPatchBody, PlantView};
use super::problem::HttpProblem;
use super::signals::SignalsDocument;
use super::studies::{NewStudyBody, StudyPatchBody, StudyView};
use super::study_analyses::{BulkAnswer, BulkRequest, StudyProgress};
use super::subjects::{NewSubjectBody, SubjectPatchBody, SubjectView};
use super::trials::{TrialPatchBody, TrialView};
use super::upload::{UploadForm, Uploaded};
use crate::analysis::ids::{AnalysisId, PlantId, StudyId, SubjectId, TrialId};
use crate::analysis::{Kind, Report, Request};
use crate::jobs::Status;
use crate::learning::{StudyFrequencyResponses, StudyLearningCurves, SubjectLearningCurve};
use crate::trial::json::TrialDocument;
use schemars::generate::SchemaSettings;
use schemars::transform::{RecursiveTransform, Transform};
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde_json::{Map, Value, json};
use std::borrow::Cow;
use utoipa::openapi::{Ref, RefOr};
use utoipa::{PartialSchema, ToSchema};

/// A moment, as RFC 3339 writes it, in UTC.
pub(super) struct Timestamp;

impl JsonSchema for Timestamp {
    fn schema_name() -> Cow<'static, str> {
        "Timestamp".into()
    }

    fn inline_schema() -> bool {
        true
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({"type": "string", "format": "date-time"})
    }
}

/// A page of analyses.
pub(super) type AnalysisList = List<AnalysisView>;
/// A page of plants.
pub(super) type PlantList = List<PlantView>;
/// A page of studies.
pub(super) type StudyList = List<StudyView>;
/// A page of subjects.
pub(super) type SubjectList = List<SubjectView>;
/// A page of trials.
pub(super) type TrialList = List<TrialView>;

/// Lets routes name bodies by their types, and lists the types for the document.
macro_rules! bodies {
    (requests: [$($request:ty),* $(,)?], answers: [$($answer:ty),* $(,)?]) => {
        $(named! { $request })*
        $(named! { $answer })*

        fn requests(generator: &mut SchemaGenerator) {
            $(let _ = generator.subschema_for::<$request>();)*
        }

        fn answers(generator: &mut SchemaGenerator) {
            $(let _ = generator.subschema_for::<$answer>();)*
        }
    };
}

macro_rules! named {
    ($body:ty) => {
        impl PartialSchema for $body {
            fn schema() -> RefOr<utoipa::openapi::Schema> {
                RefOr::Ref(Ref::from_schema_name(<Self as JsonSchema>::schema_name()))
            }
        }

        impl ToSchema for $body {
            fn name() -> Cow<'static, str> {
                <Self as JsonSchema>::schema_name()
            }
        }
    };
}

bodies! {
    requests: [
        BulkRequest,
        NewPlantBody,
        NewStudyBody,
        NewSubjectBody,
        PlantPatchBody,
        Request,
        StudyPatchBody,
        SubjectPatchBody,
        TrialDocument,
        TrialPatchBody,
        UploadForm,
        Kind,
        Status,
        AnalysisId,
        PlantId,
        StudyId,
        SubjectId,
        TrialId,
    ],
    answers: [
        AnalysisEvent,
        AnalysisView,
        BulkAnswer,
        Health,
        HttpProblem,
        KindList,
        PlantView,
        Report,
        SignalsDocument,
        StudyFrequencyResponses,
        StudyLearningCurves,
        StudyProgress,
        StudyView,
        SubjectLearningCurve,
        SubjectView,
        TrialView,
        Uploaded,
        AnalysisList,
        PlantList,
        StudyList,
        SubjectList,
        TrialList,
    ]
}

/// The schemas of all bodies by name, as OpenAPI 3.1 has them under `components`.
pub(super) fn components() -> Map<String, Value> {
    let settings = |settings: SchemaSettings| {
        settings.with(|settings| {
            settings.definitions_path = "/components/schemas".into();
            settings.meta_schema = None;
        })
    };
    let mut written = settings(SchemaSettings::draft2020_12().for_serialize()).into_generator();
    answers(&mut written);
    let mut read = settings(SchemaSettings::draft2020_12().for_deserialize()).into_generator();
    requests(&mut read);
    let mut all = written.take_definitions(true);
    all.extend(read.take_definitions(true));
    for schema in all.values_mut() {
        if let Ok(schema) = <&mut Schema>::try_from(schema) {
            RecursiveTransform(plain).transform(schema);
        }
    }
    all
}

/// Writes schemas as generators of clients understand them best.
fn plain(schema: &mut Schema) {
    words(schema);
    if schema.get("type").is_some_and(|kind| kind == "object")
        && schema.get("properties").is_none()
        && schema.get("additionalProperties").is_none()
    {
        schema.insert("additionalProperties".to_owned(), json!(true));
    }
}

/// A choice of words is an enumeration, with what each of them means in its description.
fn words(schema: &mut Schema) {
    let Some(Value::Array(choices)) = schema.get("oneOf") else { return };
    let word = |choice: &Value| {
        let word = choice.get("const")?.as_str()?.to_owned();
        let meaning = choice.get("description").and_then(Value::as_str).unwrap_or_default();
        Some((word.clone(), format!("- `{word}`: {}", meaning.replace('\n', " "))))
    };
    let mut named = Vec::new();
    for choice in choices {
        match (word(choice), choice.get("enum").and_then(Value::as_array)) {
            (Some(word), _) => named.push(word),
            (None, Some(words)) => {
                named.extend(
                    words
                        .iter()
                        .filter_map(|word| Some((word.as_str()?.to_owned(), format!("- `{}`", word.as_str()?)))),
                );
            }
            (None, None) => return,
        }
    }
    let (words, meanings): (Vec<String>, Vec<String>) = named.into_iter().unzip();
    let before =
        schema.get("description").and_then(Value::as_str).map(|text| format!("{text}\n\n")).unwrap_or_default();
    let description = format!("{before}{}", meanings.join("\n"));
    schema.remove("oneOf");
    schema.insert("type".to_owned(), json!("string"));
    schema.insert("enum".to_owned(), json!(words));
    schema.insert("description".to_owned(), json!(description));
}
