//! Settings as given (flags, or environment variables of the same names) and their checks.

use crate::api::Limits;
use crate::worker::{Folder, PoolMemo, WorkerSettings};
use axum::http::{HeaderValue, Uri};
use clap::Args;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Appendix B takes 1 GiB for a plant and its lines.
const CACHE_GIB: f64 = 8.0;

/// Where the database is.
#[derive(Debug, Clone, Args)]
pub struct DatabaseArgs {
    /// Database file; made if it does not exist.
    #[arg(long, value_name = "FILE", default_value = "volition.db", env = "VOLITION_DATABASE")]
    pub database: PathBuf,
    /// Room kept beside the database for a full disk, in MiB: given away then, so that deleting and cancelling still
    /// work. 0: none.
    #[arg(long, value_name = "MIB", default_value_t = 4, env = "VOLITION_RESERVE_MIB")]
    pub reserve_mib: u16,
}

/// Where and when a server makes backups.
#[derive(Debug, Clone, Args)]
pub struct BackupSchedule {
    /// Folder for backups, made while the server runs; none are made without one.
    #[arg(long, value_name = "FOLDER", env = "VOLITION_BACKUP_FOLDER")]
    pub backup_folder: Option<PathBuf>,
    /// Hours between backups.
    #[arg(long, value_name = "HOURS", default_value_t = 24.0, value_parser = hours, env = "VOLITION_BACKUP_EVERY_H")]
    pub backup_every_h: f64,
    /// Backups kept; older ones are deleted.
    #[arg(long, value_name = "N", default_value_t = 14, env = "VOLITION_BACKUP_KEEP")]
    pub backup_keep: usize,
}

/// What `volition backup` is asked for.
#[derive(Debug, Clone, Args)]
pub struct BackupArgs {
    /// Folder for the copy and its manifest; made if it does not exist.
    pub folder: PathBuf,
    /// Delete all but the newest N backups in the folder afterwards.
    #[arg(long, value_name = "N")]
    pub keep: Option<usize>,
}

/// What `volition verify` is asked for.
#[derive(Debug, Clone, Args)]
pub struct VerifyArgs {
    /// Database or backup to look over.
    #[arg(value_name = "FILE", default_value = "volition.db", env = "VOLITION_DATABASE")]
    pub file: PathBuf,
    /// Keep the list of damaged rows in the database, where `/metrics` counts them.
    #[arg(long)]
    pub quarantine: bool,
}

/// Where pools and trees, which trials share, wait for the next process.
#[derive(Debug, Clone, Args)]
pub struct CacheArgs {
    /// Folder for pools and trees; made if it does not exist, and may be deleted at any time. By default FILE.cache
    /// where there is a database file, otherwise `volition` in the user's folder for caches.
    #[arg(long, value_name = "FOLDER", env = "VOLITION_CACHE")]
    pub cache: Option<PathBuf>,
    /// Largest size of that folder, in GiB; what was not used for longest goes first. 0: nothing is kept.
    #[arg(long, value_name = "GIB", default_value_t = CACHE_GIB, value_parser = size_gib, env = "VOLITION_CACHE_GIB")]
    pub cache_gib: f64,
}

/// How a worker works.
#[derive(Debug, Clone, Args)]
pub struct WorkerArgs {
    /// Analyses computed at the same time.
    #[arg(long, value_name = "N", default_value_t = 1, env = "VOLITION_CONCURRENCY")]
    pub concurrency: usize,
    /// Compute threads of each analysis; 0 for one on each processor.
    #[arg(long, value_name = "N", default_value_t = 0, env = "VOLITION_COMPUTE_THREADS")]
    pub compute_threads: usize,
    /// Seconds after which a silent worker counts as dead.
    #[arg(long, value_name = "SECONDS", default_value_t = 15.0, env = "VOLITION_LEASE_S")]
    pub lease_s: f64,
    /// Deaths of its worker after which an analysis fails.
    #[arg(long, value_name = "N", default_value_t = 5, env = "VOLITION_MAX_ATTEMPTS")]
    pub max_attempts: u32,
    /// Seconds that running analyses are given to finish when the process is asked to stop.
    #[arg(long, value_name = "SECONDS", default_value_t = 20.0, env = "VOLITION_DRAIN_S")]
    pub drain_s: f64,
    /// Seconds that one analysis may take in all; no limit by default.
    #[arg(long, value_name = "SECONDS", env = "VOLITION_DEADLINE_S")]
    pub deadline_s: Option<f64>,
}

/// Where to listen.
#[derive(Debug, Clone, Args)]
pub struct ListenArgs {
    /// Address and port to listen on, such as 127.0.0.1:9000 or localhost:9000; loopback only.
    #[arg(
        long,
        value_name = "ADDRESS",
        default_value = "127.0.0.1:8080",
        value_parser = address,
        env = "VOLITION_LISTEN"
    )]
    pub listen: SocketAddr,
    /// Port to listen on, in place of the one in --listen; 0 for any that is free.
    #[arg(long, value_name = "PORT", env = "VOLITION_PORT")]
    pub port: Option<u16>,
}

impl ListenArgs {
    /// The address, if it may be served.
    ///
    /// # Errors
    /// [`ConfigError::NotLoopback`] for any address but the machine's own.
    pub fn checked(&self) -> Result<SocketAddr, ConfigError> {
        let mut address = self.listen;
        address.set_port(self.port.unwrap_or(address.port()));
        if address.ip().is_loopback() { Ok(address) } else { Err(ConfigError::NotLoopback(address)) }
    }
}

/// An address with a port; the only name that is known is `localhost`.
fn address(text: &str) -> Result<SocketAddr, String> {
    let written = match text.rsplit_once(':') {
        Some((host, port)) if host.eq_ignore_ascii_case("localhost") => format!("127.0.0.1:{port}"),
        _ => text.to_owned(),
    };
    written.parse().map_err(|_| "give an address with a port, such as 127.0.0.1:9000 or localhost:9000".to_owned())
}

/// How the server serves.
#[derive(Debug, Clone, Args)]
pub struct ServeArgs {
    /// Where to listen.
    #[command(flatten)]
    pub listen: ListenArgs,
    /// Origin whose pages may ask and read, such as http://localhost:3000; may be given several times, or several
    /// separated by commas. None may by default.
    #[arg(long, value_name = "ORIGIN", value_delimiter = ',', env = "VOLITION_ALLOW_ORIGIN")]
    pub allow_origin: Vec<String>,
    /// Largest request body, in MiB.
    #[arg(long, value_name = "MIB", default_value_t = 64, env = "VOLITION_MAX_BODY_MIB")]
    pub max_body_mib: usize,
    /// Largest trial, in rows.
    #[arg(long, value_name = "ROWS", default_value_t = 2_000_000, env = "VOLITION_MAX_ROWS")]
    pub max_rows: usize,
    /// Connections at the same time; others wait to be accepted.
    #[arg(long, value_name = "N", default_value_t = 512, env = "VOLITION_MAX_CONNECTIONS")]
    pub max_connections: usize,
    /// Serve only; leave the analyses to `volition worker` processes.
    #[arg(long, env = "VOLITION_NO_WORKER")]
    pub no_worker: bool,
    /// Backups.
    #[command(flatten)]
    pub backups: BackupSchedule,
}

/// Settings that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// Anybody on the network could read and delete the lab's data.
    #[error(
        "refusing to listen on {0}: there are no access tokens yet, so everybody who reaches that address could read \
         and delete the lab's data. Listen on 127.0.0.1 or [::1] and let others in through an SSH tunnel or a reverse \
         proxy that authenticates them"
    )]
    NotLoopback(SocketAddr),
    /// A browser would never send it as an origin.
    #[error(
        "--allow-origin takes http://HOST or https://HOST, with a port where it has one and nothing behind, not '{0}'"
    )]
    NoOrigin(String),
    /// A limit of zero would refuse everything.
    #[error("{0} must be at least 1")]
    Zero(&'static str),
}

impl Default for CacheArgs {
    fn default() -> Self {
        Self { cache: None, cache_gib: CACHE_GIB }
    }
}

impl CacheArgs {
    /// The pools that analyses share, with a folder to keep them in if there is one: that which was asked for, one
    /// beside the database, or the user's.
    #[must_use]
    pub fn pools(&self, database: Option<&Path>) -> Arc<PoolMemo> {
        let most_bytes = (self.cache_gib * f64::from(1 << 30)) as u64;
        // A variable that is set to nothing asks for nothing.
        let asked = self.cache.clone().filter(|folder| !folder.as_os_str().is_empty());
        let folder = asked.or_else(|| database.map_or_else(of_the_user, |database| Some(beside(database))));
        Arc::new(match folder.filter(|_| most_bytes > 0) {
            Some(folder) => PoolMemo::with_store(Arc::new(Folder::new(folder, most_bytes))),
            None => PoolMemo::default(),
        })
    }
}

/// A time between backups.
fn hours(text: &str) -> Result<f64, String> {
    let hours = text.parse::<f64>().map_err(|error| error.to_string())?;
    if (0.01..=10_000.0).contains(&hours) { Ok(hours) } else { Err("it must be from 0.01 to 10000".to_owned()) }
}

/// A size in GiB.
fn size_gib(text: &str) -> Result<f64, String> {
    let size = text.parse::<f64>().map_err(|error| error.to_string())?;
    if (0.0..=1e6).contains(&size) { Ok(size) } else { Err("it must be from 0 to 1000000".to_owned()) }
}

/// The folder of a database file's own: `lab.db.cache` beside `lab.db`.
fn beside(database: &Path) -> PathBuf {
    let mut name = database.as_os_str().to_owned();
    name.push(".cache");
    PathBuf::from(name)
}

/// `volition` in the folder that the system has for a user's caches; `None` where there is no such user.
fn of_the_user() -> Option<PathBuf> {
    use etcetera::BaseStrategy as _;
    let folders = etcetera::choose_base_strategy().ok()?;
    Some(folders.cache_dir().join("volition"))
}

impl ServeArgs {
    /// The origins whose pages may ask and read, as browsers write them.
    ///
    /// # Errors
    /// [`ConfigError::NoOrigin`] for what no browser would send.
    pub fn origins(&self) -> Result<Vec<HeaderValue>, ConfigError> {
        self.allow_origin.iter().filter(|text| !text.is_empty()).map(|text| origin(text)).collect()
    }

    /// The limits on uploads.
    ///
    /// # Errors
    /// [`ConfigError::Zero`] for a limit of zero.
    pub fn limits(&self) -> Result<Limits, ConfigError> {
        if self.max_body_mib == 0 {
            return Err(ConfigError::Zero("--max-body-mib"));
        }
        if self.max_rows == 0 {
            return Err(ConfigError::Zero("--max-rows"));
        }
        if self.max_connections == 0 {
            return Err(ConfigError::Zero("--max-connections"));
        }
        if self.backups.backup_keep == 0 {
            return Err(ConfigError::Zero("--backup-keep"));
        }
        let max_body_bytes = self.max_body_mib.saturating_mul(1 << 20);
        Ok(Limits {
            max_body_bytes,
            // Numbers written as text compress to about an eighth; more than that is a bomb.
            max_decompressed_bytes: max_body_bytes.saturating_mul(8) as u64,
            max_rows: self.max_rows,
            ..Limits::default()
        })
    }
}

/// `scheme://host` or `scheme://host:port`, in lower case as browsers send it.
fn origin(text: &str) -> Result<HeaderValue, ConfigError> {
    let bad = || ConfigError::NoOrigin(text.to_owned());
    let uri: Uri = text.parse().map_err(|_| bad())?;
    let (scheme, authority) = (uri.scheme_str().ok_or_else(bad)?, uri.authority().ok_or_else(bad)?);
    let written = format!("{scheme}://{authority}").to_ascii_lowercase();
    if !matches!(scheme, "http" | "https") || authority.as_str().contains('@') || text.to_ascii_lowercase() != written {
        return Err(bad());
    }
    HeaderValue::from_str(&written).map_err(|_| bad())
}

impl WorkerArgs {
    /// The settings; [`crate::worker::Worker::new`] checks them.
    #[must_use]
    pub fn settings(&self) -> WorkerSettings {
        WorkerSettings {
            concurrency: self.concurrency,
            compute_threads: self.compute_threads,
            lease_s: self.lease_s,
            // A worker must miss several signs of life before it counts as dead.
            heartbeat_s: self.lease_s / 5.0,
            max_attempts: self.max_attempts,
            drain_s: self.drain_s,
            deadline_s: self.deadline_s,
            ..WorkerSettings::default()
        }
    }
}
