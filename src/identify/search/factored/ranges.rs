//! Which gains make a stable loop, for whole clusters of feedback denominators and numerators.

use super::tree::Tree;
use crate::ctl::{Ctl, Stopped};
use crate::identify::pool::{Extremes, FeedbackTable};
use rayon::prelude::*;

/// Largest number of pairs of clusters in the table (16 bytes each).
const LARGEST_TABLE: usize = 1 << 23;

/// For each pair of a denominator cluster and a numerator cluster, and each sign of the gain, the range of the
/// logarithms of the stable members' gains. Clusters too small for the table have the range of the smallest cluster
/// around them that is in it.
#[derive(Debug)]
pub(crate) struct Ranges {
    /// Position of each node of the two trees in the table.
    pub(super) denominators: Vec<u32>,
    pub(super) numerators: Vec<u32>,
    pub(super) columns: usize,
    /// `[low, high)` for positive gains, then for negative ones; rounded outwards.
    pub(super) table: Vec<[f32; 4]>,
}

const EMPTY: [f32; 4] = [f32::INFINITY, f32::NEG_INFINITY, f32::INFINITY, f32::NEG_INFINITY];

fn unite(into: &mut [f32; 4], other: &[f32; 4]) {
    *into = [into[0].min(other[0]), into[1].max(other[1]), into[2].min(other[2]), into[3].max(other[3])];
}

/// The nodes of a tree that a table keeps: those with more than `cut` members, and their children.
fn tabled(tree: &Tree, cut: usize) -> Vec<usize> {
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
            let (rows, columns) = (tabled(denominators, cut), tabled(numerators, cut));
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
        let computed = leaves
            .par_iter()
            .map(|at| {
                let mut extremes = Extremes::none(width);
                for i in denominators.nodes[rows[*at]].members.clone() {
                    let denominator = denominators.order[i];
                    table.scan(denominator, Some((&mut extremes, scales[0][denominator], scales[1])), ctl)?;
                }
                // Rounded outwards, by more than the logarithms that are compared with these can differ.
                let low = |x: f64| if x < f64::INFINITY { ((x.ln() - 1e-6) as f32).next_down() } else { f32::INFINITY };
                let high = |x: f64| if x > 0.0 { ((x.ln() + 1e-6) as f32).next_up() } else { f32::NEG_INFINITY };
                let each: Vec<[f32; 4]> = (0..width)
                    .map(|n| {
                        [
                            low(extremes.least_positive[n]),
                            high(extremes.most_positive[n]),
                            low(extremes.least_negative[n]),
                            high(extremes.most_negative[n]),
                        ]
                    })
                    .collect();
                // As with the denominators below, from the smallest kept clusters to those around them.
                let mut united = vec![EMPTY; columns.len()];
                for at in (0..columns.len()).rev() {
                    let node = &numerators.nodes[columns[at]];
                    let inner = node.children.first().is_some_and(|child| column_of[*child] != at as u32);
                    let mut range = EMPTY;
                    if inner {
                        node.children.iter().for_each(|child| unite(&mut range, &united[column_of[*child] as usize]));
                    } else {
                        node.members.clone().for_each(|i| unite(&mut range, &each[numerators.order[i]]));
                    }
                    united[at] = range;
                }
                Ok(united)
            })
            .collect::<Result<Vec<_>, Stopped>>()?;
        let mut ranges = vec![EMPTY; rows.len() * columns.len()];
        for (at, row) in leaves.iter().zip(computed) {
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
        Ok(Self { denominators: row_of, numerators: column_of, columns: columns.len(), table: ranges })
    }

    /// The range `[low, high)` of the logarithms of the gains of a sign; empty (low above high) where no member is
    /// stable.
    pub(crate) fn of(&self, denominators: usize, numerators: usize, negative: bool) -> [f64; 2] {
        let at = self.denominators[denominators] as usize * self.columns + self.numerators[numerators] as usize;
        let range = &self.table[at];
        let sign = 2 * usize::from(negative);
        [f64::from(range[sign]), f64::from(range[sign + 1])]
    }
}
