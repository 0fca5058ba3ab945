//! Goals that an exploration gives and takes away.

use super::*;
use crate::navigation::{LocalizationUncertainty, NavigatorConfig};
use crate::observation::{BURGER_BASE_FROM_SCAN, MapView, RobotObservation, ScanView};
use msg::{ExclusionZone, Pose2, Stamp};

/// Free space of 4 m by 4 m in the middle of unknown space.
fn cells() -> Vec<i8> {
    (0..160 * 80).map(|i| if (40..120).contains(&(i % 160)) { 0 } else { -1 }).collect()
}

fn robots<'a>(cells: &'a [i8], count: usize) -> Vec<NavigatedRobot<'a>> {
    RobotId::first(count)
        .map(|robot| {
            let pose = Pose2::new(3.0 + 2.0 * robot.index() as f64, 2.0, 0.0);
            let scan = ScanView {
                received: Stamp(0),
                base_from_scan: BURGER_BASE_FROM_SCAN,
                angle_min_rad: 0.0,
                angle_increment_rad: 0.01,
                range_min_m: 0.12,
                range_max_m: 3.5,
                ranges_m: &[3.5],
            };
            let observation = RobotObservation {
                robot,
                map: MapView::from_percent(Pose2::IDENTITY, 0.05, (160, 80), cells),
                in_merged_map: true,
                map_from_base: Some(pose),
                scan: Some(scan),
            };
            NavigatedRobot {
                observation,
                odom_from_base: Some(pose),
                map_from_robot_map: None,
                uncertainty: None,
            }
        })
        .collect()
}

#[test]
fn the_navigator_drives_to_the_coordinators_goals_until_exploration_stops() {
    let cells = cells();
    let robots = robots(&cells, 2);
    let mut navigator = FleetNavigator::new(NavigatorConfig::default());
    let mut exploration = FleetExploration::new(CoordinationConfig::default());
    let input = NavigationInput { stamp: Stamp(0), robots: &robots, exclusion_zones: &[] };
    let phase = exploration.step(&mut navigator, &input, &|_| false);
    assert_eq!(phase, CoordinationPhase::Exploring);
    navigator.step(&input);
    assert_eq!(navigator.robots().filter(|robot| robot.state.is_active()).count(), 2);
    exploration.stop(&mut navigator);
    navigator.step(&input);
    assert!(!navigator.is_active());
}

#[test]
fn robots_that_are_dead_or_in_a_persons_hands_get_no_goals() {
    let cells = cells();
    let robots = robots(&cells, 2);
    let second = robots[1].observation.robot;
    let mut navigator = FleetNavigator::new(NavigatorConfig::default());
    let mut exploration = FleetExploration::new(CoordinationConfig::default());
    let input = NavigationInput { stamp: Stamp(0), robots: &robots, exclusion_zones: &[] };
    exploration.step(&mut navigator, &input, &|robot| robot == second);
    assert_eq!(
        navigator.robots().map(|robot| robot.robot).collect::<Vec<_>>(),
        [robots[0].observation.robot]
    );
    navigator.pause(robots[0].observation.robot);
    let later = NavigationInput { stamp: Stamp::from_seconds(5.0), ..input };
    exploration.step(&mut navigator, &later, &|robot| robot == second);
    assert_eq!(navigator.robots().next().map(|robot| robot.state), Some(NavigationState::Paused));
}

#[test]
fn a_robot_that_stays_lost_looks_for_its_place_once() {
    let cells = cells();
    let mut robots = robots(&cells, 2);
    robots[1].observation.map_from_base = None;
    let lost = robots[1].observation.robot;
    let mut navigator = FleetNavigator::new(NavigatorConfig::default());
    let mut exploration = FleetExploration::new(CoordinationConfig::default());
    let mut states = Vec::new();
    for second in 0..200 {
        let stamp = Stamp::from_seconds(f64::from(second));
        for robot in &mut robots {
            robot.observation.scan.as_mut().unwrap().received = stamp;
        }
        let input = NavigationInput { stamp, robots: &robots, exclusion_zones: &[] };
        exploration.step(&mut navigator, &input, &|_| false);
        navigator.step(&input);
        states.push(navigator.robots().find(|robot| robot.robot == lost).map(|robot| robot.state));
    }
    let finds = |state: &&Option<NavigationState>| **state == Some(NavigationState::FindingPlace);
    assert_eq!(states.iter().position(|state| finds(&state)), Some(10), "not at once");
    let seconds = states.iter().filter(finds).count();
    assert!((119..=122).contains(&seconds), "two minutes: {seconds} s");
    assert!(!exploration.is_driving(lost));
}

#[test]
fn a_robot_whose_place_becomes_uncertain_returns_to_one_that_it_knows() {
    let cells = cells();
    let mut robots = robots(&cells, 1);
    let robot = robots[0].observation.robot;
    // Its own map lies elsewhere in the merged one.
    robots[0].map_from_robot_map = Some(Pose2::new(1.0, 1.0, 0.0));
    let mut navigator = FleetNavigator::new(NavigatorConfig::default());
    let mut exploration = FleetExploration::new(CoordinationConfig::default());
    let mut second = 0.0;
    let mut step = |x_m: f64, sigma_m: f64, is_fixed_by_scan: bool| {
        second += 1.0;
        robots[0].observation.map_from_base = Some(Pose2::new(x_m, 2.0, 0.0));
        robots[0].uncertainty = Some(LocalizationUncertainty { sigma_m, is_fixed_by_scan });
        let input =
            NavigationInput { stamp: Stamp::from_seconds(second), robots: &robots, exclusion_zones: &[] };
        exploration.step(&mut navigator, &input, &|_| false);
        let goal =
            exploration.sent[robot.index()].as_ref().map(|sent| (sent.goal.purpose, sent.goal.position_m));
        (exploration.availability(robot).unwrap(), goal)
    };
    let exploring = |(availability, goal): (RobotAvailability, Option<(GoalPurpose, [f64; 2])>)| {
        availability == RobotAvailability::Free
            && goal.is_some_and(|(purpose, _)| purpose == GoalPurpose::Explore)
    };
    assert!(exploring(step(3.0, 0.1, true)));
    assert!(exploring(step(5.0, 0.9, false)));
    assert_eq!(
        step(5.0, 1.1, false),
        (RobotAvailability::Revisiting, Some((GoalPurpose::Revisit, [2.0, 1.0])))
    );
    assert_eq!(step(4.0, 0.9, false).0, RobotAvailability::Revisiting, "until the loop is closed");
    assert!(exploring(step(4.0, 0.2, true)));
}

#[test]
fn who_stands_deep_in_a_zone_is_said_to_be_excluded_until_the_zone_is_gone() {
    let cells = cells();
    let mut robots = robots(&cells, 2);
    robots[1].observation.map_from_base = Some(Pose2::new(5.0, 2.0, 0.0));
    let [free, inside] = [0, 1].map(|index: usize| robots[index].observation.robot);
    // So deep that navigation does not drive it out, but no deeper.
    let zones = [ExclusionZone::new(&[[4.5, 0.0], [5.5, 0.0], [5.5, 4.0], [4.5, 4.0]]).unwrap()];
    let mut navigator = FleetNavigator::new(NavigatorConfig::default());
    let mut exploration = FleetExploration::new(CoordinationConfig::default());
    let mut step = |second: u32, exclusion_zones: &[ExclusionZone]| {
        let stamp = Stamp::from_seconds(f64::from(second));
        let input = NavigationInput { stamp, robots: &robots, exclusion_zones };
        exploration.step(&mut navigator, &input, &|_| false);
        [free, inside].map(|robot| exploration.availability(robot).unwrap())
    };
    for second in 0..10 {
        assert_eq!(step(second, &zones), [RobotAvailability::Free, RobotAvailability::Excluded]);
    }
    assert_eq!(step(20, &[]), [RobotAvailability::Free; 2]);
    // A zone over all robots ends it, and the states say why.
    let all = [ExclusionZone::new(&[[1.0, -1.0], [7.0, -1.0], [7.0, 5.0], [1.0, 5.0]]).unwrap()];
    for second in 30..100 {
        assert_eq!(step(second, &all), [RobotAvailability::Excluded; 2]);
    }
    assert_eq!(exploration.end(), Some(ExplorationEnd::NoRobot));
}

#[test]
fn a_robot_beyond_the_map_is_said_to_reach_no_floor() {
    let cells = cells();
    let mut robots = robots(&cells, 2);
    robots[1].observation.map_from_base = Some(Pose2::new(100.0, 2.0, 0.0));
    let mut navigator = FleetNavigator::new(NavigatorConfig::default());
    let mut exploration = FleetExploration::new(CoordinationConfig::default());
    let input = NavigationInput { stamp: Stamp(0), robots: &robots, exclusion_zones: &[] };
    exploration.step(&mut navigator, &input, &|_| false);
    let availability = exploration.availability(robots[1].observation.robot);
    assert_eq!(availability, Some(RobotAvailability::Enclosed));
}
