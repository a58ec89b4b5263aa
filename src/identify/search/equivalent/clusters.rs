//! Clusters of like sensitivity, with the range of ‖Gfb‖ in each.

use super::controllers::{Controllers, Parts};
use super::norms::Norms;
use super::pair::View;
use crate::ctl::{Ctl, Stopped};
use crate::identify::search::sensitivity::build::cluster::Cluster;
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

/// The range of no controller.
const NOTHING: [f64; 2] = [f64::INFINITY, 0.0];

/// Makes the range of a cluster of those of its parts.
fn unite(clusters: &Clusters, cluster: u32, norms: &mut [[f64; 2]]) -> [f64; 2] {
    for part in &clusters.nodes[cluster as usize].children {
        let [low, high] = unite(clusters, *part, norms);
        let whole = &mut norms[cluster as usize];
        *whole = [whole[0].min(low), whole[1].max(high)];
    }
    norms[cluster as usize]
}

impl<'a> ClustersWithNorms<'a> {
    pub(super) fn new(clusters: &'a Clusters, lines: usize, norms: &Norms) -> Self {
        let units: Vec<[f64; 2]> = clusters
            .rows
            .par_iter()
            .map(|row| norms.of_unit(row.denominator as usize, row.numerator as usize).map(|norm| norm * row.unit))
            .collect();
        let leaf = |members: std::ops::Range<u32>| {
            members.fold(NOTHING, |[low, high], place| {
                let (row, gain) = clusters.row_and_gain(place as usize);
                let [own_low, own_high] = units[row].map(|norm| norm * gain.abs());
                [low.min(own_low), high.max(own_high)]
            })
        };
        let own = |node: &Cluster| if node.children.is_empty() { leaf(node.members.clone()) } else { NOTHING };
        let mut norms: Vec<[f64; 2]> = clusters.nodes.par_iter().map(own).collect();
        for root in &clusters.roots {
            unite(clusters, *root, &mut norms);
        }
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
