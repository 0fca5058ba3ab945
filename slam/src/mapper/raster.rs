//! Rasterization of a node: traces its beams and its swept path through the grid's cells.

use super::swept_positions_m;
use crate::config::MapConfig;
use crate::node::Node;
use crate::point_transform::PointTransform;
use msg::grid::{LOG_ODDS_MAX, LOG_ODDS_MIN, LOG_ODDS_PER_STEP, SWEPT_FREE, UNKNOWN};
use msg::tiles::{OpenTiles, TILE};
use msg::{Pose2, SweptDisk};

/// Cells of a node's beam ends and of its swept path; the buffers are reused.
#[derive(Default)]
pub(super) struct NodeCells {
    /// Cell in which the beams start.
    sensor: [i64; 2],
    /// Cells in which beams end with a return.
    hits: Vec<[i64; 2]>,
    /// Cells in which beams without a return end.
    misses: Vec<[i64; 2]>,
    /// The robot's body at the positions of the swept path.
    body: Vec<SweptDisk>,
}

impl NodeCells {
    /// Replaces the cells by those of a node at a pose.
    pub fn fill(&mut self, node: &Node, map_from_base: Pose2, config: &MapConfig) -> &Self {
        let transform = PointTransform::new(map_from_base);
        let cell_of = |v: f32| (f64::from(v) / config.resolution_m).floor() as i64;
        let cell = |p: &[f32; 2]| transform.point(*p).map(cell_of);
        self.sensor = transform.point(node.rays.sensor).map(cell_of);
        self.hits.clear();
        self.hits.extend(node.rays.hits.iter().map(cell));
        self.misses.clear();
        self.misses.extend(node.rays.misses.iter().map(cell));
        self.sensor = cell(&node.rays.sensor);
        self.body.clear();
        for position in swept_positions_m(node, config) {
            let at = map_from_base.apply(position.map(f64::from)).map(|m| m / config.resolution_m);
            self.body.extend(SweptDisk::new(at, at, config.robot_radius_m / config.resolution_m));
        }
        self
    }

    /// Draws the node into the open tiles. Returns the number of cells passed, open or not.
    pub fn draw(&self, mut tiles: OpenTiles<'_>, updates: &UpdateTables) -> usize {
        let mut cells = 0;
        // A cell that beams graze and one beam ends in is a surface: ends are drawn last and
        // make good what this scan's passing beams took.
        for &end in self.hits.iter().chain(&self.misses) {
            cells += trace_beam(&mut tiles, self.sensor, end, &updates.pass);
        }
        for &[x, y] in &self.hits {
            if let Some(cells) = tiles.cells(x.div_euclid(TILE), y.div_euclid(TILE)) {
                let cell = &mut cells[(y.rem_euclid(TILE) * TILE + x.rem_euclid(TILE)) as usize];
                *cell = updates.end[usize::from(*cell as u8)];
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

/// Tables of a cell's new value by its old value's bits.
pub(super) struct UpdateTables {
    /// After a beam passed.
    pass: [i8; 256],
    /// After a beam that was drawn as passing ends in the cell.
    end: [i8; 256],
}

impl UpdateTables {
    /// Tables of the configured log-odds of a hit and a miss.
    pub fn new(config: &MapConfig) -> Self {
        let step = |nats: f64| (nats / LOG_ODDS_PER_STEP).round().clamp(1.0, f64::from(LOG_ODDS_MAX)) as i8;
        let (hit, miss) = (step(config.hit_log_odds), -step(config.miss_log_odds));
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

/// Updates the cells of a beam from `start` up to `end`, without `end` (Bresenham). Returns their number.
fn trace_beam(tiles: &mut OpenTiles<'_>, start: [i64; 2], end: [i64; 2], update: &[i8; 256]) -> usize {
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
                *cell = update[usize::from(*cell as u8)];
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
