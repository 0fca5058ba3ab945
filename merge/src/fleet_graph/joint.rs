//! The joint solution for the submaps of all robots, with the consistent set of closures (last stages).

use super::closures::Closure;
use super::consistency::largest_consistent_set;
use super::edge::CLOSURES_MIN;
use super::frame::ReferenceRobot;
use super::pair::{RobotPair, robots_of_pair};
use super::robot::Robot;
use super::submaps::distances_along_m;
use crate::config::ClosureConfig;
use msg::{Pose2, pose::wrap_angle};
use posegraph::{Edge, Kernel, PoseSigmas, SolveError, SolverOptions, solve};

/// Standard deviations of a given start: what a tape measure and an eye along a wall reach.
const START_SIGMAS: PoseSigmas = PoseSigmas { position_m: 0.03, heading_rad: 0.01 };
/// Kernel of a given start, which may be wrong: closures that agree with each other pull the robot away from it.
const START_KERNEL: Kernel = Kernel::Cauchy { sigmas: 3.0 };
/// Standard deviations of the reference robot in the frame that it defines: practically fixed.
const REFERENCE_SIGMAS: PoseSigmas = PoseSigmas { position_m: 1e-3, heading_rad: 1e-4 };

/// Each solution may bring maps together that were far apart, hence graduated. It runs to 10 µm in at most 20 iterations:
/// nothing waits for it, and the next solution begins from it.
const SOLVER: SolverOptions =
    SolverOptions { iterations_max: 20, step_min: 1e-5, graduated: true, prior: 1e-6 };

/// The joint pose graph of all robots that have a transform. Its first pose is the frame `map` itself.
#[derive(Debug)]
pub(crate) struct JointProblem {
    poses: Vec<Pose2>,
    /// All edges but those between robots.
    edges: Vec<Edge>,
    robots: Vec<RobotInGraph>,
    pairs: Vec<PairInGraph>,
    /// Given starts: indices in `robots` and in `edges`.
    starts: Vec<(usize, usize)>,
    config: ClosureConfig,
}

/// One robot of the graph.
#[derive(Debug)]
struct RobotInGraph {
    /// Index of the robot in the fleet.
    robot: usize,
    /// Index of the pose of its first submap.
    first: usize,
    /// Frame `robotK/map` from the frame of each submap.
    poses: Vec<Pose2>,
}

/// Relations between two robots of the graph.
#[derive(Debug)]
struct PairInGraph {
    /// Index of the pair in the fleet.
    pair: usize,
    /// Indices in [`JointProblem::robots`].
    robots: [usize; 2],
    closures: Vec<Closure>,
    /// Edge from the alignment of the whole maps; used while no closure is active.
    alignment: Option<Edge>,
}

/// A solution of the joint graph.
#[derive(Debug)]
pub(crate) struct JointSolution {
    /// For each robot: its index, and frame `map` from frame `robotK/map` at each submap.
    robots: Vec<(usize, Vec<Pose2>)>,
    pairs: Vec<SolvedPair>,
    /// Index of the robot whose given start closures contradict the most, if they do.
    contradicted_start: Option<usize>,
}

/// Result of a solution for a pair.
#[derive(Debug)]
struct SolvedPair {
    pair: usize,
    /// Indices of the active closures.
    active: Vec<usize>,
    /// Mean residual of these closures, metres.
    residual_m: f64,
}

impl JointProblem {
    /// Collects the graph; `None` while no robot has both a transform and submaps.
    pub fn collect(
        robots: &[Robot],
        pairs: &[RobotPair],
        reference: Option<ReferenceRobot>,
        config: &ClosureConfig,
    ) -> Option<Self> {
        let mut problem = Self {
            poses: vec![Pose2::IDENTITY],
            edges: Vec::new(),
            robots: Vec::new(),
            pairs: Vec::new(),
            starts: Vec::new(),
            config: config.clone(),
        };
        let mut place = vec![None; robots.len()];
        for (index, robot) in robots.iter().enumerate() {
            if robot.estimate.map_from_robot_map().is_some() && !robot.submaps.poses().is_empty() {
                place[index] = Some(problem.robots.len());
                problem.add_robot(index, robot, reference.filter(|reference| reference.robot == index));
            }
        }
        for (index, pair) in pairs.iter().enumerate() {
            let [a, b] = robots_of_pair(index).map(|robot| place[robot]);
            let Some((a, b)) = a.zip(b) else { continue };
            let first = [a, b].map(|place| problem.robots[place].first);
            problem.pairs.push(PairInGraph {
                pair: index,
                robots: [a, b],
                closures: pair.closures.found().to_vec(),
                alignment: pair.closures.alignment_edge(first),
            });
        }
        (!problem.robots.is_empty()).then_some(problem)
    }

    /// Adds a robot's submaps at its transform, with its own links and its edge to the frame.
    fn add_robot(&mut self, index: usize, robot: &Robot, reference: Option<ReferenceRobot>) {
        let (Some(transform), own) = (robot.estimate.map_from_robot_map(), robot.submaps.poses()) else {
            return;
        };
        let first = self.poses.len();
        self.robots.push(RobotInGraph { robot: index, first, poses: own.to_vec() });
        self.poses.extend(own.iter().map(|pose| transform * *pose));
        self.edges.extend(robot.submaps.edges(first));
        let start =
            robot.estimate.configured_map_from_robot_map().map(|start| (start, START_SIGMAS, START_KERNEL));
        let frame =
            |reference: ReferenceRobot| (reference.map_from_robot_map, REFERENCE_SIGMAS, Kernel::Quadratic);
        if let Some((map_from_robot_map, sigmas, kernel)) = start.or(reference.map(frame)) {
            if start.is_some() {
                self.starts.push((self.robots.len() - 1, self.edges.len()));
            }
            self.edges.push(Edge {
                a: 0,
                b: first,
                a_from_b: map_from_robot_map * own[0],
                information: sigmas.information(),
                kernel,
            });
        }
    }

    /// Solves the graph: consistent closures, joint solution, and once more without the closures that it contradicts.
    ///
    /// # Errors
    /// The graph cannot be solved.
    pub fn solve(mut self) -> Result<JointSolution, SolveError> {
        let start = self.poses.clone();
        let mut active: Vec<Vec<usize>> =
            self.pairs.iter().map(|pair| self.consistent_closures(pair)).collect();
        self.optimise(&active)?;
        let kept: Vec<Vec<usize>> = self
            .pairs
            .iter()
            .zip(&active)
            .map(|(pair, closures)| closures.iter().filter(|k| self.is_inlier(pair, **k)).copied().collect())
            .collect();
        if kept != active {
            active = kept;
            self.poses = start;
            self.optimise(&active)?;
        }
        Ok(self.solution(active))
    }

    fn optimise(&mut self, active: &[Vec<usize>]) -> Result<(), SolveError> {
        let mut edges = self.edges.clone();
        for (pair, closures) in self.pairs.iter().zip(active) {
            edges.extend(closures.iter().map(|k| self.closure_edge(pair, *k)));
            edges.extend(pair.alignment.filter(|_| closures.is_empty()));
        }
        solve(&mut self.poses, &edges, &SOLVER).map(|_| ())
    }

    /// Returns the robot whose given start is the farthest outside the errors of a start, where closures relate it to others.
    fn contradicted_start(&self, active: &[Vec<usize>]) -> Option<usize> {
        let closures = |robot: usize| -> usize {
            let pairs = self.pairs.iter().zip(active).filter(|(pair, _)| pair.robots.contains(&robot));
            pairs.map(|(_, closures)| closures.len()).sum()
        };
        let errors = self.starts.iter().filter(|(robot, _)| closures(*robot) >= CLOSURES_MIN);
        let errors = errors.map(|(robot, edge)| {
            let edge = &self.edges[*edge];
            (edge.chi_squared(self.poses[edge.a], self.poses[edge.b]), self.robots[*robot].robot)
        });
        let worst = errors.max_by(|(one, _), (other, _)| one.total_cmp(other));
        worst.filter(|(error, _)| *error > self.config.outlier_sigmas.powi(2)).map(|(_, robot)| robot)
    }

    fn solution(&self, active: Vec<Vec<usize>>) -> JointSolution {
        let contradicted_start = self.contradicted_start(&active);
        let robots = self.robots.iter().map(|robot| {
            let each = robot.poses.iter().zip(&self.poses[robot.first..]);
            (robot.robot, each.map(|(own, in_map)| *in_map * own.inverse()).collect())
        });
        let pairs = self.pairs.iter().zip(active).map(|(pair, closures)| {
            let errors_m = closures.iter().map(|k| {
                let edge = self.closure_edge(pair, *k);
                self.poses[edge.a].between(self.poses[edge.b]).distance_m(edge.a_from_b)
            });
            let residual_m = errors_m.sum::<f64>() / closures.len().max(1) as f64;
            SolvedPair { pair: pair.pair, active: closures, residual_m }
        });
        JointSolution { robots: robots.collect(), pairs: pairs.collect(), contradicted_start }
    }

    fn is_inlier(&self, pair: &PairInGraph, k: usize) -> bool {
        let edge = self.closure_edge(pair, k);
        edge.chi_squared(self.poses[edge.a], self.poses[edge.b]) <= self.config.outlier_sigmas.powi(2)
    }

    fn closure_edge(&self, pair: &PairInGraph, k: usize) -> Edge {
        pair.closures[k].edge(pair.robots.map(|robot| self.robots[robot].first))
    }

    /// Returns the largest consistent set of closures of a pair, given how far the robots drove.
    fn consistent_closures(&self, pair: &PairInGraph) -> Vec<usize> {
        let [a, b] = pair.robots.map(|robot| &self.robots[robot].poses);
        let [along_a, along_b] = [a, b].map(|poses| distances_along_m(poses));
        let config = &self.config;
        let is_consistent = |k: usize, l: usize| {
            let (one, other) = (&pair.closures[k], &pair.closures[l]);
            let ([i, j], [m, n]) = (one.ids, other.ids);
            let predicted = a[m].between(a[i]) * one.measured.i_from_j * b[j].between(b[n]);
            let driven_m = (along_a[i] - along_a[m]).abs() + (along_b[j] - along_b[n]).abs();
            let [drift_m, drift_rad] =
                [config.error_m_per_m, config.error_rad_per_m].map(|per_m| per_m * driven_m);
            // The heading drifts evenly along the way: its mean, times the distance of the two ends.
            let swing_m = 0.5 * drift_rad * a[i].distance_m(a[m]);
            let within_m = (config.error_m + drift_m + swing_m).min(config.error_max_m);
            let within_rad = (config.error_rad + drift_rad).min(config.error_max_rad);
            let measured = other.measured.i_from_j;
            let rotation_rad = wrap_angle(predicted.yaw_rad - measured.yaw_rad).abs();
            predicted.distance_m(measured) <= within_m && rotation_rad <= within_rad
        };
        let inliers = |k: usize| f64::from(pair.closures[k].measured.inliers);
        largest_consistent_set(pair.closures.len(), inliers, is_consistent)
    }
}

impl JointSolution {
    /// Index of the robot whose given start the closures contradict, if they contradict any: the graph has to be solved without it.
    pub fn contradicted_start(&self) -> Option<usize> {
        self.contradicted_start
    }

    /// Applies the solution's transforms to the robots, and updates the pairs.
    pub fn apply(self, robots: &mut [Robot], pairs: &mut [RobotPair]) {
        for (robot, map_from_robot_map_at_submaps) in self.robots {
            if robots[robot].estimate.map_from_robot_map().is_some() {
                robots[robot].apply_solution(map_from_robot_map_at_submaps);
            }
        }
        for SolvedPair { pair, active, residual_m } in self.pairs {
            let closures = active.len();
            pairs[pair].closures.apply_solution(active, residual_m);
            let both = robots_of_pair(pair).map(|robot| &robots[robot]);
            let nodes = both.iter().map(|robot| robot.submaps.node_count()).sum();
            let [a, b] = both.map(|robot| robot.estimate.map_from_robot_map());
            if let Some((a, b)) = a.zip(b) {
                pairs[pair].edge.apply_solution(a.between(b), closures, nodes);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fleet_graph::submap_match::SubmapMatch;
    use nalgebra::Matrix3;

    fn problem(information: f64) -> JointProblem {
        let information = Matrix3::from_element(information);
        let measured = SubmapMatch { i_from_j: Pose2::IDENTITY, information, inliers: 9 };
        let robot = |robot| RobotInGraph { robot, first: robot + 1, poses: vec![Pose2::IDENTITY] };
        JointProblem {
            poses: vec![Pose2::IDENTITY; 3],
            edges: Vec::new(),
            robots: vec![robot(0), robot(1)],
            pairs: vec![PairInGraph {
                pair: 0,
                robots: [0, 1],
                closures: vec![Closure { ids: [0, 0], measured }],
                alignment: None,
            }],
            starts: Vec::new(),
            config: ClosureConfig::default(),
        }
    }

    #[test]
    fn a_graph_that_cannot_be_solved_is_an_error() {
        assert!(problem(0.0).solve().is_ok());
        assert!(problem(f64::NAN).solve().is_err());
    }
}
