//! The feedforward denominators of a pool in nested blocks, at the lines and on the cells of a band.

use super::models::{Cells, Model};
use crate::ctl::{Ctl, Stopped};
use crate::identify::pool::Pool;
use crate::identify::problem::Problem;
use crate::identify::search::factored::tree::{Deviation, Tree};
use num_complex::Complex64;

/// A block of denominators `D (1 + δ)` around a centre D, which need not be one of them.
#[derive(Debug)]
pub(super) struct Block {
    /// D at each line, and the largest |δ| there.
    pub lines: Vec<(Complex64, f64)>,
    /// D on each cell, and the largest |δ| there; infinite where nothing is known.
    pub cells: Vec<(Model, f64)>,
    /// The largest difference of each coefficient from the centre's, ascending powers; zeros for a single denominator.
    pub reach: Vec<f64>,
    /// Positions of the blocks that divide it; none for a single denominator.
    pub parts: Vec<u32>,
    /// Position in the pool of the first of them.
    pub first: u32,
}

impl Block {
    pub(super) fn is_single(&self) -> bool {
        self.parts.is_empty()
    }
}

/// Every denominator, in nested blocks.
#[derive(Debug)]
pub(super) struct Denominators {
    pub blocks: Vec<Block>,
    pub roots: Vec<u32>,
}

impl Denominators {
    pub(super) fn new(problem: &Problem, pool: &Pool, cells: &Cells, ctl: &Ctl) -> Result<Self, Stopped> {
        let factors = pool.feedforward();
        let responses: Vec<Vec<Complex64>> = factors.iter().map(|d| problem.at_lines(&d.coefficients)).collect();
        let tree = Tree::new(&responses, Deviation::Ratio, 1, ctl)?;
        let degree = factors.iter().map(|d| d.coefficients.len()).max().unwrap_or(1);
        let powers: Vec<Vec<Model>> = (0..cells.count).map(|cell| cells.powers(degree, cell)).collect();
        let on_cell = |descending: &[f64], cell: usize| {
            let mut sum = Model::ZERO;
            descending.iter().rev().zip(&powers[cell]).for_each(|(c, power)| sum.add(*c, power));
            sum
        };
        let mut blocks = Vec::with_capacity(tree.nodes.len());
        for node in &tree.nodes {
            ctl.check()?;
            let members = &tree.order[node.members.clone()];
            // Descending powers of one length; a mean of one is that one, bit by bit.
            let mut centre = vec![0.0; degree];
            for member in members {
                let own = &factors[*member].coefficients;
                centre[degree - own.len()..].iter_mut().zip(own).for_each(|(sum, c)| *sum += c / members.len() as f64);
            }
            let mut lines: Vec<(Complex64, f64)> = problem.at_lines(&centre).into_iter().map(|d| (d, 0.0)).collect();
            let mut on_cells: Vec<(Model, f64)> = (0..cells.count).map(|cell| (on_cell(&centre, cell), 0.0)).collect();
            let mut reach = vec![0.0_f64; degree];
            if members.len() > 1 {
                for member in members {
                    for ((centre, radius), value) in lines.iter_mut().zip(&responses[*member]) {
                        *radius = widest(*radius, (value - *centre).norm() / centre.norm());
                    }
                    let mut difference: Vec<f64> = centre.iter().map(|c| -c).collect();
                    let own = &factors[*member].coefficients;
                    difference[degree - own.len()..].iter_mut().zip(own).for_each(|(sum, c)| *sum += c);
                    let ascending = reach.iter_mut().zip(difference.iter().rev());
                    ascending.for_each(|(reach, c)| *reach = reach.max(c.abs() * (1.0 + 1e-12)));
                    for (cell, (centre, radius)) in on_cells.iter_mut().enumerate() {
                        let least = centre.least(cells.half);
                        let share = on_cell(&difference, cell).most(cells.half) / least;
                        *radius = widest(*radius, if least > 0.0 { share } else { f64::INFINITY });
                    }
                }
            }
            let parts = node.children.iter().map(|child| *child as u32).collect();
            blocks.push(Block { lines, cells: on_cells, reach, parts, first: members[0] as u32 });
        }
        Ok(Self { blocks, roots: tree.roots.iter().map(|root| *root as u32).collect() })
    }
}

/// The larger radius, rounding allowed for; infinite where one is no number.
fn widest(radius: f64, share: f64) -> f64 {
    let share = share * (1.0 + 1e-12);
    if share.is_nan() { f64::INFINITY } else { radius.max(share) }
}
