//! Evidence by short walls: do those of two maps match, or stand on each other's floor?
//!
//! Rooms of one size share their long walls wherever they are. What tells them apart is short: furniture, niches, door
//! jambs. A share of all walls hides it, since a room's outline outweighs all that stands in it.

use super::distance_field::DistanceField;
use msg::Pose2;

/// Directions in which a straight wall is looked for, over half a turn.
const DIRECTIONS: usize = 16;
/// Length of a straight piece of wall from which it is long, metres: most furniture is shorter.
const LONG_WALL_M: f64 = 1.5;
/// A straight piece may leave the wall by so much, cells: its direction is rounded.
const STRAIGHT_CELLS: f32 = 1.5;
/// Wall points of each map that are looked at.
const POINTS_MAX: usize = 6_000;

/// Wall points of a map that are compared, and whether each is part of a long wall.
pub(crate) struct ShortWalls {
    points: Vec<([f64; 2], bool)>,
    /// Length of wall that a point stands for, metres.
    point_m: f64,
}

impl ShortWalls {
    /// Chooses the points of a map.
    pub fn new(map: &DistanceField) -> Self {
        let stride = map.points.walls_m.len().div_ceil(POINTS_MAX).max(1);
        let points = map.points.walls_m.iter().step_by(stride).map(|[x, y]| {
            let at = [f64::from(*x), f64::from(*y)];
            (at, map.is_on_long_wall(map.to_cells(at)))
        });
        Self { points: points.collect(), point_m: map.points.wall_point_m * stride as f64 }
    }

    /// Returns the length of wall that a point stands for, metres.
    pub fn point_m(&self) -> f64 {
        self.point_m
    }

    /// Returns the points of short walls that lie on a wall of another map.
    pub fn matched_points(
        &self,
        other: &DistanceField,
        other_from_map: Pose2,
    ) -> impl Iterator<Item = [f64; 2]> {
        let short = self.points.iter().filter(|(_, is_long)| !is_long).map(|(at, _)| *at);
        short.filter(move |at| {
            let [u, v] = other.to_cells(other_from_map.apply(*at));
            let inside = u >= 0.0 && v >= 0.0 && u < other.width as f64 && v < other.height as f64;
            inside && other.distance[v as usize * other.width + u as usize] <= other.match_cells
        })
    }
}

/// Lengths of walls of both maps under a transform, metres.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ShortWallMatch {
    /// Short walls that lie on a wall of the other map.
    pub matched_m: f64,
    /// Walls of any length that stand on the other map's floor.
    pub contradicted_m: f64,
}

impl ShortWallMatch {
    /// Share of contradicted walls where long ones that match do not count, 0 to 1.
    pub fn conflict(&self) -> f64 {
        self.contradicted_m / (self.matched_m + self.contradicted_m).max(f64::MIN_POSITIVE)
    }
}

impl DistanceField {
    /// Whether a wall point is part of a straight wall of [`LONG_WALL_M`].
    fn is_on_long_wall(&self, [u, v]: [f64; 2]) -> bool {
        let reach = (LONG_WALL_M / self.cell_m).round() as i32;
        let is_wall = |cells: i32, [dx, dy]: [f64; 2]| {
            let (x, y) = (u + f64::from(cells) * dx, v + f64::from(cells) * dy);
            let inside = x >= 0.0 && y >= 0.0 && x < self.width as f64 && y < self.height as f64;
            inside && self.distance[y as usize * self.width + x as usize] <= STRAIGHT_CELLS
        };
        (0..DIRECTIONS).any(|k| {
            let (dy, dx) = (core::f64::consts::PI * k as f64 / DIRECTIONS as f64).sin_cos();
            let run = |sign: f64| {
                let direction = [sign * dx, sign * dy];
                (1..=reach).take_while(|cells| is_wall(*cells, direction)).count() as i32
            };
            let ahead = run(1.0);
            ahead >= reach || ahead + run(-1.0) >= reach
        })
    }

    /// Compares b's walls with this map.
    fn match_short_walls_of(&self, b: &ShortWalls, a_from_b: Pose2) -> ShortWallMatch {
        let mut result = ShortWallMatch::default();
        for (at, is_long) in &b.points {
            let [u, v] = self.to_cells(a_from_b.apply(*at));
            if !(u >= 0.0 && v >= 0.0 && u < self.width as f64 && v < self.height as f64) {
                continue;
            }
            let index = v as usize * self.width + u as usize;
            let distance = self.distance[index];
            if distance > self.conflict_cells && self.floor[index] {
                result.contradicted_m += b.point_m;
            } else if distance <= self.match_cells && !is_long {
                result.matched_m += b.point_m;
            }
        }
        result
    }
}

/// Compares the short walls of both maps under a transform between their centred frames.
pub(crate) fn match_short_walls(
    [a, b]: [&DistanceField; 2],
    [of_a, of_b]: [&ShortWalls; 2],
    a_from_b: Pose2,
) -> ShortWallMatch {
    let (b_on_a, a_on_b) =
        (a.match_short_walls_of(of_b, a_from_b), b.match_short_walls_of(of_a, a_from_b.inverse()));
    ShortWallMatch {
        matched_m: a_on_b.matched_m + b_on_a.matched_m,
        contradicted_m: a_on_b.contradicted_m + b_on_a.contradicted_m,
    }
}
