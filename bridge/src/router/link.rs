//! Measured rate of a client's connection, and what is held back because the connection is slow.
//!
//! Frames of one connection cannot be interleaved: while a map of 150 kB is on its way at 60 kB/s, transforms wait for
//! 2.5 s. So a map that would delay them for too long waits. It is tried again when nothing has waited for the connection
//! for [`BULK_RETRY`], so that a slow connection with room for a map is not without one for ever. A client that wants maps earlier subscribes to them on a second
//! connection: a connection without live topics is never held back.

use msg::Monotonic;
use std::time::Duration;

/// The longest time for which a map may delay transforms.
const BULK_DELAY_MAX: Duration = Duration::from_millis(250);
/// A held map is tried although the connection was slow when it was last measured so long ago ...
const BULK_RETRY: Duration = Duration::from_secs(60);
/// ... or sooner, if it was measured slow once or twice: a client's pause looks the same.
const BULK_RETRY_FIRST: Duration = Duration::from_secs(5);
/// Rates differ by less than this while the connection stays as slow as it is.
const AGREEING_RATIO: f64 = 3.0;
/// So many bytes in a shorter time than [`MEASURED_TIME_MIN`] show that a connection is fast.
const FAST_BYTES: usize = 64 << 10;
/// Live messages older than this are replaced by newer ones, not sent. With the bytes that the kernel holds, a
/// transform at 60 kB/s is younger than 0.5 s.
pub const LIVE_AGE_MAX: Duration = Duration::from_millis(200);
/// The rate is measured over at least so long a time.
const MEASURED_TIME_MIN: Duration = Duration::from_millis(250);

/// The order in which waiting frames are written to a connection that is slow.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Urgency {
    /// Replies, notices, transforms, the clock, velocities, the emergency stop.
    Live,
    /// Scans, odometry, and what the bridge does not know.
    Ordinary,
    /// Maps, images and point clouds.
    Bulk,
}

impl Urgency {
    /// Returns the urgency of a ROS message type, as `package/Type`.
    pub fn of(message_type: &str) -> Self {
        match message_type {
            "tf2_msgs/TFMessage"
            | "rosgraph_msgs/Clock"
            | "geometry_msgs/Twist"
            | "geometry_msgs/TwistStamped"
            | "std_msgs/Bool"
            | "std_msgs/Int32"
            | "std_msgs/Empty" => Self::Live,
            "nav_msgs/OccupancyGrid"
            | "map_msgs/OccupancyGridUpdate"
            | "sensor_msgs/Image"
            | "sensor_msgs/CompressedImage"
            | "sensor_msgs/PointCloud2" => Self::Bulk,
            _ => Self::Ordinary,
        }
    }
}

/// The rate at which a connection takes bytes, measured while frames wait for it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LinkRate {
    /// Bytes per second and when they were measured; `None` while nothing waited for long.
    measured: Option<(f64, Monotonic)>,
    /// Measurements in a row of about the same rate.
    agreeing: u32,
    /// Since when frames have waited, and the bytes that were taken since.
    waiting: Option<(Monotonic, usize)>,
}

impl LinkRate {
    /// Records a write: the connection took `bytes`, and `is_blocked` says whether frames wait still.
    pub fn record(&mut self, bytes: usize, is_blocked: bool, now: Monotonic) {
        if let Some((since, taken)) = &mut self.waiting {
            *taken += bytes;
            let elapsed_s = now.since(*since) as f64 * 1e-9;
            let rate = *taken as f64 / elapsed_s.max(1e-6);
            let is_long = elapsed_s >= MEASURED_TIME_MIN.as_secs_f64();
            let is_fast = *taken >= FAST_BYTES && self.measured.is_some_and(|(before, _)| rate > before);
            if is_long || is_fast {
                (*since, *taken) = (now, 0);
                let agrees = self.measured.is_some_and(|(before, _)| rate < AGREEING_RATIO * before);
                self.agreeing = if agrees { self.agreeing.saturating_add(1) } else { 0 };
                self.measured = Some((rate, now));
            }
        }
        match is_blocked {
            true if self.waiting.is_none() => self.waiting = Some((now, 0)),
            true => {}
            false => self.waiting = None,
        }
    }

    /// Returns the bytes per second that were measured last.
    pub fn bytes_per_s(&self) -> Option<f64> {
        self.measured.map(|(rate, _)| rate)
    }

    /// Returns the longest map that delays transforms for less than [`BULK_DELAY_MAX`], bytes.
    pub fn bulk_bytes_max(&self, now: Monotonic) -> usize {
        let valid = BULK_RETRY_FIRST.saturating_mul(1 << self.agreeing.min(8)).min(BULK_RETRY);
        match self.measured {
            Some((rate, at)) if now.since(at) < valid.as_nanos() as u64 => {
                (rate * BULK_DELAY_MAX.as_secs_f64()) as usize
            }
            _ => usize::MAX,
        }
    }
}
