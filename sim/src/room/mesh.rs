//! Triangle meshes with z up: their validation, and the estimation of the floor's height.

use super::furniture::Piece;
use super::{EXTENT_MAX_M, RoomError, TRIANGLES_MAX, VERTICES_MAX};
use glam::Vec3;

/// Triangles in a frame with z up.
#[derive(Clone, Debug, Default)]
pub(crate) struct Mesh {
    pub(crate) vertices: Vec<Vec3>,
    pub(crate) triangles: Vec<[u32; 3]>,
    /// Furniture that the file names.
    pub(crate) furniture: Vec<Piece>,
}

/// Smallest z of the normal of a level triangle: a slope of 26°.
const LEVEL_MIN: f32 = 0.9;
/// Size of the bins in the histogram of heights, metres.
const BIN_M: f32 = 0.02;
/// Share of the largest level's area that the floor has at least. The floor is the lowest such level: below
/// the ceiling and the tables, but larger than a cellar seen through a hole.
const FLOOR_SHARE: f64 = 0.4;
/// Smallest area of a floor, square metres.
const FLOOR_MIN_M2: f64 = 0.5;
/// Largest distance between the stated height of the floor and that of the mesh, metres.
const STATED_FLOOR_M: f32 = 0.2;
/// Half of the thickness of a scanned floor, metres.
const FLOOR_BAND_M: f32 = 0.05;

impl Mesh {
    /// Converts from y up (x right, z towards the viewer) to z up: a quarter turn about x.
    pub(crate) fn with_z_up(mut self) -> Self {
        self.move_points(|v| Vec3::new(v.x, -v.z, v.y));
        self
    }

    /// Moves all points, those of the furniture too.
    pub(crate) fn move_points(&mut self, to: impl Fn(Vec3) -> Vec3) {
        let of_furniture = self.furniture.iter_mut().flat_map(|piece| &mut piece.corners);
        self.vertices.iter_mut().chain(of_furniture).for_each(|point| *point = to(*point));
    }

    pub(crate) fn corners(&self, triangle: [u32; 3]) -> [Vec3; 3] {
        triangle.map(|i| self.vertices[i as usize])
    }

    /// Checks that coordinates are finite, indices exist, and sizes are those of a room.
    pub(crate) fn check(&self) -> Result<(), RoomError> {
        let count = |what, count: usize, max| {
            if count > max { Err(RoomError::TooMany { what, count, max }) } else { Ok(()) }
        };
        count("vertices", self.vertices.len(), VERTICES_MAX)?;
        count("triangles", self.triangles.len(), TRIANGLES_MAX)?;
        if self.triangles.is_empty() {
            return Err(RoomError::Empty);
        }
        if let Some(vertex) = self.vertices.iter().position(|v| !v.is_finite()) {
            return Err(RoomError::NotFinite { vertex });
        }
        let vertices = self.vertices.len();
        let wrong = self.triangles.iter().enumerate().find_map(|(triangle, corners)| {
            corners.iter().find(|i| **i as usize >= vertices).map(|index| (triangle, *index))
        });
        if let Some((triangle, index)) = wrong {
            return Err(RoomError::BadIndex { triangle, index, vertices });
        }
        let (min, max) = self.bounds();
        let extent_m = (max - min).max_element();
        let off_m = min.abs().max(max.abs()).max_element();
        if extent_m.max(off_m) > EXTENT_MAX_M {
            return Err(RoomError::TooLarge { extent_m: extent_m.max(off_m) });
        }
        Ok(())
    }

    /// Returns the corners of the box around all vertices that a triangle uses.
    pub(crate) fn bounds(&self) -> (Vec3, Vec3) {
        let used = self.triangles.iter().flat_map(|t| self.corners(*t));
        let nothing = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        used.fold(nothing, |(min, max), v| (min.min(v), max.max(v)))
    }

    /// Iterates over the mean height and the area of every level triangle, whichever side is up.
    fn level_triangles(&self) -> impl Iterator<Item = (f32, f64)> + '_ {
        self.triangles.iter().filter_map(|triangle| {
            let [a, b, c] = self.corners(*triangle);
            let normal = (b - a).cross(c - a);
            let area = normal.length() / 2.0;
            let level = normal.z.abs() > LEVEL_MIN * normal.length();
            level.then_some(((a.z + b.z + c.z) / 3.0, f64::from(area)))
        })
    }

    /// Estimates the height of the floor, near the stated height if there is one. Returns the height in
    /// metres and the floor's area in square metres.
    pub(crate) fn find_floor(&self, stated_m: Option<f32>) -> Result<(f32, f64), RoomError> {
        let (min, max) = self.bounds();
        let bins = ((max.z - min.z) / BIN_M) as usize + 1;
        let mut areas = vec![0.0; bins];
        for (height_m, area) in self.level_triangles() {
            areas[(((height_m - min.z) / BIN_M) as usize).min(bins - 1)] += area;
        }
        let half = (FLOOR_BAND_M / BIN_M) as usize;
        let thick =
            |bin: usize| areas[bin.saturating_sub(half)..(bin + half + 1).min(bins)].iter().sum::<f64>();
        let height_m = |bin: usize| min.z + (bin as f32 + 0.5) * BIN_M;
        let near =
            |bin: usize| stated_m.is_none_or(|stated| (height_m(bin) - stated).abs() <= STATED_FLOOR_M);
        let candidates = || (0..bins).filter(|bin| near(*bin));
        let most = candidates().map(thick).fold(0.0, f64::max);
        if most < FLOOR_MIN_M2 {
            return Err(RoomError::NoFloor { area_m2: most });
        }
        let lowest = candidates().find(|bin| thick(*bin) >= FLOOR_SHARE * most).unwrap_or(0);
        // The floor's height is where its area is densest, at or above its lower edge.
        let end = (lowest + 2 * half + 1).min(bins);
        let densest = (lowest..end).max_by(|a, b| thick(*a).total_cmp(&thick(*b)).then(b.cmp(a)));
        let centre_m = height_m(densest.unwrap_or(lowest));
        let within = self.level_triangles().filter(|(height, _)| (height - centre_m).abs() <= FLOOR_BAND_M);
        let (weighted, area) = within
            .fold((0.0, 0.0), |(sum, total), (height, area)| (sum + f64::from(height) * area, total + area));
        Ok(((weighted / area) as f32, area))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square(side: f32, z: f32) -> Mesh {
        let vertices = [[0.0, 0.0], [side, 0.0], [side, side], [0.0, side]];
        Mesh {
            vertices: vertices.map(|[x, y]| Vec3::new(x, y, z)).to_vec(),
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Mesh::default()
        }
    }

    fn join(meshes: &[Mesh]) -> Mesh {
        meshes.iter().fold(Mesh::default(), |mut all, mesh| {
            let first = all.vertices.len() as u32;
            all.vertices.extend(&mesh.vertices);
            all.triangles.extend(mesh.triangles.iter().map(|t| t.map(|i| i + first)));
            all
        })
    }

    #[test]
    fn the_floor_is_found_below_tables_and_ceiling() {
        let room = join(&[square(5.0, 2.9), square(4.0, 0.31), square(2.0, 1.1), square(0.9, -0.6)]);
        let (height, area) = room.find_floor(None).unwrap();
        assert!((height - 0.31).abs() < 1e-3, "{height}");
        assert!((area - 16.0).abs() < 1e-3, "{area}");
        let (height, _) = room.find_floor(Some(1.0)).unwrap();
        assert!((height - 1.1).abs() < 1e-3, "{height}");
        assert!(matches!(room.find_floor(Some(2.0)), Err(RoomError::NoFloor { .. })));
    }

    #[test]
    fn y_up_becomes_z_up() {
        let mesh = Mesh { vertices: vec![Vec3::new(1.0, 2.0, 3.0)], triangles: vec![], ..Mesh::default() };
        assert_eq!(mesh.with_z_up().vertices[0], Vec3::new(1.0, -3.0, 2.0));
    }
}
