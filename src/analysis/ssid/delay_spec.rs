//! Delays of the person, as a spec names them.

use crate::analysis::problem::{Code, Problem};
use crate::identify::delayed::Pair;
use crate::identify::refine::{Delay, Delays};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Points of a grid at most.
const MAX_POINTS: usize = 100;

/// Combinations of both delays at most.
const MAX_COMBINATIONS: usize = 400;

/// A delay in seconds: a number, a list of numbers to try, or a range that it is refined in.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(untagged)]
pub enum DelayValueSpec {
    /// This one.
    Fixed(f64),
    /// The best of these.
    Grid(Vec<f64>),
    /// Anything in a range; continuous time only.
    Range(DelayRange),
}

/// A range of delays.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DelayRange {
    /// Shortest, in seconds.
    pub from: f64,
    /// Longest, in seconds.
    pub to: f64,
}

/// The pool is searched at so many pairs of delays at most.
const MAX_SEARCHES: usize = 64;

/// Pure delays in the person's feedback and feedforward. The pool is searched without them unless `search` is true; the
/// refinement has them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DelaySpec {
    /// In the feedback. Default: none.
    #[serde(default = "none")]
    pub feedback_s: DelayValueSpec,
    /// In the feedforward. Default: none.
    #[serde(default = "none")]
    pub feedforward_s: DelayValueSpec,
    /// Whether the pool is searched at every pair of the listed delays as well, each as long as a search without;
    /// ranges cannot be. The refinement then starts from the best pair. Default: false.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub search: bool,
}

fn none() -> DelayValueSpec {
    DelayValueSpec::Fixed(0.0)
}

fn wrong(detail: impl Into<String>, location: String) -> Problem {
    Problem::new(Code::Invalid, "unusable delay", detail).at(location)
}

impl DelayValueSpec {
    fn check(&self, at: &str) -> Result<Delay, Problem> {
        let location = format!("/spec/delay/{at}");
        let is_delay = |seconds: &f64| seconds.is_finite() && *seconds >= 0.0;
        match self {
            Self::Fixed(seconds) if is_delay(seconds) => Ok(Delay::Grid(vec![*seconds])),
            Self::Fixed(seconds) => Err(wrong(format!("the delay {seconds} s is negative"), location)),
            Self::Grid(points) => {
                if points.is_empty() || points.len() > MAX_POINTS {
                    let detail = format!("there are {} delays; 1 to {MAX_POINTS} are taken", points.len());
                    return Err(wrong(detail, location));
                }
                if !points.iter().all(is_delay) || points.windows(2).any(|pair| pair[1] <= pair[0]) {
                    return Err(wrong("delays must increase, and not be negative", location));
                }
                Ok(Delay::Grid(points.clone()))
            }
            Self::Range(DelayRange { from, to }) if is_delay(from) && to.is_finite() && from < to => {
                Ok(Delay::Range([*from, *to]))
            }
            Self::Range(DelayRange { from, to }) => {
                Err(wrong(format!("there is no delay from {from} to {to} s"), location))
            }
        }
    }
}

impl DelaySpec {
    /// The delays as the refinement takes them.
    pub(super) fn check(&self) -> Result<Delays, Problem> {
        let delays = Delays {
            feedback: self.feedback_s.check("feedback_s")?,
            feedforward: self.feedforward_s.check("feedforward_s")?,
        };
        let count = |delay: &Delay| if let Delay::Grid(points) = delay { points.len() } else { 9 };
        let combinations = count(&delays.feedback) * count(&delays.feedforward);
        if combinations > MAX_COMBINATIONS {
            let detail = format!("there are {combinations} pairs of delays; at most {MAX_COMBINATIONS} are tried");
            return Err(wrong(detail, "/spec/delay".to_owned()));
        }
        if self.search {
            for (delay, at) in [(&delays.feedback, "feedback_s"), (&delays.feedforward, "feedforward_s")] {
                if matches!(delay, Delay::Range(_)) {
                    return Err(wrong(
                        "a pool cannot be searched at every delay of a range",
                        format!("/spec/delay/{at}"),
                    )
                    .mend("List the delays to search at, or leave the search to the refinement."));
                }
            }
            if combinations > MAX_SEARCHES {
                let detail =
                    format!("there are {combinations} pairs of delays; the pool is searched at {MAX_SEARCHES} at most");
                return Err(wrong(detail, "/spec/delay/search".to_owned()));
            }
        }
        Ok(delays)
    }

    /// The pairs at which the pool is searched; none where that is not asked for.
    pub(super) fn pairs(&self) -> Vec<Pair> {
        let listed = |spec: &DelayValueSpec| match spec {
            DelayValueSpec::Fixed(seconds) => vec![*seconds],
            DelayValueSpec::Grid(points) => points.clone(),
            DelayValueSpec::Range(_) => Vec::new(),
        };
        if !self.search {
            return Vec::new();
        }
        let feedforward = listed(&self.feedforward_s);
        listed(&self.feedback_s)
            .into_iter()
            .flat_map(|feedback_s| {
                feedforward.iter().map(move |feedforward_s| Pair { feedback_s, feedforward_s: *feedforward_s })
            })
            .collect()
    }
}

/// Sampled delays are whole samples.
pub(super) fn check_sampled(delays: &Delays, sample_time_s: f64) -> Result<(), Problem> {
    for (delay, at) in [(&delays.feedback, "feedback_s"), (&delays.feedforward, "feedforward_s")] {
        let location = format!("/spec/delay/{at}");
        let Delay::Grid(points) = delay else {
            return Err(wrong("a range of delays needs continuous time", location)
                .mend(format!("List multiples of the sample time, {sample_time_s} s.")));
        };
        let is_whole = |seconds: &f64| ((seconds / sample_time_s) - (seconds / sample_time_s).round()).abs() < 1e-6;
        if let Some(other) = points.iter().find(|p| !is_whole(p)) {
            return Err(wrong(format!("{other} s is no multiple of the sample time, {sample_time_s} s"), location)
                .mend("Sampled controllers have delays of whole samples."));
        }
    }
    Ok(())
}
