//! Refinement with a pure delay in feedback and feedforward: `Gfb e^{−sτ}`, `Gff e^{−sτff}`.
//!
//! Delays are scanned over a grid, each point refined from the solution of its neighbour with the delay itself in the
//! loop and stability judged exactly ([`control::delay`](crate::control::delay)); where a delay may be anything in a
//! range it is then refined with all other coefficients. The pool itself is searched without delay: its best candidate
//! is where the scan starts, and the result is a local optimum. In sampled time delays are whole samples.

use super::refinement::Refinement;
use super::setup::{DelayValue, RefineError, Setup, Start};
use crate::ctl::Ctl;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Points of a scan over a range.
const SCAN: usize = 9;

/// Halvings of the feedback's gain in search of a start that is stable with its delay.
const HALVINGS: usize = 12;

/// A delay of the model.
#[derive(Debug, Clone, PartialEq)]
pub enum Delay {
    /// Any of these, in seconds; one for a fixed delay.
    Grid(Vec<f64>),
    /// Anything between two values in seconds.
    Range([f64; 2]),
}

impl Delay {
    fn points(&self) -> Vec<f64> {
        match self {
            Self::Grid(points) => points.clone(),
            Self::Range([from, to]) => (0..SCAN).map(|i| from + (to - from) * i as f64 / (SCAN - 1) as f64).collect(),
        }
    }

    fn range(&self) -> Option<[f64; 2]> {
        if let Self::Range(range) = self { Some(*range) } else { None }
    }
}

/// The delays of feedback and feedforward.
#[derive(Debug, Clone, PartialEq)]
pub struct Delays {
    /// Of the feedback.
    pub feedback: Delay,
    /// Of the feedforward.
    pub feedforward: Delay,
}

/// A pair of delays that was tried.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ScanPoint {
    /// Of the feedback.
    pub feedback_delay_s: f64,
    /// Of the feedforward.
    pub feedforward_delay_s: f64,
    /// J refined at these delays; null where there is none.
    pub cost: Option<f64>,
    /// Why there is none.
    pub reason: Option<String>,
}

/// A start whose loop is stable with its delay, by halving the feedback where it is not.
fn refined_at<'a>(
    setup: Setup<'a>,
    start: &Start,
    delays: [DelayValue; 2],
    ctl: &Ctl,
) -> Result<Refinement<'a>, RefineError> {
    let mut start = start.clone();
    for _ in 0..HALVINGS {
        match Refinement::with_delays(setup, &start, delays, ctl) {
            Err(RefineError::OnTheEdge(_)) => start.feedback_numerator.iter_mut().for_each(|c| *c *= 0.5),
            other => return other,
        }
    }
    Err(RefineError::OnTheEdge("feedback loop with its delay, even at a small gain,"))
}

/// Scans the delays and refines the best: the refinement, and every point of the scan.
///
/// # Errors
/// [`RefineError`] where no point has a refinement: that of the last point.
///
/// # Panics
/// If a grid is empty, which is a mistake of the caller.
pub fn refine_with_delays<'a>(
    setup: Setup<'a>,
    start: &Start,
    delays: &Delays,
    ctl: &Ctl,
) -> Result<(Refinement<'a>, Vec<ScanPoint>), RefineError> {
    let fixed = |start_s: f64| DelayValue { start_s, range_s: None };
    let mut scan = Vec::new();
    let mut best: Option<(Refinement<'a>, [f64; 2])> = None;
    let mut failure = None;
    let mut row_start = start.clone();
    for feedback in delays.feedback.points() {
        let mut from = row_start.clone();
        for (column, feedforward) in delays.feedforward.points().into_iter().enumerate() {
            ctl.check()?;
            let tried = refined_at(setup, &from, [fixed(feedback), fixed(feedforward)], ctl)
                .and_then(|refinement| Ok((refinement.refined()?, refinement)));
            let (mut cost, mut reason) = (None, None);
            match tried {
                Err(RefineError::Stopped(stopped)) => return Err(stopped.into()),
                Err(error) => {
                    reason = Some(error.to_string());
                    failure = Some(error);
                }
                Ok((refined, refinement)) => {
                    cost = Some(refined.cost);
                    from = Start::of(&refined.feedforward, &refined.feedback);
                    if column == 0 {
                        row_start = from.clone();
                    }
                    if best.as_ref().is_none_or(|(best, _)| refined.cost < best.minimum.cost) {
                        best = Some((refinement, [feedback, feedforward]));
                    }
                }
            }
            scan.push(ScanPoint { feedback_delay_s: feedback, feedforward_delay_s: feedforward, cost, reason });
        }
    }
    let Some((mut best, at)) = best else {
        return Err(failure.unwrap_or(RefineError::NotFinite));
    };
    let ranges = [delays.feedback.range(), delays.feedforward.range()];
    if ranges.iter().any(Option::is_some) {
        let refined = best.refined()?;
        let values = [0, 1].map(|i| DelayValue { start_s: at[i], range_s: ranges[i] });
        let from = Start::of(&refined.feedforward, &refined.feedback);
        match Refinement::with_delays(setup, &from, values, ctl) {
            Err(RefineError::Stopped(stopped)) => return Err(stopped.into()),
            // The best point of the scan stands where its own loop cannot be started from again.
            Err(_) => {}
            Ok(joint) => best = joint,
        }
        best.start_cost = refined.cost;
    }
    Ok((best, scan))
}
