//! Maps whose consistency is known.

use super::*;
use crate::testing::{house, within};
use msg::grid::{UNKNOWN, known_count};
use msg::{Grid, GridHeader};
use proptest::prelude::*;

/// The same cells, one cell further along x.
fn shifted(grid: &Grid) -> Grid {
    let view = grid.view();
    let (width, height) = (i64::from(grid.header.width), i64::from(grid.header.height));
    let cells = (0..height).flat_map(|y| (0..width).map(move |x| view.cell(x - 1, y))).collect();
    Grid { header: grid.header, cells }
}

#[test]
fn a_map_is_consistent_with_itself() {
    let map = house();
    let same = compare(map.view(), map.view(), Pose2::IDENTITY).unwrap();
    let known = known_count(&map.cells) as f64;
    assert_eq!(
        (same.agreement, same.agreement_near, same.occupied_f1, same.overlap_share),
        (1.0, 1.0, 1.0, 1.0)
    );
    within(same.overlap_m2, known * 0.0025, 1e-9);
}

#[test]
fn one_cell_beside_is_forgiven_only_by_the_tolerant_figures() {
    let map = house();
    let beside = compare(map.view(), shifted(&map).view(), Pose2::IDENTITY).unwrap();
    assert!(beside.agreement < 0.985, "{beside:?}");
    assert!(beside.agreement_near > 0.999, "{beside:?}");
    assert!(beside.occupied_f1 > 0.999, "{beside:?}");
    let right = compare(map.view(), shifted(&map).view(), Pose2::new(-0.05, 0.0, 0.0)).unwrap();
    assert_eq!((right.agreement, right.occupied_f1), (1.0, 1.0));
}

#[test]
fn figures_equal_hand_counted_ones() {
    let row = |cells: Vec<i8>| {
        let header =
            GridHeader { resolution_m: 0.1, width: cells.len() as u32, height: 1, ..Default::default() };
        Grid { header, cells }
    };
    // Both know six cells; they agree on three: the walls at 1 and the floor at 3 and 5.
    let a = row(vec![-90, 90, 90, -90, -90, -90, UNKNOWN]);
    let b = row(vec![90, 90, -90, -90, 90, -90, 90]);
    let both = compare(a.view(), b.view(), Pose2::IDENTITY).unwrap();
    within(both.agreement, 0.5, 1e-12);
    within(both.overlap_m2, 0.06, 1e-12);
    within(both.overlap_share, 1.0, 1e-12);
    // a's walls at 1, 2 are both near one of b's; b's at 0 and 1 are near one of a's, at 4 not.
    within(both.occupied_f1, 2.0 * 1.0 * (2.0 / 3.0) / (1.0 + 2.0 / 3.0), 1e-12);
    let apart = Pose2::new(9.0, 0.0, 0.0);
    assert_eq!(compare(a.view(), b.view(), apart), None);
}

#[test]
fn chance_reaches_the_papers_figure_but_not_the_walls() {
    let map = house();
    let right = compare(map.view(), map.view(), Pose2::IDENTITY).unwrap();
    let null = null_distribution(map.view(), map.view(), Pose2::IDENTITY, 20, 1);
    assert_eq!(null.len(), 20);
    let mean = |part: fn(&GridAgreement) -> f64| null.iter().map(part).sum::<f64>() / 20.0;
    assert!(mean(|wrong| wrong.agreement) > 0.85, "floor lies on floor: {}", mean(|wrong| wrong.agreement));
    assert!(mean(|wrong| wrong.occupied_f1) < 0.35, "walls do not: {}", mean(|wrong| wrong.occupied_f1));
    assert!(null.iter().all(|wrong| wrong.overlap_m2 >= 0.5 * right.overlap_m2));
    assert!(null.iter().all(|wrong| wrong.occupied_f1 < right.occupied_f1));
}

#[test]
fn a_wrong_transform_scores_like_the_null() {
    let map = house();
    let wrong = Pose2::new(2.5, 0.6, 0.9);
    let found = compare(map.view(), map.view(), wrong).unwrap();
    let null = null_distribution(map.view(), map.view(), wrong, 20, 7);
    let best = null.iter().map(|other| other.occupied_f1).fold(0.0, f64::max);
    assert!(found.occupied_f1 <= best + 0.1, "{found:?} against {best}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]

    #[test]
    fn directions_and_frames_do_not_matter(x in -2.0..2.0, y in -2.0..2.0, yaw in -3.1..3.1, by in -3.0..3.0) {
        let (a, b) = (house(), shifted(&house()));
        let a_from_b = Pose2::new(x, y, yaw);
        let forth = compare(a.view(), b.view(), a_from_b);
        let back = compare(b.view(), a.view(), a_from_b.inverse());
        match (forth, back) {
            (Some(forth), Some(back)) => {
                prop_assert!((forth.agreement - back.agreement).abs() < 2e-3);
                prop_assert!((forth.occupied_f1 - back.occupied_f1).abs() < 1e-2);
            }
            (forth, back) => prop_assert_eq!(forth.is_some(), back.is_some()),
        }
        // Another frame for b changes nothing.
        let frame = Pose2::new(by, 1.0, by);
        let moved = Grid { header: GridHeader { origin: frame * b.header.origin, ..b.header }, ..b };
        let again = compare(a.view(), moved.view(), a_from_b * frame.inverse());
        prop_assert_eq!(forth.is_some(), again.is_some());
        if let (Some(forth), Some(again)) = (forth, again) {
            prop_assert!((forth.agreement - again.agreement).abs() < 2e-3);
        }
    }
}
