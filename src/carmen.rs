//! CARMEN logs: the text format of the public 2D LiDAR data sets. One message a line:
//!
//! ```text
//! ODOM x y theta tv rv accel time host logger_time
//! FLASER n r1..rn x y theta odom_x odom_y odom_theta time host logger_time
//! ROBOTLASER1 type start fov resolution max accuracy remission_mode n r1..rn m i1..im
//!             laser_x laser_y laser_theta robot_x robot_y robot_theta tv rv 4 more
//!             time host logger_time
//! ```
//!
//! Lines of other kinds are skipped and counted; a malformed line is an error that names the line,
//! the field and what was expected, and does not disturb the lines after it.

use core::f64::consts::{FRAC_PI_2, PI};
use msg::{BEAMS_MAX, Pose2, Scan, Stamp};

/// The longest line that is read, bytes: 4096 beams with remissions take about 60 000.
pub const LINE_MAX: usize = 1 << 18;
/// FLASER lines do not say how far the sensor sees: the SICK LMS of these logs says 81.9 m or more for no return.
const FLASER_RANGE_MAX_M: f64 = 80.0;
/// Ranges nearer than this are the sensor's own housing.
const RANGE_MIN_M: f32 = 0.02;
/// Coordinates and times beyond this are no measurement.
const NUMBER_MAX: f64 = 1e12;

/// What a line says.
#[derive(Clone, Debug, PartialEq)]
pub enum Record {
    /// An ODOM line.
    Odometry(OdometryLine),
    /// A FLASER or ROBOTLASER1 line.
    Laser(LaserLine),
}

/// The robot's odometry at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OdometryLine {
    /// Unix time.
    pub stamp: Stamp,
    /// Raw odometry.
    pub odom_from_base: Pose2,
    /// Forward, m/s.
    pub linear_m_s: f64,
    /// Counter-clockwise, rad/s.
    pub angular_rad_s: f64,
}

/// A scan and the odometry it was taken at.
#[derive(Clone, Debug, PartialEq)]
pub struct LaserLine {
    /// Unix time.
    pub stamp: Stamp,
    /// The robot's raw odometry.
    pub odom_from_base: Pose2,
    /// The sensor on the robot.
    pub base_from_scan: Pose2,
    /// First beam, radians.
    pub angle_min_rad: f64,
    /// From beam to beam, radians.
    pub angle_increment_rad: f64,
    /// Ranges from here on are no return, metres.
    pub range_max_m: f64,
    /// Metres.
    pub ranges_m: Vec<f32>,
}

impl LaserLine {
    /// Fills a message; `fov_rad` keeps only the central beams.
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

/// A line that is not what it says it is.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("line {line}: {kind} {field}: found {found}, expected {expected}")]
pub struct LineError {
    /// Counted from 1.
    pub line: usize,
    /// The line's first word.
    pub kind: &'static str,
    /// Which field.
    pub field: String,
    /// What stands there, shortened.
    pub found: String,
    /// What should.
    pub expected: &'static str,
}

/// Reads a log, line by line.
pub struct Reader<'a> {
    rest: &'a [u8],
    line: usize,
    skipped: u64,
}

impl<'a> Reader<'a> {
    /// Of a whole log's bytes.
    pub fn new(bytes: &'a [u8]) -> Self {
        Self { rest: bytes, line: 0, skipped: 0 }
    }

    /// How many lines were comments, empty or of other kinds.
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

    /// REP-117: a range that is no number is NaN, one that overflows is no return.
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

    /// The message's own time; the host and the logger's time that follow are not needed.
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
        // A half turn: 181 and 361 beams include both ends, 180 and 360 leave the last one out.
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

/// Decimal seconds to nanoseconds, exactly: a double cannot hold unix time to the nanosecond.
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
mod tests {
    use super::*;

    fn read(log: &str) -> (Vec<Record>, Vec<LineError>, u64) {
        let mut reader = Reader::new(log.as_bytes());
        let (mut records, mut errors) = (Vec::new(), Vec::new());
        for line in reader.by_ref() {
            match line {
                Ok(record) => records.push(record),
                Err(error) => errors.push(error),
            }
        }
        (records, errors, reader.skipped())
    }

    fn laser(log: &str) -> LaserLine {
        match read(log).0.pop() {
            Some(Record::Laser(line)) => line,
            other => panic!("{other:?}"),
        }
    }

    const ROBOTLASER: &str = "ROBOTLASER1 0 -0.5 1.0 0.25 81.9 0.01 0 5 1 2.5 3 81.91 0.5 0 \
        1.1 2.0 0.1 1.0 2.0 0.1 0 0 0 0 0 976052890.244111 robot 976052890.244111\n";

    #[test]
    fn reads_each_kind() {
        let line = laser(ROBOTLASER);
        assert_eq!(line.stamp, Stamp(976_052_890_244_111_000));
        assert_eq!(line.ranges_m, [1.0, 2.5, 3.0, 81.91, 0.5]);
        assert_eq!((line.angle_min_rad, line.angle_increment_rad), (-0.5, 0.25));
        assert!((line.base_from_scan.x_m - 0.1 * 0.1_f64.cos()).abs() < 1e-9);

        let line = laser("FLASER 3 1 2 3 9 9 9 0.5 -1 2 12.5 host 13.0");
        assert_eq!(line.odom_from_base, Pose2::new(0.5, -1.0, 2.0));
        assert_eq!(line.stamp, Stamp(12_500_000_000));
        assert!((line.angle_min_rad + 2.0 * line.angle_increment_rad - FRAC_PI_2).abs() < 1e-12);

        let (records, errors, skipped) =
            read("# a comment\n\nPARAM x y\nODOM 1 2 3 0.4 0.5 0 -2.884230 h 0\n");
        assert!(errors.is_empty());
        assert_eq!(skipped, 3);
        let stamp = Stamp(-2_884_230_000);
        let pose = Pose2::new(1.0, 2.0, 3.0);
        let line = OdometryLine { stamp, odom_from_base: pose, linear_m_s: 0.4, angular_rad_s: 0.5 };
        assert_eq!(records, [Record::Odometry(line)]);
    }

    #[test]
    fn crops_to_the_central_beams() {
        let mut scan: Box<Scan> = bytemuck::allocation::zeroed_box();
        laser(ROBOTLASER).write_to(&mut scan, 7, Some(0.5));
        assert_eq!(scan.ranges_m(), [2.5, 3.0, 81.91]);
        assert_eq!((scan.angle_min_rad, scan.header.seq), (-0.25, 7));
        assert_eq!(scan.hits().count(), 2);
    }

    #[test]
    fn a_malformed_line_is_named_and_the_next_one_read() {
        let cases = [
            ("ODOM 1 2", "pose", "the end of the line"),
            ("ODOM 1 2 x 0 0 0 1 h 1", "pose", "x"),
            ("ODOM 1 2 inf 0 0 0 1 h 1", "pose", "inf"),
            ("ODOM 1 2 3 0 0 0 noon h 1", "time", "noon"),
            ("FLASER 4097 1", "number of beams", "4097"),
            ("FLASER 0", "number of beams", "0"),
            ("FLASER -3", "number of beams", "-3"),
            ("FLASER 3 1 2", "range", "the end of the line"),
            ("FLASER 2 1 two 0 0 0 0 0 0 1 h 1", "range 2", "two"),
            ("ROBOTLASER1 0 -1.5 3 0.1 0 0 0 1 1 0 0 0 0 0 0 0 0 0 0 0 0 1 h 1", "maximum range", "0"),
        ];
        for (line, field, found) in cases {
            let (records, errors, _) = read(&format!("# first\n{line}\n{ROBOTLASER}"));
            assert_eq!(errors.len(), 1, "{line}");
            assert_eq!(
                (errors[0].line, errors[0].field.as_str(), errors[0].found.as_str()),
                (2, field, found)
            );
            assert_eq!(records.len(), 1, "{line}");
        }
    }

    #[test]
    fn ranges_that_are_no_numbers_stay_in_their_place() {
        let line = laser("FLASER 3 nan 1e99 2 0 0 0 0 0 0 1 h 1");
        assert!(line.ranges_m[0].is_nan());
        assert_eq!(line.ranges_m[1..], [f32::INFINITY, 2.0]);
    }

    proptest::proptest! {
        #[test]
        fn no_bytes_make_it_panic(bytes in proptest::collection::vec(proptest::num::u8::ANY, 0..400)) {
            Reader::new(&bytes).count();
        }

        #[test]
        fn no_cut_or_flip_makes_it_panic(cut in 0_usize..250, at in 0_usize..250, value in proptest::num::u8::ANY) {
            let mut bytes = ROBOTLASER.repeat(2).into_bytes();
            bytes[at] = value;
            bytes.truncate(cut.max(at));
            Reader::new(&bytes).count();
        }
    }
}
