//! The compensator of a position loop that delivers the flattest spectrum (Qiu 2021, sections IV.B–D).
//!
//! ```text
//! C(s) = K (s + 2πf_z)/(s + 2πf_p)      by Tustin's substitution, f_z = f_p for proportional control
//! maximise  SFG_xr(f_ub) = γ_x²(f_ub)/γ_r²(f_ub)   over K, f_z, f_p within a box,
//! subject to  every root of the closed loop inside the unit circle (Jury, proven with rounding bounded),
//!             and the limits given
//! ```
//! The problem is not convex. [`search()`] looks at a grid over the whole box first and climbs from its best local
//! maxima; what it reports says how many climbs ended in the answer, what the next best one was, and which edges of the
//! box hold the answer.

mod ascent;
mod climb;
mod design;
mod edge;
mod search;
mod space;

pub use design::{Compensator, Design, DesignLimits, Judged};
pub use edge::{Edge, End, Unknown};
pub use search::{Curve, DesignError, Found, SearchBox, SearchSummary, search, sweep};
