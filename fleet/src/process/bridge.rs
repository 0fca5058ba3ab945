//! The bridge process: it passes the fleet's messages to ros_tcp clients, and their commands to the robots.
//!
//! [`BridgeProcess`] is written over ports, a clock and storage. Live ([`live`]), a message on a channel wakes its feed's
//! task through the channel's file descriptor, is encoded once, and is written to the sockets before the thread waits
//! again; ROS 2 has a thread of its own that this one never waits for. In lockstep, clients are in the same process.

pub mod feeds;
pub mod live;
pub mod page;

pub use live::run;

use super::control::files::{ControlFiles, FileWorker};
use super::control::{Control, restore_files};
use super::heartbeat::{HealthCounters, Heartbeat};
use super::{Error, ProcessLoop, external};
use crate::channel::{self, Channel};
use crate::config::RobotSource;
use crate::ports::{ChannelError, Clock as _, Ports, WritePort};
use crate::run::Run;
use crate::storage::Storage;
use ::bridge::Bridge;
use feeds::{Feed, FeedResult, forward, open_feeds};
use msg::{
    ExplorationCommand, Message, Monotonic, NavigationCommand, RobotId, Role, SlamRequest, SlamResponse,
    VelocityCommand, ZoneCommand,
};
use std::cell::RefCell;
use std::rc::Rc;
use std::time::Duration;
use tokio::sync::Notify;

/// Longest time until the bridge's state is saved after it has changed.
const UPKEEP_PERIOD: Duration = Duration::from_millis(100);
/// Oldest velocity of the navigator that is passed on: four of its periods.
const NAVIGATION_AGE_MAX: Duration = Duration::from_millis(200);
/// Kind of requester that marks this process's requests to SLAM.
const REQUESTER_KIND: u64 = 1;
/// Bits of a requester's number that hold its process id; its kind is above them.
const PID_BITS: u32 = 32;

/// The bridge with its channels and its saved state.
pub struct BridgeProcess<P: Ports, W: FileWorker> {
    /// The routing core, to which clients connect.
    pub bridge: Rc<Bridge>,
    /// Feeds of the topics.
    pub feeds: Vec<Feed<P::Listener>>,
    /// What is due with time.
    pub periodic_tasks: PeriodicTasks<P, W>,
    /// Notified when an operator did what is to be saved at once, as an emergency stop: the periodic tasks save it.
    pub operator_acted: Rc<Notify>,
}

impl<P: Ports + 'static, W: FileWorker> BridgeProcess<P, W> {
    /// Opens the channels, stops every robot, and applies the saved state: permissions, drivers, emergency stop.
    /// `start_files` returns who reads and writes the files from then on.
    pub fn open<S: Storage>(
        ports: &P,
        run: &Run,
        storage: S,
        start_files: impl FnOnce(ControlFiles<S>) -> std::io::Result<W>,
    ) -> Result<Self, Error> {
        let heartbeat = Heartbeat::new(ports, run, Role::Bridge, None)?;
        let operator_acted = Rc::new(Notify::new());
        let (bridge, requester) = open_bridge(ports, run, operator_acted.clone())?;
        // Every robot gets a zero before anything else: what moved it before is not known.
        let now = ports.clock().now();
        bridge.tick(now);
        // Before the files: a stop that they restore pauses what waits in the channels.
        let goals = open_goals(ports, run, &bridge)?;
        let exploration = open_shared(ports, &channel::explore())?;
        let writer: SharedWriter<P, ExplorationCommand> = exploration.clone();
        bridge.on_exploration(move |command| writer.borrow_mut().send(&command));
        let zones = open_shared(ports, &channel::zone_command())?;
        let writer: SharedWriter<P, ZoneCommand> = zones.clone();
        bridge.on_zone(move |command| writer.borrow_mut().send(&command));
        let files = start_files(restore_files(&bridge, run, storage, now))?;
        let control = Rc::new(RefCell::new(Control::new(bridge.clone(), run, files)));
        let mut feeds = open_feeds(ports, run, &bridge)?;
        for robot in run.robots() {
            let receive = move |bridge: &Bridge, response: &SlamResponse| {
                bridge.receive_slam_response(robot, response, response.client == requester);
            };
            feeds.push(forward(ports, &bridge, &channel::slam_response(robot), receive)?);
            let velocities = channel::navigation_velocity(robot);
            feeds.push(timely_velocities(
                ports,
                &bridge,
                robot,
                velocities,
                Bridge::receive_navigation_velocity,
            )?);
            // A machine that joins a base has one robot.
            if run.config.world != RobotSource::Robots && run.config.fleet.robots == 1 {
                let velocities = channel::base_velocity(robot);
                feeds.push(timely_velocities(
                    ports,
                    &bridge,
                    robot,
                    velocities,
                    Bridge::receive_base_velocity,
                )?);
            }
        }
        let (clock, bridge_of_tasks) = (ports.clock(), bridge.clone());
        let periodic_tasks =
            PeriodicTasks { bridge: bridge_of_tasks, control, goals, exploration, zones, heartbeat, clock };
        Ok(Self { bridge, feeds, periodic_tasks, operator_acted })
    }
}

impl<P: Ports, W: FileWorker> ProcessLoop for BridgeProcess<P, W> {
    fn step(&mut self) -> Monotonic {
        let due = self.feeds.iter_mut().map(ProcessLoop::step).min();
        self.periodic_tasks.step().min(due.unwrap_or(Monotonic(u64::MAX)))
    }
}

/// Does what is due with time: late service calls, the dead man, saving of state, the health report.
pub struct PeriodicTasks<P: Ports, W> {
    bridge: Rc<Bridge>,
    /// Requests of the person at the laptop.
    pub control: Rc<RefCell<Control<W>>>,
    goals: GoalWriters<P>,
    exploration: SharedWriter<P, ExplorationCommand>,
    zones: SharedWriter<P, ZoneCommand>,
    heartbeat: Heartbeat<P>,
    clock: P::Clock,
}

impl<P: Ports, W: FileWorker> ProcessLoop for PeriodicTasks<P, W> {
    fn step(&mut self) -> Monotonic {
        let now = self.clock.now();
        self.bridge.tick(now);
        self.bridge.take_events().iter().for_each(|event| tracing::warn!("{event}"));
        self.control.borrow_mut().update_files(now);
        if now >= self.heartbeat.due() {
            self.goals.borrow().iter().for_each(WritePort::refresh);
            self.exploration.borrow().refresh();
            self.zones.borrow().refresh();
        }
        self.heartbeat.publish_if_due(|| {
            let counters = self.bridge.counters();
            let mut account = HealthCounters { clients: counters.clients, ..HealthCounters::default() };
            (account.dropped, account.refused) = (counters.dropped, counters.refused);
            account.receive_counts.received = counters.received;
            account
        });
        self.bridge.next_tick(now).min(now.next_multiple(UPKEEP_PERIOD))
    }
}

/// Writers of the robots' goals, shared by the bridge and its periodic tasks.
type GoalWriters<P> = Rc<RefCell<Vec<<P as Ports>::Writer<NavigationCommand>>>>;
/// Writer of one channel, shared likewise.
type SharedWriter<P, M> = Rc<RefCell<<P as Ports>::Writer<M>>>;

/// Opens a channel that the bridge and its periodic tasks write to.
fn open_shared<P: Ports, M: Message>(
    ports: &P,
    channel: &Channel<M>,
) -> Result<SharedWriter<P, M>, ChannelError> {
    Ok(Rc::new(RefCell::new(ports.writer(channel)?)))
}

/// Opens the robots' channels of goals, on which the bridge sends what clients want of the navigator.
fn open_goals<P: Ports + 'static>(
    ports: &P,
    run: &Run,
    bridge: &Bridge,
) -> Result<GoalWriters<P>, ChannelError> {
    let writers = run.robots().map(|robot| ports.writer(&channel::goal(robot)));
    let writers = Rc::new(RefCell::new(writers.collect::<Result<Vec<_>, _>>()?));
    let goals: GoalWriters<P> = writers.clone();
    bridge.on_navigation(move |robot, command| {
        if let Some(writer) = goals.borrow_mut().get_mut(robot.index()) {
            writer.send(&command);
        }
    });
    Ok(writers)
}

/// Takes a velocity for a robot at a time of the bridge's clock.
type VelocityReceiver = fn(&Bridge, RobotId, &VelocityCommand, Monotonic);

/// Passes the velocities of a channel for a robot to the gate, but for those that have waited too long.
fn timely_velocities<P: Ports>(
    ports: &P,
    bridge: &Rc<Bridge>,
    robot: RobotId,
    velocities: Channel<VelocityCommand>,
    receive: VelocityReceiver,
) -> FeedResult<P> {
    let clock = ports.clock();
    forward(ports, bridge, &velocities, move |bridge: &Bridge, command| {
        let now = clock.now();
        if now.since(command.header.sent) <= NAVIGATION_AGE_MAX.as_nanos() as u64 {
            receive(bridge, robot, command, now);
        }
    })
}

/// Creates the bridge, which writes the channels of velocities, of commands for merging and of requests to SLAM.
///
/// Returns the number, too, that responses to its requests carry.
fn open_bridge<P: Ports + 'static>(
    ports: &P,
    run: &Run,
    operator_acted: Rc<Notify>,
) -> Result<(Rc<Bridge>, u64), Error> {
    let writers = run.robots().map(|robot| ports.writer(&channel::command(robot)));
    let mut writers = writers.collect::<Result<Vec<P::Writer<VelocityCommand>>, _>>()?;
    let send = move |robot: RobotId, command: VelocityCommand| {
        if let Some(writer) = writers.get_mut(robot.index()) {
            writer.send(&command);
        }
    };
    let config = run.config.bridge_config();
    let bridge = match run.config.world {
        // The link writes what robots on other machines send.
        RobotSource::Simulator | RobotSource::Robots => Bridge::new(config, run.config.robot_names(), send)?,
        RobotSource::Headset | RobotSource::Ros => {
            let (world, epoch) = (external::open_world(ports, run)?, run.epoch);
            Bridge::with_external_world(config, world, move |now| epoch.stamp(now), send)?
        }
    };
    let mut edge_commands = ports.writer(&channel::edge_command())?;
    bridge.on_edge_command(move |command| edge_commands.send(&command));
    let mut operator_events = ports.writer(&channel::operator_event())?;
    bridge.on_operator_event(move |event| {
        operator_events.send(&event);
        operator_acted.notify_one();
    });
    let mut requester = SlamRequester::open(ports, run, REQUESTER_KIND)?;
    let client = requester.client;
    bridge.on_slam_request(move |robot, request| requester.send(robot, request));
    Ok((Rc::new(bridge), client))
}

/// Sends requests to the robots' SLAM in the name of the bridge.
struct SlamRequester<P: Ports> {
    /// The number that responses to this endpoint carry.
    client: u64,
    requests: Vec<P::Writer<SlamRequest>>,
}

impl<P: Ports> SlamRequester<P> {
    /// Opens the robots' request channels. `kind` tells endpoints of one process apart; the command line's is 0.
    fn open(ports: &P, run: &Run, kind: u64) -> Result<Self, ChannelError> {
        let client = kind << PID_BITS | u64::from(ports.clock().usage().pid);
        let requests = run.robots().map(|robot| ports.writer(&channel::slam_request(robot)));
        Ok(Self { client, requests: requests.collect::<Result<_, _>>()? })
    }

    /// Sends a request to a robot's SLAM.
    fn send(&mut self, robot: RobotId, request: SlamRequest) {
        if let Some(writer) = self.requests.get_mut(robot.index()) {
            writer.send(&SlamRequest { client: self.client, ..request });
        }
    }
}
