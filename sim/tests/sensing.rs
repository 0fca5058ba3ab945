//! Measurements of the LiDAR, the peers that it sees, and their repeatability.

mod common;

use bytemuck::Zeroable;
use common::{Run, drive, quiet, robot, scan};
use core::f64::consts::FRAC_PI_2;
use glam::DQuat;
use msg::pose::wrap_angle;
use msg::{GroundTruth, Header, Pose2, RobotFrame, RobotId, Scan, Stamp};
use rand_xoshiro::SplitMix64;
use rand_xoshiro::rand_core::{Rng as _, SeedableRng as _};
use sim::{LidarConfig, NoiseConfig, Room, SimConfig, Simulator};

const OPEN: Pose2 = Pose2::new(-1.2, -1.7, 0.6);

/// A closed box: 4 m along x, 3 m along y, the origin in the middle of its floor, z up.
fn box_room() -> Room {
    let obj = "# up z\n\
        v -2 -1.5 0\nv 2 -1.5 0\nv 2 1.5 0\nv -2 1.5 0\n\
        v -2 -1.5 2\nv 2 -1.5 2\nv 2 1.5 2\nv -2 1.5 2\n\
        f 1 2 3 4\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n";
    Room::from_bytes("box.obj", obj.as_bytes()).unwrap()
}

/// Distance to the walls of [`box_room`] from a point in a direction.
fn box_distance_m(from: [f64; 2], angle_rad: f64) -> f64 {
    let (sin, cos) = angle_rad.sin_cos();
    let along = |half: f64, at: f64, step: f64| ((half * step.signum() - at) / step).abs();
    along(2.0, from[0], cos).min(along(1.5, from[1], sin))
}

fn with(lidar: LidarConfig) -> SimConfig {
    SimConfig { lidar, ..quiet() }
}

#[test]
fn ranges_equal_the_distances_to_the_walls() {
    let room = box_room();
    for (_, lidar) in LidarConfig::PRESETS {
        let start = Pose2::new(0.4, -0.3, 0.8);
        let mut simulator = Simulator::new(&room, &with(lidar), robot(1), start, 1).unwrap();
        let truth = (0..50).map(|_| simulator.step().truth).last().unwrap();
        let scan = scan(&mut simulator);
        assert_eq!(scan.ranges_m().len(), lidar.beams);
        assert_eq!(scan.header.stamp, Stamp(500_000_000));
        let world_from_scan = truth.world_from_base * Pose2::new(-0.032, 0.0, 0.0);
        for (i, range) in scan.ranges_m().iter().enumerate() {
            let angle = world_from_scan.yaw_rad + f64::from(scan.angle_rad(i));
            let expected = box_distance_m([world_from_scan.x_m, world_from_scan.y_m], angle);
            assert!((f64::from(*range) - expected).abs() < 0.003, "beam {i}: {range} {expected}");
        }
    }
}

#[test]
fn presets_have_the_beams_of_their_data_sheets() {
    let mut simulator = Simulator::new(&box_room(), &quiet(), robot(1), Pose2::IDENTITY, 1).unwrap();
    let paper = scan(&mut simulator);
    assert_eq!((paper.len, paper.scan_time_s, paper.time_increment_s), (180, 0.1, 0.0));
    let quarter = core::f32::consts::FRAC_PI_4;
    assert!((paper.angle_min_rad + quarter).abs() < 1e-6 && (paper.angle_rad(179) - quarter).abs() < 1e-5);
    let config = with(LidarConfig::LDS_01);
    let mut simulator = Simulator::new(&box_room(), &config, robot(1), Pose2::IDENTITY, 1).unwrap();
    let lds = scan(&mut simulator);
    assert_eq!((lds.len, lds.angle_min_rad), (360, 0.0));
    assert!((lds.angle_increment_rad - 1f32.to_radians()).abs() < 1e-7, "no beam doubles");
}

#[test]
fn ranges_beyond_the_limits_follow_rep_117() {
    let near = LidarConfig { range_max_m: 1.0, ..LidarConfig::LDS_01 };
    let mut simulator = Simulator::new(&box_room(), &with(near), robot(1), Pose2::IDENTITY, 1).unwrap();
    assert!(scan(&mut simulator).ranges_m().iter().all(|range| *range == f32::INFINITY));
    let far = LidarConfig { range_min_m: 1.8, ..LidarConfig::LDS_02 };
    let mut simulator = Simulator::new(&box_room(), &with(far), robot(1), Pose2::IDENTITY, 1).unwrap();
    let scan = scan(&mut simulator);
    assert_eq!(scan.ranges_m()[90], f32::NEG_INFINITY, "the wall is 1.5 m away, nearer than 1.8 m");
    assert!((scan.ranges_m()[0] - 2.032).abs() < 0.002);
}

#[test]
fn noise_has_the_configured_standard_deviation() {
    let noise = NoiseConfig { range_std_m: 0.02, dropout_probability: 0.1, ..NoiseConfig::OFF };
    let config = SimConfig { noise, ..with(LidarConfig { beams: 4096, ..LidarConfig::LDS_01 }) };
    let clean = with(config.lidar);
    let measure = |config: &SimConfig| {
        scan(&mut Simulator::new(&box_room(), config, robot(1), Pose2::IDENTITY, 5).unwrap())
    };
    let (noisy, clean) = (measure(&config), measure(&clean));
    let errors: Vec<f64> = noisy
        .ranges_m()
        .iter()
        .zip(clean.ranges_m())
        .filter(|(noisy, _)| !noisy.is_nan())
        .map(|(noisy, clean)| f64::from(noisy - clean))
        .collect();
    let dropped = 1.0 - errors.len() as f64 / 4096.0;
    assert!((dropped - 0.1).abs() < 0.02, "{dropped}");
    let mean = errors.iter().sum::<f64>() / errors.len() as f64;
    let std = (errors.iter().map(|e| (e - mean).powi(2)).sum::<f64>() / errors.len() as f64).sqrt();
    assert!(mean.abs() < 0.002 && (std - 0.02).abs() < 0.001, "{mean} {std}");
}

#[test]
fn a_scan_sets_every_field_except_those_of_the_channel() {
    let mut simulator = Simulator::new(&box_room(), &quiet(), robot(1), Pose2::IDENTITY, 1).unwrap();
    simulator.step();
    let mut dirty = Box::new(Scan::zeroed());
    bytemuck::bytes_of_mut(&mut *dirty).fill(0xA5);
    let header = dirty.header;
    simulator.scan_into(&mut dirty);
    let mut clean = scan(&mut simulator);
    clean.header = Header { stamp: clean.header.stamp, ..header };
    assert!(bytemuck::bytes_of(&*dirty) == bytemuck::bytes_of(&*clean));
}

/// Records all messages of a robot in 10 s of driving, as bytes.
fn record(seed: u64, robot: RobotId) -> Vec<u8> {
    let room = Room::laboratory();
    let mut simulator = Simulator::new(&room, &SimConfig::default(), robot, OPEN, seed).unwrap();
    let mut bytes = Vec::new();
    for tick in 0..1000 {
        simulator.set_velocity_command(&drive(0.15, if tick % 300 < 150 { 0.7 } else { -0.4 }));
        let tick = simulator.step();
        bytes.extend_from_slice(bytemuck::bytes_of(&tick.truth));
        tick.odometry.iter().for_each(|odometry| bytes.extend_from_slice(bytemuck::bytes_of(odometry)));
        tick.transforms.iter().for_each(|tf| bytes.extend_from_slice(bytemuck::bytes_of(tf)));
        if tick.scan_due {
            bytes.extend_from_slice(bytemuck::bytes_of(&*scan(&mut simulator)));
        }
    }
    bytes
}

#[test]
fn the_same_seed_gives_the_same_bytes() {
    let first = record(7, robot(1));
    assert!(first == record(7, robot(1)));
    assert!(first != record(8, robot(1)));
    assert!(first != record(7, robot(2)));
}

#[test]
fn transforms_equal_those_of_the_turtlebot3() {
    let mut config = quiet();
    config.noise.heading = sim::HeadingSource::Wheels;
    let mut simulator = Simulator::new(&box_room(), &config, robot(1), Pose2::IDENTITY, 1).unwrap();
    let mut last = None;
    for _ in 0..100 {
        simulator.set_velocity_command(&drive(0.15, 0.2));
        let tick = simulator.step();
        last = tick.transforms.zip(tick.odometry).or(last);
    }
    let (transforms, odometry) = last.unwrap();
    let edges: Vec<_> = transforms.transforms().iter().map(|t| (t.parent_frame, t.child_frame)).collect();
    let edge = |parent: RobotFrame, child: RobotFrame| (parent as u32, child as u32);
    assert_eq!(
        edges,
        [
            edge(RobotFrame::Odom, RobotFrame::BaseFootprint),
            edge(RobotFrame::BaseFootprint, RobotFrame::BaseLink),
            edge(RobotFrame::BaseLink, RobotFrame::BaseScan),
            edge(RobotFrame::BaseLink, RobotFrame::WheelLeft),
            edge(RobotFrame::BaseLink, RobotFrame::WheelRight),
            edge(RobotFrame::BaseLink, RobotFrame::Imu),
        ]
    );
    let base = transforms.transforms()[0];
    assert_eq!(base.translation_m, [odometry.odom_from_base.x_m, odometry.odom_from_base.y_m, 0.0]);
    let half_yaw = odometry.odom_from_base.yaw_rad / 2.0;
    assert!((base.rotation_xyzw[2] - half_yaw.sin()).abs() < 1e-12);
    for transform in transforms.transforms() {
        let norm: f64 = transform.rotation_xyzw.iter().map(|c| c * c).sum();
        assert!((norm - 1.0).abs() < 1e-9);
    }
    // Out of a wheel's lying frame: its turn about its axle. Forward is positive on both sides.
    let turned_rad = |i: usize| {
        let upright =
            DQuat::from_rotation_x(FRAC_PI_2) * DQuat::from_array(transforms.transforms()[i].rotation_xyzw);
        wrap_angle(2.0 * upright.z.atan2(upright.w))
    };
    let expected_rad = odometry.odom_from_base.yaw_rad * 0.160 / 0.033;
    assert!((turned_rad(4) - turned_rad(3) - expected_rad).abs() < 1e-6);
    assert!(expected_rad > 0.1, "the right wheel turned farther: the robot turned left");
}

fn truth(simulator: &Simulator, world_from_base: Pose2, linear_m_s: f64) -> GroundTruth {
    let header = Header { stamp: simulator.now(), ..Header::default() };
    GroundTruth { header, world_from_base, linear_m_s, ..GroundTruth::default() }
}

#[test]
fn a_peer_is_seen_until_it_is_silent() {
    let room = box_room();
    let mut simulator =
        Simulator::new(&room, &with(LidarConfig::LDS_01), robot(1), Pose2::IDENTITY, 1).unwrap();
    let ahead = |simulator: &mut Simulator| scan(simulator).ranges_m()[0];
    assert!((ahead(&mut simulator) - 2.032).abs() < 0.002);
    for _ in 0..20 {
        let peer = truth(&simulator, Pose2::new(1.0, 0.0, 2.0), 0.0);
        simulator.update_peer(robot(2), &peer);
        simulator.step();
    }
    // The LiDAR's housing, 0.055 m in radius, sits 0.017 m behind the peer's middle.
    let housing = Pose2::new(1.0, 0.0, 2.0).apply([-0.017, 0.0]);
    let expected = 0.032 + housing[0] - (0.055f64.powi(2) - housing[1].powi(2)).sqrt();
    let seen = f64::from(ahead(&mut simulator));
    assert!((seen - expected).abs() < 0.003, "{seen} {expected}");
    for _ in 0..110 {
        simulator.step();
    }
    assert!((ahead(&mut simulator) - 2.032).abs() < 0.002, "silent for a second");
    let peer = truth(&simulator, Pose2::new(0.5, 0.0, 0.0), 0.0);
    simulator.update_peer(robot(2), &peer);
    simulator.step();
    assert!(ahead(&mut simulator) < 0.6, "and back");
    assert_eq!(simulator.refused(), 0);
}

#[test]
fn a_robot_collides_with_a_peer() {
    let mut simulator = Simulator::new(&box_room(), &quiet(), robot(1), Pose2::IDENTITY, 1).unwrap();
    let mut last = GroundTruth::default();
    for _ in 0..1000 {
        let peer = truth(&simulator, Pose2::new(0.5, 0.0, 0.0), 0.0);
        simulator.update_peer(robot(2), &peer);
        simulator.set_velocity_command(&drive(0.15, 0.0));
        last = simulator.step().truth;
    }
    // Front of the one at x + 0.038, rear of the other at 0.5 - 0.102.
    assert!((last.world_from_base.x_m - 0.36).abs() < 0.01, "{last:?}");
    assert_eq!(last.contacts, 1);
}

#[test]
fn a_moving_peer_pushes_the_robot() {
    let mut simulator = Simulator::new(&box_room(), &quiet(), robot(1), Pose2::IDENTITY, 1).unwrap();
    let mut last = GroundTruth::default();
    let mut peer = truth(&simulator, Pose2::new(-0.6, 0.0, 0.0), 0.15);
    for tick in 0..600 {
        let x_m = -0.6 + 0.0015 * f64::from(tick);
        // Its messages come at 20 Hz. In between its motion is extrapolated.
        if tick % 5 == 0 {
            peer = truth(&simulator, Pose2::new(x_m, 0.0, 0.0), 0.15);
            simulator.update_peer(robot(2), &peer);
        }
        last = simulator.step().truth;
    }
    assert!(last.contacts >= 1);
    assert!(last.world_from_base.x_m > 0.3, "{last:?} pushed ahead of {peer:?}");
    assert!(last.world_from_base.is_finite());
}

/// Each simulator has the other one's robot as a body that follows messages. Robots that push each other must not throw each other.
#[test]
fn two_robots_that_drive_into_each_other_are_not_thrown() {
    let room = box_room();
    let mut touches = 0;
    for seed in 0..12_u64 {
        let mut draws = SplitMix64::seed_from_u64(seed);
        let mut draw = |from: f64, to: f64| from + (to - from) * (draws.next_u64() as f64 / u64::MAX as f64);
        let starts = [Pose2::new(-0.2, 0.0, draw(-0.8, 0.8)), Pose2::new(0.2, 0.0, 3.1 + draw(-0.8, 0.8))];
        let simulator =
            |number: usize| Simulator::new(&room, &quiet(), robot(number + 1), starts[number], seed).unwrap();
        let mut simulators = [0, 1].map(simulator);
        let mut before = starts;
        for tick in 0..3000 {
            if tick % 100 == 0 {
                for simulator in &mut simulators {
                    simulator.set_velocity_command(&drive(draw(-0.05, 0.22), draw(-2.0, 2.0)));
                }
            }
            let truths = simulators.each_mut().map(|simulator| simulator.step().truth);
            for (number, truth) in truths.iter().enumerate() {
                simulators[1 - number].update_peer(robot(number + 1), truth);
                let [speed_m_s, turn_rad_s] = [
                    before[number].distance_m(truth.world_from_base) / 0.01,
                    wrap_angle(truth.world_from_base.yaw_rad - before[number].yaw_rad).abs() / 0.01,
                ];
                assert!(
                    speed_m_s < 0.7 && turn_rad_s < 8.6,
                    "seed {seed}, tick {tick}: {speed_m_s} {turn_rad_s}"
                );
                before[number] = truth.world_from_base;
            }
            touches += usize::from(tick == 2999 && truths[0].contacts > 0);
        }
    }
    assert!(touches >= 6, "{touches} pairs have touched");
}

#[test]
fn invalid_messages_of_peers_are_refused() {
    let mut simulator = Simulator::new(&box_room(), &quiet(), robot(1), Pose2::IDENTITY, 1).unwrap();
    let sound = truth(&simulator, Pose2::new(1.0, 0.0, 0.0), 0.0);
    simulator.update_peer(robot(1), &sound);
    simulator
        .update_peer(robot(2), &GroundTruth { world_from_base: Pose2::new(f64::NAN, 0.0, 0.0), ..sound });
    simulator.update_peer(robot(2), &GroundTruth { linear_m_s: f64::INFINITY, ..sound });
    let late = Header { stamp: Stamp(60_000_000_000), ..Header::default() };
    simulator.update_peer(robot(2), &GroundTruth { header: late, ..sound });
    assert_eq!(simulator.refused(), 4);
}

/// A peer jumps onto the robot again and again from all directions.
#[test]
fn a_jumping_peer_never_makes_the_pose_nan() {
    let mut simulator =
        Simulator::new(&box_room(), &SimConfig::default(), robot(1), Pose2::IDENTITY, 1).unwrap();
    for k in 0..2000 {
        let angle = f64::from(k) * 0.7;
        let at = simulator_pose(&mut simulator).apply([0.09 * angle.cos(), 0.09 * angle.sin()]);
        let mut peer = truth(&simulator, Pose2::new(at[0], at[1], angle), 1e3);
        peer.angular_rad_s = -1e3;
        simulator.update_peer(robot(2 + k as usize % 3), &peer);
        let run = Run::of(&mut simulator, 0.15, 1.5, 1);
        assert!(run.truths[0].world_from_base.is_finite() && run.truths[0].linear_m_s.is_finite());
        assert!(run.odometry.iter().all(|odometry| odometry.odom_from_base.is_finite()));
        // Minus infinity is too near (REP-117): the peer is beside the LiDAR.
        let is_range = |range: &f32| range.is_nan() || *range > 0.0 || *range == f32::NEG_INFINITY;
        assert!(scan(&mut simulator).ranges_m().iter().all(is_range));
    }
}

fn simulator_pose(simulator: &mut Simulator) -> Pose2 {
    simulator.step().truth.world_from_base
}
