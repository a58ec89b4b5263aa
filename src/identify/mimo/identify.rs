//! From a known plant and the closed loop's frequency response to feedforward and feedback.

use super::diagnose::identifiability;
use super::error::{MOST_DERIVATIVES, MOST_STATES, MimoError};
use super::exact::Problem;
use super::findings::findings;
use super::lines::{Line, Lines, MatrixFrequencyData};
use super::pool::{FeedbackPool, MOST_CONTROLS};
use super::search::{Optimum, search};
use super::stability::Tester;
use crate::control::{Discrete, LeftFraction, Multivariable, PolynomialMatrix};
use crate::ctl::Ctl;
use crate::identify::identifiability::Identifiability;
use crate::identify::problem::Dropped;
use crate::identify::ssid::{Finding, Weights};
use crate::num::Polynomial;
use crate::num::linalg;
use nalgebra::DMatrix;
use num_complex::Complex64;

/// The known plant.
#[derive(Debug, Clone, PartialEq)]
pub struct Plant {
    /// From the controls to all outputs.
    pub system: Multivariable<Discrete>,
    /// Which outputs are measured: the rows of Gy.
    pub measured: Vec<usize>,
    /// Which outputs are compared with the command: the rows of Gv.
    pub fed_back: Vec<usize>,
}

/// What is identified, and how.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// The candidate feedbacks.
    pub pool: FeedbackPool,
    /// Order n_ff of the FIR feedforward.
    pub feedforward_order: usize,
    /// How lines are weighted.
    pub weights: Weights,
    /// Larger pools are refused; counted before any candidate is tested for stability.
    pub max_candidates: u64,
}

/// The identified controllers.
#[derive(Debug, Clone, PartialEq)]
pub struct Identified {
    /// Gfb = Dfb⁻¹ Nfb.
    pub feedback: LeftFraction<Discrete>,
    /// Gff = (z^n I)⁻¹ Nff.
    pub feedforward: LeftFraction<Discrete>,
    /// The best candidate and how it was found; its cost is J.
    pub optimum: Optimum,
    /// Candidates before any was tested for stability.
    pub listed: u64,
    /// J of the fractions as reported, from their coefficients.
    pub cost_of_coefficients: f64,
    /// The part of J that no controller can explain, where there are more outputs than controls.
    pub unreachable_cost: f64,
    /// Poles of the feedback loop; the FIR feedforward adds poles at the origin.
    pub closed_loop_poles: Vec<Complex64>,
    /// The pool keeps poles within this radius.
    pub radius: f64,
    /// The lines, with the modelled response at each.
    pub lines: Vec<(Line, DMatrix<Complex64>)>,
    /// Lines that were left out.
    pub dropped: Vec<Dropped>,
    /// How well the lines determine the coefficients.
    pub identifiability: Identifiability,
    /// What must be read.
    pub findings: Vec<Finding>,
}

fn check_outputs(list: &'static str, given: &[usize], outputs: usize) -> Result<(), MimoError> {
    if let Some(output) = given.iter().copied().find(|o| *o >= outputs) {
        return Err(MimoError::Output { list, output, outputs });
    }
    let is_repeated = given.iter().enumerate().any(|(i, o)| given[..i].contains(o));
    if given.is_empty() || is_repeated {
        return Err(MimoError::OutputList { list, given: given.to_vec() });
    }
    Ok(())
}

/// Checks what needs no computation: outputs, sizes, the delay in the loop and the size of the pool.
///
/// # Errors
/// [`MimoError`].
pub fn check(plant: &Plant, data: &MatrixFrequencyData, settings: &Settings) -> Result<(), MimoError> {
    let (system, pool) = (&plant.system, &settings.pool);
    let (controls, outputs, states) = (system.inputs(), system.outputs(), system.states());
    if controls > MOST_CONTROLS || states > MOST_STATES {
        return Err(MimoError::TooLarge { controls, states });
    }
    check_outputs("measured_outputs", &plant.measured, outputs)?;
    check_outputs("fed_back_outputs", &plant.fed_back, outputs)?;
    let (measured, fed_back) = (plant.measured.len(), plant.fed_back.len());
    if (pool.controls(), pool.fed_back()) != (controls, fed_back) {
        return Err(MimoError::PoolSize { rows: pool.controls(), columns: pool.fed_back(), controls, fed_back });
    }
    for (line, h) in data.h.iter().enumerate() {
        let (rows, columns) = h.shape();
        if (rows, columns) != (measured, fed_back) {
            return Err(MimoError::ResponseSize { line, rows, columns, measured, fed_back });
        }
    }
    let is_delayed = system.feedthrough().select_rows(&plant.fed_back).iter().all(|v| *v == 0.0);
    for (row, of) in pool.rows().iter().enumerate() {
        let (numerator, denominator) = (of.numerator_degree(), of.degree);
        let why = if numerator > denominator {
            "a sampled controller has no more zeros than poles"
        } else if numerator == denominator && !is_delayed {
            "the plant acts on its fed-back outputs without delay"
        } else {
            continue;
        };
        return Err(MimoError::NotStrictlyProper { row, numerator, denominator, why });
    }
    let (lines, unknowns) = (data.h.len(), unknowns(settings));
    let entries = 2 * lines * measured * fed_back * unknowns;
    if entries > MOST_DERIVATIVES {
        return Err(MimoError::TooManyDerivatives { lines, measured, fed_back, unknowns, entries });
    }
    let listed = pool.listed();
    if listed > u128::from(settings.max_candidates) {
        return Err(MimoError::Unaffordable { listed, limit: settings.max_candidates });
    }
    Ok(())
}

/// Coefficients of the feedforward and of the feedback.
fn unknowns(settings: &Settings) -> usize {
    let pool = &settings.pool;
    pool.controls() * pool.fed_back() * (settings.feedforward_order + 1) + pool.unknowns()
}

fn weights(weights: Weights, data: &MatrixFrequencyData) -> Result<Option<Vec<f64>>, MimoError> {
    match weights {
        Weights::Uniform => Ok(None),
        Weights::InverseVariance => {
            let variance = data.variance.as_ref().ok_or(MimoError::NoVariance)?;
            let inverse: Vec<f64> = variance.iter().map(|v| 1.0 / v).collect();
            let usable: Vec<f64> = inverse.iter().copied().filter(|w| w.is_finite() && *w > 0.0).collect();
            let mean = crate::num::stats::mean(&usable).ok_or(MimoError::NoVariance)?;
            Ok(Some(inverse.into_iter().map(|w| w / mean).collect()))
        }
    }
}

/// Identifies feedforward and feedback.
///
/// Runs on the rayon pool that it is called in; progress counts listed candidates.
///
/// # Errors
/// [`MimoError`].
pub fn identify(
    plant: &Plant,
    data: &MatrixFrequencyData,
    settings: &Settings,
    ctl: &Ctl,
) -> Result<Identified, MimoError> {
    let pool = &settings.pool;
    check(plant, data, settings)?;
    let weights = weights(settings.weights, data)?;
    let listed = pool.listed();
    let lines = Lines::new(&plant.system, &plant.measured, &plant.fed_back, data, weights.as_deref());
    if lines.used.is_empty() {
        return Err(MimoError::NoLine { lines: data.h.len(), dropped: lines.dropped });
    }
    let time = plant.system.time();
    let order = settings.feedforward_order;
    let problem = Problem::new(lines, order, time)?;
    let lines = &problem.lines;
    let unknowns = unknowns(settings);
    let equations = lines.equations();
    if equations < unknowns {
        return Err(MimoError::Underdetermined { lines: lines.used.len(), equations, unknowns });
    }

    let tester = Tester::new(pool, &plant.system, &plant.fed_back);
    let radius = pool.radius(time);
    let optimum = search(&problem, pool, &tester, ctl)?.ok_or_else(|| MimoError::NoneStable {
        listed,
        radius,
        hidden: hidden_modes(plant, radius),
    })?;
    let (measured, controls) = (plant.measured.len(), plant.system.inputs());
    if measured < controls && !optimum.fit.is_unique {
        return Err(MimoError::FewOutputs { measured, controls });
    }
    if !optimum.fit.cost.is_finite() {
        return Err(MimoError::NotFinite("cost: the data are too large"));
    }
    let feedback = pool.fraction(&optimum.coefficients, time);
    let numerators = problem.numerators(&optimum.fit);
    let feedforward = PolynomialMatrix::new(&numerators)
        .ok()
        .and_then(|n| LeftFraction::new(PolynomialMatrix::power(pool.controls(), order), n, time).ok())
        .ok_or(MimoError::NotFinite("feedforward coefficients"))?;

    let mut model = Vec::with_capacity(lines.used.len());
    for line in &lines.used {
        let gff = feedforward.numerator().eval(line.z) * line.z.powi(-(order as i32));
        let (dfb, nfb) = (feedback.denominator().eval(line.z), feedback.numerator().eval(line.z));
        let control = (&dfb + &nfb * &line.fed_back).lu().solve(&(nfb + dfb * gff));
        model.push(&line.measured * control.ok_or(MimoError::NotFinite("closed loop"))?);
    }
    let cost_of_coefficients = lines
        .used
        .iter()
        .zip(&model)
        .map(|(line, g)| line.weight * (g - &line.response).iter().map(|v| v.norm_sqr()).sum::<f64>())
        .sum();
    let (upper, last) = optimum.coefficients.split_at(pool.controls() - 1);
    let polynomial = tester.last_row(upper).polynomial(&last[0]);
    let mut identified = Identified {
        identifiability: identifiability(lines, pool, &feedback, feedforward.numerator(), order),
        closed_loop_poles: Polynomial::new(polynomial).roots()?,
        feedback,
        feedforward,
        listed: listed as u64,
        cost_of_coefficients,
        unreachable_cost: lines.unreachable,
        radius,
        lines: lines.used.iter().cloned().zip(model).collect(),
        dropped: lines.dropped.clone(),
        findings: Vec::new(),
        optimum,
    };
    identified.findings = findings(&identified, plant, settings);
    Ok(identified)
}

/// A singular value below this share of the largest one of a Popov–Belevitch–Hautus matrix is zero.
const HIDDEN: f64 = 1e-9;

/// Modes of the plant on or outside a radius that the controls do not move or the fed-back outputs do not show
/// (Popov, Belevitch and Hautus): no feedback changes them.
fn hidden_modes(plant: &Plant, radius: f64) -> Vec<Complex64> {
    let Ok(model) = plant.system.to_state_space().map(|m| m.balanced()) else { return Vec::new() };
    let (n, m) = (model.states(), model.inputs());
    let c = model.c().select_rows(&plant.fed_back);
    let is_rank_deficient = |matrix: DMatrix<Complex64>| {
        let (rows, columns) = matrix.shape();
        let real = DMatrix::from_fn(2 * rows, 2 * columns, |i, j| {
            let v = matrix[(i % rows, j % columns)];
            match (i < rows, j < columns) {
                (true, true) | (false, false) => v.re,
                (true, false) => -v.im,
                (false, true) => v.im,
            }
        });
        linalg::singular_values(&real).is_ok_and(|values| {
            let (largest, smallest) = (values.first().copied(), values.last().copied());
            smallest.unwrap_or(0.0) <= HIDDEN * largest.unwrap_or(0.0)
        })
    };
    let complex = |v: f64| Complex64::new(v, 0.0);
    let Ok(poles) = model.poles() else { return Vec::new() };
    poles
        .into_iter()
        .filter(|pole| pole.norm() >= radius)
        .filter(|pole| {
            let shifted = |i: usize, j: usize| complex(-model.a()[(i, j)]) + if i == j { *pole } else { complex(0.0) };
            let controls =
                DMatrix::from_fn(n, n + m, |i, j| if j < n { shifted(i, j) } else { complex(model.b()[(i, j - n)]) });
            let outputs =
                DMatrix::from_fn(n + c.nrows(), n, |i, j| if i < n { shifted(i, j) } else { complex(c[(i - n, j)]) });
            is_rank_deficient(controls) || is_rank_deficient(outputs)
        })
        .collect()
}
