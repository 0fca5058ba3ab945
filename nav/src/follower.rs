//! Path follower, which computes a velocity from a path and a pose (pure pursuit, Coulter 1992).

use crate::command::Twist;
use crate::config::FollowerConfig;
use crate::geometry::{distance_m, heading_error_rad};
use crate::path::Path;
use msg::Pose2;

/// Lookahead per metre of clearance: with more space the robot may cut corners more.
const LOOKAHEAD_PER_CLEARANCE: f64 = 0.8;
/// Waypoints after the last one passed among which the nearest is looked for (1 m at 0.05 m): the follower never
/// goes back, and never jumps across a loop of the path.
const SEARCH_WAYPOINTS: usize = 20;
/// Smallest share of the speed while the heading is off: a slow curve ends sooner than a stop and a turn.
const SPEED_SHARE_MIN: f64 = 0.2;

/// Follows one path at a time.
///
/// ```
/// use msg::Pose2;
/// use nav::{FollowerConfig, Path, PathFollower, Waypoint};
///
/// // A straight path of 1 m along x.
/// let waypoints = (0..=20).map(|i| Waypoint { position_m: [f64::from(i) * 0.05, 0.0], clearance_m: 1.0 });
/// let path = Path { waypoints: waypoints.collect() };
///
/// let config = FollowerConfig::default();
/// let mut follower = PathFollower::new(config);
/// let mut pose = Pose2::new(0.0, 0.05, 0.3);
/// let period_s = 0.05;
/// while let Some(twist) = follower.follow(&path, pose, config.cruise_m_s) {
///     pose = pose * Pose2::new(twist.linear_m_s * period_s, 0.0, twist.angular_rad_s * period_s);
/// }
/// assert!((pose.x_m - 1.0).abs() < 0.11 && pose.y_m.abs() < 0.05);
/// ```
#[derive(Clone, Copy, Debug, Default)]
pub struct PathFollower {
    config: FollowerConfig,
    /// Index of the waypoint nearest to the robot.
    nearest: usize,
    is_turning: bool,
}

impl PathFollower {
    /// A follower that has no path yet.
    pub fn new(config: FollowerConfig) -> Self {
        Self { config, ..Self::default() }
    }

    /// Prepares for another path.
    pub fn reset(&mut self) {
        *self = Self::new(self.config);
    }

    /// Prepares for a new path to the same goal that starts at the robot; a turn on the spot continues.
    pub fn on_replanned(&mut self) {
        self.nearest = 0;
    }

    /// Velocity along a path at this speed; `None` at its end, or if the path is empty.
    pub fn follow(&mut self, path: &Path, map_from_base: Pose2, speed_m_s: f64) -> Option<Twist> {
        let config = &self.config;
        let waypoints = &path.waypoints;
        let here_m = [map_from_base.x_m, map_from_base.y_m];
        let end_m = path.end_m()?;
        if distance_m(here_m, end_m) < config.goal_tolerance_m {
            return None;
        }
        // The nearest waypoint ahead.
        let offset_m = |i: &usize| distance_m(waypoints[*i].position_m, here_m);
        let first = self.nearest.min(waypoints.len() - 1);
        let candidates = first..(first + SEARCH_WAYPOINTS).min(waypoints.len());
        self.nearest = candidates.min_by(|a, b| offset_m(a).total_cmp(&offset_m(b))).unwrap_or(first);
        // The waypoint to steer for.
        let lookahead_m = (LOOKAHEAD_PER_CLEARANCE * waypoints[self.nearest].clearance_m)
            .clamp(config.lookahead_min_m, config.lookahead_max_m);
        let target = (self.nearest..waypoints.len()).find(|i| offset_m(i) >= lookahead_m);
        let target_m = target.map_or(end_m, |i| waypoints[i].position_m);
        // Turn on the spot, or drive a curve.
        let error_rad = heading_error_rad(map_from_base, target_m);
        let limit_rad = if self.is_turning { config.turn_until_rad } else { config.turn_from_rad };
        self.is_turning = error_rad.abs() > limit_rad;
        let speed_share = (1.0 - error_rad.abs()).max(SPEED_SHARE_MIN);
        let linear_m_s = if self.is_turning { 0.0 } else { speed_m_s * speed_share };
        Some(Twist { linear_m_s, angular_rad_s: turning_speed_rad_s(config, error_rad) })
    }

    /// Velocity that turns the robot on the spot to face a point, and the remaining heading error in radians.
    pub fn turn_to_face(&self, map_from_base: Pose2, point_m: [f64; 2]) -> (Twist, f64) {
        let error_rad = heading_error_rad(map_from_base, point_m);
        let angular_rad_s = turning_speed_rad_s(&self.config, error_rad);
        (Twist { linear_m_s: 0.0, angular_rad_s }, error_rad)
    }
}

fn turning_speed_rad_s(config: &FollowerConfig, error_rad: f64) -> f64 {
    (config.heading_gain_1_s * error_rad).clamp(-config.turn_rad_s, config.turn_rad_s)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::path::Waypoint;
    use proptest::prelude::*;

    proptest! {
        /// Start poses around the first waypoint of a path with one corner.
        #[test]
        fn the_end_is_reached_without_leaving_the_path(
            x in -0.1..0.1,
            y in -0.1..0.1,
            yaw in -3.1..3.1,
            clearance_m in 0.0..1.0,
        ) {
            let corner = |i: i32| [f64::from(i.min(30)) * 0.05, f64::from((i - 30).max(0)) * 0.05];
            let waypoint = |i| Waypoint { position_m: corner(i), clearance_m };
            let path = Path { waypoints: (0..60).map(waypoint).collect() };
            let mut pose = Pose2::new(x, y, yaw);
            let mut follower = PathFollower::default();
            for _ in 0..1200 {
                let Some(twist) = follower.follow(&path, pose, 0.15) else { return Ok(()) };
                pose = pose * Pose2::new(twist.linear_m_s * 0.05, 0.0, twist.angular_rad_s * 0.05);
                let offset_m = |w: &Waypoint| distance_m(w.position_m, [pose.x_m, pose.y_m]);
                let off_m = path.waypoints.iter().map(offset_m).fold(f64::INFINITY, f64::min);
                prop_assert!(off_m < 0.2, "{off_m} m off the path at {pose:?}");
            }
            prop_assert!(false, "still at {pose:?} after a minute");
        }
    }

    #[test]
    fn an_empty_path_has_no_velocity() {
        assert_eq!(PathFollower::default().follow(&Path::default(), Pose2::IDENTITY, 0.15), None);
    }
}
