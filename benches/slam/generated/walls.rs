//! How much of a building is in a map.

use super::robot::{Sensor, Step, beam_angle_rad};
use msg::grid::{Occupancy, occupancy};
use msg::{GridView, Pose2};
use std::collections::BTreeSet;

/// Walls are counted in cells of this size, metres.
const CELL_M: f64 = 0.2;
/// A wall is in the map if a cell this near to it is occupied, metres: a map may be off by some centimetres.
const NEAR_M: f64 = 0.3;
/// Every so many scans, and every so many beams of them, are counted: the walls are hit many times.
const SCANS: usize = 5;
const BEAMS: usize = 3;
/// Hits farther away than this are not counted, metres: the map does not draw them by default.
const RANGE_MAX_M: f64 = 25.0;

/// Returns the share of the cells hit by scans that the map has as walls, 0 to 1.
pub fn share_in_map(map: GridView<'_>, steps: &[Step], sensor: Sensor, world_from_map: Pose2) -> f64 {
    let mut hits = BTreeSet::new();
    for step in steps.iter().step_by(SCANS) {
        for (beam, range_m) in step.ranges_m.iter().enumerate().step_by(BEAMS) {
            let range_m = f64::from(*range_m);
            if range_m <= sensor.range_m.min(RANGE_MAX_M) {
                let angle = beam_angle_rad(sensor, beam);
                let at = step.truth.apply([range_m * angle.cos(), range_m * angle.sin()]);
                hits.insert(at.map(|v| (v / CELL_M).floor() as i64));
            }
        }
    }
    let map_from_world = world_from_map.inverse();
    let reach = (NEAR_M / map.header.resolution_m).round() as i64;
    let is_wall = |cell: &&[i64; 2]| {
        let (x, y) = map.cell_of(map_from_world.apply(cell.map(|v| (v as f64 + 0.5) * CELL_M)));
        (-reach..=reach)
            .any(|dx| (-reach..=reach).any(|dy| occupancy(map.cell(x + dx, y + dy)) == Occupancy::Occupied))
    };
    hits.iter().filter(is_wall).count() as f64 / hits.len().max(1) as f64
}
