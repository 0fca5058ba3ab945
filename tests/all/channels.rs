//! The tables of channels and processes agree with each other and with ARCHITECTURE.md.

use mr_slam::channel::document::{BEGIN, END, chapter};
use mr_slam::channel::{self, CHANNELS, Direction, Endpoint, Opener, Program, Scope};
use msg::{RobotId, Role};
use std::collections::BTreeSet;
use std::path::Path;

/// Set this variable to rewrite the chapter instead of comparing it.
const REWRITE: &str = "MR_SLAM_REWRITE_DOCS";

#[test]
fn architecture_shows_the_tables_as_they_are() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("ARCHITECTURE.md");
    let text = std::fs::read_to_string(&path).unwrap();
    let (before, rest) = text.split_once(BEGIN).expect("ARCHITECTURE.md has no generated chapter");
    let (shown, after) = rest.split_once(END).expect("the generated chapter of ARCHITECTURE.md does not end");
    if std::env::var_os(REWRITE).is_some() {
        let text = format!("{before}{BEGIN}\n{}{END}{after}", chapter());
        std::fs::write(&path, text).unwrap();
        return;
    }
    assert!(
        shown.trim() == chapter().trim(),
        "ARCHITECTURE.md differs from the tables; rewrite it: {REWRITE}=1 cargo test --test all channels"
    );
}

#[test]
fn every_channel_has_a_name_of_its_own_a_writer_and_a_reader() {
    let names: BTreeSet<&str> = CHANNELS.iter().map(|row| row.name).collect();
    assert_eq!(names.len(), CHANNELS.len());
    for row in CHANNELS {
        assert!(!row.writers.is_empty() && !row.readers.is_empty() && !row.content.is_empty(), "{row:?}");
        assert!(row.depth > 0 && row.history <= row.depth, "{row:?}");
        assert!(row.readers_max >= row.readers.len(), "{row:?}");
        let may_share = row.scope == Scope::Process || row.writers_max > 1;
        let takes_the_place_of_another =
            |end: &&Endpoint| matches!(end, Endpoint::External(_) | Endpoint::OtherMachines(_));
        let at_once = row.writers.iter().filter(|end| !takes_the_place_of_another(end)).count();
        // A channel that exists only on several machines has one writer, which takes nobody's place. What simulated robots do not
        // have is written by one of two, by where the robots are.
        let is_of_real_robots = matches!(row.writers, [Endpoint::External(_), Endpoint::OtherMachines(_)]);
        assert!(may_share || at_once == 1 || row.writers.len() == 1 || is_of_real_robots, "{row:?}");
    }
}

#[test]
fn opening_a_channel_that_the_table_does_not_grant_is_an_error() {
    let [robot1, robot2] = [1, 2].map(|number| RobotId::new(number).unwrap());
    let sim1 = Opener::of_robot(Program::Worker(Role::Sim), robot1);
    let merge = Opener::of_fleet(Program::Worker(Role::Merge));
    assert!(channel::scan(robot1).check(sim1, Direction::Write).is_ok());
    let why = channel::scan(robot2).check(sim1, Direction::Write).unwrap_err().to_string();
    assert!(why.contains("robot2/scan") && why.contains("sim of robot1") && why.contains("table"), "{why}");
    assert!(channel::scan(robot1).check(merge, Direction::Read).is_err());
    // Only the others read a robot's truth, and merging never does.
    assert!(channel::truth(robot2).check(sim1, Direction::Read).is_ok());
    assert!(channel::truth(robot1).check(sim1, Direction::Read).is_err());
    assert!(channel::truth(robot1).check(merge, Direction::Read).is_err());
    let sim2 = Opener::of_robot(Program::Worker(Role::Sim), robot2);
    assert!(channel::clock().check(sim1, Direction::Write).is_ok());
    assert!(channel::clock().check(sim2, Direction::Write).is_err());
    assert!(channel::process_health(Role::Sim, Some(robot1)).check(sim1, Direction::Write).is_ok());
    assert!(channel::process_health(Role::Sim, Some(robot2)).check(sim1, Direction::Write).is_err());
}
