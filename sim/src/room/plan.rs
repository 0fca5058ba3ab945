//! What a perfect map of a room would show, and where robots can start.

use super::cells::Raster;
use super::ground::Ground;
use super::mesh::Mesh;
use super::{Room, StartError};
use crate::body::upright;
use crate::burger;
use core::f64::consts::TAU;
use glam::Vec3;
use msg::grid::{CELLS_MAX, LOG_ODDS_MAX, UNKNOWN};
use msg::{Grid, GridHeader, Pose2, ROBOTS_MAX};
use parry3d::query::{Ray, RayCast, intersection_test};

/// Finer plans are not drawn, metres.
const RESOLUTION_MIN_M: f64 = 0.01;
/// Coarser plans are not drawn, metres.
const RESOLUTION_MAX_M: f64 = 1.0;
/// Open floor of this size is a room of its own, not the inside of a cupboard, square metres.
const ROOM_MIN_M2: f64 = 3.0;
/// How far from obstacles robots start: as far as the room allows, metres.
const START_CLEARANCES_M: [f32; 3] = [0.4, 0.25, 0.15];
/// How far from each other robots start at least, metres: they can turn and pass.
const START_DISTANCE_MIN_M: f64 = 0.5;
/// A robot starts in the direction in which it sees most, within this range, metres.
const VIEW_M: f32 = 3.5;
/// A plan is drawn from rays of so many places at most, at best every so many cells of the ground (0.2 m).
const VIEWPOINTS_MAX: usize = 1000;
const VIEWPOINT_STRIDE: usize = 4;
/// Rays from each of them, and their range, metres.
const PLAN_RAYS: usize = 360;
const PLAN_RANGE_M: f32 = 12.0;
/// Directions tried, and how many of them a forward LiDAR of 90° sees.
const VIEW_RAYS: usize = 72;
const VIEW_WIDTH: usize = VIEW_RAYS / 4;

impl Room {
    /// The truth as the LiDAR's plane sees it, frame `world`: cells with a visible surface at the
    /// LiDAR's height are occupied, floor that its rays cross from where robots drive is free, the rest
    /// is unknown. `resolution_m` is kept within 0.01 to 1 m and coarse enough for [`CELLS_MAX`].
    pub fn floor_plan(&self, resolution_m: f64) -> Grid {
        let raster = self.plan_raster(resolution_m);
        let mut walls = vec![false; raster.len()];
        for (from, to) in self.lidar_slice() {
            raster.draw_segment(&mut walls, from, to);
        }
        // Cells between two rays count as seen, those behind a wall do not: no wall opens over an edge.
        let seen = self.seen_floor(&raster);
        let is_seen = |cell: usize| seen[cell] && !walls[cell];
        let beside = |cell: usize| raster.around(cell).any(|(near, over_edge)| over_edge && is_seen(near));
        let is_free = |cell: usize| !walls[cell] && (is_seen(cell) || beside(cell));
        let mut cells = vec![UNKNOWN; raster.len()];
        for cell in (0..raster.len()).filter(|cell| is_free(*cell)) {
            cells[cell] = -LOG_ODDS_MAX;
            for (near, _) in raster.around(cell).filter(|(near, _)| walls[*near]) {
                cells[near] = LOG_ODDS_MAX;
            }
        }
        let header = GridHeader {
            origin: Pose2::new(raster.origin_m[0], raster.origin_m[1], 0.0),
            resolution_m: raster.resolution_m,
            width: raster.width as u32,
            height: raster.height as u32,
            ..GridHeader::default()
        };
        Grid { header, cells }
    }

    /// Cells of floor that a ray of the LiDAR crosses, from one of many places where robots drive.
    fn seen_floor(&self, raster: &Raster) -> Vec<bool> {
        let ground = &self.ground;
        let places = ground.drivable.iter().filter(|drivable| **drivable).count();
        // Every so many rows and columns.
        let mut stride = VIEWPOINT_STRIDE;
        while places / (stride * stride) > VIEWPOINTS_MAX {
            stride += 1;
        }
        let on_lattice = |cell: &usize| {
            let (column, row) = (cell % ground.raster.width, cell / ground.raster.width);
            column % stride == 0 && row % stride == 0
        };
        let mut crossed = vec![false; raster.len()];
        for place in (0..ground.raster.len()).filter(|cell| ground.drivable[*cell]).filter(on_lattice) {
            let from = ground.raster.centre_m(place);
            for ray in 0..PLAN_RAYS {
                let (sin, cos) = (TAU * ray as f64 / PLAN_RAYS as f64).sin_cos();
                // Short of the wall, which may lie on the edge of the next cell.
                let range_m =
                    f64::from(self.view_m(from, [cos, sin], PLAN_RANGE_M)) - raster.resolution_m / 2.0;
                let to = [from[0] + range_m * cos, from[1] + range_m * sin];
                raster.draw_points(&mut crossed, from, to, 1.5);
            }
        }
        let is_floor =
            |cell: usize| ground.raster.index(raster.centre_m(cell)).is_some_and(|i| ground.floor[i]);
        crossed.into_iter().enumerate().map(|(cell, crossed)| crossed && is_floor(cell)).collect()
    }

    /// How far the LiDAR sees from a point in a unit direction, metres.
    fn view_m(&self, [x, y]: [f64; 2], [cos, sin]: [f64; 2], max_m: f32) -> f32 {
        let origin = Vec3::new(x as f32, y as f32, burger::SCAN_HEIGHT_M as f32);
        let ray = Ray::new(origin, Vec3::new(cos as f32, sin as f32, 0.0));
        self.mesh().cast_local_ray(&ray, max_m, false).unwrap_or(max_m)
    }

    fn plan_raster(&self, resolution_m: f64) -> Raster {
        let wished_m = if resolution_m.is_nan() { 0.05 } else { resolution_m };
        let mut resolution_m = wished_m.clamp(RESOLUTION_MIN_M, RESOLUTION_MAX_M);
        let ground = &self.ground.raster;
        let size_m = [ground.width, ground.height].map(|cells| cells as f64 * ground.resolution_m);
        let corner_m = [ground.origin_m[0] + size_m[0], ground.origin_m[1] + size_m[1]];
        loop {
            let raster = Raster::covering(ground.origin_m, corner_m, resolution_m);
            if raster.len() <= CELLS_MAX {
                return raster;
            }
            resolution_m *= 2.0;
        }
    }

    /// Where the LiDAR's plane cuts the room: segments in `world`, metres.
    fn lidar_slice(&self) -> impl Iterator<Item = ([f64; 2], [f64; 2])> + '_ {
        let height_m = burger::SCAN_HEIGHT_M as f32;
        self.mesh().triangles().filter_map(move |triangle| {
            let corners = [triangle.a, triangle.b, triangle.c];
            let edges = [(0, 1), (1, 2), (2, 0)].map(|(i, j)| (corners[i], corners[j]));
            let mut cuts = edges.into_iter().filter_map(|(a, b)| {
                let crosses = (a.z > height_m) != (b.z > height_m);
                let point = a + (b - a) * ((height_m - a.z) / (b.z - a.z));
                crosses.then_some([f64::from(point.x), f64::from(point.y)])
            });
            cuts.next().zip(cuts.next())
        })
    }

    /// Start poses for a fleet, deterministic: on the largest floor that a robot can drive over, apart
    /// from furniture and from each other, each looking to where it sees most.
    ///
    /// # Errors
    /// The room cannot hold so many.
    pub fn starts(&self, count: usize) -> Result<Vec<Pose2>, StartError> {
        if count > ROBOTS_MAX {
            return Err(StartError::Full { count, found: ROBOTS_MAX });
        }
        let mut found = Vec::new();
        for clearance_m in START_CLEARANCES_M {
            found = self.spread(count, clearance_m);
            if found.len() == count {
                return Ok(found.into_iter().map(|point| self.look_around(point)).collect());
            }
        }
        Err(StartError::Full { count, found: found.len() })
    }

    /// Up to `count` points: first the one with most space around it, then always the one farthest
    /// from those chosen (Gonzalez 1985).
    fn spread(&self, count: usize, clearance_m: f32) -> Vec<[f64; 2]> {
        let Ground { raster, drivable, clearance_m: clearances, .. } = &*self.ground;
        let candidates: Vec<usize> =
            (0..raster.len()).filter(|cell| drivable[*cell] && clearances[*cell] >= clearance_m).collect();
        let widest =
            candidates.iter().max_by(|a, b| clearances[**a].total_cmp(&clearances[**b]).then(b.cmp(a)));
        let mut chosen: Vec<[f64; 2]> = widest.map(|cell| raster.centre_m(*cell)).into_iter().collect();
        let mut apart_m = vec![f64::INFINITY; candidates.len()];
        while chosen.len() < count {
            let Some([x, y]) = chosen.last().copied() else { break };
            for (apart, cell) in apart_m.iter_mut().zip(&candidates) {
                let [u, v] = raster.centre_m(*cell);
                *apart = apart.min((x - u).hypot(y - v));
            }
            let farthest =
                (0..candidates.len()).max_by(|a, b| apart_m[*a].total_cmp(&apart_m[*b]).then(b.cmp(a)));
            match farthest.filter(|i| apart_m[*i] >= START_DISTANCE_MIN_M) {
                Some(i) => chosen.push(raster.centre_m(candidates[i])),
                None => break,
            }
        }
        chosen.truncate(count);
        chosen
    }

    /// A pose at a point, turned to where 90° hold most free view.
    fn look_around(&self, [x, y]: [f64; 2]) -> Pose2 {
        let angle = |ray: usize| TAU * ray as f64 / VIEW_RAYS as f64;
        let view = |ray: usize| {
            let (sin, cos) = angle(ray).sin_cos();
            self.view_m([x, y], [cos, sin], VIEW_M)
        };
        let views: Vec<f32> = (0..VIEW_RAYS).map(view).collect();
        let within = |middle: usize| -> f32 {
            let first = middle + VIEW_RAYS - VIEW_WIDTH / 2;
            (first..=first + VIEW_WIDTH).map(|ray| views[ray % VIEW_RAYS]).sum()
        };
        let best = (0..VIEW_RAYS).max_by(|a, b| within(*a).total_cmp(&within(*b)).then(b.cmp(a)));
        Pose2::new(x, y, msg::pose::wrap_angle(angle(best.unwrap_or(0))))
    }

    /// Can a robot stand here?
    pub(crate) fn check_start(&self, start: Pose2) -> Result<(), StartError> {
        let Pose2 { x_m, y_m, .. } = start;
        if !start.is_finite() {
            return Err(StartError::NotFinite);
        }
        let ground = &self.ground;
        let cell = ground.raster.index([x_m, y_m]).filter(|cell| ground.floor[*cell]);
        let Some(cell) = cell else { return Err(StartError::OffFloor { x_m, y_m }) };
        let here = intersection_test(&upright(start), &*burger::hull(), &Default::default(), self.mesh());
        if here.map_or(true, |hit| hit.intersecting) {
            return Err(StartError::InObstacle { x_m, y_m });
        }
        // The cell itself may be marked by something beside the robot; its neighbours tell.
        let near = ground.raster.around(cell).map(|(near, _)| near);
        let region = core::iter::once(cell).chain(near).map(|c| ground.open[c]).find(|region| *region != 0);
        let region = region.unwrap_or(0);
        let area_m2 = if region == 0 { 0.0 } else { ground.open_area_m2(region) };
        if region == 0 || (region != ground.open_largest() && area_m2 < ROOM_MIN_M2) {
            return Err(StartError::Enclosed { x_m, y_m, area_m2 });
        }
        Ok(())
    }
}

/// Removes what belongs to the floor and what has no area.
pub(crate) fn obstacles_of(mesh: &Mesh, relief_m: f32) -> Mesh {
    let stands_up = |triangle: &&[u32; 3]| {
        let [a, b, c] = mesh.corners(**triangle);
        let has_area = (b - a).cross(c - a).length_squared() > 0.0;
        has_area && a.z.max(b.z).max(c.z) > relief_m
    };
    let triangles = mesh.triangles.iter().filter(stands_up).copied().collect();
    Mesh { vertices: mesh.vertices.clone(), triangles }
}
