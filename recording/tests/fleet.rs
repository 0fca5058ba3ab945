//! The sensor data of a fleet's own recording: when it begins and ends, and drivers that were started again.

mod messages;

use messages::{SECOND, file, odometry, payload, scan, scan_buffer};
use msg::Stamp;
use proptest::prelude::*;
use recording::RecordingReader;
use recording::fleet::FleetRecording;
use ros_messages::{LaserScan, Message, Odometry as RosOdometry, RobotNames, Text};

type Messages = Vec<(&'static str, &'static str, i64, Vec<u8>)>;

fn read(messages: &Messages) -> FleetRecording {
    let bytes = file(messages);
    let mut recording = FleetRecording::new(&RobotNames::from(1), "odom_2d", scan_buffer());
    let mut reader = RecordingReader::new(&bytes[..]);
    while let Some(message) = reader.next_message().unwrap() {
        recording.add(&message);
    }
    recording.sort();
    recording
}

/// Odometry at 20 Hz and scans at 5 Hz from this second on; the robot drives 1 m/s, and begins at 0 m again where it is `started_again`.
fn drive(from_s: i64, seconds: i64, started_again: Option<i64>) -> Messages {
    let mut messages = Messages::new();
    for step in 0..20 * seconds {
        let at = from_s * SECOND + step * SECOND / 20;
        let driven = step - started_again.filter(|restart| step >= *restart).unwrap_or(0);
        let pose = RosOdometry { position: [driven as f64 / 20.0, 0.0, 0.0], ..odometry(at, 0.0, 0.0) };
        messages.push(("/robot1/odom", RosOdometry::TYPE, at, payload(&pose)));
        if step % 4 == 0 {
            messages.push(("/robot1/scan", LaserScan::TYPE, at, payload(&scan(at))));
        }
    }
    messages
}

fn incarnation(at: i64, number: u64) -> (&'static str, &'static str, i64, Vec<u8>) {
    ("/robot1/odom_incarnation", Text::TYPE, at, payload(&Text(number.to_string())))
}

#[test]
fn it_begins_and_ends_with_the_messages_that_are_used() {
    for from_s in [0, 5, 3600] {
        let mut messages = drive(from_s, 2, None);
        let last = messages[messages.len() - 1].2;
        // Neither one of another topic nor one that cannot be read counts.
        messages.push(("/elsewhere", Text::TYPE, i64::MAX, payload(&Text("text".into()))));
        messages.push(("/robot1/scan", LaserScan::TYPE, i64::MAX, vec![0, 1, 0, 0, 9]));
        let recording = read(&messages);
        assert_eq!((recording.begins(), recording.ends()), (Stamp(from_s * SECOND), Stamp(last)));
        assert_eq!((recording.malformed, recording.check_pauses()), (1, Ok(())));
    }
    let empty = read(&Messages::new());
    assert_eq!((empty.begins(), empty.ends(), empty.check_pauses()), (Stamp(0), Stamp(0), Ok(())));
}

#[test]
fn odometry_that_returns_to_its_origin_is_told_where_the_driver_is_not() {
    let mut messages = drive(0, 4, Some(60));
    let returned = read(&messages).robots[0].unexplained_return();
    assert_eq!(returned, Some(Stamp(3 * SECOND)));
    messages.extend([incarnation(0, 17), incarnation(3 * SECOND, 18)]);
    assert_eq!(read(&messages).robots[0].unexplained_return(), None);
    assert_eq!(read(&drive(0, 4, None)).robots[0].unexplained_return(), None);
}

#[test]
fn a_driver_counts_as_started_again_from_the_first_message_of_each_other_incarnation() {
    let mut messages = drive(0, 4, None);
    // A file of a split recording begins with the newest of the one before.
    messages.extend([
        incarnation(0, 17),
        incarnation(SECOND, 17),
        incarnation(2 * SECOND, 3),
        incarnation(3 * SECOND, 18),
    ]);
    let recording = read(&messages);
    let restarts = |at: i64| recording.robots[0].restarts_until(Stamp(at));
    assert_eq!(
        [0, SECOND, 2 * SECOND - 1, 2 * SECOND, 3 * SECOND, 9 * SECOND].map(restarts),
        [0, 0, 0, 1, 2, 2]
    );
    assert_eq!(read(&drive(0, 1, None)).robots[0].restarts_until(Stamp(5)), 0);
}

proptest! {
    #[test]
    fn a_message_with_a_time_far_from_the_others_is_refused(from_s in 0_i64..10_000, hours in 2_i64..2_000_000, later: bool) {
        let mut messages = drive(from_s, 2, None);
        let at = (from_s + if later { 2 + 3600 * hours } else { -3600 * hours }) * SECOND;
        messages.push(("/robot1/scan", LaserScan::TYPE, at.max(0), payload(&scan(at))));
        let recording = read(&messages);
        let pause = recording.check_pauses();
        let is_far = later || from_s >= 2 * 3600;
        prop_assert_eq!(pause.is_err(), is_far, "{:?}", pause);
    }
}
