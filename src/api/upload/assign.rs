//! Which number, session and plant each file gets.

use super::files::File;
use super::{FileMetadata, UploadQuery};
use crate::analysis::ids::PlantId;
use crate::analysis::{Code, Problem};
use crate::api::extract::{Integer, from_json, from_value};
use crate::api::problem::{ApiResult, unless_missing};
use crate::api::state::AppState;
use crate::api::trials::in_range;
use crate::store::{Plant, Subject};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Parts the metadata from the files proper.
pub(super) fn with_metadata(mut files: Vec<File>) -> Result<(Vec<File>, Vec<FileMetadata>), Problem> {
    let Some(at) = files.iter().position(|file| file.is_metadata()) else { return Ok((files, Vec::new())) };
    let part = files.remove(at);
    let within = |problem: Problem| {
        let place = format!("part metadata, {}", problem.location.clone().unwrap_or_default());
        problem.at(place)
    };
    let entries: Vec<serde_json::Value> = from_json(&part.bytes).map_err(within)?;
    let metadata = entries
        .iter()
        .enumerate()
        .map(|(i, entry)| from_value(entry, &format!("/{i}")).map_err(within))
        .collect::<Result<_, _>>()?;
    Ok((files, metadata))
}

/// What is known of a trial besides its recording.
#[derive(Debug, Clone)]
pub(super) struct Wanted {
    pub(crate) plant: PlantId,
    /// Where the plant was named.
    plant_at: String,
    pub(crate) number: Option<i64>,
    pub(crate) session: Option<i64>,
}

pub(super) fn assignments(
    files: &[File],
    metadata: Vec<FileMetadata>,
    query: &UploadQuery,
) -> Result<Vec<Wanted>, Problem> {
    let mut by_file: BTreeMap<String, (usize, FileMetadata)> = BTreeMap::new();
    for (i, entry) in metadata.into_iter().enumerate() {
        let bad = |field: &str, why: String| {
            Problem::new(Code::Invalid, "bad metadata", why).at(format!("part metadata, /{i}/{field}"))
        };
        if !files.iter().any(|file| file.name.as_deref() == Some(&entry.file)) {
            return Err(bad("file", format!("the form has no file named '{}'", entry.file)));
        }
        if let Some(Integer(number)) = entry.number {
            in_range(number, 1, &format!("part metadata, /{i}/number"))?;
        }
        if let Some(Integer(session)) = entry.session {
            in_range(session, 0, &format!("part metadata, /{i}/session"))?;
        }
        let file = entry.file.clone();
        if by_file.insert(file, (i, entry)).is_some() {
            return Err(bad("file", "the file has an entry already".to_owned()));
        }
    }
    let mut succession = query.number;
    let mut wanted = Vec::with_capacity(files.len());
    for file in files {
        let entry = file.name.as_ref().and_then(|name| by_file.get(name));
        let own = entry.map(|(_, entry)| entry);
        let number = own.and_then(|entry| entry.number).map(|Integer(n)| n).or_else(|| {
            let number = succession?;
            succession = Some(number + 1);
            Some(number)
        });
        let (plant, plant_at) = match (entry, query.plant) {
            (Some((i, FileMetadata { plant: Some(plant), .. })), _) => (*plant, format!("part metadata, /{i}/plant")),
            (_, Some(plant)) => (plant, "query parameter plant".to_owned()),
            (_, None) => {
                return Err(Problem::new(
                    Code::Malformed,
                    "no plant",
                    match &file.name {
                        Some(name) => format!("no plant is given for the file '{name}'"),
                        None => "no plant is given".to_owned(),
                    },
                )
                .at("query parameter plant")
                .mend("Give ?plant=ID, the plant that the trial was recorded on."));
            }
        };
        let session = own.and_then(|entry| entry.session).map(|Integer(s)| s).or(query.session);
        wanted.push(Wanted { plant, plant_at, number, session });
    }
    Ok(wanted)
}

/// The plants named, each of the subject's study and with one input and one output.
pub(super) async fn plants(
    state: &AppState,
    subject: &Subject,
    wanted: &[Wanted],
) -> ApiResult<BTreeMap<PlantId, Arc<Plant>>> {
    let mut plants = BTreeMap::new();
    for Wanted { plant: id, plant_at, .. } in wanted {
        if plants.contains_key(id) {
            continue;
        }
        let bad = |why: String| Problem::new(Code::Invalid, "no such plant in the study", why).at(plant_at.clone());
        let plant =
            unless_missing(state.store.plant(*id).await)?.ok_or_else(|| bad(format!("there is no plant {id}")))?;
        if plant.study != subject.study {
            return Err(bad(format!("the plant {id} is of another study than the subject")).into());
        }
        if let Err(error) = plant.model.check() {
            return Err(Problem::new(Code::Invalid, "not a plant of one input and one output", error.to_string())
                .at(plant_at.clone())
                .into());
        }
        plants.insert(*id, Arc::new(plant));
    }
    Ok(plants)
}
