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
mod refine;
mod spectrum;
mod translate;
mod verify;

use evidence::Evidence;
use msg::{GridView, Pose2};
use refine::{Field, Fit, coarse_stages, fine_stages};
use serde::{Deserialize, Serialize};
use translate::{COARSE_M, Candidate, Translator};
use verify::{Agreement, agreement};

/// Rotations tried, each with half a turn more.
const ROTATIONS: usize = 8;
/// Places that are refined, best coarse score first.
const REFINED: usize = 24;
/// Wall points used while there are many places to refine.
const COARSE_POINTS: usize = 3_000;
/// Wall points used for the last stage.
const FINE_POINTS: usize = 20_000;
/// Places compared cell by cell.
const VERIFIED: usize = 3;
/// Two places nearer than this are the same, metres and radians.
const SAME_PLACE: [f64; 2] = [0.5, 0.1];

/// When to believe an alignment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AlignConfig {
    /// Of the cells both maps know, at least this share agrees.
    pub strict_min: f64,
    /// F1 of occupied cells at one cell's tolerance, at least.
    pub occupied_f1_min: f64,
    /// Floor and walls both know, square metres, at least.
    pub overlap_min_m2: f64,
    /// Occupied cells found again, of both maps together, at least.
    pub inliers_min: u32,
    /// The best place's evidence over that of the best other place, at least.
    pub margin_min: f64,
    /// Least share of the walls' pull in any direction: below it a map can slide along itself.
    pub firmness_min: f64,
}

impl Default for AlignConfig {
    fn default() -> Self {
        Self {
            strict_min: 0.94,
            occupied_f1_min: 0.80,
            overlap_min_m2: 5.0,
            inliers_min: 200,
            margin_min: 1.2,
            firmness_min: 0.03,
        }
    }
}

/// The best place found for one map in another, with what speaks for it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Alignment {
    /// Frame of the second map to that of the first.
    pub a_from_b: Pose2,
    /// It passed every condition of the gate.
    pub accepted: bool,
    /// Occupied cells found again, of both maps together.
    pub inliers: u32,
    /// F1 of occupied cells at one cell's tolerance, 0 to 1.
    pub score: f64,
    /// Share of the cells both know on which they agree, 0 to 1.
    pub strict: f64,
    /// What both know, square metres.
    pub overlap_m2: f64,
    /// The same over what the map that knows less knows, 0 to 1.
    pub overlap_share: f64,
    /// Mean distance of walls found again, metres.
    pub residual_m: f64,
    /// Evidence over that of the best other place; infinite if there is no other.
    pub margin: f64,
    /// 0: the map can slide along itself; 0.5: held alike in all directions.
    pub firmness: f64,
}

/// Finds where `b` lies in `a`. `None` if one of them has no walls or nothing fits at all; else the
/// best place, which only counts if it is `accepted`.
pub fn align(a: GridView<'_>, b: GridView<'_>, config: &AlignConfig) -> Option<Alignment> {
    let (in_a, in_b) = (Evidence::of(a, COARSE_M), Evidence::of(b, COARSE_M));
    if in_a.walls_m.is_empty() || in_b.walls_m.is_empty() {
        return None;
    }
    let candidates = coarse(&in_a, &in_b);
    let field = Field::of(&in_a, a);
    let fits = refined(&field, &in_b, &candidates);
    let best = fits.iter().take(VERIFIED).map(|fit| finish(&field, &in_a, &in_b, a, b, fit));
    let best = best.max_by(|x, y| walls_agreeing(x).total_cmp(&walls_agreeing(y)))?;
    Some(judge(best, &fits, config, &in_a, &in_b))
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
fn refined(field: &Field, b: &Evidence, candidates: &[Candidate]) -> Vec<Fit> {
    let keep = b.walls_m.len().div_ceil(COARSE_POINTS).max(1);
    let mut fits: Vec<Fit> = Vec::new();
    for candidate in candidates {
        let pose = field.refine(b, candidate.a_from_b, keep, coarse_stages());
        let fit = field.fit(b, pose, keep);
        match fits.iter_mut().find(|other| same_place(other.a_from_b, pose)) {
            Some(other) if other.evidence() < fit.evidence() => *other = fit,
            Some(_) => {}
            None => fits.push(fit),
        }
    }
    fits.sort_by(|x, y| y.evidence().total_cmp(&x.evidence()));
    fits
}

fn same_place(x: Pose2, y: Pose2) -> bool {
    let turn = msg::pose::wrap_angle(x.yaw_rad - y.yaw_rad).abs();
    x.distance_m(y) < SAME_PLACE[0] && turn < SAME_PLACE[1]
}

/// A place with its exact pose and its agreement.
struct Finished {
    fit: Fit,
    coarse: Pose2,
    agreement: Agreement,
}

fn walls_agreeing(one: &Finished) -> f64 {
    one.agreement.occupied_f1 * f64::from(one.agreement.walls_found)
}

fn finish(
    field: &Field,
    in_a: &Evidence,
    in_b: &Evidence,
    a: GridView<'_>,
    b: GridView<'_>,
    fit: &Fit,
) -> Finished {
    let keep = in_b.walls_m.len().div_ceil(FINE_POINTS).max(1);
    let pose = field.refine(in_b, fit.a_from_b, keep, fine_stages());
    let a_from_b = in_a.grid_from_middle() * pose * in_b.grid_from_middle().inverse();
    Finished { fit: field.fit(in_b, pose, keep), coarse: fit.a_from_b, agreement: agreement(a, b, a_from_b) }
}

fn judge(best: Finished, fits: &[Fit], config: &AlignConfig, in_a: &Evidence, in_b: &Evidence) -> Alignment {
    let others = fits.iter().filter(|other| !same_place(other.a_from_b, best.coarse));
    let other = others.map(Fit::evidence).fold(0.0, f64::max);
    let Agreement { strict, occupied_f1, overlap_m2, overlap_share, walls_found } = best.agreement;
    let margin = best.fit.evidence() / other.max(1e-9);
    let firmness = best.fit.firmness;
    let accepted = strict >= config.strict_min
        && occupied_f1 >= config.occupied_f1_min
        && overlap_m2 >= config.overlap_min_m2
        && walls_found >= config.inliers_min
        && margin >= config.margin_min
        && firmness >= config.firmness_min;
    Alignment {
        a_from_b: in_a.grid_from_middle() * best.fit.a_from_b * in_b.grid_from_middle().inverse(),
        accepted,
        inliers: walls_found,
        score: occupied_f1,
        strict,
        overlap_m2,
        overlap_share,
        residual_m: best.fit.residual_m,
        margin,
        firmness,
    }
}
