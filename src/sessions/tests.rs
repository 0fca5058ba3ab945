//! Folders of sessions: what a run begins with, keeps and sets aside.

use super::*;

#[test]
fn places_of_maps_come_back() {
    let folder = tempfile::tempdir().unwrap();
    let known = [Some(Pose2::new(1.0, 2.0, 0.5)), None, Some(Pose2::IDENTITY)];
    create_folder(folder.path(), &known, None, false).unwrap();
    let mut config = FleetConfig::default();
    config.sessions.begin_with = folder.path().into();
    let elsewhere = vec![Some(Pose2::new(9.0, 9.0, 0.0)); 3];
    // Only of robots whose map is there.
    assert_eq!(known_starts(&config, elsewhere.clone()).unwrap(), elsewhere);
    for robot in RobotId::first(3) {
        std::fs::write(file(folder.path(), robot), "").unwrap();
    }
    assert_eq!(known_starts(&config, elsewhere).unwrap(), known);
}

#[test]
fn the_frame_of_maps_of_robots_that_started_anywhere_is_their_own_until_another_run_is_saved_there() {
    let folder = tempfile::tempdir().unwrap();
    for is_own_frame in [false, true, false] {
        create_folder(folder.path(), &[Some(Pose2::IDENTITY)], None, is_own_frame).unwrap();
        assert_eq!(have_own_frame(folder.path()), is_own_frame);
    }
}

#[test]
fn sessions_of_robots_that_an_earlier_run_had_are_not_those_of_this_one() {
    let folder = tempfile::tempdir().unwrap();
    let files = [1, 2, 3].map(|number| file(folder.path(), RobotId::new(number).unwrap()));
    files.iter().for_each(|path| std::fs::write(path, "a session").unwrap());
    create_folder(folder.path(), &[None, None], Some(folder.path()), false).unwrap();
    assert!(files[0].exists() && files[1].exists() && !files[2].exists());
    assert!(folder.path().join("robot3.slam.earlier").exists(), "nothing is deleted");
}

#[test]
fn sessions_that_are_not_continued_are_kept_beside_those_of_the_next_run() {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name);
    let elsewhere = tempfile::tempdir().unwrap();
    for (run, begin_with) in [("first", None), ("second", None), ("third", Some(elsewhere.path()))] {
        create_folder(folder.path(), &[Some(Pose2::IDENTITY), None], begin_with, false).unwrap();
        for name in ["robot1.slam", "robot2.slam", "robot2.log1"] {
            assert!(!place(name).exists(), "{run}: {name} would be overwritten");
            std::fs::write(place(name), run).unwrap();
        }
    }
    for name in ["robot1.slam.earlier", "robot2.slam.earlier", "robot2.log1.earlier"] {
        assert_eq!(std::fs::read_to_string(place(name)).unwrap(), "second", "{name}");
    }
    assert!(place("starts.json.earlier").exists() && place(STARTS).exists());
}

fn save_without_nodes(config: &FleetConfig, folder: &Path, robot: RobotId) {
    let identity = SessionIdentity::new(robot.number() as u32, 7, &config.slam);
    let (_, back) =
        slam::create_or_resume(config.slam.clone(), None, SlamMode::Mapping, slam::InitialPose::Unknown);
    session_file::write(&file(folder, robot), &back.session(identity, None, &[])).unwrap();
}

#[test]
fn a_session_without_nodes_is_no_session_to_begin_with() {
    let folder = tempfile::tempdir().unwrap();
    let mut config = FleetConfig::default();
    config.sessions.begin_with = folder.path().into();
    create_folder(folder.path(), &[Some(Pose2::IDENTITY)], None, false).unwrap();
    for robot in RobotId::first(config.fleet.robots) {
        save_without_nodes(&config, folder.path(), robot);
    }
    assert!(matches!(check(&config), Err(SessionsError::Nothing { .. })));
    let elsewhere = vec![Some(Pose2::new(9.0, 9.0, 0.0)); config.fleet.robots];
    assert_eq!(known_starts(&config, elsewhere.clone()).unwrap(), elsewhere);
}

#[test]
fn a_map_that_is_reset_in_a_continued_folder_stays_where_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let mut run = Run::in_memory(FleetConfig::default()).unwrap();
    run.dir = folder.path().into();
    assert_eq!(continued_starts(&run).unwrap(), None, "it begins with no folder");
    let sessions = super::folder(&run);
    run.config.sessions.begin_with.clone_from(&sessions);
    let mut known = vec![Some(Pose2::new(1.0, 2.0, 0.5)); run.config.fleet.robots];
    known[0] = None;
    create_folder(&sessions, &known, Some(&sessions), false).unwrap();
    for robot in run.robots() {
        save_without_nodes(&run.config, &sessions, robot);
        assert_eq!(continued_starts(&run).unwrap().as_ref(), Some(&known));
    }
}

#[test]
fn nonsense_is_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let mut config = FleetConfig::default();
    config.sessions.begin_with = folder.path().into();
    let said = check(&config).unwrap_err().to_string();
    assert!(said.contains("robot1.slam"), "{said}");
    std::fs::write(file(folder.path(), RobotId::new(1).unwrap()), "no session").unwrap();
    let said = check(&config).unwrap_err().to_string();
    assert!(said.contains("robot1.slam") && said.contains("not a session"), "{said}");
    std::fs::write(folder.path().join(STARTS), r#"{"robot1": [1e300, 0, 0]}"#).unwrap();
    let said = known_starts(&config, vec![None]).unwrap_err().to_string();
    assert!(said.contains("starts.json") && said.contains("robot1"), "{said}");
}
