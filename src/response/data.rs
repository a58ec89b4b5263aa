//! Frequency response data.

use num_complex::Complex64;

/// Frequency response data as identification takes it: equally long, in increasing frequency.
#[derive(Debug, Clone, PartialEq)]
pub struct FrequencyData {
    /// Angular frequencies in rad/s.
    pub omega_rad_s: Vec<f64>,
    /// The response at each frequency.
    pub h: Vec<Complex64>,
    /// The variance `E|H − E H|²` at each frequency; `None` unless it is known at every one.
    pub variance: Option<Vec<f64>>,
}
