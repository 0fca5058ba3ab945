//! Damped Gauss-Newton over a pose graph, with graduated robust kernels where wanted.

use crate::edge::Edge;
use crate::normal_equations::Structure;
use msg::{Pose2, pose::wrap_angle};
use nalgebra::Vector3;

/// Factor by which kernels are widened at the start of a graduated solution. A closure after a long loop may be
/// off by 100 standard deviations: with 64 times 2 it still counts nearly fully in the first iteration.
const GRADUATION_START: f64 = 64.0;
/// Factor by which each iteration reduces the kernels' widening: graduation takes four iterations.
const GRADUATION_FACTOR: f64 = 4.0;
/// First damping that is tried after a Gauss-Newton step that raised the cost, as a share of the diagonal.
const DAMPING_FIRST: f64 = 1e-3;
/// Factor by which each further try raises the damping.
const DAMPING_FACTOR: f64 = 10.0;
/// Most tries: at the last one, with damping 1e6, the step is tiny and along the gradient.
const DAMPING_TRIES: i32 = 10;
/// Rise of the cost that counts as rounding, as a share of it and in squared standard deviations.
const COST_ROUNDING: f64 = 1e-10;

/// Options of the solver: when a solution ends, and how it treats outliers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SolverOptions {
    /// Most iterations, 1 or more.
    pub iterations_max: usize,
    /// The solution has converged when an undamped step moves no pose by more than this, metres or radians.
    pub step_min: f64,
    /// Begins with wide kernels and narrows them step by step (Yang et al., "Graduated non-convexity
    /// for robust spatial perception", RA-L 2020): for new edges that may be far off.
    pub graduated: bool,
    /// Information added to every unknown, 1/m² and 1/rad². It is not part of the cost: it keeps poses
    /// that no edge holds where they are. With 0 such a graph is [`SolveError::Singular`].
    pub prior: f64,
}

impl Default for SolverOptions {
    /// A prior of 1e-6 is a standard deviation of a kilometre: no measurement is as weak.
    fn default() -> Self {
        Self { iterations_max: 20, step_min: 1e-5, graduated: false, prior: 1e-6 }
    }
}

/// Why the iterations of a solution ended, without an error.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Termination {
    /// The last step was smaller than [`SolverOptions::step_min`].
    Converged,
    /// [`SolverOptions::iterations_max`] was reached; the poses are the best ones so far.
    IterationLimit,
    /// No step, however damped, lowers the cost; the poses are the best ones so far.
    Stalled,
}

/// Summary of a solution: why it ended, effort and cost.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Summary {
    /// Reason why the iterations ended.
    pub termination: Termination,
    /// Number of linearisations.
    pub iterations: usize,
    /// Number of iterations whose Gauss-Newton step had to be damped.
    pub damped: usize,
    /// Cost before the solution, see [`cost`].
    pub initial_cost: f64,
    /// Cost after the solution, see [`cost`]; not above the initial cost unless the solution was graduated.
    pub final_cost: f64,
}

/// Why a graph could not be solved. The poses are then what they were.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SolveError {
    /// An edge names a pose that is not there, or joins a pose to itself.
    #[error("edge {edge} joins poses {a} and {b} of a graph of {poses} poses")]
    InvalidEdge {
        /// Index of the edge.
        edge: usize,
        /// Index of the edge's first pose.
        a: usize,
        /// Index of the edge's second pose.
        b: usize,
        /// Number of poses of the graph.
        poses: usize,
    },
    /// An edge's squared error is infinite or not a number.
    #[error(
        "the squared error of edge {edge} is not finite: check its information, its measurement and its poses"
    )]
    NotFinite {
        /// Index of the edge.
        edge: usize,
    },
    /// The normal equations are not positive definite, however damped.
    #[error(
        "the normal equations of iteration {iteration} are not positive definite: some pose is held by no edge, or an information matrix is no inverse covariance"
    )]
    Singular {
        /// The iteration, from 0.
        iteration: usize,
    },
    /// The sparse structure could not be built.
    #[error("the sparse structure of {poses} poses and {edges} edges cannot be built")]
    TooLarge {
        /// Number of poses of the graph.
        poses: usize,
        /// Number of edges of the graph.
        edges: usize,
    },
}

/// Sum of the edges' robust squared errors, in squared standard deviations.
pub fn cost(poses: &[Pose2], edges: &[Edge]) -> f64 {
    scaled_cost(poses, edges, 1.0)
}

/// Moves all poses but the first to a minimum of the [`cost`]; see the crate's documentation.
///
/// # Errors
/// A [`SolveError`] says why the graph cannot be solved. All poses are then what they were.
pub fn solve(poses: &mut [Pose2], edges: &[Edge], options: &SolverOptions) -> Result<Summary, SolveError> {
    let before = poses.to_vec();
    let result = minimise(poses, edges, options);
    if result.is_err() {
        poses.copy_from_slice(&before);
    }
    result
}

fn minimise(poses: &mut [Pose2], edges: &[Edge], options: &SolverOptions) -> Result<Summary, SolveError> {
    let initial_cost = checked_cost(poses, edges)?;
    let mut summary = Summary {
        termination: Termination::Converged,
        iterations: 0,
        damped: 0,
        initial_cost,
        final_cost: initial_cost,
    };
    if poses.len() < 2 {
        return Ok(summary);
    }
    let too_large = SolveError::TooLarge { poses: poses.len(), edges: edges.len() };
    let structure = Structure::new(poses.len(), edges).ok_or(too_large)?;
    summary.termination = Termination::IterationLimit;
    let mut scale = if options.graduated { GRADUATION_START } else { 1.0 };
    for iteration in 0..options.iterations_max {
        let step = descend(&structure, poses, edges, scale, options.prior);
        summary.iterations += 1;
        let done = match step {
            Step::Plain { largest } => (largest < options.step_min).then_some(Termination::Converged),
            Step::Damped => {
                summary.damped += 1;
                None
            }
            Step::None { largest } if largest < options.step_min => Some(Termination::Converged),
            Step::None { .. } => Some(Termination::Stalled),
            Step::Singular => return Err(SolveError::Singular { iteration }),
        };
        if let Some(termination) = done.filter(|_| scale <= 1.0) {
            summary.termination = termination;
            break;
        }
        scale = (scale / GRADUATION_FACTOR).max(1.0);
    }
    summary.final_cost = cost(poses, edges);
    Ok(summary)
}

/// What one iteration did to the poses.
enum Step {
    /// The Gauss-Newton step was taken as it is; its largest component, metres or radians.
    Plain { largest: f64 },
    /// A damped step was taken.
    Damped,
    /// No step lowers the cost; the largest component of the Gauss-Newton step.
    None { largest: f64 },
    /// The normal equations cannot be solved.
    Singular,
}

/// Takes the least damped step that does not raise the cost.
fn descend(structure: &Structure, poses: &mut [Pose2], edges: &[Edge], scale: f64, prior: f64) -> Step {
    let equations = structure.linearise(poses, edges, scale, prior);
    let limit = equations.cost + COST_ROUNDING * (equations.cost + 1.0);
    let mut plain_largest = None;
    for attempt in 0..=DAMPING_TRIES {
        let damping = if attempt == 0 { 0.0 } else { DAMPING_FIRST * DAMPING_FACTOR.powi(attempt - 1) };
        let Some(step) = structure.step(&equations, damping) else { continue };
        let largest = step.iter().fold(0.0_f64, |largest, d| largest.max(d.amax()));
        let moved = moved(poses, &step);
        if scaled_cost(&moved, edges, scale) <= limit {
            poses.copy_from_slice(&moved);
            return if attempt == 0 { Step::Plain { largest } } else { Step::Damped };
        }
        plain_largest.get_or_insert(largest);
    }
    plain_largest.map_or(Step::Singular, |largest| Step::None { largest })
}

/// The poses after a step, the first one unmoved.
fn moved(poses: &[Pose2], step: &[Vector3<f64>]) -> Vec<Pose2> {
    let mut moved = poses.to_vec();
    for (pose, d) in moved[1..].iter_mut().zip(step) {
        *pose = Pose2::new(pose.x_m - d[0], pose.y_m - d[1], wrap_angle(pose.yaw_rad - d[2]));
    }
    moved
}

fn scaled_cost(poses: &[Pose2], edges: &[Edge], scale: f64) -> f64 {
    let one = |edge: &Edge| edge.kernel.cost(edge.chi_squared(poses[edge.a], poses[edge.b]), scale);
    edges.iter().map(one).sum()
}

/// The [`cost`], after a check of every edge.
fn checked_cost(poses: &[Pose2], edges: &[Edge]) -> Result<f64, SolveError> {
    for (index, edge) in edges.iter().enumerate() {
        let Edge { a, b, .. } = *edge;
        if a == b || a.max(b) >= poses.len() {
            return Err(SolveError::InvalidEdge { edge: index, a, b, poses: poses.len() });
        }
        if !edge.chi_squared(poses[a], poses[b]).is_finite() {
            return Err(SolveError::NotFinite { edge: index });
        }
    }
    Ok(cost(poses, edges))
}
