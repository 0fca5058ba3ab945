//! Hough spectrum of a map, the distribution of its walls' directions (Carpin, "Fast and accurate map merging for
//! multi-robot systems", Autonomous Robots 25, 2008).

use super::points::MapPoints;
use core::f64::consts::PI;

/// Directions in half a turn: one every half degree, which the refinement corrects.
const DIRECTIONS: usize = 360;
/// Width of a stripe of the Hough transform, metres: two cells of a map.
const STRIPE_M: f32 = 0.1;
/// Most stripes: maps longer than 800 m get wider ones.
const STRIPES_MAX: usize = 8192;
/// Most wall points used: more do not sharpen the peaks.
const POINTS_MAX: usize = 12_000;
/// Half the width of the neighbourhood whose mean is subtracted, in directions.
const NEIGHBOURHOOD: usize = 12;
/// Least gap between two peaks, in directions.
const PEAK_GAP_MIN: usize = 3;

/// Computes the spectrum: for each direction, the sum over parallel stripes of the squared number of wall points in
/// them. It is large where walls run along the stripes, and sharpened so that correlations have peaks.
pub(crate) fn hough_spectrum(points: &MapPoints) -> Vec<f64> {
    let stride = points.walls_m.len().div_ceil(POINTS_MAX).max(1);
    let reach_m = points.radius_m as f32 + 1.0;
    let stripe_m = STRIPE_M.max(2.0 * reach_m / STRIPES_MAX as f32);
    let mut stripes = vec![0_u32; (2.0 * reach_m / stripe_m) as usize + 2];
    let mut spectrum: Vec<f64> = (0..DIRECTIONS)
        .map(|direction| {
            let (sin, cos) = (PI * direction as f64 / DIRECTIONS as f64).sin_cos();
            let (sin, cos) = (sin as f32 / stripe_m, cos as f32 / stripe_m);
            let offset = reach_m / stripe_m;
            stripes.fill(0);
            for [x, y] in points.walls_m.iter().step_by(stride) {
                stripes[(x * cos + y * sin + offset) as usize] += 1;
            }
            stripes.iter().map(|count| f64::from(*count).powi(2)).sum()
        })
        .collect();
    sharpen(&mut spectrum);
    spectrum
}

/// Subtracts the mean of the neighbourhood: one long corridor else makes a single broad peak that hides the short walls.
fn sharpen(spectrum: &mut [f64]) {
    let smooth: Vec<f64> = (0..DIRECTIONS)
        .map(|k| {
            (0..=2 * NEIGHBOURHOOD)
                .map(|j| spectrum[(k + DIRECTIONS + j - NEIGHBOURHOOD) % DIRECTIONS])
                .sum::<f64>()
        })
        .collect();
    spectrum.iter_mut().zip(smooth).for_each(|(value, sum)| *value -= sum / (2 * NEIGHBOURHOOD + 1) as f64);
}

/// Finds the rotations of b, radians in [0, pi), that align its walls' directions with a's.
///
/// They are the `count` largest peaks of the circular correlation, largest first. Each stands for itself and for half a
/// turn more.
pub(crate) fn candidate_rotations(a: &[f64], b: &[f64], count: usize) -> Vec<f64> {
    let correlation: Vec<f64> = (0..DIRECTIONS)
        .map(|turn| (0..DIRECTIONS).map(|k| a[(k + turn) % DIRECTIONS] * b[k]).sum())
        .collect();
    let at = |k: isize| correlation[k.rem_euclid(DIRECTIONS as isize) as usize];
    let mut peaks: Vec<usize> = (0..DIRECTIONS)
        .filter(|k| at(*k as isize) >= at(*k as isize - 1) && at(*k as isize) > at(*k as isize + 1))
        .collect();
    peaks.sort_by(|i, j| correlation[*j].total_cmp(&correlation[*i]).then(i.cmp(j)));
    let mut chosen: Vec<usize> = Vec::new();
    for peak in peaks {
        let apart = |other: &usize| {
            let gap = peak.abs_diff(*other);
            gap.min(DIRECTIONS - gap) >= PEAK_GAP_MIN
        };
        if chosen.len() < count && chosen.iter().all(apart) {
            chosen.push(peak);
        }
    }
    let refined = chosen.into_iter().map(|peak| {
        let k = peak as isize;
        let (before, here, after) = (at(k - 1), at(k), at(k + 1));
        let curve = before - 2.0 * here + after;
        let shift = if curve < 0.0 { 0.5 * (before - after) / curve } else { 0.0 };
        (peak as f64 + shift.clamp(-0.5, 0.5)) * PI / DIRECTIONS as f64
    });
    refined.collect()
}
