//! A recorded target that is conditioned on: what moves it by itself need not be known.
//!
//! The target leaves the plant's states and becomes what the experimenter does: of `x⁺ = Ax`, `y = Cx` its column of A
//! and of C is what it does to the others. The person goes on having it among the states of the model.

use super::signals::Sampled;
use crate::analysis::problem::Problem;
use crate::analysis::reading::{wrong_inputs, wrong_spec as wrong};
use crate::likelihood::lqg::{Plant, Role, Term};
use nalgebra::DMatrix;

/// A fit without the target's own state.
pub(super) struct Conditioned {
    pub sampled: Sampled,
    pub internal: Option<Plant>,
    pub terms: Vec<Term>,
}

/// The plant without this state, which the disturbance records.
///
/// # Errors
/// A [`Problem`] where the state does not move by itself, or something else is recorded as the disturbance.
pub(super) fn conditioned(
    state: usize,
    written: &Sampled,
    internal: Option<Plant>,
    terms: &[Term],
) -> Result<Conditioned, Problem> {
    let Plant { a, b, c, d, e } = &written.plant;
    let n = a.nrows();
    if state >= n || n < 2 {
        let detail = format!("the target is state {state}, and the plant has {n}, of which one at least is no target");
        return Err(wrong(detail, "/spec/target/state"));
    }
    let others = (0..n).filter(|j| *j != state);
    if b.row(state).amax() > 0.0 || others.clone().any(|j| a[(state, j)] != 0.0) {
        let detail = format!("state {state} does not move by itself: the control or another state moves it");
        return Err(wrong(detail, "/spec/target/state"));
    }
    // By default the disturbance is added to the control; a target's has no place in the plant.
    if (e != b && e.amax() > 0.0) || d.amax() > 0.0 {
        return Err(wrong_inputs(
            "the disturbance is the recorded target, and cannot move the plant otherwise",
            "/inputs/plant/e",
        )
        .mend("Leave e and d out."));
    }
    let kept: Vec<usize> = others.collect();
    let rows = |m: &DMatrix<f64>| m.select_rows(&kept);
    let columns = |m: &DMatrix<f64>| m.select_columns(&kept);
    let of_target = |m: &DMatrix<f64>| m.columns(state, 1).into_owned();
    let plant = Plant { a: columns(&rows(a)), b: rows(b), c: columns(c), e: of_target(&rows(a)), d: of_target(c) };
    let recorded = written.recorded.as_ref().map(|c| (columns(c), of_target(c)));
    if let Some((c, through)) = &recorded {
        let is_target = |i: usize| c.row(i).amax() == 0.0;
        if let Some(i) = (0..c.nrows()).find(|i| is_target(*i)) {
            let detail = format!("recorded output {i} is the target itself, which is conditioned on");
            return Err(wrong_inputs(detail, "/inputs/plant/c_recorded").mend("Leave its row out."));
        }
        if through.amax() > 0.0 {
            return Err(wrong_inputs(
                "recorded outputs are of the plant's own states; the target is in the disturbance",
                "/inputs/plant/c_recorded",
            ));
        }
    }
    let mut own = internal.unwrap_or_else(|| written.plant.clone());
    own.e = DMatrix::zeros(own.a.nrows(), 1);
    own.d = DMatrix::zeros(own.c.nrows(), 1);
    let mut left = Vec::new();
    for (at, term) in terms.iter().enumerate() {
        let mut term = term.clone();
        if term.role == Role::ProcessNoise {
            term.shape = columns(&rows(&term.shape));
            let is_used = terms.iter().any(|other| other.same_as == Some(at));
            if term.shape.amax() == 0.0 && term.held.is_none() && term.same_as.is_none() && !is_used {
                let detail = format!("{} moves the target alone, which is conditioned on", term.name);
                return Err(wrong(detail, "/spec/process_noise").mend("Leave it out."));
            }
        }
        left.push(term);
    }
    let sampled = Sampled {
        plant,
        recorded: recorded.map(|(c, _)| c),
        time: written.time,
        control_borne: columns(&rows(&written.control_borne)),
    };
    Ok(Conditioned { sampled, internal: Some(own), terms: left })
}
