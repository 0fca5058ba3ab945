//! Draws submaps, each at its pose, into one grid.

use msg::grid::{CELLS_MAX, LOG_ODDS_MAX, LOG_ODDS_MIN, SWEPT_FREE, UNKNOWN};
use msg::{Grid, GridHeader, GridView, Pose2};
use std::sync::Arc;

/// A submap with its pose.
#[derive(Clone, Debug)]
pub(crate) struct PlacedSubmap {
    /// Occupancy in the submap's frame.
    pub grid: Arc<Grid>,
    /// Frame of the drawn grid from the submap's frame.
    pub frame_from_submap: Pose2,
}

/// Sum that marks an unknown cell; no sum of beams comes near it.
const UNKNOWN_SUM: i16 = i16::MIN;
/// Sum that marks a cell that the robot has driven over; no sum of beams comes near it.
const SWEPT_FREE_SUM: i16 = i16::MIN + 1;
/// Added to every input coordinate, in cells: a centre on the border of two cells always takes the same one, whatever the
/// last bit of a sine is.
const BORDER_BIAS_CELLS: f64 = 1e-6;
const _: () = assert!(msg::SUBMAPS_MAX as i32 * (LOG_ODDS_MIN as i32) > SWEPT_FREE_SUM as i32);

/// Adds the log-odds of all submaps in one grid of the first one's resolution, aligned with the frame's axes at whole
/// multiples of it. `None` without submaps, or if the grid would be too large.
pub(crate) fn draw_submaps(placed: &[PlacedSubmap]) -> Option<Grid> {
    let resolution_m = placed.first()?.grid.header.resolution_m;
    let mut hull = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
    for submap in placed {
        for [x, y] in corners(&submap.grid.header, submap.frame_from_submap) {
            hull = [hull[0].min(x), hull[1].min(y), hull[2].max(x), hull[3].max(y)];
        }
    }
    let low = [0, 1].map(|k| (hull[k] / resolution_m).floor());
    let size = [0, 1].map(|k| ((hull[k + 2] / resolution_m).ceil() - low[k]).max(0.0));
    if size[0] * size[1] > CELLS_MAX as f64 || size.iter().any(|s| *s < 1.0) {
        return None;
    }
    let (width, height) = (size[0] as usize, size[1] as usize);
    let mut sums = vec![UNKNOWN_SUM; width * height];
    let frame_from_grid = Pose2::new(low[0] * resolution_m, low[1] * resolution_m, 0.0);
    for submap in placed {
        let grid_from_submap = frame_from_grid.between(submap.frame_from_submap);
        add(submap.grid.view(), grid_from_submap, resolution_m, &mut sums, width);
    }
    let [least, most] = [LOG_ODDS_MIN, LOG_ODDS_MAX].map(i16::from);
    let cell = |sum: &i16| match *sum {
        UNKNOWN_SUM => UNKNOWN,
        SWEPT_FREE_SUM => SWEPT_FREE,
        sum => sum.clamp(least, most) as i8,
    };
    let newest = placed.iter().map(|submap| &submap.grid.header).max_by_key(|header| header.header.stamp)?;
    let header = GridHeader {
        origin: frame_from_grid,
        resolution_m,
        width: width as u32,
        height: height as u32,
        header: newest.header,
        scan_sent: newest.scan_sent,
    };
    Some(Grid { header, cells: sums.iter().map(cell).collect() })
}

/// Corners of a submap's grid in the drawn grid's frame.
fn corners(header: &GridHeader, frame_from_submap: Pose2) -> [[f64; 2]; 4] {
    let (w, h) =
        (f64::from(header.width) * header.resolution_m, f64::from(header.height) * header.resolution_m);
    [[0.0, 0.0], [w, 0.0], [0.0, h], [w, h]].map(|corner| (frame_from_submap * header.origin).apply(corner))
}

/// Adds a submap: at every output cell's centre its nearest cell.
fn add(submap: GridView<'_>, grid_from_submap: Pose2, resolution_m: f64, sums: &mut [i16], width: usize) {
    let header = submap.header;
    let (submap_width, submap_height) = (header.width as usize, header.height as usize);
    let to_cells = (grid_from_submap * header.origin).inverse();
    let (sin, cos) = to_cells.yaw_rad.sin_cos();
    let step = resolution_m / header.resolution_m;
    let at = corners(header, grid_from_submap);
    let range = |k: usize, most: usize| {
        let low = at.iter().fold(f64::INFINITY, |low, c| low.min(c[k])) / resolution_m;
        let high = at.iter().fold(f64::NEG_INFINITY, |high, c| high.max(c[k])) / resolution_m;
        (low.floor().max(0.0) as usize).min(most)..(high.ceil().max(0.0) as usize).min(most)
    };
    let (columns, rows) = (range(0, width), range(1, sums.len() / width.max(1)));
    for y in rows {
        let v = (y as f64 + 0.5) * resolution_m;
        let start = [-sin * v + to_cells.x_m, cos * v + to_cells.y_m]
            .map(|m| m / header.resolution_m + BORDER_BIAS_CELLS);
        let row = &mut sums[y * width..][..width];
        for x in columns.clone() {
            let u = (x as f64 + 0.5) * step;
            let [i, j] = [start[0] + cos * u, start[1] + sin * u];
            // Cut off as an integer, a coordinate is rounded down only where it is not negative.
            if !(i >= 0.0 && j >= 0.0) {
                continue;
            }
            let (i, j) = (i as usize, j as usize);
            if i >= submap_width || j >= submap_height {
                continue;
            }
            let cell = submap.cells[j * submap_width + i];
            let sum = &mut row[x];
            *sum = match (cell, *sum) {
                (UNKNOWN, before) => before,
                (SWEPT_FREE, _) | (_, SWEPT_FREE_SUM) => SWEPT_FREE_SUM,
                (_, UNKNOWN_SUM) => i16::from(cell),
                (_, before) => before.saturating_add(i16::from(cell)),
            };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn submap(seed: u64, width: u32, height: u32) -> Arc<Grid> {
        let value = |i: u64| ((i.wrapping_mul(seed | 1).wrapping_mul(0x9e37_79b9)) >> 7) as i8;
        let cells =
            (0..u64::from(width * height)).map(|i| if value(i) > 100 { UNKNOWN } else { value(i) }).collect();
        let header = GridHeader {
            resolution_m: 0.05,
            width,
            height,
            origin: Pose2::new(-0.3, 0.2, 0.0),
            ..Default::default()
        };
        Arc::new(Grid { header, cells })
    }

    proptest! {
        #[test]
        fn the_order_of_submaps_does_not_matter(
            poses in prop::collection::vec((-3.0..3.0, -3.0..3.0, -3.0..3.0_f64, any::<u64>()), 1..5),
        ) {
            let mut placed: Vec<_> = poses
                .iter()
                .map(|(x, y, yaw, seed)| PlacedSubmap { grid: submap(*seed, 9, 13), frame_from_submap: Pose2::new(*x, *y, *yaw) })
                .collect();
            let forward = draw_submaps(&placed).unwrap();
            placed.reverse();
            prop_assert_eq!(draw_submaps(&placed).unwrap().cells, forward.cells);
        }
    }

    proptest! {
        #[test]
        fn each_cell_is_that_of_the_submap_under_its_centre(
            (x_m, y_m, yaw_rad, seed) in (-3.0..3.0, -3.0..3.0, -3.0..3.0_f64, any::<u64>()),
        ) {
            let placed = PlacedSubmap { grid: submap(seed, 9, 13), frame_from_submap: Pose2::new(x_m, y_m, yaw_rad) };
            let whole = draw_submaps(std::slice::from_ref(&placed)).unwrap();
            let grid = whole.view();
            for (y, x) in (0..grid.header.height).flat_map(|y| (0..grid.header.width).map(move |x| (y, x))) {
                let (x, y) = (i64::from(x), i64::from(y));
                let [u, v] = placed.frame_from_submap.inverse().apply(grid.centre_m(x, y));
                // A hair's breadth to each side: on the border of two cells either may be taken.
                let near = [-1e-5, 0.0, 1e-5].map(|d| {
                    let (i, j) = placed.grid.view().cell_of([u + d, v + d]);
                    placed.grid.view().cell(i, j)
                });
                prop_assert!(near.contains(&grid.cell(x, y)), "{x} {y}: {near:?}");
            }
        }
    }

    #[test]
    fn one_submap_at_the_origin_is_copied() {
        let grid = submap(7, 20, 11);
        let whole =
            draw_submaps(&[PlacedSubmap { grid: grid.clone(), frame_from_submap: Pose2::IDENTITY }]).unwrap();
        for y in 0..11 {
            for x in 0..20 {
                let [px, py] = grid.view().centre_m(x, y);
                let (i, j) = whole.view().cell_of([px, py]);
                let (there, here) = (whole.view().cell(i, j), grid.view().cell(x, y));
                assert_eq!(there, here);
            }
        }
    }

    #[test]
    fn no_submaps_and_too_large_grids_give_none() {
        assert!(draw_submaps(&[]).is_none());
        let far = |x| PlacedSubmap { grid: submap(1, 5, 5), frame_from_submap: Pose2::new(x, x, 0.0) };
        assert!(draw_submaps(&[far(0.0), far(1e4)]).is_none());
    }
}
