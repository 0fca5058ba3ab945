//! All translations at once: how well b's walls, turned by a candidate rotation, lie on a's walls
//! and not on its floor, as one product of spectra.

use super::evidence::Evidence;
use super::fft2::{Fft2, fast_size};
use msg::Pose2;
use rustfft::num_complex::Complex;

/// Side of a coarse cell, metres, unless the maps are too large for it.
pub(crate) const COARSE_M: f64 = 0.2;
/// The longest side of the correlated image, cells.
const SIDE_MAX: usize = 1024;
/// Cells beyond both maps, for their neighbourhoods and rounding.
const MARGIN: usize = 8;
/// A wall of one map on the floor of the other counts against, this much of a wall on a wall.
const CONFLICT: f32 = 0.5;
/// Wall on wall one coarse cell beside still counts: side and diagonal neighbours.
const NEAR: [f32; 2] = [0.6, 0.4];
/// Two peaks of one rotation are at least so far apart, metres.
const PEAK_APART_M: f64 = 1.0;
/// Peaks kept of each rotation.
const PEAKS: usize = 4;

/// A place to refine: `a` from `b`, both about their middles, and its coarse score.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Candidate {
    pub a_from_b: Pose2,
    pub score: f32,
}

/// One map's side of the correlation, and the plans for all rotations of the other.
pub(crate) struct Translator<'a> {
    b: &'a Evidence,
    cell_m: f64,
    /// Of the correlated image, cells.
    size: [usize; 2],
    /// Cell of `a`'s middle in its image.
    middle_a: [usize; 2],
    fft: Fft2,
    /// Spectrum of what b's walls should lie on, and of what b's floor should.
    for_walls: Vec<Complex<f32>>,
    for_floor: Vec<Complex<f32>>,
}

impl<'a> Translator<'a> {
    pub fn new(a: &Evidence, b: &'a Evidence) -> Self {
        let span_m = |k: usize| a.hull_m[1][k] - a.hull_m[0][k];
        let reach_m = span_m(0).max(span_m(1)) + 2.0 * b.radius_m;
        let cell_m = COARSE_M.max(reach_m / (SIDE_MAX - MARGIN) as f64);
        let size =
            [0, 1].map(|k| fast_size(((span_m(k) + 2.0 * b.radius_m) / cell_m).ceil() as usize + MARGIN));
        let middle_a = [0, 1].map(|k| (-a.hull_m[0][k] / cell_m).ceil() as usize + 1);
        let mut fft = Fft2::new(size[0], size[1]);
        let mut walls = vec![0.0; size[0] * size[1]];
        let mut floor = walls.clone();
        splat(&a.walls_m, 0.0, cell_m, middle_a, size, &mut walls);
        splat(&a.floor_m, 0.0, cell_m, middle_a, size, &mut floor);
        let near = blurred(&walls, size);
        floor.iter_mut().zip(&walls).for_each(|(floor, wall)| *floor *= 1.0 - wall);
        let mut good: Vec<f32> =
            near.iter().zip(&floor).map(|(near, floor)| near - CONFLICT * floor).collect();
        let mut bad: Vec<f32> = walls.iter().map(|wall| -CONFLICT * wall).collect();
        let (mut for_walls, mut for_floor) = (Vec::new(), Vec::new());
        fft.forward(&mut good, &mut for_walls);
        fft.forward(&mut bad, &mut for_floor);
        Self { b, cell_m, size, middle_a, fft, for_walls, for_floor }
    }

    /// The best translations for b turned by `turn_rad`, and for half a turn more.
    pub fn candidates(&mut self, turn_rad: f64) -> Vec<Candidate> {
        let (size, half) = (self.size, [half_cells(self.b, self.cell_m); 2]);
        let mut walls = vec![0.0; size[0] * size[1]];
        let mut floor = walls.clone();
        splat(&self.b.walls_m, turn_rad, self.cell_m, half, size, &mut walls);
        splat(&self.b.floor_m, turn_rad, self.cell_m, half, size, &mut floor);
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
            let a = self.for_walls.iter().zip(&self.for_floor);
            for ((out, (wall, floor)), (b_wall, b_floor)) in
                product.iter_mut().zip(a).zip(b_walls.iter().zip(&b_floor))
            {
                *out = wall * of(*b_wall) + floor * of(*b_floor);
            }
            self.fft.inverse(&mut product, &mut image);
            let scale = 1.0 / (size[0] * size[1]) as f32;
            for (x, y, score) in self.peaks(&image) {
                found.push(Candidate { a_from_b: self.pose(x, y, turn_rad, flipped), score: score * scale });
            }
        }
        found
    }

    /// Cell (x, y) of the correlation as a pose.
    fn pose(&self, x: usize, y: usize, turn_rad: f64, flipped: bool) -> Pose2 {
        let half_b = half_cells(self.b, self.cell_m);
        let metres = |t: usize, k: usize| {
            // b's image ends beyond a's: shifts larger than what that leaves are negative ones, wrapped.
            let wrapped = !flipped && t + 2 * half_b > self.size[k] + 2;
            let t = if wrapped { t as f64 - self.size[k] as f64 } else { t as f64 };
            let cells = if flipped { t + 1.0 - half_b as f64 } else { t + half_b as f64 };
            (cells - self.middle_a[k] as f64) * self.cell_m
        };
        let half_turn = if flipped { core::f64::consts::PI } else { 0.0 };
        Pose2::new(metres(x, 0), metres(y, 1), msg::pose::wrap_angle(turn_rad + half_turn))
    }

    /// The best local maxima that are well apart.
    fn peaks(&self, image: &[f32]) -> Vec<(usize, usize, f32)> {
        let (size, apart) = (self.size, (PEAK_APART_M / self.cell_m).ceil() as usize);
        let gap = |a: usize, b: usize, k: usize| a.abs_diff(b).min(size[k] - a.abs_diff(b));
        let mut best: Vec<(usize, usize, f32)> = Vec::with_capacity(PEAKS + 1);
        let mut least = 0.0;
        for (y, row) in image.chunks_exact(size[0]).enumerate() {
            for (x, score) in row.iter().enumerate() {
                if *score <= least {
                    continue;
                }
                let near =
                    |(px, py, _): &(usize, usize, f32)| gap(*px, x, 0) < apart && gap(*py, y, 1) < apart;
                if best.iter().any(|peak| near(peak) && peak.2 >= *score) {
                    continue;
                }
                best.retain(|peak| !near(peak));
                best.push((x, y, *score));
                best.sort_by(|a, b| b.2.total_cmp(&a.2));
                best.truncate(PEAKS);
                least = if best.len() == PEAKS { best[PEAKS - 1].2 } else { 0.0 };
            }
        }
        best
    }
}

/// Half the side of a map's image, in any rotation.
fn half_cells(evidence: &Evidence, cell_m: f64) -> usize {
    (evidence.radius_m / cell_m).ceil() as usize + 1
}

/// Marks the cells under points, turned; the image's corner `middle` is at their middle.
fn splat(
    points_m: &[[f32; 2]],
    turn_rad: f64,
    cell_m: f64,
    middle: [usize; 2],
    size: [usize; 2],
    image: &mut [f32],
) {
    let (sin, cos) = turn_rad.sin_cos();
    let (sin, cos) = ((sin / cell_m) as f32, (cos / cell_m) as f32);
    for [x, y] in points_m {
        let u = (cos * x - sin * y + middle[0] as f32) as usize;
        let v = (sin * x + cos * y + middle[1] as f32) as usize;
        if u < size[0] && v < size[1] {
            image[v * size[0] + u] = 1.0;
        }
    }
}

/// Walls with their neighbourhood.
fn blurred(walls: &[f32], [width, height]: [usize; 2]) -> Vec<f32> {
    let mut near = walls.to_vec();
    for (index, _) in walls.iter().enumerate().filter(|(_, wall)| **wall > 0.0) {
        let (x, y) = (index % width, index / width);
        for (dx, dy) in [(0, 1), (1, 0), (1, 2), (2, 1), (0, 0), (0, 2), (2, 0), (2, 2)] {
            let value = if dx == 1 || dy == 1 { NEAR[0] } else { NEAR[1] };
            let (x, y) = ((x + width + dx - 1) % width, (y + height + dy - 1) % height);
            near[y * width + x] = near[y * width + x].max(value);
        }
    }
    near
}
