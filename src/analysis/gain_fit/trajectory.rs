//! The trials' own trajectories in the states of the plant, as the fitted loop makes them: what the cost is shared out
//! along.

use super::assembly::Loop;
use super::spec::GainFitSpec;
use crate::analysis::inverse::shares::{SharesResult, shares};
use crate::control::parametric::{Matrices, Realisation};
use crate::control::{Continuous, Discrete, StateSpace};
use crate::inverse::reading;
use crate::likelihood::Record;
use crate::person::state_feedback::{Path, Plant, PlantModel, close};
use nalgebra::{DMatrix, DVector};

/// A loop whose outputs are the states of the plant and the controls, sampled.
pub(super) struct Observed {
    model: Realisation<Discrete>,
    states: usize,
}

impl Observed {
    /// The loop at θ; `None` where it is not defined. Behind a delay or a muscle the control is what reaches the plant.
    /// Where the filter is estimated too, the states are the person's estimates, and the control is −K times these.
    pub(super) fn new(spec: &GainFitSpec, assembled: &Loop, theta: &[f64]) -> Option<Self> {
        let [n, m, ..] = assembled.sizes;
        if assembled.both() {
            let found = assembled.model.sampled(theta, assembled.time, false)?.value;
            let k = DMatrix::from_row_slice(m, n, &theta[..n * m]);
            let mut c = DMatrix::zeros(n + m, n);
            c.view_mut((0, 0), (n, n)).fill_with_identity();
            c.view_mut((n, 0), (m, n)).copy_from(&-k);
            let d = DMatrix::zeros(n + m, found.model.inputs());
            let model = StateSpace::new(found.model.a().clone(), found.model.b().clone(), c, d, assembled.time).ok()?;
            return Some(Self { model: Realisation { model, initial: found.initial }, states: n });
        }
        let count = assembled.plant.names().len();
        let mut timings = theta.get(n * m + count..)?.iter().copied();
        let mut timing = |known: Option<f64>| known.or_else(|| timings.next());
        let delay = match &spec.delay {
            None => None,
            Some(delay) => Some((delay.order, timing(delay.seconds)?)),
        };
        let lag = match &spec.muscle_lag {
            None => None,
            Some(lag) => Some(timing(lag.seconds)?),
        };
        let plant = assembled.plant.plant::<f64>(theta.get(n * m..n * m + count)?);
        let inputs = plant.e.ncols();
        let mut c = DMatrix::zeros(n + m, n);
        c.view_mut((0, 0), (n, n)).fill_with_identity();
        let mut d = DMatrix::zeros(n + m, m);
        d.view_mut((n, 0), (m, m)).fill_with_identity();
        let watched = Plant { c, d, f: DMatrix::zeros(n + m, inputs), ..plant };
        let k = DMatrix::from_row_slice(m, n, &theta[..n * m]);
        let Matrices { a, b, c, d, initial } = close(&watched, &k, &Path { delay, lag });
        let model = if assembled.is_continuous {
            let model = StateSpace::new(a, b, c, d, Continuous).ok()?;
            Realisation { model, initial }.sampled(assembled.time).ok()?
        } else {
            Realisation { model: StateSpace::new(a, b, c, d, assembled.time).ok()?, initial }
        };
        Some(Self { model, states: n })
    }

    /// The states and the controls of a trial, samples × n and samples × m, from this initial state, or that of the
    /// model.
    pub(super) fn along(
        &self,
        record: &Record,
        initial: Option<&DVector<f64>>,
    ) -> Option<(DMatrix<f64>, DMatrix<f64>)> {
        let mut model = self.model.clone();
        if let Some(initial) = initial.filter(|x| x.len() == model.initial.len()) {
            model.initial.copy_from(initial);
        }
        let found = model.respond(&record.stimulus).ok()?;
        let controls = found.ncols() - self.states;
        Some((found.columns(0, self.states).into_owned(), found.columns(self.states, controls).into_owned()))
    }
}

/// The shares of a cost along each trajectory, and along all of them together.
pub(super) fn shares_of(
    q: &DMatrix<f64>,
    r: &DMatrix<f64>,
    trajectories: &[(DMatrix<f64>, DMatrix<f64>)],
) -> (Vec<Option<SharesResult>>, Option<SharesResult>) {
    let mut each = Vec::with_capacity(trajectories.len());
    let (mut xx, mut uu) = (q * 0.0, r * 0.0);
    for (x, u) in trajectories {
        let (of_states, of_controls) = (x.tr_mul(x), u.tr_mul(u));
        each.push(reading::shares(q, r, &of_states, &of_controls).map(shares));
        xx += of_states;
        uu += of_controls;
    }
    (each, reading::shares(q, r, &xx, &uu).map(shares))
}
