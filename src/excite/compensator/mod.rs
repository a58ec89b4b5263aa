//! The compensator of a position loop that delivers the flattest spectrum (Qiu 2021, sections IV.B–D).
//!
//! ```text
//! C(s) = K Π (s + 2πf_z)/(s + 2πf_p)    by Tustin's substitution; no section for proportional control, one for a
//!                                       lead or lag, several in cascade, or sections of second order
//! maximise  SFG_xr(f_ub) = γ_x²(f_ub)/γ_r²(f_ub)   over K and the sections within a box,
//! subject to  every root of the closed loop inside the unit circle (Jury, proven with rounding bounded),
//!             and the limits given
//! ```
//! The problem is not convex. Limits that [`impossible()`] proves to be out of reach are refused first. With one
//! section at most, [`search()`] looks at a grid over the whole box and climbs from its best local maxima; with more it
//! begins with the best of one section less. What it reports says how many climbs ended in the answer, what the next
//! best one was, and which edges of the box hold the answer.

mod ascent;
mod bound;
mod climb;
mod climbs;
mod controller;
mod design;
mod edge;
mod following;
mod norm;
mod search;
mod search_box;
mod several;
mod space;

pub use bound::{Impossible, impossible};
pub use controller::{Compensator, Section};
pub use design::{Design, DesignLimits, Judged};
pub use edge::{Edge, End, Unknown};
pub use search::{Curve, DesignError, Found, SearchSummary, search, sweep};
pub use search_box::{SearchBox, SectionBox};
