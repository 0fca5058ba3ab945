//! Messages in which processes report their health.

use crate::Header;
use bytemuck::{Pod, Zeroable};

/// Role of a process in the fleet.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[repr(u32)]
pub enum Role {
    /// Simulates one robot in its room.
    Sim = 1,
    /// Runs the SLAM of one robot.
    Slam = 2,
    /// Merges the robots' maps into the fleet's map.
    Merge = 3,
    /// Measures the fleet.
    Telemetry = 4,
    /// Connects the fleet to ros_tcp clients and to ROS 2.
    Bridge = 5,
    /// Records the fleet's messages.
    Record = 6,
    /// Drives robots to goals.
    Nav = 7,
    /// Simulates the people, doors and boxes that move in the room.
    Objects = 8,
}

impl Role {
    /// All roles in the order of their codes.
    pub const ALL: [Self; 8] = [
        Self::Sim,
        Self::Slam,
        Self::Merge,
        Self::Telemetry,
        Self::Bridge,
        Self::Record,
        Self::Nav,
        Self::Objects,
    ];

    /// Decodes a role; `None` for an unknown code.
    pub fn from_code(code: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|role| *role as u32 == code)
    }

    /// Returns the role's name in tables, in channel names and in the process list.
    pub fn name(self) -> &'static str {
        match self {
            Self::Sim => "sim",
            Self::Slam => "slam",
            Self::Merge => "merge",
            Self::Telemetry => "telemetry",
            Self::Bridge => "bridge",
            Self::Record => "record",
            Self::Nav => "nav",
            Self::Objects => "objects",
        }
    }
}

/// Health of a process over the last second. Each process sends it once a second.
// More than 12 fields: the message is one row of measurements, in a fixed layout.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct ProcessHealth {
    /// Header whose `incarnation` changes when the process is restarted.
    pub header: Header,
    /// Code of a [`Role`].
    pub role: u32,
    /// Number of the robot, from 1; 0 for a process of the whole fleet.
    pub robot: u32,
    /// Id of the process in the operating system.
    pub pid: u32,
    /// Number of connected clients (bridge only).
    pub clients: u32,
    /// Messages received on the main input since the start: scans for slam, commands for sim, maps for merge.
    pub received: u64,
    /// Messages of the main input that were sent, by their `seq`, and not received.
    pub lost: u64,
    /// Messages dropped, oldest first, because a reader was slow (bridge only).
    pub dropped: u64,
    /// Messages refused because their content is invalid.
    pub refused: u64,
    /// Median time per unit of work (a tick, a scan, a merge) over the last second, microseconds.
    pub work_p50_us: f32,
    /// Longest time per unit of work over the last second, microseconds.
    pub work_max_us: f32,
    /// Median delay of periodic work over the last second, microseconds (sim only).
    pub late_p50_us: f32,
    /// Longest delay of periodic work over the last second, microseconds (sim only).
    pub late_max_us: f32,
    /// Resident memory, bytes.
    pub memory_bytes: u64,
    /// Processor time used since the start, nanoseconds.
    pub cpu_ns: u64,
    /// How often the launcher started the process before.
    pub restarts: u64,
}
