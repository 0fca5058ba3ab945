//! A fleet in lockstep in which things go wrong, drawn from a seed: processes die and stop, messages are lost, late or
//! doubled, channels and the disk are full, time jumps, people reset maps and set the emergency stop, the operator's
//! client leaves, is stopped or is cut off, and another contends with it. What must hold is in
//! `fleet/src/lockstep/invariants.rs` and `fleet/src/lockstep/drive_checks.rs`. A seed runs again, byte for byte, with
//! `autosave_s = 2.0` below `[sessions]` in a fleet file and the command that the test prints.
//!
//! Found and mended so far:
//! - a lost `Replaced` event of a SLAM front end made the back end ignore every later node: events carry numbers now;
//! - a lost question or answer about the front end's state stopped autosave for ever: it is asked again;
//! - SLAM that died before its first save lost its map: the first save comes a second after the first node;
//! - a simulator that was stopped followed commands that were out of date;
//! - a front end that began where `odom` lay took its first scan without odometry and was in a wrong frame;
//! - a pose by odometry alone jumped when the robot's driver was started again, while SLAM was paused;
//! - a map that was reset while its robot's driver was started again was in the frame of the old driver's `odom`;
//! - the pose of `odom` that the launcher passes on was that of a simulator that had been started again since;
//! - SLAM that was restored from a session older than the last start of its robot's driver took the robot to have
//!   stood in between, and was sure of a wrong heading: it is lost now, and relocalizes the robot.
//! - a simulator went on with a command for up to 0.6 s if it came late, and coasted on where its time jumped: a
//!   command is valid for 0.3 s after it was sent, by the machine's clock;
//! - the emergency stop was not saved again after a full disk had refused it once;
//! - the selected robot was not saved again for 0.2 s after a full disk had refused it;
//! - `map` -> `odom` was in the front end's own frame where a SLAM process or a map had begun anew and odometry was missing
//!   at the second scan; the next map that was reset began there;
//! - a map that was reset before the first scan of a restarted SLAM process began in a frame of its own;
//! - where odometry was missing at one of two scans, as after a pause, nothing of the way between them was known, although
//!   messages between had measured it: the robot was found in a wrong place;
//! - a late message of a driver that had ended moved the origin of odometry to and fro;
//! - a lost robot that stood had one node more than its map, which was then the smaller component and no map any more.

use mr_slam::config::FleetConfig;
use mr_slam::lockstep::Lockstep;
use mr_slam::lockstep::faults::{BRIDGE, Fault, FaultPlan};
use mr_slam::lockstep::invariants::{check, quiet_from};
use msg::{GridView, Monotonic};
use reports::FleetView;
use std::collections::HashSet;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

/// Seeds of a test run; this variable asks for more.
const SEEDS_VARIABLE: &str = "MR_SLAM_FAULT_SEEDS";
const SEEDS: u64 = 100;
/// Two rooms beside a corridor.
const TWO_ROOMS: &str = "tests/rooms/two_rooms.obj";
/// Virtual seconds of each run.
const SECONDS: u32 = 14;

/// Returns a fleet of 1 to 4 robots in one of two rooms.
fn config(seed: u64) -> FleetConfig {
    let mut config = FleetConfig::default();
    (config.fleet.robots, config.fleet.seed) = (1 + (seed % 4) as usize, seed);
    if seed.is_multiple_of(3) {
        config.fleet.room = TWO_ROOMS.into();
    }
    config.sessions.autosave_s = 2.0;
    config
}

/// Returns whether the operator drives all robots at once, and not the selected one.
fn together(seed: u64) -> bool {
    seed % 8 < 5
}

/// Returns the command that runs a seed again.
fn command(seed: u64) -> String {
    let config = config(seed);
    let in_turn = if together(seed) { "" } else { " --in-turn" };
    format!(
        "mr-slam lockstep --config FILE --room {} --robots {} --seconds {SECONDS} --seed {seed} --faults {seed}{in_turn}",
        config.fleet.room, config.fleet.robots
    )
}

/// A fleet of two in the laboratory.
fn pair() -> FleetConfig {
    let mut config = config(1);
    config.fleet.robots = 2;
    config
}

fn second(at: f64) -> Monotonic {
    Monotonic((at * 1e9) as u64)
}

/// The processes of a fleet of two in lockstep's order.
const SIM_1: usize = 0;
const SLAM_1: usize = 2;
const SLAM_2: usize = 3;
const MERGE: usize = 4;

/// Runs a fleet with chosen faults: nothing may go wrong.
fn assert_survives(faults: FaultPlan, seconds: u32) {
    let report = check(&pair(), true, faults, seconds).unwrap();
    assert!(report.violations.is_empty(), "{:#?}", report.violations);
}

#[test]
fn invariants_hold_for_every_seed() {
    let seeds = std::env::var(SEEDS_VARIABLE).ok().and_then(|seeds| seeds.parse().ok()).unwrap_or(SEEDS);
    let next = AtomicU64::new(1);
    // A run is on one thread from its beginning to its end.
    let run_seeds = || {
        let mut violations = Vec::new();
        loop {
            let seed = next.fetch_add(1, Ordering::Relaxed);
            if seed > seeds {
                return violations;
            }
            let faults = FaultPlan::draw(seed, quiet_from(SECONDS));
            let report = check(&config(seed), together(seed), faults, SECONDS).unwrap();
            if !report.violations.is_empty() {
                violations.push((command(seed), report.violations));
            }
        }
    };
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let violations: Vec<_> = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..threads).map(|_| scope.spawn(run_seeds)).collect();
        threads.into_iter().flat_map(|thread| thread.join().unwrap()).collect()
    });
    assert!(violations.is_empty(), "{} of {seeds} seeds: {violations:#?}", violations.len());
}

#[test]
fn a_seed_with_faults_gives_the_same_bytes_twice() {
    for seed in [3, 7] {
        let faults = || FaultPlan::draw(seed, quiet_from(SECONDS));
        let run = || check(&config(seed), together(seed), faults(), SECONDS).unwrap();
        assert_eq!(run(), run(), "seed {seed}");
    }
}

#[test]
fn slam_killed_before_its_first_save_goes_on_in_the_same_frame() {
    for at in [0.05, 0.4, 0.95, 3.0] {
        assert_survives(FaultPlan::none().with(second(at), Fault::Kill(SLAM_1)), 12);
    }
}

#[test]
fn simulator_and_slam_killed_together_never_give_a_wrong_pose() {
    for apart in [0.0, 0.15, 0.3] {
        let faults = FaultPlan::none().with(second(4.0), Fault::Kill(SIM_1));
        assert_survives(faults.with(second(4.0 + apart), Fault::Kill(SLAM_1)), 14);
    }
}

#[test]
fn a_lost_replaced_event_does_not_end_the_map() {
    let faults = FaultPlan::none().with_lost_events(second(0.0), second(8.0));
    let mut fleet =
        Lockstep::with_faults(&pair(), true, faults.with(second(4.0), Fault::ResetMap(0))).unwrap();
    while fleet.now().seconds() < 14.0 {
        fleet.tick(&mut |_, _| {});
    }
    let nodes: Vec<usize> = fleet.sessions().map(|(_, session)| session.back.nodes.len()).collect();
    assert!(nodes.iter().all(|nodes| *nodes > 5), "nodes after the reset: {nodes:?}");
}

#[test]
fn robots_stand_when_the_bridge_is_killed_in_mid_drive() {
    assert_survives(FaultPlan::none().with(second(5.0), Fault::Kill(BRIDGE)), 14);
}

#[test]
fn robots_stand_when_a_stopped_simulator_goes_on() {
    let faults = FaultPlan::none()
        .with(second(5.0), Fault::Freeze(SIM_1, Duration::from_secs(2)))
        .with(second(5.2), Fault::Kill(BRIDGE));
    assert_survives(faults.with(second(5.2), Fault::LetGo(Duration::from_secs(4))), 14);
}

#[test]
fn a_map_that_was_reset_does_not_come_back_from_before_its_first_node() {
    for is_paused in [false, true] {
        let mut faults = FaultPlan::none();
        if is_paused {
            faults = faults.with(second(4.0), Fault::Pause(0, Duration::from_secs(60)));
        }
        let faults = faults.with(second(6.0), Fault::ResetMap(0)).with(second(6.5), Fault::Kill(SLAM_1));
        let mut fleet = Lockstep::with_faults(&pair(), true, faults).unwrap();
        let oldest_node = |fleet: &Lockstep| {
            let (_, session) = fleet.sessions().next().expect("SLAM of robot1 runs");
            session.back.nodes.first().map(|node| node.header.stamp.seconds())
        };
        while fleet.now().seconds() < 5.9 {
            fleet.tick(&mut |_, _| {});
        }
        assert!(oldest_node(&fleet).is_some_and(|stamp_s| stamp_s < 1.0));
        while fleet.now().seconds() < 9.0 {
            fleet.tick(&mut |_, _| {});
        }
        let oldest = oldest_node(&fleet);
        assert!(oldest.is_none_or(|stamp_s| stamp_s > 5.9), "paused: {is_paused}, {oldest:?}");
    }
}

#[test]
fn merging_says_while_its_state_cannot_be_saved() {
    let faults = FaultPlan::none().with_full_disk(second(0.0), second(6.0));
    let mut fleet = Lockstep::with_faults(&pair(), true, faults).unwrap();
    while fleet.now().seconds() < 5.0 {
        fleet.tick(&mut |_, _| {});
    }
    assert_eq!(fleet.merge_edges().unsaved, 1);
    // It tries again after a while.
    while fleet.now().seconds() < 14.0 {
        fleet.tick(&mut |_, _| {});
    }
    assert_eq!(fleet.merge_edges().unsaved, 0);
}

#[test]
fn merging_killed_goes_on_with_the_same_map() {
    let faults = FaultPlan::none().with(second(5.0), Fault::Kill(MERGE));
    assert_survives(faults.with(second(6.0), Fault::Kill(SLAM_2)), 14);
}

/// Share of the known cells that the robots' own redrawing may make unknown within seconds.
const REDRAWN_SHARE_MAX: f64 = 0.01;

/// Returns the known cells of a map as columns and rows of a lattice that stays where it is.
fn known_cells(map: GridView<'_>) -> HashSet<(i64, i64)> {
    let header = map.header;
    let corner = [header.origin.x_m, header.origin.y_m].map(|m| (m / header.resolution_m).round() as i64);
    let width = (header.width as usize).max(1);
    let known = map.cells.iter().enumerate().filter(|(_, cell)| **cell != msg::grid::UNKNOWN);
    known.map(|(index, _)| (corner[0] + (index % width) as i64, corner[1] + (index / width) as i64)).collect()
}

/// Runs a fleet of two and looks at the published merged map from second 5 on: it keeps all but [`REDRAWN_SHARE_MAX`] of what it showed.
fn assert_merged_map_keeps_its_cells(faults: FaultPlan) {
    let mut fleet = Lockstep::with_faults(&pair(), true, faults).unwrap();
    let (mut before, mut fewest) = (HashSet::new(), f64::INFINITY);
    let (mut compared_corner, mut compared_cells) = ((0.0, 0.0, 0), Vec::new());
    while fleet.now().seconds() < 12.0 {
        fleet.tick(&mut |_, _| {});
        if fleet.now().seconds() < 5.0 {
            continue;
        }
        let map = fleet.maps().find(|(name, _)| *name == "merged_map").map(|(_, map)| map);
        let map = map.expect("a fleet has a merged map");
        // Most ticks publish nothing new.
        let corner = (map.header.origin.x_m, map.header.origin.y_m, map.header.width);
        if corner == compared_corner && map.cells == compared_cells {
            continue;
        }
        (compared_corner, compared_cells) = (corner, map.cells.to_vec());
        let known = known_cells(map);
        if before.is_empty() {
            before = known;
        } else if known != before {
            let kept = before.intersection(&known).count() as f64 / before.len() as f64;
            fewest = fewest.min(kept);
            assert!(kept >= 1.0 - REDRAWN_SHARE_MAX, "at {:?}: {kept:.3} of the cells", fleet.now());
            before.extend(known);
        }
    }
    assert!(before.len() > 2000 && fewest.is_finite(), "the map was drawn: {} cells, {fewest}", before.len());
}

#[test]
fn the_merged_map_keeps_99_percent_of_its_cells_when_merging_is_killed() {
    let faults = FaultPlan::none().with(second(6.0), Fault::Kill(MERGE));
    assert_merged_map_keeps_its_cells(faults.with(second(9.5), Fault::Kill(MERGE)));
}

/// Kills the second robot's SLAM from second 6 on, as soon as it is started again: it is silent for six seconds.
fn with_silent_slam(mut faults: FaultPlan) -> FaultPlan {
    for kill in 0..200 {
        faults = faults.with(second(6.0 + 0.02 * f64::from(kill)), Fault::Kill(SLAM_2));
    }
    faults
}

#[test]
fn the_map_of_a_dead_slam_process_outlives_merging() {
    assert_merged_map_keeps_its_cells(with_silent_slam(
        FaultPlan::none().with(second(6.5), Fault::Kill(MERGE)),
    ));
}

#[test]
fn the_part_of_a_silent_slam_process_is_marked_as_old() {
    for kill_merging in [false, true] {
        let mut faults = with_silent_slam(FaultPlan::none());
        if kill_merging {
            faults = faults.with(second(8.0), Fault::Kill(MERGE));
        }
        let mut fleet = Lockstep::with_faults(&pair(), true, faults).unwrap();
        let mut oldest_s = [0.0_f64; 2];
        while fleet.now().seconds() < 20.0 {
            fleet.tick(&mut |_, _| {});
            let view = FleetView::new(fleet.stats());
            for (oldest_s, robot) in oldest_s.iter_mut().zip(&view.robots) {
                *oldest_s = oldest_s.max(robot.old_map_age_s().unwrap_or(0.0));
                let is_said = view.alarms().iter().any(|alarm| alarm.contains("merged map is"));
                assert!(robot.old_map_age_s().is_none() || is_said, "{:?}", view.alarms());
            }
        }
        assert!(oldest_s[0] == 0.0 && (4.0..10.0).contains(&oldest_s[1]), "{kill_merging}: {oldest_s:?}");
        let ages_s = fleet.stats().robots[..2].iter().map(|robot| robot.map_age_s);
        let ages_s: Vec<f64> = ages_s.collect();
        assert!(ages_s.iter().all(|age_s| (0.0..1.0).contains(age_s)), "at the end: {ages_s:?}");
    }
}

#[test]
fn robots_stand_however_their_operator_vanishes() {
    let away = Duration::from_secs(3);
    for fault in [Fault::LetGo(away), Fault::OperatorLeaves(away), Fault::OperatorFrozen(away)] {
        assert_survives(FaultPlan::none().with(second(5.0), fault), 12);
    }
    assert_survives(FaultPlan::none().with_cut(second(5.0), second(8.0)), 12);
}

#[test]
fn a_second_operator_drives_only_what_nobody_drives() {
    let faults = FaultPlan::none().with(second(2.0), Fault::Contend(0, Duration::from_secs(8)));
    let faults = faults.with(second(5.0), Fault::OperatorFrozen(Duration::from_secs(3)));
    assert_survives(faults.with(second(6.5), Fault::Kill(BRIDGE)), 14);
}

#[test]
fn the_emergency_stop_outlives_the_bridge() {
    for kill_after in [0.0, 0.05, 1.0] {
        let faults = FaultPlan::none().with(second(4.0), Fault::EmergencyStop(Duration::from_secs(4)));
        assert_survives(faults.with(second(4.0 + kill_after), Fault::Kill(BRIDGE)), 12);
    }
}

#[test]
fn a_bridge_that_is_stopped_is_replaced_and_robots_stand_meanwhile() {
    let faults = FaultPlan::none().with(second(4.0), Fault::Freeze(BRIDGE, Duration::from_secs(60)));
    assert_survives(faults, 14);
}

#[test]
fn a_paused_robots_pose_is_right_though_its_driver_is_started_again() {
    let faults = FaultPlan::none().with(second(8.0), Fault::Pause(0, Duration::from_secs(3)));
    assert_survives(faults.with(second(9.0), Fault::Kill(SIM_1)), 14);
}

#[test]
fn a_paused_robot_that_is_looked_for_says_so() {
    // Both are gone for a while, so that the new processes know nothing of how `odom` moved.
    for apart_s in [-0.3, -0.1, 0.0, 0.1, 0.3] {
        let faults = FaultPlan::none().with(second(6.0), Fault::Pause(0, Duration::from_secs(6)));
        let faults = faults.with(second(8.0), Fault::Kill(SIM_1));
        assert_survives(faults.with(second(8.0 + apart_s), Fault::Kill(SLAM_1)), 14);
    }
}

#[test]
fn a_map_begun_anew_while_the_driver_is_started_again_is_in_the_same_frame() {
    // The reset comes before the new driver's first odometry, and the first scan after it.
    for after_s in [0.0, 0.1, 0.2] {
        let faults = FaultPlan::none().with(second(8.0), Fault::Kill(SIM_1));
        assert_survives(faults.with(second(8.0 + after_s), Fault::ResetMap(0)), 14);
    }
}

#[test]
fn a_map_begun_anew_after_the_driver_was_started_again_is_in_the_same_frame() {
    for apart in [0.25, 0.4] {
        // The disk is full: SLAM finds no session, and begins where `odom` lay.
        let faults = FaultPlan::none().with_full_disk(second(0.0), second(14.0));
        let faults = faults.with(second(8.0), Fault::Kill(SIM_1));
        assert_survives(faults.with(second(8.0 + apart), Fault::Kill(SLAM_1)), 14);
    }
}
