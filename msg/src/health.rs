//! How a process is doing, by its own account.

use crate::Header;
use bytemuck::{Pod, Zeroable};

/// What a process is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[repr(u32)]
pub enum Role {
    /// A robot in its room.
    Sim = 1,
    /// A robot's map.
    Slam = 2,
    /// The fleet's map.
    Merge = 3,
    /// The fleet's figures.
    Telemetry = 4,
    /// The doors to headset and ROS 2.
    Bridge = 5,
}

impl Role {
    /// All roles, in the order of their codes.
    pub const ALL: [Self; 5] = [Self::Sim, Self::Slam, Self::Merge, Self::Telemetry, Self::Bridge];

    /// `None` for a code that no role has.
    pub fn from_code(code: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|role| *role as u32 == code)
    }

    /// The subcommand that runs it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Sim => "sim",
            Self::Slam => "slam",
            Self::Merge => "merge",
            Self::Telemetry => "telemetry",
            Self::Bridge => "bridge",
        }
    }
}

/// A process's account of its last second, sent once a second.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct ProcessHealth {
    /// `run` tells incarnations apart.
    pub header: Header,
    /// A [`Role`]'s code.
    pub role: u32,
    /// The robot's number, 0 for a process of the whole fleet.
    pub robot: u32,
    /// The process's id.
    pub pid: u32,
    /// Clients attached (bridge only).
    pub clients: u32,
    /// Messages of its main input since its start: scans for slam, commands for sim, maps for merge.
    pub received: u64,
    /// Of its main input, those that `seq` says were sent and never came.
    pub lost: u64,
    /// Messages it had to drop, oldest first, because a reader was slow (bridge only).
    pub dropped: u64,
    /// Messages refused because they made no sense.
    pub refused: u64,
    /// Time per unit of work (a tick, a scan, a merge) over the last second, microseconds.
    pub work_p50_us: f32,
    /// The slowest of the last second, microseconds.
    pub work_max_us: f32,
    /// How late periodic work began over the last second, microseconds, median (sim only).
    pub late_p50_us: f32,
    /// The latest of the last second, microseconds (sim only).
    pub late_max_us: f32,
    /// Resident memory, bytes.
    pub memory_bytes: u64,
    /// Processor time used since the start, nanoseconds.
    pub cpu_ns: u64,
}
