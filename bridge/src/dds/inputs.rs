//! The topics that the endpoint subscribes to, and the messages received on them.

use crate::input::Input;
use crate::ros::{
    Bool, Clock, Empty, Int32, LaserScan, Message, Odometry, PoseWithCovarianceStamped, Text, TfMessage,
    Twist, TwistStamped,
};
use msg::RobotId;

/// A message from DDS on a topic of the fleet, not decoded yet.
#[derive(Clone, Debug)]
pub struct ReceivedMessage {
    input: Input,
    topic: String,
    is_stamped: bool,
    payload: Vec<u8>,
}

impl ReceivedMessage {
    /// Creates a message of an input topic. `payload` is CDR with its encapsulation header.
    pub(super) fn new(topic: &InputTopic, payload: Vec<u8>) -> Self {
        Self {
            input: topic.input,
            topic: topic.tcp_topic.clone(),
            is_stamped: topic.message_type == TwistStamped::TYPE,
            payload,
        }
    }

    /// Returns whether the message is the time of an external world.
    pub fn is_clock(&self) -> bool {
        self.input == Input::Clock
    }

    /// Returns what the fleet does with the message.
    pub(crate) fn input(&self) -> Input {
        self.input
    }

    /// Returns the topic's name among the topics on TCP.
    pub(crate) fn topic(&self) -> &str {
        &self.topic
    }

    /// Returns whether the message is geometry_msgs/TwistStamped instead of Twist.
    pub(crate) fn is_stamped(&self) -> bool {
        self.is_stamped
    }

    /// Returns the message as CDR with its encapsulation header.
    pub(crate) fn payload(&self) -> &[u8] {
        &self.payload
    }
}

/// A topic that the endpoint subscribes to.
#[derive(Clone, Debug)]
pub struct InputTopic {
    /// Name with leading slash, without the namespace.
    pub name: String,
    /// ROS type as `package/Type`, such as `sensor_msgs/LaserScan`.
    pub message_type: &'static str,
    /// What the fleet does with the messages.
    input: Input,
    /// The same topic's name on TCP.
    tcp_topic: String,
}

impl InputTopic {
    fn new<M: Message>(name: String, input: Input) -> Self {
        let tcp_topic = name.strip_suffix("_stamped").unwrap_or(&name).to_owned();
        Self { name, message_type: M::TYPE, input, tcp_topic }
    }

    /// Returns whether a lost message is soon followed by a newer one.
    pub fn is_stream(&self) -> bool {
        use Input::{Clock, Command, Odometry, Scan, SelectedCommand};
        matches!(self.input, SelectedCommand | Command(_) | Scan(_) | Odometry(_) | Clock)
    }

    /// Returns whether the topic has the same name in every namespace.
    pub fn is_global(&self) -> bool {
        matches!(self.input, Input::Transforms | Input::Clock)
    }
}

/// Returns all input topics. `may_drive`: commands are accepted.
pub fn topics(robot_count: usize, is_external: bool, may_drive: bool) -> Vec<InputTopic> {
    let mut all = Vec::new();
    if is_external {
        all.extend(world_topics(robot_count));
    }
    if may_drive {
        all.extend(command_topics(robot_count, is_external));
    }
    all
}

/// Returns the topics of people and planners.
///
/// A topic has one type in ROS: TwistStamped, as Nav2 may send it, has topics of its own. Robots of an external world
/// subscribe to `/robotN/cmd_vel` themselves.
fn command_topics(robot_count: usize, is_external: bool) -> Vec<InputTopic> {
    let mut all = vec![
        InputTopic::new::<Twist>("/cmd_vel".into(), Input::SelectedCommand),
        InputTopic::new::<TwistStamped>("/cmd_vel_stamped".into(), Input::SelectedCommand),
        InputTopic::new::<Int32>("/selected_robot".into(), Input::SelectRobot),
        InputTopic::new::<Int32>("/take_control".into(), Input::TakeControl),
        InputTopic::new::<Bool>("/emergency_stop".into(), Input::EmergencyStop),
        InputTopic::new::<Empty>("/emergency_stop_release".into(), Input::ReleaseStop),
        InputTopic::new::<Text>("/merge_edge_command".into(), Input::MergeEdge),
        InputTopic::new::<PoseWithCovarianceStamped>("/initialpose".into(), Input::InitialPose(None)),
    ];
    for robot in RobotId::first(robot_count) {
        let command = Input::Command(robot);
        all.push(InputTopic::new::<Twist>(format!("/cmd_vel_{}", robot.number()), command));
        let (name, input) = (format!("/{robot}/initialpose"), Input::InitialPose(Some(robot)));
        all.push(InputTopic::new::<PoseWithCovarianceStamped>(name, input));
        if !is_external {
            all.push(InputTopic::new::<Twist>(format!("/{robot}/cmd_vel"), command));
            all.push(InputTopic::new::<TwistStamped>(format!("/{robot}/cmd_vel_stamped"), command));
        }
    }
    all
}

/// Returns the topics of robots of an external world.
fn world_topics(robot_count: usize) -> Vec<InputTopic> {
    let mut all = vec![
        InputTopic::new::<TfMessage>("/tf".into(), Input::Transforms),
        InputTopic::new::<Clock>("/clock".into(), Input::Clock),
    ];
    for robot in RobotId::first(robot_count) {
        all.push(InputTopic::new::<LaserScan>(format!("/{robot}/scan"), Input::Scan(robot)));
        all.push(InputTopic::new::<Odometry>(format!("/{robot}/odom"), Input::Odometry(robot)));
    }
    all
}
