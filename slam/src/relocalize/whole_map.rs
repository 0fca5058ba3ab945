//! The places in a whole map where points around a robot lie on walls.
//!
//! Branch and bound over all places and headings (Hess et al., "Real-time loop closure in 2D LIDAR
//! SLAM", ICRA 2016, section V-B: every level holds the maximum over the window that a cell stands
//! for, so that a coarse score is never below a finer one), best first.

use super::{Placed, same};
use crate::cloud::{Cloud, PointTransform, floor_i32};
use crate::config::{RelocalizeConfig, SlamConfig};
use crate::likelihood_field::kernel;
use msg::{Pose2, pose::wrap_angle};
use std::collections::BinaryHeap;

/// Levels of the map's pyramid: a cell of the last one stands for 2^5 = 32 fine cells.
const LEVELS: usize = 6;
/// The map's cells grow, to twice the side, until they are not more than this: a ninth of the time in a large map,
/// where the places that are found are the same; in a small one they would be found later.
const CELLS_QUICK: f32 = 32_768.0;
/// And on, until they are not more than this.
const CELLS_MAX: f32 = 2_097_152.0;

/// Side of the cells of a map of this area, m2.
fn cell_side_m(fine_m: f32, area_m2: f32) -> f32 {
    let side_m = |cells: f32| (area_m2 / cells).sqrt();
    side_m(CELLS_QUICK).clamp(fine_m, 2.0 * fine_m).max(side_m(CELLS_MAX))
}

/// Where to look.
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
    /// Whether a robot may be here: near a place where a scan was taken.
    open: Vec<bool>,
    /// How much a turn of a viewpoint counts against a metre: little if scans see all around.
    pub turn_weight_m: f64,
}

impl WholeMap {
    pub fn new(config: &SlamConfig, map: Placed<'_>) -> Self {
        let placed = || map.nodes.iter().zip(map.poses).filter(|(node, _)| node.in_map());
        let (mut low, mut high) = ([f32::MAX; 2], [f32::MIN; 2]);
        for (node, pose) in placed() {
            let place = PointTransform::new(*pose);
            for p in node.cloud.points().iter().map(|p| p.at).chain([[0.0; 2]]) {
                let at = place.point(p);
                for k in 0..2 {
                    (low[k], high[k]) = (low[k].min(at[k]), high[k].max(at[k]));
                }
            }
        }
        if low[0] > high[0] {
            (low, high) = ([0.0; 2], [0.0; 2]);
        }
        let margin = 1.0;
        let size = [0, 1].map(|k| high[k] - low[k] + 2.0 * margin);
        let cell_m = cell_side_m(config.tracking.cell_m, size[0] * size[1]);
        let corner = low.map(|v| v - margin);
        let [width, height] = size.map(|s| (s / cell_m).ceil() as i32 + 1);
        let mut fine = vec![0_u8; (width * height) as usize];
        let kernel = kernel(cell_m, config.tracking.blur_m.max(cell_m));
        let cell = |at: [f32; 2]| [0, 1].map(|k| floor_i32((at[k] - corner[k]) / cell_m));
        for (node, pose) in placed() {
            let place = PointTransform::new(*pose);
            for p in node.cloud.points() {
                let [x, y] = cell(place.point(p.at));
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
        for (_, pose) in placed() {
            let [x, y] = cell([pose.x_m as f32, pose.y_m as f32]);
            for y in (y - reach).max(0)..(y + reach + 1).min(height) {
                let row = (y * width) as usize;
                let from = (x - reach).clamp(0, width) as usize;
                let to = (x + reach + 1).clamp(0, width) as usize;
                open[row + from..row + to.max(from)].fill(true);
            }
        }
        let all_around =
            placed().filter(|(node, _)| sees_all_around(&node.cloud)).count() * 2 > map.nodes.len();
        let turn_weight_m = if all_around { 0.2 } else { 1.5 };
        let mut whole = Self { cell_m, corner, width, height, levels: vec![fine], open, turn_weight_m };
        (1..LEVELS).for_each(|level| whole.raise(level));
        whole
    }

    /// Builds a level from the one below: the maximum of four windows of half the size.
    fn raise(&mut self, level: usize) {
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

    /// Mean value under the turned points shifted by anything in [x, x + 2^level) x [y, y + 2^level),
    /// or less than `least` if it cannot reach it.
    fn score(&self, points: &[[i16; 2]], x: i32, y: i32, level: usize, least: f32) -> f32 {
        let pad = (1 << level) - 1;
        let (w, h) = (self.width + pad, self.height + pad);
        let cells = &self.levels[level];
        let all = 255 * points.len() as u32;
        let needed = (least * all as f32) as u32;
        let (mut sum, mut left) = (0_u32, all);
        for part in points.chunks(32) {
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

    /// The best places for points around a robot, at most `places_max`, and whether the search was
    /// given up before all were found.
    pub fn search(
        &self,
        points: &[[f32; 2]],
        bounds: Option<Bounds>,
        config: &RelocalizeConfig,
    ) -> (Vec<Pose2>, bool) {
        let radius = points.iter().map(|p| p[0].hypot(p[1])).fold(0.0, f32::max).clamp(1.0, 10.0);
        let (centre_rad, half_rad) = bounds.map_or((0.0, core::f64::consts::PI), |b| {
            (b.centre.yaw_rad, b.half_rad.min(core::f64::consts::PI))
        });
        let turns = (half_rad / f64::from(self.cell_m / radius)).ceil().max(1.0) as i32;
        let yaw = |turn: i32| centre_rad + half_rad * f64::from(turn) / f64::from(turns);
        // A full turn begins where it ends.
        let first = if bounds.is_some() { -turns } else { 1 - turns };
        let count = points.len();
        let mut cells: Vec<[i16; 2]> = Vec::with_capacity(count * (2 * turns + 1) as usize);
        for turn in first..=turns {
            let place = PointTransform::new(Pose2::new(0.0, 0.0, yaw(turn)));
            let to_cell = |v: f32| floor_i32(v / self.cell_m).clamp(-16_000, 16_000) as i16;
            cells.extend(points.iter().map(|p| place.point(*p).map(to_cell)));
        }
        let turned = |turn: i32| &cells[(turn - first) as usize * count..][..count];
        let mut search = BranchAndBound {
            whole: self,
            bounds,
            least: config.response_min,
            evaluations: 0,
            open: BinaryHeap::new(),
        };
        let stride = 1 << (LEVELS - 1);
        for turn in first..=turns {
            for y in (0..self.height).step_by(stride as usize) {
                for x in (0..self.width).step_by(stride as usize) {
                    search.try_block(turned(turn), Block { level: LEVELS - 1, turn, x, y });
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
                    search.try_block(turned(block.turn), child);
                }
                continue;
            }
            let pose = self.pose(block, yaw(block.turn));
            if places.iter().all(|place| !same(*place, pose)) {
                if places.is_empty() {
                    search.least = search.least.max(config.rival_share * f32::from_bits(bound));
                }
                places.push(pose);
                if places.len() == config.places_max {
                    return (places, true);
                }
            }
        }
        (places, false)
    }

    fn pose(&self, block: Block, yaw_rad: f64) -> Pose2 {
        let at =
            |corner: f32, cell: i32| f64::from(corner) + (f64::from(cell) + 0.5) * f64::from(self.cell_m);
        Pose2::new(at(self.corner[0], block.x), at(self.corner[1], block.y), wrap_angle(yaw_rad))
    }
}

/// Shifts of the turned points: the robot's cell is in [x, x + 2^level) x [y, y + 2^level).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Block {
    level: usize,
    turn: i32,
    x: i32,
    y: i32,
}

struct BranchAndBound<'a> {
    whole: &'a WholeMap,
    bounds: Option<Bounds>,
    least: f32,
    evaluations: usize,
    /// By bound (a positive float's bits are in its order), then finer levels first.
    open: BinaryHeap<(u32, core::cmp::Reverse<Block>)>,
}

impl BranchAndBound<'_> {
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
        // Open places are squares of metres: their corners and middles on a coarse lattice tell.
        let step = (side / 4).max(1);
        (block.y..top)
            .step_by(step as usize)
            .any(|y| (block.x..right).step_by(step as usize).any(|x| map.open[(y * map.width + x) as usize]))
    }
}

/// Whether a scan has returns behind the robot as well as before it.
fn sees_all_around(cloud: &Cloud) -> bool {
    let seen = cloud.parts().3;
    let used = seen.chunks(45).filter(|eighth| eighth.iter().any(|cm| *cm != 0)).count();
    used >= 6
}
