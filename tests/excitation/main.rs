//! Sequences, flatness and the loop that carries them, against numbers computed independently from Qiu 2021 and by
//! other routes.
#![allow(clippy::unwrap_used, missing_docs)]

mod compensator;
mod flatness;
mod requests;
mod sequences;
mod support;
