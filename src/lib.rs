//! The shell around the rooms: launcher, channels, one main loop per process, replay, lockstep.

// A fleet and its parts, outermost first.
pub mod config;
pub mod demo;
pub mod doctor;
pub mod fleet;
pub mod lockstep;
pub mod process;
pub mod processes;
pub mod realtime;
pub mod run;
pub mod supervisor;
pub mod up;
// Between the processes.
pub mod channel;
pub mod clock;
pub mod control;
pub mod ports;
pub mod shared_memory;
pub mod stop;
// What people see, and say.
pub mod allowed;
pub mod ask_slam;
pub mod keys;
pub mod merge_edges;
pub mod merge_memory;
pub mod observer;
pub mod report;
pub mod screen;
pub mod status;
pub mod view;
// Robots and data from elsewhere.
pub mod merge_maps;
pub mod replay;
pub mod session_file;
pub mod sessions;
pub mod storage;
// Their modules' new home, until every caller names it.
pub use formats::{carmen, map_file};
