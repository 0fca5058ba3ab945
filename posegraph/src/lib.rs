//! Pose-graph optimisation in the plane, for one robot's SLAM and for the merging of maps.
//!
//! A graph is a slice of poses and a slice of [`Edge`]s. An edge is a measured relative pose with
//! its information (inverse covariance) and a [`Kernel`]. [`solve`] moves all poses but the first
//! to a minimum of the sum of the edges' robust squared errors:
//!
//! 1. linearise every edge at the current poses (Grisetti et al., "A tutorial on graph-based
//!    SLAM", IEEE ITS Magazine 2010, eqs. 30-33);
//! 2. factor the sparse normal equations and take the Gauss-Newton step if it lowers the cost;
//! 3. else damp it, more and more, until it does (Levenberg-Marquardt);
//! 4. stop when the step is small, when no step lowers the cost, or after a number of iterations.
//!
//! The first pose is the gauge: it never moves. After an error all poses are what they were.
//!
//! ```
//! use msg::Pose2;
//! use posegraph::{Edge, Kernel, Termination, SolverOptions, information_from_sigmas, solve};
//!
//! // A robot drives around a square of 4 m; its wheels turn 3 % too far at each corner.
//! let quarter = core::f64::consts::FRAC_PI_2;
//! let information = information_from_sigmas(0.1, 0.05);
//! let edge = |a, b, a_from_b| Edge { a, b, a_from_b, information, kernel: Kernel::Quadratic };
//! let side = Pose2::new(4.0, 0.0, 1.03 * quarter);
//! let mut edges: Vec<Edge> = (0..4).map(|k| edge(k, k + 1, side)).collect();
//!
//! // Odometry alone says where it is: half a metre away from where it began.
//! let mut poses = vec![Pose2::IDENTITY];
//! for k in 0..4 {
//!     poses.push(poses[k] * side);
//! }
//! assert!(poses[4].distance_m(poses[0]) > 0.5);
//!
//! // It recognises the place where it began: the loop is closed.
//! edges.push(Edge { information: information_from_sigmas(0.01, 0.01), ..edge(0, 4, Pose2::IDENTITY) });
//! let summary = solve(&mut poses, &edges, &SolverOptions::default())?;
//! assert_eq!(summary.termination, Termination::Converged);
//! assert!(summary.final_cost < summary.initial_cost);
//! assert!(poses[4].distance_m(poses[0]) < 0.02);
//! # Ok::<(), posegraph::SolveError>(())
//! ```

mod block_cholesky;
mod edge;
mod information;
mod kernel;
mod normal_equations;
mod solver;

pub use edge::Edge;
pub use information::{
    PoseSigmas, information_from_sigmas, information_without_axis, limit_information, transport_information,
};
pub use kernel::Kernel;
pub use solver::{SolveError, SolverOptions, Summary, Termination, cost, solve};
