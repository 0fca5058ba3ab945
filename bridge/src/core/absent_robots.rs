//! Warnings for clients that publish or subscribe for a robot that the fleet does not have: nobody receives or sends such messages.

use super::Core;
use crate::command::name;
use crate::router::{ClientId, RefusalKind, Source, TopicId};
use msg::Monotonic;
use ros_messages::RobotNames;

/// Way in which a client uses a topic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum TopicUse {
    /// It publishes messages there.
    Publish,
    /// It receives the messages there.
    Subscribe,
}

/// Number of the robot that every fleet has, as names of topics have it.
const FIRST_ROBOT: &str = "1";
/// Robots that a warning names; of larger fleets it names the first and the last.
const NAMED_MAX: usize = 8;

impl Core {
    /// Warns a client that uses a topic of clients which would be the fleet's with another robot's number. The same is in the
    /// operator's log, once in 30 s for each topic.
    pub(super) fn warn_of_absent_robot(
        &mut self,
        id: ClientId,
        topic: TopicId,
        usage: TopicUse,
        now: Monotonic,
    ) {
        let Some(topic) = self.router.topics.get(topic).filter(|topic| topic.source == Source::Clients)
        else {
            return;
        };
        let is_of_fleet = |name: &str| {
            let known = self.router.topics.find(name).and_then(|id| self.router.topics.get(id));
            known.is_some_and(|topic| match usage {
                TopicUse::Publish => matches!(topic.source, Source::Input(_)),
                TopicUse::Subscribe => topic.source == Source::Fleet,
            })
        };
        let robots = self.fleet.robot_names();
        if !is_of_absent_robot(&topic.name, robots, is_of_fleet) {
            return;
        }
        let name = topic.name.clone();
        let text = format!("'{name}' belongs to no robot of this fleet, which has {}", all_robots(robots));
        let (command, what, verb) = match usage {
            TopicUse::Publish => ("__publish", "no robot receives it", "publishes on"),
            TopicUse::Subscribe => ("__subscribe", "no robot publishes it", "subscribes to"),
        };
        self.router.send_notice(id, name::WARN, format!("{command}: {text}: {what}"));
        if self.admission.ros_refusals.add(RefusalKind::AbsentRobot, &name, now).is_some() {
            let peer = self.router.client(id).map(|client| client.peer.to_string()).unwrap_or_default();
            self.report(log_text(&peer, verb, &name, robots));
        }
    }
}

/// Returns what the operator's log says of a client that uses such a topic.
fn log_text(peer: &str, verb: &str, name: &str, robots: &RobotNames) -> String {
    format!("{peer} {verb} '{name}', which belongs to no robot of this fleet: it has {}", all_robots(robots))
}

/// Returns whether a topic that the fleet does not have is in the namespace of a robot that it does not have, `/robot9/`, or is
/// one of the fleet's with another number: `/cmd_vel_9`. `is_of_fleet`: whether the fleet has a topic of this name.
fn is_of_absent_robot(name: &str, robots: &RobotNames, is_of_fleet: impl Fn(&str) -> bool) -> bool {
    let number = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    if let Some((namespace, _)) = name.strip_prefix("/robot").and_then(|rest| rest.split_once('/'))
        && number(namespace)
    {
        let prefix = format!("/robot{namespace}/");
        return !robots.robots().any(|robot| robots.topic(robot, "") == prefix);
    }
    let rest = name.trim_end_matches(|c: char| c.is_ascii_digit());
    number(&name[rest.len()..]) && is_of_fleet(&format!("{rest}{FIRST_ROBOT}"))
}

/// The robots of the fleet for people: `robot1, robot2`.
fn all_robots(robots: &RobotNames) -> String {
    let names: Vec<String> = robots.robots().map(|robot| robots.topic(robot, "")).collect();
    let names: Vec<&str> = names.iter().map(|name| name.trim_matches('/')).collect();
    match names.as_slice() {
        [""] => "one robot, whose topics have no number".into(),
        [first, .., last] if names.len() > NAMED_MAX => format!("{first} to {last}"),
        names => names.join(", "),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn topics_of_robots_that_the_fleet_does_not_have_are_found() {
        let is_input = |name: &str| name == "/cmd_vel_1";
        let fleet = RobotNames::from(2);
        for name in ["/cmd_vel_9", "/cmd_vel_0", "/cmd_vel_03", "/robot9/cmd_vel", "/robot3/goal_pose"] {
            assert!(is_of_absent_robot(name, &fleet, is_input), "{name}");
        }
        for name in
            ["/chat", "/chat_9", "/robot1/chat", "/robot2/cmd_vel", "/robots/a", "/robot/a", "/9", "/"]
        {
            assert!(!is_of_absent_robot(name, &fleet, is_input), "{name}");
        }
        let named = RobotNames::new(vec!["alice".into(), "robot_b".into()]).unwrap();
        assert!(is_of_absent_robot("/robot1/goal_pose", &named, is_input));
        assert_eq!(all_robots(&named), "alice, robot_b");
        assert_eq!(all_robots(&RobotNames::from(9)), "robot1 to robot9");
        assert_eq!(
            log_text("10.0.0.7:5", "publishes on", "/robot9/goal_pose", &RobotNames::from(9)),
            "10.0.0.7:5 publishes on '/robot9/goal_pose', which belongs to no robot of this fleet: it has robot1 to robot9"
        );
    }
}
