//! Names of topics, and the message and service types that exist: a mistyped name gets an error at once.
//!
//! Of ROS 2's own packages (Jazzy) each type is listed. Of other well-known packages only the name is, and any
//! well-formed type is accepted. A laboratory's own packages are named in the configuration.

use thiserror::Error;

/// Messages of ROS 2's own packages, and of ours.
const MESSAGES: &[(&str, &str)] = &[
    ("action_msgs", "GoalInfo GoalStatus GoalStatusArray"),
    ("actionlib_msgs", "GoalID GoalStatus GoalStatusArray"),
    ("builtin_interfaces", "Duration Time"),
    ("diagnostic_msgs", "DiagnosticArray DiagnosticStatus KeyValue"),
    (
        "geometry_msgs",
        "Accel AccelStamped AccelWithCovariance AccelWithCovarianceStamped Inertia InertiaStamped Point Point32 \
         PointStamped Polygon PolygonInstance PolygonInstanceStamped PolygonStamped Pose Pose2D PoseArray \
         PoseStamped PoseWithCovariance PoseWithCovarianceStamped Quaternion QuaternionStamped Transform \
         TransformStamped Twist TwistStamped TwistWithCovariance TwistWithCovarianceStamped Vector3 \
         Vector3Stamped VelocityStamped Wrench WrenchStamped",
    ),
    ("lifecycle_msgs", "State Transition TransitionDescription TransitionEvent"),
    ("map_msgs", "OccupancyGridUpdate PointCloud2Update ProjectedMap ProjectedMapInfo"),
    ("mr_slam_msgs", "MapTile MapTiles"),
    ("nav_msgs", "Goals GridCells MapMetaData OccupancyGrid Odometry Path"),
    (
        "rcl_interfaces",
        "FloatingPointRange IntegerRange ListParametersResult Log LoggerLevel Parameter ParameterDescriptor \
         ParameterEvent ParameterEventDescriptors ParameterType ParameterValue SetLoggerLevelsResult \
         SetParametersResult",
    ),
    ("rosgraph_msgs", "Clock"),
    (
        "sensor_msgs",
        "BatteryState CameraInfo ChannelFloat32 CompressedImage FluidPressure Illuminance Image Imu JointState \
         Joy JoyFeedback JoyFeedbackArray LaserEcho LaserScan MagneticField MultiDOFJointState \
         MultiEchoLaserScan NavSatFix NavSatStatus PointCloud PointCloud2 PointField Range RegionOfInterest \
         RelativeHumidity Temperature TimeReference",
    ),
    ("shape_msgs", "Mesh MeshTriangle Plane SolidPrimitive"),
    (
        "std_msgs",
        "Bool Byte ByteMultiArray Char ColorRGBA Empty Float32 Float32MultiArray Float64 Float64MultiArray \
         Header Int16 Int16MultiArray Int32 Int32MultiArray Int64 Int64MultiArray Int8 Int8MultiArray \
         MultiArrayDimension MultiArrayLayout String UInt16 UInt16MultiArray UInt32 UInt32MultiArray UInt64 \
         UInt64MultiArray UInt8 UInt8MultiArray",
    ),
    ("stereo_msgs", "DisparityImage"),
    ("tf2_msgs", "TF2Error TFMessage"),
    (
        "trajectory_msgs",
        "JointTrajectory JointTrajectoryPoint MultiDOFJointTrajectory MultiDOFJointTrajectoryPoint",
    ),
    ("unique_identifier_msgs", "UUID"),
    (
        "visualization_msgs",
        "ImageMarker InteractiveMarker InteractiveMarkerControl InteractiveMarkerFeedback InteractiveMarkerInit \
         InteractiveMarkerPose InteractiveMarkerUpdate Marker MarkerArray MenuEntry MeshFile UVCoordinate",
    ),
];

/// Services of ROS 2's own packages.
const SERVICES: &[(&str, &str)] = &[
    ("action_msgs", "CancelGoal"),
    ("composition_interfaces", "ListNodes LoadNode UnloadNode"),
    ("diagnostic_msgs", "AddDiagnostics SelfTest"),
    ("lifecycle_msgs", "ChangeState GetAvailableStates GetAvailableTransitions GetState"),
    ("map_msgs", "GetMapROI GetPointMap GetPointMapROI ProjectedMapsInfo SaveMap SetMapProjections"),
    ("nav_msgs", "GetMap GetPlan LoadMap SetMap"),
    (
        "rcl_interfaces",
        "DescribeParameters GetLoggerLevels GetParameterTypes GetParameters ListParameters SetLoggerLevels \
         SetParameters SetParametersAtomically",
    ),
    (
        "rosbag2_interfaces",
        "Burst GetRate IsPaused Pause Play PlayNext Resume Seek SetRate Snapshot SplitBagfile Stop TogglePaused",
    ),
    ("sensor_msgs", "SetCameraInfo"),
    ("std_srvs", "Empty SetBool Trigger"),
    ("tf2_msgs", "FrameGraph"),
    ("visualization_msgs", "GetInteractiveMarkers"),
];

/// Services of [`SERVICES`] whose response has no fields.
const EMPTY_RESPONSES: &[&str] = &[
    "map_msgs/ProjectedMapsInfo",
    "map_msgs/SaveMap",
    "rosbag2_interfaces/Pause",
    "rosbag2_interfaces/Resume",
    "rosbag2_interfaces/SplitBagfile",
    "rosbag2_interfaces/Stop",
    "rosbag2_interfaces/TogglePaused",
    "std_srvs/Empty",
];

/// Returns whether a service's response is known to have fields, so that no empty payload can be read as one.
pub fn has_response_fields(service_type: &str) -> bool {
    let (package, class) = service_type.split_once('/').unwrap_or_default();
    let of_package = SERVICES.iter().find(|(known, _)| *known == package);
    of_package.is_some_and(|(_, types)| types.split(' ').any(|known| known == class))
        && !EMPTY_RESPONSES.contains(&service_type)
}

/// Well-known packages whose types are not listed.
const OTHERS: &[&str] = &[
    "ackermann_msgs",
    "audio_common_msgs",
    "can_msgs",
    "cartographer_ros_msgs",
    "control_msgs",
    "controller_manager_msgs",
    "dwb_msgs",
    "ffmpeg_image_transport_msgs",
    "foxglove_msgs",
    "gazebo_msgs",
    "geographic_msgs",
    "gps_msgs",
    "grid_map_msgs",
    "irobot_create_msgs",
    "mavros_msgs",
    "moveit_msgs",
    "nav2_msgs",
    "nmea_msgs",
    "nvblox_msgs",
    "object_recognition_msgs",
    "octomap_msgs",
    "pcl_msgs",
    "px4_msgs",
    "quest2ros",
    "radar_msgs",
    "robot_localization",
    "ros_gz_interfaces",
    "rosapi_msgs",
    "rtabmap_msgs",
    "slam_toolbox",
    "turtlebot3_msgs",
    "turtlesim",
    "unity_robotics_demo_msgs",
    "vision_msgs",
    "voxblox_msgs",
];

/// Tells message types from service types.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// The type of a topic's messages.
    Message,
    /// The type of a service's requests and responses.
    Service,
}

impl std::fmt::Display for Kind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Message => "message",
            Self::Service => "service",
        })
    }
}

/// Why a type is not accepted.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum TypeError {
    /// The text is not of the form `package/Type`.
    #[error("'{name}' is not a type: write package/Type, as in geometry_msgs/Twist")]
    Malformed {
        /// Text that was given as a type.
        name: String,
    },
    /// The package is known, and has no such type.
    #[error("unknown {kind} class '{name}': {package} has no {kind} {class}")]
    UnknownType {
        /// Message or service.
        kind: Kind,
        /// The whole text.
        name: String,
        /// The part before the slash.
        package: String,
        /// The part behind the slash.
        class: String,
    },
    /// The package is not known.
    #[error(
        "unknown {kind} class '{name}': if {package} is your own package, add it to message_packages in the fleet \
         file's [bridge]"
    )]
    UnknownPackage {
        /// Message or service.
        kind: Kind,
        /// The whole text.
        name: String,
        /// The part before the slash.
        package: String,
    },
}

/// Returns a type as `package/Type`; the middle of `package/msg/Type` is removed.
///
/// `own_packages` are accepted with any well-formed type.
pub fn resolve(kind: Kind, name: &str, own_packages: &[String]) -> Result<String, TypeError> {
    let malformed = || TypeError::Malformed { name: name.to_owned() };
    let mut parts = name.split('/');
    let (package, class) = match (parts.next(), parts.next(), parts.next(), parts.next()) {
        (Some(package), Some(class), None, None) => (package, class),
        (Some(package), Some("msg" | "srv"), Some(class), None) => (package, class),
        _ => return Err(malformed()),
    };
    if !is_package_name(package) || !is_type_name(class) {
        return Err(malformed());
    }
    let table = match kind {
        Kind::Message => MESSAGES,
        Kind::Service => SERVICES,
    };
    let listed = table.iter().find(|(known, _)| *known == package).map(|(_, types)| *types);
    let is_own = own_packages.iter().any(|known| known == package);
    let (name, package) = (name.to_owned(), package.to_owned());
    match listed {
        _ if is_own => {}
        Some(types) if types.split(' ').any(|known| known == class) => {}
        Some(_) => return Err(TypeError::UnknownType { kind, name, package, class: class.to_owned() }),
        None if OTHERS.contains(&package.as_str()) => {}
        None => return Err(TypeError::UnknownPackage { kind, name, package }),
    }
    Ok(format!("{package}/{class}"))
}

/// The longest package or type name that is accepted.
const TYPE_NAME_MAX: usize = 128;

/// Returns whether a name is a ROS package's (REP-144): at least two lower-case letters, digits and single
/// underscores, a letter first.
pub fn is_package_name(name: &str) -> bool {
    let mut bytes = name.bytes();
    bytes.next().is_some_and(|first| first.is_ascii_lowercase())
        && (2..=TYPE_NAME_MAX).contains(&name.len())
        && bytes.all(|b| b.is_ascii_lowercase() || b.is_ascii_digit() || b == b'_')
        && !name.contains("__")
}

/// Returns whether a name is a ROS type's: letters and digits, a capital letter first.
fn is_type_name(name: &str) -> bool {
    let mut bytes = name.bytes();
    bytes.next().is_some_and(|first| first.is_ascii_uppercase())
        && name.len() <= TYPE_NAME_MAX
        && bytes.all(|b| b.is_ascii_alphanumeric())
}

/// The longest topic or service name, as in DDS.
pub const TOPIC_NAME_MAX: usize = 255;

/// Why a topic's or service's name is not accepted.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum NameError {
    /// The name has no characters but a slash.
    #[error("the topic's name is empty")]
    Empty,
    /// The name is too long or has characters that ROS does not allow.
    #[error(
        "'{name}' is not a topic's name: expected at most {TOPIC_NAME_MAX} letters, digits, '_' and '/', \
         no digit after a '/'"
    )]
    Malformed {
        /// Text that was given as a topic's name.
        name: String,
    },
}

/// Returns a name with its leading slash.
///
/// ROS 2's rule for names: tokens of letters, digits and underscores between slashes, none beginning with a digit.
/// ```
/// use ros_messages::interfaces::resolve_name;
/// assert_eq!(resolve_name("robot1/scan").as_deref(), Ok("/robot1/scan"));
/// assert!(resolve_name("/1st").is_err());
/// ```
pub fn resolve_name(name: &str) -> Result<String, NameError> {
    let path = name.strip_prefix('/').unwrap_or(name);
    let is_token = |token: &str| {
        !token.is_empty()
            && !token.starts_with(|first: char| first.is_ascii_digit())
            && token.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_')
    };
    if path.is_empty() {
        return Err(NameError::Empty);
    }
    if path.len() >= TOPIC_NAME_MAX || !path.split('/').all(is_token) {
        return Err(NameError::Malformed { name: name.to_owned() });
    }
    Ok(format!("/{path}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_types_are_accepted_and_others_get_an_error() {
        let own = ["my_msgs".to_owned()];
        let message = |name| resolve(Kind::Message, name, &own);
        assert_eq!(message("geometry_msgs/Twist").unwrap(), "geometry_msgs/Twist");
        assert_eq!(message("geometry_msgs/msg/Twist").unwrap(), "geometry_msgs/Twist");
        assert!(message("quest2ros/OVR2ROSInputs").is_ok());
        assert!(message("my_msgs/Anything").is_ok());
        assert!(
            message("geometry_msgs/Twits")
                .unwrap_err()
                .to_string()
                .contains("geometry_msgs has no message Twits")
        );
        assert!(message("no_such_pkg/Nope").unwrap_err().to_string().contains("message_packages"));
        for name in
            ["", "Twist", "/", "a/b/c", "geometry_msgs/", "Geometry/Twist", "std_msgs/msg/String/x", "é/É"]
        {
            assert!(message(name).is_err(), "{name}");
        }
        assert!(resolve(Kind::Service, "std_srvs/Trigger", &[]).is_ok());
        assert!(resolve(Kind::Service, "geometry_msgs/Twist", &[]).is_err());
    }

    #[test]
    fn ros_names_are_accepted_and_others_get_an_error() {
        assert_eq!(resolve_name("pos_rot").unwrap(), "/pos_rot");
        assert_eq!(resolve_name("/robot1/scan").unwrap(), "/robot1/scan");
        for name in ["", "/", "//a", "/a/", "/1a", "/a b", "/é", "/a\n"] {
            assert!(resolve_name(name).is_err(), "{name:?}");
        }
        assert!(resolve_name(&"a".repeat(300)).is_err());
    }
}
