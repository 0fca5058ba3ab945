//! The fleet's figures: listens to everything, says once a second how it goes.

use super::pulse::{Account, Pulse};
use super::{Error, PLAN_RESOLUTION_M};
use crate::channel;
use crate::clock::now;
use crate::config::World;
use crate::fleet;
use crate::ports::{ChannelError, ReadMapPort};
use crate::processes;
use crate::run::Run;
use crate::shared_memory::{Listener, MapReader, Participant, Reader, wait};
use crate::stop::Stop;
use ::telemetry::Telemetry;
use msg::{
    Correction, DenseMap, GroundTruth, MapTransforms, Monotonic, ProcessHealth, RobotId, Role, Transforms,
};

/// How often the figures are sent.
const PERIOD_NS: u64 = 1_000_000_000;

pub fn run(run: &Run, stop: &Stop) -> Result<(), Error> {
    let node = run.attach(Role::Telemetry, None)?;
    let mut pulse = Pulse::new(&node, run, Role::Telemetry, None)?;
    let plan = match run.config.world {
        World::Simulator => Some(fleet::room(&run.config)?.floor_plan(PLAN_RESOLUTION_M)),
        World::Headset | World::Ros => None,
    };
    let starts = fleet::true_starts(&run.config)?;

    let mut telemetry = Telemetry::new(run.config.fleet.robots, plan, &starts);
    // Only now, so that nothing waits unread while the room is built.
    let mut inputs = Inputs::open(&node, run)?;
    let bells = Inputs::bells(&node, run)?;
    let mut stats = node.writer(&channel::stats())?;
    let mut due = Monotonic(now().0 + PERIOD_NS);
    while !stop.requested() {
        wait(&bells, due);
        let received = now();
        inputs.streams(&mut telemetry, received);
        if received >= due {
            inputs.states(&mut telemetry, received);
            let stamp = run.epoch.stamp(received);
            stats.send(pulse.work(|| telemetry.compute_stats(stamp, received)));
            due = Monotonic((due.0 + PERIOD_NS).max(received.0));
        }
        pulse.beat(Account::default);
    }
    Ok(())
}

/// What telemetry reads of one robot.
struct RobotInputs {
    robot: RobotId,
    transforms: Reader<Transforms>,
    corrections: Reader<Correction>,
    truths: Reader<GroundTruth>,
    maps: MapReader,
    /// A map has come since the last figures.
    news: bool,
    grid: DenseMap,
}

/// What telemetry reads.
struct Inputs {
    robots: Vec<RobotInputs>,
    merged_map: MapReader,
    merged_news: bool,
    merged_grid: DenseMap,
    map_transforms: Reader<MapTransforms>,
    beats: Vec<Reader<ProcessHealth>>,
}

impl Inputs {
    fn open(node: &Participant, run: &Run) -> Result<Self, ChannelError> {
        let robot_inputs = |robot| {
            Ok(RobotInputs {
                robot,
                transforms: node.reader(&channel::transforms(robot))?,
                corrections: node.reader(&channel::correction(robot))?,
                truths: node.reader(&channel::truth(robot))?,
                maps: node.map_reader(&channel::map(robot))?,
                news: false,
                grid: DenseMap::default(),
            })
        };
        let beats = processes::of_fleet(&run.config)
            .map(|(row, robot)| node.reader(&channel::process_health(row.role, robot)));
        Ok(Self {
            robots: run.robots().map(robot_inputs).collect::<Result<_, ChannelError>>()?,
            merged_map: node.map_reader(&channel::merged_map())?,
            merged_news: false,
            merged_grid: DenseMap::default(),
            map_transforms: node.reader(&channel::map_transforms())?,
            beats: beats.collect::<Result<_, _>>()?,
        })
    }

    /// Whatever must be noted the moment it comes.
    fn bells(node: &Participant, run: &Run) -> Result<Vec<Listener>, ChannelError> {
        let mut bells = Vec::new();
        for robot in run.robots() {
            bells.push(node.listener(&channel::transforms(robot))?);
            bells.push(node.listener(&channel::correction(robot))?);
            bells.push(node.listener(&channel::map(robot))?);
        }
        Ok(bells)
    }

    fn streams(&mut self, telemetry: &mut Telemetry, received: Monotonic) {
        for RobotInputs { robot, transforms, corrections, truths, maps, news, .. } in &mut self.robots {
            while let Some(truth) = truths.receive() {
                telemetry.add_truth(*robot, &truth);
            }
            while let Some(transforms) = transforms.receive() {
                telemetry.add_transforms(*robot, &transforms, received);
            }
            while let Some(correction) = corrections.receive() {
                telemetry.add_correction(*robot, &correction, received);
            }
            if maps.poll() {
                telemetry.record_map_arrival(*robot, maps.map().header.scan_sent, received);
                *news = true;
            }
        }
        // It has its turn at the figures, but must not fall behind.
        self.merged_news |= self.merged_map.poll();
    }

    fn states(&mut self, telemetry: &mut Telemetry, received: Monotonic) {
        if let Some(map_transforms) = self.map_transforms.newest() {
            telemetry.map_transforms(&map_transforms);
        }
        for RobotInputs { robot, maps, news, grid, .. } in &mut self.robots {
            if std::mem::take(news) {
                telemetry.update_map(*robot, grid.update(maps.map()));
            }
        }
        if std::mem::take(&mut self.merged_news) {
            telemetry.update_merged_map(self.merged_grid.update(self.merged_map.map()), received);
        }
        for beats in &mut self.beats {
            while let Some(beat) = beats.receive() {
                telemetry.process_health(&beat, received);
            }
        }
    }
}
