//! The same fleet in one process on virtual time: no clock, no shared memory, one fixed order. The
//! same configuration gives the same messages, byte for byte, as fast as the machine goes.
//!
//! It drives the very rooms that the processes drive; only the shell differs.

mod command;

pub use command::{LockstepArgs, run};

use crate::channel::{self, Channel};
use crate::config::FleetConfig;
use crate::fleet::{self, FleetError};
use crate::process::{MAP_PERIOD, PLAN_RESOLUTION_M};
use crate::sessions::{self, SessionsError};
use bytemuck::Zeroable;
use merge::{FleetPoseGraph, Merger};
use msg::tiles::PatchSender;
use msg::{
    Clock, Correction, DenseMap, FleetStats, GridView, GroundTruth, Header, MapTransforms, MergeEdges,
    Message, Monotonic, PatchHeader, Pose2, RobotId, Scan, Stamp, Submap, SubmapPoses, TileMap,
    TrackingState, VelocityCommand,
};
use nav::{ExplorationTour, FleetObservation, MapView, RobotObservation, ScanView, TourConfig};
use operator::joystick::SimulatedJoystick;
use sim::{Simulator, Tick};
use slam::{Identity, InitialPose, Session, Slam, Submaps};
use std::collections::BTreeMap;
use telemetry::Telemetry;

/// The operator acts at 20 Hz, as a headset's stick is read.
const HAND_TICKS: u64 = 5;
/// Figures once a second.
const STATS_TICKS: u64 = 100;

/// A fleet in lockstep.
pub struct Lockstep {
    members: Vec<Member>,
    merger: Merger,
    robot_radius_m: f64,
    /// The joint graph: one piece of its work each tick.
    joint: FleetPoseGraph,
    edges: Box<MergeEdges>,
    telemetry: Telemetry,
    tour: Option<ExplorationTour>,
    joystick: SimulatedJoystick,
    together: bool,
    known: Vec<Option<Pose2>>,
    merged_map: Chart,
    map_transforms: MapTransforms,
    stats: Box<FleetStats>,
    voice: Voice,
    ticks: u64,
}

/// One robot: its simulator and its SLAM.
struct Member {
    robot: RobotId,
    simulator: Simulator,
    slam: Slam,
    scan: Box<Scan>,
    scanned: bool,
    truth: GroundTruth,
    correction: Option<Correction>,
    odom_from_base: Pose2,
    map: Chart,
    map_due: Stamp,
    submaps: Submaps,
    submap: Box<Submap>,
    submap_poses: Box<SubmapPoses>,
    nodes: usize,
}

/// A map on its way through the fleet: what has been said of it, and the grid of what is known.
#[derive(Default)]
struct Chart {
    outgoing: PatchSender,
    grid: DenseMap,
    drawn: bool,
}

impl Chart {
    fn view(&self) -> Option<GridView<'_>> {
        self.drawn.then(|| self.grid.view())
    }
}

/// Hears every message: the channel's name and the message's bytes.
pub type Listener<'a> = &'a mut dyn FnMut(&str, &[u8]);

impl Lockstep {
    /// Builds the fleet. `together`: the operator drives all robots at once, not one after the other.
    pub fn new(config: &FleetConfig, together: bool) -> Result<Self, FleetError> {
        let room = fleet::room(config)?;
        let starts = fleet::starts(config, &room)?;
        let robots = RobotId::first(config.fleet.robots);
        let member = |(robot, start): (RobotId, &Pose2)| {
            Ok(Member {
                robot,
                simulator: fleet::simulator(config, &room, robot, *start)?,
                slam: slam(config, robot)?,
                scan: Box::new(Scan::zeroed()),
                scanned: false,
                truth: GroundTruth::default(),
                correction: None,
                odom_from_base: Pose2::IDENTITY,
                map: Chart::default(),
                map_due: Stamp(i64::MIN),
                submaps: Submaps::new(&config.slam),
                submap: bytemuck::allocation::zeroed_box(),
                submap_poses: bytemuck::allocation::zeroed_box(),
                nodes: 0,
            })
        };
        let known = fleet::known_starts(config)?;
        let truth = fleet::true_starts(config)?;
        let tour = TourConfig { seed: config.fleet.seed, ..TourConfig::default() };
        Ok(Self {
            members: robots.clone().zip(&starts).map(member).collect::<Result<_, FleetError>>()?,
            merger: Merger::new(&config.merge, &known),
            robot_radius_m: config.slam.map.robot_radius_m,
            joint: FleetPoseGraph::new(&config.merge.align, &known),
            edges: Box::default(),
            telemetry: Telemetry::new(config.fleet.robots, Some(room.floor_plan(PLAN_RESOLUTION_M)), &truth),
            tour: ExplorationTour::new(tour, robots),
            joystick: SimulatedJoystick::default(),
            together,
            known,
            merged_map: Chart::default(),
            map_transforms: MapTransforms::default(),
            stats: Box::default(),
            voice: Voice::default(),
            ticks: 0,
        })
    }

    /// Every robot's session, and where the robots' maps lie.
    pub fn sessions(&mut self) -> impl Iterator<Item = (RobotId, Session)> + '_ {
        self.members.iter_mut().map(|member| {
            let identity = Identity::new(member.robot.number() as u32, 0, member.slam.back().config());
            (member.robot, member.slam.session(identity))
        })
    }

    /// Where each robot's map lies in the fleet's from the start, if that is known.
    pub fn known_starts(&self) -> &[Option<Pose2>] {
        &self.known
    }

    /// One tick of the whole fleet, in the order of the data: hand, robots, SLAM, merging, figures.
    pub fn tick(&mut self, listener: Listener<'_>) {
        if self.ticks.is_multiple_of(HAND_TICKS) {
            self.drive(listener);
        }
        let changed = self.robots(listener) | self.join(listener);
        if changed {
            self.merge(listener);
        }
        self.ticks += 1;
        if self.ticks.is_multiple_of(STATS_TICKS) {
            let stamp = self.now();
            *self.stats = *self.telemetry.compute_stats(stamp, moment(stamp));
            self.voice.say(&channel::stats(), self.stats.as_mut(), listener);
        }
    }

    /// The run's time.
    pub fn now(&self) -> Stamp {
        Stamp(self.ticks as i64 * Simulator::TICK.as_nanos() as i64)
    }

    /// The newest figures.
    pub fn stats(&self) -> &FleetStats {
        &self.stats
    }

    /// Every map so far: a name and the map.
    pub fn maps(&self) -> impl Iterator<Item = (String, GridView<'_>)> {
        let of_robots = self.members.iter().filter_map(|m| Some((format!("{}_map", m.robot), m.map.view()?)));
        of_robots.chain(self.merged_map.view().map(|map| ("merged_map".into(), map)))
    }

    /// Steps the tour and drives each robot by its simulated joystick, as the operator does.
    fn drive(&mut self, listener: Listener<'_>) {
        let Some(tour) = &mut self.tour else { return };
        let stamp = Stamp(self.ticks as i64 * Simulator::TICK.as_nanos() as i64);
        let map = self.merged_map.view().and_then(MapView::from_log_odds);
        let robots: Vec<RobotObservation<'_>> =
            self.members.iter().map(|m| m.observation(map, &self.map_transforms)).collect();
        let observation = FleetObservation { stamp, robots: &robots };
        let mut drive_commands = Vec::new();
        if self.together {
            tour.step_all(&observation, &mut drive_commands);
        } else {
            drive_commands.push(tour.step_in_turn(&observation));
        }
        for drive_command in drive_commands {
            let robot = drive_command.robot;
            let twist = self.joystick.drive(stamp, &drive_command);
            let mut command = VelocityCommand {
                linear_m_s: twist.linear_m_s,
                angular_rad_s: twist.angular_rad_s,
                ..VelocityCommand::default()
            };
            command.header.stamp = stamp;
            self.voice.say(&channel::command(robot), &mut command, listener);
            self.members[robot.index()].simulator.command(&command);
        }
    }

    /// Every robot moves, measures and maps. True if a map changed.
    fn robots(&mut self, listener: Listener<'_>) -> bool {
        let truths: Vec<GroundTruth> = self.members.iter().map(|member| member.truth).collect();
        let mut changed = false;
        for index in 0..self.members.len() {
            let member = &mut self.members[index];
            for (peer, truth) in
                truths.iter().enumerate().filter(|(peer, _)| *peer != index && self.ticks > 0)
            {
                if let Some(peer) = RobotId::new(peer + 1) {
                    member.simulator.update_peer(peer, truth);
                }
            }
            let tick = member.simulator.step();
            member.sense(&tick, &mut self.voice, &mut self.telemetry, listener);
            changed |= tick.scan_due && member.map(&mut self.voice, &mut self.telemetry, listener);
            if let Some(at) =
                member.correction.filter(|at| tick.scan_due && at.state() != TrackingState::Lost)
            {
                self.merger.set_robot_footprint(member.robot, at.map_from_base, self.robot_radius_m);
            }
            if changed {
                // Refusals are counted where processes run; here a refused map would show in the figures.
                let _ = self.merger.update_tiles(member.robot, member.slam.tiles());
            }
            if tick.scan_due {
                member.submaps(&mut self.joint, &mut self.voice, listener);
            }
        }
        changed
    }

    /// A piece of the joint graph's work. True if a robot's map lies elsewhere now, or looks different.
    fn join(&mut self, listener: Listener<'_>) -> bool {
        let Some(task) = self.joint.next_task() else { return false };
        self.joint.apply_outcome(task.run());
        let mut edges = self.edges.clone();
        self.joint.write_edges(&mut edges);
        if edges.edges() != self.edges.edges() {
            edges.header.stamp = self.now();
            self.voice.say(&channel::merge_edges(), edges.as_mut(), listener);
            self.edges = edges;
        }
        let settle = |changed: bool, member: &Member| {
            let (robot, joint) = (member.robot, &self.joint);
            let news = self.merger.apply_fleet_estimate(
                robot,
                joint.map_from_robot_map(robot),
                joint.redrawn_map(robot),
            );
            changed | news.unwrap_or(false)
        };
        self.members.iter().fold(false, settle)
    }

    fn merge(&mut self, listener: Listener<'_>) {
        let merged = self.merger.merged_tiles();
        let received = moment(merged.header.header.stamp);
        self.voice.say_map(&channel::merged_map(), &mut self.merged_map, merged, listener);
        self.map_transforms = self.merger.map_transforms();
        self.voice.say(&channel::map_transforms(), &mut self.map_transforms, listener);
        self.telemetry.update_map_transforms(&self.map_transforms);
        self.telemetry.update_merged_map(self.merged_map.grid.view(), received);
    }
}

/// A robot's SLAM, with what it is to begin with.
fn slam(config: &FleetConfig, robot: RobotId) -> Result<Slam, FleetError> {
    let first = sessions::first(config, robot).map_err(SessionsError::from)?;
    let mode = sessions::first_mode(config, first.is_some());
    let mut slam = Slam::begin(config.slam.clone(), first, mode, InitialPose::Unknown);
    // No scan of this run is in it yet.
    slam.back_mut().set_map_header(Header::default(), Monotonic::default());
    Ok(slam)
}

impl Member {
    /// What the simulator says in a tick.
    fn sense(&mut self, tick: &Tick, voice: &mut Voice, telemetry: &mut Telemetry, listener: Listener<'_>) {
        let robot = self.robot;
        if robot.index() == 0 {
            let mut clock = Clock::default();
            clock.header.stamp = tick.stamp;
            voice.say(&channel::clock(), &mut clock, listener);
        }
        self.truth = tick.truth;
        voice.say(&channel::truth(robot), &mut self.truth, listener);
        telemetry.add_truth(robot, &self.truth);
        if let Some(mut odometry) = tick.odometry {
            voice.say(&channel::odometry(robot), &mut odometry, listener);
            self.odom_from_base = odometry.odom_from_base;
            self.slam.add_odometry(&odometry);
        }
        if let Some(mut transforms) = tick.transforms {
            voice.say(&channel::transforms(robot), &mut transforms, listener);
            telemetry.add_transforms(robot, &transforms, moment(tick.stamp));
        }
    }

    /// A scan through SLAM. True if there is a new map.
    fn map(&mut self, voice: &mut Voice, telemetry: &mut Telemetry, listener: Listener<'_>) -> bool {
        let robot = self.robot;
        self.simulator.scan_into(&mut self.scan);
        voice.say(&channel::scan(robot), self.scan.as_mut(), listener);
        self.scanned = true;
        let mut correction = self.slam.process(&self.scan).correction;
        self.slam.work();
        voice.say(&channel::correction(robot), &mut correction, listener);
        telemetry.add_correction(robot, &correction, moment(correction.header.stamp));
        self.correction = Some(correction);
        let stamp = self.scan.header.stamp;
        if stamp < self.map_due {
            return false;
        }
        self.map_due = stamp + MAP_PERIOD;
        let news = voice.say_map(&channel::map(robot), &mut self.map, self.slam.tiles(), listener);
        if news {
            telemetry.add_map(robot, self.map.grid.view(), moment(stamp));
        }
        news
    }

    /// What is new of the robot's submaps, for the joint graph.
    fn submaps(&mut self, joint: &mut FleetPoseGraph, voice: &mut Voice, listener: Listener<'_>) {
        let back = self.slam.back();
        if back.nodes().len() == self.nodes {
            return;
        }
        self.nodes = back.nodes().len();
        self.submaps.update(back);
        self.submaps.poses(back, &mut self.submap_poses);
        voice.say(&channel::submap_poses(self.robot), self.submap_poses.as_mut(), listener);
        // A robot's own submaps are sound.
        let _ = joint.update_poses(self.robot, &self.submap_poses);
        while let Some(submap) = self.submaps.next_changed(back) {
            *self.submap = *submap;
            voice.say(&channel::submap(self.robot), self.submap.as_mut(), listener);
            let _ = joint.add_submap(self.robot, &self.submap);
        }
    }

    /// The robot as navigation sees it: in its own map while its place in the merged one is not known.
    fn observation<'a>(
        &'a self,
        merged: Option<MapView<'a>>,
        map_transforms: &MapTransforms,
    ) -> RobotObservation<'a> {
        let map_transform = map_transforms.robots[self.robot.index()];
        let in_merged_map = map_transform.known != 0;
        let map_from_robot_map =
            if in_merged_map { map_transform.map_from_robot_map } else { Pose2::IDENTITY };
        let map_from_base = self
            .correction
            .map(|correction| map_from_robot_map * correction.map_from_odom * self.odom_from_base);
        let own = || self.map.view().and_then(MapView::from_log_odds);
        RobotObservation {
            robot: self.robot,
            map: if in_merged_map { merged } else { own() },
            in_merged_map,
            map_from_base,
            scan: self.scanned.then(|| ScanView::from_burger_scan(&self.scan)),
        }
    }
}

/// On virtual time a message is sent and received at its stamp.
fn moment(stamp: Stamp) -> Monotonic {
    Monotonic(stamp.0.max(0) as u64)
}

/// Numbers the messages of each channel, as the channels in shared memory do.
#[derive(Default)]
struct Voice {
    seqs: BTreeMap<String, u64>,
}

impl Voice {
    fn say<T: Message>(&mut self, channel: &Channel<T>, message: &mut T, listener: Listener<'_>) {
        self.mark(&channel.name, message.header_mut());
        listener(&channel.name, bytemuck::bytes_of(message));
    }

    /// Says what is new of a map; false if nothing is.
    fn say_map(
        &mut self,
        channel: &Channel<PatchHeader>,
        chart: &mut Chart,
        map: &TileMap,
        listener: Listener<'_>,
    ) -> bool {
        let mut news = false;
        while let Some(mut patch) = chart.outgoing.next_patch(map) {
            self.say(channel, &mut patch.header, listener);
            patch.tiles.iter().for_each(|tile| listener(&channel.name, bytemuck::bytes_of(&**tile)));
            news = true;
        }
        if news {
            chart.grid.update(map);
            chart.drawn = true;
        }
        news
    }

    fn mark(&mut self, name: &str, header: &mut msg::Header) {
        let seq = self.seqs.entry(name.to_string()).or_default();
        (header.seq, header.incarnation, header.sent) = (*seq, 0, moment(header.stamp));
        *seq += 1;
    }
}
