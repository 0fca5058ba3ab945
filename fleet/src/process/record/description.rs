//! What a recording is of: the metadata at the beginning of each file.

use crate::config::{RobotSource, room};
use crate::run::Run;
use crate::world;
use recording::{METADATA, RecordingReader};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

/// Key of the fleet's configuration as TOML.
pub const CONFIGURATION: &str = "configuration";
/// Key of the time of stamp 0, nanoseconds of CLOCK_MONOTONIC.
pub const EPOCH: &str = "epoch_monotonic_ns";

/// Key of the digest of the room's files; missing for a room without files.
pub const ROOM_SHA256: &str = "room_sha256";
/// Key of the simulated robots' starts in the room: x and y in metres and yaw in radians of each robot, as JSON.
pub const STARTS: &str = "starts";

/// Describes a run: configuration, room with its digest, starts, seed, version and machine.
pub fn of_run(run: &Run) -> BTreeMap<String, String> {
    let config = &run.config;
    let is_simulated = config.world == RobotSource::Simulator;
    // A room that cannot be read any more says nothing.
    let digest = is_simulated.then(|| room::sha256(&config.fleet.room).ok().flatten()).flatten();
    let starts = || world::room(config).and_then(|room| world::starts(config, &room)).ok();
    let starts = is_simulated.then(starts).flatten().map(|starts| {
        let starts: Vec<_> = starts.iter().map(|start| [start.x_m, start.y_m, start.yaw_rad]).collect();
        serde_json::json!(starts).to_string()
    });
    let of_room = [digest.map(|digest| (ROOM_SHA256, digest)), starts.map(|starts| (STARTS, starts))];
    let entries = [
        (CONFIGURATION, config.to_toml()),
        ("robots", config.fleet.robots.to_string()),
        ("room", config.fleet.room.clone()),
        ("seed", config.fleet.seed.to_string()),
        ("version", env!("CARGO_PKG_VERSION").to_owned()),
        ("machine", machine()),
        (EPOCH, run.epoch.monotonic_ns.to_string()),
    ];
    entries
        .into_iter()
        .chain(of_room.into_iter().flatten())
        .map(|(key, value)| (key.to_owned(), value))
        .collect()
}

/// Returns whether a file says that it is of another run; one that cannot be read does not.
pub fn is_of_another_run(path: &Path, run: &Run) -> bool {
    let Ok(file) = File::open(path) else { return false };
    let mut reader = RecordingReader::new(BufReader::new(file));
    // The description comes before the first message.
    let _ = reader.next_message();
    let epoch = reader.metadata(METADATA).and_then(|metadata| metadata.get(EPOCH));
    epoch.is_some_and(|epoch| *epoch != run.epoch.monotonic_ns.to_string())
}

/// Returns processor, number of cores, kernel and memory of this machine.
pub fn machine() -> String {
    let [(_, processor), (_, cores), (_, kernel), (_, memory)] = machine_parts();
    format!("{processor}, {cores} cores, {kernel}, {memory} memory")
}

/// Returns the same, each with its name.
pub fn machine_parts() -> [(&'static str, String); 4] {
    let read = |path: &str| std::fs::read_to_string(path).unwrap_or_default();
    let field = |text: &str, name: &str| {
        let line = text.lines().find(|line| line.starts_with(name));
        line.and_then(|line| line.split_once(':')).map(|(_, value)| value.trim().to_owned())
    };
    let processor = field(&read("/proc/cpuinfo"), "model name").unwrap_or_else(|| "unknown processor".into());
    let cores = std::thread::available_parallelism().map_or(0, std::num::NonZero::get);
    let kernel = format!("Linux {}", read("/proc/sys/kernel/osrelease").trim());
    let memory = field(&read("/proc/meminfo"), "MemTotal").unwrap_or_default();
    [("processor", processor), ("cores", cores.to_string()), ("kernel", kernel), ("memory", memory)]
}
