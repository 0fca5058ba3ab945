//! Parts of a map that another map contradicts, although the two agree elsewhere: one of them is deformed.

use super::{DistanceField, is_usable, match_walls_at, wall_points};
use crate::config::WallConfig;
use msg::{GridView, Pose2};

/// Least length of walls by which a part is judged, of both maps together, metres.
const WALLS_MIN_M: f64 = 4.0;
/// Share of walls that lie on the other map's floor from which a part is contradicted: more of them than match.
const CONFLICT_MIN: f64 = 0.5;

/// How many parts of a map were compared with another map, and how many of them it contradicts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct ComparedSubmaps {
    /// Parts that share enough walls and floor with the other map.
    pub compared: u32,
    /// Those of them that lie elsewhere in the other map, by its walls.
    pub contradicted: u32,
}

impl ComparedSubmaps {
    /// Compares parts with a map. Each part comes with the map's frame from its own.
    pub fn of<'a>(
        map: GridView<'_>,
        parts: impl Iterator<Item = (GridView<'a>, Pose2)>,
        config: &WallConfig,
    ) -> Self {
        let mut count = Self::default();
        if !is_usable(map) {
            return count;
        }
        let whole = DistanceField::of_map(map, config);
        for (grid, map_from_part) in parts.filter(|(grid, _)| is_usable(*grid)) {
            let part = DistanceField::of_map(grid, config);
            let fields = [&whole, &part];
            let found = match_walls_at(fields, map_from_part);
            if found.matched + found.contradicted >= wall_points(fields, WALLS_MIN_M) {
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
