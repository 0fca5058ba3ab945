//! One turn of a planar LiDAR.

use crate::Header;
use bytemuck::{Pod, Zeroable};

/// The most beams a scan can hold.
pub const BEAMS_MAX: usize = 4096;

/// One turn of a planar LiDAR, in frame `base_scan`: as sensor_msgs/LaserScan means it.
///
/// Beam `i` looks along `angle_min_rad + i * angle_increment_rad`, counter-clockwise from the
/// sensor's x axis, and was measured at `header.stamp + i * time_increment_s`.
/// Ranges follow REP-117: +inf is no return up to `range_max_m`, NaN is no measurement.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct Scan {
    /// `stamp` is the first beam's.
    pub header: Header,
    /// Radians.
    pub angle_min_rad: f32,
    /// Radians; negative for a sensor that turns clockwise.
    pub angle_increment_rad: f32,
    /// Seconds between two beams; 0 if all are measured at once.
    pub time_increment_s: f32,
    /// Seconds between two scans.
    pub scan_time_s: f32,
    /// Metres; smaller ranges mean nothing.
    pub range_min_m: f32,
    /// Metres; larger ranges mean no return.
    pub range_max_m: f32,
    /// How many of `ranges_m` are beams. Read it by [`Scan::ranges_m`].
    pub len: u32,
    /// Zero.
    pub reserved: u32,
    /// Metres. Read it by [`Scan::ranges_m`].
    pub ranges_m: [f32; BEAMS_MAX],
}

impl Scan {
    /// The beams' ranges in metres.
    pub fn ranges_m(&self) -> &[f32] {
        &self.ranges_m[..(self.len as usize).min(BEAMS_MAX)]
    }

    /// Beam `i`'s direction in `base_scan`, radians.
    pub fn angle_rad(&self, i: usize) -> f32 {
        self.angle_min_rad + i as f32 * self.angle_increment_rad
    }

    /// The beams that hit something: (direction in radians, range in metres).
    pub fn hits(&self) -> impl Iterator<Item = (f32, f32)> + '_ {
        let measured = self.range_min_m..self.range_max_m;
        let beams = self.ranges_m().iter().enumerate();
        beams
            .filter(move |(_, range)| measured.contains(*range))
            .map(|(i, range)| (self.angle_rad(i), *range))
    }
}
