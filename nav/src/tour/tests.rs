use super::*;
use crate::observation::{BURGER_BASE_FROM_SCAN, MapView, ScanView};
use msg::Pose2;
use proptest::prelude::*;

const OPEN: [f32; 91] = [3.0; 91];

fn open_scan(now_s: f64) -> ScanView<'static> {
    ScanView {
        received: Stamp::from_seconds(now_s),
        base_from_scan: BURGER_BASE_FROM_SCAN,
        angle_min_rad: -0.8,
        angle_increment_rad: 1.6 / 90.0,
        range_min_m: 0.12,
        range_max_m: 3.5,
        ranges_m: &OPEN,
    }
}

fn robot(number: usize) -> RobotId {
    RobotId::new(number).unwrap()
}

/// Commands of some seconds at 20 Hz; the robots in `blind` have no scan.
fn commands_in_turn(tour: &mut ExplorationTour, seconds: f64, blind: &[usize]) -> Vec<DriveCommand> {
    let step = |i: u64| {
        let now_s = i as f64 * 0.05;
        let observe = |number| RobotObservation {
            scan: (!blind.contains(&number)).then(|| open_scan(now_s)),
            ..RobotObservation::unknown(robot(number))
        };
        let robots: Vec<RobotObservation> = (1..=3).map(observe).collect();
        tour.step_in_turn(&FleetObservation { stamp: Stamp::from_seconds(now_s), robots: &robots })
    };
    (0..(seconds / 0.05) as u64).map(step).collect()
}

#[test]
fn robots_take_turns_and_stop_at_the_end_of_their_turn() {
    let config = TourConfig { time_slice_s: 5.0, ..Default::default() };
    let mut tour = ExplorationTour::new(config, RobotId::first(3)).unwrap();
    let commands = commands_in_turn(&mut tour, 30.0, &[]);
    let mut order: Vec<usize> = commands.iter().map(|command| command.robot.number()).collect();
    order.dedup();
    assert_eq!(&order[..6], [1, 2, 3, 1, 2, 3]);
    for pair in commands.windows(2).filter(|pair| pair[0].robot != pair[1].robot) {
        assert_eq!(pair[0].twist, Twist::STOP);
    }
    let drives = commands.iter().any(|command| command.twist.linear_m_s > 0.07);
    assert!(drives, "without a map a robot drives by its scan");
}

#[test]
fn a_robot_without_scans_loses_its_turn() {
    let config = TourConfig { time_slice_s: 10.0, ..Default::default() };
    let mut tour = ExplorationTour::new(config, RobotId::first(3)).unwrap();
    let commands = commands_in_turn(&mut tour, 60.0, &[2]);
    let blind: Vec<&DriveCommand> = commands.iter().filter(|command| command.robot == robot(2)).collect();
    assert!(blind.iter().all(|command| command.twist == Twist::STOP));
    assert!(blind.len() < 3 * 45, "{} steps", blind.len());
    let turns: Vec<u32> = tour.stats().map(|stats| stats.turns).collect();
    assert!(turns.iter().all(|turns| *turns >= 2), "{turns:?}");
}

#[test]
fn a_robot_is_added_once() {
    assert!(ExplorationTour::new(TourConfig::default(), []).is_none());
    let mut tour = ExplorationTour::new(TourConfig::default(), [robot(1), robot(1)]).unwrap();
    tour.add(robot(2));
    tour.add(robot(2));
    assert_eq!(tour.explorers().len(), 2);
}

fn number() -> impl Strategy<Value = f64> {
    prop_oneof![6 => -6.0..6.0, 1 => Just(f64::NAN), 1 => Just(f64::INFINITY), 1 => any::<f64>()]
}

fn pose() -> impl Strategy<Value = Pose2> {
    (number(), number(), number()).prop_map(|(x, y, yaw)| Pose2::new(x, y, yaw))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    /// Any map, poses and scans give velocities within the limits, and no panic.
    #[test]
    fn any_observation_gives_a_velocity_within_the_limits(
        cells in prop::collection::vec(any::<i8>(), 900),
        poses in prop::collection::vec(prop::option::of(pose()), 40),
        ranges in prop::collection::vec(any::<f32>(), 0..60),
        angles in (number(), number()),
        limits in (number(), number()),
        (in_merged_map, at_once) in (any::<bool>(), any::<bool>()),
    ) {
        let config = TourConfig { time_slice_s: 1.0, ..Default::default() };
        let mut tour = ExplorationTour::new(config, RobotId::first(2)).unwrap();
        let map = MapView::from_percent(Pose2::new(-0.7, -0.7, 0.3), 0.05, (30, 30), &cells);
        let mut commands = Vec::new();
        for (i, pair) in poses.chunks(2).enumerate() {
            let stamp = Stamp::from_seconds(i as f64 * 0.3);
            let scan = Some(ScanView {
                received: stamp,
                angle_min_rad: angles.0,
                angle_increment_rad: angles.1,
                range_min_m: limits.0,
                range_max_m: limits.1,
                ranges_m: &ranges,
                ..open_scan(0.0)
            });
            let observe = |k: usize| {
                RobotObservation { robot: robot(k + 1), map, in_merged_map, map_from_base: pair[k], scan }
            };
            let observation = FleetObservation { stamp, robots: &[observe(0), observe(1)] };
            if at_once {
                tour.step_all(&observation, &mut commands);
            } else {
                commands.clear();
                commands.push(tour.step_in_turn(&observation));
            }
            for DriveCommand { twist, .. } in &commands {
                prop_assert!(twist.linear_m_s.abs() <= 0.15 && twist.angular_rad_s.abs() <= 0.9, "{twist:?}");
            }
        }
    }
}
