//! The table of the topics that the fleet publishes. It drives their registration on TCP and on DDS.

use crate::router::DEPTH_DEFAULT;
use ros_messages::{
    BatteryState, Bool, Clock, Float32MultiArray, Int32, LaserScan, MapTiles, Message, OccupancyGrid,
    OccupancyGridUpdate, Odometry, PathMessage, PoseWithCovarianceStamped, RobotNames, Text, TfMessage,
};

/// Identifies a row of [`OUTGOING_TOPICS`], in the order of the table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FleetTopic {
    /// Laser scans of a robot.
    Scan,
    /// Wheel odometry of a robot.
    Odometry,
    /// The state of a robot's battery.
    Battery,
    /// SLAM's pose of a robot in its own map, with covariance.
    Pose,
    /// The map of a robot.
    Map,
    /// Cell counts of a robot's map.
    SlamStats,
    /// Transforms that change.
    Transforms,
    /// Transforms that never change.
    StaticTransforms,
    /// Transforms map -> odom for an external robot whose frames are plain.
    RobotTransforms,
    /// The run's time.
    Clock,
    /// The map of all robots.
    MergedMap,
    /// The same map under the name that RViz and Nav2 expect.
    MergedMapAlias,
    /// The cells of `/map` that changed since it was published last.
    MapUpdates,
    /// The tiles of the merged map that changed since it was published last.
    MergedMapTiles,
    /// The map of all robots with the probability of each cell.
    MergedMapProbability,
    /// The edges between the robots' maps, as JSON.
    MergeEdges,
    /// What navigation does with a robot and why, as JSON.
    NavigationState,
    /// The planned path of a robot.
    Plan,
    /// How far the exploration is and what is left, as JSON.
    ExplorationState,
    /// The areas that navigation keeps robots out of, as JSON.
    ExclusionZones,
    /// The robot that `/cmd_vel` drives.
    SelectedRobot,
    /// Whether the emergency stop is set.
    EmergencyStop,
}

/// How a topic's messages are kept for its subscribers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Delivery {
    /// Present subscribers only; the newest `depth` messages wait for a slow one.
    Stream {
        /// Messages that wait for a slow subscriber.
        depth: usize,
    },
    /// A stream to which every robot adds its share of waiting messages.
    StreamOfRobots {
        /// Messages that wait for a slow subscriber, for each robot of the fleet.
        depth_per_robot: usize,
    },
    /// The newest message, for late subscribers too (latched; transient local on DDS).
    Latched,
}

/// One topic that the fleet publishes.
#[derive(Clone, Copy, Debug)]
pub struct OutgoingTopic {
    /// Identifies the row.
    pub topic: FleetTopic,
    /// ROS name. A topic whose name begins with `/robotN/` exists once for each robot.
    pub name: &'static str,
    /// ROS type as `package/Type`, such as `geometry_msgs/Twist`.
    pub message_type: &'static str,
    /// Delivery to ros_tcp clients on TCP; `None` if the topic does not exist there.
    pub tcp: Option<Delivery>,
    /// Delivery on DDS; `None` if the topic does not exist there.
    pub dds: Option<Delivery>,
    /// Whether robots of an external ROS world publish this topic themselves, so that the bridge must not on DDS.
    pub robots_publish_it: bool,
    /// Whether only robots of an external ROS world have the topic, on DDS.
    pub external_only: bool,
    /// The shared-memory channel that feeds the topic; empty if the bridge itself does.
    pub channel: &'static str,
}

const ROBOT_PREFIX: &str = "/robotN/";

/// Transforms that wait for a slow TCP client, for each robot: about a second of them.
const TCP_TRANSFORMS_DEPTH: usize = 32;
/// Samples that a DDS writer keeps for a slow reader: at least half a minute at 100, 20, 10 and 1 Hz.
const DDS_CLOCK_DEPTH: usize = 4096;
const DDS_TRANSFORMS_DEPTH: usize = 8192;
const DDS_ODOMETRY_DEPTH: usize = 1024;
const DDS_SCAN_DEPTH: usize = 512;
const DDS_STATS_DEPTH: usize = 64;
/// Updates of the map that a DDS writer keeps for a slow reader: 2 s at 5 Hz, for each may be as long as the map.
const DDS_MAP_UPDATES_DEPTH: usize = 10;

/// Updates of the map's tiles that wait for a slow TCP client: 10 s at 5 Hz. A client that misses one gets the whole map.
const MAP_TILES_DEPTH: usize = 50;

const fn stream(depth: usize) -> Option<Delivery> {
    Some(Delivery::Stream { depth })
}

const LATCHED: Option<Delivery> = Some(Delivery::Latched);

/// Returns a row of a topic that only the bridge publishes, on neither transport yet.
const fn row(
    topic: FleetTopic,
    name: &'static str,
    message_type: &'static str,
    channel: &'static str,
) -> OutgoingTopic {
    OutgoingTopic {
        topic,
        name,
        message_type,
        tcp: None,
        dds: None,
        robots_publish_it: false,
        external_only: false,
        channel,
    }
}

/// All topics that the fleet publishes.
///
/// To add one, add a row here and a [`FleetTopic`], publish it in `FleetPublisher::publish`, and send the
/// [`crate::FleetMessage`] where its channel is read. The recorder has a table of its own.
pub const OUTGOING_TOPICS: [OutgoingTopic; 22] = [
    OutgoingTopic {
        tcp: stream(DEPTH_DEFAULT),
        dds: stream(DDS_SCAN_DEPTH),
        robots_publish_it: true,
        ..row(FleetTopic::Scan, "/robotN/scan", LaserScan::TYPE, "robotN/scan")
    },
    OutgoingTopic {
        tcp: stream(DEPTH_DEFAULT),
        dds: stream(DDS_ODOMETRY_DEPTH),
        robots_publish_it: true,
        ..row(FleetTopic::Odometry, "/robotN/odom", Odometry::TYPE, "robotN/odometry")
    },
    OutgoingTopic {
        tcp: stream(1),
        dds: stream(DDS_STATS_DEPTH),
        robots_publish_it: true,
        ..row(FleetTopic::Battery, "/robotN/battery_state", BatteryState::TYPE, "robotN/battery")
    },
    OutgoingTopic {
        tcp: stream(DEPTH_DEFAULT),
        dds: stream(DDS_SCAN_DEPTH),
        ..row(FleetTopic::Pose, "/robotN/pose", PoseWithCovarianceStamped::TYPE, "robotN/pose_estimate")
    },
    OutgoingTopic {
        tcp: LATCHED,
        dds: LATCHED,
        ..row(FleetTopic::Map, "/robotN/map", OccupancyGrid::TYPE, "robotN/map")
    },
    OutgoingTopic {
        tcp: LATCHED,
        dds: stream(DDS_STATS_DEPTH),
        ..row(FleetTopic::SlamStats, "/robotN/slam_stats", Float32MultiArray::TYPE, "stats")
    },
    OutgoingTopic {
        tcp: Some(Delivery::StreamOfRobots { depth_per_robot: TCP_TRANSFORMS_DEPTH }),
        dds: stream(DDS_TRANSFORMS_DEPTH),
        ..row(FleetTopic::Transforms, "/tf", TfMessage::TYPE, "robotN/transforms")
    },
    OutgoingTopic {
        tcp: LATCHED,
        dds: LATCHED,
        robots_publish_it: true,
        ..row(FleetTopic::StaticTransforms, "/tf_static", TfMessage::TYPE, "robotN/transforms")
    },
    OutgoingTopic {
        dds: stream(DDS_TRANSFORMS_DEPTH),
        external_only: true,
        ..row(FleetTopic::RobotTransforms, "/robotN/tf", TfMessage::TYPE, "robotN/pose_estimate")
    },
    OutgoingTopic {
        tcp: stream(1),
        dds: stream(DDS_CLOCK_DEPTH),
        robots_publish_it: true,
        ..row(FleetTopic::Clock, "/clock", Clock::TYPE, "clock")
    },
    OutgoingTopic {
        tcp: LATCHED,
        dds: LATCHED,
        ..row(FleetTopic::MergedMap, "/merged_map", OccupancyGrid::TYPE, "merged_map")
    },
    OutgoingTopic {
        tcp: LATCHED,
        dds: LATCHED,
        ..row(FleetTopic::MergedMapAlias, "/map", OccupancyGrid::TYPE, "merged_map")
    },
    OutgoingTopic {
        tcp: stream(DEPTH_DEFAULT),
        dds: stream(DDS_MAP_UPDATES_DEPTH),
        ..row(FleetTopic::MapUpdates, "/map_updates", OccupancyGridUpdate::TYPE, "merged_map")
    },
    OutgoingTopic {
        tcp: stream(MAP_TILES_DEPTH),
        ..row(FleetTopic::MergedMapTiles, "/merged_map_tiles", MapTiles::TYPE, "merged_map")
    },
    OutgoingTopic {
        tcp: stream(1),
        dds: stream(1),
        ..row(FleetTopic::MergedMapProbability, "/merged_map_probability", OccupancyGrid::TYPE, "merged_map")
    },
    OutgoingTopic {
        tcp: LATCHED,
        dds: LATCHED,
        ..row(FleetTopic::MergeEdges, "/merge_edges", Text::TYPE, "merge_edges")
    },
    OutgoingTopic {
        tcp: LATCHED,
        dds: LATCHED,
        ..row(FleetTopic::NavigationState, "/robotN/navigation_state", Text::TYPE, "robotN/navigation_state")
    },
    OutgoingTopic {
        tcp: LATCHED,
        dds: LATCHED,
        ..row(FleetTopic::Plan, "/robotN/plan", PathMessage::TYPE, "robotN/plan")
    },
    OutgoingTopic {
        tcp: LATCHED,
        dds: LATCHED,
        ..row(FleetTopic::ExplorationState, "/explore/state", Text::TYPE, "exploration_state")
    },
    OutgoingTopic {
        tcp: LATCHED,
        dds: LATCHED,
        ..row(FleetTopic::ExclusionZones, "/exclusion_zones", Text::TYPE, "exclusion_zones")
    },
    OutgoingTopic {
        tcp: LATCHED,
        dds: LATCHED,
        ..row(FleetTopic::SelectedRobot, "/selected_robot", Int32::TYPE, "")
    },
    OutgoingTopic {
        tcp: LATCHED,
        dds: LATCHED,
        ..row(FleetTopic::EmergencyStop, "/emergency_stop", Bool::TYPE, "")
    },
];

impl FleetTopic {
    /// Returns the topic's row.
    pub fn row(self) -> &'static OutgoingTopic {
        &OUTGOING_TOPICS[self as usize]
    }
}

impl OutgoingTopic {
    /// Returns whether the topic exists once for each robot.
    pub fn is_per_robot(&self) -> bool {
        self.name.starts_with(ROBOT_PREFIX)
    }

    /// Returns whether the bridge publishes the topic on DDS, in a world of external robots or of simulated ones.
    pub(crate) fn is_on_dds(&self, is_external: bool) -> bool {
        self.dds.is_some() && if is_external { !self.robots_publish_it } else { !self.external_only }
    }

    /// Returns whether the topic's name is the same in every namespace.
    pub fn is_global(&self) -> bool {
        matches!(self.topic, FleetTopic::Transforms | FleetTopic::StaticTransforms | FleetTopic::Clock)
    }

    /// Returns whether the topic has no messages of its own: it repeats those of `/merged_map`.
    pub(crate) fn is_alias(&self) -> bool {
        self.topic == FleetTopic::MergedMapAlias
    }

    /// Returns whether the topic under a plain name is another topic of the fleet: `/map` or `/tf`.
    fn has_plain_twin(&self) -> bool {
        matches!(self.topic, FleetTopic::Map | FleetTopic::RobotTransforms)
    }

    /// Returns the ROS names in a fleet, in order of the robots.
    ///
    /// A robot with plain names has no map of its own: its map would be `/map`, which is the fleet's.
    pub fn names(&self, robots: &RobotNames) -> Vec<String> {
        match self.name.strip_prefix(ROBOT_PREFIX) {
            Some(_) if robots.is_plain() && self.has_plain_twin() => Vec::new(),
            Some(rest) => robots.robots().map(|robot| robots.topic(robot, rest)).collect(),
            None => vec![self.name.to_owned()],
        }
    }
}

impl Delivery {
    /// Returns how many messages wait for a slow subscriber in a fleet of `robot_count`.
    pub fn depth(self, robot_count: usize) -> usize {
        match self {
            Self::Stream { depth } => depth,
            Self::StreamOfRobots { depth_per_robot } => depth_per_robot * robot_count,
            Self::Latched => 1,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_row_is_at_the_index_of_its_topic() {
        for (index, row) in OUTGOING_TOPICS.iter().enumerate() {
            assert_eq!(row.topic as usize, index, "{}", row.name);
            assert!(row.tcp.is_some() || row.dds.is_some(), "{} is on no transport", row.name);
        }
    }

    #[test]
    fn every_published_type_has_a_schema() {
        for row in &OUTGOING_TOPICS {
            let schema = ros_messages::schema::schema(row.message_type);
            assert!(schema.is_some(), "{} has no schema", row.message_type);
        }
    }

    #[test]
    fn a_topic_per_robot_is_named_after_each_robot() {
        assert_eq!(FleetTopic::Scan.row().names(&2.into()), ["/robot1/scan", "/robot2/scan"]);
        assert_eq!(FleetTopic::Clock.row().names(&2.into()), ["/clock"]);
        let plain = RobotNames::new(vec![String::new()]).unwrap();
        assert_eq!(FleetTopic::Scan.row().names(&plain), ["/scan"]);
        assert!(FleetTopic::Map.row().names(&plain).is_empty(), "/map is the merged map");
    }
}
