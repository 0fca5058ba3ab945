//! A run as a picture: the map, the true walls and path over it, and what SLAM believes.

use super::building::Building;
use super::run::Scored;
use formats::map_file::{MapFileError, Picture, Rgb, write_map};
use msg::{GridView, Pose2};
use std::path::Path;

/// True walls.
const WALL: Rgb = [240, 150, 20];
/// The true path.
const TRUTH: Rgb = [30, 160, 70];
/// Poses that are placed in the map, and those that are not.
const PLACED: Rgb = [40, 120, 220];
const UNPLACED: Rgb = [150, 70, 190];
/// Active closures: right ones, wrong ones.
const RIGHT: Rgb = [0, 170, 180];
const WRONG: Rgb = [230, 60, 50];

/// Writes `STEM.yaml`, `STEM.pgm` and `STEM.png` of the map, and `STEM-truth.png` with the truth over it.
pub fn write(
    stem: &Path,
    map: GridView<'_>,
    building: &Building,
    scored: &Scored,
) -> Result<(), MapFileError> {
    write_map(stem, map)?;
    let map_from_world = scored.world_from_map.inverse();
    let place = |pose: Pose2| [pose.x_m, pose.y_m];
    let mut picture = Picture::new(map);
    for wall in &building.walls {
        picture.path([wall.from, wall.to].map(|end| map_from_world.apply(end)), WALL);
    }
    picture.path(scored.poses.iter().map(|pose| place(map_from_world * pose.truth)), TRUTH);
    for pair in scored.poses.windows(2) {
        let colour = if pair[1].is_placed { PLACED } else { UNPLACED };
        picture.path(pair.iter().map(|pose| place(pose.map_from_base)), colour);
    }
    for (ends, is_wrong) in &scored.closures {
        picture.path(ends.map(place), if *is_wrong { WRONG } else { RIGHT });
    }
    let mut name = stem.file_name().unwrap_or_default().to_os_string();
    name.push("-truth.png");
    picture.write_png(&stem.with_file_name(name))
}
