//! Processes of an MR-SLAM fleet, the channels between them, and the command line of `mr-slam`.

// Command line, configuration and processes.
pub mod command;
pub mod config;
pub mod demo;
pub mod fleet;
pub mod lockstep;
pub mod process;
pub mod processes;
pub mod realtime;
pub mod resources;
pub mod run;
pub mod runtime_folder;
pub mod supervisor;
// Communication between the processes.
pub mod channel;
pub mod clock;
pub mod control;
pub mod ports;
pub mod shared_memory;
pub mod stop;
// What people read and control.
pub mod allowed;
pub mod keys;
pub mod merge_memory;
pub mod observer;
pub mod terminal;
pub mod view;
// Files that outlive a process.
pub mod session_file;
pub mod sessions;
pub mod storage;
