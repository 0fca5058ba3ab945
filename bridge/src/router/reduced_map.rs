//! Maps with larger cells, for connections that are too slow for the whole map.

use crate::frame::Side;
use ros_messages::cdr::Dialect;
use ros_messages::{OccupancyGrid, decode_as, encode_as};

/// Steps of the factor by which cells grow: eighths, so that a map comes close to the bytes that it may have.
const STEPS: u32 = 8;
/// Cells grow by a factor of 32 at most, from 0.05 to 1.6 m: in larger ones no corridor is seen.
const FACTOR_MAX: u32 = 32 * STEPS;
/// Bytes of a frame beside its cells, at most: name, header, geometry.
const OVERHEAD_BYTES: usize = 256;

/// Returns the frame of a nav_msgs/OccupancyGrid with larger cells, at most `bytes_max` long.
///
/// A cell has the largest value of those that it covers: occupied before free before unknown, so that no wall is lost.
/// Origin, stamp and frame stay. `None` if the frame is no such map, or the cells would be too large.
pub fn reduce_map(frame: &[u8], dialect: Dialect, bytes_max: usize, out: &mut Vec<u8>) -> Option<()> {
    let name_bytes = u32::from_le_bytes(frame.get(..4)?.try_into().ok()?) as usize;
    let name = core::str::from_utf8(frame.get(4..4 + name_bytes)?).ok()?;
    let cells_max = bytes_max.checked_sub(OVERHEAD_BYTES)? as u64;
    let map: OccupancyGrid = decode_as(dialect, frame.get(8 + name_bytes..)?).ok()?;
    let cells = |factor: u32| u64::from(reduced(map.width, factor)) * u64::from(reduced(map.height, factor));
    let factor = (STEPS + 1..=FACTOR_MAX).find(|factor| cells(*factor) <= cells_max)?;
    let reduced = with_larger_cells(&map, factor);
    Side::Server.write_with(out, name, |out| encode_as(dialect, &reduced, out));
    Some(())
}

/// Returns the number of larger cells that cover so many cells.
fn reduced(cells: u32, factor: u32) -> u32 {
    (u64::from(cells) * u64::from(STEPS)).div_ceil(u64::from(factor)) as u32
}

/// Returns a map whose cells are `factor` / [`STEPS`] times as large.
fn with_larger_cells(map: &OccupancyGrid, factor: u32) -> OccupancyGrid {
    let (width, height) = (reduced(map.width, factor), reduced(map.height, factor));
    let mut data = vec![-1_i8; width as usize * height as usize];
    // The cells that a larger one covers, those at its edges included.
    let covered = |place: u32, count: u32| {
        let begin = u64::from(place) * u64::from(factor) / u64::from(STEPS);
        let end = (u64::from(place + 1) * u64::from(factor)).div_ceil(u64::from(STEPS));
        begin as usize..end.min(u64::from(count)) as usize
    };
    for (y, row) in (0_u32..).zip(data.chunks_exact_mut((width as usize).max(1))) {
        for source_y in covered(y, map.height) {
            let source = &map.data[source_y * map.width as usize..][..map.width as usize];
            for (x, cell) in (0_u32..).zip(row.iter_mut()) {
                let largest = source[covered(x, map.width)].iter().copied().max();
                *cell = (*cell).max(largest.unwrap_or(-1));
            }
        }
    }
    let resolution = map.resolution * factor as f32 / STEPS as f32;
    OccupancyGrid { resolution, width, height, data, frame_id: map.frame_id.clone(), ..*map }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn frame(map: &OccupancyGrid) -> Vec<u8> {
        let mut out = Vec::new();
        Side::Server.write_with(&mut out, "/merged_map", |out| encode_as(Dialect::Ros2, map, out));
        out
    }

    fn map(width: u32, height: u32, data: Vec<i8>) -> OccupancyGrid {
        let (resolution, position) = (0.05, [-3.0, 2.0, 0.0]);
        OccupancyGrid { resolution, width, height, position, data, ..OccupancyGrid::default() }
    }

    #[test]
    fn a_wall_of_one_cell_stays_and_the_map_covers_the_same_place() {
        let mut data = vec![0; 500 * 300];
        data.iter_mut().skip(250).step_by(500).for_each(|cell| *cell = 100);
        let whole = map(500, 300, data);
        let mut out = Vec::new();
        reduce_map(&frame(&whole), Dialect::Ros2, 18_000, &mut out).unwrap();
        assert!((12_000..=18_000).contains(&out.len()), "{}", out.len());
        let small: OccupancyGrid = decode_as(Dialect::Ros2, &out[8 + "/merged_map".len()..]).unwrap();
        assert_eq!(small.position, whole.position);
        let side_m = |map: &OccupancyGrid| map.resolution * map.width as f32;
        assert!((side_m(&small) - side_m(&whole)).abs() <= small.resolution);
        let wall = (250.5 * whole.resolution / small.resolution) as usize;
        assert!(small.data.chunks(small.width as usize).all(|row| row[wall] == 100));
        assert_eq!(small.data.iter().filter(|cell| **cell == -1).count(), 0);
    }

    #[test]
    fn what_is_no_map_or_too_large_is_left_alone() {
        let mut out = Vec::new();
        assert_eq!(reduce_map(&[1, 2, 3], Dialect::Ros2, 18_000, &mut out), None);
        let whole = map(2000, 2000, vec![0; 4_000_000]);
        assert_eq!(reduce_map(&frame(&whole), Dialect::Ros2, 1000, &mut out), None);
        assert!(out.is_empty());
    }

    proptest! {
        #[test]
        fn each_cell_is_in_a_larger_one_that_is_at_least_as_occupied(
            width in 1_u32..60, height in 1_u32..60, factor in STEPS + 1..=80, seed in any::<u64>(),
        ) {
            let value = |cell: u32| [-1, 0, 100][(seed.rotate_left(cell % 64) % 3) as usize];
            let whole = map(width, height, (0..width * height).map(value).collect());
            let small = with_larger_cells(&whole, factor);
            prop_assert_eq!(small.data.len(), (small.width * small.height) as usize);
            for y in 0..height {
                for x in 0..width {
                    let place = (y * STEPS / factor) * small.width + x * STEPS / factor;
                    prop_assert!(small.data[place as usize] >= whole.data[(y * width + x) as usize]);
                }
            }
        }
    }
}
