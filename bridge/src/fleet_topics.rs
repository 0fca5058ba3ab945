//! The fleet's topics towards ros_tcp clients.

mod changed_area;
mod changed_tiles;
mod odom_frames;
mod publisher;
mod static_transforms;
mod table;

pub use publisher::{FleetMessage, FleetPublisher, RobotTransformPolicy, TopicSink};
pub use table::{Delivery, FleetTopic, OUTGOING_TOPICS, OutgoingTopic};

use crate::input::{ADD_ZONE, EXPLORE, InputPurpose, REMOVE_ZONE};
use crate::router::{DEPTH_DEFAULT, Retention, Source, TopicId, TopicRouter, TopicTable};
use msg::{Monotonic, RobotId, Stamp};
use ros_messages::OdometrySigmas;
use ros_messages::cdr::{DecodeError, Writer};
use ros_messages::{
    Bool, Empty, FrameNames, HandInputs, Int32, Joy, Message, NameStyle, PathMessage, PolygonStamped,
    PoseStamped, PoseWithCovarianceStamped, RobotNames, Text, Twist,
};

/// The fleet's topics in the router, and what is published on them.
pub struct FleetTopics {
    publisher: FleetPublisher,
    /// Topics by row of [`OUTGOING_TOPICS`], then by robot; empty for a topic that is not on TCP.
    ids: [Vec<TopicId>; OUTGOING_TOPICS.len()],
    /// Topics on which each robot's velocities are published, and a robot of an external world receives them.
    velocity: Vec<[TopicId; 2]>,
    /// The topic on which the selected robot's velocities are published.
    selected_velocity: TopicId,
}

/// The topics that clients alone publish, and their meaning.
fn add_input_topics(table: &mut TopicTable, robots: &RobotNames) -> (TopicId, Vec<[TopicId; 2]>) {
    let mut add = |name: String, message_type: &str, input: InputPurpose| {
        table.add(name, message_type, Source::Input(input), Retention { depth: DEPTH_DEFAULT, latch: false })
    };
    let selected = add("/cmd_vel".into(), Twist::TYPE, InputPurpose::SelectedCommand);
    let mut velocity = Vec::with_capacity(robots.count());
    add("/initialpose".into(), PoseWithCovarianceStamped::TYPE, InputPurpose::InitialPose(None));
    for robot in robots.robots() {
        let numbered = add(format!("/cmd_vel_{}", robot.number()), Twist::TYPE, InputPurpose::Command(robot));
        // The names of a robot with plain ones are those above.
        if robots.is_plain() {
            velocity.push([numbered, selected]);
            continue;
        }
        let own = add(robots.topic(robot, "cmd_vel"), Twist::TYPE, InputPurpose::Command(robot));
        velocity.push([numbered, own]);
        let name = robots.topic(robot, "initialpose");
        add(name, PoseWithCovarianceStamped::TYPE, InputPurpose::InitialPose(Some(robot)));
    }
    for robot in robots.robots() {
        if !robots.is_plain() {
            add(robots.topic(robot, "goal_pose"), PoseStamped::TYPE, InputPurpose::Goal(Some(robot)));
        }
        add(robots.topic(robot, "waypoints"), PathMessage::TYPE, InputPurpose::Waypoints(robot));
        add(robots.topic(robot, "cancel_navigation"), Empty::TYPE, InputPurpose::CancelNavigation(robot));
        add(robots.topic(robot, "resume_navigation"), Empty::TYPE, InputPurpose::ResumeNavigation(robot));
    }
    add("/quest/joystick".into(), Joy::TYPE, InputPurpose::Joystick);
    add("/q2r_right_hand_inputs".into(), HandInputs::TYPE, InputPurpose::HandInputs);
    add(EXPLORE.into(), Bool::TYPE, InputPurpose::Explore);
    add(ADD_ZONE.into(), PolygonStamped::TYPE, InputPurpose::AddZone);
    add(REMOVE_ZONE.into(), Int32::TYPE, InputPurpose::RemoveZone);
    add("/take_control".into(), Int32::TYPE, InputPurpose::TakeControl);
    add("/emergency_stop_release".into(), Empty::TYPE, InputPurpose::ReleaseStop);
    add("/merge_edge_command".into(), Text::TYPE, InputPurpose::MergeEdge);
    (selected, velocity)
}

/// Returns who may publish a topic of the table: a few are clients' as well as the fleet's.
fn source(topic: FleetTopic, robot: RobotId, is_external: bool) -> Source {
    match topic {
        FleetTopic::Transforms => Source::Input(InputPurpose::Transforms),
        FleetTopic::SelectedRobot => Source::Input(InputPurpose::SelectRobot),
        FleetTopic::EmergencyStop => Source::Input(InputPurpose::EmergencyStop),
        FleetTopic::Scan if is_external => Source::Input(InputPurpose::Scan(robot)),
        FleetTopic::Odometry if is_external => Source::Input(InputPurpose::Odometry(robot)),
        FleetTopic::Battery if is_external => Source::Input(InputPurpose::Battery(robot)),
        FleetTopic::Clock if is_external => Source::Input(InputPurpose::Clock),
        _ => Source::Fleet,
    }
}

impl FleetTopics {
    /// Adds the fleet's topics to the table. In an external world clients publish sensor data and the clock.
    pub fn new(table: &mut TopicTable, style: NameStyle, robots: &RobotNames, is_external: bool) -> Self {
        let (selected_velocity, velocity) = add_input_topics(table, robots);
        let ids = OUTGOING_TOPICS.each_ref().map(|row| {
            let Some(delivery) = row.tcp else { return Vec::new() };
            // An alias is copied when somebody subscribes to it, so that it costs nothing otherwise.
            let latch = delivery == Delivery::Latched && !row.is_alias();
            let retention = Retention { depth: delivery.depth(robots.count()), latch };
            let named = robots.robots().zip(row.names(robots));
            let add = |(robot, name)| {
                let source = source(row.topic, robot, is_external);
                table.add(name, row.message_type, source, retention)
            };
            named.map(add).collect()
        });
        let publisher = FleetPublisher::new(style, robots, RobotTransformPolicy::OnTf);
        Self { publisher, ids, velocity, selected_velocity }
    }

    /// Sets the errors of the robots' odometry.
    pub fn set_odometry_sigmas(&mut self, sigmas: OdometrySigmas) {
        self.publisher.set_odometry_sigmas(sigmas);
    }

    /// Publishes a message of the fleet.
    pub fn publish(&mut self, router: &mut TopicRouter, message: FleetMessage<'_>) {
        self.publisher.publish(message, &mut RouterSink { router, ids: &self.ids });
    }

    /// Adds transforms of an external world that never change to those of the fleet, and publishes all of them.
    ///
    /// # Errors
    /// The payload is no tf2_msgs/TFMessage.
    pub fn receive_static_transforms(
        &mut self,
        router: &mut TopicRouter,
        payload: &[u8],
    ) -> Result<(), DecodeError> {
        self.publisher.receive_static_transforms(payload, &mut RouterSink { router, ids: &self.ids })
    }

    /// Publishes which robot `/cmd_vel` drives.
    pub fn publish_selected(&self, router: &mut TopicRouter, robot: RobotId) {
        let selected = Int32(robot.number() as i32);
        RouterSink { router, ids: &self.ids }.send(FleetTopic::SelectedRobot, None, |to| selected.write(to));
    }

    /// Publishes whether the emergency stop is set.
    pub fn publish_stop(&self, router: &mut TopicRouter, is_stopped: bool) {
        let stop = Bool(is_stopped);
        RouterSink { router, ids: &self.ids }.send(FleetTopic::EmergencyStop, None, |to| stop.write(to));
    }

    /// Publishes a robot's velocity on its topics, and on `/cmd_vel` if it is the selected robot.
    pub fn publish_velocity(
        &self,
        router: &mut TopicRouter,
        robot: RobotId,
        is_selected: bool,
        twist: &Twist,
    ) {
        let own = &self.velocity[robot.index()];
        let selected = Some(&self.selected_velocity).filter(|topic| is_selected && !own.contains(*topic));
        for topic in own.iter().chain(selected) {
            router.publish(*topic, |to| twist.write(to));
        }
    }

    /// Returns the robot whose velocities are published on this topic, if they are on one.
    pub fn robot_of_velocity_topic(&self, topic: TopicId, selected: RobotId) -> Option<RobotId> {
        if topic == self.selected_velocity {
            return Some(selected);
        }
        self.robots().find(|robot| self.velocity[robot.index()].contains(&topic))
    }

    /// Publishes again what late subscribers would miss; call it a few times a second.
    pub fn tick(&mut self, router: &mut TopicRouter, now: Monotonic) {
        self.publisher.tick(now, &mut RouterSink { router, ids: &self.ids });
    }

    /// Publishes what a new subscriber of `topic` lacks: the map transforms on `/tf`, the newest map on `/map`.
    pub fn subscribed(&mut self, router: &mut TopicRouter, topic: TopicId) {
        let mut sink = RouterSink { router, ids: &self.ids };
        if self.ids[FleetTopic::Transforms as usize].contains(&topic) {
            self.publisher.publish_map_transforms(&mut sink);
        } else if self.ids[FleetTopic::MergedMapAlias as usize].contains(&topic) {
            sink.send_again(FleetTopic::MergedMapAlias, FleetTopic::MergedMap);
        }
    }

    /// Returns whether a client is subscribed to a robot's topic.
    pub fn is_subscribed(&self, router: &TopicRouter, topic: FleetTopic, robot: RobotId) -> bool {
        let id = self.ids[topic as usize].get(robot.index());
        let topic = id.and_then(|id| router.topics.get(*id));
        topic.is_some_and(|topic| !topic.subscribers.is_empty())
    }

    /// Returns the number of robots.
    pub fn robot_count(&self) -> usize {
        self.publisher.robots().count()
    }

    /// Returns the fleet's robots.
    pub fn robots(&self) -> impl Iterator<Item = RobotId> + use<> {
        self.publisher.robots().robots()
    }

    /// Returns the robots' names.
    pub fn robot_names(&self) -> &RobotNames {
        self.publisher.robots()
    }

    /// Returns the names of the robots' frames.
    pub fn frame_names(&self) -> &FrameNames {
        self.publisher.names()
    }

    /// Returns the newest time of the run that was published.
    pub fn now(&self) -> Stamp {
        self.publisher.now()
    }

    /// Returns the newest transforms from the robots' maps to the merged map.
    pub fn map_transforms(&self) -> Option<&msg::MapTransforms> {
        self.publisher.map_transforms()
    }
}

/// The router as a transport.
struct RouterSink<'a> {
    router: &'a mut TopicRouter,
    ids: &'a [Vec<TopicId>],
}

impl TopicSink for RouterSink<'_> {
    fn send(&mut self, topic: FleetTopic, robot: Option<RobotId>, encode: impl FnOnce(&mut Writer<'_>)) {
        if let Some(id) = self.ids[topic as usize].get(robot.map_or(0, RobotId::index)) {
            self.router.publish(*id, encode);
        }
    }

    fn send_again(&mut self, topic: FleetTopic, newest_of: FleetTopic) {
        let id = |topic: FleetTopic| self.ids[topic as usize].first().copied();
        if let (Some(to), Some(from)) = (id(topic), id(newest_of)) {
            self.router.publish_copy(to, from);
        }
    }

    fn is_subscribed(&self, topic: FleetTopic) -> bool {
        let of_topic = self.ids[topic as usize].iter().filter_map(|id| self.router.topics.get(*id));
        of_topic.into_iter().any(|topic| !topic.subscribers.is_empty())
    }
}

#[cfg(test)]
mod tests;
