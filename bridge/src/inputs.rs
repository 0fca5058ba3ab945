//! What clients' messages mean to the fleet: velocities, selection, the emergency stop, transforms.

use crate::bridge::FIRST_SOURCE;
use crate::cdr::{DecodeError, Reader, with_dummy_byte};
use crate::client::{ClientId, Publication, Refusal};
use crate::command::name;
use crate::dds::Heard;
use crate::drive::Verdict;
use crate::hub::Hub;
use crate::ros::names::{is_correction, meaning};
use crate::ros::read::{self, Transform};
use crate::ros::{Bool, Empty, Int32, Message, Text, Twist, TwistStamped, decode_as, write};
use crate::teleop::Stick;
use crate::topics::{Input, Source, TopicId};
use crate::world::{Incoming, SourceClock, WorldError};
use msg::{EdgeCommand, RobotId};
use std::time::Instant;

/// Why a data frame goes no further.
struct Refused(Refusal, String);

impl From<DecodeError> for Refused {
    fn from(error: DecodeError) -> Self {
        Self(Refusal::Payload, error.to_string())
    }
}

impl Hub {
    /// A message on DDS, where there is nobody to answer: what is refused is counted.
    pub(crate) fn hear_ros(&mut self, heard: &Heard) {
        let now = Instant::now();
        self.board.counted.received += 1;
        let accepted = match (heard.what, Reader::new(&heard.payload)) {
            (_, Err(_)) => false,
            (Input::Scan(robot), Ok(from)) => self.hear_world(Incoming::Scan(robot, from)),
            (Input::Odometry(robot), Ok(from)) => self.hear_world(Incoming::Odometry(robot, from)),
            (Input::Transforms, Ok(from)) => self.hear_world(Incoming::Transforms(from)),
            (Input::Clock, Ok(from)) => self.hear_world(Incoming::Clock(from)),
            (what, Ok(_)) => {
                let Some(topic) = self.board.topics.find(&heard.topic) else { return };
                let from = Publication { topic, stamped: heard.stamped, latch: false };
                self.input(ClientId::DDS, what, from, &heard.payload, now).is_ok()
            }
        };
        self.board.counted.refused += u64::from(!accepted);
    }

    /// ROS's stamps are taken as they come: all of ROS goes by one clock.
    fn hear_world(&mut self, message: Incoming<'_>) -> bool {
        let Some(outside) = &mut self.outside else { return true };
        let received = (outside.now)();
        outside.world.hear(FIRST_SOURCE, &mut self.ros_clock, message, received).is_ok()
    }

    /// A message on a topic.
    pub(crate) fn data(&mut self, id: ClientId, name: &str, payload: &[u8]) {
        let now = Instant::now();
        let topic = self.board.topics.find(name);
        let Some(client) = self.board.client(id) else { return };
        let publication = client.publications.iter().find(|known| Some(known.topic) == topic).copied();
        let Some(publication) = publication else {
            let text = format!("'{name}' is not registered for publication here: send __publish first");
            return self.board.refuse_data(id, Refusal::Unregistered, topic, now, text);
        };
        if let Err(Refused(kind, why)) = self.accept(id, publication, payload, now) {
            self.board.refuse_data(id, kind, topic, now, format!("'{name}': {why}"));
        }
    }

    fn accept(
        &mut self,
        id: ClientId,
        from: Publication,
        payload: &[u8],
        now: Instant,
    ) -> Result<(), Refused> {
        Reader::with(self.config.payloads, payload)?;
        let Some(topic) = self.board.topics.get(from.topic) else { return Ok(()) };
        if let Source::Input(input) = topic.source {
            return self.input(id, input, from, payload, now);
        }
        self.board.relay(from.topic, with_dummy_byte(self.config.payloads, payload));
        Ok(())
    }

    /// A message the fleet listens to.
    fn input(
        &mut self,
        id: ClientId,
        input: Input,
        from: Publication,
        payload: &[u8],
        now: Instant,
    ) -> Result<(), Refused> {
        // Anyone may stop; a stick in nobody's hand asks for nothing.
        if !matches!(input, Input::Stop | Input::Joystick | Input::HandInputs) {
            self.check_drive(id)?;
        }
        match input {
            Input::SelectedCommand => self.drive(id, self.drive.selected(), from, payload, now),
            Input::Command(robot) => self.drive(id, robot, from, payload, now),
            Input::Joystick => {
                let stick = Stick::from_joy(&self.decode(payload)?);
                self.board.relay(from.topic, payload);
                self.stick(id, stick, now)
            }
            Input::HandInputs => {
                let stick = Stick::from_hand(&self.decode(payload)?);
                self.board.relay(from.topic, payload);
                self.stick(id, stick, now)
            }
            Input::Transforms => self.transforms(id, from.topic, payload),
            Input::Scan(robot) => self.hear(id, Incoming::Scan(robot, self.reader(payload)?)),
            Input::Odometry(robot) => self.hear(id, Incoming::Odometry(robot, self.reader(payload)?)),
            Input::Clock => self.hear(id, Incoming::Clock(self.reader(payload)?)),
            Input::InitialPose(robot) => {
                let message = self.decode(payload)?;
                self.initial_pose(robot, &message).map_err(|why| Refused(Refusal::Content, why))
            }
            Input::Select => {
                let robot = self.robot_of(self.decode::<Int32>(payload)?)?;
                self.drive.select(robot);
                self.tell_selected();
                Ok(())
            }
            Input::Take => self.take_over(id, self.decode::<Int32>(payload)?, now),
            Input::Stop => {
                // `false` is what a button sends when it is let go: no release.
                if self.decode::<Bool>(payload)?.0 {
                    self.stop();
                }
                Ok(())
            }
            Input::MergeEdge => {
                let Text(words) = self.decode(payload)?;
                let command = EdgeCommand::parse(&words).ok_or_else(|| {
                    let text =
                        format!("`{}`; expected `pin 1 2`, `unpin 1 2` or `undo 1 2`", shortened(&words));
                    Refused(Refusal::Content, text)
                })?;
                if self.edge_command(command) {
                    Ok(())
                } else {
                    Err(Refused(Refusal::Content, "too many at once".into()))
                }
            }
            Input::Release => {
                self.decode::<Empty>(payload)?;
                self.release();
                Ok(())
            }
        }
    }

    fn decode<M: Message>(&self, payload: &[u8]) -> Result<M, DecodeError> {
        decode_as(self.config.payloads, payload)
    }

    fn reader<'a>(&self, payload: &'a [u8]) -> Result<Reader<'a>, DecodeError> {
        Reader::with(self.config.payloads, payload)
    }

    fn check_drive(&mut self, id: ClientId) -> Result<(), Refused> {
        let Some(address) = self.board.client(id).map(|client| client.peer.ip()) else { return Ok(()) };
        if self.access.may_drive(address) {
            return Ok(());
        }
        self.access.ask(address);
        let text = format!(
            "{address} may not drive yet: somebody at the laptop must press `a` there, or say `mr-slam allow {address}`"
        );
        Err(Refused(Refusal::Permission, text))
    }

    fn robot_of(&self, Int32(number): Int32) -> Result<RobotId, Refused> {
        let count = self.robot_count;
        let text = || format!("there is no robot {number}: the fleet has 1 to {count}");
        self.drive.robot(number).ok_or_else(|| Refused(Refusal::Content, text()))
    }

    fn drive(
        &mut self,
        id: ClientId,
        robot: RobotId,
        from: Publication,
        payload: &[u8],
        now: Instant,
    ) -> Result<(), Refused> {
        let twist = if from.stamped {
            self.decode::<TwistStamped>(payload)?.twist
        } else {
            self.decode::<Twist>(payload)?
        };
        let passed = self.obey(id, robot, twist.linear[0], twist.angular[2], now)?;
        // A robot that is not simulated here has been sent it already, on its own topics.
        let told = self.outside.is_some() && self.fleet.command[robot.index()].contains(&from.topic);
        if passed && !told {
            self.board.send(from.topic, |to| twist.write(to));
        }
        Ok(())
    }

    /// A velocity for a robot: whether it went there.
    fn obey(
        &mut self,
        id: ClientId,
        robot: RobotId,
        forward_m_s: f64,
        turn_rad_s: f64,
        now: Instant,
    ) -> Result<bool, Refused> {
        match self.drive.command(id, robot, (forward_m_s, turn_rad_s) != (0.0, 0.0), now) {
            Verdict::Pass => {
                self.command(robot, forward_m_s, turn_rad_s);
                Ok(true)
            }
            Verdict::Ignore => Ok(false),
            Verdict::Stopped => {
                let text = "the emergency stop is set; publish std_msgs/Empty on /emergency_stop_release to drive on";
                Err(Refused(Refusal::Stopped, text.into()))
            }
            Verdict::Held(holder) => {
                let by = self.client_name(holder);
                let number = robot.number();
                let text =
                    format!("{robot} is driven by {by}; publish {number} on /take_control to take over");
                Err(Refused(Refusal::Held, text))
            }
        }
    }

    /// A thumb stick: drives the selected robot while the grip is held. When the grip is let go, the selection
    /// changes or an axis makes no sense, the robot it drove stands.
    fn stick(&mut self, id: ClientId, stick: Option<Stick>, now: Instant) -> Result<(), Refused> {
        let held = stick.filter(|stick| stick.held);
        let target = held.map(|_| self.drive.selected());
        let before =
            self.board.client_mut(id).and_then(|client| std::mem::replace(&mut client.gripped, target));
        if let Some(robot) = before.filter(|robot| Some(*robot) != target) {
            self.obey(id, robot, 0.0, 0.0, now)?;
        }
        if let (Some(stick), Some(robot)) = (held, target) {
            self.check_drive(id)?;
            let (forward, turn) = stick.velocity(&self.config);
            self.obey(id, robot, forward, turn, now)?;
        }
        let unsound =
            || Refused(Refusal::Payload, "an axis of the stick or the grip is missing or no number".into());
        stick.map(|_| ()).ok_or_else(unsound)
    }

    fn client_name(&self, id: ClientId) -> String {
        if id == ClientId::DDS {
            return "ROS 2".into();
        }
        self.board.client(id).map_or("another client".into(), |client| client.peer.to_string())
    }

    /// Number 0 is every robot.
    fn take_over(&mut self, id: ClientId, number: Int32, now: Instant) -> Result<(), Refused> {
        let robots = match number {
            Int32(0) => RobotId::first(self.robot_count).collect(),
            number => vec![self.robot_of(number)?],
        };
        for robot in robots {
            let Some(before) = self.drive.take(id, robot, now) else { continue };
            self.halt(core::iter::once(robot));
            let by = self.client_name(id);
            self.board.notice(before, name::WARN, format!("{by} has taken over {robot}"));
        }
        Ok(())
    }

    /// A client tells of a world of its own: its scans, its robots' transforms, its clock.
    fn hear(&mut self, id: ClientId, message: Incoming<'_>) -> Result<(), Refused> {
        let (Some(outside), Some(client)) = (&mut self.outside, self.board.client_mut(id)) else {
            return Ok(());
        };
        let setting = self.config.clock_offset;
        let clock = client.clock.get_or_insert_with(|| Box::new(SourceClock::new(setting)));
        let received = (outside.now)();
        outside.world.hear(id.serial, clock, message, received).map_err(|why| match why {
            WorldError::Payload(_) => Refused(Refusal::Payload, why.to_string()),
            WorldError::OtherSource { .. } => Refused(Refusal::Held, why.to_string()),
            WorldError::Content(_) | WorldError::Correction { .. } => {
                Refused(Refusal::Content, why.to_string())
            }
        })
    }

    /// Transforms of a client's own are passed on; those of the fleet's frames belong to SLAM and the robots. One
    /// that is refused is left out, and the others are taken.
    fn transforms(&mut self, id: ClientId, topic: TopicId, payload: &[u8]) -> Result<(), Refused> {
        let from = Reader::with(self.config.payloads, payload)?;
        let robots = self.robot_count;
        let (mut foreign, mut refused) = (0, Ok(()));
        read::transforms(&mut from.clone(), |transform| {
            if is_foreign(&transform, robots) {
                foreign += 1;
            } else if refused.is_ok() && self.outside.is_none() {
                let (parent, child) = (transform.frame_id, transform.child_frame_id);
                let text =
                    format!("{parent} -> {child} is the fleet's to publish: SLAM owns map -> odom (REP-105)");
                refused = Err(Refused(Refusal::Content, text));
            }
        })?;
        if self.outside.is_some() {
            refused = self.hear(id, Incoming::Transforms(from.clone()));
        }
        if foreign > 0 {
            // Out of its place meanwhile, because the board is asked to send.
            let clock = self.board.client_mut(id).and_then(|client| client.clock.take());
            self.board.send(topic, |to| {
                to.count(foreign);
                let all_sound = read::transforms(&mut from.clone(), |transform| {
                    if is_foreign(&transform, robots) {
                        let stamp = clock.as_ref().map_or(transform.stamp, |c| c.translate(transform.stamp));
                        let (frame, child) = (transform.frame_id, transform.child_frame_id);
                        write::transform(to, stamp, frame, child, transform.translation, transform.rotation);
                    }
                });
                debug_assert!(all_sound.is_ok(), "read once before");
            });
            if let Some(client) = self.board.client_mut(id) {
                client.clock = clock;
            }
        }
        refused
    }
}

/// The beginning of what a client said.
fn shortened(text: &str) -> String {
    text.chars().take(40).collect()
}

/// Not of the fleet's frames.
fn is_foreign(transform: &Transform<'_>, robot_count: usize) -> bool {
    let (parent, child) = (transform.frame_id, transform.child_frame_id);
    meaning(child, robot_count).is_none() && !is_correction(parent, child, robot_count)
}
