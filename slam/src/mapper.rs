//! Draws the occupancy grid: every node's beams, traced cell by cell (Bresenham 1965), add
//! log-odds where they end and take some away where they pass (Thrun, Burgard, Fox,
//! "Probabilistic Robotics", 2005, table 9.1). Then what the robot's body came over since the node before: there is
//! floor (`msg::grid::SWEPT_FREE`), until the robot sees something there.
//!
//! Evidence is clamped, so a node cannot be taken out of the map again. When nodes have moved, the
//! tiles they touched and now touch are drawn anew instead, from all nodes in their order: tile by
//! tile the same as a map drawn from nothing. That happens beside the map that is shown, in slices
//! between which new nodes are drawn as ever; when all is done the new tiles take the old ones' place.

use crate::cloud::PointTransform;
use crate::config::MapConfig;
use crate::node::Node;
use msg::grid::{LOG_ODDS_MAX, LOG_ODDS_MIN, LOG_ODDS_PER_STEP, SWEPT_FREE, UNKNOWN};
use msg::tiles::{OpenTiles, ROBOT_TILES_MAX, TILE};
use msg::{
    DenseMap, GridView, Header, MapHeader, Monotonic, Pose2, Rect, SweptDisk, TileMap, pose::wrap_angle,
};

/// Cells that a node costs in a slice at least, whatever it draws: it is looked at.
const NODE_CELLS: usize = 64;
/// Rounding of a point's place in single precision, as a share of its distance from the origin.
const ROUNDING: f64 = 1e-6;

/// Draws the occupancy grid; see the module.
pub struct OccupancyMapper {
    config: MapConfig,
    map: TileMap,
    /// How each node was drawn, by its id.
    drawn: Vec<Drawn>,
    redraw: Option<Redraw>,
    /// Nodes that did not fit into the largest map.
    clipped: u64,
    grid: DenseMap,
    ends: Ends,
    pen: Pen,
}

/// How a node is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Drawn {
    map_from_base: Pose2,
    /// A box around its beams and its body's way in `base_footprint`: low x, low y, high x, high y, metres. Empty (low
    /// above high) if it has nothing to draw.
    reach_m: [f32; 4],
    /// All its beams lie in these tiles; empty if it is not drawn.
    tiles: Rect,
}

/// A new version of some tiles.
struct Redraw {
    /// The version, as far as it has been drawn,
    map: TileMap,
    /// and its tiles.
    marks: Marks,
    /// How the nodes will be drawn then.
    drawn: Vec<Drawn>,
    /// The next to be drawn.
    next: usize,
}

impl OccupancyMapper {
    /// Nothing drawn.
    pub fn new(config: MapConfig) -> Self {
        let map = TileMap::new(MapHeader { resolution_m: config.resolution_m, ..Default::default() });
        Self {
            pen: Pen::new(&config),
            config,
            map,
            drawn: Vec::new(),
            redraw: None,
            clipped: 0,
            grid: DenseMap::default(),
            ends: Ends::default(),
        }
    }

    /// Nodes that are not drawn because the map would have become too large.
    pub fn clipped(&self) -> u64 {
        self.clipped
    }

    /// Where each drawn node lay when it was drawn: all that decides how the map came about.
    pub fn drawn(&self) -> Vec<Pose2> {
        self.drawn.iter().map(|node| node.map_from_base).collect()
    }

    /// Begins anew with nodes where an earlier canvas had them, so that the map is the same.
    pub fn restore(&mut self, nodes: &[Node], drawn: &[Pose2]) {
        self.map = TileMap::new(MapHeader { resolution_m: self.config.resolution_m, ..Default::default() });
        self.drawn.clear();
        self.redraw = None;
        self.clipped = 0;
        for (node, pose) in nodes.iter().zip(drawn) {
            self.add(node, *pose);
        }
    }

    /// The map is as of this scan, whenever its own were taken.
    pub fn date(&mut self, header: Header, scan_sent: Monotonic) {
        (self.map.header.header, self.map.header.scan_sent) = (header, scan_sent);
    }

    /// The map as drawn so far, never half a new version.
    pub fn tiles(&self) -> &TileMap {
        &self.map
    }

    /// Draws for about `cells_max` cells of beams, and one node at least: new nodes first, then
    /// what has moved by more than the configuration lets pass. True if there is more to do.
    pub fn work(&mut self, nodes: &[Node], poses: &[Pose2], cells_max: usize) -> bool {
        self.slice(nodes, poses, cells_max, self.config.redraw_m)
    }

    /// Draws all nodes exactly where they are, and the map as one grid. The result depends on nodes
    /// and poses alone.
    pub fn finish(&mut self, nodes: &[Node], poses: &[Pose2]) -> GridView<'_> {
        while self.slice(nodes, poses, usize::MAX, 0.0) {}
        self.grid.update(&self.map)
    }

    fn slice(&mut self, nodes: &[Node], poses: &[Pose2], cells_max: usize, tolerance_m: f64) -> bool {
        let mut left = cells_max;
        for (node, pose) in nodes.iter().zip(poses).skip(self.drawn.len()) {
            if left == 0 {
                return true;
            }
            left = left.saturating_sub(self.add(node, *pose));
        }
        if self.redraw.is_none() {
            self.redraw = self.begin(nodes, poses, tolerance_m);
        }
        let Some(redraw) = &mut self.redraw else { return false };
        // Nodes that came meanwhile are drawn there as they were here.
        redraw.drawn.extend_from_slice(&self.drawn[redraw.drawn.len()..]);
        while let Some(drawn) = redraw.drawn.get(redraw.next) {
            if left == 0 {
                return true;
            }
            let mut cost = NODE_CELLS;
            if redraw.marks.touches(drawn.tiles) {
                redraw.map.grow_to(drawn.tiles, ROBOT_TILES_MAX);
                let (marks, node) = (&redraw.marks, &nodes[redraw.next]);
                let open = redraw.map.open(drawn.tiles, |x, y| marks.holds(x, y));
                cost += self.ends.place(node, drawn.map_from_base, &self.config).trace(open, &self.pen);
            }
            redraw.next += 1;
            left = left.saturating_sub(cost);
        }
        self.swap();
        true
    }

    /// Draws a new node. Returns the cells its beams passed.
    fn add(&mut self, node: &Node, map_from_base: Pose2) -> usize {
        self.map.header.header = node.header;
        self.map.header.scan_sent = node.header.sent;
        let reach_m = if node.in_map() { reach_m(node, &self.config) } else { EMPTY };
        let mut drawn = Drawn { map_from_base, reach_m, tiles: Rect::default() };
        let tiles = tiles_of(&drawn, self.config.resolution_m);
        if !tiles.is_empty() && !self.map.grow_to(tiles, ROBOT_TILES_MAX) {
            self.clipped += 1;
        } else {
            drawn.tiles = tiles;
        }
        self.drawn.push(drawn);
        if drawn.tiles.is_empty() {
            return NODE_CELLS;
        }
        let open = self.map.open(tiles, |_, _| true);
        NODE_CELLS + self.ends.place(node, map_from_base, &self.config).trace(open, &self.pen)
    }

    /// A new version of the tiles that the nodes that have moved touched and will touch, if any.
    fn begin(&self, nodes: &[Node], poses: &[Pose2], tolerance_m: f64) -> Option<Redraw> {
        let moved = |was: &Drawn, is: &Pose2| {
            let turned = wrap_angle(was.map_from_base.yaw_rad - is.yaw_rad).abs();
            let moved = was.map_from_base.distance_m(*is);
            was.reach_m != EMPTY && (moved > tolerance_m || turned * 5.0 > tolerance_m)
        };
        // A node that is no longer part of the map is to be seen no more, and one that has become part
        // of it is to be seen.
        let gone = |was: &Drawn, node: &Node| was.reach_m != EMPTY && !node.in_map();
        let came = |was: &Drawn, node: &Node| {
            was.reach_m == EMPTY && node.in_map() && reach_m(node, &self.config) != EMPTY
        };
        let mut all = self.drawn.iter().zip(nodes).zip(poses);
        if !all.any(|((was, node), is)| moved(was, is) || gone(was, node) || came(was, node)) {
            return None;
        }
        // Who fits into the largest map is found anew, from the first node on.
        let mut extent = TileMap::new(self.map.header);
        let mut drawn = self.drawn.clone();
        for ((place, node), pose) in drawn.iter_mut().zip(nodes).zip(poses) {
            if gone(place, node) {
                place.reach_m = EMPTY;
            }
            if came(place, node) {
                (place.reach_m, place.map_from_base) = (reach_m(node, &self.config), *pose);
            }
            if moved(place, pose) {
                place.map_from_base = *pose;
            }
            let tiles = tiles_of(place, self.config.resolution_m);
            place.tiles = if extent.grow_to(tiles, ROBOT_TILES_MAX) { tiles } else { Rect::default() };
        }
        let mut marks = Marks::none_of([self.map.extent(), extent.extent()]);
        for (was, is) in self.drawn.iter().zip(&drawn).filter(|(was, is)| was != is) {
            marks.mark(was.tiles);
            marks.mark(is.tiles);
        }
        Some(Redraw { map: TileMap::new(self.map.header), marks, drawn, next: 0 })
    }

    /// The new version takes the old one's place, tile by tile, all at once.
    fn swap(&mut self) {
        let Some(Redraw { map: new, marks, drawn, .. }) = self.redraw.take() else { return };
        let extent = drawn.iter().fold(Rect::default(), |all, node| all.union(node.tiles));
        let mut map = TileMap::new(self.map.header);
        if !map.grow_to(extent, ROBOT_TILES_MAX) {
            // A node that came meanwhile lies too far from where the others are now: begin anew.
            return;
        }
        for (x, y) in extent.points() {
            let from = if marks.holds(x, y) { &new } else { &self.map };
            map.set(x, y, from.get(x, y).cloned());
        }
        self.clipped =
            drawn.iter().filter(|node| node.reach_m != EMPTY && node.tiles.is_empty()).count() as u64;
        (self.map, self.drawn) = (map, drawn);
    }
}

/// Some tiles of two versions' extents, which may lie far apart.
struct Marks {
    parts: [(Rect, Vec<bool>); 2],
}

impl Marks {
    fn none_of(extents: [Rect; 2]) -> Self {
        Self { parts: extents.map(|all| (all, vec![false; all.width() * all.height()])) }
    }

    fn mark(&mut self, tiles: Rect) {
        for (all, marked) in &mut self.parts {
            for (x, y) in tiles.intersect(*all).points() {
                marked[all.index(x, y)] = true;
            }
        }
    }

    fn holds(&self, x: i64, y: i64) -> bool {
        self.touches(Rect::single(x, y))
    }

    fn touches(&self, tiles: Rect) -> bool {
        let touches = |(all, marked): &(Rect, Vec<bool>)| {
            tiles.intersect(*all).points().any(|(x, y)| marked[all.index(x, y)])
        };
        self.parts.iter().any(touches)
    }
}

/// The reach of a node with nothing to draw.
const EMPTY: [f32; 4] = [f32::INFINITY, f32::INFINITY, f32::NEG_INFINITY, f32::NEG_INFINITY];

/// A box around a node's beams and its body's way, in `base_footprint`.
fn reach_m(node: &Node, config: &MapConfig) -> [f32; 4] {
    let rays = &node.rays;
    let ends = rays.hits.iter().chain(&rays.misses);
    let any = !rays.hits.is_empty() || !rays.misses.is_empty();
    let points = ends.chain(any.then_some(&rays.sensor));
    let unite = |[x0, y0, x1, y1]: [f32; 4], [x, y]: [f32; 2]| [x0.min(x), y0.min(y), x1.max(x), y1.max(y)];
    let beams = points.fold(EMPTY, |all, point| unite(all, *point));
    let radius_m = config.robot_radius_m as f32;
    let body = body(node, config).iter();
    let corners = body.flat_map(|[x, y]| [[x - radius_m, y - radius_m], [x + radius_m, y + radius_m]]);
    corners.fold(beams, unite)
}

/// Where the robot's body was on the way to a node, as far as that and its size are known.
fn body<'a>(node: &'a Node, config: &MapConfig) -> &'a [[f32; 2]] {
    if config.robot_radius_m > 0.0 { node.swept_path.positions_m() } else { &[] }
}

/// The tiles that hold all of a node's beams, wherever the last bit of a rounding falls.
fn tiles_of(node: &Drawn, resolution_m: f64) -> Rect {
    if node.reach_m == EMPTY || !node.map_from_base.is_finite() {
        return Rect::default();
    }
    let [x0, y0, x1, y1] = node.reach_m.map(f64::from);
    let corners = [[x0, y0], [x1, y0], [x0, y1], [x1, y1]].map(|p| node.map_from_base.apply(p));
    let [mut low, mut high] = [corners[0]; 2];
    for corner in corners {
        for k in 0..2 {
            (low[k], high[k]) = (low[k].min(corner[k]), high[k].max(corner[k]));
        }
    }
    let far = [low, high].as_flattened().iter().fold(0.0_f64, |most, v| most.max(v.abs()));
    let margin_m = resolution_m + far * ROUNDING;
    let cell = |metres: f64| (metres / resolution_m).floor().clamp(-1e15, 1e15) as i64;
    let (low, high) = (low.map(|v| cell(v - margin_m)), high.map(|v| cell(v + margin_m)));
    Rect { x0: low[0], y0: low[1], x1: high[0] + 1, y1: high[1] + 1 }.tiles()
}

/// A node's beams as cells of the lattice; the memory is used again.
#[derive(Default)]
struct Ends {
    sensor: [i64; 2],
    hits: Vec<[i64; 2]>,
    misses: Vec<[i64; 2]>,
    body: Vec<SweptDisk>,
}

impl Ends {
    fn place(&mut self, node: &Node, map_from_base: Pose2, config: &MapConfig) -> &Self {
        let place = PointTransform::new(map_from_base);
        let cell_of = |v: f32| (f64::from(v) / config.resolution_m).floor() as i64;
        let cell = |p: &[f32; 2]| place.point(*p).map(cell_of);
        self.sensor = place.point(node.rays.sensor).map(cell_of);
        self.hits.clear();
        self.hits.extend(node.rays.hits.iter().map(cell));
        self.misses.clear();
        self.misses.extend(node.rays.misses.iter().map(cell));
        self.sensor = cell(&node.rays.sensor);
        self.body.clear();
        for place in body(node, config) {
            let at = map_from_base.apply(place.map(f64::from)).map(|m| m / config.resolution_m);
            self.body.extend(SweptDisk::new(at, at, config.robot_radius_m / config.resolution_m));
        }
        self
    }

    /// Draws into the open tiles. Returns the cells passed, open or not.
    fn trace(&self, mut tiles: OpenTiles<'_>, pen: &Pen) -> usize {
        let mut cells = 0;
        // A cell that beams graze and one beam ends in is a surface: ends are drawn last and
        // make good what this scan's passing beams took.
        for &end in self.hits.iter().chain(&self.misses) {
            cells += pass(&mut tiles, self.sensor, end, &pen.pass);
        }
        for &[x, y] in &self.hits {
            if let Some(cells) = tiles.cells(x.div_euclid(TILE), y.div_euclid(TILE)) {
                let cell = &mut cells[(y.rem_euclid(TILE) * TILE + x.rem_euclid(TILE)) as usize];
                *cell = pen.end[usize::from(*cell as u8)];
            }
        }
        for disk in &self.body {
            for (x, y) in disk.cells().points().filter(|(x, y)| disk.covers(*x, *y)) {
                if let Some(cells) = tiles.cells(x.div_euclid(TILE), y.div_euclid(TILE)) {
                    cells[(y.rem_euclid(TILE) * TILE + x.rem_euclid(TILE)) as usize] = SWEPT_FREE;
                }
                cells += 1;
            }
        }
        cells
    }
}

/// What becomes of a cell, by its bits, when a beam passes or, after that, ends there.
struct Pen {
    pass: [i8; 256],
    end: [i8; 256],
}

impl Pen {
    fn new(config: &MapConfig) -> Self {
        let step = |nats: f64| (nats / LOG_ODDS_PER_STEP).round().clamp(1.0, 127.0) as i8;
        let (hit, miss) = (step(config.hit), -step(config.miss));
        let table = |change: i8| {
            core::array::from_fn(|bits| {
                let cell = bits as u8 as i8;
                let before = if cell == UNKNOWN { 0 } else { cell };
                match cell {
                    SWEPT_FREE if change < 0 => SWEPT_FREE,
                    _ => before.saturating_add(change).clamp(LOG_ODDS_MIN, LOG_ODDS_MAX),
                }
            })
        };
        Self { pass: table(miss), end: table(hit - miss) }
    }
}

/// Changes all cells from `start` up to, but without, `end`. Returns how many.
fn pass(tiles: &mut OpenTiles<'_>, start: [i64; 2], end: [i64; 2], change: &[i8; 256]) -> usize {
    let (dx, dy) = ((end[0] - start[0]).abs(), -(end[1] - start[1]).abs());
    let (sx, sy) = ((end[0] - start[0]).signum(), (end[1] - start[1]).signum());
    let count = dx.max(-dy);
    let (mut at, mut error, mut left) = (start, dx + dy, count);
    while left > 0 {
        let tile = at.map(|v| v.div_euclid(TILE));
        let mut cells = tiles.cells(tile[0], tile[1]);
        let [mut x, mut y] = at.map(|v| v.rem_euclid(TILE));
        // Both within the tile: no bit beyond the lowest six is set, nor the sign.
        while left > 0 && (x | y) as u64 >> TILE.trailing_zeros() == 0 {
            if let Some(cells) = &mut cells {
                let cell = &mut cells[(y * TILE + x) as usize];
                *cell = change[usize::from(*cell as u8)];
            }
            let twice = 2 * error;
            let (along_x, along_y) = (i64::from(twice >= dy), i64::from(twice <= dx));
            error += along_x * dy + along_y * dx;
            x += along_x * sx;
            y += along_y * sy;
            left -= 1;
        }
        at = [tile[0] * TILE + x, tile[1] * TILE + y];
    }
    count as usize
}

#[cfg(test)]
mod tests;
