//! `volition import DIR`: a folder of trials into a study, with the same checks as an upload; or a bundle as it is.

mod archive;
pub mod index;
pub mod load;
pub mod plant_text;

use super::bundle::take_in::{self, TakeIn, take_in};
use super::recordings::ReadingArgs;
use crate::control::Model;
use crate::exchange::tables::study::TRIAL_COLUMNS;
use crate::exchange::{Options, Saved, options};
use crate::store::{Store, Study, StudyPatch, StudyReading};
use anyhow::Context as _;
use clap::Args;
use index::{Condition, Index};
use indicatif::{ProgressBar, ProgressStyle};
use load::{Outcome, PlantOptions};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Something was refused.
const REFUSED: u8 = 2;

/// What to import, and into which study.
#[derive(Debug, Clone, Args)]
pub struct ImportArgs {
    /// Folder with recordings (tables as text or JSON, packed with gzip or not) and an index: index.csv with the
    /// columns file, subject, trial and optionally group, session, plant, display_limit, or index.json or truth.json,
    /// an array of objects with these members, and plant_num and plant_den for the plant; or a zip of one. Or a file
    /// that `volition export` wrote: a study, which is taken in under its own ids.
    pub folder: PathBuf,
    /// Name of the study that a folder is imported into; made if there is none.
    #[arg(long, value_name = "NAME")]
    pub study: Option<String>,
    /// Database file; made if it does not exist.
    #[arg(long, value_name = "FILE", default_value = "volition.db", env = "VOLITION_DATABASE")]
    pub database: PathBuf,
    /// Index file, relative to the folder.
    #[arg(long, value_name = "FILE")]
    pub index: Option<PathBuf>,
    /// Model of a plant that the index names: a JSON file, a name of the catalogue, or a transfer function such as
    /// 1/(s(s+1)). Without `NAME=`: the plant of rows that name none. Names of the catalogue and transfer functions
    /// need no option.
    #[arg(long = "plant", value_name = "NAME=MODEL")]
    pub plants: Vec<String>,
    /// Trials with |y| above this are divergent; by default what the index says.
    #[arg(long, value_name = "LIMIT")]
    pub display_limit: Option<f64>,
    /// Import only rows with this text in a column of the index; may be repeated.
    #[arg(long = "where", value_name = "COLUMN=VALUE")]
    pub conditions: Vec<Condition>,
    /// Of an exported study: compute an analysis again and compare the results; the first one that succeeded, unless an
    /// id is given.
    #[arg(long, value_name = "ANALYSIS", num_args = 0..=1)]
    pub recompute: Option<Option<String>>,
    /// Keep --columns, --time-unit, --sample-time and --resample with the study, for later imports and uploads.
    #[arg(long)]
    pub remember: bool,
    /// What the files do not say themselves; without it, what was kept with the study.
    #[command(flatten)]
    pub reading: ReadingArgs,
}

/// Imports, prints what was done, and says by the exit code whether anything was refused (2).
///
/// # Errors
/// When the index cannot be read, an option makes no sense, or the database fails.
pub async fn import(args: &ImportArgs) -> anyhow::Result<ExitCode> {
    if take_in::is_bundle(&args.folder) {
        let recompute = args.recompute.as_ref().map(Option::as_deref);
        return take_in(TakeIn { file: &args.folder, database: &args.database, recompute }).await;
    }
    let Some(study) = &args.study else {
        anyhow::bail!(
            "{} is no exported study: name the study that it is imported into with --study",
            args.folder.display()
        );
    };
    if args.recompute.is_some() {
        anyhow::bail!("--recompute is for an exported study, and {} is none", args.folder.display());
    }
    // Gone at the end of the import.
    let unpacked = archive::unpack(&args.folder)?;
    let folder = unpacked.as_ref().map_or(&*args.folder, |own| &own.folder);
    let index = index::read(folder, args.index.as_deref(), &args.conditions)?;
    let plants = plant_options(&args.plants)?;
    let limit = match args.display_limit {
        Some(limit) if limit.is_finite() && limit > 0.0 => Some(limit),
        Some(limit) => anyhow::bail!("the display limit is {limit}, and must be positive and finite"),
        None => load::common_display_limit(&index)?,
    };
    let store = Store::open(Some(&args.database)).await?;
    let study = load::find_or_create_study(&store, study, limit).await?;
    let bar = progress_bar("imported");
    let study = if args.remember { remember(&store, study, &args.reading).await? } else { study };
    let options = Options { saved: saved_of(&study.reading)?, ..args.reading.options() };
    let outcome = load::load(&store, &study, folder, &index, &plants, &options, &bar).await;
    bar.finish_and_clear();
    store.close().await;
    let outcome = outcome?;
    let head = format!("study {:?} ({}) in {}", study.name, study.id, args.database.display());
    print(&mut std::io::stdout().lock(), &head, &index, &outcome)?;
    Ok(if outcome.refused.is_empty() { ExitCode::SUCCESS } else { ExitCode::from(REFUSED) })
}

/// Keeps with the study what was said of its files.
async fn remember(store: &Store, study: Study, said: &ReadingArgs) -> anyhow::Result<Study> {
    let reading = StudyReading {
        columns: said.columns.as_ref().map(options::written),
        time_unit: said.time_unit.map(|unit| unit.name().to_owned()),
        sample_time_s: said.sample_time,
        resample: said.resample.map(|_| "linear".to_owned()),
    };
    let patch = StudyPatch { reading: Some(reading), ..StudyPatch::default() };
    Ok(store.change::<Study>(study.id, patch, Some(study.version)).await?)
}

fn saved_of(reading: &StudyReading) -> anyhow::Result<Saved> {
    let StudyReading { columns, time_unit, sample_time_s, resample } = reading;
    Saved::parse(columns.as_deref(), time_unit.as_deref(), *sample_time_s, resample.as_deref())
        .map_err(|(member, why)| anyhow::anyhow!("what is kept with the study, {member}: {why}"))
}

/// A bar on standard error; nothing where that is no terminal.
pub(super) fn progress_bar(done: &'static str) -> ProgressBar {
    let bar = ProgressBar::new(0);
    if let Ok(style) = ProgressStyle::with_template("{bar:40} {pos}/{len} {msg}  {eta} left") {
        bar.set_style(style);
    }
    bar.set_message(done);
    bar
}

fn plant_options(texts: &[String]) -> anyhow::Result<PlantOptions> {
    let mut options = PlantOptions::default();
    for text in texts {
        match text.split_once('=') {
            Some((name, value)) => {
                let model = model(value).with_context(|| format!("--plant {text}"))?;
                options.named.insert(name.to_owned(), model);
            }
            None => {
                let model = model(text).with_context(|| format!("--plant {text}"))?;
                let name = Path::new(text).file_stem().filter(|_| text.ends_with(".json"));
                let name = name.map_or_else(|| text.clone(), |stem| stem.to_string_lossy().into_owned());
                if options.default.replace((name, model)).is_some() {
                    anyhow::bail!("--plant without NAME= is given twice");
                }
            }
        }
    }
    Ok(options)
}

pub(super) fn model(text: &str) -> anyhow::Result<Model> {
    let model = if text.ends_with(".json") {
        let json = std::fs::read_to_string(text).with_context(|| format!("cannot read {text}"))?;
        serde_json::from_str(&json).with_context(|| format!("{text} holds no model {{num, den}} or {{a, b, c, d}}"))?
    } else {
        load::named_model(text).map_err(anyhow::Error::msg)?
    };
    model.shape()?;
    Ok(model)
}

/// The summary.
fn print(out: &mut impl Write, head: &str, index: &Index, outcome: &Outcome) -> std::io::Result<()> {
    let Outcome { imported, already_there, divergent, refused, notes, per_plant, subjects } = outcome;
    writeln!(out, "{head}")?;
    writeln!(
        out,
        "  {imported} trials imported ({divergent} divergent), {already_there} already there, {} refused",
        refused.len()
    )?;
    if index.filtered > 0 {
        writeln!(out, "  {} rows of the index left out by --where", index.filtered)?;
    }
    writeln!(out, "  {} subjects: {}", subjects.len(), subjects.iter().cloned().collect::<Vec<_>>().join(", "))?;
    for (plant, trials) in per_plant {
        writeln!(out, "  plant {plant}: {trials} trials")?;
    }
    if !index.extra_columns.is_empty() {
        let columns = index.extra_columns.join(", ");
        writeln!(out, "  kept in the subjects' attributes, under {}: {columns}", TRIAL_COLUMNS)?;
    }
    for note in notes {
        writeln!(out, "  note: {note}")?;
    }
    for one in refused {
        writeln!(out, "  refused {}: {}", one.file, one.reason)?;
    }
    Ok(())
}
