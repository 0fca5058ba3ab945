//! The merged map, and its comparison with the room where that is known (simulation only).

use crate::received_map::ReceivedMap;
use crate::truth::{AlignedAccuracy, MapAccuracy, ObservableArea};
use msg::Pose2;

/// Calls between two comparisons of the walls with the room's: at a call a second, every five seconds.
const CALLS_BETWEEN_COMPARISONS: usize = 5;
/// Cells of the map for which one call is added: two comparisons take about 80 ms for a million cells.
const CELLS_PER_EXTRA_CALL: usize = 100_000;

/// Accuracy of the merged map against the room.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RoomAccuracy {
    /// Errors where the map is placed,
    pub placed: MapAccuracy,
    /// and where it lies best.
    pub aligned: AlignedAccuracy,
}

impl RoomAccuracy {
    /// Nothing is known: all figures are NaN.
    pub const UNKNOWN: Self = Self { placed: MapAccuracy::UNKNOWN, aligned: AlignedAccuracy::UNKNOWN };
}

/// The newest merged map, and its accuracy against the room.
#[derive(Default)]
pub(crate) struct MergedMap {
    pub map: ReceivedMap,
    /// Version, transform and result of the newest room coverage.
    room_coverage: Option<(u64, Pose2, f64)>,
    accuracy: Option<RoomAccuracy>,
    /// Calls since `accuracy` was computed.
    accuracy_age: usize,
}

impl MergedMap {
    /// Errors of the map's walls against the room, computed now and then. NaN where the room or the transform is
    /// unknown.
    pub fn accuracy(&mut self, room: Option<&ObservableArea>, world_from_map: Option<Pose2>) -> RoomAccuracy {
        let (Some(room), Some(world_from_map)) = (room, world_from_map) else {
            self.accuracy = None;
            return RoomAccuracy::UNKNOWN;
        };
        self.accuracy_age += 1;
        let due = CALLS_BETWEEN_COMPARISONS + self.map.grid.cells.len() / CELLS_PER_EXTRA_CALL;
        if self.map.version > 0 && (self.accuracy.is_none() || self.accuracy_age >= due) {
            let map = self.map.grid.view();
            self.accuracy = Some(RoomAccuracy {
                placed: room.compare(map, world_from_map),
                aligned: room.compare_aligned(map, world_from_map),
            });
            self.accuracy_age = 0;
        }
        self.accuracy.unwrap_or(RoomAccuracy::UNKNOWN)
    }

    /// Share of the room's observable cells that the map knows, computed when the map or the transform changes. NaN where
    /// the room or the transform is unknown.
    pub fn room_coverage(&mut self, room: Option<&ObservableArea>, world_from_map: Option<Pose2>) -> f64 {
        let (Some(room), Some(world_from_map)) = (room, world_from_map) else { return f64::NAN };
        match self.room_coverage {
            Some((version, transform, coverage))
                if version == self.map.version && transform == world_from_map =>
            {
                coverage
            }
            _ => {
                let coverage = room.room_coverage(self.map.grid.view(), world_from_map);
                self.room_coverage = Some((self.map.version, world_from_map, coverage));
                coverage
            }
        }
    }
}
