//! Fusion of the maps of all robots in one tile.

use crate::resample::ResampleBuffer;
use crate::robot_map::RobotMap;
use msg::grid::{LOG_ODDS_MAX, SWEPT_FREE, UNKNOWN};
use msg::tiles::TILE_CELLS;
use msg::{IndexRect, MapTile, ROBOTS_MAX};

/// Adds the log-odds of all robots in one tile of the lattice; `None` if nothing is known there.
///
/// Log-odds of independent observers add up (`msg::grid` says why): a false obstacle of one robot is cleared by
/// those who saw the floor. Floor that a robot has driven over stays floor, whatever the others saw there.
pub(super) fn fuse_tile(
    x: i64,
    y: i64,
    robots: &[RobotMap],
    resolution_m: f64,
    buffer: &mut ResampleBuffer,
) -> Option<MapTile> {
    let mut sums = [0_i16; TILE_CELLS];
    let mut ranks = [RANK_UNKNOWN; TILE_CELLS];
    let mut any = false;
    for robot in robots.iter().filter(|robot| robot.tiles.contains(IndexRect::single(x, y))) {
        let resampler = robot.resampler.as_ref();
        if resampler.is_some_and(|resampler| resampler.resample_tile(x, y, &robot.drawn, buffer)) {
            any = true;
            for ((sum, least), cell) in sums.iter_mut().zip(&mut ranks).zip(buffer.tile.iter()) {
                *sum += i16::from(*cell & -i8::from(*cell != UNKNOWN));
                *least = (*least).min(rank(*cell));
            }
        }
    }
    if !any || ranks.iter().all(|rank| *rank == RANK_UNKNOWN) {
        return None;
    }
    let most = i16::from(LOG_ODDS_MAX);
    let mut tile = MapTile::unknown(x, y);
    for ((cell, sum), least) in tile.cells.iter_mut().zip(&sums).zip(&ranks) {
        let sum = (*sum).clamp(-most, most) as i8;
        let (known, driven) = (-i8::from(*least != RANK_UNKNOWN), -i8::from(*least == rank(SWEPT_FREE)));
        *cell = (((sum & !driven) | (SWEPT_FREE & driven)) & known) | (UNKNOWN & !known);
    }
    for robot in robots.iter().filter(|robot| robot.path_tiles.contains(IndexRect::single(x, y))) {
        robot.clear_path(resolution_m, &mut tile);
    }
    Some(tile)
}

/// Orders cells from driven over (least) to unknown (most): one minimum over the robots tells both whether one has
/// driven there and whether any knows the cell.
const fn rank(cell: i8) -> u8 {
    cell.wrapping_sub(SWEPT_FREE) as u8
}
const RANK_UNKNOWN: u8 = rank(UNKNOWN);
const _: () = assert!(rank(SWEPT_FREE) == 0 && RANK_UNKNOWN == u8::MAX);
// The sum of all robots' log-odds fits into 16 bits.
const _: () = assert!(ROBOTS_MAX * (LOG_ODDS_MAX as usize) < i16::MAX as usize);
