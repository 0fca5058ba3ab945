//! The estimate of a source's clock, and what an external world accepts and refuses.

use super::suspects::STEP_MESSAGES;
use super::*;
use msg::BEAMS_MAX;
use proptest::prelude::*;
use ros_messages::cdr::Reader;
use ros_messages::{self, LaserScan, Message, TfMessage, TransformStamped, encode};
use std::cell::RefCell;
use std::rc::Rc;

const SECOND: i64 = 1_000_000_000;

fn robot(number: usize) -> RobotId {
    RobotId::new(number).unwrap()
}

/// Sends a message every 50 ms, delayed by `delay_s(i)`; returns the clock, and the largest error of a stamp after
/// the first `settle` messages.
fn measure(
    offset_s: f64,
    drift_ppm: f64,
    messages: usize,
    settle: usize,
    delay_s: impl Fn(usize) -> f64,
) -> (SourceClock, f64) {
    let mut clock = SourceClock::new(ClockOffset::Measured);
    let mut worst: f64 = 0.0;
    for i in 0..messages {
        let at_s = 1000.0 + 0.05 * i as f64;
        let there_s = at_s * (1.0 + drift_ppm * 1e-6) + offset_s;
        let stamp = clock.convert(Stamp::from_seconds(there_s), Stamp::from_seconds(at_s + delay_s(i)));
        if i >= settle {
            let stamp = stamp.expect("no message of a clock that was not set is dropped");
            worst = worst.max((stamp - Stamp::from_seconds(at_s)).abs());
        }
    }
    (clock, worst)
}

/// A pseudo-random number in 0..1.
fn noise(i: usize) -> f64 {
    (i.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 40) as f64 / (1_u64 << 24) as f64
}

#[test]
fn an_offset_of_five_seconds_is_measured() {
    let wifi = |i: usize| 0.001 + 0.02 * noise(i).powi(4);
    let (clock, worst) = measure(5.0, 0.0, 1200, 20, wifi);
    let estimate = clock.estimate().unwrap();
    assert!((estimate.offset_s - 5.0).abs() < 2e-3, "{estimate:?}");
    assert!(worst < 3e-3, "{worst}");
    assert!(estimate.spread_p95_ms > 5.0 && estimate.spread_p95_ms < 21.0, "{estimate:?}");
    assert_eq!((estimate.messages, estimate.steps), (1200, 0));
}

#[test]
fn a_drifting_clock_is_followed_and_a_step_is_found() {
    let (clock, worst) = measure(-5.0, 80.0, 6000, 600, |i| 0.001 + 0.004 * noise(i));
    let estimate = clock.estimate().unwrap();
    assert!((estimate.drift_ppm - 80.0).abs() < 15.0, "{estimate:?}");
    assert!(worst < 3e-3, "{worst}");

    let mut clock = SourceClock::new(ClockOffset::Measured);
    for (offset_s, from) in [(5.0, 0), (60.0, 400), (-3.0, 800)] {
        for i in from..from + 400 {
            let at_s = 0.05 * i as f64;
            let _ = clock.convert(Stamp::from_seconds(at_s + offset_s), Stamp::from_seconds(at_s + 0.002));
        }
        let estimate = clock.estimate().unwrap();
        assert!((estimate.offset_s - offset_s).abs() < 3e-3, "{offset_s}: {estimate:?}");
    }
    let estimate = clock.estimate().unwrap();
    assert_eq!((estimate.steps, estimate.outliers), (2, 4), "ahead, the fifth message is believed");
    assert!((clock.take_step().unwrap() - (-3.0 - 5.0)).abs() < 0.01);
    assert_eq!(clock.take_step(), None);
}

#[test]
fn a_stalled_network_is_not_taken_for_a_clock_step() {
    // Every 10 s the network stalls for 2 s, and then delivers everything at once.
    let stalls = |i: usize| 0.001 + if i % 200 < 40 { 0.05 * (40 - i % 200) as f64 } else { 0.0 };
    let (clock, worst) = measure(5.0, 0.0, 2000, 60, stalls);
    assert_eq!(clock.estimate().unwrap().steps, 0);
    assert!(worst < 3e-3, "{worst}");
}

#[test]
fn a_first_message_that_is_faster_than_the_others_is_believed() {
    let (clock, worst) = measure(5.0, 0.0, 400, 0, |i| if i == 0 { 0.001 } else { 0.001 + 0.2 * noise(i) });
    assert_eq!((clock.estimate().unwrap().steps, clock.estimate().unwrap().outliers), (0, 0));
    assert!(worst < 3e-3, "{worst}");
}

#[test]
fn a_fixed_offset_is_applied_unmeasured() {
    let mut clock = SourceClock::new(ClockOffset::Fixed(5.0));
    assert_eq!(clock.convert(Stamp(7 * SECOND), Stamp(0)), Ok(Stamp(2 * SECOND)));
    assert_eq!(clock.estimate().unwrap().offset_s, 5.0);
    let read = |text: &str| serde_json::from_str::<ClockOffset>(text);
    assert_eq!(read("\"measured\"").unwrap(), ClockOffset::Measured);
    assert_eq!(read("-2.5").unwrap(), ClockOffset::Fixed(-2.5));
    assert!(read("\"guessed\"").is_err());
    assert_eq!(serde_json::to_string(&ClockOffset::Measured).unwrap(), "\"measured\"");
}

proptest! {
    #[test]
    fn a_constant_delay_is_measured_at_any_offset(offset_s in -1e9_f64..1e9, delay_s in 0.0..0.1) {
        let (clock, worst) = measure(offset_s, 0.0, 300, 0, |_| delay_s);
        prop_assert!((clock.estimate().unwrap().offset_s - offset_s + delay_s).abs() < 1e-3);
        prop_assert!(worst < delay_s + 1e-3, "{worst}");
    }

    #[test]
    fn a_single_wrong_stamp_at_any_place_changes_nothing(
        place in prop_oneof![Just(0), Just(1), 0_usize..300],
        size_s in prop_oneof![0.06..0.9_f64, 1.1..10.0, 10.0..1e9],
        is_ahead in any::<bool>(),
        copies in 1_usize..20,
    ) {
        let mut clock = SourceClock::new(ClockOffset::Measured);
        let mut refused = 0;
        for i in 0..400 {
            let at_s = 1000.0 + 0.05 * i as f64;
            let received = Stamp::from_seconds(at_s + 0.002);
            if i == place {
                // A message can have several transforms, all with the same stamp.
                let wrong_s = at_s + 5.0 + if is_ahead { size_s } else { -size_s };
                for _ in 0..copies {
                    let _ = clock.convert(Stamp::from_seconds(wrong_s), received);
                }
                continue;
            }
            match clock.convert(Stamp::from_seconds(at_s + 5.0), received) {
                Ok(stamp) if place > 0 || i > STEP_MESSAGES => {
                    prop_assert!((stamp - received).abs() < 1e-3, "{}", stamp - received);
                }
                Ok(_) => {}
                Err(_) => refused += 1,
            }
        }
        prop_assert_eq!(clock.estimate().unwrap().steps, 0);
        // If the first message is wrong, the next ones are not believed until they agree.
        prop_assert!(refused == 0 || (place == 0 && refused < STEP_MESSAGES), "{refused}");
        prop_assert_eq!(clock.take_step(), None);
    }

    #[test]
    fn any_stamps_give_a_finite_estimate(stamps in proptest::collection::vec((any::<i32>(), any::<u32>(), 0_i64..SECOND), 1..300)) {
        let mut clock = SourceClock::new(ClockOffset::Measured);
        let mut received = 0;
        for (sec, nanosec, step) in stamps {
            received += step;
            let _ = clock.convert(Stamp(i64::from(sec) * SECOND + i64::from(nanosec)), Stamp(received));
        }
        let estimate = clock.estimate().unwrap();
        prop_assert!(estimate.offset_s.is_finite() && estimate.spread_p95_ms.is_finite());
    }

    #[test]
    fn stamps_stay_in_order_without_a_clock_step(
        delays in proptest::collection::vec(0.0..0.04_f64, 100..400),
    ) {
        let mut clock = SourceClock::new(ClockOffset::Measured);
        let mut before = Stamp(i64::MIN);
        for (i, delay_s) in delays.iter().enumerate() {
            let at_s = 0.05 * i as f64;
            let stamp = clock.convert(Stamp::from_seconds(at_s + 5.0), Stamp::from_seconds(at_s + delay_s));
            let stamp = stamp.unwrap();
            prop_assert!(stamp > before);
            before = stamp;
        }
    }
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
            WorldMessage::Transforms(robot, transforms) => {
                let names = transforms
                    .transforms()
                    .iter()
                    .map(|transform| RobotFrame::from_code(transform.child_frame).unwrap().name());
                format!("{robot} transforms {}", names.collect::<Vec<_>>().join(" "))
            }
            WorldMessage::Clock(clock) => format!("clock {}", clock.header.stamp.0),
        });
    });
    (world, messages)
}

fn payload(message: &impl Message) -> Vec<u8> {
    let mut bytes = Vec::new();
    encode(message, &mut bytes);
    bytes
}

fn exact() -> SourceClock {
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
        ranges: vec![1.0, 9.0, 0.05],
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
    assert_eq!(*messages.borrow(), ["robot2 scan 5 [1.0, inf, NaN]"]);
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

fn edge(parent: &str, child: &str, stamp: i64, x_m: f64, rotation: [f64; 4]) -> TransformStamped {
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
