//! Rooms from occupancy grids: what a LiDAR sees in them, where robots start, and what is refused.

use crate::common::{Run, quiet, robot, scan};
use core::f64::consts::{PI, TAU};
use msg::grid::{Occupancy, UNKNOWN, occupancy};
use msg::{Grid, GridHeader, Pose2, Scan};
use proptest::prelude::*;
use sim::{LidarConfig, Room, RoomError, SimConfig, Simulator, StartError};

/// Position of the LiDAR in `base_footprint`, metres.
const SCAN_IN_BASE: Pose2 = Pose2::new(-0.032, 0.0, 0.0);
const OCCUPIED: i8 = 60;
const FREE: i8 = -60;

/// A map of free cells.
fn free_map(width: u32, height: u32, resolution_m: f64, origin: Pose2) -> Grid {
    let header = GridHeader { width, height, resolution_m, origin, ..GridHeader::default() };
    Grid { header, cells: vec![FREE; (width * height) as usize] }
}

fn set(map: &mut Grid, column: u32, row: u32, cell: i8) {
    let index = row * map.header.width + column;
    map.cells[index as usize] = cell;
}

/// Sets the cells of a rectangle's rim.
fn set_rim(map: &mut Grid, [left, bottom]: [u32; 2], [right, top]: [u32; 2], cell: i8) {
    for (column, row) in (left..=right).flat_map(|column| [(column, bottom), (column, top)]) {
        set(map, column, row, cell);
    }
    for (column, row) in (bottom..=top).flat_map(|row| [(left, row), (right, row)]) {
        set(map, column, row, cell);
    }
}

/// A map in the rows of a picture: `#` is occupied, `.` is free, and the rest is unknown.
fn picture(rows: &[&str], resolution_m: f64) -> Grid {
    let mut map = free_map(rows[0].len() as u32, rows.len() as u32, resolution_m, Pose2::IDENTITY);
    let cells = rows.iter().rev().flat_map(|row| row.bytes());
    map.cells = cells
        .map(|byte| {
            if byte == b'#' {
                OCCUPIED
            } else if byte == b'.' {
                FREE
            } else {
                UNKNOWN
            }
        })
        .collect();
    map
}

fn room(map: &Grid) -> Room {
    Room::from_map("map.yaml", map.view()).unwrap()
}

/// A LiDAR without errors that sees all around.
fn lidar(room: &Room, base: Pose2) -> Result<Box<Scan>, StartError> {
    let lidar = LidarConfig { range_min_m: 0.01, range_max_m: 100.0, ..LidarConfig::LDS_01 };
    let config = SimConfig { lidar, ..quiet() };
    Ok(scan(&mut Simulator::new(room, &config, robot(1), base, 1)?))
}

/// Returns the places at which the beams of a scan end.
fn ends(base: Pose2, scan: &Scan) -> Vec<[f64; 2]> {
    let from = base * SCAN_IN_BASE;
    let beams = scan.ranges_m().iter().enumerate().filter(|(_, range)| range.is_finite());
    let end = |(beam, range): (usize, &f32)| {
        let (sin, cos) = (TAU * beam as f64 / scan.ranges_m().len() as f64).sin_cos();
        from.apply([cos * f64::from(*range), sin * f64::from(*range)])
    };
    beams.map(end).collect()
}

/// Returns the distance from a point to the nearest occupied cell, in cells.
fn distance_to_walls(map: &Grid, point: [f64; 2]) -> f64 {
    let local = map.header.origin.inverse().apply(point).map(|m| m / map.header.resolution_m);
    let width = map.header.width as usize;
    let occupied = map.cells.iter().enumerate().filter(|(_, cell)| **cell == OCCUPIED);
    let distance = |(index, _): (usize, &i8)| {
        let beyond = |at: f64, cell: usize| (at - (cell as f64 + 0.5)).abs() - 0.5;
        beyond(local[0], index % width).max(0.0).hypot(beyond(local[1], index / width).max(0.0))
    };
    occupied.map(distance).fold(f64::INFINITY, f64::min)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn beams_end_at_occupied_cells(
        occupied in prop::collection::vec(prop::bool::weighted(0.1), 22 * 22), yaw in -PI..PI, at in (-9.0..9.0, -9.0..9.0),
    ) {
        let mut map = free_map(24, 24, 0.2, Pose2::new(at.0, at.1, yaw));
        set_rim(&mut map, [0; 2], [23; 2], OCCUPIED);
        for (index, _) in occupied.iter().enumerate().filter(|(_, occupied)| **occupied) {
            set(&mut map, 1 + index as u32 % 22, 1 + index as u32 / 22, OCCUPIED);
        }
        let room = room(&map);
        let Ok(starts) = room.starts(1) else { return Ok(()) };
        let scan = lidar(&room, starts[0]).unwrap();
        let ends = ends(starts[0], &scan);
        prop_assert_eq!(ends.len(), 360, "the rim is closed");
        for end in ends {
            // Half a cell of tolerance, of which a quarter is inside of the cell; in corners both.
            let off = distance_to_walls(&map, end);
            prop_assert!(off < 0.75, "{:?} is {} cells off", end, off);
        }
    }

    /// Digital lines of one cell at any angle, whose cells touch at corners.
    #[test]
    fn walls_of_one_cell_are_closed_and_in_their_place(radii in prop::collection::vec(1.5_f64..6.0, 3..9), phase in 0.0..TAU) {
        let (resolution_m, count) = (0.05_f64, radii.len());
        let mut map = free_map(260, 260, resolution_m, Pose2::new(-6.5, -6.5, 0.0));
        let corner = |i: usize| -> [f64; 2] {
            let (sin, cos) = (phase + TAU * i as f64 / count as f64).sin_cos();
            [cos * radii[i % count], sin * radii[i % count]]
        };
        for i in 0..count {
            let (a, b) = (corner(i), corner(i + 1));
            let steps = ((a[0] - b[0]).abs().max((a[1] - b[1]).abs()) / resolution_m).ceil();
            for step in 0..=steps as usize {
                let share = step as f64 / steps;
                let (column, row) = map.view().cell_of([0, 1].map(|axis| a[axis] + share * (b[axis] - a[axis])));
                set(&mut map, column as u32, row as u32, OCCUPIED);
            }
        }
        let room = room(&map);
        // With three corners the origin may lie in a corner of the triangle.
        let Ok(scan) = lidar(&room, Pose2::IDENTITY) else { return Ok(()) };
        let ends = ends(Pose2::IDENTITY, &scan);
        prop_assert_eq!(ends.len(), 360);
        for end in ends {
            prop_assert!(distance_to_walls(&map, end) < 0.75, "{:?}", end);
        }
    }
}

#[test]
fn cells_that_touch_at_a_corner_alone_let_no_beam_through() {
    let mut map = free_map(81, 81, 0.05, Pose2::new(-2.025, -2.025, 0.0));
    for i in 0..=30 {
        for [column, row] in [[10 + i, 40 + i], [40 + i, 70 - i], [70 - i, 40 - i], [40 - i, 10 + i]] {
            set(&mut map, column, row, OCCUPIED);
        }
    }
    let scan = lidar(&room(&map), Pose2::new(0.032, 0.0, 0.0)).unwrap();
    for (beam, range_m) in scan.ranges_m().iter().enumerate() {
        let (sin, cos) = (beam as f32).to_radians().sin_cos();
        let expected_m = 1.5 / (sin.abs() + cos.abs());
        assert!((range_m - expected_m).abs() < 0.04, "{beam}°: {range_m} m, expected {expected_m} m");
    }
}

#[test]
fn coordinates_of_the_file_are_those_of_the_room() {
    let mut map = free_map(60, 40, 0.1, Pose2::new(7.0, -3.0, 0.5));
    set_rim(&mut map, [0; 2], [59, 39], OCCUPIED);
    // The LiDAR is in the middle of the map and looks along its columns.
    let base = map.header.origin * Pose2::new(3.032, 2.0, 0.0);
    let scan = lidar(&room(&map), base).unwrap();
    // To the inner edges of the cells, and a quarter of a cell into them.
    for (beam, expected_m) in [(0, 2.925), (90, 1.925), (180, 2.925), (270, 1.925)] {
        assert!((scan.ranges_m()[beam] - expected_m).abs() < 1e-3, "{beam}: {}", scan.ranges_m()[beam]);
    }
}

#[test]
fn the_floor_plan_shows_the_cells_of_the_map() {
    let mut map = free_map(80, 60, 0.05, Pose2::new(-2.0, -1.5, 0.0));
    set_rim(&mut map, [0; 2], [79, 59], OCCUPIED);
    set_rim(&mut map, [50, 20], [57, 30], OCCUPIED);
    (0..30).for_each(|row| set(&mut map, 30, row, OCCUPIED));
    set(&mut map, 10, 40, OCCUPIED);
    let plan = room(&map).floor_plan(0.05);
    let inside = |column: i64, row: i64| (51..57).contains(&column) && (21..30).contains(&row);
    for (column, row) in (0..80).flat_map(|column| (0..60).map(move |row| (column, row))) {
        let (x, y) = plan.view().cell_of(map.view().centre_m(column, row));
        let expected =
            if inside(column, row) { Occupancy::Unknown } else { occupancy(map.view().cell(column, row)) };
        assert_eq!(occupancy(plan.view().cell(x, y)), expected, "column {column}, row {row}");
    }
}

/// A room of 4 m by 4 m, with a wall of 2 m on the left, and unknown on the three other sides.
fn open_room() -> Grid {
    let mut map = free_map(60, 60, 0.1, Pose2::IDENTITY);
    map.cells.fill(UNKNOWN);
    (10..50).for_each(|row| (10..50).for_each(|column| set(&mut map, column, row, FREE)));
    (20..40).for_each(|row| set(&mut map, 9, row, OCCUPIED));
    map
}

#[test]
fn a_border_to_unknown_cells_stops_robots_and_not_beams() {
    let room = room(&open_room());
    let start = Pose2::new(3.0, 3.0, 0.0);
    let scan = lidar(&room, start).unwrap();
    let seen = scan.ranges_m().iter().filter(|range| range.is_finite()).count();
    assert!((50..60).contains(&seen), "the wall of 2 m alone is seen: {seen} beams");
    for yaw in [0.0, 0.7, 1.57, -1.57] {
        let mut simulator = Simulator::new(&room, &quiet(), robot(1), Pose2::new(3.0, 3.0, yaw), 1).unwrap();
        let run = Run::of(&mut simulator, 0.22, 0.0, 3000);
        let last = run.truths.last().unwrap();
        let Pose2 { x_m, y_m, .. } = last.world_from_base;
        let inside = |m: f64| (1.0..=5.0).contains(&m);
        assert!(inside(x_m) && inside(y_m), "{yaw}: {x_m}, {y_m}");
        assert!(last.contacts > 0 && x_m.max((y_m - 3.0).abs() + 3.0) > 4.8, "{yaw}: {x_m}, {y_m}");
    }
}

#[test]
fn the_length_of_the_open_edge_is_that_of_floor_beside_unknown_cells() {
    // Three sides of 4 m and the two ends of the fourth, of 1 m each.
    let open_m = room(&open_room()).open_edge_m();
    assert!((open_m - 14.0).abs() < 0.5, "{open_m}");
    let mut closed = free_map(40, 40, 0.1, Pose2::IDENTITY);
    set_rim(&mut closed, [0; 2], [39; 2], OCCUPIED);
    assert_eq!(room(&closed).open_edge_m(), 0.0);
    assert_eq!(Room::laboratory().open_edge_m(), 0.0);
}

#[test]
fn a_map_whose_largest_floor_is_too_narrow_for_robots_says_that_it_has_no_space() {
    let mut map = free_map(200, 100, 0.05, Pose2::IDENTITY);
    map.cells.fill(OCCUPIED);
    // Ways of 0.2 m, connected at the left, and a box of 1 m by 1 m.
    for row in (1..99).filter(|row| row % 5 != 0) {
        (1..150).for_each(|column| set(&mut map, column, row, FREE));
    }
    (1..99).for_each(|row| (1..5).for_each(|column| set(&mut map, column, row, FREE)));
    (10..30).for_each(|row| (170..190).for_each(|column| set(&mut map, column, row, FREE)));
    let why = room(&map).starts(1).unwrap_err();
    assert_eq!(why, StartError::NoSpace);
    assert!(why.to_string().contains("no space for a robot; expected a floor of at least 3 m²"), "{why}");
}

#[test]
fn one_or_two_unknown_cells_between_walls_are_wall() {
    let seen_through = |gap: std::ops::Range<u32>| {
        let mut map = free_map(40, 40, 0.1, Pose2::IDENTITY);
        set_rim(&mut map, [0; 2], [39; 2], UNKNOWN);
        set_rim(&mut map, [1; 2], [38; 2], OCCUPIED);
        gap.for_each(|row| set(&mut map, 38, row, UNKNOWN));
        let scan = lidar(&room(&map), Pose2::new(2.0, 2.0, 0.0)).unwrap();
        scan.ranges_m().iter().filter(|range| range.is_infinite()).count()
    };
    assert_eq!([seen_through(20..21), seen_through(20..22)], [0, 0]);
    assert!(seen_through(20..23) > 3);
}

#[test]
fn robots_start_on_known_floor_alone() {
    let room = room(&open_room());
    for start in room.starts(8).unwrap() {
        assert!((1.25..=4.75).contains(&start.x_m) && (1.25..=4.75).contains(&start.y_m), "{start:?}");
    }
    let start = |x_m, y_m| Simulator::new(&room, &quiet(), robot(1), Pose2::new(x_m, y_m, 0.0), 1).err();
    assert_eq!(start(3.0, 3.0), None);
    assert_eq!(start(5.5, 3.0), Some(StartError::OffFloor { x_m: 5.5, y_m: 3.0 }));
    assert!(matches!(start(4.995, 3.0), Some(StartError::InObstacle { .. })), "on the border");
    assert!(matches!(start(1.0, 3.0), Some(StartError::InObstacle { .. })), "at the wall");
}

#[test]
fn a_small_gap_of_unknown_cells_is_floor() {
    let mut map = free_map(40, 20, 0.1, Pose2::IDENTITY);
    set_rim(&mut map, [0; 2], [39, 19], OCCUPIED);
    (8..11).for_each(|row| (19..22).for_each(|column| set(&mut map, column, row, UNKNOWN)));
    let across = |map: &Grid| {
        let mut simulator =
            Simulator::new(&room(map), &quiet(), robot(1), Pose2::new(1.0, 0.95, 0.0), 1).unwrap();
        Run::of(&mut simulator, 0.15, 0.0, 1500).truths.last().unwrap().world_from_base.x_m
    };
    assert!(across(&map) > 3.0);
    // One more row makes it larger than 0.1 m².
    (19..22).for_each(|column| set(&mut map, column, 11, UNKNOWN));
    assert!(across(&map) < 1.95);
}

#[test]
fn maps_that_are_no_rooms_are_refused_with_what_was_expected() {
    let walls = ["#####", "#...#", "#...#", "#...#", "#####"];
    let moved = |origin: Pose2, resolution_m: f64| {
        let mut map = picture(&walls, resolution_m);
        map.header.origin = origin;
        map
    };
    for (map, expected) in [
        (picture(&["....", "...."], 0.1), "no occupied cell; expected walls"),
        (picture(&["    ", "    "], 0.1), "no occupied cell"),
        (picture(&["####", "### "], 0.1), "no free cell; expected a floor"),
        (moved(Pose2::IDENTITY, 0.03), "a robot fits nowhere"),
        (moved(Pose2::new(5e5, 4e6, 0.0), 0.1), "4000000 m from the origin"),
        (moved(Pose2::IDENTITY, 100.0), "at most 200 m"),
        (moved(Pose2::new(f64::NAN, 0.0, 0.0), 0.1), "a finite pose"),
        (moved(Pose2::IDENTITY, -0.1), "a finite pose"),
        (moved(Pose2::IDENTITY, f64::NAN), "a finite pose"),
        (Grid { cells: vec![FREE; 3], ..moved(Pose2::IDENTITY, 0.1) }, "3 cells in 5 x 5"),
        (Grid::default(), "0 cells in 0 x 0"),
    ] {
        let error = Room::from_map("map.yaml", map.view()).map(|_| ()).unwrap_err();
        assert!(matches!(error, RoomError::Map(_)), "{error:?}");
        assert!(error.to_string().contains(expected), "{error}, expected {expected}");
    }
    assert!(Room::from_map("map.yaml", moved(Pose2::IDENTITY, 0.2).view()).is_ok());
}
