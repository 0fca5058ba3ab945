//! Health, statistics and map metrics of the fleet.
//!
//! ```text
//! transforms ──────────▶ jitter ───────┐
//! pose estimates ──────▶ scans, pose ──┤
//! truth ───────────────▶ pose errors ──┼─▶ Telemetry ─▶ FleetStats, once a second
//! health of processes ─▶ processes ────┤
//! maps, transforms, ───▶ MapMetrics ───┘
//! room plan              (takes long)
//! ```
//!
//! [`Telemetry`] counts messages as they arrive, in a few operations each. [`MapMetrics`] compares maps for as long as it
//! takes. It is a value of its own so that nobody who takes arrival times has to wait for it.
//!
//! [`consistency`] and [`truth`] are the map metrics as plain functions, for reports and benches.

pub mod consistency;
mod distance;
mod fleet;
mod histogram;
mod jitter;
mod map_metrics;
mod merged;
mod pairs;
mod processes;
mod received_map;
mod robot;
mod scans;
pub mod truth;
mod unreliable_maps;

pub use fleet::Telemetry;
pub use histogram::Histogram;
pub use map_metrics::{MapChanges, MapFigures, MapMetrics};
pub use unreliable_maps::{UnreliableMaps, contradictions};

#[cfg(test)]
mod testing;
