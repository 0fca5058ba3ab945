//! The robots of a headset's application, and its ros_tcp frames.

use bridge::command::{Registration, name};
use bridge::frame::Side;
use bridge::ros::{self, FrameNames, Message as _, NameStyle, Twist, write};
use bytemuck::Zeroable;
use msg::{GroundTruth, Pose2, RobotFrame, RobotId, Scan, Stamp, VelocityCommand};
use ros_messages::RobotNames;
use ros_messages::cdr::Writer;
use sim::Simulator;
use std::time::Duration;

/// How far the headset's clock is ahead of the fleet's: the difference of the two clocks in the paper.
pub const CLOCK_AHEAD: Duration = Duration::from_secs(5);

/// A headset's application with its simulated robots.
pub struct HeadsetRobots {
    robots: Vec<HeadsetRobot>,
    names: RobotNames,
    frame_names: FrameNames,
    scan: Box<Scan>,
}

struct HeadsetRobot {
    id: RobotId,
    simulator: Simulator,
    truth: GroundTruth,
}

impl HeadsetRobots {
    /// Puts simulated robots at their starts: a simulator and the pose in its world for each name.
    pub fn new(names: RobotNames, simulators: impl IntoIterator<Item = (Simulator, Pose2)>) -> Self {
        let robots = names.robots().zip(simulators).map(|(id, (simulator, start))| {
            let truth = GroundTruth { world_from_base: start, ..GroundTruth::zeroed() };
            HeadsetRobot { id, simulator, truth }
        });
        Self {
            robots: robots.collect(),
            frame_names: FrameNames::new(NameStyle::Flat, &names),
            names,
            scan: Box::new(Scan::zeroed()),
        }
    }

    /// Appends the frames with which a connection begins: what the application publishes and subscribes to.
    pub fn register(&self, out: &mut Vec<u8>) {
        let mut register = |command, topic: String, message_type: &str| {
            let about = Registration {
                topic,
                message_name: message_type.into(),
                queue_size: 10,
                ..Registration::default()
            };
            Side::Client.write_command(out, command, &about);
        };
        register(name::PUBLISH, "/tf".into(), "tf2_msgs/TFMessage");
        register(name::PUBLISH, "/clock".into(), "rosgraph_msgs/Clock");
        for robot in &self.robots {
            register(name::PUBLISH, self.names.topic(robot.id, "scan"), "sensor_msgs/LaserScan");
            register(name::SUBSCRIBE, self.names.topic(robot.id, "cmd_vel"), Twist::TYPE);
        }
    }

    /// Sets the headset's time. Call it before the first tick, and after a pause.
    pub fn set_time(&mut self, now: Stamp) {
        self.robots.iter_mut().for_each(|robot| robot.simulator.set_time(now));
    }

    /// Applies a velocity that the bridge sent on this topic; every other message is ignored.
    pub fn receive(&mut self, topic: &str, payload: &[u8]) {
        let is_its = |robot: &&mut HeadsetRobot| self.names.topic(robot.id, "cmd_vel") == topic;
        let Some(robot) = self.robots.iter_mut().find(is_its) else { return };
        if let Ok(twist) = ros::decode::<Twist>(payload) {
            robot.simulator.set_velocity_command(&VelocityCommand {
                linear_m_s: twist.linear[0],
                angular_rad_s: twist.angular[2],
                ..VelocityCommand::default()
            });
        }
    }

    /// Simulates one tick of [`Simulator::TICK`], and appends the frames that the application sends after it.
    pub fn tick(&mut self, out: &mut Vec<u8>) {
        let truths: Vec<(RobotId, GroundTruth)> =
            self.robots.iter().map(|robot| (robot.id, robot.truth)).collect();
        for (index, robot) in self.robots.iter_mut().enumerate() {
            let HeadsetRobot { id, simulator, truth } = robot;
            for (peer, truth) in truths.iter().filter(|(peer, truth)| peer != id && truth.header.stamp.0 != 0)
            {
                simulator.update_peer(*peer, truth);
            }
            let tick = simulator.step();
            *truth = tick.truth;
            truth.header.stamp = tick.stamp;
            if index == 0 {
                frame(out, "/clock", |to| write::stamp(to, tick.stamp));
            }
            if let Some(transforms) = &tick.transforms {
                frame(out, "/tf", |to| write::transforms(to, &self.frame_names, *id, transforms));
            }
            if tick.scan_due {
                simulator.scan_into(&mut self.scan);
                let (topic, link) =
                    (self.names.topic(*id, "scan"), self.frame_names.robot_frame(*id, RobotFrame::BaseScan));
                frame(out, &topic, |to| write::laser_scan(to, link, &self.scan));
            }
        }
    }
}

fn frame(out: &mut Vec<u8>, topic: &str, message: impl FnOnce(&mut Writer<'_>)) {
    Side::Client.write_with(out, topic, |payload| message(&mut Writer::new(payload)));
}

#[cfg(test)]
mod tests {
    use super::*;
    use bridge::frame::Parser;
    use bridge::ros::TfMessage;

    #[test]
    fn a_robot_drives_by_velocities_and_the_application_sends_scans_transforms_and_clock() {
        let room = sim::Room::laboratory();
        let starts = room.starts(2).unwrap();
        let simulators = RobotId::first(2).zip(starts).map(|(robot, start)| {
            (Simulator::new(&room, &sim::SimConfig::default(), robot, start, 1).unwrap(), start)
        });
        let mut headset = HeadsetRobots::new(RobotNames::from(2), simulators);
        headset.set_time(Stamp(5_000_000_000));
        let start = headset.robots[1].simulator.now();
        let mut payload = Vec::new();
        ros::encode(&Twist { angular: [0.0, 0.0, 1.0], ..Twist::default() }, &mut payload);
        let mut sent = Vec::new();
        headset.register(&mut sent);
        for _ in 0..100 {
            headset.receive("/robot2/cmd_vel", &payload);
            headset.receive("/robot3/cmd_vel", &payload);
            headset.receive("/robot1/cmd_vel", &payload[..3]);
            headset.tick(&mut sent);
        }
        assert_eq!(headset.robots[1].simulator.now() - start, 1.0);
        let speeds: Vec<f64> = headset.robots.iter().map(|robot| robot.truth.angular_rad_s).collect();
        assert!(speeds[0].abs() < 0.01 && speeds[1] > 0.9, "{speeds:?}");
        let mut parser = Parser::new(1 << 20);
        parser.push(&sent);
        let (mut clocks, mut scans, mut transforms) = (0, 0, 0);
        while let Some(received) = parser.next_frame().unwrap() {
            match received.name {
                b"/clock" => clocks += 1,
                b"/robot1/scan" | b"/robot2/scan" => scans += 1,
                b"/tf" => transforms += ros::decode::<TfMessage>(received.payload).unwrap().transforms.len(),
                command => assert!(command.starts_with(b"__"), "{command:?}"),
            }
        }
        assert_eq!((clocks, scans), (100, 20));
        assert!(transforms >= 40, "{transforms}");
    }
}
