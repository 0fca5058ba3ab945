//! The settings of recordings.

use serde::{Deserialize, Serialize};

/// Smallest file, MB: ten chunks.
const SPLIT_MIN_MB: u64 = 10;
/// Largest file, MB.
const SPLIT_MAX_MB: u64 = 1_000_000;
/// Largest disk that a recording leaves free, MB.
const DISK_FREE_MAX_MB: u64 = 1_000_000;
/// Shortest time between two grids of one map, seconds: SLAM publishes its map at 10 Hz.
const MAP_PERIOD_MIN_S: f64 = 0.1;
/// Longest time between two grids of one map, seconds.
const MAP_PERIOD_MAX_S: f64 = 3600.0;

/// Reason why the section `[recording]` is refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum RecordingConfigError {
    /// The size is out of range.
    #[error("recording.split_mb is {0}; expected {SPLIT_MIN_MB} to {SPLIT_MAX_MB} megabytes")]
    Split(u64),
    /// The period is out of range.
    #[error("recording.map_period_s is {0}; expected {MAP_PERIOD_MIN_S} to {MAP_PERIOD_MAX_S} seconds")]
    MapPeriod(f64),
    /// The disk that is left free is out of range.
    #[error("recording.disk_free_mb is {0}; expected at most {DISK_FREE_MAX_MB} megabytes")]
    DiskFree(u64),
}

impl RecordingConfigError {
    /// Returns the key below `recording`.
    pub fn key(&self) -> &'static str {
        match self {
            Self::Split(_) => "split_mb",
            Self::MapPeriod(_) => "map_period_s",
            Self::DiskFree(_) => "disk_free_mb",
        }
    }
}

/// Section `[recording]` of the configuration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RecordingConfig {
    /// Whether `up` and `demo` record the fleet's messages into `recording/` below the run's folder; also `--record`.
    pub enabled: bool,
    /// Size at which the next file begins, megabytes, 10 to 1000000.
    pub split_mb: u64,
    /// Shortest time between two grids of one map in a recording, seconds, 0.1 to 3600.
    pub map_period_s: f64,
    /// Disk that a recording leaves free for the fleet's maps and report, megabytes, 0 to 1000000: then it ends.
    pub disk_free_mb: u64,
}

impl Default for RecordingConfig {
    fn default() -> Self {
        Self { enabled: false, split_mb: 2000, map_period_s: 1.0, disk_free_mb: 500 }
    }
}

/// Bytes of a megabyte, as this section counts them.
const BYTES_PER_MB: u64 = 1_000_000;

impl RecordingConfig {
    /// Returns the size at which the next file begins, bytes.
    pub fn split_bytes(&self) -> u64 {
        self.split_mb * BYTES_PER_MB
    }

    /// Returns how much of the disk is left free, bytes.
    pub fn disk_free_bytes(&self) -> u64 {
        self.disk_free_mb * BYTES_PER_MB
    }

    /// Checks ranges of all keys.
    pub fn validate(&self) -> Result<(), RecordingConfigError> {
        if !(SPLIT_MIN_MB..=SPLIT_MAX_MB).contains(&self.split_mb) {
            return Err(RecordingConfigError::Split(self.split_mb));
        }
        if !(MAP_PERIOD_MIN_S..=MAP_PERIOD_MAX_S).contains(&self.map_period_s) {
            return Err(RecordingConfigError::MapPeriod(self.map_period_s));
        }
        if self.disk_free_mb > DISK_FREE_MAX_MB {
            return Err(RecordingConfigError::DiskFree(self.disk_free_mb));
        }
        Ok(())
    }
}
