//! The pool searched with delays, in a report.

use crate::analysis::contract::Failure;
use crate::analysis::inputs::pool_problem;
use crate::analysis::report::Warning;
use crate::control::{Model, System};
use crate::ctl::Ctl;
use crate::identify::delayed::{Pair, Point, search_with_delays};
use crate::identify::pool::PoolError;
use crate::identify::search::Search;
use crate::identify::ssid::{Settings, SsidError};
use crate::response::FrequencyData;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The best candidate at a pair of delays.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct DelayedPoint {
    /// Delay of the feedback in seconds.
    pub feedback_delay_s: f64,
    /// Delay of the feedforward in seconds.
    pub feedforward_delay_s: f64,
    /// J of the best candidate whose loop is stable with the delay; null where none was found.
    pub cost: Option<f64>,
    /// Its index in the pool (in sampled time: in the pool of the plant with this delay).
    pub index: Option<u64>,
    /// No candidate that is stable with the delays costs less.
    pub lower_bound: f64,
    /// Whether the candidate is proven to be the best one that is stable with the delays.
    pub exact: bool,
    /// Candidates that cost less, all of them unstable with the delay.
    pub unstable: u64,
    /// Candidates of the pool at these delays.
    pub pool_size: u64,
    /// Gff without its delay; null where none was found.
    pub feedforward: Option<Model>,
    /// Gfb without its delay; null where none was found.
    pub feedback: Option<Model>,
}

/// The pool searched at every pair of delays.
///
/// In continuous time its members are those of the pool without delay that are stable with the delay itself too; in
/// sampled time those that are stable with the delay.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct DelayedPool {
    /// Pair by pair, the feedforward's delays innermost.
    pub points: Vec<DelayedPoint>,
    /// The pair with the smallest cost; null where no pair has a candidate.
    pub best: Option<usize>,
    /// Whether no pair of the list has a stable candidate with a smaller cost.
    pub exact: bool,
}

impl From<&Point> for DelayedPoint {
    fn from(point: &Point) -> Self {
        let best = point.best.as_ref();
        Self {
            feedback_delay_s: point.delays.feedback_s,
            feedforward_delay_s: point.delays.feedforward_s,
            cost: best.map(|b| b.cost),
            index: best.map(|b| b.index),
            lower_bound: point.lower_bound,
            exact: best.is_some(),
            unstable: point.unstable,
            pool_size: point.pool_size,
            feedforward: best.map(|b| b.feedforward.to_model()),
            feedback: best.map(|b| b.feedback.to_model()),
        }
    }
}

/// The answer, and the controllers (feedforward, feedback) of the best pair.
pub(super) fn searched(
    plant: &System,
    data: &FrequencyData,
    settings: &Settings,
    pairs: &[Pair],
    search: &impl Search,
    ctl: &Ctl,
) -> Result<(DelayedPool, Option<[System; 2]>), Failure> {
    let found = search_with_delays(plant, data, settings, pairs, search, ctl).map_err(|error| match error {
        SsidError::Stopped(stopped) => Failure::Stopped(stopped),
        error => {
            let problem = pool_problem::problem(&error);
            Failure::Problem(match error {
                SsidError::Pool(PoolError::DegreeTooHigh { .. }) => problem
                    .at("/spec/delay/feedback_s")
                    .mend("Sampled delays count as poles: use fewer samples of delay."),
                _ => problem,
            })
        }
    })?;
    let cost = |i: usize| found[i].best.as_ref().map_or(f64::INFINITY, |b| b.cost);
    let best = (0..found.len()).filter(|i| found[*i].best.is_some()).min_by(|a, b| cost(*a).total_cmp(&cost(*b)));
    let exact = best.is_some_and(|best| found.iter().all(|point| cost(best) <= point.lower_bound));
    let controllers =
        best.and_then(|best| found[best].best.as_ref()).map(|best| [best.feedforward.clone(), best.feedback.clone()]);
    Ok((DelayedPool { points: found.iter().map(Into::into).collect(), best, exact }, controllers))
}

/// Says what was not proven.
pub(super) fn warn(pool: &DelayedPool, warnings: &mut Vec<Warning>) {
    let open: Vec<String> = pool
        .points
        .iter()
        .filter(|point| !point.exact)
        .map(|point| {
            format!(
                "{} and {} s (nothing below {:.4e})",
                point.feedback_delay_s, point.feedforward_delay_s, point.lower_bound
            )
        })
        .collect();
    if !open.is_empty() {
        warnings.push(Warning::new(
            "delay_leaves_the_pool_unstable",
            format!(
                "none of the near-optimal candidates is stable with the delays of feedback and feedforward {}; the \
                 best stable one there is not known",
                open.join(", ")
            ),
        ));
    }
}
