//! The shell around the rooms: launcher, channels, one main loop per process, replay, lockstep.

// A fleet and its parts, outermost first.
pub mod command;
pub mod config;
pub mod demo;
pub mod fleet;
pub mod lockstep;
pub mod process;
pub mod processes;
pub mod realtime;
pub mod run;
pub mod supervisor;
// Between the processes.
pub mod channel;
pub mod clock;
pub mod control;
pub mod ports;
pub mod shared_memory;
pub mod stop;
// What people see and say.
pub mod allowed;
pub mod keys;
pub mod merge_memory;
pub mod observer;
pub mod view;
// Robots and data from elsewhere.
pub mod session_file;
pub mod sessions;
pub mod storage;
