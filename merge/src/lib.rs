//! The maps of all robots in, one map and where each robot's map lies out.
//!
//! ```text
//! robotK/map ──▶ source: what changed? ──▶ layer: redrawn on the lattice of `map` ──┐
//!                                          (changed tiles only)                     ├─▶ fuse: evidence added
//! robotJ/map ──▶ source ─────────────────▶ layer ───────────────────────────────────┘   (changed tiles only)
//! ```
//!
//! The lattice never moves: cell (i, j) of `map` covers `[i, i+1) x [j, j+1)` times the resolution,
//! whatever the robots' maps look like. The merged map is a window on it that grows as needed.

mod align;
mod fleet;
mod layer;
mod merger;
mod rect;
mod source;

pub use align::{AlignConfig, Alignment, align};
pub use fleet::{Fleet, FleetRefused, Outcome, Task};
pub use merger::{MergeConfig, Merger, Refused};
