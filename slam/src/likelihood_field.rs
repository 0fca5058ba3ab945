//! Likelihood field and correlative scan matching in it.
//!
//! A cell's value falls with its distance from the closest surface. Coarser levels bound the finer ones from above, so
//! branch and bound finds the best pose of a window (Olson, "Real-time correlative scan matching", ICRA 2009;
//! Hess et al., "Real-time loop closure in 2D LIDAR SLAM", ICRA 2016, section V-B).

use crate::cloud::{Cloud, floor_i32};
use crate::point_transform::PointTransform;
use msg::Pose2;

/// Levels of the pyramid: a cell of the last one is 2^5 = 32 fine cells wide.
const LEVELS: usize = 6;
/// Largest point distance that the steps of heading are chosen for, metres: farther points would cost many more.
const RADIUS_MAX_M: f32 = 10.0;
/// Largest half side of the blur, cells: bounds the cost of inserting a point.
const KERNEL_MAX: i32 = 8;
/// Half side of the blur in standard deviations: beyond them its value is below [`KERNEL_VALUE_MIN`].
const KERNEL_SIGMAS: f32 = 2.5;
/// Least value of the blur that is drawn, of 255: smaller ones cost time and hardly change a score.
const KERNEL_VALUE_MIN: u8 = 12;
/// Range of a point's cell coordinates, cells: it is stored in 16 bits.
const CELL_RANGE: core::ops::RangeInclusive<i32> = -8000..=16000;

/// A square likelihood field with its pyramid, in the frame of the inserted points.
#[derive(Clone, Debug)]
pub struct LikelihoodField {
    cell_m: f32,
    /// Lower left corner, metres.
    corner: [f32; 2],
    /// Level 0: likelihood of a surface, 0..=255. Level h: the maximum over the 2 x 2 blocks of
    /// 2^h fine cells that begin here, which bounds every shift of less than 2^h cells.
    levels: Vec<Level>,
    kernel: Vec<(i32, i32, u8)>,
}

#[derive(Clone, Debug)]
struct Level {
    side: i32,
    cells: Vec<u8>,
}

impl Level {
    /// Value of a cell; 0 outside.
    fn at(&self, x: i32, y: i32) -> u8 {
        let inside = (x as u32) < self.side as u32 && (y as u32) < self.side as u32;
        if inside { self.cells[(y * self.side + x) as usize] } else { 0 }
    }

    /// Raises a cell to at least this value.
    fn raise(&mut self, x: i32, y: i32, value: u8) {
        if (x as u32) < self.side as u32 && (y as u32) < self.side as u32 {
            let cell = &mut self.cells[(y * self.side + x) as usize];
            *cell = (*cell).max(value);
        }
    }
}

/// Window of poses that a search covers.
#[derive(Clone, Copy, Debug)]
pub struct SearchWindow {
    /// Pose at the window's centre: the points' frame in the field's frame.
    pub centre: Pose2,
    /// Half side of the window, metres.
    pub half_m: f64,
    /// Half range of headings, radians.
    pub half_rad: f64,
    /// Score lost at the window's corners, relative to the centre: breaks ties towards the predicted pose.
    pub prediction_weight: f32,
}

/// The best pose of a window.
#[derive(Clone, Copy, Debug)]
pub struct SearchPeak {
    /// Pose of the points' frame in the field's frame.
    pub pose: Pose2,
    /// Mean field value under the points, 0 to 1, less the penalty for the distance from the prediction.
    pub score: f32,
}

/// What a search of a window found.
#[derive(Clone, Copy, Debug)]
pub struct SearchOutcome {
    /// The best pose, if one scored enough; the best so far if the search has given up.
    pub peak: Option<SearchPeak>,
    /// Whether the search stopped at `evaluations_max`: a better pose, or the only one, may not have been found.
    pub given_up: bool,
}

/// Limits of a search.
#[derive(Clone, Copy, Debug)]
pub struct SearchLimits {
    /// Least score of a result, 0 to 1.
    pub score_min: f32,
    /// Most candidates to be evaluated: bounds the search's time.
    pub evaluations_max: usize,
    /// Excludes poses around this one, within metres and radians: set to look for another place that scores nearly as
    /// well as the best pose.
    pub excluded: Option<(Pose2, f64, f64)>,
}

impl LikelihoodField {
    /// An empty field with sides of `2 * reach_m`, metres.
    pub fn new(cell_m: f32, reach_m: f32, blur_m: f32) -> Self {
        let side = (2.0 * reach_m / cell_m).ceil() as i32;
        let levels = (0..LEVELS)
            .map(|h| {
                let side = (side >> h) + 2;
                Level { side, cells: vec![0; (side * side) as usize] }
            })
            .collect();
        Self { cell_m, corner: [0.0; 2], levels, kernel: kernel(cell_m, blur_m) }
    }

    /// Empties the field and moves its centre, metres.
    pub fn clear(&mut self, centre: [f64; 2]) {
        let reach = self.levels[0].side as f32 * self.cell_m / 2.0;
        self.corner = [centre[0] as f32 - reach, centre[1] as f32 - reach];
        for level in &mut self.levels {
            level.cells.fill(0);
        }
    }

    /// Adds a scan's surface points.
    pub fn insert(&mut self, cloud: &Cloud, frame_from_cloud: Pose2) {
        let transform = PointTransform::new(frame_from_cloud);
        for p in cloud.points() {
            let [x, y] = transform.point(p.at);
            let x = floor_i32((x - self.corner[0]) / self.cell_m);
            let y = floor_i32((y - self.corner[1]) / self.cell_m);
            self.stamp(x, y);
        }
    }

    fn stamp(&mut self, x: i32, y: i32) {
        for &(dx, dy, value) in &self.kernel {
            let (fine, coarse) = self.levels.split_at_mut(1);
            let (x, y) = (x + dx, y + dy);
            let before = fine[0].at(x, y);
            if before >= value || x < 0 || y < 0 {
                continue;
            }
            fine[0].raise(x, y, value);
            for (h, level) in coarse.iter_mut().enumerate() {
                let (bx, by) = (x >> (h + 1), y >> (h + 1));
                for (sx, sy) in [(0, 0), (-1, 0), (0, -1), (-1, -1)] {
                    level.raise(bx + sx, by + sy, value);
                }
            }
        }
    }

    /// The best pose of the window for `points`, if one scores at least `score_min`.
    pub fn search(
        &self,
        points: &[[f32; 2]],
        window: &SearchWindow,
        limits: &SearchLimits,
        scratch: &mut SearchBuffers,
    ) -> SearchOutcome {
        if points.is_empty() {
            return SearchOutcome { peak: None, given_up: false };
        }
        let radius = points.iter().map(|p| p[0].hypot(p[1])).fold(0.0, f32::max).clamp(1.0, RADIUS_MAX_M);
        let step_rad = f64::from(self.cell_m / radius);
        let turns = (window.half_rad / step_rad).ceil() as i32;
        let reach = (window.half_m / f64::from(self.cell_m)).ceil() as i32;
        let top = top_level(reach);
        scratch.rotate(self, points, window.centre, turns, step_rad);
        let mut search = BranchAndBound {
            field: self,
            window,
            limits,
            scratch_cells: &scratch.cells,
            count: points.len(),
            turns,
            step_rad,
            reach,
            best: None,
            best_score: limits.score_min,
            evaluations: 0,
        };
        scratch.queue.clear();
        search.seed(top, &mut scratch.queue);
        // Best first; equal scores in the order of their numbers, so that a search can be repeated.
        scratch.queue.sort_unstable_by(|a, b| b.bound.total_cmp(&a.bound).then(a.key().cmp(&b.key())));
        for candidate in &scratch.queue {
            if candidate.bound <= search.best_score || search.evaluations > limits.evaluations_max {
                break;
            }
            search.descend(*candidate, top);
        }
        let given_up = search.evaluations > limits.evaluations_max;
        let (best, score) = (search.best, search.best_score);
        let peak = best.map(|c| SearchPeak { pose: self.pose_of(window, c, step_rad), score });
        SearchOutcome { peak, given_up }
    }

    fn pose_of(&self, window: &SearchWindow, c: Candidate, step_rad: f64) -> Pose2 {
        let cell = f64::from(self.cell_m);
        Pose2::new(
            window.centre.x_m + f64::from(c.x) * cell,
            window.centre.y_m + f64::from(c.y) * cell,
            msg::pose::wrap_angle(window.centre.yaw_rad + f64::from(c.turn) * step_rad),
        )
    }
}

/// Gaussian of one point over the cells around it, largest value first: (x, y, likelihood).
pub(crate) fn kernel(cell_m: f32, blur_m: f32) -> Vec<(i32, i32, u8)> {
    let half = ((KERNEL_SIGMAS * blur_m / cell_m).ceil() as i32).min(KERNEL_MAX);
    let mut kernel = Vec::new();
    for y in -half..=half {
        for x in -half..=half {
            let squared = ((x * x + y * y) as f32) * cell_m * cell_m;
            let value = (255.0 * (-0.5 * squared / (blur_m * blur_m)).exp()) as u8;
            if value >= KERNEL_VALUE_MIN {
                kernel.push((x, y, value));
            }
        }
    }
    // Strongest first: weaker values then find their cells already raised.
    kernel.sort_by_key(|k| core::cmp::Reverse(k.2));
    kernel
}

/// A node of the search tree: a heading and an offset in cells, with an upper bound of the score.
#[derive(Clone, Copy, Debug)]
struct Candidate {
    turn: i32,
    x: i32,
    y: i32,
    bound: f32,
}

impl Candidate {
    fn key(&self) -> (i32, i32, i32) {
        (self.turn, self.x, self.y)
    }
}

/// Buffers that searches reuse, so that they do not allocate.
#[derive(Clone, Debug, Default)]
pub struct SearchBuffers {
    /// Points in cells of level 0, heading by heading.
    cells: Vec<[i16; 2]>,
    queue: Vec<Candidate>,
}

impl SearchBuffers {
    /// Buffers for searches of up to `points` points in windows of up to `half_m` and `half_rad`, in cells of `cell_m`.
    pub fn with_capacity(points: usize, half_m: f64, half_rad: f64, cell_m: f32) -> Self {
        // The steps of heading are finest at the largest point distance.
        let turns = 2 * (half_rad / f64::from(cell_m / RADIUS_MAX_M)).ceil() as usize + 1;
        let reach = (half_m / f64::from(cell_m)).ceil() as i32;
        let blocks = ((2 * reach as usize) >> top_level(reach)) + 1;
        Self { cells: Vec::with_capacity(points * turns), queue: Vec::with_capacity(blocks * blocks * turns) }
    }

    /// Rotates the points by every heading of the window.
    fn rotate(
        &mut self,
        field: &LikelihoodField,
        points: &[[f32; 2]],
        centre: Pose2,
        turns: i32,
        step_rad: f64,
    ) {
        self.cells.clear();
        for turn in -turns..=turns {
            let yaw = centre.yaw_rad + f64::from(turn) * step_rad;
            let field_from_points = PointTransform::new(Pose2::new(
                centre.x_m - f64::from(field.corner[0]),
                centre.y_m - f64::from(field.corner[1]),
                yaw,
            ));
            let per_m = 1.0 / field.cell_m;
            let to_cell = |v: f32| floor_i32(v * per_m).clamp(*CELL_RANGE.start(), *CELL_RANGE.end()) as i16;
            self.cells.extend(points.iter().map(|p| field_from_points.point(*p).map(to_cell)));
        }
    }
}

/// The coarsest level whose cells are not wider than the window's half side.
fn top_level(reach: i32) -> usize {
    (0..LEVELS).rev().find(|h| (1 << h) <= reach.max(1)).unwrap_or(0)
}

/// State of one search.
struct BranchAndBound<'a> {
    field: &'a LikelihoodField,
    window: &'a SearchWindow,
    limits: &'a SearchLimits,
    scratch_cells: &'a [[i16; 2]],
    count: usize,
    turns: i32,
    step_rad: f64,
    reach: i32,
    best: Option<Candidate>,
    best_score: f32,
    evaluations: usize,
}

impl BranchAndBound<'_> {
    /// Queues the blocks of the coarsest level.
    fn seed(&mut self, top: usize, queue: &mut Vec<Candidate>) {
        let stride = 1 << top;
        for turn in -self.turns..=self.turns {
            let mut y = -self.reach;
            while y <= self.reach {
                let mut x = -self.reach;
                while x <= self.reach {
                    let bound = self.score(turn, x, y, top);
                    if bound > self.best_score {
                        queue.push(Candidate { turn, x, y, bound });
                    }
                    x += stride;
                }
                y += stride;
            }
        }
    }

    /// An upper bound on the score of every shift in [x, x + 2^level) x [y, y + 2^level).
    fn score(&mut self, turn: i32, x: i32, y: i32, level: usize) -> f32 {
        self.evaluations += 1;
        let start = (turn + self.turns) as usize * self.count;
        let grid = &self.field.levels[level];
        let mut sum = 0_u32;
        for cell in &self.scratch_cells[start..start + self.count] {
            let (cx, cy) = ((i32::from(cell[0]) + x) >> level, (i32::from(cell[1]) + y) >> level);
            sum += u32::from(grid.at(cx, cy));
        }
        sum as f32 / (255 * self.count) as f32 - self.prediction_penalty(turn, x, y, level)
    }

    /// Least score that a pose of the block loses for its distance from the prediction.
    fn prediction_penalty(&self, turn: i32, x: i32, y: i32, level: usize) -> f32 {
        let nearest = |low: i32| {
            let high = low + (1 << level) - 1;
            if low > 0 { low } else { high.min(0) }
        };
        let (x, y) = (nearest(x) as f32, nearest(y) as f32);
        let reach = self.reach.max(1) as f32;
        let turned = turn as f32 / self.turns.max(1) as f32;
        self.window.prediction_weight * ((x * x + y * y) / (2.0 * reach * reach) + turned * turned) / 2.0
    }

    /// Searches a block depth first, best child first.
    fn descend(&mut self, candidate: Candidate, level: usize) {
        if level == 0 {
            if candidate.bound > self.best_score && !self.is_excluded(candidate) {
                self.best_score = candidate.bound;
                self.best = Some(candidate);
            }
            return;
        }
        let half = 1 << (level - 1);
        let mut children = [candidate; 4];
        for (i, child) in children.iter_mut().enumerate() {
            child.x += if i & 1 == 1 { half } else { 0 };
            child.y += if i & 2 == 2 { half } else { 0 };
            let inside = child.x <= self.reach && child.y <= self.reach;
            child.bound = if inside { self.score(child.turn, child.x, child.y, level - 1) } else { f32::MIN };
        }
        children.sort_by(|a, b| b.bound.total_cmp(&a.bound));
        for child in children {
            if child.bound > self.best_score && self.evaluations <= self.limits.evaluations_max {
                self.descend(child, level - 1);
            }
        }
    }

    /// Whether a pose lies in the excluded surroundings.
    fn is_excluded(&self, candidate: Candidate) -> bool {
        self.limits.excluded.is_some_and(|(pose, near_m, near_rad)| {
            let here = self.field.pose_of(self.window, candidate, self.step_rad);
            let turned = msg::pose::wrap_angle(here.yaw_rad - pose.yaw_rad).abs();
            here.distance_m(pose) < near_m && turned < near_rad
        })
    }
}
