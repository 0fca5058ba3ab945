//! Inputs of navigation: maps, poses and scans of the fleet, read only while a robot has a goal.

use crate::channel;
use crate::ports::{ChannelError, Ports, ReadMapPort, ReadPort};
use crate::run::Run;
use ::nav::{LocalizationUncertainty, MapView, NavigatedRobot, NavigationInput, RobotObservation, ScanView};
use msg::pose::yaw_of_quaternion;
use msg::{
    DenseMap, ExclusionZone, MapTransforms, Monotonic, Pose2, PoseEstimate, RobotFrame, RobotFrameTransform,
    RobotId, Scan, Stamp, TrackingState, Transforms,
};

/// Oldest pose that a robot is driven by, nanoseconds: ten periods of its odometry.
const POSE_AGE_MAX_NS: u64 = 500_000_000;

/// Time without a pose or a scan after which a robot counts as silent, nanoseconds: a restart takes less.
const SILENCE_MAX_NS: u64 = 3_000_000_000;

/// Channels that navigation reads.
pub(super) struct Inputs<P: Ports> {
    robots: Vec<RobotInputs<P>>,
    merged_map: MapInput<P>,
    map_transforms: P::Reader<MapTransforms>,
    newest_transforms: Option<MapTransforms>,
}

struct RobotInputs<P: Ports> {
    robot: RobotId,
    scans: P::Reader<Scan>,
    transforms: P::Reader<Transforms>,
    pose_estimates: P::Reader<PoseEstimate>,
    map: MapInput<P>,
    state: RobotState,
}

/// What is known of a robot.
#[derive(Default)]
struct RobotState {
    /// Newest scan, and when it was sent.
    scan: Option<(Box<Scan>, Monotonic)>,
    odom_from_base: Option<(Pose2, Monotonic)>,
    base_from_scan: Pose2,
    /// `None` while the robot is lost.
    map_from_odom: Option<Pose2>,
    /// `None` while the robot is lost.
    uncertainty: Option<LocalizationUncertainty>,
    /// When SLAM said so last.
    corrected: Option<Monotonic>,
}

struct MapInput<P: Ports> {
    reader: P::MapReader,
    grid: DenseMap,
}

impl<P: Ports> MapInput<P> {
    fn new(reader: P::MapReader) -> Self {
        Self { reader, grid: DenseMap::default() }
    }

    fn receive(&mut self) {
        if self.reader.poll() {
            self.grid.update(self.reader.map());
        }
    }

    fn view(&self) -> Option<MapView<'_>> {
        MapView::from_log_odds(self.grid.view())
    }
}

impl<P: Ports> Inputs<P> {
    pub(super) fn open(ports: &P, run: &Run) -> Result<Self, ChannelError> {
        let inputs = |robot| {
            Ok(RobotInputs {
                robot,
                scans: ports.reader(&channel::scan(robot))?,
                transforms: ports.reader(&channel::transforms(robot))?,
                pose_estimates: ports.reader(&channel::pose_estimate(robot))?,
                map: MapInput::new(ports.map_reader(&channel::map(robot))?),
                state: RobotState::default(),
            })
        };
        Ok(Self {
            robots: run.robots().map(inputs).collect::<Result<_, ChannelError>>()?,
            merged_map: MapInput::new(ports.map_reader(&channel::merged_map())?),
            map_transforms: ports.reader(&channel::map_transforms())?,
            newest_transforms: None,
        })
    }

    /// Receives what has arrived.
    pub(super) fn receive(&mut self, now: Monotonic) {
        if let Some(transforms) = self.map_transforms.newest() {
            self.newest_transforms = Some(*transforms);
        }
        let transforms = self.newest_transforms;
        for RobotInputs { robot, scans, transforms: links, pose_estimates, map, state } in &mut self.robots {
            if let Some(scan) = scans.newest() {
                // While nobody navigates, messages wait here: their age is that of their sending.
                state.scan = Some((Box::new(*scan), now.min(scan.header.sent)));
            }
            if let Some(links) = links.newest() {
                state.set_frames(&links, now.min(links.header.sent));
            }
            if let Some(pose_estimate) = pose_estimates.newest() {
                let is_located = pose_estimate.is_located();
                state.map_from_odom = pose_estimate.map_from_odom().filter(|_| is_located);
                state.uncertainty =
                    is_located.then(|| uncertainty(&pose_estimate)).filter(|known| known.sigma_m.is_finite());
                // SLAM that is paused looks at no scan: the robot has no SLAM.
                let is_paused = pose_estimate.state() == TrackingState::Paused;
                state.corrected = (!is_paused).then(|| now.min(pose_estimate.header.sent));
            }
            if map_from_robot_map(transforms.as_ref(), *robot).is_none() {
                map.receive();
            }
        }
        self.merged_map.receive();
    }

    /// Where a robot's map lies in the merged map; `None` while it is not merged.
    pub(super) fn map_from_robot_map(&self, robot: RobotId) -> Option<Pose2> {
        map_from_robot_map(self.newest_transforms.as_ref(), robot)
    }

    pub(super) fn is_merged(&self, robot: RobotId) -> bool {
        self.map_from_robot_map(robot).is_some()
    }

    pub(super) fn robot_map_from_odom(&self, robot: RobotId) -> Option<Pose2> {
        self.robots.get(robot.index())?.state.map_from_odom
    }

    pub(super) fn robot_map_from_base(&self, robot: RobotId) -> Option<Pose2> {
        let (odom_from_base, _) = self.robots.get(robot.index())?.state.odom_from_base?;
        Some(self.robot_map_from_odom(robot)? * odom_from_base)
    }

    /// The robots of which no pose, of odometry or of SLAM, or no scan has arrived for some seconds.
    pub(super) fn silent_robots(&self, now: Monotonic) -> Vec<RobotId> {
        let is_old = |at: Option<Monotonic>| at.is_none_or(|at| now.since(at) > SILENCE_MAX_NS);
        let is_silent = |inputs: &&RobotInputs<P>| {
            let state = &inputs.state;
            is_old(state.scan.as_ref().map(|(_, at)| *at))
                || is_old(state.odom_from_base.map(|(_, at)| at))
                || is_old(state.corrected)
        };
        self.robots.iter().filter(is_silent).map(|inputs| inputs.robot).collect()
    }

    /// Calls `step` with what is known of the fleet.
    pub(super) fn observe(
        &mut self,
        stamp: Stamp,
        now: Monotonic,
        exclusion_zones: &[ExclusionZone],
        step: impl FnOnce(&NavigationInput),
    ) {
        let merged_map = self.merged_map.view();
        let transforms = self.newest_transforms.as_ref();
        let robot = |inputs: &'_ RobotInputs<P>| {
            let state = &inputs.state;
            let map_from_robot_map = map_from_robot_map(transforms, inputs.robot);
            // Without SLAM the map's pose is odometry's, which drifts: nobody is driven by it.
            let has_slam = state.corrected.is_some_and(|at| now.since(at) <= SILENCE_MAX_NS);
            let is_fresh = |(_, at): &(Pose2, Monotonic)| has_slam && now.since(*at) <= POSE_AGE_MAX_NS;
            let odom_from_base = state.odom_from_base.filter(is_fresh).map(|(pose, _)| pose);
            let map_from_odom = match map_from_robot_map {
                Some(map_from_robot_map) => state.map_from_odom.map(|pose| map_from_robot_map * pose),
                None => state.map_from_odom,
            };
            // A robot that is not heard of any more stands where it was.
            let newest = state.odom_from_base.map(|(pose, _)| pose);
            (map_from_robot_map, odom_from_base, map_from_odom.zip(newest).map(|(a, b)| a * b))
        };
        let robots: Vec<NavigatedRobot> = self
            .robots
            .iter()
            .map(|inputs| {
                let (map_from_robot_map, odom_from_base, map_from_base) = robot(inputs);
                let scan = inputs.state.scan.as_ref().map(|(scan, at)| ScanView {
                    // The age of the newest scan, on the clock of the observation.
                    received: Stamp(stamp.0 - now.since(*at) as i64),
                    base_from_scan: inputs.state.base_from_scan,
                    ..ScanView::from_burger_scan(scan)
                });
                let in_merged_map = map_from_robot_map.is_some();
                let map = if in_merged_map { merged_map } else { inputs.map.view() };
                let observation =
                    RobotObservation { robot: inputs.robot, map, in_merged_map, map_from_base, scan };
                NavigatedRobot {
                    observation,
                    odom_from_base,
                    map_from_robot_map,
                    uncertainty: inputs.state.uncertainty,
                }
            })
            .collect();
        step(&NavigationInput { stamp, robots: &robots, exclusion_zones });
    }
}

impl RobotState {
    fn set_frames(&mut self, transforms: &Transforms, now: Monotonic) {
        let child = |frame: RobotFrame| {
            transforms.transforms().iter().find(|known| known.child_frame == frame as u32)
        };
        if let Some(base) =
            child(RobotFrame::BaseFootprint).filter(|base| base.parent_frame == RobotFrame::Odom as u32)
        {
            self.odom_from_base = Some((planar_pose(base), now));
        }
        let base_from_link = child(RobotFrame::BaseLink).map_or(Pose2::IDENTITY, planar_pose);
        if let Some(scan) = child(RobotFrame::BaseScan) {
            let is_of_link = scan.parent_frame == RobotFrame::BaseLink as u32;
            let parent = if is_of_link { base_from_link } else { Pose2::IDENTITY };
            self.base_from_scan = parent * planar_pose(scan);
        }
    }
}

/// Returns the pose on the floor of a link in its parent.
fn planar_pose(link: &RobotFrameTransform) -> Pose2 {
    Pose2::new(link.translation_m[0], link.translation_m[1], yaw_of_quaternion(link.rotation_xyzw))
}

/// How well SLAM knows a robot's place in its map.
fn uncertainty(pose_estimate: &PoseEstimate) -> LocalizationUncertainty {
    LocalizationUncertainty {
        sigma_m: pose_estimate.position_sigma_m(),
        is_fixed_by_scan: pose_estimate.state() == TrackingState::Tracking,
    }
}

fn map_from_robot_map(transforms: Option<&MapTransforms>, robot: RobotId) -> Option<Pose2> {
    transforms?.robots.get(robot.index())?.known_pose()
}
