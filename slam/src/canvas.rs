//! Draws the occupancy grid: every node's beams, traced cell by cell (Bresenham 1965), add
//! log-odds where they end and take some away where they pass (Thrun, Burgard, Fox,
//! "Probabilistic Robotics", 2005, table 9.1).

use crate::cloud::Placement;
use crate::config::MapConfig;
use crate::node::Node;
use msg::grid::{CELLS_MAX, LOG_ODDS_MAX, LOG_ODDS_PER_STEP, UNKNOWN};
use msg::{Grid, GridHeader, GridView, Pose2, pose::wrap_angle};

/// The grid grows by whole tiles of so many cells.
const TILE: i64 = 64;

/// See the module.
pub struct Canvas {
    config: MapConfig,
    header: GridHeader,
    cells: Vec<i8>,
    /// Lower left cell, in cells of the map's lattice, a multiple of [`TILE`].
    corner: [i64; 2],
    /// Where each drawn node lay.
    drawn: Vec<Pose2>,
    /// Nodes that did not fit into the largest grid.
    clipped: u64,
    /// What is given out: the grid without the unknown margins of its tiles.
    trimmed: Grid,
}

impl Canvas {
    /// Nothing drawn.
    pub fn new(config: MapConfig) -> Self {
        let header = GridHeader { resolution_m: config.resolution_m, ..Default::default() };
        let (cells, drawn) = (Vec::new(), Vec::new());
        Self { config, header, cells, corner: [0; 2], drawn, clipped: 0, trimmed: Grid::default() }
    }

    /// Nodes that were not drawn because the grid would have become too large.
    pub fn clipped(&self) -> u64 {
        self.clipped
    }

    /// Where each drawn node lay when it was drawn: all that decides how the grid came about.
    pub fn drawn(&self) -> &[Pose2] {
        &self.drawn
    }

    /// Draws nodes where an earlier canvas had them, so that the grid is the same.
    pub fn restore(&mut self, nodes: &[Node], drawn: &[Pose2]) {
        self.forget();
        self.draw(&nodes[..drawn.len().min(nodes.len())], drawn);
    }

    /// Wipes the grid; it is drawn again from all nodes.
    pub fn forget(&mut self) {
        self.cells.fill(UNKNOWN);
        self.drawn.clear();
        self.clipped = 0;
    }

    /// The grid of these nodes at these poses, as large as what is known. New nodes are added; if
    /// old ones have moved, all is drawn again.
    pub fn draw(&mut self, nodes: &[Node], poses: &[Pose2]) -> GridView<'_> {
        if self.drawn.iter().zip(poses).any(|(was, is)| self.moved(*was, *is)) {
            self.forget();
        }
        for (node, pose) in nodes.iter().zip(poses).skip(self.drawn.len()) {
            if node.fits && !self.trace(node, *pose) {
                self.clipped += 1;
            }
            self.drawn.push(*pose);
            self.header.header = node.header;
            self.header.scan_sent = node.header.sent;
        }
        self.trim();
        self.trimmed.view()
    }

    /// Copies the known part, so that what a map says of its size does not depend on tiles.
    fn trim(&mut self) {
        let width = self.header.width as usize;
        let (mut low, mut high) = ([usize::MAX; 2], [0; 2]);
        for (y, row) in self.cells.chunks_exact(width.max(1)).enumerate() {
            let Some(first) = row.iter().position(|cell| *cell != UNKNOWN) else { continue };
            let last = row.iter().rposition(|cell| *cell != UNKNOWN).unwrap_or(first);
            (low[0], high[0]) = (low[0].min(first), high[0].max(last + 1));
            (low[1], high[1]) = (low[1].min(y), y + 1);
        }
        self.trimmed.cells.clear();
        self.trimmed.header = GridHeader { width: 0, height: 0, ..self.header };
        if high[1] == 0 {
            return;
        }
        for row in self.cells.chunks_exact(width).take(high[1]).skip(low[1]) {
            self.trimmed.cells.extend_from_slice(&row[low[0]..high[0]]);
        }
        let header = &mut self.trimmed.header;
        (header.width, header.height) = ((high[0] - low[0]) as u32, (high[1] - low[1]) as u32);
        let corner_m = [0, 1].map(|k| (self.corner[k] + low[k] as i64) as f64 * self.config.resolution_m);
        header.origin = Pose2::new(corner_m[0], corner_m[1], 0.0);
    }

    fn moved(&self, was: Pose2, is: Pose2) -> bool {
        let turned = wrap_angle(was.yaw_rad - is.yaw_rad).abs();
        was.distance_m(is) > self.config.redraw_m || turned * 5.0 > self.config.redraw_m
    }

    fn trace(&mut self, node: &Node, map_from_base: Pose2) -> bool {
        let place = Placement::new(map_from_base);
        let cell =
            |p: [f32; 2]| place.point(p).map(|v| (f64::from(v) / self.config.resolution_m).floor() as i64);
        let rays = &node.rays;
        let sensor = cell(rays.sensor);
        let hits: Vec<[i64; 2]> = rays.hits.iter().map(|p| cell(*p)).collect();
        let misses: Vec<[i64; 2]> = rays.misses.iter().map(|p| cell(*p)).collect();
        if !self.make_room(hits.iter().chain(&misses).chain([&sensor])) {
            return false;
        }
        let step = |nats: f64| (nats / LOG_ODDS_PER_STEP).round().clamp(1.0, 127.0) as i8;
        let (hit, miss) = (step(self.config.hit), -step(self.config.miss));
        // A cell that beams graze and one beam ends in is a surface: ends are drawn last and
        // make good what this scan's passing beams took.
        for &end in hits.iter().chain(&misses) {
            self.pass(sensor, end, miss);
        }
        for &end in &hits {
            self.add(end, hit - miss);
        }
        true
    }

    /// Grows the grid to hold the cells; false if it would be too large.
    fn make_room<'a>(&mut self, cells: impl Iterator<Item = &'a [i64; 2]>) -> bool {
        let empty = self.cells.is_empty();
        let mut low = if empty { [i64::MAX; 2] } else { self.corner };
        let (width, height) = (i64::from(self.header.width), i64::from(self.header.height));
        let mut high = if empty { [i64::MIN; 2] } else { [low[0] + width, low[1] + height] };
        for c in cells {
            for k in 0..2 {
                low[k] = low[k].min(c[k].div_euclid(TILE) * TILE);
                high[k] = high[k].max((c[k].div_euclid(TILE) + 1) * TILE);
            }
        }
        let size = [high[0] - low[0], high[1] - low[1]];
        if !empty && low == self.corner && size == [width, height] {
            return true;
        }
        if size[0].saturating_mul(size[1]) > CELLS_MAX as i64 {
            return false;
        }
        let mut grown = vec![UNKNOWN; (size[0] * size[1]) as usize];
        for row in 0..height {
            let from = (row * width) as usize;
            let to = ((row + self.corner[1] - low[1]) * size[0] + self.corner[0] - low[0]) as usize;
            grown[to..to + width as usize].copy_from_slice(&self.cells[from..from + width as usize]);
        }
        self.cells = grown;
        self.corner = low;
        (self.header.width, self.header.height) = (size[0] as u32, size[1] as u32);
        true
    }

    /// All cells from `start` up to, but without, `end`.
    fn pass(&mut self, start: [i64; 2], end: [i64; 2], change: i8) {
        let (dx, dy) = ((end[0] - start[0]).abs(), -(end[1] - start[1]).abs());
        let (sx, sy) = ((end[0] - start[0]).signum(), (end[1] - start[1]).signum());
        let (mut at, mut error) = (start, dx + dy);
        while at != end {
            self.add(at, change);
            let twice = 2 * error;
            if twice >= dy {
                error += dy;
                at[0] += sx;
            }
            if twice <= dx {
                error += dx;
                at[1] += sy;
            }
        }
    }

    fn add(&mut self, at: [i64; 2], change: i8) {
        let (x, y) = ((at[0] - self.corner[0]) as usize, (at[1] - self.corner[1]) as usize);
        let cell = &mut self.cells[y * self.header.width as usize + x];
        let before = if *cell == UNKNOWN { 0 } else { *cell };
        *cell = before.saturating_add(change).clamp(-LOG_ODDS_MAX, LOG_ODDS_MAX);
    }
}
