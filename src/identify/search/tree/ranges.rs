//! Which gains make a stable loop, for whole clusters of feedback denominators and numerators.

use super::axis::Tree;
use crate::identify::pool::FeedbackTable;
use crate::num::{Ctl, Stopped};
use rayon::prelude::*;

/// Largest number of pairs of clusters in the table (16 bytes each).
const LARGEST_TABLE: usize = 1 << 23;

/// Largest number of rows whose stable gains are kept (32 bytes each), and of gains that a row can keep.
const LARGEST_ROWS: usize = 1 << 23;
const LARGEST_GAINS: usize = 128;

/// The stable gains of a denominator with a numerator.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Row {
    /// A bit for each listed gain.
    pub stable: u128,
    /// What a listed gain is multiplied with, and the logarithm of that times the scales of the shapes.
    pub unit: f64,
    pub log: f64,
}

/// For each pair of a denominator cluster and a numerator cluster, and each sign of the gain, the range of the logarithms of
/// the stable members' gains. Clusters too small for the table have the range of the smallest cluster around them that is in it.
#[derive(Debug)]
pub(super) struct Ranges {
    /// Position of each node of the two trees in the table.
    denominators: Vec<u32>,
    numerators: Vec<u32>,
    columns: usize,
    /// `[low, high)` for positive gains, then for negative ones; rounded outwards.
    table: Vec<[f32; 4]>,
    /// Every pair of a denominator and a numerator, denominators outermost; empty where there are too many.
    rows: Vec<Row>,
    width: usize,
}

const EMPTY: [f32; 4] = [f32::INFINITY, f32::NEG_INFINITY, f32::INFINITY, f32::NEG_INFINITY];

fn unite(into: &mut [f32; 4], other: &[f32; 4]) {
    *into = [into[0].min(other[0]), into[1].max(other[1]), into[2].min(other[2]), into[3].max(other[3])];
}

/// The nodes of a tree that a table keeps: those with more than `cut` members, and their children.
fn kept(tree: &Tree, cut: usize) -> Vec<usize> {
    let mut kept = tree.roots.clone();
    let mut next = 0;
    while next < kept.len() {
        let node = &tree.nodes[kept[next]];
        if node.members.len() > cut {
            kept.extend(&node.children);
        }
        next += 1;
    }
    kept
}

/// The position of every node in the table: its own, or that of the smallest kept node around it.
fn positions(tree: &Tree, kept: &[usize]) -> Vec<u32> {
    let mut positions = vec![u32::MAX; tree.nodes.len()];
    for (at, node) in kept.iter().enumerate() {
        positions[*node] = at as u32;
    }
    let mut open: Vec<usize> = tree.roots.clone();
    while let Some(node) = open.pop() {
        for child in &tree.nodes[node].children {
            if positions[*child] == u32::MAX {
                positions[*child] = positions[node];
            }
            open.push(*child);
        }
    }
    positions
}

impl Ranges {
    /// `scales` are the factors that turn a gain into that of the normalised shapes: per denominator, per numerator.
    ///
    /// # Errors
    /// [`Stopped`] when `ctl` says so.
    pub(super) fn new(
        table: &FeedbackTable,
        trees: [&Tree; 2],
        scales: [&[f64]; 2],
        ctl: &Ctl,
    ) -> Result<Self, Stopped> {
        let [denominators, numerators] = trees;
        let mut cut = 0;
        let (rows, columns) = loop {
            let (rows, columns) = (kept(denominators, cut), kept(numerators, cut));
            if rows.len() * columns.len() <= LARGEST_TABLE {
                break (rows, columns);
            }
            cut = (2 * cut).max(2);
        };
        let (row_of, column_of) = (positions(denominators, &rows), positions(numerators, &columns));
        // The kept nodes without kept children divide the denominators among them.
        let leaves: Vec<usize> = (0..rows.len())
            .filter(|at| {
                let node = &denominators.nodes[rows[*at]];
                node.children.first().is_none_or(|child| row_of[*child] == *at as u32)
            })
            .collect();
        let width = scales[1].len();
        let keep = scales[0].len() * width <= LARGEST_ROWS && table.gains().len() <= LARGEST_GAINS;
        let computed = leaves
            .par_iter()
            .map(|at| {
                let mut each = vec![EMPTY; width];
                let mut kept: Vec<(usize, Row)> = Vec::new();
                for i in denominators.nodes[rows[*at]].members.clone() {
                    let denominator = denominators.order[i];
                    table.walk_denominator(denominator, ctl, |row| {
                        let Some(numerator) = row.numerator else { return Ok(()) };
                        let scale = scales[0][denominator] * scales[1][numerator];
                        if keep {
                            let unit = row.unit;
                            let stable = row.positions().iter().fold(0, |bits, p| bits | 1_u128 << p);
                            kept.push((
                                denominator * width + numerator,
                                Row { stable, unit, log: (unit * scale).ln() },
                            ));
                        }
                        for gain in row.gains {
                            let log = (gain.abs() * scale).ln();
                            let (low, high) = ((log - 1e-6) as f32, (log + 1e-6) as f32);
                            let (low, high) = (low.next_down(), high.next_up());
                            let range = if *gain > 0.0 {
                                [low, high, EMPTY[2], EMPTY[3]]
                            } else {
                                [EMPTY[0], EMPTY[1], low, high]
                            };
                            unite(&mut each[numerator], &range);
                        }
                        Ok(())
                    })?;
                }
                let united = columns
                    .iter()
                    .map(|node| {
                        let mut range = EMPTY;
                        for i in numerators.nodes[*node].members.clone() {
                            unite(&mut range, &each[numerators.order[i]]);
                        }
                        range
                    })
                    .collect::<Vec<_>>();
                Ok((united, kept))
            })
            .collect::<Result<Vec<_>, Stopped>>()?;
        let mut ranges = vec![EMPTY; rows.len() * columns.len()];
        let mut all = if keep { vec![Row::default(); scales[0].len() * width] } else { Vec::new() };
        for (at, (row, kept)) in leaves.iter().zip(computed) {
            kept.into_iter().for_each(|(at, row)| all[at] = row);
            ranges[at * columns.len()..(at + 1) * columns.len()].copy_from_slice(&row);
        }
        // Children come after their parents, so going backwards every child is complete before it is used.
        for at in (0..rows.len()).rev() {
            for child in &denominators.nodes[rows[at]].children {
                let from = row_of[*child] as usize;
                if from != at {
                    for c in 0..columns.len() {
                        let range = ranges[from * columns.len() + c];
                        unite(&mut ranges[at * columns.len() + c], &range);
                    }
                }
            }
        }
        Ok(Self {
            denominators: row_of,
            numerators: column_of,
            columns: columns.len(),
            table: ranges,
            rows: all,
            width,
        })
    }

    /// The stable gains of a denominator with a numerator, where they are kept.
    pub(super) fn row(&self, denominator: usize, numerator: usize) -> Option<&Row> {
        self.rows.get(denominator * self.width + numerator)
    }

    /// The range `[low, high)` of the logarithms of the gains of a sign; empty (low above high) where no member is stable.
    pub(super) fn of(&self, denominators: usize, numerators: usize, negative: bool) -> [f64; 2] {
        let at = self.denominators[denominators] as usize * self.columns + self.numerators[numerators] as usize;
        let range = &self.table[at];
        let sign = 2 * usize::from(negative);
        [f64::from(range[sign]), f64::from(range[sign + 1])]
    }
}
