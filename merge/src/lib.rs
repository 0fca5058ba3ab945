//! Merging of the maps of several robots: one map, and where each robot's map lies in it.
//!
//! ```text
//! robotK/map ──────▶ Merger: every map resampled on one lattice, log-odds added ──────────▶ merged map
//!                      ▲ map transforms, redrawn maps
//! robotK/submap ───▶ FleetPoseGraph: alignments and closures of submaps, one joint pose graph
//! ```
//!
//! [`Merger`] composes the merged map where the robots' maps are known to lie. [`FleetPoseGraph`] finds out where they
//! lie if the robots started anywhere, and corrects maps that drift has deformed. [`align`] is its first step, for two
//! maps alone.
//!
//! The lattice of the merged map never moves: cell (i, j) covers `[i, i+1) x [j, j+1)` times the resolution, whatever
//! the robots' maps look like.
//!
//! All of it is pure: no clock, thread, file or socket. Equal inputs give equal bytes.

mod align;
mod config;
mod fleet_graph;
mod limits;
mod merger;
mod rejections;
mod resample;
mod robot_map;
mod swept_area;

pub use align::{Alignment, align, align_near};
pub use config::{AlignConfig, CheckConfig, ClosureConfig, InvalidMergeConfig, MergeConfig, WallConfig};
pub use fleet_graph::{FleetPoseGraph, FleetSnapshot, SnapshotRejected, SubmapRejected, Task, TaskResult};
pub use merger::{MapRejected, Merger};
pub use rejections::{Rejections, SubmapMessage};
