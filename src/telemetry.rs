//! Logs: to standard error, as text for people or JSON lines for machines.
//!
//! Field names are fixed: `analysis`, `study`, `trial` (ids), `attempt`, `worker`, `elapsed_s`, `status`, `method`,
//! `path`, `request_id`, `file`, `folder`, `bytes`. Signals, subject codes and attributes are never logged.

use std::io::IsTerminal as _;
use tracing_subscriber::filter::Targets;
use tracing_subscriber::layer::SubscriberExt as _;
use tracing_subscriber::util::SubscriberInitExt as _;

/// How log lines are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum LogFormat {
    /// For people.
    Text,
    /// One JSON object a line.
    Json,
}

/// Starts logging for the process. `VOLITION_LOG` chooses what is logged: a level, or levels by target
/// (`info,volition::api=debug`).
pub fn start(format: LogFormat, default_level: &str) {
    let asked = std::env::var("VOLITION_LOG").ok();
    let read = asked.as_deref().map(str::parse::<Targets>);
    let unreadable = matches!(&read, Some(Err(_)));
    let filter = read.and_then(Result::ok).unwrap_or_else(|| default_level.parse().unwrap_or_default());
    let registry = tracing_subscriber::registry().with(filter);
    // Colours are for people: a log file has none, nor a terminal whose owner wants none (https://no-color.org).
    let colours = std::io::stderr().is_terminal() && std::env::var_os("NO_COLOR").is_none_or(|no| no.is_empty());
    let started = match format {
        LogFormat::Text => {
            let text = tracing_subscriber::fmt::layer().with_ansi(colours).with_writer(std::io::stderr);
            registry.with(text).try_init()
        }
        LogFormat::Json => {
            registry.with(tracing_subscriber::fmt::layer().json().with_writer(std::io::stderr)).try_init()
        }
    };
    // A second start in one process (tests) keeps the first subscriber.
    drop(started);
    if unreadable {
        tracing::warn!("VOLITION_LOG is no filter and is passed over; write a level, or levels by target");
    }
}
