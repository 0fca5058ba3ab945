//! The figures and maps of a fleet in lockstep, as the launcher receives them.

use super::queues::{MemoryPorts, Network, QueueMapReader, QueueReader};
use crate::channel::{self, Opener, Program};
use crate::observer::kept_place;
use crate::ports::{ChannelError, Ports, ReadMapPort, ReadPort};
use crate::run::Run;
use msg::{
    DenseMap, FleetStats, GridView, GroundTruth, MapTransforms, MergeEdges, Pose2, PoseEstimate, RobotId,
    Role,
};
use std::rc::Rc;
use telemetry::UnreliableMaps;

/// The fleet's figures and maps, as the launcher and clients receive them.
pub struct Observer {
    stats: QueueReader<FleetStats>,
    /// The newest figures.
    pub newest: Box<FleetStats>,
    /// Every map with its name.
    pub maps: Vec<(String, QueueMapReader, DenseMap)>,
    robots: Vec<LastSeen>,
    transforms: QueueReader<MapTransforms>,
    newest_transforms: Option<Box<MapTransforms>>,
    edges: QueueReader<MergeEdges>,
    newest_edges: Box<MergeEdges>,
    unreliable: UnreliableMaps,
}

/// Newest pose that was received from a robot.
struct LastSeen {
    truths: QueueReader<GroundTruth>,
    pose_estimates: QueueReader<PoseEstimate>,
    world_from_base: Option<Pose2>,
    map_from_odom: Option<Pose2>,
    map_from_base: Option<Pose2>,
}

impl Observer {
    /// Opens the channels that the launcher reads.
    pub fn open(network: &Rc<Network>, run: &Run) -> Result<Self, ChannelError> {
        let ports = MemoryPorts::attach(network, Opener::of_fleet(Program::Launcher));
        let mut maps = Vec::new();
        for robot in run.robots() {
            maps.push((format!("{robot}_map"), ports.map_reader(&channel::map(robot))?, DenseMap::default()));
        }
        maps.push(("merged_map".into(), ports.map_reader(&channel::merged_map())?, DenseMap::default()));
        let last_seen = |robot| {
            Ok(LastSeen {
                truths: ports.reader(&channel::truth(robot))?,
                pose_estimates: ports.reader(&channel::pose_estimate(robot))?,
                world_from_base: None,
                map_from_odom: None,
                map_from_base: None,
            })
        };
        Ok(Self {
            stats: ports.reader(&channel::stats())?,
            newest: Box::default(),
            maps,
            robots: run.robots().map(last_seen).collect::<Result<_, ChannelError>>()?,
            transforms: ports.reader(&channel::map_transforms())?,
            newest_transforms: None,
            edges: ports.reader(&channel::merge_edges())?,
            newest_edges: Box::default(),
            unreliable: UnreliableMaps::default(),
        })
    }

    /// Receives all that has come.
    pub fn poll(&mut self) {
        if let Some(stats) = self.stats.newest() {
            *self.newest = *stats;
        }
        self.maps.iter_mut().for_each(|(_, reader, _)| {
            reader.poll();
        });
        for (id, robot) in RobotId::first(self.robots.len()).zip(&mut self.robots) {
            if let Some(truth) = robot.truths.newest() {
                robot.world_from_base = Some(truth.world_from_base);
            }
            if let Some(pose_estimate) = robot.pose_estimates.newest() {
                robot.map_from_odom = kept_place(&pose_estimate, robot.map_from_odom);
                robot.map_from_base = Some(pose_estimate.map_from_base);
                self.unreliable.record(id, &pose_estimate);
            }
        }
        if let Some(transforms) = self.transforms.newest() {
            self.newest_transforms = Some(Box::new(*transforms));
        }
        if let Some(edges) = self.edges.newest() {
            *self.newest_edges = *edges;
        }
    }

    /// Returns the newest edges between robots' maps.
    pub fn merge_edges(&self) -> &MergeEdges {
        &self.newest_edges
    }

    /// Returns every map received so far, with its name and the reasons why it is unreliable.
    pub fn maps(&mut self) -> impl Iterator<Item = (&str, GridView<'_>, Vec<String>)> {
        let (unreliable, transforms) = (self.unreliable, self.newest_transforms.as_deref());
        let merged = unreliable.reasons_of_merged_map(transforms, &self.newest_edges);
        let robots = RobotId::first(self.robots.len()).map(move |robot| unreliable.reasons_of_robot(robot));
        let seen = self.maps.iter_mut().zip(robots.chain([merged]));
        let seen = seen.filter(|((_, reader, _), _)| reader.map().tiles().next().is_some());
        seen.map(|((name, reader, grid), reasons)| (name.as_str(), grid.update(reader.map()), reasons))
    }

    /// Returns the pose that a restarted process of a robot is given.
    pub fn last_seen(&mut self, role: Role, robot: RobotId) -> Option<Pose2> {
        let seen = &mut self.robots[robot.index()];
        match role {
            Role::Sim => {
                // Its odometry begins where the robot stands.
                seen.map_from_odom = seen.map_from_base;
                seen.world_from_base
            }
            Role::Slam => seen.map_from_odom,
            _ => None,
        }
    }
}
