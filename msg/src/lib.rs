//! Messages between the processes of a fleet, and the maps, poses and times that they are made of.
//!
//! Every message is plain data ([`bytemuck::Pod`]): `repr(C)`, without padding and pointers. Any bit
//! pattern is a valid value, so damaged shared memory cannot make a reader misbehave. Enumerations are
//! stored as codes and read by a checked accessor. Lengths are read through accessors that clamp them.
//!
//! Units are SI and radians; f32 in measurements, f64 in poses. The modules [`pose`] and [`time`] explain
//! frames and times. The table in `runtime/src/channel/table.rs` lists the writer and the readers of each message.
//!
//! A function that needs a map takes a borrowed [`GridView`], which leaves the ownership of the cells open:
//!
//! ```
//! use msg::{Grid, GridHeader, Pose2};
//!
//! let header = GridHeader {
//!     origin: Pose2::new(-1.0, -1.0, 0.0),
//!     resolution_m: 0.5,
//!     width: 4,
//!     height: 4,
//!     ..GridHeader::default()
//! };
//! let mut grid = Grid { header, cells: vec![msg::grid::UNKNOWN; 16] };
//! grid.cells[5] = msg::grid::LOG_ODDS_MAX;
//! assert_eq!(grid.view().cell_of([-0.3, -0.3]), (1, 1));
//! assert_eq!(msg::grid::occupancy(grid.view().cell(1, 1)), msg::grid::Occupancy::Occupied);
//! ```

mod battery;
mod bounded_text;
mod edges;
mod exploration;
mod file_name;
mod health;
mod id;
mod motion;
mod moving_objects;
mod navigation;
pub mod pose;
mod scan;
mod sender;
mod service;
mod stats;
pub mod time;
mod zone_shape;
mod zones;

pub mod grid;
pub mod grid_agreement;
pub mod rect;
mod refusal;
mod slam;
mod submap;
mod swept_disk;
pub mod tiles;

pub use battery::{Battery, PowerSupplyStatus};
pub use edges::{EdgeAction, EdgeCommand, EdgeState, MERGE_EDGES_MAX, MergeEdge, MergeEdges};
pub use exploration::{
    ExplorationAction, ExplorationCommand, ExplorationLeftover, ExplorationReport, ExplorationStatus,
    ExplorerState, LEFTOVERS_MAX, LeftoverReason,
};
pub use file_name::{FileNameError, check_file_name, check_relative_file_name};
pub use grid::{Grid, GridHeader, GridView};
pub use health::{ProcessHealth, Role};
pub use id::{ROBOTS_MAX, RobotId};
pub use motion::{
    Clock, GroundTruth, Odometry, RobotFrame, RobotFrameTransform, TRANSFORMS_MAX, Transforms,
    VelocityCommand,
};
pub use moving_objects::{MOVING_OBJECTS_MAX, MovingObject, MovingObjects, OBJECTS_OF_KIND_MAX, ObjectKind};
pub use navigation::{
    GOAL_POSES_MAX, NavigationAction, NavigationCommand, NavigationFrame, NavigationPlan, NavigationPose,
    NavigationReport, NavigationStatus, PLAN_POINTS_MAX, PauseReason, REASON_BYTES_MAX, RobotHold,
};
pub use pose::Pose2;
pub use rect::IndexRect;
pub use refusal::AlignmentRefusal;
pub use scan::{BEAMS_MAX, BEAMS_MIN, Scan, ScanDemand, ScanPurpose};
pub use sender::{CommandSource, CommandSourceKind, OperatorAction, OperatorEvent};
pub use service::{
    CLOSURES_MAX, ClosureInfo, InitialPoseKind, SlamMode, SlamOutcome, SlamRequest, SlamRequestKind,
    SlamResponse, TEXT_MAX, Text,
};
pub use slam::{MAP_OLD_AFTER_S, MapTransform, MapTransforms, PoseEstimate, TrackingState};
pub use stats::{Distribution, FleetStats, PROCESSES_MAX, ProcessStats, RobotStats};
pub use submap::{
    SUBMAP_CELLS_MAX, SUBMAP_EDGES_MAX, SUBMAP_SIDE_MAX, SUBMAPS_MAX, Submap, SubmapEdge, SubmapPoses,
    SubmapRequest,
};
pub use swept_disk::SweptDisk;
pub use tiles::{DenseMap, MapHeader, MapTile, PatchHeader, TileMap};
pub use time::{Monotonic, Stamp};
pub use zone_shape::ShapeError;
pub use zones::{
    ExclusionZone, ExclusionZones, ZONE_ANSWERS_MAX, ZONE_CORNERS_MAX, ZONES_MAX, ZoneAction, ZoneAnswer,
    ZoneCommand, ZoneError, ZoneRefusal,
};

use bytemuck::{Pod, Zeroable};
use serde::{Deserialize, Serialize};

/// Stamp, sending time and number with which every message begins.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable, Serialize, Deserialize)]
pub struct Header {
    /// Time at which the content was true, on the run's clock. Algorithms use no other time.
    pub stamp: Stamp,
    /// Time at which the message left its writer, on the machine's clock. Used for latency only.
    pub sent: Monotonic,
    /// Number of the message on its channel, from 0. A gap means that messages were lost.
    pub seq: u64,
    /// Number of the writer's process. A restarted writer has another one and starts at `seq` 0.
    pub incarnation: u64,
}

/// A message with a [`Header`] that a channel can carry.
pub trait Message: Pod {
    /// Name of the type between processes. It tells two layouts of the same size apart.
    const NAME: &'static str;
    /// Returns the message's header.
    fn header(&self) -> &Header;
    /// Returns the header for the channel, which numbers and times the message.
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
    Battery,
    Scan,
    Odometry,
    Transforms,
    VelocityCommand,
    GroundTruth,
    Clock,
    PoseEstimate,
    MapTransforms,
    ProcessHealth,
    FleetStats,
    MergeEdges,
    EdgeCommand,
    OperatorEvent,
    SubmapRequest,
    SlamRequest,
    SlamResponse,
    NavigationCommand,
    NavigationReport,
    NavigationPlan,
    ExplorationCommand,
    ExplorationReport,
    ZoneCommand,
    ExclusionZones,
    ScanDemand,
    RobotHold,
    MovingObjects
);
