//! What a recording is of: the metadata at the beginning of each file.

use crate::run::Run;
use recording::{METADATA, RecordingReader};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

/// Key of the fleet's configuration as TOML.
pub const CONFIGURATION: &str = "configuration";
/// Key of the time of stamp 0, nanoseconds of CLOCK_MONOTONIC.
pub const EPOCH: &str = "epoch_monotonic_ns";

/// Describes a run: configuration, room, seed, version and machine.
pub fn of_run(run: &Run) -> BTreeMap<String, String> {
    let config = &run.config;
    let entries = [
        (CONFIGURATION, config.to_toml()),
        ("robots", config.fleet.robots.to_string()),
        ("room", config.fleet.room.clone()),
        ("seed", config.fleet.seed.to_string()),
        ("version", env!("CARGO_PKG_VERSION").to_owned()),
        ("machine", machine()),
        (EPOCH, run.epoch.monotonic_ns.to_string()),
    ];
    entries.into_iter().map(|(key, value)| (key.to_owned(), value)).collect()
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
