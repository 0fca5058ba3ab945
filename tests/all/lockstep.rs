//! The whole fleet from a seed: the same messages, byte for byte.

use mr_slam::config::FleetConfig;
use mr_slam::lockstep::Lockstep;
use msg::{Odometry, PoseEstimate, Scan, Stamp, Transforms};
use reports::FleetView;
use std::collections::BTreeMap;

/// Every message a fleet says in so many seconds, by channel.
fn messages(config: &FleetConfig, seconds: usize) -> BTreeMap<String, Vec<u8>> {
    let mut said: BTreeMap<String, Vec<u8>> = BTreeMap::new();
    let mut fleet = Lockstep::new(config, true).unwrap();
    for _ in 0..seconds * 100 {
        fleet.tick(&mut |channel, bytes| said.entry(channel.into()).or_default().extend_from_slice(bytes));
    }
    said
}

fn config(robots: usize, seed: u64) -> FleetConfig {
    let mut config = FleetConfig::default();
    (config.fleet.robots, config.fleet.seed) = (robots, seed);
    config
}

#[test]
fn a_seed_is_a_run() {
    let (once, again) = (messages(&config(3, 5), 20), messages(&config(3, 5), 20));
    assert_eq!(once.keys().collect::<Vec<_>>(), again.keys().collect::<Vec<_>>());
    for (channel, bytes) in &once {
        assert!(bytes == &again[channel], "two runs differ on {channel}");
    }
    let mut named = config(3, 5);
    named.fleet.names = ["alice", "bob", "lab/carol"].map(String::from).into();
    let named = messages(&named, 20);
    let other = messages(&config(3, 6), 20);
    for channel in ["robot1/scan", "robot2/odometry", "robot3/pose_estimate", "merged_map"] {
        assert!(once[channel] != other[channel], "another seed says the same on {channel}");
        assert!(
            once[channel] == named[channel],
            "robots with names of their own do other things on {channel}"
        );
    }
}

#[test]
fn a_seed_is_a_run_though_starts_are_unknown() {
    let config = FleetConfig {
        fleet: mr_slam::config::Fleet { starts_known: false, ..config(2, 3).fleet },
        ..config(2, 3)
    };
    let (once, again) = (messages(&config, 60), messages(&config, 60));
    assert!(once.contains_key("merge_edges") && once.contains_key("robot2/submap"), "{:?}", once.keys());
    for (channel, bytes) in &once {
        assert!(bytes == &again[channel], "two runs differ on {channel}");
    }
}

#[test]
fn a_recording_replays_to_the_same_pose_estimates() {
    let config = config(1, 9);
    let said = messages(&config, 20);
    let odometry = said["robot1/odometry"].chunks_exact(size_of::<Odometry>());
    let mut odometry = odometry.map(bytemuck::pod_read_unaligned::<Odometry>).peekable();
    let mut slam = slam::Slam::new(config.slam.clone());
    let mut replayed = Vec::new();
    // The channel's numbers are not SLAM's.
    let first: PoseEstimate =
        bytemuck::pod_read_unaligned(&said["robot1/pose_estimate"][..size_of::<PoseEstimate>()]);
    let incarnation = first.header.incarnation;
    for (seq, scan) in said["robot1/scan"].chunks_exact(size_of::<Scan>()).enumerate() {
        let scan: Box<Scan> = Box::new(bytemuck::pod_read_unaligned(scan));
        while let Some(odometry) = odometry.next_if(|odometry| odometry.header.stamp <= scan.header.stamp) {
            slam.add_odometry(&odometry);
        }
        let mut pose_estimate = slam.process(&scan).pose_estimate;
        slam.work();
        (pose_estimate.header.seq, pose_estimate.header.sent.0) =
            (seq as u64, pose_estimate.header.stamp.0 as u64);
        pose_estimate.header.incarnation = incarnation;
        replayed.extend_from_slice(bytemuck::bytes_of(&pose_estimate));
    }
    assert!(said["robot1/pose_estimate"] == replayed, "the recording replays to other pose estimates");
}

#[test]
fn robots_that_started_anywhere_find_each_other() {
    let mut config = config(3, 1);
    config.fleet.starts_known = false;
    let mut fleet = Lockstep::new(&config, true).unwrap();
    let mut merged_at = [None; 3];
    for second in 0..120 {
        for _ in 0..100 {
            fleet.tick(&mut |_, _| {});
        }
        let view = FleetView::new(fleet.stats());
        for (at, robot) in merged_at.iter_mut().zip(&view.robots) {
            match (robot.merged, &at) {
                (true, None) => *at = Some(second),
                (false, Some(_)) => panic!("{} was merged and is no more", robot.robot),
                _ => {}
            }
        }
        // Once everybody is there it goes on for a while: what holds must go on holding.
        if merged_at.iter().all(|at| at.is_some_and(|at| second > at + 10)) {
            break;
        }
    }
    let view = FleetView::new(fleet.stats());
    assert!(merged_at[0] == Some(0) && merged_at.iter().all(Option::is_some), "{merged_at:?}");
    for robot in &view.robots {
        let (m, deg) = (robot.map_transform_error_m.unwrap(), robot.map_transform_error_deg.unwrap());
        assert!(m < 0.10 && deg < 1.0, "{}: {m} m, {deg} degrees from its true place", robot.robot);
    }
    let (f1, chance) = (view.occupied_f1.unwrap(), view.null_f1_mean.unwrap());
    assert!(f1 > 0.8 && chance < 0.4, "{f1} {chance}");
}

#[test]
fn three_robots_map_the_laboratory() {
    let mut fleet = Lockstep::new(&config(3, 1), true).unwrap();
    for _ in 0..60 * 100 {
        fleet.tick(&mut |_, _| {});
    }
    let view = FleetView::new(fleet.stats());
    for robot in &view.robots {
        // A robot that sees one wall alone at the end is degenerate, and knows its place.
        assert!(
            ["tracking", "degenerate"].contains(&robot.state) && robot.scans_lost == Some(0),
            "{robot:?}"
        );
        assert!(robot.pose_error_m.is_some_and(|error| error < 0.10), "{robot:?}");
    }
    assert!(view.room_coverage.is_some_and(|coverage| coverage > 0.8), "{view:?}");
    assert!(view.consistency.is_some_and(|consistency| consistency > 0.9), "{view:?}");
    assert!(view.occupied_f1.is_some_and(|f1| f1 > 0.6), "{view:?}");
}

/// Messages of one kind of each robot: what the fleet wrote, and what a client received.
#[derive(Default)]
struct Traffic<T> {
    written: Vec<T>,
    received: Vec<T>,
}

#[test]
fn every_transform_reaches_a_client_once_and_in_order() {
    let mut fleet = Lockstep::new(&config(3, 2), true).unwrap();
    let mut client = fleet.client(([127, 0, 0, 1], 50_100).into());
    client.subscribe("/tf", "tf2_msgs/TFMessage");
    client.connect();
    let mut links: BTreeMap<String, Traffic<Stamp>> = BTreeMap::new();
    let mut pose_estimates: BTreeMap<String, Traffic<[f64; 2]>> = BTreeMap::new();
    for _ in 0..20 * 100 {
        fleet.tick(&mut |channel, bytes| {
            let Some((robot, name)) = channel.strip_prefix("robot").and_then(|rest| rest.split_once('/'))
            else {
                return;
            };
            if name == "transforms" {
                let message: Transforms = bytemuck::pod_read_unaligned(bytes);
                links.entry(robot.into()).or_default().written.push(message.header.stamp);
            } else if name == "pose_estimate" {
                let pose_estimate: PoseEstimate = bytemuck::pod_read_unaligned(bytes);
                let place = pose_estimate.map_from_odom().map(|place| [place.x_m, place.y_m]);
                pose_estimates.entry(robot.into()).or_default().written.extend(place);
            }
        });
        client.receive(|_, payload| {
            let message: bridge::ros::TfMessage = bridge::ros::decode(payload).unwrap();
            for transform in message.transforms {
                let child = transform.child_frame_id.as_str();
                if let Some(robot) = child.strip_prefix("base_footprint_") {
                    links.entry(robot.into()).or_default().received.push(transform.stamp);
                } else if let Some(robot) = child.strip_prefix("odom_") {
                    let [x_m, y_m, _] = transform.translation;
                    pose_estimates.entry(robot.into()).or_default().received.push([x_m, y_m]);
                }
            }
        });
    }
    assert_eq!((links.len(), pose_estimates.len()), (3, 3));
    for (robot, Traffic { written, received }) in &links {
        assert!(written.len() > 390, "robot{robot}: {} messages in 20 s", written.len());
        assert_eq!(written, received, "transforms of robot{robot}");
    }
    for (robot, Traffic { written, received }) in &pose_estimates {
        assert!(written.len() > 190, "robot{robot}: {} pose estimates in 20 s", written.len());
        // A pose estimate may be sent again, never left out.
        let mut received = received.iter();
        let lost = written.iter().position(|place| !received.any(|other| other == place));
        assert_eq!(lost, None, "of robot{robot}'s pose estimates, this one did not arrive");
    }
}
