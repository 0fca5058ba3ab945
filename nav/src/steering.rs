//! From where to go to a wished velocity: along the way (pure pursuit, Coulter 1992), towards a point on the
//! spot, by the scan alone, and never into what the scan shows.

use crate::joystick::Twist;
use crate::memory::distance_m;
use crate::plan::BODY_RADIUS_M;
use crate::rng::Rng;
use crate::sight::ScanView;
use msg::{Pose2, pose::wrap_angle};

/// Steers for the point of the way this far ahead, metres: as far as there is room to cut the corner.
const LOOKAHEAD_M: (f64, f64) = (0.12, 0.35);
/// The way's end counts as reached at this distance, metres.
const ARRIVED_M: f64 = 0.1;
/// Turns on the spot when the way leads off by more than this, radians ...
const TURN_FROM_RAD: f64 = 0.8;
/// ... until it leads off by less than this.
const TURN_UNTIL_RAD: f64 = 0.25;
/// Fast enough for a person, slow enough for the scans to overlap well, rad/s.
pub const TURN_RAD_S: f64 = 0.9;
/// rad/s per radian of heading error.
const HEADING_GAIN_1_S: f64 = 2.0;
/// How far to each side of the middle the body needs room ahead, metres.
const CORRIDOR_M: f64 = BODY_RADIUS_M + 0.015;
/// Stands still with this much room ahead of the body, metres ...
const STOP_GAP_M: f64 = 0.07;
/// ... and gains speed with what is more, m/s per metre: 0.15 m/s at 0.32 m.
const GAP_GAIN_1_S: f64 = 0.6;

/// A place on a way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Waypoint {
    /// In the map's frame, metres.
    pub at_m: [f64; 2],
    /// To the nearest obstacle, metres.
    pub room_m: f64,
}

/// Follows one way.
#[derive(Clone, Copy, Debug, Default)]
pub struct Pursuit {
    passed: usize,
    turning: bool,
}

impl Pursuit {
    /// The way was drawn anew from where the robot is; a turn under way goes on.
    pub fn replanned(&mut self) {
        self.passed = 0;
    }

    /// The velocity along a way; `None` at its end.
    pub fn steer(&mut self, way: &[Waypoint], map_from_base: Pose2, speed_m_s: f64) -> Option<Twist> {
        let here = [map_from_base.x_m, map_from_base.y_m];
        let end = way.last()?.at_m;
        if distance_m(here, end) < ARRIVED_M {
            return None;
        }
        let off = |i: &usize| distance_m(way[*i].at_m, here);
        let passed = self.passed.min(way.len() - 1);
        // Never back, and not across a loop of the way.
        let near = passed..(passed + 20).min(way.len());
        self.passed = near.min_by(|a, b| off(a).total_cmp(&off(b))).unwrap_or(passed);
        let lookahead_m = (0.8 * way[self.passed].room_m).clamp(LOOKAHEAD_M.0, LOOKAHEAD_M.1);
        let ahead = (self.passed..way.len()).find(|i| off(i) >= lookahead_m);
        let error_rad = heading_error_rad(map_from_base, ahead.map_or(end, |i| way[i].at_m));
        let limit = if self.turning { TURN_UNTIL_RAD } else { TURN_FROM_RAD };
        self.turning = error_rad.abs() > limit;
        let linear_m_s = if self.turning { 0.0 } else { speed_m_s * (1.0 - error_rad.abs()).max(0.2) };
        Some(Twist { linear_m_s, angular_rad_s: turn_rad_s(error_rad) })
    }
}

/// Turns on the spot towards a point.
pub fn face(map_from_base: Pose2, point_m: [f64; 2]) -> (Twist, f64) {
    let error_rad = heading_error_rad(map_from_base, point_m);
    (Twist { linear_m_s: 0.0, angular_rad_s: turn_rad_s(error_rad) }, error_rad)
}

fn heading_error_rad(map_from_base: Pose2, point_m: [f64; 2]) -> f64 {
    let bearing_rad = (point_m[1] - map_from_base.y_m).atan2(point_m[0] - map_from_base.x_m);
    wrap_angle(bearing_rad - map_from_base.yaw_rad)
}

fn turn_rad_s(error_rad: f64) -> f64 {
    (HEADING_GAIN_1_S * error_rad).clamp(-TURN_RAD_S, TURN_RAD_S)
}

/// How far the body can go straight ahead by the scan, metres; infinite if nothing is seen there.
pub fn gap_ahead_m(scan: &ScanView) -> f64 {
    let ahead = scan.hits_in_base_m().filter(|[x, y]| *x > 0.0 && y.abs() < CORRIDOR_M);
    ahead.map(|[x, _]| x - BODY_RADIUS_M).fold(f64::INFINITY, f64::min)
}

/// How far it can go before it touches another robot of which it is known where it stands, in `base_footprint`.
pub fn gap_to_robot_m([x, y]: [f64; 2]) -> f64 {
    let touch_m = BODY_RADIUS_M + CORRIDOR_M;
    if x > 0.0 && y.abs() < touch_m { x - (touch_m * touch_m - y * y).sqrt() } else { f64::INFINITY }
}

/// Slows down towards what is this far ahead, and stops short of it.
pub fn guard(wish: Twist, gap_m: f64) -> Twist {
    let limit_m_s = ((gap_m - STOP_GAP_M) * GAP_GAIN_1_S).max(0.0);
    Twist { linear_m_s: wish.linear_m_s.min(limit_m_s), ..wish }
}

/// Drives by the scan alone: on while there is room, else turns to one side until there is.
#[derive(Clone, Copy, Debug, Default)]
pub struct Wander {
    /// The side it turns to, +1 or -1, while it turns.
    side: Option<f64>,
}

impl Wander {
    /// The velocity.
    pub fn steer(&mut self, scan: &ScanView, speed_m_s: f64, rng: &mut Rng) -> Twist {
        let gap_m = gap_ahead_m(scan);
        let enough_m = if self.side.is_some() { 0.8 } else { 0.3 };
        if gap_m > enough_m {
            self.side = None;
            return Twist { linear_m_s: speed_m_s, angular_rad_s: 0.0 };
        }
        let side = *self.side.get_or_insert_with(|| freer_side(scan, rng));
        Twist { linear_m_s: 0.0, angular_rad_s: side * TURN_RAD_S }
    }
}

fn freer_side(scan: &ScanView, rng: &mut Rng) -> f64 {
    let nearest = |left: bool| {
        let there = scan.hits_in_base_m().filter(|[_, y]| (*y > 0.0) == left);
        there.map(|[x, y]| x.hypot(y)).fold(f64::INFINITY, f64::min)
    };
    let (left_m, right_m) = (nearest(true), nearest(false));
    let left = if left_m == right_m { rng.below(2) == 0 } else { left_m > right_m };
    if left { 1.0 } else { -1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use msg::Stamp;
    use proptest::prelude::*;

    fn scan(ranges_m: &[f32]) -> ScanView<'_> {
        ScanView {
            seen: Stamp(0),
            base_from_scan: Pose2::IDENTITY,
            angle_min_rad: -0.8,
            angle_increment_rad: 1.6 / (ranges_m.len() - 1) as f64,
            range_min_m: 0.05,
            range_max_m: 3.5,
            ranges_m,
        }
    }

    proptest! {
        /// From any pose near a straight way, its end is reached and the robot never strays far.
        #[test]
        fn pursuit_arrives(x in -0.1..0.1, y in -0.1..0.1, yaw in -3.1..3.1, room_m in 0.0..1.0) {
            let corner = |i: i32| [f64::from(i.min(30)) * 0.05, f64::from((i - 30).max(0)) * 0.05];
            let way: Vec<Waypoint> = (0..60).map(|i| Waypoint { at_m: corner(i), room_m }).collect();
            let mut pose = Pose2::new(x, y, yaw);
            let mut pursuit = Pursuit::default();
            for _ in 0..1200 {
                let Some(twist) = pursuit.steer(&way, pose, 0.15) else { return Ok(()) };
                pose = pose * Pose2::new(twist.linear_m_s * 0.05, 0.0, twist.angular_rad_s * 0.05);
                let off = way.iter().map(|p| distance_m(p.at_m, [pose.x_m, pose.y_m])).fold(f64::INFINITY, f64::min);
                prop_assert!(off < 0.2, "{off} m off the way at {pose:?}");
            }
            prop_assert!(false, "still at {pose:?} after a minute");
        }

        #[test]
        fn never_forward_into_what_is_near(range in 0.05..0.17_f32, v in 0.0..0.15, w in -1.5..1.5) {
            let mut ranges = [f32::INFINITY; 181];
            ranges[90] = range;
            let twist = guard(Twist { linear_m_s: v, angular_rad_s: w }, gap_ahead_m(&scan(&ranges)));
            prop_assert_eq!(twist.linear_m_s, 0.0);
            prop_assert_eq!(twist.angular_rad_s, w);
        }
    }

    #[test]
    fn the_guard_lets_back_and_past() {
        let mut ranges = [f32::INFINITY; 181];
        ranges[90] = 0.1;
        let back = Twist { linear_m_s: -0.1, angular_rad_s: 0.0 };
        assert_eq!(guard(back, gap_ahead_m(&scan(&ranges))), back);
        ranges[90] = f32::INFINITY;
        ranges[0] = 0.3;
        let on = Twist { linear_m_s: 0.15, angular_rad_s: 0.0 };
        assert_eq!(guard(on, gap_ahead_m(&scan(&ranges))), on);
    }

    #[test]
    fn wanders_to_the_freer_side() {
        let mut ranges = [0.25_f32; 181];
        ranges[100..].fill(f32::INFINITY);
        let twist = Wander::default().steer(&scan(&ranges), 0.1, &mut super::Rng::new(1));
        assert_eq!(twist, Twist { linear_m_s: 0.0, angular_rad_s: TURN_RAD_S });
    }
}
