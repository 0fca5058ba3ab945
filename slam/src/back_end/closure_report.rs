//! Closures that people inspect and undo.

use super::BackEnd;
use super::loop_closures::{REJECTED_M, REJECTED_NODES, REJECTED_RAD};
use crate::graph::{Edge, EdgeKind};
use msg::{Pose2, pose::wrap_angle};

/// Links between nodes this far apart in order exist only because a closure brought passes together.
const PASS_NODES: u32 = 12;
/// A closure and its evidence.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClosureReport {
    /// Its number, for [`BackEnd::undo_closure`].
    pub number: u32,
    /// The earlier node.
    pub older: u32,
    /// The later node.
    pub newer: u32,
    /// Whether the closure is active; false after it was retracted.
    pub is_active: bool,
    /// The later node as seen from the earlier one, as measured.
    pub older_from_newer: Pose2,
    /// The map from both.
    pub poses: [Pose2; 2],
    /// How well the scans fitted, 0 to 1.
    pub response: f32,
    /// Squared error in the graph, in standard deviations.
    pub chi_squared: f64,
}

impl BackEnd {
    /// All closures, active or not, in the order in which they were found.
    pub fn closures(&self) -> impl Iterator<Item = ClosureReport> + '_ {
        let closures = self.graph.edges().iter().filter(|e| e.kind == EdgeKind::Closure);
        closures.enumerate().map(|(number, edge)| ClosureReport {
            number: number as u32,
            older: edge.a,
            newer: edge.b,
            is_active: edge.is_active,
            older_from_newer: edge.a_from_b,
            poses: [edge.a, edge.b].map(|id| self.graph.poses()[id as usize]),
            response: edge.response,
            chi_squared: self.graph.chi_squared(edge),
        })
    }

    /// Undoes a closure, with all links that it made possible and that do not stand without it.
    /// False if there is no active closure of that number.
    pub fn undo_closure(&mut self, number: u32) -> bool {
        let is_closure = |(_, e): &(usize, &Edge)| e.kind == EdgeKind::Closure;
        let found = self.graph.edges().iter().enumerate().filter(is_closure).nth(number as usize);
        let Some((index, edge)) = found.filter(|(_, e)| e.is_active) else { return false };
        let wrong = *edge;
        // A closure is found together with those that confirm it: they say the same and fall with it.
        let same = |e: &Edge| {
            let near = e.a.abs_diff(wrong.a) <= REJECTED_NODES && e.b.abs_diff(wrong.b) <= REJECTED_NODES;
            e.kind == EdgeKind::Closure && near && self.agree(e, &wrong)
        };
        let edges = self.graph.edges();
        let fallen: Vec<usize> = (0..edges.len()).filter(|&i| i == index || same(&edges[i])).collect();
        self.undo(&fallen);
        true
    }

    /// Undoes all closures. Returns how many.
    pub fn clear_closures(&mut self) -> usize {
        let edges = self.graph.edges();
        let closures: Vec<usize> =
            (0..edges.len()).filter(|&i| edges[i].is_active && edges[i].kind == EdgeKind::Closure).collect();
        let count = closures.len();
        if count > 0 {
            self.undo(&closures);
        }
        count
    }

    fn agree(&self, a: &Edge, b: &Edge) -> bool {
        let implied = self.graph.implied_by(a, [b.a, b.b]);
        let turned = wrap_angle(implied.yaw_rad - b.a_from_b.yaw_rad).abs();
        implied.distance_m(b.a_from_b) < REJECTED_M && turned < REJECTED_RAD
    }

    /// Deactivates closures and the links between passes made since; then links again what is known
    /// well enough without them, and solves.
    fn undo(&mut self, closures: &[usize]) {
        let first = closures.iter().copied().min().unwrap_or(0);
        for &index in closures {
            let edge = self.graph.edge_mut(index);
            edge.is_active = false;
            self.loop_closures.reject(edge);
        }
        let between_passes: Vec<usize> = (first..self.graph.edges().len())
            .filter(|&i| {
                let e = &self.graph.edges()[i];
                e.is_active && e.kind == EdgeKind::ScanMatch && e.a.abs_diff(e.b) > PASS_NODES
            })
            .collect();
        let mut again: Vec<u32> = between_passes.iter().map(|&i| self.graph.edges()[i].b).collect();
        for index in between_passes {
            self.graph.edge_mut(index).is_active = false;
        }
        self.solve(true);
        again.sort_unstable();
        again.dedup();
        for id in again {
            let relative = self.uncertainty_from(id);
            self.link_near(id, &relative);
        }
        self.solve(false);
    }
}
