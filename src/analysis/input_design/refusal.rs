//! What is wrong with a request, in one form.

use crate::analysis::problem::{Code, Problem};

/// The title of everything that is wrong.
pub(super) const TITLE: &str = "impossible design";

/// A problem of the request.
pub(super) fn wrong(detail: impl Into<String>, at: impl Into<String>) -> Problem {
    Problem::new(Code::Invalid, TITLE, detail).at(at)
}
