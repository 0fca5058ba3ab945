//! Encodes the fleet's messages by the bridge's tables and writes them to the files of a recording.

mod commands;
mod file_topics;

use super::Summary;
use crate::clock::Epoch;
use crate::recording_files::{RecordingCounts, RecordingFiles};
use crate::run::Run;
use ::bridge::{FleetMessage, FleetPublisher, FleetTopic, RobotTransformPolicy, TopicSink};
use ::recording::WriteError;
use file_topics::FileTopics;
use msg::{CommandSource, GroundTruth, Monotonic, Odometry, RobotFrame, RobotId};
use reports::{BridgeState, TlxEntry};
use ros_messages::{Bool, FrameNames, Int32, Message, Pose2D, write};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Name of a robot's topic with its odometry as the fleet has it: an angle and not a quaternion, so that replay is exact.
pub const PLANAR_ODOMETRY: &str = "odom_2d";
/// Frame of the true poses.
const WORLD: &str = "world";

/// A topic of a recording beside the fleet's on TCP and DDS.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum OwnTopic {
    /// Velocities that a robot gets.
    Command,
    /// Odometry as the fleet has it.
    PlanarOdometry,
    /// True poses of a simulated robot.
    GroundTruth,
    /// The fleet's figures and the health of its processes, as JSON.
    FleetStats,
    /// Who drives, waits and may drive, as JSON.
    OperatorState,
    /// Goals of a robot, and their cancellations, pauses and resumptions, as JSON.
    NavigationCommand,
    /// Answers to the form of workload, all of the run, as JSON.
    Workload,
    /// Who sends a robot's velocities, on change.
    CommandSender,
    /// Incarnation of the driver whose odometry is recorded, on change: a new one counts from another origin.
    OdometryIncarnation,
    /// Requests to a robot's SLAM, as JSON.
    SlamRequest,
    /// Commands about merge edges, as JSON.
    EdgeCommand,
    /// Emergency stop, its release, selection and takeover of robots, as JSON.
    OperatorEvent,
    /// True poses of the people, doors and boxes that move in the simulated room, as JSON.
    MovingObjects,
}

/// Records messages of the fleet.
pub struct Recorder {
    publisher: Option<FleetPublisher>,
    names: FrameNames,
    epoch: Epoch,
    file: FileTopics,
    /// Who sent each robot's newest messages.
    senders: Vec<Senders>,
}

/// Who sent the newest messages of a robot.
#[derive(Clone, Copy, Default)]
struct Senders {
    /// Sender of the velocity; `None` before the first.
    velocity: Option<CommandSource>,
    /// Incarnation of the driver that sent the odometry.
    odometry: Option<u64>,
}

impl Recorder {
    /// Begins the first file of a run's recording.
    ///
    /// # Errors
    /// A topic's type has no known definition.
    pub fn new(
        run: &Run,
        description: BTreeMap<String, String>,
        files: RecordingFiles,
    ) -> Result<Self, WriteError> {
        let (robots, config) = (run.config.robot_names(), run.config.bridge_config());
        let mut publisher = FleetPublisher::new(config.frame_names, &robots, RobotTransformPolicy::Split);
        publisher.set_odometry_sigmas(config.odometry_sigmas);
        let mut file = FileTopics::new(&robots, description, files, run.config.recording.split_bytes());
        file.begin()?;
        let names = FrameNames::new(config.frame_names, &robots);
        let senders = vec![Senders::default(); robots.count()];
        Ok(Self { publisher: Some(publisher), names, epoch: run.epoch, file, senders })
    }

    /// Records a message of the fleet that was sent at this moment.
    pub fn publish(&mut self, message: FleetMessage<'_>, sent: Monotonic) {
        self.file.at = self.epoch.stamp(sent);
        if let Some(publisher) = &mut self.publisher {
            publisher.publish(message, &mut self.file);
        }
    }

    /// Records a robot's odometry, also as the fleet has it, and before it the driver's incarnation, if that has changed.
    pub fn record_odometry(&mut self, robot: RobotId, odometry: &Odometry) {
        self.file.at = self.epoch.stamp(odometry.header.sent);
        let incarnation = odometry.header.incarnation;
        if let Some(newest) = self.senders.get_mut(robot.index())
            && newest.odometry.replace(incarnation) != Some(incarnation)
        {
            let text = incarnation.to_string();
            self.file.record(OwnTopic::OdometryIncarnation, robot.index(), |to| to.string(&text));
        }
        self.publish(FleetMessage::Odometry(robot, odometry), odometry.header.sent);
        let pose = odometry.odom_from_base;
        let pose = Pose2D { x: pose.x_m, y: pose.y_m, theta: pose.yaw_rad };
        self.file.record(OwnTopic::PlanarOdometry, robot.index(), |to| pose.write(to));
    }

    /// Records a robot's true pose.
    pub fn record_truth(&mut self, robot: RobotId, truth: &GroundTruth) {
        self.file.at = self.epoch.stamp(truth.header.sent);
        let pose = Odometry {
            header: truth.header,
            odom_from_base: truth.world_from_base,
            linear_m_s: truth.linear_m_s,
            angular_rad_s: truth.angular_rad_s,
        };
        let child = self.names.robot_frame(robot, RobotFrame::BaseFootprint);
        self.file.record(OwnTopic::GroundTruth, robot.index(), |to| {
            write::odometry(to, WORLD, child, &pose, &[0.0; 36], &[0.0; 36]);
        });
    }

    /// Records the fleet's figures.
    pub fn record_stats(&mut self, json: &str, sent: Monotonic) {
        self.file.at = self.epoch.stamp(sent);
        self.file.record(OwnTopic::FleetStats, 0, |to| to.string(json));
    }

    /// Records the bridge's state: selected robot, emergency stop, drivers.
    pub fn record_operator(&mut self, state: &BridgeState, now: Monotonic) {
        self.file.at = self.epoch.stamp(now);
        self.file.send(FleetTopic::SelectedRobot, None, |to| Int32(state.selected as i32).write(to));
        self.file.send(FleetTopic::EmergencyStop, None, |to| Bool(state.stopped).write(to));
        let json = state.operator_json().to_string();
        self.file.record(OwnTopic::OperatorState, 0, |to| to.string(&json));
    }

    /// Records the answers to the form of workload.
    pub fn record_workload(&mut self, entries: &[TlxEntry], now: Monotonic) {
        self.file.at = self.epoch.stamp(now);
        let json = serde_json::to_string(entries).unwrap_or_default();
        self.file.record(OwnTopic::Workload, 0, |to| to.string(&json));
    }

    /// Ends the chunk and passes it on to the disk, and begins the next file if this one is large enough.
    pub fn flush(&mut self) {
        self.file.flush();
    }

    /// Returns the numbers of messages.
    pub fn counts(&self) -> Arc<RecordingCounts> {
        self.file.counts.clone()
    }

    /// Ends the last file and returns what was recorded.
    pub fn finish(self) -> Summary {
        self.file.finish()
    }
}
