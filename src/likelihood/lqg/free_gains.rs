//! K and L of a free fit, which the costs are started from.

use super::design::{Design, Timing};
use super::recursion::Record;
use crate::control::Discrete;
use crate::ctl::{Ctl, Stopped};
use crate::likelihood::experiment::{Experiment, Record as FreeRecord};
use crate::likelihood::innovation::{Innovation, Predicted};
use crate::likelihood::{FitError, LoopModel, Noise, Settings, fit};
use crate::person::state_feedback::{AffinePlant, Plant as FreePlant};
use nalgebra::DMatrix;

/// Draws and climbs of the free fit: it need only come near.
const DRAWS: usize = 20;
const CLIMBS: usize = 2;

/// K (m×n) and the predictor's L (n×p) by the innovation form: from the control where it was recorded, which holds for
/// any perceived noise; from the output alone where the person senses what was recorded and knows the disturbance, as
/// if the perceived noise were the true one. `None` where neither is so, in the filter's timing, and where it fails.
///
/// # Errors
/// [`Stopped`] when `ctl` says so.
pub fn free_gains(
    design: &Design,
    records: &[Record],
    time: Discrete,
    seed: u64,
    ctl: &Ctl,
) -> Result<Option<[DMatrix<f64>; 2]>, Stopped> {
    let [n, m, p, q] = design.sizes();
    let has_control = design.recorded.control.is_some();
    let senses = design.recorded.instrument.is_none() && design.is_told;
    if design.timing == Timing::Filter || !design.is_plain() || !(has_control || senses) {
        return Ok(None);
    }
    let plant = &design.plant;
    let base = FreePlant {
        a: plant.a.clone(),
        b: plant.b.clone(),
        e: plant.e.clone(),
        c: plant.c.clone(),
        d: DMatrix::zeros(p, m),
        f: DMatrix::zeros(p, q),
        initial: vec![0.0; n],
    };
    let predicted = if has_control { Predicted::Control } else { Predicted::Output };
    let model = Innovation {
        plant: AffinePlant { base, terms: Vec::new() },
        continuous: false,
        predicted,
        is_told: design.is_told,
    };
    let free = |record: &Record| {
        let columns = record.disturbance.column_iter().chain(record.measured.column_iter());
        let stimulus = DMatrix::from_columns(&columns.map(|c| c.into_owned()).collect::<Vec<_>>());
        let target = match predicted {
            Predicted::Control => record.measured.columns(p, m).into_owned(),
            _ => record.measured.columns(0, p).into_owned(),
        };
        FreeRecord { stimulus, target, initial: None }
    };
    let Ok(experiment) = Experiment::new(&model, time, records.iter().map(free).collect(), false) else {
        return Ok(None);
    };
    let settings =
        Settings { noise: Noise::Full, bounds: model.limits(), start: None, draws: DRAWS, climbs: CLIMBS, seed };
    match fit(&experiment, &settings, ctl) {
        Ok(found) => {
            let k = DMatrix::from_row_slice(m, n, &found.theta[..m * n]);
            let l = DMatrix::from_row_slice(n, p, &found.theta[m * n..m * n + n * p]);
            Ok(Some([k, l]))
        }
        Err(FitError::Stopped(stopped)) => Err(stopped),
        Err(FitError::NoStart { .. } | FitError::NotFinite) => Ok(None),
    }
}
