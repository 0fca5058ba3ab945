//! Processor time of merging maps whose transforms are known, and of computing their statistics.

use super::pairs::cpu_s;
use super::table::{Row, Table};
use merge::{MergeConfig, Merger};
use msg::{Grid, GridHeader, MapHeader, MapTransform, MapTransforms, Pose2, RobotId, TileMap};
use telemetry::MapMetrics;

/// Rounds of each case; the table has the fastest and the median.
const ROUNDS: usize = 15;

/// Steps that robots have driven before a step is measured: more than a swept path holds.
const STEPS_BEFORE: usize = 50;

/// Adds all cases to the table.
pub fn rows(table: &mut Table) {
    table.begin("known start poses, processor time", "minimum, ms", "median, ms");
    let cases = [
        ("8 x 1000 x 1000 rotated, all new", 8, 1000, 0.2, 0.0, Changed::All, None),
        ("8 x 1000 x 1000 rotated, one new", 8, 1000, 0.2, 0.0, Changed::One, None),
        ("8 x 1000 x 1000 rotated, 1 % changed", 8, 1000, 0.2, 0.0, Changed::Hundredth, Some(5.0)),
        ("8 x 1000 x 1000 rotated, every robot 0.05 m on", 8, 1000, 0.2, 0.0, Changed::Places, None),
        ("3 x 4000 x 4000, 1 % changed", 3, 4000, 0.0, 0.0, Changed::Hundredth, Some(20.0)),
        ("3 x 4000 x 4000 rotated, 1 % changed", 3, 4000, 0.2, 0.0, Changed::Hundredth, Some(20.0)),
        ("3 x 4000 x 4000 side by side, 1 % changed", 3, 4000, 0.0, 195.0, Changed::Hundredth, Some(20.0)),
        ("3 x 200 x 200 rotated, all new", 3, 200, 0.2, 0.0, Changed::All, None),
        ("8 x 1000 x 1000 rotated, 1 % changed, whole grids", 8, 1000, 0.2, 0.0, Changed::InGrids, None),
        ("3 x 4000 x 4000, 1 % changed, whole grids", 3, 4000, 0.0, 0.0, Changed::InGrids, None),
    ];
    for (name, robots, side, yaw_step_rad, apart_m, changed, limit_ms) in cases {
        let [least, median] = compose(robots, side, yaw_step_rad, apart_m, changed);
        let row = Row::new(name, least, median);
        table.add(match limit_ms {
            Some(limit_ms) => row.at_most(limit_ms),
            None => row,
        });
    }
    for (name, side) in [("statistics of 3 x 200 x 200, all new", 200), ("the same of 3 x 1000 x 1000", 1000)]
    {
        let [least, median] = statistics(side);
        table.add(Row::new(name, least, median));
    }
}

/// Returns the least processor time of composing 8 rotated maps of 1000 x 1000 cells, milliseconds: what the same run's
/// other times are compared with.
pub fn compose_all_new_ms() -> f64 {
    compose(8, 1000, 0.2, 0.0, Changed::All)[0]
}

#[derive(Clone, Copy, PartialEq)]
enum Changed {
    All,
    One,
    Hundredth,
    /// A hundredth of the cells, sent as a whole grid.
    InGrids,
    /// No map; only the robots' places.
    Places,
}

fn compose(robots: usize, side: u32, yaw_step_rad: f64, apart_m: f64, changed: Changed) -> [f64; 2] {
    let starts: Vec<_> = (0..robots)
        .map(|k| k as f64)
        .map(|k| Some(Pose2::new((0.37 + apart_m) * k, -0.21 * k, yaw_step_rad * k)))
        .collect();
    let mut merger = Merger::new(&MergeConfig::default(), &starts);
    let mut grids: Vec<Grid> = (0..robots).map(|k| rooms(side, k)).collect();
    let mut maps: Vec<TileMap> = grids.iter().map(tiles).collect();
    let mut milliseconds = Vec::new();
    for round in 0..=ROUNDS {
        for (index, (grid, map)) in grids.iter_mut().zip(&mut maps).enumerate() {
            match changed {
                Changed::One if index > 0 => {}
                Changed::Places => {}
                Changed::InGrids => scribble(grid, side / 10, round),
                Changed::Hundredth => {
                    scribble(grid, side / 10, round);
                    patch(map, grid);
                }
                Changed::All | Changed::One => {
                    for cell in &mut grid.cells {
                        *cell = cell.wrapping_add(i8::from(*cell != i8::MIN && *cell < 100));
                    }
                    patch(map, grid);
                }
            }
        }
        let began_s = cpu_s();
        for ((robot, grid), map) in RobotId::first(robots).zip(&grids).zip(&maps) {
            if changed == Changed::Places && round > 0 {
                let distance_m = 0.05 * (STEPS_BEFORE + round) as f64;
                assert!(merger.add_robot_pose(robot, Pose2::new(distance_m, 0.3 * distance_m, 0.0), 0.105));
            } else if changed == Changed::InGrids {
                merger.update_map(robot, grid.view()).unwrap();
            } else {
                merger.update_tiles(robot, map).unwrap();
            }
        }
        merger.update_stale_tiles();
        if round == 0 {
            for (robot, step) in
                RobotId::first(robots).flat_map(|robot| (0..=STEPS_BEFORE).map(move |step| (robot, step)))
            {
                let distance_m = 0.05 * step as f64;
                merger.add_robot_pose(robot, Pose2::new(distance_m, 0.3 * distance_m, 0.0), 0.105);
            }
            merger.update_stale_tiles();
        } else {
            milliseconds.push(1e3 * (cpu_s() - began_s));
        }
    }
    assert!(merger.merged_tiles().tiles().next().is_some());
    milliseconds.sort_by(f64::total_cmp);
    [milliseconds[0], milliseconds[ROUNDS / 2]]
}

fn tiles(grid: &Grid) -> TileMap {
    let GridHeader { header, scan_sent, origin, resolution_m, .. } = grid.header;
    TileMap::from_grid(MapHeader { header, scan_sent, origin, resolution_m }, [0; 2], grid.view()).unwrap()
}

/// Updates a map as its reader would: equal tiles stay the same tiles.
fn patch(map: &mut TileMap, grid: &Grid) {
    for tile in tiles(grid).tiles() {
        let (x, y) = (tile.x.into(), tile.y.into());
        if map.get(x, y) != Some(tile) {
            map.set(x, y, Some(tile.clone()));
        }
    }
}

/// Rooms of 6 m with walls; every cell is known.
fn rooms(side: u32, seed: usize) -> Grid {
    let header = GridHeader {
        origin: Pose2::new(-0.025 * f64::from(side), -0.025 * f64::from(side), 0.0),
        resolution_m: 0.05,
        width: side,
        height: side,
        ..Default::default()
    };
    let wall = |x: u32, y: u32| x % 120 == 7 || y % 120 == 11 || (x + seed as u32).is_multiple_of(977);
    let cells = (0..side).flat_map(|y| (0..side).map(move |x| if wall(x, y) { 80 } else { -80 })).collect();
    Grid { header, cells }
}

/// Changes a square of `size` cells, elsewhere each round.
fn scribble(map: &mut Grid, size: u32, round: usize) {
    let side = map.header.width;
    let (x0, y0) = ((round as u32 * 331) % (side - size), (round as u32 * 577) % (side - size));
    for y in y0..y0 + size {
        for cell in &mut map.cells[(y * side + x0) as usize..][..size as usize] {
            *cell = cell.wrapping_add(3).max(msg::grid::LOG_ODDS_MIN);
        }
    }
}

/// Sends three maps and computes their statistics.
fn statistics(side: u32) -> [f64; 2] {
    let mut metrics = MapMetrics::new(3, None, &[]);
    let mut map_transforms = MapTransforms::default();
    for (k, map_transform) in map_transforms.robots.iter_mut().take(3).enumerate() {
        *map_transform =
            MapTransform { map_from_robot_map: Pose2::new(0.0, 0.0, 0.2 * k as f64), known: 1, map_frame: 0 };
    }
    metrics.update_map_transforms(&map_transforms);
    let maps: Vec<Grid> = (0..3).map(|k| rooms(side, k)).collect();
    let mut milliseconds: Vec<f64> = (0..ROUNDS)
        .map(|_| {
            let began_s = cpu_s();
            for (robot, map) in RobotId::first(3).zip(&maps) {
                metrics.update_map(robot, map.view());
            }
            assert_eq!(metrics.compute().pair_count(), 3);
            1e3 * (cpu_s() - began_s)
        })
        .collect();
    milliseconds.sort_by(f64::total_cmp);
    [milliseconds[0], milliseconds[ROUNDS / 2]]
}
