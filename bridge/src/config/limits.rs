//! Limits of what clients may hold and do, so that nobody who reaches the port can exhaust the bridge.

use super::ConfigError;
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// Environment of a bridge process, for the allocator of glibc: freed memory of large frames goes back to the system.
///
/// Otherwise glibc raises its thresholds with each large block that is freed, and keeps up to 64 MB.
pub const ALLOCATOR_SETTINGS: [(&str, &str); 2] =
    [("MALLOC_MMAP_THRESHOLD_", "131072"), ("MALLOC_TRIM_THRESHOLD_", "131072")];

/// Limits of clients, all together and each.
// At most 12 fields: one field for each key of one table of the fleet file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ClientLimits {
    /// Bytes that the bridge holds for all clients together: frames that are being received, messages that wait,
    /// latched messages of clients, and free buffers; 8388608 to 4294967296. The fleet's own newest maps and states are not counted.
    pub held_bytes_max: usize,
    /// Longest payload on a topic or service that the client has not registered, bytes, 4096 to 1048576. Commands are shorter.
    pub unregistered_bytes_max: usize,
    /// A connection is closed if a frame over 64 kB gains less than 64 kB in so long a time, seconds,
    /// 2 to 86400.
    pub frame_timeout_s: f64,
    /// A client that sent nothing for so long gives its place and its services to others, seconds, 2 to 86400. Unity's connector
    /// sends a keepalive each second.
    pub silence_s: f64,
    /// A client that sent nothing for so long is disconnected, seconds, 2 to 86400.
    pub silence_max_s: f64,
    /// Connections of one address at a time, 1 to 1024. Loopback has no such limit while it is trusted.
    pub connections_per_address: usize,
    /// Topics of clients that one client may use, 1 to 65536: those that the fleet does not know.
    pub topics_per_client: usize,
    /// Services that one client may offer or call, 1 to 65536.
    pub services_per_client: usize,
}

impl Default for ClientLimits {
    fn default() -> Self {
        Self {
            held_bytes_max: 64 << 20,
            unregistered_bytes_max: 64 << 10,
            frame_timeout_s: 10.0,
            silence_s: 5.0,
            silence_max_s: 300.0,
            connections_per_address: 16,
            topics_per_client: 256,
            services_per_client: 64,
        }
    }
}

impl ClientLimits {
    /// Refuses values that cannot work; the error names the key.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let counts = [
            ("limits.held_bytes_max", self.held_bytes_max, 8 << 20, 4 << 30, "8388608 to 4294967296 bytes"),
            (
                "limits.unregistered_bytes_max",
                self.unregistered_bytes_max,
                4 << 10,
                1 << 20,
                "4096 to 1048576 bytes",
            ),
            (
                "limits.connections_per_address",
                self.connections_per_address,
                1,
                1024,
                "1 to 1024 connections",
            ),
            ("limits.topics_per_client", self.topics_per_client, 1, 65_536, "1 to 65536 topics"),
            ("limits.services_per_client", self.services_per_client, 1, 65_536, "1 to 65536 services"),
        ];
        if let Some((key, value, .., expected)) =
            counts.into_iter().find(|(_, value, low, high, _)| !(*low..=*high).contains(value))
        {
            return Err(ConfigError::new(key, value.to_string(), expected));
        }
        let times = [
            ("limits.frame_timeout_s", self.frame_timeout_s),
            ("limits.silence_s", self.silence_s),
            ("limits.silence_max_s", self.silence_max_s),
        ];
        // Unity's connector sends a keepalive each second, which may be late.
        match times.into_iter().find(|(_, value)| !(2.0..=86_400.0).contains(value)) {
            Some((key, value)) => Err(ConfigError::new(key, value.to_string(), "2 to 86400 seconds")),
            None => Ok(()),
        }
    }

    /// Returns [`Self::frame_timeout_s`] as a duration.
    pub fn frame_timeout(&self) -> Duration {
        Duration::from_secs_f64(self.frame_timeout_s)
    }

    /// Returns [`Self::silence_s`] as a duration.
    pub fn silence(&self) -> Duration {
        Duration::from_secs_f64(self.silence_s)
    }

    /// Returns [`Self::silence_max_s`] as a duration.
    pub fn silence_max(&self) -> Duration {
        Duration::from_secs_f64(self.silence_max_s)
    }
}
