//! The schemas of bodies: made by schemars from the types that serde reads and writes, and named for the routes.
//!
//! Types of requests are described as they are read (a field with a default may be left out), types of answers as they
//! are written; a type of both is described as it is read, which what is written keeps to as well.

use super::analyses::{AnalysisList, AnalysisView};
use super::events::AnalysisEvent;
use super::figures::FigureList;
use super::index::IndexView;
use super::kinds::KindList;
use super::ops::Health;
use super::plants::{NewPlantBody, PlantList, PlantPatchBody, PlantView};
use super::problem::HttpProblem;
use super::signals::SignalsDocument;
use super::studies::{NewStudyBody, StudyList, StudyPatchBody, StudyView};
use super::study_analyses::{BulkAnswer, BulkRequest, StudyProgress};
use super::subjects::{NewSubjectBody, SubjectList, SubjectPatchBody, SubjectView};
use super::trials::{TrialList, TrialPatchBody, TrialView};
use super::trust::{AnalysisTrust, TrialTrust};
use super::upload::{UploadForm, Uploaded};
use crate::analysis::ids::{AnalysisId, PlantId, StudyId, SubjectId, TrialId};
use crate::analysis::{Kind, Report, Request};
use crate::exchange::models::ModelExport;
use crate::figure::Figure;
use crate::jobs::Status;
use crate::learning::median_subject::StudyMedianSubjects;
use crate::learning::trust_grid::StudyTrust;
use crate::learning::{StudyComparison, StudyFrequencyResponses, StudyLearningCurves, SubjectLearningCurve};
use crate::trial::json::TrialDocument;
use crate::trust::TrustRule;
use schemars::generate::SchemaSettings;
use schemars::transform::{RecursiveTransform, Transform};
use schemars::{JsonSchema, Schema, SchemaGenerator};
use serde_json::{Map, Value, json};
use std::borrow::Cow;
use utoipa::openapi::{Ref, RefOr};
use utoipa::{PartialSchema, ToSchema};

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
        Figure,
        FigureList,
        Health,
        HttpProblem,
        IndexView,
        KindList,
        ModelExport,
        PlantView,
        Report,
        SignalsDocument,
        StudyComparison,
        StudyMedianSubjects,
        StudyFrequencyResponses,
        StudyLearningCurves,
        StudyProgress,
        StudyView,
        SubjectLearningCurve,
        SubjectView,
        TrialView,
        StudyTrust,
        AnalysisTrust,
        TrialTrust,
        TrustRule,
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
    for (name, schema) in &mut all {
        if let Ok(schema) = <&mut Schema>::try_from(schema) {
            RecursiveTransform(plain).transform(schema);
            name_alternatives(name, schema);
        }
    }
    all
}

/// Gives each alternative that has no name one: that of the type, with that of its only member or of its form.
fn name_alternatives(name: &str, schema: &mut Schema) {
    for key in ["oneOf", "anyOf"] {
        let Some(Value::Array(choices)) = schema.get_mut(key) else { continue };
        for choice in choices.iter_mut().filter_map(Value::as_object_mut) {
            if choice.contains_key("$ref") {
                continue;
            }
            // Generators of clients make a type of each title, so that it begins with the name of its owner.
            if let Some(title) = choice.get("title").and_then(Value::as_str) {
                let whole = if title.starts_with(name) { title.to_owned() } else { format!("{name}{title}") };
                choice.insert("title".to_owned(), json!(whole));
                continue;
            }
            let members = choice.get("properties").and_then(Value::as_object);
            let ending =
                match (members.and_then(|members| members.keys().next()), choice.get("type").and_then(Value::as_str)) {
                    (Some(member), _) => capitalised(member),
                    (None, Some("array")) => "List".to_owned(),
                    (None, Some("string")) => "Name".to_owned(),
                    (None, Some("number" | "integer")) => "Number".to_owned(),
                    (None, Some("null")) => continue,
                    (None, _) => "Value".to_owned(),
                };
            choice.insert("title".to_owned(), json!(format!("{name}{ending}")));
        }
    }
}

/// `FrequencyHz` for `frequency_hz`.
fn capitalised(name: &str) -> String {
    let capital =
        |word: &str| word.chars().next().map(|c| c.to_uppercase().collect::<String>() + &word[c.len_utf8()..]);
    name.split('_').filter_map(capital).collect()
}

/// Writes schemas as generators of clients understand them best.
fn plain(schema: &mut Schema) {
    describe_members(schema);
    words(schema);
    // A generator of clients takes a field with a default for one that is always there, in requests too; descriptions
    // have the defaults in words.
    schema.remove("default");
    if schema.get("type").is_some_and(|kind| kind == "object")
        && schema.get("properties").is_none()
        && schema.get("additionalProperties").is_none()
    {
        schema.insert("additionalProperties".to_owned(), json!(true));
    }
}

/// The constant or the only member that tells an alternative from the others says what it is, where it says nothing
/// itself.
fn describe_members(schema: &mut Schema) {
    let Some(Value::Array(choices)) = schema.get_mut("oneOf") else { return };
    for choice in choices {
        let Some(text) = choice.get("description").cloned() else { continue };
        let Some(Value::Object(members)) = choice.get_mut("properties") else { continue };
        let is_alone = members.len() == 1;
        for member in members.values_mut().filter_map(Value::as_object_mut) {
            if is_alone || member.contains_key("const") {
                member.entry("description").or_insert_with(|| text.clone());
            }
        }
    }
}

/// Words to choose from are one enumeration, with what each of them means in its description.
fn words(schema: &mut Schema) {
    let Some(Value::Array(choices)) = schema.get("oneOf") else { return };
    let word = |choice: &Value| {
        let word = choice.get("const")?.as_str()?.to_owned();
        let meaning = choice.get("description").and_then(Value::as_str).unwrap_or_default();
        Some(vec![(word.clone(), format!("- `{word}`: {}", meaning.replace('\n', " ")))])
    };
    // Words that are not explained come as one enumeration.
    let plain = |choice: &Value| {
        let words = choice.get("enum")?.as_array()?.iter().filter_map(Value::as_str);
        Some(words.map(|word| (word.to_owned(), format!("- `{word}`"))).collect())
    };
    let (mut words, mut others) = (Vec::new(), Vec::new());
    for choice in choices {
        match word(choice).or_else(|| plain(choice)) {
            Some(found) => words.extend::<Vec<(String, String)>>(found),
            None => others.push(choice.clone()),
        }
    }
    if words.is_empty() {
        return;
    }
    let (words, meanings): (Vec<String>, Vec<String>) = words.into_iter().unzip();
    let meanings = meanings.join("\n");
    let mut named = json!({"type": "string", "enum": words, "description": meanings});
    if others.is_empty() {
        let before = schema.get("description").and_then(Value::as_str).map(|text| format!("{text}\n\n"));
        named["description"] = json!(format!("{}{meanings}", before.unwrap_or_default()));
        schema.remove("oneOf");
        for (key, value) in named.as_object().into_iter().flatten() {
            schema.insert(key.clone(), value.clone());
        }
    } else {
        others.insert(0, named);
        schema.insert("oneOf".to_owned(), json!(others));
    }
}
