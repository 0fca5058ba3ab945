//! Tests of the channels that the processes of a fleet in lockstep open.

use super::Lockstep;
use super::faults::FaultPlan;
use super::queues::Openings;
use crate::channel::{CHANNELS, Direction, Endpoint, Opener, Program, Scope, process_health};
use crate::config::FleetConfig;
use msg::{Monotonic, RobotId, Role};

/// Returns what the table of channels declares for the processes of a simulated fleet.
fn declared(config: &FleetConfig) -> Openings {
    let processes: Vec<Opener> =
        config.processes().map(|(row, robot)| Opener { program: row.role.into(), robot }).collect();
    let mut declared = Openings::new();
    for row in CHANNELS {
        for (ends, direction) in [(row.writers, Direction::Write), (row.readers, Direction::Read)] {
            let is_here =
                |end: &&Endpoint| !matches!(end, Endpoint::External(_) | Endpoint::OtherMachines(_));
            let ends = || ends.iter().filter(is_here);
            let channels: Vec<(String, Option<RobotId>)> = match row.scope {
                Scope::Fleet => vec![(row.name.into(), None)],
                Scope::Robot => RobotId::first(config.fleet.robots)
                    .map(|robot| (format!("{robot}/{}", row.name), Some(robot)))
                    .collect(),
                Scope::Process => Vec::new(),
            };
            for opener in &processes {
                for (name, robot) in &channels {
                    if ends().any(|end| end.includes(*opener, *robot)) {
                        declared.insert((name.clone(), direction, *opener));
                    }
                }
            }
        }
    }
    let telemetry = Opener::of_fleet(Program::Worker(Role::Telemetry));
    for (row, robot) in config.processes() {
        let opener = Opener { program: row.role.into(), robot };
        let name = process_health(row.role, robot).name;
        declared.insert((name.clone(), Direction::Write, opener));
        declared.insert((name, Direction::Read, telemetry));
    }
    declared
}

#[test]
fn faults_are_listed_in_words() {
    let all = |seed| FaultPlan::draw(seed, Monotonic(30_000_000_000)).to_string();
    for seed in 0..20 {
        let text = all(seed);
        assert!(!text.contains(['{', '(', '[']) && !text.contains("Monotonic"), "{text}");
        assert!(text.lines().skip(1).all(|line| line.starts_with("  from ") || line.starts_with("  at ")));
    }
    assert!((0..20).any(|seed| all(seed).contains("s: the bridge is killed")));
    assert_eq!(FaultPlan::none().to_string().lines().count(), 1);
}

#[test]
fn every_process_opens_the_channels_that_the_table_declares_and_no_others() {
    let mut config = FleetConfig::default();
    config.fleet.robots = 3;
    config.sim.moving.people = 1;
    let mut fleet = Lockstep::with_navigation(&config, FaultPlan::none()).unwrap();
    fleet.tick(&mut |_, _| {});
    let is_process = |opener: &Opener| matches!(opener.program, Program::Worker(_));
    let opened: Openings = fleet.openings().into_iter().filter(|(_, _, opener)| is_process(opener)).collect();
    let declared = declared(&config);
    let missing: Vec<_> = declared.difference(&opened).collect();
    let surplus: Vec<_> = opened.difference(&declared).collect();
    assert!(missing.is_empty() && surplus.is_empty(), "not opened: {missing:#?}; not declared: {surplus:#?}");
}
