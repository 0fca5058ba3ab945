//! Runs a fleet in one process on virtual time: the components of the live processes, on queues in memory, called by a
//! scheduler. The same configuration and seed give the same messages, byte for byte, as fast as the machine goes.
//!
//! Of the components that could run at one moment, the first in a fixed order runs; with faults ([`faults`]), one drawn
//! from the seed. A step takes no time. The supervisor's decisions are the live ones. Clients of the bridge, the operator
//! first, are in the same process and exchange frames with it ([`client`]).

pub mod client;
mod drive_checks;
mod drivers;
pub mod faults;
mod headset;
mod injection;
pub mod invariants;
mod members;
pub mod memory_storage;
mod merged_map_check;
mod observer;
mod operator;
mod people;
pub mod queues;
mod replay;
mod room_plan;
mod tcp;

pub use client::Client;
pub use queues::MessageObserver;

use crate::channel::{self, Opener, Program};
use crate::config::FleetConfig;
use crate::ports::{Clock, Ports};
use crate::process::bridge::feeds::open_feeds;
use crate::process::record::Recording;
use crate::process::{Error, ProcessLoop};
use crate::processes::ProcessRow;
use crate::recording_files::RecordingFiles;
use crate::run::Run;
use crate::spare_time::JobExecutor;
use crate::world;
use crate::{session_records, sessions};
use ::bridge::Transport;
use ::headset::wireless::Link;
use ::recording::fleet::FleetRecording;
use faults::FaultPlan;
use formats::map_file::{MapFileError, write_map_with_reasons};
use members::{Member, World};
use memory_storage::MemoryStorage;
use msg::{FleetStats, GridView, MergeEdges, Monotonic, Pose2, RobotId, Role, SlamRequest, Stamp};
use observer::Observer;
use people::People;
use queues::{MemoryPorts, Network, Openings, QueueWriter};
use sim::Simulator;
use slam::Session;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::rc::Rc;
use tcp::Port;

/// Steps at one moment after which the fleet counts as stuck; a robot's busiest moment takes some dozens.
const STEPS_MAX: u32 = 100_000;

/// A fleet in lockstep.
pub struct Lockstep {
    world: World,
    members: Vec<Member>,
    people: People,
    observer: Observer,
    requests: Vec<QueueWriter<SlamRequest>>,
    /// When the supervisor looks next whether a process hangs.
    watch_due: Monotonic,
    /// The robot that was selected when the bridge was killed last.
    selected: Option<RobotId>,
    /// What did not hold when a process was started again.
    violations: Vec<String>,
    known: Vec<Option<Pose2>>,
    /// Known cells in each robot's session when its SLAM was killed last.
    saved: Vec<usize>,
    /// When a person last reset a robot's map.
    reset_at: Option<Monotonic>,
}

impl Lockstep {
    /// Builds the fleet. `together`: the operator drives all robots at once, not one after the other.
    ///
    /// # Errors
    /// The configuration's room, starts or sessions cannot be used.
    pub fn new(config: &FleetConfig, together: bool) -> Result<Self, Error> {
        Self::with_faults(config, together, FaultPlan::none())
    }

    /// Builds a fleet whose clients, also a headset in which the robots live, are behind a wireless link.
    ///
    /// The operator drives one robot after the other. Delays are drawn from the fleet's seed.
    ///
    /// # Errors
    /// As [`Lockstep::new`].
    pub fn behind_link(config: &FleetConfig, link: Link) -> Result<Self, Error> {
        let fleet = Self::new(config, false)?;
        fleet.world.port.set_link(link, config.fleet.seed);
        Ok(fleet)
    }

    /// Builds a fleet with injected faults.
    ///
    /// # Errors
    /// As [`Lockstep::new`].
    pub fn with_faults(config: &FleetConfig, together: bool, faults: FaultPlan) -> Result<Self, Error> {
        world::check(config)?;
        Self::with_operator(config, together, faults)
    }

    fn with_operator(config: &FleetConfig, together: bool, faults: FaultPlan) -> Result<Self, Error> {
        // Robots that explore have no other operator.
        let mut fleet = Self::open(config, together, faults, config.fleet.explore)?;
        if config.fleet.explore {
            fleet.people.operator.idle_until = Monotonic(u64::MAX);
        }
        Ok(fleet)
    }

    /// Builds a fleet with its navigation process, which nobody drives by hand: a client sends goals.
    ///
    /// # Errors
    /// As [`Lockstep::new`].
    pub fn with_navigation(config: &FleetConfig, faults: FaultPlan) -> Result<Self, Error> {
        world::check(config)?;
        let mut fleet = Self::open(config, true, faults, true)?;
        fleet.people.operator.idle_until = Monotonic(u64::MAX);
        Ok(fleet)
    }

    fn open(
        config: &FleetConfig,
        together: bool,
        faults: FaultPlan,
        has_navigation: bool,
    ) -> Result<Self, Error> {
        let network = Network::new(faults);
        let storage = MemoryStorage::new(&network);
        let mut run = Run::in_memory(config.clone())?;
        // The recorder is no process here: see `Lockstep::record`.
        run.config.recording.enabled = false;
        let port = Port::new(&network);
        let runs = |row: &ProcessRow| has_navigation || row.role != Role::Nav;
        let mut rows: Vec<_> = run.config.processes().filter(|(row, _)| runs(row)).collect();
        // Processes in the order of the data flow: what moves in the room, robots, SLAM, merging, figures, bridge.
        rows.sort_by_key(|(row, robot)| (row.role != Role::Objects, row.role, *robot));
        let asker = MemoryPorts::attach(&network, Opener::of_fleet(Program::SlamTool));
        let requests = run.robots().map(|robot| asker.writer(&channel::slam_request(robot)));
        Ok(Self {
            requests: requests.collect::<Result<_, _>>()?,
            observer: Observer::open(&network, &run)?,
            people: People::new(&network, &port, &run, together)?,
            members: rows.into_iter().map(|(row, robot)| Member::new(row, robot)).collect(),
            known: world::known_starts(config)?,
            watch_due: Monotonic(0),
            selected: None,
            violations: Vec::new(),
            saved: vec![0; config.fleet.robots],
            reset_at: None,
            world: World {
                run,
                network,
                storage,
                port,
                recording: None,
                sends_transforms: false,
                has_room: true,
            },
        })
    }

    /// Builds a fleet whose robots send what they sent when they were recorded, instead of simulated ones.
    ///
    /// # Errors
    /// As [`Lockstep::new`].
    pub fn replay(config: &FleetConfig, recording: FleetRecording) -> Result<Self, Error> {
        Self::replay_with(config, Rc::new(recording), false)
    }

    /// Builds a fleet like [`Lockstep::replay`] whose messages transports pass on: the robots send transforms, too.
    ///
    /// # Errors
    /// As [`Lockstep::new`].
    pub fn replay_for_transports(config: &FleetConfig, recording: Rc<FleetRecording>) -> Result<Self, Error> {
        Self::replay_with(config, recording, true)
    }

    /// Builds a fleet of recorded robots. Its time begins where the recording does.
    fn replay_with(
        config: &FleetConfig,
        recording: Rc<FleetRecording>,
        sends_transforms: bool,
    ) -> Result<Self, Error> {
        // What moved in the room is in the scans.
        let mut config = config.clone();
        config.sim.moving = sim::MovingConfig::default();
        let has_room = recording.has_room;
        config.fleet.furniture_zones &= has_room;
        match has_room {
            true => world::check(&config)?,
            false => sessions::check(&config)?,
        }
        let mut fleet = Self::with_operator(&config, false, FaultPlan::none())?;
        fleet.world.has_room = has_room;
        fleet.world.network.clock().set(fleet.world.run.epoch.moment(recording.begins()));
        (fleet.world.recording, fleet.world.sends_transforms) = (Some(recording), sends_transforms);
        Ok(fleet)
    }

    /// Opens feeds that pass the fleet's messages on to a transport. Call each after each tick.
    ///
    /// # Errors
    /// A channel cannot be opened.
    pub fn feeds<T: Transport + 'static>(
        &self,
        transport: &Rc<T>,
    ) -> Result<Vec<Box<dyn ProcessLoop>>, Error> {
        let opener = Opener { program: Role::Bridge.into(), robot: None };
        let ports = MemoryPorts::attach_observer(&self.world.network, opener);
        let feeds = open_feeds(&ports, &self.world.run, transport)?;
        Ok(feeds.into_iter().map(|feed| Box::new(feed) as Box<dyn ProcessLoop>).collect())
    }

    /// Begins to record all messages. Call [`Recording::step`] after each tick.
    ///
    /// # Errors
    /// A channel cannot be opened.
    pub fn record(&self, files: RecordingFiles) -> Result<Recording<MemoryPorts>, Error> {
        let ports = MemoryPorts::attach_observer(&self.world.network, Opener::of_fleet(Program::RecordTool));
        Recording::open(
            &ports,
            &self.world.run,
            files,
            |recorder| Ok(JobExecutor::Now(Box::new(recorder))),
            None,
        )
    }

    /// Runs the fleet for one tick of the simulators. `message_observer` receives every message.
    pub fn tick(&mut self, message_observer: MessageObserver<'_>) {
        let until = Monotonic(self.time().0 + Simulator::TICK.as_nanos() as u64);
        self.run_until(until);
        self.observer.poll();
        self.world.network.report_messages(message_observer);
    }

    /// Returns the run's time.
    pub fn now(&self) -> Stamp {
        self.world.run.epoch.stamp(self.time())
    }

    /// Returns the newest figures.
    pub fn stats(&self) -> &FleetStats {
        &self.observer.newest
    }

    /// Returns the newest edges between robots' maps.
    pub fn merge_edges(&self) -> &MergeEdges {
        self.observer.merge_edges()
    }

    /// Returns every map received so far, with its name.
    pub fn maps(&mut self) -> impl Iterator<Item = (&str, GridView<'_>)> {
        self.observer.maps().map(|(name, map, _)| (name, map))
    }

    /// Writes a map at the path without extension that `path` gives for its name, with the reasons why it is unreliable.
    ///
    /// # Errors
    /// A map cannot be written.
    pub fn write_maps(&mut self, path: impl Fn(&str) -> PathBuf) -> Result<(), MapFileError> {
        self.observer.maps().try_for_each(|(name, map, reasons)| {
            let reasons: Vec<&str> = reasons.iter().map(String::as_str).collect();
            write_map_with_reasons(&path(name), map, &reasons)
        })
    }

    /// Returns the session of every robot whose SLAM runs.
    pub fn sessions(&self) -> impl Iterator<Item = (RobotId, Session)> + '_ {
        self.members.iter().filter_map(|member| {
            let slam = &member.slam()?.process;
            Some((member.robot?, slam.back_end.session(&slam.front_end_loop.front_state())))
        })
    }

    /// Returns the session with which a later fleet would begin if this one were killed now; `None` if nothing was saved yet.
    pub fn saved_session(&self, robot: RobotId) -> Option<Session> {
        let (run, storage) = (&self.world.run, &self.world.storage);
        let path = sessions::file(&sessions::folder(run), robot);
        let saved = sessions::read(storage, &path, &sessions::identity(run, robot)).ok()?;
        Some(session_records::with_records(storage, &path, saved, &run.config.slam))
    }

    /// Returns the known start transform of each robot's map: `map` from `robotK/map`.
    pub fn known_starts(&self) -> &[Option<Pose2>] {
        &self.known
    }

    /// Creates a ros_tcp client of the fleet's bridge at an address.
    pub fn client(&self, peer: SocketAddr) -> Client {
        Client::new(&self.world.port, peer)
    }

    /// Returns which process has opened which channel.
    pub fn openings(&self) -> Openings {
        self.world.network.openings()
    }

    fn time(&self) -> Monotonic {
        self.world.network.clock().now()
    }

    /// Runs all that is due, in order of time, until this moment.
    fn run_until(&mut self, until: Monotonic) {
        let mut steps = 0;
        loop {
            self.apply_faults();
            self.supervise();
            self.world.network.notify_arrivals();
            self.world.port.deliver();
            if self.step_one() {
                steps += 1;
                assert!(steps < STEPS_MAX, "the fleet is stuck at {:?}", self.time());
                continue;
            }
            let next = self.next_moment().max(Monotonic(self.time().0 + 1));
            if next > until {
                self.world.network.clock().set(until.max(self.time()));
                return;
            }
            self.world.network.clock().set(next);
            steps = 0;
        }
    }

    /// Runs one step of one thread that is due; returns false if none is.
    fn step_one(&mut self) -> bool {
        let world = &self.world;
        let shuffled = world.network.faults().is_shuffled();
        let mut runnable = Vec::new();
        for (index, member) in self.members.iter_mut().enumerate() {
            for thread in 0..member.threads.len() {
                if member.is_runnable(thread, world) {
                    if !shuffled {
                        member.step(thread);
                        return true;
                    }
                    runnable.push((index, thread));
                }
            }
        }
        // The clients are the last in the fixed order, and one more choice otherwise.
        let people_act = self.people.due() <= world.network.clock().now();
        let count = runnable.len() + usize::from(people_act);
        if count == 0 {
            return false;
        }
        let chosen = if shuffled { world.network.faults().choose(count) } else { 0 };
        match runnable.get(chosen) {
            Some((index, thread)) => self.members[*index].step(*thread),
            None => self.people.step(),
        }
        true
    }

    /// Returns the next moment at which something is due.
    fn next_moment(&self) -> Monotonic {
        let now = self.time();
        let of_member = |member: &Member| {
            // Work that became due while it was stopped is done when it continues.
            member.threads.iter().map(|thread| thread.due).min().map(|due| due.max(member.frozen_until))
        };
        let members = self.members.iter().filter_map(of_member);
        let frozen = self.members.iter().map(|member| member.frozen_until).filter(|until| *until > now);
        let faults = self.world.network.faults();
        let network = [self.world.network.next_arrival(), faults.next_due(), faults.cut_until(now)];
        members
            .chain(frozen)
            .chain(self.people.request_due())
            .chain(network.into_iter().flatten())
            .chain(self.world.port.next_arrival())
            .chain([self.people.due(), self.supervisor_due()])
            .min()
            .unwrap_or(Monotonic(u64::MAX))
    }
}

#[cfg(test)]
mod tests;
