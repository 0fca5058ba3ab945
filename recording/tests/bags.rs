//! Bags that could give a silently wrong map: of several robots and scanners, other mounts, swept scans, clocks set back.

mod messages;

use messages::{SECOND, file, odometry, payload, read, scan, scan_buffer, transform};
use msg::{Pose2, Stamp};
use recording::RecordingReader;
use recording::bag::{Bag, BagError, BagOptions, BagReader, RecordedTimes};
use ros_messages::{LaserScan, Message, Odometry as RosOdometry, TfMessage, TransformStamped};
use std::f64::consts::{FRAC_1_SQRT_2, PI};

type Messages = Vec<(&'static str, &'static str, i64, Vec<u8>)>;

fn tf(transforms: Vec<TransformStamped>) -> Vec<u8> {
    payload(&TfMessage { transforms })
}

fn mounted(rotation: [f64; 4], x: f64) -> TransformStamped {
    TransformStamped { rotation, ..transform("base_footprint", "base_scan", [x, 0.0, 0.2], 0) }
}

/// Two seconds of a robot: odometry at 20 Hz, and scans at 10 Hz, of a scanner with this mount.
fn robot(mount: TransformStamped) -> Messages {
    let mut messages: Messages = vec![("/tf_static", TfMessage::TYPE, 0, tf(vec![mount]))];
    for step in 0..40 {
        let (at, x) = (step * SECOND / 20, step as f64 * 0.01);
        messages.push(("/odom", RosOdometry::TYPE, at, payload(&odometry(at, x, 0.1))));
        if step % 2 == 0 {
            messages.push(("/scan", LaserScan::TYPE, at, payload(&scan(at))));
        }
    }
    messages
}

fn read_messages(messages: &Messages, options: &BagOptions) -> Result<Bag, BagError> {
    read(&file(messages), options)
}

#[test]
fn times_and_limits_of_scans_are_kept_with_the_odometry_of_their_sweep() {
    let mut messages = robot(mounted([0.0, 0.0, 0.0, 1.0], 0.1));
    let swept = LaserScan { time_increment: 0.0005, scan_time: 0.1, range_min: 0.3, ..scan(SECOND) };
    messages.push((
        "/scan",
        LaserScan::TYPE,
        SECOND + 1,
        payload(&LaserScan { stamp: Stamp(SECOND + 7), ..swept }),
    ));
    let bag = read_messages(&messages, &BagOptions::default()).unwrap();
    let scan = bag.scans.iter().find(|scan| scan.stamp == Stamp(SECOND + 7)).unwrap();
    assert_eq!((scan.time_increment_s, scan.scan_time_s, scan.range_min_m), (0.0005, 0.1, 0.3));
    // Each message of odometry, and the pose at the scan between two of them.
    assert_eq!(bag.odometry.len(), 41);
    assert!(bag.odometry.is_sorted_by(|a, b| a.0 < b.0));
    assert!(bag.odometry.contains(&(scan.stamp, scan.odom_from_base)));
    let without = BagOptions { without_odometry: true, ..BagOptions::default() };
    assert!(read_messages(&messages, &without).unwrap().odometry.is_empty());
}

#[test]
fn a_robot_gets_transforms_and_odometry_of_its_own_namespace() {
    let mut messages: Messages = Vec::new();
    let topics = [
        ("/robot2/scan", "/robot2/tf", "/robot2/tf_static", 0.2),
        ("/robot1/scan", "/robot1/tf", "/robot1/tf_static", 0.1),
    ];
    for (scans, tf_topic, fixed, x) in topics {
        messages.push((fixed, TfMessage::TYPE, 0, tf(vec![mounted([0.0, 0.0, 0.0, 1.0], x)])));
        for step in 0..20 {
            let at = step * SECOND / 10;
            let moved = transform("odom", "base_footprint", [x * step as f64, 0.0, 0.0], at);
            messages.push((tf_topic, TfMessage::TYPE, at, tf(vec![moved])));
            messages.push((scans, LaserScan::TYPE, at, payload(&scan(at))));
        }
    }
    for (scans, _, _, x) in topics {
        let options = BagOptions { scan_topic: Some(scans.into()), ..BagOptions::default() };
        let bag = read_messages(&messages, &options).unwrap();
        assert_eq!((bag.base_from_scan.x_m, bag.scans.len()), (x, 20), "{scans}");
        assert!((bag.scans[10].odom_from_base.x_m - 10.0 * x).abs() < 1e-9, "{scans}");
    }
    // Without its own transforms a robot does not get another's.
    messages.retain(|(topic, ..)| !topic.starts_with("/robot1/tf"));
    messages.push(("/robot2/odom", RosOdometry::TYPE, 0, payload(&odometry(0, 0.0, 0.0))));
    let options = BagOptions { scan_topic: Some("/robot1/scan".into()), ..BagOptions::default() };
    let error = read_messages(&messages, &options).unwrap_err();
    assert!(matches!(&error, BagError::NoOdometry { .. }), "{error}");
    assert!(
        error.to_string().contains("/robot2/odom") && error.to_string().contains("--odom-topic"),
        "{error}"
    );
}

#[test]
fn a_scanner_upside_down_is_mirrored_and_a_tilted_one_refused() {
    let upright = read_messages(&robot(mounted([0.0, 0.0, 0.0, 1.0], 0.1)), &BagOptions::default()).unwrap();
    // Rolled by pi; then pitched by pi, so that it looks back.
    for (rotation, yaw) in [([1.0, 0.0, 0.0, 0.0], 0.0), ([0.0, 1.0, 0.0, 0.0], PI)] {
        let bag = read_messages(&robot(mounted(rotation, 0.1)), &BagOptions::default()).unwrap();
        let (scan, expected) = (&bag.scans[0], &upright.scans[0]);
        assert_eq!(scan.angle_min_rad, -expected.angle_min_rad);
        assert_eq!(scan.angle_increment_rad, -expected.angle_increment_rad);
        assert_eq!(scan.ranges_m, expected.ranges_m);
        assert!((bag.base_from_scan.yaw_rad.abs() - yaw).abs() < 1e-9, "{:?}", bag.base_from_scan);
    }
    let vertical = robot(mounted([0.0, FRAC_1_SQRT_2, 0.0, FRAC_1_SQRT_2], 0.1));
    for without_odometry in [false, true] {
        let options = BagOptions { without_odometry, ..BagOptions::default() };
        let error = read_messages(&vertical, &options).unwrap_err().to_string();
        assert!(error.contains("`base_scan` by 90 degrees") && error.contains("--scanner"), "{error}");
        // Without odometry no base is known, but which way up the scanner is.
        let bag = read_messages(&robot(mounted([1.0, 0.0, 0.0, 0.0], 0.1)), &options).unwrap();
        assert_eq!(bag.scans[0].angle_min_rad, -upright.scans[0].angle_min_rad);
    }
    // What a person says counts.
    let reported = BagOptions { base_from_scan: Some(Pose2::IDENTITY), ..BagOptions::default() };
    assert!(read_messages(&vertical, &reported).is_ok());
}

/// Quaternion of a turn about the y axis.
fn pitched(degrees: f64) -> [f64; 4] {
    let (sin, cos) = (degrees.to_radians() / 2.0).sin_cos();
    [0.0, sin, 0.0, cos]
}

#[test]
fn a_mount_that_changes_is_refused_in_each_direction_and_angle() {
    let first = mounted(pitched(0.0), 0.1);
    let higher = TransformStamped { translation: [0.1, 0.0, 0.5], ..first.clone() };
    for other in [mounted(pitched(0.0), 0.4), higher, mounted(pitched(10.0), 0.1)] {
        let mut messages = robot(first.clone());
        messages.push(("/tf_static", TfMessage::TYPE, 1, tf(vec![other])));
        let error = read_messages(&messages, &BagOptions::default()).unwrap_err();
        assert!(matches!(error, BagError::Moving { .. }), "{error}");
    }
    let mut messages = robot(first);
    messages.push(("/tf_static", TfMessage::TYPE, 1, tf(vec![mounted(pitched(1.0), 0.12)])));
    assert!(read_messages(&messages, &BagOptions::default()).is_ok(), "an adjustment");
}

#[test]
fn a_scanner_and_a_base_on_two_branches_of_one_tree_are_connected() {
    // As where odometry is that of base_footprint, which hangs below base_link, beside the scanner.
    let turned = |parent, child, yaw: f64, x| TransformStamped {
        rotation: [0.0, 0.0, (yaw / 2.0).sin(), (yaw / 2.0).cos()],
        ..transform(parent, child, [x, 0.0, 0.0], 0)
    };
    let base = |yaw| turned("base_link", "base_footprint", yaw, 1.0);
    let mut messages = robot(turned("base_link", "base_scan", 0.0, 1.5));
    messages.push(("/tf_static", TfMessage::TYPE, 0, tf(vec![base(PI / 2.0)])));
    let found = read_messages(&messages, &BagOptions::default()).unwrap().base_from_scan;
    let expected = Pose2::new(0.0, -0.5, -PI / 2.0);
    let apart = expected.between(found);
    assert!(apart.x_m.hypot(apart.y_m) < 1e-9 && apart.yaw_rad.abs() < 1e-9, "{found:?}");
    // Each branch must be fixed.
    messages.push(("/tf_static", TfMessage::TYPE, 1, tf(vec![base(0.0)])));
    let error = read_messages(&messages, &BagOptions::default()).unwrap_err();
    assert!(matches!(&error, BagError::Moving { child, .. } if child == "base_footprint"), "{error}");
}

#[test]
fn scans_of_the_frame_that_has_most_are_used_and_the_others_counted() {
    let mut messages = robot(mounted([0.0, 0.0, 0.0, 1.0], 0.1));
    for step in 0..7 {
        let at = step * SECOND / 10 + 1;
        let rear = LaserScan { frame_id: "rear".into(), ..scan(at) };
        messages.insert(0, ("/scan", LaserScan::TYPE, at, payload(&rear)));
    }
    let bag = read_messages(&messages, &BagOptions::default()).unwrap();
    assert_eq!((bag.scans.len(), bag.left_out.other_frames, bag.base_from_scan.x_m), (20, 7, 0.1));
}

#[test]
fn two_robots_under_one_name_are_refused_and_not_mixed() {
    // Odometry of another robot, 3 m away, between that of the first.
    let mut messages = robot(mounted([0.0, 0.0, 0.0, 1.0], 0.1));
    for step in 0..40 {
        let at = step * SECOND / 20 + SECOND / 50;
        messages.push(("/odom", RosOdometry::TYPE, at, payload(&odometry(at, 3.0, 0.0))));
    }
    messages.sort_by_key(|(_, _, at, _)| *at);
    let error = read_messages(&messages, &BagOptions::default()).unwrap_err();
    assert!(matches!(error, BagError::SeveralRobots { .. }), "{error}");
    assert!(error.to_string().contains("`base_footprint`") && error.to_string().contains("--odom-topic"));
    // Without odometry its scans are those of one robot.
    let without = BagOptions { without_odometry: true, ..BagOptions::default() };
    assert_eq!(read_messages(&messages, &without).unwrap().scans.len(), 20);

    // Scans of another room between those of the first.
    let mut messages = robot(mounted([0.0, 0.0, 0.0, 1.0], 0.1));
    for step in 0..20 {
        let at = step * SECOND / 10 + SECOND / 20;
        let elsewhere = scan(at).ranges.iter().map(|range_m| range_m + 1.5).collect();
        messages.push(("/scan", LaserScan::TYPE, at, payload(&LaserScan { ranges: elsewhere, ..scan(at) })));
    }
    messages.sort_by_key(|(_, _, at, _)| *at);
    let error = read_messages(&messages, &BagOptions::default()).unwrap_err();
    assert!(matches!(error, BagError::SeveralScanners { .. }), "{error}");
    assert!(error.to_string().contains("/scan") && error.to_string().contains("`base_scan`"), "{error}");
}

#[test]
fn the_recorded_mount_stands_in_for_a_transform_and_for_no_other_mount() {
    let mut messages = robot(mounted([0.0, 0.0, 0.0, 1.0], 0.1));
    let options =
        BagOptions { recorded_base_from_scan: Some(Pose2::new(-0.032, 0.0, 0.0)), ..BagOptions::default() };
    assert_eq!(read_messages(&messages, &options).unwrap().base_from_scan.x_m, 0.1);
    messages.remove(0);
    assert_eq!(read_messages(&messages, &options).unwrap().base_from_scan.x_m, -0.032);
}

/// The messages of a robot whose clock is set back by 30 s after the first second.
fn set_back(scans_too: bool) -> Messages {
    let stamp = |at: i64| if at < SECOND { at + 100 * SECOND } else { at + 70 * SECOND };
    let of_scans = |at: i64| if scans_too { stamp(at) } else { at + 100 * SECOND };
    let mount = mounted([0.0, 0.0, 0.0, 1.0], 0.1);
    let mut messages: Messages = vec![("/tf_static", TfMessage::TYPE, 0, tf(vec![mount]))];
    for step in 0..40 {
        let (at, x) = (step * SECOND / 20, step as f64 * 0.01);
        messages.push(("/odom", RosOdometry::TYPE, at, payload(&odometry(stamp(at), x, 0.1))));
        if step % 2 == 0 {
            messages.push(("/scan", LaserScan::TYPE, at, payload(&scan(of_scans(at)))));
        }
    }
    messages
}

#[test]
fn after_a_clock_was_set_back_all_scans_are_in_the_order_of_the_recording() {
    let bag = read_messages(&set_back(true), &BagOptions::default()).unwrap();
    assert_eq!((bag.scans.len(), bag.left_out.clock_steps, bag.left_out.stray_stamps), (20, 1, 0));
    for (number, scan) in bag.scans.iter().enumerate() {
        assert!((scan.odom_from_base.x_m - 0.02 * number as f64).abs() < 1e-9, "{number}: {scan:?}");
        assert!(
            (scan.stamp.seconds() - 100.0 - 0.1 * number as f64).abs() < 0.06,
            "{number}: {:?}",
            scan.stamp
        );
    }
    // The recorder's clock is often the same one.
    let mut together = set_back(true);
    together.iter_mut().skip(1).for_each(|(_, _, at, _)| {
        *at += if *at < SECOND { 100 * SECOND } else { 70 * SECOND };
    });
    let other = read_messages(&together, &BagOptions::default()).unwrap();
    let ways = |bag: &Bag| bag.scans.iter().map(|scan| scan.odom_from_base.x_m).collect::<Vec<_>>();
    assert_eq!((ways(&other), other.left_out), (ways(&bag), bag.left_out));
    let error = read_messages(&set_back(false), &BagOptions::default()).unwrap_err();
    assert!(matches!(error, BagError::Clocks { scan_steps: 0, steps: 1, .. }), "{error}");
}

#[test]
fn a_clock_that_is_set_back_between_two_files_of_a_bag_gives_the_same_as_in_one() {
    let mut messages = set_back(true);
    messages.iter_mut().skip(1).for_each(|(_, _, at, _)| {
        *at += if *at < SECOND { 100 * SECOND } else { 70 * SECOND };
    });
    let ways = |bag: &Bag| bag.scans.iter().map(|scan| (scan.stamp, scan.odom_from_base)).collect::<Vec<_>>();
    let whole = read_messages(&messages, &BagOptions::default()).unwrap();
    for cut in [20, 31, 45] {
        let mut bag = BagReader::new(BagOptions::default());
        let (mut times, mut scan, mut ended) = (RecordedTimes::default(), scan_buffer(), Stamp(0));
        for part in [&messages[..cut], &messages[cut..]] {
            let bytes = file(part);
            let mut reader = RecordingReader::new(&bytes[..]);
            let (first, last) = bag.add("a part", &mut reader, &mut times, &mut scan).unwrap().unwrap();
            assert!(first > ended, "the times of the files do not overlap: {first:?} after {ended:?}");
            ended = last;
        }
        let split = bag.finish().unwrap();
        assert_eq!((ways(&split), split.left_out), (ways(&whole), whole.left_out), "cut at {cut}");
    }
}

#[test]
fn compressed_messages_and_too_many_beams_are_named() {
    let compressed = vec![("/scan", LaserScan::TYPE, 0, vec![0x28, 0xb5, 0x2f, 0xfd, 0, 1])];
    let error = read_messages(&compressed, &BagOptions::default()).unwrap_err();
    assert!(matches!(error, BagError::CompressedMessages), "{error}");
    let many = LaserScan { ranges: vec![1.0; 5000], angle_increment: 0.001, ..scan(0) };
    let error = read_messages(&vec![("/scan", LaserScan::TYPE, 0, payload(&many))], &BagOptions::default());
    let text = error.unwrap_err().to_string();
    assert!(text.contains("in CDR (1 scan with more than 4096 beams, which is the limit); it has"), "{text}");
    let none = vec![("/other", "std_msgs/String", 0, vec![0, 1, 0, 0, 1, 0, 0, 0, 0])];
    let text = read_messages(&none, &BagOptions::default()).unwrap_err().to_string();
    assert!(text.contains("no sensor_msgs/LaserScan in CDR; it has /other"), "{text}");
}
