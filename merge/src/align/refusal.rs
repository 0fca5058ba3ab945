//! The thresholds that an alignment must pass.

use super::{Alignment, RefinedCandidate, SMALL_OVERLAP_FACTOR, SMALL_OVERLAP_SHARE, WALLS_ROUNDING_M};
use crate::config::AlignConfig;
use msg::AlignmentRefusal;

/// Returns the first threshold that an alignment fails, if any: what it needs to be compared at all first, what tells it from other
/// places last. `walls_m` is the length of walls that are in both maps, of both together.
pub(super) fn refusal_of(
    found: &Alignment,
    candidate: &RefinedCandidate,
    walls_m: f64,
    config: &AlignConfig,
) -> Option<AlignmentRefusal> {
    let factor = if found.overlap_share < SMALL_OVERLAP_SHARE { SMALL_OVERLAP_FACTOR } else { 1.0 };
    let passed = [
        (AlignmentRefusal::LittleOverlap, found.overlap_m2 >= factor * config.overlap_min_m2),
        (AlignmentRefusal::FewWalls, walls_m >= config.walls_min_m - WALLS_ROUNDING_M),
        (AlignmentRefusal::Contradicted, candidate.is_possible(config)),
        (AlignmentRefusal::LittleAgreement, found.agreement >= config.agreement_min),
        (AlignmentRefusal::LittleAgreement, found.occupied_f1 >= config.occupied_f1_min),
        (AlignmentRefusal::FewShortWalls, found.short_walls_m >= config.short_walls_min_m),
        (AlignmentRefusal::Slides, found.observability >= config.observability_min),
        (AlignmentRefusal::OtherPlace, found.margin >= config.margin_min),
        (AlignmentRefusal::OtherPlace, found.short_walls_margin >= config.short_walls_margin_min),
    ];
    passed.into_iter().find(|(_, passed)| !passed).map(|(reason, _)| reason)
}
