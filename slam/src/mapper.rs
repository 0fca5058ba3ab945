//! Occupancy grid mapping: draws every node's beams and the robot's swept path into a tiled grid.
//!
//! - Beams are traced cell by cell (Bresenham 1965). They add log-odds where they end and subtract some where they
//!   pass (Thrun, Burgard, Fox, "Probabilistic Robotics", 2005, table 9.1).
//! - Cells that the robot's body swept since the node before are floor (`msg::grid::SWEPT_FREE`), until the robot
//!   sees something there.
//! - Log-odds are clamped, so a node cannot be subtracted again. When nodes have moved, a new version of the tiles
//!   they touched and now touch is drawn from all nodes in their order: the same as a map drawn from nothing.
//! - The new version is built in slices, beside the map that is shown, and replaces its tiles when it is complete.
//!   New nodes are drawn into the shown map meanwhile.

mod raster;
mod tile_set;

use crate::config::MapConfig;
use crate::node::Node;
use msg::tiles::ROBOT_TILES_MAX;
use msg::{DenseMap, GridView, Header, IndexRect, MapHeader, Monotonic, Pose2, TileMap, pose::wrap_angle};
use raster::{NodeCells, UpdateTables};
use tile_set::TileSet;

/// Least cost of a node in a slice, in cells: looking at it takes time even if nothing is drawn.
const NODE_CELLS: usize = 64;
/// Rounding of a point's position in single precision, as a share of its distance from the origin.
const ROUNDING: f64 = 1e-6;
/// Distance from a node at which its turn counts as a shift, metres: a usual range of a beam.
pub(crate) const TURN_ARM_M: f64 = 5.0;
/// Largest cell coordinate: far beyond any map, and exact as a float.
const CELL_MAX: f64 = 1e15;

/// Draws the occupancy grid of a robot's nodes, and draws tiles again whose nodes moved.
pub struct OccupancyMapper {
    config: MapConfig,
    map: TileMap,
    /// How each node was drawn, by node id.
    drawn: Vec<DrawnNode>,
    redraw: Option<Redraw>,
    /// Nodes that did not fit into the largest map.
    nodes_not_drawn: u64,
    grid: DenseMap,
    cells: NodeCells,
    updates: UpdateTables,
}

/// Pose and extent with which a node is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
struct DrawnNode {
    map_from_base: Pose2,
    /// Bounding box of its beams and swept path in `base_footprint`: low x, low y, high x, high y, metres. Empty (low
    /// above high) if it has nothing to draw.
    bounds_m: [f32; 4],
    /// Tiles that contain all its cells; empty if it is not drawn.
    tiles: IndexRect,
}

/// A new version of some tiles, while it is drawn.
struct Redraw {
    /// The new version, as far as it has been drawn.
    map: TileMap,
    /// Tiles that the new version replaces.
    tiles: TileSet,
    /// Pose and extent of every node in the new version, by node id.
    drawn: Vec<DrawnNode>,
    /// Id of the next node to be drawn.
    next: usize,
}

impl OccupancyMapper {
    /// A mapper with an empty map.
    pub fn new(config: MapConfig) -> Self {
        let map = TileMap::new(MapHeader { resolution_m: config.resolution_m, ..Default::default() });
        Self {
            updates: UpdateTables::new(&config),
            config,
            map,
            drawn: Vec::new(),
            redraw: None,
            nodes_not_drawn: 0,
            grid: DenseMap::default(),
            cells: NodeCells::default(),
        }
    }

    /// Number of nodes that are not drawn because the map would have become too large.
    pub fn nodes_not_drawn(&self) -> u64 {
        self.nodes_not_drawn
    }

    /// Pose with which each node was drawn; with the nodes it determines the map.
    pub fn drawn(&self) -> Vec<Pose2> {
        self.drawn.iter().map(|node| node.map_from_base).collect()
    }

    /// Replaces the map by one of these nodes at the poses of [`OccupancyMapper::drawn`]: the same map as then.
    pub fn restore(&mut self, nodes: &[Node], drawn: &[Pose2]) {
        self.map = TileMap::new(MapHeader { resolution_m: self.config.resolution_m, ..Default::default() });
        self.drawn.clear();
        self.redraw = None;
        self.nodes_not_drawn = 0;
        for (node, pose) in nodes.iter().zip(drawn) {
            self.add(node, *pose);
        }
    }

    /// Sets the map's header and sending time to those of a scan, until the next node is drawn.
    pub fn set_header(&mut self, header: Header, scan_sent: Monotonic) {
        (self.map.header.header, self.map.header.scan_sent) = (header, scan_sent);
    }

    /// The map as drawn so far; a new version shows only when it is complete.
    pub fn tiles(&self) -> &TileMap {
        &self.map
    }

    /// Draws about `cells_max` cells, and one node at least: new nodes first, then nodes that moved by more than
    /// `map.redraw_m`. Returns whether there is more to do.
    pub fn work(&mut self, nodes: &[Node], poses: &[Pose2], cells_max: usize) -> bool {
        self.slice(nodes, poses, cells_max, self.config.redraw_m)
    }

    /// Draws all nodes at exactly these poses and returns the map as one grid. The result depends on nodes and poses
    /// alone.
    pub fn finish(&mut self, nodes: &[Node], poses: &[Pose2]) -> GridView<'_> {
        while self.slice(nodes, poses, usize::MAX, 0.0) {}
        self.grid.update(&self.map)
    }

    /// Draws one slice of new nodes and of a new version; see [`OccupancyMapper::work`].
    fn slice(&mut self, nodes: &[Node], poses: &[Pose2], cells_max: usize, tolerance_m: f64) -> bool {
        let mut left = cells_max;
        for (node, pose) in nodes.iter().zip(poses).skip(self.drawn.len()) {
            if left == 0 {
                return true;
            }
            left = left.saturating_sub(self.add(node, *pose));
        }
        if self.redraw.is_none() {
            self.redraw = self.plan_redraw(nodes, poses, tolerance_m);
        }
        let Some(redraw) = &mut self.redraw else { return false };
        // The new version draws nodes that were added meanwhile as the shown map did.
        redraw.drawn.extend_from_slice(&self.drawn[redraw.drawn.len()..]);
        while let Some(drawn) = redraw.drawn.get(redraw.next) {
            if left == 0 {
                return true;
            }
            let mut cost = NODE_CELLS;
            if redraw.tiles.intersects(drawn.tiles) {
                redraw.map.grow_to(drawn.tiles, ROBOT_TILES_MAX);
                let (tiles, node) = (&redraw.tiles, &nodes[redraw.next]);
                let open = redraw.map.open(drawn.tiles, |x, y| tiles.contains(x, y));
                cost += self.cells.fill(node, drawn.map_from_base, &self.config).draw(open, &self.updates);
            }
            redraw.next += 1;
            left = left.saturating_sub(cost);
        }
        self.show_redraw();
        true
    }

    /// Draws a new node. Returns its cost in cells.
    fn add(&mut self, node: &Node, map_from_base: Pose2) -> usize {
        self.map.header.header = node.header;
        self.map.header.scan_sent = node.header.sent;
        let bounds_m = if node.in_map() { bounds_m(node, &self.config) } else { EMPTY };
        let mut drawn = DrawnNode { map_from_base, bounds_m, tiles: IndexRect::default() };
        let tiles = tiles_of(&drawn, self.config.resolution_m);
        if !tiles.is_empty() && !self.map.grow_to(tiles, ROBOT_TILES_MAX) {
            self.nodes_not_drawn += 1;
        } else {
            drawn.tiles = tiles;
        }
        self.drawn.push(drawn);
        if drawn.tiles.is_empty() {
            return NODE_CELLS;
        }
        let open = self.map.open(tiles, |_, _| true);
        NODE_CELLS + self.cells.fill(node, map_from_base, &self.config).draw(open, &self.updates)
    }

    /// Plans a new version of the tiles that moved nodes touched and will touch; `None` if no node moved.
    fn plan_redraw(&self, nodes: &[Node], poses: &[Pose2], tolerance_m: f64) -> Option<Redraw> {
        let moved = |was: &DrawnNode, is: &Pose2| {
            let turned = wrap_angle(was.map_from_base.yaw_rad - is.yaw_rad).abs();
            let moved = was.map_from_base.distance_m(*is);
            was.bounds_m != EMPTY && (moved > tolerance_m || turned * TURN_ARM_M > tolerance_m)
        };
        // Nodes may leave the map or become part of it, when components are unplaced or connected.
        let left_map = |was: &DrawnNode, node: &Node| was.bounds_m != EMPTY && !node.in_map();
        let joined_map = |was: &DrawnNode, node: &Node| {
            was.bounds_m == EMPTY && node.in_map() && bounds_m(node, &self.config) != EMPTY
        };
        let mut all = self.drawn.iter().zip(nodes).zip(poses);
        if !all.any(|((was, node), is)| moved(was, is) || left_map(was, node) || joined_map(was, node)) {
            return None;
        }
        // Which nodes fit into the largest map is decided again, from the first node on.
        let mut extent = TileMap::new(self.map.header);
        let mut drawn = self.drawn.clone();
        for ((drawn, node), pose) in drawn.iter_mut().zip(nodes).zip(poses) {
            if left_map(drawn, node) {
                drawn.bounds_m = EMPTY;
            }
            if joined_map(drawn, node) {
                (drawn.bounds_m, drawn.map_from_base) = (bounds_m(node, &self.config), *pose);
            }
            if moved(drawn, pose) {
                drawn.map_from_base = *pose;
            }
            let tiles = tiles_of(drawn, self.config.resolution_m);
            drawn.tiles = if extent.grow_to(tiles, ROBOT_TILES_MAX) { tiles } else { IndexRect::default() };
        }
        let mut replaced = TileSet::empty_within([self.map.extent(), extent.extent()]);
        for (was, is) in self.drawn.iter().zip(&drawn).filter(|(was, is)| was != is) {
            replaced.insert(was.tiles);
            replaced.insert(is.tiles);
        }
        Some(Redraw { map: TileMap::new(self.map.header), tiles: replaced, drawn, next: 0 })
    }

    /// Replaces the tiles of the shown map by the new version.
    fn show_redraw(&mut self) {
        let Some(Redraw { map: new, tiles, drawn, .. }) = self.redraw.take() else { return };
        let extent = drawn.iter().fold(IndexRect::default(), |all, node| all.union(node.tiles));
        let mut map = TileMap::new(self.map.header);
        if !map.grow_to(extent, ROBOT_TILES_MAX) {
            // A node added meanwhile lies too far from where the others are now: the next slice plans again.
            return;
        }
        for (x, y) in extent.points() {
            let from = if tiles.contains(x, y) { &new } else { &self.map };
            map.set(x, y, from.get(x, y).cloned());
        }
        self.nodes_not_drawn =
            drawn.iter().filter(|node| node.bounds_m != EMPTY && node.tiles.is_empty()).count() as u64;
        (self.map, self.drawn) = (map, drawn);
    }
}

/// Bounding box of a node with nothing to draw.
const EMPTY: [f32; 4] = [f32::INFINITY, f32::INFINITY, f32::NEG_INFINITY, f32::NEG_INFINITY];

/// Bounding box of a node's beams and swept path in `base_footprint`, metres.
fn bounds_m(node: &Node, config: &MapConfig) -> [f32; 4] {
    let rays = &node.rays;
    let ends = rays.hits.iter().chain(&rays.misses);
    let any = !rays.hits.is_empty() || !rays.misses.is_empty();
    let points = ends.chain(any.then_some(&rays.sensor));
    let unite = |[x0, y0, x1, y1]: [f32; 4], [x, y]: [f32; 2]| [x0.min(x), y0.min(y), x1.max(x), y1.max(y)];
    let beams = points.fold(EMPTY, |all, point| unite(all, *point));
    let radius_m = config.robot_radius_m as f32;
    let body = swept_positions_m(node, config).iter();
    let corners = body.flat_map(|[x, y]| [[x - radius_m, y - radius_m], [x + radius_m, y + radius_m]]);
    corners.fold(beams, unite)
}

/// Positions of the robot's body since the node before; none if the path or the robot's radius is unknown.
fn swept_positions_m<'a>(node: &'a Node, config: &MapConfig) -> &'a [[f32; 2]] {
    if config.robot_radius_m > 0.0 { node.swept_path.positions_m() } else { &[] }
}

/// Tiles that contain all of a node's cells, with a margin for rounding.
fn tiles_of(node: &DrawnNode, resolution_m: f64) -> IndexRect {
    if node.bounds_m == EMPTY || !node.map_from_base.is_finite() {
        return IndexRect::default();
    }
    let [x0, y0, x1, y1] = node.bounds_m.map(f64::from);
    let corners = [[x0, y0], [x1, y0], [x0, y1], [x1, y1]].map(|p| node.map_from_base.apply(p));
    let [mut low, mut high] = [corners[0]; 2];
    for corner in corners {
        for k in 0..2 {
            (low[k], high[k]) = (low[k].min(corner[k]), high[k].max(corner[k]));
        }
    }
    let far = [low, high].as_flattened().iter().fold(0.0_f64, |most, v| most.max(v.abs()));
    let margin_m = resolution_m + far * ROUNDING;
    let cell = |metres: f64| (metres / resolution_m).floor().clamp(-CELL_MAX, CELL_MAX) as i64;
    let (low, high) = (low.map(|v| cell(v - margin_m)), high.map(|v| cell(v + margin_m)));
    IndexRect { x0: low[0], y0: low[1], x1: high[0] + 1, y1: high[1] + 1 }.tiles()
}

#[cfg(test)]
mod tests;
