//! What a trial and its lines give to every bound.

use crate::identify::problem::Problem;
use num_complex::Complex64;

/// One line of a trial.
#[derive(Debug, Clone, Copy)]
pub(super) struct Constant {
    /// `(1 − H) √weight`.
    pub error: Complex64,
    /// √weight.
    pub root: f64,
    /// `G √weight`, turned by the angle at which the numerator's basis splits into a real and an imaginary half.
    pub plant: Complex64,
}

/// A trial at its lines.
#[derive(Debug)]
pub(super) struct Lines {
    pub constants: Vec<Constant>,
    /// Norm of the weighted error and of one: a unit in which nothing is too large or small for single precision.
    pub scale: f64,
}

impl Lines {
    pub(super) fn new(problem: &Problem) -> Self {
        let constants: Vec<Constant> = problem
            .lines()
            .iter()
            .map(|line| {
                let root = line.weight.sqrt();
                let turn = Complex64::from_polar(1.0, -problem.basis().rotation(line.omega_rad_s));
                Constant { error: (1.0 - line.response) * root, root, plant: line.plant * turn * root }
            })
            .collect();
        let scale = constants.iter().map(|c| c.error.norm_sqr() + c.root * c.root).sum::<f64>().sqrt();
        Self { constants, scale }
    }
}

/// What a unit of magnitude may lose by rounding in double precision, before the condition.
pub(super) fn rounding(lines: &Lines) -> f64 {
    32.0 * (2 * lines.constants.len() + 32) as f64 * f64::EPSILON
}
