//! Fine alignment: Gauss-Newton on point-to-line distances with robust weights
//! (Censi, "An ICP variant using a point-to-line metric", ICRA 2008; weights: Cauchy).

use crate::cloud::{Cloud, PointTransform};
use crate::config::LinkConfig;
use msg::Pose2;
use nalgebra::{Matrix3, Vector3};

/// Iterations with the wide gate, at most, and with the narrow one.
const WIDE: usize = 4;
const NARROW: usize = 5;
/// A step smaller than this ends the wide iterations, metres or radians.
const STEP_WIDE: f64 = 5e-3;
/// Weight of a point without a surface direction, against a point on a line.
const POINT_SHARE: f64 = 0.2;
/// Steps smaller than this end an alignment, metres or radians.
const STEP_MIN: f64 = 2e-4;

/// A scan that stays where it is.
#[derive(Clone, Copy)]
pub struct Reference<'a> {
    /// Its surfaces.
    pub cloud: &'a Cloud,
    /// Where it lies in the frame that the alignment happens in.
    pub frame_from_cloud: Pose2,
}

/// What is believed before looking: a pose and how well it is known.
#[derive(Clone, Copy)]
pub struct Prior {
    /// The pose believed.
    pub pose: Pose2,
    /// Inverse covariance over (x, y, yaw) in the frame.
    pub information: Matrix3<f64>,
}

/// An alignment's outcome.
#[derive(Clone, Copy, Debug)]
pub struct Alignment {
    /// Where the moved cloud lies in the frame.
    pub frame_from_cloud: Pose2,
    /// Inverse covariance that the points give over (x, y, yaw) in the frame, without the prior.
    pub information: Matrix3<f64>,
    /// The same of points on lines alone. Hits far apart on a wall seen at a flat angle have no
    /// direction and count as places that stand still; how sure a pose is should not rest on them.
    pub information_of_lines: Matrix3<f64>,
    /// Share of the points that found their surface, averaged over the references... of the best one.
    pub overlap: f32,
    /// Robust root mean square distance of matched points from their surfaces, metres.
    pub rms_m: f32,
}

impl Alignment {
    /// What a link may claim: points without a direction count little.
    pub fn information_for_links(&self, config: &LinkConfig) -> Matrix3<f64> {
        let share = config.places_share;
        self.information * share + self.information_of_lines * (1.0 - share)
    }
}

/// Sums of one pass over the points.
struct Normal {
    hessian: Matrix3<f64>,
    of_lines: Matrix3<f64>,
    gradient: Vector3<f64>,
    squared: f64,
    weight: f64,
    matched: usize,
    compared: usize,
}

impl Normal {
    /// Adds the distance `away` (in the reference's frame) along `axis` (the same in the common frame).
    fn add(
        &mut self,
        lever: &[f64; 2],
        axis: [f32; 2],
        local: [f32; 2],
        away: [f64; 2],
        share: f64,
        cauchy_m: f64,
    ) -> Matrix3<f64> {
        let r = f64::from(local[0]) * away[0] + f64::from(local[1]) * away[1];
        let w = 1.0 / (1.0 + (r / cauchy_m).powi(2));
        let [nx, ny] = axis.map(f64::from);
        let j = Vector3::new(nx, ny, nx * lever[0] + ny * lever[1]);
        let information = j * j.transpose() * (w * share);
        self.hessian += information;
        self.gradient += j * (w * share * r);
        self.squared += w * r * r;
        self.weight += w;
        information
    }
}

/// Moves `cloud` from `guess` until its points lie on the references' surfaces.
/// A point counts against every reference that has a surface there, divided by their number.
pub fn align<'a>(
    cloud: &Cloud,
    guess: Pose2,
    references: impl Iterator<Item = Reference<'a>> + Clone,
    prior: Option<Prior>,
    config: &LinkConfig,
) -> Alignment {
    let mut pose = guess;
    let weight = 1.0 / (config.point_sigma_m * config.point_sigma_m);
    let mut sums = normal_equations(cloud, pose, references.clone(), config.gate_wide_m, config.cauchy_m);
    let (mut wide, mut narrow) = (0, 0);
    while narrow < NARROW {
        let (mut hessian, mut gradient) = (sums.hessian * weight, sums.gradient * weight);
        if let Some(prior) = prior {
            hessian += prior.information;
            gradient += prior.information * difference(pose, prior.pose);
        }
        hessian += Matrix3::identity() * 1e-3;
        let Some(step) = hessian.cholesky().map(|c| c.solve(&gradient)) else { break };
        pose = Pose2::new(pose.x_m - step.x, pose.y_m - step.y, pose.yaw_rad - step.z);
        let done = narrow > 0 && step.amax() < STEP_MIN;
        wide += 1;
        if narrow > 0 || wide == WIDE || step.amax() < STEP_WIDE {
            narrow += 1;
        }
        let gate = if narrow > 0 { config.gate_narrow_m } else { config.gate_wide_m };
        sums = normal_equations(cloud, pose, references.clone(), gate, config.cauchy_m);
        if done {
            break;
        }
    }
    // A noisy sensor, or surfaces that are no lines, leave more than point_sigma.
    let mean_square = sums.squared / sums.weight.max(1e-9);
    let scatter = 1.0 / (config.point_sigma_m.powi(2)).max(mean_square);
    Alignment {
        frame_from_cloud: Pose2 { yaw_rad: msg::pose::wrap_angle(pose.yaw_rad), ..pose },
        information: sums.hessian * scatter,
        information_of_lines: sums.of_lines * scatter,
        overlap: sums.matched as f32 / sums.compared.max(1) as f32,
        rms_m: mean_square.sqrt() as f32,
    }
}

/// `pose` minus `other`, the angle wrapped.
pub fn difference(pose: Pose2, other: Pose2) -> Vector3<f64> {
    let yaw = msg::pose::wrap_angle(pose.yaw_rad - other.yaw_rad);
    Vector3::new(pose.x_m - other.x_m, pose.y_m - other.y_m, yaw)
}

fn normal_equations<'a>(
    cloud: &Cloud,
    pose: Pose2,
    references: impl Iterator<Item = Reference<'a>> + Clone,
    gate_m: f32,
    cauchy_m: f64,
) -> Normal {
    let mut sums = Normal {
        hessian: Matrix3::zeros(),
        of_lines: Matrix3::zeros(),
        gradient: Vector3::zeros(),
        squared: 0.0,
        weight: 0.0,
        matched: 0,
        compared: 0,
    };
    let share = 1.0 / references.clone().count().max(1) as f64;
    let points = cloud.points();
    let (sin, cos) = pose.yaw_rad.sin_cos();
    let mut found = [0_u8; 4096];
    for reference in references {
        // Work in the reference's frame, where its index and normals are.
        let reference_from_frame = reference.frame_from_cloud.inverse();
        let place = PointTransform::new(reference_from_frame * pose);
        let turn = PointTransform::new(reference.frame_from_cloud);
        for (i, p) in points.iter().enumerate() {
            let at = place.point(p.at);
            let Some(surface) = reference.cloud.nearest(at, place.direction(p.normal), gate_m) else {
                continue;
            };
            found[i.min(4095)] = 1;
            let [px, py] = p.at.map(f64::from);
            let lever = [-sin * px - cos * py, cos * px - sin * py];
            let away = [at[0] - surface.at[0], at[1] - surface.at[1]].map(f64::from);
            if surface.is_flat() {
                let axis = turn.direction(surface.normal);
                let of_line = sums.add(&lever, axis, surface.normal, away, share, cauchy_m);
                sums.of_lines += of_line;
            } else {
                for axis in [[1.0, 0.0], [0.0, 1.0]] {
                    sums.add(&lever, turn.direction(axis), axis, away, share * POINT_SHARE, cauchy_m);
                }
            }
        }
    }
    sums.compared = points.len();
    sums.matched = found[..points.len().min(4096)].iter().map(|f| usize::from(*f)).sum();
    sums
}
