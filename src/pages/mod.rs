//! What a lab looks at: pages of HTML beside the interface.
//!
//! Every page is written here from templates that are checked when the program is compiled, works without script, and
//! loads nothing from elsewhere. Figures stand in the pages as the one writer of [`crate::figure`] draws them; numbers
//! are those of the interface, read by the same functions. What a person typed is text and never markup.

mod analysis;
mod assets;
mod compare;
mod compare_analyses;
mod excitation;
mod frame;
mod gate;
mod grid;
mod home;
mod layout;
mod new_study;
mod numbers;
mod problems;
mod queue;
mod report;
mod router;
mod schema;
mod sentences;
mod start;
mod study;
mod subject;
mod svg;
mod trial;
mod trust;
mod upload;
mod values;
mod warnings;

pub use router::router;
