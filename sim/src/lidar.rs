//! A planar LiDAR by ray casting. The room and the peers are seen; the robot itself is not.

use crate::burger;
use crate::config::{LidarConfig, NoiseConfig};
use crate::noise::Noise;
use glam::{DVec3, Vec3};
use msg::Scan;
use parry3d::math::Pose;
use parry3d::query::Ray;
use parry3d::shape::{Shape, SharedShape};

/// Middle and radius of a ball around all of a peer that a ray can hit, in its `base_footprint`, metres.
const PEER_BALL_CENTRE: Vec3 = Vec3::new(-0.025, 0.0, 0.096);
const PEER_BALL_RADIUS_M: f32 = 0.16;

/// The sensor.
pub(crate) struct Lidar {
    config: LidarConfig,
    /// Unit directions of the rays in `base_scan`.
    directions: Vec<Vec3>,
    peer_parts: [(Pose, SharedShape); 3],
    errors: RangeErrors,
}

impl Lidar {
    pub(crate) fn new(config: LidarConfig, errors: RangeErrors) -> Self {
        let (first_rad, increment_rad) = (config.angle_min_deg.to_radians(), config.angle_increment_rad());
        let direction = |beam: usize| {
            let (sin, cos) = (first_rad + beam as f64 * increment_rad).sin_cos();
            Vec3::new(cos as f32, sin as f32, 0.0)
        };
        let directions = (0..config.beams).map(direction).collect();
        Self { config, directions, peer_parts: burger::hull_parts(), errors }
    }

    /// Writes all of `scan` but its header. All rays are cast at once (`time_increment_s` 0).
    pub(crate) fn scan_into(
        &mut self,
        scan: &mut Scan,
        room: &dyn Shape,
        world_from_base: Pose,
        world_from_peers: &[Pose],
    ) {
        let config = &self.config;
        scan.angle_min_rad = config.angle_min_deg.to_radians() as f32;
        scan.angle_increment_rad = config.angle_increment_rad() as f32;
        scan.time_increment_s = 0.0;
        scan.scan_time_s = (1.0 / config.rate_hz) as f32;
        scan.range_min_m = config.range_min_m as f32;
        scan.range_max_m = config.range_max_m as f32;
        scan.len = config.beams as u32;
        scan.reserved = 0;

        let scan_in_base = DVec3::from(burger::BASE_LINK_M) + DVec3::from(burger::SCAN_IN_BASE_LINK_M);
        let world_from_scan = world_from_base * Pose::from_translation(scan_in_base.as_vec3());
        let (beams, unused) = scan.ranges_m.split_at_mut(self.directions.len());
        for (range_m, direction) in beams.iter_mut().zip(&self.directions) {
            let ray = Ray::new(world_from_scan.translation, world_from_scan.rotation * *direction);
            let mut nearest_m = room.cast_local_ray(&ray, scan.range_max_m, false);
            for world_from_peer in world_from_peers {
                let far_m = nearest_m.unwrap_or(scan.range_max_m);
                nearest_m = cast_on_peer(&self.peer_parts, *world_from_peer, &ray, far_m).or(nearest_m);
            }
            *range_m = self.errors.measure(nearest_m, config);
        }
        unused.fill(0.0);
    }
}

/// Distance to a peer, if it is hit before `far_m`.
fn cast_on_peer(parts: &[(Pose, SharedShape)], world_from_peer: Pose, ray: &Ray, far_m: f32) -> Option<f32> {
    let to_peer = world_from_peer.transform_point(PEER_BALL_CENTRE) - ray.origin;
    let along_m = to_peer.dot(ray.dir);
    let aside_squared = to_peer.length_squared() - along_m * along_m;
    if along_m < -PEER_BALL_RADIUS_M
        || along_m > far_m + PEER_BALL_RADIUS_M
        || aside_squared > PEER_BALL_RADIUS_M * PEER_BALL_RADIUS_M
    {
        return None;
    }
    let hits = parts.iter().filter_map(|(peer_from_part, shape)| {
        shape.cast_ray(&(world_from_peer * *peer_from_part), ray, far_m, false)
    });
    hits.min_by(f32::total_cmp)
}

/// What comes between a distance and its measurement.
pub(crate) struct RangeErrors {
    pub(crate) config: NoiseConfig,
    pub(crate) range: Noise,
    pub(crate) dropout: Noise,
}

impl RangeErrors {
    /// REP-117: +inf is no return; NaN is no measurement, also for what is too near to measure.
    fn measure(&mut self, distance_m: Option<f32>, lidar: &LidarConfig) -> f32 {
        // Drawn for every ray, so that what one ray meets does not change the others' noise.
        let error = self.range.gaussian();
        if self.dropout.happens(self.config.dropout_probability) {
            return f32::NAN;
        }
        let Some(distance_m) = distance_m.map(f64::from) else { return f32::INFINITY };
        if distance_m < lidar.range_min_m {
            return f32::NAN;
        }
        let std_m = self.config.range_std_m + self.config.range_std_ratio * distance_m;
        let range_m = distance_m + std_m * error;
        if range_m >= lidar.range_max_m { f32::INFINITY } else { range_m.max(lidar.range_min_m) as f32 }
    }
}
