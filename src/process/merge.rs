//! The merge process: receives the robots' maps, and publishes the merged map and the map transforms.
//!
//! One thread draws the map. The fleet's pose graph, which estimates the transforms and redraws deformed maps, is on a
//! second thread ([`graph`]).

use super::graph::{self, FleetEstimate, FleetEstimateSlot};
use super::heartbeat::{HealthCounters, Heartbeat};
use super::{Error, Listens, ProcessLoop, serve};
use crate::channel;
use crate::fleet;
use crate::merge_memory::MergeMemory;
use crate::ports::{
    ChannelError, Clock as _, Gaps, MAP_PAUSE, Ports, ReadMapPort, ReadPort, WriteMapPort, WritePort,
};
use crate::progress::WatchedThread;
use crate::run::Run;
use crate::stop::Stop;
use crate::storage::{DiskStorage, Storage};
use ::merge::{FleetPoseGraph, Merger};
use msg::{Correction, MapTransforms, Monotonic, Pose2, RobotId, Role, TrackingState};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Runs the process until it is asked to stop.
pub fn run(run: &Run, stop: &Stop) -> Result<(), Error> {
    let (slot, done) = (Arc::<FleetEstimateSlot>::default(), AtomicBool::new(false));
    let (pose_graph, memory) = begin(run, DiskStorage)?;
    let node = run.attach(Role::Merge, None)?;
    let mut drawing = MapDrawing::open(&node, run, &pose_graph, slot.clone())?;
    std::thread::scope(|scope| {
        let graph_thread = scope.spawn(|| graph::run(run, pose_graph, memory, slot, &done));
        let progress = run.progress(Role::Merge, None, WatchedThread::Main);
        serve(&mut drawing, progress, &|| stop.requested() || graph_thread.is_finished());
        done.store(true, Ordering::Relaxed);
        graph_thread.join().map_err(|_| "the thread of the fleet's pose graph panicked")??;
        Ok(())
    })
}

/// Creates the fleet's pose graph from the state of an earlier process of this run: the transforms hold from the first
/// map on.
pub fn begin<S: Storage>(run: &Run, storage: S) -> Result<(FleetPoseGraph, MergeMemory<S>), Error> {
    let starts = fleet::known_starts(&run.config)?;
    let mut graph = FleetPoseGraph::new(&run.config.merge, &starts);
    let memory = MergeMemory::restore(run, storage, &mut graph);
    Ok((graph, memory))
}

/// Draws the merged map, and never waits for anything else.
pub struct MapDrawing<P: Ports> {
    merger: Merger,
    maps: Vec<(RobotId, P::MapReader)>,
    corrections: Vec<(RobotId, P::Reader<Correction>)>,
    slot: Arc<FleetEstimateSlot>,
    merged: P::MapWriter,
    transforms: P::Writer<MapTransforms>,
    heartbeat: Heartbeat<P>,
    clock: P::Clock,
    listeners: Vec<P::Listener>,
    robot_radius_m: f64,
    refused: u64,
}

impl<P: Ports> MapDrawing<P> {
    /// Opens the channels; the robots' maps have the transforms of `graph`.
    pub fn open(
        ports: &P,
        run: &Run,
        graph: &FleetPoseGraph,
        slot: Arc<FleetEstimateSlot>,
    ) -> Result<Self, ChannelError> {
        let robots = run.robots();
        let starts: Vec<Option<Pose2>> =
            robots.clone().map(|robot| graph.map_from_robot_map(robot)).collect();
        let maps = robots.clone().map(|robot| Ok((robot, ports.map_reader(&channel::map(robot))?)));
        let corrections = robots.clone().map(|robot| Ok((robot, ports.reader(&channel::correction(robot))?)));
        let listeners = robots.clone().map(|robot| ports.listener(&channel::map(robot)));
        let listeners = listeners.chain([ports.listener(&channel::merge_edges())]);
        let mut drawing = Self {
            merger: Merger::new(&run.config.merge, &starts),
            maps: maps.collect::<Result<_, ChannelError>>()?,
            corrections: corrections.collect::<Result<_, ChannelError>>()?,
            slot,
            merged: ports.map_writer(&channel::merged_map())?,
            transforms: ports.writer(&channel::map_transforms())?,
            heartbeat: Heartbeat::new(ports, run, Role::Merge, None)?,
            clock: ports.clock(),
            listeners: listeners.collect::<Result<_, _>>()?,
            robot_radius_m: run.config.slam.map.robot_radius_m,
            refused: 0,
        };
        drawing.transforms.send(&drawing.merger.map_transforms());
        Ok(drawing)
    }

    /// Receives all waiting messages; returns true if the merged map changes.
    fn receive(&mut self) -> bool {
        let mut changed = false;
        for (robot, reader) in &mut self.maps {
            if reader.poll() {
                let merger = &mut self.merger;
                let taken = self.heartbeat.measure(|| merger.update_tiles(*robot, reader.map())).is_ok();
                self.refused += u64::from(!taken);
                changed |= taken;
            }
        }
        for (robot, reader) in &mut self.corrections {
            changed |= set_footprint::<P>(&mut self.merger, *robot, reader, self.robot_radius_m);
        }
        if let Some(estimate) = self.slot.take() {
            let merger = &mut self.merger;
            self.refused += self.heartbeat.measure(|| apply_estimate(merger, &estimate));
            changed = true;
        }
        changed
    }

    fn gaps(&self) -> Gaps {
        self.maps.iter().fold(Gaps::default(), |mut sum, (_, reader)| {
            sum.received += reader.gaps().received;
            sum.lost += reader.gaps().lost;
            sum
        })
    }
}

impl<P: Ports> ProcessLoop for MapDrawing<P> {
    fn step(&mut self) -> Monotonic {
        if self.receive() {
            // The transforms notify nobody. The merged map does, and its readers then find the transforms.
            self.transforms.send(&self.merger.map_transforms());
            let merger = &mut self.merger;
            self.heartbeat.measure(|| merger.compose());
        }
        let complete = self.merged.send(self.merger.merged_tiles());
        self.transforms.refresh();
        let counters =
            HealthCounters { gaps: self.gaps(), refused: self.refused, ..HealthCounters::default() };
        self.heartbeat.publish_if_due(|| counters);
        let soon = Monotonic(self.clock.now().0 + MAP_PAUSE.as_nanos() as u64);
        if complete { self.heartbeat.due() } else { soon.min(self.heartbeat.due()) }
    }
}

impl<P: Ports> Listens<P::Listener> for MapDrawing<P> {
    fn listeners(&self) -> impl Iterator<Item = &P::Listener> {
        self.listeners.iter().chain([self.merged.requests()])
    }
}

/// Applies the estimate of the fleet's pose graph to every robot; returns how many maps could not be used.
fn apply_estimate(merger: &mut Merger, estimate: &FleetEstimate) -> u64 {
    let robots = RobotId::first(estimate.len()).zip(estimate);
    let refused = |(robot, (transform, map)): (RobotId, &(Option<Pose2>, _))| -> u64 {
        let map: &Option<Arc<msg::Grid>> = map;
        merger.apply_fleet_estimate(robot, *transform, map.as_ref()).is_err().into()
    };
    robots.map(refused).sum()
}

/// Tells where a robot has been since the last step: after the maps, so that what they show of it is not older. A
/// robot that is lost, or that has seen no scan yet, does not know. Nobody is woken for it: a peer's map is what shows a robot where it stands.
fn set_footprint<P: Ports>(
    merger: &mut Merger,
    robot: RobotId,
    reader: &mut P::Reader<Correction>,
    radius_m: f64,
) -> bool {
    let mut changed = false;
    while let Some(at) = reader.receive() {
        if at.state() != TrackingState::Lost && at.nodes > 0 {
            changed |= merger.set_robot_footprint(robot, at.map_from_base, radius_m);
        }
    }
    changed
}
