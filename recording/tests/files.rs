//! Files of recordings: what was written is read, up to the place where a file is cut off; nothing in a file is trusted.

mod messages;

use messages::{SECOND, file, odometry, payload, read, scan, scan_buffer, transform};
use msg::{Odometry, Pose2, Stamp};
use proptest::prelude::*;
use recording::bag::{BagError, BagOptions};
use recording::fleet::{FleetRecording, SensorMessage};
use recording::{Durability, METADATA, RecordingReader, RecordingWriter};
use ros_messages::{LaserScan, Message, Odometry as RosOdometry, Pose2D, RobotNames, TfMessage};
use std::collections::BTreeMap;

/// A bag of two seconds: a scanner 3 cm behind the base's centre, odometry at 20 Hz as message or as transform.
fn bag(with_odometry: bool, with_scanner: bool) -> Vec<u8> {
    let mut messages = Vec::new();
    for step in 0..40 {
        let (at, x) = (step * SECOND / 20, step as f64 * 0.01);
        if with_odometry {
            messages.push(("/odom", RosOdometry::TYPE, at, payload(&odometry(at, x, 0.1))));
        }
        if step % 2 == 0 {
            messages.push(("/scan", LaserScan::TYPE, at, payload(&scan(at + SECOND / 40))));
        }
    }
    if with_scanner {
        let transforms = vec![
            transform("base_footprint", "base_link", [0.0, 0.0, 0.01], 0),
            transform("base_link", "base_scan", [-0.032, 0.0, 0.17], 0),
        ];
        messages.push(("/tf_static", TfMessage::TYPE, 0, payload(&TfMessage { transforms })));
    }
    file(&messages)
}

/// Reads all messages of a file, and why it ends early.
fn read_all(bytes: &[u8]) -> (usize, Option<String>) {
    let mut reader = RecordingReader::new(bytes);
    let mut count = 0;
    while let Ok(Some(_)) = reader.next_message() {
        count += 1;
    }
    (count, reader.damage())
}

#[test]
fn what_was_written_is_read_with_its_types_and_description() {
    let expected = payload(&scan(5));
    let bytes = file(&[("/robot1/scan", LaserScan::TYPE, 42, expected.clone())]);
    let mut reader = RecordingReader::new(&bytes[..]);
    let message = reader.next_message().unwrap().unwrap();
    assert_eq!(
        (&*message.topic, &*message.message_type, &*message.encoding),
        ("/robot1/scan", "sensor_msgs/LaserScan", "cdr")
    );
    assert_eq!((message.at, message.payload), (Stamp(42), expected));
    assert!(reader.next_message().unwrap().is_none());
    assert_eq!(reader.damage(), None);
    assert_eq!(reader.metadata(METADATA).unwrap()["seed"], "7");
}

#[test]
fn after_a_kill_all_flushed_messages_can_be_read() {
    let mut writer = RecordingWriter::new(&BTreeMap::new()).unwrap();
    let topic = writer.add_topic("/robot1/scan", LaserScan::TYPE, Durability::Volatile).unwrap();
    let mut bytes = Vec::new();
    for second in 0..3 {
        for scan_number in 0..10 {
            let at = second * SECOND + scan_number * SECOND / 10;
            writer.write(topic, Stamp(at), &payload(&scan(at))).unwrap();
        }
        writer.flush().unwrap();
        bytes.extend(writer.take_part().bytes);
    }
    let (count, damage) = read_all(&bytes);
    assert_eq!(count, 30, "there is no index and no end");
    assert!(damage.is_some());
    let (count, damage) = read_all(&bytes[..bytes.len() - 100]);
    assert!(count >= 20 && damage.is_some(), "all but the last chunk: {count}");
}

#[test]
fn a_damaged_chunk_is_left_out_and_those_before_and_behind_it_are_used() {
    let mut writer = RecordingWriter::new(&BTreeMap::new()).unwrap();
    let topic = writer.add_topic("/robot1/scan", LaserScan::TYPE, Durability::Volatile).unwrap();
    let mut chunks = Vec::new();
    for second in 0..3 {
        for scan_number in 0..10 {
            let at = second * SECOND + scan_number * SECOND / 10;
            writer.write(topic, Stamp(at), &payload(&scan(at))).unwrap();
        }
        writer.flush().unwrap();
        chunks.push(writer.take_part().bytes);
    }
    let end = writer.finish().unwrap();
    let whole = [&chunks.concat()[..], &end].concat();
    assert_eq!(read_all(&whole), (30, None));
    // A chunk has 9 bytes before its content: behind a wrong length nothing can be read.
    let from = chunks[0].len();
    let length = u64::from_le_bytes(whole[from + 1..from + 9].try_into().unwrap()) as usize;
    for at in from + 9..from + 9 + length {
        let mut damaged = whole.clone();
        damaged[at] ^= 0x5a;
        let (count, damage) = read_all(&damaged);
        match damage {
            // The chunk's own times are not used.
            None => assert!(count == 30 && at < from + 25, "byte {at}: {count}"),
            Some(damage) => assert!(
                count == 20 && damage.contains("damaged and left out"),
                "byte {at}: {count}, {damage}"
            ),
        }
    }
    // The first chunk has the topic's name: what follows is used if that can be read, else it is counted.
    let mut named = 0;
    for at in (chunks[0].len() / 2..chunks[0].len() * 3 / 4).step_by(11) {
        let mut damaged = whole.clone();
        damaged[at] ^= 0x5a;
        let (count, damage) = read_all(&damaged);
        let damage = damage.unwrap_or_default();
        assert!(count == 20 || damage.contains("whose topics"), "byte {at}: {count}, {damage}");
        named += usize::from(count == 20);
    }
    assert!(named > 0);
    // An attachment is not looked at, whatever is in it.
    let attachment = [&[9][..], &32_u64.to_le_bytes(), &[0; 32]].concat();
    let with_attachment = [&chunks[0][..], &attachment, &whole[from..]].concat();
    assert_eq!(read_all(&with_attachment), (30, None));
}

#[test]
fn whatever_a_damaged_file_lacks_it_is_said_to_be_damaged() {
    let bytes = bag(true, true);
    let (mut lacking, mut used) = (0, 0);
    for end in (16..bytes.len() - 1).step_by(97) {
        match read(&bytes[..end], &BagOptions::default()) {
            Ok(bag) => {
                assert!(bag.damage.is_some(), "cut at {end}");
                used += 1;
            }
            Err(BagError::Damaged { .. }) => lacking += 1,
            // Cut within the first record.
            Err(BagError::Read(why)) => assert!(end < 100, "cut at {end}: {why}"),
            Err(why) => panic!("cut at {end}: {why}"),
        }
    }
    assert!(lacking > 0 && used > 0, "{lacking} lack something, {used} are used");
}

#[test]
fn a_file_of_another_kind_is_an_error() {
    for bytes in [&b""[..], b"FLASER 3 1 2 3\n", &[0; 4096]] {
        assert!(matches!(read(bytes, &BagOptions::default()), Err(BagError::Read(_))), "{bytes:?}");
    }
}

#[test]
fn odometry_is_taken_at_the_time_of_each_scan() {
    let bag = read(&bag(true, true), &BagOptions::default()).unwrap();
    assert_eq!((bag.scans.len(), bag.left_out.malformed, bag.left_out.without_odometry), (20, 0, 0));
    assert!((bag.base_from_scan.x_m + 0.032).abs() < 1e-12);
    // The scan lies between two messages of odometry.
    let pose = bag.scans[1].odom_from_base;
    assert!((pose.x_m - 0.025).abs() < 1e-9 && (pose.yaw_rad - 0.1).abs() < 1e-9, "{pose:?}");
}

/// A recording of one robot whose odometry is 1 % too long, with its true poses.
fn bag_with_truth() -> Vec<u8> {
    let mut messages = Vec::new();
    for step in 0..40 {
        let (at, x) = (step * SECOND / 20, step as f64 * 0.01);
        messages.push(("/robot1/odom", RosOdometry::TYPE, at, payload(&odometry(at, 1.01 * x, 0.0))));
        messages.push(("/robot1/ground_truth", RosOdometry::TYPE, at, payload(&odometry(at, 5.0 + x, 0.0))));
    }
    messages.push(("/robot1/scan", LaserScan::TYPE, SECOND, payload(&scan(SECOND + SECOND / 40))));
    file(&messages)
}

#[test]
fn true_poses_are_beside_the_odometry_and_never_instead_of_it() {
    let scanner = || BagOptions { base_from_scan: Some(Pose2::IDENTITY), ..BagOptions::default() };
    let of = |options: BagOptions| read(&bag_with_truth(), &options).map(|bag| bag.scans[0].clone());
    let found = of(scanner()).unwrap();
    let along_x_m = [found.odom_from_base, found.world_from_base.unwrap()].map(|pose| pose.x_m);
    assert!(
        (along_x_m[0] - 1.01 * 0.205).abs() < 1e-9 && (along_x_m[1] - 5.205).abs() < 1e-9,
        "{along_x_m:?}"
    );
    // With the true poses as odometry there is nothing to compare with.
    let named = of(BagOptions { odometry_topic: Some("/robot1/ground_truth".into()), ..scanner() }).unwrap();
    assert_eq!(named.world_from_base, None);
    let wrong = of(BagOptions { truth_topic: Some("/mocap".into()), ..scanner() }).unwrap_err().to_string();
    assert!(wrong.contains("/mocap") && wrong.contains("/robot1/odom"), "{wrong}");
}

#[test]
fn odometry_may_be_a_transform() {
    let mut messages = Vec::new();
    for step in 0..40 {
        let at = step * SECOND / 20;
        let odom = transform("odom", "base_footprint", [step as f64, 0.0, 0.0], at);
        messages.push(("/tf", TfMessage::TYPE, at, payload(&TfMessage { transforms: vec![odom] })));
        messages.push(("/scan", LaserScan::TYPE, at, payload(&scan(at))));
    }
    let bytes = file(&messages);
    let options = BagOptions { base_from_scan: Some(Pose2::new(0.0, 0.0, 0.0)), ..BagOptions::default() };
    let bag = read(&bytes, &options).unwrap();
    assert_eq!((bag.scans.len(), bag.scans[7].odom_from_base.x_m), (40, 7.0));
}

#[test]
fn what_is_missing_is_named_with_what_there_is() {
    let no_odometry = read(&bag(false, true), &BagOptions::default()).unwrap_err().to_string();
    assert!(
        no_odometry.contains("no odometry for /scan") && no_odometry.contains("--no-odometry"),
        "{no_odometry}"
    );
    let moving = |at: i64| TfMessage {
        transforms: vec![transform("odom_combined", "base_link", [at as f64, 0.0, 0.0], at)],
    };
    let other_name = file(&[
        ("/scan", LaserScan::TYPE, 0, payload(&scan(0))),
        ("/tf", TfMessage::TYPE, 0, payload(&moving(0))),
        ("/tf", TfMessage::TYPE, 1, payload(&moving(1))),
    ]);
    let other_name = read(&other_name, &BagOptions::default()).unwrap_err().to_string();
    assert!(other_name.contains("odom_combined -> base_link"), "{other_name}");
    let no_scanner = read(&bag(true, false), &BagOptions::default()).unwrap_err().to_string();
    assert!(
        no_scanner.contains("`base_scan` to `base_footprint`") && no_scanner.contains("--scanner"),
        "{no_scanner}"
    );
    let wished = BagOptions { scan_topic: Some("/front".into()), ..BagOptions::default() };
    let no_scan = read(&bag(true, true), &wished).unwrap_err().to_string();
    assert!(no_scan.contains("/front") && no_scan.contains("/scan (sensor_msgs/LaserScan)"), "{no_scan}");
    let two = file(&[
        ("/a/scan", LaserScan::TYPE, 0, payload(&scan(0))),
        ("/b/scan", LaserScan::TYPE, 0, payload(&scan(0))),
    ]);
    let several = read(&two, &BagOptions::default()).unwrap_err().to_string();
    assert!(several.contains("/a/scan, /b/scan") && several.contains("--scan-topic"), "{several}");
}

#[test]
fn numbers_that_are_no_measurement_are_counted_and_left_out() {
    let bad = [
        LaserScan { angle_increment: f32::NAN, ..scan(0) },
        LaserScan { angle_increment: 1.0, ..scan(0) },
        LaserScan { ranges: Vec::new(), ..scan(0) },
        LaserScan { range_max: f32::NAN, ..scan(0) },
    ];
    let mut messages: Vec<_> = bad.iter().map(|scan| ("/scan", LaserScan::TYPE, 0, payload(scan))).collect();
    messages.push(("/scan", LaserScan::TYPE, 0, vec![0, 1, 0, 0, 255, 255, 255, 255]));
    messages.push(("/scan", LaserScan::TYPE, 0, payload(&scan(0))));
    messages.push(("/odom", RosOdometry::TYPE, 0, payload(&odometry(0, f64::INFINITY, 0.0))));
    let unit = RosOdometry { orientation: [0.0; 4], ..odometry(0, 0.0, 0.0) };
    messages.push(("/odom", RosOdometry::TYPE, 0, payload(&unit)));
    let options = BagOptions { without_odometry: true, ..BagOptions::default() };
    let bag = read(&file(&messages), &options).unwrap();
    assert_eq!((bag.scans.len(), bag.left_out.malformed), (1, 7));
    // The first fault is said, in numbers, also where nothing is left.
    assert!(bag.first_fault.unwrap().starts_with("/scan: "));
    let said = |messages: &[(&str, &str, i64, Vec<u8>)]| {
        read(&file(messages), &BagOptions::default()).unwrap_err().to_string()
    };
    let no_range = LaserScan { range_max: 0.0, ..scan(0) };
    let no_scan = said(&[("/scan", LaserScan::TYPE, 0, payload(&no_range))]);
    assert!(
        no_scan.contains("the first on /scan: range_max is 0; expected more than range_min"),
        "{no_scan}"
    );
    let mut mount = transform("base_footprint", "base_scan", [0.0; 3], 0);
    mount.rotation = [0.0, 0.0, 0.7, 0.7];
    let no_mount = said(&[
        ("/scan", LaserScan::TYPE, 0, payload(&scan(0))),
        ("/odom", RosOdometry::TYPE, 0, payload(&odometry(0, 0.0, 0.0))),
        ("/tf_static", TfMessage::TYPE, 0, payload(&TfMessage { transforms: vec![mount] })),
    ]);
    assert!(no_mount.contains("/tf_static: the transform base_footprint -> base_scan has"), "{no_mount}");
}

#[test]
fn a_fleets_odometry_is_exact_and_before_its_scan() {
    let yaw = 2.518_731_904_112_9;
    let pose = Pose2D { x: 1.25, y: 0.5, theta: yaw };
    let bytes = file(&[
        ("/robot1/odom", RosOdometry::TYPE, 7, payload(&odometry(7, 1.25, yaw))),
        ("/robot1/scan", LaserScan::TYPE, 7, payload(&scan(7))),
        ("/robot1/odom_2d", Pose2D::TYPE, 7, payload(&pose)),
        ("/clock", "rosgraph_msgs/Clock", 9, vec![0, 1, 0, 0, 0, 0, 0, 0, 9, 0, 0, 0]),
    ]);
    let mut recording = FleetRecording::new(&RobotNames::from(1), "odom_2d", scan_buffer());
    // Two recorders of one run have the same messages.
    for file in [&bytes, &bytes] {
        let mut reader = RecordingReader::new(&file[..]);
        while let Some(message) = reader.next_message().unwrap() {
            recording.add(&message);
        }
    }
    recording.sort();
    assert_eq!((recording.robots[0].messages.len(), recording.duplicates), (2, 2));
    let messages = &recording.robots[0].messages;
    let (_, SensorMessage::Odometry(Odometry { odom_from_base, .. })) = &messages[0] else {
        panic!("odometry comes first: {messages:?}")
    };
    assert_eq!(odom_from_base.yaw_rad.to_bits(), yaw.to_bits());
    assert!(matches!(messages[1], (Stamp(7), SensorMessage::Scan(_))));
    assert_eq!((recording.ends(), recording.malformed, recording.clock.len()), (Stamp(9), 0, 1));
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, ..ProptestConfig::default() })]

    /// Bytes that were changed anywhere, and files that were cut off anywhere, end with a result or an error.
    #[test]
    fn no_file_makes_the_reader_panic(changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..8), end in any::<prop::sample::Index>()) {
        let mut bytes = bag(true, true);
        for (at, value) in changes {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        bytes.truncate(end.index(bytes.len()) + 1);
        let _ = read(&bytes, &BagOptions::default());
        read_all(&bytes);
    }

    /// Payloads that say anything are decoded or counted.
    #[test]
    fn no_payload_makes_the_decoders_panic(bytes in prop::collection::vec(any::<u8>(), 0..200), cut in 0_usize..900) {
        let mut whole = payload(&scan(0));
        whole.truncate(cut);
        let mut messages = Vec::new();
        for message in [&bytes, &whole] {
            messages.push(("/scan", LaserScan::TYPE, 0, message.clone()));
            messages.push(("/robot1/scan", LaserScan::TYPE, 0, message.clone()));
            messages.push(("/robot1/odom", RosOdometry::TYPE, 0, message.clone()));
            messages.push(("/robot1/odom_2d", Pose2D::TYPE, 0, message.clone()));
            messages.push(("/tf", TfMessage::TYPE, 0, message.clone()));
        }
        let file = file(&messages);
        let _ = read(&file, &BagOptions::default());
        let mut recording = FleetRecording::new(&RobotNames::from(1), "odom_2d", scan_buffer());
        let mut reader = RecordingReader::new(&file[..]);
        while let Ok(Some(message)) = reader.next_message() {
            recording.add(&message);
        }
    }
}
