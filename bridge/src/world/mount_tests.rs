//! Scans of LiDARs that are mounted in every way: what the fleet gets is where the obstacles are.

use super::mount::MOUNT_WAIT_S;
use super::*;
use ros_messages::{LaserScan, Message, TfMessage, TransformStamped, encode};
use std::cell::RefCell;
use std::f64::consts::PI;
use std::rc::Rc;

const SECOND: i64 = 1_000_000_000;
const RANGES_M: [f32; 5] = [1.0, 2.0, 0.5, 3.0, 1.5];
const LEVEL: [f64; 4] = [0.0, 0.0, 0.0, 1.0];

fn robot(number: usize) -> RobotId {
    RobotId::new(number).unwrap()
}

/// What the fleet gets: scans, and the transforms to LiDARs.
#[derive(Default)]
struct Received {
    scans: Vec<Scan>,
    lidars: Vec<RobotFrameTransform>,
}

fn world(names: impl Into<RobotNames>) -> (ExternalWorld, Rc<RefCell<Received>>) {
    let received = Rc::new(RefCell::new(Received::default()));
    let sink = received.clone();
    let world = ExternalWorld::new(names, move |message| match message {
        WorldMessage::Scan(_, scan) => sink.borrow_mut().scans.push(*scan),
        WorldMessage::Transforms(_, transforms) => {
            let is_lidar = |known: &&RobotFrameTransform| known.child_frame == RobotFrame::BaseScan as u32;
            sink.borrow_mut().lidars.extend(transforms.transforms().iter().filter(is_lidar));
        }
        _ => {}
    });
    (world, received)
}

fn send(
    world: &mut ExternalWorld,
    message: &impl Message,
    incoming: impl Fn(Reader<'_>) -> Incoming<'_>,
    at_ns: i64,
) -> Result<(), WorldError> {
    let mut bytes = Vec::new();
    encode(message, &mut bytes);
    let mut exact = SourceClock::new(ClockOffset::Fixed(0.0));
    world.receive(DDS_SOURCE, &mut exact, incoming(Reader::new(&bytes).unwrap()), Stamp(at_ns))
}

fn send_scan(world: &mut ExternalWorld, number: usize, frame: &str, at_ns: i64) -> Result<(), WorldError> {
    let scan = LaserScan {
        stamp: Stamp(at_ns),
        frame_id: frame.into(),
        angle_min: -0.7,
        angle_increment: 0.6,
        range_min: 0.1,
        range_max: 3.5,
        ranges: RANGES_M.to_vec(),
        ..LaserScan::default()
    };
    send(world, &scan, |from| Incoming::Scan(robot(number), from), at_ns)
}

fn edge(parent: &str, child: &str, translation: [f64; 3], rotation: [f64; 4]) -> TransformStamped {
    TransformStamped {
        stamp: Stamp(SECOND),
        frame_id: parent.into(),
        child_frame_id: child.into(),
        translation,
        rotation,
    }
}

/// The product of two quaternions x, y, z, w.
fn product([ax, ay, az, aw]: [f64; 4], [bx, by, bz, bw]: [f64; 4]) -> [f64; 4] {
    [
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    ]
}

/// The quaternion of a URDF's rpy.
fn rpy(roll: f64, pitch: f64, yaw: f64) -> [f64; 4] {
    let about = |axis: usize, angle: f64| {
        let mut quaternion = [0.0, 0.0, 0.0, (angle / 2.0).cos()];
        quaternion[axis] = (angle / 2.0).sin();
        quaternion
    };
    product(product(about(2, yaw), about(1, pitch)), about(0, roll))
}

fn rotate(rotation: [f64; 4], [x, y, z]: [f64; 3]) -> [f64; 3] {
    let [qx, qy, qz, w] = rotation;
    let [px, py, pz, _] = product(product(rotation, [x, y, z, 0.0]), [-qx, -qy, -qz, w]);
    [px, py, pz]
}

/// Where the obstacles of the scan are in the base, from the mount alone, metres.
fn obstacles(translation: [f64; 3], rotation: [f64; 4]) -> Vec<[f64; 2]> {
    let beam = |(i, range): (usize, &f32)| {
        let (angle, range) = (-0.7 + 0.6 * i as f64, f64::from(*range));
        let [x, y, _] = rotate(rotation, [range * angle.cos(), range * angle.sin(), 0.0]);
        [translation[0] + x, translation[1] + y]
    };
    RANGES_M.iter().enumerate().map(beam).collect()
}

/// Where a reader of the fleet's scan finds them, metres.
fn found(scan: &Scan) -> Vec<[f64; 2]> {
    let mount = scan.mount().expect("the mount is known");
    let beam = |(angle, range): (f32, f32)| {
        let (angle, range) = (f64::from(angle), f64::from(range));
        mount.apply([range * angle.cos(), range * angle.sin()])
    };
    scan.hits().map(beam).collect()
}

fn assert_near(found: &[[f64; 2]], expected: &[[f64; 2]], what: &str) {
    assert_eq!(found.len(), expected.len(), "{what}");
    for (found, expected) in found.iter().zip(expected) {
        let apart = (found[0] - expected[0]).hypot(found[1] - expected[1]);
        assert!(apart < 1e-5, "{what}: {found:?} instead of {expected:?}");
    }
}

fn on_tf(from: Reader<'_>) -> Incoming<'_> {
    Incoming::Transforms(from)
}

/// Sends a robot's transforms by one of the four topics.
fn send_tree(world: &mut ExternalWorld, topic: usize, transforms: Vec<TransformStamped>) {
    let message = TfMessage { transforms };
    let sent = match topic {
        0 => send(world, &message, |from| Incoming::StaticTransforms(None, from), SECOND),
        1 => send(world, &message, on_tf, SECOND),
        2 => send(world, &message, |from| Incoming::StaticTransforms(Some(robot(1)), from), SECOND),
        _ => send(world, &message, |from| Incoming::RobotTransforms(robot(1), from), SECOND),
    };
    sent.unwrap();
}

#[test]
fn obstacles_are_where_they_are_however_a_level_lidar_is_mounted() {
    let place = [0.12, -0.07, 0.3];
    for (roll, pitch) in [(0.0, 0.0), (PI, 0.0), (0.0, PI), (PI, PI), (-PI, 0.0)] {
        for yaw in [0.0, 0.5, PI / 2.0, -2.0, PI] {
            for topic in 0..4 {
                let (rotation, what) =
                    (rpy(roll, pitch, yaw), format!("{roll} {pitch} {yaw}, topic {topic}"));
                let (mut world, received) = world(RobotNames::new(vec![String::new()]).unwrap());
                let tree = vec![edge("base_link", "laser", place, rotation)];
                send_tree(&mut world, topic, tree);
                send_scan(&mut world, 1, "laser", SECOND).unwrap();
                assert_near(&found(&received.borrow().scans[0]), &obstacles(place, rotation), &what);
                let is_mirrored_reported = world.take_notice().unwrap().contains("mirrored");
                assert_eq!(is_mirrored_reported, rotate(rotation, [0.0, 0.0, 1.0])[2] < 0.0, "{what}");
                send_scan(&mut world, 1, "laser", 2 * SECOND).unwrap();
                assert_eq!(world.take_notice(), None, "once");
            }
        }
    }
}

#[test]
fn a_mount_is_found_along_all_frames_to_the_base_and_known_to_readers_of_transforms() {
    let (mut world, received) = world(1);
    let (half, over) = (rpy(0.0, 0.0, 0.8), rpy(PI, 0.0, 0.0));
    let fixed = vec![
        edge("/base_footprint", "base_link", [0.0, 0.0, 0.1], LEVEL),
        edge("mast", "laser", [0.0, 0.1, 0.0], over),
        edge("base_link", "mast", [0.2, 0.0, 0.5], half),
    ];
    send_tree(&mut world, 0, fixed);
    send_scan(&mut world, 1, "/laser", SECOND).unwrap();
    let offset = rotate(half, [0.0, 0.1, 0.0]);
    let place = [0.2 + offset[0], offset[1], 0.6];
    let expected = obstacles(place, product(half, over));
    assert_near(&found(&received.borrow().scans[0]), &expected, "scan");
    // Navigation, the base and TCP clients read the scan in its frame: the frame is upright, and at its place.
    send_tree(&mut world, 1, vec![edge("odom", "base_footprint", [5.0, 5.0, 0.0], LEVEL)]);
    let received = received.borrow();
    let lidar = received.lidars.last().expect("the LiDAR's frame comes with the base's");
    assert_eq!(lidar.parent_frame, RobotFrame::BaseFootprint as u32);
    let in_frame = received.scans[0].hits().map(|(angle, range)| {
        let (angle, range) = (f64::from(angle), f64::from(range));
        let [x, y, _] = rotate(lidar.rotation_xyzw, [range * angle.cos(), range * angle.sin(), 0.0]);
        [lidar.translation_m[0] + x, lidar.translation_m[1] + y]
    });
    assert_near(&in_frame.collect::<Vec<_>>(), &expected, "transform");
    assert!(rotate(lidar.rotation_xyzw, [0.0, 0.0, 1.0])[2] > 0.99, "upright");
}

#[test]
fn a_tilted_or_far_lidar_is_refused_by_name_and_taken_when_its_transform_is_corrected() {
    for (roll, pitch) in [(0.0, 0.5), (PI / 2.0, 0.0), (PI, 0.6), (-0.4, 0.0)] {
        let (mut world, received) = world(1);
        send_tree(&mut world, 0, vec![edge("base_link", "laser", [0.1, 0.0, 0.2], rpy(roll, pitch, 0.3))]);
        for n in 1..20 {
            let why = send_scan(&mut world, 1, "laser", n * SECOND).unwrap_err().to_string();
            assert!(why.contains("robot1") && why.contains("`laser`") && why.contains("degrees"), "{why}");
        }
        assert_eq!(received.borrow().scans.len(), 0);
        send_tree(&mut world, 0, vec![edge("base_link", "laser", [0.1, 0.0, 0.2], LEVEL)]);
        assert_eq!(send_scan(&mut world, 1, "laser", 30 * SECOND), Ok(()));
        assert_eq!(received.borrow().scans.len(), 1);
    }
    let (mut world, _) = world(1);
    send_tree(&mut world, 0, vec![edge("base_link", "laser", [11.0, 0.0, 0.0], LEVEL)]);
    let why = send_scan(&mut world, 1, "laser", SECOND).unwrap_err().to_string();
    assert!(why.contains("11.0 m"), "{why}");
    let (mut world, _) = self::world(1);
    send_tree(&mut world, 0, vec![edge("base_link", "laser", [0.1, 0.0, 0.0], rpy(0.0, 0.15, 0.0))]);
    send_scan(&mut world, 1, "laser", SECOND).unwrap();
    assert!(world.take_notice().unwrap().contains("tilted by 9 degrees"));
}

#[test]
fn a_lidar_without_transforms_is_waited_for_and_then_taken_as_configured() {
    let (mut world, received) = world(1);
    let after_wait = SECOND + (MOUNT_WAIT_S * SECOND as f64) as i64;
    for at in [SECOND, after_wait - 1] {
        assert_eq!(send_scan(&mut world, 1, "laser", at), Ok(()));
    }
    assert_eq!((received.borrow().scans.len(), world.take_notice()), (0, None));
    for n in 0..3 {
        send_scan(&mut world, 1, "laser", after_wait + n).unwrap();
    }
    assert!(received.borrow().scans.len() == 3 && received.borrow().scans[0].mount().is_none());
    let reported = world.take_notice().unwrap();
    assert!(
        reported.contains("robot1") && reported.contains("`laser`") && reported.contains("base_from_scan"),
        "{reported}"
    );
    assert_eq!(world.take_notice(), None, "told once");
    // A chain that ends before the base says nothing.
    send_tree(&mut world, 0, vec![edge("tower", "laser", [1.0, 0.0, 0.0], rpy(PI, 0.0, 0.0))]);
    send_scan(&mut world, 1, "laser", after_wait + 10).unwrap();
    assert!(received.borrow().scans[3].mount().is_none());
    // A loop ends.
    send_tree(&mut world, 0, vec![edge("laser", "tower", [1.0, 0.0, 0.0], LEVEL)]);
    send_scan(&mut world, 1, "laser", after_wait + 20).unwrap();
    assert!(received.borrow().scans[4].mount().is_none());
}

#[test]
fn robots_that_share_frames_on_one_topic_are_told_apart_or_the_operator_hears_of_it() {
    let (mut world, received) = world(2);
    let odometry = vec![edge("odom", "base_footprint", [0.0; 3], LEVEL)];
    for _ in 0..3 {
        send_tree(&mut world, 1, odometry.clone());
    }
    let reported = world.take_notice().unwrap();
    assert!(reported.contains("odom -> base_footprint") && reported.contains("frame_prefix"), "{reported}");
    assert_eq!(world.take_notice(), None);
    send_tree(&mut world, 0, vec![edge("base_link", "laser", [0.1, 0.0, 0.0], rpy(PI, 0.0, 0.0))]);
    for at in [SECOND, 9 * SECOND] {
        let _ = send_scan(&mut world, 1, "laser", at);
        let _ = send_scan(&mut world, 2, "laser", at);
    }
    let reported: Vec<String> = std::iter::from_fn(|| world.take_notice()).collect();
    assert!(reported.iter().any(|text| text.contains("robot2 and robot1 call")), "{reported:?}");
    assert!(received.borrow().scans.last().unwrap().mount().is_none(), "nobody knows whose it is");
    // Robot 1 on topics of its own is known again.
    send_tree(&mut world, 2, vec![edge("base_link", "laser", [0.3, 0.0, 0.0], LEVEL)]);
    send_scan(&mut world, 1, "laser", 60 * SECOND).unwrap();
    assert_eq!(received.borrow().scans.last().unwrap().mount().map(|mount| mount.x_m), Some(0.3));
}
