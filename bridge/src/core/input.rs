//! Messages of clients and of DDS that the fleet interprets: velocities, selection, emergency stop, sensor data.

use super::Core;
use super::initial_pose::InitialPoseError;
use super::navigation::{ExclusionError, GoalError};
use super::world::world_message;
use crate::access::{Action, PermissionError};
use crate::command::name;
use crate::drive::velocity_gate::{GateDecision, Velocity};
use crate::input::InputPurpose;
use crate::relay::ReceivedMessage;
use crate::router::{ClientId, Publication, RefusalKind, Source, TopicId};
use crate::teleop::Stick;
use crate::world::{Incoming, WorldError};
use msg::{EdgeCommand, Monotonic, OperatorAction, PauseReason, RobotId};
use ros_messages::cdr::{DecodeError, Reader, with_dummy_byte};
use ros_messages::{Bool, Empty, Int32, Message, Text, Twist, TwistStamped, decode_as};
use thiserror::Error;

/// Characters of a client's text that are quoted in an error.
const QUOTED_MAX: usize = 40;

/// Why a message is refused.
#[derive(Debug, Error)]
pub enum InputError {
    /// The payload is not the topic's message.
    #[error(transparent)]
    Payload(#[from] DecodeError),
    /// An axis of a hand controller is missing or not finite.
    #[error("an axis of the stick or the grip is missing or not a number")]
    StickAxis,
    /// The client's address may not drive.
    #[error(transparent)]
    Permission(#[from] PermissionError),
    /// A velocity is infinite or not a number.
    #[error("the velocity is not finite; expected m/s and rad/s")]
    NotFinite,
    /// Another client drives the robot.
    #[error("{robot} is driven by {driver}; publish {} on /take_control to take over", robot.number())]
    DrivenByOther {
        /// Robot that the client wants to drive.
        robot: RobotId,
        /// The other client's address, or `ROS 2`.
        driver: String,
    },
    /// The emergency stop is set.
    #[error("the emergency stop is set; publish std_msgs/Empty on /emergency_stop_release to drive on")]
    EmergencyStop,
    /// The fleet has no robot of that number.
    #[error("there is no robot {number}: the fleet has 1 to {robot_count}")]
    NoSuchRobot {
        /// The number in the message.
        number: i32,
        /// The fleet's number of robots.
        robot_count: usize,
    },
    /// The text is not a command for merging.
    #[error("`{text}`; expected `pin 1 2`, `unpin 1 2` or `undo 1 2`")]
    EdgeCommand {
        /// The beginning of the text.
        text: String,
    },
    /// Too many commands for merging wait.
    #[error("too many edge commands wait; send this one again")]
    TooManyEdgeCommands,
    /// The transform is between the fleet's own frames.
    #[error("{parent} -> {child} is the fleet's to publish: SLAM owns map -> odom (REP-105)")]
    FleetFrames {
        /// The parent frame in the message.
        parent: String,
        /// The child frame in the message.
        child: String,
    },
    /// The initial pose is not one.
    #[error(transparent)]
    InitialPose(#[from] InitialPoseError),
    /// The goal is not one.
    #[error(transparent)]
    Goal(#[from] GoalError),
    /// The exclusion zone is not one.
    #[error(transparent)]
    Exclusion(#[from] ExclusionError),
    /// The external world refuses the message.
    #[error(transparent)]
    World(#[from] WorldError),
}

impl InputError {
    pub(super) fn kind(&self) -> RefusalKind {
        match self {
            Self::Payload(_) | Self::NotFinite | Self::StickAxis | Self::World(WorldError::Payload(_)) => {
                RefusalKind::Payload
            }
            Self::Permission(_) => RefusalKind::Permission,
            Self::DrivenByOther { .. } | Self::World(WorldError::OtherSource { .. }) => {
                RefusalKind::OtherClient
            }
            Self::EmergencyStop => RefusalKind::EmergencyStop,
            _ => RefusalKind::Content,
        }
    }
}

impl Core {
    /// Handles a message from DDS. Nobody can be told of a refusal there: it is counted, and in the operator's log.
    pub fn receive_dds(&mut self, message: &ReceivedMessage, now: Monotonic) {
        self.router.counted.received += 1;
        let (input, payload) = (message.input(), message.payload());
        let result = match Reader::new(payload).map(|from| world_message(input, from)) {
            Err(error) => Err(error.into()),
            Ok(Some(fixed)) if input == InputPurpose::StaticTransforms => {
                self.receive_static_transforms(ClientId::DDS, payload, fixed, now)
            }
            Ok(Some(of_world)) => self.receive_dds_world(message.publisher(), of_world, now),
            Ok(None) => {
                let Some(topic) = self.router.topics.find(message.topic()) else { return };
                let publication = Publication { topic, stamped: message.is_stamped(), latch: false };
                self.apply_input(ClientId::DDS, input, publication, payload, now)
            }
        };
        if let Err(error) = result {
            self.refuse_ros(message.topic(), &error, now);
        }
    }

    /// Handles a client's message on a topic.
    pub(super) fn receive_data(&mut self, id: ClientId, name: &str, payload: &[u8], now: Monotonic) {
        let topic = self.router.topics.find(name);
        let Some(client) = self.router.client(id) else { return };
        let publication = client.publications.iter().find(|known| Some(known.topic) == topic).copied();
        let Some(publication) = publication else {
            let text = || format!("'{name}' is not registered for publication here: send __publish first");
            return self.router.refuse_data(id, RefusalKind::NotRegistered, topic, now, text);
        };
        if let Err(error) = self.accept_data(id, publication, payload, now) {
            self.router.refuse_data(id, error.kind(), topic, now, || format!("'{name}': {error}"));
        }
    }

    fn accept_data(
        &mut self,
        id: ClientId,
        publication: Publication,
        payload: &[u8],
        now: Monotonic,
    ) -> Result<(), InputError> {
        Reader::with(self.config.payloads, payload)?;
        let Some(topic) = self.router.topics.get(publication.topic) else { return Ok(()) };
        if let Source::Input(input) = topic.source {
            return self.apply_input(id, input, publication, payload, now);
        }
        let message = with_dummy_byte(self.config.payloads, payload);
        self.warn_of_unlatched(id, publication.topic, message.len(), now);
        self.router.forward(publication.topic, message);
        self.relay_message(id, publication.topic, message);
        self.accept_shared_goal(id, publication.topic, payload, now)
    }

    /// Warns a client whose message late subscribers do not get; the same once a second.
    fn warn_of_unlatched(&mut self, id: ClientId, topic: TopicId, payload_bytes: usize, now: Monotonic) {
        if !self.router.is_too_large_to_latch(topic, payload_bytes) {
            return;
        }
        let Some(client) = self.router.client_mut(id) else { return };
        if !client.should_report(RefusalKind::NotLatched, Some(topic), now) {
            return;
        }
        let name = self.router.topics.get(topic).map_or("", |topic| topic.name.as_str());
        let text = format!(
            "'{name}': a message of {payload_bytes} bytes is passed on, but late subscribers get the one before: all latched \
             messages of clients together have at most {} bytes (latched_bytes_max in [bridge])",
            self.config.latched_bytes_max
        );
        self.router.send_notice(id, name::WARN, text);
    }

    /// Applies a message that the fleet interprets.
    fn apply_input(
        &mut self,
        id: ClientId,
        input: InputPurpose,
        publication: Publication,
        payload: &[u8],
        now: Monotonic,
    ) -> Result<(), InputError> {
        self.check_permission(id, input)?;
        match input {
            InputPurpose::SelectedCommand => {
                self.drive(id, self.gate.drive().selected(), publication, payload, now)
            }
            InputPurpose::Command(robot) => self.drive(id, robot, publication, payload, now),
            InputPurpose::Joystick | InputPurpose::HandInputs => {
                let stick = match input {
                    InputPurpose::Joystick => Stick::from_joy(&self.decode(payload)?),
                    _ => Stick::from_hand(&self.decode(payload)?),
                };
                self.router.forward(publication.topic, payload);
                self.apply_stick(id, stick, now)
            }
            InputPurpose::Transforms => {
                self.receive_transforms(id.into(), publication.topic, self.reader(payload)?, now)
            }
            InputPurpose::StaticTransforms => {
                let fixed = Incoming::StaticTransforms(None, self.reader(payload)?);
                self.receive_static_transforms(id, payload, fixed, now)
            }
            InputPurpose::Scan(_)
            | InputPurpose::Odometry(_)
            | InputPurpose::Battery(_)
            | InputPurpose::RobotTransforms(_)
            | InputPurpose::RobotStaticTransforms(_)
            | InputPurpose::Clock => world_message(input, self.reader(payload)?)
                .map_or(Ok(()), |message| self.receive_world(id.into(), message, now)),
            InputPurpose::InitialPose(robot) => Ok(self.request_initial_pose(robot, &self.decode(payload)?)?),
            InputPurpose::SelectRobot => {
                let robot = self.robot_numbered(self.decode::<Int32>(payload)?)?;
                self.select(robot);
                Ok(())
            }
            InputPurpose::TakeControl => self.take_control(id, self.decode::<Int32>(payload)?, now),
            InputPurpose::EmergencyStop => {
                // A button that is released sends `false`: that must not release the stop.
                if self.decode::<Bool>(payload)?.0 {
                    self.set_emergency_stop_at(now);
                }
                Ok(())
            }
            InputPurpose::ReleaseStop => {
                self.decode::<Empty>(payload)?;
                self.release_emergency_stop();
                Ok(())
            }
            InputPurpose::MergeEdge => self.queue_edge_command(&self.decode::<Text>(payload)?.0),
            _ => self.apply_navigation_input(input, payload, now),
        }
    }

    /// Anyone who is not denied may stop the robots, and an idle hand controller needs no permission.
    fn check_permission(&mut self, id: ClientId, input: InputPurpose) -> Result<(), InputError> {
        match input {
            InputPurpose::EmergencyStop => self.check(Action::Stop, id)?,
            InputPurpose::Joystick | InputPurpose::HandInputs => {}
            _ => self.check(Action::Drive, id)?,
        }
        Ok(())
    }

    pub(super) fn decode<M: Message>(&self, payload: &[u8]) -> Result<M, DecodeError> {
        decode_as(self.config.payloads, payload)
    }

    fn reader<'a>(&self, payload: &'a [u8]) -> Result<Reader<'a>, DecodeError> {
        Reader::with(self.config.payloads, payload)
    }

    /// Fails if the client's address may not do this. On DDS nobody is known; its inputs exist only if all may drive.
    pub(super) fn check(&mut self, action: Action, id: ClientId) -> Result<(), PermissionError> {
        match self.router.client(id) {
            Some(client) => self.access.check(action, client.peer.ip()),
            None => Ok(()),
        }
    }

    fn robot_numbered(&self, Int32(number): Int32) -> Result<RobotId, InputError> {
        let robot_count = self.fleet.robot_count();
        self.gate.drive().robot(number).ok_or(InputError::NoSuchRobot { number, robot_count })
    }

    /// Selects the robot that `/cmd_vel` drives.
    pub fn select(&mut self, robot: RobotId) {
        self.gate.drive_mut().select(robot);
        self.commands.push_operator_event(OperatorAction::Select, Some(robot));
        self.publish_selected();
    }

    fn queue_edge_command(&mut self, text: &str) -> Result<(), InputError> {
        let quoted = || InputError::EdgeCommand { text: text.chars().take(QUOTED_MAX).collect() };
        let command = EdgeCommand::parse(text).ok_or_else(quoted)?;
        let (number, robot_count) = (command.later_robot(), self.fleet.robot_count());
        if number > robot_count {
            return Err(InputError::NoSuchRobot { number: number as i32, robot_count });
        }
        let is_queued = self.commands.push_edge_command(command);
        is_queued.then_some(()).ok_or(InputError::TooManyEdgeCommands)
    }

    fn drive(
        &mut self,
        id: ClientId,
        robot: RobotId,
        publication: Publication,
        payload: &[u8],
        now: Monotonic,
    ) -> Result<(), InputError> {
        let twist = if publication.stamped {
            self.decode::<TwistStamped>(payload)?.twist
        } else {
            self.decode::<Twist>(payload)?
        };
        let (linear_m_s, angular_rad_s) = (twist.linear[0], twist.angular[2]);
        self.request_velocity(id, robot, Velocity { linear_m_s, angular_rad_s }, now)
    }

    /// Sends a client's velocity through the gate to a robot.
    fn request_velocity(
        &mut self,
        id: ClientId,
        robot: RobotId,
        velocity: Velocity,
        now: Monotonic,
    ) -> Result<(), InputError> {
        let is_new_driver = self.gate.drive().leaseholder(robot, now).is_none();
        let decision = self.gate.request(self.driver(id), robot, velocity, now);
        self.send_velocities();
        match decision {
            GateDecision::Passed(passed) => {
                self.pause_if_moving(robot, passed, now, is_new_driver);
                Ok(())
            }
            // A client never gives way to the base.
            GateDecision::Ignored | GateDecision::DrivenByBase => Ok(()),
            GateDecision::NotFinite => Err(InputError::NotFinite),
            GateDecision::Stopped => Err(InputError::EmergencyStop),
            GateDecision::DrivenBy(holder) => {
                Err(InputError::DrivenByOther { robot, driver: self.driver_name(holder) })
            }
        }
    }

    /// Drives the selected robot by a thumb stick while its grip (dead man's switch) is held.
    ///
    /// The robot that the stick moved stops when the grip is released, the selection changes or an axis is invalid. A
    /// client without permission never has such a robot, so that none stops for it.
    fn apply_stick(&mut self, id: ClientId, stick: Option<Stick>, now: Monotonic) -> Result<(), InputError> {
        let held = stick.filter(|stick| stick.grip_held);
        let permission = held.map_or(Ok(()), |_| self.check(Action::Drive, id));
        let target = held.filter(|_| permission.is_ok()).map(|_| self.gate.drive().selected());
        let before = self.gate.drive_mut().set_stick_target(id, target);
        if let Some(robot) = before.filter(|robot| Some(*robot) != target) {
            self.request_velocity(id, robot, Velocity::ZERO, now)?;
        }
        permission?;
        if let (Some(stick), Some(robot)) = (held, target) {
            let (linear_m_s, angular_rad_s) = stick.velocity(&self.config);
            self.request_velocity(id, robot, Velocity { linear_m_s, angular_rad_s }, now)?;
        }
        stick.map(|_| ()).ok_or(InputError::StickAxis)
    }

    /// Takes one robot over from its driver, or all robots if the number is 0.
    fn take_control(&mut self, id: ClientId, number: Int32, now: Monotonic) -> Result<(), InputError> {
        let robots = match number {
            Int32(0) => self.fleet.robots().collect(),
            number => vec![self.robot_numbered(number)?],
        };
        self.commands.record_time(now);
        for robot in robots {
            self.push_pause(robot, PauseReason::Person);
            let before = self.gate.take_control(self.driver(id), robot, now);
            self.send_velocities();
            self.commands.push_operator_event(OperatorAction::TakeControl, Some(robot));
            let Some(before) = before else { continue };
            let by = self.client_name(id);
            self.router.send_notice(before, name::WARN, format!("{by} has taken over {robot}"));
        }
        Ok(())
    }
}
