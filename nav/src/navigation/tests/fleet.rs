//! Robots that meet: doors, corridors, dead robots and people. The test world counts every contact.

use super::super::{NavigationFailure, NavigationState};
use super::Drive;
use crate::random::RandomNumbers;
use crate::test_world::{Room, TestWorld};
use msg::Pose2;
use std::f64::consts::PI;

/// Seeds of a scenario: a few, or as many as the environment variable says.
fn seeds() -> core::ops::Range<u64> {
    let count = std::env::var("MR_SLAM_NAVIGATION_SEEDS").ok().and_then(|text| text.parse().ok());
    0..count.unwrap_or(3)
}

/// Random number from `-half_width` to `half_width`.
fn jitter(random: &mut RandomNumbers, half_width: f64) -> f64 {
    (random.index_below(2001) as f64 / 1000.0 - 1.0) * half_width
}

fn is_reached(drive: &Drive, robots: usize) -> bool {
    (1..=robots).all(|robot| drive.state(robot) == NavigationState::Reached)
}

/// Runs until no robot drives any more: each has arrived or says why not, and none has touched anything. Returns 1 if
/// all have arrived, else 0.
fn run_to_the_end(drive: &mut Drive, robots: usize, seed: u64) -> u64 {
    let ended_s = drive.run_until(300.0, |drive| !drive.navigator.is_active());
    assert!(ended_s.is_some(), "seed {seed}: no end in sight, {:?}", states(drive, robots));
    let is_said =
        |state: &NavigationState| matches!(state, NavigationState::Reached | NavigationState::Failed(_));
    assert!(states(drive, robots).iter().all(is_said), "seed {seed}: {:?}", states(drive, robots));
    assert_eq!(drive.world.bumps(), 0, "seed {seed}: contacts");
    u64::from(is_reached(drive, robots))
}

/// Of many seeds, a few meetings end with a robot that says that another one is in its way.
fn assert_most_are_solved(solved: u64) {
    let count = seeds().end;
    assert!(10 * solved >= 8 * count, "{solved} of {count} seeds are solved");
}

fn states(drive: &Drive, robots: usize) -> Vec<NavigationState> {
    (1..=robots).map(|robot| drive.state(robot)).collect()
}

#[test]
fn two_robots_head_on_in_a_door_of_a_metre_pass_it() {
    let mut solved = 0;
    for seed in seeds() {
        let mut random = RandomNumbers::new(seed);
        let (y1, y2) = (2.0 + jitter(&mut random, 0.6), 2.0 + jitter(&mut random, 0.6));
        let starts =
            [Pose2::new(1.6, y1, jitter(&mut random, PI)), Pose2::new(4.4, y2, jitter(&mut random, PI))];
        let mut drive = Drive::new(TestWorld::with_room(Room::with_door(1.0), &starts));
        drive.go(1, [4.4, y1]);
        drive.go(2, [1.6, y2]);
        solved += run_to_the_end(&mut drive, 2, seed);
    }
    assert_most_are_solved(solved);
}

#[test]
fn two_robots_head_on_in_a_door_for_one_pass_it_one_after_the_other() {
    let mut solved = 0;
    for seed in seeds() {
        let mut random = RandomNumbers::new(seed);
        let (y1, y2) = (2.0 + jitter(&mut random, 0.3), 2.0 + jitter(&mut random, 0.3));
        let starts =
            [Pose2::new(1.6, y1, jitter(&mut random, PI)), Pose2::new(4.4, y2, jitter(&mut random, PI))];
        let mut drive = Drive::new(TestWorld::with_room(Room::with_door(0.5), &starts));
        drive.go(1, [4.4, y1]);
        drive.go(2, [1.6, y2]);
        solved += run_to_the_end(&mut drive, 2, seed);
    }
    assert_most_are_solved(solved);
}

#[test]
fn eight_robots_swap_the_sides_of_a_corridor() {
    let mut solved = 0;
    for seed in seeds() {
        let mut random = RandomNumbers::new(seed);
        let mut place = |i: usize| {
            let (column, row) = ((i % 4) / 2, i % 2);
            let x = if i < 4 { 0.8 + 0.8 * column as f64 } else { 9.2 - 0.8 * column as f64 };
            [x + jitter(&mut random, 0.1), 0.6 + 0.8 * row as f64 + jitter(&mut random, 0.1)]
        };
        let places: Vec<[f64; 2]> = (0..8).map(&mut place).collect();
        let mut random = RandomNumbers::new(seed ^ 77);
        let starts: Vec<Pose2> =
            places.iter().map(|[x, y]| Pose2::new(*x, *y, jitter(&mut random, PI))).collect();
        let mut drive = Drive::new(TestWorld::with_room(Room::corridor(2.0), &starts));
        for i in 0..8 {
            // The robot that begins in front stands at the far end, so that it blocks nobody.
            let [_, y] = places[(i + 4) % 8];
            let x = if i < 4 { 9.2 - 0.8 * ((3 - i) / 2) as f64 } else { 0.8 + 0.8 * ((7 - i) / 2) as f64 };
            drive.go(i + 1, [x, y]);
        }
        solved += run_to_the_end(&mut drive, 8, seed);
    }
    assert_most_are_solved(solved);
}

#[test]
fn a_robot_that_is_dead_in_a_doorway_is_reported_within_half_a_minute() {
    for seed in seeds() {
        let mut random = RandomNumbers::new(seed);
        let at_door = Pose2::new(3.0, 2.0 + jitter(&mut random, 0.05), jitter(&mut random, PI));
        let start = Pose2::new(1.2, 2.0 + jitter(&mut random, 0.8), jitter(&mut random, PI));
        let mut drive = Drive::new(TestWorld::with_room(Room::with_door(0.7), &[start, at_door]));
        drive.go(1, [4.6, 2.0]);
        let is_said = |drive: &Drive| {
            matches!(drive.state(1), NavigationState::Blocked(_) | NavigationState::Failed(_))
        };
        assert!(drive.run_until(30.0, is_said).is_some(), "seed {seed}: {:?}", drive.state(1));
        let ended_s = drive.run_until(60.0, |drive| !drive.state(1).is_active());
        assert!(ended_s.is_some() && matches!(drive.state(1), NavigationState::Failed(_)), "seed {seed}");
        assert_eq!(drive.world.bumps(), 0, "seed {seed}");
    }
}

#[test]
fn a_person_who_stands_in_the_way_is_driven_around_or_reported() {
    for seed in seeds() {
        let mut random = RandomNumbers::new(seed);
        let start = Pose2::new(1.0, 1.0 + jitter(&mut random, 0.3), jitter(&mut random, PI));
        let mut drive = Drive::new(TestWorld::with_room(Room::corridor(2.0), &[start]));
        drive.go(1, [8.5, 1.0]);
        // The person steps into the way when the robot comes near.
        drive.run_until(60.0, |drive| drive.world.pose(0).x_m > 3.0);
        drive.world.set_people(vec![[3.8, 1.0 + jitter(&mut random, 0.2)]]);
        let ended_s = drive.run_until(120.0, |drive| !drive.state(1).is_active());
        assert!(ended_s.is_some() && is_reached(&drive, 1), "seed {seed}: {:?}", drive.state(1));
        assert_eq!(drive.world.bumps(), 0, "seed {seed}");
    }
}

#[test]
fn a_person_who_fills_a_door_is_waited_for_and_then_reported() {
    for seed in seeds() {
        let mut random = RandomNumbers::new(seed);
        let start = Pose2::new(1.2, 2.0 + jitter(&mut random, 0.5), jitter(&mut random, PI));
        let mut drive = Drive::new(TestWorld::with_room(Room::with_door(0.7), &[start]));
        drive.world.set_people(vec![[3.0, 2.0 + jitter(&mut random, 0.05)]]);
        drive.go(1, [4.6, 2.0]);
        let is_said = |drive: &Drive| matches!(drive.state(1), NavigationState::Blocked(_));
        assert!(drive.run_until(30.0, is_said).is_some(), "seed {seed}: {:?}", drive.state(1));
        assert_eq!(drive.world.bumps(), 0, "seed {seed}");
        drive.world.set_people(Vec::new());
        let ended_s = drive.run_until(90.0, |drive| !drive.state(1).is_active());
        let is_fine = is_reached(&drive, 1)
            || matches!(drive.state(1), NavigationState::Failed(NavigationFailure::GoalUnreachable));
        assert!(ended_s.is_some() && is_fine, "seed {seed}: {:?}", drive.state(1));
        assert_eq!(drive.world.bumps(), 0, "seed {seed}");
    }
}
