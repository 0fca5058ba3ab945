//! Two robots: how their maps lie to each other, what speaks for it, and what was tried.

use super::closure::{Found, Window};
use super::member::Member;
use super::task::Closure;
use crate::align::Alignment;
use msg::{EdgeState, MergeEdge, Pose2, pose::wrap_angle};
use posegraph::{Edge, Kernel, information_from_sigmas};
use std::collections::BTreeMap;

/// Two alignments nearer than this mean the same, metres and radians.
const SAME: [f64; 2] = [1.0, 0.1];
/// Places taken back that are remembered.
pub(crate) const REFUSED_MAX: usize = 8;
/// Closures kept between two robots.
const CLOSURES_MAX: usize = 192;
/// Closures that a submap has with another robot: more say little more.
const CLOSURES_EACH: usize = 3;
/// Failed matches after which a submap is left alone.
const FAILED_EACH: usize = 4;
/// Two submaps are matched if their middles are this near, as a share of their radii.
const NEAR: f64 = 0.35;
/// Pairs of submaps looked through for the next to match.
const LOOKED_THROUGH_MAX: usize = 4096;
/// What an alignment of whole maps is worth, metres and radians.
const SEED: [f64; 2] = [0.05, 0.01];
/// Uncertainty of a prediction: at a closure, and more for each metre driven from there.
const DOUBT_M: [f64; 2] = [0.08, 0.02];
const DOUBT_RAD: [f64; 2] = [0.02, 0.002];
/// How many of its standard deviations are searched, between these bounds.
const SIGMAS: f64 = 2.5;
const HALF_M: [f64; 2] = [0.25, 1.05];
const HALF_RAD: [f64; 2] = [0.06, 0.18];
/// A failed match is tried again when a closure has come this much nearer.
const NEARER: f64 = 0.4;

/// See the module.
#[derive(Clone, Debug, Default)]
pub(crate) struct Pair {
    pub state: Option<EdgeState>,
    /// The first robot's map from the second's, when `state` is in force or waits.
    pub a_from_b: Pose2,
    /// What the newest look at whole maps found, and what chance gives.
    pub grounds: Option<(Alignment, f64)>,
    /// Nodes of both when it was found.
    pub seen_at: [u32; 2],
    pub refused: Vec<Pose2>,
    pub closures: Vec<Closure>,
    /// Which of them are in force.
    pub in_force: Vec<usize>,
    pub residual_m: f64,
    tried: BTreeMap<(usize, usize), Tried>,
    pub seed: Option<Seed>,
    pub tries: u32,
    /// Nodes of both at the last attempt to align.
    pub tried_at: u32,
    /// Attempts left when nothing more will come.
    pub last_tries: u32,
    pub assessed_at: u32,
    pub contradictions: u32,
}

/// Where the alignment of whole maps was right: between two submaps that look at the same place.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Seed {
    pub ids: [usize; 2],
    pub i_from_j: Pose2,
}

#[derive(Clone, Copy, Debug)]
struct Tried {
    way_m: f64,
    found: bool,
}

/// What to match next.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Candidate {
    pub ids: [usize; 2],
    pub predicted: Pose2,
    pub window: Window,
}

impl Pair {
    pub fn state(&self) -> EdgeState {
        self.state.unwrap_or(EdgeState::None)
    }

    /// Whether two places mean the same.
    pub fn same(x: Pose2, y: Pose2) -> bool {
        x.distance_m(y) < SAME[0] && wrap_angle(x.yaw_rad - y.yaw_rad).abs() < SAME[1]
    }

    /// Whether the operator took this place back.
    pub fn is_refused(&self, a_from_b: Pose2) -> bool {
        self.refused.iter().any(|refused| Self::same(*refused, a_from_b))
    }

    /// Takes the edge back for good.
    pub fn undo(&mut self, a_from_b: Pose2) {
        if self.refused.len() == REFUSED_MAX {
            self.refused.remove(0);
        }
        self.refused.push(a_from_b);
        self.a_from_b = a_from_b;
        self.let_go(EdgeState::Undone);
    }

    /// No longer in force; what was found between the two is forgotten, what was tried is not.
    pub fn let_go(&mut self, state: EdgeState) {
        self.state = Some(state);
        self.closures.clear();
        self.in_force.clear();
        self.seed = None;
        self.contradictions = 0;
        self.tried.clear();
    }

    /// The submaps of one of the two are gone: what is left is where the maps lie.
    pub fn begin_again(&mut self, a_from_b: Option<Pose2>) {
        self.closures.clear();
        self.in_force.clear();
        self.tried.clear();
        self.seed = None;
        (self.tried_at, self.assessed_at) = (0, 0);
        match a_from_b {
            Some(a_from_b) if self.state().in_force() => self.a_from_b = a_from_b,
            _ if self.state() == EdgeState::Candidate => self.state = None,
            _ => {}
        }
    }

    /// The submaps that look at the same place, and how they lie to each other.
    pub fn sow(&mut self, a: &Member, b: &Member) {
        if self.seed.is_some() || !self.state().in_force() {
            return;
        }
        let mut best: Option<(f64, [usize; 2])> = None;
        for i in 0..a.poses.len() {
            for j in 0..b.poses.len() {
                let (Some(x), Some(y)) = (a.centre_m(i), b.centre_m(j)) else { continue };
                let y = self.a_from_b.apply(y);
                let apart = (x[0] - y[0]).hypot(x[1] - y[1]);
                if best.is_none_or(|(least, _)| apart < least) {
                    best = Some((apart, [i, j]));
                }
            }
        }
        self.seed = best.map(|(_, [i, j])| Seed {
            ids: [i, j],
            i_from_j: a.poses[i].inverse() * self.a_from_b * b.poses[j],
        });
    }

    /// The seed as a constraint of a graph in which the robots' submaps begin at `first`.
    pub fn seed_constraint(&self, first: [usize; 2]) -> Option<Edge> {
        let Seed { ids, i_from_j } = self.seed?;
        let [a, b] = [0, 1].map(|side| first[side] + ids[side]);
        Some(Edge {
            a,
            b,
            a_from_b: i_from_j,
            information: information_from_sigmas(SEED[0], SEED[1]),
            kernel: Kernel::Quadratic,
        })
    }

    /// The pair of finished submaps that is known best and has not been tried.
    pub fn next_match(&self, a: &Member, b: &Member) -> Option<Candidate> {
        let mut best: Option<(f64, [usize; 2], Pose2)> = None;
        let mut looked = 0;
        let mut have = [vec![0; a.poses.len()], vec![0; b.poses.len()]];
        for closure in &self.closures {
            for (have, id) in have.iter_mut().zip(closure.ids) {
                have.get_mut(id).into_iter().for_each(|count| *count += 1);
            }
        }
        let mut failed = [vec![0; a.poses.len()], vec![0; b.poses.len()]];
        for (i, j) in self.tried.iter().filter(|(_, tried)| !tried.found).map(|(ids, _)| *ids) {
            for (failed, id) in failed.iter_mut().zip([i, j]) {
                failed.get_mut(id).into_iter().for_each(|count| *count += 1);
            }
        }
        for i in 0..a.poses.len() {
            let (Some((of_i, _)), Some(map_from_i)) = (a.piece(i), a.map_from_submap(i)) else { continue };
            for j in 0..b.poses.len() {
                let (Some((of_j, _)), Some(map_from_j)) = (b.piece(j), b.map_from_submap(j)) else {
                    continue;
                };
                let predicted = map_from_i.between(map_from_j);
                let [x, y] = predicted.apply(of_j.centre_m);
                let apart = (x - of_i.centre_m[0]).hypot(y - of_i.centre_m[1]);
                if !of_i.finished || !of_j.finished || apart > NEAR * (of_i.radius_m + of_j.radius_m) {
                    continue;
                }
                let tried = self.tried.get(&(i, j));
                let full = have[0][i] >= CLOSURES_EACH || have[1][j] >= CLOSURES_EACH;
                let vain = failed[0][i] >= FAILED_EACH || failed[1][j] >= FAILED_EACH;
                if full || vain || tried.is_some_and(|tried| tried.found) {
                    continue;
                }
                looked += 1;
                let way_m = self.way_m(a, b, i, j);
                if tried.is_some_and(|t| way_m >= NEARER * t.way_m) {
                    continue;
                }
                if best.is_none_or(|(least, ..)| way_m < least) {
                    best = Some((way_m, [i, j], predicted));
                }
                if looked >= LOOKED_THROUGH_MAX {
                    break;
                }
            }
        }
        best.map(|(way_m, ids, predicted)| Candidate { ids, predicted, window: window(way_m) })
    }

    /// Metres that the robots drove from where they are known to each other.
    fn way_m(&self, a: &Member, b: &Member, i: usize, j: usize) -> f64 {
        let from = |[m, n]: [usize; 2]| a.way_m(i, m) + b.way_m(j, n);
        let closures = self.in_force.iter().filter_map(|k| self.closures.get(*k)).map(|c| c.ids);
        let known = closures.chain(self.seed.map(|seed| seed.ids)).map(from).fold(f64::INFINITY, f64::min);
        // Robots whose starts were given are known to each other there.
        if known.is_finite() { known } else { from([0, 0]) }
    }

    /// Notes what came of a match.
    pub fn matched(&mut self, a: &Member, b: &Member, ids: [usize; 2], found: Option<Found>) {
        let way_m = self.way_m(a, b, ids[0], ids[1]);
        self.tried.insert((ids[0], ids[1]), Tried { way_m, found: found.is_some() });
        let Some(found) = found else { return };
        match self.closures.iter_mut().find(|closure| closure.ids == ids) {
            Some(closure) => closure.found = found,
            None => {
                if self.closures.len() == CLOSURES_MAX {
                    self.closures.remove(0);
                    self.in_force.clear();
                }
                self.closures.push(Closure { ids, found });
            }
        }
    }

    /// As it is told to the fleet.
    pub fn edge(&self, id: usize, robots: [usize; 2]) -> MergeEdge {
        let (found, null_f1) = match &self.grounds {
            Some((found, null_f1)) => (Some(found), *null_f1),
            None => (None, 0.0),
        };
        let of = |value: fn(&Alignment) -> f64| found.map_or(0.0, value);
        MergeEdge {
            id: id as u32 + 1,
            a: robots[0] as u32 + 1,
            b: robots[1] as u32 + 1,
            state: self.state() as u32,
            a_from_b: self.a_from_b,
            inliers: found.map_or(0, |found| found.inliers),
            closures: self.in_force.len() as u32,
            closures_rejected: (self.closures.len() - self.in_force.len()) as u32,
            tries: self.tries,
            residual_m: of(|found| found.residual_m),
            closure_residual_m: self.residual_m,
            overlap_m2: of(|found| found.overlap_m2),
            overlap_share: of(|found| found.overlap_share),
            agreement: of(|found| found.agreement),
            occupied_f1: of(|found| found.occupied_f1),
            null_f1_max: null_f1,
            conflict: of(|found| found.conflict),
            margin: of(|found| found.margin),
        }
    }
}

fn window(way_m: f64) -> Window {
    let doubt = |[at, per_m]: [f64; 2], [least, most]: [f64; 2]| {
        let half = SIGMAS * (at + per_m * way_m);
        half.clamp(least, most)
    };
    Window { half_m: doubt(DOUBT_M, HALF_M), half_rad: doubt(DOUBT_RAD, HALF_RAD) }
}
