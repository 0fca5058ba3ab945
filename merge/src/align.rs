//! Alignment of two whole maps whose frames are unrelated: where does one lie in the other?
//!
//! ```text
//! walls, floor ─▶ rotations from Hough spectra ─▶ translations by FFT ─▶ refined on the walls ─▶ accepted?
//!                 12, each with half a turn more   4 of each rotation     the best 24
//! ```
//!
//! Candidates are ranked by their walls alone, because floor agrees with floor almost anywhere. Whether the best one is
//! accepted depends on both maps' cells too ([`AlignConfig`]).

mod contradicted;
mod distance_field;
mod null;
mod points;
mod refine;
mod refusal;
mod repeated;
mod short_walls;
mod spectrum;
mod translation;
mod wall_match;

pub(crate) use contradicted::ComparedSubmaps;
pub(crate) use distance_field::DistanceField;
pub(crate) use null::max_null_f1;
pub(crate) use points::MapPoints;
pub(crate) use refine::{refine, wall_information, wall_proximity};
pub(crate) use wall_match::{WallMatch, match_walls};

use crate::config::AlignConfig;
use crate::limits::{RESOLUTION_M, is_plausible};
use msg::grid_agreement::GridAgreement;
use msg::{AlignmentRefusal, GridView, Pose2, pose::wrap_angle};
use null::compare_cells;
use refine::{COARSE_KERNELS_M, FINE_KERNELS_M};
use refusal::refusal_of;
use repeated::repeated_places;
use serde::{Deserialize, Serialize};
use short_walls::{ShortWallMatch, ShortWalls, match_short_walls};
use translation::{COARSE_CELL_M, CoarseCandidate, TranslationSearch};

/// Rotations tried, each with half a turn more.
const ROTATIONS: usize = 12;
/// Candidates that are refined, those of the best coarse score.
const REFINED_MAX: usize = 24;
/// Wall points used while there are many candidates to refine.
const COARSE_POINTS: usize = 2_000;
/// Wall points used for the last refinement.
const FINE_POINTS: usize = 20_000;
/// Candidates that are refined by many points.
const FINALISTS: usize = 2;
/// Least score assumed for the best other place, metres of wall: chance finds as much anywhere.
const RIVAL_WALLS_MIN_M: f64 = 2.5;
/// Least length of matching short walls assumed for the best other place, metres.
const RIVAL_SHORT_WALLS_MIN_M: f64 = 2.0;
/// Rounding of a length of walls, metres: far below a cell.
const WALLS_ROUNDING_M: f64 = 1e-6;
/// Share of the smaller map below which an overlap is small. It may then be a room that is like another.
const SMALL_OVERLAP_SHARE: f64 = 0.2;
/// Factor on [`AlignConfig::overlap_min_m2`] for an overlap with such a small share.
const SMALL_OVERLAP_FACTOR: f64 = 2.0;
/// Largest distance of two alignments that are one place, metres.
const SAME_PLACE_M: f64 = 0.5;
/// Largest rotation between two alignments that are one place, radians.
const SAME_PLACE_RAD: f64 = 0.1;

/// The best transform found between two maps, with its evidence.
// More than 12 fields: each is one figure of the evidence, with a threshold or a column of its own.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Alignment {
    /// Frame of the first map from that of the second. It is not serialised: the edge keeps the transform beside
    /// its evidence.
    #[serde(skip)]
    pub a_from_b: Pose2,
    /// Whether it passed every threshold of the [`AlignConfig`].
    pub accepted: bool,
    /// The first threshold that it fails; none if it is accepted, and after a restart.
    #[serde(skip)]
    pub refusal: Option<AlignmentRefusal>,
    /// Occupied cells that the other map has too, of both maps together.
    pub inliers: u32,
    /// F1 of occupied cells at the tolerance of [`tolerance_m`](crate::config::WallConfig::tolerance_m), 0 to 1.
    pub occupied_f1: f64,
    /// Share of the cells known to both maps on which they agree, 0 to 1.
    pub agreement: f64,
    /// Area known to both maps, square metres.
    pub overlap_m2: f64,
    /// The same over the known area of the map that knows less, 0 to 1.
    pub overlap_share: f64,
    /// Share of walls that lie on the other map's floor, 0 to 1.
    pub conflict: f64,
    /// The same where long walls that match do not count: rooms of one size share those, 0 to 1.
    pub short_wall_conflict: f64,
    /// Length of short walls that match, of both maps together, metres.
    pub short_walls_m: f64,
    /// Mean distance of matched walls, metres.
    pub residual_m: f64,
    /// Matched walls less contradicted ones (weighted 2.7), metres.
    pub score_m: f64,
    /// That score over that of the best other place, or over that of 2.5 m of wall if no other place has as many. 0 where
    /// only one place was looked at.
    pub margin: f64,
    /// Length of short walls that match over that at the best other place that nothing contradicts, or over 2 m if no other place
    /// has as many. 0 where only one place was looked at, or where the place fails already.
    pub short_walls_margin: f64,
    /// Observability of the position: 0 if the map can slide along itself, 0.5 if it is held alike in all directions.
    pub observability: f64,
}

/// Finds the transform of map `b` in map `a`, whatever their frames.
///
/// Returns the best one, which counts only if it is `accepted`. Returns `None` if a map is malformed or has no walls,
/// or if nothing matches at all.
///
/// ```
/// use merge::{AlignConfig, align};
/// use msg::{Grid, GridHeader, Pose2};
///
/// // A floor plan of 12 m x 9 m with rooms and furniture: is there an obstacle at a point (metres)?
/// let is_obstacle = |x: f64, y: f64| {
///     let outer = x < 0.1 || x > 11.9 || y < 0.1 || y > 8.9;
///     let walls = ((4.0..4.1).contains(&x) && !(2.0..3.0).contains(&y))
///         || ((5.0..5.1).contains(&y) && x > 4.0 && !(7.0..8.0).contains(&x));
///     let furniture = [(1.0..2.2, 1.0..1.7), (6.0..7.3, 1.0..1.6), (9.0..9.8, 6.4..7.6), (1.5..1.9, 6.0..7.2)];
///     outer || walls || furniture.iter().any(|(across, along)| across.contains(&x) && along.contains(&y))
/// };
/// // What a robot maps that starts at a pose in the plan: 10 m around it.
/// let map_from = |start: Pose2| {
///     let origin = Pose2::new(-10.0, -10.0, 0.0);
///     let header = GridHeader { origin, resolution_m: 0.05, width: 400, height: 400, ..Default::default() };
///     let mut grid = Grid { header, cells: vec![msg::grid::UNKNOWN; 400 * 400] };
///     for i in 0..400 * 400 {
///         let [x, y] = start.apply(grid.view().centre_m(i % 400, i / 400));
///         if (0.0..12.0).contains(&x) && (0.0..9.0).contains(&y) {
///             grid.cells[i as usize] = if is_obstacle(x, y) { 80 } else { -80 };
///         }
///     }
///     grid
/// };
/// let starts = [Pose2::new(2.0, 3.0, 0.0), Pose2::new(9.0, 3.0, 1.0)];
/// let [a, b] = starts.map(map_from);
///
/// let found = align(a.view(), b.view(), &AlignConfig::default()).unwrap();
/// assert!(found.accepted, "{found:?}");
/// assert!(found.a_from_b.distance_m(starts[0].between(starts[1])) < 0.05);
/// ```
pub fn align(a: GridView<'_>, b: GridView<'_>, config: &AlignConfig) -> Option<Alignment> {
    let points = points_with_walls([a, b])?;
    let candidates = find_candidates(&points[0], &points[1]);
    let [points_a, points_b] = points;
    let walls = &config.walls;
    let (field_a, field_b) = (DistanceField::new(points_a, a, walls), DistanceField::new(points_b, b, walls));
    let fields = [&field_a, &field_b];
    let places = refine_candidates(fields, &candidates);
    let (best, margins) = CandidateVerifier::new(fields).choose(&places, config)?;
    let a_from_b =
        field_a.points.frame_from_centred * best.fine.a_from_b * field_b.points.frame_from_centred.inverse();
    Some(decide([a, b], a_from_b, &best, margins, config))
}

/// A place that was refined by many points.
struct RefinedCandidate {
    /// The walls of both maps there.
    fine: WallMatch,
    /// The short walls of both maps there.
    short_walls: ShortWallMatch,
}

impl RefinedCandidate {
    /// Whether neither all walls nor short walls alone contradict it.
    fn is_possible(&self, config: &AlignConfig) -> bool {
        self.fine.conflict() <= config.conflict_max
            && self.short_walls.conflict() <= config.short_wall_conflict_max
    }
}

/// Two maps with their short walls.
struct CandidateVerifier<'a> {
    fields: [&'a DistanceField; 2],
    short_walls: [ShortWalls; 2],
}

impl<'a> CandidateVerifier<'a> {
    fn new(fields: [&'a DistanceField; 2]) -> Self {
        Self { fields, short_walls: fields.map(ShortWalls::new) }
    }

    /// Compares the short walls, and adds them to the long ones.
    fn compare_short_walls(&self, fine: WallMatch) -> RefinedCandidate {
        RefinedCandidate {
            fine,
            short_walls: match_short_walls(self.fields, self.short_walls.each_ref(), fine.a_from_b),
        }
    }

    /// Returns the best place with its margins over all others.
    fn choose(&self, places: &[WallMatch], config: &AlignConfig) -> Option<(RefinedCandidate, Margins)> {
        let finalists = places.iter().take(FINALISTS).map(|coarse| refine_finely(self.fields, coarse));
        let best = self.compare_short_walls(finalists.max_by(|x, y| x.score().total_cmp(&y.score()))?);
        let is_other = |other: &&WallMatch| !is_same_place(other.a_from_b, best.fine.a_from_b);
        let others = places.iter().filter(is_other).map(WallMatch::score);
        let score = best.fine.score() / others.fold(rival_score_min(self.fields), f64::max);
        if score < config.margin_min || !best.is_possible(config) {
            return Some((best, Margins { score, short_walls: 0.0 }));
        }
        let repeated = repeated_places(self.fields, &self.short_walls[1], best.fine.a_from_b);
        let rivals =
            places.iter().chain(&repeated).filter(is_other).map(|other| self.compare_short_walls(*other));
        let short_walls_m =
            rivals.filter(|rival| rival.is_possible(config)).map(|rival| rival.short_walls.matched_m);
        let short_walls = best.short_walls.matched_m / short_walls_m.fold(RIVAL_SHORT_WALLS_MIN_M, f64::max);
        Some((best, Margins { score, short_walls }))
    }
}

/// Ratios of a place to the best other place; 0 where no other was looked at.
#[derive(Clone, Copy, Default)]
struct Margins {
    /// Of the scores.
    score: f64,
    /// Of the lengths of short walls that match. Places that something contradicts do not count.
    short_walls: f64,
}

/// Returns the points of both maps; `None` if one is malformed or has no walls.
fn points_with_walls(maps: [GridView<'_>; 2]) -> Option<[MapPoints; 2]> {
    if !maps.into_iter().all(is_usable) {
        return None;
    }
    let points = maps.map(|map| MapPoints::from_grid(map, COARSE_CELL_M));
    points.iter().all(|map| !map.walls_m.is_empty()).then_some(points)
}

/// Refines a transform that is roughly known, and computes the evidence for it.
///
/// `accepted` leaves out the margin, which is 0: no other place is looked at. `None` if a map is malformed or has no walls.
pub fn align_near(
    a: GridView<'_>,
    b: GridView<'_>,
    a_from_b: Pose2,
    config: &AlignConfig,
) -> Option<Alignment> {
    let points = points_with_walls([a, b])?;
    let [from_a, from_b] = points.each_ref().map(|points| points.frame_from_centred);
    let [points_a, points_b] = points;
    let fields =
        [DistanceField::new(points_a, a, &config.walls), DistanceField::new(points_b, b, &config.walls)];
    let fields = [&fields[0], &fields[1]];
    let strides = strides(fields, FINE_POINTS);
    let refined = refine(fields, from_a.inverse() * a_from_b * from_b, strides, COARSE_KERNELS_M);
    let matched = match_walls(fields, refined, strides);
    let config = without_margins(config);
    let candidate = CandidateVerifier::new(fields).compare_short_walls(matched);
    Some(decide([a, b], from_a * refined * from_b.inverse(), &candidate, Margins::default(), &config))
}

/// Computes the evidence for a given transform. `accepted` leaves out the margin, which is 0: no other place is looked
/// at. `None` if a map is malformed.
pub(crate) fn evaluate(
    a: GridView<'_>,
    b: GridView<'_>,
    a_from_b: Pose2,
    config: &AlignConfig,
) -> Option<Alignment> {
    if !is_usable(a) || !is_usable(b) {
        return None;
    }
    let fields = [a, b].map(|map| DistanceField::of_map(map, &config.walls));
    let fields = [&fields[0], &fields[1]];
    let matched = match_walls_at(fields, a_from_b);
    let candidate = CandidateVerifier::new(fields).compare_short_walls(matched);
    let config = without_margins(config);
    Some(decide([a, b], a_from_b, &candidate, Margins::default(), &config))
}

/// Matches the walls of two maps under a transform between the maps' own frames.
fn match_walls_at(fields: [&DistanceField; 2], a_from_b: Pose2) -> WallMatch {
    let [from_a, from_b] = fields.map(|field| field.points.frame_from_centred);
    match_walls(fields, from_a.inverse() * a_from_b * from_b, strides(fields, FINE_POINTS))
}

/// Returns the thresholds for one place alone.
fn without_margins(config: &AlignConfig) -> AlignConfig {
    AlignConfig { margin_min: 0.0, short_walls_margin_min: 0.0, ..config.clone() }
}

/// Returns the number of wall points of a length of walls.
pub(crate) fn wall_points([a, b]: [&DistanceField; 2], length_m: f64) -> f64 {
    length_m / ((a.points.wall_point_m + b.points.wall_point_m) / 2.0)
}

/// Returns the least score assumed for the best other place, wall points.
pub(crate) fn rival_score_min(fields: [&DistanceField; 2]) -> f64 {
    wall_points(fields, RIVAL_WALLS_MIN_M)
}

/// Returns the strides at which about this many wall points of each map are used.
pub(crate) fn strides(fields: [&DistanceField; 2], points: usize) -> [usize; 2] {
    fields.map(|field| field.points.walls_m.len().div_ceil(points).max(1))
}

/// Adds a place to a list, or replaces the entry of the same place if it has a better score.
pub(crate) fn keep_better(
    places: &mut Vec<WallMatch>,
    found: WallMatch,
    is_same_place: impl Fn(Pose2, Pose2) -> bool,
) {
    match places.iter_mut().find(|other| is_same_place(other.a_from_b, found.a_from_b)) {
        Some(other) if other.score() < found.score() => *other = found,
        Some(_) => {}
        None => places.push(found),
    }
}

/// Sorts places by score, best first.
pub(crate) fn sort_by_score(places: &mut [WallMatch]) {
    places.sort_by(|x, y| y.score().total_cmp(&x.score()));
}

fn is_usable(map: GridView<'_>) -> bool {
    GridView::new(map.header, map.cells).is_some()
        && RESOLUTION_M.contains(&map.header.resolution_m)
        && is_plausible(map.header.origin)
}

/// Coarse candidates: the best translations of each rotation, best score first.
fn find_candidates(a: &MapPoints, b: &MapPoints) -> Vec<CoarseCandidate> {
    let spectra = [a, b].map(spectrum::hough_spectrum);
    let rotations = spectrum::candidate_rotations(&spectra[0], &spectra[1], ROTATIONS);
    let mut search = TranslationSearch::new(a, b);
    let mut candidates: Vec<CoarseCandidate> =
        rotations.into_iter().flat_map(|rotation| search.find_candidates(rotation)).collect();
    candidates.sort_by(|x, y| y.score.total_cmp(&x.score));
    candidates.truncate(REFINED_MAX);
    candidates
}

/// Refines candidates by few points; one entry a place, best score first.
fn refine_candidates(fields: [&DistanceField; 2], candidates: &[CoarseCandidate]) -> Vec<WallMatch> {
    let strides = strides(fields, COARSE_POINTS);
    let mut places: Vec<WallMatch> = Vec::new();
    for candidate in candidates {
        let refined = refine(fields, candidate.a_from_b, strides, COARSE_KERNELS_M);
        keep_better(&mut places, match_walls(fields, refined, strides), is_same_place);
    }
    sort_by_score(&mut places);
    places
}

/// Refines a place by many points.
fn refine_finely(fields: [&DistanceField; 2], coarse: &WallMatch) -> WallMatch {
    let strides = strides(fields, FINE_POINTS);
    match_walls(fields, refine(fields, coarse.a_from_b, strides, FINE_KERNELS_M), strides)
}

fn is_same_place(x: Pose2, y: Pose2) -> bool {
    x.distance_m(y) < SAME_PLACE_M && wrap_angle(x.yaw_rad - y.yaw_rad).abs() < SAME_PLACE_RAD
}

/// Compares the evidence with the thresholds.
fn decide(
    [a, b]: [GridView<'_>; 2],
    a_from_b: Pose2,
    candidate: &RefinedCandidate,
    margins: Margins,
    config: &AlignConfig,
) -> Alignment {
    let (walls, short_walls) = (&candidate.fine, &candidate.short_walls);
    let cells = compare_cells(a, b, a_from_b, &config.walls);
    let GridAgreement { agreement, occupied_f1, overlap_m2, overlap_share, occupied_found, .. } = cells;
    let [walls_a_m, walls_b_m] =
        [(a, 0), (b, 1)].map(|(map, k)| occupied_found[k] as f64 * map.header.resolution_m);
    let inliers = (occupied_found[0] + occupied_found[1]) as u32;
    let mut found = Alignment {
        a_from_b,
        accepted: false,
        refusal: None,
        inliers,
        occupied_f1,
        agreement,
        overlap_m2,
        overlap_share,
        conflict: walls.conflict(),
        short_wall_conflict: short_walls.conflict(),
        short_walls_m: short_walls.matched_m,
        residual_m: walls.residual_m,
        score_m: walls.score() * a.header.resolution_m,
        margin: margins.score,
        short_walls_margin: margins.short_walls,
        observability: walls.observability,
    };
    found.refusal = refusal_of(&found, candidate, walls_a_m + walls_b_m, config);
    found.accepted = found.refusal.is_none();
    found
}

#[cfg(test)]
mod tests;
