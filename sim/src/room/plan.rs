//! Floor plans of rooms, and start poses of robots.

use super::ground::{Ground, clip};
use super::mesh::Mesh;
use super::raster::Raster;
use super::{Room, StartError};
use crate::body::upright_pose;
use crate::burger;
use core::f64::consts::TAU;
use glam::Vec3;
use msg::grid::{CELLS_MAX, LOG_ODDS_MAX, UNKNOWN};
use msg::{Grid, GridHeader, Pose2, ROBOTS_MAX};
use parry3d::query::{Ray, RayCast, intersection_test};

/// Smallest length of a plan's cells, metres.
const RESOLUTION_MIN_M: f64 = 0.01;
/// Largest length of a plan's cells, metres.
const RESOLUTION_MAX_M: f64 = 1.0;
/// Length of a plan's cells if the requested one is not a number, metres.
const RESOLUTION_DEFAULT_M: f64 = 0.05;
/// Smallest area of a free floor that is a room and not the inside of a cupboard, square metres.
pub(super) const ROOM_MIN_M2: f64 = 3.0;
/// Distances from obstacles at which robots may start, metres. The largest that the room allows is used.
const START_CLEARANCES_M: [f32; 3] = [0.4, 0.25, 0.15];
/// Smallest distance between two starting robots, metres, so that they can turn and pass.
const START_DISTANCE_MIN_M: f64 = 0.5;
/// Range within which the free view decides a robot's first heading, metres: that of the LDS-01.
const VIEW_M: f32 = 3.5;
/// Largest number of viewpoints from which a plan is computed. More take longer and show little more.
const VIEWPOINTS_MAX: usize = 1000;
/// Smallest distance between two viewpoints in cells of the ground: 0.2 m.
const VIEWPOINT_STRIDE: usize = 4;
/// Number of rays from each viewpoint: one per degree.
const PLAN_RAYS: usize = 360;
/// Range of the rays from a viewpoint, metres: the longest LiDAR preset and some more.
const PLAN_RANGE_M: f32 = 12.0;
/// Points per cell that mark a ray: at least one in each cell that it crosses along its longer side.
const RAY_POINTS_PER_CELL: f64 = 1.5;
/// Number of headings that are compared for a start pose: one per 5°.
const VIEW_RAYS: usize = 72;
/// Number of those headings that a forward LiDAR of 90° covers.
const VIEW_WIDTH: usize = VIEW_RAYS / 4;

impl Room {
    /// Computes the map that a perfect LiDAR would make on the largest floor, in frame `world`: see [`Self::floor_plan_from`].
    pub fn floor_plan(&self, resolution_m: f64) -> Grid {
        self.floor_plan_from(resolution_m, &[])
    }

    /// Computes the map that perfect LiDARs would make on the largest floor and on those where robots start (frame `world`, metres),
    /// in frame `world`.
    ///
    /// Cells with a visible surface at the LiDAR's height are occupied. Floor that rays cross from drivable
    /// places is free. All other cells are unknown. `resolution_m` is clamped to 0.01 to 1 m, and made
    /// coarser until the plan has at most [`CELLS_MAX`] cells.
    pub fn floor_plan_from(&self, resolution_m: f64, starts_m: &[[f64; 2]]) -> Grid {
        let raster = self.plan_raster(resolution_m);
        let mut walls = vec![false; raster.len()];
        for (from, to) in self.lidar_slice() {
            raster.mark_segment(&mut walls, from, to);
        }
        // Cells next to a seen one lie between two rays and count as seen. Walls have no gaps over edges, so
        // cells behind them do not.
        let seen = self.seen_floor(&raster, &self.ground.drivable_from(starts_m));
        let is_seen = |cell: usize| seen[cell] && !walls[cell];
        let has_seen_neighbour =
            |cell: usize| raster.neighbours(cell).any(|(near, over_edge)| over_edge && is_seen(near));
        let is_free = |cell: usize| !walls[cell] && (is_seen(cell) || has_seen_neighbour(cell));
        let mut cells = vec![UNKNOWN; raster.len()];
        for cell in (0..raster.len()).filter(|cell| is_free(*cell)) {
            cells[cell] = -LOG_ODDS_MAX;
            for (near, _) in raster.neighbours(cell).filter(|(near, _)| walls[*near]) {
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

    /// Finds the cells of the floor that the LiDAR's rays cross from many of the drivable places.
    fn seen_floor(&self, raster: &Raster, drivable: &[bool]) -> Vec<bool> {
        let ground = &self.ground;
        let places = drivable.iter().filter(|drivable| **drivable).count();
        // Viewpoints lie on every `stride`-th row and column.
        let mut stride = VIEWPOINT_STRIDE;
        while places / (stride * stride) > VIEWPOINTS_MAX {
            stride += 1;
        }
        let on_lattice = |cell: &usize| {
            let (column, row) = (cell % ground.raster.width, cell / ground.raster.width);
            column % stride == 0 && row % stride == 0
        };
        let directions: [_; PLAN_RAYS] = core::array::from_fn(|ray| {
            let (sin, cos) = (TAU * ray as f64 / PLAN_RAYS as f64).sin_cos();
            [cos, sin]
        });
        let mut crossed = vec![false; raster.len()];
        for place in (0..ground.raster.len()).filter(|cell| drivable[*cell]).filter(on_lattice) {
            let from = ground.raster.centre_m(place);
            for [cos, sin] in directions {
                // The ray ends before the wall, which may lie on the edge of the next cell.
                let range_m =
                    f64::from(self.view_m(from, [cos, sin], PLAN_RANGE_M)) - raster.resolution_m / 2.0;
                let to = [from[0] + range_m * cos, from[1] + range_m * sin];
                raster.mark_points(&mut crossed, from, to, RAY_POINTS_PER_CELL);
            }
        }
        let is_floor =
            |cell: usize| ground.raster.index(raster.centre_m(cell)).is_some_and(|i| ground.floor[i]);
        crossed.into_iter().enumerate().map(|(cell, crossed)| crossed && is_floor(cell)).collect()
    }

    /// Returns the LiDAR's range from a point in a unit direction, at most `max_m`, metres.
    pub(crate) fn view_m(&self, [x, y]: [f64; 2], [cos, sin]: [f64; 2], max_m: f32) -> f32 {
        let origin = Vec3::new(x as f32, y as f32, burger::SCAN_HEIGHT_M as f32);
        let ray = Ray::new(origin, Vec3::new(cos as f32, sin as f32, 0.0));
        self.mesh().cast_local_ray(&ray, max_m, false).unwrap_or(max_m)
    }

    fn plan_raster(&self, resolution_m: f64) -> Raster {
        let requested_m = if resolution_m.is_nan() { RESOLUTION_DEFAULT_M } else { resolution_m };
        let mut resolution_m = requested_m.clamp(RESOLUTION_MIN_M, RESOLUTION_MAX_M);
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

    /// Iterates over the segments in which the LiDAR's plane cuts the room, in `world`, metres.
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

    /// Chooses start poses for a fleet, always the same ones.
    ///
    /// The poses lie on the largest floor that a robot can drive on, apart from furniture and from each
    /// other. Each heading has the largest free view.
    ///
    /// # Errors
    /// The room has no space for `count` robots.
    pub fn starts(&self, count: usize) -> Result<Vec<Pose2>, StartError> {
        if count > ROBOTS_MAX {
            return Err(StartError::Full { count, found: ROBOTS_MAX });
        }
        let mut found = Vec::new();
        for clearance_m in START_CLEARANCES_M {
            found = self.spread(count, clearance_m);
            if found.len() == count {
                let starts: Vec<_> = found.into_iter().map(|point| self.look_around(point)).collect();
                // Nobody asked for these places: that one is enclosed says that the room has no better one.
                let are_usable = starts.iter().all(|start| self.check_start(*start).is_ok());
                return if are_usable { Ok(starts) } else { Err(StartError::NoSpace) };
            }
        }
        Err(StartError::Full { count, found: found.len() })
    }

    /// Chooses up to `count` points: first the one with the largest clearance, then always the one farthest
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

    /// Returns the pose at a point with the heading whose 90° have the largest free view.
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

    /// Checks that a robot can stand at a pose.
    pub(crate) fn check_start(&self, start: Pose2) -> Result<(), StartError> {
        let Pose2 { x_m, y_m, .. } = start;
        if !start.is_finite() {
            return Err(StartError::NotFinite);
        }
        let ground = &self.ground;
        let cell = ground.raster.index([x_m, y_m]).filter(|cell| ground.floor[*cell]);
        let Some(cell) = cell else { return Err(StartError::OffFloor { x_m, y_m }) };
        let here =
            intersection_test(&upright_pose(start), &*burger::hull(), &Default::default(), self.mesh());
        if here.map_or(true, |hit| hit.intersecting) {
            return Err(StartError::InObstacle { x_m, y_m });
        }
        // An obstacle next to the robot may mark the robot's own cell, so its neighbours are tested too.
        let near = ground.raster.neighbours(cell).map(|(near, _)| near);
        let region = core::iter::once(cell).chain(near).map(|c| ground.open[c]).find(|region| *region != 0);
        let region = region.unwrap_or(0);
        let area_m2 = if region == 0 { 0.0 } else { ground.open_area_m2(region) };
        if region == 0 || (region != ground.open_largest() && area_m2 < ROOM_MIN_M2) {
            return Err(StartError::Enclosed { x_m, y_m, area_m2 });
        }
        Ok(())
    }
}

/// Returns what stands on the floor: the parts of the triangles above `relief_m` metres, as [`Ground`] takes them for obstacles. Triangles
/// without area are left out.
pub(crate) fn obstacles_of(mesh: &Mesh, relief_m: f32) -> Mesh {
    let mut standing = Mesh { vertices: mesh.vertices.clone(), ..Mesh::default() };
    for triangle in &mesh.triangles {
        let corners = mesh.corners(*triangle);
        let [a, b, c] = corners;
        if (b - a).cross(c - a).length_squared() == 0.0 {
            continue;
        }
        if corners.iter().all(|corner| corner.z > relief_m) {
            standing.triangles.push(*triangle);
            continue;
        }
        let above = clip(&corners, |corner| corner.z - relief_m);
        // A convex polygon of at most four corners, as a fan of triangles.
        let first = standing.vertices.len() as u32;
        for corner in 1..(above.len() as u32).saturating_sub(1) {
            standing.triangles.push([first, first + corner, first + corner + 1]);
        }
        standing.vertices.extend(above);
    }
    standing
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Lanes of 0.6 m connect all parts of the laboratory.
    #[test]
    fn wide_lanes_connect_the_laboratory() {
        let ground = &Room::laboratory().ground;
        let wide: Vec<bool> =
            ground.clearance_m.iter().zip(&ground.floor).map(|(c, floor)| *floor && *c >= 0.3).collect();
        let (regions, _) = ground.raster.regions(&wide);
        let region = |point| regions[ground.raster.index(point).unwrap()];
        let workshop = region([-1.2, -1.7]);
        assert_ne!(workshop, 0);
        for (name, point) in [
            ("north-west", [-2.8, 1.9]),
            ("rack", [-2.9, -1.2]),
            ("door", [-0.4, 2.3]),
            ("doorway", [0.93, -1.15]),
            ("office", [2.2, -0.6]),
            ("meeting corner", [1.2, 1.4]),
        ] {
            assert_eq!(region(point), workshop, "{name}");
        }
    }
}
