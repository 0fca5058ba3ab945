//! Tests that a robot is no obstacle in the merged map, neither where it has driven nor where it stands.

use super::{RESOLUTION_M, at, grid, map, merger, pose, robot};
use crate::merger::*;
use msg::grid::{LOG_ODDS_MAX, LOG_ODDS_MIN, Occupancy, SWEPT_FREE, occupancy};
use proptest::prelude::*;

const RADIUS_M: f64 = 0.2;

#[test]
fn floor_that_a_robot_drove_over_is_free_until_the_robot_itself_sees_an_obstacle() {
    let one = |cell| grid(Pose2::IDENTITY, RESOLUTION_M, 1, vec![cell]);
    let robots = 1..=ROBOTS_MAX;
    let mut merger = merger(&[Pose2::IDENTITY; ROBOTS_MAX]);
    for number in robots.clone().skip(1) {
        merger.update_map(robot(number), one(LOG_ODDS_MAX).view()).unwrap();
    }
    assert_eq!(at(&mut merger, 0, 0), LOG_ODDS_MAX);
    merger.update_map(robot(1), one(SWEPT_FREE).view()).unwrap();
    assert_eq!(at(&mut merger, 0, 0), SWEPT_FREE);
    // The surest free cell of beams does not outweigh the others.
    merger.update_map(robot(1), one(LOG_ODDS_MIN).view()).unwrap();
    assert_eq!(occupancy(at(&mut merger, 0, 0)), Occupancy::Occupied);
    // All robots at once: no sum overflows.
    for number in robots {
        merger.update_map(robot(number), one(SWEPT_FREE).view()).unwrap();
    }
    assert_eq!(at(&mut merger, 0, 0), SWEPT_FREE);
}

#[test]
fn a_robot_is_no_obstacle_where_it_stands_and_on_its_path() {
    let ghosts = grid(Pose2::new(-5.0, -5.0, 0.0), RESOLUTION_M, 200, vec![60; 200 * 200]);
    let place = Pose2::new(1.0, 0.0, core::f64::consts::FRAC_PI_2);
    let mut merger = merger(&[Pose2::IDENTITY, place]);
    merger.update_map(robot(1), ghosts.view()).unwrap();
    // Along y in `map`, from (1, 0.5) on.
    let stand =
        |merger: &mut Merger, x_m| merger.add_robot_pose(robot(2), Pose2::new(x_m, 0.0, 0.3), RADIUS_M);
    assert!(stand(&mut merger, 0.5));
    let free = |merger: &mut Merger, y| at(merger, 20, y) == SWEPT_FREE;
    assert_eq!([4, 6, 13, 15].map(|y| free(&mut merger, y)), [false, true, true, false]);
    assert_eq!([at(&mut merger, 23, 9), at(&mut merger, 24, 9)], [SWEPT_FREE, 60]);
    // It stands still but for noise; then it drives a metre.
    assert!(!stand(&mut merger, 0.505));
    for step in 1..=10 {
        assert!(stand(&mut merger, 0.5 + 0.1 * f64::from(step)));
    }
    assert!((6..33).all(|y| free(&mut merger, y)) && !free(&mut merger, 35));
    // Without a transform it is nowhere; with another one its path lies elsewhere.
    merger.set_map_transform(robot(2), None).unwrap();
    assert!((0..40).all(|y| !free(&mut merger, y)));
    assert!(!stand(&mut merger, 1.52));
    merger.set_map_transform(robot(2), Some(Pose2::new(1.0, -1.0, place.yaw_rad))).unwrap();
    assert!((-14..13).all(|y| free(&mut merger, y)) && !free(&mut merger, 20));
    merger.set_map_transform(robot(2), Some(place)).unwrap();
    // Farther back than the path reaches, its own map must know.
    for step in 1..=40 {
        assert!(stand(&mut merger, 1.52 + 0.1 * f64::from(step)));
    }
    assert!(!free(&mut merger, 8) && free(&mut merger, 40) && free(&mut merger, 70));
    // Its map was corrected under it: the path in the old one is invalid.
    assert!(stand(&mut merger, 1.0));
    assert!(free(&mut merger, 20) && (26..80).all(|y| !free(&mut merger, y)));
    merger.remove_map(robot(2));
    assert!(!free(&mut merger, 20));
}

#[test]
fn unknown_robots_and_implausible_footprints_change_nothing() {
    let mut merger = merger(&[Pose2::IDENTITY]);
    merger.update_map(robot(1), grid(Pose2::IDENTITY, RESOLUTION_M, 40, vec![60; 1600]).view()).unwrap();
    let before = merger.merged().to_owned();
    let here = Pose2::new(1.0, 1.0, 0.0);
    assert!(!merger.add_robot_pose(robot(2), here, RADIUS_M));
    assert!(!merger.add_robot_pose(robot(1), Pose2::new(f64::NAN, 0.0, 0.0), RADIUS_M));
    assert!(!merger.add_robot_pose(robot(1), Pose2::new(1e9, 0.0, 0.0), RADIUS_M));
    for radius_m in [0.0, -1.0, f64::NAN, 1e9] {
        assert!(!merger.add_robot_pose(robot(1), here, radius_m));
    }
    assert_eq!(merger.merged().to_owned(), before);
    // Far from everything known it draws nothing, and the merged map does not grow.
    merger.add_robot_pose(robot(1), Pose2::new(500.0, 0.0, 0.0), RADIUS_M);
    assert_eq!(merger.merged().to_owned(), before);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn the_order_of_footprints_and_maps_does_not_matter(
        maps in proptest::collection::vec((map(90), pose()), 2..4), elsewhere in pose(),
        way in proptest::collection::vec((-0.15..0.15, -0.15..0.15), 1..60),
    ) {
        let starts: Vec<_> = maps.iter().map(|(_, start)| *start).collect();
        let (mut one, mut other) = (merger(&starts), merger(&starts));
        let update = |merger: &mut Merger, index: usize| {
            merger.update_map(robot(index + 1), maps[index].0.view()).unwrap();
        };
        let mut place = Pose2::IDENTITY;
        (0..maps.len()).for_each(|index| update(&mut other, index));
        other.set_map_transform(robot(1), Some(elsewhere)).unwrap();
        for (dx, dy) in way {
            place = place * Pose2::new(dx, dy, 0.1);
            one.add_robot_pose(robot(1), place, RADIUS_M);
            other.add_robot_pose(robot(1), place, RADIUS_M);
            other.merged();
        }
        other.set_map_transform(robot(1), Some(starts[0])).unwrap();
        (0..maps.len()).rev().for_each(|index| update(&mut one, index));
        prop_assert_eq!(one.merged().to_owned(), other.merged().to_owned());
    }
}
