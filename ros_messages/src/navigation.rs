//! Owned ROS messages of navigation: a goal's pose, and paths.

use super::message::{Message, read_header};
use super::sensor::read_pose;
use crate::cdr::{DecodeError, Reader, Writer};
use crate::write;
use msg::Stamp;

/// Fewest bytes of a pose with its header on the wire: stamp, empty frame, seven numbers.
pub(crate) const POSE_STAMPED_BYTES_MIN: usize = 8 + 4 + 7 * 8;

/// geometry_msgs/PoseStamped: a pose in a frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PoseStamped {
    /// Time of the pose.
    pub stamp: Stamp,
    /// Frame of the pose.
    pub frame_id: String,
    /// Position in `frame_id`: x, y, z in metres.
    pub position: [f64; 3],
    /// Orientation: unit quaternion x, y, z, w.
    pub orientation: [f64; 4],
}

impl Message for PoseStamped {
    const TYPE: &'static str = "geometry_msgs/PoseStamped";
    fn read(from: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let (stamp, frame_id) = read_header(from)?;
        let (position, orientation) = read_pose(from)?;
        Ok(Self { stamp, frame_id, position, orientation })
    }
    fn write(&self, to: &mut Writer<'_>) {
        write::header(to, self.stamp, &self.frame_id);
        write::pose(to, self.position, self.orientation);
    }
}

/// nav_msgs/Path: poses one after another.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PathMessage {
    /// Time of the path.
    pub stamp: Stamp,
    /// Frame of the path.
    pub frame_id: String,
    /// The poses, each with a frame of its own; it may be empty.
    pub poses: Vec<PoseStamped>,
}

impl Message for PathMessage {
    const TYPE: &'static str = "nav_msgs/Path";
    fn read(from: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let (stamp, frame_id) = read_header(from)?;
        let count = from.count("poses", POSE_STAMPED_BYTES_MIN)?;
        let poses = (0..count).map(|_| PoseStamped::read(from)).collect::<Result<_, _>>()?;
        Ok(Self { stamp, frame_id, poses })
    }
    fn write(&self, to: &mut Writer<'_>) {
        write::header(to, self.stamp, &self.frame_id);
        to.count(self.poses.len());
        self.poses.iter().for_each(|pose| pose.write(to));
    }
}

/// geometry_msgs/PolygonStamped: an area in a frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PolygonStamped {
    /// Time of the area.
    pub stamp: Stamp,
    /// Frame of the corners.
    pub frame_id: String,
    /// Corners in order in `frame_id`: x, y, z in metres.
    pub corners: Vec<[f32; 3]>,
}

impl Message for PolygonStamped {
    const TYPE: &'static str = "geometry_msgs/PolygonStamped";
    fn read(from: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let (stamp, frame_id) = read_header(from)?;
        let count = from.count("points", 3 * size_of::<f32>())?;
        let corner = |from: &mut Reader<'_>| Ok([from.f32("x")?, from.f32("y")?, from.f32("z")?]);
        let corners = (0..count).map(|_| corner(from)).collect::<Result<_, DecodeError>>()?;
        Ok(Self { stamp, frame_id, corners })
    }
    fn write(&self, to: &mut Writer<'_>) {
        write::header(to, self.stamp, &self.frame_id);
        to.count(self.corners.len());
        self.corners.iter().flatten().for_each(|value| to.f32(*value));
    }
}

/// Writes a nav_msgs/Path of points; each pose looks to the next point.
pub fn write_path(to: &mut Writer<'_>, frame_id: &str, at: Stamp, points_m: &[[f32; 2]]) {
    write::header(to, at, frame_id);
    to.count(points_m.len());
    let mut yaw_rad = 0.0;
    for (i, [x, y]) in points_m.iter().enumerate() {
        if let Some([next_x, next_y]) = points_m.get(i + 1) {
            yaw_rad = f64::from(next_y - y).atan2(f64::from(next_x - x));
        }
        let (position, orientation) = write::spatial(msg::Pose2::new(f64::from(*x), f64::from(*y), yaw_rad));
        write::header(to, at, frame_id);
        write::pose(to, position, orientation);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{decode, encode};

    #[test]
    fn a_polygon_is_read_as_it_was_written() {
        let corners = vec![[0.0, 1.0, 0.0], [2.5, 1.0, 0.0], [2.5, -3.0, 0.0]];
        let polygon = PolygonStamped { stamp: Stamp(5), frame_id: "map".into(), corners };
        let mut bytes = Vec::new();
        encode(&polygon, &mut bytes);
        assert_eq!(decode::<PolygonStamped>(&bytes), Ok(polygon));
        assert!(decode::<PolygonStamped>(&bytes[..bytes.len() - 1]).is_err());
    }

    #[test]
    fn a_written_path_is_read_with_headings_along_it() {
        let mut bytes = Vec::new();
        encode(&PathMessage::default(), &mut bytes);
        assert_eq!(decode::<PathMessage>(&bytes), Ok(PathMessage::default()));
        bytes.clear();
        write_path(&mut Writer::new(&mut bytes), "map", Stamp(5), &[[0.0, 0.0], [0.0, 1.0]]);
        let path: PathMessage = decode(&bytes).unwrap();
        assert_eq!((path.frame_id.as_str(), path.poses.len()), ("map", 2));
        assert_eq!((path.poses[1].position, path.poses[1].frame_id.as_str()), ([0.0, 1.0, 0.0], "map"));
        let half = std::f64::consts::FRAC_PI_4;
        assert!((path.poses[1].orientation[2] - half.sin()).abs() < 1e-9);
        assert!(decode::<PathMessage>(&bytes[..bytes.len() - 1]).is_err());
    }
}
