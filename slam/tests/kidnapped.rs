//! A robot that is carried elsewhere is lost at once and found again; one that stood or drove on without scans is neither.

mod common;
mod drive;

use common::{FULL, HALF, Lidar, NARROW, Wall, laboratory, rectangle};
use drive::{Drive, START, round, two_rooms, wander};
use msg::{Pose2, SlamMode, TrackingState};

#[test]
fn a_robot_carried_off_within_its_map_is_lost_draws_nothing_and_is_found() {
    for to in [Pose2::new(1.8, 0.4, 2.0), Pose2::new(0.4, 2.4, -1.4)] {
        let mut drive = Drive::new(laboratory(), FULL, START);
        drive.drive(&round());
        drive.carry_to(to);
        let carried = drive.said.len();
        drive.drive(&wander());
        let world_from_map = drive.said[0].2;
        assert_eq!(drive.said[carried].0, TrackingState::Lost);
        assert_eq!(drive.wrong(world_from_map, 0.2), 0, "it said to know where it was, and was wrong");
        let last = drive.said[drive.said.len() - 1];
        assert_ne!(last.0, TrackingState::Lost, "not found: {:?}", drive.slam.back_counts());
        assert_eq!(drive.slam.back_counts().unplaced, 0);
        // What it saw before it was found is in its place now, and so are all poses.
        let (ghosts, occupied) = drive.ghosts(world_from_map);
        assert!(ghosts == 0 && occupied > 500, "{ghosts} of {occupied} cells are no walls");
        for ((_, pose), (_, _, truth)) in drive.slam.trajectory().zip(&drive.said).skip(carried + 40) {
            assert!((world_from_map * pose).distance_m(*truth) < 0.2);
        }
    }
}

#[test]
fn a_narrow_view_leaves_no_ghost_either() {
    // With 90 degrees and 3.5 m, a wall may look like another for a while.
    let mut drive = Drive::new(laboratory(), NARROW, START);
    drive.drive(&round());
    drive.carry_to(Pose2::new(0.0, 2.0, 3.0));
    drive.drive(&wander());
    let world_from_map = drive.said[0].2;
    let (ghosts, occupied) = drive.ghosts(world_from_map);
    assert!(ghosts * 50 < occupied, "{ghosts} of {occupied} cells are no walls");
    let wrong = drive.wrong(world_from_map, 0.25);
    assert!(wrong < 120, "wrong in {wrong} scans");
}

#[test]
fn one_scan_of_another_view_after_a_gap_is_enough_where_both_scans_contradict_each_other() {
    let mut at_once = 0;
    for k in 0..24 {
        let angle_rad = f64::from(k) * core::f64::consts::TAU / 24.0;
        let mut drive = Drive::new(two_rooms(), FULL, START);
        drive.drive(&[(0.15, 0.1, 6.0)]);
        drive.carry_to(Pose2::new(20.0 + 2.0 * angle_rad.cos(), 1.5 * angle_rad.sin(), angle_rad));
        drive.drive(&[(0.0, 0.0, 0.1)]);
        if drive.slam.counts().odometry_breaks == 1 {
            at_once += 1;
            drive.drive(&[(0.15, 0.0, 2.0)]);
            let known = |(state, _, _): &&(TrackingState, Pose2, Pose2)| *state != TrackingState::Lost;
            assert_eq!(drive.said[60..].iter().filter(known).count(), 0, "angle {angle_rad:.1}");
        }
    }
    assert!(at_once >= 10, "{at_once} of 24");
}

#[test]
fn a_robot_that_stood_while_nothing_was_recorded_goes_on_although_somebody_stands_before_it() {
    for lidar in [FULL, HALF, NARROW] {
        let mut drive = Drive::new(laboratory(), lidar, START);
        drive.drive(&[(0.15, 0.1, 6.0)]);
        let stands = drive.robot.world_from_base;
        // Legs 0.8 m away that hide a quarter of what 90 degrees see, and 2 cm of motion.
        let [x, y] = stands.apply([0.8, 0.0]);
        drive.walls.extend(rectangle(x - 0.15, y - 0.15, x + 0.15, y + 0.15));
        drive.carry_to(Pose2::new(stands.x_m + 0.02, stands.y_m, stands.yaw_rad));
        drive.drive(&[(0.0, 0.0, 0.5), (0.0, 0.3, 4.0)]);
        let lost = drive.said[60..].iter().filter(|(state, _, _)| *state == TrackingState::Lost).count();
        assert_eq!(lost, 0);
        assert_eq!(drive.wrong(drive.said[0].2, 0.1), 0);
    }
}

/// A beam each 3 degrees, between which nothing tells whether a scan saw through a place.
const SPARSE: Lidar = Lidar { beams: 120, ..FULL };

/// The legs of a person who stands at this distance and angle from a pose.
fn person(at: Pose2, distance_m: f64, angle_rad: f64) -> Vec<Wall> {
    let [x, y] = at.apply([distance_m * angle_rad.cos(), distance_m * angle_rad.sin()]);
    rectangle(x - 0.15, y - 0.15, x + 0.15, y + 0.15)
}

#[test]
fn a_robot_carried_within_its_room_as_it_stood_is_lost_at_once() {
    // One carried by 1.2 m, with its heading, may see the walls that it saw before.
    let mut at_once = 0;
    for k in 0..24 {
        let angle_rad = f64::from(k) * core::f64::consts::TAU / 24.0;
        let mut drive = Drive::new(two_rooms(), SPARSE, START);
        drive.drive(&[(0.15, 0.1, 6.0)]);
        let stood = drive.robot.world_from_base;
        let [x_m, y_m] = [stood.x_m + 1.2 * angle_rad.cos(), stood.y_m + 1.2 * angle_rad.sin()];
        drive.carry_to(Pose2::new(x_m, y_m, stood.yaw_rad));
        drive.drive(&[(0.0, 0.0, 0.1)]);
        at_once += u64::from(drive.slam.counts().odometry_breaks == 1);
    }
    assert!(at_once >= 3, "{at_once} of 24");
}

#[test]
fn a_robot_that_stood_goes_on_although_somebody_went_and_somebody_else_came() {
    for (k, lidar) in [FULL, HALF, NARROW, SPARSE].into_iter().cycle().take(32).enumerate() {
        let angle_rad = f64::from(k as u32 / 4) * core::f64::consts::TAU / 8.0;
        let mut drive = Drive::new(laboratory(), lidar, START);
        let room = drive.walls.clone();
        drive.drive(&[(0.15, 0.1, 5.0)]);
        let stands = drive.robot.world_from_base;
        drive.walls.extend(person(stands, 0.9, angle_rad));
        drive.drive(&[(0.0, 0.0, 1.0)]);
        drive.walls = room;
        drive.walls.extend(person(stands, 0.9, angle_rad + 0.7));
        drive.carry_to(drive.robot.world_from_base);
        drive.drive(&[(0.0, 0.0, 0.5)]);
        assert_eq!(drive.slam.counts().odometry_breaks, 0, "case {k}");
    }
}

#[test]
fn a_robot_kidnapped_in_a_fixed_map_is_found_in_it() {
    let mut drive = Drive::new(laboratory(), FULL, START);
    drive.drive(&round());
    drive.slam.back_mut().set_mode(SlamMode::Localization);
    drive.drive(&[(0.15, 0.1, 4.0)]);
    drive.carry_to(Pose2::new(0.4, 2.4, -1.4));
    let carried = drive.said.len();
    drive.drive(&wander());
    assert_eq!(drive.said[carried].0, TrackingState::Lost);
    assert_eq!(drive.wrong(drive.said[0].2, 0.2), 0, "it said to know where it was, and was wrong");
    assert_ne!(drive.said[drive.said.len() - 1].0, TrackingState::Lost, "not found");
}

#[test]
fn a_robot_that_drove_on_without_scans_goes_on() {
    for (lidar, turn_rad_s) in [(FULL, 0.0), (FULL, 0.1), (HALF, 0.1), (NARROW, 0.05)] {
        let mut drive = Drive::new(laboratory(), lidar, START);
        drive.drive(&[(0.15, 0.1, 6.0)]);
        drive.drive_without_scans(0.13, turn_rad_s, 4.5);
        drive.drive(&[(0.0, 0.0, 0.5), (0.0, 0.3, 4.0)]);
        assert_eq!(drive.slam.counts().odometry_breaks, 0);
        let lost = drive.said[60..].iter().filter(|(state, _, _)| *state == TrackingState::Lost).count();
        assert_eq!((lost, drive.wrong(drive.said[0].2, 0.1)), (0, 0));
    }
}

/// A bare corridor along x whose ends are out of sight.
fn corridor() -> Vec<Wall> {
    rectangle(-60.0, -1.2, 60.0, 1.2).to_vec()
}

#[test]
fn a_robot_that_may_have_been_carried_along_a_corridor_says_so() {
    let in_corridor = || Drive::new(corridor(), Lidar { range_max_m: 8.0, ..FULL }, Pose2::IDENTITY);
    for carried_m in [0.0, 1.0, -2.0] {
        let mut drive = in_corridor();
        drive.drive(&[(0.15, 0.0, 6.0)]);
        let before_m = drive.covariance[0].sqrt();
        let Pose2 { x_m, y_m, yaw_rad } = drive.robot.world_from_base;
        drive.carry_to(Pose2::new(x_m + carried_m, y_m, yaw_rad));
        // The map's frame is told some nodes later.
        drive.drive(&[(0.15, 0.0, 20.0)]);
        let (along_m, across_m) = (drive.covariance[0].sqrt(), drive.covariance[3].sqrt());
        let (_, said, truth) = drive.said[drive.said.len() - 1];
        let error_m = (drive.said[0].2 * said).distance_m(truth);
        assert!(before_m < 0.1 && across_m < 0.05, "{before_m} m before, {across_m} m across");
        assert!(along_m > 1.0 && error_m < 2.0 * along_m, "{along_m} m along, error {error_m} m");
    }
    // Pauses of 3 s carry nobody, and neither do those in which odometry tells that it is there.
    let mut short = in_corridor();
    short.drive(&[(0.15, 0.0, 6.0)]);
    short.pause(3.0);
    short.drive(&[(0.15, 0.0, 20.0)]);
    assert!(short.covariance[0].sqrt() < 0.3, "{:?}", short.covariance);
    let mut without_scans = in_corridor();
    without_scans.drive(&[(0.15, 0.0, 6.0)]);
    without_scans.drive_without_scans(0.0, 0.0, 6.0);
    without_scans.drive(&[(0.15, 0.0, 20.0)]);
    assert!(without_scans.covariance[0].sqrt() < 0.3, "{:?}", without_scans.covariance);
}

#[test]
fn scans_after_a_pause_are_not_placed_by_the_node_before_it() {
    // A person may have put the robot down farther on in a corridor.
    for carried_m in [-2.0, 0.0, 2.0] {
        let mut drive = Drive::new(corridor(), FULL, Pose2::IDENTITY);
        drive.drive(&[(0.15, 0.0, 6.0)]);
        let nodes = drive.slam.back().nodes().len();
        let Pose2 { x_m, y_m, yaw_rad } = drive.robot.world_from_base;
        drive.carry_to(Pose2::new(x_m + carried_m, y_m, yaw_rad));
        drive.drive(&[(0.0, 0.0, 1.0)]);
        let after: Vec<bool> =
            drive.slam.back().nodes()[nodes..].iter().map(|node| node.possibly_kidnapped).collect();
        assert_eq!(after, [true], "the first scan becomes a node, and the others no further ones");
    }
}

#[test]
fn a_robot_that_stood_in_a_room_without_data_knows_its_place() {
    for lidar in [FULL, HALF, NARROW] {
        let [paused, went_on] = [true, false].map(|pauses| {
            let mut drive = Drive::new(laboratory(), lidar, START);
            drive.drive(&[(0.15, 0.1, 6.0)]);
            drive.pause(if pauses { 10.0 } else { 0.0 });
            drive.drive(&[(0.15, 0.1, 6.0)]);
            let sigma_m = |drive: &Drive| (drive.covariance[0] + drive.covariance[3]).sqrt();
            assert!(sigma_m(&drive) < 0.1, "{:?}", drive.covariance);
            // The map's frame is told some nodes later.
            drive.drive(&[(0.15, 0.1, 14.0)]);
            assert_eq!(drive.slam.back().nodes().iter().any(|node| node.possibly_kidnapped), pauses);
            assert_eq!(drive.wrong(drive.said[0].2, 0.1), 0);
            assert!(drive.said.iter().all(|(state, ..)| *state != TrackingState::Lost));
            sigma_m(&drive)
        });
        assert!(paused < 1.1 * went_on, "{paused} m with a pause, {went_on} m without");
    }
}

#[test]
fn a_robot_carried_to_another_room_stays_lost_until_it_knows_that_one_better() {
    let mut drive = Drive::new(two_rooms(), FULL, START);
    drive.drive(&round());
    let (nodes, carried) = (drive.slam.back_counts().nodes, drive.said.len());
    drive.carry_to(Pose2::new(18.5, -1.5, 0.3));
    drive.drive(&wander());
    let world_from_map = drive.said[0].2;
    assert!(drive.said[carried..].iter().all(|(state, ..)| *state == TrackingState::Lost));
    let counts = drive.slam.back_counts();
    assert!(counts.unplaced > 15 && counts.unplaced < nodes, "{counts:?}");
    let (ghosts, occupied) = drive.ghosts(world_from_map);
    assert!(ghosts == 0 && occupied > 500, "{ghosts} of {occupied} cells are no walls");
    assert_eq!(drive.slam.back().map_frame_changes(), 0);
    // The larger component is the map in the end: the other one is held back then.
    for _ in 0..4 {
        drive.drive(&wander());
    }
    let counts = drive.slam.back_counts();
    assert_eq!(counts.unplaced, nodes, "{counts:?}");
    assert_eq!(drive.slam.back().map_frame_changes(), 1, "its start says nothing of this map");
    let (state, said, truth) = drive.said[drive.said.len() - 1];
    assert_eq!(state, TrackingState::Tracking);
    let world_from_map = truth * said.inverse();
    let (ghosts, occupied) = drive.ghosts(world_from_map);
    assert!(ghosts * 50 < occupied && occupied > 500, "{ghosts} of {occupied} cells are no walls");
}

#[test]
fn a_robot_carried_back_is_found_in_an_unplaced_component() {
    let mut drive = Drive::new(two_rooms(), FULL, START);
    drive.drive(&round());
    let nodes = drive.slam.back_counts().nodes;
    drive.carry_to(Pose2::new(18.5, -1.5, 0.3));
    (0..5).for_each(|_| drive.drive(&wander()));
    assert_eq!(drive.slam.back_counts().unplaced, nodes, "the second room is the map");
    drive.carry_to(Pose2::new(1.8, 0.4, 2.0));
    drive.drive(&wander());
    let components = drive.slam.back().unplaced_component_count();
    assert_eq!(components, 1, "what it sees now is part of the first room: {:?}", drive.slam.back_counts());
}

/// A room of 5 by 3.5 m: from 0.8 m away along it, its long walls look the same.
fn plain_room() -> Vec<Wall> {
    rectangle(-2.0, -1.5, 3.0, 2.0)
}

#[test]
fn a_robot_that_was_moved_while_its_driver_was_started_again_draws_no_wall_twice() {
    for (k, distance_m) in [0.4, 0.6, 0.8, 1.0].into_iter().cycle().take(16).enumerate() {
        let angle_rad = k as f64 * core::f64::consts::TAU / 16.0;
        let mut drive = Drive::new(plain_room(), FULL, Pose2::new(0.0, 0.0, 0.2));
        drive.drive(&[(0.1, 0.1, 10.0)]);
        let stood = drive.robot.world_from_base;
        let [x_m, y_m] = stood.apply([distance_m * angle_rad.cos(), distance_m * angle_rad.sin()]);
        drive.restart_driver_at(Pose2::new(x_m, y_m, stood.yaw_rad));
        drive.drive(&[(0.1, 0.2, 10.0)]);
        let world_from_map = drive.said[0].2;
        let wrong = drive.wrong(world_from_map, 0.2);
        let (ghosts, occupied) = drive.ghosts(world_from_map);
        assert!(
            wrong == 0 && ghosts == 0,
            "{distance_m} m, {angle_rad:.1}: wrong {wrong}, {ghosts} of {occupied}"
        );
    }
}

#[test]
fn a_robot_that_stood_while_its_driver_was_started_again_goes_on() {
    for (k, lidar) in [FULL, HALF, NARROW, SPARSE].into_iter().cycle().take(16).enumerate() {
        for walls in [plain_room(), laboratory()] {
            let mut drive = Drive::new(walls, lidar, START);
            drive.drive(&[(0.1, 0.1, 2.0 + 0.5 * k as f64)]);
            drive.restart_driver_at(drive.robot.world_from_base);
            drive.drive(&[(0.0, 0.0, 0.5), (0.1, 0.3, 2.0)]);
            assert_eq!(drive.slam.counts().odometry_breaks, 0, "{k}");
        }
    }
}
