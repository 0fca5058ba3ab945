//! A robot in a known world: its map and poses must be right, the same every time, wherever the
//! work beside the scan path happens.

mod common;

use common::{FULL, HALF, Lidar, NARROW, Noise, Robot, Wall, cast, laboratory, ring};
use msg::grid::{Occupancy, occupancy};
use msg::{Pose2, TrackingState};
use slam::{Slam, SlamConfig};

/// What a drive left behind.
struct Drive {
    slam: Slam,
    /// Robot's start, the origin of its map.
    world_from_map: Pose2,
    truth: Vec<Pose2>,
    odometry_error_m: f64,
    states: Vec<TrackingState>,
}

impl Drive {
    /// Mean and largest distance between the final trajectory and the truth, metres; largest turn, radians.
    fn errors(&self) -> (f64, f64, f64) {
        let (mut sum, mut most, mut turned) = (0.0, 0.0_f64, 0.0_f64);
        for (truth, (_, pose)) in self.truth.iter().zip(self.slam.trajectory()) {
            let wanted = self.world_from_map.between(*truth);
            let apart = wanted.distance_m(pose);
            sum += apart;
            most = most.max(apart);
            turned = turned.max(msg::pose::wrap_angle(wanted.yaw_rad - pose.yaw_rad).abs());
        }
        (sum / self.truth.len() as f64, most, turned)
    }
}

/// Drives at 10 scans a second along (linear m/s, angular rad/s, seconds) legs.
fn drive(walls: &[Wall], lidar: &Lidar, start: Pose2, legs: &[(f64, f64, f64)], work: bool) -> Drive {
    let mut noise = Noise::new(7);
    let mut robot = Robot::new(start);
    let mut slam = Slam::new(SlamConfig::default());
    let (mut truth, mut states) = (Vec::new(), Vec::new());
    for &(linear, angular, seconds) in legs {
        for _ in 0..(seconds * 10.0).round() as usize {
            for _ in 0..2 {
                robot.drive(linear, angular, 0.05, &mut noise);
                slam.add_odometry(&robot.odometry());
            }
            let scan = cast(walls, lidar, robot.world_from_base, robot.stamp(), &mut noise);
            let result = slam.process(&scan);
            assert_eq!(result.rejected, None);
            states.push(result.pose_estimate.state());
            truth.push(robot.world_from_base);
            if work {
                slam.work();
            }
        }
    }
    slam.finish();
    let world_from_map = truth[0];
    let accepted = robot.odom_from_base;
    let odometry_error_m = (start * accepted).distance_m(robot.world_from_base);
    Drive { slam, world_from_map, truth, odometry_error_m, states }
}

/// A round through the laboratory: legs of driving and turning on the spot.
fn round() -> Vec<(f64, f64, f64)> {
    let quarter = (0.0, 0.5, core::f64::consts::PI);
    let (long, short) = ((0.15, 0.0, 20.0), (0.15, 0.0, 8.0));
    vec![short, quarter, long, quarter, short, short, quarter, long, quarter, short, (0.0, 1.5, 4.2)]
}

fn laboratory_start() -> Pose2 {
    Pose2::new(-1.0, -1.4, 0.0)
}

#[test]
fn holds_a_map_with_90_degrees() {
    let done = drive(&laboratory(), &NARROW, laboratory_start(), &round(), true);
    let (mean, most, turned) = done.errors();
    assert!(done.odometry_error_m > 0.3, "odometry alone is off by {} m", done.odometry_error_m);
    assert!(mean < 0.04 && most < 0.1 && turned < 0.08, "{mean} {most} {turned}");
    // Here and there nothing is within 3.5 m.
    let lost = done.states.iter().filter(|s| **s == TrackingState::Lost).count();
    assert!(lost * 10 < done.states.len(), "{lost} of {} lost", done.states.len());
}

#[test]
fn holds_a_map_with_360_degrees() {
    let mut done = drive(&laboratory(), &FULL, laboratory_start(), &round(), true);
    let (mean, most, turned) = done.errors();
    assert!(mean < 0.02 && most < 0.06 && turned < 0.03, "{mean} {most} {turned}");
    let map_from_world = done.world_from_map.inverse();
    let grid = done.slam.map();
    let near = |at: [f64; 2], wanted: Occupancy| {
        let (x, y) = grid.cell_of(map_from_world.apply(at));
        (-1..=1).any(|dx| (-1..=1).any(|dy| occupancy(grid.cell(x + dx, y + dy)) == wanted))
    };
    for y in [-2.0, -1.0, 0.0, 1.0, 2.0] {
        assert!(near([3.0, y], Occupancy::Occupied), "east wall at {y}");
        assert!(near([-3.0, y], Occupancy::Occupied), "west wall at {y}");
        assert!(near([0.3, y], Occupancy::Free), "floor at {y}");
    }
    assert!(near([3.4, 0.0], Occupancy::Unknown), "behind the east wall");
}

/// A log of the ring, one scan each 0.5 m, two rounds and a bit; wheels that veer.
fn ring_log(lidar: &Lidar) -> (Vec<(msg::Odometry, Box<msg::Scan>)>, Vec<Pose2>) {
    let walls = ring(3);
    let mut noise = Noise::new(11);
    let mut robot = Robot::new(Pose2::new(-7.8, -5.8, 0.0));
    robot.veer_rad_per_m = 0.01;
    let (mut log, mut truth) = (Vec::new(), Vec::new());
    for _ in 0..2 {
        for side_m in [15.6, 11.6, 15.6, 11.6] {
            let legs = (0..(side_m / 0.4) as usize)
                .map(|_| (0.4, 0.0))
                .chain((0..4).map(|_| (0.0, core::f64::consts::FRAC_PI_8)));
            for (way, turn) in legs {
                robot.drive(way, turn, 1.0, &mut noise);
                let scan = cast(&walls, lidar, robot.world_from_base, robot.stamp(), &mut noise);
                log.push((robot.odometry(), scan));
                truth.push(robot.world_from_base);
            }
        }
    }
    (log, truth)
}

fn run(log: &[(msg::Odometry, Box<msg::Scan>)], config: SlamConfig, work_each: usize) -> Slam {
    let mut slam = Slam::new(config);
    for (i, (odometry, scan)) in log.iter().enumerate() {
        slam.add_odometry(odometry);
        slam.process(scan);
        if i % work_each == 0 {
            slam.work();
        }
    }
    slam.finish();
    slam
}

fn mean_error(slam: &Slam, truth: &[Pose2]) -> f64 {
    let errors = truth.iter().zip(slam.trajectory()).map(|(t, (_, p))| truth[0].between(*t).distance_m(p));
    errors.sum::<f64>() / truth.len() as f64
}

#[test]
fn closing_the_ring_reduces_the_error() {
    // Odometry and a LiDAR that sees 4 m leave real drift in the corridors.
    let lidar = Lidar { range_max_m: 4.0, sigma_m: 0.02, ..HALF };
    let (log, truth) = ring_log(&lidar);
    let closed = run(&log, SlamConfig::default(), 1);
    let mut open = SlamConfig::default();
    open.closures.enabled = false;
    open.links.near = 0;
    let open = run(&log, open, 1);
    let (with, without) = (mean_error(&closed, &truth), mean_error(&open, &truth));
    assert_eq!(open.back_counts().closures, 0);
    assert!(with < 0.1 && with < 0.6 * without, "with closures {with} m, without {without} m");
}

#[test]
fn the_same_log_gives_the_same_bits() {
    let (log, _) = ring_log(&HALF);
    let bits = |slam: &mut Slam| {
        let poses: Vec<[u64; 3]> =
            slam.trajectory().map(|(_, p)| [p.x_m, p.y_m, p.yaw_rad].map(f64::to_bits)).collect();
        (poses, slam.map().to_owned())
    };
    let wanted = bits(&mut run(&log, SlamConfig::default(), 1));
    assert_eq!(wanted.0.len(), log.len());
    // Work that lags behind changes nothing.
    let late = bits(&mut run(&log, SlamConfig::default(), 9));
    assert!(wanted == late);
    // Nor does another thread.
    let (mut front, mut back) = Slam::new(SlamConfig::default()).split();
    let (send, receive) = std::sync::mpsc::sync_channel(slam::NODES_IN_FLIGHT_MAX - 2);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            for node in receive {
                back.add_node(node);
            }
            back.finish();
        });
        for (odometry, scan) in &log {
            front.add_odometry(odometry);
            if let Some(node) = front.process(scan).node {
                let _ = send.send(node);
            }
        }
        drop(send);
    });
    let threaded: Vec<[u64; 3]> =
        slam::trajectory(&front, &back).map(|(_, p)| [p.x_m, p.y_m, p.yaw_rad].map(f64::to_bits)).collect();
    assert!(wanted.0 == threaded);
    assert!(wanted.1 == back.map().to_owned());
}

#[test]
fn scans_alone_are_enough_in_a_room() {
    let walls = laboratory();
    let mut noise = Noise::new(5);
    let mut robot = Robot::new(laboratory_start());
    let mut slam = Slam::new(SlamConfig::default());
    let mut truth = Vec::new();
    for (linear, angular, seconds) in round() {
        for _ in 0..(seconds * 10.0) as usize {
            robot.drive(linear, angular, 0.1, &mut noise);
            slam.process(&cast(&walls, &FULL, robot.world_from_base, robot.stamp(), &mut noise));
            slam.work();
            truth.push(robot.world_from_base);
        }
    }
    slam.finish();
    let error = mean_error(&slam, &truth);
    assert!(error < 0.05, "{error} m");
}

#[test]
fn a_back_end_that_falls_behind_holds_nothing_up_and_leaves_no_gap() {
    let walls = laboratory();
    let mut noise = Noise::new(5);
    let mut robot = Robot::new(laboratory_start());
    let mut config = SlamConfig::default();
    config.tracking.node_distance_m = 0.05;
    config.tracking.node_turn_rad = 0.1;
    let (mut front, mut back) = Slam::new(config).split();
    let mut waiting = Vec::new();
    let mut truth = Vec::new();
    for (linear, angular, seconds) in round() {
        for _ in 0..(seconds * 10.0) as usize {
            robot.drive(linear, angular, 0.1, &mut noise);
            front.add_odometry(&robot.odometry());
            let scan = cast(&walls, &FULL, robot.world_from_base, robot.stamp(), &mut noise);
            waiting.extend(front.process(&scan).node);
            truth.push(robot.world_from_base);
        }
        // It wakes up once, half way.
        if truth.len() > 500 && back.nodes().is_empty() {
            assert_eq!(waiting.len(), slam::NODES_IN_FLIGHT_MAX);
            for node in waiting.drain(..) {
                back.add_node(node);
            }
        }
    }
    assert!(front.counts().nodes_held_back > 10, "{:?}", front.counts());
    let count = back.nodes().len() + waiting.len();
    assert!(count > slam::NODES_IN_FLIGHT_MAX, "{count}");
    for node in waiting.drain(..) {
        back.add_node(node);
    }
    back.finish();
    let poses: Vec<Pose2> = slam::trajectory(&front, &back).map(|(_, pose)| pose).collect();
    assert_eq!(poses.len(), truth.len());
    for (truth_pose, pose) in truth.iter().zip(poses) {
        let apart = truth[0].between(*truth_pose).distance_m(pose);
        assert!(apart < 0.08, "{apart} m");
    }
}
