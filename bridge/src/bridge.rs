//! The bridge as its process sees it: messages of the fleet in, commands for robots out.

use crate::board::Counters;
use crate::cdr::Dialect;
use crate::client::{Client, ClientId, Ended};
use crate::command::{handshake, name};
use crate::config::{BridgeConfig, ConfigError};
use crate::dds::Heard;
use crate::frame::{Frame, Side};
use crate::hub::{Hub, Outside};
use crate::outbox::{Lane, Outbox};
use crate::ros::{names, write};
use crate::world::{ClockEstimate, Incoming, SourceClock, SourceId, World, WorldError};
use msg::{
    Clock, Correction, EdgeCommand, FleetStats, GridView, Link, MapTransforms, Odometry, ROBOTS_MAX, RobotId,
    Scan, SlamRequest, Stamp, Transforms, VelocityCommand,
};
use std::cell::RefCell;
use std::net::{IpAddr, SocketAddr};
use std::rc::Rc;
use std::time::Instant;
use tokio::net::TcpStream;
use tokio::sync::Notify;

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
    /// Its clock, if it tells of a world of its own.
    pub clock: Option<ClockEstimate>,
}

/// Sources from here on are not clients.
pub const FIRST_SOURCE: SourceId = 1 << 48;

/// What robots are told: by [`Bridge::new`]'s caller.
type CommandSink = Box<dyn FnMut(RobotId, VelocityCommand)>;
/// What merging is told: by [`Bridge::on_edge_command`]'s caller.
type EdgeCommandSink = Box<dyn FnMut(EdgeCommand)>;
/// What robots' SLAM is asked: by [`Bridge::on_ask`]'s caller.
type AskSink = Box<dyn FnMut(RobotId, SlamRequest)>;

/// The hub between the fleet and its clients. One thread; every method returns at once.
///
/// Messages of the fleet are encoded only if somebody wants them (maps, statistics and states always, for those
/// who come late), once for all, and written to the sockets before the method returns.
pub struct Bridge {
    hub: RefCell<Hub>,
    sink: RefCell<CommandSink>,
    edge_sink: RefCell<EdgeCommandSink>,
    ask: RefCell<AskSink>,
}

impl Bridge {
    /// For robots 1 to `robot_count`. `on_command` is called with every velocity a robot must obey now: `stamp` is
    /// the fleet's newest clock, the rest of the header is the caller's to fill in. It must not call the bridge
    /// with commands of its own.
    pub fn new(
        config: BridgeConfig,
        robot_count: usize,
        on_command: impl FnMut(RobotId, VelocityCommand) + 'static,
    ) -> Result<Self, ConfigError> {
        Self::open(config, robot_count, None, Box::new(on_command))
    }

    /// The same in a world that is not simulated here: scans, the robots' transforms and the clock come from
    /// clients, or by [`Bridge::hear`], and go to `world`'s sink. `now` tells the run's time. Commands go out on
    /// `/cmd_vel_N` and `/robotN/cmd_vel`, too.
    pub fn outside(
        config: BridgeConfig,
        world: World,
        now: impl Fn() -> Stamp + 'static,
        on_command: impl FnMut(RobotId, VelocityCommand) + 'static,
    ) -> Result<Self, ConfigError> {
        let robot_count = world.robot_count();
        Self::open(config, robot_count, Some(Outside { world, now: Box::new(now) }), Box::new(on_command))
    }

    fn open(
        config: BridgeConfig,
        robot_count: usize,
        outside: Option<Outside>,
        sink: CommandSink,
    ) -> Result<Self, ConfigError> {
        config.validate()?;
        let mut hub = Hub::new(config, robot_count.clamp(1, ROBOTS_MAX), outside);
        hub.tell_selected();
        hub.tell_stop();
        Ok(Self {
            hub: RefCell::new(hub),
            sink: RefCell::new(sink),
            ask: RefCell::new(Box::new(|_, _| {})),
            edge_sink: RefCell::new(Box::new(|_| {})),
        })
    }

    /// From now on this is called with what people say of merge edges; else nobody hears it.
    pub fn on_edge_command(&self, sink: impl FnMut(EdgeCommand) + 'static) {
        *self.edge_sink.borrow_mut() = Box::new(sink);
    }

    /// Calls `ask` from now on with whatever a robot's SLAM is to do; `client` and `id` are the caller's to fill in.
    /// It must not call the bridge.
    pub fn on_ask(&self, ask: impl FnMut(RobotId, SlamRequest) + 'static) {
        *self.ask.borrow_mut() = Box::new(ask);
    }

    /// A message of a world outside that came in by another door than TCP. `source` tells machines apart, and is
    /// none of a client's if it is [`FIRST_SOURCE`] or more; `clock` is that machine's.
    pub fn hear(
        &self,
        source: SourceId,
        clock: &mut SourceClock,
        message: Incoming<'_>,
    ) -> Result<(), WorldError> {
        let hub = &mut *self.hub.borrow_mut();
        let Some(Outside { world, now }) = &mut hub.outside else { return Ok(()) };
        let received = now();
        world.hear(source, clock, message, received)
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
        if let Ok(mut sink) = self.edge_sink.try_borrow_mut() {
            while let Some(command) = { self.hub.borrow_mut().edge_commands.pop_front() } {
                sink(command);
            }
        }
        let Ok(mut sink) = self.sink.try_borrow_mut() else { return };
        loop {
            let next = self.hub.borrow_mut().next_command();
            let Some((robot, command)) = next else { break };
            sink(robot, command);
        }
        loop {
            let next = self.hub.borrow_mut().next_ask();
            let Some((robot, request)) = next else { return };
            (self.ask.borrow_mut())(robot, request);
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

    /// `/tf`: the robot's map from its odometry. `/robotN/pose`: where it is in its map.
    pub fn correction(&self, robot: RobotId, correction: &Correction) {
        self.of_robot(robot, |hub| {
            let (frame, pose) = (hub.names.map(robot), hub.fleet.pose[robot.index()]);
            hub.board.send(pose, |to| write::pose_estimate(to, frame, correction));
            hub.board.send(hub.fleet.transforms, |to| write::correction(to, &hub.names, robot, correction));
        });
    }

    /// `/tf`: the merged map from the robots' maps; on change at once, else once a second while [`crate::serve`]
    /// runs.
    pub fn map_transforms(&self, map_transforms: &MapTransforms) {
        self.with(|hub| {
            let changed = hub.set_map_transforms(map_transforms);
            if changed {
                hub.send_map_transforms(Instant::now());
            }
        });
    }

    /// `/clock`.
    pub fn clock(&self, clock: &Clock) {
        self.with(|hub| {
            hub.set_now(clock.header.stamp);
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

    /// `/merge_edges`: what merging believes of each pair of robots, and why; newest also to whoever comes later.
    pub fn merge_edges(&self, json: &str) {
        self.with(|hub| hub.board.send(hub.fleet.merge_edges, |to| to.string(json)));
    }

    /// What was heard at the ROS 2 door: as if a client on loopback had sent it.
    pub fn hear_ros(&self, heard: &Heard) {
        self.with(|hub| hub.hear_ros(heard));
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

    /// Addresses that may watch and drive, loopback aside.
    pub fn allowed(&self) -> Vec<IpAddr> {
        self.hub.borrow().access.allowed().collect()
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
        let status = |client: &Client| ClientStatus {
            peer: client.peer,
            subscriptions: client.subscriptions.len(),
            publications: client.publications.len(),
            waiting_bytes: client.outbox.bytes(),
            dropped: client.outbox.dropped(),
            drives: drives(client.id),
            clock: client.clock.as_ref().and_then(|clock| clock.estimate()),
        };
        hub.board.clients().map(status).collect()
    }

    pub(crate) fn clients_max(&self) -> usize {
        self.hub.borrow().config.clients_max
    }

    pub(crate) fn dialect(&self) -> Dialect {
        self.hub.borrow().config.payloads
    }

    pub(crate) fn frame_bytes_max(&self) -> usize {
        self.hub.borrow().config.frame_bytes_max
    }

    pub(crate) fn unsent_bytes_max(&self) -> u32 {
        self.hub.borrow().config.unsent_bytes_max
    }

    /// What is due now and again: services that took too long, map transforms.
    pub(crate) fn tick(&self, now: Instant) {
        self.with(|hub| {
            let late = hub.services.expired(now);
            late.into_iter().for_each(|call| hub.fail(&call, "no answer came in time"));
            if hub.anchors_due(now) {
                hub.send_map_transforms(now);
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
            let dialect = hub.config.payloads;
            hub.board
                .answer(id, Lane::Answer, |out| Side::Server.write(out, name::HANDSHAKE, handshake(dialect)));
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
