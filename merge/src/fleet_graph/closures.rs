//! Closures between two robots, and the choice of the submaps to match next.

use super::robot::Robot;
use super::submap_match::{SearchWindow, SubmapMatch, match_submaps};
use crate::config::MergeConfig;
use msg::{Grid, Pose2};
use posegraph::{Edge, Kernel, PoseSigmas};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Most closures kept between two robots: the oldest go first.
const CLOSURES_MAX: usize = 192;
/// Closures of one submap with the other robot after which it is not matched again: further ones add little.
const CLOSURES_PER_SUBMAP: usize = 3;
/// Failed matches after which a submap is not matched again.
const FAILURES_PER_SUBMAP: usize = 4;
/// Two submaps overlap enough to be matched if their centres are nearer than this share of the sum of their radii.
const NEAR_SHARE: f64 = 0.35;
/// Pairs of submaps looked at for the next match: bounds the time of one search.
const LOOKED_AT_MAX: usize = 4096;
/// Standard deviations of an alignment of whole maps.
const ALIGNMENT_SIGMAS: PoseSigmas = PoseSigmas { position_m: 0.05, heading_rad: 0.01 };
/// Standard deviation of a prediction, metres: at a closure, and more for each metre driven from there.
const PREDICTION_SIGMA_M: [f64; 2] = [0.08, 0.02];
/// The same in radians.
const PREDICTION_SIGMA_RAD: [f64; 2] = [0.02, 0.002];
/// Half width of the search window in standard deviations of the prediction; limited by the two ranges below.
const WINDOW_SIGMAS: f64 = 2.5;
/// Smallest and largest half width of the search window, metres.
const WINDOW_M: [f64; 2] = [0.25, 1.05];
/// Smallest and largest half width of the search window, radians.
const WINDOW_RAD: [f64; 2] = [0.06, 0.18];
/// A failed match is tried again when a closure has come nearer: the distance driven to it has shrunk to this share.
const RETRY_SHARE: f64 = 0.4;
/// Kernel of closures, which may be wrong: beyond 2 standard deviations their weight falls. SLAM's own links between
/// submaps have passed SLAM's checks and have full weight.
const CLOSURE_KERNEL: Kernel = Kernel::Cauchy { sigmas: 2.0 };

/// A measured relation between submaps of two robots.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Closure {
    /// Submaps of the first and of the second robot.
    pub ids: [usize; 2],
    /// Relative pose of the two submaps and its information, from matching their grids.
    pub measured: SubmapMatch,
}

impl Closure {
    /// Returns the closure as an edge of a graph in which the robots' submaps begin at these poses.
    pub fn edge(&self, first: [usize; 2]) -> Edge {
        Edge {
            a: first[0] + self.ids[0],
            b: first[1] + self.ids[1],
            a_from_b: self.measured.i_from_j,
            information: self.measured.information,
            kernel: CLOSURE_KERNEL,
        }
    }
}

/// Relation of two submaps of the same place, derived from an alignment of the whole maps. It links the maps
/// until there are closures.
#[derive(Clone, Copy, Debug)]
struct AlignmentLink {
    ids: [usize; 2],
    i_from_j: Pose2,
}

/// Outcome of matching two submaps.
#[derive(Clone, Copy, Debug)]
struct Attempt {
    /// Distance driven from the nearest closure at that time, metres.
    distance_m: f64,
    succeeded: bool,
}

/// All closures between two robots.
#[derive(Clone, Debug, Default)]
pub(crate) struct ClosureSet {
    found: Vec<Closure>,
    active: Vec<usize>,
    residual_m: f64,
    attempts: BTreeMap<(usize, usize), Attempt>,
    alignment: Option<AlignmentLink>,
}

/// Work: match two submaps.
#[derive(Debug)]
pub(crate) struct MatchJob {
    pair: usize,
    ids: [usize; 2],
    grids: [Arc<Grid>; 2],
    predicted: Pose2,
    window: SearchWindow,
    config: MergeConfig,
}

/// Result of a [`MatchJob`].
#[derive(Debug)]
pub(crate) struct SubmapMatchResult {
    /// Index of the pair of robots.
    pub pair: usize,
    ids: [usize; 2],
    found: Option<SubmapMatch>,
}

impl MatchJob {
    /// Matches the submaps.
    pub fn run(self) -> SubmapMatchResult {
        let [i, j] = &self.grids;
        let found = match_submaps(i.view(), j.view(), self.predicted, self.window, &self.config);
        SubmapMatchResult { pair: self.pair, ids: self.ids, found }
    }
}

impl ClosureSet {
    /// Forgets everything between the two robots.
    pub fn clear(&mut self) {
        *self = Self { residual_m: self.residual_m, ..Self::default() };
    }

    /// Returns all closures found, active or not.
    pub fn found(&self) -> &[Closure] {
        &self.found
    }

    /// Returns the indices of the closures that the last solution kept.
    pub fn active(&self) -> &[usize] {
        &self.active
    }

    /// Returns the mean residual of the closures in the last solution, metres.
    pub fn residual_m(&self) -> f64 {
        self.residual_m
    }

    /// Records which closures a solution kept, and their mean residual.
    pub fn apply_solution(&mut self, active: Vec<usize>, residual_m: f64) {
        (self.active, self.residual_m) = (active, residual_m);
    }

    /// Links the two submaps whose centres are nearest to each other by the alignment of the whole maps, unless there is
    /// such a link.
    pub fn link_by_alignment(&mut self, a_from_b: Pose2, a: &Robot, b: &Robot) {
        if self.alignment.is_some() {
            return;
        }
        let mut best: Option<(f64, [usize; 2])> = None;
        for i in 0..a.submaps.poses().len() {
            for j in 0..b.submaps.poses().len() {
                let (Some(x), Some(y)) = (a.submaps.centre_m(i), b.submaps.centre_m(j)) else { continue };
                let y = a_from_b.apply(y);
                let distance_m = (x[0] - y[0]).hypot(x[1] - y[1]);
                if best.is_none_or(|(least_m, _)| distance_m < least_m) {
                    best = Some((distance_m, [i, j]));
                }
            }
        }
        self.alignment = best.map(|(_, [i, j])| AlignmentLink {
            ids: [i, j],
            i_from_j: a.submaps.poses()[i].inverse() * a_from_b * b.submaps.poses()[j],
        });
    }

    /// Returns the link by alignment as an edge of a graph in which the robots' submaps begin at these poses.
    pub fn alignment_edge(&self, first: [usize; 2]) -> Option<Edge> {
        let AlignmentLink { ids, i_from_j } = self.alignment?;
        Some(Edge {
            a: first[0] + ids[0],
            b: first[1] + ids[1],
            a_from_b: i_from_j,
            information: ALIGNMENT_SIGMAS.information(),
            kernel: Kernel::Quadratic,
        })
    }

    /// Returns the next match: of the untried pairs of finished, overlapping submaps, the one whose prediction
    /// is the most certain.
    pub fn next_match(&self, pair: usize, [a, b]: [&Robot; 2], config: &MergeConfig) -> Option<MatchJob> {
        let mut best: Option<(f64, [usize; 2], Pose2)> = None;
        let mut looked_at = 0;
        let exhausted = self.exhausted([a, b]);
        'pairs: for i in 0..a.submaps.poses().len() {
            for j in 0..b.submaps.poses().len() {
                let Some(predicted) = predict_overlap([a, b], [i, j]) else { continue };
                let attempt = self.attempts.get(&(i, j));
                if exhausted[0][i] || exhausted[1][j] || attempt.is_some_and(|attempt| attempt.succeeded) {
                    continue;
                }
                looked_at += 1;
                let distance_m = self.distance_to_closure_m(a, b, [i, j]);
                if attempt.is_some_and(|attempt| distance_m >= RETRY_SHARE * attempt.distance_m) {
                    continue;
                }
                if best.is_none_or(|(least_m, ..)| distance_m < least_m) {
                    best = Some((distance_m, [i, j], predicted));
                }
                if looked_at >= LOOKED_AT_MAX {
                    break 'pairs;
                }
            }
        }
        let (distance_m, ids, predicted) = best?;
        let ((i, _), (j, _)) = a.submaps.get(ids[0]).zip(b.submaps.get(ids[1]))?;
        let grids = [i.grid.clone(), j.grid.clone()];
        let window = window(distance_m);
        Some(MatchJob { pair, ids, grids, predicted, window, config: config.clone() })
    }

    /// Records the result of a match; returns whether a closure was found.
    pub fn record(&mut self, a: &Robot, b: &Robot, result: SubmapMatchResult) -> bool {
        let SubmapMatchResult { ids, found, .. } = result;
        let attempt =
            Attempt { distance_m: self.distance_to_closure_m(a, b, ids), succeeded: found.is_some() };
        self.attempts.insert((ids[0], ids[1]), attempt);
        let Some(measured) = found else { return false };
        match self.found.iter_mut().find(|closure| closure.ids == ids) {
            Some(closure) => closure.measured = measured,
            None => self.push(Closure { ids, measured }),
        }
        true
    }

    /// Adds a closure; the oldest goes if there are too many.
    pub fn push(&mut self, closure: Closure) {
        if self.found.len() == CLOSURES_MAX {
            self.found.remove(0);
            self.active.clear();
        }
        self.found.push(closure);
    }

    /// Returns for each submap of both robots whether it has enough closures or failures not to be matched again.
    fn exhausted(&self, robots: [&Robot; 2]) -> [Vec<bool>; 2] {
        let counts = |ids: &mut dyn Iterator<Item = [usize; 2]>| {
            let mut counts = robots.map(|robot| vec![0; robot.submaps.poses().len()]);
            for pair in ids {
                for (counts, id) in counts.iter_mut().zip(pair) {
                    counts.get_mut(id).into_iter().for_each(|count| *count += 1);
                }
            }
            counts
        };
        let closures = counts(&mut self.found.iter().map(|closure| closure.ids));
        let failed = self.attempts.iter().filter(|(_, attempt)| !attempt.succeeded);
        let failures = counts(&mut failed.map(|((i, j), _)| [*i, *j]));
        [0, 1].map(|side| {
            let each = closures[side].iter().zip(&failures[side]);
            each.map(|(c, f)| *c >= CLOSURES_PER_SUBMAP || *f >= FAILURES_PER_SUBMAP).collect()
        })
    }

    /// Returns the least distance that the robots drove between two submaps and where their relation is known, metres.
    fn distance_to_closure_m(&self, a: &Robot, b: &Robot, [i, j]: [usize; 2]) -> f64 {
        let from = |[m, n]: [usize; 2]| a.submaps.distance_driven_m(i, m) + b.submaps.distance_driven_m(j, n);
        let closures = self.active.iter().filter_map(|k| self.found.get(*k)).map(|c| c.ids);
        let known = closures.chain(self.alignment.map(|link| link.ids));
        let least_m = known.map(from).fold(f64::INFINITY, f64::min);
        // Robots whose starts were given are known to each other there.
        if least_m.is_finite() { least_m } else { from([0, 0]) }
    }
}

/// Predicts the relation of two submaps if both are finished, have arrived and overlap enough.
fn predict_overlap([a, b]: [&Robot; 2], [i, j]: [usize; 2]) -> Option<Pose2> {
    let ((of_i, _), (of_j, _)) = a.submaps.get(i).zip(b.submaps.get(j))?;
    let predicted = a.map_from_submap(i)?.between(b.map_from_submap(j)?);
    let [x, y] = predicted.apply(of_j.centre_m);
    let distance_m = (x - of_i.centre_m[0]).hypot(y - of_i.centre_m[1]);
    let overlaps = distance_m <= NEAR_SHARE * (of_i.radius_m + of_j.radius_m);
    (of_i.finished && of_j.finished && overlaps).then_some(predicted)
}

/// Returns the search window of a prediction, given the metres driven from the nearest known relation of the robots.
fn window(distance_m: f64) -> SearchWindow {
    let half = |[at, per_m]: [f64; 2], [least, most]: [f64; 2]| {
        (WINDOW_SIGMAS * (at + per_m * distance_m)).clamp(least, most)
    };
    SearchWindow {
        half_m: half(PREDICTION_SIGMA_M, WINDOW_M),
        half_rad: half(PREDICTION_SIGMA_RAD, WINDOW_RAD),
    }
}
