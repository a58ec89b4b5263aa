//! Climbs from several starts: coarsely from each, then to the top of every hill that is met.

use super::ascent::Task;
use super::climb::{COARSE, Ending, FINE};
use super::search::SAME;
use crate::ctl::Stopped;
use rayon::iter::{IntoParallelRefIterator as _, ParallelIterator as _};

/// Where a climb ended, and the value there.
pub(super) type End = (Vec<f64>, f64);

/// Coarse climbs that end this near to each other, in the logarithms of the unknowns, are on one hill: within the
/// reach of the simplex with which the fine climb begins.
const MEET: f64 = 0.05;
/// Hills that end this share below the highest are left at their coarse end, but for the highest of them.
const HOPELESS: f64 = 0.03;
/// Values that differ by less than this share are the same long before the tops are reached.
const EQUAL: f64 = 0.01 * SAME;

/// Steps that progress counts for each start.
pub(super) const STEPS: u64 = 2;

/// The end of the climb from each start; those that met have the same.
///
/// # Errors
/// [`Stopped`].
pub(super) fn climb_from(task: &Task<'_>, starts: &[Vec<f64>], spacing: &[f64]) -> Result<Vec<End>, Stopped> {
    let climb = |start: &[f64], ending: Ending| {
        if task.is_limited() {
            task.climb_along_limits(start, spacing, ending)
        } else {
            task.climb(start, spacing, ending)
        }
    };
    let coarse: Vec<End> = starts
        .par_iter()
        .map(|start| {
            let end = climb(start, COARSE);
            task.ctl.advance(1);
            end
        })
        .collect::<Result<_, Stopped>>()?;
    let hills = hills(&coarse);
    let done: Vec<(usize, Vec<usize>, End)> = hills
        .par_iter()
        .map(|hill| {
            let mut top = coarse[hill.best].clone();
            if hill.is_worth_it {
                let found = climb(&top.0, FINE)?;
                if found.1 > top.1 {
                    top = found;
                }
            }
            task.ctl.advance(hill.members.len() as u64);
            Ok((hill.best, hill.members.clone(), top))
        })
        .collect::<Result<_, Stopped>>()?;
    let mut ends = coarse;
    for (_, members, top) in done {
        for member in members {
            ends[member] = top.clone();
        }
    }
    Ok(ends)
}

/// Coarse ends that met.
#[derive(Debug, PartialEq)]
struct Hill {
    /// The highest of them.
    best: usize,
    members: Vec<usize>,
    is_worth_it: bool,
}

/// Which ends met, the highest first.
fn hills(ends: &[End]) -> Vec<Hill> {
    let mut order: Vec<usize> = (0..ends.len()).collect();
    // Ties go to the first.
    order.sort_by(|a, b| ends[*b].1.total_cmp(&ends[*a].1).then(a.cmp(b)));
    let mut found: Vec<Hill> = Vec::new();
    for i in order {
        let (x, value) = &ends[i];
        let meets = |hill: &&mut Hill| {
            let (top, most) = &ends[hill.best];
            let is_near = x.iter().zip(top).all(|(x, top)| (x - top).abs() <= MEET);
            is_near || (value - most).abs() <= EQUAL * most.abs()
        };
        match found.iter_mut().find(meets) {
            Some(hill) => hill.members.push(i),
            None => found.push(Hill { best: i, members: vec![i], is_worth_it: value.is_finite() }),
        }
    }
    let highest = found.first().map_or(f64::NEG_INFINITY, |hill| ends[hill.best].1);
    let hopeless = found.iter_mut().filter(|hill| ends[hill.best].1 < highest * (1.0 - HOPELESS));
    hopeless.skip(1).for_each(|hill| hill.is_worth_it = false);
    found
}

#[cfg(test)]
mod tests {
    use super::{Hill, hills};

    #[test]
    fn ends_that_met_are_one_hill() {
        let end = |x: f64, y: f64, value: f64| (vec![x, y], value);
        let found = hills(&[
            end(1.0, 2.0, 1.9),
            end(1.04, 2.01, 1.95),
            end(1.08, 2.0, 1.94),
            end(4.0, 2.0, 1.0),
            end(9.0, 9.0, 1.95 * (1.0 + 1e-10)),
            end(5.0, 3.0, 0.9),
            end(5.0, 5.0, f64::NEG_INFINITY),
        ]);
        let hill = |best: usize, members: &[usize], is_worth_it| Hill { best, members: members.to_vec(), is_worth_it };
        // As high as another is the same answer, wherever it lies; the lowest are left as they are.
        let expected = [
            hill(4, &[4, 1], true),
            hill(2, &[2], true),
            hill(0, &[0], true),
            hill(3, &[3], true),
            hill(5, &[5], false),
            hill(6, &[6], false),
        ];
        assert_eq!(found, expected);
        let together = hills(&[end(1.0, 2.0, 1.9), end(1.04, 2.01, 1.95), end(1.08, 2.0, 1.94), end(1.0, 2.06, 1.96)]);
        assert_eq!(together[0], hill(3, &[3], true));
        assert_eq!(together[1], hill(1, &[1, 2, 0], true));
    }
}
