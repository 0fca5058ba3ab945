//! In which directions a map's walls run: the Hough spectrum (Carpin, "Fast and accurate map
//! merging for multi-robot systems", Autonomous Robots 25, 2008).

use super::evidence::Evidence;
use core::f64::consts::PI;

/// Directions in half a turn: half a degree each.
const DIRECTIONS: usize = 360;
/// Width of a stripe of the Hough transform, metres.
const STRIPE_M: f32 = 0.1;
/// The most stripes: beyond 400 m they are as wide as it takes.
const STRIPES_MAX: usize = 8192;
/// Wall points used: more do not sharpen the peaks.
const POINTS: usize = 12_000;
/// Half the width of a neighbourhood, in directions.
const LOBE: usize = 12;
/// Peaks nearer to a better one than this are the same, in directions.
const PEAK_APART: usize = 3;

/// For each direction, the sum over parallel stripes of the squared number of wall points in them:
/// large where walls run along the stripes. Sharpened, so that
/// correlations have peaks.
pub(crate) fn spectrum(evidence: &Evidence) -> Vec<f64> {
    let keep = evidence.walls_m.len().div_ceil(POINTS).max(1);
    let reach_m = evidence.radius_m as f32 + 1.0;
    let stripe_m = STRIPE_M.max(2.0 * reach_m / STRIPES_MAX as f32);
    let mut stripes = vec![0_u32; (2.0 * reach_m / stripe_m) as usize + 2];
    let mut spectrum: Vec<f64> = (0..DIRECTIONS)
        .map(|direction| {
            let (sin, cos) = (PI * direction as f64 / DIRECTIONS as f64).sin_cos();
            let (sin, cos) = (sin as f32 / stripe_m, cos as f32 / stripe_m);
            let offset = reach_m / stripe_m;
            stripes.fill(0);
            for [x, y] in evidence.walls_m.iter().step_by(keep) {
                stripes[(x * cos + y * sin + offset) as usize] += 1;
            }
            stripes.iter().map(|count| f64::from(*count).powi(2)).sum()
        })
        .collect();
    sharpen(&mut spectrum);
    spectrum
}

/// Takes the mean of the neighbourhood away: one long corridor else makes a single broad lobe, and
/// hides what the short walls say.
fn sharpen(spectrum: &mut [f64]) {
    let smooth: Vec<f64> = (0..DIRECTIONS)
        .map(|k| (0..=2 * LOBE).map(|j| spectrum[(k + DIRECTIONS + j - LOBE) % DIRECTIONS]).sum::<f64>())
        .collect();
    spectrum.iter_mut().zip(smooth).for_each(|(value, sum)| *value -= sum / (2 * LOBE + 1) as f64);
}

/// Rotations of b, radians in [0, pi), that lay its walls' directions over a's: the `count` best
/// peaks of the circular correlation, best first. Each stands for itself and half a turn more.
pub(crate) fn rotations(a: &[f64], b: &[f64], count: usize) -> Vec<f64> {
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
            gap.min(DIRECTIONS - gap) >= PEAK_APART
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
