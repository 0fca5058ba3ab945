//! A tiny flat world for the tests: walls, a LiDAR that casts rays at them, wheels that lie a little.
#![allow(dead_code)]

use msg::{Header, Odometry, Pose2, Scan, Stamp};
use rand_xoshiro::SplitMix64;
use rand_xoshiro::rand_core::{Rng, SeedableRng};

/// A wall from a to b, metres.
pub type Wall = [[f64; 2]; 2];

/// The four walls of a box.
pub fn rectangle(x0: f64, y0: f64, x1: f64, y1: f64) -> Vec<Wall> {
    let c = [[x0, y0], [x1, y0], [x1, y1], [x0, y1]];
    (0..4).map(|i| [c[i], c[(i + 1) % 4]]).collect()
}

/// A furnished room of 6 m x 8 m, its middle at the origin.
pub fn laboratory() -> Vec<Wall> {
    let boxes = [
        (-3.0, -4.0, 3.0, 4.0),
        (-2.6, 2.9, -1.0, 3.6),
        (1.6, -3.4, 2.5, -1.9),
        (-2.8, -3.5, -2.2, -2.3),
        (0.9, 1.2, 1.5, 1.9),
        (2.2, 2.4, 2.9, 3.3),
    ];
    boxes.iter().flat_map(|b| rectangle(b.0, b.1, b.2, b.3)).collect()
}

/// A ring of corridors, 2.4 m wide, 18 m x 14 m outside, with niches that tell places apart.
pub fn ring(seed: u64) -> Vec<Wall> {
    let mut noise = Noise::new(seed);
    let mut walls = Vec::new();
    let mut side = |a: [f64; 2], b: [f64; 2], out: [f64; 2]| {
        let length = (b[0] - a[0]).hypot(b[1] - a[1]);
        let along = [(b[0] - a[0]) / length, (b[1] - a[1]) / length];
        let at = |s: f64, d: f64| [a[0] + along[0] * s + out[0] * d, a[1] + along[1] * s + out[1] * d];
        let mut s = 0.0;
        while s < length {
            let start = (s + 0.8 + 2.0 * noise.uniform()).min(length);
            let end = (start + 0.5 + noise.uniform()).min(length);
            let depth = 0.2 + 0.5 * noise.uniform();
            walls.push([at(s, 0.0), at(start, 0.0)]);
            if end < length {
                walls.push([at(start, 0.0), at(start, depth)]);
                walls.push([at(start, depth), at(end, depth)]);
                walls.push([at(end, depth), at(end, 0.0)]);
            } else {
                walls.push([at(start, 0.0), at(end, 0.0)]);
            }
            s = end;
        }
    };
    for (x, y, out) in [(9.0, 7.0, 1.0), (6.6, 4.6, -1.0)] {
        side([-x, -y], [x, -y], [0.0, -out]);
        side([x, -y], [x, y], [out, 0.0]);
        side([x, y], [-x, y], [0.0, out]);
        side([-x, y], [-x, -y], [-out, 0.0]);
    }
    walls
}

/// Random numbers from a seed (SplitMix64).
pub struct Noise(SplitMix64);

impl Noise {
    pub fn new(seed: u64) -> Self {
        Self(SplitMix64::seed_from_u64(seed))
    }

    /// 0 to 1.
    pub fn uniform(&mut self) -> f64 {
        self.0.next_u64() as f64 / u64::MAX as f64
    }

    /// Mean 0, standard deviation 1.
    pub fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }
}

/// A planar LiDAR.
#[derive(Clone, Copy)]
pub struct Lidar {
    pub beams: usize,
    pub fov_rad: f64,
    pub range_max_m: f64,
    pub sigma_m: f64,
}

/// 180 rays over 90°, 3.5 m: the fleet's default.
pub const NARROW: Lidar =
    Lidar { beams: 180, fov_rad: core::f64::consts::FRAC_PI_2, range_max_m: 3.5, sigma_m: 0.01 };
/// 360 rays over 360°.
pub const FULL: Lidar =
    Lidar { beams: 360, fov_rad: core::f64::consts::TAU, range_max_m: 3.5, sigma_m: 0.01 };
/// 181 rays over 180°, far.
pub const HALF: Lidar =
    Lidar { beams: 181, fov_rad: core::f64::consts::PI, range_max_m: 20.0, sigma_m: 0.01 };

/// One LiDAR scan.
pub fn cast(
    walls: &[Wall],
    lidar: &Lidar,
    world_from_scan: Pose2,
    stamp: Stamp,
    noise: &mut Noise,
) -> Box<Scan> {
    let mut scan: Box<Scan> = bytemuck::allocation::zeroed_box();
    let increment = lidar.fov_rad / lidar.beams as f64;
    scan.header = Header { stamp, ..Default::default() };
    scan.angle_min_rad = (-lidar.fov_rad / 2.0 + increment / 2.0) as f32;
    scan.angle_increment_rad = increment as f32;
    (scan.range_min_m, scan.range_max_m) = (0.12, lidar.range_max_m as f32);
    scan.len = lidar.beams as u32;
    for i in 0..lidar.beams {
        let yaw = world_from_scan.yaw_rad + f64::from(scan.angle_rad(i));
        let range = distance(walls, [world_from_scan.x_m, world_from_scan.y_m], yaw);
        let measured = range + lidar.sigma_m * noise.normal();
        scan.ranges_m[i] = if measured < lidar.range_max_m { measured as f32 } else { f32::INFINITY };
    }
    scan
}

/// One scan of a LiDAR that turns in `seconds`, on a robot that meanwhile drives. The beams'
/// times are in the scan.
pub fn cast_driving(
    walls: &[Wall],
    lidar: &Lidar,
    robot: &Robot,
    (linear, angular): (f64, f64),
    seconds: f64,
    noise: &mut Noise,
) -> Box<Scan> {
    let mut scan = cast(walls, lidar, robot.world_from_base, robot.stamp(), noise);
    scan.time_increment_s = (seconds / lidar.beams as f64) as f32;
    for i in 0..lidar.beams {
        let at = robot.world_from_base * arc(linear, angular, i as f64 * f64::from(scan.time_increment_s));
        let range = distance(walls, [at.x_m, at.y_m], at.yaw_rad + f64::from(scan.angle_rad(i)));
        let measured = range + lidar.sigma_m * noise.normal();
        scan.ranges_m[i] = if measured < lidar.range_max_m { measured as f32 } else { f32::INFINITY };
    }
    scan
}

fn arc(linear: f64, angular: f64, seconds: f64) -> Pose2 {
    let turn = angular * seconds;
    Pose2::new(linear * seconds * (turn / 2.0).cos(), linear * seconds * (turn / 2.0).sin(), turn)
}

fn distance(walls: &[Wall], from: [f64; 2], yaw: f64) -> f64 {
    let (dy, dx) = yaw.sin_cos();
    let hit = |[a, b]: &Wall| {
        let (ex, ey) = (b[0] - a[0], b[1] - a[1]);
        let (fx, fy) = (a[0] - from[0], a[1] - from[1]);
        let cross = dx * ey - dy * ex;
        let (t, s) = ((fx * ey - fy * ex) / cross, (fx * dy - fy * dx) / cross);
        (t > 0.0 && (0.0..=1.0).contains(&s)).then_some(t)
    };
    walls.iter().filter_map(hit).fold(f64::INFINITY, f64::min)
}

/// A robot that is driven through the world and believes its wheels.
pub struct Robot {
    pub world_from_base: Pose2,
    pub odom_from_base: Pose2,
    pub time_s: f64,
    /// Errors of the wheels: share of the way, and radians a metre of it.
    pub slip: f64,
    pub veer_rad_per_m: f64,
}

impl Robot {
    pub fn new(world_from_base: Pose2) -> Self {
        Self {
            world_from_base,
            odom_from_base: Pose2::IDENTITY,
            time_s: 10.0,
            slip: 0.03,
            veer_rad_per_m: 0.02,
        }
    }

    /// Drives on for `seconds`.
    pub fn drive(&mut self, linear: f64, angular: f64, seconds: f64, noise: &mut Noise) {
        let slipped = linear * (1.0 + self.slip * (1.0 + noise.normal()));
        let veered = angular * (1.0 + self.slip * noise.normal()) + self.veer_rad_per_m * linear.abs();
        self.world_from_base = self.world_from_base * arc(linear, angular, seconds);
        self.odom_from_base = self.odom_from_base * arc(slipped, veered, seconds);
        self.time_s += seconds;
    }

    pub fn stamp(&self) -> Stamp {
        Stamp::from_seconds(self.time_s)
    }

    pub fn odometry(&self) -> Odometry {
        let header = Header { stamp: self.stamp(), ..Default::default() };
        Odometry { header, odom_from_base: self.odom_from_base, ..Default::default() }
    }
}

/// Odometry, scan and true pose, in order of time.
pub type Log = Vec<(Odometry, Box<Scan>, Pose2)>;

/// Bits of poses, to compare them exactly.
pub fn bits(poses: impl Iterator<Item = Pose2>) -> Vec<[u64; 3]> {
    poses.map(|p| [p.x_m, p.y_m, p.yaw_rad].map(f64::to_bits)).collect()
}

/// Two rounds of the ring of corridors, with closures.
pub fn ring_log() -> Log {
    let lidar = Lidar { range_max_m: 4.0, sigma_m: 0.02, ..HALF };
    let mut robot = Robot::new(Pose2::new(-7.8, -5.8, 0.0));
    robot.veer_rad_per_m = 0.01;
    let mut noise = Noise::new(11);
    let (walls, mut log) = (ring(3), Vec::new());
    for side_m in [15.6, 11.6, 15.6, 11.6, 15.6, 11.6, 15.6] {
        let legs = (0..(side_m / 0.4) as usize)
            .map(|_| (0.4, 0.0))
            .chain((0..4).map(|_| (0.0, core::f64::consts::FRAC_PI_8)));
        for (way, turn) in legs {
            robot.drive(way, turn, 1.0, &mut noise);
            let scan = cast(&walls, &lidar, robot.world_from_base, robot.stamp(), &mut noise);
            log.push((robot.odometry(), scan, robot.world_from_base));
        }
    }
    log
}
