//! Reader of a fleet's figures and maps, for the live table, `status` and the run's folder.

use crate::channel::{self, Opener, Program};
use crate::clock::now;
use crate::config::RobotSource;
use crate::ports::{ChannelError, ReadMapPort};
use crate::progress::{self, ProgressBoard};
use crate::run::Run;
use crate::shared_memory::{Listener, MapReader, Participant, Reader, wait};
use formats::map_file;
use msg::{
    DenseMap, EdgeState, FleetStats, GroundTruth, MapTransforms, MergeEdges, Monotonic, Pose2, PoseEstimate,
    RobotId, Role, TrackingState, VelocityCommand,
};
use reports::{EdgeView, FleetView};
use std::path::{Path, PathBuf};
use std::time::Duration;
use telemetry::UnreliableMaps;

/// Reads the fleet's figures and maps.
pub struct Observer {
    stats: Reader<FleetStats>,
    edges: Reader<MergeEdges>,
    newest_edges: Box<MergeEdges>,
    stats_listener: Listener,
    newest: Option<Box<FleetStats>>,
    merged_map: MapWatch,
    map_transforms: Reader<MapTransforms>,
    newest_transforms: Option<Box<MapTransforms>>,
    unreliable: UnreliableMaps,
    maps: Vec<MapWatch>,
    robots: Vec<RobotWatch>,
    // The readers' presence in the run; dropped after them.
    _participant: Participant,
}

/// Reader of one map channel.
struct MapWatch {
    name: String,
    reader: MapReader,
}

/// Reader of one robot's poses.
struct RobotWatch {
    truths: Reader<GroundTruth>,
    pose_estimates: Reader<PoseEstimate>,
    commands: Reader<VelocityCommand>,
    command: Option<VelocityCommand>,
    world_from_base: Option<Pose2>,
    map_from_odom: Option<Pose2>,
    map_from_base: Option<Pose2>,
}

impl RobotWatch {
    fn open(participant: &Participant, robot: RobotId) -> Result<Self, ChannelError> {
        let (truths, pose_estimates) = (
            participant.reader(&channel::truth(robot))?,
            participant.reader(&channel::pose_estimate(robot))?,
        );
        Ok(Self {
            truths,
            pose_estimates,
            commands: participant.reader(&channel::command(robot))?,
            command: None,
            world_from_base: None,
            map_from_odom: None,
            map_from_base: None,
        })
    }

    /// Receives all waiting messages; the newest pose estimate says whether the robot's map is `unreliable`.
    fn poll(&mut self, robot: RobotId, unreliable: &mut UnreliableMaps) {
        if let Some(command) = self.commands.newest() {
            self.command = Some(*command);
        }
        if let Some(truth) = self.truths.newest() {
            self.world_from_base = Some(truth.world_from_base);
        }
        if let Some(pose_estimate) = self.pose_estimates.newest() {
            self.map_from_odom = kept_place(&pose_estimate, self.map_from_odom);
            self.map_from_base = Some(pose_estimate.map_from_base);
            unreliable.record(robot, &pose_estimate);
        }
    }
}

/// Returns where `odom` lies in a robot's map, for a SLAM that is started again. A robot that is lost is nowhere: a restarted SLAM
/// would take its last place for true.
pub(crate) fn kept_place(newest: &PoseEstimate, before: Option<Pose2>) -> Option<Pose2> {
    let is_lost = newest.state() == TrackingState::Lost;
    newest.map_from_odom().or(before).filter(|_| !is_lost)
}

impl Observer {
    /// Attaches to a run under the participant name `name`.
    pub fn attach(run: &Run, name: &str) -> Result<Self, ChannelError> {
        let participant = Participant::open(&run.domain, Opener::of_fleet(Program::Launcher), name)?;
        let watch = |name: String, reader| MapWatch { name, reader };
        let robot_map =
            |robot: RobotId| Ok(watch(format!("{robot}_map"), participant.map_reader(&channel::map(robot))?));
        Ok(Self {
            stats: participant.reader(&channel::stats())?,
            stats_listener: participant.listener(&channel::stats())?,
            edges: participant.reader(&channel::merge_edges())?,
            newest_edges: Box::default(),
            newest: None,
            map_transforms: participant.reader(&channel::map_transforms())?,
            newest_transforms: None,
            unreliable: UnreliableMaps::default(),
            merged_map: watch("merged_map".into(), participant.map_reader(&channel::merged_map())?),
            maps: run.robots().map(robot_map).collect::<Result<_, ChannelError>>()?,
            robots: run
                .robots()
                .map(|robot| RobotWatch::open(&participant, robot))
                .collect::<Result<_, _>>()?,
            _participant: participant,
        })
    }

    /// Receives all waiting messages; returns whether there are new figures.
    pub fn poll(&mut self) -> bool {
        for watch in self.maps.iter_mut().chain([&mut self.merged_map]) {
            watch.reader.poll();
        }
        for (robot, watch) in RobotId::first(self.robots.len()).zip(&mut self.robots) {
            watch.poll(robot, &mut self.unreliable);
        }
        if let Some(transforms) = self.map_transforms.newest() {
            self.newest_transforms = Some(Box::new(*transforms));
        }
        let stats = self.stats.newest();
        let new = stats.is_some();
        if let Some(stats) = stats {
            self.newest = Some(Box::new(*stats));
        }
        new
    }

    /// Waits for new figures, at most `patience`, and receives all waiting messages; returns whether there are any.
    pub fn wait(&mut self, patience: Duration) -> bool {
        let until = Monotonic(now().0 + patience.as_nanos() as u64);
        wait([&self.stats_listener], until);
        self.poll()
    }

    /// Newest figures; `None` until the first ones came.
    pub fn stats(&self) -> Option<&FleetStats> {
        self.newest.as_deref()
    }

    /// Newest figures as people and scripts read them, without edges and the bridge's state; `None` until the first ones came.
    pub fn fleet_view(&self, run: &Run) -> Option<FleetView> {
        // Robots' processes on other machines have those machines' process ids.
        let is_elsewhere = run.config.world == RobotSource::Robots;
        let fleet = &run.config.fleet;
        let view = FleetView::new(self.stats()?).without_given_transforms(fleet.starts_known);
        let view = view.with_ended_processes(|pid| is_elsewhere || progress::is_alive(pid));
        let board = ProgressBoard::open(&run.domain, run.progress_slots())
            .and_then(|mut board| board.read().map(|()| board));
        let is_failing = |name: &str| {
            let index = run.config.processes().position(|(row, robot)| row.title(robot) == name);
            board.as_ref().ok().zip(index).is_some_and(|(board, index)| board.is_failing(index))
        };
        Some(view.with_names(&fleet.names).with_failing_processes(is_failing))
    }

    /// Newest velocity that a robot was told, by its index, and its age in seconds.
    pub fn command(&self, robot: usize) -> Option<(VelocityCommand, f64)> {
        let command = self.robots.get(robot)?.command?;
        Some((command, now().since(command.header.sent) as f64 * 1e-9))
    }

    /// Newest transforms of the robots' maps into the merged map.
    pub fn map_transforms(&self) -> Option<&MapTransforms> {
        self.newest_transforms.as_deref()
    }

    /// Calls `show` with the name and the cells of every map that came, robots' maps first.
    pub fn show_maps(&self, mut show: impl FnMut(&str, msg::GridView<'_>)) {
        let seen = self.maps.iter().chain([&self.merged_map]);
        for watch in seen.filter(|watch| watch.reader.map().tiles().next().is_some()) {
            show(&watch.name, DenseMap::default().update(watch.reader.map()));
        }
    }

    /// Newest edges between robots' maps, and contradicted starts.
    pub fn merge_edges(&self) -> &MergeEdges {
        &self.newest_edges
    }

    /// Receives edges and returns those whose state has changed since the last call.
    pub fn changed_edges(&mut self) -> Vec<EdgeView> {
        let Some(edges) = self.edges.newest() else { return Vec::new() };
        let before = self.newest_edges.edges();
        // The list has those that have a state: an edge that is new moves all after it.
        let state_before = |id: u32| {
            before.iter().find(|before| before.id == id).map_or(EdgeState::None, |before| before.state())
        };
        let changed = edges.edges().iter().filter(|edge| state_before(edge.id) != edge.state());
        let changed_edges = changed.map(EdgeView::new).collect();
        *self.newest_edges = *edges;
        changed_edges
    }

    /// Returns the pose with which a robot's process is restarted: of the robot in `world` for a simulator, of `odom`
    /// in `robotK/map` for SLAM.
    pub fn last_seen(&mut self, role: Role, robot: RobotId) -> Option<Pose2> {
        let watch = self.robots.get_mut(robot.index())?;
        match role {
            Role::Sim => {
                // The new simulator's odometry begins where the robot stands.
                watch.map_from_odom = watch.map_from_base;
                watch.world_from_base
            }
            Role::Slam => watch.map_from_odom,
            _ => None,
        }
    }

    /// Writes every map that came as PGM with YAML and as PNG, with the reasons why it is unreliable. Returns the paths
    /// without extension, and the errors of those that could not be written.
    pub fn write_maps(&self, dir: &Path) -> (Vec<PathBuf>, Vec<map_file::MapFileError>) {
        let robots = RobotId::first(self.maps.len()).map(|robot| self.unreliable.reasons_of_robot(robot));
        let merged = self.unreliable.reasons_of_merged_map(self.map_transforms(), &self.newest_edges);
        let seen = self.maps.iter().zip(robots).chain([(&self.merged_map, merged)]);
        let seen = seen.filter(|(watch, _)| watch.reader.map().tiles().next().is_some());
        let (mut written, mut errors) = (Vec::new(), Vec::new());
        for (watch, reasons) in seen {
            let stem = dir.join(&watch.name);
            let reasons: Vec<&str> = reasons.iter().map(String::as_str).collect();
            match map_file::write_map_with_reasons(
                &stem,
                DenseMap::default().update(watch.reader.map()),
                &reasons,
            ) {
                Ok(()) => written.push(stem),
                Err(why) => errors.push(why),
            }
        }
        (written, errors)
    }
}
