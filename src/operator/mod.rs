//! An operator without a headset: attaches over ros_tcp as a headset does, and drives.

pub mod driver;
pub mod floor;
pub mod frontier;
pub mod joystick;
pub mod memory;
pub mod plan;
#[cfg(test)]
mod rehearsal;
pub mod rng;
pub mod routes;
pub mod sight;
pub mod steering;
pub mod tour;
