//! Tool `mr-slam replay --merge`, which maps the logs of several robots and merges them as a live fleet would.
//!
//! Scans are used in the order of their stamps; each robot has its own SLAM. One thread: the same logs give the same maps.

use super::feeder::Feeder;
use super::records::{Log, LogScan, Records};
use super::{ReplayArgs, ReplayError, Summary, starts, trajectory::write_trajectory};
use crate::command::output;
use formats::map_file::{self, write_map_with_reasons};
use merge::{FleetPoseGraph, MergeConfig, Merger, Rejections, SubmapMessage};
use msg::{Grid, MergeEdges, Pose2, RobotId, Stamp, SubmapPoses};
use reports::{EdgeView, edge_table};
use serde::Serialize;
use slam::{BackEnd, FrontEnd, Slam, SlamConfig, Submaps, TrajectoryError};
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::Instant;

/// Number of merging tasks after one node; the others wait for the next.
const TASKS_PER_SCAN: usize = 16;
/// Largest number of merging tasks when all logs have ended.
const LAST_TASKS_MAX: usize = 20_000;

/// Knowledge of the robots' starts.
#[derive(Clone, Debug, PartialEq)]
pub enum Starts {
    /// File with a line for each robot: `index time x y theta`, metres and radians.
    Known(PathBuf),
    /// Nothing is known.
    Unknown,
}

/// Text that does not say what is known of the starts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("expected `unknown`, or `known:FILE` with lines `index time x y theta`")]
pub struct StartsError;

impl FromStr for Starts {
    type Err = StartsError;
    fn from_str(text: &str) -> Result<Self, StartsError> {
        match text.split_once(':') {
            None if text == "unknown" => Ok(Self::Unknown),
            Some(("known", file)) if !file.is_empty() => Ok(Self::Known(file.into())),
            _ => Err(StartsError),
        }
    }
}

/// Figures of a replay of several logs.
#[derive(Debug, Serialize)]
pub struct FleetSummary {
    /// Figures of each log's robot.
    pub robots: Vec<RobotSummary>,
    /// Edges between robots' maps, with their evidence.
    pub edges: Vec<EdgeView>,
    /// Width of the merged map, cells.
    pub map_width: u32,
    /// Height of the merged map, cells.
    pub map_height: u32,
    /// Number of solutions of the fleet's pose graph.
    pub solutions: u64,
    /// Number of times that the graph could not be solved; the estimate then stayed what it was.
    pub failed_solutions: u64,
    /// Duration from reading to the merged map, seconds.
    pub wall_s: f64,
    /// Duration of merging, seconds.
    pub merge_s: f64,
    /// Longest task of the thread that aligns maps, milliseconds.
    pub task_max_ms: f64,
    /// Longest time that merging needed for one message, milliseconds.
    pub update_max_ms: f64,
}

/// Figures of one robot in a replay of several logs.
#[derive(Debug, Serialize)]
pub struct RobotSummary {
    /// Whether its map is part of the merged map.
    pub merged: bool,
    /// Pose of the robot's map in the merged map, at the robot's last place: x m, y m, yaw rad.
    pub map_from_robot_map: Option<[f64; 3]>,
    /// Whether its map was redrawn from its submaps because no rigid transform fits all of it.
    pub redrawn: bool,
    /// Whether the maps contradict its given start. Its place comes from the maps then.
    pub start_contradicted: bool,
    /// Number of submaps.
    pub submaps: usize,
    /// Figures of its own SLAM.
    pub slam: Summary,
}

/// Robot of one log.
struct Robot<'a> {
    id: RobotId,
    records: Records<'a>,
    truth: &'a [(Stamp, Pose2)],
    next: Option<LogScan>,
    front: FrontEnd,
    back: BackEnd,
    submaps: Submaps,
    feeder: Feeder<'a>,
    summary: Summary,
}

/// Replays all logs, writes the requested files and prints the summary.
pub fn run(
    args: &ReplayArgs,
    starts: &Starts,
    config: &SlamConfig,
    merging: &MergeConfig,
) -> Result<(), ReplayError> {
    let began = Instant::now();
    let logs = Log::read_robots(args)?;
    let known = match starts {
        Starts::Known(file) => starts::read(file, logs.len())?,
        Starts::Unknown => vec![None; logs.len()],
    };
    let robots = RobotId::first(logs.len()).zip(&logs);
    let robots = robots
        .map(|(id, (name, log))| Robot::new(id, log, name, args, config))
        .collect::<Result<Vec<_>, _>>()?;
    let mut merged = Merged {
        fleet: FleetPoseGraph::new(merging, &known),
        poses: bytemuck::allocation::zeroed_box(),
        rejections: Rejections::default(),
        merge_s: 0.0,
        task_max_ms: 0.0,
        update_max_ms: 0.0,
    };
    let mut robots = merged.replay(robots);
    merged.rejections.summary().for_each(|line| output::note(&line));
    let map = merged.map(merging, &mut robots);
    if let Some(path) = &args.map {
        let reasons = merged.unreliable_reasons(&robots);
        let reasons: Vec<&str> = reasons.iter().map(String::as_str).collect();
        write_map_with_reasons(&map_file::stem(path), map.view(), &reasons)?;
    }
    if let Some(folder) = &args.trajectory {
        write_trajectories(folder, &robots, &merged.fleet)?;
    }
    let summary = merged.summary(robots, &map, began);
    output::print_either(args.json, &summary, || summary.text())?;
    if summary.robots.iter().filter(|robot| robot.merged).count() < 2 {
        output::note(
            "no two maps were merged: they share too little floor; the result has the first robot's map alone",
        );
    }
    Ok(())
}

impl<'a> Robot<'a> {
    fn new(
        id: RobotId,
        log: &'a Log,
        name: &str,
        args: &ReplayArgs,
        config: &SlamConfig,
    ) -> Result<Self, ReplayError> {
        let mut records = log.records();
        let Some(first) = records.next_laser() else {
            let (skipped, malformed) = (records.skipped(), records.malformed);
            return Err(ReplayError::NoScan { path: name.into(), skipped, malformed });
        };
        let mut config = config.clone();
        let on_robot = first.line.base_from_scan;
        config.lidar.base_from_scan = [on_robot.x_m, on_robot.y_m, on_robot.yaw_rad];
        let (front, back) = Slam::new(config.clone()).split();
        let mut summary = Summary { log: name.into(), ..Summary::default() };
        summary.count_log(log);
        let (submaps, feeder, truth) = (Submaps::new(&config), Feeder::new(args, log), log.truth());
        Ok(Self { id, records, truth, next: Some(first), front, back, submaps, feeder, summary })
    }

    /// Feeds the next scan to SLAM. Returns whether it became a node.
    fn scan(&mut self) -> bool {
        let Some(scan) = self.next.take() else { return false };
        let node = self.feeder.scan(&mut self.front, &scan);
        self.next = self.records.next_laser();
        let made = node.is_some();
        if let Some(node) = node {
            let frame_update = self.back.add_node(node);
            self.front.add_frame_update(frame_update);
            self.submaps.update(&self.back);
        }
        made
    }
}

struct Merged {
    fleet: FleetPoseGraph,
    poses: Box<SubmapPoses>,
    /// Messages that the fleet's pose graph has rejected; a rejected submap is missing in the map.
    rejections: Rejections,
    merge_s: f64,
    task_max_ms: f64,
    update_max_ms: f64,
}

impl Merged {
    /// Feeds all scans in the order of their stamps.
    fn replay<'a>(&mut self, mut robots: Vec<Robot<'a>>) -> Vec<Robot<'a>> {
        let due =
            |robot: &&mut Robot<'a>| robot.next.as_ref().map(|scan| (scan.line.stamp, robot.id.index()));
        while let Some(robot) = robots.iter_mut().filter(|r| r.next.is_some()).min_by_key(due) {
            if robot.scan() {
                self.send(robot);
                self.work(TASKS_PER_SCAN);
            }
        }
        for robot in &mut robots {
            robot.back.finish();
            robot.submaps.finish();
            self.send(robot);
        }
        self.fleet.finish();
        self.work(LAST_TASKS_MAX);
        robots
    }

    /// Sends a robot's new submaps and poses to the fleet's pose graph.
    fn send(&mut self, robot: &mut Robot<'_>) {
        robot.submaps.poses(&robot.back, &mut self.poses);
        let began = Instant::now();
        let mut record = |message, result| {
            if let Some(text) = self.rejections.record(robot.id, message, result) {
                tracing::warn!("merge: {text}");
            }
        };
        record(SubmapMessage::Poses, self.fleet.update_poses(robot.id, &self.poses));
        while let Some(submap) = robot.submaps.next_changed(&robot.back) {
            record(SubmapMessage::Submap, self.fleet.add_submap(robot.id, submap));
        }
        self.note_update(began);
    }

    fn work(&mut self, tasks: usize) {
        for _ in 0..tasks {
            let began = Instant::now();
            let Some(task) = self.fleet.next_task() else { return };
            self.note_update(began);
            let began = Instant::now();
            let outcome = task.run();
            let spent_s = began.elapsed().as_secs_f64();
            self.merge_s += spent_s;
            self.task_max_ms = self.task_max_ms.max(1e3 * spent_s);
            let began = Instant::now();
            self.fleet.apply_result(outcome);
            self.note_update(began);
        }
    }

    fn note_update(&mut self, began: Instant) {
        let spent_s = began.elapsed().as_secs_f64();
        self.merge_s += spent_s;
        self.update_max_ms = self.update_max_ms.max(1e3 * spent_s);
    }

    /// Draws the merged map of every robot that has a place, redrawn where necessary.
    fn map(&self, config: &MergeConfig, robots: &mut [Robot<'_>]) -> Grid {
        let map_transforms: Vec<_> =
            robots.iter().map(|robot| self.fleet.map_from_robot_map(robot.id)).collect();
        let mut merger = Merger::new(config, &map_transforms);
        for robot in robots.iter_mut() {
            // A map that is refused is missing in the merged one, which shows.
            let _ = match self.fleet.redrawn_map(robot.id) {
                Some(map) => merger.update_map(robot.id, map.view()),
                None => merger.update_map(robot.id, robot.back.map()),
            };
        }
        merger.merged().to_owned()
    }

    fn edges(&self) -> MergeEdges {
        let mut edges = MergeEdges::default();
        self.fleet.write_edges(&mut edges);
        edges
    }

    /// Reasons why the merged map is unreliable: those of the robots whose maps are in it, and of pairs that contradict each other.
    fn unreliable_reasons(&self, robots: &[Robot<'_>]) -> Vec<String> {
        let merged = robots.iter().filter(|robot| self.fleet.map_from_robot_map(robot.id).is_some());
        let reasons = merged.flat_map(|robot| {
            robot.back.reliability_evidence().reasons().map(|reason| format!("{}: {reason}", robot.id))
        });
        reasons.chain(telemetry::contradictions(&self.edges())).collect()
    }

    fn summary(&self, robots: Vec<Robot<'_>>, map: &Grid, began: Instant) -> FleetSummary {
        let edges = self.edges();
        let robots = robots.into_iter().map(|mut robot| {
            robot.summary.count(&robot.front, &robot.back);
            let trajectory: Vec<_> = robot.back.trajectory_with_places(robot.front.samples()).collect();
            robot.summary.set_end(trajectory.last());
            robot.summary.error = TrajectoryError::of_placed(&trajectory, robot.truth);
            robot.summary.count_records(&robot.records);
            let place = self.fleet.map_from_robot_map(robot.id);
            RobotSummary {
                merged: place.is_some(),
                map_from_robot_map: place.map(|p| [p.x_m, p.y_m, p.yaw_rad]),
                redrawn: self.fleet.redrawn_map(robot.id).is_some(),
                start_contradicted: self.fleet.is_start_contradicted(robot.id),
                submaps: robot.submaps.len(),
                slam: robot.summary,
            }
        });
        FleetSummary {
            robots: robots.collect(),
            edges: edges.edges().iter().map(EdgeView::new).collect(),
            map_width: map.header.width,
            map_height: map.header.height,
            solutions: self.fleet.solve_count(),
            failed_solutions: self.fleet.failed_solve_count(),
            wall_s: began.elapsed().as_secs_f64(),
            merge_s: self.merge_s,
            task_max_ms: self.task_max_ms,
            update_max_ms: self.update_max_ms,
        }
    }
}

/// Writes a file for each robot, `robotK.tum`, in the merged map's frame if the robot has a place there, otherwise in
/// its own.
fn write_trajectories(
    folder: &Path,
    robots: &[Robot<'_>],
    fleet: &FleetPoseGraph,
) -> Result<(), ReplayError> {
    std::fs::create_dir_all(folder)
        .map_err(|source| ReplayError::Write { path: folder.to_owned(), source })?;
    for robot in robots {
        let path = folder.join(format!("{}.tum", robot.id));
        let poses = robot.back.graph().poses();
        let known = robot.front.samples().iter().filter(|sample| (sample.node as usize) < poses.len());
        let trajectory = known.map(|sample| {
            let in_robot_map = poses[sample.node as usize] * sample.node_from_base;
            (
                sample.stamp,
                map_from_robot_map_at(robot, fleet, sample.node) * in_robot_map,
                robot.back.place_of(sample),
            )
        });
        write_trajectory(&path, trajectory).map_err(|source| ReplayError::Write { path, source })?;
    }
    Ok(())
}

/// Returns the pose of `robotK/map` in `map` at a node.
fn map_from_robot_map_at(robot: &Robot<'_>, fleet: &FleetPoseGraph, node: u32) -> Pose2 {
    let at = |id: u32| fleet.map_from_robot_map_at(robot.id, id);
    let place = robot.submaps.submap_of(node).and_then(|(id, _)| at(id));
    place.or(fleet.map_from_robot_map(robot.id)).unwrap_or(Pose2::IDENTITY)
}

impl FleetSummary {
    /// Formats the summary for a terminal.
    fn text(&self) -> String {
        let mut text = String::new();
        for robot in &self.robots {
            let place = match robot.map_from_robot_map {
                Some([x, y, yaw]) => format!("x {x:.3} m, y {y:.3} m, {:.2} degrees", yaw.to_degrees()),
                None => "not merged".into(),
            };
            let wrong = if robot.start_contradicted { ", its given start contradicts the maps" } else { "" };
            let redrawn_note = if robot.redrawn { ", redrawn" } else { "" };
            let RobotSummary { slam, submaps, .. } = robot;
            text += &format!(
                "{}: {} scans, {submaps} submaps, {place}{redrawn_note}{wrong}\n",
                slam.log, slam.scans
            );
        }
        text += &edge_table(&self.edges);
        for edge in self.edges.iter().filter(|edge| edge.contradicted) {
            text += &format!(
                "the maps of {} and {} contradict each other: one of them is deformed, or lies wrong\n",
                edge.a, edge.b
            );
        }
        text + &format!(
            "merged map {} x {} cells; {:.2} s, merging {:.2} s ({} solutions, {} failed; longest task {:.0} ms, update {:.2} ms)\n",
            self.map_width,
            self.map_height,
            self.wall_s,
            self.merge_s,
            self.solutions,
            self.failed_solutions,
            self.task_max_ms,
            self.update_max_ms
        )
    }
}
