//! The exact ranges of the norms over every candidate that costs at most so much.

use super::best::{Best, End};
use super::clusters::ClustersWithNorms;
use super::controllers::{Controllers, Listed};
use super::denominators::Denominators;
use super::models::Cells;
use super::norms::Norms;
use super::pair::Trial;
use super::products::Products;
use super::question::{Quantity, Question, norm_of};
use super::walk::{Material, Walk, Work};
use crate::control::System;
use crate::ctl::{Ctl, Phase, Stopped};
use crate::identify::held::Held;
use crate::identify::pool::{Feedback, FeedbackTable, Position};
use crate::identify::search::prepared::Prepared;
use crate::identify::search::screen::{exact, systems};

/// Cells of the band on which feedforward controllers are bounded.
const CELLS: usize = 32;

/// A member of the set at an end of a range.
#[derive(Debug, Clone, PartialEq)]
pub struct ExtremeMember {
    /// Its index in the pool; of several with the same norm the lowest.
    pub index: u64,
    /// J, by QR.
    pub cost: f64,
    /// The norm.
    pub norm: f64,
    /// Gff.
    pub feedforward: System,
    /// Gfb.
    pub feedback: System,
}

/// Between which members a norm lies over the whole set.
#[derive(Debug, Clone, PartialEq)]
pub struct NormRange {
    /// The member with the smallest norm; `None` where each one's is infinite.
    pub least: Option<ExtremeMember>,
    /// The member with the largest norm; `None` where one's is infinite.
    pub largest: Option<ExtremeMember>,
}

/// The ranges over the set. No candidate of the pool that costs at most the limit has a norm outside of them.
#[derive(Debug, Clone, PartialEq)]
pub struct EquivalentRanges {
    /// Of ‖Gfb‖; `None` where the feedback is held at zero, which it is of every member.
    pub feedback: Option<NormRange>,
    /// Of ‖Gff G − 1‖; `None` where the feedforward is held at zero: it is 1 of every member.
    pub feedforward_plant_minus_one: Option<NormRange>,
    /// Pairs of clusters that were bounded. With several threads this depends on which of them found what first, as
    /// does the next member.
    pub bounded: u64,
    /// Norms computed by quadrature.
    pub evaluated: u64,
}

/// Finds the ranges by branch and bound over what a search has prepared, or over the pool as it is listed. The answer
/// is the same for each. Progress counts parts of the pool.
///
/// # Errors
/// [`Stopped`] when `ctl` says so.
pub fn ranges(question: &Question<'_>, prepared: Option<&Prepared>, ctl: &Ctl) -> Result<EquivalentRanges, Stopped> {
    let Question { problem, pool, plant, norms, .. } = *question;
    let cells = Cells::new(problem.time(), norms.band_rad_s(), CELLS);
    let powers = pool.feedforward().iter().map(|d| d.coefficients.len()).max().unwrap_or(1);
    let material = Material {
        trial: Trial::new(problem, plant, powers, &cells),
        denominators: Denominators::new(problem, pool, &cells, ctl)?,
        norms: Norms::new(pool.feedback(), &cells),
        without_feedback: without_feedback(pool.feedback()),
    };
    match prepared {
        Some(Prepared::Sensitivity(clusters)) => {
            let lines = problem.lines().len();
            of(question, &ClustersWithNorms::new(clusters, lines, &material.norms), &material, ctl)
        }
        Some(Prepared::Factored(trees)) => {
            of(question, &Products::new(problem, pool, trees, &material.norms), &material, ctl)
        }
        None => of(question, &Listed { pool }, &material, ctl),
    }
}

/// The first denominator that makes a stable loop without feedback.
fn without_feedback(table: &FeedbackTable) -> Option<Feedback> {
    let denominator = (0..table.denominators().len()).find(|d| !table.gains_of(*d, None).is_empty())?;
    Some(Feedback { denominator, numerator: None, gain: 0.0, gain_position: None })
}

fn of<C: Controllers>(
    question: &Question<'_>,
    controllers: &C,
    material: &Material,
    ctl: &Ctl,
) -> Result<EquivalentRanges, Stopped> {
    let work = Work::default();
    let candidate = question.pool.candidate(question.pool.position(question.best));
    let end = |quantity: Quantity, end: End| -> Result<Option<Option<ExtremeMember>>, Stopped> {
        ctl.enter(Phase::Intervals, 0.25);
        let best = Best::new(quantity, end);
        let known = norm_of(question, quantity, &candidate);
        if known == f64::INFINITY && quantity == Quantity::Distance && material.trial.has_pole_in_band() {
            // G is infinite there, and every member's norm.
            return Ok(None);
        }
        best.take(known, question.best);
        Walk { controllers, question, material, best: &best, ctl }.run(&work)?;
        Ok(best.found().filter(|(norm, _)| norm.is_finite()).map(|found| member(question, quantity, found)))
    };
    let range = |quantity: Quantity| -> Result<NormRange, Stopped> {
        let least = end(quantity, End::Least)?;
        // Where every norm is infinite there is nothing to look for.
        let largest = if least.is_some() { end(quantity, End::Largest)? } else { None };
        Ok(NormRange { least: least.flatten(), largest: largest.flatten() })
    };
    let unless = |held: Held, quantity| (question.held != Some(held)).then(|| range(quantity)).transpose();
    let feedback = unless(Held::Feedback, Quantity::Feedback)?;
    let feedforward_plant_minus_one = unless(Held::Feedforward, Quantity::Distance)?;
    let (bounded, evaluated) = (work.bounded.into_inner(), work.evaluated.into_inner());
    Ok(EquivalentRanges { feedback, feedforward_plant_minus_one, bounded, evaluated })
}

/// The member with a norm; of a feedback controller the first of its members. `None` where a coefficient overflows.
fn member(question: &Question<'_>, quantity: Quantity, (norm, index): (f64, u64)) -> Option<ExtremeMember> {
    let Question { problem, pool, limit, .. } = *question;
    let count = pool.feedforward().len() as u64;
    let candidate = |index: u64| pool.candidate(pool.position(index));
    let first = match quantity {
        Quantity::Distance => index,
        Quantity::Feedback => {
            let feedback = pool.position(index).feedback;
            let costs = |f: &u64| {
                let position = Position { feedforward: *f as usize, feedback };
                exact::cost(problem, &pool.candidate(position)) <= limit
            };
            index / count * count + (0..index % count).find(costs).unwrap_or(index % count)
        }
    };
    let (cost, [feedforward, feedback]) = systems::systems(problem, pool, &candidate(first)).ok()?;
    Some(ExtremeMember { index: first, cost, norm, feedforward, feedback })
}
