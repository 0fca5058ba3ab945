//! Motion model: predicts the pose of the next scan from odometry, or from the last motion.

use super::scan_check::lidar_works;
use super::scan_matcher::TrackedPose;
use super::{FrontEnd, LastScan};
use crate::beam_poses::{BeamPoses, scale_motion};
use crate::config::OdometryConfig;
use crate::limits::{INTERVAL_S_MAX, SIGMA_MAX, UNMEASURED_S_MAX};
use crate::node::Node;
use crate::odometry::{MeasuredMotion, OdometryBuffer};
use msg::{Pose2, Scan, Stamp, TrackingState, pose::wrap_angle};
use nalgebra::{Matrix3, Vector3};

/// Longest time over which the last motion predicts a scan's pose, seconds.
pub(super) const CONSTANT_MOTION_MAX_S: f64 = 0.5;
/// The same limit as a multiple of the interval over which that motion was measured.
const CONSTANT_MOTION_TIMES_MAX: f64 = 3.0;
/// Odometry that claims more than this many times what the robot can have driven was reset.
pub(super) const ODOMETRY_JUMP_FACTOR: f64 = 3.0;
/// Added to what the robot can have driven: odometry's own jitter, metres.
const ODOMETRY_JUMP_MARGIN_M: f64 = 1.0;
/// A step of odometry between two scans may be no motion if it exceeds the step before it this many times, and this, metres and radians.
/// It is none if it also exceeds what the robot can drive in that time [`ODOMETRY_JUMP_FACTOR`] times, and that.
const STEP_FACTOR: f64 = 2.0;
const STEP_MIN_M: f64 = 0.15;
const STEP_MIN_RAD: f64 = 0.2;
/// Without odometry the speed is uncertain by this share of the robot's largest one (one standard deviation).
pub(crate) const SPEED_SIGMA_SHARE: f64 = 0.3;

/// Without odometry, a scan that leaves a direction open by a larger standard deviation measures nothing along it, metres.
const UNMEASURED_SIGMA_M: f64 = 0.012;

/// The motion continued for `ahead_s` at constant speed, after it took `before_s`; bounded.
pub(super) fn continue_motion(motion: Pose2, before_s: f64, ahead_s: f64) -> Pose2 {
    scale_motion(motion, (ahead_s / before_s).min(CONSTANT_MOTION_TIMES_MAX))
}

/// The pose expected of a scan before it is matched, in the front end's frame.
pub(super) struct PosePrediction {
    pub pose: Pose2,
    /// One standard deviation of the position, metres.
    pub sigma_m: f64,
    /// One standard deviation of the heading, radians.
    pub sigma_rad: f64,
    /// Covariance of the pose that the prediction starts from.
    start_covariance: Matrix3<f64>,
    /// Distance from there, metres.
    distance_m: f64,
    /// Whether it may be given out without a match: odometry measured the motion since the newest reference, and the LiDAR works.
    pub allows_dead_reckoning: bool,
    /// What odometry's step since the last scan may be.
    pub step: OdometryStep,
}

impl PosePrediction {
    /// The pose after a motion that odometry measured, from a start pose with its covariance.
    fn by_odometry(
        (start, start_covariance): (Pose2, Matrix3<f64>),
        MeasuredMotion { moved, unmeasured_s }: MeasuredMotion,
        config: &OdometryConfig,
    ) -> Self {
        let (distance_m, turn_rad) = (moved.x_m.hypot(moved.y_m), moved.yaw_rad.abs());
        Self {
            pose: start * moved,
            sigma_m: (config.sigma_m
                + config.sigma_m_per_m * distance_m
                + SPEED_SIGMA_SHARE * config.speed_max_m_s * unmeasured_s)
                .min(SIGMA_MAX),
            sigma_rad: (config.sigma_rad
                + config.sigma_rad_per_rad * turn_rad
                + config.sigma_rad_per_m * distance_m
                + SPEED_SIGMA_SHARE * config.turn_max_rad_s * unmeasured_s)
                .min(SIGMA_MAX),
            start_covariance,
            distance_m,
            allows_dead_reckoning: false,
            step: OdometryStep::Motion,
        }
    }

    /// Variances of x, y and yaw.
    pub fn variances(&self) -> Vector3<f64> {
        Vector3::new(self.sigma_m.powi(2), self.sigma_m.powi(2), self.sigma_rad.powi(2))
    }

    /// The same prediction with the error of the reference as one of its own: a reference that saw nothing has its pose by
    /// odometry, too.
    pub fn with_error_of_reference(self) -> Self {
        let covariance = self.covariance();
        let sigma = |i: usize| covariance[(i, i)].sqrt();
        Self {
            sigma_m: sigma(0).max(sigma(1)),
            sigma_rad: sigma(2),
            start_covariance: Matrix3::zeros(),
            distance_m: 0.0,
            ..self
        }
    }

    /// Covariance of the predicted pose: an error in heading moves the end of the path sideways.
    pub fn covariance(&self) -> Matrix3<f64> {
        let sideways = (self.start_covariance[(2, 2)] * self.distance_m.powi(2)).min(SIGMA_MAX.powi(2));
        self.start_covariance
            + Matrix3::from_diagonal(&(self.variances() + Vector3::new(sideways, sideways, 0.0)))
    }
}

impl FrontEnd {
    /// The pose expected of a scan: from odometry, or from the last motion.
    pub(super) fn predict(&mut self, scan: &Scan, continuous_from_base: Option<Pose2>) -> PosePrediction {
        let newest = self.matcher.references.back();
        let stamp = scan.header.stamp;
        let mut prediction = self.motion.predict(stamp, continuous_from_base, newest, &self.config.odometry);
        if self.matcher.newest_saw_nothing(&self.config.tracking) {
            prediction = prediction.with_error_of_reference();
        }
        prediction.allows_dead_reckoning &= lidar_works(scan);
        prediction
    }

    /// Odometry that slipped, or that is back after it was missing, counts from the matched pose.
    pub(super) fn rebase_odometry(&mut self, pose: &TrackedPose, continuous_from_base: Option<Pose2>) {
        let Some((newest, odom)) = self.matcher.references.back().zip(continuous_from_base) else { return };
        let is_back = self.motion.continuous_from_reference.is_none() && pose.is_tracked;
        if pose.slipped
            && let Some(moved) = self.motion.moved_since_reference(continuous_from_base)
        {
            let off = pose.local_from_base.between(newest.local_from_base * moved);
            let slip = &mut self.node_builder.slip;
            *slip = [slip[0] + off.x_m, slip[1] + off.y_m, wrap_angle(slip[2] + off.yaw_rad)];
        }
        if pose.slipped || is_back {
            self.motion.rebase_odometry(newest, pose.local_from_base, odom);
            self.counts.slips += u64::from(pose.slipped);
        }
    }

    /// Adds up the time in which the robot's motion is a guess: without odometry, while the scans leave a direction open. Odometry that
    /// was missing for a while measures the whole motion since the newest reference, if it was there for that one.
    pub(super) fn count_unmeasured_time(
        &mut self,
        stamp: Stamp,
        pose: &TrackedPose,
        continuous_from_base: Option<Pose2>,
    ) {
        if continuous_from_base.is_some() && self.motion.continuous_from_reference.is_some() {
            self.node_builder.unmeasured_s = 0.0;
            return;
        }
        let leaves_open =
            pose.state == TrackingState::Lost || pose.worst_position_sigma_m > UNMEASURED_SIGMA_M;
        if let (true, Some(last)) = (leaves_open, self.motion.last.as_ref()) {
            let unmeasured_s = self.node_builder.unmeasured_s + (stamp - last.stamp) as f32;
            self.node_builder.unmeasured_s = unmeasured_s.min(UNMEASURED_S_MAX);
        }
    }
}

/// What a step of odometry between two scans may be. A driver that is started again below its publisher, or whose pose is set, jumps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum OdometryStep {
    /// Too short to matter: the search window has both.
    Motion,
    /// A motion, or a jump.
    Unclear,
    /// No motion that the robot can make in this time.
    Jump,
}

impl OdometryStep {
    /// `moved`: odometry's motion in this time; `before`: the robot's motion between the two scans before.
    fn new(moved: Pose2, seconds: f64, before: Pose2, config: &OdometryConfig) -> Self {
        let length = |pose: Pose2| [pose.x_m.hypot(pose.y_m), pose.yaw_rad.abs()];
        let exceeds = |limit: [f64; 2]| {
            let [m, rad] = length(moved);
            m > limit[0] + STEP_MIN_M || rad > limit[1] + STEP_MIN_RAD
        };
        let possible = [config.speed_max_m_s, config.turn_max_rad_s];
        match exceeds(length(before).map(|length| STEP_FACTOR * length)) {
            false => Self::Motion,
            true if exceeds(possible.map(|speed| ODOMETRY_JUMP_FACTOR * speed * seconds)) => Self::Jump,
            true => Self::Unclear,
        }
    }
}

/// Odometry, the last scan, and the reference that poses are predicted from.
pub(super) struct MotionModel {
    pub odometry: OdometryBuffer,
    /// The last accepted scan.
    pub last: Option<LastScan>,
    /// Pose of the newest reference scan in the continuous frame, if odometry has not jumped since.
    pub continuous_from_reference: Option<Pose2>,
    /// Covariance of that scan's pose.
    pub reference_covariance: Matrix3<f64>,
}

impl MotionModel {
    pub fn new(config: &OdometryConfig) -> Self {
        Self {
            odometry: OdometryBuffer::new(config.clone()),
            last: None,
            continuous_from_reference: None,
            reference_covariance: Matrix3::zeros(),
        }
    }

    /// Forgets where the robot was: nothing is known of its motion since the last scan.
    pub fn forget(&mut self) {
        self.continuous_from_reference = None;
        self.last = self.last.map(|last| LastScan { continuous_from_base: None, motion: None, ..last });
    }

    /// The pose expected at a stamp. `newest` is the newest reference scan.
    pub fn predict(
        &mut self,
        stamp: Stamp,
        continuous_from_base: Option<Pose2>,
        newest: Option<&Node>,
        config: &OdometryConfig,
    ) -> PosePrediction {
        let Some(last) = &self.last else {
            return PosePrediction {
                pose: Pose2::IDENTITY,
                sigma_m: 0.0,
                sigma_rad: 0.0,
                start_covariance: Matrix3::zeros(),
                distance_m: 0.0,
                allows_dead_reckoning: false,
                step: OdometryStep::Motion,
            };
        };
        let interval_s = stamp - last.stamp;
        let mut step = OdometryStep::Motion;
        if let (Some(before), Some(now)) = (last.continuous_from_base, continuous_from_base) {
            let possible_m = config.speed_max_m_s * interval_s + ODOMETRY_JUMP_MARGIN_M;
            if before.distance_m(now) > ODOMETRY_JUMP_FACTOR * possible_m {
                self.continuous_from_reference = None;
            }
            let motion_before = last.motion.map_or(Pose2::IDENTITY, |(motion, _)| motion);
            step = OdometryStep::new(before.between(now), interval_s, motion_before, config);
        }
        // From the newest reference, not from the last scan: many small steps would add up to more
        // uncertainty than one long one.
        let reference = newest.zip(self.continuous_from_reference).zip(continuous_from_base);
        if let Some(((node, before), now)) = reference {
            let measured = MeasuredMotion { moved: before.between(now), unmeasured_s: 0.0 };
            let start = (node.local_from_base, self.reference_covariance);
            let prediction = PosePrediction::by_odometry(start, measured, config);
            return PosePrediction { allows_dead_reckoning: step != OdometryStep::Jump, step, ..prediction };
        }
        if let Some(measured) = self.measured_motion(last, stamp, config) {
            return PosePrediction::by_odometry((last.local_from_base, last.covariance), measured, config);
        }
        Self::predict_by_last_motion(last, interval_s, config)
    }

    /// The pose expected at a stamp if what odometry says since the last scan is no motion.
    pub fn predict_without_odometry(&self, stamp: Stamp, config: &OdometryConfig) -> Option<PosePrediction> {
        let last = self.last.as_ref()?;
        Some(Self::predict_by_last_motion(last, stamp - last.stamp, config))
    }

    fn predict_by_last_motion(last: &LastScan, interval_s: f64, config: &OdometryConfig) -> PosePrediction {
        let motion = last.motion.filter(|_| interval_s < CONSTANT_MOTION_MAX_S);
        let step = motion
            .map_or(Pose2::IDENTITY, |(motion, before_s)| continue_motion(motion, before_s, interval_s));
        PosePrediction {
            pose: last.local_from_base * step,
            sigma_m: (SPEED_SIGMA_SHARE * config.speed_max_m_s * interval_s + config.sigma_m).min(SIGMA_MAX),
            sigma_rad: (SPEED_SIGMA_SHARE * config.turn_max_rad_s * interval_s + config.sigma_rad)
                .min(SIGMA_MAX),
            start_covariance: last.covariance,
            distance_m: step.x_m.hypot(step.y_m),
            allows_dead_reckoning: false,
            step: OdometryStep::Motion,
        }
    }

    /// The motion since the last scan as far as odometry measured it, where it was missing at one of their stamps; `None` if it claims
    /// more than the robot can have driven.
    fn measured_motion(
        &self,
        last: &LastScan,
        stamp: Stamp,
        config: &OdometryConfig,
    ) -> Option<MeasuredMotion> {
        let measured = self.odometry.motion_between(last.stamp, stamp)?;
        let possible_m = config.speed_max_m_s * (stamp - last.stamp) + ODOMETRY_JUMP_MARGIN_M;
        let distance_m = measured.moved.x_m.hypot(measured.moved.y_m);
        Some(measured).filter(|_| distance_m <= ODOMETRY_JUMP_FACTOR * possible_m)
    }

    /// Sensor poses of a scan whose beams took `seconds`, from odometry; `None` if it does not cover the sweep, or jumps.
    pub fn beam_poses(
        &self,
        base_from_scan: Pose2,
        scan: &Scan,
        seconds: f64,
        continuous_from_base: Option<Pose2>,
        config: &OdometryConfig,
    ) -> Option<BeamPoses> {
        let before = continuous_from_base?;
        let moved = |after_s| {
            let then = scan.header.stamp + core::time::Duration::from_secs_f64(after_s);
            Some(before.between(self.odometry.at(then)?))
        };
        // Odometry that jumps during the sweep tells nothing of it.
        let is_jump =
            |moved| OdometryStep::new(moved, seconds, Pose2::IDENTITY, config) == OdometryStep::Jump;
        BeamPoses::new(base_from_scan, scan, seconds, |after_s| {
            moved(after_s).filter(|moved| !is_jump(*moved))
        })
    }

    /// After wheels have slipped, odometry counts from the matched pose, so that the slip no longer pulls.
    pub fn rebase_odometry(&mut self, newest: &Node, local_from_base: Pose2, continuous_from_base: Pose2) {
        let moved = newest.local_from_base.between(local_from_base);
        self.continuous_from_reference = Some(continuous_from_base * moved.inverse());
    }

    /// Odometry from the newest reference scan to now.
    pub fn moved_since_reference(&self, continuous_from_base: Option<Pose2>) -> Option<Pose2> {
        self.continuous_from_reference.zip(continuous_from_base).map(|(before, now)| before.between(now))
    }

    /// Records an accepted scan.
    pub fn record(
        &mut self,
        stamp: Stamp,
        local_from_base: Pose2,
        covariance: Matrix3<f64>,
        continuous_from_base: Option<Pose2>,
    ) {
        let since = |l: LastScan| (l.local_from_base.between(local_from_base), stamp - l.stamp);
        let motion = self.last.map(since).filter(|(_, seconds)| *seconds > 0.0 && *seconds < INTERVAL_S_MAX);
        self.last = Some(LastScan { stamp, local_from_base, continuous_from_base, motion, covariance });
    }

    /// The clock was set back to `begins`. Odometry's poses stay valid as measured since the newest reference.
    pub fn reset_clock(&mut self, begins: Stamp) {
        self.last = self.last.map(|last| LastScan {
            stamp: begins,
            continuous_from_base: None,
            motion: None,
            ..last
        });
    }
}
