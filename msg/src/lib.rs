//! The nouns on the arrows: what one process says to another.
//!
//! Every message is plain data ([`bytemuck::Pod`]): `repr(C)`, no padding, no pointer, and any
//! bit pattern is a value, so that a reader can never be made to misbehave by what a writer left
//! in shared memory. Fields that mean an enumeration are stored as codes and read by a checked
//! accessor. Lengths are read through accessors that clamp them.
//!
//! Units are SI and radians; f32 in measurements, f64 in poses. Frames and time: see [`pose`],
//! [`time`]; who writes which message to whom: the table in the binary's `channel.rs`.

mod edges;
mod health;
mod id;
mod motion;
pub mod pose;
mod scan;
mod service;
mod stats;
pub mod time;

pub mod grid;
pub mod rect;
mod slam;
mod submap;
mod swept_disk;
pub mod tiles;

pub use edges::{EdgeAction, EdgeCommand, EdgeState, MERGE_EDGES_MAX, MergeEdge, MergeEdges};
pub use grid::{Grid, GridHeader, GridView};
pub use health::{ProcessHealth, Role};
pub use id::{ROBOTS_MAX, RobotId};
pub use motion::{Clock, GroundTruth, LINKS_MAX, Link, LinkTransform, Odometry, Transforms, VelocityCommand};
pub use pose::Pose2;
pub use rect::Rect;
pub use scan::{BEAMS_MAX, Scan};
pub use service::{
    CLOSURES_MAX, ClosureInfo, SlamMode, SlamOutcome, SlamRequest, SlamRequestKind, SlamResponse, StartPose,
    TEXT_MAX, Text,
};
pub use slam::{Correction, MapTransform, MapTransforms, TrackingState};
pub use stats::{Distribution, FleetStats, PROCESSES_MAX, ProcessStats, RobotStats};
pub use submap::{
    SUBMAP_CELLS_MAX, SUBMAP_EDGES_MAX, SUBMAP_SIDE_MAX, SUBMAPS_MAX, Submap, SubmapEdge, SubmapPoses,
    SubmapRequest,
};
pub use swept_disk::SweptDisk;
pub use tiles::{DenseMap, MapHeader, MapTile, PatchHeader, TileMap};
pub use time::{Monotonic, Stamp};

use bytemuck::{Pod, Zeroable};

/// What every message begins with.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct Header {
    /// When the content was true, on the run's clock. The algorithms' only time.
    pub stamp: Stamp,
    /// When the message left its writer, on the machine's clock. For latency only.
    pub sent: Monotonic,
    /// Counts the writer's messages on this channel from 0 without gaps: a gap is a loss.
    pub seq: u64,
    /// The writer's incarnation: a restarted writer has another, and starts at `seq` 0.
    pub incarnation: u64,
}

/// A message with a header, as one channel carries it.
pub trait Message: Pod {
    /// Its name between processes: tells two layouts apart, even when they are equally large.
    const NAME: &'static str;
    /// The header.
    fn header(&self) -> &Header;
    /// The header, for the channel to number and time.
    fn header_mut(&mut self) -> &mut Header;
}

macro_rules! messages {
    ($($message:ident),*) => {$(
        impl Message for $message {
            const NAME: &'static str = concat!("msg::", stringify!($message));
            fn header(&self) -> &Header {
                &self.header
            }
            fn header_mut(&mut self) -> &mut Header {
                &mut self.header
            }
        }
    )*};
}
messages!(
    Scan,
    Odometry,
    Transforms,
    VelocityCommand,
    GroundTruth,
    Clock,
    Correction,
    MapTransforms,
    ProcessHealth,
    FleetStats,
    MergeEdges,
    EdgeCommand,
    SubmapRequest,
    SlamRequest,
    SlamResponse
);
