//! Scans on their way to a base at which somebody looks: fewer beams than the robot's, and a lower rate.

use crate::error::WireError;
use crate::reader::Reader;
use crate::size::{HEAD_BYTES, MESSAGE_MAX};
use msg::{BEAMS_MAX, Scan, Stamp};
use std::time::Duration;

/// Number of bytes of a scan before its ranges.
const SCAN_HEAD: usize = 34;
/// Largest number of beams of a scan in one message.
pub const SCAN_BEAMS_MAX: usize = (MESSAGE_MAX - HEAD_BYTES - SCAN_HEAD) / 2;
/// Code of the largest range: ranges are fractions of it, 0.05 mm each for a range of 3.5 m.
const LARGEST: f32 = 65_000.0;
/// Code of no measurement.
const NO_MEASUREMENT: u16 = 65_535;
/// Code of no return.
const NO_RETURN: u16 = 65_534;
/// Code of an obstacle that is too close to be measured.
const TOO_CLOSE: u16 = 65_533;

/// Largest rate and number of beams of scans that somebody asks for, or that a robot sends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ScanRate {
    /// Shortest time between two scans, milliseconds, at least 1.
    pub period_ms: u16,
    /// Largest number of beams, 1 to [`SCAN_BEAMS_MAX`].
    pub beams: u16,
}

impl ScanRate {
    /// Returns the rate of at most `hz` scans a second with at most `beams` beams, within what can be sent.
    pub fn new(hz: f64, beams: usize) -> Self {
        let period_ms = (1000.0 / hz).clamp(1.0, f64::from(u16::MAX)) as u16;
        Self { period_ms, beams: beams.clamp(1, SCAN_BEAMS_MAX) as u16 }
    }

    /// Returns the rate that exceeds neither of two.
    pub fn at_most(self, other: Self) -> Self {
        Self { period_ms: self.period_ms.max(other.period_ms), beams: self.beams.min(other.beams) }
    }

    /// Reads what is asked for: `Some(None)` for nothing, `None` if a number is out of range.
    pub(crate) fn read(from: &mut Reader<'_>) -> Result<Option<Option<Self>>, WireError> {
        Ok(match (from.u16()?, from.u16()?) {
            (0, 0) => Some(None),
            (period_ms @ 1.., beams @ 1..) if usize::from(beams) <= SCAN_BEAMS_MAX => {
                Some(Some(Self { period_ms, beams }))
            }
            _ => None,
        })
    }

    /// Returns the shortest time between two scans.
    pub fn period(self) -> Duration {
        Duration::from_millis(self.period_ms.into())
    }
}

/// A scan with few beams. Ranges follow REP-117 as those of [`Scan`] do.
#[derive(Clone, Debug, PartialEq)]
pub struct DecimatedScan {
    /// Time of the first beam, on the robot's clock.
    pub stamp: Stamp,
    /// Direction of the first beam, radians.
    pub angle_min_rad: f32,
    /// Angle between two beams, radians.
    pub angle_increment_rad: f32,
    /// Time between two beams, seconds.
    pub time_increment_s: f32,
    /// Time between two scans of the sensor, seconds.
    pub scan_time_s: f32,
    /// Smallest valid range, metres.
    pub range_min_m: f32,
    /// Largest valid range, metres.
    pub range_max_m: f32,
    /// Ranges, metres: at most [`SCAN_BEAMS_MAX`].
    pub ranges_m: Vec<f32>,
}

impl DecimatedScan {
    /// Joins groups of neighbouring beams so that at most `beams_max` are left. Each has the nearest range of its group, so
    /// that no obstacle is lost, and points along the group's middle.
    pub fn new(scan: &Scan, beams_max: usize) -> Self {
        let ranges = scan.ranges_m();
        let stride = ranges.len().div_ceil(beams_max.clamp(1, SCAN_BEAMS_MAX)).max(1);
        // `f32::min` ignores what is not a number.
        let nearest = |group: &[f32]| group.iter().copied().fold(f32::NAN, f32::min);
        let scale = stride as f32;
        Self {
            stamp: scan.header.stamp,
            angle_min_rad: scan.angle_min_rad + 0.5 * (scale - 1.0) * scan.angle_increment_rad,
            angle_increment_rad: scan.angle_increment_rad * scale,
            time_increment_s: scan.time_increment_s * scale,
            scan_time_s: scan.scan_time_s,
            range_min_m: scan.range_min_m,
            range_max_m: scan.range_max_m,
            ranges_m: ranges.chunks(stride).map(nearest).collect(),
        }
    }

    /// Writes the scan into a message of a channel, all but its header.
    pub fn write_to(&self, scan: &mut Scan) {
        scan.angle_min_rad = self.angle_min_rad;
        scan.angle_increment_rad = self.angle_increment_rad;
        scan.time_increment_s = self.time_increment_s;
        scan.scan_time_s = self.scan_time_s;
        scan.range_min_m = self.range_min_m;
        scan.range_max_m = self.range_max_m;
        let len = self.ranges_m.len().min(BEAMS_MAX);
        scan.ranges_m[..len].copy_from_slice(&self.ranges_m[..len]);
        scan.len = len as u32;
        // The base gets the mount with the robot's transforms.
        scan.set_mount(None);
    }

    fn numbers(&self) -> [f32; 6] {
        [
            self.angle_min_rad,
            self.angle_increment_rad,
            self.time_increment_s,
            self.scan_time_s,
            self.range_min_m,
            self.range_max_m,
        ]
    }

    pub(crate) fn write(&self, to: &mut Vec<u8>) {
        to.extend(self.stamp.0.to_le_bytes());
        self.numbers().iter().for_each(|number| to.extend(number.to_le_bytes()));
        let ranges = &self.ranges_m[..self.ranges_m.len().min(SCAN_BEAMS_MAX)];
        to.extend((ranges.len() as u16).to_le_bytes());
        ranges.iter().for_each(|range| to.extend(code(*range, self.range_max_m).to_le_bytes()));
    }

    /// Reads a scan; `None` if a number is not finite, or a range or the count is out of range.
    pub(crate) fn read(from: &mut Reader<'_>) -> Result<Option<Self>, WireError> {
        let stamp = Stamp(from.i64()?);
        let mut numbers = [0.0; 6];
        for number in &mut numbers {
            *number = from.f32()?;
        }
        let count = usize::from(from.u16()?);
        let [angle_min_rad, angle_increment_rad, time_increment_s, scan_time_s, range_min_m, range_max_m] =
            numbers;
        let is_finite = numbers.iter().all(|number| number.is_finite());
        if !is_finite || count > SCAN_BEAMS_MAX || !(0.0..range_max_m).contains(&range_min_m) {
            return Ok(None);
        }
        let mut ranges_m = Vec::with_capacity(count);
        for _ in 0..count {
            let Some(range_m) = range(from.u16()?, range_max_m) else { return Ok(None) };
            ranges_m.push(range_m);
        }
        Ok(Some(Self {
            stamp,
            angle_min_rad,
            angle_increment_rad,
            time_increment_s,
            scan_time_s,
            range_min_m,
            range_max_m,
            ranges_m,
        }))
    }
}

fn code(range_m: f32, range_max_m: f32) -> u16 {
    match range_m {
        r if r.is_nan() => NO_MEASUREMENT,
        f32::NEG_INFINITY => TOO_CLOSE,
        r if r > range_max_m => NO_RETURN,
        r => (r / range_max_m * LARGEST).round().clamp(0.0, LARGEST) as u16,
    }
}

fn range(code: u16, range_max_m: f32) -> Option<f32> {
    match code {
        NO_MEASUREMENT => Some(f32::NAN),
        NO_RETURN => Some(f32::INFINITY),
        TOO_CLOSE => Some(f32::NEG_INFINITY),
        code if f32::from(code) <= LARGEST => Some(f32::from(code) / LARGEST * range_max_m),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::scan;

    #[test]
    fn a_group_of_beams_has_its_nearest_range_and_its_middle() {
        let ranges = [2.0, 1.0, f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 3.0, f32::NAN, f32::NAN, 2.5];
        let few = DecimatedScan::new(&scan(&ranges), 5);
        assert_eq!(few.ranges_m[..3], [1.0, f32::INFINITY, f32::NEG_INFINITY]);
        assert!(few.ranges_m[3].is_nan() && few.ranges_m[4] == 2.5 && few.ranges_m.len() == 5);
        assert!((few.angle_min_rad - 0.55).abs() < 1e-6 && (few.angle_increment_rad - 0.2).abs() < 1e-6);
        let all = DecimatedScan::new(&scan(&ranges), 9);
        assert_eq!((all.angle_min_rad, all.angle_increment_rad, all.ranges_m.len()), (0.5, 0.1, 9));
        assert!(DecimatedScan::new(&scan(&[]), 5).ranges_m.is_empty());
    }

    #[test]
    fn the_largest_scan_fits_into_a_message() {
        let few = DecimatedScan::new(&scan(&[1.0; BEAMS_MAX]), usize::MAX);
        let mut bytes = Vec::new();
        few.write(&mut bytes);
        assert!(few.ranges_m.len() <= SCAN_BEAMS_MAX && HEAD_BYTES + bytes.len() <= MESSAGE_MAX);
    }
}
