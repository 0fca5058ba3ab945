//! One robot in its room, at its own pace: 100 ticks a second on absolute deadlines.

use super::Error;
use super::pulse::{Account, Pulse};
use crate::channel;
use crate::fleet;
use crate::ports::ChannelError;
use crate::run::Run;
use crate::shared_memory::{Participant, Reader, Writer, wait};
use crate::stop::Stop;
use msg::{Clock, GroundTruth, Odometry, Pose2, RobotId, Role, Scan, Transforms, VelocityCommand};
use sim::Simulator;

/// A simulator further behind than this lets the time go instead of hurrying after it: the
/// machine slept, or is far too slow.
const BEHIND_MAX_S: f64 = 1.0;

/// The robot whose simulator keeps the fleet's clock.
const TIMEKEEPER: usize = 1;

pub fn run(run: &Run, robot: RobotId, at: Option<Pose2>, stop: &Stop) -> Result<(), Error> {
    let node = run.attach(Role::Sim, Some(robot))?;
    let mut pulse = Pulse::new(&node, run, Role::Sim, Some(robot))?;
    let mut commands = node.reader(&channel::command(robot))?;
    let command_bell = node.listener(&channel::command(robot))?;
    let mut outputs = Outputs::open(&node, robot)?;
    let mut peers = run
        .robots()
        .filter(|peer| *peer != robot)
        .map(|peer| Ok((peer, node.reader(&channel::truth(peer))?)))
        .collect::<Result<Vec<(RobotId, Reader<GroundTruth>)>, ChannelError>>()?;
    let room = fleet::room(&run.config)?;
    let start = fleet::starts(&run.config, &room)?[robot.index()];

    let lag = fleet::tick_lag(robot, run.config.fleet.robots);
    let at_start = || fleet::simulator(&run.config, &room, robot, start);
    // Where it was may have been against a table; then it begins anew.
    let mut simulator = match at {
        Some(place) => fleet::simulator(&run.config, &room, robot, place).or_else(|why| {
            eprintln!("{robot} cannot go on from {place:?} and begins anew at its start: {why}");
            at_start()
        })?,
        None => at_start()?,
    };
    simulator.join_at(fleet::stamp_now(run.epoch));
    while !stop.requested() {
        let due = run.epoch.moment(simulator.now() + Simulator::TICK + lag);
        while wait([&command_bell], due) {
            obey(&mut commands, &mut simulator);
        }
        pulse.late(due);
        pulse.work(|| {
            obey(&mut commands, &mut simulator);
            for (peer, truths) in &mut peers {
                if let Some(truth) = truths.newest() {
                    simulator.update_peer(*peer, &truth);
                }
            }
            outputs.tick(&mut simulator);
        });
        pulse.beat(|| Account { gaps: commands.gaps(), refused: simulator.refused(), ..Account::default() });
        let now = fleet::stamp_now(run.epoch);
        if now - simulator.now() > BEHIND_MAX_S {
            simulator.join_at(now);
        }
    }
    Ok(())
}

fn obey(commands: &mut Reader<VelocityCommand>, simulator: &mut Simulator) {
    while let Some(command) = commands.receive() {
        simulator.command(&command);
    }
}

/// What a simulator writes.
struct Outputs {
    scan: Writer<Scan>,
    odometry: Writer<Odometry>,
    transforms: Writer<Transforms>,
    truth: Writer<GroundTruth>,
    clock: Option<Writer<Clock>>,
}

impl Outputs {
    fn open(node: &Participant, robot: RobotId) -> Result<Self, ChannelError> {
        Ok(Self {
            scan: node.writer(&channel::scan(robot))?,
            odometry: node.writer(&channel::odometry(robot))?,
            transforms: node.writer(&channel::transforms(robot))?,
            truth: node.writer(&channel::truth(robot))?,
            clock: (robot.number() == TIMEKEEPER).then(|| node.writer(&channel::clock())).transpose()?,
        })
    }

    /// Simulates one tick and sends what is due: odometry before the scan that needs it.
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
