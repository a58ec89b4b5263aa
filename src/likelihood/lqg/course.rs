//! The predictor of trials that share their gains: its systems and, where the data do not move them, its covariances.
//!
//! Noise of the motor that grows with the control makes the records other than normal. Where the horizon ends, many
//! trials share a start, and the predictor is that of the first two moments of s over all of them, which are propagated
//! exactly: `E u² = (Hᵤ E s)² + Hᵤ Cov(s) Hᵤᵀ` at every sample. Without an end it is `E[u² | data so far]`, by the
//! predictor's own mean and covariance, along each trial.

use super::covariance::{Scratch, State, Step, first, stands_still, step};
use super::design::{Design, Role};
use super::jet::Jet;
use super::joint::{Grown, Joint};
use super::recursion::Evaluation;
use super::walk::Trial;
use crate::ctl::{Ctl, Stopped};
use nalgebra::DMatrix;
use std::borrow::Cow;
use std::ops::Range;

/// For so many steps the recursion stands still, so that a slow mode is not passed over.
const STILL_STEPS: usize = 10;
/// Products of numbers between two questions whether to go on, of a step of width³.
const PRODUCTS_BETWEEN_CHECKS: usize = 32_000;

/// The predictor.
pub(super) struct Course<'a> {
    design: &'a Design,
    joints: Vec<Joint>,
    joint_places: Vec<usize>,
    /// Empty where each trial has its own.
    steps: Vec<Step>,
    step_places: Vec<usize>,
}

/// Whether every trial has covariances of its own.
pub(super) fn is_of_each_trial(design: &Design) -> bool {
    design.has(Role::ControlDependentNoise) && design.horizon.is_none()
}

/// The moments of s over all trials.
struct Moments {
    mean: Jet,
    covariance: Jet,
}

impl Grown {
    /// Q with what controls of this second moment, m×m, add to it.
    fn added(&self, q: &Jet, moment: &Jet) -> Jet {
        q.clone().add(&self.entry.times(&moment.diagonal()).times_transposed(&self.entry), 1.0)
    }
}

impl Moments {
    /// Of the control.
    fn of_control(&self, grown: &Grown) -> Jet {
        let mean = grown.control.times(&self.mean);
        let spread = grown.control.times(&self.covariance).times_transposed(&grown.control);
        mean.times_transposed(&mean).add(&spread, 1.0)
    }

    fn advance(&mut self, joint: &Joint, q: &Jet, disturbance: &DMatrix<f64>) {
        let d = Jet::fixed(disturbance, q.count());
        self.mean = joint.f.times(&self.mean).add(&joint.drive.times(&d), 1.0);
        self.covariance = joint.f.times(&self.covariance).times_transposed(&joint.f).add(q, 1.0).symmetric();
    }
}

impl<'a> Course<'a> {
    /// The predictor of trials up to so many samples, of which `trial` is one; `None` where a covariance is not
    /// positive definite.
    ///
    /// # Errors
    /// [`Stopped`] when `ctl` says so.
    pub(super) fn new(
        design: &'a Design,
        (joints, joint_places): (Vec<Joint>, Vec<usize>),
        trial: Option<&Trial>,
        longest: usize,
        ctl: &Ctl,
    ) -> Result<Option<Self>, Stopped> {
        let mut course = Self { design, joints, joint_places, steps: Vec::new(), step_places: Vec::new() };
        let Some(mut state) = first(design.start, course.joint(0)) else { return Ok(None) };
        if is_of_each_trial(design) {
            return Ok(Some(course));
        }
        let (channels, width) = course.joint(0).h.shape();
        let mut scratch = Scratch::new(width, channels, &state);
        let count = course.joint(0).f.count();
        let mut moments = trial.filter(|_| course.joint(0).grown.is_some()).map(|trial| Moments {
            mean: Jet::fixed(&DMatrix::from_column_slice(width, 1, &trial.start), count),
            covariance: Jet::zeros(width, width, count),
        });
        let mut still = 0;
        let between = (PRODUCTS_BETWEEN_CHECKS / width.pow(3)).max(1);
        for k in 0..longest {
            if k % between == 0 {
                ctl.check()?;
            }
            let told = design.told(k);
            let same = k > 0 && course.joint_place(k) == course.joint_place(k - 1) && told == design.told(k - 1);
            if same && still >= STILL_STEPS {
                // Without an end nothing else comes.
                if design.horizon.is_none() {
                    break;
                }
                course.step_places.push(course.steps.len() - 1);
                continue;
            }
            let joint = course.joint(k);
            let q = match (&moments, &joint.grown) {
                (Some(moments), Some(grown)) => Cow::Owned(grown.added(&joint.q, &moments.of_control(grown))),
                _ => Cow::Borrowed(&joint.q),
            };
            let Some(found) = step(joint, &q, &state, told, &mut scratch) else { return Ok(None) };
            if let (Some(moments), Some(trial)) = (&mut moments, trial) {
                moments.advance(joint, &q, &trial.disturbance.columns(k, 1).into_owned());
            }
            let is_still = same && course.steps.last().is_some_and(|last| stands_still(&found, last, width));
            still = if is_still { still + 1 } else { 0 };
            course.step_places.push(course.steps.len());
            course.steps.push(found);
            std::mem::swap(&mut state, &mut scratch.next);
        }
        Ok(Some(course))
    }

    /// Parameters that derivatives are by.
    pub(super) fn count(&self) -> usize {
        self.joint(0).f.count()
    }

    fn joint_place(&self, sample: usize) -> usize {
        self.joint_places[sample.min(self.joint_places.len() - 1)]
    }

    /// The system of a sample.
    pub(super) fn joint(&self, sample: usize) -> &Joint {
        &self.joints[self.joint_place(sample)]
    }

    /// The channels that tell something at a sample.
    pub(super) fn told(&self, sample: usize) -> Range<usize> {
        self.design.told(sample)
    }

    /// The step of a sample; `None` where each trial has its own.
    pub(super) fn step(&self, sample: usize) -> Option<&Step> {
        let last = self.step_places.len().checked_sub(1)?;
        self.steps.get(self.step_places[sample.min(last)])
    }

    /// P at the first sample.
    pub(super) fn first(&self) -> Option<State> {
        first(self.design.start, self.joint(0))
    }

    /// Adds what all trials of these lengths have of the covariances alone.
    pub(super) fn add_traces(&self, lengths: impl Iterator<Item = usize> + Clone, into: &mut Evaluation) {
        let Some(last) = self.step_places.len().checked_sub(1) else { return };
        let mut times = vec![0usize; self.steps.len()];
        for (at, place) in self.step_places.iter().enumerate() {
            let uses = |n: usize| if at < last { usize::from(n > at) } else { n.saturating_sub(last) };
            times[*place] += lengths.clone().map(uses).sum::<usize>();
        }
        for (step, times) in self.steps.iter().zip(times) {
            step.add_traces(times as f64, into);
        }
    }

    /// Q at a sample of a trial whose control's variance follows from what was recorded up to then; `None` where the
    /// errors' covariance is not positive definite. `s` and `e` are the predictor's state and error.
    pub(super) fn grown_by_data(&self, sample: usize, state: &State, [s, e]: [&Jet; 2]) -> Option<Jet> {
        let joint = self.joint(sample);
        let Some(grown) = &joint.grown else { return Some(joint.q.clone()) };
        let p = Jet::square(&state.p, &state.slopes, joint.f.count());
        let mut mean = grown.control.times(s);
        let mut spread = grown.control.times(&p).times_transposed(&grown.control);
        let channels = joint.h.shape().0;
        if self.told(sample).len() == channels {
            let ph = p.times_transposed(&joint.h);
            let sigma = joint.h.times(&ph).add(&joint.n, 1.0).symmetric();
            let shared = grown.control.times(&ph);
            let gain = shared.times(&sigma.inverse()?);
            mean = mean.add(&gain.times(e), 1.0);
            spread = spread.add(&gain.times_transposed(&shared), -1.0);
        }
        Some(grown.added(&joint.q, &mean.times_transposed(&mean).add(&spread, 1.0)))
    }
}

impl Step {
    /// Adds the part of gradient and information that is the covariance's own, so many times.
    pub(super) fn add_traces(&self, times: f64, into: &mut Evaluation) {
        for (sum, of_step) in into.gradient.iter_mut().zip(&self.half_traces) {
            *sum -= times * of_step;
        }
        for (sum, of_step) in into.information.iter_mut().zip(&self.information) {
            *sum += times * of_step;
        }
    }
}
