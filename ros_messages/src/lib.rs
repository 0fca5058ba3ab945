//! ROS messages and their encoding in CDR, types and names of topics, and frames.
//!
//! [`message`], [`sensor`] and [`joystick`] have owned messages with ROS's fields, for clients, tests and the bridge's
//! inputs. [`mod@write`] and [`read`] convert between CDR and the fleet's messages without allocating, for the frequent
//! ones. [`names`] has the names of frames.

pub mod actions;
pub mod battery;
pub mod cdr;
pub mod interfaces;
pub mod joystick;
pub mod map_tiles;
pub mod message;
pub mod names;
pub mod navigation;
mod odometry_covariance;
pub mod read;
pub mod schema;
pub mod sensor;
pub mod spatial_pose;
pub mod write;

pub use battery::BatteryState;
pub use cdr::{DecodeError, Dialect};
pub use joystick::{HandInputs, Joy};
pub use map_tiles::{MapTile, MapTiles};
pub use message::{
    Bool, Clock, Empty, Float32MultiArray, Int32, Message, Pose2D, Text, TfMessage, TransformStamped, Twist,
    TwistStamped, decode, decode_as, encode, encode_as,
};
pub use names::{FrameNames, NameStyle, RobotNameError, RobotNames};
pub use navigation::{PathMessage, PolygonStamped, PoseStamped};
pub use odometry_covariance::{OdometryCovariance, OdometrySigmas};
pub use sensor::{LaserScan, OccupancyGrid, OccupancyGridUpdate, Odometry, PoseWithCovarianceStamped};

#[cfg(test)]
mod tests;
