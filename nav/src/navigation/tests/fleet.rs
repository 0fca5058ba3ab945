//! Robots that meet: doors, corridors, dead robots and people. The test world counts every contact.
//!
//! `MR_SLAM_NAVIGATION_SEEDS=100 cargo test -p nav --lib navigation::tests::fleet -- --nocapture` prints a row for each
//! scenario over so many seeds.

use super::super::{NavigationFailure, NavigationState};
use super::Drive;
use crate::random::RandomNumbers;
use crate::test_world::{Room, TestWorld};
use msg::Pose2;
use std::f64::consts::PI;

/// Longest time until a robot that stands says why, seconds.
const REPORT_MAX_S: f64 = 30.0;
/// Longest time of a meeting, seconds: a robot that waits gives up before.
const END_MAX_S: f64 = 300.0;
/// Movement below which a robot stands, metres.
const STANDING_M: f64 = 0.1;

/// Error of the map that robots drive by, metres: less than the margin of paths.
const MAP_ERROR_M: f64 = 0.04;

/// Seeds of a scenario: a few, or as many as the environment variable says.
fn seeds() -> core::ops::Range<u64> {
    let count = std::env::var("MR_SLAM_NAVIGATION_SEEDS").ok().and_then(|text| text.parse().ok());
    0..count.unwrap_or(3)
}

/// Random number from `-half_width` to `half_width`.
fn jitter(random: &mut RandomNumbers, half_width: f64) -> f64 {
    (random.index_below(2001) as f64 / 1000.0 - 1.0) * half_width
}

fn states(drive: &Drive) -> Vec<NavigationState> {
    drive.navigator.robots().map(|navigation| navigation.state).collect()
}

/// How one meeting ended.
#[derive(Clone, Copy, Debug, Default)]
struct Outcome {
    is_solved: bool,
    /// Time until all had arrived or given up, seconds.
    ended_s: f64,
    /// Longest time for which a robot stood without saying why, seconds.
    unreported_s: f64,
}

/// Runs on a map that is off by [`MAP_ERROR_M`] until no robot drives any more: each has arrived or says why not, and none has touched anything.
fn run_to_the_end(drive: &mut Drive, seed: u64) -> Outcome {
    let robots = drive.world.robot_count();
    let mut random = RandomNumbers::new(seed);
    let away_rad = jitter(&mut random, PI);
    drive.map_error = Pose2::new(MAP_ERROR_M * away_rad.cos(), MAP_ERROR_M * away_rad.sin(), 0.0);
    let start_s = drive.now().seconds();
    let mut stands = vec![(drive.world.pose(0), start_s); robots];
    let mut unreported_s = 0.0_f64;
    while drive.navigator.is_active() {
        let now_s = drive.now().seconds();
        assert!(now_s - start_s < END_MAX_S, "seed {seed}: no end in sight, {:?}", states(drive));
        drive.step();
        for navigation in drive.navigator.robots() {
            let (at, since_s) = &mut stands[navigation.robot.index()];
            let pose = drive.world.pose(navigation.robot.index());
            let is_reported = !matches!(
                navigation.state,
                NavigationState::Driving | NavigationState::Planning | NavigationState::Recovering
            );
            if is_reported || at.distance_m(pose) > STANDING_M {
                (*at, *since_s) = (pose, now_s);
            }
            unreported_s = unreported_s.max(now_s - *since_s);
        }
    }
    let is_said =
        |state: &NavigationState| matches!(state, NavigationState::Reached | NavigationState::Failed(_));
    assert!(states(drive).iter().all(is_said), "seed {seed}: {:?}", states(drive));
    assert_eq!(drive.world.bumps(), 0, "seed {seed}: contacts");
    assert!(unreported_s < REPORT_MAX_S, "seed {seed}: stood for {unreported_s} s without a reason");
    let is_solved = states(drive).iter().all(|state| *state == NavigationState::Reached);
    if !is_solved {
        println!("seed {seed}: {:?}", states(drive));
    }
    Outcome { is_solved, ended_s: drive.now().seconds() - start_s, unreported_s }
}

/// Runs a scenario over all seeds, prints its row, and returns how many are solved.
fn run_seeds(name: &str, run: impl Fn(u64) -> Outcome) -> u64 {
    let outcomes: Vec<Outcome> = seeds().map(run).collect();
    let solved = outcomes.iter().filter(|outcome| outcome.is_solved).count() as u64;
    let mut ended_s: Vec<f64> = outcomes.iter().map(|outcome| outcome.ended_s).collect();
    ended_s.sort_by(f64::total_cmp);
    let unreported_s = outcomes.iter().map(|outcome| outcome.unreported_s).fold(0.0, f64::max);
    let (median_s, longest_s) = (ended_s[ended_s.len() / 2], ended_s[ended_s.len() - 1]);
    println!(
        "{name:<40} solved {solved:>3} of {:>3}, contacts 0, end {median_s:.0} s (longest {longest_s:.0} s), \
         unreported stand {unreported_s:.1} s",
        outcomes.len()
    );
    solved
}

/// Of many seeds, a few meetings end with a robot that says that another one is in its way.
fn assert_most_are_solved(solved: u64) {
    let count = seeds().end;
    assert!(100 * solved >= 95 * count, "{solved} of {count} seeds are solved");
}

/// Two robots that swap the rooms on both sides of a door. `aside_m`: how far from its middle they start.
fn swap_rooms(door_m: f64, aside_m: f64, seed: u64) -> Outcome {
    let mut random = RandomNumbers::new(seed);
    let (y1, y2) = (2.0 + jitter(&mut random, aside_m), 2.0 + jitter(&mut random, aside_m));
    let starts = [Pose2::new(1.6, y1, jitter(&mut random, PI)), Pose2::new(4.4, y2, jitter(&mut random, PI))];
    let mut drive = Drive::new(TestWorld::with_room(Room::with_door(door_m), &starts));
    drive.go(1, [4.4, y1]);
    drive.go(2, [1.6, y2]);
    run_to_the_end(&mut drive, seed)
}

#[test]
fn two_robots_head_on_in_a_door_of_a_metre_pass_it() {
    assert_most_are_solved(run_seeds("head-on, door of 1 m", |seed| swap_rooms(1.0, 0.6, seed)));
}

#[test]
fn robots_that_stopped_side_by_side_in_a_door_move_apart() {
    for seed in [7, 11, 27] {
        assert!(swap_rooms(1.0, 0.6, seed).is_solved, "seed {seed}");
    }
}

#[test]
fn two_robots_head_on_in_a_door_for_one_pass_it_one_after_the_other() {
    assert_most_are_solved(run_seeds("head-on, door of 0.5 m", |seed| swap_rooms(0.5, 0.3, seed)));
}

#[test]
fn eight_robots_swap_the_sides_of_a_corridor() {
    let run = |seed| {
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
        run_to_the_end(&mut drive, seed)
    };
    assert_most_are_solved(run_seeds("8 robots swap sides, corridor of 2 m", run));
}

/// Two robots that stand closer to each other than plans allow and want to go to one side; each second their goals change by up to
/// `renewed_m`, as those of an exploration do.
fn leave_together(renewed_m: f64, seed: u64) -> Outcome {
    /// Time in which goals change, seconds, and in which each robot has to get away.
    const RENEWED_S: f64 = 40.0;
    let mut random = RandomNumbers::new(seed);
    let apart_m = 0.26 + jitter(&mut random, 0.04);
    let bearing_rad = jitter(&mut random, PI);
    let one = Pose2::new(5.0, 1.0, jitter(&mut random, PI));
    let [x, y] = [5.0 + apart_m * bearing_rad.cos(), 1.0 + apart_m * bearing_rad.sin()];
    let starts = [one, Pose2::new(x, y, jitter(&mut random, PI))];
    let mut drive = Drive::new(TestWorld::with_room(Room::corridor(2.0), &starts));
    let goals_m = [[1.0, 0.6], [1.4, 1.4]];
    let mut go = |drive: &mut Drive, off_m: f64| {
        for (i, [x, y]) in goals_m.into_iter().enumerate() {
            drive.go(i + 1, [x + 0.5 + jitter(&mut random, off_m), y]);
        }
    };
    go(&mut drive, 0.0);
    while renewed_m > 0.0 && drive.now().seconds() < RENEWED_S {
        go(&mut drive, renewed_m);
        drive.run_until(1.0, |_| false);
    }
    for (i, start) in starts.iter().enumerate().filter(|_| renewed_m > 0.0) {
        let moved_m = drive.world.pose(i).distance_m(*start);
        assert!(moved_m > 1.0, "seed {seed}: robot {} is {moved_m} m away, {:?}", i + 1, states(&drive));
    }
    run_to_the_end(&mut drive, seed)
}

#[test]
fn robots_that_stand_close_to_each_other_leave_to_one_side() {
    assert_most_are_solved(run_seeds("close to each other, one way", |seed| leave_together(0.0, seed)));
}

#[test]
fn robots_that_stand_close_to_each_other_leave_although_their_goals_change_each_second() {
    let run = |seed| leave_together(0.4, seed);
    assert_most_are_solved(run_seeds("close to each other, goals that change", run));
    // They waited for each other for ever, until a robot that stands for one whose plan waits gave way.
    run(51);
    run(63);
}

#[test]
fn a_robot_that_is_dead_in_a_doorway_is_reported_within_half_a_minute() {
    let run = |seed| {
        let mut random = RandomNumbers::new(seed);
        let at_door = Pose2::new(3.0, 2.0 + jitter(&mut random, 0.05), jitter(&mut random, PI));
        let start = Pose2::new(1.2, 2.0 + jitter(&mut random, 0.8), jitter(&mut random, PI));
        let mut drive = Drive::new(TestWorld::with_room(Room::with_door(0.7), &[start, at_door]));
        drive.go(1, [4.6, 2.0]);
        let is_said = |drive: &Drive| {
            matches!(drive.state(1), NavigationState::Blocked(_) | NavigationState::Failed(_))
        };
        assert!(drive.run_until(REPORT_MAX_S, is_said).is_some(), "seed {seed}: {:?}", drive.state(1));
        run_to_the_end(&mut drive, seed)
    };
    assert_eq!(run_seeds("dead robot in a doorway: reported", run), 0, "nobody passes a door that is closed");
}

#[test]
fn a_robot_that_dies_on_its_way_through_a_door_is_an_obstacle() {
    let run = |seed| {
        let mut random = RandomNumbers::new(seed);
        let starts = [
            Pose2::new(1.2, 2.0 + jitter(&mut random, 0.8), jitter(&mut random, PI)),
            Pose2::new(2.3, 2.0 + jitter(&mut random, 0.1), jitter(&mut random, 0.1)),
        ];
        let mut drive = Drive::new(TestWorld::with_room(Room::with_door(0.7), &starts));
        // The one that dies has routes, and goes first.
        drive.go(2, [4.6, 2.0]);
        drive.run_until(20.0, |drive| drive.world.pose(1).x_m > 2.95).expect("it drives through the door");
        drive.dead = Some((1, drive.now()));
        drive.go(1, [4.6, 2.2]);
        let is_said = |drive: &Drive| {
            let is_over = matches!(drive.state(1), NavigationState::Blocked(_) | NavigationState::Failed(_));
            is_over || drive.state(1) == NavigationState::WaitingForRobot(super::id(2))
        };
        assert!(drive.run_until(REPORT_MAX_S, is_said).is_some(), "seed {seed}: {:?}", drive.state(1));
        run_to_the_end(&mut drive, seed)
    };
    assert_eq!(run_seeds("robot that dies in a doorway on its way: reported", run), 0);
}

#[test]
fn a_person_who_stands_in_the_way_is_driven_around_or_reported() {
    let run = |seed| {
        let mut random = RandomNumbers::new(seed);
        let start = Pose2::new(1.0, 1.0 + jitter(&mut random, 0.3), jitter(&mut random, PI));
        let mut drive = Drive::new(TestWorld::with_room(Room::corridor(2.0), &[start]));
        drive.go(1, [8.5, 1.0]);
        // The person steps into the way when the robot comes near.
        drive.run_until(60.0, |drive| drive.world.pose(0).x_m > 3.0);
        drive.world.set_people(vec![[3.8, 1.0 + jitter(&mut random, 0.2)]]);
        run_to_the_end(&mut drive, seed)
    };
    assert_eq!(run_seeds("person steps into the way, corridor", run), seeds().end);
}

#[test]
fn a_person_who_fills_a_door_is_waited_for_and_then_reported() {
    let run = |seed| {
        let mut random = RandomNumbers::new(seed);
        let start = Pose2::new(1.2, 2.0 + jitter(&mut random, 0.5), jitter(&mut random, PI));
        let mut drive = Drive::new(TestWorld::with_room(Room::with_door(0.7), &[start]));
        drive.world.set_people(vec![[3.0, 2.0 + jitter(&mut random, 0.05)]]);
        drive.go(1, [4.6, 2.0]);
        let is_said = |drive: &Drive| matches!(drive.state(1), NavigationState::Blocked(_));
        assert!(drive.run_until(REPORT_MAX_S, is_said).is_some(), "seed {seed}: {:?}", drive.state(1));
        assert_eq!(drive.world.bumps(), 0, "seed {seed}");
        drive.world.set_people(Vec::new());
        let outcome = run_to_the_end(&mut drive, seed);
        let is_fine = outcome.is_solved
            || drive.state(1) == NavigationState::Failed(NavigationFailure::GoalUnreachable);
        assert!(is_fine, "seed {seed}: {:?}", drive.state(1));
        outcome
    };
    run_seeds("person fills a door, then leaves", run);
}

#[test]
fn a_goal_that_replaces_another_one_has_its_whole_time() {
    let start = Pose2::new(1.2, 2.0, PI);
    let mut drive = Drive::new(TestWorld::with_room(Room::with_door(0.7), &[start]));
    drive.world.set_people(vec![[3.0, 2.0]]);
    drive.go(1, [4.6, 2.0]);
    let stands = |drive: &Drive| matches!(drive.state(1), NavigationState::Blocked(_));
    drive.run_until(REPORT_MAX_S, stands).expect("a person fills the door");
    // A little less than until it gives up.
    let has_failed = drive.run_until(15.0, |drive| !drive.state(1).is_active());
    assert_eq!(has_failed, None, "{:?}", drive.state(1));
    drive.go(1, [1.2, 2.0]);
    drive.run_until(60.0, |drive| !drive.state(1).is_active());
    assert_eq!(drive.state(1), NavigationState::Reached);
}
