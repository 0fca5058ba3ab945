//! The plan of a fleet's room, computed once for all runs of a program in the same room: it takes as long as some ten seconds of a run.

use crate::config::{FleetConfig, RobotSource, room};
use crate::process::telemetry::map_worker::room_plan;
use crate::world::WorldError;
use msg::Grid;
use std::collections::VecDeque;
use std::fs;
use std::path::PathBuf;
use std::sync::Mutex;
use std::time::SystemTime;

/// Plans that are kept; beyond them the oldest is dropped.
const PLANS_MAX: usize = 8;

/// The room of a configuration; for files also their lengths and when each was written last.
type RoomKey = (String, Vec<Option<(u64, SystemTime)>>);

/// The newest plans, oldest first.
static PLANS: Mutex<VecDeque<(RoomKey, Option<Grid>)>> = Mutex::new(VecDeque::new());

/// Returns the plan of the room, as [`room_plan`] does.
pub(super) fn cached_room_plan(config: &FleetConfig) -> Result<Option<Grid>, WorldError> {
    if config.world != RobotSource::Simulator {
        return room_plan(config);
    }
    let path = config.fleet.room.clone();
    let written =
        |file: PathBuf| fs::metadata(file).ok().and_then(|file| Some((file.len(), file.modified().ok()?)));
    let written = room::files(&path).into_iter().map(written).collect();
    let key = (path, written);
    // A thread that panicked here has left whole entries.
    let plans = || PLANS.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
    if let Some((_, plan)) = plans().iter().find(|(known, _)| *known == key) {
        return Ok(plan.clone());
    }
    let plan = room_plan(config)?;
    let mut plans = plans();
    if plans.len() == PLANS_MAX {
        plans.pop_front();
    }
    plans.push_back((key, plan.clone()));
    Ok(plan)
}
