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
/// A beam that ends this far behind an obstacle has passed through it, metres.
const CLEARED_BEHIND_M: f64 = 0.12;
/// Hits this close to another robot's body are that robot, metres: the error of both poses.
const ROBOT_HIT_SPACE_M: f64 = 0.115;
/// Hits within this many cells of an obstacle of the map are that obstacle.
const MAP_REACH_CELLS: i64 = 2;

/// Obstacles around one robot.
#[derive(Clone, Debug, Default)]
pub(crate) struct RecentObstacles {
    last_scan: Option<Stamp>,
    cells: BTreeMap<(i32, i32), Stamp>,
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
        for hit in scan.hits_in_base_m().filter(|hit| hit[0].hypot(hit[1]) < RANGE_MAX_M) {
            let hit = frame_from_base.apply(hit);
            let is_robot =
                robots_m.iter().any(|robot| distance_m(*robot, hit) < radius_m + ROBOT_HIT_SPACE_M);
            let cell = hit.map(|v| (v / CELL_M).floor() as i32);
            if !is_robot && (self.cells.len() < CELLS_MAX || self.cells.contains_key(&(cell[0], cell[1]))) {
                self.cells.insert((cell[0], cell[1]), now);
            }
        }
    }

    fn clear_seen_through(&mut self, now: Stamp, frame_from_base: Pose2, scan: &ScanView) {
        let scan_from_frame = (frame_from_base * scan.base_from_scan).inverse();
        self.cells.retain(|cell, seen| {
            let [x, y] = scan_from_frame.apply(centre_m(*cell));
            let beam = ((y.atan2(x) - scan.angle_min_rad) / scan.angle_increment_rad).round();
            let range_m = if beam >= 0.0 { scan.ranges_m.get(beam as usize).copied() } else { None };
            let is_cleared =
                range_m.is_some_and(|range_m| f64::from(range_m) > x.hypot(y) + CLEARED_BEHIND_M);
            !is_cleared && now - *seen <= AGE_MAX_S
        });
    }

    /// Forgets all obstacles.
    pub(crate) fn clear(&mut self) {
        self.cells.clear();
    }

    /// Draws the obstacles that the map does not show into a window of it.
    pub(crate) fn mark(&self, now: Stamp, map_from_frame: Pose2, map: &mut ClearanceMap) {
        let is_recent = |seen: &Stamp| *seen + Duration::from_secs_f64(AGE_MAX_S) >= now;
        let points = self.cells.iter().filter(|(_, seen)| is_recent(seen));
        let points = points.map(|(cell, _)| map_from_frame.apply(centre_m(*cell)));
        let unknown_to_map: Vec<[f64; 2]> =
            points.filter(|point| !map.is_occupied_near(*point, MAP_REACH_CELLS)).collect();
        unknown_to_map.iter().for_each(|point| map.mark_occupied(*point));
    }
}

fn centre_m((x, y): (i32, i32)) -> [f64; 2] {
    [(f64::from(x) + 0.5) * CELL_M, (f64::from(y) + 0.5) * CELL_M]
}
