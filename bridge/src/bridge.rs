//! The bridge as its process sees it: messages of the fleet in, commands for robots out.

use crate::access::Access;
use crate::board::{Board, ClientId, Counters, Ended};
use crate::command::{HANDSHAKE, name};
use crate::config::{BridgeConfig, ConfigError};
use crate::drive::Drive;
use crate::frame::{Frame, Side};
use crate::outbox::{Lane, Outbox};
use crate::ros::{Bool, FrameNames, Int32, Message, names, write};
use crate::services::Services;
use crate::topics::{DEPTH_USUAL, Input, Source, TopicId, Topics};
use msg::{
    Anchors, Clock, Command, Correction, FleetStats, GridView, Header, Link, Odometry, ROBOTS_MAX, RobotId,
    Scan, Stamp, Transforms,
};
use std::cell::RefCell;
use std::collections::VecDeque;
use std::net::{IpAddr, SocketAddr};
use std::rc::Rc;
use std::time::{Duration, Instant};
use tokio::net::TcpStream;
use tokio::sync::Notify;

/// Where each robot's map lies in the merged one is told again this often, for whoever has just come.
const ANCHORS_PERIOD: Duration = Duration::from_secs(1);
/// Transforms that wait for a slow client, per robot: about a second of them.
const TRANSFORMS_DEPTH: usize = 32;
/// Commands that wait to be taken; each frame's are taken before the next frame is read.
const COMMANDS_MAX: usize = 4 * ROBOTS_MAX;
/// Selected at start.
const FIRST: RobotId = RobotId::new(1).unwrap();

/// The fleet's topics.
pub(crate) struct FleetTopics {
    scan: Vec<TopicId>,
    map: Vec<TopicId>,
    stats: Vec<TopicId>,
    odometry: Vec<TopicId>,
    pub(crate) transforms: TopicId,
    clock: TopicId,
    merged_map: TopicId,
    pub(crate) selected: TopicId,
    pub(crate) stop: TopicId,
}

impl FleetTopics {
    fn new(topics: &mut Topics, robots: usize) -> Self {
        let depth = TRANSFORMS_DEPTH * robots;
        let mut input = |name: String, class: &str, input: Input| {
            topics.add(name, class, Source::Input(input), DEPTH_USUAL, false);
        };
        input("/cmd_vel".into(), "geometry_msgs/Twist", Input::SelectedCommand);
        for robot in RobotId::first(robots) {
            input(format!("/cmd_vel_{}", robot.number()), "geometry_msgs/Twist", Input::Command(robot));
            input(format!("/{robot}/cmd_vel"), "geometry_msgs/Twist", Input::Command(robot));
        }
        input("/take_control".into(), Int32::TYPE, Input::Take);
        input("/emergency_stop_release".into(), "std_msgs/Empty", Input::Release);
        let mut each = |topic: &str, class: &str, depth: usize, latch: bool| {
            let name = |robot: RobotId| format!("/{robot}/{topic}");
            let add = |robot| topics.add(name(robot), class, Source::Fleet, depth, latch);
            RobotId::first(robots).map(add).collect()
        };
        Self {
            scan: each("scan", "sensor_msgs/LaserScan", DEPTH_USUAL, false),
            map: each("map", "nav_msgs/OccupancyGrid", 1, true),
            stats: each("slam_stats", "std_msgs/Float32MultiArray", 1, true),
            odometry: each("odom", "nav_msgs/Odometry", DEPTH_USUAL, false),
            transforms: topics.add(
                "/tf".into(),
                "tf2_msgs/TFMessage",
                Source::Input(Input::Transforms),
                depth,
                false,
            ),
            clock: topics.add("/clock".into(), "rosgraph_msgs/Clock", Source::Fleet, 1, false),
            merged_map: topics.add("/merged_map".into(), "nav_msgs/OccupancyGrid", Source::Fleet, 1, true),
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

/// All that the bridge knows.
pub(crate) struct Hub {
    pub(crate) config: BridgeConfig,
    pub(crate) robot_count: usize,
    pub(crate) board: Board,
    pub(crate) fleet: FleetTopics,
    pub(crate) names: FrameNames,
    pub(crate) drive: Drive,
    pub(crate) access: Access,
    pub(crate) services: Services,
    percent: [i8; 256],
    now: Stamp,
    anchors: Option<Anchors>,
    anchors_due: Option<Instant>,
    commands: VecDeque<(RobotId, Command)>,
}

impl Hub {
    fn robots(&self) -> impl Iterator<Item = RobotId> + use<> {
        RobotId::first(self.robot_count)
    }

    /// A velocity for a robot: m/s forward, rad/s counter-clockwise.
    pub(crate) fn command(&mut self, robot: RobotId, linear_m_s: f64, angular_rad_s: f64) {
        if self.commands.len() == COMMANDS_MAX {
            self.commands.pop_front();
        }
        let header = Header { stamp: self.now, ..Header::default() };
        self.commands.push_back((robot, Command { header, linear_m_s, angular_rad_s }));
    }

    pub(crate) fn halt(&mut self, robots: impl Iterator<Item = RobotId>) {
        robots.for_each(|robot| self.command(robot, 0.0, 0.0));
    }

    /// Tells everybody which robot is selected.
    pub(crate) fn tell_selected(&mut self) {
        let selected = Int32(self.drive.selected().number() as i32);
        self.board.send(self.fleet.selected, |to| selected.write(to));
    }

    /// Tells everybody whether the emergency stop is set.
    pub(crate) fn tell_stop(&mut self) {
        let stopped = Bool(self.drive.stopped());
        self.board.send(self.fleet.stop, |to| stopped.write(to));
    }

    /// Stops every robot until released.
    pub(crate) fn stop(&mut self) {
        self.drive.set_stopped(true);
        self.halt(self.robots());
        self.tell_stop();
    }

    /// Lets the robots go again.
    pub(crate) fn release(&mut self) {
        self.drive.set_stopped(false);
        self.tell_stop();
    }

    /// /tf: where the robots' maps lie in the merged one, as of now.
    pub(crate) fn tell_anchors(&mut self, at: Instant) {
        let Some(anchors) = self.anchors.filter(|anchors| anchors.robots.iter().any(|a| a.known == 1)) else {
            return;
        };
        let stamp = Stamp(self.now.0.max(anchors.header.stamp.0));
        self.board.send(self.fleet.transforms, |to| write::anchors(to, &self.names, stamp, &anchors));
        self.anchors_due = Some(at + ANCHORS_PERIOD);
    }

    fn leave(&mut self, id: ClientId) -> Option<Outbox> {
        let rest = self.board.detach(id)?;
        let driven = self.drive.leave(id);
        self.halt(driven.into_iter());
        let failed = self.services.leave(id);
        failed.into_iter().for_each(|call| self.fail(&call, "the client that offered it has left"));
        Some(rest)
    }
}

/// One connection, for the fleet's table.
#[derive(Clone, Debug, PartialEq)]
pub struct ClientStatus {
    /// Its address.
    pub peer: SocketAddr,
    /// Topics it is sent.
    pub subscriptions: usize,
    /// Topics it may send.
    pub publications: usize,
    /// Bytes that wait for it.
    pub waiting_bytes: usize,
    /// Messages dropped or replaced because it was slow.
    pub dropped: u64,
    /// Robots it drives now.
    pub drives: Vec<RobotId>,
}

/// What robots are told: by [`Bridge::new`]'s caller.
type CommandSink = Box<dyn FnMut(RobotId, Command)>;

/// The hub between the fleet and its clients. One thread; every method returns at once.
///
/// Messages of the fleet are encoded only if somebody wants them (maps, statistics and states always, for those
/// who come late), once for all, and written to the sockets before the method returns.
pub struct Bridge {
    hub: RefCell<Hub>,
    sink: RefCell<CommandSink>,
}

impl Bridge {
    /// For robots 1 to `robot_count`. `on_command` is called with every velocity a robot must obey now: `stamp` is
    /// the fleet's newest clock, the rest of the header is the caller's to fill in. It must not call the bridge
    /// with commands of its own.
    pub fn new(
        config: BridgeConfig,
        robot_count: usize,
        on_command: impl FnMut(RobotId, Command) + 'static,
    ) -> Result<Self, ConfigError> {
        config.validate()?;
        let robot_count = robot_count.clamp(1, ROBOTS_MAX);
        let mut topics = Topics::new(config.client_topics_max);
        let fleet = FleetTopics::new(&mut topics, robot_count);
        let mut hub = Hub {
            robot_count,
            board: Board::new(topics, config.outbox_bytes_max, config.latched_bytes_max),
            fleet,
            names: FrameNames::new(config.frame_names),
            drive: Drive::new(robot_count, FIRST, config.lease()),
            access: Access::new(&config),
            services: Services::new(config.client_topics_max, config.service_timeout()),
            config,
            percent: msg::grid::percent_table(),
            now: Stamp(0),
            anchors: None,
            anchors_due: None,
            commands: VecDeque::with_capacity(COMMANDS_MAX),
        };
        hub.tell_selected();
        hub.tell_stop();
        Ok(Self { hub: RefCell::new(hub), sink: RefCell::new(Box::new(on_command)) })
    }

    /// Changes the hub, then hands to the sockets and the robots what that has brought about.
    fn with<T>(&self, change: impl FnOnce(&mut Hub) -> T) -> T {
        let result = {
            let hub = &mut *self.hub.borrow_mut();
            let result = change(hub);
            hub.board.flush();
            result
        };
        self.pass_commands();
        result
    }

    /// Commands go out while the hub is free, so that whoever takes them may send messages.
    fn pass_commands(&self) {
        let Ok(mut sink) = self.sink.try_borrow_mut() else { return };
        loop {
            let next = self.hub.borrow_mut().commands.pop_front();
            let Some((robot, command)) = next else { return };
            self.hub.borrow_mut().board.counted.commands += 1;
            sink(robot, command);
        }
    }

    fn of_robot(&self, robot: RobotId, change: impl FnOnce(&mut Hub)) {
        self.with(|hub| {
            if robot.number() <= hub.robot_count {
                change(hub);
            }
        });
    }

    /// `/robotN/scan`.
    pub fn scan(&self, robot: RobotId, scan: &Scan) {
        self.of_robot(robot, |hub| {
            let frame = hub.names.link(robot, Link::BaseScan);
            hub.board.send(hub.fleet.scan[robot.index()], |to| write::laser_scan(to, frame, scan));
        });
    }

    /// `/tf`: the robot's own links.
    pub fn transforms(&self, robot: RobotId, transforms: &Transforms) {
        self.of_robot(robot, |hub| {
            hub.board.send(hub.fleet.transforms, |to| write::transforms(to, &hub.names, robot, transforms));
        });
    }

    /// `/tf`: the robot's map from its odometry.
    pub fn correction(&self, robot: RobotId, correction: &Correction) {
        self.of_robot(robot, |hub| {
            hub.board.send(hub.fleet.transforms, |to| write::correction(to, &hub.names, robot, correction));
        });
    }

    /// `/tf`: the merged map from the robots' maps; on change at once, else once a second while [`crate::serve`]
    /// runs.
    pub fn anchors(&self, anchors: &Anchors) {
        self.with(|hub| {
            let changed = hub.anchors.is_none_or(|before| before.robots != anchors.robots);
            hub.anchors = Some(*anchors);
            if changed {
                hub.tell_anchors(Instant::now());
            }
        });
    }

    /// `/clock`.
    pub fn clock(&self, clock: &Clock) {
        self.with(|hub| {
            hub.now = clock.header.stamp;
            hub.board.send(hub.fleet.clock, |to| write::stamp(to, clock.header.stamp));
        });
    }

    /// `/robotN/odom`.
    pub fn odometry(&self, robot: RobotId, odometry: &Odometry) {
        self.of_robot(robot, |hub| {
            let (odom, base) =
                (hub.names.link(robot, Link::Odom), hub.names.link(robot, Link::BaseFootprint));
            hub.board.send(hub.fleet.odometry[robot.index()], |to| write::odometry(to, odom, base, odometry));
        });
    }

    /// `/robotN/map`, newest also to whoever comes later.
    pub fn map(&self, robot: RobotId, map: GridView<'_>) {
        self.of_robot(robot, |hub| {
            let frame = hub.names.map(robot);
            let topic = hub.fleet.map[robot.index()];
            hub.board.send(topic, |to| write::occupancy_grid(to, frame, &hub.percent, map));
        });
    }

    /// `/merged_map`, newest also to whoever comes later.
    pub fn merged_map(&self, map: GridView<'_>) {
        self.with(|hub| {
            let topic = hub.fleet.merged_map;
            hub.board.send(topic, |to| write::occupancy_grid(to, names::MAP, &hub.percent, map));
        });
    }

    /// `/robotN/slam_stats` of every robot.
    pub fn stats(&self, stats: &FleetStats) {
        self.with(|hub| {
            for robot in hub.robots() {
                let topic = hub.fleet.stats[robot.index()];
                hub.board.send(topic, |to| write::slam_stats(to, &stats.robots[robot.index()]));
            }
        });
    }

    /// Stops every robot until [`Bridge::release`]: as `/emergency_stop`.
    pub fn stop(&self) {
        self.with(Hub::stop);
    }

    /// Lets the robots go again: as `/emergency_stop_release`.
    pub fn release(&self) {
        self.with(Hub::release);
    }

    /// Whether the emergency stop is set.
    pub fn stopped(&self) -> bool {
        self.hub.borrow().drive.stopped()
    }

    /// Which robot `/cmd_vel` goes to.
    pub fn selected(&self) -> RobotId {
        self.hub.borrow().drive.selected()
    }

    /// Addresses that have asked to drive and wait for an answer.
    pub fn waiting(&self) -> Vec<IpAddr> {
        self.hub.borrow().access.waiting().to_vec()
    }

    /// Lets an address watch and drive from now on.
    pub fn allow(&self, address: IpAddr) {
        self.with(|hub| {
            hub.access.allow(address);
            let same = |peer: SocketAddr| peer.ip().to_canonical() == address.to_canonical();
            let there: Vec<ClientId> = hub.board.clients().filter(|c| same(c.peer)).map(|c| c.id).collect();
            there.into_iter().for_each(|id| hub.board.notice(id, name::LOG, "you may drive now".into()));
        });
    }

    /// No longer; its robots stop.
    pub fn deny(&self, address: IpAddr) {
        self.with(|hub| {
            hub.access.deny(address);
            let denied = |peer: SocketAddr| !hub.access.may_drive(peer.ip());
            let there: Vec<ClientId> = hub.board.clients().filter(|c| denied(c.peer)).map(|c| c.id).collect();
            for id in there {
                let driven = hub.drive.leave(id);
                hub.halt(driven.into_iter());
            }
        });
    }

    /// What has been counted since the start.
    pub fn counters(&self) -> Counters {
        self.hub.borrow().board.counters()
    }

    /// Every connection.
    pub fn clients(&self) -> Vec<ClientStatus> {
        let hub = self.hub.borrow();
        let now = Instant::now();
        let drives = |id| hub.robots().filter(|robot| hub.drive.holder(*robot, now) == Some(id)).collect();
        let status = |client: &crate::board::Client| ClientStatus {
            peer: client.peer,
            subscriptions: client.subscriptions.len(),
            publications: client.publications.len(),
            waiting_bytes: client.waiting_bytes(),
            dropped: client.dropped(),
            drives: drives(client.id),
        };
        hub.board.clients().map(status).collect()
    }

    pub(crate) fn clients_max(&self) -> usize {
        self.hub.borrow().config.clients_max
    }

    pub(crate) fn frame_bytes_max(&self) -> usize {
        self.hub.borrow().config.frame_bytes_max
    }

    pub(crate) fn unsent_bytes_max(&self) -> u32 {
        self.hub.borrow().config.unsent_bytes_max
    }

    /// What is due now and again: services that took too long, anchors.
    pub(crate) fn tick(&self, now: Instant) {
        self.with(|hub| {
            let late = hub.services.expired(now);
            late.into_iter().for_each(|call| hub.fail(&call, "no answer came in time"));
            if hub.anchors_due.is_some_and(|due| now >= due) {
                hub.tell_anchors(now);
            }
        });
    }

    /// A new connection; `None` if there are too many. Its first frame is the handshake.
    pub(crate) fn attach(
        &self,
        stream: &Rc<TcpStream>,
        peer: SocketAddr,
        wake: &Rc<Notify>,
    ) -> Option<ClientId> {
        self.with(|hub| {
            if hub.board.clients().count() >= hub.config.clients_max {
                hub.board.counted.refused += 1;
                return None;
            }
            let id = hub.board.attach(stream.clone(), peer, wake.clone());
            hub.board.answer(id, Lane::Answer, |out| Side::Server.write(out, name::HANDSHAKE, HANDSHAKE));
            Some(id)
        })
    }

    /// One frame from a client. Its commands reach the robots before this returns; what it brings about for
    /// clients is written by [`Bridge::flush`], so that a client that sends much is not answered frame by frame.
    pub(crate) fn receive(&self, id: ClientId, frame: Frame<'_>) {
        self.hub.borrow_mut().receive(id, frame);
        self.pass_commands();
    }

    /// Hands what waits to the sockets.
    pub(crate) fn flush(&self) {
        self.hub.borrow_mut().board.flush();
    }

    /// Whether a client's frames wait for room in its socket; an error if it must end.
    pub(crate) fn waits(&self, id: ClientId) -> Result<bool, Ended> {
        self.hub.borrow().board.waits(id)
    }

    /// Writes on for one client whose socket has room again; whether more waits.
    pub(crate) fn flush_one(&self, id: ClientId) -> bool {
        self.hub.borrow_mut().board.flush_one(id)
    }

    /// A client's stream makes no sense any more: it is told why. What has not been sent to it comes back.
    pub(crate) fn lost_track(&self, id: ClientId, why: String) -> Option<Outbox> {
        self.with(|hub| {
            hub.board.refuse(id, why);
            hub.leave(id)
        })
    }

    /// A connection is over: robots it drove stop, calls it should have answered fail.
    pub(crate) fn detach(&self, id: ClientId) {
        self.with(|hub| drop(hub.leave(id)));
    }
}
