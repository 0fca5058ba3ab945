//! Reasons for which a map is rejected.

use msg::grid::MAP_CELLS_MAX;
use msg::{MapHeader, Pose2, RobotId, Stamp};

/// Reason why a map was rejected. The robot's last valid map stays in use.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum MapRejected {
    /// The fleet has no such robot.
    #[error("{robot} is not of this fleet of {robot_count}: give it a start")]
    UnknownRobot {
        /// The robot named.
        robot: RobotId,
        /// Number of robots in the fleet.
        robot_count: usize,
    },
    /// Size, resolution or origin is not plausible.
    #[error(
        "a grid of {width} x {height} cells of {resolution_m} m with {cells} cells and its corner at x {} m, y {} m, yaw {} rad is invalid: \
         expected finite numbers within 100 km, 0.005 to 1 m a cell, and as many cells as the size says",
        origin.x_m, origin.y_m, origin.yaw_rad
    )]
    Malformed {
        /// Columns, by the header.
        width: u32,
        /// Rows, by the header.
        height: u32,
        /// Side of a cell, metres, by the header.
        resolution_m: f64,
        /// Lower left corner, by the header.
        origin: Pose2,
        /// Number of cells received.
        cells: usize,
    },
    /// The map is older than the one in use.
    #[error("a map of {:.3} s came after one of {:.3} s", stamp.seconds(), newest.seconds())]
    Stale {
        /// Stamp of the rejected map.
        stamp: Stamp,
        /// Stamp of the map in use.
        newest: Stamp,
    },
    /// The merged map would have more than [`MAP_CELLS_MAX`] cells.
    #[error(
        "the merged map would be {width} x {height} cells, more than a map has here, {MAP_CELLS_MAX}, its margin included: the maps are too large, \
         or lie far apart because a start is wrong"
    )]
    TooLarge {
        /// Columns it would have.
        width: usize,
        /// Rows it would have.
        height: usize,
    },
}

impl MapRejected {
    pub(super) fn malformed(header: &MapHeader, (width, height): (u32, u32), cells: usize) -> Self {
        let MapHeader { resolution_m, origin, .. } = *header;
        Self::Malformed { width, height, resolution_m, origin, cells }
    }

    pub(super) fn too_large(width: u32, height: u32) -> Self {
        Self::TooLarge { width: width as usize, height: height as usize }
    }
}
