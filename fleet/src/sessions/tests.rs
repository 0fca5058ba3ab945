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

/// A folder in which a map of another frame was loaded into robot 2, and of whose frame robot 3's file says nothing that can be read.
fn with_other_frames(folder: &Path) -> Vec<Option<Pose2>> {
    let known = vec![Some(Pose2::new(1.0, 2.0, 0.5)); 3];
    create_folder(folder, &known, None, false).unwrap();
    for robot in RobotId::first(3) {
        std::fs::write(file(folder, robot), "").unwrap();
    }
    let [first, second, third] = [1, 2, 3].map(|number| frame_file(folder, RobotId::new(number).unwrap()));
    std::fs::write(first, "0").unwrap();
    std::fs::write(second, "1").unwrap();
    std::fs::write(third, "?").unwrap();
    known
}

#[test]
fn the_start_of_a_robot_that_loaded_a_map_of_another_frame_is_unknown() {
    let folder = tempfile::tempdir().unwrap();
    let mut run = Run::in_memory(FleetConfig::default()).unwrap();
    run.dir = folder.path().into();
    let sessions = super::folder(&run);
    let known = with_other_frames(&sessions);
    let expected = [known[0], None, None];
    run.config.sessions.begin_with.clone_from(&sessions);
    assert_eq!(known_starts(&run.config, vec![None; 3]).unwrap(), expected);
    // Merging that is started again knows no more.
    assert_eq!(crate::world::known_starts_of_run(&run).unwrap()[..3], expected);
}

#[test]
fn a_run_in_the_folder_of_another_begins_in_the_first_frame_and_not_with_a_wrong_start() {
    for is_continued in [false, true] {
        let folder = tempfile::tempdir().unwrap();
        with_other_frames(folder.path());
        let mut config = FleetConfig::default();
        config.sessions.begin_with = folder.path().into();
        let known = known_starts(&config, vec![None; 3]).unwrap();
        create_folder(folder.path(), &known, Some(folder.path()).filter(|_| is_continued), false).unwrap();
        for robot in RobotId::first(3) {
            let frame = frame_file(folder.path(), robot);
            assert_eq!(read_frame(&DiskStorage, &frame).unwrap(), 0, "{robot}");
            let earlier = frame.with_extension("frame.earlier");
            assert_ne!(
                earlier.exists(),
                is_continued,
                "the number stays beside the session that was renamed"
            );
        }
        let kept = read_starts(&folder.path().join(STARTS)).unwrap();
        assert_eq!(kept.keys().collect::<Vec<_>>(), ["robot1"]);
    }
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
