//! mr_slam_msgs/MapTiles: the parts of a map that changed, for clients that keep the map.
//!
//! map_msgs/OccupancyGridUpdate has one rectangle, no size of the map and no number: a client cannot tell a lost one.

use crate::cdr::{DecodeError, Reader, Writer};
use crate::message::{Message, read_header};
use crate::sensor::read_pose;
use crate::{read, write};
use msg::{GridView, IndexRect, Stamp};

/// Areas of a map that changed, and which update this is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TileUpdate<'a> {
    /// Number of this update, from 1.
    pub number: u32,
    /// Number of the update before; 0 if only the whole map tells what changed.
    pub base: u32,
    /// Changed rectangles of the map.
    pub areas: &'a [IndexRect],
}

/// One rectangle of cells.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct MapTile {
    /// Column of the map where the rectangle begins.
    pub x: u32,
    /// Row of the map where the rectangle begins.
    pub y: u32,
    /// Number of columns.
    pub width: u32,
    /// Number of rows.
    pub height: u32,
    /// Values as in [`crate::OccupancyGrid::data`].
    pub data: Vec<i8>,
}

/// mr_slam_msgs/MapTiles: an update of a map.
///
/// A client applies it to its map if it is the first since it began to listen, or if `base` is the `number` of the last one.
/// Otherwise it gets the whole map again. Cells that the new size adds are unknown.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MapTiles {
    /// Time of the newest content.
    pub stamp: Stamp,
    /// Frame of the map.
    pub frame_id: String,
    /// Number of this update, from 1.
    pub number: u32,
    /// Number of the update before; 0 if only the whole map tells what changed.
    pub base: u32,
    /// Side length of a cell, metres.
    pub resolution: f32,
    /// Number of cells of the whole map along x and y.
    pub size: (u32, u32),
    /// Position of the lower left corner of cell (0, 0), metres.
    pub position: [f64; 3],
    /// Orientation: unit quaternion x, y, z, w.
    pub orientation: [f64; 4],
    /// Rectangles of cells that changed.
    pub tiles: Vec<MapTile>,
}

/// Least bytes of a [`MapTile`].
const TILE_BYTES_MIN: usize = 20;

impl Message for MapTiles {
    const TYPE: &'static str = "mr_slam_msgs/MapTiles";
    fn read(from: &mut Reader<'_>) -> Result<Self, DecodeError> {
        let (stamp, frame_id) = read_header(from)?;
        let (number, base) = (from.u32("number")?, from.u32("base")?);
        read::stamp(from, "info.map_load_time")?;
        let resolution = from.f32("info.resolution")?;
        let size = (from.u32("info.width")?, from.u32("info.height")?);
        let (position, orientation) = read_pose(from)?;
        let count = from.count("tiles", TILE_BYTES_MIN)?;
        let tiles = (0..count).map(|_| read_tile(from)).collect::<Result<_, _>>()?;
        Ok(Self { stamp, frame_id, number, base, resolution, size, position, orientation, tiles })
    }
    fn write(&self, to: &mut Writer<'_>) {
        write::header(to, self.stamp, &self.frame_id);
        to.u32(self.number);
        to.u32(self.base);
        write::map_info(to, self.stamp, self.resolution, self.size, self.position, self.orientation);
        to.count(self.tiles.len());
        for tile in &self.tiles {
            [tile.x, tile.y, tile.width, tile.height].into_iter().for_each(|number| to.u32(number));
            to.byte_seq_with(tile.data.len(), |bytes| {
                bytes.iter_mut().zip(&tile.data).for_each(|(byte, cell)| *byte = *cell as u8);
            });
        }
    }
}

fn read_tile(from: &mut Reader<'_>) -> Result<MapTile, DecodeError> {
    let (x, y) = (from.u32("tile.x")?, from.u32("tile.y")?);
    let (width, height) = (from.u32("tile.width")?, from.u32("tile.height")?);
    let data = from.byte_seq("tile.data")?;
    if u64::from(width) * u64::from(height) != data.len() as u64 {
        return Err(DecodeError::GridSize { width, height, cells: data.len() });
    }
    Ok(MapTile { x, y, width, height, data: data.iter().map(|byte| *byte as i8).collect() })
}

/// Writes mr_slam_msgs/MapTiles: the cells of the update's areas as [`write::occupancy_grid`] has them.
pub fn write_map_tiles(
    to: &mut Writer<'_>,
    frame_id: &str,
    values: &[i8; 256],
    grid: GridView<'_>,
    update: TileUpdate<'_>,
) {
    let about = grid.header;
    let (position, orientation) = write::spatial(about.origin);
    write::header(to, about.header.stamp, frame_id);
    to.u32(update.number);
    to.u32(update.base);
    let size = (about.width, about.height);
    write::map_info(to, about.header.stamp, about.resolution_m as f32, size, position, orientation);
    to.count(update.areas.len());
    for area in update.areas {
        to.u32(area.x0 as u32);
        to.u32(area.y0 as u32);
        write::grid_area(to, values, grid, *area);
    }
}
