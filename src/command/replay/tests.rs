//! Replays of a small made-up log.

use super::*;
use std::io::Write as _;
use std::path::Path;

/// A robot that drives 2 m through a box of 8 m x 6 m, one scan each 0.25 m.
fn log() -> String {
    let mut log = String::from("# a box\nPARAM robot none\n");
    for step in 0..9 {
        let x = f64::from(step) * 0.25;
        log += "FLASER 181";
        for beam in 0..181 {
            let (sin, cos) = (f64::from(beam) - 90.0).to_radians().sin_cos();
            let range = ((6.0 - x) / cos.max(1e-9)).min(3.0 / sin.abs().max(1e-9));
            log += &format!(" {range:.3}");
        }
        let odometry = x * 1.02;
        log += &format!(" 0 0 0 {odometry} 0 0 976052890.24411{step} host 0\n");
        log += "FLASER 3 1 2 oops\n";
    }
    log
}

/// The options of a replay of one log, with nothing else given.
pub fn args(log: &Path) -> ReplayArgs {
    ReplayArgs {
        logs: vec![log.to_owned()],
        bag: BagArgs::default(),
        config: None,
        merge: None,
        trajectory: None,
        map: None,
        json: false,
        fov_deg: None,
        no_odometry: false,
        no_closures: false,
        session: None,
        save_session: None,
        mode: Mode::Mapping,
        at: None,
        go_on: false,
        skip: 0,
        scans: None,
        serving: serve::ServeArgs::default(),
    }
}

#[test]
fn every_scan_gets_a_pose_at_its_own_stamp() {
    let folder = std::env::temp_dir().join(format!("mr-slam-replay-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let (path, trajectory) = (folder.join("box.log.gz"), folder.join("box.tum"));
    let mut packed = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    packed.write_all(log().as_bytes()).unwrap();
    std::fs::write(&path, packed.finish().unwrap()).unwrap();
    let map = Some(folder.join("box.yaml"));
    run(&ReplayArgs { trajectory: Some(trajectory.clone()), map, ..args(&path) }).unwrap();

    let text = std::fs::read_to_string(&trajectory).unwrap();
    let rows: Vec<Vec<&str>> = text.lines().map(|l| l.split(' ').collect()).collect();
    assert_eq!(rows.len(), 9);
    for (step, row) in rows.iter().enumerate() {
        assert_eq!(row[0], format!("976052890.24411{step}"));
        let x: f64 = row[1].parse().unwrap();
        assert!((x - 0.25 * step as f64).abs() < 0.02, "{x} at scan {step}");
    }
    assert!(folder.join("box.pgm").exists() && folder.join("box.yaml").exists());
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn malformed_lines_are_counted() {
    let replayed =
        feed(&Log::Carmen(log().into_bytes()), SlamConfig::default(), &args(Path::new("box.log"))).unwrap();
    let summary = replayed.summary;
    assert_eq!((summary.scans, summary.malformed_lines, summary.skipped_lines), (9, 9, 2));
}

#[test]
fn a_scan_stamped_in_the_far_future_is_left_out_and_counted_and_the_others_are_used() {
    let log = log();
    let stamp = |step: usize| format!("976052890.24411{step}");
    let scans = || (0..9).filter(|step| log.contains(&stamp(*step)));
    assert_eq!(scans().count(), 9);
    for step in [0, 4, 7] {
        let changed = log.replace(&stamp(step), &format!("976053890.24411{step}"));
        let replayed =
            feed(&Log::Carmen(changed.into_bytes()), SlamConfig::default(), &args(Path::new("box.log")));
        let summary = replayed.unwrap().summary;
        assert_eq!((summary.scans, summary.left_out.stray_stamps, summary.rejected()), (8, 1, 0), "{step}");
        assert!(serde_json::to_value(&summary).unwrap()["left_out"]["stray_stamps"] == 1);
        assert!(summary.text().contains("1 scans whose single stamps"));
    }
}

#[test]
fn a_log_without_scans_says_what_was_expected() {
    let error =
        feed(&Log::Carmen(b"ODOM 1 2\nhello\n".to_vec()), SlamConfig::default(), &args(Path::new("x.log")));
    let message = error.err().unwrap().to_string();
    assert!(message.contains("x.log") && message.contains("FLASER"), "{message}");
    assert!(message.contains("1 other lines, 1 malformed"), "{message}");
}

#[test]
fn a_log_whose_scans_are_all_skipped_says_how_many_it_has() {
    let all = |skip| ReplayArgs { skip, ..args(Path::new("box.log")) };
    let fed = |skip| feed(&Log::Carmen(log().into_bytes()), SlamConfig::default(), &all(skip));
    assert_eq!(fed(8).unwrap().summary.scans, 1);
    let message = fed(9).err().unwrap().to_string();
    assert!(message.contains("box.log has 9 scans") && message.contains("--skip"), "{message}");
}

#[test]
fn outputs_that_cannot_be_written_are_refused_before_the_log_is_read() {
    let folder = tempfile::tempdir().unwrap();
    let nowhere = Some(folder.path().join("missing/result"));
    let log = || args(&folder.path().join("missing.log"));
    for args in [
        ReplayArgs { map: nowhere.clone(), ..log() },
        ReplayArgs { trajectory: nowhere.clone(), ..log() },
        ReplayArgs { save_session: nowhere.clone(), ..log() },
    ] {
        let error = run(&args).unwrap_err();
        assert!(
            matches!(&error, ReplayError::Write { path, .. } if path.starts_with(folder.path().join("missing"))),
            "{error}"
        );
    }
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn results_that_would_replace_what_is_read_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let names = ["robot1.tum", "map.yaml", "fleet.toml", "starts"];
    names.iter().for_each(|name| std::fs::write(path(name), "kept").unwrap());
    let (log, other) = (|| args(&path("robot1.tum")), |name| Some(path(name)));
    let starts = || Some(Starts::Known(path("starts")));
    for args in [
        ReplayArgs { trajectory: other("robot1.tum"), ..log() },
        ReplayArgs { save_session: other("fleet.toml"), config: other("fleet.toml"), ..log() },
        ReplayArgs { save_session: other("robot1.tum"), session: other("robot1.tum"), ..log() },
        ReplayArgs { map: other("map"), logs: vec![path("map.yaml")], ..log() },
        ReplayArgs { trajectory: Some(folder.path().into()), merge: starts(), ..log() },
        ReplayArgs { map: other("new"), save_session: other("starts"), merge: starts(), ..log() },
    ] {
        let error = run(&args).unwrap_err();
        assert!(matches!(error, ReplayError::Overwrites(_)), "{error}");
    }
    assert!(names.iter().all(|name| std::fs::read_to_string(path(name)).unwrap() == "kept"));
}

#[test]
fn figures_that_were_not_measured_are_null() {
    let json = serde_json::to_value(Summary::default()).unwrap();
    for name in ["wall_s", "times_real_time", "scan_ms", "back_end_ms", "map_width", "map_height", "map_ms"] {
        assert!(json[name].is_null(), "{name} of a robot in `--merge`: {json:#}");
    }
    let replayed =
        feed(&Log::Carmen(log().into_bytes()), SlamConfig::default(), &args(Path::new("box.log"))).unwrap();
    assert!(replayed.summary.scan_ms.is_some_and(|times| times.p50 > 0.0));
}

#[test]
fn localization_without_a_map_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let (path, saved) = (folder.path().join("room.log"), folder.path().join("room.session"));
    std::fs::write(&path, furnished_log()).unwrap();
    let localizing =
        ReplayArgs { mode: Mode::Localization, save_session: Some(saved.clone()), ..args(&path) };
    assert!(matches!(run(&localizing), Err(ReplayError::NothingToLocalizeIn)));
    assert!(!saved.exists());
}

#[test]
fn localization_writes_the_poses_of_its_own_scans_in_the_map() {
    let folder = tempfile::tempdir().unwrap();
    let (path, session) = (folder.path().join("room.log"), folder.path().join("room.session"));
    std::fs::write(&path, furnished_log()).unwrap();
    let mapping = ReplayArgs { save_session: Some(session.clone()), ..args(&path) };
    run(&mapping).unwrap();
    let trajectory = folder.path().join("localized.tum");
    let localizing = ReplayArgs {
        session: Some(session),
        mode: Mode::Localization,
        at: Some(Pose2::IDENTITY),
        trajectory: Some(trajectory.clone()),
        save_session: None,
        ..mapping
    };
    run(&localizing).unwrap();
    let text = std::fs::read_to_string(&trajectory).unwrap();
    let poses: Vec<(f64, f64)> = text
        .lines()
        .map(|line| {
            let mut values = line.split(' ').map(|value| value.parse::<f64>().unwrap());
            (values.next().unwrap(), values.next().unwrap())
        })
        .collect();
    assert!(poses.len() > STEPS / 2, "{} poses of {STEPS} scans:\n{text}", poses.len());
    for (stamp, x) in &poses {
        let driven_m = (stamp - FIRST_STAMP_S) * SPEED_M_S;
        assert!((x - driven_m).abs() < 0.1, "{x} m at {stamp}, where the robot had driven {driven_m} m");
    }
    let replayed =
        feed(&Log::Carmen(std::fs::read(&path).unwrap()), SlamConfig::default(), &localizing).unwrap();
    assert_eq!(replayed.summary.not_located + poses.len() as u64, STEPS as u64);
}

/// Scans of [`furnished_log`].
const STEPS: usize = 40;
/// Stamp of its first scan, seconds.
const FIRST_STAMP_S: f64 = 1000.0;
/// Speed of its robot.
const SPEED_M_S: f64 = 0.1;

/// A robot that drives 3.9 m along a room of 8 m x 6 m with boxes by its walls, one scan a second.
fn furnished_log() -> String {
    let boxes = [(2.0, 2.0, 1.0), (4.0, -2.4, 0.6), (5.2, 1.8, 1.4), (1.0, -1.9, 1.3), (6.2, -0.8, 0.9)];
    // Whether a point is no floor.
    let is_solid = |x: f64, y: f64| {
        !(-1.0..7.0).contains(&x)
            || y.abs() > 3.0
            || boxes
                .iter()
                .any(|(left, low, side)| (*left..left + side).contains(&x) && (*low..low + side).contains(&y))
    };
    let mut log = String::new();
    for step in 0..STEPS {
        let seconds = step as f64;
        let x = seconds * SPEED_M_S;
        log += "FLASER 181";
        for beam in 0..181 {
            let (sin, cos) = (f64::from(beam) - 90.0).to_radians().sin_cos();
            let range = (1..1000).map(|k| 0.01 * f64::from(k)).find(|r| is_solid(x + r * cos, r * sin));
            log += &format!(" {:.3}", range.unwrap_or(10.0));
        }
        log += &format!(" {x} 0 0 {x} 0 0 {} host 0\n", FIRST_STAMP_S + seconds);
    }
    log
}
