//! From CDR straight into the fleet's nouns, as [`super::write`] is the other way: nothing is allocated.

use crate::cdr::{DecodeError, Dialect, Reader};
use msg::{BEAMS_MAX, Scan, Stamp};

/// builtin_interfaces/Time.
pub fn stamp(from: &mut Reader<'_>, field: &'static str) -> Result<Stamp, DecodeError> {
    let sec = i64::from(from.i32(field)?);
    let nanosec = i64::from(from.u32(field)?);
    Ok(Stamp(sec * 1_000_000_000 + nanosec))
}

/// std_msgs/Header: stamp and frame.
pub fn header<'a>(from: &mut Reader<'a>) -> Result<(Stamp, &'a str), DecodeError> {
    if from.dialect() == Dialect::Ros1 {
        from.u32("header.seq")?;
    }
    Ok((stamp(from, "header.stamp")?, from.string("header.frame_id")?))
}

/// sensor_msgs/LaserScan, all of it but the intensities; its frame. `into.header.stamp` is as the message says.
/// Whether the numbers make a scan is not looked at, but for the count of its beams.
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
        let what = format!("a scan has {} beams; at most {BEAMS_MAX} can be used", ranges.len());
        return Err(DecodeError::Inconsistent { what });
    }
    into.len = ranges.len() as u32;
    into.ranges_m.iter_mut().zip(ranges).for_each(|(place, range)| *place = range);
    Ok(frame_id)
}

/// geometry_msgs/TransformStamped, borrowed: `frame_id` from `child_frame_id`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Transform<'a> {
    /// When it holds.
    pub stamp: Stamp,
    /// The parent.
    pub frame_id: &'a str,
    /// The child.
    pub child_frame_id: &'a str,
    /// Metres.
    pub translation: [f64; 3],
    /// Quaternion x, y, z, w; perhaps not of unit length.
    pub rotation: [f64; 4],
}

/// tf2_msgs/TFMessage, one edge after the other. An error may come after some of them.
pub fn transforms<'a>(from: &mut Reader<'a>, mut each: impl FnMut(Transform<'a>)) -> Result<(), DecodeError> {
    // The shortest transform: stamp 8, two empty strings of 4, seven doubles.
    for _ in 0..from.count("transforms", 72)? {
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

/// nav_msgs/Odometry's pose as the transform it is: `frame_id` from `child_frame_id`. Covariances and velocities are
/// not looked at.
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
