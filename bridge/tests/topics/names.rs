//! Robots with names of their own, and one with plain topics and frames, as Unity's Robotics-Nav2-SLAM-Example has it.

use crate::local::LocalClient;
use bridge::ros::{
    self, LaserScan, OccupancyGrid, Odometry, PoseWithCovarianceStamped, TfMessage, TransformStamped, Twist,
    TwistStamped,
};
use bridge::world::{ExternalWorld, WorldMessage};
use bridge::{Bridge, BridgeConfig, FleetMessage, RobotNames};
use msg::{
    GridHeader, GridView, Header, MapTransform, MapTransforms, Monotonic, Pose2, PoseEstimate, RobotId, Stamp,
};
use std::cell::RefCell;
use std::rc::Rc;

type Log = Rc<RefCell<Vec<String>>>;

fn names(names: &[&str]) -> RobotNames {
    RobotNames::new(names.iter().map(|name| (*name).to_owned()).collect()).unwrap()
}

/// A bridge of an external world: what reaches the fleet, and the velocities that reach its robots.
fn external(robots: &[&str]) -> (Bridge, Log) {
    let log = Log::default();
    let (to_world, to_commands) = (log.clone(), log.clone());
    let world = ExternalWorld::new(names(robots), move |message| {
        to_world.borrow_mut().push(match message {
            WorldMessage::Scan(robot, _) => format!("{robot} scan"),
            WorldMessage::Odometry(robot, odometry) => {
                format!("{robot} odometry {:.1}", odometry.odom_from_base.x_m)
            }
            WorldMessage::OdometryRestart(robot) => format!("{robot} odometry restart"),
            WorldMessage::Transforms(robot, transforms) => format!("{robot} links {}", transforms.len),
            WorldMessage::Battery(robot, battery) => format!("{robot} battery {:.2}", battery.percentage),
            WorldMessage::Clock(_) => "clock".into(),
        });
    });
    let on_command = move |robot: RobotId, command: msg::VelocityCommand| {
        // The bridge begins with zeros for all robots.
        if command.linear_m_s != 0.0 {
            to_commands.borrow_mut().push(format!("{robot} {:.2}", command.linear_m_s));
        }
    };
    let stamp_at = |now: Monotonic| Stamp(now.0 as i64);
    (Bridge::with_external_world(BridgeConfig::default(), world, stamp_at, on_command).unwrap(), log)
}

const NOW: Monotonic = Monotonic(1_000_000_000);
const STAMP: Stamp = Stamp(1_000_000_000);

#[test]
fn a_client_that_publishes_for_a_robot_that_the_fleet_does_not_have_is_warned() {
    let bridge = Bridge::new(BridgeConfig::default(), 2, |_, _| {}).unwrap();
    let client = LocalClient::connect(&bridge);
    let warned = |topic: &str| {
        client.publish::<Twist>(topic);
        let frames = client.take_frames();
        let warning = frames.iter().find(|(name, _)| name == "__warn");
        warning.map(|(_, text)| String::from_utf8_lossy(text).into_owned())
    };
    for topic in ["/cmd_vel_9", "/robot9/cmd_vel", "/robot9/goal_pose"] {
        let text = warned(topic).expect(topic);
        assert!(text.contains(topic) && text.contains("robot1, robot2"), "{text}");
    }
    for topic in ["/cmd_vel_2", "/chat_9"] {
        assert_eq!(warned(topic), None, "{topic}");
    }
}

fn scan(frame: &str) -> LaserScan {
    LaserScan {
        stamp: STAMP,
        frame_id: frame.into(),
        angle_increment: 0.1,
        range_min: 0.1,
        range_max: 3.0,
        ranges: vec![1.0; 8],
        ..LaserScan::default()
    }
}

fn edge(parent: &str, child: &str, x_m: f64) -> TransformStamped {
    TransformStamped {
        stamp: STAMP,
        frame_id: parent.into(),
        child_frame_id: child.into(),
        translation: [x_m, 0.0, 0.0],
        rotation: [0.0, 0.0, 0.0, 1.0],
    }
}

fn pose_estimate(x_m: f64) -> PoseEstimate {
    let header = Header { stamp: STAMP, ..Header::default() };
    let pose = Pose2::new(x_m, 0.0, 0.0);
    PoseEstimate { header, map_from_odom: pose, map_from_base: pose, ..PoseEstimate::default() }
}

fn map_transforms(x_m: f64) -> MapTransforms {
    let mut transforms = MapTransforms::default();
    transforms.robots[0] =
        MapTransform { map_from_robot_map: Pose2::new(x_m, 0.0, 0.0), known: 1, map_frame: 0 };
    transforms
}

/// Exactly the topics, frames and values of Unity's example: it publishes `/scan`, `/tf` and `clock` and subscribes to
/// `cmd_vel` and `/map`, without a robot's name anywhere. Where its laser sees nothing, a range is the largest float. Its
/// transforms say that `odom` lies at the origin of `map`, between the robot's own.
#[test]
fn unitys_navigation_example_is_mapped_under_its_own_names() {
    let (bridge, log) = external(&[""]);
    let unity = LocalClient::connect(&bridge);
    unity.publish::<ros::Clock>("clock");
    unity.publish::<LaserScan>("/scan");
    unity.publish::<TfMessage>("/tf");
    unity.subscribe::<Twist>("cmd_vel");
    unity.subscribe::<OccupancyGrid>("/map");
    unity.subscribe::<TfMessage>("/tf");
    unity.send("clock", &ros::Clock { clock: STAMP }, NOW);
    let transforms = vec![
        edge("odom", "base_footprint", 1.5),
        edge("map", "odom", 0.0),
        edge("base_footprint", "base_link", 0.0),
        edge("base_link", "base_scan", 0.0),
        edge("base_link", "wheel_left_link", 0.0),
    ];
    unity.send("/tf", &TfMessage { transforms }, NOW);
    let mut sweep = LaserScan { range_max: 1000.0, scan_time: 0.1, ..scan("base_scan") };
    sweep.ranges[3] = f32::MAX;
    sweep.intensities = vec![0.0; sweep.ranges.len()];
    unity.send("/scan", &sweep, NOW);
    let expected = ["clock", "robot1 odometry 1.5", "robot1 links 4", "robot1 scan"];
    assert_eq!(*log.borrow(), expected);
    let refusals: Vec<_> = unity.take_frames().into_iter().filter(|(name, _)| name == "__error").collect();
    let [(_, text)] = refusals.as_slice() else { panic!("{refusals:?}") };
    assert!(String::from_utf8_lossy(text).contains("map -> odom"), "the rest is taken, and this is said");

    bridge.publish(FleetMessage::PoseEstimate(RobotId::new(1).unwrap(), &pose_estimate(0.5)));
    assert!(
        unity.take::<TfMessage>("/tf").is_empty(),
        "the map's place is not known yet: nothing is invented"
    );
    bridge.publish(FleetMessage::MapTransforms(&map_transforms(2.0)));
    bridge.publish(FleetMessage::PoseEstimate(RobotId::new(1).unwrap(), &pose_estimate(0.5)));
    let frames: Vec<TfMessage> = unity.take("/tf");
    let [tree] = frames.as_slice() else { panic!("{frames:?}") };
    let [of_map] = tree.transforms.as_slice() else { panic!("{tree:?}") };
    assert_eq!((of_map.frame_id.as_str(), of_map.child_frame_id.as_str()), ("map", "odom"));
    assert_eq!(of_map.translation[0], 2.5, "by way of the robot's own map");

    let header = GridHeader { width: 1, height: 1, resolution_m: 0.05, ..GridHeader::default() };
    bridge.publish(FleetMessage::MergedMap(GridView::new(&header, &[100]).unwrap()));
    let maps: Vec<OccupancyGrid> = unity.take("/map");
    assert_eq!((maps[0].frame_id.as_str(), maps[0].data.as_slice()), ("map", &[100][..]));

    let driver = LocalClient::connect(&bridge);
    driver.publish::<Twist>("/cmd_vel");
    driver.send("/cmd_vel", &Twist { linear: [0.1, 0.0, 0.0], ..Twist::default() }, NOW);
    let velocities: Vec<Twist> = unity.take("cmd_vel");
    let moving = velocities.iter().filter(|twist| twist.linear[0] != 0.0);
    assert_eq!(moving.count(), 1, "each velocity once: {velocities:?}");
    assert_eq!(log.borrow().last().map(String::as_str), Some("robot1 0.10"));
}

#[test]
fn robots_have_any_names_and_namespaces() {
    let (bridge, log) = external(&["alice", "lab/bob"]);
    let client = LocalClient::connect(&bridge);
    client.publish::<LaserScan>("/lab/bob/scan");
    client.publish::<Odometry>("/alice/odom");
    client.publish::<TfMessage>("/tf");
    client.publish::<Twist>("/lab/bob/cmd_vel");
    client.subscribe::<PoseWithCovarianceStamped>("/lab/bob/pose");
    client.send("/lab/bob/scan", &scan("anything"), NOW);
    let odometry = Odometry {
        stamp: STAMP,
        frame_id: "odom".into(),
        child_frame_id: "base_footprint".into(),
        position: [0.7, 0.0, 0.0],
        orientation: [0.0, 0.0, 0.0, 1.0],
        ..Odometry::default()
    };
    client.send("/alice/odom", &odometry, NOW);
    client.send(
        "/tf",
        &TfMessage { transforms: vec![edge("odom_lab_bob", "base_footprint_lab_bob", 0.3)] },
        NOW,
    );
    client.send("/lab/bob/cmd_vel", &Twist { linear: [0.1, 0.0, 0.0], ..Twist::default() }, NOW);
    let expected = [
        "robot2 scan",
        "robot1 odometry 0.7",
        "robot1 links 1",
        "robot2 odometry 0.3",
        "robot2 links 1",
        "robot2 0.10",
    ];
    assert_eq!(*log.borrow(), expected);
    bridge.publish(FleetMessage::PoseEstimate(RobotId::new(2).unwrap(), &pose_estimate(1.0)));
    let poses: Vec<PoseWithCovarianceStamped> = client.take("/lab/bob/pose");
    assert_eq!(poses[0].frame_id, "map_lab_bob");
}

#[test]
fn a_stamped_velocity_on_the_plain_name_is_heard_by_its_type() {
    let (bridge, log) = external(&["alice"]);
    let client = LocalClient::connect(&bridge);
    client.publish::<TwistStamped>("/cmd_vel");
    let twist = Twist { linear: [0.1, 0.0, 0.0], ..Twist::default() };
    client.send("/cmd_vel", &TwistStamped { stamp: STAMP, frame_id: String::new(), twist }, NOW);
    assert!(client.take::<Twist>("/cmd_vel").is_empty());
    assert_eq!(*log.borrow(), ["robot1 0.10"]);
}
