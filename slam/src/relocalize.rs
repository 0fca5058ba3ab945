//! Looks for a robot in a whole map, without knowing where it is or where it looks.
//!
//! Branch and bound over all places and headings (Hess et al., "Real-time loop closure in 2D LIDAR
//! SLAM", ICRA 2016, section V-B: every level holds the maximum over the window that a cell stands
//! for, so that a coarse score is never below a finer one), best first. Not the best place alone is
//! looked at: all that score nearly as well are aligned and asked whether their scans contradict
//! what the robot sees. One must remain, and a second search from elsewhere must find the same.

use crate::align::{Reference, align};
use crate::closure::{JUDGES, judge};
use crate::cloud::{Cloud, Placement, floor_i32};
use crate::config::{RelocalizeConfig, SlamConfig};
use crate::field::kernel;
use crate::node::Node;
use msg::{Pose2, pose::wrap_angle};
use std::collections::{BinaryHeap, VecDeque};

/// Levels of the map's pyramid: a cell of the last one stands for 2^5 = 32 fine cells.
const LEVELS: usize = 6;
/// The map's cells grow, to twice the side, until they are not more than this: a ninth of the time in a large map,
/// where the places that are found are the same; in a small one they would be found later.
const CELLS_QUICK: f32 = 32_768.0;
/// And on, until they are not more than this.
const CELLS_MAX: f32 = 2_097_152.0;
/// Points of the query.
const POINTS_MAX: usize = 300;
/// Nodes that wait for their robot to be found; beyond them the oldest are dropped.
const WAITING_MAX: usize = 128;
/// Places nearer to each other than this are one.
const SAME_M: f64 = 0.6;
const SAME_RAD: f64 = 0.2;
/// After so many searches in vain the way between two of them is twice as long, after so many more
/// three times, ...
const SEARCHES_OFTEN: f64 = 12.0;
/// ... up to so many times.
const RARELY_MAX: f64 = 2.0;
/// Searches whose outcome is remembered.
const PENDING_MAX: usize = 16;

/// Where the scan path's frame lies in the map, as somebody says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hint {
    /// The map from the scan path's frame.
    pub map_from_local: Pose2,
    /// One standard deviation of the robot's position, metres.
    pub sigma_m: f64,
    /// And of its heading, radians.
    pub sigma_rad: f64,
}

/// How searches for the robot ended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct SeekCounts {
    /// Searches made.
    pub searches: u64,
    /// No place scores enough.
    pub no_response: u64,
    /// Every place that scores was contradicted.
    pub contradicted: u64,
    /// More than one place remained, or the search was given up.
    pub ambiguous: u64,
    /// One place remained.
    pub found: u64,
    /// Robots believed to be found.
    pub believed: u64,
    /// Nodes dropped while nothing was found.
    pub dropped: u64,
}

/// Nodes and where they lie.
#[derive(Clone, Copy)]
pub struct Placed<'a> {
    /// The nodes,
    pub nodes: &'a [Node],
    /// and the map from each.
    pub poses: &'a [Pose2],
}

/// A robot that is looked for.
pub struct Seeker {
    config: SlamConfig,
    whole: WholeMap,
    hint: Option<Hint>,
    /// The newest nodes since the search began.
    waiting: VecDeque<Node>,
    nodes: usize,
    way_m: f64,
    searched_m: Option<f64>,
    searched: u32,
    /// Finds that wait for a witness: the map from the scan path's frame, and the way when found.
    pending: VecDeque<(Pose2, f64)>,
    counts: SeekCounts,
}

/// What a seeker knows after a node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Sought {
    /// Nothing yet.
    Nothing,
    /// The map from the scan path's frame.
    Found(Pose2),
    /// Not found where it should be; the hint is taken for the truth.
    HintTaken(Hint),
}

impl Seeker {
    /// Of a robot in this map; the map must stay the same while it is looked for.
    pub fn new(config: SlamConfig, map: Placed<'_>, hint: Option<Hint>, counts: SeekCounts) -> Self {
        Self {
            whole: WholeMap::new(&config, map),
            hint,
            waiting: VecDeque::with_capacity(WAITING_MAX),
            nodes: 0,
            way_m: 0.0,
            searched_m: None,
            searched: 0,
            pending: VecDeque::with_capacity(PENDING_MAX),
            counts,
            config,
        }
    }

    /// Where it is said to be.
    pub fn hint(&self) -> Option<Hint> {
        self.hint
    }

    /// How searches ended.
    pub fn counts(&self) -> SeekCounts {
        self.counts
    }

    /// The nodes since the search began, oldest first; it has them no more.
    pub fn take_waiting(&mut self) -> VecDeque<Node> {
        core::mem::take(&mut self.waiting)
    }

    /// Looks at one more node.
    pub fn seek(&mut self, node: Node, map: Placed<'_>) -> Sought {
        let moved = self
            .waiting
            .back()
            .map_or(Pose2::IDENTITY, |last| last.local_from_base.between(node.local_from_base));
        self.way_m += moved.x_m.hypot(moved.y_m) + moved.yaw_rad.abs();
        if !node.fits {
            // What was seen before is tied to what is seen now by odometry alone,
            self.pending.clear();
        }
        if node.torn {
            // or not even by that.
            self.counts.dropped += self.waiting.len() as u64;
            self.waiting.clear();
        }
        self.nodes += 1;
        if self.waiting.len() == WAITING_MAX {
            self.waiting.pop_front();
            self.counts.dropped += 1;
        }
        self.waiting.push_back(node);
        let r = &self.config.relocalize;
        // A robot that is long not found is more rarely looked for.
        let rarely = 1.0 + (self.searched as f64 / SEARCHES_OFTEN).min(RARELY_MAX - 1.0).floor();
        if self.searched_m.is_none_or(|at| self.way_m - at >= rarely * r.travel_m) {
            self.searched += 1;
            self.searched_m = Some(self.way_m);
            if let Some(map_from_local) = self.search(map)
                && self.witnessed(map_from_local)
            {
                self.counts.believed += 1;
                return Sought::Found(map_from_local);
            }
        }
        match self.hint {
            Some(hint) if self.nodes >= self.config.relocalize.hint_nodes => Sought::HintTaken(hint),
            _ => Sought::Nothing,
        }
    }

    /// One search with the newest nodes. The map from the scan path's frame, if one place remains.
    fn search(&mut self, map: Placed<'_>) -> Option<Pose2> {
        let query = self.query()?;
        let newest = self.waiting.back()?;
        self.counts.searches += 1;
        let merged =
            Cloud::merged(query.iter().map(|(n, pose)| (&*n.cloud, *pose)), 4 * self.config.lidar.points_max);
        let stride = merged.points().len().div_ceil(POINTS_MAX).max(1);
        let points: Vec<[f32; 2]> = merged.points().iter().step_by(stride).map(|p| p.at).collect();
        let bounds = self.hint.map(|hint| Bounds {
            centre: hint.map_from_local * newest.local_from_base,
            half_m: 3.0 * hint.sigma_m,
            half_rad: 3.0 * hint.sigma_rad,
        });
        let (places, given_up) = self.whole.search(&points, bounds, &self.config.relocalize);
        if places.is_empty() {
            self.counts.no_response += 1;
            return None;
        }
        let mut remaining: Vec<Pose2> = Vec::new();
        for place in &places {
            if let Some(pose) = self.settle(map, &merged, &query, place.pose)
                && remaining.iter().all(|other| !same(*other, pose))
            {
                remaining.push(pose);
            }
        }
        match remaining[..] {
            [] => self.counts.contradicted += 1,
            [map_from_newest] if !given_up => {
                self.counts.found += 1;
                return Some(map_from_newest * newest.local_from_base.inverse());
            }
            _ => self.counts.ambiguous += 1,
        }
        None
    }

    /// The newest nodes as seen from the newest, as a closure's query; none if they see too little.
    fn query(&self) -> Option<Vec<(Node, Pose2)>> {
        let c = &self.config.closures;
        let newest = self.waiting.back()?;
        let mut way = 0.0;
        let mut query: Vec<(Node, Pose2)> = Vec::new();
        for node in self.waiting.iter().rev().take(c.query_nodes) {
            let pose = newest.local_from_base.between(node.local_from_base);
            way += query.last().map_or(0.0, |(_, last)| last.distance_m(pose));
            if way > c.query_m {
                break;
            }
            query.push((node.clone(), pose));
            if !node.fits {
                break;
            }
        }
        query.reverse();
        let points: usize = query.iter().map(|(n, _)| n.cloud.points().len()).sum();
        (points >= 4 * self.config.tracking.points_min).then_some(query)
    }

    /// Aligns the query at a place and asks the scans taken there whether they agree.
    fn settle(&self, map: Placed<'_>, merged: &Cloud, query: &[(Node, Pose2)], at: Pose2) -> Option<Pose2> {
        let r = &self.config.relocalize;
        let mut near: Vec<(f64, usize)> = (0..map.nodes.len())
            .filter(|&i| map.nodes[i].in_map())
            .map(|i| {
                let away = wrap_angle(map.poses[i].yaw_rad - at.yaw_rad).abs();
                (map.poses[i].distance_m(at) + self.whole.turn_weight_m * away, i)
            })
            .collect();
        near.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        near.truncate(JUDGES);
        let references = near
            .iter()
            .map(|&(_, i)| Reference { cloud: &map.nodes[i].cloud, frame_from_cloud: map.poses[i] });
        let fit = align(merged, at, references, None, &self.config.links);
        if fit.frame_from_cloud.distance_m(at) > 0.5 || fit.overlap < r.overlap_min {
            return None;
        }
        let chain: Vec<(&Node, Pose2)> = near.iter().map(|&(_, i)| (&map.nodes[i], map.poses[i])).collect();
        let seen: Vec<(&Node, Pose2)> = query.iter().map(|(node, pose)| (node, *pose)).collect();
        let (agree, contradict) = judge(chain.iter(), &seen, fit.frame_from_cloud);
        (agree as f32 >= r.agreement_min * (agree + contradict) as f32).then_some(fit.frame_from_cloud)
    }

    /// Whether enough earlier finds, from elsewhere, say the same. With a hint one is enough.
    fn witnessed(&mut self, map_from_local: Pose2) -> bool {
        let r = &self.config.relocalize;
        let newest = self.waiting.back().map_or(Pose2::IDENTITY, |n| n.local_from_base);
        let here = map_from_local * newest;
        let mut way_m = self.way_m;
        let mut agreeing = 1;
        for (other, at_m) in self.pending.iter().rev() {
            let there = *other * newest;
            let turned = wrap_angle(there.yaw_rad - here.yaw_rad).abs();
            if here.distance_m(there) < r.agree_m && turned < r.agree_rad && way_m - at_m >= r.apart_m {
                agreeing += 1;
                way_m = *at_m;
            }
        }
        if self.pending.len() == PENDING_MAX {
            self.pending.pop_front();
        }
        self.pending.push_back((map_from_local, self.way_m));
        self.hint.is_some() || agreeing >= r.witnesses
    }
}

/// Side of the cells of a map of this area, m2.
fn cell_side_m(fine_m: f32, area_m2: f32) -> f32 {
    let side_m = |cells: f32| (area_m2 / cells).sqrt();
    side_m(CELLS_QUICK).clamp(fine_m, 2.0 * fine_m).max(side_m(CELLS_MAX))
}

fn same(a: Pose2, b: Pose2) -> bool {
    a.distance_m(b) < SAME_M && wrap_angle(a.yaw_rad - b.yaw_rad).abs() < SAME_RAD
}

/// Where to look.
#[derive(Clone, Copy)]
struct Bounds {
    centre: Pose2,
    half_m: f64,
    half_rad: f64,
}

/// A place that scores.
#[derive(Clone, Copy)]
struct Place {
    pose: Pose2,
}

/// The whole map as a likelihood field with its pyramid.
struct WholeMap {
    cell_m: f32,
    corner: [f32; 2],
    width: i32,
    height: i32,
    /// Level h, cell (x, y): the maximum over [x, x + 2^h) x [y, y + 2^h), from -(2^h - 1) on.
    levels: Vec<Vec<u8>>,
    /// Whether a robot may be here: near a place where a scan was taken.
    open: Vec<bool>,
    /// How much a turn of a viewpoint counts against a metre: little if scans see all around.
    turn_weight_m: f64,
}

impl WholeMap {
    fn new(config: &SlamConfig, map: Placed<'_>) -> Self {
        let placed = || map.nodes.iter().zip(map.poses).filter(|(node, _)| node.in_map());
        let (mut low, mut high) = ([f32::MAX; 2], [f32::MIN; 2]);
        for (node, pose) in placed() {
            let place = Placement::new(*pose);
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
            let place = Placement::new(*pose);
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
    fn search(
        &self,
        points: &[[f32; 2]],
        bounds: Option<Bounds>,
        config: &RelocalizeConfig,
    ) -> (Vec<Place>, bool) {
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
            let place = Placement::new(Pose2::new(0.0, 0.0, yaw(turn)));
            let to_cell = |v: f32| floor_i32(v / self.cell_m).clamp(-16_000, 16_000) as i16;
            cells.extend(points.iter().map(|p| place.point(*p).map(to_cell)));
        }
        let turned = |turn: i32| &cells[(turn - first) as usize * count..][..count];
        let mut hunt =
            Hunt { whole: self, bounds, least: config.response_min, evaluations: 0, open: BinaryHeap::new() };
        let stride = 1 << (LEVELS - 1);
        for turn in first..=turns {
            for y in (0..self.height).step_by(stride as usize) {
                for x in (0..self.width).step_by(stride as usize) {
                    hunt.try_block(turned(turn), Block { level: LEVELS - 1, turn, x, y });
                }
            }
        }
        let mut places: Vec<Place> = Vec::new();
        while let Some((bound, core::cmp::Reverse(block))) = hunt.open.pop() {
            if f32::from_bits(bound) < hunt.least {
                break;
            }
            if hunt.evaluations > config.evaluations_max {
                return (places, true);
            }
            if block.level > 0 {
                let half = 1 << (block.level - 1);
                for (dx, dy) in [(0, 0), (half, 0), (0, half), (half, half)] {
                    let child = Block { level: block.level - 1, x: block.x + dx, y: block.y + dy, ..block };
                    hunt.try_block(turned(block.turn), child);
                }
                continue;
            }
            let pose = self.pose(block, yaw(block.turn));
            if places.iter().all(|place| !same(place.pose, pose)) {
                if places.is_empty() {
                    hunt.least = hunt.least.max(config.rival_share * f32::from_bits(bound));
                }
                places.push(Place { pose });
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

struct Hunt<'a> {
    whole: &'a WholeMap,
    bounds: Option<Bounds>,
    least: f32,
    evaluations: usize,
    /// By bound (a positive float's bits are in its order), then finer levels first.
    open: BinaryHeap<(u32, core::cmp::Reverse<Block>)>,
}

impl Hunt<'_> {
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
