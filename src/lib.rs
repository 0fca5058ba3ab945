//! The shell around the rooms: launcher, channels, one main loop per process, operator, replay, lockstep.

// A fleet and its parts, outermost first.
pub mod demo;
pub mod up;
pub mod supervisor;
pub mod process;
pub mod lockstep;
pub mod fleet;
pub mod config;
pub mod run;
// Between the processes.
pub mod channel;
pub mod shared_memory;
pub mod clock;
pub mod stop;
// What people see.
pub mod observer;
pub mod view;
pub mod screen;
pub mod report;
pub mod status;
pub mod map_file;
// Robots and data from elsewhere.
pub mod operator;
pub mod replay;
pub mod carmen;
