//! The metrics of the maps, computed beside the loop that takes arrival times: that loop must never wait for them.
//!
//! One job is under way at most. What changes meanwhile waits in the newest version of each map, so that nothing piles up
//! however long a job takes. In lockstep a job is done at once.

use super::super::{Error, PLAN_RESOLUTION_M};
use crate::config::{FleetConfig, RobotSource};
use crate::job_thread::{JobRunner, JobWorker};
use crate::realtime::work_in_background;
use crate::run::Run;
use crate::world::{self, WorldError};
use ::telemetry::{MapChanges, MapFigures, MapMetrics, Telemetry};
use msg::{Grid, Monotonic};
use std::sync::mpsc::{Receiver, sync_channel};
use tokio::sync::oneshot::{self, error::TryRecvError};

/// Niceness of the threads that draw the room's plan and compare maps (nice(2)): a tenth of the share of others, where they
/// need the processor.
const NICENESS: i32 = 10;

/// Computes the metrics of the maps.
pub struct MapWorker {
    metrics: MapMetrics,
    /// Where the room's plan comes, until it has come.
    awaited_room: Option<Receiver<Grid>>,
}

impl MapWorker {
    /// Creates the metrics of a fleet without maps. They have no coverage without the room's `plan`, frame `world`.
    ///
    /// # Errors
    /// The configuration's room or starts cannot be used.
    pub fn new(run: &Run, plan: Option<Grid>) -> Result<Self, Error> {
        let starts = world::starts_in_room(run)?;
        Ok(Self { metrics: MapMetrics::new(run.config.fleet.robots, plan, &starts), awaited_room: None })
    }

    /// As [`MapWorker::new`], but a thread of low priority draws the room's plan.
    pub(super) fn with_room_in_background(run: &Run) -> Result<Self, Error> {
        Ok(Self { awaited_room: draw_room_in_background(run), ..Self::new(run, None)? })
    }
}

impl JobRunner for MapWorker {
    const THREAD: &'static str = "maps";
    const NICENESS: i32 = NICENESS;
    const LEAVES_STATE: bool = false;
    type Job = MapChanges;
    type Report = MapFigures;

    fn run(&mut self, changes: &MapChanges) -> MapFigures {
        if let Some(plan) = self.awaited_room.as_ref().and_then(|room| room.try_recv().ok()) {
            self.metrics.set_room(plan);
            self.awaited_room = None;
        }
        self.metrics.apply(changes);
        self.metrics.compute()
    }
}

/// Hands changed maps to the worker, and its figures to telemetry. Never waits.
pub(super) struct MapHandover<W> {
    worker: W,
    /// The job that is under way, and when its maps were taken.
    job: Option<(oneshot::Receiver<MapFigures>, Monotonic)>,
}

impl<W: JobWorker<MapChanges, MapFigures>> MapHandover<W> {
    pub(super) fn new(worker: W) -> Self {
        Self { worker, job: None }
    }

    /// Hands over the `changes` of the maps that are taken `now`, if the worker is free.
    pub(super) fn hand_over(
        &mut self,
        telemetry: &mut Telemetry,
        now: Monotonic,
        changes: impl FnOnce() -> MapChanges,
    ) {
        self.receive(telemetry);
        if self.job.is_none() {
            self.job = Some((self.worker.submit(changes()), now));
        }
    }

    /// Takes the figures that are ready.
    pub(super) fn receive(&mut self, telemetry: &mut Telemetry) {
        let Some((report, taken)) = &mut self.job else { return };
        match report.try_recv() {
            Err(TryRecvError::Empty) => return,
            Ok(figures) => telemetry.set_map_figures(figures, *taken),
            // It was refused.
            Err(TryRecvError::Closed) => {}
        }
        self.job = None;
    }
}

/// Draws the room's plan on a thread of low priority, and returns where it comes. The plan takes as much processor time as the
/// start of the whole fleet, and nobody needs it before there is a map.
fn draw_room_in_background(run: &Run) -> Option<Receiver<Grid>> {
    let (config, (sender, receiver)) = (run.config.clone(), sync_channel(1));
    let draw = move || {
        work_in_background(NICENESS);
        match room_plan(&config) {
            Ok(Some(plan)) => drop(sender.send(plan)),
            Ok(None) => {}
            Err(why) => tracing::warn!("telemetry: no coverage and no errors of the maps: {why}"),
        }
    };
    std::thread::Builder::new().name("room".into()).spawn(draw).ok().map(|_| receiver)
}

/// Returns the plan of a simulated room, frame `world`. Other worlds have none.
pub fn room_plan(config: &FleetConfig) -> Result<Option<Grid>, WorldError> {
    match config.world {
        RobotSource::Simulator => {
            let room = world::room(config)?;
            let starts_m: Vec<_> =
                world::starts(config, &room)?.iter().map(|start| [start.x_m, start.y_m]).collect();
            Ok(Some(room.floor_plan_from(PLAN_RESOLUTION_M, &starts_m)))
        }
        RobotSource::Headset | RobotSource::Ros | RobotSource::Robots => Ok(None),
    }
}
