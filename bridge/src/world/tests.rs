//! What an external world accepts and refuses.

use super::suspects::STEP_MESSAGES;
use super::*;
use msg::BEAMS_MAX;
use ros_messages::cdr::Reader;
use ros_messages::{self, LaserScan, Message, TfMessage, TransformStamped, encode};
use std::cell::RefCell;
use std::rc::Rc;

const SECOND: i64 = 1_000_000_000;

fn robot(number: usize) -> RobotId {
    RobotId::new(number).unwrap()
}

type Messages = Rc<RefCell<Vec<String>>>;

/// A world of two robots, and what it messages.
fn world() -> (ExternalWorld, Messages) {
    let messages = Messages::default();
    let sink = messages.clone();
    let world = ExternalWorld::new(2, move |message| {
        sink.borrow_mut().push(match message {
            WorldMessage::Scan(robot, scan) => {
                format!("{robot} scan {} {:?}", scan.header.stamp.0, scan.ranges_m())
            }
            WorldMessage::Odometry(robot, odometry) => {
                let (pose, v, w) = (odometry.odom_from_base, odometry.linear_m_s, odometry.angular_rad_s);
                format!("{robot} odometry {:.2} {:.2} {v:.2} {w:.2}", pose.x_m, pose.yaw_rad)
            }
            WorldMessage::OdometryRestart(robot) => format!("{robot} odometry begins anew"),
            WorldMessage::Transforms(robot, transforms) => {
                let names = transforms
                    .transforms()
                    .iter()
                    .map(|transform| RobotFrame::from_code(transform.child_frame).unwrap().name());
                format!("{robot} transforms {}", names.collect::<Vec<_>>().join(" "))
            }
            WorldMessage::Battery(robot, battery) => format!("{robot} battery {}", battery.percentage),
            WorldMessage::Clock(clock) => format!("clock {}", clock.header.stamp.0),
        });
    });
    (world, messages)
}

pub(super) fn payload(message: &impl Message) -> Vec<u8> {
    let mut bytes = Vec::new();
    encode(message, &mut bytes);
    bytes
}

pub(super) fn exact() -> SourceClock {
    SourceClock::new(ClockOffset::Fixed(0.0))
}

fn scan_message(stamp: i64) -> LaserScan {
    LaserScan {
        stamp: Stamp(stamp),
        angle_min: -0.5,
        angle_increment: 0.5,
        scan_time: 0.1,
        range_min: 0.1,
        range_max: 3.5,
        ranges: vec![1.0, 9.0, 0.05, f32::NEG_INFINITY],
        ..LaserScan::default()
    }
}

fn receive_scan(world: &mut ExternalWorld, number: usize, message: &LaserScan) -> Result<(), WorldError> {
    let bytes = payload(message);
    let from = Reader::new(&bytes).unwrap();
    world.receive(1, &mut exact(), Incoming::Scan(robot(number), from), message.stamp)
}

#[test]
fn a_scan_is_checked_and_its_ranges_are_limited() {
    let (mut world, messages) = world();
    assert_eq!(receive_scan(&mut world, 2, &scan_message(5)), Ok(()));
    assert_eq!(*messages.borrow(), ["robot2 scan 5 [1.0, inf, NaN, -inf]"]);
    let mut refused = |change: &dyn Fn(&mut LaserScan)| {
        let mut message = scan_message(6);
        change(&mut message);
        receive_scan(&mut world, 2, &message).unwrap_err().to_string()
    };
    assert!(refused(&|m| m.stamp = Stamp(5)).contains("not newer"));
    assert!(refused(&|m| m.ranges = vec![1.0; BEAMS_MAX + 1]).contains("4097 beams"));
    assert!(refused(&|m| m.ranges.clear()).contains("0 beams"));
    assert!(refused(&|m| m.angle_increment = f32::NAN).contains("NaN"));
    assert!(refused(&|m| m.angle_increment = 7.0).contains("one turn"));
    assert!(refused(&|m| m.range_max = f32::INFINITY).contains("range_max"));
    assert!(refused(&|m| m.scan_time = -1.0).contains("scan_time"));
    assert!(receive_scan(&mut world, 3, &scan_message(6)).unwrap_err().to_string().contains("1 to 2"));
    assert_eq!(messages.borrow().len(), 1);
}

pub(super) fn edge(parent: &str, child: &str, stamp: i64, x_m: f64, rotation: [f64; 4]) -> TransformStamped {
    TransformStamped {
        stamp: Stamp(stamp),
        frame_id: parent.into(),
        child_frame_id: child.into(),
        translation: [x_m, 0.0, 0.0],
        rotation,
    }
}

const LEVEL: [f64; 4] = [0.0, 0.0, 0.0, 1.0];

fn receive_tree(
    world: &mut ExternalWorld,
    source: SourceId,
    received: i64,
    transforms: Vec<TransformStamped>,
) -> Result<(), WorldError> {
    let bytes = payload(&TfMessage { transforms });
    let from = Reader::new(&bytes).unwrap();
    world.receive(source, &mut exact(), Incoming::Transforms(from), Stamp(received))
}

#[test]
fn odometry_is_taken_from_transforms_in_any_naming_style() {
    let (mut world, messages) = world();
    let turned = [0.0, 0.0, 0.05_f64.sin(), 0.05_f64.cos()];
    let first = vec![
        edge("odom_1", "base_footprint_1", 0, 1.0, LEVEL),
        edge("base_footprint_1", "base_link_1", 0, 0.0, LEVEL),
        edge("robot2/odom", "robot2/base_link", 0, 0.0, LEVEL),
        edge("world", "table", 0, 0.0, LEVEL),
    ];
    assert_eq!(receive_tree(&mut world, 1, 0, first), Ok(()));
    let second = vec![
        edge("odom_1", "base_footprint_1", SECOND / 2, 1.1, turned),
        edge("robot2/odom", "robot2/base_link", 0, 0.0, LEVEL),
    ];
    assert_eq!(receive_tree(&mut world, 1, SECOND / 2, second), Ok(()));
    let expected = [
        "robot1 odometry 1.00 0.00 0.00 0.00",
        "robot2 odometry 0.00 0.00 0.00 0.00",
        "robot1 transforms base_footprint base_link",
        "robot2 transforms base_link",
        "robot1 odometry 1.10 0.10 0.20 0.20",
        "robot1 transforms base_footprint",
        "robot2 transforms base_link",
    ];
    assert_eq!(*messages.borrow(), expected, "robot 2's pose is sent once for one stamp");
}

#[test]
fn a_robot_with_odometry_in_tf_is_located_by_that_and_not_by_its_odometry_topic() {
    let (mut world, messages) = world();
    let topic = |world: &mut ExternalWorld, stamp: i64, x_m: f64| {
        let pose = ros_messages::Odometry {
            stamp: Stamp(stamp),
            position: [x_m, 0.0, 0.0],
            orientation: LEVEL,
            ..Default::default()
        };
        let bytes = payload(&pose);
        let message = Incoming::Odometry(robot(1), Reader::new(&bytes).unwrap());
        assert_eq!(world.receive(1, &mut exact(), message, Stamp(stamp)), Ok(()));
    };
    topic(&mut world, 0, 1.0);
    // Two stamps, so that each would be new: TF's estimate is another one.
    receive_tree(&mut world, 1, 5, vec![edge("odom_1", "base_link_1", 5, 2.0, LEVEL)]).unwrap();
    topic(&mut world, 10, 1.1);
    receive_tree(&mut world, 1, 15, vec![edge("odom_1", "base_link_1", 15, 2.0, LEVEL)]).unwrap();
    let taken = |prefix: &str| messages.borrow().iter().filter(|m| m.starts_with(prefix)).count();
    assert_eq!(taken("robot1 odometry 2.00 0.00 0.00"), 2, "no velocity from one to the other: {messages:?}");
    assert_eq!(taken("robot1 odometry 1."), 1);
    // A robot whose TF ends is located by its topic again.
    topic(&mut world, 4 * SECOND, 1.2);
    assert_eq!(taken("robot1 odometry 1.20"), 1);
}

#[test]
fn a_driver_that_is_started_again_is_another_writer_of_odometry() {
    let (mut world, messages) = world();
    let mut send = |publisher: u8, seconds: i64, x: f64| {
        let transform = edge("odom_1", "base_footprint_1", seconds * SECOND, x, LEVEL);
        let bytes = payload(&TfMessage { transforms: vec![transform] });
        let sender = Sender { source: 1, publisher: Some([publisher; 16]) };
        let message = Incoming::Transforms(Reader::new(&bytes).unwrap());
        world.receive(sender, &mut exact(), message, Stamp(seconds * SECOND)).unwrap();
    };
    send(1, 0, 0.0);
    send(1, 1, 3.0);
    send(2, 5, 0.05);
    send(2, 6, 1.0);
    // Its odometry goes on: a filter before the driver was started again.
    send(3, 10, 1.5);
    let taken = messages.borrow();
    let taken: Vec<&str> =
        taken.iter().map(String::as_str).filter(|message| message.contains("odometry")).collect();
    assert_eq!(
        taken,
        [
            "robot1 odometry 0.00 0.00 0.00 0.00",
            "robot1 odometry 3.00 0.00 3.00 0.00",
            "robot1 odometry begins anew",
            "robot1 odometry 0.05 0.00 0.00 0.00",
            "robot1 odometry 1.00 0.00 0.95 0.00",
            "robot1 odometry 1.50 0.00 0.00 0.00",
        ]
    );
}

#[test]
fn a_client_that_comes_back_at_the_origin_is_another_writer_of_odometry() {
    let (mut world, messages) = world();
    let send = |world: &mut ExternalWorld, client: SourceId, tenths: i64, x: f64| {
        let stamp = tenths * SECOND / 10;
        let tree = vec![edge("odom_1", "base_footprint_1", stamp, x, LEVEL)];
        receive_tree(world, client, stamp, tree).unwrap();
        let restarts = messages.borrow().iter().filter(|message| message.contains("anew")).count();
        (restarts, std::iter::from_fn(|| world.take_notice()).collect::<String>())
    };
    (0..5).for_each(|tenth| assert_eq!(send(&mut world, 7, tenth, 0.03 * tenth as f64).0, 0));
    world.disconnect(7);
    // Its odometry goes on: the network was away.
    assert_eq!(send(&mut world, 8, 20, 0.4), (0, String::new()));
    world.disconnect(8);
    // A simulation was started again, and stands 0.4 m nearer to its origin.
    let (restarts, reported) = send(&mut world, 9, 21, 0.0);
    assert!(restarts == 1 && reported.contains("robot1: its driver was started again"), "{reported}");
}

#[test]
fn odometry_that_loses_its_origin_below_one_publisher_is_another_writer() {
    let (mut world, messages) = world();
    let mut send = |publisher: Option<PublisherId>, tenths: i64, x: f64| {
        let stamp = tenths * SECOND / 10;
        let transform = edge("odom_1", "base_footprint_1", stamp, x, LEVEL);
        let bytes = payload(&TfMessage { transforms: vec![transform] });
        let message = Incoming::Transforms(Reader::new(&bytes).unwrap());
        world.receive(Sender { source: 1, publisher }, &mut exact(), message, Stamp(stamp)).unwrap();
        let restarts = messages.borrow().iter().filter(|message| message.contains("anew")).count();
        (restarts, std::iter::from_fn(|| world.take_notice()).collect::<String>())
    };
    let driver = Some([1; 16]);
    (0..10).for_each(|tenth| assert_eq!(send(driver, tenth, 0.2 * tenth as f64), (0, String::new())));
    let (restarts, reported) = send(driver, 10, 0.0);
    assert!(restarts == 1 && reported.contains("robot1: odometry jumps 1.80 m"), "{reported}");
    assert_eq!(send(driver, 11, 0.02), (1, String::new()));
    assert_eq!(send(driver, 20, 0.4), (1, String::new()));
    // After a silence it begins at the origin; a client on TCP may be a simulation, in which the robot was put there.
    assert_eq!(send(driver, 100, 0.0).0, 2);
    assert_eq!(send(None, 1000, 0.0).0, 3, "another sender");
    let (restarts, reported) = send(None, 1001, 3.0);
    assert!(restarts == 3 && reported.contains("the scans tell"), "{reported}");
}

#[test]
fn a_clock_that_was_set_back_is_believed_when_several_scans_agree() {
    let (mut world, messages) = world();
    let mut send = |stamp: i64, received: i64| {
        let bytes = payload(&scan_message(stamp));
        let message = Incoming::Scan(robot(1), Reader::new(&bytes).unwrap());
        let taken = world.receive(1, &mut exact(), message, Stamp(received)).is_ok();
        (taken, world.take_step())
    };
    let hour = 3600 * SECOND;
    assert_eq!(send(hour, hour), (true, None));
    // One old message, or the same one again and again, is no other clock.
    (0..20).for_each(|_| assert_eq!(send(5, hour), (false, None)));
    assert_eq!(send(hour + SECOND, hour + SECOND), (true, None));
    let after: Vec<_> = (2..22).map(|n| send(n * SECOND, hour + n * SECOND)).collect();
    let first = STEP_MESSAGES - 1;
    assert!(after[..first].iter().all(|answer| *answer == (false, None)), "{after:?}");
    assert_eq!(after[first], (true, Some((robot(1), -3600.0))));
    assert!(after[first + 1..].iter().all(|answer| *answer == (true, None)), "{after:?}");
    assert_eq!(messages.borrow().len(), 2 + after.len() - first);
}

#[test]
fn scans_of_a_lidar_that_hangs_are_refused_while_the_robot_moves() {
    let (mut world, _) = world();
    let mut send = |tenths: i64, x_m: f64, range_m: f32| {
        let stamp = tenths * SECOND / 10;
        receive_tree(&mut world, 1, stamp, vec![edge("odom_1", "base_link_1", stamp, x_m, LEVEL)]).unwrap();
        receive_scan(&mut world, 1, &LaserScan { ranges: vec![range_m; 3], ..scan_message(stamp) })
    };
    let refused: Vec<bool> = (0..30).map(|k| send(k, 0.02 * k as f64, 1.0).is_err()).collect();
    assert!(!refused[15] && refused[16..].iter().all(|is| *is), "{refused:?}");
    assert!(send(30, 0.6, 1.0).unwrap_err().to_string().contains("robot1: its scans repeat"));
    assert_eq!(send(31, 0.6, 1.1), Ok(()));
    // Odometry that jumps is no motion.
    (32..60).for_each(|k| assert_eq!(send(k, if k < 40 { 0.6 } else { 5.0 }, 1.1), Ok(())));
}

#[test]
fn only_slams_own_transform_is_refused() {
    let (mut world, messages) = world();
    for (parent, child) in
        [("map", "odom_1"), ("map_1", "odom_1"), ("robot1/map", "robot1/odom"), ("map", "odom")]
    {
        messages.borrow_mut().clear();
        let stamp = messages.borrow().len() as i64;
        let tree =
            vec![edge(parent, child, stamp, 0.0, LEVEL), edge("odom_1", "base_link_1", stamp, 0.0, LEVEL)];
        let why = receive_tree(&mut world, 1, 0, tree).unwrap_err();
        assert!(matches!(why, WorldError::Correction { .. }), "{why}");
        assert!(why.to_string().contains("SLAM owns map -> odom"), "{why}");
        assert!(
            messages.borrow().contains(&"robot1 transforms base_link".into()),
            "the rest is taken: {messages:?}"
        );
    }
}

#[test]
fn the_error_names_the_invalid_transform() {
    let (mut world, messages) = world();
    let mut refused = |transform: TransformStamped| {
        receive_tree(&mut world, 1, 0, vec![transform]).unwrap_err().to_string()
    };
    let half = 0.5_f64.sqrt();
    assert!(refused(edge("odom_1", "base_link_1", 0, 0.0, [half, 0.0, 0.0, half])).contains("leans by 90"));
    assert!(refused(edge("odom_1", "base_link_1", 0, 0.0, [0.0; 4])).contains("unit quaternion"));
    assert!(refused(edge("odom_1", "base_link_1", 0, f64::NAN, LEVEL)).contains("NaN"));
    assert!(refused(edge("odom_2", "base_link_1", 0, 0.0, LEVEL)).contains("a frame of robot1"));
    assert!(refused(edge("odom_3", "base_link_3", 0, 0.0, LEVEL)).contains("robots 1 to 2"));
    assert_eq!(messages.borrow().len(), 0);
}

#[test]
fn a_robot_has_one_source_at_a_time() {
    let (mut world, _) = world();
    let tree = |stamp| vec![edge("odom_1", "base_link_1", stamp, 0.0, LEVEL)];
    assert_eq!(receive_tree(&mut world, 1, 0, tree(0)), Ok(()));
    let other = receive_tree(&mut world, 2, SECOND, tree(SECOND)).unwrap_err();
    assert!(other.to_string().contains("robot1 has another source"), "{other}");
    assert_eq!(
        receive_tree(&mut world, 2, 3 * SECOND, tree(3 * SECOND)),
        Ok(()),
        "the first has been silent for 2 s"
    );
    world.disconnect(2);
    assert_eq!(receive_tree(&mut world, 1, 3 * SECOND, tree(4 * SECOND)), Ok(()), "the second left");
}

#[test]
fn the_clock_does_not_run_backwards() {
    let (mut world, messages) = world();
    for stamp in [5, 7, 6, 8] {
        let bytes = payload(&ros_messages::Clock { clock: Stamp(stamp) });
        let from = Reader::new(&bytes).unwrap();
        world.receive(1, &mut exact(), Incoming::Clock(from), Stamp(stamp)).unwrap();
    }
    assert_eq!(*messages.borrow(), ["clock 5", "clock 7", "clock 8"]);
}

#[test]
fn plain_frames_on_a_robots_own_topic_are_that_robots() {
    let (mut world, messages) = world();
    let mut send = |transforms: Vec<TransformStamped>| {
        let bytes = payload(&TfMessage { transforms });
        let message = Incoming::RobotTransforms(robot(2), Reader::new(&bytes).unwrap());
        world.receive(7, &mut exact(), message, Stamp(0))
    };
    let tree = vec![
        edge("odom", "base_footprint", 0, 1.0, LEVEL),
        edge("base_footprint", "base_link", 0, 0.0, LEVEL),
    ];
    assert_eq!(send(tree), Ok(()));
    let expected = ["robot2 odometry 1.00 0.00 0.00 0.00", "robot2 transforms base_footprint base_link"];
    assert_eq!(*messages.borrow(), expected);
    let correction = send(vec![edge("map", "odom", 1, 0.0, LEVEL)]);
    assert!(matches!(correction, Err(WorldError::Correction { .. })), "{correction:?}");
}
