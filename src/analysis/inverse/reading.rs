//! What weights mean, in the names and units of the request.

use super::half::{Half, Labels};
use super::parts::{EquivalentResult, axis, comparison, rows};
use super::regulator::CostReading;
use super::shares::shares;
use super::units;
use crate::control::lyapunov::Clock;
use crate::inverse::Role;
use crate::inverse::reading;
use nalgebra::DMatrix;

/// Reads the weights Q and R with their gain; of a filter those of its dual, with the units of noise.
pub(super) fn read(half: &Half, q: &DMatrix<f64>, r: &DMatrix<f64>, k: &DMatrix<f64>) -> CostReading {
    let Half { gains, states, ports, trajectory, other, .. } = half;
    let (normalised_q, normalised_r, _) = reading::normalised(q, r);
    let is_regulator = gains.role() == Role::Regulator;
    let [q_units, r_units] = weight_units(half).map_or([None, None], |pair| pair.map(Some));
    let (mut stationary, mut sizes) = (None, None);
    if is_regulator {
        let closed = gains.a() - gains.b() * k;
        let noise = DMatrix::identity(gains.states(), gains.states());
        stationary = reading::stationary_shares(&closed, k, q, r, &noise, gains.clock()).ok().flatten();
        let steady = || reading::stationary_covariance(&closed, &noise, gains.clock()).ok().map(|x| x.diagonal());
        let recorded = trajectory.as_ref().map(|(x, _)| x.map(|v| v * v).row_mean().transpose());
        sizes = recorded.or_else(steady).map(|squares| squares.iter().map(|v| v.max(0.0).sqrt()).collect::<Vec<f64>>());
    }
    let sized = sizes.as_ref().map(|sizes| reading::sized_axes(&normalised_q, sizes));
    CostReading {
        equivalents: is_regulator.then(|| equivalents(states, ports, &normalised_q)),
        normalised_q: rows(&normalised_q),
        normalised_r: rows(&normalised_r),
        normalised_q_units: q_units,
        normalised_r_units: r_units,
        q_axes: reading::axes(q).into_iter().map(|a| axis(a, &states.names)).collect(),
        r_axes: reading::axes(r).into_iter().map(|a| axis(a, &ports.names)).collect(),
        sized_axes: sized.map(|axes| axes.into_iter().map(|a| axis(a, &states.names)).collect()),
        sizes,
        stationary_shares: stationary.map(shares),
        trajectory_shares: trajectory.as_ref().and_then(|(x, u)| reading::shares_along(q, r, x, u)).map(shares),
        comparison: other.as_ref().map(|(other_q, other_r)| comparison(reading::compare((q, r), (other_q, other_r)))),
    }
}

/// The units of both weights, where those of states and ports are known.
fn weight_units(half: &Half) -> Option<[Vec<Vec<String>>; 2]> {
    let (states, ports) = half.states.units.as_ref().zip(half.ports.units.as_ref())?;
    Some(match half.gains.role() {
        Role::Regulator => units::of_cost(states, ports),
        Role::Filter => units::of_noise(states, ports, half.gains.clock() == Clock::Continuous),
    })
}

/// What one unit of each state is worth in input, from Q on the scale on which R has the mean eigenvalue 1.
fn equivalents(states: &Labels, inputs: &Labels, normalised_q: &DMatrix<f64>) -> Vec<EquivalentResult> {
    let worth = states.units.as_ref().zip(inputs.units.as_ref()).map(|(x, u)| units::of_equivalents(x, u));
    let one = |(i, state): (usize, &String)| EquivalentResult {
        state: state.clone(),
        input: normalised_q[(i, i)].max(0.0).sqrt(),
        unit: worth.as_ref().map(|units| units[i].clone()),
    };
    states.names.iter().enumerate().map(one).collect()
}
