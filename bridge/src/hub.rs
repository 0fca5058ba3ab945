//! All that the bridge knows, and what it does of its own accord.

use crate::access::Access;
use crate::board::Board;
use crate::client::ClientId;
use crate::config::BridgeConfig;
use crate::drive::Drive;
use crate::outbox::Outbox;
use crate::ros::{
    Bool, FrameNames, HandInputs, Int32, Joy, Message, PoseWithCovarianceStamped, Text, Twist, write,
};
use crate::services::Services;
use crate::topics::{DEPTH_USUAL, Input, Source, TopicId, Topics};
use crate::world::{ClockOffset, SourceClock, World};
use msg::{EdgeCommand, Header, MapTransforms, ROBOTS_MAX, RobotId, SlamRequest, Stamp, VelocityCommand};
use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// Where each robot's map lies in the merged one is told again this often, for whoever has just come.
const ANCHORS_PERIOD: Duration = Duration::from_secs(1);
/// Transforms that wait for a slow client, per robot: about a second of them.
const TRANSFORMS_DEPTH: usize = 32;
/// Commands that wait to be taken; each frame's are taken before the next frame is read.
const COMMANDS_MAX: usize = 4 * ROBOTS_MAX;
/// The same for merging.
const EDGE_COMMANDS_MAX: usize = 16;
/// Requests to SLAM that wait to be taken, likewise.
const ASKS_MAX: usize = 16;
/// Selected at start.
const FIRST: RobotId = RobotId::new(1).unwrap();

/// The fleet's topics.
pub struct FleetTopics {
    pub scan: Vec<TopicId>,
    pub map: Vec<TopicId>,
    pub stats: Vec<TopicId>,
    pub odometry: Vec<TopicId>,
    pub pose: Vec<TopicId>,
    pub transforms: TopicId,
    pub clock: TopicId,
    pub merged_map: TopicId,
    pub merge_edges: TopicId,
    pub selected: TopicId,
    pub stop: TopicId,
    /// Where a robot that is not simulated here hears its commands.
    pub command: Vec<[TopicId; 2]>,
}

impl FleetTopics {
    /// `outside`: scans and the clock come in instead of going out only.
    fn new(topics: &mut Topics, robots: usize, outside: bool) -> Self {
        let depth = TRANSFORMS_DEPTH * robots;
        let mut input = |name: String, class: &str, input: Input| {
            topics.add(name, class, Source::Input(input), DEPTH_USUAL, false)
        };
        input("/cmd_vel".into(), "geometry_msgs/Twist", Input::SelectedCommand);
        let mut command = |robot: RobotId| {
            let names = [format!("/cmd_vel_{}", robot.number()), format!("/{robot}/cmd_vel")];
            names.map(|name| input(name, "geometry_msgs/Twist", Input::Command(robot)))
        };
        let command = RobotId::first(robots).map(&mut command).collect();
        let mut initial_pose = |name: String, robot: Option<RobotId>| {
            input(name, PoseWithCovarianceStamped::TYPE, Input::InitialPose(robot))
        };
        initial_pose("/initialpose".into(), None);
        for robot in RobotId::first(robots) {
            initial_pose(format!("/{robot}/initialpose"), Some(robot));
        }
        input("/quest/joystick".into(), Joy::TYPE, Input::Joystick);
        input("/q2r_right_hand_inputs".into(), HandInputs::TYPE, Input::HandInputs);
        input("/take_control".into(), Int32::TYPE, Input::Take);
        input("/emergency_stop_release".into(), "std_msgs/Empty", Input::Release);
        input("/merge_edge_command".into(), Text::TYPE, Input::MergeEdge);
        let from_outside = |input: Input| if outside { Source::Input(input) } else { Source::Fleet };
        let scan = |robot: RobotId| {
            let (name, source) = (format!("/{robot}/scan"), from_outside(Input::Scan(robot)));
            topics.add(name, "sensor_msgs/LaserScan", source, DEPTH_USUAL, false)
        };
        let scan = RobotId::first(robots).map(scan).collect();
        let mut each = |topic: &str, class: &str, depth: usize, latch: bool| {
            let name = |robot: RobotId| format!("/{robot}/{topic}");
            let add = |robot| topics.add(name(robot), class, Source::Fleet, depth, latch);
            RobotId::first(robots).map(add).collect()
        };
        Self {
            scan,
            command,
            map: each("map", "nav_msgs/OccupancyGrid", 1, true),
            stats: each("slam_stats", "std_msgs/Float32MultiArray", 1, true),
            odometry: each("odom", "nav_msgs/Odometry", DEPTH_USUAL, false),
            pose: each("pose", "geometry_msgs/PoseWithCovarianceStamped", DEPTH_USUAL, false),
            transforms: topics.add(
                "/tf".into(),
                "tf2_msgs/TFMessage",
                Source::Input(Input::Transforms),
                depth,
                false,
            ),
            clock: topics.add("/clock".into(), "rosgraph_msgs/Clock", from_outside(Input::Clock), 1, false),
            merged_map: topics.add("/merged_map".into(), "nav_msgs/OccupancyGrid", Source::Fleet, 1, true),
            merge_edges: topics.add("/merge_edges".into(), Text::TYPE, Source::Fleet, 1, true),
            selected: topics.add(
                "/selected_robot".into(),
                Int32::TYPE,
                Source::Input(Input::Select),
                1,
                true,
            ),
            stop: topics.add("/emergency_stop".into(), Bool::TYPE, Source::Input(Input::Stop), 1, true),
        }
    }
}

/// The world, where it is not simulated here.
pub struct Outside {
    pub world: World,
    /// The run's time.
    pub now: Box<dyn Fn() -> Stamp>,
}

/// All that the bridge knows.
pub struct Hub {
    pub config: BridgeConfig,
    pub robot_count: usize,
    pub board: Board,
    pub fleet: FleetTopics,
    pub names: FrameNames,
    pub drive: Drive,
    pub access: Access,
    pub services: Services,
    pub percent: [i8; 256],
    pub outside: Option<Outside>,
    /// The clock of what is heard on DDS.
    pub ros_clock: SourceClock,
    /// Where the robots' maps lie in the merged one.
    pub map_transforms: Option<MapTransforms>,
    /// What robots' SLAM is to be asked, until it is taken.
    asks: VecDeque<(RobotId, SlamRequest)>,
    now: Stamp,
    anchors_due: Option<Instant>,
    commands: VecDeque<(RobotId, VelocityCommand)>,
    /// What merging is told.
    pub edge_commands: VecDeque<EdgeCommand>,
}

impl Hub {
    /// A sound configuration and 1 to [`ROBOTS_MAX`] robots.
    pub fn new(config: BridgeConfig, robot_count: usize, outside: Option<Outside>) -> Self {
        let mut topics = Topics::new(config.client_topics_max);
        let fleet = FleetTopics::new(&mut topics, robot_count, outside.is_some());
        Self {
            robot_count,
            board: Board::new(topics, &config),
            fleet,
            names: FrameNames::new(config.frame_names),
            percent: msg::grid::percent_table(),
            drive: Drive::new(robot_count, FIRST, config.lease()),
            access: Access::new(&config),
            services: Services::new(config.client_topics_max, config.service_timeout()),
            config,
            outside,
            ros_clock: SourceClock::new(ClockOffset::Fixed(0.0)),
            map_transforms: None,
            asks: VecDeque::with_capacity(ASKS_MAX),
            now: Stamp(0),
            anchors_due: None,
            commands: VecDeque::with_capacity(COMMANDS_MAX),
            edge_commands: VecDeque::with_capacity(EDGE_COMMANDS_MAX),
        }
    }

    /// The fleet's robots.
    pub fn robots(&self) -> impl Iterator<Item = RobotId> + use<> {
        RobotId::first(self.robot_count)
    }

    /// A velocity for a robot: m/s forward, rad/s counter-clockwise.
    pub fn command(&mut self, robot: RobotId, linear_m_s: f64, angular_rad_s: f64) {
        if self.commands.len() == COMMANDS_MAX {
            self.commands.pop_front();
        }
        let header = Header { stamp: self.now, ..Header::default() };
        self.commands.push_back((robot, VelocityCommand { header, linear_m_s, angular_rad_s }));
        if self.outside.is_some() {
            let twist = Twist { linear: [linear_m_s, 0.0, 0.0], angular: [0.0, 0.0, angular_rad_s] };
            self.fleet.command[robot.index()]
                .iter()
                .for_each(|topic| self.board.send(*topic, |to| twist.write(to)));
        }
    }

    /// A word for merging; false if too many wait.
    pub fn edge_command(&mut self, command: EdgeCommand) -> bool {
        let room = self.edge_commands.len() < EDGE_COMMANDS_MAX;
        if room {
            self.edge_commands.push_back(command);
        }
        room
    }

    /// Something a robot's SLAM is to do.
    pub fn ask(&mut self, robot: RobotId, request: SlamRequest) {
        if self.asks.len() == ASKS_MAX {
            self.asks.pop_front();
        }
        self.asks.push_back((robot, request));
    }

    /// The next request to hand to a robot's SLAM.
    pub fn next_ask(&mut self) -> Option<(RobotId, SlamRequest)> {
        self.asks.pop_front()
    }

    /// The next command to hand to its robot.
    pub fn next_command(&mut self) -> Option<(RobotId, VelocityCommand)> {
        let next = self.commands.pop_front()?;
        self.board.counted.commands += 1;
        Some(next)
    }

    /// The fleet's newest clock.
    pub fn set_now(&mut self, now: Stamp) {
        self.now = now;
    }

    /// Where the robots' maps lie; whether that is news.
    pub fn set_map_transforms(&mut self, map_transforms: &MapTransforms) -> bool {
        let changed = self.map_transforms.is_none_or(|before| before.robots != map_transforms.robots);
        self.map_transforms = Some(*map_transforms);
        changed
    }

    /// Whether it is time to tell where the maps lie again.
    pub fn anchors_due(&self, now: Instant) -> bool {
        self.anchors_due.is_some_and(|due| now >= due)
    }

    /// Tells robots to stand still.
    pub fn halt(&mut self, robots: impl Iterator<Item = RobotId>) {
        robots.for_each(|robot| self.command(robot, 0.0, 0.0));
    }

    /// Tells everybody which robot is selected.
    pub fn tell_selected(&mut self) {
        let selected = Int32(self.drive.selected().number() as i32);
        self.board.send(self.fleet.selected, |to| selected.write(to));
    }

    /// Tells everybody whether the emergency stop is set.
    pub fn tell_stop(&mut self) {
        let stopped = Bool(self.drive.stopped());
        self.board.send(self.fleet.stop, |to| stopped.write(to));
    }

    /// Stops every robot until released.
    pub fn stop(&mut self) {
        self.drive.set_stopped(true);
        self.halt(self.robots());
        self.tell_stop();
    }

    /// Lets the robots go again.
    pub fn release(&mut self) {
        self.drive.set_stopped(false);
        self.tell_stop();
    }

    /// /tf: where the robots' maps lie in the merged one, as of now.
    pub fn send_map_transforms(&mut self, at: Instant) {
        let Some(map_transforms) =
            self.map_transforms.filter(|map_transforms| map_transforms.robots.iter().any(|a| a.known == 1))
        else {
            return;
        };
        let stamp = Stamp(self.now.0.max(map_transforms.header.stamp.0));
        self.board
            .send(self.fleet.transforms, |to| write::map_transforms(to, &self.names, stamp, &map_transforms));
        self.anchors_due = Some(at + ANCHORS_PERIOD);
    }

    /// A client is gone: what it drove stops, what it should have answered fails. What it has not been sent.
    pub fn leave(&mut self, id: ClientId) -> Option<Outbox> {
        let rest = self.board.detach(id)?;
        if let Some(outside) = &mut self.outside {
            outside.world.leave(id.serial);
        }
        let driven = self.drive.leave(id);
        self.halt(driven.into_iter());
        let failed = self.services.leave(id);
        failed.into_iter().for_each(|call| self.fail(&call, "the client that offered it has left"));
        Some(rest)
    }
}
