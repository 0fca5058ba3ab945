//! One log through SLAM, in a process of its own: two threads as in the live worker, each measuring itself.

use crate::relations::{self, Errors, Trajectory, Which};
use crate::settings::slam_config;
use crate::varied::{Maker, Varied};
use allocation_counter::measure;
use bytemuck::Zeroable;
use formats::carmen::{LaserLine, Reader, Record};
use formats::map_file::write_map;
use msg::{Odometry, Scan};
use rustix::time::{ClockId, clock_gettime};
use serde::{Deserialize, Serialize};
use slam::{
    BackEnd, EdgeKind, FrontEnd, MapFrameUpdate, Node, ReliabilityEvidence, ScanResult, Slam, Stage,
    StageObserver,
};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, mpsc};
use std::time::Instant;

/// Nodes that may wait for the back end: the log waits then, and no node is held back.
const WAITING_MAX: usize = slam::NODES_IN_FLIGHT_MAX - 2;
/// Nodes until the scan path is in its steady state.
const WARM_UP_NODES: u32 = 100;
/// A measurement this far from the truth is wrong: metres, radians. What is taken for the truth is
/// itself off by some centimetres.
const WRONG_M: f64 = 0.5;
const WRONG_RAD: f64 = 0.15;
/// Nodes at either end that are compared.
const ENDS_NODES: u32 = 100;

/// What to run.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Task {
    /// A CARMEN log.
    pub log: PathBuf,
    /// What is different from the log.
    pub varied: Varied,
    /// What the trajectory is compared with.
    pub relations: PathBuf,
    /// Odometry between the scans.
    pub odometry: Option<PathBuf>,
    /// The robot's true way, scan by scan, if it is known: `t x y yaw` a line.
    pub truth: Option<PathBuf>,
    /// Where to write its way as found.
    pub trajectory: Option<PathBuf>,
    /// Where to write the map: YAML, PGM and PNG of this name.
    pub map: Option<PathBuf>,
}

/// What came of it.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Outcome {
    /// Errors of all relations.
    pub all: Errors,
    /// Of those that come back to a place.
    pub revisit: Errors,
    /// Of those between scans of the log.
    pub both_kept: Errors,
    /// Of all between poses that are placed in the map: what the map itself gets wrong.
    pub in_map: Errors,
    /// Scans that got a pose.
    pub scans: u64,
    /// Of them, scans that did not fit.
    pub lost: u64,
    /// Nodes of the graph.
    pub nodes: usize,
    /// Links between them.
    pub links: usize,
    /// Active closures.
    pub closures: usize,
    /// Retracted closures.
    pub retracted: u64,
    /// Nodes that are not placed in the map.
    pub unplaced: usize,
    /// Evidence that the map is wrong.
    pub evidence: ReliabilityEvidence,
    /// Active closures that are not true, if the truth is known.
    pub wrong_closures: usize,
    /// The same of links between scans.
    pub wrong_links: usize,
    /// Reading to final trajectory, seconds.
    pub wall_s: f64,
    /// Processor time of the process for it, seconds.
    pub cpu_s: f64,
    /// The process's largest resident memory at that moment, MB.
    pub memory_mb: f64,
    /// Scan path a scan, milliseconds: wall time.
    pub scan_wall_ms: Spread,
    /// The same: processor time of its thread.
    pub scan_cpu_ms: Spread,
    /// The scans of the first nodes, processor time.
    pub first_nodes_cpu_ms: Spread,
    /// The scans of the last nodes.
    pub last_nodes_cpu_ms: Spread,
    /// Work beside, milliseconds a node: wall time.
    pub beside_wall_ms: Spread,
    /// The same: processor time of its thread.
    pub beside_cpu_ms: Spread,
    /// Allocations on the scan path in its steady state.
    pub allocations: u64,
    /// The scans they were counted over.
    pub allocations_scans: u64,
    /// Processor time by stage.
    pub stages: Vec<StageTimes>,
}

/// Of times.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct Spread {
    /// How many.
    pub count: usize,
    /// Mean.
    pub mean: f64,
    /// Median.
    pub p50: f64,
    /// 99th percentile.
    pub p99: f64,
    /// Largest.
    pub max: f64,
}

impl Spread {
    /// Of times in nanoseconds, as milliseconds.
    pub fn of(times_ns: impl Iterator<Item = u64>) -> Self {
        let mut times: Vec<u64> = times_ns.collect();
        times.sort_unstable();
        let Some(last) = times.len().checked_sub(1) else { return Self::default() };
        let at = |share: f64| times[(share * last as f64).ceil() as usize] as f64 * 1e-6;
        let mean = times.iter().sum::<u64>() as f64 * 1e-6 / times.len() as f64;
        Self { count: times.len(), mean, p50: at(0.5), p99: at(0.99), max: at(1.0) }
    }
}

/// Processor time of one stage.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct StageTimes {
    /// Its name.
    pub stage: String,
    /// How often it was entered.
    pub count: u64,
    /// Milliseconds in all.
    pub total_ms: f64,
    /// The longest single one, milliseconds.
    pub max_ms: f64,
}

/// Sums and maxima by stage, shared by the two threads' stopwatches.
#[derive(Default)]
struct StageSums([[AtomicU64; 3]; Stage::ALL.len()]);

impl StageSums {
    fn times(&self) -> Vec<StageTimes> {
        let of = |stage: &Stage| {
            let [count, total, max] = self.0[*stage as usize].each_ref().map(|v| v.load(Ordering::Relaxed));
            let (total_ms, max_ms) = (total as f64 * 1e-6, max as f64 * 1e-6);
            StageTimes { stage: stage.name().into(), count, total_ms, max_ms }
        };
        Stage::ALL.iter().filter(|stage| **stage != Stage::Idle).map(of).collect()
    }
}

/// One thread's.
struct Stopwatch {
    sums: Arc<StageSums>,
    stage: Stage,
    since_ns: u64,
}

impl Stopwatch {
    fn new(sums: &Arc<StageSums>) -> Box<Self> {
        Box::new(Self { sums: sums.clone(), stage: Stage::Idle, since_ns: 0 })
    }
}

impl StageObserver for Stopwatch {
    fn stage_started(&mut self, stage: Stage) {
        let now = thread_cpu_ns();
        if self.stage != Stage::Idle {
            let took = now - self.since_ns;
            let [count, total, max] = &self.sums.0[self.stage as usize];
            count.fetch_add(1, Ordering::Relaxed);
            total.fetch_add(took, Ordering::Relaxed);
            max.fetch_max(took, Ordering::Relaxed);
        }
        (self.stage, self.since_ns) = (stage, now);
    }
}

/// Processor time of this thread.
pub fn thread_cpu_ns() -> u64 {
    let t = clock_gettime(ClockId::ThreadCPUTime);
    t.tv_sec as u64 * 1_000_000_000 + t.tv_nsec as u64
}

/// One unit of work.
#[derive(Clone, Copy)]
struct Took {
    wall_ns: u64,
    cpu_ns: u64,
    /// The newest node afterwards.
    nodes: u32,
    allocations: u64,
}

/// Does a task: what a child process of the bench is for.
pub fn drive(task: &Task) -> Result<Outcome, String> {
    let start = Instant::now();
    let log = unpack(&task.log)?;
    let sums = Arc::new(StageSums::default());
    let Replayed { front, mut back, scans, besides } = replay(&log, task, &sums)?;
    let wall_s = start.elapsed().as_secs_f64();
    let cpu_s = mr_slam::clock::cpu_ns() as f64 * 1e-9;
    let map = back.map();
    let memory_mb = memory_peak_mb()?;
    if let Some(stem) = &task.map {
        write_map(stem, map).map_err(|why| why.to_string())?;
    }
    let mut outcome = Outcome { wall_s, cpu_s, memory_mb, stages: sums.times(), ..Outcome::default() };
    outcome.measure(&scans, &besides);
    outcome.count(&front, &back);
    outcome.score(task, &front, &back)?;
    Ok(outcome)
}

impl Outcome {
    fn measure(&mut self, scans: &[Took], besides: &[Took]) {
        let nodes = scans.last().map_or(0, |took| took.nodes);
        let first = |took: &&Took| took.nodes <= ENDS_NODES;
        let last = |took: &&Took| took.nodes + ENDS_NODES > nodes;
        self.scan_wall_ms = Spread::of(scans.iter().map(|took| took.wall_ns));
        self.scan_cpu_ms = Spread::of(scans.iter().map(|took| took.cpu_ns));
        self.first_nodes_cpu_ms = Spread::of(scans.iter().filter(first).map(|took| took.cpu_ns));
        self.last_nodes_cpu_ms = Spread::of(scans.iter().filter(last).map(|took| took.cpu_ns));
        self.beside_wall_ms = Spread::of(besides.iter().map(|took| took.wall_ns));
        self.beside_cpu_ms = Spread::of(besides.iter().map(|took| took.cpu_ns));
        let steady = scans.iter().filter(|took| took.nodes > WARM_UP_NODES);
        (self.allocations, self.allocations_scans) =
            steady.fold((0, 0), |(sum, count), took| (sum + took.allocations, count + 1));
    }

    fn count(&mut self, front: &FrontEnd, back: &BackEnd) {
        let (counts, done) = (front.counts(), back.counts());
        (self.scans, self.lost) = (counts.accepted, counts.lost);
        (self.nodes, self.links, self.closures) = (done.nodes, done.links, done.closures);
        (self.retracted, self.unplaced) = (done.retracted, done.unplaced);
        self.evidence = back.reliability_evidence();
    }

    fn score(&mut self, task: &Task, front: &FrontEnd, back: &BackEnd) -> Result<(), String> {
        let poses = slam::trajectory(front, back).map(|(stamp, pose)| (stamp.0 as f64 * 1e-9, pose));
        let estimate = Trajectory::new(poses.collect());
        let (begins_s, cut) = (estimate.begins_s(), task.varied.begins_at > 0.0);
        let odometry = task.odometry.as_deref().map(|path| text(path, Trajectory::parse)).transpose()?;
        let mut relations = text(&task.relations, relations::parse)?;
        relations.retain(|relation| !cut || relation.begins_after(begins_s));
        let errors = |which| relations::errors(&estimate, odometry.as_ref(), &relations, which);
        (self.all, self.revisit) = (errors(Which::All), errors(Which::Revisits));
        self.both_kept = errors(Which::BothKept);
        let placed = |sample: &slam::TrajectorySample| {
            let node = back.node_from_front_end(sample.node).map(|id| &back.nodes()[id as usize]);
            node.is_some_and(|node| node.is_placed())
        };
        let placed: Vec<bool> = front.samples().iter().map(placed).collect();
        relations
            .retain(|relation| relation.ends(&estimate).into_iter().all(|at| placed.get(at) == Some(&true)));
        self.in_map = relations::errors(&estimate, odometry.as_ref(), &relations, Which::All);
        if let Some(path) = &task.trajectory {
            let fail = |why: std::io::Error| format!("{}: {why}", path.display());
            std::fs::write(path, estimate.text()).map_err(fail)?;
        }
        if let Some(path) = &task.truth {
            let truth = text(path, Trajectory::parse)?;
            self.wrong_closures = wrong(back, &truth, EdgeKind::Closure);
            self.wrong_links = wrong(back, &truth, EdgeKind::ScanMatch);
        }
        Ok(())
    }
}

/// How many active edges say something else than the truth.
fn wrong(back: &BackEnd, truth: &Trajectory, kind: EdgeKind) -> usize {
    let at = |id: u32| truth.scan_at(back.nodes()[id as usize].header.stamp.0 as f64 * 1e-9);
    let wrong = |edge: &&slam::Edge| {
        let Some((a, b)) = at(edge.a).zip(at(edge.b)) else { return false };
        let error = a.between(b).between(edge.a_from_b);
        error.x_m.hypot(error.y_m) > WRONG_M || error.yaw_rad.abs() > WRONG_RAD
    };
    back.graph().edges().iter().filter(|edge| edge.is_active && edge.kind == kind).filter(wrong).count()
}

/// Largest log when unpacked, bytes: a safety limit, public logs are below 100 MB.
const LOG_BYTES_MAX: u64 = 1 << 30;

/// A file's bytes, unpacked if they are gzip.
pub fn unpack(path: &Path) -> Result<Vec<u8>, String> {
    let fail = |why: std::io::Error| format!("{}: {why}", path.display());
    let bytes = std::fs::read(path).map_err(fail)?;
    formats::gzip::unpack(bytes, LOG_BYTES_MAX).map_err(fail)
}

fn text<T>(path: &Path, parse: impl Fn(&str) -> Result<T, String>) -> Result<T, String> {
    let text = String::from_utf8(unpack(path)?).map_err(|why| format!("{}: {why}", path.display()))?;
    parse(&text).map_err(|why| format!("{}: {why}", path.display()))
}

/// The kernel's account of the largest resident memory this process ever had.
fn memory_peak_mb() -> Result<f64, String> {
    let status = std::fs::read_to_string("/proc/self/status").map_err(|why| why.to_string())?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:")).ok_or("no VmHWM in status")?;
    let kib: f64 = line.trim().trim_end_matches("kB").trim().parse().map_err(|_| "VmHWM is no number")?;
    Ok(kib * 1024.0 / 1e6)
}

struct Replayed {
    front: FrontEnd,
    back: BackEnd,
    scans: Vec<Took>,
    besides: Vec<Took>,
}

fn replay(log: &[u8], task: &Task, sums: &Arc<StageSums>) -> Result<Replayed, String> {
    let lasers = || {
        Reader::new(log).filter_map(|record| match record {
            Ok(Record::Laser(line)) => Some(line),
            _ => None,
        })
    };
    let varied = task.varied;
    let left_out =
        if varied.begins_at > 0.0 { (varied.begins_at * lasers().count() as f64) as usize } else { 0 };
    let mut maker = Maker::new(varied);
    let mut lines = lasers().skip(left_out).map(|line| maker.make(line));
    let first = lines.next().ok_or_else(|| format!("{}: no scan", task.log.display()))?;
    let mut config = slam_config();
    let on_robot = first.base_from_scan;
    config.lidar.base_from_scan = [on_robot.x_m, on_robot.y_m, on_robot.yaw_rad];
    let (mut front, mut back) = Slam::new(config).split();
    front.observe_stages(Stopwatch::new(sums));
    back.observe_stages(Stopwatch::new(sums));
    let (to_back, nodes) = mpsc::sync_channel::<Node>(WAITING_MAX);
    let (to_front, frame_updates) = mpsc::channel::<MapFrameUpdate>();
    let mut scans = Vec::new();
    let besides = std::thread::scope(|scope| {
        let back = &mut back;
        let beside = scope.spawn(move || work_beside(back, nodes, to_front));
        let mut message = Box::new(Scan::zeroed());
        for (seq, line) in std::iter::once(first).chain(lines).enumerate() {
            line.write_to(&mut message, seq as u64, varied.fov_deg.map(f64::to_radians));
            let (took, result) = scan(&mut front, &line, &message, &frame_updates);
            scans.push(took);
            if let Some(node) = result.node {
                let _ = to_back.send(node);
            }
        }
        drop(to_back);
        beside.join()
    });
    let besides = besides.map_err(|_| "the work beside the scans failed")?;
    Ok(Replayed { front, back, scans, besides })
}

/// All that the live worker does on its scan path.
fn scan(
    front: &mut FrontEnd,
    line: &LaserLine,
    message: &Scan,
    frame_updates: &mpsc::Receiver<MapFrameUpdate>,
) -> (Took, ScanResult) {
    let header = msg::Header { stamp: line.stamp, ..Default::default() };
    let odometry = Odometry { header, odom_from_base: line.odom_from_base, ..Default::default() };
    let mut result = None;
    let (wall, cpu) = (Instant::now(), thread_cpu_ns());
    let counted = measure(|| {
        front.add_odometry(&odometry);
        frame_updates.try_iter().for_each(|frame_update| front.add_frame_update(frame_update));
        result = Some(front.process(message));
    });
    let (wall_ns, cpu_ns) = (wall.elapsed().as_nanos() as u64, thread_cpu_ns() - cpu);
    let result = result.expect("the scan was processed");
    let nodes = result.pose_estimate.nodes;
    (Took { wall_ns, cpu_ns, nodes, allocations: counted.count_total }, result)
}

fn work_beside(
    back: &mut BackEnd,
    nodes: mpsc::Receiver<Node>,
    to_front: mpsc::Sender<MapFrameUpdate>,
) -> Vec<Took> {
    let mut besides = Vec::new();
    let mut timed = |work: &mut dyn FnMut()| {
        let (wall, cpu) = (Instant::now(), thread_cpu_ns());
        work();
        let (wall_ns, cpu_ns) = (wall.elapsed().as_nanos() as u64, thread_cpu_ns() - cpu);
        besides.push(Took { wall_ns, cpu_ns, nodes: 0, allocations: 0 });
    };
    for node in nodes {
        let mut node = Some(node);
        timed(&mut || {
            let frame_update = node.take().map(|node| back.add_node(node));
            // The log may have ended, then nobody listens.
            let _ = frame_update.map(|frame_update| to_front.send(frame_update));
        });
    }
    timed(&mut || back.finish());
    besides
}
