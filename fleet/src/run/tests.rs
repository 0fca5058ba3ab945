//! Tests of creating and attaching to runs.

use super::*;
use crate::config::room;
use std::os::unix::fs::PermissionsExt;

#[test]
fn a_folder_that_anybody_may_write_to_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let dir = folder.path().join("run");
    create_folder(&dir).unwrap();
    fs::set_permissions(&dir, fs::Permissions::from_mode(0o777)).unwrap();
    let why = create_folder(&dir).unwrap_err().to_string();
    assert!(why.contains("777") && why.contains("--run-dir"), "{why}");
}

#[test]
fn a_run_that_cannot_be_described_leaves_nothing_in_shared_memory() {
    const ALONE: &str = "MR_SLAM_TEST_ALONE";
    if std::env::var_os(ALONE).is_none() {
        // Other tests have runs of this process; in one of its own, all that is there is this run's.
        let name = std::thread::current().name().unwrap().to_owned();
        let test = std::env::current_exe().unwrap();
        let test = std::process::Command::new(test).args(["--exact", &name]).env(ALONE, "1").output();
        let output = String::from_utf8_lossy(&test.as_ref().unwrap().stdout).into_owned();
        assert!(test.unwrap().status.success() && output.contains("1 passed"), "{output}");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    // A file cannot replace a folder that is not empty.
    fs::create_dir_all(folder.path().join("run.json/in-the-way")).unwrap();
    Run::create(folder.path(), FleetConfig::default(), 0, false).unwrap_err();
    let own = format!("mrslam_{}_", std::process::id());
    let entries = fs::read_dir(crate::shared_memory::SHARED_MEMORY).unwrap().flatten();
    let left: Vec<_> = entries
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .filter(|name| name.starts_with(&own) && name.ends_with("_ipc"))
        .collect();
    assert!(left.is_empty(), "{left:?}");
}

#[test]
fn a_runs_processes_read_the_room_of_its_start_whatever_becomes_of_the_files() {
    let (maps, folder) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let room = maps.path().join("hall.obj");
    let box_of_walls = "v 0 0 0\nv 4 0 0\nv 4 4 0\nv 0 4 0\nv 0 0 2\nv 4 0 2\nv 4 4 2\nv 0 4 2\n\
                        f 1 2 3 4\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n";
    fs::write(&room, box_of_walls).unwrap();
    let mut config = FleetConfig::default();
    config.fleet.room = room.display().to_string();
    let digest = room::sha256(&config.fleet.room).unwrap();
    let run = Run::create(folder.path(), config, 0, false).unwrap();
    let _guard = DomainGuard::new(run.domain.clone());
    assert_eq!(run.config.world_name(), "hall.obj");
    fs::write(&room, "v 0 0 0\n").unwrap();
    let of_process = |run: &Run| Run::open(&run.dir).unwrap().config.fleet.room;
    assert_eq!(room::sha256(&of_process(&run)).unwrap(), digest);
    room::load(&of_process(&run)).map(drop).unwrap();
    // The folder that is made again has the room, too.
    let real = run.dir.clone();
    fs::rename(&real, real.with_extension("moved")).unwrap();
    restore_folder(&run).unwrap().unwrap();
    assert_eq!(room::sha256(&of_process(&run)).unwrap(), digest);
    fs::remove_dir_all(real.with_extension("moved")).unwrap();
}

#[test]
fn a_tool_of_another_build_is_told_so_when_it_attaches_or_cannot_read_the_configuration() {
    let folder = tempfile::tempdir().unwrap();
    let run = Run::create(folder.path(), FleetConfig::default(), 0, false).unwrap();
    let _guard = DomainGuard::new(run.domain.clone());
    run.attach(Role::Telemetry, None).unwrap();
    fs::write(run.domain.root().join("build"), "0.0.9, layout 1").unwrap();
    let why = run.attach(Role::Telemetry, None).err().unwrap().to_string();
    assert!(why.contains("0.0.9, layout 1") && why.contains(layout::OWN), "{why}");
    fs::write(run.dir.join("fleet.toml"), "[of_another_build]\nkey = 1\n").unwrap();
    let why = Run::open_running(&run.dir).unwrap_err().to_string();
    assert!(why.contains("0.0.9, layout 1"), "{why}");
}

#[test]
fn fleets_that_start_in_the_same_second_get_folders_of_their_own() {
    let folder = tempfile::tempdir().unwrap();
    let parent = folder.path().join("runs");
    let create = || create_new_folder(&parent, "2026-01-01T00-00-00").unwrap();
    let starts: Vec<_> =
        std::thread::scope(|all| [0; 4].map(|_| all.spawn(create)).map(|one| one.join().unwrap()).into());
    let mut names: Vec<_> = starts.iter().map(|dir| dir.strip_prefix(&parent).unwrap().to_owned()).collect();
    names.sort();
    let expected = ["", "-2", "-3", "-4"].map(|end| PathBuf::from(format!("2026-01-01T00-00-00{end}")));
    assert_eq!(names, expected);
}
