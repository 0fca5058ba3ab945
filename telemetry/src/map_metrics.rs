//! Metrics of the maps, which take long. They are apart from the counting of messages, which must not wait.

use crate::merged::{MergedMap, RoomAccuracy};
use crate::pairs::{PairComparisons, PairMeans, PlacedMap};
use crate::received_map::ReceivedMap;
use crate::truth::ObservableArea;
use msg::{DenseMap, Grid, GridView, MapTransforms, Pose2, ROBOTS_MAX, RobotId, RobotStats, TileMap};

/// What has changed since the metrics were computed last.
#[derive(Clone, Debug, Default)]
pub struct MapChanges {
    /// Newest maps of the robots whose map has changed.
    pub robots: Vec<(RobotId, TileMap)>,
    /// The newest merged map, if it has changed.
    pub merged: Option<TileMap>,
    /// Where each robot's map lies in the fleet's.
    pub map_transforms: MapTransforms,
}

/// Metrics of the maps, as they were computed together.
#[derive(Clone, Debug)]
pub struct MapFigures {
    /// Cell counts of each robot's map, by [`RobotId::index`]; the rest of a row is zero.
    pub(crate) robots: [RobotStats; ROBOTS_MAX],
    /// Cell counts of the merged map; the rest is zero.
    pub(crate) merged_map: RobotStats,
    pub(crate) pairs: PairMeans,
    pub(crate) room_coverage: f64,
    pub(crate) accuracy: RoomAccuracy,
}

impl Default for MapFigures {
    /// No map is known: counts are zero, and all else is NaN.
    fn default() -> Self {
        Self {
            robots: [RobotStats::default(); ROBOTS_MAX],
            merged_map: RobotStats::default(),
            pairs: PairComparisons::new(0).means(),
            room_coverage: f64::NAN,
            accuracy: RoomAccuracy::UNKNOWN,
        }
    }
}

impl MapFigures {
    /// Returns the number of pairs of maps that overlap.
    pub fn pair_count(&self) -> u32 {
        self.pairs.count
    }
}

/// A robot's newest map.
#[derive(Default)]
struct RobotMap {
    dense: DenseMap,
    map: ReceivedMap,
}

/// The newest maps of a fleet, their comparisons with each other, and with the room where that is known.
pub struct MapMetrics {
    robots: Vec<RobotMap>,
    /// Frame `world` from frame `robotK/map`, as far as it is known.
    world_from_robot_map: Vec<Option<Pose2>>,
    room: Option<ObservableArea>,
    merged_dense: DenseMap,
    merged: MergedMap,
    map_transforms: MapTransforms,
    pairs: PairComparisons,
}

impl MapMetrics {
    /// Creates the metrics of a fleet without maps.
    ///
    /// `room_plan` is the room's floor plan in frame `world`, if it is known; [`MapMetrics::set_room`] sets it later.
    /// `world_from_robot_map` is where each robot's map lies in truth, by [`RobotId::index`], if that is known.
    pub fn new(robot_count: usize, room_plan: Option<Grid>, world_from_robot_map: &[Option<Pose2>]) -> Self {
        let robot_count = robot_count.min(ROBOTS_MAX);
        let truth = |index: usize| world_from_robot_map.get(index).copied().flatten();
        let mut metrics = Self {
            robots: (0..robot_count).map(|_| RobotMap::default()).collect(),
            world_from_robot_map: (0..robot_count).map(truth).collect(),
            room: None,
            merged_dense: DenseMap::default(),
            merged: MergedMap::default(),
            map_transforms: MapTransforms::default(),
            pairs: PairComparisons::new(robot_count),
        };
        if let Some(plan) = room_plan {
            metrics.set_room(plan);
        }
        metrics
    }

    /// Sets the room's floor plan in frame `world`. Until then coverage and errors against the room are unknown. A
    /// malformed plan is ignored.
    pub fn set_room(&mut self, plan: Grid) {
        if GridView::new(&plan.header, &plan.cells).is_some() {
            let starts_m = self.world_from_robot_map.iter().flatten().map(|pose| [pose.x_m, pose.y_m]);
            self.room = Some(ObservableArea::new(plan, starts_m));
        }
    }

    /// Replaces a robot's map. A malformed one is ignored, and one of a robot that the fleet does not have.
    pub fn update_map(&mut self, robot: RobotId, map: GridView<'_>) {
        if let Some(robot) = self.robots.get_mut(robot.index()) {
            robot.map.update(map);
        }
    }

    /// Replaces the merged map. A malformed one is ignored.
    pub fn update_merged_map(&mut self, map: GridView<'_>) {
        self.merged.map.update(map);
    }

    /// Replaces the transforms of the robots' maps in the merged map.
    pub fn update_map_transforms(&mut self, map_transforms: &MapTransforms) {
        self.map_transforms = *map_transforms;
    }

    /// Takes what has changed.
    pub fn apply(&mut self, changes: &MapChanges) {
        self.map_transforms = changes.map_transforms;
        for (robot, map) in &changes.robots {
            if let Some(robot) = self.robots.get_mut(robot.index()) {
                robot.map.update(robot.dense.update(map));
            }
        }
        if let Some(map) = &changes.merged {
            self.merged.map.update(self.merged_dense.update(map));
        }
    }

    /// Computes the metrics. It compares a bounded number of cells: many large maps take turns.
    pub fn compute(&mut self) -> MapFigures {
        self.compare_pairs();
        let world_from_map = world_from_map(&self.world_from_robot_map, &self.map_transforms);
        let mut robots = [RobotStats::default(); ROBOTS_MAX];
        for (counts, robot) in robots.iter_mut().zip(&self.robots) {
            *counts = robot.map.counts;
        }
        MapFigures {
            robots,
            merged_map: self.merged.map.counts,
            pairs: self.pairs.means(),
            accuracy: self.merged.accuracy(self.room.as_ref(), world_from_map),
            room_coverage: self.merged.room_coverage(self.room.as_ref(), world_from_map),
        }
    }

    /// Compares the pairs of maps that have changed, and draws one more wrong transform.
    fn compare_pairs(&mut self) {
        let maps = self.robots.iter().enumerate();
        let maps: Vec<_> = maps
            .map(|(index, robot)| PlacedMap {
                grid: &robot.map.grid,
                version: robot.map.version,
                map_from_robot_map: known_transform(&self.map_transforms, index),
            })
            .collect();
        self.pairs.refresh(&maps);
        self.pairs.draw_null(&maps);
    }
}

/// Returns frame `map` from frame `robotK/map`, if it is known.
pub(crate) fn known_transform(map_transforms: &MapTransforms, index: usize) -> Option<Pose2> {
    map_transforms.robots[index].known_pose().filter(|pose| pose.is_finite())
}

/// Returns frame `world` from frame `map`, by the first robot whose map's place is known in both.
pub(crate) fn world_from_map(
    world_from_robot_map: &[Option<Pose2>],
    map_transforms: &MapTransforms,
) -> Option<Pose2> {
    (0..world_from_robot_map.len()).find_map(|index| {
        let transform = known_transform(map_transforms, index)?;
        Some(true_transform(world_from_robot_map, map_transforms, index)? * transform.inverse())
    })
}

/// Returns frame `world` from frame `robotK/map` in truth: only that of the frame in which the robot began is known.
pub(crate) fn true_transform(
    world_from_robot_map: &[Option<Pose2>],
    map_transforms: &MapTransforms,
    index: usize,
) -> Option<Pose2> {
    world_from_robot_map[index].filter(|_| map_transforms.robots[index].map_frame == 0)
}
