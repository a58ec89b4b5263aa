//! c* of several inputs: the factor on the whole gain at which it becomes optimal, between two certificates.
//!
//! cK is optimal for c = 1 − t where `Q ⪰ tKᵀRK` (in sampled time S = R + BᵀPB in the place of R): from c* upwards, in
//! sampled time up to where R would be lost. It is bracketed: at the lower end a certificate says that no weights
//! exist, or the loop is not stable; at the upper end weights are certified. The margins of the programs, which prove
//! nothing, say where between the ends to look next.

use super::plane::{self, Found, Outcome};
use super::{DecisionError, Verdict};
use crate::control::lyapunov::Lyapunov;
use crate::ctl::Ctl;
use crate::inverse::reach::Core;
use crate::inverse::verdict::reduced::Reduced;

/// Entries of the gain up to which it is looked for: each step is a verdict of its own.
pub(super) const ENTRIES: usize = 36;
/// Factors that are tried are exp(±0.02), and the exponent doubles up to 10.
const FIRST: f64 = 0.02;
const STEPS: i32 = 10;
/// How well it is found, relative.
const PRECISION: f64 = 1e-3;
/// How far from where the margins put c* it is asked, as a share of the precision: on the side that is open.
const BESIDE: f64 = 0.3;
/// Of a bracket the middle is asked where the margins would leave more than this share of it.
const SLOW: f64 = 0.5;

/// A factor that was asked.
#[derive(Debug, Clone, Copy)]
struct Asked {
    /// ln c.
    place: f64,
    verdict: Verdict,
    /// Positive where weights exist.
    margin: Option<f64>,
}

/// The verdict on the core with c times its gain; infeasible too where that does not stabilise.
fn ask(core: &Core, place: f64, ctl: &Ctl) -> Result<Asked, DecisionError> {
    let c = place.exp();
    let mut scaled = core.clone();
    scaled.k *= c;
    scaled.rounding.k *= c;
    let answer = |verdict, margin| Asked { place, verdict, margin };
    let is_stable = Lyapunov::new(&scaled.closed_loop(), core.clock).is_ok_and(|equation| equation.is_stable());
    if !is_stable {
        return Ok(answer(Verdict::Infeasible, None));
    }
    let Some(reduced) = Reduced::new(&scaled) else { return Ok(answer(Verdict::Boundary, None)) };
    let Found { outcome, margin } = plane::search(&scaled, &reduced, ctl)?;
    Ok(match outcome {
        Outcome::Primal(_) => answer(Verdict::Feasible, margin),
        Outcome::Dual(..) | Outcome::Coupling(_) => answer(Verdict::Infeasible, margin),
        Outcome::Neither => answer(Verdict::Boundary, margin),
    })
}

/// Where the line through two margins crosses zero.
fn crossing(one: Asked, two: Asked) -> Option<f64> {
    let (first, second) = (one.margin?, two.margin?);
    let share = first / (first - second);
    share.is_finite().then_some(one.place + share * (two.place - one.place))
}

/// c* to a thousandth, where the gain itself has this verdict; `None` where no factor that is tried is certified, or
/// the certificates of both sides leave a wider gap.
pub(super) fn several_inputs(core: &Core, own: Verdict, ctl: &Ctl) -> Result<Option<f64>, DecisionError> {
    let steps = || (0..STEPS).map(|step| FIRST * 2f64.powi(step));
    let mut high = (own == Verdict::Feasible).then_some(Asked { place: 0.0, verdict: own, margin: None });
    for place in steps().flat_map(|step| [step, -step]) {
        if high.is_some() {
            break;
        }
        high = Some(ask(core, place, ctl)?).filter(|asked| asked.verdict == Verdict::Feasible);
    }
    let Some(start) = high else { return Ok(None) };
    let (mut low, mut high) = (None, start);
    for step in steps() {
        let asked = ask(core, start.place - step, ctl)?;
        match asked.verdict {
            Verdict::Feasible => high = asked,
            Verdict::Infeasible => {
                low = Some(asked);
                break;
            }
            Verdict::Boundary => {}
        }
    }
    let Some(mut low) = low else { return Ok(None) };
    let precision = PRECISION.ln_1p();
    let mut halve = false;
    while high.place - low.place > precision {
        let width = high.place - low.place;
        let middle = 0.5 * (low.place + high.place);
        let place = match crossing(low, high).filter(|place| !halve && low.place < *place && *place < high.place) {
            // Beside the crossing, on the side of the end that is farther: that end comes next to it if it is right.
            Some(place) => {
                let towards = if high.place - place > place - low.place { BESIDE } else { -BESIDE };
                (place + towards * precision).clamp(low.place + 0.01 * width, high.place - 0.01 * width)
            }
            None => middle,
        };
        let asked = ask(core, place, ctl)?;
        match asked.verdict {
            Verdict::Feasible => high = asked,
            Verdict::Infeasible => low = asked,
            // Not decided: nothing between is narrower than this.
            Verdict::Boundary => return Ok(None),
        }
        halve = high.place - low.place > SLOW * width;
    }
    Ok(Some(high.place.exp()))
}
