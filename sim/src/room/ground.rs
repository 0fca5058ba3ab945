//! The floor seen from above: its cells, the obstacles on it, and the cells where a robot fits.

use super::mesh::Mesh;
use super::raster::Raster;
use crate::burger;
use glam::Vec3;

/// Height up to which triangles belong to the floor, metres: edges of carpets, thresholds, noise of a scan.
pub(crate) const FLOOR_RELIEF_M: f32 = 0.03;
/// Length of a cell's side, metres.
pub(crate) const CELL_M: f64 = 0.05;
/// Radius up to which a hole in a scanned floor is closed, metres.
const HOLE_RADIUS_M: f32 = 0.15;
/// Margin between a robot and an obstacle in a cell where the robot fits, metres.
const FIT_MARGIN_M: f32 = 0.02;
/// Clearance of a cell where a robot's centre fits, metres.
const FIT_M: f32 = burger::RADIUS_M as f32 + FIT_MARGIN_M;
/// Height above the robot up to which obstacles count, metres.
pub(crate) const HEAD_MARGIN_M: f32 = 0.01;
/// Smallest z of the normal of a triangle of the floor: a slope of 46°, because scans are rough.
const FLOOR_NORMAL_Z_MIN: f32 = 0.7;

/// Floor of a room in cells.
#[derive(Debug)]
pub(crate) struct Ground {
    pub(crate) raster: Raster,
    /// Cells of the floor, and of holes that the floor encloses.
    pub(crate) floor: Vec<bool>,
    /// Distance from each cell's centre to the nearest obstacle that a robot could touch, metres.
    pub(crate) clearance_m: Vec<f32>,
    /// Number, from 1, of the region of free floor that each cell belongs to; 0 elsewhere.
    pub(crate) open: Vec<u32>,
    /// Number of cells in each region of `open`.
    pub(crate) open_sizes: Vec<usize>,
    /// Number, from 1, of the region in which a robot can drive that each cell belongs to; 0 elsewhere.
    regions: Vec<u32>,
    /// Cells of the largest region that a robot can drive in.
    pub(crate) drivable: Vec<bool>,
}

impl Ground {
    /// Finds the floor of a mesh that was checked and whose floor is at z = 0.
    pub(crate) fn new(mesh: &Mesh) -> Self {
        let (min, max) = mesh.bounds();
        let raster = Raster::covering([min.x.into(), min.y.into()], [max.x.into(), max.y.into()], CELL_M);
        let floor = floor_cells(&raster, mesh);
        let mut obstacles = vec![false; raster.len()];
        for triangle in &mesh.triangles {
            let corners = mesh.corners(*triangle);
            let outline = slab(&corners, FLOOR_RELIEF_M, burger::HEIGHT_M as f32 + HEAD_MARGIN_M);
            raster.mark_polygon(&mut obstacles, &outline);
        }
        Self::from_cells(raster, floor, &obstacles)
    }

    /// Finds where robots fit between the cells of obstacles on the cells of the floor.
    pub(crate) fn from_cells(raster: Raster, floor: Vec<bool>, obstacles: &[bool]) -> Self {
        let clearance_m = raster.distances_m(obstacles);
        let free: Vec<bool> =
            floor.iter().zip(obstacles).map(|(floor, obstacle)| *floor && !obstacle).collect();
        let (open, open_sizes) = raster.regions(&free);
        let fits: Vec<bool> = free.iter().zip(&clearance_m).map(|(free, c)| *free && *c >= FIT_M).collect();
        let (regions, sizes) = raster.regions(&fits);
        let largest = largest(&sizes);
        let drivable = regions.iter().map(|region| *region != 0 && *region == largest).collect();
        Self { raster, floor, clearance_m, open, open_sizes, regions, drivable }
    }

    /// Returns the cells of the largest region that a robot can drive in, and of those in which these places lie.
    pub(crate) fn drivable_from(&self, places_m: &[[f64; 2]]) -> Vec<bool> {
        let is_there = |region: u32| region != 0 && places_m.iter().any(|at| self.region_at(*at) == region);
        let (count, mut chosen) = (self.regions.iter().copied().max().unwrap_or(0), Vec::new());
        chosen.extend((0..=count).map(is_there));
        let cells = self.regions.iter().zip(&self.drivable);
        cells.map(|(region, in_largest)| *in_largest || chosen[*region as usize]).collect()
    }

    /// Returns the region in which a robot at a place can drive; 0 if there is none. Beside a wall it is that of a neighbouring cell.
    fn region_at(&self, at: [f64; 2]) -> u32 {
        let Some(cell) = self.raster.index(at) else { return 0 };
        let near = self.raster.neighbours(cell).map(|(near, _)| self.regions[near]);
        core::iter::once(self.regions[cell]).chain(near).find(|region| *region != 0).unwrap_or(0)
    }

    /// Returns the area of a region of `open`, square metres.
    pub(crate) fn open_area_m2(&self, region: u32) -> f64 {
        self.open_sizes[region as usize] as f64 * CELL_M * CELL_M
    }

    /// Returns the number of the largest region of `open`; 0 if there is none.
    pub(crate) fn open_largest(&self) -> u32 {
        largest(&self.open_sizes)
    }
}

/// Returns the number of the region with most cells; 0 if there is none.
fn largest(sizes: &[usize]) -> u32 {
    let regions = sizes.iter().enumerate().skip(1);
    regions
        .max_by_key(|(label, size)| (**size, core::cmp::Reverse(*label)))
        .map_or(0, |(label, _)| label as u32)
}

/// Finds the cells of the floor: those with triangles near z = 0.
///
/// Small holes are closed. Larger holes are filled if the floor encloses them, because a scanner cannot see
/// the floor below a table.
fn floor_cells(raster: &Raster, mesh: &Mesh) -> Vec<bool> {
    let mut scanned = vec![false; raster.len()];
    for triangle in &mesh.triangles {
        let corners = mesh.corners(*triangle);
        let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
        if normal.z.abs() > FLOOR_NORMAL_Z_MIN * normal.length() {
            let flat = slab(&corners, -2.0 * FLOOR_RELIEF_M, 2.0 * FLOOR_RELIEF_M);
            raster.mark_polygon(&mut scanned, &flat);
        }
    }
    // Morphological closing: grow the floor, then shrink it by as much.
    let grown: Vec<bool> = raster.distances_m(&scanned).iter().map(|d| *d <= HOLE_RADIUS_M).collect();
    let rest: Vec<bool> = grown.iter().map(|g| !g).collect();
    let closed: Vec<bool> = raster.distances_m(&rest).iter().map(|d| *d > HOLE_RADIUS_M).collect();
    let floor: Vec<bool> = closed.iter().zip(&scanned).map(|(closed, scanned)| *closed || *scanned).collect();
    // A hole is what cannot be reached from the rim without crossing the floor.
    let mut outside = vec![0; raster.len()];
    let on_rim = |cell: &usize| {
        let (column, row) = (cell % raster.width, cell / raster.width);
        column == 0 || row == 0 || column + 1 == raster.width || row + 1 == raster.height
    };
    let rim = (0..raster.len()).filter(on_rim).filter(|cell| !floor[*cell]);
    raster.flood(&mut outside, 1, rim, |cell| !floor[cell]);
    outside.iter().map(|label| *label == 0).collect()
}

/// Returns the part of a triangle between two heights, seen from above: a convex polygon, perhaps empty
/// (Sutherland and Hodgman 1974).
pub(crate) fn slab(corners: &[Vec3; 3], low_m: f32, high_m: f32) -> Vec<[f64; 2]> {
    let above = clip(corners, |v| v.z - low_m);
    let within = clip(&above, |v| high_m - v.z);
    within.iter().map(|v| [v.x.into(), v.y.into()]).collect()
}

/// Keeps the part of a polygon where `inside` is not negative.
pub(crate) fn clip(polygon: &[Vec3], inside: impl Fn(Vec3) -> f32) -> Vec<Vec3> {
    let mut kept = Vec::with_capacity(polygon.len() + 1);
    for (a, b) in polygon.iter().zip(polygon.iter().cycle().skip(1)) {
        let (da, db) = (inside(*a), inside(*b));
        if da >= 0.0 {
            kept.push(*a);
        }
        if (da >= 0.0) != (db >= 0.0) {
            kept.push(*a + (*b - *a) * (da / (da - db)));
        }
    }
    kept
}
