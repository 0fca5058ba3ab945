//! Exploration and path following for ground robots: maps, poses and scans in, velocities out.
//! Pure: no clock, socket, file or thread.

pub mod driver;
pub mod floor;
pub mod frontier;
pub mod joystick;
pub mod memory;
pub mod plan;
pub mod rng;
pub mod routes;
pub mod sight;
pub mod steering;
pub mod tour;
