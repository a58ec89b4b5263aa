//! The loop in sampled time: three filters in doubled precision, the direct paths solved for within each sample.

use super::closed::{ClosedLoop, Delays};
use super::simulator::{Drive, Simulated, SimulatorError, sample};
use crate::control::double_double::DoubleDouble;
use crate::control::simulate::{DelayLine, SimulationError};
use crate::control::{Discrete, System, TransferFunction};
use crate::ctl::Ctl;

/// Samples between two looks at whether to go on.
const CHECKED: usize = 1024;

/// The three filters.
pub(super) struct Sampled<'a> {
    plant: &'a TransferFunction<Discrete>,
    feedforward: &'a TransferFunction<Discrete>,
    feedback: &'a TransferFunction<Discrete>,
    preview: usize,
}

impl<'a> Sampled<'a> {
    /// `None` for a loop in continuous time.
    pub(super) fn new(closed: &'a ClosedLoop) -> Option<Self> {
        let (System::Discrete(plant), System::Discrete(feedforward), System::Discrete(feedback)) =
            (&closed.plant, &closed.feedforward, &closed.feedback)
        else {
            return None;
        };
        let Delays { preview_s, .. } = closed.delays;
        let preview = (preview_s / plant.time().period_s()).round() as usize;
        Some(Self { plant, feedforward, feedback, preview })
    }

    /// How far the feedforward sees ahead, in samples.
    pub(super) fn preview(&self) -> usize {
        self.preview
    }

    /// Runs the loop for `samples` samples.
    pub(super) fn run(&self, drive: &Drive, samples: usize, ctl: &Ctl) -> Result<Simulated, SimulatorError> {
        let mut plant = DelayLine::new(self.plant, "plant")?.starting_with(drive.initial);
        let mut feedforward = DelayLine::new(self.feedforward, "feedforward")?;
        let mut feedback = DelayLine::new(self.feedback, "feedback")?;
        let (plant_gain, feedback_gain) = (plant.feedthrough(), feedback.feedthrough());
        let (mut control, mut output) = (Vec::with_capacity(samples), Vec::with_capacity(samples));
        for k in 0..samples {
            if k % CHECKED == 0 {
                ctl.check()?;
            }
            let seen = DoubleDouble::from(sample(drive.command, k)).sub(sample(drive.perception, k).into());
            let remnant = sample(drive.remnant, k).into();
            let d = sample(drive.disturbance, k).into();
            let forward = feedforward.step(sample(drive.command, k + self.preview).into()).add(remnant);
            // y = pending + g (forward + pending_fb + k (seen − y) + d), solved for y.
            let known = forward.add(feedback.pending()).add(seen.mul(feedback_gain)).add(d);
            let y = plant.pending().add(known.mul(plant_gain)).div(1.0 + plant_gain * feedback_gain);
            let u = forward.add(feedback.step(seen.sub(y)));
            plant.step(u.add(d));
            if !(y.value().is_finite() && u.value().is_finite()) {
                return Err(SimulationError::Overflow { sample: k }.into());
            }
            control.push(u.value());
            output.push(y.value());
        }
        Ok(Simulated { control: Some(control), output })
    }
}
