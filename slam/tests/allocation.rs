//! The scan path asks the system for no memory once it runs.

mod common;

use allocation_counter::measure;
use common::{FULL, Lidar, NARROW, Noise, Robot, Wall, cast, laboratory};
use msg::Pose2;
use slam::{Slam, SlamConfig};
use std::sync::mpsc::sync_channel;

/// Allocations of the scan path over some of the scans of a drive in circles; the back end runs
/// in between, on this thread, and is not counted.
fn allocations(walls: &[Wall], lidar: impl Fn(usize) -> Lidar, odometry: bool) -> (u64, usize) {
    let mut noise = Noise::new(4);
    let mut robot = Robot::new(Pose2::new(-1.0, -1.4, 0.0));
    let (mut front, mut back) = Slam::new(SlamConfig::default()).split();
    let (send, receive) = sync_channel(slam::NODES_IN_FLIGHT_MAX);
    let (answer, answers) = sync_channel(64);
    let (mut counted, mut nodes) = (0, 0);
    for i in 0..900 {
        robot.drive(0.2, 0.25, 0.1, &mut noise);
        let lidar = lidar(i);
        let mut scan = cast(walls, &lidar, robot.world_from_base, robot.stamp(), &mut noise);
        scan.time_increment_s = 0.05 / lidar.beams as f32;
        let steady = i >= 100;
        let allocated = measure(|| {
            if odometry {
                front.add_odometry(&robot.odometry());
            }
            answers.try_iter().for_each(|frame_update| front.add_frame_update(frame_update));
            let result = front.process(&scan);
            nodes += usize::from(steady && result.node.is_some());
            if let Some(node) = result.node {
                let _ = send.try_send(node);
            }
        });
        counted += if steady { allocated.count_total } else { 0 };
        // The back end falls behind now and then.
        if i % 40 == 0 {
            for node in receive.try_iter() {
                let _ = answer.try_send(back.add_node(node));
            }
        }
    }
    assert_eq!(front.counts().nodes_held_back, 0);
    (counted, nodes)
}

#[test]
fn the_scan_path_allocates_nothing() {
    let (counted, nodes) = allocations(&laboratory(), |_| NARROW, true);
    assert!(nodes > 30, "{nodes} nodes");
    assert_eq!(counted, 0);
}

#[test]
fn not_even_when_scans_grow_to_4096_beams() {
    let lidar = |i: usize| match i {
        0..300 => FULL,
        300..600 => Lidar { beams: 1 + (i * 37) % 4096, ..FULL },
        _ => Lidar { beams: 4096, ..FULL },
    };
    assert_eq!(allocations(&laboratory(), lidar, true).0, 0);
}

#[test]
fn nor_without_odometry() {
    assert_eq!(allocations(&laboratory(), |_| FULL, false).0, 0);
}
