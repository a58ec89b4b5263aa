//! Clusters of like sensitivity, with the range of ‖Gfb‖ in each.

use super::controllers::{Controllers, Parts};
use super::norms::Norms;
use super::pair::View;
use crate::ctl::{Ctl, Stopped};
use crate::identify::search::sensitivity::build::clusters::Clusters;
use rayon::prelude::*;

/// Listed controllers.
#[derive(Debug)]
pub(super) struct ClustersWithNorms<'a> {
    clusters: &'a Clusters,
    lines: usize,
    /// Cluster by cluster.
    norms: Vec<[f64; 2]>,
}

impl<'a> ClustersWithNorms<'a> {
    pub(super) fn new(clusters: &'a Clusters, lines: usize, norms: &Norms) -> Self {
        let units: Vec<[f64; 2]> = clusters
            .rows
            .par_iter()
            .map(|row| norms.of_unit(row.denominator as usize, row.numerator as usize).map(|norm| norm * row.unit))
            .collect();
        let leaf = |members: std::ops::Range<u32>| {
            members.fold([f64::INFINITY, 0.0_f64], |[low, high], place| {
                let (row, gain) = clusters.row_and_gain(place as usize);
                let [own_low, own_high] = units[row].map(|norm| norm * gain.abs());
                [low.min(own_low), high.max(own_high)]
            })
        };
        let norms = clusters.nodes.par_iter().map(|node| leaf(node.members.clone())).collect();
        Self { clusters, lines, norms }
    }
}

impl Controllers for ClustersWithNorms<'_> {
    type Cluster = u32;

    fn roots(&self) -> Vec<u32> {
        self.clusters.roots.clone()
    }

    fn view(&self, cluster: &u32, into: &mut View) {
        let node = &self.clusters.nodes[*cluster as usize];
        into.norm = self.norms[*cluster as usize];
        into.inverse.clear();
        into.inverse.extend((0..self.lines).map(|line| node.centre(line)));
        into.radius.clear();
        // Of a cluster without reach nothing is known.
        let known = |line: usize| if node.reach.is_finite() { node.profile(line).radius } else { f64::INFINITY };
        into.radius.extend((0..self.lines).map(known));
    }

    fn parts(&self, cluster: &u32, _: &Ctl) -> Result<Parts<u32>, Stopped> {
        let node = &self.clusters.nodes[*cluster as usize];
        Ok(if node.children.is_empty() {
            Parts::Controllers(node.members.clone().map(|place| self.clusters.feedback(place as usize)).collect())
        } else {
            Parts::Clusters(node.children.to_vec())
        })
    }
}
