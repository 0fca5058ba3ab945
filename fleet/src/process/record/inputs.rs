//! The channels that a recorder reads.

use super::recording_work::RecordingWork;
use super::topics::Recorder;
use crate::channel::{self, Channel};
use crate::ports::{ChannelError, Ports, ReadMapPort, ReadPort, ReceiveCounts};
use crate::run::Run;
use ::bridge::FleetMessage;
use msg::{
    Battery, Clock, DenseMap, EdgeCommand, ExclusionZones, ExplorationReport, FleetStats, GridView,
    GroundTruth, MapTransforms, MergeEdges, Message, Monotonic, MovingObjects, NavigationCommand,
    NavigationPlan, NavigationReport, Odometry, OperatorEvent, PatchHeader, PoseEstimate, RobotId, Scan,
    SlamRequest, Transforms, VelocityCommand,
};
use reports::{FleetView, edges_json};
use std::time::Duration;

/// Channels of one robot.
// More than 12 fields: one for each channel.
struct RobotInputs<P: Ports> {
    robot: RobotId,
    commands: P::Reader<VelocityCommand>,
    odometry: P::Reader<Odometry>,
    transforms: P::Reader<Transforms>,
    scans: P::Reader<Scan>,
    batteries: P::Reader<Battery>,
    pose_estimates: P::Reader<PoseEstimate>,
    truths: P::Reader<GroundTruth>,
    goals: P::Reader<NavigationCommand>,
    slam_requests: P::Reader<SlamRequest>,
    navigation: P::Reader<NavigationReport>,
    plans: P::Reader<NavigationPlan>,
    map: MapInput<P>,
}

/// A map, of which a grid is recorded at most once in a period.
struct MapInput<P: Ports> {
    reader: P::MapReader,
    grid: DenseMap,
    period: Duration,
    has_changed: bool,
    due: Monotonic,
}

impl<P: Ports> MapInput<P> {
    fn open(ports: &P, channel: &Channel<PatchHeader>, run: &Run) -> Result<Self, ChannelError> {
        let period = Duration::from_secs_f64(run.config.recording.map_period_s);
        let reader = ports.map_reader(channel)?;
        Ok(Self { reader, grid: DenseMap::default(), period, has_changed: false, due: Monotonic(0) })
    }

    /// Records the newest version, if it is new and due.
    fn receive(
        &mut self,
        to: &mut RecordingWork,
        now: Monotonic,
        record: impl FnOnce(&mut Recorder, GridView<'_>) + Send + 'static,
    ) {
        self.has_changed |= self.reader.poll();
        if self.has_changed && now >= self.due {
            let map = self.grid.update(self.reader.map());
            let (header, cells, bytes) = (*map.header, map.cells.to_vec(), map.cells.len());
            let record = move |to: &mut Recorder| record(to, GridView { header: &header, cells: &cells });
            to.record(bytes, Box::new(record));
            (self.has_changed, self.due) = (false, now + self.period);
        }
    }
}

/// All channels of a fleet.
pub struct Inputs<P: Ports> {
    robots: Vec<RobotInputs<P>>,
    /// People, doors and boxes, if any move in the simulated room.
    objects: Option<P::Reader<MovingObjects>>,
    clock: P::Reader<Clock>,
    stats: P::Reader<FleetStats>,
    edges: P::Reader<MergeEdges>,
    edge_commands: P::Reader<EdgeCommand>,
    operator_events: P::Reader<OperatorEvent>,
    zones: P::Reader<ExclusionZones>,
    exploration: P::Reader<ExplorationReport>,
    map_transforms: P::Reader<MapTransforms>,
    merged_map: MapInput<P>,
}

impl<P: Ports> Inputs<P> {
    /// Opens the channels.
    pub fn open(ports: &P, run: &Run) -> Result<Self, ChannelError> {
        let of_robot = |robot| {
            Ok(RobotInputs {
                robot,
                commands: ports.reader(&channel::command(robot))?,
                odometry: ports.reader(&channel::odometry(robot))?,
                transforms: ports.reader(&channel::transforms(robot))?,
                scans: ports.reader(&channel::scan(robot))?,
                batteries: ports.reader(&channel::battery(robot))?,
                pose_estimates: ports.reader(&channel::pose_estimate(robot))?,
                truths: ports.reader(&channel::truth(robot))?,
                goals: ports.reader(&channel::goal(robot))?,
                slam_requests: ports.reader(&channel::slam_request(robot))?,
                navigation: ports.reader(&channel::navigation_state(robot))?,
                plans: ports.reader(&channel::plan(robot))?,
                map: MapInput::open(ports, &channel::map(robot), run)?,
            })
        };
        let has_objects = !run.config.world.is_external() && run.config.sim.moving.is_any();
        Ok(Self {
            robots: run.robots().map(of_robot).collect::<Result<_, ChannelError>>()?,
            objects: has_objects.then(|| ports.reader(&channel::moving_objects())).transpose()?,
            clock: ports.reader(&channel::clock())?,
            stats: ports.reader(&channel::stats())?,
            edges: ports.reader(&channel::merge_edges())?,
            edge_commands: ports.reader(&channel::edge_command())?,
            operator_events: ports.reader(&channel::operator_event())?,
            zones: ports.reader(&channel::exclusion_zones())?,
            exploration: ports.reader(&channel::exploration_state())?,
            map_transforms: ports.reader(&channel::map_transforms())?,
            merged_map: MapInput::open(ports, &channel::merged_map(), run)?,
        })
    }

    /// Records what has come on the channels of one of so many parts: robots are spread over them, the fleet's channels are in the
    /// first.
    pub fn receive(&mut self, (part, parts): (usize, usize), to: &mut RecordingWork, now: Monotonic) {
        for input in self.robots.iter_mut().filter(|input| input.robot.index() % parts == part) {
            input.receive(to, now);
        }
        if part == 0 {
            self.receive_of_fleet(to, now);
        }
    }

    fn receive_of_fleet(&mut self, to: &mut RecordingWork, now: Monotonic) {
        if let Some(objects) = &mut self.objects {
            each(objects, to, Recorder::record_moving_objects);
        }
        each(&mut self.clock, to, |to, clock| to.publish(FleetMessage::Clock(clock), sent(clock)));
        each(&mut self.operator_events, to, Recorder::record_operator_event);
        each(&mut self.edge_commands, to, Recorder::record_edge_command);
        each(&mut self.map_transforms, to, |to, all| to.publish(FleetMessage::MapTransforms(all), sent(all)));
        self.merged_map.receive(to, now, move |to, map| to.publish(FleetMessage::MergedMap(map), now));
        each(&mut self.edges, to, |to, edges| {
            to.publish(FleetMessage::MergeEdges(&edges_json(edges)), sent(edges));
        });
        each(&mut self.zones, to, |to, zones| to.publish(FleetMessage::ExclusionZones(zones), sent(zones)));
        each(&mut self.exploration, to, |to, report| {
            to.publish(FleetMessage::ExplorationState(report), sent(report));
        });
        each(&mut self.stats, to, |to, stats| {
            to.publish(FleetMessage::Stats(stats), sent(stats));
            let view = serde_json::to_string(&FleetView::new(stats)).unwrap_or_default();
            to.record_stats(&view, sent(stats));
        });
    }

    /// Lets the newest version of each map be recorded at once, at the end of the recording.
    pub fn end_map_periods(&mut self) {
        let of_robots = self.robots.iter_mut().map(|input| &mut input.map);
        of_robots.chain([&mut self.merged_map]).for_each(|map| map.due = Monotonic(0));
    }

    /// Returns the number of messages that were sent and not received, of all channels of which each message is recorded.
    pub fn lost(&self) -> u64 {
        let of_fleet = [
            self.clock.receive_counts(),
            self.stats.receive_counts(),
            self.edges.receive_counts(),
            self.edge_commands.receive_counts(),
            self.operator_events.receive_counts(),
            self.zones.receive_counts(),
            self.exploration.receive_counts(),
            self.map_transforms.receive_counts(),
        ];
        let of_robots = self.robots.iter().flat_map(RobotInputs::receive_counts);
        of_fleet.into_iter().chain(of_robots).map(|counts| counts.lost).sum()
    }
}

impl<P: Ports> RobotInputs<P> {
    /// Returns the counts of the channels of which each message is recorded: not those of maps and true poses.
    fn receive_counts(&self) -> [ReceiveCounts; 10] {
        [
            self.commands.receive_counts(),
            self.odometry.receive_counts(),
            self.transforms.receive_counts(),
            self.scans.receive_counts(),
            self.batteries.receive_counts(),
            self.pose_estimates.receive_counts(),
            self.goals.receive_counts(),
            self.slam_requests.receive_counts(),
            self.navigation.receive_counts(),
            self.plans.receive_counts(),
        ]
    }

    fn receive(&mut self, to: &mut RecordingWork, now: Monotonic) {
        let robot = self.robot;
        each(&mut self.commands, to, move |to, command| to.record_command(robot, command));
        each(&mut self.odometry, to, move |to, odometry| to.record_odometry(robot, odometry));
        each(&mut self.transforms, to, move |to, all| {
            to.publish(FleetMessage::Transforms(robot, all), sent(all));
        });
        each(&mut self.scans, to, move |to, scan| to.publish(FleetMessage::Scan(robot, scan), sent(scan)));
        each(&mut self.batteries, to, move |to, battery| {
            to.publish(FleetMessage::Battery(robot, battery), sent(battery));
        });
        each(&mut self.pose_estimates, to, move |to, pose_estimate| {
            to.publish(FleetMessage::PoseEstimate(robot, pose_estimate), sent(pose_estimate));
        });
        each(&mut self.goals, to, move |to, command| to.record_navigation_command(robot, command));
        each(&mut self.slam_requests, to, move |to, request| to.record_slam_request(robot, request));
        each(&mut self.navigation, to, move |to, report| {
            to.publish(FleetMessage::NavigationState(robot, report), sent(report));
        });
        each(&mut self.plans, to, move |to, plan| to.publish(FleetMessage::Plan(robot, plan), sent(plan)));
        // 100 Hz of it, of which the newest of each poll is enough.
        if let Some(truth) = self.truths.newest() {
            let truth = *truth;
            to.record(size_of_val(&truth), Box::new(move |to| to.record_truth(robot, &truth)));
        }
        self.map.receive(to, now, move |to, map| to.publish(FleetMessage::Map(robot, map), now));
    }
}

/// Records each message that has come.
fn each<M: Message + Send>(
    reader: &mut impl ReadPort<M>,
    to: &mut RecordingWork,
    record: impl Fn(&mut Recorder, &M) + Copy + Send + 'static,
) {
    while let Some(message) = reader.receive() {
        // The channel's memory is needed for newer messages.
        let message = Box::new(*message);
        to.record(size_of::<M>(), Box::new(move |to: &mut Recorder| record(to, &message)));
    }
}

fn sent(message: &impl Message) -> Monotonic {
    message.header().sent
}
