//! Collision limit, the forward speed allowed by what stands ahead (as nav2_collision_monitor's approach model).

use crate::command::Twist;
use crate::config::{FollowerConfig, RobotBody};
use crate::observation::ScanView;

/// Least gap between two robots that pass each other, metres: the error of their poses.
const PASSING_GAP_MIN_M: f64 = 0.03;

/// Limits the forward speed of one robot.
#[derive(Clone, Copy, Debug, Default)]
pub struct CollisionLimit {
    body: RobotBody,
    config: FollowerConfig,
}

impl CollisionLimit {
    /// A limit for robots of this size.
    pub fn new(body: RobotBody, config: FollowerConfig) -> Self {
        Self { body, config }
    }

    /// Distance that the body can drive straight ahead by the scan, metres; infinite if nothing stands there.
    pub fn free_distance_m(&self, scan: &ScanView) -> f64 {
        self.nearest_ahead_m(scan).map_or(f64::INFINITY, |[x, _]| x - self.body.radius_m)
    }

    /// The scan's point that the body would touch first on its way straight ahead, in `base_footprint`, metres.
    pub fn nearest_ahead_m(&self, scan: &ScanView) -> Option<[f64; 2]> {
        let half_width_m = self.half_width_m();
        let ahead = scan.hits_in_base_m().filter(|[x, y]| *x > 0.0 && y.abs() < half_width_m);
        ahead.min_by(|a, b| a[0].total_cmp(&b[0]))
    }

    /// Distance that the body can drive straight back by the scan, metres; infinite if nothing that the scan shows stands there.
    fn free_distance_behind_m(&self, scan: &ScanView) -> f64 {
        let half_width_m = self.half_width_m();
        let behind = scan.hits_in_base_m().filter(|[x, y]| *x < 0.0 && y.abs() < half_width_m);
        behind.map(|[x, _]| -x - self.body.radius_m).fold(f64::INFINITY, f64::min)
    }

    /// Distance that the body can drive straight ahead before it touches a point in `base_footprint`, metres; infinite if it passes by.
    pub fn free_distance_to_point_m(&self, [x, y]: [f64; 2]) -> f64 {
        self.free_distance_to_disc_m([x, y], self.half_width_m())
    }

    /// Distance that the body can drive straight ahead before it touches a robot of the same size at a position in
    /// `base_footprint`, metres; infinite if it passes by.
    pub fn free_distance_to_robot_m(&self, [x, y]: [f64; 2]) -> f64 {
        self.free_distance_to_disc_m([x, y], self.body.radius_m + self.half_width_m())
    }

    /// Distance straight ahead until a position is `touch_m` from the middle of the body, metres; infinite if it stays farther away.
    fn free_distance_to_disc_m(&self, [x, y]: [f64; 2], touch_m: f64) -> f64 {
        if x > 0.0 && y.abs() < touch_m { x - (touch_m * touch_m - y * y).sqrt() } else { f64::INFINITY }
    }

    /// Lowers the forward speed so that the robot comes no nearer to a robot of the same size that stands close by, at
    /// a position in `base_footprint`.
    pub fn limit_speed_to_robot(&self, twist: Twist, other_in_base_m: [f64; 2]) -> Twist {
        let ahead = self.limit_speed(twist, self.free_distance_to_robot_m(other_in_base_m));
        let [x, y] = other_in_base_m;
        let distance_m = x.hypot(y);
        if x <= 0.0 || distance_m == 0.0 {
            return ahead;
        }
        // The part of the speed that closes the gap between the two.
        let gap = Twist { linear_m_s: ahead.linear_m_s * x / distance_m, ..ahead };
        // Robots that pass each other may be nearer than one that stands ahead.
        let spare_m = self.config.stop_distance_m - PASSING_GAP_MIN_M;
        let closing = self.limit_speed(gap, distance_m - 2.0 * self.body.radius_m + spare_m);
        Twist { linear_m_s: closing.linear_m_s * distance_m / x, ..ahead }
    }

    /// Lowers the forward speed so that the robot stops short of an obstacle at this free distance.
    pub fn limit_speed(&self, twist: Twist, free_distance_m: f64) -> Twist {
        let FollowerConfig { stop_distance_m, speed_per_distance_1_s, .. } = self.config;
        let limit_m_s = ((free_distance_m - stop_distance_m) * speed_per_distance_1_s).max(0.0);
        Twist { linear_m_s: twist.linear_m_s.min(limit_m_s), ..twist }
    }

    /// Lowers the backward speed so that the robot stops short of what the scan shows behind it.
    pub fn limit_speed_back(&self, twist: Twist, scan: &ScanView) -> Twist {
        let free_distance_m = self.free_distance_behind_m(scan);
        let forward = Twist { linear_m_s: -twist.linear_m_s, ..twist };
        Twist { linear_m_s: -self.limit_speed(forward, free_distance_m).linear_m_s, ..twist }
    }

    fn half_width_m(&self) -> f64 {
        self.body.radius_m + self.config.side_margin_m
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use msg::{Pose2, Stamp};
    use proptest::prelude::*;

    fn scan(ranges_m: &[f32]) -> ScanView<'_> {
        ScanView {
            received: Stamp(0),
            base_from_scan: Pose2::IDENTITY,
            angle_min_rad: -0.8,
            angle_increment_rad: 1.6 / (ranges_m.len() - 1) as f64,
            range_min_m: 0.05,
            range_max_m: 3.5,
            ranges_m,
        }
    }

    fn limited(twist: Twist, ranges_m: &[f32]) -> Twist {
        let limit = CollisionLimit::default();
        limit.limit_speed(twist, limit.free_distance_m(&scan(ranges_m)))
    }

    proptest! {
        #[test]
        fn no_forward_speed_towards_a_near_obstacle(range in 0.05..0.17_f32, v in 0.0..0.15, w in -1.5..1.5) {
            let mut ranges = [f32::INFINITY; 181];
            ranges[90] = range;
            let twist = limited(Twist { linear_m_s: v, angular_rad_s: w }, &ranges);
            prop_assert_eq!(twist.linear_m_s, 0.0);
            prop_assert_eq!(twist.angular_rad_s, w);
        }
    }

    proptest! {
        #[test]
        fn no_backward_speed_towards_a_near_obstacle_behind(range in 0.05..0.17_f32, v in 0.0..0.1_f64) {
            // The scanner looks back.
            let mut ranges = [f32::INFINITY; 181];
            ranges[90] = range;
            let (limit, back) = (CollisionLimit::default(), Twist { linear_m_s: -v, angular_rad_s: 0.0 });
            let base_from_scan = Pose2::new(0.0, 0.0, core::f64::consts::PI);
            let scan = ScanView { base_from_scan, ..scan(&ranges) };
            prop_assert_eq!(limit.limit_speed_back(back, &scan).linear_m_s, 0.0);
            prop_assert_eq!(limit.free_distance_m(&scan), f64::INFINITY);
            let ahead = Twist { linear_m_s: v, angular_rad_s: 0.0 };
            prop_assert_eq!(limit.limit_speed_back(ahead, &scan), ahead);
        }
    }

    #[test]
    fn driving_back_and_driving_past_are_not_limited() {
        let mut ranges = [f32::INFINITY; 181];
        ranges[90] = 0.1;
        let back = Twist { linear_m_s: -0.1, angular_rad_s: 0.0 };
        assert_eq!(limited(back, &ranges), back);
        ranges[90] = f32::INFINITY;
        ranges[0] = 0.3;
        let forward = Twist { linear_m_s: 0.15, angular_rad_s: 0.0 };
        assert_eq!(limited(forward, &ranges), forward);
    }
}
