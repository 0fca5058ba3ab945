//! Whole tours in the test world: how much of the floor they map, and that no robot bumps into anything.

use super::*;
use crate::observation::{BURGER_BASE_FROM_SCAN, MapView, ScanView};
use crate::test_world::{RANGE_MAX_M, RANGE_MIN_M, STEP_S, TestWorld, beam_angle_rad};
use msg::{Grid, Pose2};
use std::collections::VecDeque;

/// Steps between two scans, two maps, and two measurements of the coverage.
const SCAN_STEPS: u64 = 2;
const MAP_STEPS: u64 = 20;
const COVERAGE_STEPS: u64 = 200;

#[derive(Clone, Copy)]
struct Scenario {
    robots: usize,
    seed: u64,
    seconds: f64,
    all_at_once: bool,
    /// Time at which the map moves under the robots, as after a loop closure, seconds.
    map_moves_at_s: f64,
    /// Amplitude of the pose's error, metres and radians.
    pose_error: f64,
}

impl Default for Scenario {
    fn default() -> Self {
        Self {
            robots: 1,
            seed: 1,
            seconds: 300.0,
            all_at_once: false,
            map_moves_at_s: f64::MAX,
            pose_error: 0.01,
        }
    }
}

struct Outcome {
    /// Share of the floor in the map, every 10 s.
    coverage: Vec<f64>,
    bumps: u32,
    commands: Vec<DriveCommand>,
    tour: ExplorationTour,
}

impl Outcome {
    fn covered(&self) -> f64 {
        *self.coverage.last().unwrap()
    }
}

fn drive(scenario: Scenario) -> Outcome {
    let mut world = TestWorld::new(scenario.robots, scenario.seed);
    let floor = world.floor_cells();
    let config = TourConfig { seed: scenario.seed, ..Default::default() };
    let mut tour = ExplorationTour::new(config, RobotId::first(scenario.robots)).unwrap();
    let (mut coverage, mut commands, mut all_commands) = (Vec::new(), Vec::new(), Vec::new());
    let mut map_from_world = Pose2::IDENTITY;
    // Maps arrive one period late.
    let mut sent: VecDeque<Grid> = VecDeque::new();
    for step in 0..(scenario.seconds / STEP_S) as u64 {
        let now_s = step as f64 * STEP_S;
        if step.is_multiple_of(SCAN_STEPS) {
            world.scan_and_map();
        }
        if now_s >= scenario.map_moves_at_s {
            map_from_world = Pose2::new(0.4, -0.3, 0.12);
        }
        if step.is_multiple_of(MAP_STEPS) {
            let mut map = world.map().clone();
            map.header.origin = map_from_world * map.header.origin;
            sent.push_back(map);
            if sent.len() > 2 {
                sent.pop_front();
            }
        }
        if step.is_multiple_of(COVERAGE_STEPS) {
            coverage.push(world.coverage(&floor));
        }
        let view = sent.front().and_then(|map| MapView::from_log_odds(map.view()));
        let observe = |i| observe(&world, i, view, now_s, map_from_world, scenario.pose_error);
        let robots: Vec<RobotObservation> = (0..scenario.robots).map(observe).collect();
        let observation = FleetObservation { stamp: Stamp::from_seconds(now_s), robots: &robots };
        if scenario.all_at_once {
            tour.step_all(&observation, &mut commands);
        } else {
            commands.clear();
            commands.push(tour.step_in_turn(&observation));
        }
        world.stop_all();
        commands.iter().for_each(|command| world.set_velocity(command.robot, command.twist));
        world.move_robots();
        all_commands.extend(&commands);
    }
    coverage.push(world.coverage(&floor));
    Outcome { coverage, bumps: world.bumps(), commands: all_commands, tour }
}

fn observe<'a>(
    world: &'a TestWorld,
    index: usize,
    map: Option<MapView<'a>>,
    now_s: f64,
    map_from_world: Pose2,
    pose_error: f64,
) -> RobotObservation<'a> {
    // An error that swings slowly, as a scan matcher's does; each robot's has another phase.
    let error = (now_s * 0.7 + index as f64 * 2.0).sin() * pose_error;
    RobotObservation {
        robot: RobotId::new(index + 1).unwrap(),
        map,
        in_merged_map: true,
        map_from_base: Some(map_from_world * world.pose(index) * Pose2::new(error, -error, error)),
        scan: Some(ScanView {
            received: Stamp::from_seconds(now_s),
            base_from_scan: BURGER_BASE_FROM_SCAN,
            angle_min_rad: beam_angle_rad(0),
            angle_increment_rad: beam_angle_rad(1) - beam_angle_rad(0),
            range_min_m: RANGE_MIN_M,
            range_max_m: RANGE_MAX_M,
            ranges_m: world.ranges_m(index),
        }),
    }
}

#[test]
fn one_robot_maps_the_room() {
    for seed in 0..4 {
        let outcome = drive(Scenario { seed, seconds: 200.0, ..Default::default() });
        assert!(outcome.covered() > 0.9, "seed {seed}: {:?}", outcome.coverage);
        assert_eq!(outcome.bumps, 0, "seed {seed}");
    }
}

#[test]
fn three_robots_in_turn_map_the_room() {
    for seed in 0..4 {
        let outcome = drive(Scenario { seed, robots: 3, seconds: 240.0, ..Default::default() });
        assert!(outcome.covered() > 0.9, "seed {seed}: {:?}", outcome.coverage);
        assert_eq!(outcome.bumps, 0, "seed {seed}");
        let held_s: Vec<f64> = outcome.tour.stats().map(|stats| stats.held_s).collect();
        assert!(held_s.iter().all(|held_s| (held_s - 80.0).abs() < 1.0), "seed {seed}: {held_s:?}");
    }
}

#[test]
fn three_robots_at_once_map_the_room_sooner() {
    for seed in 0..4 {
        let scenario = Scenario { seed, robots: 3, all_at_once: true, seconds: 100.0, ..Default::default() };
        let outcome = drive(scenario);
        assert!(outcome.covered() > 0.9, "seed {seed}: {:?}", outcome.coverage);
        assert_eq!(outcome.bumps, 0, "seed {seed}");
    }
}

#[test]
fn a_map_that_moves_and_poses_that_are_off_do_not_stop_the_tour() {
    for seed in 0..2 {
        let scenario =
            Scenario { seed, map_moves_at_s: 45.0, pose_error: 0.03, seconds: 200.0, ..Default::default() };
        let outcome = drive(scenario);
        assert!(outcome.covered() > 0.9, "seed {seed}: {:?}", outcome.coverage);
    }
}

#[test]
fn a_robot_patrols_once_no_frontier_is_left() {
    let outcome = drive(Scenario { seconds: 400.0, ..Default::default() });
    let stats = outcome.tour.stats().next().unwrap().exploration;
    assert!(stats.patrols > 0, "{stats:?}");
    assert!(stats.driven_m > 20.0, "{stats:?}");
    assert_eq!(outcome.bumps, 0);
}

#[test]
fn the_same_seed_gives_the_same_tour() {
    let scenario = Scenario { robots: 2, seconds: 60.0, ..Default::default() };
    assert!(drive(scenario).commands == drive(scenario).commands);
}
