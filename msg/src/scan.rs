//! Scans of a planar LiDAR.

use crate::{Header, Pose2, ROBOTS_MAX, RobotId};
use bytemuck::{Pod, Zeroable};

/// Fewest beams of a scan.
pub const BEAMS_MIN: usize = 2;
/// Largest number of beams in a scan.
pub const BEAMS_MAX: usize = 4096;

/// One scan of a planar LiDAR in frame `base_scan`, as sensor_msgs/LaserScan defines it.
///
/// Beam `i` points along `angle_min_rad + i * angle_increment_rad`, counter-clockwise from the
/// sensor's x axis. It was measured at `header.stamp + i * time_increment_s`.
/// `base_scan` is upright: a scan of a LiDAR upside down is mirrored before it becomes this message.
/// Ranges follow REP-117: +inf is no return up to `range_max_m`, -inf is a surface nearer than `range_min_m`, NaN is no measurement.
///
/// ```
/// let mut scan: msg::Scan = bytemuck::Zeroable::zeroed();
/// (scan.angle_min_rad, scan.angle_increment_rad) = (-0.1, 0.1);
/// (scan.range_min_m, scan.range_max_m) = (0.12, 3.5);
/// scan.len = 3;
/// scan.ranges_m[..3].copy_from_slice(&[2.0, f32::INFINITY, 1.5]);
///
/// let hits: Vec<(f32, f32)> = scan.hits().collect();
/// assert_eq!(hits, [(-0.1, 2.0), (0.1, 1.5)]);
/// ```
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct Scan {
    /// Header whose `stamp` is the time of the first beam.
    pub header: Header,
    /// Direction of the first beam, radians.
    pub angle_min_rad: f32,
    /// Angle between two beams, radians; negative for a sensor that turns clockwise.
    pub angle_increment_rad: f32,
    /// Time between two beams, seconds; 0 if all are measured at once.
    pub time_increment_s: f32,
    /// Time between two scans, seconds.
    pub scan_time_s: f32,
    /// Smallest valid range, metres.
    pub range_min_m: f32,
    /// Largest valid range, metres. A larger range means no return.
    pub range_max_m: f32,
    /// Number of `ranges_m` in use. Read them by [`Scan::ranges_m`].
    pub len: u32,
    /// 1 if `base_from_scan` is known. Read it by [`Scan::mount`].
    pub mount_known: u32,
    /// Pose of `base_scan` in `base_footprint`. Read it by [`Scan::mount`].
    pub base_from_scan: Pose2,
    /// Storage of the ranges, metres. Read it by [`Scan::ranges_m`].
    pub ranges_m: [f32; BEAMS_MAX],
}

/// What scans of robots on other machines are wanted for: it decides how many cross the link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum ScanPurpose {
    /// Somebody looks at them, or records them.
    Viewing = 0,
    /// A robot is driven by them.
    Navigation = 1,
}

/// Demand for scans of robots on other machines. It is repeated while it lasts: every second or more often.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct ScanDemand {
    /// Header whose `stamp` is not used.
    pub header: Header,
    /// Bit [`RobotId::index`](crate::RobotId::index) is set for each robot whose scans are wanted.
    pub robots: u64,
    /// Code of a [`ScanPurpose`].
    pub purpose: u32,
    /// Padding, always zero.
    pub reserved: u32,
}

impl ScanDemand {
    /// Returns whether a robot's scans are wanted.
    pub fn includes(&self, robot: RobotId) -> bool {
        self.robots & bit(robot) != 0
    }

    /// Returns the set of robots that [`Self::robots`] holds.
    pub fn set_of(robots: impl IntoIterator<Item = RobotId>) -> u64 {
        robots.into_iter().fold(0, |set, robot| set | bit(robot))
    }
}

/// A set of robots is one number.
const _: () = assert!(ROBOTS_MAX <= u64::BITS as usize);

fn bit(robot: RobotId) -> u64 {
    1 << robot.index()
}

impl Scan {
    /// Returns the ranges of all beams, metres.
    pub fn ranges_m(&self) -> &[f32] {
        &self.ranges_m[..(self.len as usize).min(BEAMS_MAX)]
    }

    /// Returns the pose of `base_scan` in `base_footprint`, if the scan's source says it; otherwise the configured one counts.
    pub fn mount(&self) -> Option<Pose2> {
        (self.mount_known == 1).then_some(self.base_from_scan)
    }

    /// Sets the pose of `base_scan` in `base_footprint`; `None` if the configured one counts.
    pub fn set_mount(&mut self, base_from_scan: Option<Pose2>) {
        (self.mount_known, self.base_from_scan) =
            base_from_scan.map_or((0, Pose2::IDENTITY), |base_from_scan| (1, base_from_scan));
    }

    /// Mirrors the scan: from how a LiDAR upside down measured it to how an upright one would have.
    pub fn mirror(&mut self) {
        self.angle_min_rad = -self.angle_min_rad;
        self.angle_increment_rad = -self.angle_increment_rad;
    }

    /// Returns the direction of beam `i` in `base_scan`, radians.
    pub fn angle_rad(&self, i: usize) -> f32 {
        self.angle_min_rad + i as f32 * self.angle_increment_rad
    }

    /// Iterates over the beams with a valid range: (direction in radians, range in metres).
    pub fn hits(&self) -> impl Iterator<Item = (f32, f32)> + '_ {
        let measured = self.range_min_m..self.range_max_m;
        let beams = self.ranges_m().iter().enumerate();
        beams
            .filter(move |(_, range)| measured.contains(*range))
            .map(|(i, range)| (self.angle_rad(i), *range))
    }
}
