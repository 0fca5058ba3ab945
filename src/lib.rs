//! The shell around the rooms: launcher, channels, one main loop per process, operator, replay, lockstep.

pub mod carmen;
pub mod channel;
pub mod clock;
pub mod map_file;
pub mod operator;
pub mod replay;
pub mod shared_memory;
