//! Where a robot's LiDAR is mounted, by the robot's own transforms, and what follows for its scans.
//!
//! ```text
//!   scan's frame ─▶ parent ─▶ ... ─▶ base    on /robotN/tf and /robotN/tf_static, else on /tf and /tf_static
//!     level       taken, with its place and heading on the base
//!     upside down mirrored, then the same
//!     tilted      refused
//!     unknown     taken as upright, at the configured place, after a moment in which the transforms may come
//! ```

use super::frame_tree::{FrameTrees, without_slash};
use super::notices::is_due;
use super::{DDS_SOURCE, ExternalWorld, MessageContext, Notices, SourceId, WorldError};
use msg::{Pose2, RobotFrame, RobotFrameTransform, RobotId, Stamp};
use ros_messages::names::{FleetFrame, RobotNames};
use ros_messages::spatial_pose::{ScannerMount, SpatialPose, TILT_MAX_DEG};
use thiserror::Error;

/// Scans of ROS 2 are not taken for so long while the mount is unknown, seconds: transforms are often discovered after scans.
pub(super) const MOUNT_WAIT_S: f64 = 2.0;
/// Most frames between a LiDAR and its base.
const CHAIN_MAX: usize = 32;
/// The largest distance of a LiDAR from its base, metres: that of `base_from_scan`.
const DISTANCE_MAX_M: f64 = 10.0;
/// A mount that changes by less is the same, metres ...
const SAME_M: f64 = 0.01;
/// ... and degrees.
const SAME_DEG: f64 = 1.0;
/// A tilt from which the operator is told, degrees: 0.14 % of a range.
const TILT_TOLD_DEG: f64 = 3.0;
/// Why a LiDAR's mount is not accepted.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum MountError {
    /// The LiDAR does not measure in the floor's plane.
    #[error(
        "tilts it by {tilt_deg:.0} degrees against the base; expected a level LiDAR, upright or upside down, within \
         {TILT_MAX_DEG} degrees: correct its transform (the joint's rpy in the URDF), or mount it level"
    )]
    Tilted {
        /// Angle between the LiDAR's plane and the base's, degrees, 0 to 180.
        tilt_deg: f64,
    },
    /// The LiDAR is not on the robot.
    #[error(
        "puts it {distance_m:.1} m from the base; expected at most {DISTANCE_MAX_M} m: correct its transform"
    )]
    Far {
        /// Distance from the base, metres.
        distance_m: f64,
    },
}

/// Where a robot's LiDAR is.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Placement {
    Known(ScannerMount),
    /// No transforms lead from the LiDAR to the base.
    Unknown,
    /// Another robot's LiDAR has the same frame on a topic of both: it may be the other's.
    Shared(RobotId),
}

/// What is known of one robot's LiDAR.
#[derive(Clone, Debug, Default)]
pub(super) struct RobotMount {
    /// The frame of its scans.
    scan_frame: String,
    /// Parent and child frame of its odometry topic.
    odometry_frames: [String; 2],
    /// When its first scan came, by the run's time.
    since: Option<Stamp>,
    /// What the operator was told last, and when by the run's time.
    reported: Option<(Placement, Stamp)>,
    /// The LiDAR's upright frame on the base.
    base_from_scan: Option<SpatialPose>,
}

/// The mounts of all robots, and the transforms that they are from.
#[derive(Default)]
pub(super) struct Mounts {
    pub(super) trees: FrameTrees,
    robots: Vec<RobotMount>,
    /// Whether the operator was told that a transform does not say whose it is.
    is_unnamed_reported: bool,
}

impl Mounts {
    /// Creates the mounts of a fleet, all unknown.
    pub(super) fn new(robot_count: usize) -> Self {
        Self { robots: vec![RobotMount::default(); robot_count], ..Self::default() }
    }

    /// Waits for a robot's transforms anew: its source has left.
    pub(super) fn await_transforms(&mut self, robot: RobotId) {
        if let Some(mount) = self.robots.get_mut(robot.index()) {
            mount.since = None;
        }
    }

    /// Takes the frames' names from a robot's odometry.
    pub(super) fn learn_odometry(&mut self, robot: RobotId, parent: &str, child: &str) {
        let Some(mount) = self.robots.get_mut(robot.index()) else { return };
        for (known, name) in mount.odometry_frames.iter_mut().zip([parent, child]) {
            set_name(known, name);
        }
    }

    /// Returns the LiDAR's upright frame as a transform from the base, if it is known.
    pub(super) fn transform(&self, robot: RobotId, base: u32) -> Option<RobotFrameTransform> {
        let (translation_m, rotation_xyzw) = self.robots.get(robot.index())?.base_from_scan?.parts();
        let child_frame = RobotFrame::BaseScan as u32;
        Some(RobotFrameTransform { parent_frame: base, child_frame, translation_m, rotation_xyzw })
    }

    /// Tells the operator once that odometry on a topic of all robots does not say whose it is.
    pub(super) fn report_unnamed(
        &mut self,
        parent: &str,
        child: &str,
        names: &RobotNames,
        notices: &mut Notices,
    ) {
        if !std::mem::replace(&mut self.is_unnamed_reported, true) {
            // Of the first robot, as an example.
            let topic =
                |name| names.robots().next().map_or_else(String::new, |robot| names.topic(robot, name));
            let [odom, base, tf, tf_static] = ["odom", "base_footprint", "tf", "tf_static"].map(topic);
            notices.push(format!(
                "{parent} -> {child} on /tf does not say which robot's it is, and is not used: several robots would read the \
                 same frames. Give each robot its own: frames {}, {} (frame_prefix), or its transforms on {tf} and {tf_static}. Until \
                 then odometry comes from {odom} alone", without_slash(&odom), without_slash(&base)
            ));
        }
    }
}

/// Replaces a name; an equal one costs nothing.
fn set_name(known: &mut String, name: &str) {
    if known != without_slash(name) {
        known.replace_range(.., without_slash(name));
    }
}

impl ExternalWorld {
    /// Puts the scan that is being decoded on its robot. Returns whether it is taken: not while its mount may still come.
    pub(super) fn mount_scan(
        &mut self,
        context: &MessageContext<'_>,
        robot: RobotId,
        frame: &str,
    ) -> Result<bool, WorldError> {
        let mount = &mut self.mounts.robots[robot.index()];
        set_name(&mut mount.scan_frame, frame);
        let is_waiting = context.received - *mount.since.get_or_insert(context.received) < MOUNT_WAIT_S;
        let known_before = mount
            .reported
            .map(|(reported, _)| reported)
            .filter(|reported| matches!(reported, Placement::Known(_)));
        let found = self.find_mount(context.source, robot);
        let mount = &mut self.mounts.robots[robot.index()];
        let placement = match found {
            Ok(Ok((pose, found))) => {
                mount.base_from_scan = Some(if found.is_upside_down { pose.turned_over() } else { pose });
                Placement::Known(found)
            }
            // A source that has come back sends its transforms soon.
            Ok(Err(_)) if is_waiting => match known_before {
                Some(known) => known,
                None if context.source == DDS_SOURCE => return Ok(false),
                None => {
                    self.scan.set_mount(None);
                    return Ok(true);
                }
            },
            Ok(Err(unknown)) => {
                mount.base_from_scan = None;
                unknown
            }
            Err(source) => {
                mount.base_from_scan = None;
                return Err(WorldError::Mount { robot, frame: frame.into(), source });
            }
        };
        let known = match placement {
            Placement::Known(mount) => Some(mount),
            Placement::Unknown | Placement::Shared(_) => None,
        };
        if known.is_some_and(|mount| mount.is_upside_down) {
            self.scan.mirror();
        }
        self.scan.set_mount(known.map(|mount| mount.base_from_scan));
        self.report_mount(robot, placement, context.received);
        Ok(true)
    }

    /// Returns a LiDAR's pose on its base and what that is in the plane, or why it is not known.
    fn find_mount(
        &self,
        source: SourceId,
        robot: RobotId,
    ) -> Result<Result<(SpatialPose, ScannerMount), Placement>, MountError> {
        let mount = &self.mounts.robots[robot.index()];
        let of_fleet = |name: &str| match self.names.parse_frame_of(robot, name) {
            Some(FleetFrame::Robot(frame)) => Some(frame),
            _ => None,
        };
        let [odom, base] = &mount.odometry_frames;
        let is_odom = |name: &str| name == odom || of_fleet(name) == Some(RobotFrame::Odom);
        let is_base = |name: &str| name == base || of_fleet(name) == Some(RobotFrame::BaseFootprint);
        let (mut at, mut pose) = (mount.scan_frame.as_str(), SpatialPose::IDENTITY);
        if at.is_empty() {
            return Ok(Err(Placement::Unknown));
        }
        for _ in 0..CHAIN_MAX {
            if is_base(at) {
                return on_base(pose);
            }
            let Some((edge, is_shared)) = self.mounts.trees.edge(source, robot, at) else {
                return if of_fleet(at) == Some(RobotFrame::BaseLink) {
                    on_base(pose)
                } else {
                    Ok(Err(Placement::Unknown))
                };
            };
            if is_odom(&edge.parent) {
                return on_base(pose);
            }
            if let Some(other) = self.robot_with_scan_frame(robot, at).filter(|_| is_shared) {
                return Ok(Err(Placement::Shared(other)));
            }
            (pose, at) = (edge.parent_from_child.compose(&pose), &edge.parent);
        }
        Ok(Err(Placement::Unknown))
    }

    /// Returns another robot whose scans have this frame.
    fn robot_with_scan_frame(&self, robot: RobotId, frame: &str) -> Option<RobotId> {
        let has_frame = |other: &RobotId| self.mounts.robots[other.index()].scan_frame == frame;
        self.names.robots().filter(|other| *other != robot).find(has_frame)
    }

    /// Writes a notice when a mount is known first, or has changed.
    fn report_mount(&mut self, robot: RobotId, placement: Placement, received: Stamp) {
        let mount = &mut self.mounts.robots[robot.index()];
        let is_due = mount
            .reported
            .is_none_or(|(reported, at)| !is_same(reported, placement) && is_due(Some(at), received));
        if is_due {
            let before = mount.reported.map(|(reported, _)| reported);
            mount.reported = Some((placement, received));
            self.notices.push(notice(robot, &mount.scan_frame, placement, before));
        }
    }
}

fn on_base(pose: SpatialPose) -> Result<Result<(SpatialPose, ScannerMount), Placement>, MountError> {
    let mount = pose.mount().map_err(|tilt_deg| MountError::Tilted { tilt_deg })?;
    let distance_m = mount.base_from_scan.x_m.hypot(mount.base_from_scan.y_m);
    if distance_m > DISTANCE_MAX_M {
        return Err(MountError::Far { distance_m });
    }
    Ok(Ok((pose, mount)))
}

/// Returns whether two placements are the same but for what transforms are rounded to.
fn is_same(a: Placement, b: Placement) -> bool {
    let (Placement::Known(a), Placement::Known(b)) = (a, b) else { return a == b };
    let change = a.base_from_scan.between(b.base_from_scan);
    a.is_upside_down == b.is_upside_down
        && change.x_m.hypot(change.y_m) <= SAME_M
        && change.yaw_rad.to_degrees().abs() <= SAME_DEG
        && (a.tilt_deg - b.tilt_deg).abs() <= SAME_DEG
}

/// Returns what the operator is told of a mount.
fn notice(robot: RobotId, frame: &str, placement: Placement, before: Option<Placement>) -> String {
    let mut text = match placement {
        Placement::Known(ScannerMount { base_from_scan, is_upside_down, tilt_deg }) => {
            let Pose2 { x_m, y_m, yaw_rad } = base_from_scan;
            let over = if is_upside_down { ", upside down: its scans are mirrored" } else { "" };
            let tilt = if tilt_deg > TILT_TOLD_DEG {
                format!(
                    "; it is tilted by {tilt_deg:.0} degrees, so that it may see the floor, and ranges are too long"
                )
            } else {
                String::new()
            };
            format!(
                "{robot}: its transforms put the LiDAR `{frame}` at x {x_m:.3} m, y {y_m:.3} m, yaw {:.1} degrees on the base\
                 {over}{tilt}; base_from_scan below [slam.lidar] is not used for it",
                yaw_rad.to_degrees()
            )
        }
        Placement::Unknown => format!(
            "{robot}: no transforms lead from its base to its LiDAR `{frame}`: it is taken as level, upright and at \
             base_from_scan below [slam.lidar]; publish base_link -> {frame} on /tf_static, or check base_from_scan"
        ),
        Placement::Shared(other) => format!(
            "{robot} and {other} call their LiDARs `{frame}` on one /tf: which mount is whose is not known, and \
             base_from_scan below [slam.lidar] is used; give each robot its own frames (frame_prefix) or its transforms on \
             /{robot}/tf and /{robot}/tf_static"
        ),
    };
    match before {
        None => {}
        Some(Placement::Known(_)) => {
            text += ". The mount has changed: a LiDAR that moves on its base is not supported";
        }
        Some(_) => {
            text += ". Scans were mapped with the configured mount before: if it differs, begin a new map"
        }
    }
    text
}
