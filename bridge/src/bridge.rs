//! The public interface of the bridge: the fleet's messages in, commands for robots out.

mod clients;
mod navigation;
mod operator;
mod permissions;
mod room;
mod status;

pub use clients::ClientStatus;
pub(crate) use status::FleetStatus;

use crate::config::{BridgeConfig, ConfigError};
use crate::core::{ConnectError, Core};
use crate::fleet_topics::{FleetMessage, FleetTopic};
use crate::frame::RosTcpFrame;
use crate::relay::{RosCommand, RosEvent};
use crate::router::{ClientId, ClientSocket, ConnectionEnded, Counters};
use crate::world::{ExternalWorld, WorldInput};
use msg::{
    CommandSource, EdgeCommand, ExplorationCommand, Monotonic, NavigationCommand, OperatorEvent, RobotId,
    SlamRequest, SlamResponse, Stamp, VelocityCommand, ZoneCommand,
};
use ros_messages::RobotNames;
use ros_messages::cdr::Dialect;
use std::cell::RefCell;
use std::net::{IpAddr, SocketAddr};
use std::time::Duration;

/// Longest time between two ticks: late service calls and transforms to repeat wait for it.
const TICK_MAX: Duration = Duration::from_millis(250);

/// Where velocities go.
type CommandSink = Box<dyn FnMut(RobotId, VelocityCommand)>;
/// Where actions of operators go, for the record.
type OperatorEventSink = Box<dyn FnMut(OperatorEvent)>;
/// Where commands for merging go.
type EdgeCommandSink = Box<dyn FnMut(EdgeCommand)>;
/// Where requests to SLAM go.
type SlamRequestSink = Box<dyn FnMut(RobotId, SlamRequest)>;
/// Where commands to the navigator go.
type NavigationSink = Box<dyn FnMut(RobotId, NavigationCommand)>;
type ExplorationSink = Box<dyn FnMut(ExplorationCommand)>;
type ZoneSink = Box<dyn FnMut(ZoneCommand)>;
/// Where commands for the ROS 2 endpoint go.
type RosCommandSink = Box<dyn FnMut(RosCommand)>;

/// The bridge between the fleet and its clients.
///
/// It reads no clock, no socket and no file: `now` is a monotonic time of the caller's, clients connect with
/// [`Bridge::connect`], and [`crate::serve`] connects those on TCP. It belongs to one thread, and every method
/// returns without waiting.
///
/// A message of the fleet is encoded once for all clients, and only if somebody needs it; maps, statistics and states
/// always, for late subscribers. It is written to the sockets before the method returns.
///
/// A client in this process drives robot 1, and leaves; the robot is stopped:
/// ```
/// use bridge::command::{Registration, name};
/// use bridge::frame::{Parser, Side};
/// use bridge::ros::{Message, Twist, encode};
/// use bridge::{Bridge, BridgeConfig};
/// use msg::Monotonic;
/// use std::{cell::RefCell, rc::Rc};
///
/// let velocities = Rc::new(RefCell::new(Vec::new()));
/// let sink = velocities.clone();
/// let on_command = move |_robot, command: msg::VelocityCommand| sink.borrow_mut().push(command.linear_m_s);
/// let bridge = Bridge::new(BridgeConfig::default(), 3, on_command)?;
///
/// let client = bridge.connect(([127, 0, 0, 1], 5000).into())?;
/// let mut sent = Vec::new();
/// let topic = "/cmd_vel_1".to_owned();
/// let registration = Registration { topic, message_name: Twist::TYPE.into(), ..Default::default() };
/// Side::Client.write_command(&mut sent, name::PUBLISH, &registration);
/// let twist = Twist { linear: [0.1, 0.0, 0.0], ..Default::default() };
/// Side::Client.write_with(&mut sent, "/cmd_vel_1", |out| encode(&twist, out));
///
/// let mut parser = Parser::new(1 << 20);
/// parser.push(&sent);
/// while let Some(frame) = parser.next_frame()? {
///     bridge.receive(client, frame, Monotonic(0));
/// }
/// bridge.disconnect(client);
/// // Each robot is sent a zero first: what moved it before is not known.
/// assert_eq!(*velocities.borrow(), [0.0, 0.0, 0.0, 0.1, 0.0]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Bridge {
    core: RefCell<Core>,
    on_command: RefCell<CommandSink>,
    on_operator_event: RefCell<OperatorEventSink>,
    on_edge_command: RefCell<EdgeCommandSink>,
    on_slam_request: RefCell<SlamRequestSink>,
    on_navigation: RefCell<NavigationSink>,
    on_exploration: RefCell<ExplorationSink>,
    on_zone: RefCell<ZoneSink>,
    on_ros_command: RefCell<RosCommandSink>,
}

impl Bridge {
    /// Creates the bridge of robots that are simulated or replayed in this fleet: their number, or their names.
    ///
    /// `on_command` is called with every velocity that a robot must execute now. `header.stamp` is the fleet's newest
    /// time; the caller fills in the rest of the header. It must not call the bridge with commands of its own.
    pub fn new(
        config: BridgeConfig,
        robots: impl Into<RobotNames>,
        on_command: impl FnMut(RobotId, VelocityCommand) + 'static,
    ) -> Result<Self, ConfigError> {
        Self::open(config, &robots.into(), None, Box::new(on_command))
    }

    /// Creates the bridge of a world outside this fleet: a headset application's, or real robots.
    ///
    /// Scans, the robots' transforms and the clock come from clients or from DDS, and go to `world`'s sink. `stamp_at`
    /// converts the bridge's `now` into the run's time. Velocities are also published on `/cmd_vel_N` and
    /// `/robotN/cmd_vel`.
    pub fn with_external_world(
        config: BridgeConfig,
        world: ExternalWorld,
        stamp_at: impl Fn(Monotonic) -> Stamp + 'static,
        on_command: impl FnMut(RobotId, VelocityCommand) + 'static,
    ) -> Result<Self, ConfigError> {
        let robots = world.robot_names().clone();
        let input = WorldInput::new(world, config.clock_offset, Box::new(stamp_at));
        Self::open(config, &robots, Some(input), Box::new(on_command))
    }

    fn open(
        config: BridgeConfig,
        robots: &RobotNames,
        world: Option<WorldInput>,
        on_command: CommandSink,
    ) -> Result<Self, ConfigError> {
        config.validate()?;
        Ok(Self {
            core: RefCell::new(Core::new(config, robots, world)),
            on_command: RefCell::new(on_command),
            on_operator_event: RefCell::new(Box::new(|_| {})),
            on_edge_command: RefCell::new(Box::new(|_| {})),
            on_slam_request: RefCell::new(Box::new(|_, _| {})),
            on_navigation: RefCell::new(Box::new(|_, _| {})),
            on_exploration: RefCell::new(Box::new(|_| {})),
            on_zone: RefCell::new(Box::new(|_| {})),
            on_ros_command: RefCell::new(Box::new(|_| {})),
        })
    }

    /// Sets where clients' commands for merging go. It must not call the bridge.
    pub fn on_edge_command(&self, sink: impl FnMut(EdgeCommand) + 'static) {
        *self.on_edge_command.borrow_mut() = Box::new(sink);
    }

    /// Sets where clients' requests to a robot's SLAM go. It must not call the bridge.
    ///
    /// The caller fills in the request's `client` and `id`.
    pub fn on_slam_request(&self, sink: impl FnMut(RobotId, SlamRequest) + 'static) {
        *self.on_slam_request.borrow_mut() = Box::new(sink);
    }

    /// Exchanges clients' topics and services with ROS: sets where commands for the ROS 2 endpoint go. It must not call the bridge.
    ///
    /// Call it before clients connect. Its events come back by [`Bridge::receive_ros`].
    pub fn on_ros_command(&self, sink: impl FnMut(RosCommand) + 'static) {
        *self.on_ros_command.borrow_mut() = Box::new(sink);
        self.update(|core| {
            core.open_relay();
            core.publish_selected();
            core.publish_stop();
        });
    }

    /// Changes the core, then writes the frames and passes on the commands that result.
    fn update<T>(&self, change: impl FnOnce(&mut Core) -> T) -> T {
        let result = {
            let core = &mut *self.core.borrow_mut();
            let result = change(core);
            core.commands.set_sender(CommandSource::BRIDGE);
            core.router.flush();
            result
        };
        self.pass_commands();
        result
    }

    /// Passes on the commands that wait. The core is not borrowed meanwhile: a sink may publish messages.
    fn pass_commands(&self) {
        if !self.core.borrow().has_commands() {
            return;
        }
        if let Ok(mut sink) = self.on_operator_event.try_borrow_mut() {
            while let Some(event) = { self.core.borrow_mut().commands.next_operator_event() } {
                sink(event);
            }
        }
        if let Ok(mut sink) = self.on_edge_command.try_borrow_mut() {
            while let Some(command) = { self.core.borrow_mut().commands.next_edge_command() } {
                sink(command);
            }
        }
        if let Ok(mut sink) = self.on_command.try_borrow_mut() {
            while let Some((robot, command)) = { self.core.borrow_mut().commands.next_velocity() } {
                sink(robot, command);
            }
        }
        self.pass_navigation_commands();
        if let Ok(mut sink) = self.on_slam_request.try_borrow_mut() {
            while let Some((robot, request)) = { self.core.borrow_mut().commands.next_slam_request() } {
                sink(robot, request);
            }
        }
        if let Ok(mut sink) = self.on_ros_command.try_borrow_mut() {
            while let Some(command) = { self.core.borrow_mut().relay.next_command() } {
                sink(command);
            }
        }
    }

    /// Publishes a message of the fleet to the clients that subscribed to its topics.
    pub fn publish(&self, message: FleetMessage<'_>) {
        self.update(|core| core.publish(message));
    }

    /// Connects a client of this process at an address, which access control judges.
    ///
    /// Its frames wait for [`Bridge::take_outgoing`]; the handshake is the first.
    pub fn connect(&self, peer: SocketAddr) -> Result<ClientId, ConnectError> {
        self.update(|core| core.connect(peer, None))
    }

    /// Connects a client on a socket.
    pub(crate) fn connect_socket(
        &self,
        peer: SocketAddr,
        socket: Box<dyn ClientSocket>,
    ) -> Result<ClientId, ConnectError> {
        self.update(|core| core.connect(peer, Some(socket)))
    }

    /// Handles one frame from a client. Its commands reach the robots before this returns.
    ///
    /// Frames for clients wait until `flush`, so that a client that sends much is not answered frame by
    /// frame.
    pub fn receive(&self, client: ClientId, frame: RosTcpFrame<'_>, now: Monotonic) {
        self.core.borrow_mut().receive(client, frame, now);
        self.pass_commands();
    }

    /// Handles the answer of a robot's SLAM to a request. `is_ours`: the request was this bridge's.
    pub fn receive_slam_response(&self, robot: RobotId, response: &SlamResponse, is_ours: bool) {
        self.update(|core| core.receive_slam_response(robot, response, is_ours));
    }

    /// Handles an event of the ROS 2 endpoint: messages, requests, responses, and changes of the ROS graph.
    pub fn receive_ros(&self, event: RosEvent, now: Monotonic) {
        self.update(|core| {
            core.commands.set_sender(CommandSource::ROS2);
            core.receive_ros(event, now);
        });
    }

    /// Appends the frames that wait for a client of this process to `out`.
    ///
    /// Fails if the client is disconnected, or must be because it left too many replies unread.
    pub fn take_outgoing(&self, client: ClientId, out: &mut Vec<u8>) -> Result<(), ConnectionEnded> {
        self.core.borrow_mut().take_outgoing(client, out)
    }

    /// Does what is due: stops robots whose last velocity is too old, fails late service calls, repeats transforms for
    /// late subscribers. Call it when [`Self::next_tick`] says.
    pub fn tick(&self, now: Monotonic) {
        self.update(|core| core.tick(now));
    }

    /// Returns when [`Self::tick`] must be called next, if nothing else happens before: at `now` or later.
    ///
    /// A velocity that arrives meanwhile is never due before: it is valid for longer than this waits.
    pub fn next_tick(&self, now: Monotonic) -> Monotonic {
        let core = self.core.borrow();
        let latest = now + TICK_MAX.min(core.gate.timeout() / 2);
        core.gate.next_due().map_or(latest, |due| due.clamp(now, latest))
    }

    /// Disconnects a client: the robots that it drove stop, the calls that it should have answered fail.
    pub fn disconnect(&self, client: ClientId) {
        self.update(|core| drop(core.disconnect(client)));
    }

    /// Returns the robots that somebody drives now, with the driver's address; `None` for ROS 2.
    pub fn drivers(&self, now: Monotonic) -> Vec<(RobotId, Option<IpAddr>)> {
        let core = self.core.borrow();
        let driver = |robot| Some((robot, core.gate.drive().leaseholder(robot, now)?.address));
        core.fleet.robots().filter_map(driver).collect()
    }

    /// Keeps a robot until `until` for the driver that an earlier bridge saved: nobody else drives it, unless by
    /// `/take_control`.
    pub fn restore_driver(&self, robot: RobotId, address: Option<IpAddr>, until: Monotonic) {
        self.core.borrow_mut().gate.drive_mut().restore_lease(robot, address, until);
    }

    /// Returns what has been counted since the start.
    pub fn counters(&self) -> Counters {
        self.core.borrow().counters()
    }

    /// Returns whether a client is subscribed to a robot's topic.
    pub(crate) fn is_subscribed(&self, topic: FleetTopic, robot: RobotId) -> bool {
        let core = self.core.borrow();
        core.fleet.is_subscribed(&core.router, topic, robot)
    }

    pub(crate) fn clients_max(&self) -> usize {
        self.core.borrow().config.clients_max
    }

    pub(crate) fn dialect(&self) -> Dialect {
        self.core.borrow().config.payloads
    }

    pub(crate) fn frame_bytes_max(&self) -> usize {
        self.core.borrow().config.frame_bytes_max
    }

    pub(crate) fn unsent_bytes_max(&self) -> u32 {
        self.core.borrow().config.unsent_bytes_max
    }

    /// Writes waiting frames to the sockets.
    pub(crate) fn flush(&self) {
        self.core.borrow_mut().router.flush();
    }

    /// Returns whether a client's frames wait until its socket accepts bytes; fails if the connection must end.
    pub(crate) fn is_blocked(&self, id: ClientId) -> Result<bool, ConnectionEnded> {
        self.core.borrow().router.is_blocked(id)
    }

    /// Returns whether frames of a client are gathered, which its task is to write.
    pub(crate) fn is_gathering(&self, id: ClientId) -> bool {
        self.core.borrow().router.is_gathering(id)
    }

    /// Continues writing for a client whose socket accepts bytes again, or whose frames were gathered; returns whether it is
    /// blocked still.
    pub(crate) fn flush_client(&self, id: ClientId) -> bool {
        self.core.borrow_mut().router.flush_client(id)
    }
}

#[cfg(test)]
mod tests;
