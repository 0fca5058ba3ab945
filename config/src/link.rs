//! The settings of the link between a base and robots on other machines.

use serde::{Deserialize, Serialize};

/// Highest rate of scans, Hz: that of the fastest small LiDARs.
const RATE_MAX_HZ: f64 = 20.0;
/// Lowest rate of scans, Hz.
const RATE_MIN_HZ: f64 = 0.1;
/// Fewest beams: a scan with fewer shows no walls.
const BEAMS_MIN: usize = 8;
/// Most beams that fit into one message of the link.
const BEAMS_MAX: usize = 2000;

/// Reason why the section `[link]` is refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum MachineLinkConfigError {
    /// A rate is out of range.
    #[error("link.{key} is {hz}; expected {RATE_MIN_HZ} to {RATE_MAX_HZ} Hz")]
    Rate {
        /// Key below `link`.
        key: &'static str,
        /// Rate that was asked for, Hz.
        hz: f64,
    },
    /// The number of beams is out of range.
    #[error("link.scan_beams is {0}; expected {BEAMS_MIN} to {BEAMS_MAX}")]
    Beams(usize),
}

impl MachineLinkConfigError {
    /// Returns the key below `link`.
    pub fn key(&self) -> &'static str {
        match self {
            Self::Rate { key, .. } => key,
            Self::Beams(_) => "scan_beams",
        }
    }
}

/// Section `[link]` of the configuration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MachineLinkConfig {
    /// Most scans a second of a robot that its machine sends while somebody at the base looks at them, 0.1 to 20 Hz. At 5 Hz
    /// with 180 beams they are 2.1 kB/s. While nobody looks none is sent.
    pub scan_rate_hz: f64,
    /// Most scans a second, each with the pose of its time, while navigation at the base drives the robot, 0.1 to 20 Hz.
    /// Navigation gives a robot that it has not seen for 0.5 s a zero.
    pub drive_rate_hz: f64,
    /// Most beams of such a scan, 8 to 2000. Of the robot's beams neighbours are joined, and the nearest range of each group is
    /// sent. 180: one each 2 degrees.
    pub scan_beams: usize,
}

impl Default for MachineLinkConfig {
    fn default() -> Self {
        Self { scan_rate_hz: 5.0, drive_rate_hz: 10.0, scan_beams: 180 }
    }
}

impl MachineLinkConfig {
    /// Checks ranges of all keys.
    pub fn validate(&self) -> Result<(), MachineLinkConfigError> {
        for (key, hz) in [("scan_rate_hz", self.scan_rate_hz), ("drive_rate_hz", self.drive_rate_hz)] {
            if !(RATE_MIN_HZ..=RATE_MAX_HZ).contains(&hz) {
                return Err(MachineLinkConfigError::Rate { key, hz });
            }
        }
        if !(BEAMS_MIN..=BEAMS_MAX).contains(&self.scan_beams) {
            return Err(MachineLinkConfigError::Beams(self.scan_beams));
        }
        Ok(())
    }
}
