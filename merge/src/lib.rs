//! The maps of all robots in, one map and where each robot's map lies out.
//!
//! ```text
//! robotK/map ──▶ source: which tiles changed? ──▶ tiles of `map` that they touch ──┐
//! robotJ/map ──▶ source ─────────────────────────────────────────────────────────▶ ├─▶ each composed anew:
//!                                                   lookup: every robot's cells    ┘   evidence added
//!                                                   under a tile, turned
//! ```
//!
//! The lattice never moves: cell (i, j) of `map` covers `[i, i+1) x [j, j+1)` times the resolution,
//! whatever the robots' maps look like.

mod align;
mod fleet_graph;
mod lookup;
mod merger;
mod source;
mod trail;

pub use align::{AlignConfig, Alignment, align};
pub use fleet_graph::{FleetPoseGraph, FleetSnapshot, Outcome, SnapshotRejected, SubmapRejected, Task};
pub use merger::{MapRejected, MergeConfig, Merger};
