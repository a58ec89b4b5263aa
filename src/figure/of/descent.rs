//! How a descent towards a gain went.

use super::bode::Unreadable;
use super::document::{all_numbers, number};
use super::provenance::ReportOrigin;
use crate::analysis::{Analysis as _, Report, inverse_lqe, inverse_lqg, inverse_lqr};
use crate::figure::text::three;
use crate::figure::{Axis, Figure, Ink, Mark, Panel, Series, Weight};

/// The name of the figure in addresses.
pub const NAME: &str = "descent";

/// The squared distance of the gains and the relative distance over the steps of the descent of Priess 2015, Table 3.1;
/// of a whole controller (§4.4.3) those of regulator and filter.
///
/// # Errors
/// [`Unreadable`] where the kind has no descent, or none was asked for.
pub fn descent(report: &Report, subject: &str) -> Result<Figure, Unreadable> {
    let halves: &[(&str, &str)] = if report.kind == inverse_lqr::Plan::KIND {
        &[("", "K")]
    } else if report.kind == inverse_lqe::Plan::KIND {
        &[("", "L")]
    } else if report.kind == inverse_lqg::Plan::KIND {
        &[("/regulator", "K"), ("/filter", "L")]
    } else {
        return Err(Unreadable::Kind { kind: report.kind.to_string() });
    };
    let (mut squares, mut shares, mut findings) = (Vec::new(), Vec::new(), Vec::new());
    for (at, (root, gain)) in halves.iter().enumerate() {
        let own = format!("{root}/fit/descent");
        if report.result.pointer(&format!("{own}/course")).is_none() {
            continue;
        }
        let steps = all_numbers(&report.result, &format!("{own}/course/step"))?;
        let line = |name: &str| -> Result<Series, Unreadable> {
            let values = all_numbers(&report.result, &format!("{own}/course/{name}"))?;
            let look = (Mark::Line, Ink::of_group(at), Weight::Thick);
            Ok(Series::values(*gain, look, steps.clone(), values.into_iter().map(Some)).labelled())
        };
        squares.push(line("residual")?);
        shares.push(line("relative_distance")?);
        let end =
            |name: &str| number(&report.result, &format!("{own}/{name}")).map_or_else(|| "unknown".to_owned(), three);
        let left_out = ["rejected_q", "rejected_r"].map(|name| number(&report.result, &format!("{own}/{name}")));
        let left_out: f64 = left_out.into_iter().flatten().sum();
        let stalled = if left_out > 0.0 { format!("; {left_out} parts of steps were left out") } else { String::new() };
        findings.push(format!(
            "{gain}: from {} to {} in {} steps{stalled}.",
            end("first_residual"),
            end("residual"),
            steps.last().copied().unwrap_or(0.0)
        ));
    }
    if squares.is_empty() {
        return Err(Unreadable::Nothing("the spec asked for no descent; ask with fit.descent".to_owned()));
    }
    let origin = ReportOrigin { subject: subject.to_owned() };
    Ok(Figure {
        name: NAME.to_owned(),
        title: format!("{subject}: the gradient descent"),
        description: findings.join(" "),
        caption: format!("It promises no minimum: the fit beside it is usually nearer. {}", origin.caption(report)),
        sampling: String::new(),
        x: Axis::linear("step", "").including(&[0.0]),
        panels: vec![
            Panel::new(
                "",
                Axis::linear("squared distance of the gains", "unit of the gain²").including(&[0.0]),
                squares,
            ),
            Panel::new("", Axis::linear("relative distance of the gains", "1").including(&[0.0]), shares),
        ],
    })
}
