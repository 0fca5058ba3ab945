//! What the navigator is told about the fleet in each step.

use crate::observation::{RobotObservation, ScanView};
use msg::{ExclusionZone, Pose2, RobotId, Stamp};

/// Oldest scan that a robot is driven by, seconds: five periods of a Burger's LiDAR.
const SCAN_AGE_MAX_S: f64 = 0.5;

/// How well the place of a robot in its own map is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LocalizationUncertainty {
    /// Standard deviation of the position in its least certain direction, metres.
    pub sigma_m: f64,
    /// Whether the newest scan tells the position in every direction.
    pub is_fixed_by_scan: bool,
}

/// One robot at one moment.
#[derive(Clone, Copy, Debug)]
pub struct NavigatedRobot<'a> {
    /// Its map, pose and newest scan.
    pub observation: RobotObservation<'a>,
    /// Its pose by the wheels, which never jumps.
    pub odom_from_base: Option<Pose2>,
    /// Where its own map lies in the merged map; `None` while it is not merged.
    pub map_from_robot_map: Option<Pose2>,
    /// How well its place in its own map is known; `None`: nobody says.
    pub uncertainty: Option<LocalizationUncertainty>,
}

/// The fleet at one moment.
#[derive(Clone, Copy, Debug)]
pub struct NavigationInput<'a> {
    /// Time of the observation; it never goes back.
    pub stamp: Stamp,
    /// All robots, with and without goals.
    pub robots: &'a [NavigatedRobot<'a>],
    /// Where robots of the merged map must not go. Where zones lie in the map of a robot that is not merged is not known.
    pub exclusion_zones: &'a [ExclusionZone],
}

/// Poses of a robot that is localized.
#[derive(Clone, Copy, Debug)]
pub(super) struct RobotPoses {
    pub(super) map_from_base: Pose2,
    pub(super) odom_from_base: Pose2,
}

impl RobotPoses {
    pub(super) fn odom_from_map(&self) -> Pose2 {
        self.odom_from_base * self.map_from_base.inverse()
    }

    pub(super) fn position_m(&self) -> [f64; 2] {
        [self.map_from_base.x_m, self.map_from_base.y_m]
    }
}

impl<'a> NavigatedRobot<'a> {
    /// A robot of which nothing is known.
    pub fn unknown(robot: RobotId) -> Self {
        let observation = RobotObservation::unknown(robot);
        Self { observation, odom_from_base: None, map_from_robot_map: None, uncertainty: None }
    }

    pub(super) fn poses(&self) -> Option<RobotPoses> {
        let map_from_base = self.observation.map_from_base.filter(|pose| pose.is_finite())?;
        let odom_from_base = self.odom_from_base.filter(|pose| pose.is_finite())?;
        Some(RobotPoses { map_from_base, odom_from_base })
    }

    /// Where it stands, or stood when its pose was known last, in the frame of its map.
    pub(super) fn position_m(&self) -> Option<[f64; 2]> {
        let pose = self.observation.map_from_base.filter(|pose| pose.is_finite())?;
        Some([pose.x_m, pose.y_m])
    }

    /// Whether its poses and its scan are fresh: else it gets no new routes, and does not follow those that it has.
    pub(super) fn can_drive(&self, now: Stamp) -> bool {
        self.poses().is_some() && self.fresh_scan(now).is_some()
    }

    /// The newest scan, if it is fresh enough to drive by.
    pub(super) fn fresh_scan(&self, now: Stamp) -> Option<ScanView<'a>> {
        self.observation.scan.filter(|scan| now - scan.received <= SCAN_AGE_MAX_S)
    }
}
