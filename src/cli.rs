//! The command line.

use crate::app;
use crate::config::{BackupArgs, CacheArgs, DatabaseArgs, ServeArgs, VerifyArgs, WorkerArgs};
use crate::telemetry::{self, LogFormat};
use clap::{CommandFactory as _, Parser, Subcommand};
use clap_complete::Shell;
use std::io::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;

/// What every command's exit code says.
const EXIT_CODES: &str = "Exit codes: 0 it is done; 1 it was tried and failed, or something is damaged; 2 what was \
                          asked for makes no sense; 130 it was interrupted.";

/// Which control law, and which intent, produced this human motion?
#[derive(Debug, Parser)]
#[command(name = "volition", version, about, max_term_width = 110, after_help = EXIT_CODES)]
struct Cli {
    /// How log lines are written to standard error.
    #[arg(long, global = true, value_enum, default_value = "text", env = "VOLITION_LOG_FORMAT")]
    log_format: LogFormat,
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Serve the API, with an embedded database and worker.
    Serve {
        #[command(flatten)]
        serve: ServeArgs,
        #[command(flatten)]
        database: DatabaseArgs,
        #[command(flatten)]
        worker: WorkerArgs,
        #[command(flatten)]
        cache: CacheArgs,
    },
    /// Compute queued analyses of a database that a server (or nobody) serves.
    Worker {
        #[command(flatten)]
        database: DatabaseArgs,
        #[command(flatten)]
        worker: WorkerArgs,
        #[command(flatten)]
        cache: CacheArgs,
        /// Stop when nothing is queued or running any more.
        #[arg(long)]
        until_idle: bool,
    },
    /// Make the database, or bring its schema up to date.
    Migrate {
        #[command(flatten)]
        database: DatabaseArgs,
    },
    /// Copy the database into a folder while it is used, check the copy, and write a manifest beside it.
    ///
    /// Exits with 0, or 1 where no copy was made or rows were damaged already.
    Backup {
        #[command(flatten)]
        backup: BackupArgs,
        #[command(flatten)]
        database: DatabaseArgs,
    },
    /// Look a database or a backup over: its pages, its references, every hash in it, and its manifest if it has one.
    ///
    /// Exits with 0 where everything is in order, 1 where something is damaged, each row with a line.
    Verify(VerifyArgs),
    /// Write the OpenAPI document to standard output.
    Openapi,
    /// Simulate people with one stimulus and with two, estimate every trial in several ways, and print the estimates
    /// beside the truth.
    Demo(app::demo::DemoArgs),
    /// Compare the groups of a study: change with practice and difference between groups, with intervals and exact
    /// tests.
    ///
    /// Exits with 0, or 2 for a request that makes no sense.
    Compare(app::compare::CompareArgs),
    /// Write a study as one tidy table (a row for each trial and analysis), or its learning curves, frequency responses
    /// or comparison as tables.
    ///
    /// Exits with 0, or 2 for a request that makes no sense.
    Table(app::table::TableArgs),
    /// Draw the figures of a study: the learning curve of every quantity, as files.
    ///
    /// Exits with 0, or 2 for a request that makes no sense.
    Figures(app::figures::FiguresArgs),
    /// Look at a recording before it is imported: what it is taken for, its samples, gaps and doubts, and the command
    /// that imports it.
    ///
    /// Exits with 0, or 2 for a file that is refused.
    Check(app::check::CheckArgs),
    /// Write a study into one file with the hash of everything in it, or its recordings as a folder of Motion-BIDS.
    Export(app::bundle::ExportArgs),
    /// Import a folder of recordings with an index, or a study that was exported.
    ///
    /// Exits with 0, or 2 where something was refused.
    Import(app::import::ImportArgs),
    /// Execute one analysis from a file, without a server: a summary at a terminal, the report as JSON in a pipe,
    /// problems on standard error.
    ///
    /// Exits with 0 for a report, 1 for an analysis that failed, 2 for bad input, 130 where it was interrupted.
    Run(app::run::RunArgs),
    /// Write completions for a shell to standard output.
    Completions {
        /// The shell.
        #[arg(value_enum)]
        shell: Shell,
    },
    /// Write pages for `man` into a folder.
    Man {
        /// The folder; made if it does not exist.
        folder: PathBuf,
    },
}

/// Parses the command line and does what it says.
#[must_use]
pub fn run() -> ExitCode {
    let cli = Cli::parse();
    let level = if matches!(cli.command, Command::Serve { .. } | Command::Worker { .. }) { "info" } else { "warn" };
    telemetry::start(cli.log_format, level);
    for name in unknown_settings(std::env::vars_os().filter_map(|(name, _)| name.into_string().ok())) {
        tracing::warn!("{name} is no setting of volition and changes nothing; `volition help COMMAND` names those");
    }
    match execute(cli.command) {
        Ok(code) => code,
        Err(error) => {
            // Standard error may be gone; there is nobody left to tell.
            let _ = writeln!(std::io::stderr(), "volition: {error:#}");
            app::exit::code_of(&error)
        }
    }
}

/// Variables that look like settings and are none: a misspelt one would change nothing, in silence.
fn unknown_settings(names: impl Iterator<Item = String>) -> Vec<String> {
    fn collect(command: &clap::Command, known: &mut Vec<String>) {
        known.extend(command.get_arguments().filter_map(|argument| argument.get_env()?.to_str().map(str::to_owned)));
        command.get_subcommands().for_each(|own| collect(own, known));
    }
    let mut known = vec!["VOLITION_LOG".to_owned()];
    collect(&Cli::command(), &mut known);
    names.filter(|name| name.starts_with("VOLITION_") && !known.contains(name)).collect()
}

fn execute(command: Command) -> anyhow::Result<ExitCode> {
    match command {
        Command::Serve { serve, database, worker, cache } => {
            app::block_on(app::serve::serve(&serve, &database, &worker, &cache)).map(|()| ExitCode::SUCCESS)
        }
        Command::Worker { database, worker, cache, until_idle } => {
            app::block_on(app::serve::work(&database, &worker, &cache, until_idle)).map(|()| ExitCode::SUCCESS)
        }
        Command::Migrate { database } => app::block_on(app::serve::migrate(&database)).map(|()| ExitCode::SUCCESS),
        Command::Backup { backup, database } => app::block_on(app::backup::backup(&database, &backup)),
        Command::Verify(args) => app::block_on(app::backup::verify(&args)),
        Command::Openapi => {
            let mut out = std::io::stdout().lock();
            writeln!(out, "{}", crate::api::document())?;
            Ok(ExitCode::SUCCESS)
        }
        Command::Demo(args) => app::block_on(app::demo::demo(&args)),
        Command::Compare(args) => app::block_on(app::compare::compare(&args)),
        Command::Table(args) => app::block_on(app::table::table(&args)),
        Command::Figures(args) => app::block_on(app::figures::figures(&args)),
        Command::Check(args) => app::check::check(&args),
        Command::Export(args) => app::block_on(app::bundle::export(&args)),
        Command::Import(args) => app::block_on(app::import::import(&args)),
        Command::Run(args) => app::run::run(&args),
        Command::Completions { shell } => {
            app::manual::completions(&mut Cli::command(), shell, &mut std::io::stdout().lock())?;
            Ok(ExitCode::SUCCESS)
        }
        Command::Man { folder } => {
            let pages = app::manual::pages(Cli::command(), &folder)?;
            writeln!(std::io::stdout(), "{pages} pages in {}", folder.display())?;
            Ok(ExitCode::SUCCESS)
        }
    }
}
