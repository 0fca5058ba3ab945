//! Obstacles that recent scans show and the map may not: marked by hits, cleared by beams that pass through.
//!
//! Positions are in one frame: `odom` where it is known, so that a correction of the map moves none of them, else the map's.

use crate::clearance_map::ClearanceMap;
use crate::geometry::distance_m;
use crate::observation::ScanView;
use core::time::Duration;
use msg::{Pose2, Stamp};
use std::collections::BTreeMap;

/// Farthest hit that is kept, metres: errors of the heading misplace farther ones.
const RANGE_MAX_M: f64 = 1.5;
/// Side of the cells that hits are kept in, metres: that of the map's.
const CELL_M: f64 = 0.05;
/// Most cells kept: a disc of [`RANGE_MAX_M`] full of obstacles.
const CELLS_MAX: usize = 4096;
/// Time after which an obstacle that is not seen any more is forgotten, seconds: longer than a turn on the spot.
const AGE_MAX_S: f64 = 8.0;
/// Time for which an obstacle limits the speed that the newest scan cannot show, seconds: a robot that moved on is half a metre away by then.
const UNSEEN_AGE_MAX_S: f64 = 4.0;
/// A beam that ends this far behind an obstacle has passed through it, metres.
const CLEARED_BEHIND_M: f64 = 0.12;
/// Hits this close to another robot's body are that robot, metres: the error of both poses.
const ROBOT_HIT_SPACE_M: f64 = 0.115;
/// How much farther than its hits another robot reaches, metres: a LiDAR sees the housing of its LiDAR, 0.055 m in radius, and the body
/// has 0.105 m.
const UNSEEN_BODY_M: f64 = 0.05;
/// Hits that may be the housing of a LiDAR are no wider than this, metres.
const HOUSING_WIDTH_MAX_M: f64 = 0.13;
/// What is beside them is this much farther away, metres.
const HOUSING_DEPTH_MIN_M: f64 = 0.15;
/// Directions in which it does, from a hit.
const AROUND: [[f64; 2]; 9] = [
    [0.0, 0.0],
    [1.0, 0.0],
    [0.0, 1.0],
    [-1.0, 0.0],
    [0.0, -1.0],
    [1.0, 1.0],
    [-1.0, 1.0],
    [-1.0, -1.0],
    [1.0, -1.0],
];
/// Hits within this many cells of an obstacle of the map are that obstacle.
const MAP_REACH_CELLS: i64 = 2;

/// Obstacles around one robot.
#[derive(Clone, Debug, Default)]
pub(crate) struct RecentObstacles {
    last_scan: Option<Stamp>,
    cells: BTreeMap<(i32, i32), Seen>,
}

/// How a cell with an obstacle was seen.
#[derive(Clone, Copy, Debug)]
struct Seen {
    at: Stamp,
    /// It may be the housing of another robot's LiDAR.
    is_housing: bool,
}

impl RecentObstacles {
    /// Adds a scan once; `robots_m` are the positions of the other robots and `radius_m` is that of each.
    pub(crate) fn record(
        &mut self,
        now: Stamp,
        frame_from_base: Pose2,
        scan: &ScanView,
        robots_m: &[[f64; 2]],
        radius_m: f64,
    ) {
        if self.last_scan == Some(scan.received) {
            return;
        }
        self.last_scan = Some(scan.received);
        self.clear_seen_through(now, frame_from_base, scan);
        let housings = housings(scan);
        let frame_from_scan = frame_from_base * scan.base_from_scan;
        for beam in scan.beams().filter(|beam| beam.is_hit && beam.range_m < RANGE_MAX_M) {
            let (sin, cos) = beam.angle_rad.sin_cos();
            let hit = frame_from_scan.apply([cos * beam.range_m, sin * beam.range_m]);
            let is_housing = housings.iter().any(|[from, to]| (*from..=*to).contains(&beam.angle_rad));
            let is_robot =
                robots_m.iter().any(|robot| distance_m(*robot, hit) < radius_m + ROBOT_HIT_SPACE_M);
            let cell = hit.map(|v| (v / CELL_M).floor() as i32);
            if !is_robot && (self.cells.len() < CELLS_MAX || self.cells.contains_key(&(cell[0], cell[1]))) {
                self.cells.insert((cell[0], cell[1]), Seen { at: now, is_housing });
            }
        }
    }

    fn clear_seen_through(&mut self, now: Stamp, frame_from_base: Pose2, scan: &ScanView) {
        let scan_from_frame = (frame_from_base * scan.base_from_scan).inverse();
        self.cells.retain(|cell, seen| {
            let [x, y] = scan_from_frame.apply(centre_m(*cell));
            let range_m = scan.beam_towards(y.atan2(x));
            let is_cleared =
                range_m.is_some_and(|range_m| f64::from(range_m) > x.hypot(y) + CLEARED_BEHIND_M);
            !is_cleared && now - seen.at <= AGE_MAX_S
        });
    }

    /// Positions in `base_footprint` of recent obstacles where the scan does not measure, metres: beside its view, or nearer than its
    /// shortest range. Another robot may stand there, which the map does not show either.
    pub(crate) fn unseen_in_base_m<'a>(
        &'a self,
        now: Stamp,
        frame_from_base: Pose2,
        scan: &'a ScanView,
    ) -> impl Iterator<Item = [f64; 2]> + 'a {
        let base_from_frame = frame_from_base.inverse();
        let scan_from_base = scan.base_from_scan.inverse();
        let recent = self.cells.iter().filter(move |(_, seen)| now - seen.at <= UNSEEN_AGE_MAX_S);
        recent.map(move |(cell, _)| base_from_frame.apply(centre_m(*cell))).filter(move |in_base_m| {
            let [x, y] = scan_from_base.apply(*in_base_m);
            scan.beam_towards(y.atan2(x)).is_none() || x.hypot(y) < scan.range_min_m
        })
    }

    /// Forgets all obstacles.
    pub(crate) fn clear(&mut self) {
        self.cells.clear();
    }

    /// Draws the obstacles that the map does not show into a window of it.
    pub(crate) fn mark(&self, now: Stamp, map_from_frame: Pose2, map: &mut ClearanceMap) {
        let is_recent = |seen: &Seen| seen.at + Duration::from_secs_f64(AGE_MAX_S) >= now;
        let points = self.cells.iter().filter(|(_, seen)| is_recent(seen));
        let points = points.map(|(cell, seen)| (map_from_frame.apply(centre_m(*cell)), seen.is_housing));
        let unknown_to_map: Vec<([f64; 2], bool)> =
            points.filter(|(point, _)| !map.is_occupied_near(*point, MAP_REACH_CELLS)).collect();
        for ([x, y], is_housing) in unknown_to_map {
            for [towards_x, towards_y] in if is_housing { &AROUND[..] } else { &AROUND[..1] } {
                map.mark_occupied([x + UNSEEN_BODY_M * towards_x, y + UNSEEN_BODY_M * towards_y]);
            }
        }
    }
}

/// Ranges of angles in the sensor's frame in which a scan shows what may be the housing of another robot's LiDAR: hits next to each other,
/// with what is beside them farther away, or not in view.
fn housings(scan: &ScanView) -> Vec<[f64; 2]> {
    let mut found = Vec::new();
    // Beams of the current thing: first and last angle, nearest range, and whether it is nearer than the beam before it.
    let mut thing: Option<([f64; 2], f64, bool)> = None;
    let mut before_m = f64::INFINITY;
    let mut end = |thing: Option<([f64; 2], f64, bool)>, next_m: f64| {
        let Some((angles, range_m, is_before)) = thing else { return };
        let is_narrow = (angles[1] - angles[0]).abs() * range_m <= HOUSING_WIDTH_MAX_M;
        if is_before && is_narrow && next_m > range_m + HOUSING_DEPTH_MIN_M {
            found.push([angles[0].min(angles[1]), angles[0].max(angles[1])]);
        }
    };
    for beam in scan.beams() {
        let range_m = if beam.is_hit { beam.range_m } else { f64::INFINITY };
        thing = match thing {
            Some((angles, nearest_m, is_before)) if (range_m - before_m).abs() < HOUSING_DEPTH_MIN_M => {
                Some(([angles[0], beam.angle_rad], nearest_m.min(range_m), is_before))
            }
            ended => {
                end(ended, range_m);
                let begins = ([beam.angle_rad; 2], range_m, before_m > range_m + HOUSING_DEPTH_MIN_M);
                Some(begins).filter(|_| beam.is_hit && range_m < RANGE_MAX_M)
            }
        };
        before_m = range_m;
    }
    end(thing, f64::INFINITY);
    found
}

fn centre_m((x, y): (i32, i32)) -> [f64; 2] {
    [(f64::from(x) + 0.5) * CELL_M, (f64::from(y) + 0.5) * CELL_M]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::collision::CollisionLimit;
    use crate::observation::MapView;
    use msg::grid::Occupancy;

    /// A scan of 90 degrees with one beam in each degree, at the middle of the robot.
    fn scan(received_s: f64, ranges_m: &[f32; 91]) -> ScanView<'_> {
        ScanView {
            received: Stamp::from_seconds(received_s),
            base_from_scan: Pose2::IDENTITY,
            angle_min_rad: -core::f64::consts::FRAC_PI_4,
            angle_increment_rad: 1f64.to_radians(),
            range_min_m: 0.12,
            range_max_m: 3.5,
            ranges_m,
        }
    }

    /// Free distance ahead by what the scan does not see.
    fn unseen_m(obstacles: &RecentObstacles, at_s: f64, odom_from_base: Pose2, scan: &ScanView) -> f64 {
        let unseen = obstacles.unseen_in_base_m(Stamp::from_seconds(at_s), odom_from_base, scan);
        unseen
            .map(|at_m| CollisionLimit::default().free_distance_to_point_m(at_m))
            .fold(f64::INFINITY, f64::min)
    }

    #[test]
    fn what_a_robot_turned_away_from_still_stands_beside_it() {
        let (mut near, open) = ([f32::INFINITY; 91], [f32::INFINITY; 91]);
        near[75..].fill(0.14);
        let mut obstacles = RecentObstacles::default();
        obstacles.record(Stamp::from_seconds(1.0), Pose2::IDENTITY, &scan(1.0, &near), &[], 0.105);
        // It stands at 30 to 45 degrees; after a turn by 20 degrees to the right most of it is out of view, and ahead on the left.
        let turned = Pose2::new(0.0, 0.0, -20f64.to_radians());
        obstacles.record(Stamp::from_seconds(1.1), turned, &scan(1.1, &open), &[], 0.105);
        let free_m = unseen_m(&obstacles, 1.1, turned, &scan(1.1, &open));
        assert!(free_m < 0.07, "the robot would touch it after {free_m} m");
        // Behind the robot it is in nobody's way, and a while later it may be gone.
        let away = Pose2::new(0.0, 0.0, -100f64.to_radians());
        assert_eq!(unseen_m(&obstacles, 1.2, away, &scan(1.2, &open)), f64::INFINITY);
        assert_eq!(unseen_m(&obstacles, 6.0, turned, &scan(6.0, &open)), f64::INFINITY);
        // What is nearer than the shortest range is not measured either.
        let close = Pose2::new(0.1, 0.08, 35f64.to_radians());
        assert!(unseen_m(&obstacles, 1.3, close, &scan(1.3, &open)) < 0.07);
    }

    #[test]
    fn narrow_things_before_what_is_behind_them_may_be_housings() {
        let found = |ranges: &[f32; 91]| housings(&scan(1.0, ranges)).len();
        let mut ranges = [f32::INFINITY; 91];
        ranges[40..46].fill(0.8);
        assert_eq!(found(&ranges), 1, "0.084 m wide, and nothing behind it");
        ranges.iter_mut().filter(|range| **range > 3.0).for_each(|range| *range = 1.2);
        assert_eq!(found(&ranges), 1, "a wall behind it");
        ranges[40..52].fill(0.8);
        assert_eq!(found(&ranges), 0, "0.17 m wide");
        let mut ranges = [1.0_f32; 91];
        ranges[40..46].fill(2.0);
        assert_eq!(found(&ranges), 0, "a gap in a wall");
        let mut ranges = [f32::INFINITY; 91];
        ranges[..8].fill(0.4);
        assert_eq!(found(&ranges), 1, "at the edge of the view");
        let wall: [f32; 91] = core::array::from_fn(|i| 0.5 / (i as f32 - 45.0).to_radians().cos());
        assert_eq!(found(&wall), 0);
    }

    #[test]
    fn an_obstacle_that_the_map_does_not_show_reaches_farther_than_its_hits() {
        // Floor of 3 m by 3 m with a wall at y = 0.5 m; the robot at (1, 1) looks along the wall.
        let mut cells = vec![0_i8; 3600];
        cells[600..660].fill(100);
        let view = MapView::from_percent(Pose2::IDENTITY, 0.05, (60, 60), &cells).unwrap();
        let occupied_cells = |angle_deg: i32, range_m: f32| {
            let mut ranges = [f32::INFINITY; 91];
            ranges[(angle_deg + 45) as usize] = range_m;
            let (mut obstacles, at) = (RecentObstacles::default(), Pose2::new(1.0, 1.0, 0.0));
            obstacles.record(Stamp::from_seconds(1.0), at, &scan(1.0, &ranges), &[], 0.105);
            let mut map = ClearanceMap::default();
            map.copy_window(&view, [1.0, 1.0]);
            obstacles.mark(Stamp::from_seconds(1.0), Pose2::IDENTITY, &mut map);
            (0..map.cell_count()).filter(|cell| map.occupancy(*cell) == Occupancy::Occupied).count()
        };
        assert_eq!(occupied_cells(0, 0.525), 60 + 9, "a robot's body around the housing of its LiDAR");
        assert_eq!(occupied_cells(-45, 0.7), 60, "a hit on the wall is the wall");
    }
}
