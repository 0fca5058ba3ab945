//! Comparison of the merged map with the room in which a headset's robots are: only the experiment knows that room.

use crate::config::{FleetConfig, RobotSource};
use crate::process::PLAN_RESOLUTION_M;
use crate::world::{self, WorldError};
use msg::{GridView, Pose2};
use reports::{AgainstRoomView, AlignedView, FleetView};
use telemetry::truth::ObservableArea;

/// Name of the merged map, of its channel and of its file.
pub const MERGED_MAP: &str = "merged_map";

/// Fills in how the merged map agrees with the room, where telemetry does not know the room.
///
/// # Errors
/// The room, or the robots' starts in it, cannot be used.
pub fn compare(view: &mut FleetView, map: GridView<'_>, config: &FleetConfig) -> Result<(), WorldError> {
    if config.world != RobotSource::Headset {
        return Ok(());
    }
    let room = world::room(config)?;
    let starts = world::starts(config, &room)?;
    // With unknown starts `map` is the first robot's map, which begins at its start.
    let world_from_map = match starts.first() {
        Some(first) if !config.fleet.starts_known => *first,
        _ => Pose2::IDENTITY,
    };
    let places: Vec<_> = starts.iter().map(|start| [start.x_m, start.y_m]).collect();
    let plan = room.floor_plan_from(PLAN_RESOLUTION_M, &places);
    let area = ObservableArea::new(plan, places);
    let (errors, best) = (area.compare(map, world_from_map), area.compare_aligned(map, world_from_map));
    let known = |value: f64| value.is_finite().then_some(value);
    view.room_coverage = known(errors.room_coverage);
    view.against_room = known(errors.occupied_f1).map(|occupied_f1| AgainstRoomView {
        occupied_f1,
        map_to_room_m: errors.map_to_room_m,
        room_to_map_m: errors.room_to_map_m,
        wall_thickness_m: errors.wall_thickness_m,
        aligned: AlignedView {
            room_coverage: best.accuracy.room_coverage,
            occupied_f1: best.accuracy.occupied_f1,
            map_to_room_m: best.accuracy.map_to_room_m,
            room_to_map_m: best.accuracy.room_to_map_m,
            moved_m: best.moved_m,
            turned_deg: best.turned_rad.to_degrees(),
        },
    });
    Ok(())
}
