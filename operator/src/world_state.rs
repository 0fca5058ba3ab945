//! World state, with the newest transform of each frame, scan of each robot, and maps that the bridge sent.
//!
//! State, not a queue: newer content replaces older, however rarely it is read.

use crate::link_statistics::MessageContent;
use crate::robot_topics::RobotTopics;
use bridge::cdr::DecodeError;
use bridge::ros::{self, Bool, FrameNames, Int32, LaserScan, NameStyle, OccupancyGrid, TfMessage};
use msg::pose::yaw_of_quaternion;
use msg::{Pose2, ROBOTS_MAX, RobotFrame, RobotId, Stamp};
use nav::observation::BURGER_BASE_FROM_SCAN;
use nav::{MapView, RobotObservation, ScanView};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Most frames kept: 64 robots with 8 frames each, twice over.
const FRAMES_MAX: usize = 1024;
/// Most steps from a frame to an ancestor: base to map takes three, so more mean a loop.
const STEPS_MAX: usize = 16;
/// Age at which a pose is no longer used, seconds: 20 periods of a robot's transforms.
const POSE_AGE_MAX_S: f64 = 1.0;
/// Age at which a link on the way from a robot to a map is no longer used, seconds: the bridge repeats those of maps once a second, while
/// they hold.
const LINK_AGE_MAX_S: f64 = 5.0;

/// Newest transform of a frame to its parent.
#[derive(Clone, Debug)]
struct FrameTransform {
    parent: String,
    parent_from_child: Pose2,
    received: Stamp,
}

/// Newest map on one topic: its bytes until they are decoded, and the last one decoded.
#[derive(Clone, Debug, Default)]
struct MapSlot {
    encoded: Option<Vec<u8>>,
    decoded: Option<Arc<OccupancyGrid>>,
}

impl MapSlot {
    fn store(&mut self, payload: &[u8]) {
        let encoded = self.encoded.get_or_insert_default();
        encoded.clear();
        encoded.extend_from_slice(payload);
    }
}

/// Maps with the robot that each belongs to; `None` is the merged map.
pub type Maps<T> = Vec<(Option<RobotId>, T)>;

/// Decodes maps, without access to the state. Maps that cannot be decoded are left out.
pub fn decode_maps(encoded: Maps<Vec<u8>>) -> Maps<Arc<OccupancyGrid>> {
    let decode = |bytes: Vec<u8>| ros::decode(&bytes).ok().map(Arc::new);
    encoded.into_iter().filter_map(|(robot, bytes)| Some((robot, decode(bytes)?))).collect()
}

/// Newest state of one robot. Owns its content; [`RobotState::observation`] borrows it for navigation.
#[derive(Clone, Debug)]
pub struct RobotState {
    /// The robot described.
    pub robot: RobotId,
    /// The merged map, or the robot's own while that is not merged.
    pub map: Option<Arc<OccupancyGrid>>,
    /// Whether `map` is the merged map.
    pub in_merged_map: bool,
    /// Pose of the robot in `map`.
    pub map_from_base: Option<Pose2>,
    /// Newest scan with its time of arrival.
    pub scan: Option<(Stamp, Arc<LaserScan>)>,
    /// Pose of the sensor on the robot.
    pub base_from_scan: Pose2,
}

impl RobotState {
    /// The state as navigation reads it.
    pub fn observation(&self) -> RobotObservation<'_> {
        let map = self.map.as_deref().and_then(|map| {
            let [x_m, y_m, _] = map.position;
            let map_from_grid = Pose2::new(x_m, y_m, yaw_of_quaternion(map.orientation));
            let size = (map.width, map.height);
            MapView::from_percent(map_from_grid, f64::from(map.resolution), size, &map.data)
        });
        let scan = self.scan.as_ref().map(|(received, scan)| ScanView {
            received: *received,
            base_from_scan: self.base_from_scan,
            angle_min_rad: f64::from(scan.angle_min),
            angle_increment_rad: f64::from(scan.angle_increment),
            range_min_m: f64::from(scan.range_min),
            range_max_m: f64::from(scan.range_max),
            ranges_m: &scan.ranges,
        });
        let Self { robot, in_merged_map, map_from_base, .. } = *self;
        RobotObservation { robot, map, in_merged_map, map_from_base, scan }
    }
}

/// All that the bridge has sent. Stamps are times of arrival on the operator's clock.
#[derive(Clone, Debug)]
pub struct WorldState {
    robots: RobotTopics,
    /// Names of frames in the styles that the bridge may use.
    frame_names: [FrameNames; 2],
    transforms: BTreeMap<String, FrameTransform>,
    scans: [Option<(Stamp, Arc<LaserScan>)>; ROBOTS_MAX],
    merged_map: MapSlot,
    robot_maps: [MapSlot; ROBOTS_MAX],
    selected_robot: Option<i32>,
    is_emergency_stopped: bool,
}

impl Default for WorldState {
    fn default() -> Self {
        Self::new(RobotTopics::default())
    }
}

impl WorldState {
    /// Creates the state of a fleet of which nothing was received yet.
    pub fn new(robots: RobotTopics) -> Self {
        Self {
            frame_names: [NameStyle::Flat, NameStyle::Slash]
                .map(|style| FrameNames::new(style, robots.names())),
            robots,
            transforms: BTreeMap::new(),
            scans: [const { None }; ROBOTS_MAX],
            merged_map: MapSlot::default(),
            robot_maps: std::array::from_fn(|_| MapSlot::default()),
            selected_robot: None,
            is_emergency_stopped: false,
        }
    }

    /// Stores the content of a message that the statistics have recorded.
    pub fn store(
        &mut self,
        now: Stamp,
        topic: &str,
        payload: &[u8],
        content: MessageContent,
    ) -> Result<(), DecodeError> {
        match (content, topic) {
            (MessageContent::Transforms(message), _) => self.store_transforms(now, message),
            (MessageContent::Scan(robot, scan), _) => self.scans[robot.index()] = Some((now, Arc::new(scan))),
            (MessageContent::Encoded, "/merged_map") => self.merged_map.store(payload),
            (MessageContent::Encoded, "/selected_robot") => {
                self.selected_robot = Some(ros::decode::<Int32>(payload)?.0);
            }
            (MessageContent::Encoded, "/emergency_stop") => {
                self.is_emergency_stopped = ros::decode::<Bool>(payload)?.0;
            }
            (MessageContent::Encoded, topic) => {
                if let Some((robot, "map")) = self.robots.split(topic) {
                    self.robot_maps[robot.index()].store(payload);
                }
            }
        }
        Ok(())
    }

    /// Returns the topics of the robots.
    pub fn robot_topics(&self) -> &RobotTopics {
        &self.robots
    }

    /// Forgets which robot is selected: another operator may select one while the link is down.
    pub fn on_disconnected(&mut self) {
        self.selected_robot = None;
    }

    /// Number of the robot that `/cmd_vel` goes to, if the bridge has said so.
    pub fn selected_robot(&self) -> Option<i32> {
        self.selected_robot
    }

    /// Whether the emergency stop is set.
    pub fn is_emergency_stopped(&self) -> bool {
        self.is_emergency_stopped
    }

    /// Takes the maps that arrived since the last call, encoded.
    pub fn take_encoded_maps(&mut self) -> Maps<Vec<u8>> {
        let merged = self.merged_map.encoded.take().map(|bytes| (None, bytes));
        let robots = RobotId::first(ROBOTS_MAX).zip(&mut self.robot_maps);
        let robots = robots.filter_map(|(robot, slot)| Some((Some(robot), slot.encoded.take()?)));
        merged.into_iter().chain(robots).collect()
    }

    /// Stores decoded maps.
    pub fn store_maps(&mut self, maps: Maps<Arc<OccupancyGrid>>) {
        for (robot, map) in maps {
            let slot = robot.map_or(&mut self.merged_map, |robot| &mut self.robot_maps[robot.index()]);
            slot.decoded = Some(map);
        }
    }

    /// Newest merged map that was decoded.
    pub fn merged_map(&self) -> Option<Arc<OccupancyGrid>> {
        self.merged_map.decoded.clone()
    }

    /// State of one robot: in the merged map if its place there is known, else in its own map.
    pub fn robot(&self, now: Stamp, robot: RobotId) -> RobotState {
        let has_merged_map = self.merged_map.decoded.is_some();
        let map_from_base = self.pose_in_map(now, robot, None).filter(|_| has_merged_map);
        let in_merged_map = map_from_base.is_some();
        let (map, map_from_base) = match in_merged_map {
            true => (self.merged_map.decoded.clone(), map_from_base),
            false => {
                let own_map = self.robot_maps[robot.index()].decoded.clone();
                (own_map, self.pose_in_map(now, robot, Some(robot)))
            }
        };
        RobotState {
            robot,
            map,
            in_merged_map,
            map_from_base,
            scan: self.scans[robot.index()].clone(),
            base_from_scan: self.base_from_scan(robot).unwrap_or(BURGER_BASE_FROM_SCAN),
        }
    }

    fn store_transforms(&mut self, now: Stamp, message: TfMessage) {
        for transform in message.transforms {
            let [x_m, y_m, _] = transform.translation;
            let pose = Pose2::new(x_m, y_m, yaw_of_quaternion(transform.rotation));
            let is_known = self.transforms.contains_key(&transform.child_frame_id);
            if pose.is_finite() && (is_known || self.transforms.len() < FRAMES_MAX) {
                let newest =
                    FrameTransform { parent: transform.frame_id, parent_from_child: pose, received: now };
                self.transforms.insert(transform.child_frame_id, newest);
            }
        }
    }

    /// Pose of a robot's base in the map of a robot, or in the merged map if `map_of` is `None`.
    fn pose_in_map(&self, now: Stamp, robot: RobotId, map_of: Option<RobotId>) -> Option<Pose2> {
        self.frame_names.iter().find_map(|names| {
            let base = names.robot_frame(robot, RobotFrame::BaseFootprint);
            if now - self.transforms.get(base)?.received > POSE_AGE_MAX_S {
                return None;
            }
            let map = map_of.map_or(ros::names::MAP, |map_of| names.map(map_of));
            self.ancestor_from_frame(map, base, |link| now - link.received <= LINK_AGE_MAX_S)
        })
    }

    fn base_from_scan(&self, robot: RobotId) -> Option<Pose2> {
        self.frame_names.iter().find_map(|names| {
            let base = names.robot_frame(robot, RobotFrame::BaseFootprint);
            // The scanner is fixed: its link may be said once.
            self.ancestor_from_frame(base, names.robot_frame(robot, RobotFrame::BaseScan), |_| true)
        })
    }

    /// Pose of a frame in one of its ancestors; `None` if the ancestor is not on the way to the root, or a link does not hold.
    fn ancestor_from_frame(
        &self,
        ancestor: &str,
        frame: &str,
        holds: impl Fn(&FrameTransform) -> bool,
    ) -> Option<Pose2> {
        let mut current = frame;
        let mut current_from_frame = Pose2::IDENTITY;
        for _ in 0..STEPS_MAX {
            if current == ancestor {
                return Some(current_from_frame);
            }
            let transform = self.transforms.get(current).filter(|link| holds(link))?;
            current_from_frame = transform.parent_from_child * current_from_frame;
            current = &transform.parent;
        }
        None
    }
}

#[cfg(test)]
mod tests;
