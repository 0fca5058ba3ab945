//! How sure SLAM is of what it says: corridors, the covariance, and clocks that are set back.

mod common;
mod drive;

use common::{FULL, HALF, Lidar, NARROW, cast, laboratory, rectangle};
use drive::{Drive, START, round};
use msg::{Pose2, TrackingState};

/// Variances of a pose estimate's covariance along and across a heading.
fn along_across(covariance: [f64; 6], yaw_rad: f64) -> (f64, f64) {
    let [xx, xy, _, yy, ..] = covariance;
    let (s, c) = yaw_rad.sin_cos();
    (c * c * xx + 2.0 * c * s * xy + s * s * yy, s * s * xx - 2.0 * c * s * xy + c * c * yy)
}

#[test]
fn in_a_corridor_the_covariance_is_long_and_the_state_says_so() {
    // It lies askew, so that no axis of the map is its own.
    let corridor_from_world = Pose2::new(0.0, 0.0, -0.6);
    let place = |p: [f64; 2]| corridor_from_world.inverse().apply(p);
    let walls = rectangle(-60.0, -1.2, 60.0, 1.2).into_iter().map(|wall| wall.map(place)).collect();
    let mut drive = Drive::new(walls, Lidar { range_max_m: 8.0, ..FULL }, Pose2::new(0.0, 0.0, 0.6));
    let (mut degenerate, mut in_map) = (0, Vec::new());
    for i in 0..100 {
        drive.robot.drive(0.3, 0.0, 0.1, &mut drive.noise);
        drive.slam.add_odometry(&drive.robot.odometry());
        let (pose, stamp) = (drive.robot.world_from_base, drive.robot.stamp());
        let scan = cast(&drive.walls, &drive.lidar, pose, stamp, &mut drive.noise);
        let pose_estimate = drive.slam.process(&scan).pose_estimate;
        drive.slam.work();
        degenerate += usize::from(pose_estimate.state() == TrackingState::Degenerate);
        if i > 0 {
            // The map's x axis is where the robot looked first: along the corridor, about.
            let yaw_rad = pose_estimate.map_from_base.yaw_rad;
            let (along, across) = along_across(pose_estimate.covariance, yaw_rad);
            assert!(along > 3.0 * across, "scan {i}: {along} along, {across} across");
            assert!(across.sqrt() < 0.03, "scan {i}: {across} across");
            if i == 20 || i == 99 {
                in_map.push(along.sqrt());
            }
        }
    }
    // In the map the uncertainty along the corridor adds up: after 3 m it is less than a tenth, after 10 m or so twice that.
    assert!(in_map[0] < 0.1 && in_map[1] > 1.5 * in_map[0], "{in_map:?} along");
    assert!(degenerate > 95, "{degenerate} of 100");
    // In a room every direction is known.
    let mut room = Drive::new(laboratory(), FULL, START);
    room.drive(&round());
    let tracking = room.said.iter().filter(|(state, ..)| *state == TrackingState::Tracking).count();
    assert!(tracking * 50 > room.said.len() * 49, "{tracking} of {}", room.said.len());
}

/// The error of each pose in the map as seen from the first one, held against the covariance that it was given with: normalised
/// estimation error squared of (x, y, yaw), whose mean is 3 if it is right (Bar-Shalom, Li, Kirubarajan, "Estimation with
/// applications to tracking and navigation", 2001, section 5.4). The covariance is that of the best way through the graph, which is
/// cautious where many ways agree.
#[test]
fn the_covariance_is_about_what_the_error_is() {
    for (lidar, low, high) in [(FULL, 0.1, 3.0), (HALF, 0.1, 3.0), (NARROW, 0.1, 3.0)] {
        let lidar = Lidar { sigma_m: 0.03, ..lidar };
        let mut drive = Drive::new(laboratory(), lidar, START);
        let mut nees = Vec::new();
        let mut first: Option<(Pose2, Pose2)> = None;
        for (linear, angular, seconds) in round() {
            for _ in 0..(seconds * 2.0) as usize {
                for _ in 0..5 {
                    drive.robot.drive(linear, angular, 0.1, &mut drive.noise);
                    drive.slam.add_odometry(&drive.robot.odometry());
                }
                let (truth, stamp) = (drive.robot.world_from_base, drive.robot.stamp());
                let scan = cast(&drive.walls, &lidar, truth, stamp, &mut drive.noise);
                let pose_estimate = drive.slam.process(&scan).pose_estimate;
                drive.slam.work();
                let said = pose_estimate.map_from_base;
                let (first_said, first_truth) = *first.get_or_insert((said, truth));
                if pose_estimate.state() != TrackingState::Lost && first_said != said {
                    // In axes of the robot.
                    let error = first_truth.between(truth).inverse() * first_said.between(said);
                    let e = nalgebra::Vector3::new(error.x_m, error.y_m, error.yaw_rad);
                    let inverse = turned(pose_estimate.covariance, -said.yaw_rad).try_inverse().unwrap();
                    nees.push((e.transpose() * inverse * e).x);
                }
            }
        }
        let mean = nees.iter().sum::<f64>() / nees.len() as f64;
        eprintln!("NEES {mean} of {}", nees.len());
        assert!(nees.len() > 100 && mean > low && mean < high, "{mean} over {} scans", nees.len());
    }
}

fn turned([xx, xy, xt, yy, yt, tt]: [f64; 6], yaw_rad: f64) -> nalgebra::Matrix3<f64> {
    let turn = nalgebra::Rotation2::new(yaw_rad).to_homogeneous();
    turn * nalgebra::Matrix3::new(xx, xy, xt, xy, yy, yt, xt, yt, tt) * turn.transpose()
}

#[test]
fn a_blind_robot_is_less_sure_with_every_metre_and_a_standing_one_is_not() {
    let mut drive = Drive::new(laboratory(), FULL, START);
    drive.drive(&[(0.15, 0.0, 5.0)]);
    let blind = |drive: &mut Drive, linear: f64| {
        drive.robot.drive(linear, 0.0, 0.1, &mut drive.noise);
        drive.slam.add_odometry(&drive.robot.odometry());
        let mut scan = cast(&[], &drive.lidar, Pose2::IDENTITY, drive.robot.stamp(), &mut drive.noise);
        scan.ranges_m.fill(f32::INFINITY);
        let pose_estimate = drive.slam.process(&scan).pose_estimate;
        assert_eq!(pose_estimate.state(), TrackingState::Degenerate);
        pose_estimate.covariance[0].sqrt()
    };
    let first = blind(&mut drive, 0.0);
    let standing = (0..200).map(|_| blind(&mut drive, 0.0)).fold(0.0, f64::max);
    assert!(standing < 1.01 * first, "{first} m, later {standing} m");
    let driving: Vec<f64> = (0..100).map(|_| blind(&mut drive, 0.15)).collect();
    assert!(driving.is_sorted(), "{driving:?}");
    // 1.5 m at a tenth, and what the heading is off by.
    assert!((0.1..0.4).contains(&driving[99]), "{} m", driving[99]);
    // Nobody knows where one is that was carried off.
    drive.carry_to(Pose2::new(1.8, 0.4, 2.0));
    drive.drive(&[(0.15, 0.1, 4.0)]);
    drive.robot.drive(0.15, 0.0, 0.1, &mut drive.noise);
    drive.slam.add_odometry(&drive.robot.odometry());
    let (pose, stamp) = (drive.robot.world_from_base, drive.robot.stamp());
    let pose_estimate =
        drive.slam.process(&cast(&drive.walls, &drive.lidar, pose, stamp, &mut drive.noise)).pose_estimate;
    assert!(
        pose_estimate.state() == TrackingState::Lost && pose_estimate.covariance[0] > 100.0,
        "{pose_estimate:?}"
    );
}

#[test]
fn a_clock_set_back_for_good_is_believed_after_a_few_scans() {
    let mut drive = Drive::new(laboratory(), FULL, START);
    drive.drive(&[(0.15, 0.0, 4.0)]);
    drive.robot.time_s -= 7200.0;
    let jumped = drive.said.len();
    drive.drive(&[(0.15, 0.0, 4.0), (0.0, 0.5, 6.0)]);
    let counts = drive.slam.counts();
    assert_eq!((counts.rejected_stamp_went_back, counts.clock_resets), (4, 1), "{counts:?}");
    assert_eq!(counts.accepted as usize, drive.said.len() - 4);
    let world_from_map = drive.said[0].2;
    assert_eq!(drive.wrong(world_from_map, 0.1), 0);
    assert!(drive.said[jumped + 4..].iter().all(|(state, ..)| *state == TrackingState::Tracking));
    // And once more forward, which is nothing unusual.
    drive.robot.time_s += 7200.0;
    drive.drive(&[(0.15, 0.0, 4.0)]);
    assert_eq!(drive.slam.counts().clock_resets, 1);
    assert_eq!(drive.wrong(world_from_map, 0.1), 0);
}

#[test]
fn single_jumps_stalls_and_scans_out_of_order_are_refused() {
    let mut drive = Drive::new(laboratory(), FULL, START);
    drive.drive(&[(0.15, 0.0, 2.0)]);
    let now_s = drive.robot.time_s;
    // One at a time back; some twice; in order but with seconds between, then again forward.
    for back_s in [5.0, 5.0, 3.0, 15.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 2.0, 1.9, 1.8, 1.7] {
        let stamp = msg::Stamp::from_seconds(now_s - back_s);
        let scan = cast(&drive.walls, &drive.lidar, drive.robot.world_from_base, stamp, &mut drive.noise);
        assert!(drive.slam.process(&scan).rejected.is_some(), "{back_s} s back");
    }
    let counts = drive.slam.counts();
    assert_eq!(
        (counts.rejected_stamp_repeated, counts.rejected_stamp_went_back, counts.clock_resets),
        (6, 8, 0)
    );
    drive.drive(&[(0.15, 0.0, 2.0)]);
    assert_eq!(drive.slam.counts().accepted, 40);
}
