//! Owned ROS messages with the fields of their definitions (common_interfaces, Jazzy); units are SI.

use crate::cdr::{DecodeError, Dialect, Reader, Writer};
use crate::{read, write};
use msg::Stamp;

/// A message with a definition in ROS.
pub trait Message: Sized {
    /// Type as `package/Type`.
    const TYPE: &'static str;
    /// Reads the fields.
    fn read(from: &mut Reader<'_>) -> Result<Self, DecodeError>;
    /// Writes the fields.
    fn write(&self, to: &mut Writer<'_>);
}

/// Decodes a message from its payload. Bytes behind its end are ignored, because writers pad.
pub fn decode<M: Message>(payload: &[u8]) -> Result<M, DecodeError> {
    M::read(&mut Reader::new(payload)?)
}

/// Appends a message's payload with its encapsulation header.
///
/// ```
/// use ros_messages::{Int32, decode, encode};
/// let mut payload = Vec::new();
/// encode(&Int32(7), &mut payload);
/// assert_eq!(payload, [0, 1, 0, 0, 7, 0, 0, 0]);
/// assert_eq!(decode(&payload), Ok(Int32(7)));
/// ```
pub fn encode<M: Message>(message: &M, out: &mut Vec<u8>) {
    message.write(&mut Writer::new(out));
}

/// Decodes a message in either encoding.
pub fn decode_as<M: Message>(dialect: Dialect, payload: &[u8]) -> Result<M, DecodeError> {
    M::read(&mut Reader::with(dialect, payload)?)
}

/// Appends a message's payload in either encoding.
pub fn encode_as<M: Message>(dialect: Dialect, message: &M, out: &mut Vec<u8>) {
    message.write(&mut Writer::with(dialect, out));
}

/// Reads std_msgs/Header: stamp and frame.
pub(crate) fn read_header(from: &mut Reader<'_>) -> Result<(Stamp, String), DecodeError> {
    read::header(from).map(|(stamp, frame_id)| (stamp, frame_id.to_owned()))
}

/// geometry_msgs/Twist: a commanded velocity. Reading refuses NaN and infinities.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Twist {
    /// Linear velocity forward, left and up, m/s.
    pub linear: [f64; 3],
    /// Angular velocity about the same axes, rad/s.
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

/// geometry_msgs/TwistStamped: a commanded velocity with its time and frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TwistStamped {
    /// Time of the command.
    pub stamp: Stamp,
    /// Frame of the velocity.
    pub frame_id: String,
    /// The commanded velocity.
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

/// geometry_msgs/Pose2D: a pose in the plane, with its angle as it is and not as a quaternion.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pose2D {
    /// Position in the frame, metres.
    pub x: f64,
    /// Position in the frame, metres.
    pub y: f64,
    /// Angle, radians, counter-clockwise.
    pub theta: f64,
}

impl Message for Pose2D {
    const TYPE: &'static str = "geometry_msgs/Pose2D";
    fn read(from: &mut Reader<'_>) -> Result<Self, DecodeError> {
        Ok(Self { x: from.finite("x")?, y: from.finite("y")?, theta: from.finite("theta")? })
    }
    fn write(&self, to: &mut Writer<'_>) {
        to.f64s(&[self.x, self.y, self.theta]);
    }
}

/// std_msgs/Int32: one signed integer.
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

/// std_msgs/Bool: one boolean.
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

/// std_msgs/Empty. ROS 2 encodes it as one zero byte; Unity's connector and ROS 1 as none.
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

/// std_msgs/String: a text.
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

/// rosgraph_msgs/Clock: the simulated time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Clock {
    /// The present time.
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

/// Length of the shortest std_msgs/MultiArrayDimension, bytes: an empty string, size and stride.
const DIMENSION_BYTES_MIN: usize = 12;

/// std_msgs/Float32MultiArray: floats without dimensions.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Float32MultiArray {
    /// The values in order.
    pub data: Vec<f32>,
}

impl Message for Float32MultiArray {
    const TYPE: &'static str = "std_msgs/Float32MultiArray";
    fn read(from: &mut Reader<'_>) -> Result<Self, DecodeError> {
        for _ in 0..from.count("layout.dim", DIMENSION_BYTES_MIN)? {
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

/// geometry_msgs/TransformStamped: the transform `frame_id` from `child_frame_id`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TransformStamped {
    /// Time of the transform.
    pub stamp: Stamp,
    /// The parent frame.
    pub frame_id: String,
    /// The child frame.
    pub child_frame_id: String,
    /// Position of the child in the parent, metres.
    pub translation: [f64; 3],
    /// Orientation of the child in the parent: unit quaternion x, y, z, w.
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

/// tf2_msgs/TFMessage: transforms between frames.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TfMessage {
    /// Edges of the tree of transforms.
    pub transforms: Vec<TransformStamped>,
}

impl Message for TfMessage {
    const TYPE: &'static str = "tf2_msgs/TFMessage";
    fn read(from: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let count = from.count("transforms", read::TRANSFORM_BYTES_MIN)?;
        let transforms = (0..count).map(|_| TransformStamped::read(from)).collect::<Result<_, _>>()?;
        Ok(Self { transforms })
    }
    fn write(&self, to: &mut Writer<'_>) {
        to.count(self.transforms.len());
        self.transforms.iter().for_each(|transform| transform.write(to));
    }
}
