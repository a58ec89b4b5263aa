//! Every feedback controller of a pool, in nested clusters of like sensitivities.
//!
//! What a controller does to a response is its sensitivity `S = 1/(1 + G Gfb)` at the lines, and controllers of very
//! different poles, zeros and gains have nearly the same: some thousand clusters within a third of their centre hold
//! the 31 million of appendix B. Members of a cluster deviate by `κ = S_c/S − 1 = Σ_i t_i v_i + ρ` from its centre,
//! with real t, few directions v and a small rest. Clusters depend on plant, lines and pool, not on what was measured:
//! all trials of a study share them.

use super::cluster::Cluster;
use super::denominators::{self, Denominators};
use super::line_lanes::{LINE_LANES, Rows};
use super::members::{GAIN_BITS, Row, Table};
use super::size::CONTROLLER_LANES as LANES;
use super::tree_builder::{Forest, TreeBuilder};
use crate::ctl::{Ctl, Stopped};
use crate::identify::pool::{Feedback, Pool};
use crate::identify::problem::Problem;
use num_complex::Complex64;
use rayon::prelude::*;

/// Clusters of at most so many members are not divided. Smaller ones save a search little time and cost much memory.
pub(crate) const LEAF: usize = 76;

/// The most controllers that are listed (4 bytes each).
const LARGEST_LIST: u64 = 50_000_000;

/// The clusters of a pool at the lines of a problem.
#[derive(Debug)]
pub struct Clusters {
    pub(crate) nodes: Vec<Cluster>,
    pub(crate) roots: Vec<u32>,
    pub(crate) members: Vec<u32>,
    pub(crate) rows: Vec<Row>,
    pub(crate) gains: Vec<f64>,
    /// `G/D` of each denominator, and each numerator, at the lines.
    pub(crate) denominators: Rows,
    pub(crate) numerators: Rows,
    /// How many denominators make a stable loop without feedback, and the first of them.
    pub(crate) without_feedback: Option<(u64, usize)>,
    pub(crate) feedforward: Denominators,
}

/// Whether the controllers of this pool can be listed.
fn can_list(pool: &Pool) -> bool {
    let table = pool.feedback();
    let rows = table.denominators().len() as u64 * table.numerators().len() as u64;
    table.len() <= LARGEST_LIST
        && table.gains().len() <= 1 << GAIN_BITS
        && rows < 1 << (32 - GAIN_BITS)
        && denominators::can_hold(pool)
}

/// `G/D` of each denominator, and each numerator, at the lines.
pub(crate) fn at_lines(problem: &Problem, pool: &Pool) -> [Rows; 2] {
    let table = pool.feedback();
    let denominator = |d: &[f64]| -> Vec<Complex64> {
        problem.reciprocal_at_lines(d).iter().zip(problem.lines()).map(|(d, line)| line.plant * d).collect()
    };
    let denominators: Vec<_> = table.denominators().par_iter().map(|d| denominator(&d.coefficients)).collect();
    let numerators: Vec<_> = table.numerators().iter().map(|n| problem.at_lines(&n.coefficients)).collect();
    [denominators, numerators].map(|rows| Rows::new(problem.lines().len(), &rows))
}

impl Clusters {
    /// Lists and clusters the controllers. The measured responses of the problem are not used. `None` where
    /// `can_list` says no.
    ///
    /// # Errors
    /// [`Stopped`] when `ctl` says so.
    pub fn new(problem: &Problem, pool: &Pool, ctl: &Ctl) -> Result<Option<Self>, Stopped> {
        Self::with_leaves(problem, pool, LEAF, ctl)
    }

    /// As [`Clusters::new`], dividing clusters of more than `leaf` members: the answer of a search is the same for any.
    ///
    /// # Errors
    /// [`Stopped`] when `ctl` says so.
    pub fn with_leaves(problem: &Problem, pool: &Pool, leaf: usize, ctl: &Ctl) -> Result<Option<Self>, Stopped> {
        if !can_list(pool) {
            return Ok(None);
        }
        let Some(feedforward) = Denominators::new(problem, pool, ctl)? else { return Ok(None) };
        let table = pool.feedback();
        let [denominators, numerators] = at_lines(problem, pool);
        let listed = (0..denominators.len())
            .into_par_iter()
            .map(|denominator| {
                let (mut rows, mut positions) = (Vec::new(), Vec::new());
                let mut zero = false;
                table.walk_denominator(denominator, ctl, |row| {
                    match row.numerator {
                        Some(numerator) => {
                            let new =
                                Row { denominator: denominator as u32, numerator: numerator as u32, unit: row.unit };
                            let before = positions.len();
                            positions.extend(row.positions().iter().map(|p| *p as u8));
                            rows.push((new, positions.len() - before));
                        }
                        None => zero = true,
                    }
                    Ok(())
                })?;
                Ok((rows, positions, zero))
            })
            .collect::<Result<Vec<_>, Stopped>>()?;
        let mut without_feedback = None;
        let (mut rows, mut members) = (Vec::new(), Vec::with_capacity(table.len() as usize));
        for (denominator, (listed, positions, zero)) in listed.into_iter().enumerate() {
            if zero {
                let (count, first) = without_feedback.unwrap_or((0, denominator));
                without_feedback = Some((count + 1, first));
            }
            let mut positions = positions.into_iter();
            for (row, count) in listed {
                let base = (rows.len() as u32) << GAIN_BITS;
                members.extend(positions.by_ref().take(count).map(|p: u8| base | u32::from(p)));
                rows.push(row);
            }
        }
        let gains = table.gains().to_vec();
        let builder = TreeBuilder {
            table: Table::new(&rows, &gains, &denominators, &numerators),
            lines: problem.lines().len(),
            leaf: leaf.max(1),
            ctl,
        };
        let Forest { nodes, roots } = builder.forest(&mut members)?;
        Ok(Some(Self { nodes, roots, members, rows, gains, denominators, numerators, without_feedback, feedforward }))
    }

    fn table(&self) -> Table<'_> {
        Table::new(&self.rows, &self.gains, &self.denominators, &self.numerators)
    }

    /// `1 + L` of up to eight members, by their places in the order of the clusters: per line eight real and eight
    /// imaginary parts, of which those left over repeat the last.
    pub(crate) fn responses(&self, places: &[u32], into: &mut [f64]) {
        let table = self.table();
        for lane in 0..LANES {
            let place = places[lane.min(places.len() - 1)];
            let place = table.place(self.members[place as usize]);
            let ((d, n), gain) = (table.factors(&place), place.gain);
            for ((lines, d), n) in into.chunks_mut(2 * LANES * LINE_LANES).zip(d).zip(n) {
                let parts = d.re.0.iter().zip(&d.im.0).zip(n.re.0.iter().zip(&n.im.0));
                for (line, ((d_re, d_im), (n_re, n_im))) in lines.chunks_exact_mut(2 * LANES).zip(parts) {
                    line[lane] = 1.0 + gain * (d_re * n_re - d_im * n_im);
                    line[LANES + lane] = gain * (d_re * n_im + d_im * n_re);
                }
            }
        }
    }

    /// The row of a member, and its gain as listed.
    pub(crate) fn row_and_gain(&self, place: usize) -> (usize, f64) {
        let member = self.members[place];
        ((member >> GAIN_BITS) as usize, self.gains[(member & ((1 << GAIN_BITS) - 1)) as usize])
    }

    /// The controller of a member.
    pub(crate) fn feedback(&self, place: usize) -> Feedback {
        let member = self.members[place];
        let row = &self.rows[(member >> GAIN_BITS) as usize];
        let position = (member & ((1 << GAIN_BITS) - 1)) as usize;
        Feedback {
            denominator: row.denominator as usize,
            numerator: Some(row.numerator as usize),
            gain: self.gains[position] * row.unit,
            gain_position: Some(position),
        }
    }
}
