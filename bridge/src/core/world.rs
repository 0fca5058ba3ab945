//! Sensor data of an external world, from clients and from DDS.

use super::Core;
use super::input::InputError;
use crate::fleet_topics::FleetTopic;
use crate::input::InputPurpose;
use crate::router::{ClientId, TopicId};
use crate::world::{DDS_SOURCE, Incoming, PublisherId, Sender, WorldInput};
use msg::Monotonic;
use ros_messages::cdr::Reader;
use ros_messages::names::RobotNames;
use ros_messages::read::{self, Transform};
use ros_messages::write;

/// Who sent sensor data: a client, or a publisher on DDS.
#[derive(Clone, Copy)]
pub(super) struct WorldSender {
    client: ClientId,
    publisher: Option<PublisherId>,
}

impl From<ClientId> for WorldSender {
    fn from(client: ClientId) -> Self {
        Self { client, publisher: None }
    }
}

impl WorldSender {
    /// Returns the same for the external world, which counts all of DDS as one source.
    fn of_world(self) -> Sender {
        let source = if self.client == ClientId::DDS { DDS_SOURCE } else { self.client.serial };
        Sender { source, publisher: self.publisher }
    }
}

impl Core {
    /// Takes a message of robots on DDS.
    pub(super) fn receive_dds_world(
        &mut self,
        publisher: Option<PublisherId>,
        message: Incoming<'_>,
        now: Monotonic,
    ) -> Result<(), InputError> {
        let sender = WorldSender { client: ClientId::DDS, publisher };
        if self.world.is_none() {
            return Ok(());
        }
        let topic = self.router.topics.find(FleetTopic::Transforms.row().name);
        match (message, topic) {
            (Incoming::Transforms(from), Some(topic)) => self.receive_transforms(sender, topic, from, now),
            (message, _) => self.receive_world(sender, message, now),
        }
    }

    /// Passes a source's sensor data to the external world.
    pub(super) fn receive_world(
        &mut self,
        sender: WorldSender,
        message: Incoming<'_>,
        now: Monotonic,
    ) -> Result<(), InputError> {
        let Some(world) = &mut self.world else { return Ok(()) };
        let result = world.receive(sender.of_world(), message, now);
        if let Some((robot, step_s)) = world.take_clock_step(sender.of_world().source) {
            self.report_clock_step(sender.client, robot, step_s);
        }
        while let Some(notice) = self.world.as_mut().and_then(WorldInput::take_notice) {
            self.report(notice);
        }
        Ok(result?)
    }

    /// Takes transforms that never change: the external world reads where LiDARs are mounted, and clients get all of them.
    pub(super) fn receive_static_transforms(
        &mut self,
        id: ClientId,
        payload: &[u8],
        message: Incoming<'_>,
        now: Monotonic,
    ) -> Result<(), InputError> {
        self.receive_world(id.into(), message, now)?;
        Ok(self.fleet.receive_static_transforms(&mut self.router, payload)?)
    }

    /// Forwards a source's own transforms to clients; those between the fleet's frames belong to SLAM and the robots.
    ///
    /// Refused transforms are left out, and the others are taken; the error is the first one's.
    pub(super) fn receive_transforms(
        &mut self,
        sender: WorldSender,
        topic: TopicId,
        from: Reader<'_>,
        now: Monotonic,
    ) -> Result<(), InputError> {
        let robots = self.fleet.robot_names().clone();
        let (mut foreign, mut result) = (0, Ok(()));
        read::transforms(&mut from.clone(), |transform| {
            if is_foreign(&transform, &robots) {
                foreign += 1;
            } else if result.is_ok() && self.world.is_none() {
                let (parent, child) = (transform.frame_id.to_owned(), transform.child_frame_id.to_owned());
                result = Err(InputError::FleetFrames { parent, child });
            }
        })?;
        if self.world.is_some() {
            result = self.receive_world(sender, Incoming::Transforms(from.clone()), now);
        }
        if foreign > 0 {
            let world = self.world.as_ref();
            self.router.publish(topic, |to| {
                to.count(foreign);
                let reread = read::transforms(&mut from.clone(), |transform| {
                    if is_foreign(&transform, &robots) {
                        let stamp = world.map_or(transform.stamp, |w| {
                            w.translate(sender.of_world().source, transform.stamp)
                        });
                        let (frame, child) = (transform.frame_id, transform.child_frame_id);
                        write::transform(to, stamp, frame, child, transform.translation, transform.rotation);
                    }
                });
                debug_assert!(reread.is_ok(), "the same bytes were read before");
            });
        }
        result
    }
}

/// Returns the message to the external world that an input is, if it is one.
pub(super) fn world_message(input: InputPurpose, from: Reader<'_>) -> Option<Incoming<'_>> {
    Some(match input {
        InputPurpose::Scan(robot) => Incoming::Scan(robot, from),
        InputPurpose::Transforms => Incoming::Transforms(from),
        InputPurpose::Odometry(robot) => Incoming::Odometry(robot, from),
        InputPurpose::Battery(robot) => Incoming::Battery(robot, from),
        InputPurpose::RobotTransforms(robot) => Incoming::RobotTransforms(robot, from),
        InputPurpose::StaticTransforms => Incoming::StaticTransforms(None, from),
        InputPurpose::RobotStaticTransforms(robot) => Incoming::StaticTransforms(Some(robot), from),
        InputPurpose::Clock => Incoming::Clock(from),
        _ => return None,
    })
}

/// Returns whether a transform is not between the fleet's frames.
fn is_foreign(transform: &Transform<'_>, robots: &RobotNames) -> bool {
    let (parent, child) = (transform.frame_id, transform.child_frame_id);
    robots.parse_frame(child).is_none() && !robots.is_correction(parent, child)
}

#[cfg(test)]
mod tests {
    use crate::command::{Registration, name};
    use crate::frame::{Parser, Side};
    use crate::input::InputPurpose;
    use crate::relay::{ReceivedMessage, RosEvent};
    use crate::world::ExternalWorld;
    use crate::{Bridge, BridgeConfig, ClientId};
    use msg::{Monotonic, Stamp};
    use ros_messages::{Message, RobotNames, TfMessage, TransformStamped, decode, encode};

    const NOW: Monotonic = Monotonic(1_000_000_000);

    fn transform(parent: &str, child: &str, x_m: f64) -> TransformStamped {
        TransformStamped {
            stamp: Stamp(1_000_000_000),
            frame_id: parent.into(),
            child_frame_id: child.into(),
            translation: [x_m, 0.0, 0.0],
            rotation: [0.0, 0.0, 0.0, 1.0],
        }
    }

    /// A bridge of one external robot with plain names.
    fn bridge() -> Bridge {
        let world = ExternalWorld::new(RobotNames::new(vec![String::new()]).unwrap(), |_| {});
        let stamp_at = |now: Monotonic| Stamp(now.0 as i64);
        Bridge::with_external_world(BridgeConfig::default(), world, stamp_at, |_, _| {}).unwrap()
    }

    fn subscribe(bridge: &Bridge, topic: &str) -> ClientId {
        let client = bridge.connect(([127, 0, 0, 1], 1).into()).unwrap();
        let (topic, message_name) = (topic.to_owned(), TfMessage::TYPE.to_owned());
        let registration = Registration { topic, message_name, ..Registration::default() };
        let mut bytes = Vec::new();
        Side::Client.write_command(&mut bytes, name::SUBSCRIBE, &registration);
        let mut parser = Parser::new(1 << 20);
        parser.push(&bytes);
        while let Some(frame) = parser.next_frame().unwrap() {
            bridge.receive(client, frame, NOW);
        }
        client
    }

    /// Takes the transforms that a client has got: parent, child and x, in metres.
    fn received(bridge: &Bridge, client: ClientId, topic: &str) -> Vec<Vec<(String, String, f64)>> {
        let mut parser = Parser::new(1 << 20);
        let mut bytes = Vec::new();
        bridge.take_outgoing(client, &mut bytes).unwrap();
        parser.push(&bytes);
        let mut messages = Vec::new();
        while let Some(frame) = parser.next_frame().unwrap() {
            if frame.name == topic.as_bytes() {
                let message: TfMessage = decode(frame.payload).unwrap();
                let row = |t: TransformStamped| (t.frame_id, t.child_frame_id, t.translation[0]);
                messages.push(message.transforms.into_iter().map(row).collect());
            }
        }
        messages
    }

    fn send_from_ros(bridge: &Bridge, input: InputPurpose, topic: &str, transforms: Vec<TransformStamped>) {
        let mut payload = Vec::new();
        encode(&TfMessage { transforms }, &mut payload);
        let message = ReceivedMessage::new(input, topic.into(), false, payload);
        bridge.receive_ros(RosEvent::Input(message), NOW);
    }

    fn row(parent: &str, child: &str, x_m: f64) -> (String, String, f64) {
        (parent.into(), child.into(), x_m)
    }

    #[test]
    fn fixed_transforms_of_ros_are_one_latched_set_on_tcp() {
        let bridge = bridge();
        let early = subscribe(&bridge, "/tf_static");
        let send =
            |transforms| send_from_ros(&bridge, InputPurpose::StaticTransforms, "/tf_static", transforms);
        // Two publishers, each with its own latched message; the newest transform to a frame counts.
        send(vec![transform("base_link", "base_scan", 0.1), transform("base_link", "/camera", 0.2)]);
        send(vec![transform("camera", "camera_optical", 0.3), transform("map", "odom", 9.0)]);
        send(vec![transform("base_link", "camera", 0.4)]);
        send(vec![transform("base_link", "camera", 0.4)]);
        let whole = vec![
            row("base_link", "base_scan", 0.1),
            row("base_link", "camera", 0.4),
            row("camera", "camera_optical", 0.3),
        ];
        let messages = received(&bridge, early, "/tf_static");
        assert_eq!(messages.last(), Some(&whole), "SLAM's own map -> odom is left out: {messages:?}");
        let late = subscribe(&bridge, "/tf_static");
        assert_eq!(received(&bridge, late, "/tf_static"), [whole]);
    }

    #[test]
    fn moving_transforms_of_other_frames_in_ros_reach_clients() {
        let bridge = bridge();
        let client = subscribe(&bridge, "/tf");
        let transforms = vec![
            transform("map", "odom", 9.0),
            transform("odom", "base_footprint", 1.5),
            transform("base_link", "gripper", 0.2),
        ];
        send_from_ros(&bridge, InputPurpose::Transforms, "/tf", transforms);
        let messages = received(&bridge, client, "/tf");
        let of_gripper = messages.iter().flatten().filter(|(_, child, _)| child == "gripper");
        assert_eq!(of_gripper.collect::<Vec<_>>(), [&row("base_link", "gripper", 0.2)]);
        assert!(messages.iter().flatten().all(|(_, child, _)| child != "odom"), "{messages:?}");
    }
}
