//! `volition backup` and `verify`, and what a server does on a schedule.

use crate::config::{BackupArgs, BackupSchedule, DatabaseArgs, VerifyArgs};
use crate::store::{Manifest, Store, StoreResult, Verified, verify_file};
use anyhow::Context as _;
use std::io::Write as _;
use std::path::Path;
use std::process::ExitCode;
use std::time::Duration;
use tokio_util::sync::CancellationToken;

/// How often what a database needs from time to time is done.
const UPKEEP_EVERY: Duration = Duration::from_secs(3600);

/// How long idempotency keys are kept.
const KEYS_KEPT: Duration = Duration::from_secs(30 * 24 * 3600);

/// The shortest pause after a backup that failed.
const TRY_AGAIN: Duration = Duration::from_secs(600);

/// Lines about damage that are printed.
const MOST_LINES: usize = 1000;

/// Copies a database while it is used.
///
/// # Errors
/// A database that cannot be opened, a copy that cannot be made or is not in order.
pub async fn backup(database: &DatabaseArgs, args: &BackupArgs) -> anyhow::Result<ExitCode> {
    let path = &database.database;
    anyhow::ensure!(path.exists(), "there is no database {}", path.display());
    let store = Store::open(Some(path)).await.with_context(|| format!("cannot open {}", path.display()))?;
    let made = async {
        let manifest = store.backup(&args.folder).await.context("the backup could not be made")?;
        let gone = match args.keep {
            Some(keep) => {
                Store::retain_backups(&args.folder, keep).await.context("old backups could not be deleted")?
            }
            None => Vec::new(),
        };
        anyhow::Ok((manifest, gone))
    }
    .await;
    store.close().await;
    let (manifest, gone) = made?;
    let mut out = std::io::stdout().lock();
    let file = args.folder.join(&manifest.file);
    writeln!(out, "{}  {} bytes, sha256 {}", file.display(), manifest.bytes, manifest.sha256)?;
    for name in gone {
        writeln!(out, "deleted {name}")?;
    }
    if manifest.damaged.is_empty() {
        return Ok(ExitCode::SUCCESS);
    }
    writeln!(out, "{} rows were damaged in the database already:", manifest.damaged.len())?;
    for line in manifest.damaged.iter().take(MOST_LINES) {
        writeln!(out, "  {line}")?;
    }
    Ok(ExitCode::from(1))
}

/// Looks a database or a backup over and says what is damaged.
///
/// # Errors
/// A file that is no database of this program and step.
pub async fn verify(args: &VerifyArgs) -> anyhow::Result<ExitCode> {
    let file = &args.file;
    anyhow::ensure!(file.exists(), "there is no file {}", file.display());
    let mut out = std::io::stdout().lock();
    let differs = match manifest_of(file)? {
        Some(manifest) => compare(&manifest, file)?,
        None => None,
    };
    if let Some(why) = &differs {
        writeln!(out, "manifest: {why}")?;
    }
    let verified = verify_file(file).await?;
    let Verified { step, rows, pages, references, findings } = &verified;
    let rows: Vec<String> = rows.iter().map(|(table, many)| format!("{many} {table}")).collect();
    writeln!(out, "{}: schema step {step}; {}", file.display(), rows.join(", "))?;
    let lines = pages.iter().map(|why| format!("pages: {why}"));
    let lines = lines.chain(references.iter().map(|why| format!("references: {why}")));
    let lines = lines.chain(findings.iter().map(ToString::to_string));
    for line in lines.take(MOST_LINES) {
        writeln!(out, "{line}")?;
    }
    if args.quarantine {
        let store = Store::open(Some(file)).await?;
        let noted = store.quarantine(findings).await;
        store.close().await;
        noted.context("the list of damaged rows could not be kept")?;
    }
    if verified.is_sound() && differs.is_none() {
        writeln!(out, "everything is in order")?;
        return Ok(ExitCode::SUCCESS);
    }
    Ok(ExitCode::from(1))
}

/// The manifest beside a backup, if there is one.
fn manifest_of(file: &Path) -> anyhow::Result<Option<Manifest>> {
    let mut name = file.as_os_str().to_owned();
    name.push(".json");
    match std::fs::read(&name) {
        Ok(text) => Ok(Some(serde_json::from_slice(&text).context("the manifest beside it cannot be read")?)),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(error).context("the manifest beside it cannot be read"),
    }
}

fn compare(manifest: &Manifest, file: &Path) -> anyhow::Result<Option<String>> {
    let (bytes, sha256) = Manifest::measure(file)?;
    if bytes != manifest.bytes {
        return Ok(Some(format!("the file has {bytes} bytes, not {}", manifest.bytes)));
    }
    Ok((sha256 != manifest.sha256).then(|| format!("the file has the hash {sha256}, not {}", manifest.sha256)))
}

/// Backups on a schedule, until `shutdown`. Periods are told by a clock that nobody sets; only how old the newest
/// backup is at the start is read from its manifest.
pub(super) async fn on_schedule(store: &Store, schedule: &BackupSchedule, shutdown: &CancellationToken) {
    let Some(folder) = &schedule.backup_folder else { return };
    let period = Duration::from_secs_f64(schedule.backup_every_h * 3600.0);
    let mut pause = store.age_of_newest_backup(folder).map_or(Duration::ZERO, |age| period.saturating_sub(age));
    loop {
        tokio::select! {
            () = shutdown.cancelled() => return,
            () = tokio::time::sleep(pause) => {}
        }
        pause = match kept(store, folder, schedule.backup_keep).await {
            Ok(manifest) => {
                tracing::info!(file = manifest.file, bytes = manifest.bytes, "backup made");
                if !manifest.damaged.is_empty() {
                    tracing::error!(rows = manifest.damaged.len(), "rows are damaged; volition verify names them");
                }
                period
            }
            Err(error) => {
                tracing::error!(%error, folder = %folder.display(), "no backup could be made; trying again");
                TRY_AGAIN.min(period)
            }
        };
    }
}

async fn kept(store: &Store, folder: &Path, keep: usize) -> StoreResult<Manifest> {
    let manifest = store.backup(folder).await?;
    for name in Store::retain_backups(folder, keep).await? {
        tracing::info!(file = name, "old backup deleted");
    }
    Ok(manifest)
}

/// Looks after the database until `shutdown`.
pub(super) async fn upkeep(store: &Store, shutdown: &CancellationToken) {
    loop {
        tokio::select! {
            () = shutdown.cancelled() => return,
            () = tokio::time::sleep(UPKEEP_EVERY) => {}
        }
        match store.upkeep(KEYS_KEPT).await {
            Ok(gone) => tracing::debug!(gone, "idempotency keys that were old were deleted"),
            Err(error) => tracing::warn!(%error, "the database could not be looked after; trying again later"),
        }
    }
}
