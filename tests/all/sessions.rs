//! Sessions on the command line: saving, loading, localization, continuation and refusals.

use crate::harness::{Folder, mr_slam, output, output_of, send};
use rustix::process::Signal;
use serde_json::Value;
use slam::{SessionIdentity, SlamConfig};
use std::fmt::Write;
use std::path::Path;
use std::process::{Command, Stdio};

/// An 8 m x 6 m room that looks different from everywhere: walls as segments.
fn walls() -> Vec<[f64; 4]> {
    let rectangle = |x0: f64, y0: f64, x1: f64, y1: f64| {
        [[x0, y0, x1, y0], [x1, y0, x1, y1], [x1, y1, x0, y1], [x0, y1, x0, y0]]
    };
    [
        (0.0, 0.0, 8.0, 6.0),
        (0.0, 4.8, 1.5, 6.0),
        (6.7, 0.0, 8.0, 0.9),
        (3.4, 2.6, 4.3, 3.3),
        (7.3, 4.0, 8.0, 4.6),
    ]
    .into_iter()
    .flat_map(|(x0, y0, x1, y1)| rectangle(x0, y0, x1, y1))
    .collect()
}

/// A drive around the room's middle, from an angle in degrees on: its log, and its first pose.
fn log(from_deg: f64, scans: usize) -> (String, [f64; 3]) {
    let walls = walls();
    let pose = |i: usize| {
        let angle = (from_deg + 4.0 * i as f64).to_radians();
        [4.0 + 2.4 * angle.cos(), 3.0 + 1.7 * angle.sin(), (1.7 * angle.cos()).atan2(-2.4 * angle.sin())]
    };
    let first = pose(0);
    let mut text = String::new();
    for i in 0..scans {
        let [x, y, yaw] = pose(i);
        write!(text, "FLASER 181").unwrap();
        for beam in 0..181 {
            let (dy, dx) = (yaw + (f64::from(beam) - 90.0).to_radians()).sin_cos();
            let hit = |[ax, ay, bx, by]: &[f64; 4]| {
                let (ex, ey, fx, fy) = (bx - ax, by - ay, ax - x, ay - y);
                let cross = dx * ey - dy * ex;
                let (t, s) = ((fx * ey - fy * ex) / cross, (fx * dy - fy * dx) / cross);
                (t > 0.0 && (0.0..=1.0).contains(&s)).then_some(t)
            };
            let range = walls.iter().filter_map(hit).fold(f64::INFINITY, f64::min);
            write!(text, " {range:.3}").unwrap();
        }
        // Odometry begins at zero, as a robot's does that was switched on.
        let (sin, cos) = first[2].sin_cos();
        let (dx, dy) = (x - first[0], y - first[1]);
        let (ox, oy, turned) = (cos * dx + sin * dy, cos * dy - sin * dx, yaw - first[2]);
        writeln!(text, " 0 0 0 {ox:.4} {oy:.4} {turned:.4} {:.2} host 0", 100.0 + 0.5 * i as f64).unwrap();
    }
    (text, first)
}

fn replay(log: &Path, args: &[&str]) -> Value {
    let done = output_of(mr_slam().arg("replay").arg(log).args(args).arg("--json"));
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    serde_json::from_slice(&done.stdout).unwrap()
}

fn ends_at(summary: &Value) -> [f64; 3] {
    [0, 1, 2].map(|k| summary["ends_at"][k].as_f64().unwrap())
}

/// Checks that a session file stays whole when its process is killed or the disk is full while it is saved.
fn assert_kept_whole(log: &Path, file: &str, is_whole: &dyn Fn() -> bool) {
    // The process is killed before, during or after saving. The file is whole every time.
    for milliseconds in 0..12 {
        let mut child = mr_slam()
            .args(["replay", log.to_str().unwrap(), "--save-session", file])
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        std::thread::sleep(std::time::Duration::from_millis(15 * milliseconds));
        send(child.id(), Signal::KILL);
        child.wait().unwrap();
        assert!(is_whole(), "killed after {} ms", 15 * milliseconds);
    }

    // A limit on the file's size causes the same error as a full disk.
    let limited = format!(
        "trap '' XFSZ; ulimit -f 40; exec '{}' replay '{}' --save-session '{file}'",
        env!("CARGO_BIN_EXE_mr-slam"),
        log.display()
    );
    let done = output_of(Command::new("bash").args(["-c", &limited]));
    let said = String::from_utf8_lossy(&done.stderr);
    assert!(!done.status.success() && said.contains("room.slam"), "{said}");
    assert!(is_whole());
}

#[test]
fn a_saved_session_survives_kills_and_is_continued_in_every_mode() {
    let folder = Folder::new();
    let (text, start) = log(0.0, 100);
    let first = folder.file("first.log", text);
    let (text, again) = log(130.0, 40);
    let second = folder.file("second.log", text);
    let session = folder.path().join("room.slam");
    let file = session.to_str().unwrap();
    let saved =
        replay(&first, &["--save-session", file, "--map", folder.path().join("room.yaml").to_str().unwrap()]);
    // Which frame updates the scan path had heard of when it ended may differ; the map may not.
    let kept = || {
        let identity = SessionIdentity::new(0, 0, &SlamConfig::default());
        let back = mr_slam::session_file::read(&session, &identity).unwrap().back;
        back.poses.iter().flat_map(|p| [p.x_m, p.y_m, p.yaw_rad]).map(f64::to_bits).collect::<Vec<_>>()
    };
    let whole = kept();
    assert_kept_whole(&first, file, &|| kept() == whole);

    // The last scan of the second log, in the map of the first: the truth to compare with.
    let pose = |i: f64| {
        let angle = (130.0 + 4.0 * i).to_radians();
        [4.0 + 2.4 * angle.cos(), 3.0 + 1.7 * angle.sin()]
    };
    let last = pose(39.0);
    let (sin, cos) = start[2].sin_cos();
    let (dx, dy) = (last[0] - start[0], last[1] - start[1]);
    let truth = [cos * dx + sin * dy, cos * dy - sin * dx];
    assert!((again[0] - start[0]).hypot(again[1] - start[1]) > 2.0, "it begins elsewhere");
    let map = folder.path().join("room.yaml");
    for (from, mode) in
        [(file, "continue"), (file, "localize"), (file, "lifelong"), (map.to_str().unwrap(), "localize")]
    {
        let kept = folder.path().join("next.slam");
        let found =
            replay(&second, &["--session", from, "--mode", mode, "--save-session", kept.to_str().unwrap()]);
        let [x, y, _] = ends_at(&found);
        assert!((x - truth[0]).hypot(y - truth[1]) < 0.1, "{mode} in {from}: {found}");
        assert_eq!(found["relocalization"]["accepted"], 1, "{mode}: {found}");
        let nodes = found["nodes"].as_u64().unwrap();
        match mode {
            "continue" => assert!(nodes > saved["nodes"].as_u64().unwrap(), "{found}"),
            "localize" if from == file => assert_eq!(found["nodes"], saved["nodes"]),
            _ => {}
        }
    }
}

#[test]
fn an_invalid_session_file_is_refused_with_its_path_and_the_reason() {
    let folder = Folder::new();
    let log = folder.file("a.log", log(0.0, 12).0);
    let (log, good) = (log.to_str().unwrap(), folder.path().join("good.slam"));
    replay(Path::new(log), &["--save-session", good.to_str().unwrap()]);
    let bytes = std::fs::read(&good).unwrap();
    let mut flipped = bytes.clone();
    flipped[1000] ^= 1;
    let mut version = bytes.clone();
    version[8] = 99;
    let cases: [(&str, &[u8], &str); 5] = [
        ("cut.slam", &bytes[..bytes.len() - 9], "truncated"),
        ("flipped.slam", &flipped, "checksum"),
        ("new.slam", &version, "version 99"),
        ("picture.slam", b"P5\n1 1\n255\nx", "not a session"),
        ("empty.slam", b"", "not a session"),
    ];
    for (name, content, reason) in cases {
        let file = folder.file(name, content);
        let done = output(&["replay", log, "--session", file.to_str().unwrap()]);
        let said = String::from_utf8_lossy(&done.stderr);
        assert!(!done.status.success() && said.contains(name) && said.contains(reason), "{name}: {said}");
    }
    let robot =
        "ROBOTLASER1 0 -1.57 3.14 0.5 20 0.01 0 7 1 1 1 1 1 1 1 0 0.3 0 0 0 0 0 0 0 0 0 0 100.0 h 0\n";
    let other = folder.file("other.log", robot);
    let done = output(&["replay", other.to_str().unwrap(), "--session", good.to_str().unwrap()]);
    let said = String::from_utf8_lossy(&done.stderr);
    assert!(!done.status.success() && said.contains("another robot's"), "{said}");
}
