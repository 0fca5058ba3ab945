//! Known start poses: every robot's map on one lattice, evidence added.

use crate::align::AlignConfig;
use crate::layer::Layer;
use crate::rect::{Rect, TILE, Tiles};
use crate::source::Source;
use msg::grid::{CELLS_MAX, LOG_ODDS_MAX, UNKNOWN};
use msg::{Anchor, Anchors, GridHeader, GridView, Header, Monotonic, Pose2, ROBOTS_MAX, RobotId, Stamp};
use serde::{Deserialize, Serialize};

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
pub enum Refused {
    /// There is no such robot.
    #[error("{robot} is not of this fleet of {robot_count}: give it a start")]
    Stranger {
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
    /// The merged map would have more than [`CELLS_MAX`] cells.
    #[error(
        "the merged map would be {width} x {height} cells, more than {CELLS_MAX}: is a start pose wrong?"
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
    merged: Layer,
    dirty: Tiles,
    header: GridHeader,
}

impl Merger {
    /// `starts` says where each robot's map lies, `map` from `robotK/map`, by [`RobotId::index`].
    /// A robot without a start is kept, but not drawn until [`Merger::set_anchor`] places it.
    /// A config that [`MergeConfig::check`] refuses is brought into its limits.
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
        let header = GridHeader { resolution_m, ..Default::default() };
        Self { resolution_m, sources, merged: Layer::default(), dirty: Tiles::default(), header }
    }

    /// Takes a robot's newest map, in its own frame `robotK/map`: any origin, yaw, size, resolution.
    pub fn update(&mut self, robot: RobotId, map: GridView<'_>) -> Result<(), Refused> {
        self.check(robot, map)?;
        let source = &self.sources[robot.index()];
        let change = source.compare(map);
        let lookup = source.lookup(map.header, self.resolution_m);
        let window = match &lookup {
            Some(lookup) if change.afresh => lookup.lattice_box(change.known),
            Some(lookup) => source.layer.window.unite(lookup.lattice_box(change.known)),
            None => Rect::default(),
        };
        let extent = self.extent_with(robot, window)?;
        self.reframe(extent);
        let source = &mut self.sources[robot.index()];
        if change.afresh {
            self.dirty.mark(source.layer.window);
            source.layer = Layer::default();
        }
        source.layer.reframe(window);
        source.store(map, &change);
        if let Some(lookup) = lookup {
            let mut tiles = Tiles::none_of(window);
            change.tiles.iter().for_each(|tile| tiles.mark(lookup.lattice_box(*tile)));
            source.layer.redraw(&tiles, &lookup, source.grid.view());
            tiles.marked().for_each(|tile| self.dirty.mark(tile));
            self.note_time(map.header);
        }
        Ok(())
    }

    /// Places a robot's map, moves it, or (`None`) takes it out of the merged map.
    pub fn set_anchor(&mut self, robot: RobotId, map_from_robot_map: Option<Pose2>) -> Result<(), Refused> {
        let robot_count = self.sources.len();
        let source = self.sources.get(robot.index()).ok_or(Refused::Stranger { robot, robot_count })?;
        if let Some(pose) = map_from_robot_map.filter(|pose| !is_near(*pose)) {
            return Err(malformed(
                &GridHeader { origin: pose, ..source.grid.header },
                source.grid.cells.len(),
            ));
        }
        let moved = Source { map_from_robot_map, ..Default::default() };
        let lookup =
            moved.lookup(&source.grid.header, self.resolution_m).filter(|_| !source.grid.cells.is_empty());
        let window = lookup.map_or(Rect::default(), |lookup| lookup.lattice_box(source.known));
        let extent = self.extent_with(robot, window)?;
        self.reframe(extent);
        let source = &mut self.sources[robot.index()];
        self.dirty.mark(source.layer.window);
        self.dirty.mark(window);
        source.map_from_robot_map = map_from_robot_map;
        source.layer = Layer::default();
        source.layer.reframe(window);
        if let Some(lookup) = lookup {
            let mut all = Tiles::none_of(window);
            all.mark(window);
            source.layer.redraw(&all, &lookup, source.grid.view());
            let header = source.grid.header;
            self.note_time(&header);
        }
        Ok(())
    }

    /// Takes a robot's evidence back: it was reset, or it left. Its place stays known.
    pub fn forget(&mut self, robot: RobotId) {
        if let Some(source) = self.sources.get_mut(robot.index()) {
            self.dirty.mark(source.layer.window);
            *source = Source { map_from_robot_map: source.map_from_robot_map, ..Default::default() };
        }
    }

    /// The merged map, frame `map`. Its cells are squares of a lattice that never moves; stamp and
    /// `scan_sent` are those of the newest map in it. Without cells before the first map.
    pub fn merged(&mut self) -> GridView<'_> {
        let layers: Vec<&Layer> = self.sources.iter().map(|source| &source.layer).collect();
        for tile in self.dirty.marked() {
            fuse(&mut self.merged, tile, &layers);
        }
        self.dirty = Tiles::none_of(self.merged.window);
        GridView { header: &self.header, cells: &self.merged.cells }
    }

    /// Where each robot's map lies.
    pub fn anchors(&self) -> Anchors {
        let mut anchors = Anchors {
            header: Header { stamp: self.header.header.stamp, ..Default::default() },
            ..Default::default()
        };
        for (anchor, source) in anchors.robots.iter_mut().zip(&self.sources) {
            if let Some(map_from_robot_map) = source.map_from_robot_map {
                *anchor = Anchor { map_from_robot_map, known: 1, reserved: 0 };
            }
        }
        anchors
    }

    fn check(&self, robot: RobotId, map: GridView<'_>) -> Result<(), Refused> {
        let robot_count = self.sources.len();
        let source = self.sources.get(robot.index()).ok_or(Refused::Stranger { robot, robot_count })?;
        let header = map.header;
        let sound = GridView::new(header, map.cells).is_some()
            && RESOLUTION_M.contains(&header.resolution_m)
            && is_near(header.origin);
        if !sound {
            return Err(malformed(header, map.cells.len()));
        }
        let (stamp, newest) = (header.header.stamp, source.grid.header.header.stamp);
        let same_run = header.header.run == source.grid.header.header.run && !source.grid.cells.is_empty();
        if same_run && stamp < newest { Err(Refused::Stale { stamp, newest }) } else { Ok(()) }
    }

    /// The merged map's window when this robot's layer has `window`. It does not shrink unless the
    /// limit demands it.
    fn extent_with(&self, robot: RobotId, window: Rect) -> Result<Rect, Refused> {
        let others = self.sources.iter().enumerate().filter(|(index, _)| *index != robot.index());
        let needed = others.fold(window, |all, (_, other)| all.unite(other.layer.window));
        let fits = |rect: &Rect| rect.area().is_some_and(|area| area <= CELLS_MAX);
        let too_large = Refused::TooLarge { width: needed.width(), height: needed.height() };
        Some(self.merged.window.unite(needed)).filter(fits).or(Some(needed).filter(fits)).ok_or(too_large)
    }

    fn reframe(&mut self, extent: Rect) {
        if extent == self.merged.window {
            return;
        }
        let mut dirty = Tiles::none_of(extent);
        self.dirty.marked().for_each(|tile| dirty.mark(tile));
        self.dirty = dirty;
        self.merged.reframe(extent);
        let corner = |cell: i64| cell as f64 * self.resolution_m;
        self.header.origin = Pose2::new(corner(extent.x0), corner(extent.y0), 0.0);
        (self.header.width, self.header.height) = (extent.width() as u32, extent.height() as u32);
    }

    fn note_time(&mut self, newest: &GridHeader) {
        if newest.header.stamp >= self.header.header.stamp || self.header.scan_sent == Monotonic::default() {
            self.header.header.stamp = newest.header.stamp;
            self.header.scan_sent = newest.scan_sent;
        }
    }
}

pub(crate) fn is_near(pose: Pose2) -> bool {
    pose.is_finite() && pose.x_m.abs() <= DISTANCE_M_MAX && pose.y_m.abs() <= DISTANCE_M_MAX
}

fn malformed(header: &GridHeader, cells: usize) -> Refused {
    let GridHeader { width, height, resolution_m, origin, .. } = *header;
    Refused::Malformed { width, height, resolution_m, origin, cells }
}

/// Adds the evidence of all layers in one tile. Log-odds of independent observers add up (msg's
/// `grid` says why), so an obstacle that one robot imagined is cleared by those who saw the floor.
fn fuse(merged: &mut Layer, tile: Rect, layers: &[&Layer]) {
    let tile = tile.intersect(merged.window);
    for y in tile.y0..tile.y1 {
        let mut sum = [0_i16; TILE as usize];
        let mut known = [false; TILE as usize];
        for layer in layers {
            let part = tile.intersect(layer.window);
            if part.is_empty() || !(part.y0..part.y1).contains(&y) {
                continue;
            }
            let places = (part.x0 - tile.x0) as usize..(part.x1 - tile.x0) as usize;
            let cells = layer.row(part.x0, part.x1, y);
            for ((sum, known), cell) in sum[places.clone()].iter_mut().zip(&mut known[places]).zip(cells) {
                let is_known = *cell != UNKNOWN;
                *sum += if is_known { i16::from(*cell) } else { 0 };
                *known |= is_known;
            }
        }
        let most = i16::from(LOG_ODDS_MAX);
        for (cell, (sum, known)) in merged.row_mut(tile.x0, tile.x1, y).iter_mut().zip(sum.iter().zip(known))
        {
            *cell = if known { (*sum).clamp(-most, most) as i8 } else { UNKNOWN };
        }
    }
}

const _: () = assert!(ROBOTS_MAX * (LOG_ODDS_MAX as usize) < i16::MAX as usize);

#[cfg(test)]
mod tests;
