//! Simulation of a planar LiDAR by ray casting. It sees the room, what moves in it, and the peers, but not its own robot.

use crate::burger::{self, HOUSING_CENTRE_M, HOUSING_HALF_HEIGHT_M, HOUSING_RADIUS_M};
use crate::config::{LidarConfig, NoiseConfig};
use crate::moving::Outline;
use crate::noise::Noise;
use glam::{DVec3, Vec3};
use msg::{MOVING_OBJECTS_MAX, ROBOTS_MAX, Scan};
use parry3d::math::Pose;
use parry3d::query::{Ray, RayCast};
use parry3d::shape::{Cuboid, Shape};

/// Centre of a ball that contains all parts of a peer, in the peer's `base_footprint`, metres.
const PEER_BALL_CENTRE: Vec3 = Vec3::new(-0.025, 0.0, 0.096);
/// Radius of that ball, metres: from the centre to the farthest corner of [`burger::BOXES_M`].
const PEER_BALL_RADIUS_M: f32 = 0.16;

/// What the beams of a scan can meet, in `world`.
pub(crate) struct Surroundings<'a> {
    pub(crate) room: &'a dyn Shape,
    pub(crate) world_from_peers: &'a [Pose],
    /// Outlines of people, doors and boxes, which are higher than the beams.
    pub(crate) objects: &'a [Outline],
}

/// LiDAR of one robot.
pub(crate) struct Lidar {
    config: LidarConfig,
    /// Unit directions of the beams in `base_scan`.
    directions: Vec<Vec3>,
    errors: RangeNoise,
}

impl Lidar {
    pub(crate) fn new(config: LidarConfig, errors: RangeNoise) -> Self {
        let (first_rad, increment_rad) = (config.angle_min_deg.to_radians(), config.angle_increment_rad());
        let direction = |beam: usize| {
            let (sin, cos) = (first_rad + beam as f64 * increment_rad).sin_cos();
            Vec3::new(cos as f32, sin as f32, 0.0)
        };
        let directions = (0..config.beams).map(direction).collect();
        Self { config, directions, errors }
    }

    /// Measures a scan. Writes all of `scan` except its header. All beams have the same time
    /// (`time_increment_s` 0).
    pub(crate) fn scan_into(
        &mut self,
        scan: &mut Scan,
        world_from_base: Pose,
        surroundings: &Surroundings<'_>,
    ) {
        let Surroundings { room, world_from_peers, .. } = *surroundings;
        let config = &self.config;
        scan.angle_min_rad = config.angle_min_deg.to_radians() as f32;
        scan.angle_increment_rad = config.angle_increment_rad() as f32;
        scan.time_increment_s = 0.0;
        scan.scan_time_s = (1.0 / config.rate_hz) as f32;
        scan.range_min_m = config.range_min_m as f32;
        scan.range_max_m = config.range_max_m as f32;
        scan.len = config.beams as u32;
        scan.set_mount(None);

        let scan_in_base = DVec3::from(burger::BASE_LINK_M) + DVec3::from(burger::SCAN_IN_BASE_LINK_M);
        let world_from_scan = world_from_base * Pose::from_translation(scan_in_base.as_vec3());
        let mut targets = [Target::default(); ROBOTS_MAX];
        for (target, world_from_peer) in targets.iter_mut().zip(world_from_peers) {
            *target = Target::new(*world_from_peer);
        }
        let targets = &targets[..world_from_peers.len().min(ROBOTS_MAX)];
        let from = world_from_scan.translation;
        let near = surroundings.objects.iter().filter(|object| {
            object.distance_of_centre_m([from.x.into(), from.y.into()])
                <= config.range_max_m + object.bound_m()
        });
        let mut objects = [None; MOVING_OBJECTS_MAX];
        objects.iter_mut().zip(near).for_each(|(slot, object)| *slot = Some(object));
        let (beams, unused) = scan.ranges_m.split_at_mut(self.directions.len());
        for (range_m, direction) in beams.iter_mut().zip(&self.directions) {
            let ray = Ray::new(world_from_scan.translation, world_from_scan.rotation * *direction);
            let mut nearest_m = room.cast_local_ray(&ray, scan.range_max_m, false);
            for target in targets {
                let far_m = nearest_m.unwrap_or(scan.range_max_m);
                nearest_m = target.cast(&ray, far_m).or(nearest_m);
            }
            for object in objects.iter().map_while(|object| *object) {
                let far_m = nearest_m.unwrap_or(scan.range_max_m);
                nearest_m = object.cast(&ray, far_m).or(nearest_m);
            }
            *range_m = self.errors.measure(nearest_m, config);
        }
        unused.fill(0.0);
    }
}

/// A peer as a target of the beams of one scan. It stands upright, as all mirrored peers do.
#[derive(Clone, Copy, Default)]
struct Target {
    peer_from_world: Pose,
    /// Centre of the ball around the peer, in `world`.
    ball_centre: Vec3,
}

impl Target {
    fn new(world_from_peer: Pose) -> Self {
        let ball_centre = world_from_peer.transform_point(PEER_BALL_CENTRE);
        Self { peer_from_world: world_from_peer.inverse(), ball_centre }
    }

    /// Returns the distance along a ray to the peer, metres; `None` if it is `far_m` or more.
    fn cast(&self, ray: &Ray, far_m: f32) -> Option<f32> {
        let to_centre = self.ball_centre - ray.origin;
        let along_m = to_centre.dot(ray.dir);
        let aside_squared = to_centre.length_squared() - along_m * along_m;
        if along_m < -PEER_BALL_RADIUS_M
            || along_m > far_m + PEER_BALL_RADIUS_M
            || aside_squared > PEER_BALL_RADIUS_M * PEER_BALL_RADIUS_M
        {
            return None;
        }
        let ray = ray.transform_by(&self.peer_from_world);
        let boxes = burger::BOXES_M.iter().filter_map(|(centre, half)| {
            Cuboid::new(*half).cast_local_ray(&ray.translate_by(-*centre), far_m, false)
        });
        boxes.chain(cast_on_housing(&ray, far_m)).min_by(f32::total_cmp)
    }
}

/// Returns the distance to the round side of the housing, from outside, along a ray in the peer's
/// `base_footprint`.
///
/// The closed form is much faster than parry's iteration for cylinders, which takes a microsecond per ray.
fn cast_on_housing(ray: &Ray, far_m: f32) -> Option<f32> {
    let (from, direction) = ((ray.origin - HOUSING_CENTRE_M).truncate(), ray.dir.truncate());
    // |from + t direction| = radius
    let (a, b) = (direction.length_squared(), from.dot(direction));
    let c = from.length_squared() - HOUSING_RADIUS_M * HOUSING_RADIUS_M;
    let discriminant = b * b - a * c;
    if discriminant < 0.0 || a == 0.0 {
        return None;
    }
    let t = (-b - discriminant.sqrt()) / a;
    let above_m = ray.origin.z + t * ray.dir.z - HOUSING_CENTRE_M.z;
    ((0.0..far_m).contains(&t) && above_m.abs() <= HOUSING_HALF_HEIGHT_M).then_some(t)
}

/// Errors of range measurements.
pub(crate) struct RangeNoise {
    pub(crate) config: NoiseConfig,
    pub(crate) range: Noise,
    pub(crate) dropout: Noise,
}

impl RangeNoise {
    /// Returns the measured range of a distance by REP-117: +inf is no return, -inf is a surface nearer than the smallest range, and
    /// NaN is no measurement.
    fn measure(&mut self, distance_m: Option<f32>, lidar: &LidarConfig) -> f32 {
        // A number is drawn for every beam, so that one beam's target does not change the others' noise.
        let error = self.range.gaussian();
        if self.dropout.bernoulli(self.config.dropout_probability) {
            return f32::NAN;
        }
        let Some(distance_m) = distance_m.map(f64::from) else { return f32::INFINITY };
        if distance_m < lidar.range_min_m {
            return f32::NEG_INFINITY;
        }
        let std_m = self.config.range_std_m + self.config.range_std_ratio * distance_m;
        let range_m = distance_m + std_m * error;
        if range_m >= lidar.range_max_m { f32::INFINITY } else { range_m.max(lidar.range_min_m) as f32 }
    }
}
