//! Controllers held at zero, in a spec: what of it makes sense.

use crate::analysis::problem::Problem;
use crate::analysis::reading::wrong_spec as wrong;
use crate::identify::held::Held;
use crate::identify::pool::{Degrees, Recipe};
use crate::identify::refine::{Delay, Delays};

/// A pool with what is held at zero.
pub(super) fn holding(recipe: Recipe, held: Option<Held>) -> Recipe {
    if let Some(held) = held { recipe.holding(held) } else { recipe }
}

/// Refuses the degrees of a controller that is held at zero; `at` is where they are written.
pub(super) fn refuse_degrees(held: Option<Held>, degrees: Degrees, at: &str) -> Result<(), Problem> {
    let Degrees { feedforward_numerator, feedforward_denominator, feedback_numerator, feedback_denominator } = degrees;
    let Some(held) = held else { return Ok(()) };
    let given = match held {
        Held::Feedforward => [("numerator", feedforward_numerator), ("denominator", feedforward_denominator)],
        Held::Feedback => [("numerator", feedback_numerator), ("denominator", feedback_denominator)],
    };
    let name = held.name();
    match given.iter().find(|(_, degree)| degree.is_some()) {
        Some((part, _)) => Err(wrong(
            format!("the {name} is held at zero, and has no {part} that could have a degree"),
            format!("{at}/{name}_{part}_degree"),
        )
        .mend("Leave the degree out, or leave the controller free.")),
        None => Ok(()),
    }
}

/// Refuses the delay of a controller that is held at zero.
pub(super) fn refuse_delay(held: Option<Held>, delays: &Delays) -> Result<(), Problem> {
    let Some(held) = held else { return Ok(()) };
    let delay = match held {
        Held::Feedback => &delays.feedback,
        Held::Feedforward => &delays.feedforward,
    };
    if matches!(delay, Delay::Grid(points) if *points == [0.0]) {
        return Ok(());
    }
    let name = held.name();
    Err(wrong(
        format!("the {name} is held at zero, and has nothing that could be delayed"),
        format!("/spec/delay/{name}_s"),
    )
    .mend("Leave the delay out, or leave the controller free."))
}

/// Checks which controllers are to be held at zero beside the fit of both.
pub(super) fn check_restrictions(
    restrictions: Option<&[Held]>,
    held: Option<Held>,
    has_delays: bool,
) -> Result<(), Problem> {
    let Some(listed) = restrictions else { return Ok(()) };
    let at = "/spec/restrictions";
    if let Some(held) = held {
        let detail = format!(
            "the {} is held at zero already, and restrictions are compared with a fit of both controllers",
            held.name()
        );
        return Err(wrong(detail, at).mend("Leave one of held_at_zero and restrictions out."));
    }
    if has_delays {
        return Err(wrong("fits with delays are not compared with restricted ones", at)
            .mend("Leave the delays out, or ask for the restricted fit by held_at_zero with the other one's delay."));
    }
    if listed.is_empty() {
        return Err(wrong("there are 0 restrictions; name feedback, feedforward, or both", at));
    }
    let is_repeated = |i: usize| listed[..i].contains(&listed[i]);
    match (0..listed.len()).find(|i| is_repeated(*i)) {
        Some(i) => Err(wrong(format!("the {} is named twice", listed[i].name()), format!("{at}/{i}"))),
        None => Ok(()),
    }
}
