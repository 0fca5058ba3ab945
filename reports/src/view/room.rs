//! The merged map beside the simulated room.

use super::Style;
use msg::FleetStats;
use serde::Serialize;

/// Walls of the merged map compared with the simulated room's.
#[derive(Clone, Debug, Serialize)]
pub struct AgainstRoomView {
    /// F1 of occupied cells with a tolerance of one cell.
    pub occupied_f1: f64,
    /// Mean distance from occupied cells to the nearest visible wall, metres, each at most 1 m.
    pub map_to_room_m: f64,
    /// Mean distance from visible walls to the nearest occupied cell, metres, each at most 1 m.
    pub room_to_map_m: f64,
    /// Mean thickness of the map's walls, metres.
    pub wall_thickness_m: f64,
    /// The same where the map lies best on the room.
    pub aligned: AlignedView,
}

/// The merged map moved onto the simulated room: with unknown starts its frame has the error of the first robot's first scans.
#[derive(Clone, Debug, Serialize)]
pub struct AlignedView {
    /// Known share of the observable cells, 0 to 1.
    pub room_coverage: f64,
    /// F1 of occupied cells with a tolerance of one cell.
    pub occupied_f1: f64,
    /// Mean distance from occupied cells to the nearest visible wall, metres, each at most 1 m.
    pub map_to_room_m: f64,
    /// Mean distance from visible walls to the nearest occupied cell, metres, each at most 1 m.
    pub room_to_map_m: f64,
    /// By how much the map's origin is moved for that, metres.
    pub moved_m: f64,
    /// By how much the map is turned for that, degrees.
    pub turned_deg: f64,
}

impl AgainstRoomView {
    /// Returns the comparison; `None` where the room is not known.
    pub(crate) fn new(stats: &FleetStats) -> Option<Self> {
        stats.room_f1.is_finite().then_some(Self {
            occupied_f1: stats.room_f1,
            map_to_room_m: stats.map_to_room_m,
            room_to_map_m: stats.room_to_map_m,
            wall_thickness_m: stats.wall_thickness_m,
            aligned: AlignedView {
                room_coverage: stats.aligned_room_coverage,
                occupied_f1: stats.aligned_room_f1,
                map_to_room_m: stats.aligned_map_to_room_m,
                room_to_map_m: stats.aligned_room_to_map_m,
                moved_m: stats.aligned_by_m,
                turned_deg: stats.aligned_by_rad.to_degrees(),
            },
        })
    }

    /// Formats the comparison; `room_coverage`: known share of the observable cells, if that is known.
    pub fn table(&self, room_coverage: Option<f64>, style: &Style) -> String {
        let percent = |value: f64| format!("{:.1} %", 100.0 * value);
        let metres = |value: f64| format!("{value:.3} m");
        let (coverage, best) = (room_coverage.map_or_else(|| "-".into(), percent), &self.aligned);
        let rows = [
            ("known, of the observable area", coverage, percent(best.room_coverage)),
            ("occupied F1", percent(self.occupied_f1), percent(best.occupied_f1)),
            ("from the map's walls to the room's", metres(self.map_to_room_m), metres(best.map_to_room_m)),
            ("from the room's walls to the map's", metres(self.room_to_map_m), metres(best.room_to_map_m)),
            ("thickness of walls", metres(self.wall_thickness_m), String::new()),
            ("moved", String::new(), metres(best.moved_m)),
            ("turned", String::new(), format!("{:.2} degrees", best.turned_deg)),
        ];
        let rows = rows.map(|(name, placed, aligned)| [name.to_owned(), placed, aligned]);
        style.value_table(["merged map beside the room", "as it lies", "moved onto it"], &rows)
    }
}
