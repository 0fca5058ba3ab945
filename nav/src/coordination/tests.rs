//! Tests of the coordinator on small maps.

use super::*;
use crate::config::RobotBody;
use crate::observation::MapView;

/// Two rooms of 4 m by 4 m beside a known one, both unknown: free cells of the middle, walls with two doors.
fn cells() -> Vec<i8> {
    let (width, height) = (240, 80);
    let mut cells = vec![-1_i8; width * height];
    for (x, y) in (80..160).flat_map(|x| (0..height).map(move |y| (x, y))) {
        let is_door = (30..50).contains(&y);
        let is_wall = y == 0 || y == height - 1 || ((x == 80 || x == 159) && !is_door);
        cells[y * width + x] = if is_wall { 100 } else { 0 };
    }
    cells
}

fn robot(number: usize, x_m: f64, y_m: f64) -> CoordinatedRobot {
    CoordinatedRobot {
        robot: RobotId::new(number).unwrap(),
        map_from_base: Some(Pose2::new(x_m, y_m, 0.0)),
        home: None,
        availability: RobotAvailability::Free,
        progress: GoalProgress::Idle,
    }
}

fn input<'a>(cells: &'a [i8], robots: &'a [CoordinatedRobot], at_s: f64) -> CoordinationInput<'a> {
    let map = MapView::from_percent(Pose2::IDENTITY, 0.05, (240, 80), cells).unwrap();
    CoordinationInput { stamp: Stamp::from_seconds(at_s), map, robots, excluded: &[] }
}

#[test]
fn two_robots_go_to_different_doors() {
    let cells = cells();
    let robots = [robot(1, 5.8, 2.0), robot(2, 6.4, 2.0)];
    let mut coordinator = FleetCoordinator::new(CoordinationConfig::default());
    assert_eq!(coordinator.update(&input(&cells, &robots, 0.0)), CoordinationPhase::Exploring);
    let goals: Vec<[f64; 2]> = robots.iter().map(|r| coordinator.goal(r.robot).unwrap().position_m).collect();
    assert!(goals[0][0] < 5.8 && goals[1][0] > 6.2, "{goals:?}");
    assert!(coordinator.estimate().unwrap().least_s > 5.0);
}

#[test]
fn robots_that_unknown_floor_separates_look_at_it_from_both_sides() {
    // 0.8 m of an unknown passage lie between the robots. The door is on the side of the first one, and more unknown floor beside the passage.
    let mut cells = cells();
    for (x, y) in (104..160).flat_map(|x| (0..80).map(move |y| (x, y))) {
        let is_passage = (30..50).contains(&y);
        let known = if x == 159 || ((112..128).contains(&x) && !is_passage) { 100 } else { 0 };
        let is_unknown = is_passage && ((112..128).contains(&x) || (x < 112 && y < 38));
        cells[y * 240 + x] = if is_unknown { -1 } else { known };
    }
    let robots = [robot(1, 5.0, 2.0), robot(2, 7.2, 2.0)];
    let mut coordinator = FleetCoordinator::new(CoordinationConfig::default());
    coordinator.update(&input(&cells, &robots, 0.0));
    let goals_m = robots.map(|robot| coordinator.goal(robot.robot).map(|goal| goal.position_m));
    assert!(goals_m[0].is_some_and(|at_m| at_m[0] < 5.6), "{goals_m:?}");
    assert!(goals_m[1].is_some_and(|at_m| at_m[0] > 6.4), "{goals_m:?}");
}

#[test]
fn only_free_robots_get_goals_and_the_others_tasks_pass_on() {
    let cells = cells();
    let mut robots = [robot(1, 5.8, 2.0), robot(2, 6.4, 2.0)];
    let mut coordinator = FleetCoordinator::new(CoordinationConfig::default());
    coordinator.update(&input(&cells, &robots, 0.0));
    assert!(coordinator.goal(robots[1].robot).is_some());
    for taken in [RobotAvailability::Manual, RobotAvailability::Lost, RobotAvailability::Silent] {
        robots[1].availability = taken;
        coordinator.update(&input(&cells, &robots, 2.0));
        assert!(coordinator.goal(robots[1].robot).is_none(), "{taken:?}");
        assert!(coordinator.goal(robots[0].robot).is_some(), "{taken:?}");
    }
}

#[test]
fn a_goal_at_which_something_stands_is_left_alone_for_a_while() {
    let cells = cells();
    let mut robots = [robot(1, 5.8, 2.0)];
    let mut coordinator = FleetCoordinator::new(CoordinationConfig::default());
    coordinator.update(&input(&cells, &robots, 0.0));
    let first_m = coordinator.goal(robots[0].robot).unwrap().position_m;
    robots[0].progress = GoalProgress::Occupied;
    coordinator.update(&input(&cells, &robots, 2.0));
    let other_m = coordinator.goal(robots[0].robot).unwrap().position_m;
    assert!(distance_m(first_m, other_m) >= 0.5, "{first_m:?} {other_m:?}");
    robots[0].progress = GoalProgress::Failed;
    coordinator.update(&input(&cells, &robots, 4.0));
    // Both doors were left alone; the first one is looked at again later, since it was not seen in vain.
    robots[0].progress = GoalProgress::Idle;
    coordinator.update(&input(&cells, &robots, 40.0));
    assert_eq!(coordinator.phase(), CoordinationPhase::Exploring);
    assert!(coordinator.goal(robots[0].robot).is_some());
}

#[test]
fn what_is_never_seen_is_given_up_and_robots_go_home() {
    let cells = cells();
    let mut robots = [robot(1, 5.8, 2.0)];
    let mut coordinator = FleetCoordinator::new(CoordinationConfig::default());
    let mut seconds = 0.0;
    // The map never changes, although the robot arrives everywhere.
    while coordinator.update(&input(&cells, &robots, seconds)) == CoordinationPhase::Exploring {
        let goal = coordinator.goal(robots[0].robot).unwrap().clone();
        let [x_m, y_m] = goal.position_m;
        for heading_rad in &goal.headings_rad {
            robots[0].map_from_base = Some(Pose2::new(x_m, y_m, *heading_rad));
            robots[0].progress = GoalProgress::Active;
            coordinator.update(&input(&cells, &robots, seconds));
        }
        robots[0].progress = GoalProgress::Reached;
        seconds += 10.0;
        assert!(seconds < 2000.0, "exploration does not end");
    }
    let leftovers = coordinator.leftovers();
    assert!(leftovers.iter().any(|left| left.reason == LeftoverReason::NotVisible), "{leftovers:?}");
    robots[0].progress = GoalProgress::Idle;
    coordinator.update(&input(&cells, &robots, seconds + 2.0));
    let goal = coordinator.goal(robots[0].robot).unwrap();
    assert_eq!((goal.purpose, goal.position_m), (GoalPurpose::Home, [5.8, 2.0]));
    robots[0].progress = GoalProgress::Reached;
    assert_eq!(coordinator.update(&input(&cells, &robots, seconds + 3.0)), CoordinationPhase::Done);
}

#[test]
fn robots_that_get_nowhere_do_not_keep_exploration_from_its_end() {
    let cells = cells();
    // The first never leaves its place, the second is sent to and fro between two places and never arrives.
    for (robots, far_m) in [(1, 0.0), (2, 0.0), (2, 1.5)] {
        let mut robots = [robot(1, 5.8, 2.0), robot(2, 6.4, 2.0)][..robots].to_vec();
        let mut coordinator = FleetCoordinator::new(CoordinationConfig::default());
        let mut seconds = 0.0;
        while coordinator.update(&input(&cells, &robots, seconds)) == CoordinationPhase::Exploring {
            for robot in &mut robots {
                robot.progress = GoalProgress::Active;
            }
            if let Some(second) = robots.get_mut(1) {
                let x_m = if ((seconds / 10.0) as u32).is_multiple_of(2) { 6.4 } else { 6.4 - far_m };
                second.map_from_base = Some(Pose2::new(x_m, 2.0, 0.0));
            }
            seconds += 1.0;
            assert!(seconds < 600.0, "exploration does not end");
        }
        let leftovers = coordinator.leftovers();
        let is_named = |left: &Leftover| left.reason == LeftoverReason::TookTooLong;
        assert!(leftovers.iter().any(is_named), "{leftovers:?}");
    }
}

#[test]
fn two_plans_of_nearly_the_same_cost_do_not_turn_a_robot_to_and_fro() {
    let cells = cells();
    let mut robots = [robot(1, 6.0, 2.0)];
    let mut coordinator = FleetCoordinator::new(CoordinationConfig::default());
    let mut side = None;
    // Errors of the map move the robot by a few centimetres between the two doors.
    for step in 0..20 {
        let off_m = if step % 2 == 0 { 0.1 } else { -0.1 };
        robots[0].map_from_base = Some(Pose2::new(6.0 + off_m, 2.0, core::f64::consts::FRAC_PI_2));
        coordinator.update(&input(&cells, &robots, 2.0 * f64::from(step)));
        let is_left = coordinator.goal(robots[0].robot).unwrap().position_m[0] < 6.0;
        assert_eq!(*side.get_or_insert(is_left), is_left, "step {step}");
    }
}

#[test]
fn what_a_robot_did_not_look_at_or_through_is_not_given_up() {
    let mut cells = cells();
    let mut robots = [robot(1, 4.5, 2.0)];
    let mut coordinator = FleetCoordinator::new(CoordinationConfig::default());
    coordinator.update(&input(&cells, &robots, 0.0));
    // It stands before the left door and leaves it in vain again and again, turned away from it.
    for attempt in 0..4 {
        let place_m = [4.5, 2.0];
        coordinator.goals[0].as_mut().unwrap().position_m = place_m;
        robots[0].progress = GoalProgress::Reached;
        coordinator.update(&input(&cells, &robots, f64::from(attempt)));
    }
    let is_given_up = |coordinator: &FleetCoordinator, x_m| coordinator.unseen.is_given_up([x_m, 2.025]);
    assert!(!is_given_up(&coordinator, 3.975));
    // Turned to it, what it should see is given up, and not the room behind.
    robots[0].map_from_base = Some(Pose2::new(4.5, 2.0, core::f64::consts::PI));
    for attempt in 4..8 {
        coordinator.goals[0].as_mut().unwrap().position_m = [4.5, 2.0];
        coordinator.update(&input(&cells, &robots, f64::from(attempt)));
    }
    assert!(is_given_up(&coordinator, 3.975) && !is_given_up(&coordinator, 3.5));
    // A sliver of it gets known: the rest is worth a look.
    (30..50).flat_map(|y| (70..80).map(move |x| y * 240 + x)).for_each(|cell| cells[cell] = 0);
    robots[0].progress = GoalProgress::Idle;
    coordinator.update(&input(&cells, &robots, 20.0));
    let goal = coordinator.goal(robots[0].robot).unwrap();
    assert!(goal.position_m[0] < 5.0, "{goal:?}");
}

#[test]
fn what_shows_through_gaps_in_which_no_robot_fits_is_left_alone() {
    // The walls of the middle room without doors, with a gap of a cell or two in every ten.
    let gaps_of = |gap_cells: i64| {
        let mut cells = cells();
        for y in 1..79_i64 {
            let is_gap = y % 10 < gap_cells;
            for x in [80, 159] {
                cells[(y * 240 + x) as usize] = if is_gap { 0 } else { 100 };
            }
        }
        cells
    };
    let robots = [robot(1, 6.0, 2.0)];
    for gap_cells in [1, 2] {
        let cells = gaps_of(gap_cells);
        let mut coordinator = FleetCoordinator::new(CoordinationConfig::default());
        let phase = coordinator.update(&input(&cells, &robots, 0.0));
        assert_ne!(phase, CoordinationPhase::Exploring, "gaps of {gap_cells} cells");
    }
    // Where a robot fits through, it looks.
    let mut wide = gaps_of(1);
    (30..41).for_each(|y| wide[y * 240 + 80] = 0);
    let mut coordinator = FleetCoordinator::new(CoordinationConfig::default());
    assert_eq!(coordinator.update(&input(&wide, &robots, 0.0)), CoordinationPhase::Exploring);
}

#[test]
fn excluded_areas_are_not_entered_and_are_named_at_the_end() {
    let cells = cells();
    let robots = [robot(1, 6.0, 2.0)];
    let left = vec![[3.0, 0.0], [5.2, 0.0], [5.2, 4.0], [3.0, 4.0]];
    let excluded = [left];
    let mut coordinator = FleetCoordinator::new(CoordinationConfig::default());
    coordinator.update(&CoordinationInput { excluded: &excluded, ..input(&cells, &robots, 0.0) });
    let goal = coordinator.goal(robots[0].robot).unwrap();
    assert!(goal.position_m[0] > 5.2, "{goal:?}");
    assert!(coordinator.leftovers().iter().any(|left| left.reason == LeftoverReason::Unreachable));
}

#[test]
fn the_same_inputs_give_the_same_goals() {
    let cells = cells();
    let robots = [robot(1, 5.0, 1.0), robot(2, 6.4, 3.0), robot(3, 7.0, 2.0)];
    let run = || {
        let mut coordinator = FleetCoordinator::new(CoordinationConfig::default());
        for i in 0..5 {
            coordinator.update(&input(&cells, &robots, f64::from(i)));
        }
        robots.map(|robot| coordinator.goal(robot.robot).cloned())
    };
    assert_eq!(run(), run());
}

#[test]
fn a_lidar_that_sees_all_around_needs_no_heading() {
    let cells = cells();
    let robots = [robot(1, 6.0, 2.0)];
    let config = CoordinationConfig { view_angle_rad: core::f64::consts::TAU, ..Default::default() };
    let mut coordinator = FleetCoordinator::new(config);
    coordinator.update(&input(&cells, &robots, 0.0));
    let goal = coordinator.goal(robots[0].robot).unwrap();
    assert!(goal.headings_rad.is_empty(), "{goal:?}");
}

#[test]
fn goals_lie_where_robots_of_any_size_fit() {
    let cells = cells();
    let robots = [robot(1, 6.0, 2.0)];
    for radius_m in [0.105, 0.22, 0.4] {
        let body = RobotBody { radius_m, ..RobotBody::default() };
        let mut coordinator = FleetCoordinator::new(CoordinationConfig { body, ..Default::default() });
        coordinator.update(&input(&cells, &robots, 0.0));
        let goal = coordinator.goal(robots[0].robot).unwrap().position_m;
        let walls = (0..cells.len()).filter(|index| cells[*index] == 100);
        let centre =
            |index: usize| [(index % 240) as f64 * 0.05 + 0.025, (index / 240) as f64 * 0.05 + 0.025];
        let nearest_m = walls.map(|index| distance_m(centre(index), goal)).fold(f64::INFINITY, f64::min);
        assert!(nearest_m > radius_m, "{goal:?} is {nearest_m} m from a wall, for a robot of {radius_m} m");
    }
}

#[test]
fn robots_that_fit_through_no_door_get_no_goal_behind_it() {
    let cells = cells();
    let robots = [robot(1, 6.0, 2.0)];
    let body = RobotBody { radius_m: 0.6, ..RobotBody::default() };
    let mut coordinator = FleetCoordinator::new(CoordinationConfig { body, ..Default::default() });
    coordinator.update(&input(&cells, &robots, 0.0));
    if let Some(goal) = coordinator.goal(robots[0].robot) {
        assert!((4.6..7.4).contains(&goal.position_m[0]), "{goal:?} is not in the middle room");
    }
}

#[test]
fn a_lidar_of_longer_range_looks_from_farther_away() {
    let cells = cells();
    let robots = [robot(1, 6.0, 2.0)];
    let distance_of = |view_range_m: f64| {
        let config = CoordinationConfig { view_range_m, ..Default::default() };
        let mut coordinator = FleetCoordinator::new(config);
        coordinator.update(&input(&cells, &robots, 0.0));
        let goal = coordinator.goal(robots[0].robot).unwrap();
        (goal.position_m[0] - 6.0).abs()
    };
    assert!(distance_of(1.0) > distance_of(6.0), "{} and {} m of way", distance_of(1.0), distance_of(6.0));
}
