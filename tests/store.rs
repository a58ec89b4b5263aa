//! What the store promises, whatever database is behind it: one suite, run on SQLite today.
#![allow(clippy::unwrap_used, missing_docs)]

mod store_suite;
