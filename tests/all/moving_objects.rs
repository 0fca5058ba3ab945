//! Fleets in lockstep in whose room people walk, doors open and close, and boxes are moved.

use mr_slam::channel::Program;
use mr_slam::config::FleetConfig;
use mr_slam::lockstep::Lockstep;
use mr_slam::lockstep::faults::{Fault, FaultPlan};
use mr_slam::lockstep::invariants::{check, quiet_from};
use msg::{GroundTruth, Monotonic, MovingObjects, ObjectKind, Role, Scan};
use sha2::{Digest, Sha256};

/// A fleet of two in the laboratory with people, a door and boxes.
fn config() -> FleetConfig {
    let mut config = FleetConfig::default();
    config.fleet.robots = 2;
    config.sim.moving = sim::MovingConfig { people: 4, doors: 1, boxes: 3 };
    config.sessions.autosave_s = 2.0;
    config
}

/// The process of moving objects is the first in lockstep's order.
const OBJECTS: usize = 0;
const SIM_1: usize = 1;

fn second(at: f64) -> Monotonic {
    Monotonic((at * 1e9) as u64)
}

/// Runs a fleet, and returns all messages about moving objects and the hash of all messages.
fn run(config: &FleetConfig, faults: FaultPlan, seconds: u32) -> (Vec<MovingObjects>, String) {
    let mut fleet = Lockstep::with_faults(config, true, faults).unwrap();
    let (mut hash, mut seen) = (Sha256::new(), Vec::new());
    for _ in 0..seconds * 100 {
        fleet.tick(&mut |channel, bytes| {
            hash.update(channel);
            hash.update(bytes);
            if channel == "moving_objects" {
                seen.push(bytemuck::pod_read_unaligned::<MovingObjects>(bytes));
            }
        });
    }
    (seen, format!("{:x}", hash.finalize()))
}

#[test]
fn a_seed_is_a_run_with_moving_objects_too() {
    let (seen, hash) = run(&config(), FaultPlan::none(), 10);
    assert!(seen.len() >= 198, "{} messages in 10 s", seen.len());
    assert_eq!(seen[0].objects().len(), 8);
    assert_eq!(run(&config(), FaultPlan::none(), 10).1, hash);
    let other = FleetConfig { sim: sim::SimConfig::default(), ..config() };
    let (none, other_hash) = run(&other, FaultPlan::none(), 10);
    assert!(none.is_empty() && other_hash != hash, "without moving objects nobody sends any");
}

#[test]
fn robots_see_people_where_they_are() {
    let mut fleet = Lockstep::with_faults(&config(), true, FaultPlan::none()).unwrap();
    let (mut objects, mut truth, mut hits) = (MovingObjects::default(), GroundTruth::default(), 0);
    for _ in 0..3000 {
        fleet.tick(&mut |channel, bytes| match channel {
            "moving_objects" => objects = bytemuck::pod_read_unaligned(bytes),
            "robot1/truth" => truth = bytemuck::pod_read_unaligned(bytes),
            "robot1/scan" => {
                let scan: Scan = bytemuck::pod_read_unaligned(bytes);
                let age_s = scan.header.stamp - objects.header.stamp;
                let world_from_scan = truth.world_from_base * msg::Pose2::new(-0.032, 0.0, 0.0);
                for (beam, range_m) in scan.ranges_m().iter().enumerate().filter(|(_, m)| m.is_finite()) {
                    let yaw_rad =
                        f64::from(scan.angle_min_rad) + beam as f64 * f64::from(scan.angle_increment_rad);
                    let range_m = f64::from(*range_m);
                    let hit = world_from_scan
                        * msg::Pose2::new(range_m * yaw_rad.cos(), range_m * yaw_rad.sin(), 0.0);
                    for person in objects.objects().iter().filter(|o| o.kind() == Some(ObjectKind::Person)) {
                        let at = person.world_from_object_after(age_s);
                        let inside_m = person.half_size_m[0] - at.distance_m(hit);
                        assert!(inside_m < 0.1, "a beam goes through a person by {inside_m} m");
                        hits += usize::from(inside_m.abs() < 0.03);
                    }
                }
            }
            _ => {}
        });
    }
    assert!(hits > 100, "{hits} beams end at people");
}

#[test]
fn a_restarted_process_goes_on_where_people_stood() {
    let faults =
        FaultPlan::none().with(second(5.0), Fault::Kill(OBJECTS)).with(second(7.0), Fault::Kill(SIM_1));
    let (seen, _) = run(&config(), faults, 10);
    let restarts =
        seen.windows(2).filter(|pair| pair[0].header.incarnation != pair[1].header.incarnation).count();
    assert_eq!(restarts, 1);
    for pair in seen.windows(2) {
        for (before, after) in pair[0].objects().iter().zip(pair[1].objects()) {
            // A person who starts to walk has gone one tick.
            let jump_m = before.world_from_object_after(1.0).distance_m(after.world_from_object);
            assert!(jump_m < 1e-6 || before.kind() == Some(ObjectKind::Box), "{jump_m} m: {before:?}");
            assert_eq!(before.half_size_m, after.half_size_m);
        }
    }
}

#[test]
fn invariants_hold_among_moving_objects() {
    for seed in 1..=6 {
        let mut config = config();
        config.fleet.seed = seed;
        let report = check(&config, true, FaultPlan::draw(seed, quiet_from(14)), 14).unwrap();
        assert!(report.violations.is_empty(), "seed {seed}: {:#?}", report.violations);
    }
}

#[test]
fn worlds_that_are_not_simulated_have_no_moving_objects() {
    let has_objects = |config: &FleetConfig| {
        config.processes().any(|(row, _)| Program::from(row.role) == Program::Worker(Role::Objects))
    };
    let mut config = config();
    assert!(has_objects(&config));
    config.world = mr_slam::config::RobotSource::Headset;
    assert!(!has_objects(&config));
    assert!(!has_objects(&FleetConfig::default()));
}

/// Room, number of robots and virtual seconds of a longer exploration, such as `office:7,3,900`.
const EXPLORATION_VARIABLE: &str = "MR_SLAM_MOVING_EXPLORATION";

#[test]
fn robots_that_explore_touch_neither_people_nor_doors_nor_boxes() {
    let asked = std::env::var(EXPLORATION_VARIABLE).unwrap_or("laboratory,2,40".into());
    let [room, robots, seconds] = asked.split(',').collect::<Vec<_>>().try_into().unwrap();
    let mut config = config();
    (config.fleet.room, config.fleet.robots) = (room.into(), robots.parse().unwrap());
    (config.fleet.explore, config.sim.moving.people) = (true, 3);
    let mut fleet = Lockstep::with_faults(&config, true, FaultPlan::none()).unwrap();
    let (mut driven, mut contacts) = (0.0, Vec::new());
    for _ in 0..seconds.parse::<u32>().unwrap() * 100 {
        fleet.tick(&mut |channel, bytes| {
            if let Some((robot, "truth")) = channel.split_once('/') {
                let truth: GroundTruth = bytemuck::pod_read_unaligned(bytes);
                driven += truth.linear_m_s.abs() * 0.01;
                if truth.contacts > contacts.iter().filter(|(known, _)| known == robot).count() as u64 {
                    contacts.push((robot.to_owned(), truth));
                }
            }
        });
    }
    assert!(driven > 2.0, "the robots drove {driven} m");
    assert!(contacts.is_empty(), "{contacts:#?}");
}
