//! What the stored things have in common: reading one, making one, changing one, deleting one.

use super::error::{StoreError, StoreResult};
use super::idempotency::{or_deleted, remember, replay};
use super::open::Store;
use super::records::{Created, IdempotencyKey, Study};
use crate::analysis::ids::StudyId;
use sqlx::sqlite::SqliteRow;
use sqlx::{AssertSqlSafe, SqliteConnection};
use std::fmt::Display;
use std::future::Future;

/// A sort of stored thing: the rows of a table, each with an id and a version that counts its changes.
pub trait Noun: Sized + Send + 'static {
    /// Names one of them.
    type Id: Copy + Display + Send + Sync + 'static;
    /// What one of them is called in messages.
    const NAME: &'static str;
    /// Their table.
    const TABLE: &'static str;
    /// Selects what [`Noun::from_row`] reads, the table under the alias `n`.
    const SELECT: &'static str;

    /// Reads a row.
    ///
    /// # Errors
    /// [`StoreError::Damaged`] naming the column, the database's own.
    fn from_row(row: &SqliteRow) -> StoreResult<Self>;

    /// Its id.
    fn id(&self) -> Self::Id;

    /// Counts changes, from 1; the ETag follows it.
    fn version(&self) -> i64;

    /// Says why it may not be deleted at the moment.
    ///
    /// # Errors
    /// [`StoreError::Conflict`] with the rule, the database's own.
    fn may_go(connection: &mut SqliteConnection, id: &str) -> impl Future<Output = StoreResult<()>> + Send {
        let _ = (connection, id);
        async { Ok(()) }
    }
}

/// A noun that is made one at a time.
pub(super) trait Make: Noun {
    /// One as asked for.
    type New: Send + Sync + 'static;

    /// The study that it is made in, which must exist; `None` where it is made in none.
    fn study(new: &Self::New) -> Option<StudyId>;

    /// Writes it.
    ///
    /// # Errors
    /// [`StoreError::NotFound`] and [`StoreError::Conflict`] as the noun has it, the database's own.
    fn insert(
        connection: &mut SqliteConnection,
        new: &Self::New,
        now: i64,
    ) -> impl Future<Output = StoreResult<Self>> + Send;
}

/// A noun whose fields can be changed.
pub trait Change: Noun {
    /// Which fields, and to what; the default leaves all of them as they are.
    type Patch: Default + PartialEq + Send + Sync + 'static;

    /// Whether the change takes away what may name a person, so that it is scrubbed like a deletion.
    fn forgets(_before: &Self, _patch: &Self::Patch) -> bool {
        false
    }

    /// Writes a change that is one, to a row that is still `before`.
    ///
    /// # Errors
    /// [`StoreError::Conflict`] as the noun has it, the database's own.
    fn update(
        connection: &mut SqliteConnection,
        before: &Self,
        patch: &Self::Patch,
        now: i64,
    ) -> impl Future<Output = StoreResult<Self>> + Send;
}

/// A query for rows of `N`: its `SELECT`, and then `rest`.
pub(super) fn select<N: Noun>(rest: &str) -> AssertSqlSafe<String> {
    AssertSqlSafe(format!("{} {rest}", N::SELECT))
}

/// One thing.
pub(super) async fn fetch<N: Noun>(connection: &mut SqliteConnection, id: impl Display) -> StoreResult<N> {
    let id = id.to_string();
    let row = sqlx::query(select::<N>("WHERE n.id = $1")).bind(&id).fetch_optional(connection).await?;
    N::from_row(&row.ok_or_else(|| StoreError::not_found(N::NAME, id))?)
}

/// `NotFound` where there is no such study.
pub(super) async fn must_exist(connection: &mut SqliteConnection, study: StudyId) -> StoreResult<()> {
    fetch::<Study>(connection, study).await.map(drop)
}

/// Why a conditional write to a row of `N` matched nothing.
async fn missed<N: Noun>(connection: &mut SqliteConnection, id: &str) -> StoreResult<StoreError> {
    let exists = AssertSqlSafe(format!("SELECT 1 FROM {} WHERE id = $1", N::TABLE));
    let found: Option<i64> = sqlx::query_scalar(exists).bind(id).fetch_optional(connection).await?;
    Ok(match found {
        Some(_) => StoreError::Stale { noun: N::NAME },
        None => StoreError::not_found(N::NAME, id),
    })
}

impl Store {
    /// One thing.
    ///
    /// # Errors
    /// [`StoreError::NotFound`], the database's own.
    pub async fn read<N: Noun>(&self, id: N::Id) -> StoreResult<N> {
        fetch(&mut *self.readers()?.acquire().await?, id).await
    }

    /// Makes one thing, once for an idempotency key.
    pub(super) async fn make<N: Make>(&self, new: N::New, key: Option<&IdempotencyKey>) -> StoreResult<Created<N>> {
        let (store, key) = (self.clone(), key.cloned());
        self.uninterrupted(async move { store.write_new(new, key.as_ref()).await }).await
    }

    async fn write_new<N: Make>(&self, new: N::New, key: Option<&IdempotencyKey>) -> StoreResult<Created<N>> {
        let study = N::study(&new);
        let scope = study.map_or_else(|| N::TABLE.to_owned(), |study| format!("studies/{study}/{}", N::TABLE));
        let mut tx = self.begin().await?;
        if let Some(study) = study {
            must_exist(&mut tx, study).await?;
        }
        if let Some(ids) = replay(&mut tx, &scope, key).await? {
            return or_deleted(fetch(&mut tx, ids.concat()).await).map(Created::Replayed);
        }
        let now = self.now_us();
        let made = N::insert(&mut tx, &new, now).await?;
        remember(&mut tx, &scope, key, &[made.id().to_string()], now).await?;
        tx.commit().await?;
        Ok(Created::New(made))
    }

    /// Changes one thing: a study's name, description or display limit, a plant's name, a subject's code, group or
    /// attributes, a trial's number or session. Where `if_match` is given, only if that is still its version.
    ///
    /// A study's new display limit also changes (the version of) every trial that it makes divergent or no longer so.
    /// A plant's model never changes, since results were computed with it.
    ///
    /// # Errors
    /// [`StoreError::NotFound`], [`StoreError::Stale`], [`StoreError::Conflict`] (`plant_name_taken`,
    /// `subject_code_taken`, `trial_number_taken`), the database's own.
    pub async fn change<N: Change>(&self, id: N::Id, patch: N::Patch, if_match: Option<i64>) -> StoreResult<N> {
        let (store, id) = (self.clone(), id.to_string());
        self.uninterrupted(async move {
            let (after, forgets) = store.write_change(&id, &patch, if_match).await?;
            if forgets { store.erased(std::future::ready(Ok(after))).await } else { Ok(after) }
        })
        .await
    }

    /// The thing as it is then, and whether something of it must be gone.
    async fn write_change<N: Change>(
        &self,
        id: &str,
        patch: &N::Patch,
        if_match: Option<i64>,
    ) -> StoreResult<(N, bool)> {
        let mut tx = self.begin().await?;
        let before: N = fetch(&mut tx, id).await?;
        if if_match.is_some_and(|version| version != before.version()) {
            return Err(StoreError::Stale { noun: N::NAME });
        }
        if *patch == N::Patch::default() {
            return Ok((before, false));
        }
        let forgets = N::forgets(&before, patch);
        if forgets {
            tx = self.begin_erasing(tx).await?;
        }
        let after = N::update(&mut tx, &before, patch, self.now_us()).await?;
        tx.commit().await?;
        Ok((after, forgets))
    }

    /// Deletes one thing with all that belongs to it, and overwrites what they held: a study's plants, subjects, trials
    /// and analyses; a subject's trials; a trial's recording and the analyses that used it; the analyses that named a
    /// plant. A plant stays (`plant_in_use`) while trials were recorded on it. A running analysis is abandoned by its
    /// worker at the next heartbeat. Where `if_match` is given, only if that is still its version.
    ///
    /// # Errors
    /// [`StoreError::NotFound`], [`StoreError::Stale`], [`StoreError::Conflict`] (`plant_in_use`), the database's own.
    pub async fn delete<N: Noun>(&self, id: N::Id, if_match: Option<i64>) -> StoreResult<()> {
        let id = id.to_string();
        self.relieved(move |store| {
            let id = id.clone();
            async move {
                let deleting = store.clone();
                store.erased(async move { deleting.write_deletion::<N>(&id, if_match).await }).await
            }
        })
        .await
    }

    async fn write_deletion<N: Noun>(&self, id: &str, if_match: Option<i64>) -> StoreResult<()> {
        let mut tx = self.begin_erasing(self.begin_relief().await?).await?;
        N::may_go(&mut tx, id).await?;
        let delete = AssertSqlSafe(format!("DELETE FROM {} WHERE id = $1 AND ($2 IS NULL OR version = $2)", N::TABLE));
        let gone = sqlx::query(delete).bind(id).bind(if_match).execute(&mut *tx).await?;
        if gone.rows_affected() == 0 {
            return Err(missed::<N>(&mut tx, id).await?);
        }
        Ok(tx.commit().await?)
    }
}
