//! Null distribution of an alignment, the agreement of the same two maps under wrong transforms.

use super::points::MapPoints;
use super::translation::COARSE_CELL_M;
use crate::config::WallConfig;
use core::f64::consts::TAU;
use msg::grid_agreement::{GridAgreement, compare_grids};
use msg::{GridView, Pose2};

/// Wrong transforms of which the largest F1 counts.
const TRANSFORMS: usize = 20;
/// Most transforms tried to find them.
const TRIES_MAX: usize = 60;
/// Share of the right transform's overlap that a wrong one must leave.
const OVERLAP_SHARE_MIN: f64 = 0.5;
/// Smallest rotation of a wrong transform, and how much larger it can be, radians: 20° to 180° either way.
const ROTATION_RAD: [f64; 2] = [0.35, 2.79];
/// Smallest translation of a wrong transform, and how much longer it can be, metres.
const TRANSLATION_M: [f64; 2] = [2.0, 6.0];

/// Largest F1 of occupied cells under wrong transforms: what chance reaches.
///
/// Each is 2 to 8 m and 20° to 180° off and leaves at least half the overlap. The same maps give the same figure. The
/// fleet's statistics give a mean instead (`telemetry`).
pub(crate) fn max_null_f1(a: GridView<'_>, b: GridView<'_>, a_from_b: Pose2, config: &WallConfig) -> f64 {
    let right = compare_cells(a, b, a_from_b, config);
    // Rotating about the centre of b's walls keeps most of the overlap.
    let centre = MapPoints::from_grid(b, COARSE_CELL_M).frame_from_centred;
    let [x, y] = a_from_b.apply([centre.x_m, centre.y_m]);
    let (mut largest, mut left): (f64, usize) = (0.0, TRANSFORMS);
    for k in 0..TRIES_MAX {
        // A low-discrepancy sequence covers directions, rotations and distances more evenly than random numbers.
        let share = |prime: f64| (k as f64 * prime.sqrt()).fract();
        let sign = if k % 2 == 0 { 1.0 } else { -1.0 };
        let rotation = (ROTATION_RAD[0] + ROTATION_RAD[1] * share(2.0)) * sign;
        let (translation, direction) = (TRANSLATION_M[0] + TRANSLATION_M[1] * share(3.0), TAU * share(5.0));
        let rotated = Pose2::new(x, y, rotation) * Pose2::new(-x, -y, 0.0);
        let wrong = Pose2::new(translation * direction.cos(), translation * direction.sin(), 0.0)
            * rotated
            * a_from_b;
        let found = compare_cells(a, b, wrong, config);
        if found.overlap_m2 >= OVERLAP_SHARE_MIN * right.overlap_m2 {
            largest = largest.max(found.occupied_f1);
            left -= 1;
            if left == 0 {
                break;
            }
        }
    }
    largest
}

/// Compares two grids cell by cell; all zero if they have no cell in common.
pub(super) fn compare_cells(
    a: GridView<'_>,
    b: GridView<'_>,
    a_from_b: Pose2,
    config: &WallConfig,
) -> GridAgreement {
    compare_grids(a, b, a_from_b, config.tolerance_m).unwrap_or_default()
}
