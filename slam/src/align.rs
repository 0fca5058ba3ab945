//! Fine alignment: Gauss-Newton on point-to-line distances with robust weights
//! (Censi, "An ICP variant using a point-to-line metric", ICRA 2008; weights: Cauchy).

use crate::cloud::Cloud;
use crate::config::{AlignmentConfig, LinkConfig};
use crate::point_transform::PointTransform;
use msg::Pose2;
use nalgebra::{Matrix3, Vector3};

/// Most iterations with the wide gate.
const WIDE_ITERATIONS_MAX: usize = 4;
/// Iterations with the narrow gate, counted from the last wide one.
const NARROW_ITERATIONS: usize = 5;
/// A step smaller than this ends the wide iterations, metres or radians.
const STEP_WIDE: f64 = 5e-3;
/// Weight of a point without a surface direction, against a point on a line.
const POINT_SHARE: f64 = 0.2;
/// Steps smaller than this end an alignment, metres or radians.
const STEP_MIN: f64 = 2e-4;
/// Information added to each coordinate, 1/m² and 1/rad²: keeps an unobserved direction solvable.
const REGULARISATION: f64 = 1e-3;
/// Least sum of weights that residuals are divided by: without any match the sum is zero.
const WEIGHT_MIN: f64 = 1e-9;
/// A direction is degenerate if the normals of both scans have no larger share of their information along it than this, of that across
/// it. In a bare corridor seen by 360 beams it is 0.0001 by chance, and 0.01 with a pillar that stands 0.5 m into it. With 0.003 and
/// with 0.01 the results on generated corridors are the same.
const DEGENERATE_SHARE_MAX: f64 = 0.005;
/// Points that are compared with all references before the next ones: it is remembered of so many which of them matched.
const BLOCK_POINTS: usize = 4096;

/// A scan that an alignment compares with and does not move.
#[derive(Clone, Copy)]
pub struct Reference<'a> {
    /// Surface points of the scan.
    pub cloud: &'a Cloud,
    /// Pose of the scan in the common frame of the alignment.
    pub frame_from_cloud: Pose2,
}

/// Prior of an alignment: a pose and its information.
#[derive(Clone, Copy)]
pub struct Prior {
    /// Expected pose of the moved cloud in the common frame.
    pub pose: Pose2,
    /// Inverse covariance over (x, y, yaw) in the frame.
    pub information: Matrix3<f64>,
}

/// Result of an alignment.
#[derive(Clone, Copy, Debug)]
pub struct ScanAlignment {
    /// Pose of the moved cloud in the common frame.
    pub frame_from_cloud: Pose2,
    /// Inverse covariance that the points give over (x, y, yaw) in the frame, without the prior.
    pub information: Matrix3<f64>,
    /// Information of points on lines alone. Hits far apart on a wall seen at a flat angle have no normal and count as
    /// point landmarks; a pose's certainty should not rest on them.
    pub information_of_lines: Matrix3<f64>,
    /// The same without what the noise of normals pretends. A normal that is off by 0.1 rad claims to hold a corridor's
    /// length, and a hundred of them claim centimetres; the product of the normals of two scans does not, as their noise
    /// is independent.
    pub information_without_noise: Matrix3<f64>,
    /// Direction in the frame in which almost no surface with a normal in both scans faces (`DEGENERATE_SHARE_MAX`), radians; `None` if there
    /// is none. Poles and chair legs have no normals: they do not count.
    pub degenerate_direction_rad: Option<f64>,
    /// Share of the points that matched a surface of at least one reference, 0 to 1.
    pub overlap: f32,
    /// Robust root mean square distance of matched points from their surfaces, metres.
    pub rms_m: f32,
}

impl ScanAlignment {
    /// Information of a link: points without a normal count by `links.point_landmark_weight`.
    pub fn information_for_links(&self, config: &LinkConfig) -> Matrix3<f64> {
        let share = config.point_landmark_weight;
        self.information * share + self.information_of_lines * (1.0 - share)
    }
}

/// Normal equations and sums of one iteration over the points.
struct NormalEquations {
    hessian: Matrix3<f64>,
    of_lines: Matrix3<f64>,
    /// Lines with the normals of both scans; not symmetric.
    of_both_normals: Matrix3<f64>,
    gradient: Vector3<f64>,
    squared: f64,
    weight: f64,
    matched: usize,
    compared: usize,
}

impl NormalEquations {
    fn zero() -> Self {
        Self {
            hessian: Matrix3::zeros(),
            of_lines: Matrix3::zeros(),
            of_both_normals: Matrix3::zeros(),
            gradient: Vector3::zeros(),
            squared: 0.0,
            weight: 0.0,
            matched: 0,
            compared: 0,
        }
    }

    /// Adds the distance `away` (in the reference's frame) along `axis` (the same in the common frame). Returns its
    /// Jacobian and its weight.
    fn add(
        &mut self,
        lever: &[f64; 2],
        axis: [f32; 2],
        local: [f32; 2],
        away: [f64; 2],
        share: f64,
        cauchy_m: f64,
    ) -> (Vector3<f64>, f64) {
        let r = f64::from(local[0]) * away[0] + f64::from(local[1]) * away[1];
        let w = 1.0 / (1.0 + (r / cauchy_m).powi(2));
        let [nx, ny] = axis.map(f64::from);
        let j = jacobian([nx, ny], lever);
        self.hessian += j * j.transpose() * (w * share);
        self.gradient += j * (w * share * r);
        self.squared += w * r * r;
        self.weight += w;
        (j, w * share)
    }
}

/// How the distance along an axis changes with the moved cloud's pose (x, y, yaw).
fn jacobian([nx, ny]: [f64; 2], lever: &[f64; 2]) -> Vector3<f64> {
    Vector3::new(nx, ny, nx * lever[0] + ny * lever[1])
}

/// How a point of the moved cloud moves as that turns, for the sine and cosine of its heading, metres per radian.
fn lever(point: [f32; 2], (sin, cos): (f64, f64)) -> [f64; 2] {
    let [x_m, y_m] = point.map(f64::from);
    [-sin * x_m - cos * y_m, cos * x_m - sin * y_m]
}

/// The nearest symmetric matrix without negative eigenvalues.
fn without_negative(information: Matrix3<f64>) -> Matrix3<f64> {
    let mut parts = ((information + information.transpose()) * 0.5).symmetric_eigen();
    parts.eigenvalues.apply(|value| *value = value.max(0.0));
    parts.recompose()
}

/// Direction of the plane that the normals of both scans do not constrain, radians (Zhang, Kaess, Singh, "On degeneracy of
/// optimization-based state estimation problems", ICRA 2016).
fn degenerate_direction_rad(of_both_normals: Matrix3<f64>) -> Option<f64> {
    let plane = of_both_normals.fixed_view::<2, 2>(0, 0).into_owned();
    let parts = ((plane + plane.transpose()) * 0.5).symmetric_eigen();
    let (least, most) = (parts.eigenvalues.imin(), parts.eigenvalues.imax());
    let is_degenerate = parts.eigenvalues[least] < DEGENERATE_SHARE_MAX * parts.eigenvalues[most];
    let axis = parts.eigenvectors.column(least);
    is_degenerate.then(|| f64::atan2(axis[1], axis[0]))
}

/// Aligns `cloud`, starting at `guess`, with the references' surfaces.
/// A point counts against every reference that has a surface there, divided by the number of references.
pub fn align<'a>(
    cloud: &Cloud,
    guess: Pose2,
    references: impl Iterator<Item = Reference<'a>> + Clone,
    prior: Option<Prior>,
    config: &AlignmentConfig,
) -> ScanAlignment {
    let mut pose = guess;
    let weight = 1.0 / (config.point_sigma_m * config.point_sigma_m);
    let mut sums = normal_equations(cloud, pose, references.clone(), config.gate_wide_m, config.cauchy_m);
    let (mut wide, mut narrow) = (0, 0);
    while narrow < NARROW_ITERATIONS {
        let (mut hessian, mut gradient) = (sums.hessian * weight, sums.gradient * weight);
        if let Some(direction_rad) = degenerate_direction_rad(sums.of_both_normals) {
            // The solution is not moved along it (Zhang et al. 2016, section IV).
            let axis = Vector3::new(direction_rad.cos(), direction_rad.sin(), 0.0);
            let column = hessian * axis;
            let along = axis.dot(&column);
            if along > 0.0 {
                gradient -= column * (axis.dot(&gradient) / along);
                hessian = posegraph::information_without_axis(hessian, direction_rad);
            }
        }
        if let Some(prior) = prior {
            hessian += prior.information;
            gradient += prior.information * difference(pose, prior.pose);
        }
        hessian += Matrix3::identity() * REGULARISATION;
        let Some(step) = hessian.cholesky().map(|c| c.solve(&gradient)) else { break };
        pose = Pose2::new(pose.x_m - step.x, pose.y_m - step.y, pose.yaw_rad - step.z);
        let done = narrow > 0 && step.amax() < STEP_MIN;
        wide += 1;
        if narrow > 0 || wide == WIDE_ITERATIONS_MAX || step.amax() < STEP_WIDE {
            narrow += 1;
        }
        let gate = if narrow > 0 { config.gate_narrow_m } else { config.gate_wide_m };
        sums = normal_equations(cloud, pose, references.clone(), gate, config.cauchy_m);
        if done {
            break;
        }
    }
    // A noisy sensor, or surfaces that are no lines, scatter more than point_sigma.
    let mean_square = sums.squared / sums.weight.max(WEIGHT_MIN);
    let scatter = 1.0 / (config.point_sigma_m.powi(2)).max(mean_square);
    ScanAlignment {
        frame_from_cloud: Pose2 { yaw_rad: msg::pose::wrap_angle(pose.yaw_rad), ..pose },
        information: sums.hessian * scatter,
        information_of_lines: sums.of_lines * scatter,
        information_without_noise: without_negative(sums.of_both_normals) * scatter,
        degenerate_direction_rad: degenerate_direction_rad(sums.of_both_normals),
        overlap: sums.matched as f32 / sums.compared.max(1) as f32,
        rms_m: mean_square.sqrt() as f32,
    }
}

/// `pose` minus `other` as (x, y, yaw), the yaw wrapped.
pub fn difference(pose: Pose2, other: Pose2) -> Vector3<f64> {
    let yaw = msg::pose::wrap_angle(pose.yaw_rad - other.yaw_rad);
    Vector3::new(pose.x_m - other.x_m, pose.y_m - other.y_m, yaw)
}

/// Normal equations of one iteration at a pose, over all points and references.
fn normal_equations<'a>(
    cloud: &Cloud,
    pose: Pose2,
    references: impl Iterator<Item = Reference<'a>> + Clone,
    gate_m: f32,
    cauchy_m: f64,
) -> NormalEquations {
    let mut sums = NormalEquations::zero();
    let share = 1.0 / references.clone().count().max(1) as f64;
    let heading = pose.yaw_rad.sin_cos();
    let frame_from_cloud = PointTransform::new(pose);
    for block in cloud.points().chunks(BLOCK_POINTS) {
        let mut found = [false; BLOCK_POINTS];
        for reference in references.clone() {
            // The reference's index and normals are in its own frame.
            let reference_from_frame = reference.frame_from_cloud.inverse();
            let reference_from_cloud = PointTransform::new(reference_from_frame * pose);
            let frame_from_reference = PointTransform::new(reference.frame_from_cloud);
            for (p, is_found) in block.iter().zip(&mut found) {
                let at = reference_from_cloud.point(p.at);
                let normal = reference_from_cloud.direction(p.normal);
                let Some(surface) = reference.cloud.nearest(at, normal, gate_m) else { continue };
                *is_found = true;
                let lever = lever(p.at, heading);
                let away = [at[0] - surface.at[0], at[1] - surface.at[1]].map(f64::from);
                if surface.has_normal() {
                    let axis = frame_from_reference.direction(surface.normal);
                    let (j, w) = sums.add(&lever, axis, surface.normal, away, share, cauchy_m);
                    sums.of_lines += j * j.transpose() * w;
                    if p.has_normal() {
                        let own = jacobian(frame_from_cloud.direction(p.normal).map(f64::from), &lever);
                        sums.of_both_normals += j * (own * w).transpose();
                    }
                } else {
                    for axis in [[1.0, 0.0], [0.0, 1.0]] {
                        let in_frame = frame_from_reference.direction(axis);
                        sums.add(&lever, in_frame, axis, away, share * POINT_SHARE, cauchy_m);
                    }
                }
            }
        }
        sums.matched += found.iter().filter(|is_found| **is_found).count();
    }
    sums.compared = cloud.points().len();
    sums
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::common::{FULL, Lidar, Noise, Wall, cast, rectangle};
    use crate::config::SlamConfig;
    use crate::testing::standing_node;
    use core::f64::consts::PI;
    use msg::Stamp;

    const LIDAR: Lidar = Lidar { range_max_m: 12.0, ..FULL };

    /// Direction of the corridor in the frame of the first scan, radians.
    const CORRIDOR_RAD: f64 = -0.7;

    /// Two scans 0.5 m apart in the middle of a world, the second aligned with the first.
    fn aligned(world: &[Wall], seed: u64) -> ScanAlignment {
        let config = SlamConfig::default();
        let mut noise = Noise::new(seed);
        let poses = [Pose2::new(0.0, 0.1, -CORRIDOR_RAD), Pose2::new(0.5, 0.1, -CORRIDOR_RAD + 0.2)];
        let [first, second] = poses.map(|at| {
            let scan = cast(world, &LIDAR, at, Stamp(0), &mut noise);
            standing_node(0, &scan, at, &config.lidar).cloud
        });
        let reference = Reference { cloud: &first, frame_from_cloud: Pose2::IDENTITY };
        align(&second, poses[0].between(poses[1]), core::iter::once(reference), None, &config.alignment)
    }

    /// A corridor of 60 m whose ends are out of sight.
    fn corridor() -> Vec<Wall> {
        rectangle(-30.0, -1.1, 30.0, 1.1).into_iter().collect()
    }

    #[test]
    fn every_point_of_a_dense_cloud_counts_for_the_overlap() {
        let mut config = SlamConfig::default();
        (config.lidar.points_max, config.lidar.spacing_m) = (2000, 0.005);
        let scan =
            cast(&rectangle(-3.0, -2.0, 3.0, 2.0), &LIDAR, Pose2::IDENTITY, Stamp(0), &mut Noise::new(1));
        let cloud = standing_node(0, &scan, Pose2::IDENTITY, &config.lidar).cloud;
        let reference = Reference { cloud: &cloud, frame_from_cloud: Pose2::IDENTITY };
        for scans in [1, 4, 12, 40] {
            let query = core::iter::repeat_n((&*cloud, Pose2::IDENTITY), scans);
            let merged = Cloud::merged(query, usize::MAX);
            assert!(merged.points().len() > 250 * scans);
            let references = core::iter::once(reference);
            let fit = align(&merged, Pose2::IDENTITY, references, None, &config.alignment);
            assert!(fit.overlap > 0.99, "{scans} scans: {}", fit.overlap);
        }
    }

    #[test]
    fn a_bare_corridor_is_degenerate_along_itself_and_one_with_an_end_or_a_pillar_in_sight_is_not() {
        for seed in 0..20 {
            let bare = aligned(&corridor(), seed);
            let direction_rad = bare.degenerate_direction_rad.expect("a bare corridor is degenerate");
            let off_rad = (direction_rad - CORRIDOR_RAD + PI / 2.0).rem_euclid(PI) - PI / 2.0;
            assert!(off_rad.abs() < 0.02, "seed {seed}: {off_rad}");
            let [along, across] = [CORRIDOR_RAD, CORRIDOR_RAD + PI / 2.0]
                .map(|angle_rad| Vector3::new(angle_rad.cos(), angle_rad.sin(), 0.0));
            let of = |information: Matrix3<f64>, axis: Vector3<f64>| axis.dot(&(information * axis));
            assert!(of(bare.information, along) > 400.0, "the noise of its normals claims less than 5 cm");
            let left = posegraph::information_without_axis(bare.information, direction_rad);
            assert!(of(left, along) < 4.0, "seed {seed}: half a metre or more");
            assert!(of(left, across) > 0.5 * of(bare.information, across), "seed {seed}");
            assert!(left[(2, 2)] > 0.5 * bare.information[(2, 2)], "seed {seed}");
            let with_end = [corridor(), rectangle(-30.0, -1.1, 6.0, 1.1).into_iter().collect()].concat();
            assert_eq!(aligned(&with_end, seed).degenerate_direction_rad, None, "seed {seed}: an end");
            let pillar = [corridor(), rectangle(2.0, 0.6, 3.0, 1.1).into_iter().collect()].concat();
            assert_eq!(aligned(&pillar, seed).degenerate_direction_rad, None, "seed {seed}: a pillar");
        }
    }
}
