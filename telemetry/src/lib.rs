//! Health, statistics and metrics of the fleet.
//!
//! ```text
//! transforms ─▶ jitter ──────┐
//! corrections ─▶ scans, pose ─┤
//! maps, map_transforms ─▶ pairs ─────┼─▶ FleetStats, once a second
//! truth, room plan ─▶ errors ─┤
//! health ─▶ processes ────────┘
//! ```
//!
//! [`consistency`] and [`truth`] are the map metrics as plain functions, for reports and benches.

pub mod consistency;
mod distance;
mod fleet;
mod histogram;
mod jitter;
mod pairs;
mod processes;
mod robot;
mod scans;
pub mod truth;

pub use fleet::Telemetry;
pub use histogram::Histogram;

#[cfg(test)]
mod testing;
