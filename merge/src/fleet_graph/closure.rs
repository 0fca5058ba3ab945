//! Two submaps of different robots, and where the one is thought to lie in the other: do their
//! walls say so, and exactly where?

use crate::align::{Evidence, Field, Fit, fit, nearness, pull, refine};
use msg::{GridView, Pose2, pose::wrap_angle};
use nalgebra::Matrix3;
use posegraph::{limit_information, transport_information};

/// Between two starts of the search, metres and radians: walls pull over about half of it.
const STARTS_APART: [f64; 2] = [0.35, 0.06];
/// Starts along an axis to each side, at most.
const STARTS_MAX: usize = 3;
/// Starts that are drawn to the walls: those nearest to them.
const STARTS_REFINED: usize = 24;
/// Wall points used while there are many starts, and for the last few.
const POINTS: [usize; 2] = [500, 5_000];
/// The places that are looked at closely.
const FINALISTS: usize = 3;
/// How far walls pull, metres: while there are many starts, and at last.
const STAGES_M: [&[f64]; 2] = [&[0.25], &[0.12, 0.05]];
/// Two places nearer than this are the same, metres and radians.
const SAME_PLACE: [f64; 2] = [0.25, 0.05];
/// Walls found again, at least.
const FOUND_MIN: f64 = 150.0;
/// Walls of one in the middle of the other's floor, over those and the found, at most.
const CONFLICT_MAX: f64 = 0.11;
/// Evidence over that of the best other place, or of so many walls, at least.
const MARGIN_MIN: f64 = 1.3;
const LEAST_EVIDENCE: f64 = 50.0;
/// Least share of the walls' pull in any direction.
const OBSERVABILITY_MIN: f64 = 0.04;
/// A wall point's distance from its line, metres, one standard deviation.
const POINT_SIGMA_M: f64 = 0.03;
/// Neighbouring cells come from the same scans and err alike: so many are one measurement.
const ALIKE: f64 = 8.0;
/// Two drawn maps are known to each other no better than this, metres and radians.
const FLOOR: [f64; 2] = [0.02, 0.004];
/// Information along a direction that no wall holds, 1/m² and 1/rad²: a standard deviation of 30 m, about the side
/// of a floor plan.
const UNOBSERVED: f64 = 1e-3;
/// A start's square, of which floor must not hold walls.
const FLOOR_SQUARE_M: f64 = 0.2;

/// How far from the prediction to look, to each side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Window {
    pub half_m: f64,
    pub half_rad: f64,
}

/// A place recognised by another robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Found {
    pub i_from_j: Pose2,
    /// Inverse covariance over (x, y, yaw) in `i`.
    pub information: Matrix3<f64>,
    /// Wall cells of both found again.
    pub inliers: u32,
    /// Mean distance of walls found again, metres.
    pub residual_m: f64,
}

/// Looks for submap `j` in submap `i` around a prediction.
pub(crate) fn find(i: GridView<'_>, j: GridView<'_>, predicted: Pose2, window: Window) -> Option<Found> {
    let fields = [i, j].map(|grid| Field::of(Evidence::of(grid, FLOOR_SQUARE_M), grid));
    if fields.iter().any(|field| field.evidence.walls_m.is_empty()) {
        return None;
    }
    let fields = [&fields[0], &fields[1]];
    let [i_from_a, j_from_b] = fields.map(|field| field.evidence.frame_from_middle);
    let centre = i_from_a.inverse() * predicted * j_from_b;
    let found = search(fields, centre, window)?;
    let found_from_centre = centre.between(found.a_from_b);
    let strayed = [found_from_centre.x_m.hypot(found_from_centre.y_m), found_from_centre.yaw_rad.abs()];
    if strayed[0] > window.half_m + STARTS_APART[0] || strayed[1] > window.half_rad + STARTS_APART[1] {
        return None;
    }
    let keep = thinned(fields, POINTS[1]);
    let points = pull(fields, found.a_from_b, keep, STAGES_M[1][1]);
    // Each point stands for those left out, and both maps look at the same walls: the mean of both ways.
    let each = (keep[0] + keep[1]) as f64 / 4.0;
    let information = points * (each / (ALIKE * POINT_SIGMA_M * POINT_SIGMA_M));
    let moved = transport_information(information, i_from_a, found.a_from_b, j_from_b.inverse());
    Some(Found {
        i_from_j: i_from_a * found.a_from_b * j_from_b.inverse(),
        information: limit_information(moved, FLOOR, UNOBSERVED),
        inliers: found.found as u32,
        residual_m: found.residual_m,
    })
}

/// The best place in the window, if it stands out and nothing speaks against it.
fn search(fields: [&Field; 2], centre: Pose2, window: Window) -> Option<Fit> {
    let keep = thinned(fields, POINTS[0]);
    let mut places: Vec<Fit> = Vec::new();
    let mut begin: Vec<(f64, Pose2)> =
        starts(centre, window).map(|start| (nearness(fields, start, keep), start)).collect();
    begin.sort_by(|x, y| y.0.total_cmp(&x.0));
    for (_, start) in begin.into_iter().take(STARTS_REFINED) {
        let found = fit(fields, refine(fields, start, keep, STAGES_M[0]), keep);
        match places.iter_mut().find(|other| same_place(other.a_from_b, found.a_from_b)) {
            Some(other) if other.evidence() < found.evidence() => *other = found,
            Some(_) => {}
            None => places.push(found),
        }
    }
    places.sort_by(|x, y| y.evidence().total_cmp(&x.evidence()));
    places.truncate(FINALISTS);
    let keep = thinned(fields, POINTS[1]);
    for place in &mut places {
        *place = fit(fields, refine(fields, place.a_from_b, keep, STAGES_M[1]), keep);
    }
    places.sort_by(|x, y| y.evidence().total_cmp(&x.evidence()));
    let best = *places.first()?;
    let others = places[1..].iter().filter(|other| !same_place(other.a_from_b, best.a_from_b));
    let rival = others.map(Fit::evidence).fold(LEAST_EVIDENCE, f64::max);
    let believed = best.found >= FOUND_MIN
        && best.conflict() <= CONFLICT_MAX
        && best.observability >= OBSERVABILITY_MIN
        && best.evidence() >= MARGIN_MIN * rival;
    believed.then_some(best)
}

fn starts(centre: Pose2, window: Window) -> impl Iterator<Item = Pose2> {
    let each_side = |half: f64, apart: f64| ((half / apart).ceil() as usize).min(STARTS_MAX) as i64;
    let (n, turns) = (each_side(window.half_m, STARTS_APART[0]), each_side(window.half_rad, STARTS_APART[1]));
    (-turns..=turns).flat_map(move |t| {
        (-n..=n).flat_map(move |y| {
            (-n..=n).map(move |x| {
                let yaw_rad = wrap_angle(centre.yaw_rad + t as f64 * STARTS_APART[1]);
                let [dx, dy] = [x, y].map(|k| k as f64 * STARTS_APART[0]);
                Pose2::new(centre.x_m + dx, centre.y_m + dy, yaw_rad)
            })
        })
    })
}

fn same_place(x: Pose2, y: Pose2) -> bool {
    x.distance_m(y) < SAME_PLACE[0] && wrap_angle(x.yaw_rad - y.yaw_rad).abs() < SAME_PLACE[1]
}

fn thinned(fields: [&Field; 2], points: usize) -> [usize; 2] {
    fields.map(|field| field.evidence.walls_m.len().div_ceil(points).max(1))
}
