//! Known start poses: every robot's map on one lattice, evidence added.

use crate::align::AlignConfig;
use crate::lookup::Bench;
use crate::source::{Source, reach};
use msg::grid::{LOG_ODDS_MAX, MAP_CELLS_MAX, SWEPT_FREE, UNKNOWN};
use msg::tiles::{MAP_TILES_MAX, TILE, TILE_CELLS};
use msg::{
    DenseMap, Grid, GridHeader, GridView, Header, MapHeader, MapTile, MapTransform, MapTransforms, Monotonic,
    Pose2, ROBOTS_MAX, Rect, RobotId, Stamp, TileMap,
};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Sides of a cell that make sense, metres.
pub(crate) const RESOLUTION_M: core::ops::RangeInclusive<f64> = 0.005..=1.0;
/// The farthest that a map may lie from the origin of `map`, metres.
const DISTANCE_M_MAX: f64 = 100_000.0;

/// How maps are merged.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MergeConfig {
    /// Side of a cell of the merged map, metres, 0.005 to 1. Best that of the robots' maps.
    pub resolution_m: f64,
    /// When to believe where a robot's map lies that started anywhere.
    pub align: AlignConfig,
}

impl Default for MergeConfig {
    fn default() -> Self {
        Self { resolution_m: 0.05, align: AlignConfig::default() }
    }
}

impl MergeConfig {
    /// What is wrong with it, if anything.
    pub fn validate(&self) -> Result<(), String> {
        if RESOLUTION_M.contains(&self.resolution_m) {
            return self.align.validate();
        }
        Err(format!("merge.resolution_m is {}; expected 0.005 to 1 metre a cell", self.resolution_m))
    }
}

/// Why a map was not taken. The robot's last good map stays in force.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum MapRejected {
    /// There is no such robot.
    #[error("{robot} is not of this fleet of {robot_count}: give it a start")]
    UnknownRobot {
        /// Who.
        robot: RobotId,
        /// How many starts there are.
        robot_count: usize,
    },
    /// Size, resolution or origin is not usable.
    #[error(
        "a grid of {width} x {height} cells of {resolution_m} m with {cells} cells and origin {origin:?} makes no \
         sense: expected finite numbers within 100 km, 0.005 to 1 m a cell, and as many cells as the size says"
    )]
    Malformed {
        /// As the header says.
        width: u32,
        /// As the header says.
        height: u32,
        /// As the header says.
        resolution_m: f64,
        /// As the header says.
        origin: Pose2,
        /// As there are.
        cells: usize,
    },
    /// An older map than the one in force.
    #[error("a map of {stamp:?} came after one of {newest:?}")]
    Stale {
        /// Of the refused map.
        stamp: Stamp,
        /// Of the map in force.
        newest: Stamp,
    },
    /// The merged map would have more than [`MAP_CELLS_MAX`] cells.
    #[error(
        "the merged map would be {width} x {height} cells, more than {MAP_CELLS_MAX}: is a start pose wrong?"
    )]
    TooLarge {
        /// Cells along x.
        width: usize,
        /// Cells along y.
        height: usize,
    },
}

/// The fleet's map.
pub struct Merger {
    resolution_m: f64,
    sources: Vec<Source>,
    /// The merged map, up to date but for `dirty`.
    merged: TileMap,
    /// By their place in the merged map's extent.
    dirty: Vec<bool>,
    grid: DenseMap,
    bench: Bench,
}

impl Merger {
    /// `starts` says where each robot's map lies, `map` from `robotK/map`, by [`RobotId::index`].
    /// A robot without a start is kept, but not drawn until [`Merger::set_map_transform`] places it.
    /// A config that [`MergeConfig::validate`] refuses is brought into its limits.
    pub fn new(config: &MergeConfig, starts: &[Option<Pose2>]) -> Self {
        let [least, most] = [*RESOLUTION_M.start(), *RESOLUTION_M.end()];
        let resolution_m = if RESOLUTION_M.contains(&config.resolution_m) {
            config.resolution_m
        } else {
            least.max(config.resolution_m.min(most))
        };
        let place = |start: &Option<Pose2>| start.filter(|pose| is_near(*pose));
        let sources = starts.iter().take(ROBOTS_MAX);
        let sources =
            sources.map(|start| Source { map_from_robot_map: place(start), ..Default::default() }).collect();
        let merged = TileMap::new(MapHeader { resolution_m, ..Default::default() });
        let (dirty, grid, bench) = (Vec::new(), DenseMap::default(), Bench::default());
        Self { resolution_m, sources, merged, dirty, grid, bench }
    }

    /// Takes a robot's newest map, in its own frame `robotK/map`: any origin, yaw, size, resolution.
    pub fn update_map(&mut self, robot: RobotId, map: GridView<'_>) -> Result<(), MapRejected> {
        let GridHeader { header, scan_sent, origin, resolution_m, width, height } = *map.header;
        let about = MapHeader { header, scan_sent, origin, resolution_m };
        let source = self.check(robot, &about, (width, height), map.cells.len())?;
        if GridView::new(map.header, map.cells).is_none() {
            return Err(malformed(&about, (width, height), map.cells.len()));
        }
        let too_large = MapRejected::TooLarge { width: width as usize, height: height as usize };
        let tiles = source.tiles_of(map).ok_or(too_large)?;
        self.take_own(robot, tiles)
    }

    /// The same as tiles, of which those shared with the robot's last map are not even looked at.
    pub fn update_tiles(&mut self, robot: RobotId, map: &TileMap) -> Result<(), MapRejected> {
        let cells = map.extent().area().unwrap_or(0) * TILE_CELLS;
        let side = |tiles: usize| (tiles * TILE as usize) as u32;
        let size = (side(map.extent().width()), side(map.extent().height()));
        self.check(robot, &map.header, size, cells)?;
        self.take_own(robot, map.clone())
    }

    /// Takes over what the fleet's graph has found out about a robot: where its map lies, and what it looks like where
    /// no place alone puts all of it right. While it is redrawn, what the robot itself sends is kept, but not drawn.
    /// What is as before costs nothing. Whether anything was not.
    pub fn apply_fleet_estimate(
        &mut self,
        robot: RobotId,
        map_from_robot_map: Option<Pose2>,
        redrawn: Option<&Arc<Grid>>,
    ) -> Result<bool, MapRejected> {
        let robot_count = self.sources.len();
        let source =
            self.sources.get(robot.index()).ok_or(MapRejected::UnknownRobot { robot, robot_count })?;
        let moved = source.map_from_robot_map != map_from_robot_map;
        let same = match (&source.redrawn, redrawn) {
            (None, None) => true,
            (Some(before), Some(now)) => Arc::ptr_eq(before, now),
            _ => false,
        };
        if moved {
            self.set_map_transform(robot, map_from_robot_map)?;
        }
        if !same {
            self.redraw(robot, redrawn)?;
        }
        Ok(moved || !same)
    }

    fn redraw(&mut self, robot: RobotId, redrawn: Option<&Arc<Grid>>) -> Result<(), MapRejected> {
        let source = &self.sources[robot.index()];
        let map = match redrawn {
            None => source.own.clone(),
            Some(grid) => {
                let GridHeader { header, scan_sent, origin, resolution_m, width, height } = grid.header;
                let about = MapHeader { header, scan_sent, origin, resolution_m };
                let sound = GridView::new(&grid.header, &grid.cells).is_some_and(|_| is_near(origin));
                if !sound || !RESOLUTION_M.contains(&resolution_m) {
                    return Err(malformed(&about, (width, height), grid.cells.len()));
                }
                let too_large = MapRejected::TooLarge { width: width as usize, height: height as usize };
                source.tiles_of(grid.view()).ok_or(too_large)?
            }
        };
        self.take(robot, map)?;
        self.sources[robot.index()].redrawn = redrawn.cloned();
        Ok(())
    }

    /// Takes a robot's own map that has been checked.
    fn take_own(&mut self, robot: RobotId, map: TileMap) -> Result<(), MapRejected> {
        if self.sources[robot.index()].redrawn.is_none() {
            self.take(robot, map.clone())?;
        }
        self.sources[robot.index()].own = map;
        Ok(())
    }

    /// Draws a map that has been checked from now on.
    fn take(&mut self, robot: RobotId, map: TileMap) -> Result<(), MapRejected> {
        let source = &self.sources[robot.index()];
        let lookup = source.lookup_of(&map.header, self.resolution_m);
        let reach = reach(&map, lookup.as_ref());
        self.make_room(robot, reach)?;
        let source = &self.sources[robot.index()];
        match &lookup {
            Some(lookup) if source.lookup.as_ref() == Some(lookup) => {
                let changed = map.changed_since(&source.map);
                let changed = changed.filter(|(x, y)| map.get(*x, *y) != source.map.get(*x, *y));
                for (x, y) in changed {
                    let tiles = lookup.lattice_box(Rect::cells_of_tile(x, y)).tiles();
                    mark(&mut self.dirty, self.merged.extent(), tiles);
                }
            }
            _ => {
                mark(&mut self.dirty, self.merged.extent(), source.reach);
                mark(&mut self.dirty, self.merged.extent(), reach);
            }
        }
        if lookup.is_some() {
            self.note_time(&map.header);
        }
        let source = &mut self.sources[robot.index()];
        (source.map, source.lookup, source.reach) = (map, lookup, reach);
        Ok(())
    }

    /// Places a robot's map, moves it, or (`None`) takes it out of the merged map.
    pub fn set_map_transform(
        &mut self,
        robot: RobotId,
        map_from_robot_map: Option<Pose2>,
    ) -> Result<(), MapRejected> {
        let robot_count = self.sources.len();
        let source =
            self.sources.get(robot.index()).ok_or(MapRejected::UnknownRobot { robot, robot_count })?;
        if let Some(origin) = map_from_robot_map.filter(|pose| !is_near(*pose)) {
            return Err(malformed(&MapHeader { origin, ..source.map.header }, (0, 0), 0));
        }
        let moved = Source { map_from_robot_map, ..source.clone() };
        let lookup = moved.lookup_of(&moved.map.header, self.resolution_m);
        let reach = reach(&moved.map, lookup.as_ref());
        self.make_room(robot, reach)?;
        let body = moved.body_tiles(self.resolution_m);
        for tiles in [moved.reach, reach, moved.body, body] {
            mark(&mut self.dirty, self.merged.extent(), tiles);
        }
        if lookup.is_some() {
            self.note_time(&moved.map.header);
        }
        self.sources[robot.index()] = Source { lookup, reach, body, ..moved };
        Ok(())
    }

    /// Takes where a robot is now, `robotK/map` from `base_footprint`, and how far its body reaches around that: what
    /// its peers see there is the robot. Its own map says so too, but only from its newest node back. Whether the
    /// merged map may be another.
    pub fn set_robot_footprint(&mut self, robot: RobotId, robot_map_from_base: Pose2, radius_m: f64) -> bool {
        let Some(source) = self.sources.get_mut(robot.index()) else { return false };
        if !source.trail.note(robot_map_from_base, radius_m) {
            return false;
        }
        let now = source.body_tiles(self.resolution_m);
        let before = core::mem::replace(&mut source.body, now);
        mark(&mut self.dirty, self.merged.extent(), before);
        mark(&mut self.dirty, self.merged.extent(), now);
        !now.is_empty()
    }

    /// Takes a robot's evidence back: it was reset, or it left. Its place stays known.
    pub fn remove_map(&mut self, robot: RobotId) {
        if let Some(source) = self.sources.get_mut(robot.index()) {
            mark(&mut self.dirty, self.merged.extent(), source.reach);
            mark(&mut self.dirty, self.merged.extent(), source.body);
            *source = Source { map_from_robot_map: source.map_from_robot_map, ..Default::default() };
        }
    }

    /// Composes the tiles that may have changed; those that did not stay the same tiles.
    pub fn compose(&mut self) {
        let extent = self.merged.extent();
        for ((x, y), dirty) in extent.points().zip(&mut self.dirty) {
            if std::mem::take(dirty) {
                let tile = fuse(x, y, &self.sources, self.resolution_m, &mut self.bench);
                if tile.as_ref() != self.merged.get(x, y).map(|tile| &**tile) {
                    self.merged.set(x, y, tile.map(Arc::new));
                }
            }
        }
    }

    /// The merged map, frame `map`. Its cells are squares of a lattice that never moves; stamp and
    /// `scan_sent` are those of the newest map in it. Without tiles before the first map.
    pub fn merged_tiles(&mut self) -> &TileMap {
        self.compose();
        &self.merged
    }

    /// The same as one grid of what is known; without cells before the first map.
    pub fn merged(&mut self) -> GridView<'_> {
        self.compose();
        self.grid.update(&self.merged)
    }

    /// Where each robot's map lies.
    pub fn map_transforms(&self) -> MapTransforms {
        let mut anchors = MapTransforms {
            header: Header { stamp: self.merged.header.header.stamp, ..Default::default() },
            ..Default::default()
        };
        for (anchor, source) in anchors.robots.iter_mut().zip(&self.sources) {
            if let Some(map_from_robot_map) = source.map_from_robot_map {
                *anchor = MapTransform { map_from_robot_map, known: 1, reserved: 0 };
            }
        }
        anchors
    }

    fn check(
        &self,
        robot: RobotId,
        header: &MapHeader,
        size: (u32, u32),
        cells: usize,
    ) -> Result<&Source, MapRejected> {
        let robot_count = self.sources.len();
        let source =
            self.sources.get(robot.index()).ok_or(MapRejected::UnknownRobot { robot, robot_count })?;
        if !RESOLUTION_M.contains(&header.resolution_m) || !is_near(header.origin) {
            return Err(malformed(header, size, cells));
        }
        let (old, new) = (&source.own.header.header, &header.header);
        let same_run = new.incarnation == old.incarnation && source.own.tiles().next().is_some();
        if same_run && new.stamp < old.stamp {
            return Err(MapRejected::Stale { stamp: new.stamp, newest: old.stamp });
        }
        Ok(source)
    }

    /// Makes room in the merged map for a robot's map that reaches these tiles. It does not shrink
    /// unless the limit demands it.
    fn make_room(&mut self, robot: RobotId, reach: Rect) -> Result<(), MapRejected> {
        let others = self.sources.iter().enumerate().filter(|(index, _)| *index != robot.index());
        let needed = others.fold(reach, |all, (_, other)| all.union(other.reach));
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
            let mut dirty = vec![false; extent.width() * extent.height()];
            let marked = before.points().zip(&self.dirty).filter(|(_, dirty)| **dirty);
            marked.for_each(|((x, y), _)| mark(&mut dirty, extent, Rect::single(x, y)));
            self.dirty = dirty;
        }
        Ok(())
    }

    fn note_time(&mut self, newest: &MapHeader) {
        let header = &mut self.merged.header;
        if newest.header.stamp >= header.header.stamp || header.scan_sent == Monotonic::default() {
            header.header.stamp = newest.header.stamp;
            header.scan_sent = newest.scan_sent;
        }
    }
}

fn mark(dirty: &mut [bool], extent: Rect, tiles: Rect) {
    for (x, y) in tiles.intersect(extent).points() {
        dirty[extent.index(x, y)] = true;
    }
}

pub(crate) fn is_near(pose: Pose2) -> bool {
    pose.is_finite() && pose.x_m.abs() <= DISTANCE_M_MAX && pose.y_m.abs() <= DISTANCE_M_MAX
}

fn malformed(header: &MapHeader, (width, height): (u32, u32), cells: usize) -> MapRejected {
    let MapHeader { resolution_m, origin, .. } = *header;
    MapRejected::Malformed { width, height, resolution_m, origin, cells }
}

/// Adds the evidence of all robots in one tile; `None` if there is none. Log-odds of independent
/// observers add up (msg's `grid` says why), so an obstacle that one robot imagined is cleared by
/// those who saw the floor. Where a robot has driven there is floor, whatever all others took it for.
fn fuse(x: i64, y: i64, sources: &[Source], resolution_m: f64, bench: &mut Bench) -> Option<MapTile> {
    let mut sums = [0_i16; TILE_CELLS];
    let mut least = [RANK_UNKNOWN; TILE_CELLS];
    let mut any = false;
    for source in sources.iter().filter(|source| source.reach.contains(Rect::single(x, y))) {
        let found = source.lookup.as_ref().is_some_and(|lookup| lookup.find(x, y, &source.map, bench));
        if found {
            any = true;
            for ((sum, least), cell) in sums.iter_mut().zip(&mut least).zip(bench.found.iter()) {
                *sum += i16::from(*cell & -i8::from(*cell != UNKNOWN));
                *least = (*least).min(rank(*cell));
            }
        }
    }
    if !any || least.iter().all(|least| *least == RANK_UNKNOWN) {
        return None;
    }
    let most = i16::from(LOG_ODDS_MAX);
    let mut tile = MapTile::unknown(x, y);
    for ((cell, sum), least) in tile.cells.iter_mut().zip(&sums).zip(&least) {
        let sum = (*sum).clamp(-most, most) as i8;
        let (known, driven) = (-i8::from(*least != RANK_UNKNOWN), -i8::from(*least == rank(SWEPT_FREE)));
        *cell = (((sum & !driven) | (SWEPT_FREE & driven)) & known) | (UNKNOWN & !known);
    }
    for source in sources.iter().filter(|source| source.body.contains(Rect::single(x, y))) {
        source.clear(resolution_m, &mut tile);
    }
    Some(tile)
}

/// A cell's place in the order of what is certain to be free, that first and what nobody knows last: the least of several
/// says both, at the price of one.
const fn rank(cell: i8) -> u8 {
    cell.wrapping_sub(SWEPT_FREE) as u8
}
const RANK_UNKNOWN: u8 = rank(UNKNOWN);
const _: () = assert!(rank(SWEPT_FREE) == 0 && RANK_UNKNOWN == u8::MAX);
const _: () = assert!(ROBOTS_MAX * (LOG_ODDS_MAX as usize) < i16::MAX as usize);

#[cfg(test)]
mod peers;
#[cfg(test)]
mod tests;
