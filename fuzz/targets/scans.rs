//! Scans and odometry of any content through SLAM: poses stay numbers, the map stays a map.
#![no_main]

use libfuzzer_sys::fuzz_target;
use msg::{BEAMS_MAX, Odometry, Pose2, Scan, Stamp};
use slam::{Slam, SlamConfig};

/// Scans of one input.
const SCANS_MAX: usize = 24;

/// The input, read number by number.
struct Bytes<'a>(&'a [u8]);

impl Bytes<'_> {
    fn take<const N: usize>(&mut self) -> [u8; N] {
        let mut out = [0; N];
        let n = N.min(self.0.len());
        out[..n].copy_from_slice(&self.0[..n]);
        self.0 = &self.0[n..];
        out
    }

    fn small(&mut self) -> f64 {
        f64::from(i16::from_le_bytes(self.take())) / 1000.0
    }

    /// Mostly something a sensor would say, sometimes anything at all.
    fn any(&mut self) -> f64 {
        if self.take::<1>()[0] < 240 { self.small() } else { f64::from_le_bytes(self.take()) }
    }
}

fuzz_target!(|bytes: &[u8]| {
    let mut bytes = Bytes(bytes);
    let mut config = SlamConfig::default();
    config.tracking.local_map_reach_m = 5.0;
    let mut slam = Slam::new(config);
    let mut scan: Box<Scan> = bytemuck::allocation::zeroed_box();
    let mut stamp_s = 0.0;
    for _ in 0..SCANS_MAX {
        if bytes.0.is_empty() {
            break;
        }
        stamp_s += bytes.small();
        let odom_from_base = Pose2::new(bytes.any(), bytes.any(), bytes.any());
        let mut odometry = Odometry { odom_from_base, ..Default::default() };
        odometry.header.stamp = Stamp::from_seconds(stamp_s);
        slam.add_odometry(&odometry);
        scan.header.stamp = odometry.header.stamp;
        scan.angle_min_rad = bytes.any() as f32;
        scan.angle_increment_rad = bytes.any() as f32 / 30.0;
        (scan.range_min_m, scan.range_max_m) = (bytes.any() as f32 / 100.0, 1.0 + bytes.any() as f32);
        scan.time_increment_s = bytes.any() as f32 / 1000.0;
        scan.len = u32::from(u16::from_le_bytes(bytes.take()) & 255);
        let mut range = bytes.any() as f32;
        for i in 0..(scan.len as usize).min(BEAMS_MAX) {
            // Walls are smooth: each byte moves the range a little, some make it anything.
            match bytes.take::<1>()[0] {
                255 => range = f32::from_le_bytes(bytes.take()),
                254 => range = bytes.small() as f32,
                step => range += (f32::from(step) - 127.0) / 1000.0,
            }
            scan.ranges_m[i] = range;
        }
        let step = slam.process(&scan);
        assert!(step.pose_estimate.map_from_base.is_finite(), "{:?}", step.pose_estimate);
        slam.work();
    }
    slam.finish();
    let grid = slam.map();
    assert_eq!(grid.cells.len(), grid.header.width as usize * grid.header.height as usize);
    assert!(slam.trajectory().all(|(_, pose)| pose.is_finite()));
});
