//! One generated log through SLAM, and what came of it against the truth.

use super::building::{Building, Kind};
use super::picture;
use super::robot::{Event, OdometryKind, Robot, SENSORS, Step, angles_rad, drive};
use super::walls::share_in_map;
use super::wrong_sensor::WrongSensor;
use crate::noise::Noise;
use crate::settings::slam_config;
use msg::pose::best_rigid_transform;
use msg::{Header, Odometry, Pose2, Scan, Stamp, TrackingState};
use nalgebra::{Matrix3, Vector3};
use serde::Serialize;
use slam::{BackEnd, EdgeKind, FrontEnd, PlaceInMap, ReliabilityEvidence, Slam};
use std::path::Path;

/// An error that people call a wrong map, metres.
pub const METRE_SCALE_M: f64 = 1.0;
/// An edge further from the truth is wrong.
const WRONG_M: f64 = 0.5;
const WRONG_RAD: f64 = 0.15;
/// An error within so many standard deviations of the position is one that the covariance admits.
const SAID_SIGMAS: f64 = 3.0;
/// Each so many scans the covariance is compared with the error.
const NEES_EVERY: usize = 10;
/// Smallest range of the sensors, metres.
const RANGE_MIN_M: f32 = 0.05;

/// What a seed stands for.
#[derive(Clone, Copy, Debug)]
pub struct Case {
    /// The seed.
    pub seed: u64,
    /// The building's kind.
    pub kind: Kind,
    /// The robot.
    pub robot: Robot,
    /// What is wrong about its sensors.
    pub wrong_sensor: WrongSensor,
}

impl Case {
    /// Draws the case of a seed. Kind, sensor and odometry take turns, so that few seeds cover them; the rest is random. Each 48 seeds have
    /// each kind with each sensor, each 288 with each odometry as well.
    pub fn draw(seed: u64) -> Self {
        let mut noise = Noise::new(seed ^ 0x67E9_E7A7);
        let pick = |count: usize, stride: u64| ((seed / stride) % count as u64) as usize;
        let kind = Kind::ALL[pick(Kind::ALL.len(), 1)];
        let sensor = SENSORS[(pick(SENSORS.len(), 8) + pick(Kind::ALL.len(), 1)) % SENSORS.len()];
        let odometry =
            OdometryKind::ALL[(pick(OdometryKind::ALL.len(), 48) + pick(OdometryKind::ALL.len(), 3)) % 6];
        let event =
            if noise.uniform() < 0.5 { Event::Nothing } else { Event::ALL[noise.below(Event::ALL.len())] };
        let thinned_m = if noise.uniform() < 0.5 { noise.between(0.5, 1.0) } else { 0.0 };
        let people = if noise.uniform() < 0.3 { 1 + noise.below(4) } else { 0 };
        let dropout = if noise.uniform() < 0.3 { noise.between(0.0, 0.1) } else { 0.0 };
        let robot = Robot { sensor, odometry, event, thinned_m, people, dropout };
        Self { seed, kind, robot, wrong_sensor: WrongSensor::Nothing }
    }

    /// Draws the case of a seed, with this event on the way.
    pub fn draw_with_event(seed: u64, event: Event) -> Self {
        let case = Self::draw(seed);
        Self { robot: Robot { event, ..case.robot }, ..case }
    }

    /// Draws the case of a seed with sensors that are not as described.
    pub fn draw_with_wrong_sensor(seed: u64) -> Self {
        Self { wrong_sensor: WrongSensor::draw(seed), ..Self::draw(seed) }
    }
}

/// What came of a case.
// More than 12 fields: one for each figure in the JSON.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Outcome {
    /// The seed.
    pub seed: u64,
    /// Names of the case's parts.
    pub building: String,
    /// The sensor's name.
    pub sensor: String,
    /// The odometry's kind.
    pub odometry: String,
    /// What happened on the way.
    pub event: String,
    /// What is wrong about the sensors.
    pub wrong_sensor: String,
    /// Distance between scans, metres; 0: ten a second.
    pub thinned_m: f64,
    /// Length of the way, metres.
    pub way_m: f64,
    /// Number of scans.
    pub scans: usize,
    /// Mean and largest distance of the poses from the truth, after the best rigid alignment, metres.
    pub mean_error_m: f64,
    /// The largest.
    pub max_error_m: f64,
    /// The largest of the poses that SLAM said are placed in the map, metres.
    pub max_error_placed_m: f64,
    /// The largest of those that are more than [`SAID_SIGMAS`] standard deviations off, by their covariance in the map.
    pub max_error_unsaid_m: f64,
    /// Share of the scans whose node is placed in the map.
    pub placed_share: f64,
    /// Whether SLAM was lost at the end.
    pub lost_at_end: bool,
    /// Evidence that the map is wrong, as SLAM has it at the end.
    pub evidence: ReliabilityEvidence,
    /// Whether SLAM calls its map unreliable.
    pub is_unreliable: bool,
    /// Whether it says that the scans and odometry contradict each other all the time.
    pub says_wrong_sensor: bool,
    /// Number of active closures: right, wrong.
    pub closures: [usize; 2],
    /// Number of retracted closures: right, wrong.
    pub retracted: [usize; 2],
    /// Number of active wrong links between scans.
    pub wrong_links: usize,
    /// NEES over its degrees of freedom: median over the scans that were tracked.
    pub nees: Option<f64>,
    /// The same of active links and closures, against the truth: median over the edges.
    pub edge_nees: [Option<f64>; 2],
    /// Share of the walls that scans hit that are walls in the map.
    pub walls_share: f64,
}

impl Outcome {
    /// Whether a pose that SLAM calls part of its map is wrong by a metre.
    pub fn is_wrong(&self) -> bool {
        self.max_error_placed_m > METRE_SCALE_M
    }

    /// Whether a pose is wrong by a metre although SLAM calls it part of its map, its covariance in the map says otherwise,
    /// and the map is not called unreliable. A robot that is lost at the end has not said so of the poses before.
    pub fn is_silent(&self) -> bool {
        self.max_error_unsaid_m > METRE_SCALE_M && !self.is_unreliable
    }

    /// Whether a map without an error of a metre is called unreliable.
    pub fn is_false_alarm(&self) -> bool {
        !self.is_wrong() && self.is_unreliable
    }
}

/// Runs a case; writes the map if a place for it is given.
pub fn run(case: &Case, map: Option<&Path>) -> Result<Outcome, String> {
    let mut noise = Noise::new(case.seed);
    let mut building = Building::draw(case.kind, &mut noise);
    let glass_share = if noise.uniform() < 0.2 { 0.1 } else { 0.0 };
    building.walls.iter_mut().for_each(|wall| wall.is_glass = noise.uniform() < glass_share);
    let steps = drive(&building, &case.robot, &mut noise);
    let mut config = slam_config();
    config.lidar.base_from_scan = [0.0; 3];
    let (mut front, mut back) = Slam::new(config).split();
    let mut outcome = Outcome {
        seed: case.seed,
        building: case.kind.name().into(),
        sensor: case.robot.sensor.name.into(),
        odometry: format!("{:?}", case.robot.odometry),
        event: format!("{:?}", case.robot.event),
        wrong_sensor: case.wrong_sensor.name().into(),
        thinned_m: case.robot.thinned_m,
        way_m: steps.windows(2).map(|pair| pair[0].truth.distance_m(pair[1].truth)).sum(),
        scans: steps.len(),
        ..Outcome::default()
    };
    outcome.feed(&mut front, &mut back, &steps, case);
    let scored = outcome.score(&front, &back, &steps);
    outcome.walls_share = share_in_map(back.map(), &steps, case.robot.sensor, scored.world_from_map);
    if let Some(stem) = map {
        picture::write(stem, back.map(), &building, &scored).map_err(|why| why.to_string())?;
    }
    Ok(outcome)
}

/// A pose of the final trajectory, where the robot truly was, and whether the pose's node is placed in the map.
#[derive(Clone, Copy)]
pub struct ScoredPose {
    /// Pose in the map.
    pub map_from_base: Pose2,
    /// The true pose.
    pub truth: Pose2,
    /// Whether SLAM calls it part of its map.
    pub is_placed: bool,
    /// Standard deviation of the position of the pose's node in the map, metres.
    pub sigma_m: f64,
}

/// A final trajectory against the truth.
pub struct Scored {
    /// The truth's frame from the map's, where the placed poses fit best.
    pub world_from_map: Pose2,
    /// All poses in order.
    pub poses: Vec<ScoredPose>,
    /// Both ends of the active closures in the map, and whether each is wrong.
    pub closures: Vec<([Pose2; 2], bool)>,
}

impl Outcome {
    fn feed(&mut self, front: &mut FrontEnd, back: &mut BackEnd, steps: &[Step], case: &Case) {
        let mut scan: Box<Scan> = bytemuck::allocation::zeroed_box();
        let mut nees = Vec::new();
        for (index, step) in steps.iter().enumerate() {
            let header =
                Header { stamp: Stamp::from_seconds(step.stamp_s), seq: index as u64, ..Header::default() };
            if let Some(odom_from_base) = step.odometry.map(|pose| case.wrong_sensor.change_odometry(pose)) {
                front.add_odometry(&Odometry { header, odom_from_base, ..Odometry::default() });
                if front.take_unknown_motion() {
                    back.start_relocalization(None);
                }
            }
            fill_scan(&mut scan, header, step, case);
            let result = front.process(&scan);
            if let Some(node) = result.node {
                front.add_frame_update(back.add_node(node));
            }
            let pose_estimate = result.pose_estimate;
            self.lost_at_end = pose_estimate.state() == TrackingState::Lost;
            if !self.lost_at_end && index % NEES_EVERY == NEES_EVERY - 1 {
                let expected = map_from_world(back, steps).map(|map_from_world| map_from_world * step.truth);
                nees.extend(expected.and_then(|expected| {
                    nees_of(pose_estimate.map_from_base, expected, pose_estimate.covariance)
                }));
            }
        }
        back.finish();
        (self.evidence, self.is_unreliable) =
            (back.reliability_evidence(), back.reliability_evidence().is_unreliable());
        self.says_wrong_sensor = self.evidence.odometry_agreement.reasons().next().is_some();
        self.nees = median(nees);
    }

    fn score(&mut self, front: &FrontEnd, back: &BackEnd, steps: &[Step]) -> Scored {
        let truth_at = |stamp: Stamp| truth_at(steps, stamp);
        let sigma_m = |number: u32| {
            let id = back.node_from_front_end(number).unwrap_or_default();
            back.graph().position_variance_trace_m2(id).sqrt()
        };
        let poses: Vec<ScoredPose> = back
            .trajectory_with_places(front.samples())
            .zip(front.samples())
            .filter_map(|((stamp, map_from_base, place), sample)| {
                let is_placed = place == PlaceInMap::Known;
                Some(ScoredPose {
                    map_from_base,
                    truth: truth_at(stamp)?,
                    is_placed,
                    sigma_m: sigma_m(sample.node),
                })
            })
            .collect();
        // The map is put where the poses that are placed in it fit best.
        let placed_poses: Vec<_> = poses.iter().filter(|pose| pose.is_placed).copied().collect();
        let world_from_map = fit(if placed_poses.is_empty() { &poses } else { &placed_poses });
        let errors = |poses: &[ScoredPose]| -> Vec<f64> {
            poses.iter().map(|pose| (world_from_map * pose.map_from_base).distance_m(pose.truth)).collect()
        };
        let (all, of_placed) = (errors(&poses), errors(&placed_poses));
        self.mean_error_m = all.iter().sum::<f64>() / all.len().max(1) as f64;
        self.max_error_m = all.iter().copied().fold(0.0, f64::max);
        self.max_error_placed_m = of_placed.iter().copied().fold(0.0, f64::max);
        // What the covariances say is seen from one node of the map.
        let map_from_world = map_from_world(back, steps).unwrap_or(world_from_map.inverse());
        let unsaid_m = |pose: &ScoredPose| {
            let error_m = (map_from_world * pose.truth).distance_m(pose.map_from_base);
            if error_m > SAID_SIGMAS * pose.sigma_m { error_m } else { 0.0 }
        };
        self.max_error_unsaid_m = placed_poses.iter().map(unsaid_m).fold(0.0, f64::max);
        self.placed_share = placed_poses.len() as f64 / steps.len().max(1) as f64;
        let closures = self.score_edges(back, &truth_at);
        Scored { world_from_map, poses, closures }
    }

    /// Counts right and wrong edges, and returns the active closures.
    fn score_edges(
        &mut self,
        back: &BackEnd,
        truth_at: &dyn Fn(Stamp) -> Option<Pose2>,
    ) -> Vec<([Pose2; 2], bool)> {
        let (mut active, mut nees) = (Vec::new(), [Vec::new(), Vec::new()]);
        for edge in back.graph().edges() {
            let at = |id: u32| truth_at(back.nodes()[id as usize].header.stamp);
            let Some((a, b)) = at(edge.a).zip(at(edge.b)) else { continue };
            let error = a.between(b).between(edge.a_from_b);
            let wrong = usize::from(error.x_m.hypot(error.y_m) > WRONG_M || error.yaw_rad.abs() > WRONG_RAD);
            let measured = normalized_squared(edge.a_from_b, a.between(b), edge.measured_information());
            match (edge.kind, edge.is_active) {
                (EdgeKind::Closure, true) => {
                    self.closures[wrong] += 1;
                    nees[1].push(measured);
                    let poses = [edge.a, edge.b].map(|id| back.graph().poses()[id as usize]);
                    active.push((poses, wrong == 1));
                }
                (EdgeKind::Closure, false) => self.retracted[wrong] += 1,
                (EdgeKind::ScanMatch, true) => {
                    self.wrong_links += wrong;
                    nees[0].push(measured);
                }
                _ => {}
            }
        }
        self.edge_nees = nees.map(median);
        active
    }
}

/// Writes what the LiDAR of a case sends at a step.
fn fill_scan(scan: &mut Scan, header: Header, step: &Step, case: &Case) {
    let sensor = case.robot.sensor;
    let [first, increment] = angles_rad(sensor);
    scan.header = header;
    (scan.angle_min_rad, scan.angle_increment_rad) = (first as f32, increment as f32);
    (scan.range_min_m, scan.range_max_m) = (RANGE_MIN_M, sensor.range_m as f32);
    scan.len = step.ranges_m.len() as u32;
    scan.ranges_m[..step.ranges_m.len()].copy_from_slice(&step.ranges_m);
    case.wrong_sensor.change_scan(scan);
}

/// Returns the median, if there is a value.
pub fn median(mut values: Vec<f64>) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

/// Returns the rigid transform that puts the poses nearest to the truth; the identity without poses.
fn fit(poses: &[ScoredPose]) -> Pose2 {
    let at = |pose: Pose2| [pose.x_m, pose.y_m];
    let pairs: Vec<_> = poses.iter().map(|pose| [at(pose.map_from_base), at(pose.truth)]).collect();
    best_rigid_transform(&pairs).unwrap_or_default()
}

/// Returns the true pose at a stamp.
fn truth_at(steps: &[Step], stamp: Stamp) -> Option<Pose2> {
    let index = steps.partition_point(|step| step.stamp_s < stamp.0 as f64 * 1e-9 - 1e-3);
    steps.get(index).map(|step| step.truth)
}

/// Returns the pose of the true world in the map, where the node has its true pose that the covariances are seen from.
fn map_from_world(back: &BackEnd, steps: &[Step]) -> Option<Pose2> {
    let seen_from = back.covariance_reference_node() as usize;
    let map_from_node = *back.graph().poses().get(seen_from)?;
    let world_from_node = truth_at(steps, back.nodes().get(seen_from)?.header.stamp)?;
    Some(map_from_node * world_from_node.inverse())
}

/// Returns the normalised squared error over its three degrees of freedom (Bar-Shalom et al. 2001, section 5.4); `None`
/// if the covariance cannot be inverted.
fn nees_of(estimate: Pose2, truth: Pose2, covariance: [f64; 6]) -> Option<f64> {
    let [xx, xy, xt, yy, yt, tt] = covariance;
    let inverse = Matrix3::new(xx, xy, xt, xy, yy, yt, xt, yt, tt).try_inverse()?;
    let normalized = normalized_squared(estimate, truth, inverse);
    normalized.is_finite().then_some(normalized)
}

fn normalized_squared(estimate: Pose2, truth: Pose2, information: Matrix3<f64>) -> f64 {
    let yaw = msg::pose::wrap_angle(estimate.yaw_rad - truth.yaw_rad);
    let error = Vector3::new(estimate.x_m - truth.x_m, estimate.y_m - truth.y_m, yaw);
    (error.transpose() * information * error)[0] / 3.0
}
