//! The simulator process: one robot in its room, 100 ticks a second on absolute deadlines.

use super::heartbeat::{HealthCounters, Heartbeat};
use super::{Error, Listens, ProcessLoop, serve};
use crate::channel;
use crate::ports::{ChannelError, Clock as _, Ports, ReadPort, WritePort};
use crate::progress::WatchedThread;
use crate::run::Run;
use crate::stop::Stop;
use crate::world;
use msg::{
    Clock, GroundTruth, Monotonic, MovingObjects, Odometry, Pose2, RobotId, Role, Scan, Stamp, Transforms,
    VelocityCommand,
};
use sim::Simulator;
use std::time::Duration;

/// Delay after which a simulator skips the missed ticks instead of catching up: the
/// machine slept, or is far too slow.
const BEHIND_MAX_S: f64 = 1.0;

/// The robot whose simulator keeps the fleet's clock.
const TIMEKEEPER: usize = 1;

/// Runs the process until it is asked to stop.
pub fn run(run: &Run, robot: RobotId, world_from_base: Option<Pose2>, stop: &Stop) -> Result<(), Error> {
    let participant = run.attach(Role::Sim, Some(robot))?;
    let mut process = SimulatorProcess::open(&participant, run, robot, world_from_base)?;
    serve(&mut process, run.progress(Role::Sim, Some(robot), WatchedThread::Main), &|| stop.requested());
    Ok(())
}

/// A robot's simulator with its channels.
pub struct SimulatorProcess<P: Ports> {
    simulator: Simulator,
    inputs: Inputs<P>,
    outputs: Outputs<P>,
    heartbeat: Heartbeat<P>,
    clock: P::Clock,
    epoch: crate::clock::Epoch,
    /// Time by which a tick is simulated after its stamp.
    tick_offset: Duration,
}

/// Input channels of a simulator.
struct Inputs<P: Ports> {
    commands: P::Reader<VelocityCommand>,
    command_listener: P::Listener,
    peers: Vec<(RobotId, P::Reader<GroundTruth>)>,
    /// People, doors and boxes, if any move in the room.
    objects: Option<P::Reader<MovingObjects>>,
    /// Age above which a command is out of date.
    command_age_max: Duration,
    /// Until when the newest command is valid.
    valid_until: Monotonic,
    /// Commands ignored because they were out of date.
    outdated: u64,
}

impl<P: Ports> SimulatorProcess<P> {
    /// Puts the robot at its start, or at `world_from_base`, its pose before a restart.
    pub fn open(ports: &P, run: &Run, robot: RobotId, world_from_base: Option<Pose2>) -> Result<Self, Error> {
        let heartbeat = Heartbeat::new(ports, run, Role::Sim, Some(robot))?;
        let inputs = Inputs::open(ports, run, robot)?;
        let outputs = Outputs::open(ports, robot)?;
        let room = world::room(&run.config)?;
        let start = world::starts(&run.config, &room)?[robot.index()];
        let at_start = || world::simulator(&run.config, &room, robot, start);
        // The old pose may touch a table; the robot then begins at its start.
        let mut simulator = match world_from_base {
            Some(pose) => world::simulator(&run.config, &room, robot, pose).or_else(|why| {
                tracing::warn!(
                    "{robot} cannot continue from x {:.3} m, y {:.3} m and begins at its start: {why}",
                    pose.x_m,
                    pose.y_m
                );
                at_start()
            })?,
            None => at_start()?,
        };
        let clock = ports.clock();
        simulator.set_time(run.epoch.stamp(clock.now()));
        let tick_offset = world::tick_offset(robot, run.config.fleet.robots);
        Ok(Self { simulator, inputs, outputs, heartbeat, clock, epoch: run.epoch, tick_offset })
    }

    /// Returns when the next tick is simulated.
    fn due(&self) -> Monotonic {
        self.epoch.moment(self.simulator.now() + Simulator::TICK + self.tick_offset)
    }

    fn now(&self) -> Stamp {
        self.epoch.stamp(self.clock.now())
    }
}

impl<P: Ports> ProcessLoop for SimulatorProcess<P> {
    fn step(&mut self) -> Monotonic {
        let now = self.clock.now();
        self.inputs.apply_commands(&mut self.simulator, now);
        let due = self.due();
        if now < due {
            return due;
        }
        let Self { simulator, inputs, outputs, heartbeat, .. } = self;
        heartbeat.record_lateness(due);
        heartbeat.measure(|| {
            inputs.update_peers(simulator);
            inputs.update_objects(simulator);
            outputs.tick(simulator);
        });
        heartbeat.publish_if_due(|| HealthCounters {
            receive_counts: inputs.commands.receive_counts(),
            refused: simulator.refused() + inputs.outdated,
            ..HealthCounters::default()
        });
        let now = self.now();
        if now - self.simulator.now() > BEHIND_MAX_S {
            self.simulator.skip_to(now);
        }
        self.due()
    }
}

impl<P: Ports> Listens<P::Listener> for SimulatorProcess<P> {
    fn listeners(&self) -> impl Iterator<Item = &P::Listener> {
        std::iter::once(&self.inputs.command_listener)
    }
}

impl<P: Ports> Inputs<P> {
    fn open(ports: &P, run: &Run, robot: RobotId) -> Result<Self, ChannelError> {
        let peers = run.robots().filter(|peer| *peer != robot);
        let moving = run.config.sim.moving.is_any();
        let peers = peers.map(|peer| Ok((peer, ports.reader(&channel::truth(peer))?)));
        Ok(Self {
            commands: ports.reader(&channel::command(robot))?,
            command_listener: ports.listener(&channel::command(robot))?,
            peers: peers.collect::<Result<_, ChannelError>>()?,
            objects: moving.then(|| ports.reader(&channel::moving_objects())).transpose()?,
            command_age_max: Duration::from_secs_f64(run.config.sim.limits.command_timeout_s),
            valid_until: Monotonic(0),
            outdated: 0,
        })
    }

    /// Passes commands to the simulator and drops outdated ones, which would move a robot that nobody drives. Such
    /// commands are left in the queue after this process was stopped for a while.
    fn apply_commands(&mut self, simulator: &mut Simulator, now: Monotonic) {
        while let Some(command) = self.commands.receive() {
            if now.since(command.header.sent) > self.command_age_max.as_nanos() as u64 {
                self.outdated += 1;
                continue;
            }
            simulator.set_velocity_command(&command);
            self.valid_until = command.header.sent + self.command_age_max;
        }
        // By the machine's clock: a command that waited, or a process that was stopped, makes it valid no longer.
        if now >= self.valid_until {
            simulator.stop();
        }
    }

    fn update_peers(&mut self, simulator: &mut Simulator) {
        for (peer, truths) in &mut self.peers {
            if let Some(truth) = truths.newest() {
                simulator.update_peer(*peer, &truth);
            }
        }
    }

    fn update_objects(&mut self, simulator: &mut Simulator) {
        if let Some(objects) = self.objects.as_mut().and_then(ReadPort::newest) {
            simulator.update_objects(&objects);
        }
    }
}

/// Output channels of a simulator.
struct Outputs<P: Ports> {
    scan: P::Writer<Scan>,
    odometry: P::Writer<Odometry>,
    transforms: P::Writer<Transforms>,
    truth: P::Writer<GroundTruth>,
    clock: Option<P::Writer<Clock>>,
}

impl<P: Ports> Outputs<P> {
    fn open(ports: &P, robot: RobotId) -> Result<Self, ChannelError> {
        let keeps_time = robot.number() == TIMEKEEPER;
        Ok(Self {
            scan: ports.writer(&channel::scan(robot))?,
            odometry: ports.writer(&channel::odometry(robot))?,
            transforms: ports.writer(&channel::transforms(robot))?,
            truth: ports.writer(&channel::truth(robot))?,
            clock: keeps_time.then(|| ports.writer(&channel::clock())).transpose()?,
        })
    }

    /// Simulates one tick and sends its messages: odometry before the scan that needs it.
    fn tick(&mut self, simulator: &mut Simulator) {
        let tick = simulator.step();
        if let Some(clock) = &mut self.clock {
            clock.send_with(|slot| slot.header.stamp = tick.stamp);
        }
        self.truth.send(&tick.truth);
        if let Some(odometry) = &tick.odometry {
            self.odometry.send(odometry);
        }
        if let Some(transforms) = &tick.transforms {
            self.transforms.send(transforms);
        }
        if tick.scan_due {
            self.scan.send_with(|slot| simulator.scan_into(slot));
        }
    }
}
