//! Closed-loop frequency responses from recorded trials.
//!
//! A segment of `N` samples `x₀ … x_{N−1}` at the sample time `T` has, with the window `w`, the discrete Fourier
//! transform `X(ω) = Σᵢ wᵢ xᵢ e^{−jωiT}`, `i` counted from the start of the segment. With `R` of the input and `Y` of
//! the output, the response is the average over all segments of all trials, of `n` segments in all:
//!
//! - ratios (Zhang 2015, sections 3.5.1 and 5.6.1): `H = (1/n) Σ Yₛ/Rₛ`,
//! - cross spectra: `H = Σ R̄ₛYₛ / Σ |Rₛ|²`.
//!
//! Variances are those of the complex `H`, `E|H − E H|²` (the sum of the variances of its two parts):
//!
//! - ratios, `n ≥ 2`: `Σ |Yₛ/Rₛ − H|² / (n (n − 1))`,
//! - cross spectra, `n ≥ 2`: `Σ |Yₛ − H Rₛ|² / ((n − 1) Σ |Rₛ|²)`,
//! - `n = 1`: `S/|R|²` with `S` the mean of `|Y|²` over nearby lines of the segment's grid on which no stimulus has
//!   power,
//! - where transients are removed from segments that are no whole periods: the mean square error of the local
//!   polynomials ([`local_polynomial`]), of any number of segments,
//! - otherwise unknown, with the reason.
//!
//! ## Transients, drifts, windows
//! `Y/R` is the response only in a periodic steady state of whole periods. Otherwise what the loop remembers at the
//! segment's ends adds a transient to every line, an offset or a slope leaks, and a window spreads every line over its
//! neighbours. By default the transient and the output's slope are estimated beside the response and removed. Where
//! they are kept (the presets, windows) the same estimate says for every line how much they are: [`Estimate::leakage`].
//!
//! ## End samples
//! A segment from `a` to `b` seconds (counted from the first sample) begins at sample `round(a/T)` and has `N =
//! round((b − a)/T)` samples: the end sample `b` is *excluded*. That makes `k/(b − a)` Hz the segment's grid, on which
//! a signal of period `b − a` has no leakage at all. Zhang's sums run from `i = 0` to `N`, the end sample *included*;
//! the presets follow that. For his commands, which are not periodic, the two differ by less than 1 % of `H` (on a
//! linear loop and the 60-s chirp: mean error 0.026 excluded, 0.023 included, both from leakage).

mod data;
mod drift;
mod error;
mod estimate;
mod excited;
mod grids;
mod job;
mod lines;
mod local_polynomial;
mod removal;
mod repeats;
mod result;
mod segments;
mod settings;
mod spectrum;
pub mod stimuli;
mod usable;
mod variance;
mod warnings;

pub use data::FrequencyData;
pub use error::FrequencyError;
pub use estimate::{estimate, estimate_between};
pub use repeats::{Fold, MOST_FOLDS, RepeatKind, Repeats, repeats};
pub use result::{Estimate, UsedSegment, VarianceSource};
pub use settings::{
    Average, Bounds, Channels, CheckedSettings, CountSegments, Detrend, EndSample, FrequencySettings, LengthSegments,
    Lines, Response, Segments, SettingsError, Stimulus, Transients, Window,
};
pub use spectrum::direct_transform;
pub use warnings::EstimateWarning;
