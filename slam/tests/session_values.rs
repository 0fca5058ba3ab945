//! Whatever scans and odometry say, the session made of them can be written, and read back.

mod common;

use common::{FULL, Lidar, Noise, Robot, cast_driving, laboratory};
use msg::Pose2;
use proptest::prelude::*;
use slam::{Session, SessionIdentity, Slam, SlamConfig};

/// What goes wrong at one step.
#[derive(Clone, Copy, Debug)]
enum Glitch {
    /// Nothing does.
    None,
    /// One odometry message has this position (m) and heading (rad).
    Pose(f64, f64),
    /// One odometry message has these speeds, m/s and rad/s.
    Speed(f64, f64),
    /// Odometry comes from a driver that was started again, whose pose begins here.
    Restart(f64),
    /// Clocks go forward by this, seconds.
    Forward(f64),
    /// The wheels turn on the spot and the robot stands.
    Slip(f64),
    /// No odometry comes.
    Silence,
    /// The scan says that its LiDAR is this far from the middle of the robot, metres.
    Mount(f64),
    /// The scan sees nothing up to this range, metres.
    Nothing(f32),
}

fn glitch() -> impl Strategy<Value = Glitch> {
    let metres = prop_oneof![-10.0..10.0, -1e4..1e4, -1e10..1e10, Just(f64::MAX), Just(f64::NAN)];
    let speed = prop_oneof![-1.0..1.0, -1e12..1e12, Just(f64::MAX), Just(f64::INFINITY)];
    let forward_s = prop_oneof![0.0..10.0, 0.0..1e6, 1e9..3e9];
    let range_m = prop_oneof![5.0_f32..100.0, Just(1e6), Just(f32::MAX)];
    prop_oneof![
        10 => Just(Glitch::None),
        2 => (metres.clone(), -100.0..100.0).prop_map(|(m, rad)| Glitch::Pose(m, rad)),
        1 => (speed.clone(), speed).prop_map(|(m_s, rad_s)| Glitch::Speed(m_s, rad_s)),
        1 => metres.clone().prop_map(Glitch::Restart),
        1 => forward_s.prop_map(Glitch::Forward),
        4 => (-2.0..2.0).prop_map(Glitch::Slip),
        3 => Just(Glitch::Silence),
        1 => metres.prop_map(Glitch::Mount),
        1 => range_m.prop_map(Glitch::Nothing),
    ]
}

/// A robot whose odometry comes from a driver that is started again now and then.
struct Drive {
    robot: Robot,
    noise: Noise,
    incarnation: u64,
    /// Pose of the first driver's frame in that of the present one.
    origin: Pose2,
}

impl Drive {
    fn new() -> Self {
        let robot = Robot::new(Pose2::new(-0.6, -0.5, 0.3));
        Self { robot, noise: Noise::new(9), incarnation: 0, origin: Pose2::IDENTITY }
    }
}

/// Feeds a robot's log with glitches; each lasts one step of 0.2 s, in which one scan is taken.
fn feed(slam: &mut Slam, drive: &mut Drive, glitches: &[(Glitch, usize)]) {
    const TURN_S: f64 = 0.2;
    let lidar = Lidar { range_max_m: 8.0, beams: 120, ..FULL };
    let walls = laboratory();
    let Drive { robot, noise, incarnation, origin } = drive;
    for &(glitch, step) in glitches {
        match glitch {
            Glitch::Restart(x_m) => {
                *incarnation += 1;
                *origin = Pose2::new(x_m, 0.0, 0.0) * robot.odom_from_base.inverse();
            }
            Glitch::Forward(seconds) => robot.time_s += seconds,
            _ => {}
        }
        let (linear, angular) = if matches!(glitch, Glitch::Slip(_)) { (0.0, 0.0) } else { (0.3, 0.4) };
        let mut scan = cast_driving(&walls, &lidar, robot, (linear, angular), TURN_S, noise);
        match glitch {
            Glitch::Mount(x_m) => scan.set_mount(Some(Pose2::new(x_m, 0.0, 0.0))),
            Glitch::Nothing(range_m) => {
                scan.range_max_m = range_m;
                scan.ranges_m.fill(f32::INFINITY);
            }
            _ => {}
        }
        for part in 0..4 {
            robot.drive(linear, angular, TURN_S / 4.0, noise);
            if let Glitch::Slip(turned_rad) = glitch {
                robot.odom_from_base = robot.odom_from_base * Pose2::new(0.0, 0.0, turned_rad);
            }
            let mut odometry = robot.odometry();
            odometry.header.incarnation = *incarnation;
            odometry.odom_from_base = *origin * odometry.odom_from_base;
            match glitch {
                Glitch::Silence => continue,
                Glitch::Pose(m, yaw_rad) if part == step => {
                    odometry.odom_from_base = Pose2::new(m, m, yaw_rad)
                }
                Glitch::Speed(m_s, rad_s) if part == step => {
                    (odometry.linear_m_s, odometry.angular_rad_s) = (m_s, rad_s);
                }
                _ => {}
            }
            slam.add_odometry(&odometry);
        }
        slam.process(&scan);
        slam.work();
    }
}

/// Asserts that the session of a SLAM can be written, and that what is read back is the same.
fn assert_can_be_stored(slam: &mut Slam) {
    let bytes = slam.session(SessionIdentity::new(1, 7, &SlamConfig::default())).encode().unwrap();
    assert_eq!(Session::decode_any(&bytes).unwrap().encode(), Ok(bytes));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]

    #[test]
    fn whatever_scans_and_odometry_say_their_session_can_be_stored(
        glitches in prop::collection::vec((glitch(), 0_usize..4), 1..60),
        with_nodes_between in any::<bool>(),
    ) {
        let mut config = SlamConfig::default();
        config.tracking.node_distance_m = if with_nodes_between { 0.05 } else { 0.3 };
        let (mut slam, mut robot) = (Slam::new(config), Drive::new());
        for part in glitches.chunks(10) {
            feed(&mut slam, &mut robot, part);
            assert_can_be_stored(&mut slam);
        }
    }
}

#[test]
fn a_robot_that_is_stuck_with_turning_wheels_can_be_stored() {
    let mut slam = Slam::new(SlamConfig::default());
    feed(&mut slam, &mut Drive::new(), &[(Glitch::Slip(0.06), 0); 80]);
    assert!(slam.counts().slips > 40, "{:?}", slam.counts());
    assert_can_be_stored(&mut slam);
}

#[test]
fn a_map_with_as_many_links_as_the_configuration_allows_can_be_stored() {
    let mut config = SlamConfig::default();
    config.links.sequential = 64;
    config.links.near = 64;
    config.tracking.node_distance_m = 0.01;
    let mut slam = Slam::new(config);
    feed(&mut slam, &mut Drive::new(), &[(Glitch::None, 0); 220]);
    let counts = slam.back_counts();
    assert!(counts.links > 64 * counts.nodes, "{counts:?}");
    assert_can_be_stored(&mut slam);
}
