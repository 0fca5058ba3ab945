//! Paths that planners return and the follower drives.

/// Position on a path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Waypoint {
    /// Position in the frame of the map, metres.
    pub position_m: [f64; 2],
    /// Distance to the nearest known obstacle, metres.
    pub clearance_m: f64,
}

/// Waypoints from the robot to a goal, one cell of the map apart (nav_msgs/Path without headings).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Path {
    /// At least one waypoint if a planner made the path.
    pub waypoints: Vec<Waypoint>,
}

impl Path {
    /// Last position of the path, in the frame of the map, metres. `None` if the path is empty.
    pub fn end_m(&self) -> Option<[f64; 2]> {
        self.waypoints.last().map(|waypoint| waypoint.position_m)
    }
}
