//! Requests that are refused, and what they name.
