//! The exchange of clients' topics with ROS: who may publish there, and what clients are told about it.

use super::Core;
use crate::access::Action;
use crate::command::name;
use crate::relay::{RosEvent, RosGraph};
use crate::router::{Client, ClientId, Source, Topic, TopicId};
use msg::Monotonic;
use ros_messages::{Message, RobotNames, Twist, TwistStamped};

impl Core {
    /// Handles what the ROS 2 endpoint tells.
    pub fn receive_ros(&mut self, event: RosEvent, now: Monotonic) {
        match event {
            RosEvent::Input(message) => self.receive_dds(&message, now),
            RosEvent::Message { topic, payload } => {
                self.router.counted.received += 1;
                if let Some(id) = self.find_relayed(&topic) {
                    self.router.forward(id, &payload);
                }
            }
            RosEvent::OtherEncoding { topic } => {
                self.router.counted.refused += 1;
                if let Some(id) = self.find_relayed(&topic)
                    && self.relay.should_report_mismatch(id)
                {
                    let text = format!(
                        "'{topic}': messages of ROS are dropped: their encoding is not little-endian CDR"
                    );
                    self.notify_users(id, name::ERROR, &text);
                }
            }
            RosEvent::Failure { topic, text } => {
                if let Some(id) = self.find_relayed(&topic) {
                    self.notify_users(id, name::ERROR, &text);
                }
            }
            RosEvent::Request { service, id, payload } => {
                self.receive_ros_request(&service, id, &payload, now);
            }
            RosEvent::Response { number, payload, .. } => self.receive_ros_response(number, &payload),
            RosEvent::ServiceFailure { service, text } => self.receive_service_failure(&service, &text),
            RosEvent::Graph(graph) => self.set_ros_graph(graph),
            RosEvent::RobotListens(robot) => {
                self.gate.repeat_stop(robot);
                self.send_velocities();
            }
            RosEvent::DriverLost => self.stop_robots_of(ClientId::DDS),
        }
    }

    /// Finds a topic that clients alone publish.
    fn find_relayed(&self, name: &str) -> Option<TopicId> {
        let id = self.router.topics.find(name)?;
        self.router.topics.get(id).filter(|topic| topic.source == Source::Clients).map(|_| id)
    }

    fn set_ros_graph(&mut self, graph: RosGraph) {
        self.fail_lost_calls(&graph);
        self.report_other_drivers(&graph);
        self.relay.set_graph(graph);
        self.update_actions();
        for id in self.relay.topics().collect::<Vec<_>>() {
            self.apply_graph(id, None);
        }
    }

    /// Compares a topic with ROS: keeps latched messages, and says once that the types differ.
    ///
    /// `user`: a client that has just registered, and is told for itself.
    fn apply_graph(&mut self, id: TopicId, user: Option<ClientId>) {
        let Some(topic) = self.router.topics.get_mut(id) else { return };
        let Some(known) = self.relay.graph().topics.get(&topic.name) else { return };
        topic.retention.latch |= known.is_latched;
        let ours = &topic.message_type;
        let differs = |theirs: &[String]| !theirs.is_empty() && !theirs.contains(ours);
        let is_other = (differs(&known.published) && !topic.subscribers.is_empty())
            || (differs(&known.subscribed) && !topic.publishers.is_empty());
        if is_other {
            let theirs = known.types().find(|theirs| theirs != ours).unwrap_or_default();
            let text =
                format!("'{}' is {theirs} in ROS, not {ours}: it is not exchanged with ROS", topic.name);
            let is_first = self.relay.should_report_mismatch(id);
            match user {
                Some(client) => self.router.send_notice(client, name::ERROR, text),
                None if is_first => self.notify_users(id, name::ERROR, &text),
                None => {}
            }
        }
    }

    /// Sends text to the clients that subscribed to a topic or publish it.
    fn notify_users(&mut self, id: TopicId, kind: &str, text: &str) {
        let uses = |client: &&Client| {
            client.subscriptions.contains(&id) || client.publications.iter().any(|known| known.topic == id)
        };
        let clients: Vec<ClientId> = self.router.clients().filter(uses).map(|client| client.id).collect();
        for client in clients {
            self.router.send_notice(client, kind, text.to_owned());
        }
    }

    /// Receives a topic from ROS for a client that subscribed, and begins to wait for its publisher.
    pub(super) fn relay_subscription(&mut self, client: ClientId, id: TopicId, now: Monotonic) {
        let Some(topic) = self.router.topics.get(id).filter(|topic| topic.source == Source::Clients) else {
            return;
        };
        let result = self.relay.subscribe(id, topic);
        self.relay.expect_publisher(client, topic.name.clone(), now);
        match result {
            Ok(()) => self.apply_graph(id, Some(client)),
            Err(error) => self.router.refuse(client, error.to_string()),
        }
    }

    /// Announces a topic to ROS for a client that may publish there. Otherwise it is told so with its first message.
    pub(super) fn relay_publication(&mut self, client: ClientId, id: TopicId) {
        let Some(topic) = self.router.topics.get(id).filter(|topic| topic.source == Source::Clients) else {
            return;
        };
        let is_of_fleet =
            is_fleet_velocity(topic, self.fleet.robot_names()) || self.offered.actions.owns(&topic.name);
        if is_of_fleet || !self.may_use_ros(client, &topic.name) {
            return;
        }
        match self.relay.advertise(id, topic) {
            Ok(()) => self.apply_graph(id, Some(client)),
            Err(error) => self.router.refuse(client, error.to_string()),
        }
    }

    /// Publishes a client's message in ROS, if the client may.
    pub(super) fn relay_message(&mut self, client: ClientId, id: TopicId, payload: &[u8]) {
        if !self.relay.has_endpoint() {
            return;
        }
        let Some(topic) = self.router.topics.get(id) else { return };
        let refusal = if is_fleet_velocity(topic, self.fleet.robot_names()) {
            Some(format!("'{}' is not published in ROS: publish velocities on /cmd_vel_N", topic.name))
        } else if self.offered.actions.owns(&topic.name) {
            Some(format!("'{}' is not published in ROS: it is a topic of the robot's own action", topic.name))
        } else if self.may_use_ros(client, &topic.name) {
            None
        } else {
            let Some(peer) = self.router.client(client).map(|client| client.peer.ip()) else { return };
            let error = self.access.check(Action::Drive, peer).err();
            error.map(|error| {
                format!(
                    "'{}' is not published in ROS: {error}; open_topics in [bridge] opens a topic to all",
                    topic.name
                )
            })
        };
        match refusal {
            None => {
                if self.relay.advertise(id, topic).is_ok() {
                    self.relay.publish(id, payload);
                }
            }
            Some(text) => {
                if self.router.client_mut(client).is_some_and(|client| client.should_report_unrelayed(id)) {
                    self.router.counted.refused += 1;
                    self.router.send_notice(client, name::WARN, text);
                }
            }
        }
    }

    /// Ends the exchange of topics that no client uses any more.
    pub(super) fn remove_unused_relays(&mut self) {
        let topics = &self.router.topics;
        self.relay.remove_unused(|id| topics.get(id));
    }

    /// Tells clients once that nobody publishes the topics that they subscribed to.
    pub(super) fn report_unpublished(&mut self, now: Monotonic) {
        while let Some(waiting) = self.relay.next_unpublished(now) {
            let (client, name) = (waiting.client, &waiting.topic);
            let Some(id) = self.router.topics.find(name) else { continue };
            let is_subscribed = self.router.client(client).is_some_and(|c| c.subscriptions.contains(&id));
            let has_client = self.router.topics.get(id).is_some_and(|topic| !topic.publishers.is_empty());
            let has_node = self.relay.graph().topics.get(name).is_some_and(|t| !t.published.is_empty());
            if !is_subscribed || has_client || has_node {
                continue;
            }
            let hint = if self.relay.has_endpoint() {
                "no client and no ROS 2 node does"
            } else {
                "no client does, and ROS 2 is not connected (mr-slam up --ros-domain N)"
            };
            let text = format!("nobody publishes '{name}' now: {hint}; messages follow when somebody does");
            self.router.send_notice(client, name::WARN, text);
        }
    }
}

/// Returns whether a topic may be a velocity for a robot of the fleet, which the bridge alone sends.
///
/// These are topics called `cmd_vel...` of the fleet's robots or without a namespace, and the robots' topics of Twist.
fn is_fleet_velocity(topic: &Topic, robots: &RobotNames) -> bool {
    let last = topic.name.rsplit('/').next().unwrap_or_default();
    let is_command = last.starts_with("cmd_vel");
    let is_twist = [Twist::TYPE, TwistStamped::TYPE].contains(&topic.message_type.as_str());
    let is_plain = topic.name.rfind('/') == Some(0);
    let is_robots = |robot| {
        let namespace = robots.topic(robot, "");
        namespace != "/" && topic.name.starts_with(&namespace)
    };
    (is_command && is_plain) || ((is_command || is_twist) && robots.robots().any(is_robots))
}
