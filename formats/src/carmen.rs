//! CARMEN logs: the text format of the public 2D LiDAR data sets (Carnegie Mellon Robot Navigation Toolkit).
//!
//! One message a line:
//!
//! ```text
//! ODOM x y theta tv rv accel time host logger_time
//! FLASER n r1..rn x y theta odom_x odom_y odom_theta time host logger_time
//! ROBOTLASER1 type start fov resolution max accuracy remission_mode n r1..rn m i1..im
//!             laser_x laser_y laser_theta robot_x robot_y robot_theta tv rv 4 more
//!             time host logger_time
//! ```
//!
//! Lines of other kinds are skipped and counted. A malformed line is an error that names the line, the field
//! and what was expected; the lines after it are still read.

mod stray;

pub use stray::StrayFilter;

use core::f64::consts::{FRAC_PI_2, PI};
use msg::{BEAMS_MAX, Pose2, Scan, Stamp};

/// Longest line that is read, bytes. 4096 beams with remissions take about 60 000.
pub const LINE_MAX: usize = 1 << 18;
/// Maximum range of FLASER lines, which do not carry one. The SICK LMS of these logs reports 81.9 m or more for
/// no return.
const FLASER_RANGE_MAX_M: f64 = 80.0;
/// Minimum range, metres: nearer returns come from the sensor's own housing.
const RANGE_MIN_M: f32 = 0.02;
/// Largest coordinate (metres) or time (seconds) that can be a measurement.
const NUMBER_MAX: f64 = 1e12;

/// Message of one line.
#[derive(Clone, Debug, PartialEq)]
pub enum Record {
    /// An ODOM line.
    Odometry(OdometryLine),
    /// A FLASER or ROBOTLASER1 line.
    Laser(LaserLine),
}

/// Raw odometry of the robot at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OdometryLine {
    /// Time of the message, Unix time.
    pub stamp: Stamp,
    /// Pose of `base_footprint` in the odometry's frame.
    pub odom_from_base: Pose2,
    /// Forward velocity, m/s.
    pub linear_m_s: f64,
    /// Yaw rate, rad/s, counter-clockwise.
    pub angular_rad_s: f64,
}

/// Laser scan with the odometry at which it was taken.
#[derive(Clone, Debug, PartialEq)]
pub struct LaserLine {
    /// Time of the message, Unix time.
    pub stamp: Stamp,
    /// Pose of `base_footprint` in the odometry's frame when the scan was taken.
    pub odom_from_base: Pose2,
    /// Pose of `base_scan` in `base_footprint`.
    pub base_from_scan: Pose2,
    /// Angle of the first beam, radians.
    pub angle_min_rad: f64,
    /// Angle between neighbouring beams, radians.
    pub angle_increment_rad: f64,
    /// Range from which a reading means no return, metres.
    pub range_max_m: f64,
    /// Range of each beam, metres.
    pub ranges_m: Vec<f32>,
}

impl LaserLine {
    /// Fills a scan message with sequence number `seq`; `fov_rad` keeps the central beams only.
    pub fn write_to(&self, scan: &mut Scan, seq: u64, fov_rad: Option<f64>) {
        let half = fov_rad.map_or(f64::INFINITY, |fov| fov / 2.0 + 1e-6);
        let increment = self.angle_increment_rad;
        let middle = self.angle_min_rad + increment * (self.ranges_m.len() as f64 - 1.0) / 2.0;
        let angle = |i: usize| self.angle_min_rad + increment * i as f64;
        let kept = (0..self.ranges_m.len()).filter(|&i| (angle(i) - middle).abs() <= half);
        let mut len = 0;
        let mut first = None;
        for i in kept.take(BEAMS_MAX) {
            first.get_or_insert(i);
            scan.ranges_m[len] = self.ranges_m[i];
            len += 1;
        }
        scan.header = msg::Header { stamp: self.stamp, seq, ..Default::default() };
        scan.angle_min_rad = angle(first.unwrap_or(0)) as f32;
        scan.angle_increment_rad = increment as f32;
        (scan.time_increment_s, scan.scan_time_s) = (0.0, 0.0);
        (scan.range_min_m, scan.range_max_m) = (RANGE_MIN_M, self.range_max_m as f32);
        scan.len = len as u32;
    }
}

/// Malformed line: where, what was found and what was expected.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("line {line}: {kind} {field}: found {found}, expected {expected}")]
pub struct LineError {
    /// Line number, from 1.
    pub line: usize,
    /// First word of the line, such as `FLASER`.
    pub kind: &'static str,
    /// Field that is malformed, such as `range 2`.
    pub field: String,
    /// Text that was found, at most 24 characters.
    pub found: String,
    /// Text that was expected.
    pub expected: &'static str,
}

/// Iterator over the messages of a log.
pub struct Reader<'a> {
    rest: &'a [u8],
    line: usize,
    skipped: u64,
}

impl<'a> Reader<'a> {
    /// Starts at the first line of a log's bytes.
    pub fn new(bytes: &'a [u8]) -> Self {
        Self { rest: bytes, line: 0, skipped: 0 }
    }

    /// Number of lines so far that were comments, empty or of other kinds.
    pub fn skipped(&self) -> u64 {
        self.skipped
    }

    fn next_line(&mut self) -> Option<&'a [u8]> {
        if self.rest.is_empty() {
            return None;
        }
        let end = self.rest.iter().position(|b| *b == b'\n').unwrap_or(self.rest.len());
        let line = &self.rest[..end];
        self.rest = self.rest.get(end + 1..).unwrap_or(&[]);
        self.line += 1;
        Some(line)
    }
}

impl Iterator for Reader<'_> {
    type Item = Result<Record, LineError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            let line = self.next_line()?;
            let start = line.iter().position(|b| !b.is_ascii_whitespace()).unwrap_or(line.len());
            let word_end = line[start..].iter().position(u8::is_ascii_whitespace);
            let word = &line[start..word_end.map_or(line.len(), |e| start + e)];
            let kind = match word {
                b"ODOM" => "ODOM",
                b"FLASER" => "FLASER",
                b"ROBOTLASER1" => "ROBOTLASER1",
                _ => {
                    self.skipped += 1;
                    continue;
                }
            };
            return Some(parse(kind, line, self.line));
        }
    }
}

fn parse(kind: &'static str, bytes: &[u8], line: usize) -> Result<Record, LineError> {
    let error = |found: String, expected| LineError { line, kind, field: "line".into(), found, expected };
    if bytes.len() > LINE_MAX {
        return Err(error(format!("{} bytes", bytes.len()), "at most 262144 bytes"));
    }
    let text = core::str::from_utf8(bytes).map_err(|_| error("other bytes".into(), "text in UTF-8"))?;
    let mut words = text.split_ascii_whitespace();
    words.next();
    let mut fields = Fields { words, line, kind };
    match kind {
        "ODOM" => fields.odometry().map(Record::Odometry),
        "FLASER" => fields.flaser().map(Record::Laser),
        _ => fields.robotlaser().map(Record::Laser),
    }
}

/// Remaining words of one line.
struct Fields<'a> {
    words: core::str::SplitAsciiWhitespace<'a>,
    line: usize,
    kind: &'static str,
}

impl Fields<'_> {
    fn error(&self, field: &str, found: &str, expected: &'static str) -> LineError {
        let found = found.chars().take(24).collect();
        LineError { line: self.line, kind: self.kind, field: field.into(), found, expected }
    }

    fn word(&mut self, field: &str, expected: &'static str) -> Result<&str, LineError> {
        self.words.next().ok_or_else(|| self.error(field, "the end of the line", expected))
    }

    fn number(&mut self, field: &str) -> Result<f64, LineError> {
        const EXPECTED: &str = "a number";
        let word = self.words.next().ok_or_else(|| self.error(field, "the end of the line", EXPECTED))?;
        let number = word.parse::<f64>().ok().filter(|v| v.is_finite() && v.abs() < NUMBER_MAX);
        number.ok_or_else(|| self.error(field, word, EXPECTED))
    }

    fn pose(&mut self, field: &str) -> Result<Pose2, LineError> {
        Ok(Pose2::new(self.number(field)?, self.number(field)?, self.number(field)?))
    }

    fn count(&mut self, field: &str, least: usize) -> Result<usize, LineError> {
        let expected = if least == 0 { "a count up to 4096" } else { "a count from 1 to 4096" };
        let word = self.words.next().ok_or_else(|| self.error(field, "the end of the line", expected))?;
        let count = word.parse::<usize>().ok().filter(|n| (least..=BEAMS_MAX).contains(n));
        count.ok_or_else(|| self.error(field, word, expected))
    }

    /// Reads `count` ranges in metres. REP-117: not a number is NaN, an overflow is no return.
    fn ranges(&mut self, count: usize) -> Result<Vec<f32>, LineError> {
        let mut ranges = Vec::with_capacity(count);
        for i in 0..count {
            let word = self.word("range", "a range in metres, as many as the count says")?;
            let range = word.parse::<f32>();
            let word = word.to_owned();
            let field = || format!("range {}", i + 1);
            ranges.push(range.map_err(|_| self.error(&field(), &word, "a range in metres"))?);
        }
        Ok(ranges)
    }

    /// Reads the message's own time. The host and the logger's time that follow are not needed.
    fn stamp(&mut self) -> Result<Stamp, LineError> {
        const EXPECTED: &str = "a time in seconds";
        let word = self.words.next().ok_or_else(|| self.error("time", "the end of the line", EXPECTED))?;
        parse_stamp(word).ok_or_else(|| self.error("time", word, EXPECTED))
    }

    fn odometry(&mut self) -> Result<OdometryLine, LineError> {
        let odom_from_base = self.pose("pose")?;
        let linear_m_s = self.number("tv")?;
        let angular_rad_s = self.number("rv")?;
        self.number("accel")?;
        Ok(OdometryLine { stamp: self.stamp()?, odom_from_base, linear_m_s, angular_rad_s })
    }

    fn flaser(&mut self) -> Result<LaserLine, LineError> {
        let count = self.count("number of beams", 1)?;
        let ranges_m = self.ranges(count)?;
        // The laser's pose may be a corrected one; on these robots it is the robot's.
        self.pose("laser pose")?;
        let odom_from_base = self.pose("odometry pose")?;
        // The beams span a half turn: 181 and 361 of them include both ends, 180 and 360 leave the last one out.
        let steps = if count % 2 == 1 && count > 1 { count - 1 } else { count };
        Ok(LaserLine {
            stamp: self.stamp()?,
            odom_from_base,
            base_from_scan: Pose2::IDENTITY,
            angle_min_rad: -FRAC_PI_2,
            angle_increment_rad: PI / steps as f64,
            range_max_m: FLASER_RANGE_MAX_M,
            ranges_m,
        })
    }

    fn robotlaser(&mut self) -> Result<LaserLine, LineError> {
        self.number("laser type")?;
        let angle_min_rad = self.number("start angle")?;
        self.number("field of view")?;
        let angle_increment_rad = self.number("angular resolution")?;
        let range_max_m = self.number("maximum range")?;
        self.number("accuracy")?;
        self.number("remission mode")?;
        let count = self.count("number of beams", 1)?;
        let ranges_m = self.ranges(count)?;
        for _ in 0..self.count("number of remissions", 0)? {
            self.number("remission")?;
        }
        let odom_from_scan = self.pose("laser pose")?;
        let odom_from_base = self.pose("robot pose")?;
        for field in ["tv", "rv", "forward safety", "side safety", "turn axis"] {
            self.number(field)?;
        }
        if range_max_m <= f64::from(RANGE_MIN_M) {
            return Err(self.error("maximum range", &range_max_m.to_string(), "metres above 0.02"));
        }
        Ok(LaserLine {
            stamp: self.stamp()?,
            odom_from_base,
            base_from_scan: odom_from_base.between(odom_from_scan),
            angle_min_rad,
            angle_increment_rad,
            range_max_m,
            ranges_m,
        })
    }
}

/// Converts decimal seconds to nanoseconds exactly: a double cannot hold Unix time to the nanosecond.
fn parse_stamp(word: &str) -> Option<Stamp> {
    let (negative, digits) = word.strip_prefix('-').map_or((false, word), |rest| (true, rest));
    let (whole, fraction) = digits.split_once('.').unwrap_or((digits, ""));
    let decimal = |s: &str| s.bytes().all(|b| b.is_ascii_digit());
    if !decimal(whole) || !decimal(fraction) || whole.is_empty() {
        let seconds = word.parse::<f64>().ok().filter(|v| v.abs() < 9e9)?;
        return Some(Stamp::from_seconds(seconds));
    }
    let seconds: i64 = whole.parse().ok().filter(|s| *s < 9_000_000_000)?;
    let padded: String = fraction.chars().chain("000000000".chars()).take(9).collect();
    let nanoseconds = seconds * 1_000_000_000 + padded.parse::<i64>().ok()?;
    Some(Stamp(if negative { -nanoseconds } else { nanoseconds }))
}

#[cfg(test)]
mod tests;
