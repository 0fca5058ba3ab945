//! What tests of several modules need.

use msg::Scan;

/// Returns a scan of these ranges, metres, from 0.5 rad on.
pub fn scan(ranges_m: &[f32]) -> Scan {
    let mut scan: Scan = bytemuck::Zeroable::zeroed();
    (scan.angle_min_rad, scan.angle_increment_rad) = (0.5, 0.1);
    (scan.range_min_m, scan.range_max_m) = (0.12, 3.5);
    scan.len = ranges_m.len() as u32;
    scan.ranges_m[..ranges_m.len()].copy_from_slice(ranges_m);
    scan
}
