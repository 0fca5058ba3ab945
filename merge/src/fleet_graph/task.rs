//! The expensive parts of merging as plain values: what to do, and what came of it. They can be done
//! on any thread, and what comes out depends on what went in alone.

use super::clique::largest_consistent;
use super::closure::{Found, Window, find};
use super::compose::{Placed, compose};
use super::member::{SubmapRun, ways_m};
use crate::align::{AlignConfig, Alignment, align, assess, null_f1};
use msg::{Grid, Pose2, pose::wrap_angle};
use posegraph::{Edge, Kernel, SolverOptions};
use std::sync::Arc;

/// Two closures agree if one leads to the other within this, metres and radians,
const AGREE: [f64; 2] = [0.12, 0.03];
/// and this more for each metre that the robots drove between them; the heading lost on the way moves the other end.
const AGREE_PER_M: [f64; 2] = [0.01, 0.004];
/// The most of all together: SLAM's own drift along a way without closures.
const AGREE_MAX: [f64; 2] = [4.0, 0.4];
/// A closure that the solution contradicts by so many standard deviations is not believed.
const CONTRADICTED_SIGMAS: f64 = 6.0;
/// Closures between robots may be wrong: farther off than 2 standard deviations, they pull less and less. What SLAM
/// knows of its own submaps has passed its own checks and counts as it is.
const CLOSURE_KERNEL: Kernel = Kernel::Cauchy { sigmas: 2.0 };
/// Each solution may bring maps together that were far apart, hence graduated. It runs to 10 µm in at most 20
/// iterations: nothing waits for it, and the next solution begins from it.
const SOLVER: SolverOptions =
    SolverOptions { iterations_max: 20, step_min: 1e-5, graduated: true, prior: 1e-6 };

/// One piece of work. See [`super::FleetPoseGraph::next_task`].
#[derive(Debug)]
pub struct Task {
    /// Which incarnations of the robots it is about: a result about others is thrown away.
    pub(crate) runs: Vec<Option<SubmapRun>>,
    pub(crate) job: Job,
}

/// What a [`Task`] came to. See [`super::FleetPoseGraph::apply_outcome`].
#[derive(Debug)]
pub struct Outcome {
    pub(crate) runs: Vec<Option<SubmapRun>>,
    pub(crate) answer: Answer,
}

#[derive(Debug)]
pub(crate) enum Job {
    /// Where does one robot's map lie in another's?
    Align { pair: usize, nodes: [u32; 2], a: Vec<Placed>, b: Vec<Placed>, config: AlignConfig },
    /// How well do two robots' maps agree where the fleet's graph has them?
    Assess { pair: usize, a: Vec<Placed>, b: Vec<Placed> },
    /// Does submap j lie in submap i?
    Match { pair: usize, ids: [usize; 2], grids: [Arc<Grid>; 2], predicted: Pose2, window: Window },
    /// Where do all submaps lie?
    Solve(Problem),
    /// One robot's map from its submaps.
    Straighten { robot: usize, version: u64, anchor: Pose2, corrections: Vec<Pose2>, placed: Vec<Placed> },
}

#[derive(Debug)]
pub(crate) enum Answer {
    Align { pair: usize, nodes: [u32; 2], found: Option<(Alignment, f64)> },
    Assess { pair: usize, found: Option<(Alignment, f64)> },
    Match { pair: usize, ids: [usize; 2], found: Option<Found> },
    Solve(Solution),
    Straighten { robot: usize, version: u64, anchor: Pose2, corrections: Vec<Pose2>, grid: Option<Grid> },
}

/// A closure between two robots.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Closure {
    /// Submaps of the first and of the second robot.
    pub ids: [usize; 2],
    pub found: Found,
}

/// The fleet's graph as it is now; the first pose is `map` itself.
#[derive(Debug)]
pub(crate) struct Problem {
    pub poses: Vec<Pose2>,
    pub constraints: Vec<Edge>,
    /// For each robot in it: its index, where its submaps begin, and their poses in its own map.
    pub members: Vec<(usize, usize, Vec<Pose2>)>,
    pub pairs: Vec<ProblemPair>,
}

/// What two robots say of each other.
#[derive(Debug)]
pub(crate) struct ProblemPair {
    pub pair: usize,
    /// Places in [`Problem::members`].
    pub members: [usize; 2],
    pub closures: Vec<Closure>,
    /// Holds while there are no closures.
    pub seed: Option<Edge>,
}

#[derive(Debug)]
pub(crate) struct Solution {
    /// `map` from `robotK/map` at each submap.
    pub members: Vec<(usize, Vec<Pose2>)>,
    /// For each pair: which closures are in force, and how far the solution leaves them on the mean, metres.
    pub pairs: Vec<(usize, Vec<usize>, f64)>,
}

impl Task {
    /// Does it.
    pub fn run(self) -> Outcome {
        let answer = match self.job {
            Job::Align { pair, nodes, a, b, config } => {
                let found = both(&a, &b).and_then(|[a, b]| {
                    let found = align(a.view(), b.view(), &config)?;
                    let chance =
                        if found.accepted { null_f1(a.view(), b.view(), found.a_from_b) } else { 0.0 };
                    Some((found, chance))
                });
                Answer::Align { pair, nodes, found }
            }
            Job::Assess { pair, a, b } => {
                let found = both(&a, &b).and_then(|[a, b]| {
                    let found = assess(a.view(), b.view(), Pose2::IDENTITY)?;
                    Some((found, null_f1(a.view(), b.view(), Pose2::IDENTITY)))
                });
                Answer::Assess { pair, found }
            }
            Job::Match { pair, ids, grids, predicted, window } => {
                let found = find(grids[0].view(), grids[1].view(), predicted, window);
                Answer::Match { pair, ids, found }
            }
            Job::Solve(problem) => Answer::Solve(problem.solve()),
            Job::Straighten { robot, version, anchor, corrections, placed } => {
                Answer::Straighten { robot, version, anchor, corrections, grid: compose(&placed) }
            }
        };
        Outcome { runs: self.runs, answer }
    }
}

fn both(a: &[Placed], b: &[Placed]) -> Option<[Grid; 2]> {
    Some([compose(a)?, compose(b)?])
}

impl Problem {
    fn solve(mut self) -> Solution {
        let mut in_force: Vec<Vec<usize>> = self.pairs.iter().map(|pair| self.consistent(pair)).collect();
        let start = self.poses.clone();
        self.relax(&in_force);
        // What the whole contradicts is left out, and the whole is solved once more without it.
        let limit = CONTRADICTED_SIGMAS.powi(2);
        let kept: Vec<Vec<usize>> = self
            .pairs
            .iter()
            .zip(&in_force)
            .map(|(pair, closures)| {
                let stands = |k: &&usize| {
                    let closure = self.constraint(pair, **k);
                    closure.chi_squared(self.poses[closure.a], self.poses[closure.b]) <= limit
                };
                closures.iter().filter(stands).copied().collect()
            })
            .collect();
        if kept != in_force {
            in_force = kept;
            self.poses = start;
            self.relax(&in_force);
        }
        let members = self.members.iter().map(|(robot, first, own)| {
            let corrections = own.iter().zip(&self.poses[*first..]).map(|(own, map)| *map * own.inverse());
            (*robot, corrections.collect())
        });
        let pairs = self.pairs.iter().zip(&in_force).map(|(pair, closures)| {
            let off = closures.iter().map(|k| {
                let c = self.constraint(pair, *k);
                self.poses[c.a].between(self.poses[c.b]).distance_m(c.a_from_b)
            });
            (pair.pair, closures.clone(), off.sum::<f64>() / closures.len().max(1) as f64)
        });
        Solution { members: members.collect(), pairs: pairs.collect() }
    }

    fn relax(&mut self, in_force: &[Vec<usize>]) {
        let mut constraints = self.constraints.clone();
        for (pair, closures) in self.pairs.iter().zip(in_force) {
            constraints.extend(closures.iter().map(|k| self.constraint(pair, *k)));
            constraints.extend(pair.seed.filter(|_| closures.is_empty()));
        }
        // After an error the poses are where SLAM and the anchors have them: the best that is known.
        let _ = posegraph::solve(&mut self.poses, &constraints, &SOLVER);
    }

    fn constraint(&self, pair: &ProblemPair, k: usize) -> Edge {
        let Closure { ids, found } = pair.closures[k];
        let place = |side: usize| self.members[pair.members[side]].1 + ids[side];
        Edge {
            a: place(0),
            b: place(1),
            a_from_b: found.i_from_j,
            information: found.information,
            kernel: CLOSURE_KERNEL,
        }
    }

    /// The largest set of closures that can be true together, given how the robots drove.
    fn consistent(&self, pair: &ProblemPair) -> Vec<usize> {
        let [a, b] = pair.members.map(|member| &self.members[member].2);
        let [along_a, along_b] = [a, b].map(|poses| ways_m(poses));
        let agree = |k: usize, l: usize| {
            let (one, other) = (&pair.closures[k], &pair.closures[l]);
            let ([i, j], [m, n]) = (one.ids, other.ids);
            let implied = a[m].between(a[i]) * one.found.i_from_j * b[j].between(b[n]);
            let way_m = (along_a[i] - along_a[m]).abs() + (along_b[j] - along_b[n]).abs();
            let [drift_m, drift_rad] = AGREE_PER_M.map(|per_m| per_m * way_m);
            let swing_m = 0.5 * drift_rad * a[i].distance_m(a[m]);
            let within_m = (AGREE[0] + drift_m + swing_m).min(AGREE_MAX[0]);
            let within_rad = (AGREE[1] + drift_rad).min(AGREE_MAX[1]);
            let turned = wrap_angle(implied.yaw_rad - other.found.i_from_j.yaw_rad).abs();
            implied.distance_m(other.found.i_from_j) <= within_m && turned <= within_rad
        };
        largest_consistent(pair.closures.len(), |k| f64::from(pair.closures[k].found.inliers), agree)
    }
}
