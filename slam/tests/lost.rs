//! How sure SLAM is of what it says: a robot that is carried off, corridors, the covariance, and
//! clocks that are set back.

mod common;

use common::{FULL, HALF, Lidar, NARROW, Noise, Robot, Wall, cast, laboratory, rectangle};
use msg::grid::{Occupancy, occupancy};
use msg::{Pose2, TrackingState};
use slam::{Slam, SlamConfig};

/// Two rooms without a door between them: what a robot sees that is carried from one to the other.
fn two_rooms() -> Vec<Wall> {
    let mut walls = laboratory();
    let shift = |[x, y]: [f64; 2]| [x + 20.0, y];
    let other =
        [(-4.0, -3.0, 3.0, 2.5), (-3.5, 1.0, -2.0, 2.0), (0.5, -2.5, 1.0, -0.5), (1.8, 1.2, 2.6, 2.0)];
    let other = other.iter().flat_map(|b| rectangle(b.0, b.1, b.2, b.3));
    walls.extend(other.map(|wall| wall.map(shift)));
    walls
}

/// A robot, its SLAM, and what it said of each scan.
struct Drive {
    walls: Vec<Wall>,
    lidar: Lidar,
    robot: Robot,
    noise: Noise,
    slam: Slam,
    /// State, `map_from_base` as said, and the truth.
    said: Vec<(TrackingState, Pose2, Pose2)>,
}

impl Drive {
    fn new(walls: Vec<Wall>, lidar: Lidar, start: Pose2) -> Self {
        let slam = Slam::new(SlamConfig::default());
        Self { walls, lidar, robot: Robot::new(start), noise: Noise::new(3), slam, said: Vec::new() }
    }

    /// Legs of (linear m/s, angular rad/s, seconds) at ten scans a second.
    fn drive(&mut self, legs: &[(f64, f64, f64)]) {
        for &(linear, angular, seconds) in legs {
            for _ in 0..(seconds * 10.0).round() as usize {
                self.robot.drive(linear, angular, 0.1, &mut self.noise);
                self.slam.add_odometry(&self.robot.odometry());
                let (pose, stamp) = (self.robot.world_from_base, self.robot.stamp());
                let scan = cast(&self.walls, &self.lidar, pose, stamp, &mut self.noise);
                let pose_estimate = self.slam.process(&scan).pose_estimate;
                self.slam.work();
                self.said.push((pose_estimate.state(), pose_estimate.map_from_base, pose));
            }
        }
    }

    /// Somebody lifts it, for a moment it sees nothing, and puts it down elsewhere.
    fn carry_to(&mut self, pose: Pose2) {
        self.robot.world_from_base = pose;
        self.robot.time_s += 5.0;
    }

    /// Scans that were said to be known, though they were off by more than this.
    fn wrong(&self, world_from_map: Pose2, most_m: f64) -> usize {
        let wrong = |(state, said, truth): &&(TrackingState, Pose2, Pose2)| {
            *state != TrackingState::Lost && (world_from_map * *said).distance_m(*truth) > most_m
        };
        self.said.iter().filter(wrong).count()
    }

    /// Occupied cells of the map that are no wall.
    fn ghosts(&mut self, world_from_map: Pose2) -> (usize, usize) {
        let walls = self.walls.clone();
        let grid = self.slam.map();
        let (mut ghosts, mut occupied) = (0, 0);
        for y in 0..i64::from(grid.header.height) {
            for x in 0..i64::from(grid.header.width) {
                if occupancy(grid.cell(x, y)) != Occupancy::Occupied {
                    continue;
                }
                occupied += 1;
                let at = [x as f64 + 0.5, y as f64 + 0.5].map(|v| v * grid.header.resolution_m);
                let at = (world_from_map * grid.header.origin).apply(at);
                ghosts += usize::from(walls.iter().all(|wall| away(wall, at) > 0.2));
            }
        }
        (ghosts, occupied)
    }
}

fn away([a, b]: &Wall, p: [f64; 2]) -> f64 {
    let (ex, ey) = (b[0] - a[0], b[1] - a[1]);
    let t = (((p[0] - a[0]) * ex + (p[1] - a[1]) * ey) / (ex * ex + ey * ey)).clamp(0.0, 1.0);
    (p[0] - a[0] - t * ex).hypot(p[1] - a[1] - t * ey)
}

/// A round through the laboratory.
fn round() -> Vec<(f64, f64, f64)> {
    let quarter = (0.0, 0.5, core::f64::consts::PI);
    let (long, short) = ((0.15, 0.0, 20.0), (0.15, 0.0, 8.0));
    vec![short, quarter, long, quarter, short, short, quarter, long, quarter, short]
}

const START: Pose2 = Pose2 { x_m: -1.0, y_m: -1.4, yaw_rad: 0.0 };

fn wander() -> Vec<(f64, f64, f64)> {
    vec![(0.15, 0.1, 12.0), (0.0, 0.5, 4.0), (0.15, 0.1, 12.0), (0.15, -0.2, 12.0), (0.0, 0.5, 12.6)]
}

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
fn wheels_that_stood_while_another_view_came_do_not_say_where_the_robot_is() {
    for k in 0..24 {
        let angle_rad = f64::from(k) * core::f64::consts::TAU / 24.0;
        let mut drive = Drive::new(two_rooms(), FULL, START);
        drive.drive(&[(0.15, 0.1, 6.0)]);
        let (x_m, y_m) = (20.0 + 2.0 * angle_rad.cos(), 1.5 * angle_rad.sin());
        drive.carry_to(Pose2::new(x_m, y_m, angle_rad));
        drive.drive(&[(0.0, 0.0, 0.1), (0.15, 0.0, 2.0)]);
        let (found, _, _) = drive.said[drive.said.len() - 21];
        assert_eq!(found, TrackingState::Lost, "carried to {x_m:.1}, {y_m:.1}, {angle_rad:.1}");
        let known = drive.said[60..].iter().filter(|(state, _, _)| *state != TrackingState::Lost).count();
        assert_eq!(known, 0, "carried to {x_m:.1}, {y_m:.1}, {angle_rad:.1}");
    }
}

#[test]
fn a_robot_that_stood_while_nothing_was_recorded_goes_on_although_somebody_stands_before_it() {
    for lidar in [FULL, HALF, NARROW] {
        let mut drive = Drive::new(laboratory(), lidar, START);
        drive.drive(&[(0.15, 0.1, 6.0)]);
        let stands = drive.robot.world_from_base;
        // Legs 0.8 m away that hide a quarter of what 90 degrees see, and a hand's width of motion.
        let [x, y] = stands.apply([0.8, 0.0]);
        drive.walls.extend(rectangle(x - 0.15, y - 0.15, x + 0.15, y + 0.15));
        drive.carry_to(Pose2::new(stands.x_m + 0.02, stands.y_m, stands.yaw_rad));
        drive.drive(&[(0.0, 0.0, 0.5), (0.0, 0.3, 4.0)]);
        let lost = drive.said[60..].iter().filter(|(state, _, _)| *state == TrackingState::Lost).count();
        assert_eq!(lost, 0);
        assert_eq!(drive.wrong(drive.said[0].2, 0.1), 0);
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
    // The larger component is the map in the end: the other one is held back then.
    for _ in 0..4 {
        drive.drive(&wander());
    }
    let counts = drive.slam.back_counts();
    assert_eq!(counts.unplaced, nodes, "{counts:?}");
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

/// In a small room the covariance is hardly more than that of the pose in the local map, so it is held against the motion
/// since a scan a moment ago, of which it is about half the uncertainty: normalised estimation error squared of
/// (x, y, yaw), whose mean is 3 if it is right (Bar-Shalom, Li, Kirubarajan, "Estimation with
/// applications to tracking and navigation", 2001, section 5.4).
#[test]
fn the_covariance_is_about_what_the_error_is() {
    for (lidar, low, high) in [(FULL, 0.1, 3.0), (HALF, 0.1, 3.0), (NARROW, 0.1, 3.0)] {
        let lidar = Lidar { sigma_m: 0.03, ..lidar };
        let mut drive = Drive::new(laboratory(), lidar, START);
        let mut nees = Vec::new();
        let mut before: Option<(Pose2, Pose2, [f64; 6])> = None;
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
                let now = (pose_estimate.map_from_base, truth, pose_estimate.covariance);
                let known = pose_estimate.state() != TrackingState::Lost;
                if let (Some((said, was, covariance)), true) = (before, known) {
                    let error = was.between(truth).inverse() * said.between(now.0);
                    // In axes of the robot, both uncertainties together.
                    let p = [covariance, now.2].map(|c| turned(c, -now.0.yaw_rad));
                    let e = nalgebra::Vector3::new(error.x_m, error.y_m, error.yaw_rad);
                    let inverse = (p[0] + p[1]).try_inverse().unwrap();
                    nees.push((e.transpose() * inverse * e).x);
                }
                before = known.then_some(now);
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
