//! Measured rate of a client's connection, and how much of maps and images may be written to it at a time.
//!
//! Frames of one connection cannot be interleaved: while a map of 150 kB is on its way at 60 kB/s, transforms wait for
//! 2.5 s. So a bulk frame is begun only if its sending takes [`BULK_DELAY_MAX`] at most. A map that is longer is sent
//! with larger cells; other bulk frames are held back. Before anything is measured, a connection is taken for one of
//! 60 kB/s. A connection without live topics is never held back.

use msg::Monotonic;
use std::time::Duration;

/// The longest time for which a bulk frame may delay transforms.
const BULK_DELAY_MAX: Duration = Duration::from_millis(200);
/// Bytes of bulk frames that a connection of unknown rate gets at a time. It is more than the kernel holds then, so that
/// the rate is known afterwards; at 60 kB/s it is through after 0.4 s.
const FIRST_BULK_BYTES: usize = 24 << 10;
/// Bulk frames leave so many times the time of their sending to others.
const BULK_PAUSES: f64 = 3.0;
/// Times that are computed from a rate end here, seconds: the rate may be next to nothing.
const RATE_TIME_MAX_S: f64 = 60.0;
/// A bulk frame that cannot be made smaller is tried although the connection was slow when measured so long ago ...
const BULK_RETRY: Duration = Duration::from_secs(60);
/// ... or sooner, if it was measured slow once or twice: a client's pause looks the same.
const BULK_RETRY_FIRST: Duration = Duration::from_secs(5);
/// Rates differ by less than this while the connection stays as slow as it is.
const AGREEING_RATIO: f64 = 3.0;
/// [`BULK_RETRY_FIRST`] is doubled so many times at most; [`BULK_RETRY`] ends it before.
const DOUBLINGS_MAX: u32 = 8;
/// A burst that was taken at once shows that a connection carries this many times as much in [`BULK_DELAY_MAX`].
const BURST_GAIN: f64 = 4.0;
/// Bytes taken while frames waited that show a higher rate, however short the time: more than a burst of
/// acknowledgements sets free on a slow connection.
const MEASURED_BYTES_MIN: usize = 8 << 10;
/// The same for the first rate: so much of the first map waits when the kernel's buffer is full.
const MEASURED_BYTES_FIRST: usize = 3 << 10;
/// The rate is otherwise measured over at least so long a time.
const MEASURED_TIME_MIN: Duration = Duration::from_millis(250);
/// The share of a rate that is used after a shorter time: the kernel's buffer empties in steps of a third.
const SHORT_MEASUREMENT_SHARE: f64 = 0.5;
/// Shortest time that a rate is computed from: the clock of a scheduler is no finer.
const TIME_MIN_S: f64 = 1e-3;
/// Live messages older than this are replaced by newer ones, not sent. With the bytes that the kernel holds, a
/// transform at 60 kB/s is younger than 0.5 s.
pub const LIVE_AGE_MAX: Duration = Duration::from_millis(200);
/// Send buffer of a connection, as a time at its rate. Linux doubles the number of bytes, for its own use of memory.
const SEND_BUFFER_TIME: Duration = Duration::from_millis(60);
/// Bounds of a connection's send buffer, bytes. Linux makes none smaller than about 2 kB.
const SEND_BUFFER_MIN: usize = 3 << 10;
const SEND_BUFFER_MAX: usize = 4 << 20;
/// Send buffer of a connection of unknown rate, bytes: the least at which the messages of three robots never wait for an
/// acknowledgement over loopback, which may take 40 ms.
pub const SEND_BUFFER_FIRST: usize = 8 << 10;
/// A connection without live topics gets no long bulk frames for so long after a subscription: those to live topics may
/// follow. Unity's connector needs a few round trips for each of its topics.
const SETTLING_TIME: Duration = Duration::from_millis(300);

/// A connection below this rate is slow, bytes per second: three robots' transforms and scans are a tenth of it.
const SLOW_BYTES_PER_S: f64 = 1e6;
/// The delay of live messages is the longest of one to two such times.
const DELAY_PERIOD: Duration = Duration::from_secs(1);

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
            | "mr_slam_msgs/MapTiles"
            | "sensor_msgs/Image"
            | "sensor_msgs/CompressedImage"
            | "sensor_msgs/PointCloud2" => Self::Bulk,
            _ => Self::Ordinary,
        }
    }
}

/// How much of bulk frames may be begun now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BulkBudget {
    /// Bytes of bulk frames, together.
    pub bytes: usize,
    /// Whether one frame that cannot be made smaller may be longer.
    pub one_of_any_length: bool,
    /// Whether maps that are longer are sent with larger cells.
    pub reduces_maps: bool,
}

impl BulkBudget {
    /// Messages are sent without a limit.
    pub const UNLIMITED: Self = Self { bytes: usize::MAX, one_of_any_length: true, reduces_maps: false };
    /// No bulk frame.
    pub const NONE: Self = Self { bytes: 0, one_of_any_length: false, reduces_maps: false };
}

/// The rate at which a connection takes bytes, measured while frames wait for it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ConnectionRate {
    /// Bytes per second and when they were measured; `None` while nothing waited for long.
    measured: Option<(f64, Monotonic)>,
    /// Measurements in a row of about the same rate.
    agreeing: u32,
    /// Since when frames have waited, and the bytes that were taken since.
    waiting: Option<(Monotonic, usize)>,
    /// When the next bulk frame may be begun.
    bulk_due: Monotonic,
    /// Bytes that the kernel takes because its buffer was made larger: they show no rate.
    grown: usize,
}

impl ConnectionRate {
    /// Records a write: the connection took `bytes`, and `is_blocked` says whether frames wait still.
    ///
    /// More bytes than the kernel can hold, taken at once, show that the connection passes them on.
    pub fn record(&mut self, bytes: usize, is_blocked: bool, now: Monotonic) {
        let passed_on = bytes.saturating_sub(self.grown);
        self.grown -= bytes - passed_on;
        match self.waiting {
            Some((since, taken)) => {
                let taken = taken + passed_on;
                let elapsed_s = now.since(since) as f64 * 1e-9;
                let is_long = elapsed_s >= MEASURED_TIME_MIN.as_secs_f64();
                let trusted = if is_long { 1.0 } else { SHORT_MEASUREMENT_SHARE };
                let rate = trusted * taken as f64 / elapsed_s.max(TIME_MIN_S);
                let is_higher = self.bytes_per_s().is_none_or(|before| rate > before);
                let enough = if self.measured.is_none() { MEASURED_BYTES_FIRST } else { MEASURED_BYTES_MIN };
                if is_long || (is_higher && taken >= enough) {
                    self.waiting = Some((now, 0));
                    self.set_rate(rate, now);
                } else {
                    self.waiting = Some((since, taken));
                }
            }
            // Linux holds up to twice the send buffer.
            None if !is_blocked && bytes > 2 * self.send_buffer_bytes() => {
                let rate = BURST_GAIN * bytes as f64 / BULK_DELAY_MAX.as_secs_f64();
                if self.bytes_per_s().is_none_or(|before| rate > before) {
                    self.set_rate(rate, now);
                }
            }
            None => {}
        }
        match is_blocked {
            true if self.waiting.is_none() => self.waiting = Some((now, 0)),
            true => {}
            false => self.waiting = None,
        }
    }

    fn set_rate(&mut self, rate: f64, now: Monotonic) {
        let agrees = self.bytes_per_s().is_some_and(|before| rate < AGREEING_RATIO * before);
        self.agreeing = if agrees { self.agreeing.saturating_add(1) } else { 0 };
        let before = self.send_buffer_bytes();
        self.measured = Some((rate, now));
        self.grown += 2 * self.send_buffer_bytes().saturating_sub(before);
    }

    /// Records that so many bytes of bulk frames were begun.
    pub fn record_bulk(&mut self, bytes: usize, now: Monotonic) {
        if let Some(rate) = self.bytes_per_s() {
            self.bulk_due =
                now + Duration::from_secs_f64((BULK_PAUSES * bytes as f64 / rate).min(RATE_TIME_MAX_S));
        }
    }

    /// Returns the bytes per second that were measured last.
    pub fn bytes_per_s(&self) -> Option<f64> {
        self.measured.map(|(rate, _)| rate)
    }

    /// Returns how much of bulk frames may be begun on a connection with live topics.
    pub fn bulk_budget(&self, now: Monotonic) -> BulkBudget {
        let Some((rate, at)) = self.measured else {
            let bytes = if self.waiting.is_some() { 0 } else { FIRST_BULK_BYTES };
            return BulkBudget { bytes, one_of_any_length: bytes > 0, reduces_maps: bytes > 0 };
        };
        if now < self.bulk_due {
            return BulkBudget::NONE;
        }
        let valid = BULK_RETRY_FIRST.saturating_mul(1 << self.agreeing.min(DOUBLINGS_MAX)).min(BULK_RETRY);
        let is_old = now.since(at) >= valid.as_nanos() as u64;
        let bytes = (rate * BULK_DELAY_MAX.as_secs_f64()) as usize;
        // An old low rate may have been a pause of the client's.
        let bytes = if is_old { bytes.max(FIRST_BULK_BYTES) } else { bytes };
        BulkBudget { bytes, one_of_any_length: is_old, reduces_maps: true }
    }

    /// Returns the send buffer that holds what the connection carries in a short time, bytes.
    pub fn send_buffer_bytes(&self) -> usize {
        match self.measured {
            Some((rate, _)) => {
                let bytes = (rate * SEND_BUFFER_TIME.as_secs_f64()) as usize;
                bytes.clamp(SEND_BUFFER_MIN, SEND_BUFFER_MAX)
            }
            None => SEND_BUFFER_FIRST,
        }
    }

    /// Returns how long a byte waits in the kernel before it leaves, at most; zero while the connection keeps up.
    pub fn kernel_delay(&self) -> Duration {
        match (self.waiting, self.measured) {
            (Some(_), Some((rate, _))) if rate > 0.0 => {
                Duration::from_secs_f64((2.0 * self.send_buffer_bytes() as f64 / rate).min(RATE_TIME_MAX_S))
            }
            _ => Duration::ZERO,
        }
    }

    /// Returns whether frames wait for the connection.
    pub fn is_waiting(&self) -> bool {
        self.waiting.is_some()
    }

    /// Returns whether urgent frames go before others although nothing waits yet.
    pub fn is_slow(&self) -> bool {
        self.bytes_per_s().is_some_and(|rate| rate < SLOW_BYTES_PER_S)
    }

    /// Returns how much of bulk frames may be begun on a connection without live topics.
    pub fn budget_without_live_topics(subscribed_at: Monotonic, now: Monotonic) -> BulkBudget {
        let is_settling = now.since(subscribed_at) < SETTLING_TIME.as_nanos() as u64;
        if is_settling {
            BulkBudget { bytes: FIRST_BULK_BYTES, ..BulkBudget::NONE }
        } else {
            BulkBudget::UNLIMITED
        }
    }
}

/// The longest delay of live messages lately: their wait in the bridge and in the kernel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LiveDelay {
    /// Since when `longest` counts.
    since: Monotonic,
    longest: Duration,
    previous_longest: Duration,
}

impl LiveDelay {
    /// Records the delay of a write.
    pub fn record(&mut self, delay: Duration, now: Monotonic) {
        let period = DELAY_PERIOD.as_nanos() as u64;
        let elapsed = now.since(self.since);
        if elapsed >= period {
            self.previous_longest = if elapsed < 2 * period { self.longest } else { Duration::ZERO };
            (self.since, self.longest) = (now, Duration::ZERO);
        }
        self.longest = self.longest.max(delay);
    }

    /// Returns the longest delay of the last second or two.
    pub fn longest(&self) -> Duration {
        self.longest.max(self.previous_longest)
    }
}
