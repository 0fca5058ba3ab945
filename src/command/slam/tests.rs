//! Names of files, and robots on other machines.

use super::*;

#[test]
fn at_a_base_the_robots_machine_is_named_at_once() {
    let mut config = crate::config::FleetConfig::default();
    let robot = RobotId::new(1).unwrap();
    assert!(check_is_here(&Run::in_memory(config.clone()).unwrap(), robot).is_ok());
    config.world = RobotSource::Robots;
    let why = check_is_here(&Run::in_memory(config).unwrap(), robot).unwrap_err().to_string();
    assert!(why.contains("on the robot's own machine") && !why.contains("try again"), "{why}");
}

#[test]
fn a_folder_is_no_name_of_a_file() {
    for folder in [".", "..", "/", "maps/", ""] {
        assert!(matches!(text(Path::new(folder)), Err(SlamCommandError::Folder(_))), "{folder}");
    }
    assert!(text(Path::new("maps/monday")).unwrap().as_str().ends_with("/maps/monday"));
}
