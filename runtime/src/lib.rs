//! What a process of the fleet runs on: channels, ports, clock, storage, and settings of the machine.
//!
//! The tables of processes and of channels are data ([`processes`], [`channel`]). Live, ports are channels in shared memory
//! ([`shared_memory`]), the clock is the system's, and storage is the disk.

// The tables, and what carries the messages.
pub mod channel;
pub mod clock;
pub mod ports;
pub mod processes;
pub mod shared_memory;
pub mod storage;
// The loop of a process that also waits for sockets.
pub mod event_loop;
// Progress of threads, and what follows when there is none.
pub mod progress;
pub mod restarts;
pub mod watchdog;
// Files, signals and settings of a process, and the start of further ones.
pub mod child_messages;
pub mod child_process;
pub mod emergency_stop_file;
pub mod end_grace;
mod file_lock;
mod held_signals;
pub mod job_thread;
pub mod keys;
pub mod layout;
pub mod lossy_path;
pub mod other_fleets;
pub mod realtime;
pub mod recording_files;
pub mod runtime_folder;
pub mod saved_files;
pub mod spare_time;
pub mod stop;
pub mod time_slice;
