//! The routing core, which composes the bridge's parts and handles what clients send.
//!
//! It reads no clock and no socket. Time comes in as `now`, a monotonic time of the caller's.

mod absent_robots;
mod actions;
mod admission;
mod initial_pose;
mod input;
mod navigation;
mod other_drivers;
mod pauses;
mod registration;
mod relay;
mod ros_refusals;
mod service_exchange;
mod service_frames;
mod world;

use crate::access::AccessControl;
use crate::actions::ActionServers;
use crate::battery::Batteries;
use crate::command::{handshake, name};
use crate::command_queues::CommandQueues;
use crate::config::BridgeConfig;
use crate::drive::velocity_gate::{Velocity, VelocityGate};
use crate::drive::{DriveArbiter, DriveClient};
use crate::fleet_topics::{FleetMessage, FleetTopic, FleetTopics};
use crate::frame::{RosTcpFrame, Side};
use crate::newest_stats::NewestStats;
use crate::relay::RelayTable;
use crate::router::{
    ClientId, ClientSocket, Counters, ExpectedFrame, FrameKind, OutgoingQueue, TopicRouter, TopicTable,
};
use crate::services::{Provider, ServiceCalls};
use crate::slam_services::SlamServices;
use crate::world::WorldInput;
use msg::{CommandSource, Header, Monotonic, OperatorAction, PauseReason, RobotId, VelocityCommand};
use ros_messages::{Bool, Int32, RobotNames, Twist};
use std::net::SocketAddr;

use admission::AdmissionState;
pub use admission::{ClientSelector, ConnectError, SelectorError};

/// The robot that is selected at start.
const FIRST_ROBOT: RobotId = RobotId::new(1).unwrap();

/// What the fleet offers to ROS 2 nodes, and in part to clients.
pub struct FleetServices {
    /// SLAM's services by their ROS names.
    pub slam: SlamServices,
    /// Nav2's actions of the robots, for ROS 2 nodes alone.
    pub actions: ActionServers,
}

/// The parts of the bridge.
// More than 12 fields: each is a part with a module of its own.
pub struct Core {
    /// The bridge's settings.
    pub config: BridgeConfig,
    /// Topics, clients and the frames between them.
    pub router: TopicRouter,
    /// The fleet's own topics.
    pub fleet: FleetTopics,
    /// The gate that every velocity passes.
    pub gate: VelocityGate,
    /// Who may watch and drive.
    pub access: AccessControl,
    /// Services of clients, and all calls that wait.
    pub services: ServiceCalls,
    /// Services and actions of the fleet.
    pub offered: FleetServices,
    /// The exchange of clients' topics with ROS.
    pub relay: RelayTable,
    /// Commands for robots, merging and SLAM that wait to be taken.
    pub commands: CommandQueues,
    /// Receives sensor data if the world is not simulated here.
    pub world: Option<WorldInput>,
    /// The newest figures of telemetry, for the operator's page.
    pub stats: NewestStats,
    /// The newest states of the robots' batteries.
    pub batteries: Batteries,
    /// The clients that are being dropped.
    admission: AdmissionState,
}

impl Core {
    /// Creates the core of a valid configuration.
    pub fn new(config: BridgeConfig, robots: &RobotNames, world: Option<WorldInput>) -> Self {
        let mut topics = TopicTable::new(config.client_topics_max);
        let mut fleet = FleetTopics::new(&mut topics, config.frame_names, robots, world.is_some());
        fleet.set_odometry_sigmas(config.odometry_sigmas);
        let drive = DriveArbiter::new(robots.count(), FIRST_ROBOT, config.lease());
        let mut core = Self {
            router: TopicRouter::new(topics, &config),
            fleet,
            gate: VelocityGate::new(&config.velocity, robots.count(), drive),
            access: AccessControl::new(&config),
            services: ServiceCalls::new(config.client_topics_max),
            offered: FleetServices { slam: SlamServices::new(robots), actions: ActionServers::new(robots) },
            relay: RelayTable::new(
                config.dds.relayed_topics_max,
                config.dds.relayed_services_max,
                &config.open_topics,
            ),
            commands: CommandQueues::default(),
            config,
            world,
            stats: NewestStats::default(),
            batteries: Batteries::new(robots.count()),
            admission: AdmissionState::default(),
        };
        core.send_velocities();
        core.publish_selected();
        core.publish_stop();
        core
    }

    /// Connects a client and sends it the handshake, which must be its first frame.
    pub fn connect(
        &mut self,
        peer: SocketAddr,
        socket: Option<Box<dyn ClientSocket>>,
    ) -> Result<ClientId, ConnectError> {
        self.make_place(peer)?;
        let id = self.router.connect(peer, socket);
        self.record_connected(id);
        let payload = handshake(self.config.payloads);
        self.router
            .send_frames(id, FrameKind::Reply, |out| Side::Server.write(out, name::HANDSHAKE, payload));
        Ok(id)
    }

    /// Handles one frame from a client.
    pub fn receive(&mut self, id: ClientId, frame: RosTcpFrame<'_>, now: Monotonic) {
        self.commands.set_sender(self.sender(id));
        self.receive_frame(id, frame, now);
        self.commands.set_sender(CommandSource::BRIDGE);
    }

    fn receive_frame(&mut self, id: ClientId, frame: RosTcpFrame<'_>, now: Monotonic) {
        self.router.counted.received += 1;
        self.record_received(Some(id), now);
        if frame.is_keepalive() {
            return;
        }
        let Ok(name) = core::str::from_utf8(frame.name) else {
            let text = format!("a destination is not UTF-8: '{}'", String::from_utf8_lossy(frame.name));
            return self.router.refuse(id, text);
        };
        let Some(client) = self.router.client_mut(id) else { return };
        let expected = client.expected.take();
        if name.starts_with("__") {
            if expected.is_some() {
                let text =
                    format!("{name} came between a service's number and its frame: the call is dropped");
                self.router.refuse(id, text);
            }
            return self.receive_system_command(id, name, frame, now);
        }
        match expected {
            None => self.receive_data(id, name, frame.payload, now),
            Some(ExpectedFrame::Request(number)) => {
                self.receive_request(id, number, name, frame.payload, now);
            }
            Some(ExpectedFrame::Response(number)) => self.receive_response(id, number, frame.payload),
        }
    }

    /// Publishes a message of the fleet.
    pub fn publish(&mut self, message: FleetMessage<'_>) {
        if let FleetMessage::Stats(stats) = message {
            self.stats.set(stats);
        }
        match message {
            FleetMessage::Battery(robot, battery) => self.batteries.set(robot, battery),
            FleetMessage::NavigationState(robot, report) => {
                self.record_navigation(robot, report);
                self.apply_goal_report(robot, report);
            }
            FleetMessage::PoseEstimate(robot, pose_estimate) => self.record_goal_pose(robot, pose_estimate),
            _ => {}
        }
        if let FleetMessage::ExplorationState(report) = message {
            self.record_exploration(report);
        }
        self.fleet.publish(&mut self.router, message);
    }

    /// Does what is due at this time: stops robots whose last velocity is too old, fails late service calls, repeats
    /// transforms for late subscribers, drops clients that are gone.
    pub fn tick(&mut self, now: Monotonic) {
        self.commands.record_time(now);
        // A replay shows what was recorded, however slowly it goes.
        if !self.access.is_replay {
            self.stats.tick(now);
        }
        self.batteries.tick(now);
        if let Some(world) = &mut self.world {
            world.tick(now);
        }
        self.gate.tick(now);
        self.send_velocities();
        self.enforce_limits(now);
        for call in self.services.remove_expired(now) {
            self.fail_call(&call, "no answer came in time");
        }
        self.report_unpublished(now);
        self.tick_actions(now);
        self.fleet.tick(&mut self.router, now);
        self.router.retry_held();
    }

    /// Disconnects a client: stops the robots that it drove, fails the calls that it should have answered.
    ///
    /// Returns the client's unsent frames, or `None` if it is disconnected already.
    pub fn disconnect(&mut self, id: ClientId) -> Option<OutgoingQueue> {
        let unsent = self.router.disconnect(id)?;
        self.remove_unused_relays();
        if let Some(world) = &mut self.world {
            world.disconnect(id.serial);
        }
        self.stop_robots_of(id);
        for call in self.services.remove_calls_of(id) {
            if call.provider == Provider::Ros {
                self.relay.cancel_call(&call.service, call.number);
            }
        }
        for call in self.services.remove_client(id) {
            self.fail_call(&call, "the client that offered it has left");
        }
        self.update_services();
        Some(unsent)
    }

    /// Sends the velocities that have passed the gate: the only way of a velocity to a robot, whatever the world.
    pub fn send_velocities(&mut self) {
        while let Some((robot, velocity)) = self.gate.next_output() {
            let header = Header { stamp: self.fleet.now(), ..Header::default() };
            let Velocity { linear_m_s, angular_rad_s } = velocity;
            self.commands.push_velocity(
                robot,
                VelocityCommand { header, linear_m_s, angular_rad_s, ..VelocityCommand::default() },
            );
            let twist = Twist { linear: [linear_m_s, 0.0, 0.0], angular: [0.0, 0.0, angular_rad_s] };
            let is_selected = robot == self.gate.drive().selected();
            self.fleet.publish_velocity(&mut self.router, robot, is_selected, &twist);
        }
    }

    /// Returns a client as the sender of commands.
    fn sender(&self, id: ClientId) -> CommandSource {
        match self.router.client(id) {
            Some(client) => CommandSource::client(client.peer),
            None if id == ClientId::DDS => CommandSource::ROS2,
            None => CommandSource::default(),
        }
    }

    /// Returns a client as the driver of a robot.
    pub(crate) fn driver(&self, id: ClientId) -> DriveClient {
        let address = self.router.client(id).map(|client| client.peer.ip().to_canonical());
        DriveClient { client: Some(id), address }
    }

    /// Returns a driver's name for people.
    fn driver_name(&self, driver: DriveClient) -> String {
        match (driver.client, driver.address) {
            (Some(id), _) => self.client_name(id),
            (None, Some(address)) => format!("{address}, which drove it before the bridge was restarted"),
            (None, None) => "ROS 2".into(),
        }
    }

    /// Returns a client's name for people.
    fn client_name(&self, id: ClientId) -> String {
        if id == ClientId::DDS {
            return "ROS 2".into();
        }
        self.router.client(id).map_or("another client".into(), |client| client.peer.to_string())
    }

    /// Ends a client's leases and stops the robots that it drove last.
    pub fn stop_robots_of(&mut self, id: ClientId) {
        self.gate.release_client(id);
        self.send_velocities();
    }

    /// Publishes which robot is selected.
    pub fn publish_selected(&mut self) {
        let selected = self.gate.drive().selected();
        self.fleet.publish_selected(&mut self.router, selected);
        self.relay.publish_state(FleetTopic::SelectedRobot.row().name, &Int32(selected.number() as i32));
    }

    /// Publishes whether the emergency stop is set.
    pub fn publish_stop(&mut self) {
        let is_stopped = self.gate.drive().is_stopped();
        self.fleet.publish_stop(&mut self.router, is_stopped);
        self.relay.publish_state(FleetTopic::EmergencyStop.row().name, &Bool(is_stopped));
    }

    /// Sets the emergency stop: every robot stops, and stays stopped until it is released.
    pub fn set_emergency_stop(&mut self) {
        if !self.gate.drive().is_stopped() {
            self.pause_all_navigation(PauseReason::EmergencyStop);
        }
        self.gate.set_stopped(true);
        self.commands.push_operator_event(OperatorAction::Stop, None);
        self.send_velocities();
        self.publish_stop();
    }

    /// Releases the emergency stop.
    pub fn release_emergency_stop(&mut self) {
        self.gate.set_stopped(false);
        self.commands.push_operator_event(OperatorAction::Release, None);
        self.publish_stop();
    }

    /// Returns whether commands wait until they are passed on.
    pub fn has_commands(&self) -> bool {
        !self.commands.is_empty() || self.relay.has_command()
    }

    /// Returns the counters.
    pub fn counters(&self) -> Counters {
        Counters { commands: self.commands.velocities_taken(), ..self.router.counters() }
    }
}
