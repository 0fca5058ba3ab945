//! Properties that hold whatever the robots' maps look like.

mod peers;

use super::*;
use core::f64::consts::FRAC_PI_2;
use msg::grid::{Occupancy, UNKNOWN, known_count, occupancy};
use msg::{Grid, GridHeader, Stamp};
use proptest::prelude::*;

pub(super) const RESOLUTION_M: f64 = 0.05;

pub(super) fn robot(number: usize) -> RobotId {
    RobotId::new(number).unwrap()
}

pub(super) fn grid(origin: Pose2, resolution_m: f64, width: u32, cells: Vec<i8>) -> Grid {
    let height = cells.len() as u32 / width;
    Grid { header: GridHeader { origin, resolution_m, width, height, ..Default::default() }, cells }
}

pub(super) fn merger(starts: &[Pose2]) -> Merger {
    Merger::new(&MergeConfig::default(), &starts.iter().map(|start| Some(*start)).collect::<Vec<_>>())
}

/// Merged log-odds at a cell of the lattice.
pub(super) fn at(merger: &mut Merger, x: i64, y: i64) -> i8 {
    let view = merger.merged();
    let corner = [view.header.origin.x_m, view.header.origin.y_m].map(|m| (m / RESOLUTION_M).round() as i64);
    view.cell(x - corner[0], y - corner[1])
}

/// Merged log-odds in a fixed window, which must hold all known cells.
fn window(merger: &mut Merger, half: i64) -> Vec<i8> {
    let cells = IndexRect { x0: -half, y0: -half, x1: half, y1: half };
    let view = merger.merged().to_owned();
    let corner = [view.header.origin.x_m, view.header.origin.y_m].map(|m| (m / RESOLUTION_M).round() as i64);
    let merged = IndexRect::with_size(view.header.width, view.header.height);
    let outside = view.cells.iter().zip(merged.points()).filter(|(cell, (x, y))| {
        let (x, y) = (x + corner[0], y + corner[1]);
        **cell != UNKNOWN && !(x >= -half && x < half && y >= -half && y < half)
    });
    assert_eq!(outside.count(), 0, "known cells beyond the test's window");
    cells.points().map(|(x, y)| view.view().cell(x - corner[0], y - corner[1])).collect()
}

fn log_odds() -> impl Strategy<Value = i8> {
    prop_oneof![2 => Just(UNKNOWN), 1 => -127_i8..=127]
}

pub(super) fn map(side: u32) -> impl Strategy<Value = Grid> {
    let shape = (1..=side, 1..=side, -40..40_i32, -40..40_i32);
    shape.prop_flat_map(|(width, height, x, y)| {
        let cells = proptest::collection::vec(log_odds(), (width * height) as usize);
        let origin = Pose2::new(f64::from(x) * RESOLUTION_M, f64::from(y) * RESOLUTION_M, 0.0);
        cells.prop_map(move |cells| grid(origin, RESOLUTION_M, width, cells))
    })
}

pub(super) fn pose() -> impl Strategy<Value = Pose2> {
    (-2.0..2.0, -2.0..2.0, -3.2..3.2).prop_map(|(x, y, yaw)| Pose2::new(x, y, yaw))
}

/// The same content in a window that is larger by so many cells on each side.
fn grown(map: &Grid, [left, below, right, above]: [u32; 4]) -> Grid {
    let (width, height) = (map.header.width + left + right, map.header.height + below + above);
    let r = map.header.resolution_m;
    let shift = Pose2::new(-f64::from(left) * r, -f64::from(below) * r, 0.0);
    let cells = IndexRect::with_size(width, height).points();
    let cells = cells.map(|(x, y)| map.view().cell(x - i64::from(left), y - i64::from(below))).collect();
    Grid { header: GridHeader { width, height, origin: map.header.origin * shift, ..map.header }, cells }
}

#[test]
fn the_map_of_one_robot_at_the_origin_is_copied() {
    let cells: Vec<i8> = (0..200 * 100).map(|i| (i % 256) as u8 as i8).collect();
    let map = grid(Pose2::new(-1.0, 2.0, 0.0), RESOLUTION_M, 200, cells);
    let mut merger = merger(&[Pose2::IDENTITY]);
    merger.update_map(robot(1), map.view()).unwrap();
    let merged = merger.merged().to_owned();
    assert_eq!((merged.header.width, merged.header.height), (200, 100));
    assert!(merged.header.origin.distance_m(map.header.origin) < 1e-9);
    assert_eq!(merged.cells, map.cells);
}

#[test]
fn an_imagined_obstacle_is_cleared_by_robots_that_saw_the_floor() {
    let one = |cell| grid(Pose2::IDENTITY, RESOLUTION_M, 1, vec![cell]);
    let mut merger = merger(&[Pose2::IDENTITY; 3]);
    merger.update_map(robot(1), one(60).view()).unwrap();
    assert_eq!(occupancy(at(&mut merger, 0, 0)), Occupancy::Occupied);
    merger.update_map(robot(2), one(-60).view()).unwrap();
    merger.update_map(robot(3), one(-60).view()).unwrap();
    assert_eq!(at(&mut merger, 0, 0), -60);
    // Unknown cells count nothing, and a robot that leaves takes its log-odds away.
    merger.update_map(robot(2), one(UNKNOWN).view()).unwrap();
    assert_eq!(at(&mut merger, 0, 0), 0);
    merger.remove_map(robot(1));
    assert_eq!(at(&mut merger, 0, 0), -60);
    merger.remove_map(robot(3));
    assert_eq!(at(&mut merger, 0, 0), UNKNOWN);
    let certain = one(127);
    for number in 1..=3 {
        merger.update_map(robot(number), certain.view()).unwrap();
    }
    assert_eq!(at(&mut merger, 0, 0), 127);
}

#[test]
fn thin_walls_survive_finer_cells_and_coarse_cells_leave_no_holes() {
    // A wall one cell of 1.25 cm thick, at some angle.
    let mut cells = vec![-100_i8; 400 * 400];
    (0..400).for_each(|x| cells[200 * 400 + x] = 100);
    let fine = grid(Pose2::new(-2.5, -2.5, 0.0), 0.0125, 400, cells);
    let mut merger = merger(&[Pose2::new(0.0, 0.0, 0.3), Pose2::IDENTITY]);
    merger.update_map(robot(1), fine.view()).unwrap();
    for step in -30..30 {
        let [x, y] = Pose2::new(0.0, 0.0, 0.3).apply([f64::from(step) * RESOLUTION_M, 0.006]);
        let cell = at(&mut merger, (x / RESOLUTION_M).floor() as i64, (y / RESOLUTION_M).floor() as i64);
        assert_eq!(occupancy(cell), Occupancy::Occupied, "hole at step {step}");
    }
    merger.remove_map(robot(1));
    let coarse = grid(Pose2::new(-1.0, -1.0, 0.4), 0.2, 10, vec![-50; 100]);
    merger.update_map(robot(2), coarse.view()).unwrap();
    let known = known_count(merger.merged().cells);
    assert!((1590..1610).contains(&known), "4 square metres are 1600 cells, not {known}");
}

#[test]
fn malformed_maps_are_rejected_and_change_nothing() {
    let good = grid(Pose2::IDENTITY, RESOLUTION_M, 2, vec![50; 4]);
    let mut merger = merger(&[Pose2::IDENTITY, Pose2::new(90_000.0, 90_000.0, 0.0)]);
    merger.update_map(robot(1), good.view()).unwrap();
    let before = merger.merged().to_owned();
    let header = good.header;
    for bad in [
        GridHeader { width: 3, ..header },
        GridHeader { width: u32::MAX, height: u32::MAX, ..header },
        GridHeader { resolution_m: f64::NAN, ..header },
        GridHeader { resolution_m: 1e-9, ..header },
        GridHeader { origin: Pose2::new(f64::INFINITY, 0.0, 0.0), ..header },
        GridHeader { origin: Pose2::new(1e9, 0.0, 0.0), ..header },
    ] {
        let refused = merger.update_map(robot(1), GridView { header: &bad, cells: &good.cells });
        assert!(matches!(refused, Err(MapRejected::Malformed { .. })), "{bad:?}: {refused:?}");
    }
    let far = merger.update_map(robot(2), good.view());
    assert!(matches!(far, Err(MapRejected::TooLarge { .. })), "{far:?}");
    let stranger = merger.update_map(robot(3), good.view());
    assert!(matches!(stranger, Err(MapRejected::UnknownRobot { .. })), "{stranger:?}");
    assert_eq!(merger.merged().to_owned(), before);
}

#[test]
fn an_older_map_is_rejected_unless_the_robot_restarted() {
    let stamped = |seconds, run, cell| {
        let mut map = grid(Pose2::IDENTITY, RESOLUTION_M, 1, vec![cell]);
        map.header.header =
            Header { stamp: Stamp::from_seconds(seconds), incarnation: run, ..Default::default() };
        map.header.scan_sent = Monotonic(seconds as u64 + 1);
        map
    };
    let mut merger = merger(&[Pose2::IDENTITY; 2]);
    merger.update_map(robot(1), stamped(5.0, 1, 50).view()).unwrap();
    merger.update_map(robot(2), stamped(3.0, 1, 20).view()).unwrap();
    assert_eq!(
        (merger.merged().header.scan_sent, merger.map_transforms().header.stamp),
        (Monotonic(6), Stamp::from_seconds(5.0))
    );
    let refused = merger.update_map(robot(1), stamped(4.0, 1, -50).view());
    assert!(matches!(refused, Err(MapRejected::Stale { .. })), "{refused:?}");
    merger.update_map(robot(1), stamped(4.0, 2, -50).view()).unwrap();
    assert_eq!(at(&mut merger, 0, 0), -30);
}

#[test]
fn a_robot_without_a_start_is_drawn_when_its_transform_is_set() {
    let map = grid(Pose2::IDENTITY, RESOLUTION_M, 2, vec![50; 4]);
    let mut merger = Merger::new(&MergeConfig::default(), &[None]);
    merger.update_map(robot(1), map.view()).unwrap();
    assert!(merger.merged().cells.is_empty());
    assert_eq!(merger.map_transforms().robots[0].known, 0);
    merger.set_map_transform(robot(1), Some(Pose2::new(1.0, 0.0, 0.0))).unwrap();
    assert_eq!(
        (at(&mut merger, 20, 0), at(&mut merger, 0, 0), merger.map_transforms().robots[0].known),
        (50, UNKNOWN, 1)
    );
    merger.set_map_transform(robot(1), None).unwrap();
    assert_eq!(at(&mut merger, 20, 0), UNKNOWN);
}

#[test]
fn a_redrawn_map_replaces_the_robots_own_one_until_it_is_withdrawn() {
    let stamped = |seconds, cell| {
        let mut map = grid(Pose2::IDENTITY, RESOLUTION_M, 2, vec![cell; 4]);
        map.header.header =
            Header { stamp: Stamp::from_seconds(seconds), incarnation: 1, ..Default::default() };
        map
    };
    let mut merger = Merger::new(&MergeConfig::default(), &[None]);
    merger.update_map(robot(1), stamped(5.0, 50).view()).unwrap();
    let place = Some(Pose2::new(1.0, 0.0, 0.0));
    // Drawn from older scans than the robot's newest map, and used nevertheless.
    let redrawn = Arc::new(stamped(4.0, -30));
    assert_eq!(merger.apply_fleet_estimate(robot(1), place, Some(&redrawn)), Ok(true));
    assert_eq!(at(&mut merger, 20, 0), -30);
    assert_eq!(merger.apply_fleet_estimate(robot(1), place, Some(&redrawn)), Ok(false));
    merger.update_map(robot(1), stamped(6.0, 70).view()).unwrap();
    assert_eq!(at(&mut merger, 20, 0), -30);
    assert_eq!(merger.apply_fleet_estimate(robot(1), place, None), Ok(true));
    assert_eq!(at(&mut merger, 20, 0), 70);
    let broken = Arc::new(Grid { header: redrawn.header, cells: vec![1] });
    let refused = merger.apply_fleet_estimate(robot(1), place, Some(&broken));
    assert!(matches!(refused, Err(MapRejected::Malformed { .. })), "{refused:?}");
    assert_eq!(merger.apply_fleet_estimate(robot(1), None, None), Ok(true));
    assert_eq!(at(&mut merger, 20, 0), UNKNOWN);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn order_of_robots_does_not_matter(
        maps in proptest::collection::vec((map(90), pose()), 2..5),
    ) {
        let starts: Vec<_> = maps.iter().map(|(_, start)| *start).collect();
        let (mut one, mut other) = (merger(&starts), merger(&starts));
        for (index, (map, _)) in maps.iter().enumerate() {
            one.update_map(robot(index + 1), map.view()).unwrap();
        }
        for (index, (map, _)) in maps.iter().enumerate().rev() {
            other.update_map(robot(index + 1), map.view()).unwrap();
            other.merged();
        }
        prop_assert_eq!(one.merged().to_owned(), other.merged().to_owned());
    }

    #[test]
    fn a_map_merged_with_itself_has_the_same_occupancy(map in map(70), start in pose()) {
        let (mut once, mut twice) = (merger(&[start]), merger(&[start, start]));
        once.update_map(robot(1), map.view()).unwrap();
        twice.update_map(robot(1), map.view()).unwrap();
        twice.update_map(robot(2), map.view()).unwrap();
        for (a, b) in once.merged().cells.iter().zip(twice.merged().cells) {
            let undecided = occupancy(*a) == Occupancy::Unknown && *a != UNKNOWN;
            prop_assert!(undecided || occupancy(*a) == occupancy(*b), "{a} {b}");
        }
    }

    #[test]
    fn a_shifted_origin_changes_nothing(
        map in map(70), start in pose(), margins in proptest::array::uniform4(0_u32..80),
    ) {
        let (mut plain, mut shifted) = (merger(&[start]), merger(&[start]));
        plain.update_map(robot(1), map.view()).unwrap();
        shifted.update_map(robot(1), grown(&map, margins).view()).unwrap();
        prop_assert_eq!(window(&mut plain, 240), window(&mut shifted, 240));
    }

    #[test]
    fn growing_step_by_step_gives_the_same_as_at_once(
        map in map(70), start in pose(),
        growth in proptest::collection::vec(proptest::array::uniform4(0_u32..20), 1..4),
        edits in proptest::collection::vec((0.0..1.0, log_odds()), 1..4),
        resolution_m in prop_oneof![3 => Just(RESOLUTION_M), 1 => 0.02..0.12],
    ) {
        let mut map = Grid { header: GridHeader { resolution_m, ..map.header }, ..map };
        let (mut stepwise, mut at_once) = (merger(&[start]), merger(&[start]));
        stepwise.update_map(robot(1), map.view()).unwrap();
        for (margins, (place, cell)) in growth.iter().zip(edits.iter().cycle()) {
            map = grown(&map, *margins);
            let index = (place * map.cells.len() as f64) as usize;
            map.cells[index] = *cell;
            stepwise.merged();
            stepwise.update_map(robot(1), map.view()).unwrap();
        }
        at_once.update_map(robot(1), map.view()).unwrap();
        prop_assert_eq!(window(&mut stepwise, 400), window(&mut at_once, 400));
    }

    #[test]
    fn a_quarter_turn_is_exact(map in map(70), turns in 1..4_i32) {
        // The same content, stored in a grid whose own axes are turned.
        let (width, height) = (i64::from(map.header.width), i64::from(map.header.height));
        let (turned_width, turned_height) = if turns % 2 == 1 { (height, width) } else { (width, height) };
        let source = |x: i64, y: i64| match turns {
            1 => (width - 1 - y, x),
            2 => (width - 1 - x, height - 1 - y),
            _ => (y, height - 1 - x),
        };
        let corner = match turns {
            1 => [width, 0],
            2 => [width, height],
            _ => [0, height],
        };
        let corner = corner.map(|cells| cells as f64 * RESOLUTION_M);
        let turn = Pose2::new(corner[0], corner[1], f64::from(turns) * FRAC_PI_2);
        let cells = IndexRect::with_size(turned_width as u32, turned_height as u32).points();
        let cells = cells.map(|(x, y)| { let (x, y) = source(x, y); map.view().cell(x, y) }).collect();
        let turned = grid(map.header.origin * turn, RESOLUTION_M, turned_width as u32, cells);
        let (mut plain, mut rotated) = (merger(&[Pose2::IDENTITY]), merger(&[Pose2::IDENTITY]));
        plain.update_map(robot(1), map.view()).unwrap();
        rotated.update_map(robot(1), turned.view()).unwrap();
        prop_assert_eq!(window(&mut plain, 120), window(&mut rotated, 120));
    }

    #[test]
    fn moving_a_map_gives_the_same_as_starting_there(map in map(70), a in pose(), b in pose()) {
        let (mut moved, mut there) = (merger(&[a]), merger(&[b]));
        moved.update_map(robot(1), map.view()).unwrap();
        moved.merged();
        moved.set_map_transform(robot(1), Some(b)).unwrap();
        there.update_map(robot(1), map.view()).unwrap();
        prop_assert_eq!(window(&mut moved, 240), window(&mut there, 240));
    }
}
