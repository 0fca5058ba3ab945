//! What the robots' LiDARs see, as the coordinator expects it of unknown space.

use super::config::CoordinationConfig;
use crate::observation::{ALL_AROUND_RAD, ScanView};
use core::f64::consts::TAU;

/// Distance by which unknown space is expected to be seen less far than the LiDAR's range, metres: returns at its end
/// are sparse.
const RANGE_MARGIN_M: f64 = 0.2;
/// Shortest and longest range that is expected, metres. What lies farther behind a frontier is rarely in view, and
/// longer rays take time.
const RANGE_M: [f64; 2] = [1.0, 6.0];
/// Smallest angle that is expected, radians: a narrower sensor would never end a look around.
const ANGLE_MIN_RAD: f64 = 0.35;

impl CoordinationConfig {
    /// Sets range and angle to what the weakest of some LiDARs sees. Scans without a beam or a finite range are left
    /// out; without any other, nothing changes.
    pub(super) fn set_sensors<'a>(&mut self, scans: impl Iterator<Item = ScanView<'a>>) {
        let views = scans.filter_map(|scan| {
            let angle_rad = scan.angle_increment_rad.abs() * scan.ranges_m.len() as f64;
            let is_usable = scan.range_max_m.is_finite() && angle_rad.is_finite() && angle_rad > 0.0;
            is_usable.then_some((scan.range_max_m - RANGE_MARGIN_M, angle_rad))
        });
        if let Some((range_m, angle_rad)) = views.reduce(|a, b| (a.0.min(b.0), a.1.min(b.1))) {
            self.view_range_m = range_m.clamp(RANGE_M[0], RANGE_M[1]);
            self.view_angle_rad = angle_rad.clamp(ANGLE_MIN_RAD, TAU);
        }
    }

    /// Whether the sensor sees all around, so that robots need not turn to look.
    pub(super) fn sees_all_around(&self) -> bool {
        self.view_angle_rad >= ALL_AROUND_RAD
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::observation::BURGER_BASE_FROM_SCAN;
    use msg::Stamp;

    fn scan(range_max_m: f64, angle_increment_rad: f64, ranges_m: &[f32]) -> ScanView<'_> {
        ScanView {
            received: Stamp(0),
            base_from_scan: BURGER_BASE_FROM_SCAN,
            angle_min_rad: 0.0,
            angle_increment_rad,
            range_min_m: 0.12,
            range_max_m,
            ranges_m,
        }
    }

    #[test]
    fn the_weakest_lidar_counts_and_the_range_is_capped() {
        let mut config = CoordinationConfig::default();
        let ranges = [1.0_f32; 360];
        config.set_sensors([scan(30.0, TAU / 360.0, &ranges)].into_iter());
        assert_eq!((config.view_range_m, config.sees_all_around()), (RANGE_M[1], true));
        let scans = [scan(30.0, TAU / 360.0, &ranges), scan(3.5, 0.5_f64.to_radians(), &ranges[..180])];
        config.set_sensors(scans.into_iter());
        assert!((config.view_range_m - 3.3).abs() < 1e-9);
        assert!((config.view_angle_rad.to_degrees() - 90.0).abs() < 1e-9 && !config.sees_all_around());
    }

    #[test]
    fn scans_that_say_nothing_change_nothing() {
        let mut config = CoordinationConfig::default();
        config.set_sensors([scan(f64::INFINITY, 0.01, &[1.0]), scan(3.5, f64::NAN, &[1.0])].into_iter());
        config.set_sensors([scan(8.0, 0.01, &[])].into_iter());
        assert_eq!(config, CoordinationConfig::default());
    }
}
