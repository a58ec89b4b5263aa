//! `volition check FILE`: what a file is taken for, what is doubtful about it, and how to import it.

use super::import::model;
use super::recordings::{self, ReadingArgs};
use crate::analysis::{Problem, Warning};
use crate::exchange::{Reading, TimeUnit, Understood, options};
use crate::learning::recording::{doubts, explained_output};
use crate::trial::{Channel, Trial};
use clap::Args;
use serde::Serialize;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// The file is no recording.
const REFUSED: u8 = 2;

/// Sample times, in seconds, that a unit of time may lead to.
const PLAUSIBLE_S: std::ops::RangeInclusive<f64> = 2e-4..=0.2;

/// What to look at.
#[derive(Debug, Clone, Args)]
pub struct CheckArgs {
    /// A recording in any format that is read.
    pub file: PathBuf,
    /// What the files do not say themselves.
    #[command(flatten)]
    pub reading: ReadingArgs,
    /// The plant that it was recorded on, to hold y against G u: a JSON file, a name of the catalogue, or a transfer
    /// function such as 1/(s(s+1)).
    #[arg(long, value_name = "MODEL")]
    pub plant: Option<String>,
    /// Write JSON.
    #[arg(long)]
    pub json: bool,
}

/// A signal in numbers.
#[derive(Serialize)]
struct Range {
    signal: &'static str,
    least: f64,
    largest: f64,
    is_constant: bool,
}

/// What is said of a file.
#[derive(Serialize)]
struct Findings {
    understood: Understood,
    ignored_columns: Vec<String>,
    samples: usize,
    sample_time_s: f64,
    duration_s: f64,
    signals: Vec<Range>,
    /// The share of y that the plant explains with u, from the best initial state.
    explained_output: Option<f64>,
    warnings: Vec<Warning>,
    import: Vec<String>,
}

/// Looks at a file; exits with 2 where it is refused.
///
/// # Errors
/// When the plant is none, or standard output cannot be written.
pub fn check(args: &CheckArgs) -> anyhow::Result<ExitCode> {
    let plant = args.plant.as_deref().map(model).transpose()?;
    let reading = match recordings::read(&args.file, &args.reading.options()) {
        Ok(reading) => reading,
        Err(problem) => return refuse(args, &problem),
    };
    let Reading { trial, understood, ignored_columns, mut warnings, .. } = reading;
    let doubts = doubts(&trial, plant.as_ref());
    warnings.extend(doubts.into_iter().map(|doubt| Warning::new(doubt.code, doubt.message)));
    let findings = Findings {
        understood,
        ignored_columns,
        samples: trial.samples(),
        sample_time_s: trial.sample_time_s,
        duration_s: trial.sample_time_s * trial.samples() as f64,
        signals: ranges(&trial),
        explained_output: plant.as_ref().and_then(|plant| explained_output(&trial, plant)),
        warnings,
        import: import(args),
    };
    let mut out = std::io::stdout().lock();
    if args.json {
        serde_json::to_writer_pretty(&mut out, &findings)?;
        writeln!(out)?;
    } else {
        print(&mut out, &args.file, &trial, &findings)?;
    }
    Ok(ExitCode::SUCCESS)
}

fn refuse(args: &CheckArgs, problem: &Problem) -> anyhow::Result<ExitCode> {
    let mut err = std::io::stderr().lock();
    if args.json {
        serde_json::to_writer_pretty(&mut err, problem)?;
        writeln!(err)?;
    } else {
        writeln!(err, "{}: {}: {}", args.file.display(), problem.title, problem.detail)?;
        if let Some(place) = &problem.location {
            writeln!(err, "  at: {place}")?;
        }
        if let Some(mend) = &problem.mend {
            writeln!(err, "  next: {}", as_flags(mend))?;
        }
    }
    Ok(ExitCode::from(REFUSED))
}

/// Parameters as the flags of a command.
fn as_flags(text: &str) -> String {
    let mut text = text.to_owned();
    for (parameter, flag) in [
        ("columns=", "--columns "),
        ("time_unit=", "--time-unit "),
        ("sample_time_s=", "--sample-time "),
        ("resample=", "--resample "),
        ("sample_time_s", "--sample-time"),
    ] {
        text = text.replace(parameter, flag);
    }
    text
}

fn ranges(trial: &Trial) -> Vec<Range> {
    let channels = Channel::ALL.into_iter().filter(|channel| *channel != Channel::Time);
    let of = |channel: Channel| {
        let values = trial.signals.channel(channel)?;
        let least = values.iter().copied().fold(f64::INFINITY, f64::min);
        let largest = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        Some(Range { signal: channel.letter(), least, largest, is_constant: least == largest })
    };
    channels.filter_map(of).collect()
}

/// The commands that import the file.
fn import(args: &CheckArgs) -> Vec<String> {
    let folder = args.file.parent().filter(|folder| *folder != Path::new("")).unwrap_or(Path::new("."));
    let name = args.file.file_name().unwrap_or_default().to_string_lossy();
    let plant = args.plant.as_deref().unwrap_or("PLANT");
    let index = format!(
        "printf '{}\\n{},s01,1\\n' > {}",
        "file,subject,trial",
        name.replace('%', "%%"),
        quoted(&folder.join("index.csv").display().to_string())
    );
    let mut import =
        format!("volition import {} --study STUDY --plant {}", quoted(&folder.display().to_string()), quoted(plant));
    let ReadingArgs { columns, time_unit, sample_time, resample } = &args.reading;
    if let Some(columns) = columns {
        import.push_str(&format!(" --columns {}", quoted(&options::written(columns))));
    }
    if let Some(unit) = time_unit {
        import.push_str(&format!(" --time-unit {}", unit.name()));
    }
    if let Some(seconds) = sample_time {
        import.push_str(&format!(" --sample-time {seconds}"));
    }
    if resample.is_some() {
        import.push_str(" --resample linear");
    }
    vec![index, import]
}

/// For a shell.
fn quoted(text: &str) -> String {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "._-/:,".contains(c);
    if !text.is_empty() && text.chars().all(is_plain) {
        text.to_owned()
    } else {
        format!("'{}'", text.replace('\'', "'\\''"))
    }
}

fn print(out: &mut impl Write, file: &Path, trial: &Trial, findings: &Findings) -> std::io::Result<()> {
    writeln!(out, "{}", file.display())?;
    for sentence in &findings.understood.words {
        writeln!(out, "  {sentence}")?;
    }
    let Findings { samples, sample_time_s, duration_s, .. } = findings;
    writeln!(out, "  {samples} samples, {sample_time_s} s apart: {duration_s} s, without a gap")?;
    for Range { signal, least, largest, is_constant } in &findings.signals {
        if *is_constant {
            writeln!(out, "  {signal} is {least} throughout")?;
        } else {
            writeln!(out, "  {signal} from {least} to {largest}")?;
        }
    }
    if let Some(explained) = findings.explained_output {
        writeln!(out, "  G u explains {:.2} % of y", 100.0 * explained.max(0.0))?;
    }
    for warning in &findings.warnings {
        writeln!(out, "  warning: {} ({})", warning.message, warning.code)?;
    }
    if findings.warnings.iter().any(|warning| warning.code == "implausible_sample_time") {
        for (unit, step_s) in units(trial) {
            writeln!(out, "  if time counts {0}: --time-unit {0} ({step_s} s apart)", unit.name())?;
        }
        if trial.signals.time_s.is_some() && trial.sample_time_s == 1.0 {
            writeln!(out, "  if it counts samples: --time-unit samples --sample-time SECONDS")?;
        }
    }
    writeln!(out, "  to import it:")?;
    for command in &findings.import {
        writeln!(out, "    {command}")?;
    }
    Ok(())
}

/// Units of time with which a recording would be one of a person.
fn units(trial: &Trial) -> Vec<(TimeUnit, f64)> {
    if trial.signals.time_s.is_none() {
        return Vec::new();
    }
    let units = [TimeUnit::Milliseconds, TimeUnit::Microseconds, TimeUnit::Nanoseconds].into_iter();
    let step = |unit: TimeUnit| Some((unit, trial.sample_time_s / unit.per_second()?));
    units.filter_map(step).filter(|(_, step_s)| PLAUSIBLE_S.contains(step_s)).collect()
}
