//! Resources of the machine that a fleet needs: shared memory, file descriptors, disk. Checked before a start, watched after it.

use crate::FleetConfig;
use runtime::channel::{SharedMemoryNeed, shared_memory_need};
use runtime::shared_memory::SHARED_MEMORY;
pub use runtime::storage::free_bytes;
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Descriptors of a process beside its channels: standard streams, clients, files, DDS.
const DESCRIPTORS_BASE: u64 = 256;
/// Descriptors of one transport of the bridge for each robot; no process has more channels. The bridge of a fleet of
/// three has 277 in all.
const DESCRIPTORS_PER_ROBOT: u64 = 64;
/// Descriptors that are asked for if the system permits them: more costs nothing.
const DESCRIPTORS_WISHED: u64 = 65_536;
/// Disk for maps, sessions and the report of one robot: its largest map as PGM and PNG, and its session, bytes.
const DISK_PER_ROBOT: u64 = 64 << 20;
/// Disk below which a fleet does not start, bytes: it could not even describe itself.
const DISK_LEAST: u64 = 1 << 20;

/// Resource that a fleet would lack.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
pub enum Shortage {
    /// Shared memory has too little room.
    #[error("{SHARED_MEMORY} has {} free; the fleet needs {} at least, {} when readers fall behind: mount -o remount,size={}M {SHARED_MEMORY}, or docker run --shm-size={}m", megabytes(*free), megabytes(need.least), megabytes(need.most), mebibytes(need.most), mebibytes(need.most))]
    SharedMemory {
        /// Bytes that are free.
        free: u64,
        /// Bytes that are needed.
        need: SharedMemoryNeed,
    },
    /// A process may open too few files.
    #[error(
        "a process may open {limit} files; the fleet's need {need}: ulimit -n {need}, or `nofile` in /etc/security/limits.conf"
    )]
    Descriptors {
        /// Largest number that is permitted.
        limit: u64,
        /// Number that is needed.
        need: u64,
    },
    /// The disk of the run's folder has too little room.
    #[error("{folder}: {} free; the fleet's maps and sessions need up to {}", megabytes(*free), megabytes(*need))]
    Disk {
        /// Folder of the run.
        folder: PathBuf,
        /// Bytes that are free.
        free: u64,
        /// Bytes that are needed.
        need: u64,
    },
}

fn megabytes(bytes: u64) -> String {
    format!("{:.1} MB", bytes as f64 * 1e-6)
}

fn mebibytes(bytes: u64) -> u64 {
    bytes.div_ceil(1 << 20)
}

/// A shortage, and whether a fleet can start all the same.
#[derive(Debug, PartialEq, Eq)]
pub struct Finding {
    /// What is short.
    pub shortage: Shortage,
    /// Whether a fleet cannot start.
    pub is_fatal: bool,
}

/// Compares free shared memory with the need of a fleet.
pub fn check_shared_memory(config: &FleetConfig) -> Option<Finding> {
    check_shared_memory_of(
        free_bytes(Path::new(SHARED_MEMORY))?,
        shared_memory_need(config.fleet.robots, config.world.is_external()),
    )
}

fn check_shared_memory_of(free: u64, need: SharedMemoryNeed) -> Option<Finding> {
    let shortage = Shortage::SharedMemory { free, need };
    (free < need.most).then_some(Finding { shortage, is_fatal: free < need.least })
}

/// Raises this process's limit of file descriptors as far as permitted, for its children too, and compares it with the need.
pub fn check_descriptors(config: &FleetConfig) -> Option<Finding> {
    let Rlimit { current, maximum } = getrlimit(Resource::Nofile);
    let wished = maximum.unwrap_or(u64::MAX).min(DESCRIPTORS_WISHED);
    let mut limit = current.unwrap_or(u64::MAX);
    if limit < wished && setrlimit(Resource::Nofile, Rlimit { current: Some(wished), maximum }).is_ok() {
        limit = wished;
    }
    let transports = 1 + u64::from(config.bridge.dds.enabled);
    check_descriptors_of(limit, transports * config.fleet.robots as u64)
}

fn check_descriptors_of(limit: u64, robot_transports: u64) -> Option<Finding> {
    let need = DESCRIPTORS_BASE + DESCRIPTORS_PER_ROBOT * robot_transports;
    let shortage = Shortage::Descriptors { limit, need };
    (limit < need).then_some(Finding { shortage, is_fatal: true })
}

/// Compares the free room in the run's folder with the need of a fleet.
pub fn check_disk(folder: &Path, config: &FleetConfig) -> Option<Finding> {
    check_disk_of(folder, free_bytes(folder)?, config.fleet.robots)
}

fn check_disk_of(folder: &Path, free: u64, robots: usize) -> Option<Finding> {
    let need = DISK_PER_ROBOT * robots as u64;
    let shortage = Shortage::Disk { folder: folder.to_owned(), free, need };
    (free < need).then_some(Finding { shortage, is_fatal: free < DISK_LEAST })
}

/// Watches shared memory and disk of a running fleet; reports each shortage once until it is over.
#[derive(Debug)]
pub struct ResourceMonitor {
    folder: PathBuf,
    polled: Option<Instant>,
    is_short: [bool; 2],
}

/// Period at which a running fleet's free bytes are looked at.
const POLL_PERIOD: Duration = Duration::from_secs(1);
/// Free bytes below which a running fleet's shared memory or disk counts as full: a few of the largest messages.
const NEARLY_FULL: u64 = 4 << 20;

impl ResourceMonitor {
    /// Creates the monitor of a run in `folder`.
    pub fn new(folder: &Path) -> Self {
        Self { folder: folder.to_owned(), polled: None, is_short: [false; 2] }
    }

    /// Looks at the free bytes once a second, and calls `notify` with what has changed. Returns whether there is room again.
    pub fn poll(&mut self, notify: &mut dyn FnMut(String)) -> bool {
        if self.polled.is_some_and(|polled| polled.elapsed() < POLL_PERIOD) {
            return false;
        }
        self.polled = Some(Instant::now());
        let free = [free_bytes(Path::new(SHARED_MEMORY)), free_bytes(&self.folder)];
        self.check(free, notify)
    }

    fn check(&mut self, free: [Option<u64>; 2], notify: &mut dyn FnMut(String)) -> bool {
        let mut has_room_again = false;
        let disk = self.folder.display().to_string();
        let consequences = [
            (SHARED_MEMORY, "processes of the fleet will end with signal 7 (SIGBUS)"),
            (disk.as_str(), "sessions and maps cannot be saved"),
        ];
        for ((free, is_short), (place, consequence)) in
            free.into_iter().zip(&mut self.is_short).zip(consequences)
        {
            let Some(free) = free else { continue };
            let now_short = free < NEARLY_FULL;
            match (*is_short, now_short) {
                (false, true) => {
                    notify(format!("{place} is nearly full ({} free): {consequence}", megabytes(free)))
                }
                (true, false) => {
                    has_room_again = true;
                    notify(format!("{place} has room again ({} free)", megabytes(free)));
                }
                _ => {}
            }
            *is_short = now_short;
        }
        has_room_again
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shortage_names_what_is_free_what_is_needed_and_what_helps() {
        let need = SharedMemoryNeed { least: 10_000_000, most: 60_000_000 };
        assert_eq!(check_shared_memory_of(60_000_000, need), None);
        let warning = check_shared_memory_of(30_000_000, need).unwrap();
        assert!(!warning.is_fatal);
        let fatal = check_shared_memory_of(5_000_000, need).unwrap();
        let words = fatal.shortage.to_string();
        assert!(fatal.is_fatal && words.contains("5.0 MB free") && words.contains("remount"), "{words}");
        assert_eq!(check_descriptors_of(1024, 3), None);
        let words = check_descriptors_of(64, 3).unwrap().shortage.to_string();
        assert!(words.contains("may open 64 files") && words.contains("ulimit"), "{words}");
        assert!(check_disk_of(Path::new("/run"), 0, 1).unwrap().is_fatal);
        assert!(!check_disk_of(Path::new("/run"), DISK_LEAST, 1).unwrap().is_fatal);
    }

    #[test]
    fn a_full_file_system_is_reported_once_and_its_end_too() {
        let mut monitor = ResourceMonitor::new(Path::new("/run"));
        let mut reported = Vec::new();
        let judged = [1 << 30, 100, 50, 1 << 30]
            .map(|free| monitor.check([Some(free), None], &mut |event| reported.push(event)));
        assert_eq!(judged, [false, false, false, true]);
        assert_eq!(reported.len(), 2, "{reported:?}");
        assert!(reported[0].contains("SIGBUS") && reported[1].contains("room again"), "{reported:?}");
    }
}
