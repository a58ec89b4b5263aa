//! A frequency response with all that belongs to it.

use super::data::FrequencyData;
use super::warnings::EstimateWarning;
use num_complex::Complex64;

/// A segment that went into an estimate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct UsedSegment {
    /// The trial, from 0.
    pub trial: usize,
    /// Its first sample, in seconds from the trial's first.
    pub start_s: f64,
    /// Its length in seconds: the period of its grid.
    pub length_s: f64,
    /// The samples that were summed.
    pub samples: usize,
    /// The slope that was taken off the output, in its units a second; `None` where none stood above the noise or none
    /// was to be taken off.
    pub slope_per_s: Option<f64>,
}

/// Where variances come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum VarianceSource {
    /// The scatter of the segments.
    Repetition,
    /// The output's power on nearby lines without a stimulus.
    NearbyLines,
    /// The mean square error of the local polynomials.
    LocalPolynomial,
}

/// A closed-loop frequency response with all that belongs to it; arrays are equally long, in increasing frequency.
#[derive(Debug, Clone, PartialEq)]
pub struct Estimate {
    /// Frequencies in Hz.
    pub frequency_hz: Vec<f64>,
    /// Angular frequencies in rad/s.
    pub omega_rad_s: Vec<f64>,
    /// The response; `None` where the input has no power at all (to rounding).
    pub h: Vec<Option<Complex64>>,
    /// `E|H − E H|²`, where it is known.
    pub variance: Vec<Option<f64>>,
    /// Where the variances come from; `None` if none is known.
    pub variance_source: Option<VarianceSource>,
    /// Mean square of the input's sinusoid on each line, averaged over segments, in squared units of the input.
    pub input_power: Vec<f64>,
    /// The same of the segment in which it is weakest.
    pub input_power_minimum: Vec<f64>,
    /// What transients, slopes and a window leave in the response, root mean square; 0 where nothing stands above the
    /// noise, a bound where the data do not tell the response from the transient, `None` where nothing is known of it.
    pub leakage: Vec<Option<f64>>,
    /// Whether the error of the line is at most a fifth of its response (or of the median response, where that is
    /// larger), as far as it is known, and the data tell the response from the transient.
    pub usable: Vec<bool>,
    /// `|Σ R̄Y|²/(Σ|R|² Σ|Y|²)` over segments, times `|h|²/(|h|² + leakage²)`; `None` of a single one.
    pub coherence: Vec<Option<f64>>,
    /// Segments averaged on each line.
    pub averages: Vec<usize>,
    /// Real degrees of freedom of the variances of local polynomials, the fewest; `None` of others.
    pub degrees_of_freedom: Option<f64>,
    /// Whether transients were removed.
    pub transients_removed: bool,
    /// The segments.
    pub segments: Vec<UsedSegment>,
    /// Step of the grid of the shortest segment, in Hz.
    pub resolution_hz: f64,
    /// Equivalent noise bandwidth of the window on that grid, in Hz.
    pub noise_bandwidth_hz: f64,
    /// What must be read before using it.
    pub warnings: Vec<EstimateWarning>,
}

impl Estimate {
    /// The data as identification takes them; lines without a response are left out, and so are lines that are not
    /// usable where local polynomials tell which (warnings name them).
    #[must_use]
    pub fn data(&self) -> FrequencyData {
        let chooses = self.variance_source == Some(VarianceSource::LocalPolynomial) && self.usable.contains(&true);
        let known: Vec<usize> =
            (0..self.h.len()).filter(|i| self.h[*i].is_some() && (self.usable[*i] || !chooses)).collect();
        FrequencyData {
            omega_rad_s: known.iter().map(|i| self.omega_rad_s[*i]).collect(),
            h: known.iter().filter_map(|i| self.h[*i]).collect(),
            variance: known.iter().map(|i| self.variance[*i]).collect(),
        }
    }
}
