//! The topics that the endpoint subscribes to.

use crate::config::VelocityMessage;
use crate::input::{ADD_ZONE, EXPLORE, InputPurpose, REMOVE_ZONE, SHARED_GOAL};
use crate::relay::ReceivedMessage;
use ros_messages::{
    BatteryState, Bool, Clock, Empty, Int32, LaserScan, Message, Odometry, PathMessage, PolygonStamped,
    PoseStamped, PoseWithCovarianceStamped, RobotNames, Text, TfMessage, Twist, TwistStamped,
};

/// A topic that the endpoint subscribes to.
#[derive(Clone, Debug)]
pub struct InputTopic {
    /// Name with leading slash, without the namespace.
    pub name: String,
    /// ROS type as `package/Type`, such as `sensor_msgs/LaserScan`.
    pub message_type: &'static str,
    /// What the fleet does with the messages.
    input: InputPurpose,
    /// The same topic's name on TCP.
    tcp_topic: String,
}

impl InputTopic {
    fn new<M: Message>(name: String, input: InputPurpose) -> Self {
        let tcp_topic = name.strip_suffix("_stamped").unwrap_or(&name).to_owned();
        Self { name, message_type: M::TYPE, input, tcp_topic }
    }

    /// Returns what was received on the topic. `payload` is CDR with its encapsulation header.
    pub fn message(&self, payload: Vec<u8>) -> ReceivedMessage {
        let is_stamped = self.message_type == TwistStamped::TYPE;
        ReceivedMessage::new(self.input, self.tcp_topic.clone(), is_stamped, payload)
    }

    /// Returns whether a lost message is soon followed by a newer one.
    pub fn is_stream(&self) -> bool {
        use InputPurpose::{Battery, Clock, Command, Odometry, Scan, SelectedCommand};
        matches!(self.input, SelectedCommand | Command(_) | Scan(_) | Odometry(_) | Battery(_) | Clock)
    }

    /// Returns whether the topic has the same name in every namespace.
    pub fn is_global(&self) -> bool {
        matches!(self.input, InputPurpose::Transforms | InputPurpose::StaticTransforms | InputPurpose::Clock)
    }

    /// Returns whether messages sent before the endpoint started are wanted too (transient local).
    pub fn is_latched(&self) -> bool {
        matches!(self.input, InputPurpose::StaticTransforms | InputPurpose::RobotStaticTransforms(_))
    }
}

/// Returns all input topics. `may_drive`: commands are accepted.
pub fn topics(
    robots: &RobotNames,
    velocity: VelocityMessage,
    is_external: bool,
    may_drive: bool,
) -> Vec<InputTopic> {
    let mut all = Vec::new();
    if is_external {
        all.extend(world_topics(robots));
    }
    if may_drive {
        all.extend(command_topics(robots, velocity, is_external));
    }
    all
}

/// Returns the topics of people and planners.
///
/// Robots of an external world subscribe to `/robotN/cmd_vel` themselves, and one with plain names to `/cmd_vel`.
fn command_topics(robots: &RobotNames, velocity: VelocityMessage, is_external: bool) -> Vec<InputTopic> {
    let mut all = vec![
        InputTopic::new::<TwistStamped>("/cmd_vel_stamped".into(), InputPurpose::SelectedCommand),
        InputTopic::new::<Int32>("/selected_robot".into(), InputPurpose::SelectRobot),
        InputTopic::new::<Int32>("/take_control".into(), InputPurpose::TakeControl),
        InputTopic::new::<Bool>("/emergency_stop".into(), InputPurpose::EmergencyStop),
        InputTopic::new::<Empty>("/emergency_stop_release".into(), InputPurpose::ReleaseStop),
        InputTopic::new::<Bool>(EXPLORE.into(), InputPurpose::Explore),
        InputTopic::new::<PolygonStamped>(ADD_ZONE.into(), InputPurpose::AddZone),
        InputTopic::new::<Int32>(REMOVE_ZONE.into(), InputPurpose::RemoveZone),
        InputTopic::new::<Text>("/merge_edge_command".into(), InputPurpose::MergeEdge),
        InputTopic::new::<PoseWithCovarianceStamped>("/initialpose".into(), InputPurpose::InitialPose(None)),
        InputTopic::new::<PoseStamped>(SHARED_GOAL.into(), InputPurpose::Goal(None)),
    ];
    for robot in robots.robots() {
        let name = |rest: &str| robots.topic(robot, rest);
        if !robots.is_plain() {
            all.push(InputTopic::new::<PoseStamped>(name("goal_pose"), InputPurpose::Goal(Some(robot))));
        }
        all.push(InputTopic::new::<PathMessage>(name("waypoints"), InputPurpose::Waypoints(robot)));
        all.push(InputTopic::new::<Empty>(name("cancel_navigation"), InputPurpose::CancelNavigation(robot)));
        all.push(InputTopic::new::<Empty>(name("resume_navigation"), InputPurpose::ResumeNavigation(robot)));
    }
    let mut add_velocity = |name: &str, input: InputPurpose| {
        for is_stamped in velocity.is_stamped() {
            all.push(match is_stamped {
                false => InputTopic::new::<Twist>(name.to_owned(), input),
                true => InputTopic::new::<TwistStamped>(name.to_owned(), input),
            });
        }
    };
    if !(is_external && robots.is_plain()) {
        add_velocity("/cmd_vel", InputPurpose::SelectedCommand);
    }
    for robot in robots.robots() {
        add_velocity(&format!("/cmd_vel_{}", robot.number()), InputPurpose::Command(robot));
        if !is_external && !robots.is_plain() {
            add_velocity(&robots.topic(robot, "cmd_vel"), InputPurpose::Command(robot));
        }
    }
    // The topics of a robot with plain names are those above.
    for robot in robots.robots().filter(|_| !robots.is_plain()) {
        let (name, input) = (robots.topic(robot, "initialpose"), InputPurpose::InitialPose(Some(robot)));
        all.push(InputTopic::new::<PoseWithCovarianceStamped>(name, input));
        if !is_external {
            let name = robots.topic(robot, "cmd_vel_stamped");
            all.push(InputTopic::new::<TwistStamped>(name, InputPurpose::Command(robot)));
        }
    }
    all
}

/// Returns the topics of robots of an external world.
fn world_topics(robots: &RobotNames) -> Vec<InputTopic> {
    let mut all = vec![
        InputTopic::new::<TfMessage>("/tf".into(), InputPurpose::Transforms),
        InputTopic::new::<TfMessage>("/tf_static".into(), InputPurpose::StaticTransforms),
        InputTopic::new::<Clock>("/clock".into(), InputPurpose::Clock),
    ];
    for robot in robots.robots() {
        all.push(InputTopic::new::<LaserScan>(robots.topic(robot, "scan"), InputPurpose::Scan(robot)));
        all.push(InputTopic::new::<Odometry>(robots.topic(robot, "odom"), InputPurpose::Odometry(robot)));
        let battery = robots.topic(robot, "battery_state");
        all.push(InputTopic::new::<BatteryState>(battery, InputPurpose::Battery(robot)));
        if !robots.is_plain() {
            all.push(InputTopic::new::<TfMessage>(
                robots.topic(robot, "tf"),
                InputPurpose::RobotTransforms(robot),
            ));
            all.push(InputTopic::new::<TfMessage>(
                robots.topic(robot, "tf_static"),
                InputPurpose::RobotStaticTransforms(robot),
            ));
        }
    }
    all
}
