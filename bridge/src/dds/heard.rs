//! What is heard on DDS, on its way to the bridge's own thread.

use crate::ros::{
    Bool, Clock, Empty, Int32, LaserScan, Message, Odometry, PoseWithCovarianceStamped, Text, TfMessage,
    Twist, TwistStamped,
};
use crate::topics::Input;
use msg::RobotId;

/// A message that was heard, not decoded yet; for [`crate::Bridge::hear_ros`].
#[derive(Clone, Debug)]
pub struct Heard {
    pub(crate) what: Input,
    /// Where TCP clients find the same topic.
    pub(crate) topic: String,
    /// geometry_msgs/TwistStamped instead of Twist.
    pub(crate) stamped: bool,
    /// CDR behind its encapsulation header.
    pub(crate) payload: Vec<u8>,
}

impl Heard {
    /// Whether it is the time of a world outside.
    pub fn is_clock(&self) -> bool {
        self.what == Input::Clock
    }
}

/// A topic the door listens to.
pub(super) struct InputTopic {
    /// With leading slash, without the namespace.
    pub name: String,
    /// `package/Type`.
    pub class: &'static str,
    /// What it means, without the payload.
    pub heard: Heard,
}

impl InputTopic {
    fn new<M: Message>(name: String, what: Input) -> Self {
        let stamped = M::TYPE == TwistStamped::TYPE;
        let topic = name.strip_suffix("_stamped").unwrap_or(&name).to_owned();
        Self { name, class: M::TYPE, heard: Heard { what, topic, stamped, payload: Vec::new() } }
    }

    /// Whether a lost message is soon followed by a better one.
    pub fn is_stream(&self) -> bool {
        use Input::{Clock, Command, Odometry, Scan, SelectedCommand};
        matches!(self.heard.what, SelectedCommand | Command(_) | Scan(_) | Odometry(_) | Clock)
    }

    /// Whether the namespace does not apply.
    pub fn is_global(&self) -> bool {
        matches!(self.heard.what, Input::Transforms | Input::Clock)
    }
}

/// What people and planners say. A topic has one type in ROS: velocities with a stamp, as Nav2 may send them, have
/// names of their own. Robots that are `outside` hear `/robotN/cmd_vel` themselves.
pub(super) fn commands(robots: usize, outside: bool) -> Vec<InputTopic> {
    let mut all = vec![
        InputTopic::new::<Twist>("/cmd_vel".into(), Input::SelectedCommand),
        InputTopic::new::<TwistStamped>("/cmd_vel_stamped".into(), Input::SelectedCommand),
        InputTopic::new::<Int32>("/selected_robot".into(), Input::Select),
        InputTopic::new::<Int32>("/take_control".into(), Input::Take),
        InputTopic::new::<Bool>("/emergency_stop".into(), Input::Stop),
        InputTopic::new::<Empty>("/emergency_stop_release".into(), Input::Release),
        InputTopic::new::<Text>("/merge_edge_command".into(), Input::MergeEdge),
        InputTopic::new::<PoseWithCovarianceStamped>("/initialpose".into(), Input::InitialPose(None)),
    ];
    for robot in RobotId::first(robots) {
        let command = Input::Command(robot);
        all.push(InputTopic::new::<Twist>(format!("/cmd_vel_{}", robot.number()), command));
        let (name, input) = (format!("/{robot}/initialpose"), Input::InitialPose(Some(robot)));
        all.push(InputTopic::new::<PoseWithCovarianceStamped>(name, input));
        if !outside {
            all.push(InputTopic::new::<Twist>(format!("/{robot}/cmd_vel"), command));
            all.push(InputTopic::new::<TwistStamped>(format!("/{robot}/cmd_vel_stamped"), command));
        }
    }
    all
}

/// What robots outside say.
pub(super) fn world(robots: usize) -> Vec<InputTopic> {
    let mut all = vec![
        InputTopic::new::<TfMessage>("/tf".into(), Input::Transforms),
        InputTopic::new::<Clock>("/clock".into(), Input::Clock),
    ];
    for robot in RobotId::first(robots) {
        all.push(InputTopic::new::<LaserScan>(format!("/{robot}/scan"), Input::Scan(robot)));
        all.push(InputTopic::new::<Odometry>(format!("/{robot}/odom"), Input::Odometry(robot)));
    }
    all
}
