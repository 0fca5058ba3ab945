//! Search over all translations at once, as one product of spectra: how well do b's walls, rotated by a candidate
//! angle, lie on a's walls and not on its floor?

use super::points::MapPoints;
use fft2d::{Complex, Fft2, fast_size};
use msg::Pose2;

/// Side of a cell of the correlated images, metres, unless the maps are too large for it.
pub(crate) const COARSE_CELL_M: f64 = 0.2;
/// Longest side of the correlated images, cells.
const SIDE_MAX: usize = 1024;
/// Cells around both maps, for their neighbourhoods and rounding.
const MARGIN_CELLS: usize = 8;
/// Penalty of a wall on the other map's floor, where a wall on a wall counts 1.
const CONFLICT_PENALTY: f32 = 0.5;
/// Score of a wall one cell beside another: at its side, at its corner.
const NEIGHBOUR_SCORES: [f32; 2] = [0.6, 0.4];
/// Least distance between two peaks of one rotation, metres: nearer ones refine to the same place.
const PEAK_DISTANCE_MIN_M: f64 = 1.0;
/// Most peaks of each rotation.
const PEAKS_MAX: usize = 4;

/// A coarse alignment.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CoarseCandidate {
    /// Centred frame of `a` from that of `b`.
    pub a_from_b: Pose2,
    /// Correlation of the two maps, larger is better.
    pub score: f32,
}

/// Correlation of one map with all rotations of another.
pub(crate) struct TranslationSearch<'a> {
    b: &'a MapPoints,
    cell_m: f64,
    /// Width and height of the correlated images, cells.
    size: [usize; 2],
    /// Cell of the origin of `a`'s centred frame in its image.
    centre_a: [usize; 2],
    fft: Fft2,
    /// Spectrum of the score of a wall of b at each cell of a,
    wall_scores: Vec<Complex<f32>>,
    /// and of a floor point of b.
    floor_scores: Vec<Complex<f32>>,
}

impl<'a> TranslationSearch<'a> {
    /// Prepares the search for `b` in `a`.
    pub fn new(a: &MapPoints, b: &'a MapPoints) -> Self {
        let span_m = |k: usize| a.bounds_m[1][k] - a.bounds_m[0][k];
        let reach_m = span_m(0).max(span_m(1)) + 2.0 * b.radius_m;
        let cell_m = COARSE_CELL_M.max(reach_m / (SIDE_MAX - MARGIN_CELLS) as f64);
        let size = [0, 1]
            .map(|k| fast_size(((span_m(k) + 2.0 * b.radius_m) / cell_m).ceil() as usize + MARGIN_CELLS));
        let centre_a = [0, 1].map(|k| (-a.bounds_m[0][k] / cell_m).ceil() as usize + 1);
        let mut fft = Fft2::new(size[0], size[1]);
        let mut walls = vec![0.0; size[0] * size[1]];
        let mut floor = walls.clone();
        rasterize(&a.walls_m, 0.0, cell_m, centre_a, size, &mut walls);
        rasterize(&a.floor_m, 0.0, cell_m, centre_a, size, &mut floor);
        let near = neighbourhood_scores(&walls, size);
        floor.iter_mut().zip(&walls).for_each(|(floor, wall)| *floor *= 1.0 - wall);
        let mut good: Vec<f32> =
            near.iter().zip(&floor).map(|(near, floor)| near - CONFLICT_PENALTY * floor).collect();
        let mut bad: Vec<f32> = walls.iter().map(|wall| -CONFLICT_PENALTY * wall).collect();
        let (mut wall_scores, mut floor_scores) = (Vec::new(), Vec::new());
        fft.forward(&mut good, &mut wall_scores);
        fft.forward(&mut bad, &mut floor_scores);
        Self { b, cell_m, size, centre_a, fft, wall_scores, floor_scores }
    }

    /// Finds the best translations for b rotated by `rotation_rad`, and by half a turn more.
    pub fn find_candidates(&mut self, rotation_rad: f64) -> Vec<CoarseCandidate> {
        let (size, half) = (self.size, [half_cells(self.b, self.cell_m); 2]);
        let mut walls = vec![0.0; size[0] * size[1]];
        let mut floor = walls.clone();
        rasterize(&self.b.walls_m, rotation_rad, self.cell_m, half, size, &mut walls);
        rasterize(&self.b.floor_m, rotation_rad, self.cell_m, half, size, &mut floor);
        floor.iter_mut().zip(&walls).for_each(|(floor, wall)| *floor *= 1.0 - wall);
        let (mut b_walls, mut b_floor) = (Vec::new(), Vec::new());
        self.fft.forward(&mut walls, &mut b_walls);
        self.fft.forward(&mut floor, &mut b_floor);
        let mut found = Vec::new();
        let mut product = vec![Complex::default(); self.fft.spectrum_len()];
        let mut image = walls;
        for flipped in [false, true] {
            // The mirror image through the origin, which is half a turn, has the conjugate spectrum.
            let of = |b: Complex<f32>| if flipped { b } else { b.conj() };
            let a = self.wall_scores.iter().zip(&self.floor_scores);
            for ((out, (wall, floor)), (b_wall, b_floor)) in
                product.iter_mut().zip(a).zip(b_walls.iter().zip(&b_floor))
            {
                *out = wall * of(*b_wall) + floor * of(*b_floor);
            }
            self.fft.inverse(&mut product, &mut image);
            let scale = 1.0 / (size[0] * size[1]) as f32;
            for (x, y, score) in self.peaks(&image) {
                found.push(CoarseCandidate {
                    a_from_b: self.pose(x, y, rotation_rad, flipped),
                    score: score * scale,
                });
            }
        }
        found
    }

    /// Converts cell (x, y) of the correlation to a pose.
    fn pose(&self, x: usize, y: usize, rotation_rad: f64, flipped: bool) -> Pose2 {
        let half_b = half_cells(self.b, self.cell_m);
        let metres = |t: usize, k: usize| {
            // b's image ends beyond a's: shifts larger than what that leaves are negative ones, wrapped.
            let wrapped = !flipped && t + 2 * half_b > self.size[k] + 2;
            let t = if wrapped { t as f64 - self.size[k] as f64 } else { t as f64 };
            let cells = if flipped { t + 1.0 - half_b as f64 } else { t + half_b as f64 };
            (cells - self.centre_a[k] as f64) * self.cell_m
        };
        let half_turn = if flipped { core::f64::consts::PI } else { 0.0 };
        Pose2::new(metres(x, 0), metres(y, 1), msg::pose::wrap_angle(rotation_rad + half_turn))
    }

    /// Finds the largest local maxima that are well apart.
    fn peaks(&self, image: &[f32]) -> Vec<(usize, usize, f32)> {
        let (size, distance_min) = (self.size, (PEAK_DISTANCE_MIN_M / self.cell_m).ceil() as usize);
        let gap = |a: usize, b: usize, k: usize| a.abs_diff(b).min(size[k] - a.abs_diff(b));
        let mut best: Vec<(usize, usize, f32)> = Vec::with_capacity(PEAKS_MAX + 1);
        let mut least = 0.0;
        for (y, row) in image.chunks_exact(size[0]).enumerate() {
            for (x, score) in row.iter().enumerate() {
                if *score <= least {
                    continue;
                }
                let near = |(px, py, _): &(usize, usize, f32)| {
                    gap(*px, x, 0) < distance_min && gap(*py, y, 1) < distance_min
                };
                if best.iter().any(|peak| near(peak) && peak.2 >= *score) {
                    continue;
                }
                best.retain(|peak| !near(peak));
                best.push((x, y, *score));
                best.sort_by(|a, b| b.2.total_cmp(&a.2));
                best.truncate(PEAKS_MAX);
                least = if best.len() == PEAKS_MAX { best[PEAKS_MAX - 1].2 } else { 0.0 };
            }
        }
        best
    }
}

/// Half the side of a map's image in any rotation, cells.
fn half_cells(points: &MapPoints, cell_m: f64) -> usize {
    (points.radius_m / cell_m).ceil() as usize + 1
}

/// Marks the cells under rotated points; the points' origin is at the corner of cell `centre`.
fn rasterize(
    points_m: &[[f32; 2]],
    rotation_rad: f64,
    cell_m: f64,
    centre: [usize; 2],
    size: [usize; 2],
    image: &mut [f32],
) {
    let (sin, cos) = rotation_rad.sin_cos();
    let (sin, cos) = ((sin / cell_m) as f32, (cos / cell_m) as f32);
    for [x, y] in points_m {
        let u = (cos * x - sin * y + centre[0] as f32) as usize;
        let v = (sin * x + cos * y + centre[1] as f32) as usize;
        if u < size[0] && v < size[1] {
            image[v * size[0] + u] = 1.0;
        }
    }
}

/// Score of a wall at each cell: 1 on a wall, less beside one.
fn neighbourhood_scores(walls: &[f32], [width, height]: [usize; 2]) -> Vec<f32> {
    let mut near = walls.to_vec();
    for (index, _) in walls.iter().enumerate().filter(|(_, wall)| **wall > 0.0) {
        let (x, y) = (index % width, index / width);
        for (dx, dy) in [(0, 1), (1, 0), (1, 2), (2, 1), (0, 0), (0, 2), (2, 0), (2, 2)] {
            let value = if dx == 1 || dy == 1 { NEIGHBOUR_SCORES[0] } else { NEIGHBOUR_SCORES[1] };
            let (x, y) = ((x + width + dx - 1) % width, (y + height + dy - 1) % height);
            near[y * width + x] = near[y * width + x].max(value);
        }
    }
    near
}
