//! Decodes CDR into the fleet's messages without allocating: the reverse of [`super::write`].

use crate::cdr::{DecodeError, Dialect, Reader};
use msg::{BEAMS_MAX, Scan, Stamp};

/// Reads builtin_interfaces/Time; `field` names it in the error.
pub fn stamp(from: &mut Reader<'_>, field: &'static str) -> Result<Stamp, DecodeError> {
    let sec = i64::from(from.i32(field)?);
    let nanosec = i64::from(from.u32(field)?);
    Ok(Stamp(sec * 1_000_000_000 + nanosec))
}

/// Reads std_msgs/Header: stamp and frame.
pub fn header<'a>(from: &mut Reader<'a>) -> Result<(Stamp, &'a str), DecodeError> {
    if from.dialect() == Dialect::Ros1 {
        from.u32("header.seq")?;
    }
    Ok((stamp(from, "header.stamp")?, from.string("header.frame_id")?))
}

/// Reads sensor_msgs/LaserScan without its intensities; returns its frame.
///
/// `into.header.stamp` is the message's. Only the number of beams is checked.
pub fn laser_scan<'a>(from: &mut Reader<'a>, into: &mut Scan) -> Result<&'a str, DecodeError> {
    let (stamp, frame_id) = header(from)?;
    into.header.stamp = stamp;
    into.angle_min_rad = from.f32("angle_min")?;
    from.f32("angle_max")?;
    into.angle_increment_rad = from.f32("angle_increment")?;
    into.time_increment_s = from.f32("time_increment")?;
    into.scan_time_s = from.f32("scan_time")?;
    into.range_min_m = from.f32("range_min")?;
    into.range_max_m = from.f32("range_max")?;
    let ranges = from.f32s("ranges")?;
    if ranges.len() > BEAMS_MAX {
        return Err(DecodeError::TooManyBeams { beams: ranges.len(), limit: BEAMS_MAX });
    }
    into.len = ranges.len() as u32;
    into.ranges_m.iter_mut().zip(ranges).for_each(|(place, range)| *place = range);
    Ok(frame_id)
}

/// geometry_msgs/TransformStamped with borrowed names: the transform `frame_id` from `child_frame_id`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Transform<'a> {
    /// Time of the transform.
    pub stamp: Stamp,
    /// The parent frame.
    pub frame_id: &'a str,
    /// The child frame.
    pub child_frame_id: &'a str,
    /// Position of the child in the parent, metres.
    pub translation: [f64; 3],
    /// Quaternion x, y, z, w, of any length.
    pub rotation: [f64; 4],
}

/// Length of the shortest TransformStamped, bytes: stamp 8, two empty strings of 4, seven doubles.
pub const TRANSFORM_BYTES_MIN: usize = 72;

/// Reads tf2_msgs/TFMessage, one transform after the other. An error may follow some of them.
pub fn transforms<'a>(from: &mut Reader<'a>, mut each: impl FnMut(Transform<'a>)) -> Result<(), DecodeError> {
    for _ in 0..from.count("transforms", TRANSFORM_BYTES_MIN)? {
        let (stamp, frame_id) = header(from)?;
        each(Transform {
            stamp,
            frame_id,
            child_frame_id: from.string("child_frame_id")?,
            translation: from.f64s("transform.translation")?,
            rotation: from.f64s("transform.rotation")?,
        });
    }
    Ok(())
}

/// Reads nav_msgs/Odometry's pose as the transform `frame_id` from `child_frame_id`, without covariances and velocities.
pub fn odometry<'a>(from: &mut Reader<'a>) -> Result<Transform<'a>, DecodeError> {
    let (stamp, frame_id) = header(from)?;
    Ok(Transform {
        stamp,
        frame_id,
        child_frame_id: from.string("child_frame_id")?,
        translation: from.f64s("pose.position")?,
        rotation: from.f64s("pose.orientation")?,
    })
}
