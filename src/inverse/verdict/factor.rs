//! c* of several inputs: the factor on the whole gain at which it becomes optimal, between two certificates.
//!
//! cK is optimal for c = 1 − t where `Q ⪰ tKᵀRK` (in sampled time S = R + BᵀPB in the place of R): from c* upwards, in
//! sampled time up to where R would be lost. It is found by bisection: at the lower end a certificate says that no
//! weights exist, or the loop is not stable; at the upper end weights are certified.

use super::plane::{self, Outcome};
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

/// The verdict on the core with c times its gain; infeasible too where that does not stabilise.
fn verdict_at(core: &Core, c: f64, ctl: &Ctl) -> Result<Verdict, DecisionError> {
    let mut scaled = core.clone();
    scaled.k *= c;
    scaled.rounding.k *= c;
    let is_stable = Lyapunov::new(&scaled.closed_loop(), core.clock).is_ok_and(|equation| equation.is_stable());
    if !is_stable {
        return Ok(Verdict::Infeasible);
    }
    let Some(reduced) = Reduced::new(&scaled) else { return Ok(Verdict::Boundary) };
    Ok(match plane::search(&scaled, &reduced, ctl)? {
        Outcome::Primal(_) => Verdict::Feasible,
        Outcome::Dual(..) | Outcome::Coupling(_) => Verdict::Infeasible,
        Outcome::Neither => Verdict::Boundary,
    })
}

/// c* to a thousandth, where the gain itself has this verdict; `None` where no factor that is tried is certified, or
/// the certificates of both sides leave a wider gap.
pub(super) fn several_inputs(core: &Core, own: Verdict, ctl: &Ctl) -> Result<Option<f64>, DecisionError> {
    let steps = || (0..STEPS).map(|step| (FIRST * 2f64.powi(step)).exp());
    let mut high = (own == Verdict::Feasible).then_some(1.0);
    for c in steps().flat_map(|c| [c, 1.0 / c]) {
        if high.is_some() {
            break;
        }
        high = (verdict_at(core, c, ctl)? == Verdict::Feasible).then_some(c);
    }
    let Some(start) = high else { return Ok(None) };
    let (mut low, mut high) = (None, start);
    for c in steps().map(|c| start / c) {
        match verdict_at(core, c, ctl)? {
            Verdict::Feasible => high = c,
            Verdict::Infeasible => {
                low = Some(c);
                break;
            }
            Verdict::Boundary => {}
        }
    }
    let Some(mut low) = low else { return Ok(None) };
    while high > low * (1.0 + PRECISION) {
        let middle = (low * high).sqrt();
        match verdict_at(core, middle, ctl)? {
            Verdict::Feasible => high = middle,
            Verdict::Infeasible => low = middle,
            // Not decided: nothing between is narrower than this.
            Verdict::Boundary => return Ok(None),
        }
    }
    Ok(Some(high))
}
