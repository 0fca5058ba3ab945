//! The process of moving objects: people, doors and boxes of the simulated room, 20 times a second.
//!
//! It reads where the robots truly are, and every simulator reads where the objects are: all robots are in the same room. While it does
//! not run, people and doors stand. A restarted one goes on from the file that the one before has written in each tick.

use super::heartbeat::{HealthCounters, Heartbeat};
use super::{Error, Listens, ProcessLoop, serve};
use crate::channel;
use crate::clock::Epoch;
use crate::ports::{Clock as _, Ports, ReadPort, WritePort};
use crate::progress::WatchedThread;
use crate::run::Run;
use crate::stop::Stop;
use crate::storage::{DiskStorage, Storage};
use crate::world;
use msg::{GroundTruth, Monotonic, MovingObjects, Pose2, Role, Stamp};
use sim::ObjectSimulator;
use std::path::PathBuf;
use std::time::Duration;

/// Name of the file with the newest message, in the run's runtime folder, which is as a rule in memory.
const FILE: &str = "objects";
/// Delay after which a process skips the missed ticks instead of catching up.
const BEHIND_MAX_S: f64 = 0.1;
/// Time for which a restarted process waits for the poses of all robots: those of a dead simulator do not come.
const WAIT_MAX: Duration = Duration::from_secs(1);

/// Runs the process until it is asked to stop.
pub fn run(run: &Run, stop: &Stop) -> Result<(), Error> {
    let participant = run.attach(Role::Objects, None)?;
    let mut process = ObjectsProcess::open(&participant, run, DiskStorage)?;
    serve(&mut process, run.progress(Role::Objects, None, WatchedThread::Main), &|| stop.requested());
    Ok(())
}

/// The simulation of moving objects with its channels.
// More than 12 fields: the simulation, what it reads and writes, and when it is due.
pub struct ObjectsProcess<P: Ports, S> {
    objects: ObjectSimulator,
    truths: Vec<P::Reader<GroundTruth>>,
    /// Newest pose of each robot, in `world`; `None` before the first of them in a restarted process.
    robots: Vec<Option<Pose2>>,
    writer: P::Writer<MovingObjects>,
    message: Box<MovingObjects>,
    /// Time of the next tick.
    next: Stamp,
    /// Until when it waits for the robots' poses.
    wait_until: Monotonic,
    storage: S,
    file: PathBuf,
    /// Whether the log says already that the file cannot be written.
    has_warned: bool,
    heartbeat: Heartbeat<P>,
    clock: P::Clock,
    epoch: Epoch,
    refused: u64,
}

impl<P: Ports, S: Storage> ObjectsProcess<P, S> {
    /// Opens the channels, and goes on from what an earlier process of this run has written.
    ///
    /// # Errors
    /// The configuration's room or starts cannot be used, or a channel cannot be opened.
    pub fn open(ports: &P, run: &Run, storage: S) -> Result<Self, Error> {
        let heartbeat = Heartbeat::new(ports, run, Role::Objects, None)?;
        let config = &run.config;
        let room = world::room(config)?;
        let starts = world::starts(config, &room)?;
        let mut objects = ObjectSimulator::new(&room, &config.sim.moving, &starts, config.fleet.seed);
        let (wished, found) = (config.sim.moving, objects.counts());
        if found != wished {
            tracing::warn!("{}: it has no place for the others", found.text_of(&wished));
        }
        let file = run.domain.root().join(FILE);
        let saved = read(&storage, &file, run.begun);
        let robots = match &saved {
            Some(saved) => {
                objects.resume(saved);
                vec![None; starts.len()]
            }
            None => starts.into_iter().map(Some).collect(),
        };
        let clock = ports.clock();
        let now = clock.now();
        let truths = run.robots().map(|robot| ports.reader(&channel::truth(robot)));
        let mut process = Self {
            objects,
            truths: truths.collect::<Result<_, _>>()?,
            robots,
            writer: ports.writer(&channel::moving_objects())?,
            message: Box::default(),
            next: Stamp(0),
            wait_until: now + WAIT_MAX,
            storage,
            file,
            has_warned: false,
            heartbeat,
            clock,
            epoch: run.epoch,
            refused: 0,
        };
        process.message.header.incarnation = run.begun.0;
        process.skip_to(now);
        Ok(process)
    }

    /// Lets the next tick be the first whole one from a moment on.
    fn skip_to(&mut self, now: Monotonic) {
        let tick_ns = ObjectSimulator::TICK.as_nanos() as i64;
        let since_ns = self.epoch.stamp(now).0;
        self.next = Stamp((since_ns + tick_ns - 1).div_euclid(tick_ns) * tick_ns);
    }

    fn receive_poses(&mut self) {
        for (reader, pose) in self.truths.iter_mut().zip(&mut self.robots) {
            let Some(truth) = reader.newest() else { continue };
            match truth.world_from_base.is_finite() {
                true => *pose = Some(truth.world_from_base),
                false => self.refused += 1,
            }
        }
    }

    fn tick(&mut self) {
        self.objects.advance(self.robots.iter().copied().flatten());
        self.objects.write(&mut self.message);
        self.message.header.stamp = self.next;
        self.writer.send(&self.message);
        self.save();
        self.next = self.next + ObjectSimulator::TICK;
    }

    /// Writes the message for the process after this one.
    fn save(&mut self) {
        let written = self.storage.replace(&self.file, bytemuck::bytes_of(&*self.message));
        if let Err(why) = &written
            && !self.has_warned
        {
            let path = self.file.display();
            tracing::warn!(
                "{path}: {why}; until it can be written, restarted people and boxes are where they were before"
            );
        }
        self.has_warned = written.is_err();
    }
}

/// Reads the newest message of an earlier process of the run that has begun at this moment.
fn read(storage: &impl Storage, file: &std::path::Path, begun: Monotonic) -> Option<MovingObjects> {
    let bytes = storage.read(file, size_of::<MovingObjects>() as u64).ok()?;
    let message: MovingObjects = bytemuck::try_pod_read_unaligned(&bytes).ok()?;
    (message.header.incarnation == begun.0).then_some(message)
}

impl<P: Ports, S: Storage> ProcessLoop for ObjectsProcess<P, S> {
    fn step(&mut self) -> Monotonic {
        let now = self.clock.now();
        let due = self.epoch.moment(self.next);
        if now < due {
            return due;
        }
        self.heartbeat.record_lateness(due);
        self.receive_poses();
        if self.epoch.stamp(now) - self.next > BEHIND_MAX_S {
            self.skip_to(now);
        }
        if now < self.wait_until && self.robots.contains(&None) {
            self.next = self.next + ObjectSimulator::TICK;
        } else {
            self.tick();
            self.heartbeat.record_work(self.clock.now().since(now));
        }
        let refused = self.refused;
        self.heartbeat.publish_if_due(|| HealthCounters { refused, ..HealthCounters::default() });
        self.epoch.moment(self.next)
    }
}

impl<P: Ports, S> Listens<P::Listener> for ObjectsProcess<P, S> {
    fn listeners(&self) -> impl Iterator<Item = &P::Listener> {
        std::iter::empty()
    }
}
