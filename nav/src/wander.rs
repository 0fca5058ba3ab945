//! Wandering, which drives by the scan alone while the pose is unknown.

use crate::collision::CollisionLimit;
use crate::command::Twist;
use crate::config::FollowerConfig;
use crate::observation::ScanView;
use crate::random::RandomNumbers;

/// Free distance below which the robot turns away, metres: from there it would have to slow down.
const TURN_BELOW_M: f64 = 0.3;
/// Free distance above which it drives on, metres: more than above, or it would turn again at once.
const DRIVE_ABOVE_M: f64 = 0.8;

/// Angle to each side in which the LiDAR has to see for the robot to drive, radians: the body at 0.2 m.
const AHEAD_RAD: f64 = 0.5;

/// Drives straight on while there is space, else turns to one side until there is.
#[derive(Clone, Copy, Debug, Default)]
pub struct Wander {
    /// Side that the robot turns to while it turns: 1 is left, -1 is right.
    turn_side: Option<f64>,
}

impl Wander {
    /// Velocity for the newest scan.
    pub fn drive(
        &mut self,
        scan: &ScanView,
        limit: &CollisionLimit,
        config: &FollowerConfig,
        random: &mut RandomNumbers,
    ) -> Twist {
        // Nothing but the scan tells what is ahead.
        if !scan.sees_ahead(AHEAD_RAD) {
            return Twist { linear_m_s: 0.0, angular_rad_s: config.turn_rad_s };
        }
        let needed_m = if self.turn_side.is_some() { DRIVE_ABOVE_M } else { TURN_BELOW_M };
        if limit.free_distance_m(scan) > needed_m {
            self.turn_side = None;
            return Twist { linear_m_s: config.cruise_m_s, angular_rad_s: 0.0 };
        }
        let side = *self.turn_side.get_or_insert_with(|| freer_side(scan, random));
        Twist { linear_m_s: 0.0, angular_rad_s: side * config.turn_rad_s }
    }
}

/// Side whose nearest obstacle is farther away; a random one if both are equal.
fn freer_side(scan: &ScanView, random: &mut RandomNumbers) -> f64 {
    let nearest_m = |is_left: bool| {
        let hits = scan.hits_in_base_m().filter(|[_, y]| (*y > 0.0) == is_left);
        hits.map(|[x, y]| x.hypot(y)).fold(f64::INFINITY, f64::min)
    };
    let (left_m, right_m) = (nearest_m(true), nearest_m(false));
    let is_left = if left_m == right_m { random.index_below(2) == 0 } else { left_m > right_m };
    if is_left { 1.0 } else { -1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use msg::{Pose2, Stamp};

    #[test]
    fn a_blocked_robot_turns_to_the_freer_side() {
        let mut ranges = [0.25_f32; 181];
        ranges[100..].fill(f32::INFINITY);
        let scan = ScanView {
            received: Stamp(0),
            base_from_scan: Pose2::IDENTITY,
            angle_min_rad: -0.8,
            angle_increment_rad: 1.6 / 180.0,
            range_min_m: 0.05,
            range_max_m: 3.5,
            ranges_m: &ranges,
        };
        let (limit, config) = (CollisionLimit::default(), FollowerConfig::default());
        let twist = Wander::default().drive(&scan, &limit, &config, &mut RandomNumbers::new(1));
        assert_eq!(twist, Twist { linear_m_s: 0.0, angular_rad_s: config.turn_rad_s });
    }
}
