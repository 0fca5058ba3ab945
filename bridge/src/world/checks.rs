//! Checks of the numbers in sensor data from outside: what is accepted is finite and within physical bounds.

use msg::pose::{COORDINATE_MAX_M, yaw_of_quaternion};
use msg::{BEAMS_MAX, BEAMS_MIN, Header, Pose2, RobotFrame, RobotFrameTransform, Scan};
use ros_messages::read::Transform;
use std::f64::consts::TAU;
use thiserror::Error;

/// A quaternion's length may differ from 1 by this much; it is normalised.
const UNIT_TOLERANCE: f64 = 1e-2;
/// The largest tilt of a robot on a floor, radians: a larger one means another convention of axes.
const TILT_MAX_RAD: f64 = 0.35;
/// The longest time of one scan, seconds.
const SCAN_TIME_MAX_S: f32 = 10.0;

/// Why a scan is not accepted.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum ScanError {
    /// Too few beams.
    #[error("a scan has {beams} beams; at least {BEAMS_MIN} are needed")]
    TooFewBeams {
        /// The number of beams.
        beams: usize,
    },
    /// The angles are not finite, or span more than a turn.
    #[error("{beams} beams from {angle_min_rad} rad in steps of {step_rad} rad; expected one turn at most")]
    Angles {
        /// The number of beams.
        beams: usize,
        /// Angle of the first beam, radians.
        angle_min_rad: f32,
        /// Angle between beams, radians.
        step_rad: f32,
    },
    /// The limits of the range are not in order.
    #[error("ranges from {range_min_m} to {range_max_m} m; expected 0 <= range_min < range_max")]
    RangeLimits {
        /// Smallest valid range, metres.
        range_min_m: f32,
        /// Largest valid range, metres.
        range_max_m: f32,
    },
    /// The times are negative, too long or not finite.
    #[error(
        "time_increment {time_increment_s} s, scan_time {scan_time_s} s; expected a scan of 0 to {SCAN_TIME_MAX_S} s"
    )]
    Times {
        /// Time between beams, seconds.
        time_increment_s: f32,
        /// Time between scans, seconds.
        scan_time_s: f32,
    },
    /// The stamp is not newer than the last scan's.
    #[error("the scan's stamp, {stamp_s:.3} s, is not newer than the last one's")]
    NotNewer {
        /// The scan's stamp by the source's clock, seconds.
        stamp_s: f64,
    },
}

/// Why a transform or pose is not accepted.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum TransformError {
    /// A coordinate is not finite, or too large.
    #[error("a translation of {value_m} m; expected at most {COORDINATE_MAX_M} m")]
    Translation {
        /// The coordinate, metres.
        value_m: f64,
    },
    /// The rotation is not a unit quaternion.
    #[error("its rotation {rotation_xyzw:?} is not a unit quaternion (x, y, z, w)")]
    Rotation {
        /// Rotation in the message: x, y, z, w.
        rotation_xyzw: [f64; 4],
    },
    /// The robot would lean, as it does in another convention of axes such as Unity's own.
    #[error("it leans by {tilt_deg:.0} degrees; expected ROS's axes: x forward, y left, z up")]
    Tilt {
        /// The tilt, degrees.
        tilt_deg: f64,
    },
    /// The parent is not a frame of the same robot.
    #[error("its parent should be a frame of {robot}, such as its odom")]
    Parent {
        /// The robot of the child frame.
        robot: msg::RobotId,
    },
    /// The fleet has no such robot.
    #[error("the fleet has robots 1 to {robot_count}")]
    NoSuchRobot {
        /// The fleet's number of robots.
        robot_count: usize,
    },
}

/// Returns a scan without beams.
pub fn empty_scan() -> Box<Scan> {
    Box::new(Scan {
        header: Header::default(),
        angle_min_rad: 0.0,
        angle_increment_rad: 0.0,
        time_increment_s: 0.0,
        scan_time_s: 0.0,
        range_min_m: 0.0,
        range_max_m: 0.0,
        len: 0,
        mount_known: 0,
        base_from_scan: Pose2::IDENTITY,
        ranges_m: [0.0; BEAMS_MAX],
    })
}

/// Checks a scan's numbers. Ranges above the maximum become infinite; -inf is a surface that is too near (REP-117). Other ranges below the
/// minimum become NaN: drivers use 0 for beams without a measurement.
pub fn check_scan(scan: &mut Scan) -> Result<(), ScanError> {
    let Scan { angle_min_rad, angle_increment_rad, range_min_m, range_max_m, .. } = *scan;
    let beams = scan.len as usize;
    if beams < BEAMS_MIN {
        return Err(ScanError::TooFewBeams { beams });
    }
    let step = f64::from(angle_increment_rad);
    let span = step.abs() * (beams - 1) as f64;
    if !angle_min_rad.is_finite() || !step.is_finite() || step == 0.0 || span > TAU + step.abs() {
        return Err(ScanError::Angles { beams, angle_min_rad, step_rad: angle_increment_rad });
    }
    let in_order = range_min_m >= 0.0 && range_min_m < range_max_m && range_max_m.is_finite();
    if !in_order {
        return Err(ScanError::RangeLimits { range_min_m, range_max_m });
    }
    let is_time = |seconds: f32| seconds.is_finite() && (0.0..=SCAN_TIME_MAX_S).contains(&seconds);
    if !is_time(scan.time_increment_s * beams as f32) || !is_time(scan.scan_time_s) {
        let (time_increment_s, scan_time_s) = (scan.time_increment_s, scan.scan_time_s);
        return Err(ScanError::Times { time_increment_s, scan_time_s });
    }
    for range in &mut scan.ranges_m[..beams] {
        if *range > range_max_m {
            *range = f32::INFINITY;
        } else if *range < range_min_m && *range != f32::NEG_INFINITY {
            *range = f32::NAN;
        }
    }
    Ok(())
}

/// Checks a transform's numbers and normalises its quaternion.
pub fn check_transform(
    parent: RobotFrame,
    child: RobotFrame,
    transform: &Transform<'_>,
) -> Result<RobotFrameTransform, TransformError> {
    let is_near = |value: &&f64| value.abs() <= COORDINATE_MAX_M;
    if let Some(value) = transform.translation.iter().find(|value| !is_near(value)) {
        return Err(TransformError::Translation { value_m: *value });
    }
    let length = transform.rotation.iter().map(|value| value * value).sum::<f64>().sqrt();
    let is_unit = (length - 1.0).abs() <= UNIT_TOLERANCE;
    if !is_unit {
        return Err(TransformError::Rotation { rotation_xyzw: transform.rotation });
    }
    Ok(RobotFrameTransform {
        parent_frame: parent as u32,
        child_frame: child as u32,
        translation_m: transform.translation,
        rotation_xyzw: transform.rotation.map(|value| value / length),
    })
}

/// Returns the pose on the floor that a transform gives.
pub(crate) fn floor_pose(transform: &Transform<'_>) -> Result<Pose2, TransformError> {
    planar_pose(&check_transform(RobotFrame::Odom, RobotFrame::BaseFootprint, transform)?)
}

/// Returns the pose on the floor. Fails if the robot leans.
pub fn planar_pose(transform: &RobotFrameTransform) -> Result<Pose2, TransformError> {
    let [x, y, ..] = transform.rotation_xyzw;
    let up = 1.0 - 2.0 * (x * x + y * y);
    if up < TILT_MAX_RAD.cos() {
        return Err(TransformError::Tilt { tilt_deg: up.clamp(-1.0, 1.0).acos().to_degrees() });
    }
    Ok(Pose2::new(
        transform.translation_m[0],
        transform.translation_m[1],
        yaw_of_quaternion(transform.rotation_xyzw),
    ))
}
