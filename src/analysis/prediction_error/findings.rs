//! What a scientist must read before using the result.

use super::assembly::Assembly;
use super::result::{NormResult, PredictionErrorResult};
use crate::analysis::report::Warning;
use crate::prediction_error::residuals::LEVEL;

/// What further lags explain is doubted below this probability: a form never holds exactly.
const CUT_SHORT: f64 = 1e-3;

/// A feedback that exceeds that of the default lags by this factor is suspected of being the plant's inverse: this saw
/// 89 % of the cases and 15 % of others, free default lags none of 80.
const TRAP_RATIO: f64 = 2.0;

/// Likewise from this cosine on.
const TRAP_COSINE: f64 = 0.8;

/// With more trials the shared feedback's bias outweighs its noise.
const MANY_TRIALS: usize = 6;

/// A reduction with a larger misfit describes another controller.
const MISFIT: f64 = 0.25;

/// Everything that the result calls for.
pub(super) fn of(result: &PredictionErrorResult, assembly: &Assembly<'_>, warnings: &mut Vec<Warning>) {
    residuals(result, warnings);
    let mut warn = |code: &str, message: String| warnings.push(Warning::new(code, message));
    let unstable: Vec<&str> =
        result.trials.iter().filter(|t| t.stable == Some(false)).map(|t| t.trial.as_str()).collect();
    if !unstable.is_empty() {
        warn(
            "loop_unstable",
            format!(
                "with the plant the estimated loop of {} is unstable, while the person's was not",
                unstable.join(", ")
            ),
        );
    }
    if let Err(why) = &assembly.sampled {
        warn("plant_not_sampled", format!("nothing was simulated, since the plant has no sampled form: {why}"));
    }
    let undetermined: Vec<&str> =
        result.trials.iter().filter(|t| t.feedforward.lines.is_empty()).map(|t| t.trial.as_str()).collect();
    if !undetermined.is_empty() {
        warn(
            "feedforward_not_determined",
            format!("the command of {} has too few frequencies to determine the feedforward", undetermined.join(", ")),
        );
    }
    let trap = &result.inverse_trap;
    let is_large = trap.ratio_to_default.is_some_and(|r| r > TRAP_RATIO);
    if is_large || trap.cosine.is_some_and(|c| c > TRAP_COSINE) {
        let ratio =
            trap.ratio_to_default.map_or_else(String::new, |r| format!(", {r:.1} times that of the default lags"));
        let cosine = trap.cosine.unwrap_or(f64::NAN);
        warn(
            "near_inverse_of_the_plant",
            format!(
                "the feedback may be the negative inverse of the plant, which y = G u fits exactly: their cosine is \
                 {cosine:.2}{ratio}"
            ),
        );
    }
    if let Some(test) = result.hypotheses.unchanged_feedback.filter(|t| t.p_value < LEVEL) {
        warn(
            "feedback_changed",
            format!(
                "the feedback of the first half of the trials is not that of the second (p = {:.1e}), though one is \
                 estimated for all: see `change`, or estimate blocks of trials apart",
                test.p_value
            ),
        );
    }
    if result.trials.len() > MANY_TRIALS && assembly.found.sharing().feedback {
        warn(
            "floor_of_errors",
            format!(
                "{} trials share a feedback; its errors are taken as those of {MANY_TRIALS}, since what is left with \
                 more is bias of the form, which their number does not lessen",
                result.trials.len()
            ),
        );
    }
    if let Some(rational) =
        result.feedback.as_ref().and_then(|f| f.rational.as_ref()).filter(|r| r.relative_misfit > MISFIT)
    {
        warn(
            "reduction_misfit",
            format!(
                "the rational feedback misses the estimated one by {:.0} % (rms over the band): quote the lags",
                100.0 * rational.relative_misfit
            ),
        );
    }
    moves(result, warnings);
    warnings.push(Warning::new(
        "assumptions",
        "the person is taken as linear and time-invariant within a trial, to act on the error no sooner than the least \
         delay, and its noise as a process with the poles of its controllers; how far the feedforward looks ahead is \
         not told",
    ));
}

fn residuals(result: &PredictionErrorResult, warnings: &mut Vec<Warning>) {
    let mut warn = |code: &str, message: String| warnings.push(Warning::new(code, message));
    let tests = &result.residual_tests;
    let coloured: Vec<&str> = result.trials.iter().filter(|t| !t.whiteness.white).map(|t| t.trial.as_str()).collect();
    if !coloured.is_empty() || !tests.whiteness.white {
        let which = if coloured.is_empty() { "all trials together".to_owned() } else { coloured.join(", ") };
        let beside = match &result.moving_average_answer {
            Some(answer) if answer.whiteness.white => {
                "; with a moving average they are white: see `moving_average_answer`"
            }
            Some(_) => "; nor are they with a moving average",
            None => "",
        };
        warn(
            "prediction_errors_not_white",
            format!(
                "the residuals of {which} are not white, and the noise model carries the feedback: their intervals are \
                 not of 95 %{beside}"
            ),
        );
    }
    for (code, test, what) in [
        ("feedforward_cut_short", &tests.later_command, "command"),
        ("feedback_cut_short", &tests.later_error, "error"),
    ] {
        if test.p_value < CUT_SHORT {
            warn(
                code,
                format!("later lags of the {what} explain more (p = {:.1e}): the form is cut short", test.p_value),
            );
        }
    }
}

/// The answer moves with the form by more than its interval.
fn moves(result: &PredictionErrorResult, warnings: &mut Vec<Warning>) {
    let Some((answer, others)) = result.profile.split_first() else { return };
    let half = |of: &dyn Fn(&super::result::PredictionErrorNorms) -> NormResult| {
        let widths: Option<Vec<f64>> = result
            .trials
            .iter()
            .map(|t| of(&t.metrics).nominal_interval.map(|[low, high]| 0.5 * (high - low)))
            .collect();
        crate::num::stats::mean(&widths?)
    };
    type Norm = fn(&super::result::ProfileEntry) -> Option<f64>;
    let quantities: [(&str, Norm, Option<f64>); 2] = [
        ("‖Gfb‖", |e| e.norm_feedback, half(&|m| m.norm_feedback.clone())),
        ("‖Gff G − 1‖", |e| e.norm_feedforward_plant_minus_one, half(&|m| m.norm_feedforward_plant_minus_one.clone())),
    ];
    for (name, of, half) in quantities {
        let (Some(value), Some(half)) = (of(answer), half) else { continue };
        let far: Vec<String> = others
            .iter()
            .filter_map(|e| Some((e, of(e)?)))
            .filter(|(_, other)| (other - value).abs() > half)
            .map(|(e, other)| format!("{other:.3} ({})", e.form))
            .collect();
        if !far.is_empty() {
            warnings.push(Warning::new(
                "answer_moves",
                format!("{name} is {value:.3}, and moves by more than its interval with the form: {}", far.join(", ")),
            ));
        }
    }
}
