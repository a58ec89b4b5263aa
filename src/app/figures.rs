//! `volition figures STUDY --out DIR`: what a study, or an analysis, offers to see, as files.

mod like;

use super::{Answer, ask, find_study};
use crate::analysis::ids::AnalysisId;
use crate::store::Store;
use anyhow::{Context as _, bail};
use clap::Args;
use like::Asked;
use serde_json::Value;
use std::io::{self, Write};
use std::path::PathBuf;
use std::process::ExitCode;

/// The request makes no sense.
const REFUSED: u8 = 2;

/// Which study, and how its figures are drawn: the parameters of `GET /v1/studies/{study}/figures/{name}`.
#[derive(Debug, Clone, Args)]
pub struct FiguresArgs {
    /// The study, by id or by name; or an analysis, by id.
    pub study: String,
    /// The folder that the files are written to; it is made where it is not there, and files of these names are
    /// replaced.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Database file.
    #[arg(long, value_name = "FILE", default_value = "volition.db", env = "VOLITION_DATABASE")]
    pub database: PathBuf,
    /// The form of the files: svg, png, csv or json.
    #[arg(long, value_name = "NAME", default_value = "svg")]
    pub format: String,
    /// How they are dressed: light, dark or paper.
    #[arg(long, value_name = "NAME", default_value = "paper")]
    pub theme: String,
    /// Their width in pixels, 96 an inch: 320 are 85 mm, 680 are 180 mm.
    #[arg(long, value_name = "PIXELS", default_value = "680")]
    pub width: String,
    /// How the controllers shown were estimated: ssid, ssid_refined, two_stimulus or prediction_error.
    #[arg(long, value_name = "NAME", default_value = "ssid")]
    pub estimator: String,
    /// Only the figures that a publication shows: of a study zhang2015_chapter_3 or zhang2015_chapter_5, with each
    /// group's median subject; of an analysis qiu2021, or priess2015_chapter_3, _4 or _5.
    #[arg(long, value_name = "NAME")]
    pub like: Option<String>,
}

/// Draws, writes, and prints the names of the files; says by the exit code whether the request was refused (2).
///
/// # Errors
/// When there is no such database or study, the database fails, or a file cannot be written.
pub async fn figures(args: &FiguresArgs) -> anyhow::Result<ExitCode> {
    if !args.database.exists() {
        bail!("there is no database {}; name it with --database", args.database.display());
    }
    let store = Store::open(Some(&args.database)).await?;
    let outcome = write(args, &store, &mut io::stdout().lock()).await;
    store.close().await;
    outcome
}

/// What figures are of, by id.
enum Source {
    Study(String),
    Analysis(String),
}

impl Source {
    /// The study of this id or name; the analysis of this id where there is no such study.
    async fn find(store: &Store, wanted: &str) -> anyhow::Result<Self> {
        if let Ok(id) = wanted.parse::<AnalysisId>()
            && store.analysis(id).await.is_ok()
        {
            return Ok(Self::Analysis(wanted.to_owned()));
        }
        find_study(store, wanted).await.map(Self::Study)
    }

    /// Where the interface has it.
    fn address(&self) -> String {
        match self {
            Self::Study(id) => format!("/v1/studies/{id}"),
            Self::Analysis(id) => format!("/v1/analyses/{id}"),
        }
    }
}

/// Every figure that a study or an analysis lists.
async fn all(store: &Store, source: &Source) -> anyhow::Result<Vec<Asked>> {
    let Answer::Body(list) = ask(store, &format!("{}/figures", source.address())).await? else {
        bail!("its figures cannot be listed");
    };
    let list: Value = serde_json::from_slice(&list).context("the list of figures cannot be read")?;
    let one = |figure: &Value| {
        let [file, link] = ["name", "link"].map(|key| figure[key].as_str().map(str::to_owned));
        Some(Asked { file: file?, link: link? })
    };
    let found = list["figures"].as_array().into_iter().flatten().map(one);
    found.collect::<Option<Vec<_>>>().context("the list of figures cannot be read")
}

async fn write(args: &FiguresArgs, store: &Store, out: &mut impl Write) -> anyhow::Result<ExitCode> {
    let source = Source::find(store, &args.study).await?;
    let asked = match &args.like {
        Some(name) => like::figures(store, &source, name, &args.estimator).await?,
        None => all(store, &source).await?,
    };
    let query: Vec<String> =
        [("format", &args.format), ("theme", &args.theme), ("w", &args.width), ("estimator", &args.estimator)]
            .into_iter()
            .map(|(name, value)| format!("{name}={}", super::encoded(value)))
            .collect();
    std::fs::create_dir_all(&args.out).with_context(|| format!("{} cannot be made", args.out.display()))?;
    for Asked { file, link } in asked {
        // Of one trial or one study, whichever the figure is about: what a trial's figure does not know is not asked.
        let own = query.iter().filter(|own| link.starts_with("/v1/studies/") || !own.starts_with("estimator="));
        let joint = if link.contains('?') { "&" } else { "?" };
        let address = format!("{link}{joint}{}", own.cloned().collect::<Vec<_>>().join("&"));
        let body = match ask(store, &address).await? {
            Answer::Body(body) => body,
            Answer::Problem(body) => {
                let mut err = io::stderr().lock();
                err.write_all(&body)?;
                writeln!(err)?;
                return Ok(ExitCode::from(REFUSED));
            }
        };
        let file = args.out.join(format!("{file}.{}", args.format));
        std::fs::write(&file, body).with_context(|| format!("{} cannot be written", file.display()))?;
        writeln!(out, "{}", file.display())?;
    }
    Ok(ExitCode::SUCCESS)
}
