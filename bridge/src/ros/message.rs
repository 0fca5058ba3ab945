//! ROS 2 messages, owned, with the fields of their definitions (common_interfaces, Jazzy), units SI.

use crate::cdr::{DecodeError, Dialect, Reader, Writer};
use crate::ros::{read, write};
use msg::Stamp;

/// Something with a definition in ROS.
pub trait Message: Sized {
    /// `package/Type`, as ros_tcp and rosbridge write it.
    const TYPE: &'static str;
    /// Takes the fields off a reader.
    fn read(from: &mut Reader<'_>) -> Result<Self, DecodeError>;
    /// Appends the fields to a writer.
    fn write(&self, to: &mut Writer<'_>);
}

/// One message from its payload. Bytes behind its end are ignored: writers pad.
pub fn decode<M: Message>(payload: &[u8]) -> Result<M, DecodeError> {
    M::read(&mut Reader::new(payload)?)
}

/// Appends one message's payload, encapsulation header included.
pub fn encode<M: Message>(message: &M, out: &mut Vec<u8>) {
    message.write(&mut Writer::new(out));
}

/// [`decode`] in either dialect.
pub fn decode_as<M: Message>(dialect: Dialect, payload: &[u8]) -> Result<M, DecodeError> {
    M::read(&mut Reader::with(dialect, payload)?)
}

/// [`encode`] in either dialect.
pub fn encode_as<M: Message>(dialect: Dialect, message: &M, out: &mut Vec<u8>) {
    message.write(&mut Writer::with(dialect, out));
}

/// std_msgs/Header: stamp and frame.
pub(super) fn read_header(from: &mut Reader<'_>) -> Result<(Stamp, String), DecodeError> {
    read::header(from).map(|(stamp, frame_id)| (stamp, frame_id.to_owned()))
}

fn read_pose(from: &mut Reader<'_>) -> Result<([f64; 3], [f64; 4]), DecodeError> {
    Ok((from.f64s("position")?, from.f64s("orientation")?))
}

/// geometry_msgs/Twist: a wished velocity. Reading refuses NaN and infinities.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Twist {
    /// m/s: forward, left, up.
    pub linear: [f64; 3],
    /// rad/s about the same axes.
    pub angular: [f64; 3],
}

impl Message for Twist {
    const TYPE: &'static str = "geometry_msgs/Twist";
    fn read(from: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let linear = [from.finite("linear.x")?, from.finite("linear.y")?, from.finite("linear.z")?];
        let angular = [from.finite("angular.x")?, from.finite("angular.y")?, from.finite("angular.z")?];
        Ok(Self { linear, angular })
    }
    fn write(&self, to: &mut Writer<'_>) {
        to.f64s(&self.linear);
        to.f64s(&self.angular);
    }
}

/// geometry_msgs/TwistStamped.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TwistStamped {
    /// When it was wished.
    pub stamp: Stamp,
    /// The frame it is in.
    pub frame_id: String,
    /// The velocity.
    pub twist: Twist,
}

impl Message for TwistStamped {
    const TYPE: &'static str = "geometry_msgs/TwistStamped";
    fn read(from: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let (stamp, frame_id) = read_header(from)?;
        Ok(Self { stamp, frame_id, twist: Twist::read(from)? })
    }
    fn write(&self, to: &mut Writer<'_>) {
        write::header(to, self.stamp, &self.frame_id);
        self.twist.write(to);
    }
}

/// std_msgs/Int32.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Int32(pub i32);

impl Message for Int32 {
    const TYPE: &'static str = "std_msgs/Int32";
    fn read(from: &mut Reader<'_>) -> Result<Self, DecodeError> {
        from.i32("data").map(Self)
    }
    fn write(&self, to: &mut Writer<'_>) {
        to.i32(self.0);
    }
}

/// std_msgs/Bool.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Bool(pub bool);

impl Message for Bool {
    const TYPE: &'static str = "std_msgs/Bool";
    fn read(from: &mut Reader<'_>) -> Result<Self, DecodeError> {
        from.bool("data").map(Self)
    }
    fn write(&self, to: &mut Writer<'_>) {
        to.bool(self.0);
    }
}

/// std_msgs/Empty. ROS 2 puts one zero byte where nothing is; Unity's connector and ROS 1 put none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Empty;

impl Message for Empty {
    const TYPE: &'static str = "std_msgs/Empty";
    fn read(_: &mut Reader<'_>) -> Result<Self, DecodeError> {
        Ok(Self)
    }
    fn write(&self, to: &mut Writer<'_>) {
        if to.dialect() == Dialect::Ros2 {
            to.u8(0);
        }
    }
}

/// std_msgs/String.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Text(pub String);

impl Message for Text {
    const TYPE: &'static str = "std_msgs/String";
    fn read(from: &mut Reader<'_>) -> Result<Self, DecodeError> {
        from.string("data").map(|text| Self(text.to_owned()))
    }
    fn write(&self, to: &mut Writer<'_>) {
        to.string(&self.0);
    }
}

/// rosgraph_msgs/Clock.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Clock {
    /// Now.
    pub clock: Stamp,
}

impl Message for Clock {
    const TYPE: &'static str = "rosgraph_msgs/Clock";
    fn read(from: &mut Reader<'_>) -> Result<Self, DecodeError> {
        read::stamp(from, "clock").map(|clock| Self { clock })
    }
    fn write(&self, to: &mut Writer<'_>) {
        write::stamp(to, self.clock);
    }
}

/// std_msgs/Float32MultiArray without dimensions.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Float32MultiArray {
    /// The values, in order.
    pub data: Vec<f32>,
}

impl Message for Float32MultiArray {
    const TYPE: &'static str = "std_msgs/Float32MultiArray";
    fn read(from: &mut Reader<'_>) -> Result<Self, DecodeError> {
        for _ in 0..from.count("layout.dim", 12)? {
            from.string("layout.dim.label")?;
            from.u32("layout.dim.size")?;
            from.u32("layout.dim.stride")?;
        }
        from.u32("layout.data_offset")?;
        from.f32_seq("data").map(|data| Self { data })
    }
    fn write(&self, to: &mut Writer<'_>) {
        write::float_array(to, &self.data);
    }
}

/// sensor_msgs/LaserScan.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LaserScan {
    /// The first beam's.
    pub stamp: Stamp,
    /// The LiDAR's frame.
    pub frame_id: String,
    /// Radians.
    pub angle_min: f32,
    /// Radians.
    pub angle_max: f32,
    /// Radians.
    pub angle_increment: f32,
    /// Seconds between beams.
    pub time_increment: f32,
    /// Seconds between scans.
    pub scan_time: f32,
    /// Metres.
    pub range_min: f32,
    /// Metres.
    pub range_max: f32,
    /// Metres.
    pub ranges: Vec<f32>,
    /// The device's own units; perhaps none.
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

/// geometry_msgs/TransformStamped: `frame_id` from `child_frame_id`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TransformStamped {
    /// When it holds.
    pub stamp: Stamp,
    /// The parent.
    pub frame_id: String,
    /// The child.
    pub child_frame_id: String,
    /// Metres.
    pub translation: [f64; 3],
    /// Unit quaternion x, y, z, w.
    pub rotation: [f64; 4],
}

impl Message for TransformStamped {
    const TYPE: &'static str = "geometry_msgs/TransformStamped";
    fn read(from: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let (stamp, frame_id) = read_header(from)?;
        Ok(Self {
            stamp,
            frame_id,
            child_frame_id: from.string("child_frame_id")?.to_owned(),
            translation: from.f64s("transform.translation")?,
            rotation: from.f64s("transform.rotation")?,
        })
    }
    fn write(&self, to: &mut Writer<'_>) {
        let (frame, child) = (&self.frame_id, &self.child_frame_id);
        write::transform(to, self.stamp, frame, child, self.translation, self.rotation);
    }
}

/// tf2_msgs/TFMessage.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TfMessage {
    /// Edges of the transform tree.
    pub transforms: Vec<TransformStamped>,
}

impl Message for TfMessage {
    const TYPE: &'static str = "tf2_msgs/TFMessage";
    fn read(from: &mut Reader<'_>) -> Result<Self, DecodeError> {
        // The shortest transform: stamp 8, two empty strings of 4, seven doubles.
        let count = from.count("transforms", 72)?;
        let transforms = (0..count).map(|_| TransformStamped::read(from)).collect::<Result<_, _>>()?;
        Ok(Self { transforms })
    }
    fn write(&self, to: &mut Writer<'_>) {
        to.count(self.transforms.len());
        self.transforms.iter().for_each(|transform| transform.write(to));
    }
}

/// geometry_msgs/PoseWithCovarianceStamped.
#[derive(Clone, Debug, PartialEq)]
pub struct PoseWithCovarianceStamped {
    /// When it held.
    pub stamp: Stamp,
    /// The frame of the pose.
    pub frame_id: String,
    /// Metres.
    pub position: [f64; 3],
    /// Unit quaternion x, y, z, w.
    pub orientation: [f64; 4],
    /// Row-major over x, y, z (metres) and rotations about them (radians).
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

/// nav_msgs/Odometry; covariances, which our robots leave zero, are passed over.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Odometry {
    /// When it held.
    pub stamp: Stamp,
    /// The frame of the pose.
    pub frame_id: String,
    /// The frame of the velocity.
    pub child_frame_id: String,
    /// Metres.
    pub position: [f64; 3],
    /// Unit quaternion x, y, z, w.
    pub orientation: [f64; 4],
    /// m/s and rad/s.
    pub twist: Twist,
}

impl Message for Odometry {
    const TYPE: &'static str = "nav_msgs/Odometry";
    fn read(from: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let (stamp, frame_id) = read_header(from)?;
        let child_frame_id = from.string("child_frame_id")?.to_owned();
        let (position, orientation) = read_pose(from)?;
        from.f64s::<36>("pose.covariance")?;
        let twist = Twist::read(from)?;
        from.f64s::<36>("twist.covariance")?;
        Ok(Self { stamp, frame_id, child_frame_id, position, orientation, twist })
    }
    fn write(&self, to: &mut Writer<'_>) {
        write::header(to, self.stamp, &self.frame_id);
        to.string(&self.child_frame_id);
        write::pose(to, self.position, self.orientation);
        to.f64s(&[0.0; 36]);
        self.twist.write(to);
        to.f64s(&[0.0; 36]);
    }
}

/// nav_msgs/OccupancyGrid.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct OccupancyGrid {
    /// Of the newest content.
    pub stamp: Stamp,
    /// The map's frame.
    pub frame_id: String,
    /// Side of a cell, metres.
    pub resolution: f32,
    /// Cells along x.
    pub width: u32,
    /// Cells along y.
    pub height: u32,
    /// Of the lower left corner of cell (0, 0), metres.
    pub position: [f64; 3],
    /// Unit quaternion x, y, z, w.
    pub orientation: [f64; 4],
    /// Row-major percent of occupation, row 0 lowest; -1 unknown.
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
            let what = format!("a grid of {width} x {height} cells comes with {} cells", data.len());
            return Err(DecodeError::Inconsistent { what });
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
