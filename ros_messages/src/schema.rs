//! ROS 2 definitions of the message types that the bridge publishes, as `ros2msg` schemas.
//!
//! Field lists of Humble to Jazzy: common_interfaces, rcl_interfaces, geometry2, navigation_msgs.

mod services;

pub use services::{ServiceSchemas, service_schemas};

use std::collections::BTreeSet;
use std::fmt::Write as _;

/// The line between a definition and those that it uses.
const SEPARATOR: &str = "================================================================================";

/// A type's fields, one a line, and the types that they use.
struct Definition {
    name: &'static str,
    fields: &'static str,
    uses: &'static [&'static str],
}

const fn definition(name: &'static str, fields: &'static str, uses: &'static [&'static str]) -> Definition {
    Definition { name, fields, uses }
}

const HEADER: &str = "std_msgs/Header";
const TIME: &str = "builtin_interfaces/Time";

/// All types, in alphabetical order of their packages.
const DEFINITIONS: &[Definition] = &[
    definition(TIME, "int32 sec\nuint32 nanosec", &[]),
    definition("geometry_msgs/Point", "float64 x\nfloat64 y\nfloat64 z", &[]),
    definition(
        "geometry_msgs/Pose",
        "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
        &["geometry_msgs/Point", "geometry_msgs/Quaternion"],
    ),
    definition("geometry_msgs/Point32", "float32 x\nfloat32 y\nfloat32 z", &[]),
    definition("geometry_msgs/Polygon", "geometry_msgs/Point32[] points", &["geometry_msgs/Point32"]),
    definition(
        "geometry_msgs/PolygonStamped",
        "std_msgs/Header header\ngeometry_msgs/Polygon polygon",
        &[HEADER, "geometry_msgs/Polygon", "geometry_msgs/Point32"],
    ),
    definition(
        "geometry_msgs/PoseStamped",
        "std_msgs/Header header\ngeometry_msgs/Pose pose",
        &[HEADER, "geometry_msgs/Pose"],
    ),
    definition(
        "geometry_msgs/PoseWithCovariance",
        "geometry_msgs/Pose pose\nfloat64[36] covariance",
        &["geometry_msgs/Pose"],
    ),
    definition(
        "geometry_msgs/PoseWithCovarianceStamped",
        "std_msgs/Header header\ngeometry_msgs/PoseWithCovariance pose",
        &[HEADER, "geometry_msgs/PoseWithCovariance"],
    ),
    definition("geometry_msgs/Pose2D", "float64 x\nfloat64 y\nfloat64 theta", &[]),
    definition("geometry_msgs/Quaternion", "float64 x\nfloat64 y\nfloat64 z\nfloat64 w", &[]),
    definition(
        "geometry_msgs/Transform",
        "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation",
        &["geometry_msgs/Vector3", "geometry_msgs/Quaternion"],
    ),
    definition(
        "geometry_msgs/TransformStamped",
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/Transform transform",
        &[HEADER, "geometry_msgs/Transform"],
    ),
    definition(
        "geometry_msgs/Twist",
        "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular",
        &["geometry_msgs/Vector3"],
    ),
    definition(
        "geometry_msgs/TwistStamped",
        "std_msgs/Header header\ngeometry_msgs/Twist twist",
        &[HEADER, "geometry_msgs/Twist"],
    ),
    definition(
        "geometry_msgs/TwistWithCovariance",
        "geometry_msgs/Twist twist\nfloat64[36] covariance",
        &["geometry_msgs/Twist"],
    ),
    definition("geometry_msgs/Vector3", "float64 x\nfloat64 y\nfloat64 z", &[]),
    definition(
        "map_msgs/OccupancyGridUpdate",
        "std_msgs/Header header\nint32 x\nint32 y\nuint32 width\nuint32 height\nint8[] data",
        &[HEADER],
    ),
    definition("mr_slam_msgs/MapTile", "uint32 x\nuint32 y\nuint32 width\nuint32 height\nint8[] data", &[]),
    definition(
        "mr_slam_msgs/MapTiles",
        "std_msgs/Header header\nuint32 number\nuint32 base\nnav_msgs/MapMetaData info\n\
         mr_slam_msgs/MapTile[] tiles",
        &[HEADER, "nav_msgs/MapMetaData", "mr_slam_msgs/MapTile"],
    ),
    definition(
        "nav_msgs/MapMetaData",
        "builtin_interfaces/Time map_load_time\nfloat32 resolution\nuint32 width\nuint32 height\n\
         geometry_msgs/Pose origin",
        &[TIME, "geometry_msgs/Pose"],
    ),
    definition(
        "nav_msgs/OccupancyGrid",
        "std_msgs/Header header\nnav_msgs/MapMetaData info\nint8[] data",
        &[HEADER, "nav_msgs/MapMetaData"],
    ),
    definition(
        "nav_msgs/Odometry",
        "std_msgs/Header header\nstring child_frame_id\ngeometry_msgs/PoseWithCovariance pose\n\
         geometry_msgs/TwistWithCovariance twist",
        &[HEADER, "geometry_msgs/PoseWithCovariance", "geometry_msgs/TwistWithCovariance"],
    ),
    definition(
        "nav_msgs/Path",
        "std_msgs/Header header\ngeometry_msgs/PoseStamped[] poses",
        &[HEADER, "geometry_msgs/PoseStamped"],
    ),
    definition("rosgraph_msgs/Clock", "builtin_interfaces/Time clock", &[TIME]),
    definition(
        "sensor_msgs/BatteryState",
        "std_msgs/Header header\nfloat32 voltage\nfloat32 temperature\nfloat32 current\nfloat32 charge\n\
         float32 capacity\nfloat32 design_capacity\nfloat32 percentage\nuint8 power_supply_status\n\
         uint8 power_supply_health\nuint8 power_supply_technology\nbool present\nfloat32[] cell_voltage\n\
         float32[] cell_temperature\nstring location\nstring serial_number",
        &[HEADER],
    ),
    definition("sensor_msgs/Joy", "std_msgs/Header header\nfloat32[] axes\nint32[] buttons", &[HEADER]),
    definition(
        "sensor_msgs/LaserScan",
        "std_msgs/Header header\nfloat32 angle_min\nfloat32 angle_max\nfloat32 angle_increment\n\
         float32 time_increment\nfloat32 scan_time\nfloat32 range_min\nfloat32 range_max\nfloat32[] ranges\n\
         float32[] intensities",
        &[HEADER],
    ),
    definition("std_msgs/Bool", "bool data", &[]),
    definition("std_msgs/Empty", "", &[]),
    definition(
        "std_msgs/Float32MultiArray",
        "std_msgs/MultiArrayLayout layout\nfloat32[] data",
        &["std_msgs/MultiArrayLayout"],
    ),
    definition(HEADER, "builtin_interfaces/Time stamp\nstring frame_id", &[TIME]),
    definition("std_msgs/Int32", "int32 data", &[]),
    definition("std_msgs/MultiArrayDimension", "string label\nuint32 size\nuint32 stride", &[]),
    definition(
        "std_msgs/MultiArrayLayout",
        "std_msgs/MultiArrayDimension[] dim\nuint32 data_offset",
        &["std_msgs/MultiArrayDimension"],
    ),
    definition("std_msgs/String", "string data", &[]),
    definition(
        "tf2_msgs/TFMessage",
        "geometry_msgs/TransformStamped[] transforms",
        &["geometry_msgs/TransformStamped"],
    ),
];

fn find(name: &str) -> Option<&'static Definition> {
    DEFINITIONS.iter().find(|definition| definition.name == name)
}

/// Returns the schema of a type, `package/Type`: its definition, then those that it uses; `None` if it is not known.
pub fn schema(message_type: &str) -> Option<String> {
    let definition = find(message_type)?;
    Some(with_used_types(definition.fields, definition.uses))
}

/// Returns fields, then the definitions of the types that they use.
fn with_used_types(fields: &str, uses: &[&'static str]) -> String {
    let mut text = fields.to_owned();
    let (mut written, mut open) = (BTreeSet::new(), uses.to_vec());
    while let Some(name) = open.pop() {
        if written.insert(name)
            && let Some(used) = find(name)
        {
            // Writing to a string cannot fail.
            let _ = write!(text, "\n{SEPARATOR}\nMSG: {name}\n{}", used.fields);
            open.extend(used.uses);
        }
    }
    text.push('\n');
    text
}

/// Returns where the first stamp is in a message of this type, bytes after the encapsulation header.
///
/// Types with a header begin with it; a list of transforms has its length before the first one's header.
pub fn stamp_offset(message_type: &str) -> Option<usize> {
    match message_type {
        "rosgraph_msgs/Clock" => Some(0),
        "tf2_msgs/TFMessage" => Some(4),
        _ => find(message_type)?.uses.contains(&HEADER).then_some(0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    #[test]
    fn a_schema_defines_every_type_that_it_uses_once() {
        for definition in DEFINITIONS {
            let text = schema(definition.name).unwrap();
            for line in text.lines().filter(|line| line.contains('/') && !line.starts_with("MSG:")) {
                let used = line.split_whitespace().next().unwrap().trim_end_matches("[]");
                let defined = format!("MSG: {used}\n");
                assert_eq!(text.matches(&defined).count(), 1, "{used} in {}", definition.name);
            }
        }
    }
}
