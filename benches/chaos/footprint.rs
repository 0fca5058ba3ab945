//! What a fleet takes of the machine: processes, shared memory, descriptors, memory.

use crate::fleet::{Fleet, children};
use mr_slam::run::Run;
use serde::Serialize;
use std::path::Path;

/// What a fleet takes at one moment.
#[derive(Clone, Debug, Serialize)]
pub struct Footprint {
    /// Processes below the launcher.
    pub processes: usize,
    /// Files in shared memory.
    pub shared_files: usize,
    /// Bytes of these files, megabytes.
    pub shared_mb: f64,
    /// Open descriptors of the launcher.
    pub launcher_descriptors: usize,
    /// Open descriptors of all processes.
    pub descriptors: usize,
    /// Resident memory of the launcher that it shares with no other process, megabytes.
    pub launcher_mb: f64,
    /// The same of all processes. What they share (program, channels) does not grow: the files in shared memory are counted.
    pub memory_mb: f64,
}

impl Footprint {
    /// Measures a fleet.
    pub fn of(fleet: &Fleet) -> Self {
        let launcher = fleet.launcher();
        let processes = children(launcher);
        let files = shared_files(&fleet.run);
        let bytes = |name: &String| std::fs::metadata(name).map_or(0, |about| about.len());
        Self {
            processes: processes.len(),
            shared_files: files.len(),
            shared_mb: files.iter().map(bytes).sum::<u64>() as f64 * 1e-6,
            launcher_descriptors: descriptors(launcher),
            descriptors: processes.iter().map(|pid| descriptors(*pid)).sum(),
            launcher_mb: memory_mb(launcher),
            memory_mb: processes.iter().map(|pid| memory_mb(*pid)).sum(),
        }
    }
}

/// Returns the paths of a run's files in shared memory.
pub fn shared_files(run: &Run) -> Vec<String> {
    let progress = run.domain.progress_file();
    let (Some(folder), Some(name)) = (progress.parent(), progress.file_name()) else { return Vec::new() };
    let prefix = name.to_string_lossy().trim_end_matches("progress").to_owned();
    let names = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let paths = names.map(|entry| entry.path());
    let is_own = |path: &std::path::PathBuf| {
        path.file_name().is_some_and(|name| name.to_string_lossy().starts_with(&prefix))
    };
    paths.filter(is_own).map(|path| path.display().to_string()).collect()
}

/// Returns whether a process exists.
pub fn exists(pid: u32) -> bool {
    Path::new(&format!("/proc/{pid}")).exists()
}

fn descriptors(pid: u32) -> usize {
    std::fs::read_dir(format!("/proc/{pid}/fd")).map_or(0, Iterator::count)
}

/// Returns the resident anonymous memory of a process, megabytes: heap and stacks, proc_pid_status(5).
fn memory_mb(pid: u32) -> f64 {
    let status = std::fs::read_to_string(format!("/proc/{pid}/status")).unwrap_or_default();
    let line = status.lines().find_map(|line| line.strip_prefix("RssAnon:"));
    let kilobytes = line.and_then(|line| line.split_whitespace().next()?.parse::<f64>().ok());
    kilobytes.unwrap_or(0.0) * 1.024e-3
}
