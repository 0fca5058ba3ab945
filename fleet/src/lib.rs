//! A fleet: the loops of its processes, their supervisor, the files of a run, and lockstep, which runs all in virtual time.

// What processes run on is a crate of its own.
pub(crate) use runtime::{
    channel, child_process, clock, emergency_stop_file, end_grace, event_loop, job_thread, layout,
    lossy_path, other_fleets, ports, processes, progress, realtime, recording_files, restarts,
    runtime_folder, saved_files, shared_memory, spare_time, stop, storage, time_slice, watchdog,
};
// The configuration is a crate of its own too.
pub(crate) use ::config;

// Processes.
pub mod lockstep;
mod page_files;
pub mod process;
pub mod run;
pub mod supervisor;
pub mod world;
// What people read and control.
pub mod allowed;
pub mod certificate;
pub mod control;
pub mod merge_maps;
pub mod merge_state_file;
pub mod nasa_tlx;
pub mod observer;
pub mod offered_room;
// Files that outlive a process.
pub mod session_file;
pub mod session_records;
pub mod sessions;
