//! Fuzzes every reader of ROS messages: any bytes are a message or an error. A decoded message encodes and decodes to
//! the same bytes. The same bytes go to an external world, which must pass on finite numbers only.
#![no_main]

use bridge::cdr::{Dialect, Reader};
use bridge::ros::{
    BatteryState, Bool, Clock, Empty, Float32MultiArray, HandInputs, Int32, Joy, LaserScan, Message, OccupancyGrid,
    Odometry, PoseWithCovarianceStamped, Text, TfMessage, TransformStamped, Twist, TwistStamped, decode_as,
    encode_as,
};
use bridge::slam_services::SERVICES;
use bridge::world::{ClockOffset, ExternalWorld, Incoming, SourceClock, WorldMessage};
use libfuzzer_sys::fuzz_target;
use msg::{RobotId, Stamp};
use std::path::{Component, Path};

/// Decodes; if that succeeds, encodes and decodes again.
fn read<M: Message>(dialect: Dialect, payload: &[u8]) {
    match decode_as::<M>(dialect, payload) {
        Ok(message) => {
            let mut once = Vec::new();
            encode_as(dialect, &message, &mut once);
            let again = decode_as::<M>(dialect, &once);
            let mut twice = Vec::new();
            again.iter().for_each(|message| encode_as(dialect, message, &mut twice));
            assert_eq!(once, twice, "{}", M::TYPE);
        }
        Err(error) => assert!(!error.to_string().is_empty()),
    }
}

const READERS: [fn(Dialect, &[u8]); 18] = [
    read::<BatteryState>,
    read::<Bool>,
    read::<Clock>,
    read::<Empty>,
    read::<Float32MultiArray>,
    read::<HandInputs>,
    read::<Int32>,
    read::<Joy>,
    read::<LaserScan>,
    read::<OccupancyGrid>,
    read::<Odometry>,
    read::<PoseWithCovarianceStamped>,
    read::<Text>,
    read::<TfMessage>,
    read::<TransformStamped>,
    read::<Twist>,
    read::<TwistStamped>,
    services,
];

/// Reads the requests of SLAM's services.
fn services(dialect: Dialect, payload: &[u8]) {
    for service in SERVICES {
        let requests = Reader::with(dialect, payload)
            .ok()
            .and_then(|mut from| service.service.read(&mut from, false).ok());
        if let Some(requests) = requests {
            assert!(requests.first.pose.is_finite());
            let file = Path::new(requests.first.text.as_str());
            assert!(file.components().all(|part| matches!(part, Component::Normal(_))), "{file:?}");
        }
    }
}

/// Receives the payload as each message of an external world; all numbers passed on must be finite.
fn receive(dialect: Dialect, payload: &[u8]) {
    let Some(robot) = RobotId::new(1) else { return };
    let mut world = ExternalWorld::new(2, |message| match message {
        WorldMessage::Odometry(_, odometry) => {
            assert!(odometry.odom_from_base.is_finite());
            assert!(odometry.linear_m_s.is_finite() && odometry.angular_rad_s.is_finite());
        }
        WorldMessage::Transforms(_, transforms) => {
            let all_finite = |values: &[f64]| values.iter().all(|value| value.is_finite());
            assert!(transforms.transforms().iter().all(|l| all_finite(&l.translation_m) && all_finite(&l.rotation_xyzw)));
        }
        WorldMessage::Scan(_, scan) => assert!(scan.ranges_m().len() >= 2 && scan.angle_increment_rad.is_finite()),
        WorldMessage::Battery(..) | WorldMessage::Clock(_) | WorldMessage::OdometryRestart(_) => {}
    });
    let mut clock = SourceClock::new(ClockOffset::Measured);
    let Ok(from) = Reader::with(dialect, payload) else { return };
    let all = [
        Incoming::Scan(robot, from.clone()),
        Incoming::Transforms(from.clone()),
        Incoming::Odometry(robot, from.clone()),
        Incoming::Battery(robot, from.clone()),
        Incoming::Clock(from),
    ];
    for (message, received_ns) in all.into_iter().zip(0..) {
        if let Err(error) = world.receive(1, &mut clock, message, Stamp(received_ns)) {
            assert!(!error.to_string().is_empty());
        }
    }
}

fuzz_target!(|bytes: &[u8]| {
    let Some((which, payload)) = bytes.split_first() else { return };
    let dialect = if *which < 64 { Dialect::Ros1 } else { Dialect::Ros2 };
    match READERS.get(usize::from(*which % 32)) {
        Some(reader) => reader(dialect, payload),
        None => receive(dialect, payload),
    }
});
