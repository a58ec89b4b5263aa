//! Why nothing is identified from several inputs and outputs.

use super::pool::MOST_CONTROLS;
use crate::ctl::Stopped;
use crate::identify::basis::TooFewLines;
use crate::identify::problem::{Dropped, Unusable};
use crate::num::linalg::NoConvergence;
use num_complex::Complex64;

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
    /// Fewer outputs than controls, and the lines do not determine the feedforward.
    #[error(
        "Gy is {measured}x{controls}: with fewer measured outputs than controls each line tells less than there is to \
         know, and all lines together leave feedforwards of this order with the same response (the matrix Ω₂ of Zhang \
         2015, proposition 4.1, is rank deficient at the best feedback)"
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
        "row {row} (counted from 0) of the feedback has a numerator of degree {numerator} over a denominator of degree \
         {denominator}, and {why}: Gfb Gv must be strictly proper (Zhang 2015, assumption A3.1)"
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
        "{lines} lines of {measured}x{fed_back} responses and {unknowns} unknown coefficients make a matrix of \
         derivatives with {entries} entries; at most {MOST_DERIVATIVES} are taken"
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
    #[error("none of the {listed} feedback candidates has a stable closed loop within |z| < \
        {radius}{}", hidden_text(.hidden))]
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
pub(super) fn grouped(dropped: &[Dropped]) -> Vec<(&'static str, &'static str, String)> {
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
