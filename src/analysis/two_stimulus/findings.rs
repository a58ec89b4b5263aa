//! What a scientist must read before using the result.

use super::prediction::RegularisedResult;
use super::result::StructureFit;
use crate::analysis::report::Warning;
use crate::control::System;
use crate::two_stimulus::controllers::Controllers;
use crate::two_stimulus::structure::FeedforwardLaw;

/// A p-value below this says that the structure does not describe the responses.
const MISFIT: f64 = 0.01;

/// A share of comparisons within both bands below this says that the two estimates contradict each other.
const AGREEING: f64 = 0.9;

/// Relative misfit of `y = G (u + d)` that is worth a warning.
const PLANT_MISMATCH: f64 = 0.1;

/// A relative standard deviation above this leaves the linearised bands too narrow.
const FIRST_ORDER: f64 = 0.25;

fn hertz(frequencies: &[f64]) -> String {
    let words: Vec<String> = frequencies.iter().map(|f| format!("{}", (f * 1e6).round() / 1e6)).collect();
    format!("{} Hz", words.join(", "))
}

/// Findings about the estimate that is shrunk towards a structure.
pub(super) fn of_regularised(found: &RegularisedResult, warnings: &mut Vec<Warning>) {
    if !found.controllers.is_empty() {
        warnings.push(Warning::new(
            "regularised_bands_too_narrow",
            "the bands of the regularised controllers take the structure and the sizes of deviations as known: of 60 \
             simulated people they held the feedback's size in 83 % and its phase in 76 %, the feedforward's in 92 %, \
             and not in 95 %; the bands of `lines` do not assume this"
                .to_owned(),
        ));
    }
}

/// Findings about the estimate without structure.
pub(super) fn of_estimate(free: &Controllers, plant: &System, given: bool, warnings: &mut Vec<Warning>) {
    let lines = &free.lines;
    let at = |meant: &dyn Fn(&crate::two_stimulus::controllers::LineControllers) -> bool| -> Vec<f64> {
        lines.iter().filter(|line| meant(line)).map(|line| line.response.frequency_hz).collect()
    };
    let mut say = |code: &str, frequencies: Vec<f64>, words: &str| {
        if !frequencies.is_empty() {
            warnings.push(Warning::new(code, format!("{}: {words}", hertz(&frequencies))));
        }
    };
    say(
        "confounded_line",
        at(&|line| line.response.confounded),
        "command and disturbance share the line in one proportion, and their effects cannot be told apart; the line is \
         left out",
    );
    say(
        "feedback_interpolated",
        at(&|line| line.feedback.is_some_and(|f| f.interpolated)),
        "the disturbance does not excite the line; the feedback is interpolated between its neighbours, with the error \
         that this may have stated and in the bands",
    );
    say(
        "feedback_not_determined",
        at(&|line| line.feedback.is_none() && !line.response.confounded),
        "the line lies outside those of the disturbance, and the command alone does not determine the feedback there",
    );
    if lines.iter().all(|line| line.response.command.is_none()) {
        say(
            "feedforward_not_determined",
            at(&|_| true),
            "the command excites no line, so nothing is known of the feedforward",
        );
    }
    say(
        "ambiguous_phase",
        free.ambiguous_phase_hz.clone(),
        "the phase of the feedback jumps by more than a third of a turn to this line",
    );
    say(
        "noise_unknown",
        at(&|line| line.response.covariance.is_none() && !line.response.confounded),
        "there are too few trials, segments and nearby lines without a stimulus to tell the noise, and so there are no \
         bands",
    );
    say(
        "noisy_estimate",
        at(&|line| {
            let is_noisy = |e: crate::two_stimulus::controllers::Estimated| {
                e.variance.is_some_and(|v| (0.5 * v).sqrt() > FIRST_ORDER * e.value.norm())
            };
            line.feedback.is_some_and(is_noisy) || line.feedforward.is_some_and(is_noisy)
        }),
        "the standard deviation exceeds a quarter of the estimate, where bands by linearisation are too narrow",
    );
    if !given {
        say(
            "plant_mismatch",
            at(&|line| {
                let Some([h_ud, h_yd]) = line.response.disturbance else { return false };
                let g = plant.response(line.response.omega_rad_s);
                let expected = g * (1.0 + h_ud);
                (h_yd - expected).norm() > PLANT_MISMATCH * h_yd.norm()
            }),
            "y differs from G (u + d) by more than a tenth: either drift leaks into the line, or the plant is not the \
             one named. The feedback and the feedforward of `lines` do not use the plant; the fits do",
        );
    }
    warnings.push(Warning::new(
        "assumptions",
        "the person is taken as linear and time-invariant over all trials given, with noise that is circular, \
         independent between trials and lines, and alike in trials with one stimulus and with two; bands are \
         linearised",
    ));
}

/// Findings about the best of the structures.
pub(super) fn of_best(best: &StructureFit, warnings: &mut Vec<Warning>) {
    if let Some(p) = best.p_value.filter(|p| *p < MISFIT) {
        warnings.push(Warning::new(
            "structure_misfit",
            format!(
                "the best structure leaves a reduced chi-square of {:.2} (p = {p:.1e}): it does not describe the \
                 responses within their noise; its bands are widened by the root of that",
                best.reduced_chi_square.unwrap_or(f64::NAN)
            ),
        ));
    }
    if let Some(agreement) = best.agreement.as_ref().filter(|a| (a.within as f64) < AGREEING * a.compared as f64) {
        warnings.push(Warning::new(
            "estimates_disagree",
            format!(
                "{} of {} magnitudes and phases of the best structure lie outside the joint 95 % bands of the estimate \
                 without structure",
                agreement.compared - agreement.within,
                agreement.compared
            ),
        ));
    }
    let edges: Vec<&str> = best.parameters.iter().filter(|p| p.at_edge).map(|p| p.name.as_str()).collect();
    if !edges.is_empty() {
        let has_feedforward = best.structure.feedforward != FeedforwardLaw::None;
        let which = if has_feedforward { "" } else { " (without a feedforward, delays often do)" };
        warnings.push(Warning::new(
            "parameter_at_edge",
            format!("{} of the best structure lie on the edge of their range{which}", edges.join(", ")),
        ));
    }
    let open: Vec<&str> =
        best.parameters.iter().filter(|p| p.interval_95.is_none() && !p.at_edge).map(|p| p.name.as_str()).collect();
    if !open.is_empty() {
        let message = format!("the lines do not determine {} of the best structure one by one", open.join(", "));
        warnings.push(Warning::new("parameters_not_determined", message));
    }
    if let Some([agreeing, starts]) = best.starts_agreeing.filter(|[agreeing, starts]| *agreeing == 1 && *starts > 1) {
        let message =
            format!("only {agreeing} of {starts} starts came to the smallest cost: there may be a smaller one");
        warnings.push(Warning::new("starts_disagree", message));
    }
}
