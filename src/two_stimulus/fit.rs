//! Parametric fits to the responses to both stimuli jointly.
//!
//! `J(θ) = Σ_k e_k* C_k⁻¹ e_k`, `e_k` the misfit of (H_ur, H_ud) at a line, or of (H_yr, H_yd), and C_k their
//! covariance: maximum likelihood for circular Gaussian noise of known covariance, independent from line to line. Twice
//! J is chi-square with `2 n − p` degrees of freedom (n complex values, p parameters) if the structure is right.
//!
//! On a plant that is known exactly u and y carry the same information, `y = G (u + d)`; in u it comes without what the
//! plant's drift leaks into y, so trials are fitted in u. Every step of the search keeps the delayed loop stable
//! ([`super::stability`]).

use super::responses::{LineResponse, UD, UR, YD, YR};
use super::structure::{FeedbackLaw, FeedforwardLaw, Parameter, Person, RationalLaw};
use crate::ctl::{Ctl, Stopped};
use crate::num::distributions::{chi_square_cdf, student_t};
use crate::num::least_squares::{LeastSquares, LeastSquaresError, Options, minimise};
use crate::num::rng;
use nalgebra::{DMatrix, DVector};
use num_complex::Complex64;
use rand::RngExt;
use rand_distr::StandardNormal;

/// Which responses are fitted.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Channel {
    /// H_ur and H_ud.
    Control,
    /// H_yr and H_yd.
    Output,
}

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

/// Lines that the noise of a line is smoothed over.
pub const NEIGHBOURS: usize = 7;

/// A parameter this near to the edge of its range, in internal units, lies on it.
const AT_EDGE: f64 = 1e-6;

/// A misfit `e` at a line: the values, and the inverse of the Cholesky factor of their covariance.
struct Target {
    omega: f64,
    /// Positions in `[H_ur, H_yr, H_ud, H_yd]`, with the data.
    wanted: Vec<(usize, Complex64)>,
    /// Rows of the whitening, lower triangular.
    whitening: Vec<Vec<Complex64>>,
}

struct Cost<'a> {
    person: &'a Person,
    targets: &'a [Target],
    equations: usize,
}

fn outside(parameter: &Parameter, x: f64) -> f64 {
    if parameter.logarithmic { x.exp() } else { x }
}

fn inside(parameter: &Parameter, value: f64) -> f64 {
    if parameter.logarithmic { value.ln() } else { value }
}

impl Cost<'_> {
    fn values(&self, x: &[f64]) -> Vec<f64> {
        self.person.parameters().iter().zip(x).map(|(p, x)| outside(p, *x)).collect()
    }

    fn residuals(&self, x: &[f64], into: &mut DVector<f64>) -> bool {
        let values = self.values(x);
        let mut row = 0;
        for target in self.targets {
            let model = self.person.closed_loop(&values, target.omega);
            let e: Vec<Complex64> = target.wanted.iter().map(|(i, data)| data - model[*i]).collect();
            for weights in &target.whitening {
                let sum: Complex64 = weights.iter().zip(&e).map(|(w, e)| w * e).sum();
                // The real and the imaginary part have half of the variance each.
                into[row] = std::f64::consts::SQRT_2 * sum.re;
                into[row + 1] = std::f64::consts::SQRT_2 * sum.im;
                row += 2;
            }
        }
        into.iter().all(|v| v.is_finite())
    }
}

/// Step of the central differences, in internal units.
const STEP: f64 = 1e-6;

impl LeastSquares for Cost<'_> {
    fn unknowns(&self) -> usize {
        self.person.parameters().len()
    }

    fn equations(&self) -> usize {
        self.equations
    }

    fn evaluate(&self, x: &[f64], residuals: &mut DVector<f64>, jacobian: Option<&mut DMatrix<f64>>) -> bool {
        if !self.residuals(x, residuals) {
            return false;
        }
        let Some(jacobian) = jacobian else { return true };
        let mut moved = x.to_vec();
        let (mut above, mut below) = (residuals.clone(), residuals.clone());
        for j in 0..x.len() {
            let step = STEP * x[j].abs().max(1.0);
            moved[j] = x[j] + step;
            let is_fine = self.residuals(&moved, &mut above);
            moved[j] = x[j] - step;
            if !(is_fine && self.residuals(&moved, &mut below)) {
                return false;
            }
            moved[j] = x[j];
            jacobian.set_column(j, &((&above - &below) / (2.0 * step)));
        }
        true
    }

    fn bounds(&self) -> Vec<[f64; 2]> {
        self.person.parameters().iter().map(|p| p.range.map(|value| inside(p, value))).collect()
    }

    fn is_feasible(&self, x: &[f64]) -> bool {
        self.person.is_stable(&self.values(x))
    }
}

/// What each line's covariance is multiplied by, to have the smoothed noise; 1 where its noise was given.
fn smoothing(responses: &[LineResponse], channel: Channel) -> Vec<f64> {
    let which = usize::from(channel == Channel::Output);
    // (position, ln ω, ln σ² without bias, weight)
    let known: Vec<(usize, f64, f64, f64)> = responses
        .iter()
        .enumerate()
        .filter_map(|(i, line)| {
            let noise = line.noise?[which];
            (noise > 0.0).then(|| (i, line.omega_rad_s.ln(), noise.ln() + 0.5 / line.freedoms, line.freedoms))
        })
        .collect();
    let mut factors = vec![1.0; responses.len()];
    for (i, x, _, _) in &known {
        let mut distances: Vec<f64> = known.iter().map(|(_, other, _, _)| (other - x).abs()).collect();
        distances.sort_by(f64::total_cmp);
        // The farthest of the neighbours still counts a little.
        let reach = 1.1 * distances[(NEIGHBOURS - 1).min(distances.len() - 1)];
        let mut sums = [0.0; 5];
        for (_, other, level, weight) in &known {
            let distance = if reach > 0.0 { (other - x).abs() / reach } else { 0.0 };
            if distance < 1.0 {
                let w = weight * (1.0 - distance.powi(3)).powi(3);
                let t = other - x;
                for (sum, term) in sums.iter_mut().zip([1.0, t, t * t, *level, t * level]) {
                    *sum += w * term;
                }
            }
        }
        let [n, t, tt, level, t_level] = sums;
        let determinant = n * tt - t * t;
        let smooth = if determinant > 1e-9 * n * tt { (tt * level - t * t_level) / determinant } else { level / n };
        if let Some(noise) = responses[*i].noise {
            factors[*i] = smooth.exp() / noise[which];
        }
    }
    factors
}

fn targets(responses: &[LineResponse], channel: Channel, weighted: bool) -> Vec<Target> {
    let factors = smoothing(responses, channel);
    let (r, d) = if channel == Channel::Control { (UR, UD) } else { (YR, YD) };
    let mut targets = Vec::new();
    for (line, factor) in responses.iter().zip(factors) {
        let pick = |pair: [Complex64; 2]| if channel == Channel::Control { pair[0] } else { pair[1] };
        let wanted: Vec<(usize, Complex64)> = [(r, line.command), (d, line.disturbance)]
            .into_iter()
            .filter_map(|(i, pair)| Some((i, pick(pair?))))
            .collect();
        if wanted.is_empty() {
            continue;
        }
        let one = Complex64::from(1.0);
        let whitening = match (&line.covariance, weighted) {
            (Some(c), true) => {
                let c = DMatrix::from_fn(wanted.len(), wanted.len(), |a, b| c[(wanted[a].0, wanted[b].0)] * factor);
                let Some(factor) = c.cholesky() else { continue };
                let n = wanted.len();
                let Some(inverse) = factor.l().solve_lower_triangular(&DMatrix::identity(n, n)) else { continue };
                (0..n).map(|a| (0..n).map(|b| inverse[(a, b)]).collect()).collect()
            }
            _ => (0..wanted.len())
                .map(|a| (0..wanted.len()).map(|b| if a == b { one } else { 0.0.into() }).collect())
                .collect(),
        };
        targets.push(Target { omega: line.omega_rad_s, wanted, whitening });
    }
    targets
}

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
    let mut best: Option<crate::num::least_squares::Minimum> = None;
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
    best: &crate::num::least_squares::Minimum,
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

/// A start with a stable loop: from typical values for the first, scattered around them for the others; numerators of
/// rational laws by linear least squares on the estimates without structure.
fn first_guess(cost: &Cost<'_>, responses: &[LineResponse], seed: u64, start: usize) -> Option<Vec<f64>> {
    let person = cost.person;
    let mut stream = rng::stream(seed, &format!("start {start} of a two-stimulus fit"));
    let mut scatter = |deviation: f64| -> f64 {
        let normal: f64 = stream.sample(StandardNormal);
        if start == 0 { 0.0 } else { deviation * normal }
    };
    let estimated = super::controllers::controllers(responses);
    let collect = |pick: &dyn Fn(&super::controllers::LineControllers) -> Option<Complex64>| -> Vec<(f64, Complex64)> {
        estimated.lines.iter().filter_map(|line| Some((line.response.omega_rad_s, pick(line)?))).collect()
    };
    let feedback = collect(&|line| line.feedback.filter(|f| !f.interpolated).map(|f| f.value));
    let feedforward = collect(&|line| line.feedforward.map(|f| f.value));
    let mut sizes: Vec<f64> = feedback.iter().map(|(_, g)| g.norm()).collect();
    sizes.sort_by(f64::total_cmp);
    let typical = sizes.get(sizes.len() / 2).copied().unwrap_or(1.0);
    // The lowest line has the least delay.
    let sign = feedback.first().map_or(1.0, |(_, g)| if g.re < -0.5 * g.norm() { -1.0 } else { 1.0 });
    let unit = 1.0 / person.scale_rad_s();
    let mut values: Vec<f64> = Vec::new();
    for parameter in person.parameters() {
        let factor = scatter(0.7).exp();
        let value = match parameter.name.as_str() {
            "feedback_gain" => sign * typical * factor,
            "feedforward_gain" => 0.5 * factor,
            "feedback_lead_s" => 0.3 * unit * factor,
            "feedback_lag_s" => 0.2 * unit * factor,
            "feedforward_lag_s" | "neuromuscular_lag_s" => 0.1 * unit * factor,
            name if name.ends_with("_delay_s") => {
                let [low, high] = parameter.range;
                (low + (high - low) * 0.25 * factor).min(low + 0.95 * (high - low))
            }
            name if name.contains("_denominator_") => factor * factor,
            _ => 0.0,
        };
        let [low, high] = parameter.range;
        values.push(value.clamp(low, high));
    }
    for (prefix, law, data) in rational_laws(person, &feedback, &feedforward) {
        fill_numerator(person, prefix, law, data, &mut values);
    }
    // A smaller loop gain is stable sooner.
    for _ in 0..40 {
        if person.is_stable(&values) {
            let x: Vec<f64> = person.parameters().iter().zip(&values).map(|(p, v)| inside(p, *v)).collect();
            return Some(x);
        }
        for (parameter, value) in person.parameters().iter().zip(values.iter_mut()) {
            if parameter.name == "feedback_gain" || parameter.name.starts_with("feedback_numerator_") {
                *value *= 0.7;
            }
        }
    }
    None
}

type Samples = Vec<(f64, Complex64)>;

fn rational_laws<'a>(
    person: &Person,
    feedback: &'a Samples,
    feedforward: &'a Samples,
) -> Vec<(&'static str, RationalLaw, &'a Samples)> {
    let mut laws = Vec::new();
    if let FeedbackLaw::Rational(law) = person.structure().feedback {
        laws.push(("feedback", law, feedback));
    }
    if let FeedforwardLaw::Rational(law) = person.structure().feedforward {
        laws.push(("feedforward", law, feedforward));
    }
    laws
}

/// The numerator that comes nearest to the data for the denominator and delay at hand; each numerator coefficient
/// enters linearly.
fn fill_numerator(person: &Person, prefix: &str, law: RationalLaw, data: &Samples, values: &mut [f64]) {
    let name = format!("{prefix}_numerator_0");
    let Some(first) = person.parameters().iter().position(|p| p.name == name) else { return };
    let count = law.numerator_degree + 1;
    let columns: Vec<Vec<Complex64>> = (0..count)
        .map(|i| {
            let mut unit = values.to_vec();
            unit[first..first + count].fill(0.0);
            unit[first + i] = 1.0;
            data.iter()
                .map(|(omega, _)| {
                    let response = person.response(&unit, *omega);
                    if prefix == "feedback" { response.feedback } else { response.feedforward }
                })
                .collect()
        })
        .collect();
    let rows = data.len();
    let part = |z: Complex64, i: usize| if i < rows { z.re } else { z.im };
    // Relative errors: every line tells as much.
    let a = DMatrix::from_fn(2 * rows, count, |i, j| part(columns[j][i % rows] / data[i % rows].1.norm(), i));
    let b = DVector::from_fn(2 * rows, |i, _| part(data[i % rows].1 / data[i % rows].1.norm(), i));
    if let Some((solution, _)) = crate::num::linalg::least_squares(&a, &b) {
        values[first..first + count].copy_from_slice(solution.as_slice());
    } else {
        values[first] = data.first().map_or(1.0, |(_, g)| g.norm());
    }
}
