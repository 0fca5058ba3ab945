//! The floor from above: where it is, what stands on it, where a robot fits.

use super::cells::Raster;
use super::mesh::Mesh;
use crate::burger;
use glam::Vec3;

/// Lower than this belongs to the floor: carpets' edges, thresholds, the noise of a scan. Metres.
pub(crate) const FLOOR_RELIEF_M: f32 = 0.03;
/// Side of a cell of the ground, metres.
const CELL_M: f64 = 0.05;
/// A hole of a scanned floor up to twice this is floor nevertheless, metres.
const HOLE_RADIUS_M: f32 = 0.15;
/// A cell counts as room for a robot's middle if obstacles are so far from it, metres.
const FIT_M: f32 = burger::RADIUS_M as f32 + 0.02;

/// A room's floor in cells.
#[derive(Debug)]
pub(crate) struct Ground {
    pub(crate) raster: Raster,
    /// There is floor, or a hole that floor encloses.
    pub(crate) floor: Vec<bool>,
    /// From a cell's middle to the nearest obstacle that a robot could touch, metres.
    pub(crate) clearance_m: Vec<f32>,
    /// Region of floor without obstacles, from 1; 0 elsewhere.
    pub(crate) open: Vec<u32>,
    /// Cells in each region of `open`.
    pub(crate) open_sizes: Vec<usize>,
    /// The largest region over which a robot can drive.
    pub(crate) drivable: Vec<bool>,
}

impl Ground {
    /// `mesh` is checked, its floor at z = 0.
    pub(crate) fn of(mesh: &Mesh) -> Self {
        let (min, max) = mesh.bounds();
        let raster = Raster::covering([min.x.into(), min.y.into()], [max.x.into(), max.y.into()], CELL_M);
        let floor = floor_cells(&raster, mesh);
        let mut obstacles = vec![false; raster.len()];
        for triangle in &mesh.triangles {
            let corners = mesh.corners(*triangle);
            let seen_from_above = slab(&corners, FLOOR_RELIEF_M, burger::HEIGHT_M as f32 + 0.01);
            raster.draw_convex(&mut obstacles, &seen_from_above);
        }
        let clearance_m = raster.distances_m(&obstacles);
        let free: Vec<bool> =
            floor.iter().zip(&obstacles).map(|(floor, obstacle)| *floor && !obstacle).collect();
        let (open, open_sizes) = raster.regions(&free);
        let fits: Vec<bool> = free.iter().zip(&clearance_m).map(|(free, c)| *free && *c >= FIT_M).collect();
        let (labels, sizes) = raster.regions(&fits);
        let largest = largest(&sizes);
        let drivable = labels.iter().map(|label| *label != 0 && *label == largest).collect();
        Self { raster, floor, clearance_m, open, open_sizes, drivable }
    }

    /// Square metres of a region of `open`.
    pub(crate) fn open_area_m2(&self, region: u32) -> f64 {
        self.open_sizes[region as usize] as f64 * CELL_M * CELL_M
    }

    /// The largest region of `open`, 0 if there is none.
    pub(crate) fn open_largest(&self) -> u32 {
        largest(&self.open_sizes)
    }
}

/// Which region has most cells; 0 if there is none.
fn largest(sizes: &[usize]) -> u32 {
    let regions = sizes.iter().enumerate().skip(1);
    regions
        .max_by_key(|(label, size)| (**size, core::cmp::Reverse(*label)))
        .map_or(0, |(label, _)| label as u32)
}

/// Cells with triangles near z = 0, small holes closed, large holes filled if floor is all around:
/// what a scanner could not see below a table.
fn floor_cells(raster: &Raster, mesh: &Mesh) -> Vec<bool> {
    let mut scanned = vec![false; raster.len()];
    for triangle in &mesh.triangles {
        let corners = mesh.corners(*triangle);
        let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
        if normal.z.abs() > 0.7 * normal.length() {
            let flat = slab(&corners, -2.0 * FLOOR_RELIEF_M, 2.0 * FLOOR_RELIEF_M);
            raster.draw_convex(&mut scanned, &flat);
        }
    }
    // Closing: grow, then shrink by as much.
    let grown: Vec<bool> = raster.distances_m(&scanned).iter().map(|d| *d <= HOLE_RADIUS_M).collect();
    let rest: Vec<bool> = grown.iter().map(|g| !g).collect();
    let closed: Vec<bool> = raster.distances_m(&rest).iter().map(|d| *d > HOLE_RADIUS_M).collect();
    let floor: Vec<bool> = closed.iter().zip(&scanned).map(|(closed, scanned)| *closed || *scanned).collect();
    // What cannot be reached from the rim without crossing floor is a hole.
    let mut outside = vec![0; raster.len()];
    let on_rim = |cell: &usize| {
        let (column, row) = (cell % raster.width, cell / raster.width);
        column == 0 || row == 0 || column + 1 == raster.width || row + 1 == raster.height
    };
    let rim = (0..raster.len()).filter(on_rim).filter(|cell| !floor[*cell]);
    raster.flood(&mut outside, 1, rim, |cell| !floor[cell]);
    outside.iter().map(|label| *label == 0).collect()
}

/// The part of a triangle between two heights, from above: a convex polygon, empty if there is none
/// (Sutherland and Hodgman 1974).
fn slab(corners: &[Vec3; 3], low_m: f32, high_m: f32) -> Vec<[f64; 2]> {
    let above = clip(corners, |v| v.z - low_m);
    let within = clip(&above, |v| high_m - v.z);
    within.iter().map(|v| [v.x.into(), v.y.into()]).collect()
}

/// Keeps the side where `inside` is not negative.
fn clip(polygon: &[Vec3], inside: impl Fn(Vec3) -> f32) -> Vec<Vec3> {
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
