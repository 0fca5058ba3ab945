//! The telemetry process, which reads all figures and publishes the fleet's statistics once a second.
//!
//! Its loop takes the time at which each message arrives, so it does nothing that takes long: the metrics of the maps are
//! computed beside it ([`map_worker`]). They begin shortly before the statistics are due, and enter the next ones that are due when
//! they are ready; `maps_age_s` says how old their maps are.

pub mod map_worker;
#[cfg(test)]
mod tests;

use super::heartbeat::{HealthCounters, Heartbeat};
use super::{Error, Listens, ProcessLoop, serve};
use crate::channel;
use crate::clock::now;
use crate::config::RobotSource;
use crate::job_thread::{JobThread, JobWorker};
use crate::ports::{ChannelError, Clock as _, Ports, ReadMapPort, ReadPort, WritePort};
use crate::progress::WatchedThread;
use crate::run::Run;
use crate::stop::Stop;
use crate::world;
use ::telemetry::{MapChanges, MapFigures, Telemetry};
use map_worker::{MapHandover, MapWorker};
use msg::{
    FleetStats, GroundTruth, MapTransforms, Monotonic, PoseEstimate, ProcessHealth, RobotId, Role, TileMap,
    Transforms,
};
use std::time::Duration;

/// Period of the figures, nanoseconds.
const PERIOD_NS: u64 = 1_000_000_000;
/// Time before the figures at which the maps for them are taken: most comparisons are done by then.
const MAPS_LEAD: Duration = Duration::from_millis(200);

/// Runs the process until it is asked to stop.
pub fn run(run: &Run, stop: &Stop) -> Result<(), Error> {
    let participant = run.attach(Role::Telemetry, None)?;
    let progress = run.progress(Role::Telemetry, None, WatchedThread::Second);
    let worker = JobThread::start_watched(MapWorker::with_room_in_background(run)?, progress)?;
    let mut process = TelemetryProcess::open(&participant, run, worker, MAPS_LEAD)?;
    for (row, robot) in run.config.processes() {
        process.telemetry.expect_process(row.role, robot, now());
    }
    serve(&mut process, run.progress(Role::Telemetry, None, WatchedThread::Main), &|| stop.requested());
    Ok(())
}

/// Computes the fleet's figures from all that is published.
pub struct TelemetryProcess<P: Ports, W> {
    telemetry: Telemetry,
    maps: MapHandover<W>,
    inputs: Inputs<P>,
    stats: P::Writer<FleetStats>,
    heartbeat: Heartbeat<P>,
    clock: P::Clock,
    epoch: crate::clock::Epoch,
    due: Monotonic,
    /// Time before `due` at which maps are taken, nanoseconds, and whether those for the next figures were.
    maps_lead_ns: u64,
    are_maps_taken: bool,
}

impl<P: Ports, W: JobWorker<MapChanges, MapFigures>> TelemetryProcess<P, W> {
    /// Opens all channels; the first figures are due in a second. `map_worker` computes the metrics of the maps, which it gets
    /// `maps_lead` before the figures are due.
    pub fn open(ports: &P, run: &Run, map_worker: W, maps_lead: Duration) -> Result<Self, Error> {
        let heartbeat = Heartbeat::new(ports, run, Role::Telemetry, None)?;
        let starts = world::starts_in_room(run)?;
        let clock = ports.clock();
        let mut telemetry = Telemetry::new(run.config.fleet.robots, &starts, clock.now());
        if run.config.world == RobotSource::Robots {
            telemetry.set_lost_scans_unknown();
        }
        Ok(Self {
            telemetry,
            maps: MapHandover::new(map_worker),
            inputs: Inputs::open(ports, run)?,
            stats: ports.writer(&channel::stats())?,
            heartbeat,
            due: Monotonic(clock.now().0 + PERIOD_NS),
            clock,
            epoch: run.epoch,
            maps_lead_ns: maps_lead.as_nanos() as u64,
            are_maps_taken: false,
        })
    }
}

impl<P: Ports, W> TelemetryProcess<P, W> {
    /// Returns when maps are to be taken for the figures, or when those are due if they were.
    fn maps_due(&self) -> Monotonic {
        let lead_ns = if self.are_maps_taken { 0 } else { self.maps_lead_ns };
        Monotonic(self.due.0.saturating_sub(lead_ns))
    }
}

impl<P: Ports, W: JobWorker<MapChanges, MapFigures>> ProcessLoop for TelemetryProcess<P, W> {
    fn step(&mut self) -> Monotonic {
        let received = self.clock.now();
        self.inputs.receive_streams(&mut self.telemetry, received);
        if !self.are_maps_taken && received >= self.maps_due() {
            self.inputs.receive_states(&mut self.telemetry, received);
            self.maps.hand_over(&mut self.telemetry, received, || self.inputs.take_map_changes());
            self.are_maps_taken = true;
        }
        if received >= self.due {
            self.inputs.receive_states(&mut self.telemetry, received);
            self.maps.receive(&mut self.telemetry);
            let stamp = self.epoch.stamp(received);
            let stats = self.heartbeat.measure(|| self.telemetry.compute_stats(stamp, received));
            self.stats.send(stats);
            self.due = Monotonic((self.due.0 + PERIOD_NS).max(received.0));
            self.are_maps_taken = false;
        }
        self.heartbeat.publish_if_due(HealthCounters::default);
        self.maps_due()
    }
}

impl<P: Ports, W> Listens<P::Listener> for TelemetryProcess<P, W> {
    fn listeners(&self) -> impl Iterator<Item = &P::Listener> {
        self.inputs.listeners.iter()
    }
}

/// Channels of one robot that telemetry reads.
struct RobotInputs<P: Ports> {
    robot: RobotId,
    transforms: P::Reader<Transforms>,
    pose_estimates: P::Reader<PoseEstimate>,
    truths: P::Reader<GroundTruth>,
    map: MapInput<P>,
}

/// A map that telemetry reads.
struct MapInput<P: Ports> {
    reader: P::MapReader,
    /// A new version was received since the last one was handed over.
    changed: bool,
}

impl<P: Ports> MapInput<P> {
    fn new(reader: P::MapReader) -> Self {
        Self { reader, changed: false }
    }

    /// Returns the newest version if it was not handed over yet. A copy shares the tiles.
    fn take_changed(&mut self) -> Option<TileMap> {
        std::mem::take(&mut self.changed).then(|| self.reader.map().clone())
    }
}

/// Channels that telemetry reads.
struct Inputs<P: Ports> {
    robots: Vec<RobotInputs<P>>,
    merged_map: MapInput<P>,
    map_transforms: P::Reader<MapTransforms>,
    newest_map_transforms: MapTransforms,
    health: Vec<P::Reader<ProcessHealth>>,
    /// Listeners of all channels whose time of arrival is measured.
    listeners: Vec<P::Listener>,
}

impl<P: Ports> Inputs<P> {
    fn open(ports: &P, run: &Run) -> Result<Self, ChannelError> {
        let robot_inputs = |robot| {
            Ok(RobotInputs {
                robot,
                transforms: ports.reader(&channel::transforms(robot))?,
                pose_estimates: ports.reader(&channel::pose_estimate(robot))?,
                truths: ports.reader(&channel::truth(robot))?,
                map: MapInput::new(ports.map_reader(&channel::map(robot))?),
            })
        };
        let health = run
            .config
            .processes()
            .map(|(row, robot)| ports.reader(&channel::process_health(row.role, robot)));
        let mut listeners = Vec::new();
        for robot in run.robots() {
            listeners.push(ports.listener(&channel::transforms(robot))?);
            listeners.push(ports.listener(&channel::pose_estimate(robot))?);
            listeners.push(ports.listener(&channel::map(robot))?);
        }
        Ok(Self {
            robots: run.robots().map(robot_inputs).collect::<Result<_, ChannelError>>()?,
            merged_map: MapInput::new(ports.map_reader(&channel::merged_map())?),
            map_transforms: ports.reader(&channel::map_transforms())?,
            newest_map_transforms: MapTransforms::default(),
            health: health.collect::<Result<_, _>>()?,
            listeners,
        })
    }

    fn receive_streams(&mut self, telemetry: &mut Telemetry, received: Monotonic) {
        for RobotInputs { robot, transforms, pose_estimates, truths, .. } in &mut self.robots {
            while let Some(truth) = truths.receive() {
                telemetry.add_truth(*robot, &truth);
            }
            while let Some(transforms) = transforms.receive() {
                telemetry.add_transforms(*robot, &transforms, received);
            }
            while let Some(pose_estimate) = pose_estimates.receive() {
                telemetry.add_pose_estimate(*robot, &pose_estimate, received);
            }
        }
        // Maps come last, as their cells are copied.
        for RobotInputs { robot, map, .. } in &mut self.robots {
            if map.reader.poll() {
                telemetry.record_map_arrival(*robot, map.reader.map().header.scan_sent, received);
                map.changed = true;
            }
        }
        // Reading it here keeps its queue from overflowing.
        self.merged_map.changed |= self.merged_map.reader.poll();
    }

    fn receive_states(&mut self, telemetry: &mut Telemetry, received: Monotonic) {
        if let Some(transforms) = self.map_transforms.newest() {
            self.newest_map_transforms = *transforms;
            telemetry.update_map_transforms(&transforms);
        }
        for health in &mut self.health {
            while let Some(report) = health.receive() {
                telemetry.add_process_health(&report, received);
            }
        }
    }

    /// Returns the maps that have changed since the last call.
    fn take_map_changes(&mut self) -> MapChanges {
        let robots = self.robots.iter_mut();
        MapChanges {
            robots: robots.filter_map(|of| Some((of.robot, of.map.take_changed()?))).collect(),
            merged: self.merged_map.take_changed(),
            map_transforms: self.newest_map_transforms,
        }
    }
}
