//! Health, statistics and map metrics of the fleet.
//!
//! ```text
//! transforms ────────────▶ jitter ─────┐
//! pose estimates ────────▶ scans, pose ┤
//! maps, map transforms ──▶ pairs ──────┼─▶ FleetStats, once a second
//! truth, room plan ──────▶ errors ─────┤
//! health of processes ───▶ processes ──┘
//! ```
//!
//! [`consistency`] and [`truth`] are the map metrics as plain functions, for reports and benches.

pub mod consistency;
mod distance;
mod fleet;
mod histogram;
mod jitter;
mod merged;
mod pairs;
mod processes;
mod robot;
mod scans;
pub mod truth;
mod unreliable_maps;

pub use fleet::Telemetry;
pub use histogram::Histogram;
pub use unreliable_maps::{UnreliableMaps, contradictions};

#[cfg(test)]
mod testing;
