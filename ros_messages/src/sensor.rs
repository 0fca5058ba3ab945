//! Owned ROS messages of sensors, poses and maps; units are SI.

use super::message::{Message, Twist, read_header};
use crate::cdr::{DecodeError, Reader, Writer};
use crate::{read, write};
use msg::Stamp;

/// Reads a geometry_msgs/Pose: position and orientation.
pub(crate) fn read_pose(from: &mut Reader<'_>) -> Result<([f64; 3], [f64; 4]), DecodeError> {
    Ok((from.f64s("position")?, from.f64s("orientation")?))
}

/// sensor_msgs/LaserScan: one turn of a LiDAR.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LaserScan {
    /// Time of the first beam.
    pub stamp: Stamp,
    /// Frame of the LiDAR.
    pub frame_id: String,
    /// Angle of the first beam, radians.
    pub angle_min: f32,
    /// Angle of the last beam, radians.
    pub angle_max: f32,
    /// Angle between beams, radians.
    pub angle_increment: f32,
    /// Time between beams, seconds.
    pub time_increment: f32,
    /// Time between scans, seconds.
    pub scan_time: f32,
    /// Smallest valid range, metres.
    pub range_min: f32,
    /// Largest valid range, metres.
    pub range_max: f32,
    /// Ranges in order of the beams, metres.
    pub ranges: Vec<f32>,
    /// Intensities in the device's own units; may be empty.
    pub intensities: Vec<f32>,
}

impl Message for LaserScan {
    const TYPE: &'static str = "sensor_msgs/LaserScan";
    fn read(from: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let (stamp, frame_id) = read_header(from)?;
        Ok(Self {
            stamp,
            frame_id,
            angle_min: from.f32("angle_min")?,
            angle_max: from.f32("angle_max")?,
            angle_increment: from.f32("angle_increment")?,
            time_increment: from.f32("time_increment")?,
            scan_time: from.f32("scan_time")?,
            range_min: from.f32("range_min")?,
            range_max: from.f32("range_max")?,
            ranges: from.f32_seq("ranges")?,
            intensities: from.f32_seq("intensities")?,
        })
    }
    fn write(&self, to: &mut Writer<'_>) {
        write::header(to, self.stamp, &self.frame_id);
        let angles = [self.angle_min, self.angle_max, self.angle_increment];
        let times = [self.time_increment, self.scan_time];
        let limits = [self.range_min, self.range_max];
        angles.iter().chain(&times).chain(&limits).for_each(|value| to.f32(*value));
        to.f32_seq(&self.ranges);
        to.f32_seq(&self.intensities);
    }
}

/// geometry_msgs/PoseWithCovarianceStamped: a pose with its uncertainty.
#[derive(Clone, Debug, PartialEq)]
pub struct PoseWithCovarianceStamped {
    /// Time of the pose.
    pub stamp: Stamp,
    /// Frame of the pose.
    pub frame_id: String,
    /// Position in `frame_id`: x, y, z in metres.
    pub position: [f64; 3],
    /// Orientation: unit quaternion x, y, z, w.
    pub orientation: [f64; 4],
    /// Covariance, row-major over x, y, z (metres) and the rotations about them (radians).
    pub covariance: [f64; 36],
}

impl Message for PoseWithCovarianceStamped {
    const TYPE: &'static str = "geometry_msgs/PoseWithCovarianceStamped";
    fn read(from: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let (stamp, frame_id) = read_header(from)?;
        let (position, orientation) = read_pose(from)?;
        Ok(Self { stamp, frame_id, position, orientation, covariance: from.f64s("covariance")? })
    }
    fn write(&self, to: &mut Writer<'_>) {
        write::header(to, self.stamp, &self.frame_id);
        write::pose(to, self.position, self.orientation);
        to.f64s(&self.covariance);
    }
}

/// nav_msgs/Odometry: pose and velocity by the wheels, with covariances.
#[derive(Clone, Debug, PartialEq)]
pub struct Odometry {
    /// Time of the pose.
    pub stamp: Stamp,
    /// Frame of the pose.
    pub frame_id: String,
    /// Frame of the velocity.
    pub child_frame_id: String,
    /// Position in `frame_id`: x, y, z in metres.
    pub position: [f64; 3],
    /// Orientation: unit quaternion x, y, z, w.
    pub orientation: [f64; 4],
    /// Row-major covariance of the pose over x, y, z and the rotations about them; m, rad.
    pub pose_covariance: [f64; 36],
    /// Velocity, m/s and rad/s.
    pub twist: Twist,
    /// Row-major covariance of the velocity, in the same order.
    pub twist_covariance: [f64; 36],
}

impl Default for Odometry {
    fn default() -> Self {
        Self {
            stamp: Stamp(0),
            frame_id: String::new(),
            child_frame_id: String::new(),
            position: [0.0; 3],
            orientation: [0.0; 4],
            pose_covariance: [0.0; 36],
            twist: Twist::default(),
            twist_covariance: [0.0; 36],
        }
    }
}

impl Message for Odometry {
    const TYPE: &'static str = "nav_msgs/Odometry";
    fn read(from: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let (stamp, frame_id) = read_header(from)?;
        let child_frame_id = from.string("child_frame_id")?.to_owned();
        let (position, orientation) = read_pose(from)?;
        let pose_covariance = from.f64s("pose.covariance")?;
        let twist = Twist::read(from)?;
        let twist_covariance = from.f64s("twist.covariance")?;
        Ok(Self {
            stamp,
            frame_id,
            child_frame_id,
            position,
            orientation,
            pose_covariance,
            twist,
            twist_covariance,
        })
    }
    fn write(&self, to: &mut Writer<'_>) {
        write::header(to, self.stamp, &self.frame_id);
        to.string(&self.child_frame_id);
        write::pose(to, self.position, self.orientation);
        to.f64s(&self.pose_covariance);
        self.twist.write(to);
        to.f64s(&self.twist_covariance);
    }
}

/// nav_msgs/OccupancyGrid: a map.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct OccupancyGrid {
    /// Time of the newest content.
    pub stamp: Stamp,
    /// Frame of the map.
    pub frame_id: String,
    /// Side length of a cell, metres.
    pub resolution: f32,
    /// Number of cells along x.
    pub width: u32,
    /// Number of cells along y.
    pub height: u32,
    /// Position of the lower left corner of cell (0, 0), metres.
    pub position: [f64; 3],
    /// Orientation: unit quaternion x, y, z, w.
    pub orientation: [f64; 4],
    /// 0 free, 100 occupied, -1 unknown, or percent if graded; row-major from the lowest row.
    pub data: Vec<i8>,
}

impl Message for OccupancyGrid {
    const TYPE: &'static str = "nav_msgs/OccupancyGrid";
    fn read(from: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let (stamp, frame_id) = read_header(from)?;
        read::stamp(from, "info.map_load_time")?;
        let resolution = from.f32("info.resolution")?;
        let (width, height) = (from.u32("info.width")?, from.u32("info.height")?);
        let (position, orientation) = read_pose(from)?;
        let data = from.byte_seq("data")?;
        if u64::from(width) * u64::from(height) != data.len() as u64 {
            return Err(DecodeError::GridSize { width, height, cells: data.len() });
        }
        let data = data.iter().map(|byte| *byte as i8).collect();
        Ok(Self { stamp, frame_id, resolution, width, height, position, orientation, data })
    }
    fn write(&self, to: &mut Writer<'_>) {
        write::header(to, self.stamp, &self.frame_id);
        let size = (self.width, self.height);
        write::map_info(to, self.stamp, self.resolution, size, self.position, self.orientation);
        to.byte_seq_with(self.data.len(), |bytes| {
            bytes.iter_mut().zip(&self.data).for_each(|(byte, cell)| *byte = *cell as u8);
        });
    }
}

/// map_msgs/OccupancyGridUpdate: a rectangle of a map that was published before.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct OccupancyGridUpdate {
    /// Time of the newest content.
    pub stamp: Stamp,
    /// Frame of the map.
    pub frame_id: String,
    /// First column of the map's that the rectangle replaces.
    pub x: i32,
    /// First row of the map's that the rectangle replaces.
    pub y: i32,
    /// Number of cells along x.
    pub width: u32,
    /// Number of cells along y.
    pub height: u32,
    /// Values as in [`OccupancyGrid::data`].
    pub data: Vec<i8>,
}

impl Message for OccupancyGridUpdate {
    const TYPE: &'static str = "map_msgs/OccupancyGridUpdate";
    fn read(from: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let (stamp, frame_id) = read_header(from)?;
        let (x, y) = (from.i32("x")?, from.i32("y")?);
        let (width, height) = (from.u32("width")?, from.u32("height")?);
        let data = from.byte_seq("data")?;
        if u64::from(width) * u64::from(height) != data.len() as u64 {
            return Err(DecodeError::GridSize { width, height, cells: data.len() });
        }
        let data = data.iter().map(|byte| *byte as i8).collect();
        Ok(Self { stamp, frame_id, x, y, width, height, data })
    }
    fn write(&self, to: &mut Writer<'_>) {
        write::header(to, self.stamp, &self.frame_id);
        to.i32(self.x);
        to.i32(self.y);
        to.u32(self.width);
        to.u32(self.height);
        to.byte_seq_with(self.data.len(), |bytes| {
            bytes.iter_mut().zip(&self.data).for_each(|(byte, cell)| *byte = *cell as u8);
        });
    }
}
