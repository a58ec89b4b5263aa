//! What every handler shares.

use super::telemetry::HttpTelemetry;
use crate::cache::CacheCounters;
use crate::store::Store;
use axum::http::HeaderValue;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{Mutex, Semaphore};
use tokio_util::sync::CancellationToken;

/// How much one request may ask of the server.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Bytes of a request body as it comes over the wire.
    pub max_body_bytes: usize,
    /// Bytes that a compressed body, or all compressed files of one upload, may unpack to.
    pub max_decompressed_bytes: u64,
    /// Rows (samples) of one trial.
    pub max_rows: usize,
    /// Files in one multipart upload.
    pub max_multipart_files: usize,
    /// Analyses that one bulk request may queue.
    pub max_bulk_analyses: usize,
    /// Bytes read from a client that keeps sending after it was answered, before the connection is closed.
    pub max_drained_bytes: u64,
    /// How long such a client is read for.
    pub max_drain_time: Duration,
    /// How long a client may pause within a body.
    pub body_stall: Duration,
    /// How long an answer waits at most for an analysis (`Prefer: wait`).
    pub max_wait: Duration,
    /// How long a request may take in all; event streams excepted.
    pub request_timeout: Duration,
    /// Bytes that the JSON of one request may take in memory once it is read.
    pub max_json_memory_bytes: u64,
    /// The same of all requests together; others wait.
    pub json_memory_bytes: u64,
    /// Bytes of large JSON bodies that are held at the same time; others wait before they are read.
    pub json_bodies_bytes: u64,
    /// Uploads that are read and parsed at the same time; others wait. Bounds the memory taken.
    pub concurrent_uploads: usize,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            max_body_bytes: 64 << 20,
            max_decompressed_bytes: 512 << 20,
            max_rows: 2_000_000,
            max_multipart_files: 500,
            max_bulk_analyses: 20_000,
            max_drained_bytes: 2 << 30,
            max_drain_time: Duration::from_secs(30),
            body_stall: Duration::from_secs(30),
            max_wait: Duration::from_secs(60),
            request_timeout: Duration::from_secs(120),
            max_json_memory_bytes: 512 << 20,
            json_memory_bytes: 640 << 20,
            json_bodies_bytes: 256 << 20,
            concurrent_uploads: 3,
        }
    }
}

/// Memory is lent in pieces of so many bytes.
pub(super) const ROOM_UNIT: u64 = 64 << 10;

fn room(bytes: u64) -> Arc<Semaphore> {
    Arc::new(Semaphore::new(usize::try_from(bytes.div_ceil(ROOM_UNIT)).unwrap_or(Semaphore::MAX_PERMITS)))
}

/// Figures that are drawn at the same time; others wait. A picture for print takes some 50 MB.
const FIGURES_AT_ONCE: usize = 2;

/// What every handler shares; cheap to clone.
#[derive(Debug, Clone)]
pub struct AppState {
    /// Where everything is kept.
    pub store: Store,
    /// How much one request may ask.
    pub limits: Limits,
    /// Cancelled when the server begins to drain: event streams end, so that connections can close.
    pub shutdown: CancellationToken,
    pub(super) uploads: Arc<Semaphore>,
    /// Large JSON bodies, and what they become, in [`ROOM_UNIT`]s.
    pub(super) json_bodies: Arc<Semaphore>,
    pub(super) json_memory: Arc<Semaphore>,
    /// Held while a figure is drawn.
    pub(super) figures: Arc<Semaphore>,
    /// Held while free numbers are looked up and taken, so that uploads at the same time do not chase one another.
    pub(super) numbering: Arc<Mutex<()>>,
    pub(super) telemetry: Arc<HttpTelemetry>,
    /// Origins whose pages may read the answers, as browsers write them.
    pub(super) origins: Arc<[HeaderValue]>,
    /// How often the analyses of this process needed what they share, for the metrics.
    pub(super) cache: Arc<CacheCounters>,
}

impl AppState {
    /// State over a store, with default limits.
    #[must_use]
    pub fn new(store: Store) -> Self {
        Self {
            store,
            limits: Limits::default(),
            shutdown: CancellationToken::new(),
            uploads: Arc::new(Semaphore::new(Limits::default().concurrent_uploads)),
            json_bodies: room(Limits::default().json_bodies_bytes),
            json_memory: room(Limits::default().json_memory_bytes),
            figures: Arc::new(Semaphore::new(FIGURES_AT_ONCE)),
            numbering: Arc::default(),
            telemetry: Arc::default(),
            origins: Arc::default(),
            cache: Arc::default(),
        }
    }

    /// With other limits.
    #[must_use]
    pub fn with_limits(mut self, limits: Limits) -> Self {
        self.limits = limits;
        self.uploads = Arc::new(Semaphore::new(limits.concurrent_uploads.max(1)));
        // Whatever one request may take, there is room for one.
        self.json_bodies = room(limits.json_bodies_bytes.max(limits.max_body_bytes as u64));
        self.json_memory = room(limits.json_memory_bytes.max(limits.max_json_memory_bytes));
        self
    }

    /// With what counts how often the analyses of this process need what they share.
    #[must_use]
    pub fn with_cache(mut self, cache: Arc<CacheCounters>) -> Self {
        self.cache = cache;
        self
    }

    /// With origins whose pages may read the answers; none may by default.
    #[must_use]
    pub fn with_origins(mut self, origins: Vec<HeaderValue>) -> Self {
        self.origins = origins.into();
        self
    }

    /// With a token that says when the server drains.
    #[must_use]
    pub fn with_shutdown(mut self, shutdown: CancellationToken) -> Self {
        self.shutdown = shutdown;
        self
    }
}
