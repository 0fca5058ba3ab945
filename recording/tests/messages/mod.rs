//! Messages and files of bags for tests.

#![allow(dead_code, reason = "each file of tests uses some of them")]

use msg::{Scan, Stamp};
use recording::bag::{Bag, BagError, BagOptions, read_bag};
use recording::{Durability, RecordingReader, RecordingWriter};
use ros_messages::{LaserScan, Message, Odometry as RosOdometry, TransformStamped, encode};
use std::collections::BTreeMap;

/// One second, nanoseconds.
pub const SECOND: i64 = 1_000_000_000;

pub fn scan_buffer() -> Box<Scan> {
    bytemuck::allocation::zeroed_box()
}

pub fn payload(message: &impl Message) -> Vec<u8> {
    let mut bytes = Vec::new();
    encode(message, &mut bytes);
    bytes
}

pub fn scan(at: i64) -> LaserScan {
    LaserScan {
        stamp: Stamp(at),
        frame_id: "base_scan".into(),
        angle_min: -1.0,
        angle_max: 1.0,
        angle_increment: 0.01,
        range_min: 0.1,
        range_max: 3.5,
        ranges: vec![1.5; 200],
        ..LaserScan::default()
    }
}

pub fn odometry(at: i64, x: f64, yaw: f64) -> RosOdometry {
    RosOdometry {
        stamp: Stamp(at),
        frame_id: "odom".into(),
        child_frame_id: "base_footprint".into(),
        position: [x, 0.5, 0.0],
        orientation: [0.0, 0.0, (yaw / 2.0).sin(), (yaw / 2.0).cos()],
        ..RosOdometry::default()
    }
}

pub fn transform(parent: &str, child: &str, translation: [f64; 3], at: i64) -> TransformStamped {
    TransformStamped {
        stamp: Stamp(at),
        frame_id: parent.into(),
        child_frame_id: child.into(),
        translation,
        rotation: [0.0, 0.0, 0.0, 1.0],
    }
}

/// A file with messages of several topics: topic, type, time in nanoseconds, payload.
pub fn file(messages: &[(&str, &str, i64, Vec<u8>)]) -> Vec<u8> {
    let description = BTreeMap::from([("seed".to_owned(), "7".to_owned())]);
    let mut writer = RecordingWriter::new(&description).unwrap();
    let mut topics: Vec<&str> = Vec::new();
    for (topic, message_type, at, payload) in messages {
        let index = topics.iter().position(|known| known == topic).unwrap_or_else(|| {
            topics.push(topic);
            writer.add_topic(topic, message_type, Durability::Volatile).unwrap()
        });
        writer.write(index, Stamp(*at), payload).unwrap();
    }
    writer.finish().unwrap()
}

pub fn read(bytes: &[u8], options: &BagOptions) -> Result<Bag, BagError> {
    read_bag(&mut RecordingReader::new(bytes), options, &mut scan_buffer())
}
