//! From a known plant and the closed loop's frequency response to feedforward and feedback.

use super::diagnose::identifiability;
use super::exact::Problem;
use super::lines::{Line, Lines, MatrixFrequencyData};
use super::pool::{FeedbackPool, MOST_CONTROLS};
use super::search::{Optimum, search};
use super::stability::Tester;
use crate::control::{Discrete, LeftFraction, Multivariable, PolynomialMatrix};
use crate::identify::basis::TooFewLines;
use crate::identify::identifiability::Identifiability;
use crate::identify::problem::{Dropped, Unusable};
use crate::identify::search::NEAR;
use crate::identify::ssid::{Finding, Weights};
use crate::num::linalg::{self, NoConvergence};
use crate::num::{Ctl, Polynomial, Stopped};
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

/// The largest plant: determinants of degree n lose their digits as n grows.
pub const MOST_STATES: usize = 40;

/// Entries of the matrix of derivatives, of which singular values are taken.
pub const MOST_DERIVATIVES: usize = 4_000_000;

/// Why nothing was identified.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MimoError {
    /// Somebody asked it to stop.
    #[error(transparent)]
    Stopped(#[from] Stopped),
    /// An output that the plant does not have, or none.
    #[error("{list} names output {output} (counted from 0), and the plant has {outputs}")]
    Output {
        /// `measured_outputs` or `fed_back_outputs`.
        list: &'static str,
        /// The output.
        output: usize,
        /// Outputs of the plant.
        outputs: usize,
    },
    /// A list without outputs, or with one twice.
    #[error("{list} is empty or names an output twice: {given:?}")]
    OutputList {
        /// `measured_outputs` or `fed_back_outputs`.
        list: &'static str,
        /// The list.
        given: Vec<usize>,
    },
    /// The pool's feedback does not fit the plant.
    #[error(
        "the feedback of the pool is {rows}x{columns}, and must be {controls}x{fed_back}: \
         the plant has {controls} inputs, and {fed_back} outputs are fed back"
    )]
    PoolSize {
        /// Rows of the feedback numerator.
        rows: usize,
        /// Columns of it.
        columns: usize,
        /// Inputs of the plant.
        controls: usize,
        /// Fed-back outputs.
        fed_back: usize,
    },
    /// A response that does not fit the plant.
    #[error(
        "the response h at line {line} (counted from 0) is {rows}x{columns}, and must be {measured}x{fed_back}: \
         measured outputs by commands, one for each fed-back output"
    )]
    ResponseSize {
        /// The line.
        line: usize,
        /// Its rows.
        rows: usize,
        /// Its columns.
        columns: usize,
        /// Measured outputs.
        measured: usize,
        /// Fed-back outputs.
        fed_back: usize,
    },
    /// Fewer outputs than controls: the feedforward is not determined.
    #[error(
        "Gy is {measured}x{controls}: with fewer measured outputs than controls, several feedforwards have the same response \
         (Zhang 2015, proposition 4.1)"
    )]
    FewOutputs {
        /// Measured outputs.
        measured: usize,
        /// Controls.
        controls: usize,
    },
    /// Too many controls or states.
    #[error("the plant has {controls} inputs and {states} states; at most {MOST_CONTROLS} and {MOST_STATES} are taken")]
    TooLarge {
        /// Inputs.
        controls: usize,
        /// States.
        states: usize,
    },
    /// The loop has no delay.
    #[error(
        "row {row} (counted from 0) of the feedback has a numerator of degree {numerator} over a denominator of degree {denominator}, \
         and {why}: Gfb Gv must be strictly proper (Zhang 2015, assumption A3.1)"
    )]
    NotStrictlyProper {
        /// The row, from 0.
        row: usize,
        /// Degree of the numerator.
        numerator: usize,
        /// Degree of the denominator.
        denominator: usize,
        /// Why that is too much.
        why: &'static str,
    },
    /// The pool is larger than allowed.
    #[error("the pool lists {listed} feedback candidates, and at most {limit} are tried")]
    Unaffordable {
        /// Candidates.
        listed: u128,
        /// The limit.
        limit: u64,
    },
    /// More data and coefficients than their diagnosis can hold.
    #[error(
        "{lines} lines of {measured}x{fed_back} responses and {unknowns} unknown coefficients make a matrix of derivatives with \
         {entries} entries; at most {MOST_DERIVATIVES} are taken"
    )]
    TooManyDerivatives {
        /// Lines given.
        lines: usize,
        /// Rows of the response.
        measured: usize,
        /// Columns of the response.
        fed_back: usize,
        /// Unknown coefficients.
        unknowns: usize,
        /// Entries of the matrix of derivatives.
        entries: usize,
    },
    /// Weights by variance without variances.
    #[error("the data have no variance, which the weights need")]
    NoVariance,
    /// None of the lines can be used.
    #[error("none of the {lines} frequency lines can be used: {}", reasons(.dropped))]
    NoLine {
        /// Lines given.
        lines: usize,
        /// Why each was dropped.
        dropped: Vec<Dropped>,
    },
    /// The lines do not determine the feedforward.
    #[error(transparent)]
    TooFewLines(#[from] TooFewLines),
    /// Fewer equations than unknowns: every pool would fit.
    #[error("the {lines} usable frequency lines give {equations} equations for {unknowns} unknown coefficients")]
    Underdetermined {
        /// Usable lines.
        lines: usize,
        /// Real equations.
        equations: usize,
        /// Unknown coefficients.
        unknowns: usize,
    },
    /// No candidate stabilises the plant.
    #[error("none of the {listed} feedback candidates has a stable closed loop within |z| < {radius}{}", hidden_text(.hidden))]
    NoneStable {
        /// Candidates.
        listed: u128,
        /// Radius.
        radius: f64,
        /// Plant modes on or outside the radius that the fed-back outputs do not see or the controls do not move.
        hidden: Vec<Complex64>,
    },
    /// The closed-loop poles were not found.
    #[error(transparent)]
    NoConvergence(#[from] NoConvergence),
    /// Data or a result overflows.
    #[error("not finite: {0}")]
    NotFinite(&'static str),
}

fn hidden_text(hidden: &[Complex64]) -> String {
    let words: Vec<String> = hidden.iter().map(|z| format!("{:.4}{:+.4}j", z.re, z.im)).collect();
    if words.is_empty() {
        String::new()
    } else {
        format!(
            "; the plant has modes at z = {} that no feedback from the fed-back outputs moves \
             (a matrix of transfer functions counts a mode once for each column)",
            words.join(", ")
        )
    }
}

fn reason(why: Unusable) -> (&'static str, &'static str) {
    match why {
        Unusable::PlantPole => ("line_on_plant_pole", "a plant pole lies there"),
        Unusable::PlantZero => (
            "line_with_singular_plant",
            "Gy does not have full column rank there, so that some controls have no effect that is measured",
        ),
        Unusable::NoResponse => ("line_without_response", "there is no finite response"),
        Unusable::NoWeight => ("line_without_weight", "its variance gives no positive weight"),
        Unusable::AboveNyquist => ("line_above_nyquist", "it lies above the Nyquist frequency"),
    }
}

/// For each reason its code, its words and the frequencies (rad/s) dropped for it.
fn grouped(dropped: &[Dropped]) -> Vec<(&'static str, &'static str, String)> {
    let all =
        [Unusable::PlantPole, Unusable::PlantZero, Unusable::NoResponse, Unusable::NoWeight, Unusable::AboveNyquist];
    all.into_iter()
        .filter_map(|why| {
            let lines: Vec<String> =
                dropped.iter().filter(|d| d.why == why).map(|d| format!("{:.5}", d.omega_rad_s)).collect();
            let (code, words) = reason(why);
            (!lines.is_empty()).then(|| (code, words, lines.join(", ")))
        })
        .collect()
}

fn reasons(dropped: &[Dropped]) -> String {
    let parts: Vec<String> =
        grouped(dropped).into_iter().map(|(_, words, lines)| format!("at {lines} rad/s {words}")).collect();
    parts.join("; ")
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

/// Below this separation, or above this condition number, feedback and feedforward count as confounded.
const POOR_SEPARATION: f64 = 0.02;
const POOR_CONDITION: f64 = 1e4;

/// Below this separation they cannot be told apart at all.
const NO_SEPARATION: f64 = 1e-8;

/// Relative difference between J by least squares and J of the reported coefficients that is worth a warning.
const COST_MISMATCH: f64 = 1e-6;

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
    if measured < controls {
        return Err(MimoError::FewOutputs { measured, controls });
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

fn findings(found: &Identified, plant: &Plant, settings: &Settings) -> Vec<Finding> {
    let pool = &settings.pool;
    let mut findings = Vec::new();
    let mut say = |code: &'static str, message: String| findings.push(Finding { code, message });
    for (code, words, lines) in grouped(&found.dropped) {
        say(code, format!("left out at {lines} rad/s: {words}"));
    }
    // Two closed loops differ by a rational matrix whose numerator has at most this degree (after Zhang 2015, proposition 4.3).
    let wanted = 2 * (plant.system.states() + pool.states()) + settings.feedforward_order;
    if found.lines.len() <= wanted {
        say(
            "few_lines",
            format!(
                "{} frequency lines; more than {wanted} are needed to make sure that controllers with the same response at the lines \
                 have the same closed loop (Zhang 2015, proposition 4.3)",
                found.lines.len()
            ),
        );
    }
    let is_zero = found.feedback.numerator().to_nested().iter().flatten().flatten().all(|c| *c == 0.0);
    if is_zero {
        say(
            "zero_feedback",
            "the best candidate has no feedback at all; its feedback denominator means nothing".to_owned(),
        );
    }
    let judged = &found.identifiability;
    let numbers = format!(
        "separation {} (1: unlike, 0: confounded), condition number {}",
        judged.separation.map_or_else(|| "undefined".to_owned(), |s| format!("{s:.2e}")),
        judged.condition_number.map_or_else(|| "undefined".to_owned(), |c| format!("{c:.2e}")),
    );
    let has_free = pool.rows().iter().flat_map(|row| &row.coefficients).any(|c| c.values.len() > 1);
    let poor = judged.separation.is_some_and(|s| s < POOR_SEPARATION)
        || judged.condition_number.is_none_or(|c| c > POOR_CONDITION);
    if judged.separation.is_some_and(|s| s < NO_SEPARATION) {
        say(
            "feedback_not_determined",
            format!(
                "a change of the feedback can be undone by the feedforward, so that the response is the same whatever the feedback is \
                 (Zhang 2015, example 4.1): {numbers}. Of all such feedbacks of the pool the first one is reported"
            ),
        );
    } else if poor && has_free && !is_zero {
        say(
            "feedback_poorly_determined",
            format!(
                "the response to the commands cannot tell two controllers apart but by their assumed degrees, and here it hardly does: {numbers}. \
                 Feedback and feedforward of much the same cost may differ a lot"
            ),
        );
    } else {
        say(
            "feedback_from_structure",
            format!(
                "feedback and feedforward are told apart only by their assumed degrees (Zhang 2015, example 4.1 and assumption A3.5); {numbers}. \
                 They describe the modelled loop on the known plant, which is no proof about the person"
            ),
        );
    }
    let optimum = &found.optimum;
    if optimum.near_optimal > 1 {
        say(
            "near_optimal_candidates",
            format!(
                "{}{} candidates of the pool cost at most {:.0} % more than the best one, or cannot be told from it by rounding",
                if optimum.near_optimal_is_capped { "more than " } else { "" },
                optimum.near_optimal,
                100.0 * NEAR
            ),
        );
    }
    if !optimum.fit.is_unique {
        say(
            "feedforward_not_unique",
            "with this feedback the lines do not determine every feedforward coefficient; dependent ones were set to 0"
                .to_owned(),
        );
    }
    for edge in pool.edges(&optimum.coefficients) {
        say(
            "edge_of_pool",
            format!("the best candidate lies on the edge of the pool: {edge}; a wider pool may hold a better one"),
        );
    }
    let mismatch = (found.cost_of_coefficients - optimum.fit.cost).abs();
    let scale: f64 =
        found.lines.iter().map(|(line, _)| line.weight * line.response.iter().map(|v| v.norm_sqr()).sum::<f64>()).sum();
    if mismatch > COST_MISMATCH * optimum.fit.cost && mismatch > 1e-12 * scale {
        say(
            "ill_conditioned_coefficients",
            format!(
                "the coefficients as written give the cost {:.6e} instead of {:.6e}: the feedforward is too high in order \
                 for its lines to be written in powers of 1/z",
                found.cost_of_coefficients, optimum.fit.cost
            ),
        );
    }
    findings
}
