//! Alignments that must be found, and maps that must be refused.

use super::*;
use crate::{MergeConfig, Merger};
use msg::grid::UNKNOWN;
use msg::{Grid, GridHeader, RobotId};
use proptest::prelude::*;

const RESOLUTION_M: f64 = 0.05;

/// A cell of a floor plan: `None` outside it, else whether it is an obstacle.
type Plan = fn(i64, i64) -> Option<bool>;

/// 16 m x 11 m: rooms, doors and furniture, no part of it like another.
fn house(x: i64, y: i64) -> Option<bool> {
    let (x, y) = (x + 160, y + 110);
    let inside = (0..320).contains(&x) && (0..220).contains(&y);
    let outer = x == 0 || x == 319 || y == 0 || y == 219;
    let inner = (x == 110 && !(60..78).contains(&y) && y < 150)
        || (y == 120 && x > 110 && !(190..208).contains(&x))
        || (x == 230 && y > 120 && !(150..168).contains(&y));
    let furniture = [
        (20..52, 30..44),
        (70..80, 100..140),
        (150..190, 20..38),
        (260..275, 60..90),
        (130..150, 180..205),
        (280..300, 170..178),
    ];
    let stands = furniture.iter().any(|(across, along)| across.contains(&x) && along.contains(&y));
    inside.then_some(outer || inner || stands)
}

/// Another building, 13 m x 13 m, with pillars and benches.
fn workshop(x: i64, y: i64) -> Option<bool> {
    let (x, y) = (x + 130, y + 130);
    let inside = (0..260).contains(&x) && (0..260).contains(&y);
    let outer = !(2..=257).contains(&x) || !(2..=257).contains(&y);
    let pillars = (x % 65 < 6) && (y % 52 < 6) && x > 30 && y > 30;
    let bench = (y == x / 2 + 60 && x < 120) || ((200..204).contains(&x) && y > 90 && y < 200);
    inside.then_some(outer || pillars || bench)
}

/// The walls of the house with other furniture: outlines of a table and a cupboard.
fn house_with(furniture: [[i64; 4]; 2], x: i64, y: i64) -> Option<bool> {
    let (x, y) = (x + 160, y + 110);
    let inside = (0..320).contains(&x) && (0..220).contains(&y);
    let outer = x == 0 || x == 319 || y == 0 || y == 219;
    let inner = (x == 110 && !(60..78).contains(&y)) || (y == 120 && x > 110 && !(190..208).contains(&x));
    let stands = furniture.iter().any(|[x0, y0, x1, y1]| {
        let on_outline = x == *x0 || x == *x1 || y == *y0 || y == *y1;
        on_outline && (*x0..=*x1).contains(&x) && (*y0..=*y1).contains(&y)
    });
    inside.then_some(outer || inner || stands)
}

/// One tenant's furniture.
fn first_tenant(x: i64, y: i64) -> Option<bool> {
    house_with([[20, 30, 40, 44], [60, 160, 76, 176]], x, y)
}

/// The next one's.
fn next_tenant(x: i64, y: i64) -> Option<bool> {
    house_with([[200, 70, 222, 82], [240, 180, 262, 194]], x, y)
}

/// An empty hall, 10 m x 6 m: half a turn changes nothing.
fn hall(x: i64, y: i64) -> Option<bool> {
    (x.abs() <= 100 && y.abs() <= 60).then_some(x.abs() == 100 || y.abs() == 60)
}

/// A hall of 15 m x 8 m with two rows of equal pillars: half a turn changes nothing.
fn hall_of_bays(x: i64, y: i64) -> Option<bool> {
    let inside = x.abs() <= 150 && y.abs() <= 80;
    let outer = x.abs() >= 149 || y.abs() >= 79;
    let pillar = ((x + 150) % 50 - 25).abs() <= 4 && (y.abs() - 30).abs() <= 4;
    inside.then_some(outer || pillar)
}

/// Two parallel walls of 30 m: nothing tells where along them a robot is.
fn corridor(x: i64, y: i64) -> Option<bool> {
    (x.abs() <= 300 && y.abs() <= 20).then_some(y.abs() == 20)
}

/// Map of the plan between columns `from` and `to`.
fn map(plan: Plan, from: i64, to: i64) -> Grid {
    let side = 320_u32;
    let corner = -i64::from(side) / 2;
    let cell = |x: i64, y: i64| match plan(x, y) {
        Some(true) if (from..to).contains(&x) => 90,
        Some(false) if (from..to).contains(&x) => -90,
        _ => UNKNOWN,
    };
    let cells =
        (0..i64::from(side)).flat_map(|y| (0..i64::from(side)).map(move |x| cell(x + corner, y + corner)));
    let header = GridHeader {
        origin: Pose2::new(corner as f64 * RESOLUTION_M, corner as f64 * RESOLUTION_M, 0.0),
        resolution_m: RESOLUTION_M,
        width: side,
        height: side,
        ..Default::default()
    };
    Grid { header, cells: cells.collect() }
}

/// The same map resampled in another frame.
fn redrawn(map: &Grid, frame_from_map: Pose2) -> Grid {
    let mut merger = Merger::new(&MergeConfig::default(), &[Some(frame_from_map)]);
    merger.update_map(RobotId::new(1).unwrap(), map.view()).unwrap();
    merger.merged().to_owned()
}

fn apart(x: Pose2, y: Pose2) -> (f64, f64) {
    (x.distance_m(y), msg::pose::wrap_angle(x.yaw_rad - y.yaw_rad).abs())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(6))]

    #[test]
    fn overlapping_halves_of_a_house_are_aligned(x in -20.0..20.0, y in -20.0..20.0, yaw in -3.1..3.1) {
        let b_from_a = Pose2::new(x, y, yaw);
        let (a, b) = (map(house, -160, 60), redrawn(&map(house, -60, 160), b_from_a));
        let found = align(a.view(), b.view(), &AlignConfig::default()).unwrap();
        let (metres, radians) = apart(found.a_from_b, b_from_a.inverse());
        // An error of yaw shows at b's distance from its origin.
        prop_assert!(found.accepted, "{found:?}");
        prop_assert!(radians < 0.01, "{found:?}");
        prop_assert!(metres < 0.05 + 0.01 * b_from_a.inverse().distance_m(Pose2::IDENTITY), "{found:?}");
    }
}

#[test]
fn the_same_rooms_with_other_furniture_are_refused() {
    let a = map(first_tenant, -160, 160);
    let turned = Pose2::new(1.0, 2.0, 0.7);
    let [same, other] = [first_tenant, next_tenant].map(|plan| {
        let b = redrawn(&map(plan, -160, 160), turned);
        align(a.view(), b.view(), &AlignConfig::default()).unwrap()
    });
    assert!(same.accepted && same.short_wall_conflict < 0.1, "{same:?}");
    // Of all walls, hardly any contradict: the outline outweighs the furniture.
    assert!(other.conflict < AlignConfig::default().conflict_max, "{other:?}");
    assert!(!other.accepted && other.short_wall_conflict > 0.5, "{other:?}");
}

#[test]
fn opposite_ends_of_a_hall_of_equal_bays_are_refused() {
    // Half a turn lays one end on the other, and nothing contradicts it.
    let (a, b) = (map(hall_of_bays, -160, 5), map(hall_of_bays, -5, 160));
    let config = AlignConfig::default();
    let found = align(a.view(), redrawn(&b, Pose2::new(1.0, 2.0, 0.7)).view(), &config).unwrap();
    assert!(found.conflict < config.conflict_max && found.margin > config.margin_min, "{found:?}");
    assert!(!found.accepted && found.short_walls_margin < config.short_walls_margin_min, "{found:?}");
}

#[test]
fn equal_maps_give_equal_alignments() {
    let (a, b) = (map(house, -160, 60), redrawn(&map(house, -60, 160), Pose2::new(1.0, 2.0, 0.7)));
    let twice = [0, 1].map(|_| align(a.view(), b.view(), &AlignConfig::default()));
    assert!(twice[0].is_some());
    assert_eq!(twice[0], twice[1]);
}

#[test]
fn maps_of_different_places_are_refused() {
    let pairs =
        [(map(house, -160, 160), map(workshop, -160, 160)), (map(house, -160, -60), map(house, 60, 160))];
    for (a, b) in pairs {
        let found = align(a.view(), redrawn(&b, Pose2::new(0.3, 0.1, 1.1)).view(), &AlignConfig::default());
        assert!(found.is_none_or(|found| !found.accepted), "{found:?}");
    }
}

#[test]
fn ambiguous_alignments_are_refused() {
    for plan in [hall as Plan, corridor] {
        let (a, b) = (map(plan, -160, 160), redrawn(&map(plan, -160, 160), Pose2::new(0.4, -0.2, 0.5)));
        let found = align(a.view(), b.view(), &AlignConfig::default()).unwrap();
        assert!(!found.accepted, "{found:?}");
    }
}

#[test]
fn empty_and_malformed_maps_are_not_aligned() {
    let house = map(house, -160, 160);
    let empty = map(|_, _| None, 0, 0);
    let floor = map(|_, _| Some(false), -100, 100);
    let mut wild = house.clone();
    wild.header.resolution_m = 1e300;
    let lone = Grid {
        header: GridHeader { width: 1, height: 1, resolution_m: 0.05, ..Default::default() },
        cells: vec![100],
    };
    for other in [&empty, &floor, &Grid::default(), &wild] {
        assert_eq!(align(house.view(), other.view(), &AlignConfig::default()), None);
        assert_eq!(align(other.view(), house.view(), &AlignConfig::default()), None);
    }
    for (a, b) in [(&house, &lone), (&lone, &house), (&lone, &lone)] {
        assert!(align(a.view(), b.view(), &AlignConfig::default()).is_none_or(|found| !found.accepted));
    }
}

/// The same map with four cells in place of each.
fn finer(map: &Grid) -> Grid {
    let header = GridHeader {
        resolution_m: map.header.resolution_m / 2.0,
        width: 2 * map.header.width,
        height: 2 * map.header.height,
        ..map.header
    };
    let cell = |i: usize| {
        let (x, y) = (i % header.width as usize / 2, i / header.width as usize / 2);
        map.cells[y * map.header.width as usize + x]
    };
    Grid { header, cells: (0..header.width as usize * header.height as usize).map(cell).collect() }
}

#[test]
fn walls_match_and_contradict_at_the_same_distances_whatever_the_resolution() {
    let coarse = map(house, -160, 160);
    let fine = finer(&coarse);
    let config = crate::config::WallConfig::default();
    let shares = |grid: &Grid, shift_m: f64| {
        let field =
            || DistanceField::new(MapPoints::from_grid(grid.view(), COARSE_CELL_M), grid.view(), &config);
        let (a, b) = (field(), field());
        let found = match_walls([&a, &b], Pose2::new(shift_m, shift_m, 0.0), [1, 1]);
        let all = (a.points.walls_m.len() + b.points.walls_m.len()) as f64;
        [found.matched / all, found.contradicted / all]
    };
    // On the walls; beside them, which says nothing; on the floor.
    for shift_m in [0.0, 0.1, 0.2] {
        let [coarse, fine] = [&coarse, &fine].map(|grid| shares(grid, shift_m));
        assert!((coarse[1] - fine[1]).abs() < 0.1, "{shift_m} m: {coarse:?}, in finer cells {fine:?}");
        assert_eq!(
            [coarse[1] > 0.02, fine[1] > 0.02],
            [shift_m > 0.15; 2],
            "{shift_m} m: {coarse:?}, {fine:?}"
        );
    }
    let halves = [map(house, -160, 60), map(house, -60, 160)];
    let found = [halves.clone(), halves.map(|half| finer(&half))]
        .map(|[a, b]| align(a.view(), b.view(), &AlignConfig::default()).unwrap());
    assert!(found.iter().all(|found| found.accepted), "{found:?}");
}
