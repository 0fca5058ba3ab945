//! Backing up: the one motion of a robot into space that its LiDAR may not see.

use crate::clearance_map::ClearanceMap;
use crate::command::Twist;
use crate::config::RobotBody;
use crate::geometry::distance_m;
use core::time::Duration;
use msg::grid::Occupancy;
use msg::{Pose2, Stamp};

/// Speed and longest time of backing up.
const SPEED_M_S: f64 = 0.08;
const DURATION_MAX_S: f64 = 3.0;
/// Distances by which a robot backs up, metres: as far as all of them up to there are clear.
const STEPS_M: [f64; 3] = [0.05, 0.1, 0.15];

/// Velocity of backing up.
pub const BACK_UP: Twist = Twist { linear_m_s: -SPEED_M_S, angular_rad_s: 0.0 };

/// How far a robot at a pose may back up, metres. `None`: not even the shortest way.
///
/// The body with its margin has to be clear of obstacles in the map, and what lies behind the body has to be known.
/// `is_free` says whether anything else allows a way back of a length in metres.
pub fn back_up_distance_m(
    map: &ClearanceMap,
    body: RobotBody,
    map_from_base: Pose2,
    is_free: impl Fn(f64) -> bool,
) -> Option<f64> {
    let behind_m = |back_m: f64| map_from_base.apply([-back_m, 0.0]);
    let may_back_up = |back_m: &f64| {
        is_clear(map, body, behind_m(*back_m))
            && is_known(map, behind_m(*back_m + body.radius_m))
            && is_free(*back_m)
    };
    STEPS_M.into_iter().take_while(may_back_up).last()
}

/// Whether the body with its margin is clear of obstacles at a point.
fn is_clear(map: &ClearanceMap, body: RobotBody, point_m: [f64; 2]) -> bool {
    let needed_m = body.clearance_min_m(map.cell_size_m());
    map.cell_at(point_m).is_some_and(|cell| map.clearance_m(cell) >= needed_m)
}

/// Whether a point has been seen, or lies in the robot's own place.
fn is_known(map: &ClearanceMap, point_m: [f64; 2]) -> bool {
    map.cell_at(point_m).is_some_and(|cell| map.occupancy(cell) != Occupancy::Unknown)
}

/// A way back that the robot is on.
#[derive(Clone, Copy, Debug)]
pub struct BackingUp {
    from_m: [f64; 2],
    distance_m: f64,
    until: Stamp,
}

impl BackingUp {
    /// Starts at a position, metres.
    pub fn new(now: Stamp, from_m: [f64; 2], distance_m: f64) -> Self {
        Self { from_m, distance_m, until: now + Duration::from_secs_f64(DURATION_MAX_S) }
    }

    /// Whether it ends, with the robot at a position in the frame of the start.
    pub fn is_done(&self, now: Stamp, at_m: [f64; 2]) -> bool {
        now >= self.until || distance_m(self.from_m, at_m) >= self.distance_m
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::observation::MapView;
    use crate::test_world::{Room, TestWorld};
    use proptest::prelude::*;

    proptest! {
        /// A robot backs up without seeing where.
        #[test]
        fn a_robot_that_backs_up_touches_nothing_although_its_map_is_off(
            door_m in 0.4..1.2_f64,
            (x_m, y_m) in (2.6..3.4_f64, 1.2..2.8_f64),
            (yaw_rad, away_rad) in (-3.2..3.2_f64, -3.2..3.2_f64),
        ) {
            let world = TestWorld::with_room(Room::with_door(door_m), &[Pose2::new(1.2, 2.0, 0.0)]);
            let (body, mut known) = (RobotBody::default(), world.known_map().clone());
            let error = Pose2::new(0.05 * away_rad.cos(), 0.05 * away_rad.sin(), 0.0);
            known.header.origin = error * known.header.origin;
            let mut map = ClearanceMap::default();
            map.copy_window(&MapView::from_log_odds(known.view()).unwrap(), [x_m, y_m]);
            map.compute_clearance();
            let map_from_base = Pose2::new(x_m, y_m, yaw_rad);
            if let Some(back_m) = back_up_distance_m(&map, body, map_from_base, |_| true) {
                let end_m = map_from_base.apply([-back_m, 0.0]);
                prop_assert!(world.clearance_m(end_m) > body.radius_m);
            }
        }
    }

    #[test]
    fn unknown_space_and_other_reasons_keep_a_robot_where_it_is() {
        let distance_m = |behind: i8, is_free: fn(f64) -> bool| {
            // Cells of a room of 2 m by 2 m, row by row; the first column of 0.8 m is behind the robot.
            let cells: Vec<i8> = (0..1600).map(|i| if i % 40 < 16 { behind } else { 0 }).collect();
            let view = MapView::from_percent(Pose2::IDENTITY, 0.05, (40, 40), &cells).unwrap();
            let mut map = ClearanceMap::default();
            map.copy_window(&view, [1.0, 1.0]);
            map.compute_clearance();
            back_up_distance_m(&map, RobotBody::default(), Pose2::new(0.98, 1.0, 0.0), is_free)
        };
        assert_eq!(distance_m(0, |_| true), Some(0.15));
        assert_eq!(distance_m(0, |back_m| back_m < 0.12), Some(0.1));
        assert_eq!(distance_m(0, |_| false), None);
        assert_eq!(distance_m(-1, |_| true), Some(0.05), "the body ends 0.025 m before the unknown");
        assert_eq!(distance_m(100, |_| true), None);
    }

    #[test]
    fn it_ends_at_its_distance_or_after_its_time() {
        let backing_up = BackingUp::new(Stamp(0), [1.0, 1.0], 0.1);
        let at = Stamp::from_seconds;
        assert!(!backing_up.is_done(at(1.0), [0.95, 1.0]));
        assert!(backing_up.is_done(at(1.0), [0.89, 1.0]));
        assert!(backing_up.is_done(at(3.1), [0.95, 1.0]));
    }
}
