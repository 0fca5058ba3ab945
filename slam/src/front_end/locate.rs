//! Where a scan says the robot is: odometry's prediction, a search around it, and the alignment.

use super::{CARRIED_MAX_S, FrontEnd};
use crate::align::{Alignment, Prior, Reference, align};
use crate::beam_poses::part;
use crate::cloud::Cloud;
use crate::likelihood_field::{SearchLimits, SearchWindow};
use crate::stages::Stage;
use msg::{Pose2, Stamp, TrackingState};
use nalgebra::{Matrix3, Vector3};

/// A window smaller than this needs no search: the alignment finds the way.
const SEARCH_MIN_M: f64 = 0.12;
const SEARCH_MIN_RAD: f64 = 0.06;
/// Field values under a good match; less is not worth aligning.
const RESPONSE_MIN: f32 = 0.25;
/// Evaluations one search of the scan path may cost.
const EVALUATIONS_MAX: usize = 12_000;
/// Nor over more than so many times the interval it was seen in.
const CARRIED_TIMES_MAX: f64 = 3.0;
/// How strongly the search prefers what odometry says.
const PULL: f32 = 0.1;
/// A pose this many standard deviations from where odometry has it is strained.
const SLIP_SIGMAS: f64 = 3.0;
/// To be believed against odometry, so much of a scan must fit ...
const SLIP_OVERLAP_MIN: f32 = 0.7;
/// ... and leave no direction more unsure than this by itself, metres.
const SLIP_WIDEST_M: f64 = 0.03;

/// Goes on for `ahead_s` as in the `motion` that took `before_s`; not far beyond it.
pub(super) fn carried(motion: Pose2, before_s: f64, ahead_s: f64) -> Pose2 {
    part(motion, (ahead_s / before_s).min(CARRIED_TIMES_MAX))
}

fn strained(fit: &Alignment, expected: &PosePrediction) -> bool {
    let off = expected.pose.between(fit.frame_from_cloud);
    off.x_m.hypot(off.y_m) > SLIP_SIGMAS * expected.sigma_m
        || off.yaw_rad.abs() > SLIP_SIGMAS * expected.sigma_rad
}

/// How unsure points alone leave the worst known direction, one standard deviation, metres.
fn widest_m(information: &Matrix3<f64>) -> Option<f64> {
    let seen = (information + Matrix3::identity() * 1e-3).try_inverse()?;
    Some(seen.fixed_view::<2, 2>(0, 0).into_owned().symmetric_eigenvalues().max().sqrt())
}

/// What the scan path knows before it looks at a scan.
pub(super) struct PosePrediction {
    pose: Pose2,
    sigma_m: f64,
    sigma_rad: f64,
    /// Of the pose it is reckoned from.
    before: Matrix3<f64>,
    way_m: f64,
}

impl PosePrediction {
    /// Variances of x, y and yaw.
    fn accepted(&self) -> Vector3<f64> {
        Vector3::new(self.sigma_m.powi(2), self.sigma_m.powi(2), self.sigma_rad.powi(2))
    }

    /// Of the pose, if no scan says more: an error in heading carries the way aside.
    fn covariance(&self) -> Matrix3<f64> {
        let aside = self.before[(2, 2)] * self.way_m.powi(2);
        self.before + Matrix3::from_diagonal(&(self.accepted() + Vector3::new(aside, aside, 0.0)))
    }
}

/// What a scan said.
pub(super) struct TrackedPose {
    pub local_from_base: Pose2,
    pub covariance: Matrix3<f64>,
    pub state: TrackingState,
    /// The scan says, clearly, that the wheels did not do what they counted.
    pub slipped: bool,
}

impl FrontEnd {
    /// Where the robot should be by odometry, or by its last motion, and how sure that is.
    pub(super) fn expect(&mut self, stamp: Stamp, odom_from_base: Option<Pose2>) -> PosePrediction {
        let Some(last) = &self.last else {
            let before = Matrix3::zeros();
            return PosePrediction {
                pose: Pose2::IDENTITY,
                sigma_m: 0.0,
                sigma_rad: 0.0,
                before,
                way_m: 0.0,
            };
        };
        let c = &self.config.odometry;
        let interval_s = stamp - last.stamp;
        if let (Some(before), Some(now)) = (last.odom_from_base, odom_from_base) {
            // Wheels that claim more than the robot can have driven were reset.
            if before.distance_m(now) > 3.0 * (c.speed_max_m_s * interval_s + 1.0) {
                self.node_odom_from_base = None;
            }
        }
        // From the newest node, not from the scan before: many small steps would add up to more
        // doubt than one long one.
        let from_node = self.recent.back().zip(self.node_odom_from_base).zip(odom_from_base);
        if let Some(((node, before), now)) = from_node {
            let moved = before.between(now);
            let (way, turn) = (moved.x_m.hypot(moved.y_m), moved.yaw_rad.abs());
            let sigma_m = c.sigma_m + c.sigma_m_per_m * way;
            let sigma_rad = c.sigma_rad + c.sigma_rad_per_rad * turn + c.sigma_rad_per_m * way;
            let (pose, before) = (node.local_from_base * moved, self.node_covariance);
            return PosePrediction { pose, sigma_m, sigma_rad, before, way_m: way };
        }
        let moving = last.motion.filter(|_| interval_s < CARRIED_MAX_S);
        let step = moving.map_or(Pose2::IDENTITY, |(motion, before_s)| carried(motion, before_s, interval_s));
        PosePrediction {
            pose: last.local_from_base * step,
            sigma_m: 0.3 * c.speed_max_m_s * interval_s + c.sigma_m,
            sigma_rad: 0.3 * c.turn_max_rad_s * interval_s + c.sigma_rad,
            before: last.covariance,
            way_m: step.x_m.hypot(step.y_m),
        }
    }

    /// Matches the scan against the local map: search, then alignment.
    pub(super) fn locate(&mut self, cloud: &Cloud, expected: &PosePrediction) -> TrackedPose {
        let t = &self.config.tracking;
        let dead_reckoned = TrackedPose {
            local_from_base: expected.pose,
            covariance: expected.covariance(),
            state: TrackingState::Lost,
            slipped: false,
        };
        if self.recent.is_empty() {
            return TrackedPose { state: TrackingState::Starting, ..dead_reckoned };
        }
        if cloud.points().len() < t.points_min {
            return dead_reckoned;
        }
        let (half_m, half_rad) = (3.0 * expected.sigma_m, 3.0 * expected.sigma_rad);
        let narrow = half_m <= SEARCH_MIN_M && half_rad <= SEARCH_MIN_RAD;
        let direct = if narrow { self.refine(cloud, expected.pose, expected) } else { None };
        let found = direct.or_else(|| {
            let guess = self.search(cloud, expected, half_m, half_rad)?;
            self.refine(cloud, guess, expected)
        });
        // What does not fit may fit elsewhere by chance: after a loss more is asked.
        let found =
            found.filter(|found| !self.last_scan_lost || !self.contradicted(cloud, found.local_from_base));
        found.unwrap_or(dead_reckoned)
    }

    fn search(
        &mut self,
        cloud: &Cloud,
        expected: &PosePrediction,
        half_m: f64,
        half_rad: f64,
    ) -> Option<Pose2> {
        self.stages.stage_started(Stage::Search);
        let t = &self.config.tracking;
        let stride = cloud.points().len().div_ceil(t.search_points_max).max(1);
        self.points.clear();
        self.points.extend(cloud.points().iter().step_by(stride).map(|p| p.at));
        let window = SearchWindow {
            centre: expected.pose,
            half_m: half_m.clamp(SEARCH_MIN_M, t.window_max_m),
            half_rad: half_rad.clamp(SEARCH_MIN_RAD, t.window_max_rad),
            pull: PULL,
        };
        let limits = SearchLimits { score_min: RESPONSE_MIN, evaluations_max: EVALUATIONS_MAX, except: None };
        let older = &self.local_maps[0].field;
        older.search(&self.points, &window, &limits, &mut self.scratch).map(|peak| peak.pose)
    }

    fn refine(&mut self, cloud: &Cloud, guess: Pose2, expected: &PosePrediction) -> Option<TrackedPose> {
        self.stages.stage_started(Stage::Align);
        let references =
            self.recent.iter().map(|n| Reference { cloud: &n.cloud, frame_from_cloud: n.local_from_base });
        let accepted = Matrix3::from_diagonal(&expected.accepted().map(|variance| 1.0 / variance));
        let prior = Prior { pose: expected.pose, information: accepted };
        let fit = align(cloud, guess, references.clone(), Some(prior), &self.config.links);
        let free = strained(&fit, expected)
            .then(|| align(cloud, fit.frame_from_cloud, references.clone(), None, &self.config.links))
            .filter(|free| {
                free.overlap >= SLIP_OVERLAP_MIN
                    && widest_m(&free.information).is_some_and(|m| m < SLIP_WIDEST_M)
            });
        let slipped = free.is_some();
        let fit = free.unwrap_or(fit);
        if fit.overlap < self.config.tracking.overlap_min {
            return None;
        }
        let floor = Matrix3::from_diagonal(&Vector3::new(1e-4, 1e-4, 1e-5));
        let covariance = (fit.information_of_lines + accepted).try_inverse()? + floor;
        let degenerate = widest_m(&fit.information_of_lines)? > self.config.tracking.degenerate_sigma_m;
        let state = if degenerate { TrackingState::Degenerate } else { TrackingState::Tracking };
        Some(TrackedPose { local_from_base: fit.frame_from_cloud, covariance, state, slipped })
    }

    /// After wheels have slipped, odometry counts from where the scan says the robot is: what they
    /// counted in vain pulls no longer.
    pub(super) fn forget_slip(&mut self, found: &TrackedPose, odom_from_base: Option<Pose2>) {
        let (true, Some(node), Some(now)) = (found.slipped, self.recent.back(), odom_from_base) else {
            return;
        };
        let moved = node.local_from_base.between(found.local_from_base);
        self.node_odom_from_base = Some(now * moved.inverse());
        self.counts.slips += 1;
    }
}
