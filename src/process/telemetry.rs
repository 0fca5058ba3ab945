//! The telemetry process, which reads all figures and publishes the fleet's statistics once a second.

use super::heartbeat::{HealthCounters, Heartbeat};
use super::{Error, Listens, PLAN_RESOLUTION_M, ProcessLoop, serve};
use crate::channel;
use crate::clock::now;
use crate::config::{FleetConfig, RobotSource};
use crate::fleet::{self, FleetError};
use crate::ports::{ChannelError, Clock as _, Ports, ReadMapPort, ReadPort, WritePort};
use crate::progress::WatchedThread;
use crate::realtime::lower_priority;
use crate::run::Run;
use crate::stop::Stop;
use crate::time_slice;
use ::telemetry::Telemetry;
use msg::{
    DenseMap, FleetStats, Grid, GroundTruth, MapTransforms, Monotonic, PoseEstimate, ProcessHealth, RobotId,
    Role, Transforms,
};
use std::sync::mpsc::{Receiver, sync_channel};

/// Period of the figures, nanoseconds.
const PERIOD_NS: u64 = 1_000_000_000;
/// Priority of the thread that draws the room's plan (nice(2)): a tenth of the share of others, where they need the processor.
const ROOM_NICE: i32 = 10;

/// Runs the process until it is asked to stop.
pub fn run(run: &Run, stop: &Stop) -> Result<(), Error> {
    let participant = run.attach(Role::Telemetry, None)?;
    let mut process = TelemetryProcess::open(&participant, run, None)?;
    process.awaited_room = draw_room_in_background(run);
    for (row, robot) in run.config.processes() {
        process.telemetry.expect_process(row.role, robot, now());
    }
    serve(&mut process, run.progress(Role::Telemetry, None, WatchedThread::Main), &|| stop.requested());
    Ok(())
}

/// Draws the room's plan on a thread of low priority, and returns where it comes. The plan takes as much processor time as the
/// start of the whole fleet, and nobody needs it before there is a map.
fn draw_room_in_background(run: &Run) -> Option<Receiver<Grid>> {
    let (config, (sender, receiver)) = (run.config.clone(), sync_channel(1));
    let draw = move || {
        time_slice::request_default();
        lower_priority(ROOM_NICE);
        match room_plan(&config) {
            Ok(Some(plan)) => drop(sender.send(plan)),
            Ok(None) => {}
            Err(why) => tracing::warn!("telemetry: no coverage and no errors of the maps: {why}"),
        }
    };
    std::thread::Builder::new().name("room".into()).spawn(draw).ok().map(|_| receiver)
}

/// Returns the plan of a simulated room, frame `world`. Other worlds have none.
pub fn room_plan(config: &FleetConfig) -> Result<Option<Grid>, FleetError> {
    match config.world {
        RobotSource::Simulator => {
            let room = fleet::room(config)?;
            let starts_m: Vec<_> =
                fleet::starts(config, &room)?.iter().map(|start| [start.x_m, start.y_m]).collect();
            Ok(Some(room.floor_plan_from(PLAN_RESOLUTION_M, &starts_m)))
        }
        RobotSource::Headset | RobotSource::Ros | RobotSource::Robots => Ok(None),
    }
}

/// Computes the fleet's figures from all that is published.
pub struct TelemetryProcess<P: Ports> {
    telemetry: Telemetry,
    /// Where the room's plan comes, until it has come.
    awaited_room: Option<Receiver<Grid>>,
    inputs: Inputs<P>,
    stats: P::Writer<FleetStats>,
    heartbeat: Heartbeat<P>,
    clock: P::Clock,
    epoch: crate::clock::Epoch,
    due: Monotonic,
}

impl<P: Ports> TelemetryProcess<P> {
    /// Opens all channels; the first figures are due in a second. They have no coverage without the room's `plan`, frame `world`.
    pub fn open(ports: &P, run: &Run, plan: Option<Grid>) -> Result<Self, Error> {
        let heartbeat = Heartbeat::new(ports, run, Role::Telemetry, None)?;
        let starts = fleet::starts_in_room(&run.config)?;
        let clock = ports.clock();
        Ok(Self {
            telemetry: Telemetry::new(run.config.fleet.robots, plan, &starts),
            awaited_room: None,
            inputs: Inputs::open(ports, run)?,
            stats: ports.writer(&channel::stats())?,
            heartbeat,
            due: Monotonic(clock.now().0 + PERIOD_NS),
            clock,
            epoch: run.epoch,
        })
    }
}

impl<P: Ports> TelemetryProcess<P> {
    /// Takes the room's plan if it has come.
    fn receive_room(&mut self) {
        let Some(plan) = self.awaited_room.as_ref().and_then(|room| room.try_recv().ok()) else { return };
        self.telemetry.set_room(plan);
        self.awaited_room = None;
    }
}

impl<P: Ports> ProcessLoop for TelemetryProcess<P> {
    fn step(&mut self) -> Monotonic {
        let received = self.clock.now();
        self.inputs.receive_streams(&mut self.telemetry, received);
        if received >= self.due {
            self.receive_room();
            self.inputs.receive_states(&mut self.telemetry, received);
            let stamp = self.epoch.stamp(received);
            let stats = self.heartbeat.measure(|| self.telemetry.compute_stats(stamp, received));
            self.stats.send(stats);
            self.due = Monotonic((self.due.0 + PERIOD_NS).max(received.0));
        }
        self.heartbeat.publish_if_due(HealthCounters::default);
        self.due
    }
}

impl<P: Ports> Listens<P::Listener> for TelemetryProcess<P> {
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
    /// A new version was received since the last figures.
    changed: bool,
    grid: DenseMap,
}

impl<P: Ports> MapInput<P> {
    fn new(reader: P::MapReader) -> Self {
        Self { reader, changed: false, grid: DenseMap::default() }
    }
}

/// Channels that telemetry reads.
struct Inputs<P: Ports> {
    robots: Vec<RobotInputs<P>>,
    merged_map: MapInput<P>,
    map_transforms: P::Reader<MapTransforms>,
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
            health: health.collect::<Result<_, _>>()?,
            listeners,
        })
    }

    fn receive_streams(&mut self, telemetry: &mut Telemetry, received: Monotonic) {
        for RobotInputs { robot, transforms, pose_estimates, truths, map } in &mut self.robots {
            while let Some(truth) = truths.receive() {
                telemetry.add_truth(*robot, &truth);
            }
            while let Some(transforms) = transforms.receive() {
                telemetry.add_transforms(*robot, &transforms, received);
            }
            while let Some(pose_estimate) = pose_estimates.receive() {
                telemetry.add_pose_estimate(*robot, &pose_estimate, received);
            }
            if map.reader.poll() {
                telemetry.record_map_arrival(*robot, map.reader.map().header.scan_sent, received);
                map.changed = true;
            }
        }
        // It is evaluated with the figures; reading it here keeps its queue from overflowing.
        self.merged_map.changed |= self.merged_map.reader.poll();
    }

    fn receive_states(&mut self, telemetry: &mut Telemetry, received: Monotonic) {
        if let Some(transforms) = self.map_transforms.newest() {
            telemetry.update_map_transforms(&transforms);
        }
        for RobotInputs { robot, map, .. } in &mut self.robots {
            if std::mem::take(&mut map.changed) {
                telemetry.update_map(*robot, map.grid.update(map.reader.map()));
            }
        }
        let map = &mut self.merged_map;
        if std::mem::take(&mut map.changed) {
            telemetry.update_merged_map(map.grid.update(map.reader.map()), received);
        }
        for health in &mut self.health {
            while let Some(report) = health.receive() {
                telemetry.add_process_health(&report, received);
            }
        }
    }
}
