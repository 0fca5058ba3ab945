//! ROS nodes that send velocities to the robots of an external world past the bridge.

use super::Core;
use crate::relay::RosGraph;
use msg::RobotId;
use ros_messages::RobotNames;

impl Core {
    /// Tells the operator which robots other ROS nodes begin to drive, and which no longer: a robot of an external world obeys everybody
    /// who publishes on its topic, and no limit, lease or stop of the bridge holds there.
    pub(super) fn report_other_drivers(&mut self, graph: &RosGraph) {
        if self.world.is_none() {
            return;
        }
        let robots = self.fleet.robot_names().clone();
        for robot in self.fleet.robots().collect::<Vec<_>>() {
            let topic = robots.topic(robot, "cmd_vel");
            let is_driven =
                |graph: &RosGraph| graph.topics.get(&topic).is_some_and(|it| !it.published.is_empty());
            match (is_driven(self.relay.graph()), is_driven(graph)) {
                (false, true) => self.report(warning(&robots, robot, &topic)),
                (true, false) => {
                    self.report(format!("no other ROS node publishes velocities on {topic} any more"))
                }
                _ => {}
            }
        }
    }
}

fn warning(robots: &RobotNames, robot: RobotId, topic: &str) -> String {
    let instead = format!("/cmd_vel_{}", robot.number());
    // A robot with plain names has that topic itself.
    let advice = if robots.is_plain() { "end it".into() } else { format!("have it publish on {instead}") };
    format!(
        "another ROS node publishes velocities on {topic}: {robot} obeys it beside this fleet, past limits, leases and the emergency \
         stop; {advice}"
    )
}

#[cfg(test)]
mod tests {
    use crate::relay::{RosEvent, RosGraph, RosTopic};
    use crate::world::ExternalWorld;
    use crate::{Bridge, BridgeConfig};
    use msg::{Monotonic, Stamp};

    #[test]
    fn the_operator_is_told_once_who_drives_a_robot_past_the_bridge() {
        let world = ExternalWorld::new(2, |_| {});
        let stamp_at = |now: Monotonic| Stamp(now.0 as i64);
        let bridge =
            Bridge::with_external_world(BridgeConfig::default(), world, stamp_at, |_, _| {}).unwrap();
        let graph = |topics: &[(&str, bool)]| {
            let mut graph = RosGraph::default();
            for (name, is_published) in topics {
                let types = vec!["geometry_msgs/Twist".to_owned()];
                let [published, subscribed] =
                    if *is_published { [types, Vec::new()] } else { [Vec::new(), types] };
                graph.topics.insert((*name).into(), RosTopic { published, subscribed, is_latched: false });
            }
            bridge.receive_ros(RosEvent::Graph(graph), Monotonic(1));
            bridge.take_events()
        };
        assert_eq!(graph(&[("/robot1/cmd_vel", false), ("/cmd_vel_2", true)]), [""; 0], "a robot listens");
        let reported = graph(&[("/robot1/cmd_vel", false), ("/robot2/cmd_vel", true)]);
        assert!(
            reported[0].contains("on /robot2/cmd_vel: robot2") && reported[0].contains("/cmd_vel_2"),
            "{reported:?}"
        );
        assert_eq!(graph(&[("/robot2/cmd_vel", true)]), [""; 0], "once");
        assert_eq!(graph(&[]), ["no other ROS node publishes velocities on /robot2/cmd_vel any more"]);
    }
}
