//! Surface points of a scan: finds its returns, thins them, and fits a normal to each.

use super::{BEARINGS, SurfacePoint, bearing};
use crate::beam_poses::BeamPoses;
use msg::Scan;

/// Reach of a normal's fit along the surface on each side, metres: far enough to average out the noise of close beams.
const NORMAL_REACH_M: f32 = 0.25;
/// Beams of a normal's fit on each side: always the first number, however far apart, never more than the last.
const NORMAL_BEAMS: core::ops::RangeInclusive<usize> = 2..=16;
/// Largest gap between neighbours on one surface, metres, on top of twice the beams' spacing.
const SURFACE_GAP_M: f32 = 0.25;
/// Largest standard deviation of points around their line, metres: beyond it they have no normal.
const FLATNESS_M: f32 = 0.04;
/// Largest ratio of the small eigenvalue of the points' scatter to the large one: beyond it they form no line.
const EIGENVALUE_RATIO_MAX: f32 = 0.1;
/// Growth of the spacing between points, per try, while they are too many.
const SPACING_GROWTH: f32 = 1.5;

/// A beam's return: position in `base_footprint` and range, metres.
#[derive(Clone, Copy, Debug)]
pub(super) struct Hit {
    at: [f32; 2],
    range: f32,
}

/// Buffers that building clouds reuses, so that it does not allocate.
#[derive(Clone, Debug, Default)]
pub struct CloudScratch {
    pub(super) hits: Vec<Hit>,
    pub(super) kept: Vec<usize>,
    pub(super) points: Vec<SurfacePoint>,
}

impl CloudScratch {
    /// Buffers for scans of up to [`msg::BEAMS_MAX`] beams and clouds of up to `points_max` points.
    pub fn with_capacity(points_max: usize) -> Self {
        Self {
            hits: Vec::with_capacity(msg::BEAMS_MAX),
            kept: Vec::with_capacity(points_max + 1),
            points: Vec::with_capacity(points_max),
        }
    }
}

/// The usable returns of a scan in `base_footprint`, in beam order.
pub(super) fn find_hits(hits: &mut Vec<Hit>, scan: &Scan, sweep: &BeamPoses, range_use_max_m: f32) {
    let useful = |range: f32| {
        (scan.range_min_m..scan.range_max_m).contains(&range) && range > 0.0 && range <= range_use_max_m
    };
    let first_beam = sweep.base_from_sensor(0);
    hits.clear();
    for (beam, &range) in scan.ranges_m().iter().enumerate().filter(|(_, range)| useful(**range)) {
        let base_from_sensor = if sweep.has_motion() { sweep.base_from_sensor(beam) } else { first_beam };
        let (sin, cos) = scan.angle_rad(beam).sin_cos();
        hits.push(Hit { at: base_from_sensor.point([range * cos, range * sin]), range });
    }
}

/// Records the nearest return by bearing around the sensor, centimetres; 0 without a return.
pub(super) fn fill_bearings(seen_cm: &mut [u16; BEARINGS], hits: &[Hit], sensor: [f32; 2]) {
    seen_cm.fill(0);
    for hit in hits {
        let slot = &mut seen_cm[bearing(hit.at[0] - sensor[0], hit.at[1] - sensor[1])];
        let range_cm = (hit.range * 100.0).clamp(1.0, 65_535.0) as u16;
        *slot = if *slot == 0 { range_cm } else { range_cm.min(*slot) };
    }
}

/// Euclidean distance of two points, metres.
fn distance(a: [f32; 2], b: [f32; 2]) -> f32 {
    ((a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2)).sqrt()
}

/// Indices of hits at least `spacing_m` apart along the scan; wider if they would be too many.
pub(super) fn thin(kept: &mut Vec<usize>, hits: &[Hit], spacing_m: f32, points_max: usize) {
    let mut spacing = spacing_m;
    loop {
        kept.clear();
        for (i, hit) in hits.iter().enumerate() {
            if kept.last().is_none_or(|&last| distance(hits[last].at, hit.at) >= spacing) {
                kept.push(i);
            }
            if kept.len() > points_max {
                break;
            }
        }
        if kept.len() <= points_max {
            return;
        }
        spacing *= SPACING_GROWTH;
    }
}

/// Hit `i` with the normal of a line fitted to its neighbours along the scan.
pub(super) fn surface_point(hits: &[Hit], i: usize, gap_per_m: f32, sensor: [f32; 2]) -> SurfacePoint {
    let same = |a: usize, b: usize| {
        distance(hits[a].at, hits[b].at) < SURFACE_GAP_M + gap_per_m * hits[a].range.max(hits[b].range)
    };
    let wanted = |j: usize| {
        let (beams, distance_m) = (j.abs_diff(i), distance(hits[i].at, hits[j].at));
        beams <= *NORMAL_BEAMS.start() || (beams <= *NORMAL_BEAMS.end() && distance_m < NORMAL_REACH_M)
    };
    let mut first = i;
    while first > 0 && wanted(first - 1) && same(first - 1, first) {
        first -= 1;
    }
    let mut last = i;
    while last + 1 < hits.len() && wanted(last + 1) && same(last, last + 1) {
        last += 1;
    }
    let at = hits[i].at;
    let normal = if last - first >= 2 { line_normal(&hits[first..=last]) } else { None };
    let towards = |n: [f32; 2]| {
        let out = n[0] * (sensor[0] - at[0]) + n[1] * (sensor[1] - at[1]);
        if out < 0.0 { [-n[0], -n[1]] } else { n }
    };
    SurfacePoint { at, normal: normal.map_or([0.0; 2], towards) }
}

/// Unit normal of a line through the hits (total least squares); `None` if they form no line.
fn line_normal(hits: &[Hit]) -> Option<[f32; 2]> {
    let n = hits.len() as f32;
    let mean = hits.iter().fold([0.0; 2], |m, h| [m[0] + h.at[0] / n, m[1] + h.at[1] / n]);
    let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
    for h in hits {
        let (x, y) = (h.at[0] - mean[0], h.at[1] - mean[1]);
        xx += x * x / n;
        xy += x * y / n;
        yy += y * y / n;
    }
    // Eigenvalues of the 2x2 scatter; the normal belongs to the small one.
    let (middle, half) = ((xx + yy) / 2.0, ((xx - yy) / 2.0).hypot(xy));
    let (small, large) = ((middle - half).max(0.0), middle + half);
    let flat = small.sqrt() < FLATNESS_M && small < EIGENVALUE_RATIO_MAX * large;
    if !flat {
        return None;
    }
    let along = 0.5 * (2.0 * xy).atan2(xx - yy);
    Some([-along.sin(), along.cos()])
}
