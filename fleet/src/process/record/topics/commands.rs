//! Commands of people and programs in a recording, each with who sent it, and other messages as JSON.

use super::{OwnTopic, Recorder};
use msg::{
    EdgeCommand, Monotonic, MovingObjects, NavigationCommand, OperatorEvent, RobotId, SlamRequest,
    SlamRequestKind, VelocityCommand,
};
use reports::{
    edge_command_json, moving_objects_json, navigation_command_json, operator_event_json, slam_request_json,
};

impl Recorder {
    /// Records the velocity that a robot is to drive, and before it who sent it, if that has changed.
    pub fn record_command(&mut self, robot: RobotId, command: &VelocityCommand) {
        self.file.at = self.epoch.stamp(command.header.sent);
        if let Some(newest) = self.senders.get_mut(robot.index())
            && newest.velocity.replace(command.sender) != Some(command.sender)
        {
            let sender = command.sender.to_string();
            self.file.record(OwnTopic::CommandSender, robot.index(), |to| to.string(&sender));
        }
        let velocity = [command.linear_m_s, 0.0, 0.0, 0.0, 0.0, command.angular_rad_s];
        self.file.record(OwnTopic::Command, robot.index(), |to| to.f64s(&velocity));
    }

    /// Records a goal of a robot, or what is to become of its goal.
    pub fn record_navigation_command(&mut self, robot: RobotId, command: &NavigationCommand) {
        let json = navigation_command_json(command);
        self.record_json(OwnTopic::NavigationCommand, robot.index(), command.header.sent, &json);
    }

    /// Records a request to a robot's SLAM; one that only asks for the state changes nothing and is left out.
    pub fn record_slam_request(&mut self, robot: RobotId, request: &SlamRequest) {
        if request.kind != SlamRequestKind::State as u32 {
            let json = slam_request_json(request);
            self.record_json(OwnTopic::SlamRequest, robot.index(), request.header.sent, &json);
        }
    }

    /// Records a command about a merge edge.
    pub fn record_edge_command(&mut self, command: &EdgeCommand) {
        self.record_json(OwnTopic::EdgeCommand, 0, command.header.sent, &edge_command_json(command));
    }

    /// Records what an operator did.
    pub fn record_operator_event(&mut self, event: &OperatorEvent) {
        self.record_json(OwnTopic::OperatorEvent, 0, event.header.sent, &operator_event_json(event));
    }

    /// Records where people, doors and boxes truly are.
    pub fn record_moving_objects(&mut self, objects: &MovingObjects) {
        self.record_json(OwnTopic::MovingObjects, 0, objects.header.sent, &moving_objects_json(objects));
    }

    fn record_json(&mut self, topic: OwnTopic, robot: usize, sent: Monotonic, json: &serde_json::Value) {
        self.file.at = self.epoch.stamp(sent);
        let json = json.to_string();
        self.file.record(topic, robot, |to| to.string(&json));
    }
}
