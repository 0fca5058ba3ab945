//! The map that a robot draws of a building: rays from the places of its path, summed in a grid.

use super::building::{Building, Point, Wall, distance};
use crate::noise::Noise;
use msg::grid::UNKNOWN;
use msg::{Grid, GridHeader, Pose2};

/// Side of a map's cell, metres.
const RESOLUTION_M: f64 = 0.05;
/// Distance between two scans, metres.
const SCAN_STEP_M: f64 = 0.25;
/// Angle between two beams, degrees.
const BEAM_STEP_DEG: f64 = 0.5;
/// Evidence of a beam that ends in a cell, of one that passes it, and of both at most, steps of log-odds.
const HIT: i16 = 18;
const PASS: i16 = -8;
const EVIDENCE_MAX: i16 = 70;
/// A beam passes no cell nearer to its end than this, metres: walls stand between cells.
const END_M: f64 = 0.075;
/// Error of a pose in its own map, standard deviation, metres and radians.
const POSE_NOISE: [f64; 2] = [0.008, 0.001];

/// The LiDAR of a robot, and how well its SLAM keeps the map straight.
#[derive(Clone, Copy, Debug)]
pub struct Mapping {
    /// Field of view, degrees.
    pub view_deg: f64,
    /// Largest range, metres.
    pub range_m: f64,
    /// Standard deviation of a range, metres.
    pub noise_m: f64,
    /// Drift of the heading, radians a metre: bends the map.
    pub bend_rad_per_m: f64,
}

/// Returns the map of a robot that drove along a path, in a frame that lies at `world_from_map`.
pub fn draw_map(
    building: &Building,
    path: &[Point],
    mapping: Mapping,
    world_from_map: Pose2,
    noise: &mut Noise,
) -> Grid {
    let map_from_world = world_from_map.inverse();
    let mut grid = EvidenceGrid::around(path.iter().map(|at| map_from_world.apply(*at)), mapping.range_m);
    let poses = scan_poses(path);
    let mut believed = poses.first().copied().unwrap_or(Pose2::IDENTITY);
    for (index, truth) in poses.iter().enumerate() {
        if let Some(last) = index.checked_sub(1).map(|last| poses[last]) {
            let moved = last.between(*truth);
            believed =
                believed * moved * Pose2::new(0.0, 0.0, mapping.bend_rad_per_m * moved.x_m.hypot(moved.y_m));
        }
        let [metres, radians] = POSE_NOISE;
        let error = Pose2::new(metres * noise.normal(), metres * noise.normal(), radians * noise.normal());
        let map_from_robot = map_from_world * believed * error;
        let reachable: Vec<&Wall> =
            building.walls.iter().filter(|wall| is_near(wall, *truth, mapping)).collect();
        let beams = (mapping.view_deg / BEAM_STEP_DEG) as i32;
        for beam in 0..beams {
            let angle_rad = (f64::from(beam) * BEAM_STEP_DEG - mapping.view_deg / 2.0).to_radians();
            let range_m = range(&reachable, *truth, angle_rad) + mapping.noise_m * noise.normal();
            if range_m <= mapping.range_m && range_m > 0.0 {
                grid.add_beam(map_from_robot, angle_rad, range_m);
            }
        }
    }
    grid.into_map()
}

/// Places of scans along a path, each heading along its leg.
fn scan_poses(path: &[Point]) -> Vec<Pose2> {
    let mut poses = Vec::new();
    for leg in path.windows(2) {
        let ([x, y], length_m) = (leg[0], distance(leg[0], leg[1]));
        let yaw_rad = (leg[1][1] - y).atan2(leg[1][0] - x);
        let count = (length_m / SCAN_STEP_M).ceil() as usize;
        let (sin, cos) = yaw_rad.sin_cos();
        poses.extend((0..count).map(|step| {
            let along_m = length_m * step as f64 / count as f64;
            Pose2::new(x + along_m * cos, y + along_m * sin, yaw_rad)
        }));
    }
    poses
}

fn is_near(wall: &Wall, pose: Pose2, mapping: Mapping) -> bool {
    let at = [pose.x_m, pose.y_m];
    let outside = |k: usize| {
        wall.from[k].min(wall.to[k]) - at[k] > mapping.range_m
            || at[k] - wall.from[k].max(wall.to[k]) > mapping.range_m
    };
    !outside(0) && !outside(1)
}

/// Distance to the first wall, metres; infinite if there is none.
fn range(walls: &[&Wall], pose: Pose2, angle_rad: f64) -> f64 {
    let (sin, cos) = (pose.yaw_rad + angle_rad).sin_cos();
    walls.iter().fold(f64::INFINITY, |nearest, wall| {
        let [dx, dy] = [wall.to[0] - wall.from[0], wall.to[1] - wall.from[1]];
        let [x, y] = [wall.from[0] - pose.x_m, wall.from[1] - pose.y_m];
        let cross = cos * dy - sin * dx;
        if cross.abs() < 1e-9 {
            return nearest;
        }
        let (along_m, share) = ((x * dy - y * dx) / cross, (x * sin - y * cos) / cross);
        if along_m > 0.0 && (0.0..=1.0).contains(&share) { nearest.min(along_m) } else { nearest }
    })
}

/// Evidence about the cells of a map.
struct EvidenceGrid {
    corner_cell: [i64; 2],
    size: [usize; 2],
    evidence: Vec<i16>,
}

impl EvidenceGrid {
    fn around(points: impl Iterator<Item = Point>, range_m: f64) -> Self {
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for at in points {
            for k in 0..2 {
                (low[k], high[k]) = (low[k].min(at[k]), high[k].max(at[k]));
            }
        }
        let margin_m = range_m + 1.0;
        let corner_cell = low.map(|m| ((m - margin_m) / RESOLUTION_M).floor() as i64);
        let last_cell = high.map(|m| ((m + margin_m) / RESOLUTION_M).ceil() as i64);
        let size = [0, 1].map(|k| (last_cell[k] - corner_cell[k]).max(0) as usize);
        Self { corner_cell, size, evidence: vec![0; size[0] * size[1]] }
    }

    fn add(&mut self, at: Point, evidence: i16) {
        let [x, y] = [0, 1].map(|k| (at[k] / RESOLUTION_M).floor() as i64 - self.corner_cell[k]);
        if x >= 0 && y >= 0 && (x as usize) < self.size[0] && (y as usize) < self.size[1] {
            let cell = &mut self.evidence[y as usize * self.size[0] + x as usize];
            *cell = (*cell + evidence).clamp(-EVIDENCE_MAX, EVIDENCE_MAX);
        }
    }

    fn add_beam(&mut self, map_from_robot: Pose2, angle_rad: f64, range_m: f64) {
        let (sin, cos) = angle_rad.sin_cos();
        let steps = ((range_m - END_M) / RESOLUTION_M).max(0.0) as usize;
        for step in 0..steps {
            let along_m = step as f64 * RESOLUTION_M;
            self.add(map_from_robot.apply([along_m * cos, along_m * sin]), PASS);
        }
        self.add(map_from_robot.apply([range_m * cos, range_m * sin]), HIT);
    }

    /// The known part as a map.
    fn into_map(self) -> Grid {
        let (mut low, mut high) = (self.size, [0; 2]);
        for (index, _) in self.evidence.iter().enumerate().filter(|(_, evidence)| **evidence != 0) {
            let cell = [index % self.size[0], index / self.size[0]];
            for k in 0..2 {
                (low[k], high[k]) = (low[k].min(cell[k]), high[k].max(cell[k] + 1));
            }
        }
        if low[0] >= high[0] {
            (low, high) = ([0; 2], [1; 2]);
        }
        let corner = [0, 1].map(|k| (self.corner_cell[k] + low[k] as i64) as f64 * RESOLUTION_M);
        let rows = (low[1]..high[1]).map(|y| &self.evidence[y * self.size[0]..][low[0]..high[0]]);
        let cell = |evidence: &i16| if *evidence == 0 { UNKNOWN } else { *evidence as i8 };
        let cells: Vec<i8> = rows.flatten().map(cell).collect();
        let header = GridHeader {
            origin: Pose2::new(corner[0], corner[1], 0.0),
            resolution_m: RESOLUTION_M,
            width: (high[0] - low[0]) as u32,
            height: (high[1] - low[1]) as u32,
            ..GridHeader::default()
        };
        Grid { header, cells }
    }
}
