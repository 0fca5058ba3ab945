//! The operator of a fleet in lockstep: the scripted tour as a ros_tcp client of the bridge.

use super::client::Client;
use super::queues::Network;
use super::tcp::Port;
use crate::ports::Clock;
use crate::run::Run;
use bridge::ros;
use msg::{Monotonic, RobotId, Stamp};
use nav::{DriveCommand, ExplorationTour, FleetObservation, RobotObservation, TourConfig, Twist};
use operator::joystick::SimulatedJoystick;
use operator::link_statistics::MessageContent;
use operator::robot_topics::RobotTopics;
use operator::world_state::{RobotState, WorldState, decode_maps};
use std::net::SocketAddr;
use std::rc::Rc;
use std::time::Duration;

/// Period of the operator's control loop: a headset's stick is read at 20 Hz.
const PERIOD: Duration = Duration::from_millis(50);
/// Time between two attempts to connect, as the connector waits.
const RETRY_PERIOD: Duration = Duration::from_secs(1);
/// Address of the operator's client.
const PEER: ([u8; 4], u16) = ([127, 0, 0, 1], 50_001);

/// Drives the robots by the scripted tour.
pub struct Operator {
    client: Client,
    network: Rc<Network>,
    run: Run,
    world: WorldState,
    tour: Option<ExplorationTour>,
    joystick: SimulatedJoystick,
    together: bool,
    /// The robot that it selected last on this connection.
    selected: Option<RobotId>,
    retry_at: Monotonic,
    /// Moment at which it acts next.
    pub due: Monotonic,
    /// No velocity is sent until then.
    pub idle_until: Monotonic,
}

impl Operator {
    /// Creates an operator that connects at once. `together`: it drives all robots at once, each by its own topic, not
    /// the selected one after the other.
    pub fn new(network: &Rc<Network>, port: &Rc<Port>, run: &Run, together: bool) -> Self {
        let config = TourConfig { seed: run.config.fleet.seed, ..TourConfig::default() };
        let mut client = Client::new(port, SocketAddr::from(PEER));
        client.subscribe("/tf", "tf2_msgs/TFMessage");
        client.subscribe("/merged_map", "nav_msgs/OccupancyGrid");
        client.subscribe("/selected_robot", "std_msgs/Int32");
        client.subscribe("/emergency_stop", "std_msgs/Bool");
        let names = run.config.robot_names();
        for robot in run.robots() {
            client.subscribe(&names.topic(robot, "scan"), "sensor_msgs/LaserScan");
            client.subscribe(&names.topic(robot, "map"), "nav_msgs/OccupancyGrid");
            client.advertise::<ros::Twist>(&velocity_topic(robot));
        }
        client.advertise::<ros::Int32>("/selected_robot");
        client.advertise::<ros::Twist>("/cmd_vel");
        Self {
            client,
            network: network.clone(),
            world: WorldState::new(RobotTopics::new(names)),
            tour: ExplorationTour::new(config, run.robots()),
            joystick: SimulatedJoystick::default(),
            together,
            selected: None,
            retry_at: Monotonic(0),
            due: Monotonic(0),
            idle_until: Monotonic(0),
            run: run.clone(),
        }
    }

    /// Closes the connection; it connects again at `retry_at`.
    pub fn disconnect(&mut self, retry_at: Monotonic) {
        self.client.disconnect();
        self.on_disconnected(retry_at);
    }

    fn on_disconnected(&mut self, retry_at: Monotonic) {
        self.world.on_disconnected();
        (self.selected, self.retry_at) = (None, retry_at);
    }

    /// Reads what has arrived and drives, at [`PERIOD`].
    pub fn step(&mut self) {
        let now = self.network.clock().now();
        if now < self.due {
            return;
        }
        self.due = (self.due + PERIOD).max(now);
        let stamp = self.run.epoch.stamp(now);
        self.receive(stamp);
        if self.client.is_connected() {
            self.drive(now, stamp);
        } else if self.retry_at <= now {
            self.client.connect();
            self.on_disconnected(now + RETRY_PERIOD);
        }
    }

    fn receive(&mut self, stamp: Stamp) {
        let (world, network) = (&mut self.world, &self.network);
        self.client.receive(|topic, payload| {
            network.record("operator", topic, payload);
            if let Ok(content) = MessageContent::decode(world.robot_topics(), topic, payload) {
                let _ = world.store(stamp, topic, payload, content);
            }
        });
        let maps = decode_maps(self.world.take_encoded_maps());
        self.world.store_maps(maps);
    }

    fn drive(&mut self, now: Monotonic, stamp: Stamp) {
        let Some(tour) = &mut self.tour else { return };
        let states: Vec<RobotState> = self.run.robots().map(|robot| self.world.robot(stamp, robot)).collect();
        let robots: Vec<RobotObservation<'_>> = states.iter().map(RobotState::observation).collect();
        let observation = FleetObservation { stamp, robots: &robots };
        let mut commands = Vec::new();
        if self.together {
            tour.step_all(&observation, &mut commands);
        } else {
            commands.push(tour.step_in_turn(&observation));
        }
        if now < self.idle_until {
            return;
        }
        for command in commands {
            let twist = match self.world.is_emergency_stopped() {
                true => Twist::STOP,
                false => self.joystick.drive(stamp, &command),
            };
            self.publish_velocity(DriveCommand { twist, ..command });
        }
    }

    fn publish_velocity(&mut self, command: DriveCommand) {
        let Twist { linear_m_s, angular_rad_s } = command.twist;
        let twist = ros::Twist { linear: [linear_m_s, 0.0, 0.0], angular: [0.0, 0.0, angular_rad_s] };
        if self.together {
            return self.client.publish(&velocity_topic(command.robot), &twist);
        }
        if self.selected != Some(command.robot) {
            self.selected = Some(command.robot);
            return self.client.publish("/selected_robot", &ros::Int32(command.robot.number() as i32));
        }
        if self.world.selected_robot() == Some(command.robot.number() as i32) {
            self.client.publish("/cmd_vel", &twist);
        }
    }
}

/// Returns the topic of one robot's velocities.
pub fn velocity_topic(robot: RobotId) -> String {
    format!("/cmd_vel_{}", robot.number())
}
