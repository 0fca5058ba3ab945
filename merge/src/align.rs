//! Unknown start poses: where does one map lie in another?
//!
//! ```text
//! walls, floor ─▶ rotation spectra ─▶ every translation (FFT) ─▶ refined on a's walls ─▶ gate
//!                 8 turns, and half a turn more     4 places each    the best few
//! ```
//!
//! Places are ranked by their walls alone: floor agrees with floor almost anywhere. Carpin's
//! acceptance index, which counts floor too, is one of the conditions of the gate.

mod evidence;
mod fft2;
mod field;
mod fit;
mod refine;
mod spectrum;
mod translate;
mod verify;

use crate::merger::{RESOLUTION_M, is_near};
pub(crate) use evidence::Evidence;
pub(crate) use field::Field;
pub(crate) use fit::{Fit, fit};
use msg::{GridView, Pose2};
use refine::{coarse_stages, fine_stages};
pub(crate) use refine::{nearness, pull, refine};
use serde::{Deserialize, Serialize};
use translate::{COARSE_M, Candidate, Translator};
pub(crate) use verify::{Agreement, agreement};

/// Rotations tried, each with half a turn more.
const ROTATIONS: usize = 12;
/// Places that are refined, best coarse score first.
const REFINED: usize = 24;
/// Wall points used while there are many places to refine.
const COARSE_POINTS: usize = 2_000;
/// Wall points used for the last stage.
const FINE_POINTS: usize = 20_000;
/// Places compared cell by cell.
const VERIFIED: usize = 2;
/// Walls by which a place must be ahead of nothing: what chance finds anywhere.
const LEAST_EVIDENCE: f64 = 50.0;
/// Wrong transforms that say what chance gives, and how many are tried to find them.
const NULL_TRANSFORMS: usize = 20;
const NULL_TRIES: usize = 60;
/// What a small part of both maps agrees on, this share of the smaller one, may be one room that is like another's: it
/// must be so many times [`AlignConfig::overlap_min_m2`].
const PART_SHARE: f64 = 0.2;
const PART_TIMES: f64 = 2.0;
/// Two places nearer than this are the same, metres and radians.
const SAME_PLACE: [f64; 2] = [0.5, 0.1];

/// When to believe an alignment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AlignConfig {
    /// Of the cells both maps know, at least this share agrees.
    pub agreement_min: f64,
    /// F1 of occupied cells at one cell's tolerance, at least.
    pub occupied_f1_min: f64,
    /// Walls of one map in the middle of the other's floor, over those and the walls found, at most:
    /// what tells the best place in the wrong building from a right one most clearly.
    pub conflict_max: f64,
    /// Floor and walls both know, square metres, at least.
    pub overlap_min_m2: f64,
    /// Occupied cells found again, of both maps together, at least.
    pub inliers_min: u32,
    /// The best place's evidence over that of the best other place, at least.
    pub margin_min: f64,
    /// Least share of the walls' pull in any direction: below it a map can slide along itself.
    pub observability_min: f64,
}

impl Default for AlignConfig {
    fn default() -> Self {
        Self {
            agreement_min: 0.94,
            occupied_f1_min: 0.80,
            conflict_max: 0.11,
            overlap_min_m2: 10.0,
            inliers_min: 200,
            margin_min: 1.5,
            observability_min: 0.03,
        }
    }
}

impl AlignConfig {
    /// What is wrong with it, if anything.
    pub fn validate(&self) -> Result<(), String> {
        let shares = [
            ("agreement_min", self.agreement_min),
            ("occupied_f1_min", self.occupied_f1_min),
            ("conflict_max", self.conflict_max),
            ("observability_min", self.observability_min),
        ];
        if let Some((name, value)) = shares.iter().find(|(_, value)| !(0.0..=1.0).contains(value)) {
            return Err(format!("merge.align.{name} is {value}; expected a share, 0 to 1"));
        }
        let amounts = [("overlap_min_m2", self.overlap_min_m2), ("margin_min", self.margin_min)];
        if let Some((name, value)) = amounts.iter().find(|(_, value)| !(value.is_finite() && *value >= 0.0)) {
            return Err(format!("merge.align.{name} is {value}; expected a number from 0"));
        }
        Ok(())
    }
}

/// The best place found for one map in another, with what speaks for it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Alignment {
    /// Frame of the second map to that of the first. Whoever keeps the rest keeps it beside.
    #[serde(skip)]
    pub a_from_b: Pose2,
    /// It passed every condition of the gate.
    pub accepted: bool,
    /// Occupied cells found again, of both maps together.
    pub inliers: u32,
    /// F1 of occupied cells at one cell's tolerance, 0 to 1.
    pub occupied_f1: f64,
    /// Share of the cells both know on which they agree, 0 to 1.
    pub agreement: f64,
    /// What both know, square metres.
    pub overlap_m2: f64,
    /// The same over what the map that knows less knows, 0 to 1.
    pub overlap_share: f64,
    /// Walls of one map in the middle of the other's floor, over those and the walls found, 0 to 1.
    pub conflict: f64,
    /// Mean distance of walls found again, metres.
    pub residual_m: f64,
    /// Evidence (walls found less walls missed) over that of the best other place, or over
    /// `LEAST_EVIDENCE` walls if no other has as much.
    pub margin: f64,
    /// 0: the map can slide along itself; 0.5: held alike in all directions.
    pub observability: f64,
}

/// Finds where `b` lies in `a`. `None` if one of them makes no sense, has no walls, or nothing fits
/// at all; else the best place, which only counts if it is `accepted`.
pub fn align(a: GridView<'_>, b: GridView<'_>, config: &AlignConfig) -> Option<Alignment> {
    if !is_usable(a) || !is_usable(b) {
        return None;
    }
    let walls = [Evidence::of(a, COARSE_M), Evidence::of(b, COARSE_M)];
    if walls.iter().any(|map| map.walls_m.is_empty()) {
        return None;
    }
    let candidates = coarse(&walls[0], &walls[1]);
    let [of_a, of_b] = walls;
    let (field_a, field_b) = (Field::of(of_a, a), Field::of(of_b, b));
    let fields = [&field_a, &field_b];
    let fits = refined(fields, &candidates);
    let exact = fits.iter().take(VERIFIED).map(|coarse| (coarse, finished(fields, coarse)));
    let (coarse, best) = exact.max_by(|x, y| x.1.evidence().total_cmp(&y.1.evidence()))?;
    let others = fits.iter().filter(|other| !same_place(other.a_from_b, coarse.a_from_b));
    let margin = best.evidence() / others.map(Fit::evidence).fold(LEAST_EVIDENCE, f64::max);
    let a_from_b =
        field_a.evidence.frame_from_middle * best.a_from_b * field_b.evidence.frame_from_middle.inverse();
    Some(judge(a_from_b, &best, margin, &agreement(a, b, a_from_b), config))
}

/// The same figures for a place that is already known. `accepted` is whether they pass the gate but
/// for `margin`, which is 0: no other place is looked at.
pub(crate) fn assess(a: GridView<'_>, b: GridView<'_>, a_from_b: Pose2) -> Option<Alignment> {
    if !is_usable(a) || !is_usable(b) {
        return None;
    }
    let [of_a, of_b] = [Evidence::of(a, COARSE_M), Evidence::of(b, COARSE_M)];
    let (field_a, field_b) = (Field::of(of_a, a), Field::of(of_b, b));
    let fields = [&field_a, &field_b];
    let [from_a, from_b] = fields.map(|field| field.evidence.frame_from_middle);
    let fit = fit(fields, from_a.inverse() * a_from_b * from_b, thinned(fields, FINE_POINTS));
    let config = AlignConfig { margin_min: 0.0, ..AlignConfig::default() };
    Some(judge(a_from_b, &fit, 0.0, &agreement(a, b, a_from_b), &config))
}

/// What chance gives: the largest F1 of occupied cells (one cell's tolerance) under
/// [`NULL_TRANSFORMS`] wrong transforms, 2 to 8 m and 20° to 180° off, that leave at least half the
/// overlap. The same maps give the same figure.
pub(crate) fn null_f1(a: GridView<'_>, b: GridView<'_>, a_from_b: Pose2) -> f64 {
    let right = agreement(a, b, a_from_b);
    // The middle of b's walls: turning about it keeps most of the overlap.
    let middle = Evidence::of(b, COARSE_M).frame_from_middle;
    let [x, y] = a_from_b.apply([middle.x_m, middle.y_m]);
    let (mut most, mut left): (f64, usize) = (0.0, NULL_TRANSFORMS);
    for k in 0..NULL_TRIES {
        // Low-discrepancy instead of random: even over all directions, turns and distances.
        let share = |prime: f64| (k as f64 * prime.sqrt()).fract();
        let turn = (0.35 + 2.79 * share(2.0)) * if k % 2 == 0 { 1.0 } else { -1.0 };
        let (shift, towards) = (2.0 + 6.0 * share(3.0), core::f64::consts::TAU * share(5.0));
        let about = Pose2::new(x, y, turn) * Pose2::new(-x, -y, 0.0);
        let wrong = Pose2::new(shift * towards.cos(), shift * towards.sin(), 0.0) * about * a_from_b;
        let found = agreement(a, b, wrong);
        if found.overlap_m2 >= 0.5 * right.overlap_m2 {
            most = most.max(found.occupied_f1);
            left -= 1;
            if left == 0 {
                break;
            }
        }
    }
    most
}

fn is_usable(map: GridView<'_>) -> bool {
    GridView::new(map.header, map.cells).is_some()
        && RESOLUTION_M.contains(&map.header.resolution_m)
        && is_near(map.header.origin)
}

/// Rotations, and for each the best translations; best first.
fn coarse(a: &Evidence, b: &Evidence) -> Vec<Candidate> {
    let turns = spectrum::rotations(&spectrum::spectrum(a), &spectrum::spectrum(b), ROTATIONS);
    let mut translator = Translator::new(a, b);
    let mut candidates: Vec<Candidate> =
        turns.into_iter().flat_map(|turn| translator.candidates(turn)).collect();
    candidates.sort_by(|x, y| y.score.total_cmp(&x.score));
    candidates.truncate(REFINED);
    candidates
}

/// The candidates drawn to the nearest walls, without doubles, most evidence first.
fn refined(fields: [&Field; 2], candidates: &[Candidate]) -> Vec<Fit> {
    let keep = thinned(fields, COARSE_POINTS);
    let mut fits: Vec<Fit> = Vec::new();
    for candidate in candidates {
        let found = fit(fields, refine(fields, candidate.a_from_b, keep, coarse_stages()), keep);
        match fits.iter_mut().find(|other| same_place(other.a_from_b, found.a_from_b)) {
            Some(other) if other.evidence() < found.evidence() => *other = found,
            Some(_) => {}
            None => fits.push(found),
        }
    }
    fits.sort_by(|x, y| y.evidence().total_cmp(&x.evidence()));
    fits
}

/// A refined place once more, by many points.
fn finished(fields: [&Field; 2], coarse: &Fit) -> Fit {
    let keep = thinned(fields, FINE_POINTS);
    fit(fields, refine(fields, coarse.a_from_b, keep, fine_stages()), keep)
}

/// Every how many wall points of either map, to use about so many.
fn thinned(fields: [&Field; 2], points: usize) -> [usize; 2] {
    fields.map(|field| field.evidence.walls_m.len().div_ceil(points).max(1))
}

fn same_place(x: Pose2, y: Pose2) -> bool {
    let turn = msg::pose::wrap_angle(x.yaw_rad - y.yaw_rad).abs();
    x.distance_m(y) < SAME_PLACE[0] && turn < SAME_PLACE[1]
}

fn judge(a_from_b: Pose2, fit: &Fit, margin: f64, agreement: &Agreement, config: &AlignConfig) -> Alignment {
    let Agreement { agreement, occupied_f1, overlap_m2, overlap_share, walls_found } = *agreement;
    let times = if overlap_share < PART_SHARE { PART_TIMES } else { 1.0 };
    let accepted = agreement >= config.agreement_min
        && occupied_f1 >= config.occupied_f1_min
        && fit.conflict() <= config.conflict_max
        && overlap_m2 >= times * config.overlap_min_m2
        && walls_found >= config.inliers_min
        && margin >= config.margin_min
        && fit.observability >= config.observability_min;
    Alignment {
        a_from_b,
        accepted,
        inliers: walls_found,
        occupied_f1,
        agreement,
        overlap_m2,
        overlap_share,
        conflict: fit.conflict(),
        residual_m: fit.residual_m,
        margin,
        observability: fit.observability,
    }
}

#[cfg(test)]
mod tests;
