//! Selects the topics of a message of the fleet, and encodes the message for each.

mod fixed_frames;
mod json;
mod repeated;

use super::changed_area::ChangedAreaFinder;
use super::changed_tiles::ChangedTileFinder;
use super::odom_frames::OdomFrames;
use super::static_transforms::StaticTransformSet;
use super::table::FleetTopic;
use crate::input::InputPurpose;
use crate::repeater::{PoseEstimateRepeater, Repetition};
use json::{exploration_json, navigation_json, zones_json};
use msg::{
    Battery, Clock, ExclusionZones, ExplorationReport, FleetStats, GridView, MapTransforms, Monotonic,
    NavigationPlan, NavigationReport, Odometry, PoseEstimate, RobotFrame, RobotId, Scan, Stamp, Transforms,
};
use ros_messages::battery::write_battery;
use ros_messages::cdr::Writer;
use ros_messages::map_tiles::write_map_tiles;
use ros_messages::navigation::write_path;
use ros_messages::{FrameNames, NameStyle, RobotNames, names, write};
use ros_messages::{OdometryCovariance, OdometrySigmas};
use std::time::Duration;

/// The transforms from the robots' maps to the merged map are published again after this time, because `/tf` keeps
/// no message for late subscribers.
const MAP_TRANSFORMS_PERIOD: Duration = Duration::from_secs(1);

/// A message of the fleet, as its channel carries it.
#[derive(Clone, Copy)]
pub enum FleetMessage<'a> {
    /// A robot's laser scan: `/robotN/scan`.
    Scan(RobotId, &'a Scan),
    /// The transforms between a robot's own frames: `/tf`, and `/tf_static` on DDS.
    Transforms(RobotId, &'a Transforms),
    /// A robot's wheel odometry: `/robotN/odom`.
    Odometry(RobotId, &'a Odometry),
    /// The state of a robot's battery: `/robotN/battery_state`.
    Battery(RobotId, &'a Battery),
    /// SLAM's transform map -> odom and pose of a robot: `/tf` and `/robotN/pose`.
    PoseEstimate(RobotId, &'a PoseEstimate),
    /// The transforms from the robots' maps to the merged map: `/tf`, on change and once a second.
    MapTransforms(&'a MapTransforms),
    /// The run's time: `/clock`.
    Clock(&'a Clock),
    /// A robot's whole map: `/robotN/map`.
    Map(RobotId, GridView<'a>),
    /// The map of all robots: `/merged_map`, `/map`, `/map_updates`, `/merged_map_tiles` and `/merged_map_probability`.
    MergedMap(GridView<'a>),
    /// The fleet's statistics: `/robotN/slam_stats` of every robot.
    Stats(&'a FleetStats),
    /// The edges between the robots' maps as JSON: `/merge_edges`.
    MergeEdges(&'a str),
    /// How far the exploration is: `/explore/state`.
    ExplorationState(&'a ExplorationReport),
    /// The areas that navigation keeps robots out of: `/exclusion_zones`.
    ExclusionZones(&'a ExclusionZones),
    /// What navigation does with a robot: `/robotN/navigation_state`.
    NavigationState(RobotId, &'a NavigationReport),
    /// The planned path of a robot: `/robotN/plan`.
    Plan(RobotId, &'a NavigationPlan),
}

/// Where a transport accepts encoded messages.
pub trait TopicSink {
    /// Encodes and sends a message, if the topic exists on this transport and somebody needs the message.
    fn send(&mut self, topic: FleetTopic, robot: Option<RobotId>, encode: impl FnOnce(&mut Writer<'_>));

    /// Sends the newest message of a latched topic on another topic, without encoding it again.
    fn send_again(&mut self, topic: FleetTopic, newest_of: FleetTopic);

    /// Returns whether somebody subscribes to a topic of the whole fleet.
    fn is_subscribed(&self, topic: FleetTopic) -> bool;
}

/// How the transforms between a robot's own frames are published.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RobotTransformPolicy {
    /// All of them on `/tf`, because Unity's connector listens to that alone; the fixed ones on `/tf_static` too.
    OnTf,
    /// The moving ones on `/tf`, the fixed ones once on `/tf_static`.
    Split,
    /// Not at all: the robots publish them themselves.
    ByRobots,
}

/// Published values of each cell value, by its bits.
struct GridValues {
    /// Free, occupied or unknown.
    trinary: [i8; 256],
    /// Percent of occupation.
    percent: [i8; 256],
}

/// What finds the changes of the merged map: one area for `/map_updates`, tiles for `/merged_map_tiles`.
#[derive(Default)]
struct MapChanges {
    area: ChangedAreaFinder,
    tiles: ChangedTileFinder,
}

/// The covariances of all robots' odometry.
struct OdometryCovariances {
    sigmas: OdometrySigmas,
    robots: Vec<OdometryCovariance>,
}

/// What repeated transforms need.
struct RepeatedTransforms {
    repeater: PoseEstimateRepeater,
    /// The frames of external robots, as they call them.
    frames: Option<OdomFrames>,
    /// The pose estimates that are being sent.
    due: Vec<(RobotId, PoseEstimate)>,
}

/// Publishes the fleet's messages on a transport's topics.
pub struct FleetPublisher {
    robots: RobotNames,
    names: FrameNames,
    values: GridValues,
    map_changes: MapChanges,
    odometry: OdometryCovariances,
    /// The transforms map -> odom if they are repeated; otherwise they are sent with each of SLAM's answers.
    repeated: Option<RepeatedTransforms>,
    robot_transforms: RobotTransformPolicy,
    /// The transforms that never change; empty if they are [`RobotTransformPolicy::ByRobots`].
    static_transforms: StaticTransformSet,
    /// Whether each robot's fixed frames are in the set.
    has_fixed_frames: Vec<bool>,
    map_transforms: Option<MapTransforms>,
    map_transforms_due: Option<Monotonic>,
    now: Stamp,
}

impl FleetPublisher {
    /// Creates the publisher of a fleet.
    pub fn new(style: NameStyle, robots: &RobotNames, robot_transforms: RobotTransformPolicy) -> Self {
        Self {
            robots: robots.clone(),
            names: FrameNames::new(style, robots),
            values: GridValues { trinary: msg::grid::trinary_table(), percent: msg::grid::percent_table() },
            map_changes: MapChanges::default(),
            odometry: OdometryCovariances {
                sigmas: OdometrySigmas::default(),
                robots: vec![OdometryCovariance::default(); robots.count()],
            },
            repeated: None,
            robot_transforms,
            static_transforms: StaticTransformSet::default(),
            has_fixed_frames: vec![false; robots.count()],
            map_transforms: None,
            map_transforms_due: None,
            now: Stamp(0),
        }
    }

    /// Sets the errors of the robots' odometry.
    pub fn set_odometry_sigmas(&mut self, sigmas: OdometrySigmas) {
        self.odometry.sigmas = sigmas;
    }

    /// Repeats the transforms map -> odom from now on, by [`FleetPublisher::repeat_transforms`], dated ahead.
    pub fn set_repetition(&mut self, repetition: Repetition) {
        let robot_count = self.robots.count();
        let is_external = self.robot_transforms == RobotTransformPolicy::ByRobots;
        self.repeated = Some(RepeatedTransforms {
            repeater: PoseEstimateRepeater::new(repetition, robot_count),
            frames: is_external.then(|| OdomFrames::new(robot_count)),
            due: Vec::with_capacity(robot_count),
        });
    }

    /// Takes the names of an external robot's frames from its message.
    pub fn learn_frames(&mut self, input: InputPurpose, payload: &[u8]) {
        if let Some(frames) = self.repeated.as_mut().and_then(|repeated| repeated.frames.as_mut()) {
            frames.learn(&self.robots, input, payload);
        }
    }

    /// Returns the robots' names.
    pub fn robots(&self) -> &RobotNames {
        &self.robots
    }

    /// Returns the names of the robots' frames.
    pub fn names(&self) -> &FrameNames {
        &self.names
    }

    /// Returns the newest time of the run that was published.
    pub fn now(&self) -> Stamp {
        self.now
    }

    /// Returns the newest transforms from the robots' maps to the merged map.
    pub fn map_transforms(&self) -> Option<&MapTransforms> {
        self.map_transforms.as_ref()
    }

    fn has(&self, robot: RobotId) -> bool {
        robot.number() <= self.robots.count()
    }

    /// Publishes a message on its topics. Messages of robots that the fleet does not have are dropped.
    pub fn publish(&mut self, message: FleetMessage<'_>, sink: &mut impl TopicSink) {
        match message {
            FleetMessage::Scan(robot, scan) if self.has(robot) => {
                let frame = self.names.robot_frame(robot, RobotFrame::BaseScan);
                sink.send(FleetTopic::Scan, Some(robot), |to| write::laser_scan(to, frame, scan));
            }
            FleetMessage::Transforms(robot, transforms) if self.has(robot) => {
                self.publish_links(robot, transforms, sink);
            }
            FleetMessage::Odometry(robot, odometry) if self.has(robot) => {
                self.publish_odometry(robot, odometry, sink);
            }
            FleetMessage::Battery(robot, battery) if self.has(robot) => {
                sink.send(FleetTopic::Battery, Some(robot), |to| write_battery(to, battery));
            }
            FleetMessage::PoseEstimate(robot, pose_estimate) if self.has(robot) => {
                self.publish_pose_estimate(robot, pose_estimate, sink);
            }
            FleetMessage::Map(robot, map) if self.has(robot) => {
                let (frame, values) = (self.names.map(robot), &self.values.trinary);
                let encode = |to: &mut Writer<'_>| write::occupancy_grid(to, frame, values, map);
                sink.send(FleetTopic::Map, Some(robot), encode);
            }
            FleetMessage::NavigationState(robot, report) if self.has(robot) => {
                let json = navigation_json(report);
                sink.send(FleetTopic::NavigationState, Some(robot), |to| to.string(&json));
            }
            FleetMessage::Plan(robot, plan) if self.has(robot) => self.publish_plan(robot, plan, sink),
            FleetMessage::Scan(..)
            | FleetMessage::Transforms(..)
            | FleetMessage::Odometry(..)
            | FleetMessage::Battery(..)
            | FleetMessage::PoseEstimate(..)
            | FleetMessage::Map(..)
            | FleetMessage::NavigationState(..)
            | FleetMessage::Plan(..) => {}
            FleetMessage::MapTransforms(transforms) => self.set_map_transforms(transforms, sink),
            FleetMessage::Clock(clock) => {
                self.now = clock.header.stamp;
                sink.send(FleetTopic::Clock, None, |to| write::stamp(to, clock.header.stamp));
            }
            FleetMessage::MergedMap(map) => self.publish_merged_map(map, sink),
            FleetMessage::Stats(stats) => {
                for robot in self.robots.robots() {
                    let encode = |to: &mut Writer<'_>| write::slam_stats(to, &stats.robots[robot.index()]);
                    sink.send(FleetTopic::SlamStats, Some(robot), encode);
                }
            }
            FleetMessage::ExplorationState(report) => {
                let json = exploration_json(report, &self.robots, &self.names);
                send_text(FleetTopic::ExplorationState, &json, sink);
            }
            FleetMessage::ExclusionZones(zones) => {
                send_text(FleetTopic::ExclusionZones, &zones_json(zones), sink)
            }
            FleetMessage::MergeEdges(json) => send_text(FleetTopic::MergeEdges, json, sink),
        }
    }

    /// Publishes a robot's odometry with the errors that have added up.
    fn publish_odometry(&mut self, robot: RobotId, odometry: &msg::Odometry, sink: &mut impl TopicSink) {
        let frame = self.names.robot_frame(robot, RobotFrame::Odom);
        let child = self.names.robot_frame(robot, RobotFrame::BaseFootprint);
        let OdometryCovariances { sigmas, robots } = &mut self.odometry;
        let covariance = &mut robots[robot.index()];
        covariance.add(sigmas, odometry);
        let encode = |to: &mut Writer<'_>| {
            let of_velocity = OdometryCovariance::of_velocity(sigmas, odometry);
            write::odometry(to, frame, child, odometry, &covariance.of_pose(), &of_velocity);
        };
        sink.send(FleetTopic::Odometry, Some(robot), encode);
    }

    fn publish_plan(&self, robot: RobotId, plan: &NavigationPlan, sink: &mut impl TopicSink) {
        let frame = if plan.in_merged_map == 1 { names::MAP } else { self.names.map(robot) };
        let encode = |to: &mut Writer<'_>| write_path(to, frame, plan.header.stamp, plan.points_m());
        sink.send(FleetTopic::Plan, Some(robot), encode);
    }

    /// Publishes the merged map, and what changed in it since the last one.
    fn publish_merged_map(&mut self, map: GridView<'_>, sink: &mut impl TopicSink) {
        let GridValues { trinary, percent } = &self.values;
        let encode = |to: &mut Writer<'_>| write::occupancy_grid(to, names::MAP, trinary, map);
        sink.send(FleetTopic::MergedMap, None, encode);
        sink.send_again(FleetTopic::MergedMapAlias, FleetTopic::MergedMap);
        let encode = |to: &mut Writer<'_>| write::occupancy_grid(to, names::MAP, percent, map);
        sink.send(FleetTopic::MergedMapProbability, None, encode);
        if !sink.is_subscribed(FleetTopic::MapUpdates) {
            self.map_changes.area.clear();
        } else if let Some(area) = self.map_changes.area.changed_area(map) {
            let encode =
                |to: &mut Writer<'_>| write::occupancy_grid_update(to, names::MAP, trinary, map, area);
            sink.send(FleetTopic::MapUpdates, None, encode);
        }
        if !sink.is_subscribed(FleetTopic::MergedMapTiles) {
            self.map_changes.tiles.clear();
        } else if let Some(update) = self.map_changes.tiles.changed_tiles(map, trinary) {
            let encode = |to: &mut Writer<'_>| write_map_tiles(to, names::MAP, trinary, map, update);
            sink.send(FleetTopic::MergedMapTiles, None, encode);
        }
    }

    fn publish_links(&mut self, robot: RobotId, transforms: &Transforms, sink: &mut impl TopicSink) {
        let names = &self.names;
        match self.robot_transforms {
            RobotTransformPolicy::OnTf => {
                let encode = |to: &mut Writer<'_>| write::transforms(to, names, robot, transforms);
                sink.send(FleetTopic::Transforms, None, encode);
                self.publish_fixed_frames(robot, transforms, sink);
            }
            RobotTransformPolicy::Split => {
                sink.send(FleetTopic::Transforms, None, |to| {
                    write::some_transforms(to, names, &[(robot, transforms)], |frame| !frame.is_fixed());
                });
                self.publish_fixed_frames(robot, transforms, sink);
            }
            RobotTransformPolicy::ByRobots => {}
        }
    }

    fn publish_pose_estimate(
        &mut self,
        robot: RobotId,
        pose_estimate: &PoseEstimate,
        sink: &mut impl TopicSink,
    ) {
        if self.robot_transforms == RobotTransformPolicy::ByRobots {
            // Nobody else may say the time there.
            self.now = self.now.max(pose_estimate.header.stamp);
        }
        let Some(pose_estimate) = self.in_published_map(pose_estimate) else { return };
        let (names, frame) = (&self.names, self.names.map(robot));
        let pose_estimate = &pose_estimate;
        sink.send(FleetTopic::Pose, Some(robot), |to| write::pose_estimate(to, frame, pose_estimate));
        // Where odometry was never known, `odom` lies nowhere: no transform is sent.
        let Some(map_from_odom) = pose_estimate.map_from_odom().filter(|_| self.repeated.is_none()) else {
            return;
        };
        let stamp = pose_estimate.header.stamp;
        let poses = (self.map_from_robot_map(robot), map_from_odom);
        let encode = |to: &mut Writer<'_>| write::map_from_odom(to, names, robot, stamp, poses);
        sink.send(FleetTopic::Transforms, None, encode);
    }

    /// Returns a pose estimate in the map that its frame names: a robot with plain names has the merged map alone.
    ///
    /// `None` while that map's transform is not known.
    fn in_published_map(&self, pose_estimate: &PoseEstimate) -> Option<PoseEstimate> {
        if !self.robots.is_plain() {
            return Some(*pose_estimate);
        }
        Some(pose_estimate.transformed(self.map_transforms.as_ref()?.robots[0].known_pose()?))
    }

    fn set_map_transforms(&mut self, transforms: &MapTransforms, sink: &mut impl TopicSink) {
        let has_changed = self.map_transforms.is_none_or(|before| before.robots != transforms.robots);
        self.map_transforms = Some(*transforms);
        if has_changed {
            self.publish_map_transforms(sink);
        }
    }

    /// Publishes the transforms from the robots' maps to the merged map with the newest time of the run.
    pub fn publish_map_transforms(&mut self, sink: &mut impl TopicSink) {
        let Some(transforms) = &self.map_transforms else { return };
        // A robot with plain names has no map of its own.
        if self.robots.is_plain() || transforms.robots.iter().all(|robot| robot.known != 1) {
            return;
        }
        let stamp = self.now.max(transforms.header.stamp);
        let encode = |to: &mut Writer<'_>| write::map_transforms(to, &self.names, stamp, transforms);
        sink.send(FleetTopic::Transforms, None, encode);
        // The next tick begins the period.
        self.map_transforms_due = None;
    }

    /// Publishes again what late subscribers would miss.
    pub fn tick(&mut self, now: Monotonic, sink: &mut impl TopicSink) {
        match self.map_transforms_due {
            Some(due) if now < due => return,
            Some(_) => self.publish_map_transforms(sink),
            None => {}
        }
        self.map_transforms_due = Some(now + MAP_TRANSFORMS_PERIOD);
    }
}

/// Sends a text of the fleet as a std_msgs/String.
fn send_text(topic: FleetTopic, text: &str, sink: &mut impl TopicSink) {
    sink.send(topic, None, |to| to.string(text));
}
