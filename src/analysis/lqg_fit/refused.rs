//! What is refused by name: records that do not tell what a spec asks.

use super::spec::{LqgFitInitialState, LqgFitSpec};
use crate::analysis::problem::Problem;
use crate::analysis::reading::{wrong_inputs, wrong_spec as wrong};
use crate::control::lyapunov::Clock;
use crate::control::structural::{self, StructuralError};
use crate::likelihood::lqg::{Design, Recorded, Role, Start, Term, Timing};
use crate::num::linalg;
use nalgebra::{DMatrix, DVector};

/// A noise of the motor that process noise covers up to this share cannot be told from it.
const COVERED: f64 = 1e-6;
/// A mode that no control reaches may grow by this in a sample.
const GROWTH: f64 = 1e-9;

/// Refuses what records of this design cannot tell, by name.
pub(super) fn check(design: &Design, spec: &LqgFitSpec) -> Result<(), Problem> {
    let Recorded { rows, instrument, control, is_applied } = &design.recorded;
    let [_, _, p, _] = design.sizes();
    let terms = &design.terms;
    let is_exact = |noise: &DMatrix<f64>| noise.clone().cholesky().is_none();
    let of_senses = terms.iter().filter(|t| t.role == Role::MeasurementNoise && t.held != Some(0.0));
    let v = of_senses.fold(DMatrix::zeros(p, p), |sum, term| sum + &term.shape);
    if instrument.is_none() && rows.is_some() {
        return Err(wrong(
            "other outputs were recorded than those that are sensed, and nothing is said of the instrument",
            "/spec/instrument_variance",
        )
        .mend("Give its covariance, zero where it is exact."));
    }
    if instrument.is_none() && is_exact(&v) {
        return Err(wrong(
            "an output that is sensed without noise leaves nothing to predict",
            "/spec/measurement_noise",
        )
        .mend("Give every output a noise, or the variance of the instrument that recorded it."));
    }
    let u_is_exact = control.as_ref().is_some_and(is_exact) && !(*is_applied && design.has(Role::MotorNoise));
    if u_is_exact && instrument.is_none() {
        return Err(wrong(
            "the control and what the person sensed are both recorded exactly: the belief is then known, and any \
             misfit impossible",
            "/spec/control_variance",
        )
        .mend(
            "Give the variance of what recorded the control, or of the instrument that recorded the outputs \
             (instrument_variance).",
        ));
    }
    if spec.initial_state == LqgFitInitialState::FirstSample && instrument.as_ref().is_none_or(|v| v.amax() > 0.0) {
        return Err(wrong("the first sample is the first state only where outputs are exact", "/spec/initial_state")
            .mend("Say that the instrument is exact (instrument_variance of zeros), or give the initial states."));
    }
    if let Some(instrument) = instrument.as_ref().filter(|noise| is_exact(noise)) {
        // What is recorded exactly must be moved by noise at every sample, or its density is none.
        let b = &design.plant.b;
        let moved = terms.iter().filter(|t| t.held != Some(0.0)).filter_map(|t| match t.role {
            Role::ProcessNoise => Some(t.shape.clone()),
            Role::MotorNoise | Role::ControlDependentNoise => Some(b * &t.shape * b.transpose()),
            _ => None,
        });
        let moved = moved.fold(&design.plant.a * 0.0, |sum, m| sum + m);
        let [shown, _] = design.recorded_rows();
        if is_exact(&(shown * moved * shown.transpose() + instrument)) {
            return Err(wrong(
                "an output is recorded exactly, and no noise moves it between samples: nothing is left to predict",
                "/spec/instrument_variance",
            )
            .mend("Give the instrument's covariance, or a process noise that moves every recorded output."));
        }
    }
    let is_settled = design.start == Start::Settled;
    if is_settled && design.horizon.is_some() {
        return Err(wrong("a horizon that ends has no steady state to start from", "/spec/initial_state")
            .mend("Let the trials start at rest, at the first sample, or at given states."));
    }
    for (plant, member) in [(&design.plant, "plant"), (design.internal(), "internal_model")] {
        let stabilisable = structural::check_stabilisable(&plant.a, &plant.b, Clock::Sampled);
        if let Err(StructuralError::NotStabilisable(mode)) = stabilisable {
            let at = format!("/inputs/{member}");
            if mode.norm() > 1.0 + GROWTH {
                let detail = format!("no control reaches the mode {mode:.4} of the {member}, which grows by itself");
                return Err(wrong_inputs(detail, at));
            }
            if is_settled && member == "plant" {
                let detail = format!(
                    "no control reaches the mode {mode:.4} of the plant, such as a target's, which never settles"
                );
                return Err(wrong(detail, "/spec/initial_state")
                    .mend("Let the trials start at rest, at the first sample, or at given states."));
            }
        }
    }
    grown(design, spec)?;
    covered(terms, &design.plant.b, *is_applied)?;
    Ok(())
}

/// Refuses what noise that grows with the control is not modelled with, or hides.
fn grown(design: &Design, spec: &LqgFitSpec) -> Result<(), Problem> {
    let Some(noise) = &spec.control_dependent_noise else { return Ok(()) };
    let name = &noise.name;
    if design.timing == Timing::Filter {
        return Err(wrong(
            format!("gains under {name} are those of a person whose control rests on what was sensed a sample before"),
            "/spec/belief",
        )
        .mend("Take {\"belief\": \"predicted\"}."));
    }
    if design.recorded.is_applied && design.recorded.control.is_some() {
        return Err(wrong(format!("an applied control that {name} is part of is not modelled"), "/spec/control")
            .mend("Leave the control out of the fit, or record the command."));
    }
    if design.horizon.is_none() || noise.held.is_some() {
        return Ok(());
    }
    let free = |role: Role| design.terms.iter().filter(move |t| t.role == role && t.held.is_none());
    let b = &design.plant.b;
    let moved = free(Role::MotorNoise).map(|t| (t, b * &t.shape * b.transpose(), "motor_noise"));
    let process = free(Role::ProcessNoise).map(|t| (t, t.shape.clone(), "process_noise"));
    for (term, moved, member) in moved.chain(process) {
        // Additive noise that enters where the control does.
        let left = &moved - b * least_squares(b, &moved);
        if left.norm() <= COVERED * moved.norm() {
            let detail = format!(
                "{} and {name} are not told apart in reaches: noise that grows with the control hides what is added",
                term.name
            );
            return Err(
                wrong(detail, format!("/spec/{member}")).mend(format!("Hold one of them, such as {}.", term.name))
            );
        }
    }
    Ok(())
}

/// The least-squares solution of `BX = M`.
fn least_squares(b: &DMatrix<f64>, m: &DMatrix<f64>) -> DMatrix<f64> {
    b.clone().svd(true, true).solve(m, 1e-12).unwrap_or_else(|_| DMatrix::zeros(b.ncols(), m.ncols()))
}

/// Refuses a noise of the motor that the process noise covers: only `W + BMBᵀ` shows, unless the applied control is
/// recorded.
fn covered(terms: &[Term], b: &DMatrix<f64>, is_applied: bool) -> Result<(), Problem> {
    let free = |role: Role| terms.iter().filter(move |t| t.role == role && t.held.is_none() && t.same_as.is_none());
    let process: Vec<DVector<f64>> =
        free(Role::ProcessNoise).map(|term| DVector::from_column_slice(term.shape.as_slice())).collect();
    if is_applied || process.is_empty() {
        return Ok(());
    }
    for term in free(Role::MotorNoise) {
        let moved = b * &term.shape * b.transpose();
        let moved = DVector::from_column_slice(moved.as_slice());
        let (u, sigma, _) = linalg::svd(&DMatrix::from_columns(&process))
            .map_err(|error| wrong(error.to_string(), "/spec/process_noise"))?;
        let largest = sigma.first().copied().unwrap_or(0.0);
        let rank = sigma.iter().filter(|s| **s > 1e-10 * largest).count();
        let basis = u.columns(0, rank);
        let left = &moved - basis * basis.tr_mul(&moved);
        if left.norm() <= COVERED * moved.norm() {
            return Err(wrong(
                format!(
                    "{} and the process noise cannot be told apart: only their sum W + BMBᵀ moves what was recorded",
                    term.name
                ),
                "/spec/motor_noise",
            )
            .mend("Record the applied control, hold one of both, or leave the motor's noise to the process noise."));
        }
    }
    Ok(())
}
