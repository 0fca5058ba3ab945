//! Runs a fleet in one process on virtual time: the components of the live processes, on queues in memory, called by a
//! scheduler. The same configuration and seed give the same messages, byte for byte, as fast as the machine goes.
//!
//! Of the components that could run at one moment, the first in a fixed order runs; with faults ([`faults`]), one drawn
//! from the seed. A step takes no time. The supervisor's decisions are the live ones. Clients of the bridge, the operator
//! first, are in the same process and exchange frames with it ([`client`]).

pub mod client;
mod command;
pub mod faults;
pub mod invariants;
mod members;
mod memory_storage;
mod operator;
pub mod queues;
mod tcp;

pub use client::Client;
pub use command::{LockstepArgs, run};
pub use queues::MessageObserver;

use crate::channel::{self, Opener, Program};
use crate::config::FleetConfig;
use crate::fleet;
use crate::ports::{ChannelError, Clock, Ports, ReadMapPort, ReadPort, WritePort};
use crate::process::Error;
use crate::processes;
use crate::run::Run;
use faults::{Fault, FaultPlan};
use members::{Member, World};
use memory_storage::MemoryStorage;
use msg::{
    Correction, DenseMap, FleetStats, GridView, GroundTruth, Monotonic, Pose2, RobotId, Role, SlamRequest,
    SlamRequestKind, Stamp,
};
use operator::Operator;
use queues::{MemoryPorts, Network, Openings, QueueMapReader, QueueReader, QueueWriter};
use sim::Simulator;
use slam::Session;
use std::net::SocketAddr;
use std::rc::Rc;
use tcp::Port;

/// Steps at one moment after which the fleet counts as stuck; a robot's busiest moment takes some dozens.
const STEPS_MAX: u32 = 100_000;

/// A fleet in lockstep.
pub struct Lockstep {
    world: World,
    members: Vec<Member>,
    operator: Operator,
    observer: Observer,
    requests: Vec<QueueWriter<SlamRequest>>,
    /// People's requests that are due later: `Resume` after `Pause`.
    resume_at: Vec<(Monotonic, RobotId)>,
    known: Vec<Option<Pose2>>,
    /// Known cells in each robot's session when its SLAM was killed last.
    saved: Vec<usize>,
}

/// The fleet's figures and maps, as the launcher and clients receive them.
struct Observer {
    stats: QueueReader<FleetStats>,
    newest: Box<FleetStats>,
    maps: Vec<(String, QueueMapReader, DenseMap)>,
    robots: Vec<LastSeen>,
}

/// Newest pose that was received from a robot.
struct LastSeen {
    truths: QueueReader<GroundTruth>,
    corrections: QueueReader<Correction>,
    world_from_base: Option<Pose2>,
    map_from_odom: Option<Pose2>,
    map_from_base: Option<Pose2>,
}

impl Lockstep {
    /// Builds the fleet. `together`: the operator drives all robots at once, not one after the other.
    ///
    /// # Errors
    /// The configuration's room, starts or sessions cannot be used.
    pub fn new(config: &FleetConfig, together: bool) -> Result<Self, Error> {
        Self::with_faults(config, together, FaultPlan::none())
    }

    /// Builds a fleet with injected faults.
    ///
    /// # Errors
    /// As [`Lockstep::new`].
    pub fn with_faults(config: &FleetConfig, together: bool, faults: FaultPlan) -> Result<Self, Error> {
        fleet::check(config)?;
        let network = Network::new(faults);
        let storage = MemoryStorage::new(&network);
        let run = Run::in_memory(config.clone())?;
        let port = Port::new(&network);
        let mut rows: Vec<_> = processes::of_fleet(config).collect();
        // Processes in the order of the data flow: robots, SLAM, merging, figures, bridge.
        rows.sort_by_key(|(row, robot)| (row.role, *robot));
        let asker = MemoryPorts::attach(&network, Opener::of_fleet(Program::SlamTool));
        let requests = run.robots().map(|robot| asker.writer(&channel::slam_request(robot)));
        Ok(Self {
            requests: requests.collect::<Result<_, _>>()?,
            observer: Observer::open(&network, &run)?,
            operator: Operator::new(&network, &port, &run, together),
            members: rows.into_iter().map(|(row, robot)| Member::new(row, robot)).collect(),
            known: fleet::known_starts(config)?,
            resume_at: Vec::new(),
            saved: vec![0; config.fleet.robots],
            world: World { run, network, storage, port },
        })
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

    /// Returns every map received so far, with its name.
    pub fn maps(&mut self) -> impl Iterator<Item = (&str, GridView<'_>)> {
        let seen =
            self.observer.maps.iter_mut().filter(|(_, reader, _)| reader.map().tiles().next().is_some());
        seen.map(|(name, reader, grid)| (name.as_str(), grid.update(reader.map())))
    }

    /// Returns the session of every robot whose SLAM runs.
    pub fn sessions(&self) -> impl Iterator<Item = (RobotId, Session)> + '_ {
        self.members.iter().filter_map(|member| {
            let slam = &member.slam()?.process;
            Some((member.robot?, slam.back_end.session(&slam.scan_path.front_state())))
        })
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
        // The operator is the last in the fixed order, and one more choice otherwise.
        let operator_acts = self.operator.due <= world.network.clock().now();
        let count = runnable.len() + usize::from(operator_acts);
        if count == 0 {
            return false;
        }
        let chosen = if shuffled { world.network.faults().choose(count) } else { 0 };
        match runnable.get(chosen) {
            Some((index, thread)) => self.members[*index].step(*thread),
            None => self.operator.step(),
        }
        true
    }

    /// Returns the next moment at which something is due.
    fn next_moment(&self) -> Monotonic {
        let now = self.time();
        let of_member = |member: &Member| {
            let threads = member.threads.iter().map(|thread| thread.due).min();
            let restart = match member.policy.state() {
                crate::supervisor::restarts::State::Waiting { until } => Some(until),
                _ => None,
            };
            // Work that became due while it was stopped is done when it continues.
            threads.map(|due| due.max(member.frozen_until)).into_iter().chain(restart).min()
        };
        let resume = self.resume_at.iter().map(|(at, _)| *at);
        let members = self.members.iter().filter_map(of_member);
        let frozen = self.members.iter().map(|member| member.frozen_until).filter(|until| *until > now);
        let faults = self.world.network.faults();
        let network = [self.world.network.next_arrival(), faults.next_due(), faults.cut_until(now)];
        members
            .chain(frozen)
            .chain(resume)
            .chain(network.into_iter().flatten())
            .chain([self.operator.due])
            .min()
            .unwrap_or(Monotonic(u64::MAX))
    }

    /// Starts the processes that are due, as the live supervisor does.
    fn supervise(&mut self) {
        let now = self.time();
        for member in &mut self.members {
            if !member.policy.is_due(now) {
                continue;
            }
            let at = member.robot.and_then(|robot| self.observer.last_seen(member.row.role, robot));
            if let Err(why) = member.start(&self.world, at) {
                eprintln!("cannot start the {}: {why}", member.row.title(member.robot));
                member.policy.on_death(now);
            }
        }
    }

    /// Injects the faults that are due.
    fn apply_faults(&mut self) {
        let now = self.time();
        while let Some(position) = self.resume_at.iter().position(|(at, _)| *at <= now) {
            let (_, robot) = self.resume_at.remove(position);
            self.request(robot, SlamRequestKind::Resume);
        }
        loop {
            let Some(fault) = self.world.network.faults().take_due(now) else { return };
            let robots = self.world.run.config.fleet.robots;
            let robot = |chosen: usize| RobotId::new(chosen % robots + 1);
            match fault {
                Fault::Kill(chosen) => {
                    let index = chosen % self.members.len();
                    self.observer.poll();
                    self.record_saved_map(index);
                    self.members[index].kill(now);
                }
                Fault::Freeze(chosen, duration) => {
                    let index = chosen % self.members.len();
                    self.members[index].frozen_until = now + duration;
                }
                Fault::ClockStep(duration) => self.world.network.clock().set(now + duration),
                Fault::LetGo(duration) => self.operator.idle_until = now + duration,
                Fault::ResetMap(chosen) => {
                    let Some(robot) = robot(chosen) else { continue };
                    self.saved[robot.index()] = 0;
                    self.request(robot, SlamRequestKind::Reset);
                }
                Fault::Pause(chosen, duration) => {
                    let Some(robot) = robot(chosen) else { continue };
                    self.request(robot, SlamRequestKind::Pause);
                    self.resume_at.push((now + duration, robot));
                }
            }
        }
    }

    /// Records, before a SLAM process is killed, how much of its map the restarted one must know again.
    fn record_saved_map(&mut self, index: usize) {
        let member = &self.members[index];
        if let Some(robot) = member.robot.filter(|_| member.slam().is_some()) {
            self.saved[robot.index()] = self.saved_cells(robot);
        }
    }

    fn request(&mut self, robot: RobotId, kind: SlamRequestKind) {
        let request = SlamRequest { kind: kind as u32, ..SlamRequest::default() };
        self.requests[robot.index()].send(&request);
    }
}

impl Observer {
    fn open(network: &Rc<Network>, run: &Run) -> Result<Self, ChannelError> {
        let ports = MemoryPorts::attach(network, Opener::of_fleet(Program::Launcher));
        let mut maps = Vec::new();
        for robot in run.robots() {
            maps.push((format!("{robot}_map"), ports.map_reader(&channel::map(robot))?, DenseMap::default()));
        }
        maps.push(("merged_map".into(), ports.map_reader(&channel::merged_map())?, DenseMap::default()));
        let last_seen = |robot| {
            Ok(LastSeen {
                truths: ports.reader(&channel::truth(robot))?,
                corrections: ports.reader(&channel::correction(robot))?,
                world_from_base: None,
                map_from_odom: None,
                map_from_base: None,
            })
        };
        Ok(Self {
            stats: ports.reader(&channel::stats())?,
            newest: Box::default(),
            maps,
            robots: run.robots().map(last_seen).collect::<Result<_, ChannelError>>()?,
        })
    }

    fn poll(&mut self) {
        if let Some(stats) = self.stats.newest() {
            *self.newest = *stats;
        }
        self.maps.iter_mut().for_each(|(_, reader, _)| {
            reader.poll();
        });
        for robot in &mut self.robots {
            if let Some(truth) = robot.truths.newest() {
                robot.world_from_base = Some(truth.world_from_base);
            }
            if let Some(correction) = robot.corrections.newest() {
                robot.map_from_odom = correction.map_from_odom().or(robot.map_from_odom);
                robot.map_from_base = Some(correction.map_from_base);
            }
        }
    }

    /// Returns the pose that a restarted process of a robot is given.
    fn last_seen(&mut self, role: Role, robot: RobotId) -> Option<Pose2> {
        let seen = &mut self.robots[robot.index()];
        match role {
            Role::Sim => {
                // Its odometry begins where the robot stands.
                seen.map_from_odom = seen.map_from_base;
                seen.world_from_base
            }
            Role::Slam => seen.map_from_odom,
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests;
