//! `volition serve`, `worker` and `migrate`: the parts put together.

use super::backup;
use super::exit::INTERRUPTED;
use crate::api::{self, AppState, Connections, Limits};
use crate::config::{BackupSchedule, CacheArgs, DatabaseArgs, ServeArgs, WorkerArgs};
use crate::jobs::Status;
use crate::pages;
use crate::store::{Store, StoreResult};
use crate::worker::{Analyses, Worker, WorkerSettings};
use anyhow::Context as _;
use axum::http::HeaderValue;
use std::io::Write as _;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;

/// How long open connections are given to finish their requests at shutdown.
const CONNECTIONS_DRAIN: Duration = Duration::from_secs(10);

/// Pause between looks at the queue of a worker that stops when it is idle.
const IDLE_POLL: Duration = Duration::from_millis(200);

/// Serves pages and API until SIGINT or SIGTERM, then finishes requests and drains the worker.
///
/// # Errors
/// Settings that cannot be used, a database that cannot be opened, an address that cannot be listened on.
pub async fn serve(
    serve: &ServeArgs,
    database: &DatabaseArgs,
    worker: &WorkerArgs,
    cache: &CacheArgs,
) -> anyhow::Result<()> {
    let served = Served {
        address: serve.listen.checked()?,
        origins: serve.origins()?,
        limits: serve.limits()?,
        worker: (!serve.no_worker).then(|| worker.settings()),
        place: "/".to_owned(),
        max_connections: serve.max_connections,
        backups: Some(serve.backups.clone()),
    };
    run(served, database, cache).await
}

/// What is served, and how.
pub(crate) struct Served {
    /// Where it listens; on the loopback interface.
    pub(crate) address: SocketAddr,
    /// What a request may ask.
    pub(crate) limits: Limits,
    /// The worker inside; `None` for none.
    pub(crate) worker: Option<WorkerSettings>,
    /// Origins whose pages may read the answers.
    pub(crate) origins: Vec<HeaderValue>,
    /// The page that is named to whoever started it.
    pub(crate) place: String,
    /// Connections at the same time.
    pub(crate) max_connections: usize,
    /// Copies that are made of the database; none of one that is gone afterwards.
    pub(crate) backups: Option<BackupSchedule>,
}

/// Serves a database until SIGINT or SIGTERM.
pub(crate) async fn run(served: Served, database: &DatabaseArgs, cache: &CacheArgs) -> anyhow::Result<()> {
    let Served { address, limits, origins, worker, place, max_connections, backups } = served;
    let store = open(database).await?;
    let pools = cache.pools(Some(&database.database));
    let embedded = worker.is_some();
    let analyses = Arc::new(Analyses::new(Arc::clone(&pools)));
    let worker = Worker::new(store.clone(), analyses, worker.unwrap_or_default())?;
    let listener = TcpListener::bind(address).await.with_context(|| format!("cannot listen on {address}"))?;
    let address = listener.local_addr()?;

    let shutdown = stop_on_signal()?;
    let state =
        AppState::new(store.clone()).with_limits(limits).with_cache(pools.counters()).with_shutdown(shutdown.clone());
    let state = state.with_origins(origins);
    let listening = shutdown.clone();
    let connections = Connections { at_once: max_connections, ..Connections::default() };
    let server = tokio::spawn(api::serve(listener, pages::router(state), connections, listening));
    // Scripts wait for the first line and read the port from it; both go out at once, since they may read no more.
    let said = format!("volition listens on http://{address}\nTo look at in a browser: http://{address}{place}\n");
    std::io::stdout().write_all(said.as_bytes())?;
    tracing::info!(%address, database = %database.database.display(), "serving");

    let working = shutdown.clone();
    let work = async {
        if embedded {
            worker.run(working).await;
        } else {
            working.cancelled().await;
        }
    };
    let looking_after = async {
        let copies = async {
            if let Some(backups) = &backups {
                backup::on_schedule(&store, backups, &shutdown).await;
            }
        };
        tokio::join!(copies, backup::upkeep(&store, &shutdown));
    };
    let requests = async {
        shutdown.cancelled().await;
        tokio::time::timeout(CONNECTIONS_DRAIN, server).await
    };
    let (requests, (), ()) = tokio::join!(requests, work, looking_after);
    if requests.is_err() {
        tracing::warn!(waited_s = CONNECTIONS_DRAIN.as_secs(), "some connections did not close in time");
    }
    store.close().await;
    Ok(())
}

/// Works on a database that another process serves, until SIGINT or SIGTERM, or until nothing is left to do.
///
/// # Errors
/// Settings that cannot be used, or a database that cannot be opened.
pub async fn work(
    database: &DatabaseArgs,
    worker: &WorkerArgs,
    cache: &CacheArgs,
    until_idle: bool,
) -> anyhow::Result<()> {
    let store = open(database).await?;
    let pools = cache.pools(Some(&database.database));
    let worker = Worker::new(store.clone(), Arc::new(Analyses::new(pools)), worker.settings())?;
    let shutdown = stop_on_signal()?;
    let idle = async {
        while until_idle && !shutdown.is_cancelled() {
            if is_idle(&store).await? {
                shutdown.cancel();
            }
            tokio::time::sleep(IDLE_POLL).await;
        }
        StoreResult::Ok(())
    };
    let (idle, _) = tokio::join!(idle, worker.run(shutdown.clone()));
    store.close().await;
    idle.context("the queue could not be looked at")
}

/// Makes the database or brings its schema up to date.
///
/// # Errors
/// A database that cannot be opened or migrated.
pub async fn migrate(database: &DatabaseArgs) -> anyhow::Result<()> {
    let store = open(database).await?;
    store.close().await;
    writeln!(std::io::stdout(), "{} is up to date", database.database.display())?;
    Ok(())
}

async fn open(database: &DatabaseArgs) -> anyhow::Result<Store> {
    let path = &database.database;
    let store =
        Store::open(Some(path)).await.with_context(|| format!("cannot open the database {}", path.display()))?;
    match store.keep_reserve(u64::from(database.reserve_mib) << 20).await {
        Ok(()) => {}
        // Served all the same: people can read, and it is made as soon as there is room.
        Err(error) => tracing::error!(%error, "no room can be kept for a full disk"),
    }
    Ok(store)
}

async fn is_idle(store: &Store) -> StoreResult<bool> {
    let counts = store.count_by_status().await?;
    Ok(counts.iter().all(|(status, count)| *count == 0 || !matches!(status, Status::Queued | Status::Running)))
}

/// Cancelled by the first SIGINT or SIGTERM. The second ends the process at once; leases take care of its work.
fn stop_on_signal() -> std::io::Result<CancellationToken> {
    let token = CancellationToken::new();
    let cancelled = token.clone();
    // Listened to from here on, and not only once the task has begun.
    let mut signals = Signals::new()?;
    tokio::spawn(async move {
        signals.next().await;
        tracing::info!("stopping; once more stops at once");
        cancelled.cancel();
        signals.next().await;
        tracing::warn!("stopped at once; analyses under way are rescued when their leases run out");
        std::process::exit(i32::from(INTERRUPTED));
    });
    Ok(token)
}

/// The signals by which a person or a system asks the process to stop.
#[cfg(unix)]
struct Signals {
    interrupt: tokio::signal::unix::Signal,
    terminate: tokio::signal::unix::Signal,
}

#[cfg(unix)]
impl Signals {
    fn new() -> std::io::Result<Self> {
        use tokio::signal::unix::{SignalKind, signal};
        Ok(Self { interrupt: signal(SignalKind::interrupt())?, terminate: signal(SignalKind::terminate())? })
    }

    async fn next(&mut self) {
        tokio::select! {
            _ = self.interrupt.recv() => {}
            _ = self.terminate.recv() => {}
        }
    }
}

/// The signals by which a person asks the process to stop.
#[cfg(not(unix))]
struct Signals;

#[cfg(not(unix))]
impl Signals {
    fn new() -> std::io::Result<Self> {
        Ok(Self)
    }

    async fn next(&mut self) {
        if tokio::signal::ctrl_c().await.is_err() {
            std::future::pending::<()>().await;
        }
    }
}
