//! Whether the command alone tells feedback and feedforward apart.
//!
//! From the command one response is measured, and two controllers are asked for: `H = G (Gff + Gfb)/(1 + G Gfb)`. Any
//! feedback controller fits any data if the feedforward controller is free; only the degrees of both tell them apart
//! (Zhang 2015, example 2.1). How well they do is read from the derivatives of the modelled response at the lines. With
//! `Q = 1/(Dfb + G Nfb)`: `∂G̃/∂Gff = G Dfb Q`, by the feedback numerator's coefficients `G (1 − G Gff) Dfb Q² xⁱ`, by
//! the denominator's `−G (1 − G Gff) Nfb Q² xⁱ`; all are finite at a feedback pole.

use super::held::Held;
use super::problem::Problem;
use crate::control::System;
use crate::num::linalg;
use nalgebra::DMatrix;
use num_complex::Complex64;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How well the lines determine the coefficients near the identified ones.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Identifiability {
    /// Free coefficients: feedforward numerator and denominator, feedback numerator and denominator.
    pub unknowns: usize,
    /// Real equations: two per line, one where everything is real (0 Hz).
    pub equations: usize,
    /// Condition number of the derivatives of the response by all coefficients, each scaled to unit length; null where
    /// there are more unknowns than equations, or a coefficient has no effect.
    pub condition_number: Option<f64>,
    /// Sine of the smallest angle between what a change of feedback does to the response and what a change of
    /// feedforward can do: 1 where they are unlike, 0 where feedforward can undo a change of feedback, so that the data
    /// do not tell them apart. Null where the feedback is zero, where a controller is held at zero, or where there are
    /// more unknowns than equations.
    pub separation: Option<f64>,
}

/// A function of the coefficients at the lines as a real column, scaled to unit length; `None` if it vanishes.
fn column(values: impl Iterator<Item = Complex64>) -> Option<Vec<f64>> {
    let (re, im): (Vec<f64>, Vec<f64>) = values.map(|v| (v.re, v.im)).unzip();
    let mut column = [re, im].concat();
    let norm = column.iter().map(|v| v * v).sum::<f64>().sqrt();
    if !(norm > 0.0 && norm.is_finite()) {
        return None;
    }
    column.iter_mut().for_each(|v| *v /= norm);
    Some(column)
}

/// The columns `factor · xⁱ` for `i` below `count`.
fn powers(problem: &Problem, factor: &[Complex64], count: usize) -> Vec<Option<Vec<f64>>> {
    let points: Vec<Complex64> = problem.lines().iter().map(|l| problem.time().point(l.omega_rad_s)).collect();
    (0..count as u32).map(|power| column(factor.iter().zip(&points).map(|(f, x)| f * x.powu(power)))).collect()
}

fn matrix(columns: &[Vec<f64>]) -> DMatrix<f64> {
    DMatrix::from_fn(columns[0].len(), columns.len(), |i, j| columns[j][i])
}

/// The structure that the pool gives the controllers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Structure {
    /// Degree of the feedforward numerator.
    pub feedforward_numerator: usize,
    /// Whether the feedforward denominator is free (it is not in an FIR filter).
    pub feedforward_denominator_is_free: bool,
    /// Degree of the feedforward denominator.
    pub feedforward_denominator: usize,
    /// Degree of the feedback numerator.
    pub feedback_numerator: usize,
    /// Degree of the feedback denominator.
    pub feedback_denominator: usize,
    /// The controller that is held at zero, whose degrees say nothing.
    pub held: Option<Held>,
}

impl Structure {
    /// The number of free coefficients.
    #[must_use]
    pub fn unknowns(&self) -> usize {
        self.feedforward_unknowns() + self.feedback_unknowns()
    }

    /// The free coefficients of the feedforward.
    #[must_use]
    pub fn feedforward_unknowns(&self) -> usize {
        let denominator = if self.feedforward_denominator_is_free { self.feedforward_denominator } else { 0 };
        if self.held == Some(Held::Feedforward) { 0 } else { self.feedforward_numerator + 1 + denominator }
    }

    /// The free coefficients of the feedback.
    #[must_use]
    pub fn feedback_unknowns(&self) -> usize {
        let all = self.feedback_numerator + 1 + self.feedback_denominator;
        if self.held == Some(Held::Feedback) { 0 } else { all }
    }
}

/// The number of real equations that the lines give.
#[must_use]
pub fn equations(problem: &Problem) -> usize {
    problem
        .lines()
        .iter()
        .map(
            |line| {
                if problem.time().point(line.omega_rad_s).im.abs() < 1e-12 && line.omega_rad_s == 0.0 { 1 } else { 2 }
            },
        )
        .sum()
}

/// Judges the derivatives at identified controllers.
#[must_use]
pub fn judge(problem: &Problem, structure: Structure, feedforward: &System, feedback: &System) -> Identifiability {
    let (equations, unknowns) = (equations(problem), structure.unknowns());
    let mut judged = Identifiability { unknowns, equations, condition_number: None, separation: None };
    if unknowns > equations {
        return judged;
    }
    let at = |system: &System| {
        (problem.at_lines(system.num().coefficients()), problem.at_lines(system.den().coefficients()))
    };
    let ((n_ff, d_ff), (n_fb, d_fb)) = (at(feedforward), at(feedback));
    let mut factors: [Vec<Complex64>; 4] = Default::default();
    for (k, line) in problem.lines().iter().enumerate() {
        let (root_weight, g) = (line.weight.sqrt(), line.plant);
        let q = 1.0 / (d_fb[k] + g * n_fb[k]);
        let by_feedforward = root_weight * g * d_fb[k] * q;
        let by_feedback = root_weight * g * (1.0 - g * n_ff[k] / d_ff[k]) * q * q;
        factors[0].push(by_feedforward / d_ff[k]);
        factors[1].push(-by_feedforward * n_ff[k] / (d_ff[k] * d_ff[k]));
        factors[2].push(by_feedback * d_fb[k]);
        factors[3].push(-by_feedback * n_fb[k]);
    }
    let free = if structure.feedforward_denominator_is_free { structure.feedforward_denominator } else { 0 };
    let (mut ff, mut fb) = (Vec::new(), Vec::new());
    if structure.held != Some(Held::Feedforward) {
        ff.extend(powers(problem, &factors[0], structure.feedforward_numerator + 1));
        ff.extend(powers(problem, &factors[1], free));
    }
    if structure.held != Some(Held::Feedback) {
        fb.extend(powers(problem, &factors[2], structure.feedback_numerator + 1));
        fb.extend(powers(problem, &factors[3], structure.feedback_denominator));
    }
    if let Some(all) = ff.iter().chain(&fb).cloned().collect::<Option<Vec<_>>>()
        && let Ok(values) = linalg::singular_values(&matrix(&all))
        && let (Some(largest), Some(smallest)) = (values.first(), values.last())
        && *smallest > 0.0
    {
        judged.condition_number = Some(largest / smallest);
    }
    let ff: Vec<Vec<f64>> = ff.into_iter().flatten().collect();
    let fb: Option<Vec<Vec<f64>>> = fb.into_iter().collect();
    if let Some(fb) = fb.filter(|fb| !ff.is_empty() && !fb.is_empty()) {
        let (own, other) = (matrix(&fb).qr().q(), matrix(&ff).qr().q());
        let apart = &own - &other * (other.transpose() * &own);
        judged.separation =
            linalg::singular_values(&apart).ok().and_then(|values| values.last().copied()).map(|sine| sine.min(1.0));
    }
    judged
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::{Continuous, TransferFunction};
    use crate::identify::problem::Lines;

    fn tf(num: &[f64], den: &[f64]) -> System {
        System::Continuous(TransferFunction::new(num, den, Continuous).unwrap())
    }

    fn judge_on(plant: &System, ff: &System, fb: &System, structure: Structure) -> Identifiability {
        let omega: Vec<f64> = (1..=20).map(|k| 0.2 * std::f64::consts::PI * f64::from(k)).collect();
        let h: Vec<Complex64> = omega
            .iter()
            .map(|w| {
                let (g, ff, fb) = (plant.response(*w), ff.response(*w), fb.response(*w));
                g * (ff + fb) / (1.0 + g * fb)
            })
            .collect();
        let problem = Problem::new(&Lines::new(plant, &omega, &h, None), structure.feedforward_numerator).unwrap();
        judge(&problem, structure, ff, fb)
    }

    #[test]
    fn a_structure_that_separates_is_told_from_one_that_does_not() {
        let first_order = Structure {
            feedforward_numerator: 1,
            feedforward_denominator_is_free: true,
            feedforward_denominator: 1,
            feedback_numerator: 0,
            feedback_denominator: 1,
            held: None,
        };
        // The example of section 2.6 is identifiable, as the thesis shows.
        let good =
            judge_on(&tf(&[4.0], &[1.0, 2.0]), &tf(&[2.1, 3.0], &[1.0, 6.5]), &tf(&[5.4], &[1.0, 7.1]), first_order);
        assert!(good.separation.unwrap() > 1e-4 && good.condition_number.unwrap() < 1e5, "{good:?}");
        // A feedforward of degree 6 over 6 can undo any change of a feedback of degree 1 (the closed loop has degree
        // 3).
        let free = Structure { feedforward_numerator: 6, feedforward_denominator: 6, ..first_order };
        let ff = tf(&[1.0, 9.0, 30.0, 60.0, 70.0, 50.0, 20.0], &[1.0, 12.0, 60.0, 160.0, 240.0, 192.0, 64.0]);
        let poor = judge_on(&tf(&[4.0], &[1.0, 2.0]), &ff, &tf(&[5.4], &[1.0, 7.1]), free);
        assert!(poor.separation.unwrap() < 0.1 * good.separation.unwrap(), "{poor:?} {good:?}");
    }

    #[test]
    fn no_feedback_has_no_separation() {
        let structure = Structure {
            feedforward_numerator: 1,
            feedforward_denominator_is_free: true,
            feedforward_denominator: 1,
            feedback_numerator: 0,
            feedback_denominator: 1,
            held: None,
        };
        let none =
            judge_on(&tf(&[4.0], &[1.0, 2.0]), &tf(&[2.1, 3.0], &[1.0, 6.5]), &tf(&[0.0], &[1.0, 7.1]), structure);
        assert_eq!((none.separation, none.condition_number), (None, None));
    }
}
