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
fn a_robot_that_stays_lost_looks_for_its_place_again_and_again_but_not_for_ever() {
    let cells = cells();
    let mut robots = robots(&cells, 2);
    robots[1].observation.map_from_base = None;
    let lost = robots[1].observation.robot;
    let mut navigator = FleetNavigator::new(NavigatorConfig::default());
    let mut exploration = FleetExploration::new(CoordinationConfig::default());
    let mut states = Vec::new();
    for second in 0..1000 {
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
    let searches: Vec<_> =
        states.chunk_by(|a, b| finds(&a) == finds(&b)).filter(|it| finds(&&it[0])).collect();
    assert_eq!(searches.len(), 5, "again after a pause, but not for ever");
    assert!(searches.iter().all(|search| (119..=122).contains(&search.len())), "two minutes");
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

/// Robots of which one is absent for some time, in a room of which nothing is unknown: when exploration ends, and how.
fn end_with_absence(seconds: f64, is_silent: bool) -> (f64, ExplorationEnd) {
    let walls = |i: usize| i.is_multiple_of(160) || i % 160 == 159 || !(160..79 * 160).contains(&i);
    let cells: Vec<i8> = (0..160 * 80).map(|i| if walls(i) { 100 } else { 0 }).collect();
    let mut robots = robots(&cells, 2);
    let (absent, pose) = (robots[1].observation.robot, robots[1].observation.map_from_base);
    let mut navigator = FleetNavigator::new(NavigatorConfig::default());
    let mut exploration = FleetExploration::new(CoordinationConfig::default());
    for tick in 0..2000 {
        let at_s = 0.1 * f64::from(tick);
        let stamp = Stamp::from_seconds(at_s);
        let is_absent = at_s < seconds;
        robots[1].observation.map_from_base = pose.filter(|_| is_silent || !is_absent);
        for robot in &mut robots {
            robot.observation.scan.as_mut().unwrap().received = stamp;
        }
        let input = NavigationInput { stamp, robots: &robots, exclusion_zones: &[] };
        exploration.step(&mut navigator, &input, &|robot| is_silent && is_absent && robot == absent);
        navigator.step(&input);
        if let Some(end) = exploration.end() {
            return (at_s, end);
        }
    }
    panic!("exploration has no end");
}

#[test]
fn exploration_waits_for_a_robot_that_is_lost_or_silent_for_a_moment() {
    let (at_once_s, end) = end_with_absence(0.0, false);
    assert!(at_once_s < 5.0 && end == ExplorationEnd::Completed, "{at_once_s} s: {end:?}");
    for is_silent in [false, true] {
        // One that stays lost looks for its place from 10 s on.
        for absent_s in [2.0, 8.0, 30.0] {
            let (at_s, end) = end_with_absence(absent_s, is_silent);
            assert!((absent_s..absent_s + 10.0).contains(&at_s), "{absent_s} s absent: {at_s} s");
            assert_eq!(end, ExplorationEnd::Completed);
        }
    }
    let (at_s, end) = end_with_absence(1000.0, true);
    assert!((60.0..65.0).contains(&at_s) && end == ExplorationEnd::Completed, "{at_s} s: {end:?}");
    let (at_s, _) = end_with_absence(1000.0, false);
    assert!((130.0..140.0).contains(&at_s), "its search takes two minutes: {at_s} s");
}

#[test]
fn an_exploration_without_scans_or_maps_waits_for_its_robots_and_then_fails() {
    let cells = cells();
    let mut robots = robots(&cells, 2);
    for robot in &mut robots {
        (robot.observation.map, robot.observation.map_from_base) = (None, None);
    }
    let mut navigator = FleetNavigator::new(NavigatorConfig::default());
    let mut exploration = FleetExploration::new(CoordinationConfig::default());
    let mut step = |second: u32, robots: &[NavigatedRobot], is_silent: bool| {
        let stamp = Stamp::from_seconds(f64::from(second));
        let input = NavigationInput { stamp, robots, exclusion_zones: &[] };
        (exploration.step(&mut navigator, &input, &|_| is_silent), exploration.end())
    };
    let with_maps = self::robots(&cells, 2);
    for second in 0..5 {
        assert_eq!(step(second, &robots, true), (CoordinationPhase::Exploring, None), "it may be starting");
    }
    assert_eq!(step(5, &robots, true), (CoordinationPhase::Waiting, None));
    assert_eq!(step(6, &with_maps, false), (CoordinationPhase::Exploring, None), "it goes on");
    for second in 7..66 {
        assert_eq!(step(second, &with_maps, true).1, None);
    }
    assert_eq!(step(66, &with_maps, true), (CoordinationPhase::Waiting, Some(ExplorationEnd::NoRobot)));
}

#[test]
fn an_exploration_of_a_fleet_that_never_had_a_map_fails() {
    let cells = cells();
    let mut robots = robots(&cells, 1);
    robots[0].observation.map = None;
    let mut navigator = FleetNavigator::new(NavigatorConfig::default());
    let mut end_s = |is_manual: bool| {
        let mut exploration = FleetExploration::new(CoordinationConfig::default());
        (0..200).find(|second| {
            let stamp = Stamp::from_seconds(f64::from(*second));
            let input = NavigationInput { stamp, robots: &robots, exclusion_zones: &[] };
            if is_manual {
                exploration.set_manual(robots[0].observation.robot, false);
            }
            exploration.step(&mut navigator, &input, &|_| false);
            exploration.end() == Some(ExplorationEnd::NoRobot)
        })
    };
    assert_eq!(end_s(false), Some(60));
    assert_eq!(end_s(true), None, "a person may keep it");
}
