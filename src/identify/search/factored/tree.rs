//! A tree over one factor of the candidates (the feedback denominators, the feedback numerators or the feedforward
//! denominators), by their responses at the lines.
//!
//! A node stands for a cluster of factors. With the response `x_c` of its centre, each member deviates by
//! `d = ln(x/x_c)` or `d = x/x_c − 1` per line, and
//!
//! `d = Σ_m t_m v_m + ρ`, `low_m ≤ t_m ≤ high_m`, `|ρ_k| ≤ remainder_k`, `|d_k| ≤ radius_k`
//!
//! with real t and the cluster's principal directions `v_m ∈ Cᴷ`. A tree depends on the lines and the pool, not on the
//! measured response: all trials of a study share it.

use crate::ctl::{Ctl, Stopped};
use num_complex::Complex64;

/// Principal directions kept per node.
pub(crate) const DIRECTIONS: usize = 2;

/// How members deviate from a centre.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Deviation {
    /// `ln(x/x_c)`: products of factors add up.
    Logarithm,
    /// `x/x_c − 1`: linear in the coefficients of a polynomial.
    Ratio,
}

/// A cluster of factors.
#[derive(Debug, Clone)]
pub(crate) struct Node {
    /// Response of the centre at each line, which need not be a member's.
    pub centre: Vec<Complex64>,
    /// Principal directions, `DIRECTIONS · K` values, zero where there are fewer.
    pub directions: Vec<Complex64>,
    /// Range of the coordinate along each direction.
    pub low: [f64; DIRECTIONS],
    pub high: [f64; DIRECTIONS],
    /// Largest modulus per line of what the directions leave over.
    pub remainder: Vec<f64>,
    /// Largest modulus per line of the deviation.
    pub radius: Vec<f64>,
    /// Root mean square over the lines of the radius: the size of the cluster as a number.
    pub spread: f64,
    /// The members, a range of [`Tree::order`].
    pub members: std::ops::Range<usize>,
    /// Positions of the sub-clusters; none in a leaf.
    pub children: Vec<usize>,
}

/// A tree of clusters.
#[derive(Debug, Clone)]
pub(crate) struct Tree {
    pub nodes: Vec<Node>,
    /// Positions of the factors, so that every node's members are adjacent.
    pub order: Vec<usize>,
    /// The nodes that together hold every factor: the root, and a node of its own for each factor with a zero or a pole
    /// on a line, from which nothing deviates by a finite amount.
    pub roots: Vec<usize>,
}

/// Rounds of power iteration per direction. An inexact direction costs a little in the remainder, which is measured
/// after it.
const POWER_ITERATIONS: usize = 12;

/// Moduli outside this range count as a zero or a pole on the line.
const REGULAR: std::ops::Range<f64> = 1e-12..1e12;

impl Tree {
    /// Over these responses, with leaves of at most `leaf` members.
    ///
    /// # Errors
    /// [`Stopped`] when `ctl` says so.
    pub(crate) fn new(
        responses: &[Vec<Complex64>],
        deviation: Deviation,
        leaf: usize,
        ctl: &Ctl,
    ) -> Result<Self, Stopped> {
        let (regular, singular): (Vec<usize>, Vec<usize>) =
            (0..responses.len()).partition(|i| responses[*i].iter().all(|x| REGULAR.contains(&x.norm())));
        let mut tree = Self { nodes: Vec::new(), order: regular, roots: Vec::new() };
        if !tree.order.is_empty() {
            let all = 0..tree.order.len();
            let root = tree.grow(responses, deviation, leaf.max(1), all, ctl)?;
            tree.roots.push(root);
        }
        for factor in singular {
            let at = tree.order.len();
            tree.order.push(factor);
            let node = Node::single(&responses[factor], at);
            tree.roots.push(tree.nodes.len());
            tree.nodes.push(node);
        }
        Ok(tree)
    }

    fn grow(
        &mut self,
        responses: &[Vec<Complex64>],
        deviation: Deviation,
        leaf: usize,
        members: std::ops::Range<usize>,
        ctl: &Ctl,
    ) -> Result<usize, Stopped> {
        ctl.check()?;
        let (node, along) = Node::around(responses, deviation, &self.order[members.clone()], members.start);
        let id = self.nodes.len();
        self.nodes.push(node);
        if members.len() > leaf {
            // Split at the median of the first principal coordinate.
            let mut sorted: Vec<(f64, usize)> =
                along.into_iter().zip(self.order[members.clone()].iter().copied()).collect();
            sorted.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            for (slot, (_, factor)) in self.order[members.clone()].iter_mut().zip(sorted) {
                *slot = factor;
            }
            let middle = (members.start + members.end) / 2;
            for half in [members.start..middle, middle..members.end] {
                let child = self.grow(responses, deviation, leaf, half, ctl)?;
                self.nodes[id].children.push(child);
            }
        }
        Ok(id)
    }
}

impl Node {
    fn single(response: &[Complex64], at: usize) -> Self {
        let lines = response.len();
        Self {
            centre: response.to_vec(),
            directions: vec![Complex64::ZERO; DIRECTIONS * lines],
            low: [0.0; DIRECTIONS],
            high: [0.0; DIRECTIONS],
            remainder: vec![0.0; lines],
            radius: vec![0.0; lines],
            spread: 0.0,
            members: at..at + 1,
            children: Vec::new(),
        }
    }

    /// The cluster of these factors, and each one's coordinate along the first direction.
    fn around(responses: &[Vec<Complex64>], deviation: Deviation, factors: &[usize], first: usize) -> (Self, Vec<f64>) {
        let mut node = Self::single(&responses[factors[0]], first);
        node.members = first..first + factors.len();
        if factors.len() == 1 {
            return (node, vec![0.0]);
        }
        let lines = node.centre.len();
        let deviations = |centre: &[Complex64]| -> Vec<Vec<Complex64>> {
            let of = |x: Complex64, c: Complex64| match deviation {
                Deviation::Logarithm => (x / c).ln(),
                Deviation::Ratio => x / c - 1.0,
            };
            factors.iter().map(|i| responses[*i].iter().zip(centre).map(|(x, c)| of(*x, *c)).collect()).collect()
        };
        // The mean of the members; a second round removes what the branch of the logarithm did to the first.
        for _ in 0..2 {
            let around = deviations(&node.centre);
            for (k, centre) in node.centre.iter_mut().enumerate() {
                let mean = around.iter().map(|d| d[k]).sum::<Complex64>() / factors.len() as f64;
                *centre *= match deviation {
                    Deviation::Logarithm => mean.exp(),
                    Deviation::Ratio => 1.0 + mean,
                };
            }
        }
        let around = deviations(&node.centre);
        let mut left = around.clone();
        let mut along = vec![0.0; factors.len()];
        for m in 0..DIRECTIONS.min(factors.len() - 1) {
            let Some(direction) = principal(&left) else { break };
            let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
            for (i, rest) in left.iter_mut().enumerate() {
                let t = product(rest, &direction);
                low = low.min(t);
                high = high.max(t);
                rest.iter_mut().zip(&direction).for_each(|(r, v)| *r -= v * t);
                if m == 0 {
                    along[i] = t;
                }
            }
            (node.low[m], node.high[m]) = (low, high);
            node.directions[m * lines..(m + 1) * lines].copy_from_slice(&direction);
        }
        let largest = |values: &[Vec<Complex64>], k: usize| values.iter().map(|d| d[k].norm()).fold(0.0, f64::max);
        for k in 0..lines {
            // The last places of t and of the difference are not the members' own.
            node.remainder[k] = largest(&left, k) + 1e-14 * largest(&around, k);
            node.radius[k] = largest(&around, k);
        }
        node.spread = (node.radius.iter().map(|r| r * r).sum::<f64>() / lines as f64).sqrt();
        (node, along)
    }
}

/// The real inner product of Cᴷ.
fn product(a: &[Complex64], b: &[Complex64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a.re * b.re + a.im * b.im).sum()
}

/// The unit vector along which these vectors are longest, nearly; `None` where they vanish.
fn principal(vectors: &[Vec<Complex64>]) -> Option<Vec<Complex64>> {
    let longest = vectors.iter().max_by(|a, b| product(a, a).total_cmp(&product(b, b)))?;
    let unit = |v: Vec<Complex64>| {
        let norm = product(&v, &v).sqrt();
        (norm > 1e-13).then(|| v.into_iter().map(|x| x / norm).collect::<Vec<_>>())
    };
    let mut direction = unit(longest.clone())?;
    for _ in 0..POWER_ITERATIONS {
        let mut next = vec![Complex64::ZERO; direction.len()];
        for v in vectors {
            let share = product(v, &direction);
            next.iter_mut().zip(v).for_each(|(n, x)| *n += x * share);
        }
        let norm = product(&next, &next).sqrt();
        if norm.is_nan() || norm <= f64::MIN_POSITIVE {
            break;
        }
        direction = next.into_iter().map(|x| x / norm).collect();
    }
    Some(direction)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Second-order polynomials at 7 lines, one with a root on a line.
    fn factors() -> Vec<Vec<Complex64>> {
        let mut all = Vec::new();
        for i in 0..40 {
            let (a1, a0) = (0.1 * f64::from(i % 8), 1.0 + 0.5 * f64::from(i / 8));
            let at = |k: i32| Complex64::new(a0 - f64::from(k * k), a1 * f64::from(k));
            all.push((1..8).map(at).collect());
        }
        all
    }

    #[test]
    fn every_member_lies_in_its_cluster() {
        let responses = factors();
        for deviation in [Deviation::Logarithm, Deviation::Ratio] {
            let tree = Tree::new(&responses, deviation, 2, &Ctl::new()).unwrap();
            let mut order = tree.order.clone();
            order.sort_unstable();
            assert_eq!(order, (0..40).collect::<Vec<_>>());
            assert!(tree.roots.len() > 1, "a1 = 0 and a0 = 1 has a root at the first line");
            for node in &tree.nodes {
                for factor in &tree.order[node.members.clone()] {
                    let lines = node.centre.len();
                    let d: Vec<Complex64> = responses[*factor]
                        .iter()
                        .zip(&node.centre)
                        .map(|(x, c)| match deviation {
                            Deviation::Logarithm if x == c => Complex64::ZERO,
                            Deviation::Logarithm => (x / c).ln(),
                            Deviation::Ratio => x / c - 1.0,
                        })
                        .collect();
                    if d.iter().any(|d| !d.is_finite()) {
                        assert_eq!(node.members.len(), 1);
                        continue;
                    }
                    let mut rest = d.clone();
                    for m in 0..DIRECTIONS {
                        let v = &node.directions[m * lines..(m + 1) * lines];
                        let t = product(&rest, v);
                        assert!(t >= node.low[m] - 1e-12 && t <= node.high[m] + 1e-12);
                        rest.iter_mut().zip(v).for_each(|(r, v)| *r -= v * t);
                    }
                    for k in 0..lines {
                        assert!(d[k].norm() <= node.radius[k] + 1e-12);
                        assert!(rest[k].norm() <= node.remainder[k] + 1e-12);
                    }
                }
            }
        }
    }

    #[test]
    fn ratios_of_second_order_polynomials_need_two_directions() {
        let responses: Vec<_> = factors().into_iter().filter(|f| f.iter().all(|x| x.norm() > 0.0)).collect();
        let tree = Tree::new(&responses, Deviation::Ratio, 1, &Ctl::new()).unwrap();
        for node in &tree.nodes {
            assert!(node.remainder.iter().zip(&node.radius).all(|(left, radius)| *left <= 1e-11 * radius.max(1.0)));
        }
    }
}
