//! Matching of two submaps of different robots around a predicted transform.

use crate::align::{
    DistanceField, MapPoints, WallMatch, keep_better, match_walls, refine, rival_score_min, sort_by_score,
    strides, wall_information, wall_points, wall_proximity,
};
use crate::config::{ClosureConfig, MergeConfig};
use msg::{GridView, Pose2, pose::wrap_angle};
use nalgebra::Matrix3;
use posegraph::{limit_information, transport_information};

/// Distance between two starts of the search, metres and radians: walls attract over about half of it.
const START_SPACING: [f64; 2] = [0.35, 0.06];
/// Most starts along an axis to each side.
const STARTS_MAX: usize = 3;
/// Starts that are refined: those whose walls are nearest to each other.
const REFINED_MAX: usize = 24;
/// Wall points used while there are many starts, and for the last few.
const POINTS: [usize; 2] = [500, 5_000];
/// Places that are refined by many points.
const FINALISTS: usize = 3;
/// Kernel widths of the refinement of the many starts, metres.
const COARSE_KERNELS_M: &[f64] = &[0.25];
/// Kernel widths of the refinement of the best starts, metres.
const FINE_KERNELS_M: &[f64] = &[0.12, 0.05];
/// Two transforms within this distance and rotation of each other are one place, metres and radians.
const SAME_PLACE: [f64; 2] = [0.25, 0.05];
/// Standard deviation of a wall point's distance from its wall, metres.
const POINT_SIGMA_M: f64 = 0.03;
/// Wall points that count as one measurement: neighbouring cells come from the same scans and share their errors.
const CORRELATED_POINTS: f64 = 8.0;
/// Least standard deviations of a match, metres and radians: drawn maps are no more exact than that.
const SIGMA_FLOOR: [f64; 2] = [0.02, 0.004];
/// Information along a direction that no wall holds, 1/m² and 1/rad²: a standard deviation of 30 m, about the side of a
/// floor plan.
const UNOBSERVED_INFORMATION: f64 = 1e-3;
/// Side of a floor point's square, metres.
const FLOOR_SQUARE_M: f64 = 0.2;

/// Half widths of the search window around the prediction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SearchWindow {
    /// Along x and y, metres.
    pub half_m: f64,
    /// Of the rotation, radians.
    pub half_rad: f64,
}

/// A measured transform between two submaps.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SubmapMatch {
    /// Frame of submap i from that of submap j.
    pub i_from_j: Pose2,
    /// Inverse covariance over (x, y, yaw) in i.
    pub information: Matrix3<f64>,
    /// Matched wall points of both.
    pub inliers: u32,
}

/// Matches submap `j` to submap `i` around a predicted transform. `None` unless one place in the window stands out and
/// nothing contradicts it.
pub(crate) fn match_submaps(
    i: GridView<'_>,
    j: GridView<'_>,
    predicted: Pose2,
    window: SearchWindow,
    config: &MergeConfig,
) -> Option<SubmapMatch> {
    let walls = &config.align.walls;
    let fields =
        [i, j].map(|grid| DistanceField::new(MapPoints::from_grid(grid, FLOOR_SQUARE_M), grid, walls));
    if fields.iter().any(|field| field.points.walls_m.is_empty()) {
        return None;
    }
    let fields = [&fields[0], &fields[1]];
    let [i_from_a, j_from_b] = fields.map(|field| field.points.frame_from_centred);
    let predicted = i_from_a.inverse() * predicted * j_from_b;
    let found = find_best_place(fields, predicted, window, &config.closures)?;
    let moved = predicted.between(found.a_from_b);
    let moved = [moved.x_m.hypot(moved.y_m), moved.yaw_rad.abs()];
    if moved[0] > window.half_m + START_SPACING[0] || moved[1] > window.half_rad + START_SPACING[1] {
        return None;
    }
    let strides = strides(fields, POINTS[1]);
    let of_points = wall_information(fields, found.a_from_b, strides, FINE_KERNELS_M[1]);
    // Each point stands for those left out; both maps look at the same walls, so that the mean of both ways counts.
    let points_each = (strides[0] + strides[1]) as f64 / 4.0;
    let information = of_points * (points_each / (CORRELATED_POINTS * POINT_SIGMA_M * POINT_SIGMA_M));
    let information = transport_information(information, i_from_a, found.a_from_b, j_from_b.inverse());
    Some(SubmapMatch {
        i_from_j: i_from_a * found.a_from_b * j_from_b.inverse(),
        information: limit_information(information, SIGMA_FLOOR, UNOBSERVED_INFORMATION),
        inliers: found.matched as u32,
    })
}

/// Returns the best place in the window, if it passes all thresholds.
fn find_best_place(
    fields: [&DistanceField; 2],
    predicted: Pose2,
    window: SearchWindow,
    config: &ClosureConfig,
) -> Option<WallMatch> {
    let few = strides(fields, POINTS[0]);
    let mut ranked: Vec<(f64, Pose2)> =
        starts(predicted, window).map(|start| (wall_proximity(fields, start, few), start)).collect();
    ranked.sort_by(|x, y| y.0.total_cmp(&x.0));
    let mut places: Vec<WallMatch> = Vec::new();
    for (_, start) in ranked.into_iter().take(REFINED_MAX) {
        let found = match_walls(fields, refine(fields, start, few, COARSE_KERNELS_M), few);
        keep_better(&mut places, found, is_same_place);
    }
    sort_by_score(&mut places);
    places.truncate(FINALISTS);
    let many = strides(fields, POINTS[1]);
    for place in &mut places {
        *place = match_walls(fields, refine(fields, place.a_from_b, many, FINE_KERNELS_M), many);
    }
    sort_by_score(&mut places);
    let best = *places.first()?;
    let others = places[1..].iter().filter(|other| !is_same_place(other.a_from_b, best.a_from_b));
    let rival_score = others.map(WallMatch::score).fold(rival_score_min(fields), f64::max);
    let accepted = best.matched >= wall_points(fields, config.walls_min_m)
        && best.conflict() <= config.conflict_max
        && best.observability >= config.observability_min
        && best.score() >= config.margin_min * rival_score;
    accepted.then_some(best)
}

/// Returns a regular lattice of transforms over the window.
fn starts(predicted: Pose2, window: SearchWindow) -> impl Iterator<Item = Pose2> {
    let each_side = |half: f64, spacing: f64| ((half / spacing).ceil() as usize).min(STARTS_MAX) as i64;
    let steps = each_side(window.half_m, START_SPACING[0]);
    let rotations = each_side(window.half_rad, START_SPACING[1]);
    (-rotations..=rotations).flat_map(move |t| {
        (-steps..=steps).flat_map(move |y| {
            (-steps..=steps).map(move |x| {
                let yaw_rad = wrap_angle(predicted.yaw_rad + t as f64 * START_SPACING[1]);
                let [dx, dy] = [x, y].map(|k| k as f64 * START_SPACING[0]);
                Pose2::new(predicted.x_m + dx, predicted.y_m + dy, yaw_rad)
            })
        })
    })
}

fn is_same_place(x: Pose2, y: Pose2) -> bool {
    x.distance_m(y) < SAME_PLACE[0] && wrap_angle(x.yaw_rad - y.yaw_rad).abs() < SAME_PLACE[1]
}
