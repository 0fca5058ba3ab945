//! The merged map, in which every robot's map is resampled on one lattice and log-odds are added.

mod fuse;
mod rejected;

pub use rejected::MapRejected;

use crate::config::MergeConfig;
use crate::limits::{RESOLUTION_M, is_plausible};
use crate::resample::ResampleBuffer;
use crate::robot_map::{RobotMap, lattice_tiles};
use fuse::fuse_tile;
use msg::tiles::{MAP_TILES_MAX, TILE, TILE_CELLS};
use msg::{
    DenseMap, Grid, GridHeader, GridView, Header, IndexRect, MapHeader, MapTransform, MapTransforms,
    Monotonic, Pose2, ROBOTS_MAX, RobotId, TileMap,
};
use std::sync::Arc;

/// The fleet's merged map. It recomputes only the tiles that a new map or transform may change.
///
/// ```
/// use merge::{MergeConfig, Merger};
/// use msg::{Grid, GridHeader, Pose2, RobotId};
///
/// // Two robots see the same square metre of floor; the second robot's map begins 1 m to the left.
/// let header = GridHeader { resolution_m: 0.05, width: 20, height: 20, ..Default::default() };
/// let floor = Grid { header, cells: vec![-60; 400] };
/// let starts = [Some(Pose2::IDENTITY), Some(Pose2::new(-1.0, 0.0, 0.0))];
/// let mut merger = Merger::new(&MergeConfig::default(), &starts);
/// for robot in RobotId::first(2) {
///     merger.update_map(robot, floor.view())?;
/// }
/// let merged = merger.merged();
/// assert_eq!((merged.header.width, merged.header.height), (40, 20));
/// assert!(merged.cells.iter().all(|cell| *cell == -60));
/// # Ok::<(), merge::MapRejected>(())
/// ```
pub struct Merger {
    resolution_m: f64,
    /// One element for each robot of the fleet, at [`RobotId::index`].
    robots: Vec<RobotMap>,
    /// Up to date but for the tiles marked in `stale`.
    merged: TileMap,
    /// By index in the merged map's extent.
    stale: Vec<bool>,
    grid: DenseMap,
    buffer: ResampleBuffer,
}

impl Merger {
    /// Creates an empty merged map for a fleet.
    ///
    /// `starts` is frame `map` from frame `robotK/map` for each robot, by [`RobotId::index`]. A robot without a start
    /// is drawn from the moment that [`Merger::set_map_transform`] places it. A configuration that
    /// [`MergeConfig::validate`] rejects is brought into its limits.
    pub fn new(config: &MergeConfig, starts: &[Option<Pose2>]) -> Self {
        let resolution_m = config.plausible_resolution_m();
        let robot = |start: &Option<Pose2>| RobotMap {
            map_from_robot_map: start.filter(|pose| is_plausible(*pose)),
            ..RobotMap::default()
        };
        Self {
            resolution_m,
            robots: starts.iter().take(ROBOTS_MAX).map(robot).collect(),
            merged: TileMap::new(MapHeader { resolution_m, ..Default::default() }),
            stale: Vec::new(),
            grid: DenseMap::default(),
            buffer: ResampleBuffer::default(),
        }
    }

    /// Replaces a robot's map by a whole grid in frame `robotK/map`, of any origin, yaw, size and resolution.
    ///
    /// # Errors
    /// [`MapRejected`] says why the map is not taken.
    pub fn update_map(&mut self, robot: RobotId, map: GridView<'_>) -> Result<(), MapRejected> {
        let GridHeader { width, height, .. } = *map.header;
        let header = header_of(map.header);
        let source = self.check(robot, &header, (width, height), map.cells.len())?;
        if GridView::new(map.header, map.cells).is_none() {
            return Err(MapRejected::malformed(&header, (width, height), map.cells.len()));
        }
        let tiles = source.tiles_of(map).ok_or(MapRejected::too_large(width, height))?;
        self.set_own_map(robot, tiles)
    }

    /// Replaces a robot's map by tiles. Tiles shared with its last map cost nothing.
    ///
    /// # Errors
    /// [`MapRejected`] says why the map is not taken.
    pub fn update_tiles(&mut self, robot: RobotId, map: &TileMap) -> Result<(), MapRejected> {
        let cells = map.extent().area().unwrap_or(0) * TILE_CELLS;
        let side = |tiles: usize| (tiles * TILE as usize) as u32;
        let size = (side(map.extent().width()), side(map.extent().height()));
        self.check(robot, &map.header, size, cells)?;
        self.set_own_map(robot, map.clone())
    }

    /// Applies what the fleet's pose graph estimates for a robot: its map's transform, and its redrawn map if no
    /// single transform aligns all of it.
    ///
    /// While a redrawn map is in use, maps that the robot sends are kept but not drawn. Returns whether anything
    /// changed.
    ///
    /// # Errors
    /// [`MapRejected`] says why the transform or the redrawn map is not taken.
    pub fn apply_fleet_estimate(
        &mut self,
        robot: RobotId,
        map_from_robot_map: Option<Pose2>,
        redrawn: Option<&Arc<Grid>>,
    ) -> Result<bool, MapRejected> {
        let source = self.robot(robot)?;
        let moved = source.map_from_robot_map != map_from_robot_map;
        let same_drawing = match (&source.redrawn, redrawn) {
            (None, None) => true,
            (Some(before), Some(now)) => Arc::ptr_eq(before, now),
            _ => false,
        };
        if moved {
            self.set_map_transform(robot, map_from_robot_map)?;
        }
        if !same_drawing {
            self.set_redrawn_map(robot, redrawn)?;
        }
        Ok(moved || !same_drawing)
    }

    /// Sets frame `map` from frame `robotK/map`; `None` removes the robot's map from the merged map.
    ///
    /// # Errors
    /// [`MapRejected`] says why the transform is not taken.
    pub fn set_map_transform(
        &mut self,
        robot: RobotId,
        map_from_robot_map: Option<Pose2>,
    ) -> Result<(), MapRejected> {
        let source = self.robot(robot)?;
        if let Some(origin) = map_from_robot_map.filter(|pose| !is_plausible(*pose)) {
            return Err(MapRejected::malformed(&MapHeader { origin, ..source.drawn.header }, (0, 0), 0));
        }
        let moved = RobotMap { map_from_robot_map, ..source.clone() };
        let resampler = moved.resampler_for(&moved.drawn.header, self.resolution_m);
        let tiles = lattice_tiles(&moved.drawn, resampler.as_ref());
        self.grow_to(robot, tiles)?;
        let path_tiles = moved.current_path_tiles(self.resolution_m);
        for changed in [moved.tiles, tiles, moved.path_tiles, path_tiles] {
            mark(&mut self.stale, self.merged.extent(), changed);
        }
        if resampler.is_some() {
            self.record_time(&moved.drawn.header);
        }
        self.robots[robot.index()] = RobotMap { resampler, tiles, path_tiles, ..moved };
        Ok(())
    }

    /// Records where a robot's body is: its pose `robotK/map` from `base_footprint`, and its radius.
    ///
    /// Obstacles that other robots see there are the robot itself. The robot's own map shows that too, but only up to
    /// its newest pose-graph node. Returns whether the merged map may have changed; an implausible pose or radius
    /// changes nothing.
    pub fn add_robot_pose(&mut self, robot: RobotId, robot_map_from_base: Pose2, radius_m: f64) -> bool {
        let Some(source) = self.robots.get_mut(robot.index()) else { return false };
        if !source.path.add_pose(robot_map_from_base, radius_m) {
            return false;
        }
        let now = source.current_path_tiles(self.resolution_m);
        let before = core::mem::replace(&mut source.path_tiles, now);
        mark(&mut self.stale, self.merged.extent(), before);
        mark(&mut self.stale, self.merged.extent(), now);
        !now.is_empty()
    }

    /// Removes a robot's map: the robot was reset, or it left. The transform of its map stays known.
    pub fn remove_map(&mut self, robot: RobotId) {
        if let Some(source) = self.robots.get_mut(robot.index()) {
            mark(&mut self.stale, self.merged.extent(), source.tiles);
            mark(&mut self.stale, self.merged.extent(), source.path_tiles);
            *source = RobotMap { map_from_robot_map: source.map_from_robot_map, ..Default::default() };
        }
    }

    /// Recomputes the tiles that may have changed. A tile that comes out equal stays the same [`Arc`].
    pub fn update_stale_tiles(&mut self) {
        let extent = self.merged.extent();
        for ((x, y), stale) in extent.points().zip(&mut self.stale) {
            if std::mem::take(stale) {
                let tile = fuse_tile(x, y, &self.robots, self.resolution_m, &mut self.buffer);
                if tile.as_ref() != self.merged.get(x, y).map(|tile| &**tile) {
                    self.merged.set(x, y, tile.map(Arc::new));
                }
            }
        }
    }

    /// The merged map in frame `map`, up to date; without tiles before the first map.
    ///
    /// Its cells are squares of a lattice that never moves. Stamp and `scan_sent` are those of the newest map in it.
    pub fn merged_tiles(&mut self) -> &TileMap {
        self.update_stale_tiles();
        &self.merged
    }

    /// The known part of the merged map as one grid, up to date; without cells before the first map.
    pub fn merged(&mut self) -> GridView<'_> {
        self.update_stale_tiles();
        self.grid.update(&self.merged)
    }

    /// Returns where each robot's map lies in the merged map.
    pub fn map_transforms(&self) -> MapTransforms {
        let mut transforms = MapTransforms {
            header: Header { stamp: self.merged.header.header.stamp, ..Default::default() },
            ..Default::default()
        };
        for (transform, source) in transforms.robots.iter_mut().zip(&self.robots) {
            if let Some(map_from_robot_map) = source.map_from_robot_map {
                *transform = MapTransform { map_from_robot_map, known: 1, map_frame: 0 };
            }
        }
        transforms
    }

    fn robot(&self, robot: RobotId) -> Result<&RobotMap, MapRejected> {
        let robot_count = self.robots.len();
        self.robots.get(robot.index()).ok_or(MapRejected::UnknownRobot { robot, robot_count })
    }

    fn check(
        &self,
        robot: RobotId,
        header: &MapHeader,
        size: (u32, u32),
        cells: usize,
    ) -> Result<&RobotMap, MapRejected> {
        let source = self.robot(robot)?;
        if !RESOLUTION_M.contains(&header.resolution_m) || !is_plausible(header.origin) {
            return Err(MapRejected::malformed(header, size, cells));
        }
        let (old, new) = (&source.own.header.header, &header.header);
        let same_incarnation = new.incarnation == old.incarnation && source.own.tiles().next().is_some();
        if same_incarnation && new.stamp < old.stamp {
            return Err(MapRejected::Stale { stamp: new.stamp, newest: old.stamp });
        }
        Ok(source)
    }

    /// Keeps a valid map of the robot, and draws it unless a redrawn one is in use.
    fn set_own_map(&mut self, robot: RobotId, map: TileMap) -> Result<(), MapRejected> {
        if self.robots[robot.index()].redrawn.is_none() {
            self.set_drawn_map(robot, map.clone())?;
        }
        self.robots[robot.index()].own = map;
        Ok(())
    }

    fn set_redrawn_map(&mut self, robot: RobotId, redrawn: Option<&Arc<Grid>>) -> Result<(), MapRejected> {
        let source = &self.robots[robot.index()];
        let map = match redrawn {
            None => source.own.clone(),
            Some(grid) => {
                let GridHeader { origin, resolution_m, width, height, .. } = grid.header;
                let valid = GridView::new(&grid.header, &grid.cells).is_some_and(|_| is_plausible(origin));
                if !valid || !RESOLUTION_M.contains(&resolution_m) {
                    let header = header_of(&grid.header);
                    return Err(MapRejected::malformed(&header, (width, height), grid.cells.len()));
                }
                source.tiles_of(grid.view()).ok_or(MapRejected::too_large(width, height))?
            }
        };
        self.set_drawn_map(robot, map)?;
        self.robots[robot.index()].redrawn = redrawn.cloned();
        Ok(())
    }

    /// Draws a valid map from now on, and marks the tiles that it may change.
    fn set_drawn_map(&mut self, robot: RobotId, map: TileMap) -> Result<(), MapRejected> {
        let source = &self.robots[robot.index()];
        let resampler = source.resampler_for(&map.header, self.resolution_m);
        let tiles = lattice_tiles(&map, resampler.as_ref());
        self.grow_to(robot, tiles)?;
        let source = &self.robots[robot.index()];
        match &resampler {
            Some(resampler) if source.resampler.as_ref() == Some(resampler) => {
                let changed = map.changed_since(&source.drawn);
                let changed = changed.filter(|(x, y)| map.get(*x, *y) != source.drawn.get(*x, *y));
                for (x, y) in changed {
                    let tiles = resampler.lattice_cells(IndexRect::cells_of_tile(x, y)).tiles();
                    mark(&mut self.stale, self.merged.extent(), tiles);
                }
            }
            _ => {
                mark(&mut self.stale, self.merged.extent(), source.tiles);
                mark(&mut self.stale, self.merged.extent(), tiles);
            }
        }
        if resampler.is_some() {
            self.record_time(&map.header);
        }
        let source = &mut self.robots[robot.index()];
        (source.drawn, source.resampler, source.tiles) = (map, resampler, tiles);
        Ok(())
    }

    /// Extends the merged map to a robot's tiles. It shrinks only if it would exceed its limit otherwise.
    fn grow_to(&mut self, robot: RobotId, tiles: IndexRect) -> Result<(), MapRejected> {
        let others = self.robots.iter().enumerate().filter(|(index, _)| *index != robot.index());
        let needed = others.fold(tiles, |all, (_, other)| all.union(other.tiles));
        let before = self.merged.extent();
        if !self.merged.grow_to(needed, MAP_TILES_MAX) {
            let mut merged = TileMap::new(self.merged.header);
            if !merged.grow_to(needed, MAP_TILES_MAX) {
                let (width, height) = (needed.width() * TILE as usize, needed.height() * TILE as usize);
                return Err(MapRejected::TooLarge { width, height });
            }
            for (x, y) in needed.points() {
                merged.set(x, y, self.merged.get(x, y).cloned());
            }
            self.merged = merged;
        }
        let extent = self.merged.extent();
        if extent != before {
            let mut stale = vec![false; extent.width() * extent.height()];
            let marked = before.points().zip(&self.stale).filter(|(_, stale)| **stale);
            marked.for_each(|((x, y), _)| mark(&mut stale, extent, IndexRect::single(x, y)));
            self.stale = stale;
        }
        Ok(())
    }

    /// Sets the merged map's time to that of the newest map in it.
    fn record_time(&mut self, newest: &MapHeader) {
        let header = &mut self.merged.header;
        if newest.header.stamp >= header.header.stamp || header.scan_sent == Monotonic::default() {
            header.header.stamp = newest.header.stamp;
            header.scan_sent = newest.scan_sent;
        }
    }
}

fn header_of(grid: &GridHeader) -> MapHeader {
    let GridHeader { header, scan_sent, origin, resolution_m, .. } = *grid;
    MapHeader { header, scan_sent, origin, resolution_m }
}

fn mark(stale: &mut [bool], extent: IndexRect, tiles: IndexRect) {
    for (x, y) in tiles.intersect(extent).points() {
        stale[extent.index(x, y)] = true;
    }
}

#[cfg(test)]
mod tests;
