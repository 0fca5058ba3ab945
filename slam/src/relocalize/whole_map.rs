//! Branch-and-bound search of a whole map for the poses at which a scan's points lie on walls.
//!
//! It follows Hess et al., "Real-time loop closure in 2D LIDAR SLAM", ICRA 2016, section V-B. Every level holds the
//! maximum over the window that a cell stands for, so a coarse score is never below a finer one. The search is best
//! first, over all positions and headings.

use super::{MapNodes, is_same_place};
use crate::cloud::{Cloud, floor_i32};
use crate::config::{RelocalizeConfig, SlamConfig};
use crate::likelihood_field::kernel;
use crate::point_transform::PointTransform;
use msg::{Pose2, pose::wrap_angle};
use std::collections::BinaryHeap;

/// Levels of the map's pyramid: a cell of the last one has the side of 2^5 = 32 fine cells.
const LEVELS: usize = 6;
/// Number of cells above which their side grows, up to twice: a large map needs a ninth of the time for the same
/// results. In a small map larger cells would delay them.
const CELLS_QUICK: f32 = 32_768.0;
/// Number of cells above which their side grows without limit: bounds the memory of the pyramid.
const CELLS_MAX: f32 = 2_097_152.0;
/// Margin of the field around the map's points, metres: room for the likelihood around them.
const MARGIN_M: f32 = 1.0;
/// Bounds of the radius by which the steps of heading are chosen, metres: a step moves a point there by one cell.
const RADIUS_MIN_M: f32 = 1.0;
const RADIUS_MAX_M: f32 = 10.0;
/// Largest offset of a point in cells: it is stored in 16 bits.
const OFFSET_MAX: i32 = 16_000;
/// Cells along the side of a block that are looked at for open floor: open areas are squares of several metres.
const OPEN_SAMPLES: i32 = 4;
/// Points scored between two checks whether the least score can still be reached.
const SCORE_CHUNK: usize = 32;
/// Bearings of an eighth of a turn, at one a degree.
const EIGHTH_BEARINGS: usize = 45;
/// Eighths of a turn with returns, of eight, from which a scan counts as seeing all around.
const EIGHTHS_ALL_AROUND: usize = 6;

/// Cell side for a map of this area (m²), metres; `fine_m` is the least.
fn cell_side_m(fine_m: f32, area_m2: f32) -> f32 {
    let side_m = |cells: f32| (area_m2 / cells).sqrt();
    side_m(CELLS_QUICK).clamp(fine_m, 2.0 * fine_m).max(side_m(CELLS_MAX))
}

/// Bounds of a search: a square of positions and a range of headings around a pose.
#[derive(Clone, Copy)]
pub(super) struct Bounds {
    pub centre: Pose2,
    pub half_m: f64,
    pub half_rad: f64,
}

/// The whole map as a likelihood field with its pyramid.
pub(super) struct WholeMap {
    cell_m: f32,
    corner: [f32; 2],
    width: i32,
    height: i32,
    /// Level h, cell (x, y): the maximum over [x, x + 2^h) x [y, y + 2^h), from -(2^h - 1) on.
    levels: Vec<Vec<u8>>,
    /// Cells where a robot may be: near a position where a scan was taken.
    open: Vec<bool>,
    /// Whether most scans have returns behind the robot as well as before it.
    pub sees_all_around: bool,
}

impl WholeMap {
    /// The likelihood field and pyramid of a map's nodes.
    pub fn new(config: &SlamConfig, map: MapNodes<'_>) -> Self {
        let posed = || map.nodes.iter().zip(map.poses).filter(|(node, _)| map.contains(node));
        let (mut low, mut high) = ([f32::MAX; 2], [f32::MIN; 2]);
        for (node, pose) in posed() {
            let map_from_node = PointTransform::new(*pose);
            for p in node.cloud.points().iter().map(|p| p.at).chain([[0.0; 2]]) {
                let at = map_from_node.point(p);
                for k in 0..2 {
                    (low[k], high[k]) = (low[k].min(at[k]), high[k].max(at[k]));
                }
            }
        }
        if low[0] > high[0] {
            (low, high) = ([0.0; 2], [0.0; 2]);
        }
        let size = [0, 1].map(|k| high[k] - low[k] + 2.0 * MARGIN_M);
        let cell_m = cell_side_m(config.tracking.cell_m, size[0] * size[1]);
        let corner = low.map(|v| v - MARGIN_M);
        let [width, height] = size.map(|s| (s / cell_m).ceil() as i32 + 1);
        let mut fine = vec![0_u8; (width * height) as usize];
        let kernel = kernel(cell_m, config.tracking.blur_m.max(cell_m));
        let cell = |at: [f32; 2]| [0, 1].map(|k| floor_i32((at[k] - corner[k]) / cell_m));
        for (node, pose) in posed() {
            let map_from_node = PointTransform::new(*pose);
            for p in node.cloud.points() {
                let [x, y] = cell(map_from_node.point(p.at));
                for &(dx, dy, value) in &kernel {
                    let (x, y) = (x + dx, y + dy);
                    if (0..width).contains(&x) && (0..height).contains(&y) {
                        let cell = &mut fine[(y * width + x) as usize];
                        *cell = (*cell).max(value);
                    }
                }
            }
        }
        let mut open = vec![false; (width * height) as usize];
        let reach = (config.relocalize.near_node_m / f64::from(cell_m)).ceil() as i32;
        for (_, pose) in posed() {
            let [x, y] = cell([pose.x_m as f32, pose.y_m as f32]);
            for y in (y - reach).max(0)..(y + reach + 1).min(height) {
                let row = (y * width) as usize;
                let from = (x - reach).clamp(0, width) as usize;
                let to = (x + reach + 1).clamp(0, width) as usize;
                open[row + from..row + to.max(from)].fill(true);
            }
        }
        let all_around = posed().filter(|(node, _)| sees_all_around(&node.cloud)).count();
        let sees_all_around = all_around * 2 > posed().count();
        let mut whole = Self { cell_m, corner, width, height, levels: vec![fine], open, sees_all_around };
        (1..LEVELS).for_each(|level| whole.add_level(level));
        whole
    }

    /// Builds a level from the one below: the maximum of four windows of half the size.
    fn add_level(&mut self, level: usize) {
        let (half, pad, below_pad) = (1 << (level - 1), (1 << level) - 1, (1 << (level - 1)) - 1);
        let (w, h) = (self.width + pad, self.height + pad);
        let below_width = self.width + below_pad;
        let below = &self.levels[level - 1];
        let at = |x: i32, y: i32| {
            let (x, y) = (x + below_pad, y + below_pad);
            let inside = (0..below_width).contains(&x) && (0..self.height + below_pad).contains(&y);
            if inside { below[(y * below_width + x) as usize] } else { 0 }
        };
        let mut cells = Vec::with_capacity((w * h) as usize);
        for y in -pad..self.height {
            for x in -pad..self.width {
                cells.push(at(x, y).max(at(x + half, y)).max(at(x, y + half)).max(at(x + half, y + half)));
            }
        }
        self.levels.push(cells);
    }

    /// Upper bound, 0 to 1, of the mean value under the rotated points for offsets in
    /// [x, x + 2^level) x [y, y + 2^level); 0 if it cannot reach `least`.
    fn score(&self, points: &[[i16; 2]], x: i32, y: i32, level: usize, least: f32) -> f32 {
        let pad = (1 << level) - 1;
        let (w, h) = (self.width + pad, self.height + pad);
        let cells = &self.levels[level];
        let all = 255 * points.len() as u32;
        let needed = (least * all as f32) as u32;
        let (mut sum, mut left) = (0_u32, all);
        for part in points.chunks(SCORE_CHUNK) {
            for p in part {
                let (cx, cy) = (i32::from(p[0]) + x + pad, i32::from(p[1]) + y + pad);
                if (cx as u32) < w as u32 && (cy as u32) < h as u32 {
                    sum += u32::from(cells[(cy * w + cx) as usize]);
                }
            }
            left -= 255 * part.len() as u32;
            if sum + left < needed {
                return 0.0;
            }
        }
        sum as f32 / all as f32
    }

    /// The best poses for points around a robot, at most `places_max`, and whether the search stopped before all were
    /// found.
    pub fn search(
        &self,
        points: &[[f32; 2]],
        bounds: Option<Bounds>,
        config: &RelocalizeConfig,
    ) -> (Vec<Pose2>, bool) {
        let headings = Headings::new(points, bounds, self.cell_m);
        let mut search = BranchAndBound {
            whole: self,
            bounds,
            least: config.response_min,
            evaluations: 0,
            open: BinaryHeap::new(),
        };
        let stride = 1 << (LEVELS - 1);
        for turn in headings.turns() {
            for y in (0..self.height).step_by(stride as usize) {
                for x in (0..self.width).step_by(stride as usize) {
                    search.try_block(headings.points(turn), Block { level: LEVELS - 1, turn, x, y });
                }
            }
        }
        let mut places: Vec<Pose2> = Vec::new();
        while let Some((bound, core::cmp::Reverse(block))) = search.open.pop() {
            if f32::from_bits(bound) < search.least {
                break;
            }
            if search.evaluations > config.evaluations_max {
                return (places, true);
            }
            if block.level > 0 {
                let half = 1 << (block.level - 1);
                for (dx, dy) in [(0, 0), (half, 0), (0, half), (half, half)] {
                    let child = Block { level: block.level - 1, x: block.x + dx, y: block.y + dy, ..block };
                    search.try_block(headings.points(block.turn), child);
                }
                continue;
            }
            let pose = self.pose(block, headings.yaw_rad(block.turn));
            if places.iter().all(|other| !is_same_place(*other, pose)) {
                if places.is_empty() {
                    search.least = search.least.max(config.candidate_ratio_min * f32::from_bits(bound));
                }
                places.push(pose);
                if places.len() == config.places_max {
                    return (places, true);
                }
            }
        }
        (places, false)
    }

    /// Pose of a finest block's cell centre in the map.
    fn pose(&self, block: Block, yaw_rad: f64) -> Pose2 {
        let at =
            |corner: f32, cell: i32| f64::from(corner) + (f64::from(cell) + 0.5) * f64::from(self.cell_m);
        Pose2::new(at(self.corner[0], block.x), at(self.corner[1], block.y), wrap_angle(yaw_rad))
    }
}

/// The headings of a search, and the points rotated by each.
struct Headings {
    centre_rad: f64,
    half_rad: f64,
    /// Number of steps of heading on each side of the centre.
    steps: i32,
    /// The first step: a full turn begins where it ends.
    first: i32,
    /// Number of points.
    count: usize,
    /// Offsets of the rotated points from the robot in cells, heading by heading.
    cells: Vec<[i16; 2]>,
}

impl Headings {
    fn new(points: &[[f32; 2]], bounds: Option<Bounds>, cell_m: f32) -> Self {
        let ranges_m = points.iter().map(|p| p[0].hypot(p[1]));
        let radius_m = ranges_m.fold(0.0, f32::max).clamp(RADIUS_MIN_M, RADIUS_MAX_M);
        let (centre_rad, half_rad) = bounds.map_or((0.0, core::f64::consts::PI), |b| {
            (b.centre.yaw_rad, b.half_rad.min(core::f64::consts::PI))
        });
        let steps = (half_rad / f64::from(cell_m / radius_m)).ceil().max(1.0) as i32;
        let first = if bounds.is_some() { -steps } else { 1 - steps };
        let count = points.len();
        let cells = Vec::with_capacity(count * (2 * steps + 1) as usize);
        let mut headings = Self { centre_rad, half_rad, steps, first, count, cells };
        for turn in headings.turns() {
            let rotation = PointTransform::new(Pose2::new(0.0, 0.0, headings.yaw_rad(turn)));
            let to_cell = |v: f32| floor_i32(v / cell_m).clamp(-OFFSET_MAX, OFFSET_MAX) as i16;
            headings.cells.extend(points.iter().map(|p| rotation.point(*p).map(to_cell)));
        }
        headings
    }

    /// Indices of the headings.
    fn turns(&self) -> core::ops::RangeInclusive<i32> {
        self.first..=self.steps
    }

    /// A heading by its index, radians.
    fn yaw_rad(&self, turn: i32) -> f64 {
        self.centre_rad + self.half_rad * f64::from(turn) / f64::from(self.steps)
    }

    /// The points rotated by a heading, in cells.
    fn points(&self, turn: i32) -> &[[i16; 2]] {
        &self.cells[(turn - self.first) as usize * self.count..][..self.count]
    }
}

/// A node of the search tree: one heading, and positions in cells [x, x + 2^level) x [y, y + 2^level).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Block {
    level: usize,
    turn: i32,
    x: i32,
    y: i32,
}

/// State of one search.
struct BranchAndBound<'a> {
    whole: &'a WholeMap,
    bounds: Option<Bounds>,
    least: f32,
    evaluations: usize,
    /// Blocks to be searched, by bound (positive floats order as their bits), then finer levels first.
    open: BinaryHeap<(u32, core::cmp::Reverse<Block>)>,
}

impl BranchAndBound<'_> {
    /// Bounds a block's score and queues it if it may contain a pose with the least score.
    fn try_block(&mut self, points: &[[i16; 2]], block: Block) {
        if !self.may_be_here(block) {
            return;
        }
        self.evaluations += 1;
        let bound = self.whole.score(points, block.x, block.y, block.level, self.least);
        if bound >= self.least {
            self.open.push((bound.to_bits(), core::cmp::Reverse(block)));
        }
    }

    /// Whether a robot may be anywhere in the block.
    fn may_be_here(&self, block: Block) -> bool {
        let map = self.whole;
        let side = 1 << block.level;
        let (right, top) = ((block.x + side).min(map.width), (block.y + side).min(map.height));
        if block.x >= map.width || block.y >= map.height {
            return false;
        }
        if let Some(bounds) = self.bounds {
            let outside = |low: i32, high: i32, corner: f32, centre: f64| {
                let metres = |cell: i32| f64::from(corner) + f64::from(cell) * f64::from(map.cell_m);
                metres(low) > centre + bounds.half_m || metres(high) < centre - bounds.half_m
            };
            if outside(block.x, right, map.corner[0], bounds.centre.x_m)
                || outside(block.y, top, map.corner[1], bounds.centre.y_m)
            {
                return false;
            }
        }
        let step = (side / OPEN_SAMPLES).max(1);
        (block.y..top)
            .step_by(step as usize)
            .any(|y| (block.x..right).step_by(step as usize).any(|x| map.open[(y * map.width + x) as usize]))
    }
}

/// Whether a scan has returns behind the robot as well as before it.
fn sees_all_around(cloud: &Cloud) -> bool {
    let seen = cloud.parts().3;
    let used = seen.chunks(EIGHTH_BEARINGS).filter(|eighth| eighth.iter().any(|cm| *cm != 0)).count();
    used >= EIGHTHS_ALL_AROUND
}
