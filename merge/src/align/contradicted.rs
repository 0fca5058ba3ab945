//! Parts of a map that another map contradicts, although the two agree elsewhere: one of them is bent.

use super::distance_field::DistanceField;
use super::points::MapPoints;
use super::wall_match::match_walls;
use super::{COARSE_CELL_M, FINE_POINTS, is_usable, strides};
use crate::config::WallConfig;
use msg::{GridView, Pose2};

/// Least length of walls by which a part is judged, of both maps together, metres.
const WALLS_MIN_M: f64 = 4.0;
/// Share of walls that lie on the other map's floor from which a part is contradicted: more of them than match.
const CONFLICT_MIN: f64 = 0.5;

/// How many parts of a map were compared with another map, and how many of them it contradicts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct ComparedParts {
    /// Parts that share enough walls and floor with the other map.
    pub compared: u32,
    /// Those of them that lie elsewhere in the other map, by its walls.
    pub contradicted: u32,
}

impl ComparedParts {
    /// Compares parts with a map. Each part comes with the map's frame from its own.
    pub fn of<'a>(
        map: GridView<'_>,
        parts: impl Iterator<Item = (GridView<'a>, Pose2)>,
        config: &WallConfig,
    ) -> Self {
        let mut count = Self::default();
        let field =
            |grid: GridView<'_>| DistanceField::new(MapPoints::from_grid(grid, COARSE_CELL_M), grid, config);
        if !is_usable(map) {
            return count;
        }
        let whole = field(map);
        for (grid, map_from_part) in parts.filter(|(grid, _)| is_usable(*grid)) {
            let part = field(grid);
            let fields = [&whole, &part];
            let [from_whole, from_part] = fields.map(|field| field.points.frame_from_centred);
            let place = from_whole.inverse() * map_from_part * from_part;
            let found = match_walls(fields, place, strides(fields, FINE_POINTS));
            let wall_point_m = (whole.points.wall_point_m + part.points.wall_point_m) / 2.0;
            if (found.matched + found.contradicted) * wall_point_m >= WALLS_MIN_M {
                count.compared += 1;
                count.contradicted += u32::from(found.conflict() >= CONFLICT_MIN);
            }
        }
        count
    }

    /// The sum of two counts.
    pub fn plus(self, other: Self) -> Self {
        Self {
            compared: self.compared + other.compared,
            contradicted: self.contradicted + other.contradicted,
        }
    }
}
