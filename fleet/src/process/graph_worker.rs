//! The merge process's second thread: receives submaps and estimates where the robots' maps lie by the fleet's pose
//! graph.
//! The merged map never waits for it, and it has less priority than all that robots wait for.

use super::{Listens, ProcessLoop, serve};
use crate::channel;
use crate::clock::Epoch;
use crate::merge_maps::{MapFiles, MapSlot};
use crate::merge_state_file::MergeStateFile;
use crate::ports::{ChannelError, Clock as _, Ports, ReadPort, WritePort};
use crate::progress::WatchedThread;
use crate::realtime::lower_priority;
use crate::run::Run;
use crate::storage::{DiskStorage, Storage};
use ::merge::{FleetPoseGraph, Rejections, SubmapMessage, SubmapRejected};
use msg::{
    EdgeAction, EdgeCommand, Grid, MergeEdges, Monotonic, Pose2, RobotId, Role, Submap, SubmapPoses,
    SubmapRequest,
};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// Period at which the thread polls its channels without being woken.
const POLL_NS: u64 = 500_000_000;
/// Time after which missing submaps are requested, and requested again; longer each time while that brings none.
const REQUEST_NS: u64 = 3_000_000_000;
const REQUEST_MAX_NS: u64 = 60_000_000_000;
/// Niceness of this thread: it gets less processor time than the threads that robots wait for.
const NICE: i32 = 10;

/// What the fleet's pose graph knows of a robot's map.
#[derive(Clone, Debug)]
pub struct RobotMapEstimate {
    /// Pose of the frame `robotK/map` in `map`; `None` while the robot's map is not connected.
    pub map_from_robot_map: Option<Pose2>,
    /// Number of the frame `robotK/map`.
    pub map_frame: u32,
    /// The robot's map drawn anew, if no single transform aligns it.
    pub redrawn: Option<Arc<Grid>>,
}

/// Estimate for each robot, by its index.
pub type FleetEstimate = Vec<RobotMapEstimate>;

/// The newest estimate, for the thread that draws the map. [`channel::merge_edges`] wakes it when there is a new one.
#[derive(Default)]
pub struct FleetEstimateSlot(Mutex<Option<FleetEstimate>>);

impl FleetEstimateSlot {
    fn put(&self, estimate: FleetEstimate) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(estimate);
    }

    /// Takes the estimate that was stored since the last call.
    pub fn take(&self) -> Option<FleetEstimate> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).take()
    }
}

/// What the thread of the fleet's pose graph begins with.
pub struct GraphWorkerParts<S> {
    /// The fleet's pose graph.
    pub graph: FleetPoseGraph,
    /// The file with the state of the graph.
    pub state_file: MergeStateFile<S>,
    /// The files with the robots' maps.
    pub files: MapFiles<S>,
    /// The newest estimates, for the thread that draws.
    pub estimates: Arc<FleetEstimateSlot>,
    /// The newest maps, from the thread that draws.
    pub maps: Arc<MapSlot>,
}

/// Runs the thread until `done`.
pub fn run(run: &Run, state: GraphWorkerParts<DiskStorage>, done: &AtomicBool) -> Result<(), ChannelError> {
    lower_priority(NICE);
    let participant = run.attach_thread(Role::Merge, None, "graph")?;
    let mut graph = GraphWorker::open(&participant, run, state)?;
    let progress = run.progress(Role::Merge, None, WatchedThread::Second);
    serve(&mut graph, progress, &|| done.load(Ordering::Relaxed));
    let rejected = graph.sources.iter().flat_map(|source| source.rejections.summary());
    rejected.for_each(|line| tracing::warn!("merge: {line}"));
    Ok(())
}

/// The fleet's pose graph with its channels. A step receives all messages and does one job.
pub struct GraphWorker<P: Ports, S> {
    graph: FleetPoseGraph,
    state_file: MergeStateFile<S>,
    files: MapFiles<S>,
    maps: Arc<MapSlot>,
    sources: Vec<Source<P>>,
    commands: P::Reader<EdgeCommand>,
    output: Output<P>,
    listeners: Vec<P::Listener>,
    clock: P::Clock,
}

impl<P: Ports, S: Storage> GraphWorker<P, S> {
    /// Opens the channels of a graph.
    pub fn open(ports: &P, run: &Run, state: GraphWorkerParts<S>) -> Result<Self, ChannelError> {
        let GraphWorkerParts { graph, state_file, files, estimates: slot, maps } = state;
        let mut listeners = vec![ports.listener(&channel::edge_command())?];
        for robot in run.robots() {
            listeners.push(ports.listener(&channel::submap_poses(robot))?);
            listeners.push(ports.listener(&channel::submap(robot))?);
        }
        let sources = run.robots().map(|robot| Source::open(ports, robot));
        Ok(Self {
            graph,
            state_file,
            files,
            maps,
            sources: sources.collect::<Result<_, _>>()?,
            commands: ports.reader(&channel::edge_command())?,
            output: Output {
                writer: ports.writer(&channel::merge_edges())?,
                epoch: run.epoch,
                edges: Box::default(),
                answered: false,
                estimate: None,
                slot,
            },
            listeners,
            clock: ports.clock(),
        })
    }
}

impl<P: Ports, S: Storage> ProcessLoop for GraphWorker<P, S> {
    fn step(&mut self) -> Monotonic {
        while let Some(command) = self.commands.receive() {
            self.output.apply_command(&mut self.graph, &command);
        }
        let now = self.clock.now();
        self.sources.iter_mut().for_each(|source| source.receive(&mut self.graph, now));
        let task = self.graph.next_task();
        let worked = task.is_some();
        if let Some(task) = task {
            let outcome = task.run();
            if let Some(why) = outcome.solve_error() {
                tracing::warn!(
                    "merge: the joint pose graph was not solved: {why}; robots' maps stay where they are"
                );
            }
            self.graph.apply_result(outcome);
        }
        // Saved before it is published, so that a pin that a client has seen outlives this process.
        let is_saved = self.state_file.save(&self.graph, now, self.output.answered);
        self.files.save(&self.maps, now);
        self.output.publish(&self.graph, self.sources.len(), is_saved, now);
        if worked { now } else { Monotonic(now.0 + POLL_NS) }
    }
}

impl<P: Ports, S: Storage> Listens<P::Listener> for GraphWorker<P, S> {
    fn listeners(&self) -> impl Iterator<Item = &P::Listener> {
        self.listeners.iter()
    }
}

/// Channels of one robot's submaps.
struct Source<P: Ports> {
    robot: RobotId,
    submaps: P::Reader<Submap>,
    poses: P::Reader<SubmapPoses>,
    requests: P::Writer<SubmapRequest>,
    /// Messages that the graph has rejected.
    rejections: Rejections,
    /// Messages lost so far, when all submaps were last requested.
    lost: u64,
    /// Moment since which a submap has been missing.
    missing_since: Option<Monotonic>,
    /// How many were missing at the last request; 0 before the first.
    missing_before: usize,
    /// Time until the next request.
    pause_ns: u64,
}

impl<P: Ports> Source<P> {
    fn open(ports: &P, robot: RobotId) -> Result<Self, ChannelError> {
        Ok(Self {
            robot,
            submaps: ports.reader(&channel::submap(robot))?,
            poses: ports.reader(&channel::submap_poses(robot))?,
            requests: ports.writer(&channel::submap_request(robot))?,
            rejections: Rejections::default(),
            lost: 0,
            missing_since: None,
            missing_before: 0,
            pause_ns: REQUEST_NS,
        })
    }

    /// Counts a message that was rejected, and says so if its reason is new.
    fn record(&mut self, message: SubmapMessage, result: Result<(), SubmapRejected>) {
        if let Some(text) = self.rejections.record(self.robot, message, result) {
            tracing::warn!("merge: {text}");
        }
    }

    fn receive(&mut self, graph: &mut FleetPoseGraph, now: Monotonic) {
        if let Some(poses) = self.poses.newest() {
            let result = graph.update_poses(self.robot, &poses);
            self.record(SubmapMessage::Poses, result);
        }
        while let Some(submap) = self.submaps.receive() {
            let result = graph.add_submap(self.robot, &submap);
            self.record(SubmapMessage::Submap, result);
        }
        let (lost, missing) = (self.submaps.receive_counts().lost, graph.missing_submaps(self.robot));
        if missing == 0 && lost == self.lost {
            (self.missing_since, self.missing_before, self.pause_ns) = (None, 0, REQUEST_NS);
            return;
        }
        let since = *self.missing_since.get_or_insert(now);
        let is_new = lost != self.lost || missing > self.missing_before;
        if now.since(since) >= if is_new { REQUEST_NS } else { self.pause_ns } {
            // Submaps without a known place never come, while each request has SLAM send all others anew.
            let was_in_vain = lost == self.lost && (1..=missing).contains(&self.missing_before);
            self.pause_ns = if was_in_vain { (2 * self.pause_ns).min(REQUEST_MAX_NS) } else { REQUEST_NS };
            self.requests.send(&SubmapRequest::default());
            (self.lost, self.missing_since, self.missing_before) = (lost, None, missing);
        }
    }
}

/// Publishes the results of the graph.
struct Output<P: Ports> {
    writer: P::Writer<MergeEdges>,
    epoch: Epoch,
    /// Edges as published last, with the current count of commands.
    edges: Box<MergeEdges>,
    /// A command was answered since the last publication.
    answered: bool,
    estimate: Option<FleetEstimate>,
    slot: Arc<FleetEstimateSlot>,
}

impl<P: Ports> Output<P> {
    fn apply_command(&mut self, graph: &mut FleetPoseGraph, command: &EdgeCommand) {
        let action = EdgeAction::from_code(command.action);
        let done = action.is_some_and(|action| graph.apply_command(command.edge, action));
        self.edges.commands += 1;
        self.edges.refused += u32::from(!done);
        self.answered = true;
    }

    /// Publishes edges and estimates that have changed, and whether the state of this moment is saved.
    fn publish(&mut self, graph: &FleetPoseGraph, robots: usize, is_saved: bool, now: Monotonic) {
        let of_robot = |robot| RobotMapEstimate {
            map_from_robot_map: graph.map_from_robot_map(robot),
            map_frame: graph.map_frame(robot),
            redrawn: graph.redrawn_map(robot).cloned(),
        };
        let estimate: FleetEstimate = RobotId::first(robots).map(of_robot).collect();
        let moved = self.estimate.as_ref().is_none_or(|before| !same(before, &estimate));
        let mut edges = self.edges.clone();
        graph.write_edges(&mut edges);
        edges.unsaved = u32::from(!is_saved);
        if moved {
            self.slot.put(estimate.clone());
            self.estimate = Some(estimate);
        }
        let changed = edges.edges() != self.edges.edges()
            || edges.unsaved != self.edges.unsaved
            || edges.contradicted_start_bits != self.edges.contradicted_start_bits;
        if moved || self.answered || changed {
            let known = |robot: &RobotId| self.edges.contradicted_starts().any(|other| other == *robot);
            for robot in edges.contradicted_starts().filter(|robot| !known(robot)) {
                tracing::warn!(
                    "merge: the given start of {robot} contradicts the maps and is not used; its place comes from the maps"
                );
            }
            edges.header.stamp = self.epoch.stamp(now);
            self.writer.send(&edges);
            (self.edges, self.answered) = (edges, false);
        }
        self.writer.refresh();
    }
}

fn same(before: &FleetEstimate, now: &FleetEstimate) -> bool {
    before.iter().zip(now).all(|(before, now)| {
        (before.map_from_robot_map, before.map_frame) == (now.map_from_robot_map, now.map_frame)
            && before.redrawn.as_ref().map(Arc::as_ptr) == now.redrawn.as_ref().map(Arc::as_ptr)
    })
}
