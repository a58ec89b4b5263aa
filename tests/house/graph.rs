//! The graph of the library's files: an arrow from each file to those that define what it uses.

use crate::source::Sources;
use std::collections::{BTreeMap, BTreeSet};

/// Siblings in one circle, from which on no best order is sought: all arrows among them count as upward.
const MOST_SIBLINGS: usize = 18;

/// Arrows among the files of the library, tests left out.
#[derive(Debug)]
pub struct Graph {
    /// The module of each file.
    pub modules: Vec<Vec<String>>,
    pub names: Vec<String>,
    pub arrows: BTreeSet<(usize, usize)>,
}

impl Graph {
    /// An arrow for each path of a file, imported or written out, that leads to a definition in another file, however
    /// many re-exports are between. Methods and fields lead nowhere, as no path names them.
    pub fn of(sources: &Sources) -> Self {
        let mut arrows = BTreeSet::new();
        for (index, module) in sources.modules.iter().enumerate() {
            let paths =
                module.imports.iter().filter(|import| !import.test).flat_map(|i| sources.resolve(index, &i.path));
            let mentions = module.mentions.iter().filter(|mention| !mention.test);
            for target in paths.chain(mentions.flat_map(|mention| sources.mentioned(index, mention))) {
                if let crate::resolve::Target::Item(defined) = target {
                    arrows.insert((module.file, sources.modules[defined].file));
                }
            }
        }
        arrows.retain(|(from, to)| from != to && !sources.files[*from].test && !sources.files[*to].test);
        Self {
            modules: sources.files.iter().map(|file| file.module.clone()).collect(),
            names: sources.files.iter().map(|file| file.path.display().to_string()).collect(),
            arrows,
        }
    }

    /// Import circles: strongly connected components of more than one file, the largest first.
    pub fn circles(&self) -> Vec<Vec<&str>> {
        let arrows: Vec<_> = self.arrows.iter().copied().collect();
        let mut circles = components(self.names.len(), &arrows);
        circles.retain(|circle| circle.len() > 1);
        circles.sort_by_key(|circle| std::cmp::Reverse(circle.len()));
        circles.iter().map(|circle| circle.iter().map(|file| self.names[*file].as_str()).collect()).collect()
    }

    /// Arrows that begin in a room (a module with all below it) and how many of them end there too.
    pub fn within(&self, room: &[&str]) -> (usize, usize) {
        let from = self.arrows.iter().filter(|(from, _)| self.inside(*from, room));
        (from.clone().count(), from.filter(|(_, to)| self.inside(*to, room)).count())
    }

    fn inside(&self, file: usize, room: &[&str]) -> bool {
        let module = &self.modules[file];
        module.len() >= room.len() && module.iter().zip(room).all(|(a, b)| a == b)
    }

    /// The arrows that run upward of those which begin in a room (a module with all below it).
    ///
    /// A module stands above what is below its folder, and files and folders of one folder stand in the order in which
    /// the fewest arrows run against it. So an arrow runs upward when
    /// - it ends in the file of a module that its own file lies in (`mod.rs`, or the file beside the folder), or
    /// - it leads from one member of a folder of the room to another against that order (a member is a file or a folder
    ///   with all below it), so at least one arrow of each circle of members is upward, or
    /// - it leads out of the room to something that uses the room in turn, directly or through others.
    ///
    /// A definition that a façade re-exports counts as where it is written, so moving names through `pub use` changes
    /// nothing.
    pub fn upward(&self, room: &[&str]) -> Vec<(&str, &str)> {
        let mut upward = Vec::new();
        let mut among: BTreeMap<&[String], Vec<(usize, usize)>> = BTreeMap::new();
        for &(from, to) in self.arrows.iter().filter(|(from, _)| self.inside(*from, room)) {
            let (a, b) = (&self.modules[from], &self.modules[to]);
            let common = a.iter().zip(b).take_while(|(a, b)| a == b).count();
            if common == b.len() {
                upward.push((from, to));
            } else if common < room.len() {
                if self.reaches(to, room) {
                    upward.push((from, to));
                }
            } else if common < a.len() {
                among.entry(&a[..common]).or_default().push((from, to));
            }
        }
        for (folder, arrows) in among {
            upward.extend(self.against_the_order(folder.len(), &arrows));
        }
        upward.into_iter().map(|(from, to)| (self.names[from].as_str(), self.names[to].as_str())).collect()
    }

    fn reaches(&self, from: usize, room: &[&str]) -> bool {
        let (mut seen, mut open) = (BTreeSet::from([from]), vec![from]);
        while let Some(file) = open.pop() {
            if self.inside(file, room) {
                return true;
            }
            let next = self.arrows.range((file, 0)..(file + 1, 0)).map(|(_, to)| *to);
            open.extend(next.filter(|to| seen.insert(*to)));
        }
        false
    }

    /// Arrows among the members of a folder, `depth` words below the root, that run against the best order.
    fn against_the_order(&self, depth: usize, arrows: &[(usize, usize)]) -> Vec<(usize, usize)> {
        let member = |file: usize| self.modules[file][depth].as_str();
        let names: BTreeSet<&str> = arrows.iter().flat_map(|(from, to)| [member(*from), member(*to)]).collect();
        let names: Vec<&str> = names.into_iter().collect();
        let place = |file: usize| names.binary_search(&member(file)).unwrap();
        let between: Vec<(usize, usize)> = arrows.iter().map(|(from, to)| (place(*from), place(*to))).collect();
        let mut upward = Vec::new();
        for circle in components(names.len(), &between).into_iter().filter(|circle| circle.len() > 1) {
            let inner = |at: usize| circle.iter().position(|member| *member == at);
            let pairs: Vec<_> = between.iter().map(|(a, b)| inner(*a).zip(inner(*b))).collect();
            let order = (circle.len() <= MOST_SIBLINGS).then(|| {
                let mut weights = vec![vec![0; circle.len()]; circle.len()];
                pairs.iter().flatten().for_each(|(a, b)| weights[*a][*b] += 1);
                best_order(&weights)
            });
            let against = |(a, b): (usize, usize)| order.as_ref().is_none_or(|order| order[a] < order[b]);
            upward.extend(
                arrows.iter().zip(&pairs).filter(|(_, pair)| pair.is_some_and(against)).map(|(arrow, _)| *arrow),
            );
        }
        upward
    }
}

/// The height of each member in an order, users above what they use, in which the least weight runs upward:
/// `weights[a][b]` arrows lead from `a` to `b`. By dynamic programming over the sets of the lowest members.
fn best_order(weights: &[Vec<u32>]) -> Vec<usize> {
    let n = weights.len();
    let mut cost = vec![u32::MAX; 1 << n];
    let mut last = vec![0; 1 << n];
    cost[0] = 0;
    for set in 0..1_usize << n {
        for top in (0..n).filter(|member| set >> member & 1 == 0) {
            // Those below that use the one put on top of them run upward.
            let up: u32 = (0..n).filter(|below| set >> below & 1 == 1).map(|below| weights[below][top]).sum();
            let with = set | 1 << top;
            if cost[set] + up < cost[with] {
                (cost[with], last[with]) = (cost[set] + up, top);
            }
        }
    }
    let mut heights = vec![0; n];
    let mut set = (1 << n) - 1;
    for height in (0..n).rev() {
        heights[last[set]] = height;
        set &= !(1 << last[set]);
    }
    heights
}

/// The strongly connected components of a graph: two members are in one when each reaches the other.
fn components(count: usize, arrows: &[(usize, usize)]) -> Vec<Vec<usize>> {
    let mut forward = vec![Vec::new(); count];
    let mut backward = vec![Vec::new(); count];
    for (from, to) in arrows {
        forward[*from].push(*to);
        backward[*to].push(*from);
    }
    let reached = |start: usize, arrows: &[Vec<usize>]| {
        let (mut seen, mut open) = (vec![false; count], vec![start]);
        seen[start] = true;
        while let Some(at) = open.pop() {
            for next in &arrows[at] {
                if !std::mem::replace(&mut seen[*next], true) {
                    open.push(*next);
                }
            }
        }
        seen
    };
    let mut placed = vec![false; count];
    let mut found = Vec::new();
    for start in 0..count {
        if placed[start] {
            continue;
        }
        let (after, before) = (reached(start, &forward), reached(start, &backward));
        let component: Vec<usize> = (0..count).filter(|at| after[*at] && before[*at]).collect();
        component.iter().for_each(|at| placed[*at] = true);
        found.push(component);
    }
    found
}

#[test]
fn components_and_orders_are_the_known_ones() {
    let arrows = [(0, 1), (1, 2), (2, 0), (2, 3), (4, 3)];
    assert_eq!(components(5, &arrows), [vec![0, 1, 2], vec![3], vec![4]]);
    // 0 uses 1 twice, 1 uses 2 once, 2 uses 0 once and 1 three times: 0 above 2 above 1 leaves 2 → 0 and 1 → 2 upward.
    let heights = best_order(&[vec![0, 2, 0], vec![0, 0, 1], vec![1, 3, 0]]);
    let up = |a: usize, b: usize| heights[a] < heights[b];
    assert_eq!((up(0, 1), up(1, 2), up(2, 0), up(2, 1)), (false, true, false, false));
}
