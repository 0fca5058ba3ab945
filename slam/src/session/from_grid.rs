//! A session from a map that is only a grid (PGM and YAML): scans are taken in it, all around, from
//! places a metre apart. Good for localization; there is no graph, so that mapping cannot be continued.

use super::log::LogPosition;
use super::{Session, SessionIdentity};
use crate::back_end::BackEndState;
use crate::beam_poses::BeamPoses;
use crate::cloud::{Cloud, CloudScratch};
use crate::config::{LidarConfig, SlamConfig};
use crate::node::{Node, Rays, SweptPath};
use bytemuck::Zeroable;
use msg::grid::{Occupancy, occupancy};
use msg::{GridView, Header, Pose2, Scan, SlamMode};
use std::sync::Arc;

/// Between places where scans are taken, metres.
const SPACING_M: f64 = 1.0;
/// Beams of a scan.
const BEAMS: usize = 720;
/// The longest beam, metres.
const REACH_M: f64 = 25.0;
/// A place must be this far from walls, metres.
const CLEAR_M: f64 = 0.2;
/// Places at most: the spacing grows until they fit.
const PLACES_MAX: usize = 4000;
/// Factor by which the spacing grows.
const SPACING_GROWTH: f64 = 1.5;

impl Session {
    /// See the module. The grid's frame becomes the robot's map frame.
    pub fn from_grid(identity: SessionIdentity, grid: GridView<'_>, config: &SlamConfig) -> Self {
        let mut spacing_m = SPACING_M;
        let mut places = free_places(grid, spacing_m);
        while places.len() > PLACES_MAX {
            spacing_m *= SPACING_GROWTH;
            places = free_places(grid, spacing_m);
        }
        let lidar = LidarConfig { base_from_scan: [0.0; 3], ..config.lidar.clone() };
        let config = SlamConfig { lidar, ..config.clone() };
        let mut scan = Box::new(Scan::zeroed());
        let sweep = BeamPoses::still(Pose2::IDENTITY);
        let mut scratch = CloudScratch::with_capacity(config.lidar.points_max);
        let mut back = BackEndState::default();
        for (id, at) in places.into_iter().enumerate() {
            take_scan(grid, at, &mut scan);
            let mut cloud = Cloud::with_capacity(config.lidar.points_max);
            cloud.fill(&scan, &sweep, &config.lidar, &mut scratch);
            let map_from_base = Pose2::new(at[0], at[1], 0.0);
            back.nodes.push(Node {
                odometry_break: false,
                disconnected_component: None,
                uncertain_component: None,
                id: id as u32,
                header: Header::default(),
                local_from_base: map_from_base,
                previous_from_this: None,
                is_tracked: true,
                unmeasured_s: 0.0,
                slip: [0.0; 3],
                possibly_kidnapped: false,
                cloud: Arc::new(cloud),
                rays: Arc::new(Rays::new(&scan, &sweep, &config)),
                // No robot was there.
                swept_path: SweptPath::default(),
            });
            back.front_ids.push(id as u32);
            back.poses.push(map_from_base);
        }
        Self {
            identity,
            mode: SlamMode::Localization,
            back,
            front: None,
            samples: Vec::new(),
            log: LogPosition::default(),
        }
    }
}

/// Free points of a lattice, in the grid's frame.
fn free_places(grid: GridView<'_>, spacing_m: f64) -> Vec<[f64; 2]> {
    let step = (spacing_m / grid.header.resolution_m).ceil().max(1.0) as usize;
    let clear = (CLEAR_M / grid.header.resolution_m).ceil() as i64;
    let free = |x: i64, y: i64| occupancy(grid.cell(x, y)) == Occupancy::Free;
    let mut places = Vec::new();
    for y in (step as i64 / 2..i64::from(grid.header.height)).step_by(step) {
        for x in (step as i64 / 2..i64::from(grid.header.width)).step_by(step) {
            let around = [(0, 0), (clear, 0), (-clear, 0), (0, clear), (0, -clear)];
            if around.iter().all(|(dx, dy)| free(x + dx, y + dy)) {
                places.push(grid.centre_m(x, y));
            }
        }
    }
    places
}

/// What a LiDAR would see there, looking along the map's x axis.
fn take_scan(grid: GridView<'_>, at: [f64; 2], scan: &mut Scan) {
    let increment = core::f64::consts::TAU / BEAMS as f64;
    scan.angle_min_rad = -core::f32::consts::PI;
    scan.angle_increment_rad = increment as f32;
    (scan.range_min_m, scan.range_max_m) = (0.0, REACH_M as f32);
    scan.len = BEAMS as u32;
    for beam in 0..BEAMS {
        let (sin, cos) = f64::from(scan.angle_rad(beam)).sin_cos();
        scan.ranges_m[beam] = cast(grid, at, [cos, sin]).map_or(f32::NAN, |range| range as f32);
    }
}

/// Metres to the first occupied cell; `None` if the beam leaves what is known first.
fn cast(grid: GridView<'_>, from: [f64; 2], along: [f64; 2]) -> Option<f64> {
    let step_m = grid.header.resolution_m / 2.0;
    for step in 1..(REACH_M / step_m) as usize {
        let range = step as f64 * step_m;
        let (x, y) = grid.cell_of([from[0] + range * along[0], from[1] + range * along[1]]);
        match grid.cell(x, y) {
            msg::grid::UNKNOWN => return None,
            cell if occupancy(cell) == Occupancy::Occupied => {
                // Where the beam is nearest to the cell's middle: where the scans that made it ended.
                let [cx, cy] = grid.centre_m(x, y);
                return Some((cx - from[0]) * along[0] + (cy - from[1]) * along[1]);
            }
            _ => {}
        }
    }
    None
}
