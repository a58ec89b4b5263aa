//! Products of poles, zeros and gains, which are never listed: a cluster of denominators, one of numerators and a range
//! of gains.

use super::controllers::{Controllers, Parts};
use super::norms::{Norms, Sides};
use super::pair::View;
use crate::ctl::{Ctl, Stopped};
use crate::identify::pool::Pool;
use crate::identify::problem::Problem;
use crate::identify::search::factored::tree::Tree;
use crate::identify::search::factored::trees::FactorTrees;

/// Controllers that are looked at one by one instead of being divided further.
const FEW: f64 = 32.0;

/// Gains closer than this (in logarithms, half of a range) are not divided further.
const NARROW: f64 = 0.04;

/// How far rounding may move the logarithm of a gain, amply.
const LOGARITHM: f64 = 1e-9;

/// Controllers as products.
#[derive(Debug)]
pub(super) struct Products<'a> {
    problem: &'a Problem,
    pool: &'a Pool,
    trees: &'a FactorTrees,
    /// Of each cluster of denominators and of numerators, at the scaled gain one.
    norms: [Vec<Sides>; 2],
}

/// A set of products.
#[derive(Debug, Clone, Copy)]
pub(super) struct Product {
    denominators: usize,
    numerators: usize,
    negative: bool,
    /// Logarithms of the gains of the scaled shapes, `[low, high)`.
    low: f64,
    high: f64,
}

impl Product {
    fn half(&self) -> f64 {
        0.5 * (self.high - self.low)
    }
}

impl<'a> Products<'a> {
    pub(super) fn new(problem: &'a Problem, pool: &'a Pool, trees: &'a FactorTrees, norms: &Norms) -> Self {
        let united = |tree: &Tree, each: &[Sides], scales: &[f64]| -> Vec<Sides> {
            let of = |members: &[usize]| {
                let own = |i: &usize| each[*i].scaled(1.0 / scales[*i]);
                let mut sides = own(&members[0]);
                members[1..].iter().for_each(|i| sides.unite(&own(i)));
                sides
            };
            tree.nodes.iter().map(|node| of(&tree.order[node.members.clone()])).collect()
        };
        let (d, n) = (&trees.denominators, &trees.numerators);
        let norms = [united(&d.tree, &norms.denominators, &d.scales), united(&n.tree, &norms.numerators, &n.scales)];
        Self { problem, pool, trees, norms }
    }

    /// Less what cannot be stable; `None` where nothing is left.
    fn clip(&self, product: Product) -> Option<Product> {
        let [low, high] = self.trees.ranges.of(product.denominators, product.numerators, product.negative);
        let clipped = Product { low: product.low.max(low), high: product.high.min(high), ..product };
        (clipped.low < clipped.high).then_some(clipped)
    }

    /// Up to eight parts, divided three times along whatever is widest.
    fn divide(&self, whole: Product) -> Vec<Product> {
        let mut parts = vec![whole];
        for _ in 0..3 {
            let mut next = Vec::with_capacity(2 * parts.len());
            for part in parts {
                let p = &self.trees.denominators.tree.nodes[part.denominators];
                let z = &self.trees.numerators.tree.nodes[part.numerators];
                let spreads = [p.spread, z.spread, part.half()];
                let divisible = [!p.children.is_empty(), !z.children.is_empty(), part.half() > NARROW];
                match (0..3).filter(|a| divisible[*a]).max_by(|a, b| spreads[*a].total_cmp(&spreads[*b])) {
                    Some(0) => next.extend(p.children.iter().map(|child| Product { denominators: *child, ..part })),
                    Some(1) => next.extend(z.children.iter().map(|child| Product { numerators: *child, ..part })),
                    Some(_) => {
                        let middle = 0.5 * (part.low + part.high);
                        next.push(Product { high: middle, ..part });
                        next.push(Product { low: middle, ..part });
                    }
                    None => next.push(part),
                }
            }
            parts = next.into_iter().filter_map(|part| self.clip(part)).collect();
        }
        parts
    }

    fn is_small(&self, product: &Product) -> bool {
        let p = &self.trees.denominators.tree.nodes[product.denominators];
        let z = &self.trees.numerators.tree.nodes[product.numerators];
        let gains = (2.0 * product.half() / self.trees.gain_step).max(1.0);
        (p.members.len() * z.members.len()) as f64 * gains <= FEW
            || (p.children.is_empty() && z.children.is_empty() && product.half() <= NARROW)
    }
}

impl Controllers for Products<'_> {
    type Cluster = Product;

    fn roots(&self) -> Vec<Product> {
        let (p, z) = (&self.trees.denominators.tree.roots, &self.trees.numerators.tree.roots);
        let signs = [false, true].into_iter();
        let whole = |negative: bool| {
            p.iter().flat_map(move |denominators| {
                z.iter().map(move |numerators| Product {
                    denominators: *denominators,
                    numerators: *numerators,
                    negative,
                    low: f64::NEG_INFINITY,
                    high: f64::INFINITY,
                })
            })
        };
        signs.flat_map(whole).filter_map(|product| self.clip(product)).collect()
    }

    fn view(&self, product: &Product, into: &mut View) {
        let p = &self.trees.denominators.tree.nodes[product.denominators];
        let z = &self.trees.numerators.tree.nodes[product.numerators];
        let magnitude = (0.5 * (product.low + product.high)).exp();
        let gain = if product.negative { -magnitude } else { magnitude };
        into.inverse.clear();
        into.radius.clear();
        for (k, line) in self.problem.lines().iter().enumerate() {
            // L = L_c e^d, so that κ = L_c (e^d − 1)/(1 + L_c).
            let centre = line.plant * (gain * (p.centre[k] * z.centre[k]));
            let deviation = p.radius[k] + z.radius[k] + product.half() + 1e-12;
            let radius = (centre / (1.0 + centre)).norm() * deviation.exp_m1() * (1.0 + 1e-9) + 1e-15;
            into.inverse.push(1.0 + centre);
            into.radius.push(if radius.is_nan() { f64::INFINITY } else { radius });
        }
        let [low, high] = self.norms[0][product.denominators].mean_with(&self.norms[1][product.numerators]);
        into.norm = [low * (product.low - LOGARITHM).exp(), high * (product.high + LOGARITHM).exp()];
        if into.norm[1].is_nan() {
            into.norm[1] = f64::INFINITY;
        }
    }

    fn parts(&self, product: &Product, ctl: &Ctl) -> Result<Parts<Product>, Stopped> {
        ctl.check()?;
        if !self.is_small(product) {
            return Ok(Parts::Clusters(self.divide(*product)));
        }
        let (d, n) = (&self.trees.denominators, &self.trees.numerators);
        // A little wider than the range, whose ends are decided by the logarithms.
        let bounds = [(product.low - LOGARITHM).exp(), (product.high + LOGARITHM).exp()];
        let mut controllers = Vec::new();
        for i in d.tree.nodes[product.denominators].members.clone() {
            let denominator = d.tree.order[i];
            let opened = self.pool.feedback().open(denominator);
            for j in n.tree.nodes[product.numerators].members.clone() {
                let numerator = n.tree.order[j];
                let scale = d.scales[denominator] * n.scales[numerator];
                opened.visit(numerator, product.negative, bounds.map(|bound| bound / scale), |feedback| {
                    let log = (feedback.gain.abs() * scale).ln();
                    if product.low <= log && log < product.high {
                        controllers.push(feedback);
                    }
                });
            }
        }
        Ok(Parts::Controllers(controllers))
    }
}
