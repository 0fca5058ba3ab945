//! Viewpoints: places from which much unknown space is expected to be seen, and the headings to look at there.
//!
//! The expected new area is that of unknown cells on rays of the sensor, as in next-best-view exploration
//! (González-Baños and Latombe 2002). Viewpoints are chosen one after the other, each for the area that those before it
//! do not show (greedy set cover).

use super::config::CoordinationConfig;
use crate::clearance_map::ClearanceMap;
use core::f64::consts::TAU;
use msg::grid::Occupancy;

/// Rays of a viewpoint: one per 6 degrees.
pub(super) const RAYS: usize = 60;
/// Distance between candidate viewpoints, cells: 0.4 m.
const LATTICE_CELLS: i64 = 8;
/// Rays by which a robot's heading may differ from the one it was sent: navigation accepts 0.1 rad, a ray is 0.105 rad.
const HEADING_TOLERANCE_RAYS: usize = 1;
/// Rays by which a turn of the sensor is lengthened until it shows enough: 30 degrees.
const SWEEP_STEP_RAYS: usize = 5;
/// The two cells beside a diagonal step into unknown space: at a corner of walls one of them is occupied.
const OPEN_SIDES: [(i64, i64); 2] = [(1, 0), (0, 1)];

/// A place from which unknown space is seen.
#[derive(Clone, Copy, Debug)]
pub(super) struct Viewpoint {
    /// Cell of the clearance map.
    pub(super) cell: usize,
    /// Area expected to be seen, square metres, which no viewpoint of the same search before it shows.
    pub(super) gain_m2: f64,
    /// First heading of the centre of the sensor, radians, and the angle to turn on from there, radians from 0.
    pub(super) look_rad: f64,
    pub(super) sweep_rad: f64,
}

/// Directions in the grid of a map, one bit for each of [`RAYS`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Directions(u64);

impl Directions {
    /// What a sensor sees that has turned once around.
    pub(super) const ALL: Self = Self((1 << RAYS) - 1);

    /// Adds those that a sensor sees which points to `heading_rad` in the grid, and sees `view_angle_rad`.
    pub(super) fn add_view(&mut self, heading_rad: f64, view_angle_rad: f64) {
        let ray_rad = TAU / RAYS as f64;
        let half = (view_angle_rad / 2.0 / ray_rad).floor() as i64;
        let middle = (heading_rad / ray_rad).round() as i64;
        if half * 2 >= RAYS as i64 {
            *self = Self::ALL;
        }
        for ray in middle - half..=middle + half {
            self.0 |= 1 << ray.rem_euclid(RAYS as i64);
        }
    }

    fn contain(self, ray: usize) -> bool {
        self.0 & (1 << ray) != 0
    }

    /// Number of the ray that is nearest to a direction.
    fn nearest(direction_rad: f64) -> usize {
        let ray = (direction_rad / (TAU / RAYS as f64)).round() as i64;
        ray.rem_euclid(RAYS as i64) as usize
    }
}

/// Finds viewpoints, in buffers that it keeps.
#[derive(Clone, Debug, Default)]
pub(super) struct ViewpointSearch {
    /// Number of the search in which a cell was shown by a chosen viewpoint.
    shown: Vec<u32>,
    search: u32,
    candidates: Vec<(f64, usize)>,
    rays: Vec<Ray>,
    /// Number of unknown cells beside free ones above and left of each cell, this one included (summed-area table).
    frontiers: Vec<u32>,
}

/// Steps of one ray: cell offsets.
#[derive(Clone, Debug)]
struct Ray(Vec<(i64, i64)>);

/// What is seen along a ray: expected new area, per ray.
type Gains = [f64; RAYS];

impl ViewpointSearch {
    /// Appends viewpoints among passable cells, best first, until the next would show less than `gain_min_m2` or `found` has `found_max`.
    ///
    /// The frontiers of the map have been counted. `extra` are candidates beside those of the lattice: where robots stand and where they go now.
    /// `is_opaque` says which unknown cells no beam enters, by earlier attempts, or no robot reaches.
    #[expect(clippy::too_many_arguments, reason = "one call, each argument of another kind")]
    pub(super) fn find(
        &mut self,
        map: &ClearanceMap,
        config: &CoordinationConfig,
        is_candidate: &dyn Fn(usize) -> bool,
        is_opaque: &dyn Fn(usize) -> bool,
        extra: &[usize],
        gain_min_m2: f64,
        found_max: usize,
        found: &mut Vec<Viewpoint>,
    ) {
        self.begin(map, config);
        self.candidates.clear();
        let on_lattice: Vec<usize> =
            lattice(map).filter(|cell| is_candidate(*cell) && self.is_near_frontier(map, *cell)).collect();
        for cell in on_lattice.into_iter().chain(extra.iter().copied()) {
            let gains = self.gains(map, config, cell, is_opaque);
            let gain_m2: f64 = gains.iter().sum();
            if gain_m2 >= gain_min_m2 {
                self.candidates.push((gain_m2, cell));
            }
        }
        // Lazy greedy: a gain only falls, so that the best is found if its gain is up to date.
        while found.len() < found_max {
            let best = (0..self.candidates.len())
                .max_by(|a, b| self.candidates[*a].0.total_cmp(&self.candidates[*b].0).then(b.cmp(a)));
            let Some(best) = best.filter(|best| self.candidates[*best].0 >= gain_min_m2) else { break };
            let (stale_m2, cell) = self.candidates[best];
            let gains = self.gains(map, config, cell, is_opaque);
            let gain_m2: f64 = gains.iter().sum();
            if gain_m2 < stale_m2 - 1e-9 {
                self.candidates[best].0 = gain_m2;
                continue;
            }
            self.candidates.swap_remove(best);
            self.mark_shown(map, config, cell);
            let (look_rad, sweep_rad) = sweep(&gains, config);
            found.push(Viewpoint { cell, gain_m2, look_rad, sweep_rad });
        }
    }

    /// Calls `visit` with the unknown cells that the sensor should have shown from a cell: they are in range and in one of the
    /// directions, and all is free in between. The first that each ray of a viewpoint finds are among them.
    pub(super) fn for_each_visible_frontier(
        &mut self,
        map: &ClearanceMap,
        config: &CoordinationConfig,
        cell: usize,
        directions: Directions,
        mut visit: impl FnMut(usize),
    ) {
        self.begin(map, config);
        for (_, ray) in self.rays.iter().enumerate().filter(|(index, _)| directions.contain(*index)) {
            trace(map, config, cell, ray, |seen, _| {
                visit(seen);
                false
            });
        }
        let (width, height) = (map.width(), map.cell_count() as i64 / map.width().max(1));
        let (x, y) = (cell as i64 % width, cell as i64 / width);
        let reach = (config.view_range_m / map.cell_size_m()) as i64;
        let is_within = |at: i64, size: i64| at >= 1 && at < size - 1;
        for dy in (-reach..=reach).filter(|dy| is_within(y + dy, height)) {
            for dx in (-reach..=reach).filter(|dx| is_within(x + dx, width)) {
                let seen = ((y + dy) * width + x + dx) as usize;
                if dx * dx + dy * dy <= reach * reach
                    && map.occupancy(seen) == Occupancy::Unknown
                    && directions.contain(Directions::nearest((dy as f64).atan2(dx as f64)))
                    && is_free_until(map, (x, y), (dx, dy))
                {
                    visit(seen);
                }
            }
        }
    }

    fn begin(&mut self, map: &ClearanceMap, config: &CoordinationConfig) {
        if self.shown.len() != map.cell_count() || self.search == u32::MAX {
            self.shown.clear();
            self.shown.resize(map.cell_count(), 0);
            self.search = 0;
        }
        self.search += 1;
        let reach = (config.view_range_m / map.cell_size_m()) as usize;
        if self.rays.first().is_none_or(|ray| ray.0.len() != reach) {
            self.rays = (0..RAYS).map(|ray| ray_steps(ray, reach)).collect();
        }
    }

    /// Counts the unknown cells beside free ones, for the searches in this map.
    pub(super) fn count_frontiers(&mut self, map: &ClearanceMap) {
        let width = map.width() as usize;
        self.frontiers.clear();
        self.frontiers.resize(map.cell_count(), 0);
        for cell in width..map.cell_count().saturating_sub(width) {
            let is_frontier = map.occupancy(cell) == Occupancy::Unknown
                && [cell - 1, cell + 1, cell - width, cell + width]
                    .iter()
                    .any(|side| map.occupancy(*side) == Occupancy::Free);
            // The table of a row's first cell begins anew: the cell before it is on the other edge.
            let before = if cell % width == 0 { 0 } else { self.frontiers[cell - 1] };
            let above_before = if cell % width == 0 { 0 } else { self.frontiers[cell - width - 1] };
            self.frontiers[cell] =
                u32::from(is_frontier) + before + self.frontiers[cell - width] - above_before;
        }
    }

    /// Whether a frontier lies in the square that rays from a cell reach.
    fn is_near_frontier(&self, map: &ClearanceMap, cell: usize) -> bool {
        let width = map.width();
        // The last row of the map has no table.
        let rows = map.cell_count() as i64 / width - 1;
        let reach = self.rays.first().map_or(0, |ray| ray.0.len()) as i64;
        let (x, y) = (cell as i64 % width, cell as i64 / width);
        let at = |x: i64, y: i64| {
            let (x, y) = (x.min(width - 1), y.min(rows - 1));
            if x < 0 || y < 0 { 0 } else { self.frontiers[(y * width + x) as usize] }
        };
        let (left, right, low, high) = (x - reach - 1, x + reach, y - reach - 1, y + reach);
        at(right, high) + at(left, low) > at(left, high) + at(right, low)
    }

    fn gains(
        &self,
        map: &ClearanceMap,
        config: &CoordinationConfig,
        cell: usize,
        is_opaque: &dyn Fn(usize) -> bool,
    ) -> Gains {
        let mut gains = [0.0; RAYS];
        for (ray, gain) in self.rays.iter().zip(&mut gains) {
            trace(map, config, cell, ray, |seen, area_m2| {
                // A beam that entered it would have shown it by now; so none gets behind it either.
                if is_opaque(seen) {
                    return false;
                }
                if self.shown[seen] != self.search {
                    *gain += area_m2;
                }
                true
            });
        }
        gains
    }

    fn mark_shown(&mut self, map: &ClearanceMap, config: &CoordinationConfig, cell: usize) {
        let Self { rays, shown, search, .. } = self;
        let width = map.width();
        for ray in rays.iter() {
            trace(map, config, cell, ray, |seen, _| {
                // Rays are wider than a cell farther out: their neighbours are shown too.
                let cells = shown.len() as i64;
                for neighbour in [0, 1, -1, width, -width].map(|step| seen as i64 + step) {
                    if (0..cells).contains(&neighbour) {
                        shown[neighbour as usize] = *search;
                    }
                }
                true
            });
        }
    }
}

/// Whether all cells on the straight line to a cell are free, that cell left out.
fn is_free_until(map: &ClearanceMap, (x, y): (i64, i64), (dx, dy): (i64, i64)) -> bool {
    let steps = dx.abs().max(dy.abs());
    let at = |step: i64| {
        let along = |d: i64| (d as f64 * step as f64 / steps as f64).round() as i64;
        (x + along(dx), y + along(dy))
    };
    let occupancy = |(x, y): (i64, i64)| map.occupancy((y * map.width() + x) as usize);
    let is_free = (1..steps).all(|step| occupancy(at(step)) == Occupancy::Free);
    is_free && steps > 0 && {
        let ((u, v), (x, y)) = (at(steps - 1), at(steps));
        // Between two cells of a wall a diagonal step would leak.
        u == x || v == y || [(u, y), (x, v)].iter().all(|side| occupancy(*side) != Occupancy::Occupied)
    }
}

fn ray_steps(ray: usize, reach: usize) -> Ray {
    let (sin, cos) = (TAU * ray as f64 / RAYS as f64).sin_cos();
    let step = |i: usize| ((i as f64 * cos).round() as i64, (i as f64 * sin).round() as i64);
    Ray((1..=reach).map(step).collect())
}

/// Candidates: every eighth cell of every eighth row.
fn lattice(map: &ClearanceMap) -> impl Iterator<Item = usize> + use<> {
    let (width, rows) = (map.width(), map.cell_count() as i64 / map.width().max(1));
    let axis = |count: i64| (LATTICE_CELLS / 2..count).step_by(LATTICE_CELLS as usize);
    axis(rows).flat_map(move |y| axis(width).map(move |x| (y * width + x) as usize))
}

/// Calls `visit` with each unknown cell along a ray and the area expected to be seen there, square metres, until it
/// returns false.
///
/// The chance that unknown space is open falls with its depth.
fn trace(
    map: &ClearanceMap,
    config: &CoordinationConfig,
    from: usize,
    ray: &Ray,
    mut visit: impl FnMut(usize, f64) -> bool,
) {
    let width = map.width();
    let height = map.cell_count() as i64 / width;
    let (x0, y0) = (from as i64 % width, from as i64 / width);
    let cell_m = map.cell_size_m();
    let ray_rad = TAU / RAYS as f64;
    let fade = (-cell_m / config.unknown_depth_m).exp();
    let mut chance = 1.0;
    let (mut was_free, mut last) = (true, (0, 0));
    for (i, step) in ray.0.iter().enumerate() {
        let (x, y) = (x0 + step.0, y0 + step.1);
        if x < 1 || y < 1 || x >= width - 1 || y >= height - 1 {
            return;
        }
        let cell = (y * width + x) as usize;
        match map.occupancy(cell) {
            Occupancy::Occupied => return,
            Occupancy::Free => was_free = true,
            Occupancy::Unknown => {
                // Between two cells of a wall a diagonal step would leak.
                let is_diagonal = step.0 != last.0 && step.1 != last.1;
                let leaks = was_free
                    && is_diagonal
                    && OPEN_SIDES.iter().any(|(dx, dy)| {
                        let (u, v) = (x - (step.0 - last.0) * dx, y - (step.1 - last.1) * dy);
                        map.occupancy((v * width + u) as usize) == Occupancy::Occupied
                    });
                if leaks {
                    return;
                }
                if !visit(cell, chance * (i + 1) as f64 * cell_m * ray_rad * cell_m) {
                    return;
                }
                chance *= fade;
                was_free = false;
            }
        }
        last = *step;
    }
}

/// Heading and turn of the sensor that show most of the gain in the least turn: the shortest arc that holds the
/// configured share of it.
fn sweep(gains: &Gains, config: &CoordinationConfig) -> (f64, f64) {
    let ray_rad = TAU / RAYS as f64;
    let view = (config.view_angle_rad / ray_rad).round() as usize;
    let view = view.saturating_sub(2 * HEADING_TOLERANCE_RAYS).clamp(1, RAYS);
    let total: f64 = gains.iter().sum();
    let sum_of = |first: usize, count: usize| -> f64 { (0..count).map(|i| gains[(first + i) % RAYS]).sum() };
    let mut count = view;
    loop {
        let best = (0..RAYS)
            .map(|first| (sum_of(first, count), first))
            .max_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1)));
        let (gain, first) = best.unwrap_or((0.0, 0));
        if gain >= config.sweep_share * total || count + SWEEP_STEP_RAYS > RAYS {
            let look = first as f64 + (view as f64 - 1.0) / 2.0;
            return (look * ray_rad, (count - view) as f64 * ray_rad);
        }
        count += SWEEP_STEP_RAYS;
    }
}
