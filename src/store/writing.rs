//! What every write has in common: it runs to its end whoever goes away meanwhile, on a connection that is in order,
//! and where the disk is full it says so.

use super::blocking::off_runtime;
use super::error::{StoreError, StoreResult, Trouble};
use super::open::Store;
use super::reserve::Kept;
use sqlx::{Sqlite, Transaction};
use std::future::Future;
use std::sync::Arc;
use std::time::Instant;

impl Store {
    /// Begins a write; nobody else can until it ends. Refused while the disk is so full that the reserve is given away:
    /// what it frees is for deleting and cancelling.
    pub(super) async fn begin(&self) -> StoreResult<Transaction<'static, Sqlite>> {
        self.keep_room().await?;
        self.begin_relief().await
    }

    /// Begins a write that makes room or ends work, which may use the room that the reserve gave.
    pub(super) async fn begin_relief(&self) -> StoreResult<Transaction<'static, Sqlite>> {
        Ok(self.writer()?.begin_with("BEGIN IMMEDIATE").await?)
    }

    /// Makes the reserve again where it was given away.
    pub(super) async fn keep_room(&self) -> StoreResult<()> {
        let Some(reserve) = self.inner().reserve.get().filter(|reserve| !reserve.is_there()) else { return Ok(()) };
        let reserve = Arc::clone(reserve);
        match off_runtime(move || Ok(reserve.keep())).await? {
            Kept::Yes => Ok(()),
            Kept::NoRoom => Err(StoreError::Full("there is not even room for the reserve".to_owned())),
        }
    }

    /// Runs a write to its end, even when whoever asked for it goes away meanwhile: a future that is dropped half-way
    /// would leave a connection within a transaction, and nobody would know what was written.
    pub(super) async fn uninterrupted<T, F>(&self, write: F) -> StoreResult<T>
    where
        T: Send + 'static,
        F: Future<Output = StoreResult<T>> + Send + 'static,
    {
        let permit = Arc::clone(&self.inner().writes).acquire_owned().await;
        let task = tokio::spawn(async move {
            let _permit = permit;
            write.await
        });
        match task.await {
            Ok(outcome) => outcome,
            Err(error) if error.is_panic() => std::panic::resume_unwind(error.into_panic()),
            Err(_) => Err(sqlx::Error::PoolClosed.into()),
        }
    }

    /// Runs a write that makes room or ends work, and once more with the room of the reserve where the disk is full.
    pub(super) async fn relieved<T, F>(&self, write: impl Fn(Self) -> F + Send + 'static) -> StoreResult<T>
    where
        T: Send + 'static,
        F: Future<Output = StoreResult<T>> + Send + 'static,
    {
        let store = self.clone();
        self.uninterrupted(async move {
            match write(store.clone()).await {
                Err(error) if error.trouble() == Some(Trouble::Full) && store.give_room() => write(store).await,
                outcome => outcome,
            }
        })
        .await
    }

    fn give_room(&self) -> bool {
        self.inner().reserve.get().is_some_and(|reserve| reserve.give())
    }

    /// Whether the database can do its work (readiness): commits a changed row. A read, and even the beginning of a
    /// write, succeed on a full disk. Whoever asks while an answer is sought waits for it, and shares one that began
    /// after they asked.
    ///
    /// # Errors
    /// The database's own.
    pub async fn ping(&self) -> StoreResult<()> {
        let asked = Instant::now();
        let mut latest = self.inner().ready.lock().await;
        if latest.is_some_and(|began| began >= asked) {
            return Ok(());
        }
        let began = Instant::now();
        let store = self.clone();
        let outcome = self
            .uninterrupted(async move {
                let mut tx = store.begin().await?;
                sqlx::query("UPDATE readiness SET commits = commits + 1 WHERE id = 1").execute(&mut *tx).await?;
                Ok(tx.commit().await?)
            })
            .await;
        *latest = outcome.is_ok().then_some(began);
        outcome
    }
}
