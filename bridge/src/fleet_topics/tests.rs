//! Repeated transforms map -> odom, and the topics and frames on which external robots get them.

use super::*;
use crate::input::InputPurpose;
use crate::repeater::Repetition;
use msg::{Header, MapTransform, MapTransforms, Pose2, PoseEstimate, TrackingState};
use ros_messages::OdometrySigmas;
use ros_messages::{Odometry, TfMessage, TransformStamped, decode, encode};
use std::time::Duration;

/// A transport that keeps what is sent.
#[derive(Default)]
struct Sent(Vec<(FleetTopic, Option<RobotId>, Vec<u8>)>);

impl TopicSink for Sent {
    fn send(&mut self, topic: FleetTopic, robot: Option<RobotId>, encode: impl FnOnce(&mut Writer<'_>)) {
        let mut payload = Vec::new();
        encode(&mut Writer::new(&mut payload));
        self.0.push((topic, robot, payload));
    }
    fn send_again(&mut self, _: FleetTopic, _: FleetTopic) {}
    fn is_subscribed(&self, _: FleetTopic) -> bool {
        false
    }
}

impl Sent {
    /// Takes the transforms as `topic: stamp in ms, parent -> child`.
    fn take_transforms(&mut self) -> Vec<String> {
        let mut all = Vec::new();
        for (topic, robot, payload) in std::mem::take(&mut self.0) {
            let name = match (topic, robot) {
                (FleetTopic::Transforms, None) => "/tf".into(),
                (FleetTopic::RobotTransforms, Some(robot)) => format!("/{robot}/tf"),
                _ => continue,
            };
            for transform in decode::<TfMessage>(&payload).unwrap().transforms {
                let TransformStamped { stamp, frame_id, child_frame_id, .. } = transform;
                all.push(format!("{name}: {} {frame_id} -> {child_frame_id}", stamp.0 / 1_000_000));
            }
        }
        all
    }
}

fn robot(number: usize) -> RobotId {
    RobotId::new(number).unwrap()
}

fn ms(ms: u64) -> Monotonic {
    Monotonic(ms * 1_000_000)
}

/// A publisher of two robots that repeats transforms for a second, 200 ms ahead.
fn publisher(robot_transforms: RobotTransformPolicy) -> FleetPublisher {
    let mut publisher = FleetPublisher::new(NameStyle::Flat, &2.into(), robot_transforms);
    let repetition = Repetition { tolerance: Duration::from_millis(200), hold: Duration::from_secs(1) };
    publisher.set_repetition(repetition);
    publisher
}

/// SLAM's answer at 5 s of the run.
fn pose_estimate(state: TrackingState) -> PoseEstimate {
    let header = Header { stamp: Stamp(5_000_000_000), ..Header::default() };
    PoseEstimate {
        header,
        map_from_odom: Pose2::new(1.0, 0.0, 0.0),
        state: state as u32,
        ..PoseEstimate::default()
    }
}

fn payload(message: &impl Message) -> Vec<u8> {
    let mut out = Vec::new();
    encode(message, &mut out);
    out
}

#[test]
fn the_whole_chain_is_repeated_and_dated_ahead() {
    let (mut publisher, mut sent) = (publisher(RobotTransformPolicy::Split), Sent::default());
    let mut transforms = MapTransforms::default();
    transforms.robots[0] = MapTransform { known: 1, ..MapTransform::default() };
    publisher.publish(FleetMessage::MapTransforms(&transforms), &mut sent);
    sent.take_transforms();
    let answer = pose_estimate(TrackingState::Tracking);
    publisher.publish(FleetMessage::PoseEstimate(robot(1), &answer), &mut sent);
    assert!(sent.take_transforms().is_empty(), "once, by the repetition");
    publisher.receive_pose_estimate(robot(1), &answer, ms(0));
    publisher.repeat_transforms(ms(0), &mut sent);
    publisher.repeat_transforms(ms(20), &mut sent);
    assert_eq!(
        sent.take_transforms(),
        [
            "/tf: 5200 map -> map_1",
            "/tf: 5200 map_1 -> odom_1",
            "/tf: 5220 map -> map_1",
            "/tf: 5220 map_1 -> odom_1"
        ]
    );
    publisher.receive_pose_estimate(robot(1), &pose_estimate(TrackingState::Lost), ms(40));
    publisher.repeat_transforms(ms(40), &mut sent);
    assert!(sent.take_transforms().is_empty(), "a lost robot's transform is not known");
}

#[test]
fn external_robots_get_map_to_odom_in_their_own_tree() {
    let answer = pose_estimate(TrackingState::Tracking);
    // The transforms of both robots at the answer, after these messages of theirs.
    let chains_of = |known: usize, messages: &[(InputPurpose, Vec<u8>)]| {
        let (mut publisher, mut sent) = (publisher(RobotTransformPolicy::ByRobots), Sent::default());
        let mut transforms = MapTransforms::default();
        transforms.robots[..known].fill(MapTransform { known: 1, ..MapTransform::default() });
        publisher.publish(FleetMessage::MapTransforms(&transforms), &mut sent);
        sent.take_transforms();
        messages.iter().for_each(|(input, payload)| publisher.learn_frames(*input, payload));
        [1, 2].iter().for_each(|number| publisher.receive_pose_estimate(robot(*number), &answer, ms(0)));
        publisher.repeat_transforms(ms(0), &mut sent);
        sent.take_transforms()
    };
    let chains = |messages: &[(InputPurpose, Vec<u8>)]| chains_of(0, messages);
    assert!(chains(&[]).is_empty(), "no robot has named its frames: nothing is invented");
    let odometry = payload(&Odometry { frame_id: "odom".into(), ..Odometry::default() });
    let first = (InputPurpose::Odometry(robot(1)), odometry);
    assert_eq!(chains(std::slice::from_ref(&first)), ["/tf: 5200 map_1 -> odom"]);
    let transform = TransformStamped {
        frame_id: "odom".into(),
        child_frame_id: "base_footprint".into(),
        ..TransformStamped::default()
    };
    let second =
        (InputPurpose::RobotTransforms(robot(2)), payload(&TfMessage { transforms: vec![transform] }));
    let expected = ["/robot1/tf: 5200 map_1 -> odom", "/robot2/tf: 5200 map_2 -> odom"];
    let both = [first, second];
    assert_eq!(chains(&both), expected, "both call it odom");
    // Of two robots one is in the merged map: its map's frame is as new on /tf, and nothing is said of the other's.
    let expected = [
        "/tf: 5200 map -> map_1",
        "/robot1/tf: 5200 map -> map_1",
        "/robot1/tf: 5200 map_1 -> odom",
        "/robot2/tf: 5200 map_2 -> odom",
    ];
    assert_eq!(chains_of(1, &both), expected);
}

#[test]
fn without_repetition_the_whole_chain_has_the_scans_stamp_and_unknown_maps_are_left_out() {
    let (mut publisher, mut sent) =
        (FleetPublisher::new(NameStyle::Flat, &2.into(), RobotTransformPolicy::OnTf), Sent::default());
    let answer = pose_estimate(TrackingState::Tracking);
    let mut chain = |publisher: &mut FleetPublisher, number| {
        publisher.publish(FleetMessage::PoseEstimate(robot(number), &answer), &mut sent);
        sent.take_transforms()
    };
    assert_eq!(chain(&mut publisher, 1), ["/tf: 5000 map_1 -> odom_1"], "no map is merged yet");
    let mut transforms = MapTransforms::default();
    transforms.robots[0] = MapTransform { known: 1, ..MapTransform::default() };
    publisher.publish(FleetMessage::MapTransforms(&transforms), &mut Sent::default());
    assert_eq!(chain(&mut publisher, 1), ["/tf: 5000 map -> map_1", "/tf: 5000 map_1 -> odom_1"]);
    assert_eq!(chain(&mut publisher, 2), ["/tf: 5000 map_2 -> odom_2"]);
}

#[test]
fn odometry_has_covariances() {
    let (mut publisher, mut sent) = (publisher(RobotTransformPolicy::Split), Sent::default());
    publisher.set_odometry_sigmas(OdometrySigmas { m_per_m: 0.05, rad_per_rad: 0.02, rad_per_m: 0.01 });
    for x_m in [0.0, 1.0] {
        let odometry = msg::Odometry { odom_from_base: Pose2::new(x_m, 0.0, 0.0), ..Default::default() };
        publisher.publish(FleetMessage::Odometry(robot(1), &odometry), &mut sent);
    }
    let (_, _, last) = sent.0.pop().unwrap();
    let odometry: Odometry = decode(&last).unwrap();
    assert!((odometry.pose_covariance[0] - 0.0025).abs() < 1e-12, "{:?}", odometry.pose_covariance);
    assert!(odometry.twist_covariance[0] > 0.0 && odometry.twist_covariance[35] > 0.0);
}
