//! Command line of `mr-slam`, and all that its tests and benches use of the crates below.

// What processes run on is a crate of its own.
pub use runtime::{
    channel, child_messages, child_process, clock, emergency_stop_file, end_grace, event_loop, job_thread,
    keys, layout, lossy_path, other_fleets, ports, processes, progress, realtime, recording_files, restarts,
    runtime_folder, saved_files, shared_memory, spare_time, stop, storage, time_slice, watchdog,
};

// The configuration is a crate of its own too.
pub use ::config;
pub use ::config::resources;

// The processes, in real and in virtual time, and the files of a run.
pub use fleet::{
    allowed, certificate, control, lockstep, merge_maps, merge_state_file, nasa_tlx, observer, offered_room,
    process, run, session_file, session_records, sessions, supervisor, world,
};

pub mod command;
