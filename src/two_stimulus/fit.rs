//! Parametric fits to the responses to both stimuli jointly.
//!
//! `J(θ) = Σ_k e_k* C_k⁻¹ e_k`, `e_k` the misfit of (H_ur, H_ud) at a line, or of (H_yr, H_yd), and C_k their
//! covariance: maximum likelihood for circular Gaussian noise of known covariance, independent from line to line. Twice
//! J is chi-square with `2 n − p` degrees of freedom (n complex values, p parameters) if the structure is right.
//!
//! On a plant that is known exactly u and y carry the same information, `y = G (u + d)`; in u it comes without what the
//! plant's drift leaks into y, so trials are fitted in u. Every step of the search keeps the delayed loop stable
//! ([`super::stability`]).

mod cost;
mod start;

use super::responses::LineResponse;
use super::structure::{FeedforwardLaw, Person};
use crate::ctl::{Ctl, Stopped};
use crate::num::distributions::{chi_square_cdf, student_t};
use crate::num::least_squares::{LeastSquares, LeastSquaresError, Minimum, Options, minimise};
pub use cost::Channel;
use cost::{Cost, STEP, inside, outside, targets};
use nalgebra::DMatrix;
use num_complex::Complex64;
use start::first_guess;

/// How the search is run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FitSettings {
    /// Which responses are fitted.
    pub channel: Channel,
    /// Starts of the search, the first of them not random.
    pub starts: usize,
    /// Seed of the others.
    pub seed: u64,
}

/// Why there is no fit.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FitError {
    /// Somebody asked it to stop.
    #[error(transparent)]
    Stopped(#[from] Stopped),
    /// More parameters than the lines can bear.
    #[error("{equations} real equations of the excited lines do not determine {unknowns} parameters")]
    Underdetermined {
        /// Real equations.
        equations: usize,
        /// Parameters.
        unknowns: usize,
    },
    /// A feedforward, and no line that the command excites.
    #[error("the structure has a feedforward, and the command excites no line")]
    NoCommand,
    /// Without the disturbance, feedback and feedforward are not told apart by data.
    #[error("the disturbance excites no line, so the data do not tell feedback from feedforward")]
    NoDisturbance,
    /// No start has a stable loop.
    #[error("no start of the search has a stable loop with a finite cost")]
    NoStart,
}

/// A parameter as found.
#[derive(Debug, Clone, PartialEq)]
pub struct Found {
    /// Its name.
    pub name: String,
    /// Its value.
    pub value: f64,
    /// The half-width of its 95 % interval by linearisation (of its logarithm for positive ones: `value·e^{±h}`);
    /// `None` where it lies on the edge of its range or is not determined.
    pub half_width: Option<f64>,
    /// Whether the interval is one of the logarithm.
    pub logarithmic: bool,
    /// Whether it lies on the edge of its range.
    pub at_edge: bool,
}

/// A fitted person.
#[derive(Debug, Clone, PartialEq)]
pub struct Fitted {
    /// The structure on its plant.
    pub person: Person,
    /// The parameters' values.
    pub values: Vec<f64>,
    /// The same with their intervals.
    pub parameters: Vec<Found>,
    /// `J` at the optimum; in squared units of the response where no variance is known.
    pub cost: f64,
    /// Whether the noise of all lines was known; all lines count alike otherwise.
    pub weighted: bool,
    /// Complex values fitted.
    pub equations: usize,
    /// `2 J/(2n − p)`: 1 for a structure that is right under a noise that is right. `None` without degrees of freedom,
    /// or without variances.
    pub reduced_chi_square: Option<f64>,
    /// The probability of a larger one, if both are right.
    pub p_value: Option<f64>,
    /// Akaike's criterion `2 J + 2 p`, where variances are known.
    pub akaike: Option<f64>,
    /// Starts that came to the same cost.
    pub starts_agreeing: usize,
    /// Starts in all.
    pub starts: usize,
    /// Covariance of the internal unknowns (logarithms of positive parameters), scaled by the reduced chi-square where
    /// that exceeds 1. Parameters at an edge count as free; where that makes the Jacobian singular, they count as
    /// fixed. `None` where it is singular all the same.
    pub covariance: Option<DMatrix<f64>>,
    /// Degrees of freedom of its scale; infinite where variances are taken as known.
    pub freedoms: f64,
}

/// The value of a controller with the standard deviation of `ln|X|` and of its phase.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Band {
    /// The value.
    pub value: Complex64,
    /// Standard deviations of `ln|X|` and of `arg X` in rad.
    pub deviation: Option<[f64; 2]>,
}

/// Costs within this share of each other are of the same optimum.
const SAME_COST: f64 = 1e-4;

/// A unit column that keeps less than this beside the others is dependent on them.
const DEPENDENT: f64 = 1e-7;

/// A parameter this near to the edge of its range, in internal units, lies on it.
const AT_EDGE: f64 = 1e-6;

/// Fits a person to the responses.
///
/// Lines without a known covariance are left out if others have one; if none has, all count alike.
///
/// # Errors
/// [`FitError`].
pub fn fit(responses: &[LineResponse], person: &Person, settings: &FitSettings, ctl: &Ctl) -> Result<Fitted, FitError> {
    let usable: Vec<&LineResponse> = responses.iter().filter(|line| !line.confounded).collect();
    if !usable.iter().any(|line| line.disturbance.is_some()) {
        return Err(FitError::NoDisturbance);
    }
    let has_command = usable.iter().any(|line| line.command.is_some());
    if !has_command && person.structure().feedforward != FeedforwardLaw::None {
        return Err(FitError::NoCommand);
    }
    let weighted = usable.iter().any(|line| line.covariance.is_some());
    let used: Vec<LineResponse> =
        usable.into_iter().filter(|line| !weighted || line.covariance.is_some()).cloned().collect();
    let targets = targets(&used, settings.channel, weighted);
    let count: usize = targets.iter().map(|t| t.wanted.len()).sum();
    let (equations, unknowns) = (2 * count, person.parameters().len());
    if equations < unknowns {
        return Err(FitError::Underdetermined { equations, unknowns });
    }
    let cost = Cost { person, targets: &targets, equations };
    let mut costs: Vec<f64> = Vec::new();
    let mut best: Option<Minimum> = None;
    let starts = settings.starts.max(1);
    ctl.set_total(starts as u64);
    for start in 0..starts {
        ctl.check()?;
        ctl.advance(1);
        let Some(x) = first_guess(&cost, &used, settings.seed, start) else { continue };
        let options = Options { max_evaluations: 300, ..Options::default() };
        match minimise(&cost, &x, &options, ctl) {
            Ok(found) => {
                costs.push(found.cost);
                if best.as_ref().is_none_or(|best| found.cost < best.cost) {
                    best = Some(found);
                }
            }
            Err(LeastSquaresError::Stopped(stopped)) => return Err(stopped.into()),
            Err(_) => {}
        }
    }
    let best = best.ok_or(FitError::NoStart)?;
    let agreeing = costs.iter().filter(|c| **c <= best.cost * (1.0 + SAME_COST) + 1e-12).count();
    Ok(assemble(person, &cost, &best, weighted, count, agreeing, starts))
}

/// `scale (JᵀJ)⁻¹` of the columns `free`, zero elsewhere; `None` where they are dependent.
fn covariance_of(jacobian: &DMatrix<f64>, free: &[usize], scale: f64) -> Option<DMatrix<f64>> {
    let columns = jacobian.select_columns(free);
    // In units of the columns, whose sizes differ by orders of magnitude.
    let norms: Vec<f64> = columns.column_iter().map(|c| c.norm()).collect();
    if norms.iter().any(|n| *n <= 0.0) {
        return None;
    }
    let unit = DMatrix::from_fn(columns.nrows(), columns.ncols(), |i, j| columns[(i, j)] / norms[j]);
    let r = unit.qr().unpack_r();
    let diagonal: Vec<f64> = r.diagonal().iter().map(|d| d.abs()).collect();
    if diagonal.iter().any(|d| *d < DEPENDENT) {
        return None;
    }
    let root = r.solve_upper_triangular(&DMatrix::identity(free.len(), free.len()))?;
    let inverse = &root * root.transpose();
    let n = jacobian.ncols();
    let mut whole = DMatrix::zeros(n, n);
    for (a, i) in free.iter().enumerate() {
        for (b, j) in free.iter().enumerate() {
            whole[(*i, *j)] = scale * inverse[(a, b)] / (norms[a] * norms[b]);
        }
    }
    Some(whole)
}

fn assemble(
    person: &Person,
    cost: &Cost<'_>,
    best: &Minimum,
    weighted: bool,
    count: usize,
    starts_agreeing: usize,
    starts: usize,
) -> Fitted {
    let values = cost.values(&best.x);
    let bounds = cost.bounds();
    let at_edge: Vec<bool> =
        best.x.iter().zip(&bounds).map(|(x, [low, high])| x - low < AT_EDGE || high - x < AT_EDGE).collect();
    let free = (0..values.len()).filter(|i| !at_edge[*i]).count();
    let freedoms = 2.0 * count as f64 - free as f64;
    let reduced = (freedoms > 0.0).then(|| best.cost / freedoms);
    let scale = match (weighted, reduced) {
        (true, Some(reduced)) => Some(reduced.max(1.0)),
        (true, None) => Some(1.0),
        (false, reduced) => reduced,
    };
    // A parameter at an edge is as uncertain as any; only where it changes nothing at all is it taken as fixed.
    let covariance = scale.and_then(|scale| {
        let all: Vec<usize> = (0..values.len()).collect();
        let inner: Vec<usize> = all.iter().copied().filter(|i| !at_edge[*i]).collect();
        covariance_of(&best.jacobian, &all, scale).or_else(|| covariance_of(&best.jacobian, &inner, scale))
    });
    let scale_freedoms = if weighted { f64::INFINITY } else { freedoms };
    let quantile = student_t(0.95, scale_freedoms.max(1.0));
    let parameters = person
        .parameters()
        .iter()
        .enumerate()
        .map(|(i, parameter)| Found {
            name: parameter.name.clone(),
            value: values[i],
            half_width: covariance.as_ref().filter(|_| !at_edge[i]).map(|c| quantile * c[(i, i)].max(0.0).sqrt()),
            logarithmic: parameter.logarithmic,
            at_edge: at_edge[i],
        })
        .collect();
    Fitted {
        person: person.clone(),
        parameters,
        // ‖r‖² is twice J.
        cost: 0.5 * best.cost,
        weighted,
        equations: count,
        reduced_chi_square: reduced.filter(|_| weighted),
        p_value: (weighted && freedoms > 0.0).then(|| 1.0 - chi_square_cdf(best.cost, freedoms)),
        akaike: weighted.then_some(best.cost + 2.0 * values.len() as f64),
        values,
        starts_agreeing,
        starts,
        covariance,
        freedoms: scale_freedoms,
    }
}

impl Fitted {
    /// The loop's responses `[H_ur, H_yr, H_ud, H_yd]` at a frequency.
    #[must_use]
    pub fn closed_loop(&self, omega_rad_s: f64) -> [Complex64; 4] {
        self.person.closed_loop(&self.values, omega_rad_s)
    }

    /// `[Gfb, Gff]` with their deviations, by linearisation.
    #[must_use]
    pub fn bands(&self, omega_rad_s: f64) -> [Band; 2] {
        let both = |values: &[f64]| {
            let response = self.person.response(values, omega_rad_s);
            [response.feedback, response.feedforward]
        };
        let centre = both(&self.values);
        let parameters = self.person.parameters();
        let x: Vec<f64> = parameters.iter().zip(&self.values).map(|(p, v)| inside(p, *v)).collect();
        let gradients: Vec<[Complex64; 2]> = (0..x.len())
            .map(|j| {
                let step = STEP * x[j].abs().max(1.0);
                let at = |shift: f64| {
                    let mut values = self.values.clone();
                    values[j] = outside(&parameters[j], x[j] + shift);
                    both(&values)
                };
                let (above, below) = (at(step), at(-step));
                std::array::from_fn(|i| (above[i] - below[i]) / (2.0 * step * centre[i]))
            })
            .collect();
        std::array::from_fn(|i| {
            let deviation = self.covariance.as_ref().filter(|_| centre[i].norm_sqr() > 0.0).map(|covariance| {
                let mut variance = [0.0; 2];
                for a in 0..x.len() {
                    for b in 0..x.len() {
                        variance[0] += gradients[a][i].re * covariance[(a, b)] * gradients[b][i].re;
                        variance[1] += gradients[a][i].im * covariance[(a, b)] * gradients[b][i].im;
                    }
                }
                variance.map(|v| v.max(0.0).sqrt())
            });
            Band { value: centre[i], deviation }
        })
    }

    /// Student's quantile for bands with this probability.
    #[must_use]
    pub fn quantile(&self, probability: f64) -> f64 {
        student_t(probability, self.freedoms.max(1.0))
    }
}
