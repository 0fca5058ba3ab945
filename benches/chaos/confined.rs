//! A full disk and full shared memory: the bench runs itself again in a mount namespace of its own, with small file systems.

use crate::fleet::{Fleet, PATIENCE, Process};
use crate::watch::Watch;
use crate::{Args, Row, Rows};
use mr_slam::channel::shared_memory_need;
use mr_slam::clock::now;
use mr_slam::resources::free_bytes;
use std::error::Error;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant, SystemTime};

/// First words of the bench inside.
pub const DISK: &str = "full-disk";
pub const SHM: &str = "full-shm";

/// Disk of the run's folder, and disk that the recording is to leave free, megabytes.
const DISK_MB: u64 = 64;
const DISK_FREE_MB: u64 = 16;
/// Disk that the recording has before it must end, megabytes: some seconds.
const RECORDING_MB: u64 = 4;
/// Time between two saved sessions, seconds.
const AUTOSAVE_S: f64 = 2.0;
/// Characters of a message that the table shows.
const SHOWN_MAX: usize = 46;
/// Shared memory with which no fleet starts, megabytes.
const SHM_TOO_SMALL_MB: u64 = 2;
/// How long the disk or shared memory is full.
const FULL: Duration = Duration::from_secs(8);
/// Longest time until all processes work again after shared memory was full. The supervisor waits longer before each start
/// of a process that dies again and again, at most 5 s.
const BACK_WITHIN_S: f64 = 7.0;
/// Longest wait for the recording's end.
const RECORDING_ENDS: Duration = Duration::from_secs(90);

/// Runs a part in a mount namespace of its own; says so where that is not permitted.
pub fn run(part: &str, words: &[String]) -> Rows {
    let program = std::env::current_exe()?;
    let mut command = Command::new("unshare");
    command.args(["--mount", "--propagation", "private"]).arg(program).arg(part).args(&words[1..]);
    let ended = command.stdin(Stdio::null()).output();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).trim().to_owned();
    let why = match ended {
        Ok(ended) if ended.status.success() => return Ok(serde_json::from_slice(&ended.stdout)?),
        Ok(ended) if text(&ended.stderr).contains("unshare:") => text(&ended.stderr),
        Ok(ended) => return Err(text(&ended.stderr).into()),
        Err(why) => format!("unshare: {why}"),
    };
    let name = part.trim_start_matches("full-");
    Ok(vec![Row::note(name, "not checked", why)])
}

/// Prints rows for the bench outside.
pub fn print(rows: &[Row]) -> Result<(), Box<dyn Error>> {
    println!("{}", serde_json::to_string(rows)?);
    Ok(())
}

fn mount(folder: &Path, megabytes: u64) -> Result<(), Box<dyn Error>> {
    let size = format!("size={megabytes}m");
    let ended = Command::new("mount").args(["-t", "tmpfs", "-o", &size, "tmpfs"]).arg(folder).output()?;
    if ended.status.success() { Ok(()) } else { Err(String::from_utf8_lossy(&ended.stderr).into()) }
}

/// Writes a file until only `left` bytes are free.
fn fill(folder: &Path, name: &str, left: u64) -> Result<PathBuf, Box<dyn Error>> {
    let path = folder.join(name);
    let mut file = std::fs::File::create(&path)?;
    let block = vec![0_u8; 64 << 10];
    while free_bytes(folder).unwrap_or(0) > left {
        // The last block does not fit any more.
        if file.write_all(&block).is_err() {
            break;
        }
    }
    Ok(path)
}

fn pids(fleet: &Fleet) -> Vec<Process> {
    let mut processes = fleet.processes();
    processes.retain(|process| process.name != "record");
    processes
}

/// Records and saves onto a disk that becomes full.
pub fn disk(args: &Args) -> Rows {
    let dir = std::env::temp_dir().join(format!("mr-slam-full-{}", std::process::id()));
    std::fs::create_dir_all(&dir)?;
    mount(&dir, DISK_MB)?;
    let config = dir.join("full.toml");
    let text =
        format!("[recording]\ndisk_free_mb = {DISK_FREE_MB}\n[sessions]\nautosave_s = {AUTOSAVE_S:.1}\n");
    std::fs::write(&config, text)?;
    let first = fill(&dir, "filler", (DISK_FREE_MB + RECORDING_MB) << 20)?;
    let folder = dir.join("run");
    let config = config.to_string_lossy();
    let mut fleet = Fleet::start_in(&folder, "demo", args.robots, &["--record", "--config", &config])?;
    let watch = Watch::start(&fleet.run)?;
    std::thread::sleep(Duration::from_secs_f64(2.0 * AUTOSAVE_S));
    let (begun, before) = (now(), pids(&fleet));
    let ended_s = recording_end(&folder);
    // Now saving fails too.
    let second = fill(&dir, "filler2", 0)?;
    std::thread::sleep(FULL);
    std::fs::remove_file(first)?;
    std::fs::remove_file(second)?;
    let room = (SystemTime::now(), Instant::now());
    let sessions = folder.join("sessions");
    let is_saved = || newest_change(&sessions).is_some_and(|at| at > room.0);
    while !is_saved() && room.1.elapsed() < PATIENCE {
        std::thread::sleep(Duration::from_millis(50));
    }
    let saved_s = is_saved().then(|| room.1.elapsed().as_secs_f64());
    let (missed, poses) = (watch.missed(begun, &[]), watch.poses(begun));
    let after = pids(&fleet);
    let changed = before.iter().filter(|process| !after.contains(process));
    let changed: Vec<&str> = changed.map(|process| process.name.as_str()).collect();
    drop(watch);
    let ended_well = fleet.end();
    let summary = std::fs::read_to_string(folder.join("recording/recording.json")).unwrap_or_default();
    let summary: serde_json::Value = serde_json::from_str(&summary).unwrap_or_default();
    let message = summary["ended"].as_str().unwrap_or("no message");
    // The reason stands behind the path.
    let message = message.rsplit(": ").next().unwrap_or_default();
    let seconds = |s: Option<f64>| s.map_or("never".to_owned(), |s| format!("{s:.1} s"));
    Ok(vec![
        Row::new(
            "disk",
            "the recording ended with a message, after",
            format!("{}: {message}", seconds(ended_s)),
            "a message",
            summary["ended"].is_string() && ended_s.is_some(),
        ),
        Row::new(
            "disk",
            "processes that ended meanwhile",
            format!("{} {}", changed.len(), changed.join(", ")),
            "0",
            changed.is_empty(),
        ),
        Row::new("disk", "scans without a pose", format!("{missed} of {poses}"), "0", missed == 0),
        Row::new("disk", "sessions are saved again after", seconds(saved_s), "<= 20 s", saved_s.is_some()),
        Row::new("disk", "the fleet ended well", ended_well.to_string(), "true", ended_well),
    ])
}

/// Waits until a recording's files grow no more; returns after how many seconds they last did.
fn recording_end(run: &Path) -> Option<f64> {
    let size = || -> u64 {
        let files = std::fs::read_dir(run.join("recording")).into_iter().flatten().flatten();
        files.filter_map(|file| file.metadata().ok()).map(|about| about.len()).sum()
    };
    let begun = Instant::now();
    let (mut newest, mut grew) = (size(), begun.elapsed());
    while begun.elapsed() < RECORDING_ENDS {
        let now = size();
        if now != newest {
            (newest, grew) = (now, begun.elapsed());
        }
        // It writes at least once a second while it records.
        if begun.elapsed() - grew > Duration::from_secs(5) {
            return Some(grew.as_secs_f64());
        }
        std::thread::sleep(Duration::from_millis(100));
    }
    None
}

/// Returns when a file of a folder, or of a folder in it, was changed last.
fn newest_change(folder: &Path) -> Option<SystemTime> {
    let entries = std::fs::read_dir(folder).ok()?.flatten();
    let change = |entry: std::fs::DirEntry| match entry.path().is_dir() {
        true => newest_change(&entry.path()),
        false => entry.metadata().ok()?.modified().ok(),
    };
    entries.filter_map(change).max()
}

/// Starts a fleet with too little shared memory, and fills it while another runs.
pub fn shared_memory(args: &Args) -> Rows {
    let folder = Path::new(mr_slam::shared_memory::SHARED_MEMORY);
    mount(folder, SHM_TOO_SMALL_MB)?;
    let dir = std::env::temp_dir().join(format!("mr-slam-refused-{}", std::process::id()));
    let refused = Command::new(env!("CARGO_BIN_EXE_mr-slam"))
        .args(["up", "--port", "0", "--seconds", "1", "--robots", &args.robots.to_string(), "--run-dir"])
        .arg(&dir)
        .output()?;
    std::fs::remove_dir_all(&dir)?;
    let words = String::from_utf8_lossy(&refused.stderr);
    let words = words.lines().last().unwrap_or_default();
    let named = words.contains("/dev/shm") && words.contains("remount");
    let mut rows = vec![Row::new(
        "shm",
        "too little at the start: refused, and what helps is named",
        words.chars().take(SHOWN_MAX).collect(),
        "refused",
        !refused.status.success() && named,
    )];
    mount(folder, (shared_memory_need(args.robots, false).most >> 20) + 8)?;
    let mut fleet = Fleet::start("demo", args.robots, &[])?;
    let watch = Watch::start(&fleet.run)?;
    std::thread::sleep(Duration::from_secs(5));
    let before = fleet.processes();
    let filler = fill(folder, "filler", 0)?;
    std::thread::sleep(FULL);
    let during = fleet.processes();
    let survived = before.iter().filter(|process| during.contains(process)).count();
    std::fs::remove_file(filler)?;
    let room = Instant::now();
    // And the operator.
    let (count, mut back_s) = (fleet.run.config.processes().count() + 1, None);
    while back_s.is_none() && room.elapsed() < PATIENCE {
        let from = now();
        std::thread::sleep(Duration::from_millis(500));
        // Every process works, and every robot's scans are answered.
        if fleet.processes().len() == count && watch.poses(from) >= 3 * args.robots {
            back_s = Some(room.elapsed().as_secs_f64());
        }
    }
    drop(watch);
    rows.push(Row::note(
        "shm",
        "processes that lived through full shared memory",
        format!("{survived} of {}", before.len()),
    ));
    rows.push(Row::new(
        "shm",
        "all processes work again after there is room",
        back_s.map_or("never".to_owned(), |s| format!("{s:.1} s")),
        "<= 7 s",
        back_s.is_some_and(|s| s <= BACK_WITHIN_S),
    ));
    let ended_well = fleet.end();
    rows.push(Row::new("shm", "the fleet ended well", ended_well.to_string(), "true", ended_well));
    Ok(rows)
}
