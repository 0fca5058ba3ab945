//! Scan matching against the local map: a correlative search around the prediction, then an alignment.

use super::motion::{OdometryStep, PosePrediction};
use crate::align::{Prior, Reference, ScanAlignment, align};
use crate::cloud::{Agreement, Cloud};
use crate::config::{SlamConfig, TrackingConfig};
use crate::likelihood_field::{LikelihoodField, SearchBuffers, SearchLimits, SearchWindow};
use crate::node::Node;
use crate::stages::{Stage, StageObserver};
use msg::{Pose2, TrackingState};
use nalgebra::{Matrix3, Vector3};
use std::collections::VecDeque;

/// The search window and the first window that needs no search span this many standard deviations.
const WINDOW_SIGMAS: f64 = 3.0;
/// A window smaller than this needs no search: the alignment converges from anywhere in it, metres and radians.
const SEARCH_MIN_M: f64 = 0.12;
const SEARCH_MIN_RAD: f64 = 0.06;
/// Mean field value under a good match, 0 to 1; less is not worth aligning.
const RESPONSE_MIN: f32 = 0.25;
/// Most evaluations of one search: about 2 ms.
const EVALUATIONS_MAX: usize = 12_000;
/// Score that a pose at the window's corner loses against the prediction.
const PREDICTION_WEIGHT: f32 = 0.1;
/// An alignment farther than this many standard deviations from the prediction contradicts odometry.
const SLIP_SIGMAS: f64 = 3.0;
/// Least share of a scan's points that fit for the scan to overrule odometry, 0 to 1.
const SLIP_OVERLAP_MIN: f32 = 0.7;
/// Largest standard deviation of the position, by the scan alone, for it to overrule odometry, metres.
const SLIP_SIGMA_MAX_M: f64 = 0.03;
/// Added before an information matrix is inverted, 1/m² and 1/rad²: a standard deviation of 30 m.
const REGULARISATION: f64 = 1e-3;
/// Variances that no pose is better known than: 1 cm and 3 mrad.
const COVARIANCE_FLOOR: [f64; 3] = [1e-4, 1e-4, 1e-5];
/// Share of compared points that, contradicted, shows that the robot is elsewhere, 0 to 1.
const BREAK_SHARE: f32 = 0.3;
/// Least number of contradicted points for that, counted in each of the newest scans that see through or are seen
/// through.
const BREAK_POINTS_MIN: usize = 40;

/// A place farther than this from a pose is another one, metres and radians.
const ELSEWHERE_M: f64 = 0.25;
const ELSEWHERE_RAD: f64 = 0.15;
/// A scan fits another place clearly better if its response there is this many times the response where it is, and so high at least. Of 36
/// generated runs in which a robot stood, 35 have at most 1.06 times the response elsewhere.
const CLEARLY_BETTER_FACTOR: f32 = 1.15;
const CLEARLY_BETTER_MIN: f32 = 0.6;

/// Largest contradicted share of a scan that fits, 0 to 1.
const FITS_SHARE_MAX: f32 = 0.15;
/// By how much more of a scan is contradicted where it clearly fits less, 0 to 1.
pub(super) const CLEARLY_SHARE: f32 = 0.1;

/// Standard deviation of a pose by odometry alone from which the robot is lost, metres: beyond, it does not find the door that
/// it drives to.
const OPEN_FLOOR_SIGMA_MAX_M: f64 = 0.5;

/// Result of matching a scan.
pub(super) struct TrackedPose {
    pub local_from_base: Pose2,
    pub covariance: Matrix3<f64>,
    pub state: TrackingState,
    /// Whether the scan fits the local map, or sees nothing that could fit.
    pub is_tracked: bool,
    /// Whether the scan clearly contradicts odometry.
    pub slipped: bool,
    /// Standard deviation in the direction that the scan leaves open most, metres; infinite if it fits nothing.
    pub worst_position_sigma_m: f64,
}

/// Surfaces of some newest nodes as a field to search in.
pub(super) struct LocalMap {
    pub field: LikelihoodField,
    pub nodes: usize,
}

impl LocalMap {
    fn new(config: &TrackingConfig) -> Self {
        let field = LikelihoodField::new(config.cell_m, config.local_map_reach_m, config.blur_m);
        Self { field, nodes: 0 }
    }
}

/// The newest scans, as references to align with and as fields to search in.
pub(super) struct ScanMatcher {
    /// Reference scans, newest at the back: the newest nodes, and scans that could not be published as nodes.
    pub references: VecDeque<Node>,
    /// Two maps that overlap by half: the older one is searched.
    pub local_maps: [LocalMap; 2],
    buffers: SearchBuffers,
    points: Vec<[f32; 2]>,
}

impl ScanMatcher {
    pub fn new(config: &TrackingConfig) -> Self {
        let c = config;
        Self {
            references: VecDeque::with_capacity(c.references + 1),
            local_maps: [LocalMap::new(c), LocalMap::new(c)],
            buffers: SearchBuffers::with_capacity(
                c.search_points_max,
                c.window_max_m,
                c.window_max_rad,
                c.cell_m,
            ),
            points: Vec::with_capacity(c.search_points_max),
        }
    }

    /// Matches a scan around its predicted pose. `after_loss`: the scan before did not fit, so that a
    /// fit must not be contradicted: a scan that does not fit may fit elsewhere by chance.
    pub fn match_scan(
        &mut self,
        cloud: &Cloud,
        prediction: &PosePrediction,
        after_loss: bool,
        config: &SlamConfig,
        stages: &mut dyn StageObserver,
    ) -> TrackedPose {
        let predicted = TrackedPose {
            local_from_base: prediction.pose,
            covariance: prediction.covariance(),
            state: TrackingState::Lost,
            is_tracked: false,
            slipped: false,
            worst_position_sigma_m: f64::INFINITY,
        };
        if self.references.is_empty() {
            let state = TrackingState::Starting;
            return TrackedPose { state, is_tracked: true, worst_position_sigma_m: 0.0, ..predicted };
        }
        if cloud.points().len() < config.tracking.points_min {
            let state = state_by_odometry(prediction);
            return TrackedPose { state, is_tracked: state != TrackingState::Lost, ..predicted };
        }
        let half = [WINDOW_SIGMAS * prediction.sigma_m, WINDOW_SIGMAS * prediction.sigma_rad];
        let narrow = half[0] <= SEARCH_MIN_M && half[1] <= SEARCH_MIN_RAD;
        let direct =
            if narrow { self.align(cloud, prediction.pose, prediction, config, stages) } else { None };
        let matched = direct.or_else(|| {
            let guess = self.search(cloud, prediction.pose, half, &config.tracking, stages)?;
            self.align(cloud, guess, prediction, config, stages)
        });
        let matched =
            matched.filter(|matched| !after_loss || !self.contradicts(cloud, matched.local_from_base));
        // What shows something else than the local map has may be new ground: odometry may well be right.
        matched.unwrap_or_else(|| match self.contradicts(cloud, prediction.pose) {
            true => predicted,
            false => TrackedPose { state: state_by_odometry(prediction), ..predicted },
        })
    }

    /// Whether a scan fits another place of the older local map clearly better than this one: within the search window of tracking.
    pub fn fits_elsewhere(&mut self, cloud: &Cloud, local_from_base: Pose2, config: &TrackingConfig) -> bool {
        self.sample_points(cloud, config);
        let here = SearchWindow {
            centre: local_from_base,
            half_m: SEARCH_MIN_M,
            half_rad: SEARCH_MIN_RAD,
            prediction_weight: 0.0,
        };
        let elsewhere = SearchWindow { half_m: config.window_max_m, half_rad: config.window_max_rad, ..here };
        let limits = SearchLimits { score_min: 0.0, evaluations_max: EVALUATIONS_MAX, excluded: None };
        let older = &self.local_maps[0].field;
        let response = older.search(&self.points, &here, &limits, &mut self.buffers).peak;
        let limits = SearchLimits {
            score_min: response
                .map_or(0.0, |peak| CLEARLY_BETTER_FACTOR * peak.score)
                .max(CLEARLY_BETTER_MIN),
            excluded: Some((local_from_base, ELSEWHERE_M, ELSEWHERE_RAD)),
            ..limits
        };
        older.search(&self.points, &elsewhere, &limits, &mut self.buffers).peak.is_some()
    }

    /// Chooses the points of a scan that a search looks at.
    fn sample_points(&mut self, cloud: &Cloud, config: &TrackingConfig) {
        let stride = cloud.points().len().div_ceil(config.search_points_max).max(1);
        self.points.clear();
        self.points.extend(cloud.points().iter().step_by(stride).map(|p| p.at));
    }

    /// The best pose of the window in the older local map.
    fn search(
        &mut self,
        cloud: &Cloud,
        centre: Pose2,
        [half_m, half_rad]: [f64; 2],
        config: &TrackingConfig,
        stages: &mut dyn StageObserver,
    ) -> Option<Pose2> {
        stages.stage_started(Stage::Search);
        self.sample_points(cloud, config);
        let window = SearchWindow {
            centre,
            half_m: half_m.clamp(SEARCH_MIN_M, config.window_max_m),
            half_rad: half_rad.clamp(SEARCH_MIN_RAD, config.window_max_rad),
            prediction_weight: PREDICTION_WEIGHT,
        };
        let limits =
            SearchLimits { score_min: RESPONSE_MIN, evaluations_max: EVALUATIONS_MAX, excluded: None };
        let older = &self.local_maps[0].field;
        older.search(&self.points, &window, &limits, &mut self.buffers).peak.map(|peak| peak.pose)
    }

    /// Aligns the scan with the references, with the prediction as a prior unless the scan clearly contradicts it.
    fn align(
        &self,
        cloud: &Cloud,
        guess: Pose2,
        prediction: &PosePrediction,
        config: &SlamConfig,
        stages: &mut dyn StageObserver,
    ) -> Option<TrackedPose> {
        stages.stage_started(Stage::Align);
        let references = self
            .references
            .iter()
            .map(|node| Reference { cloud: &node.cloud, frame_from_cloud: node.local_from_base });
        let information = Matrix3::from_diagonal(&prediction.variances().map(|variance| 1.0 / variance));
        let prior = Prior { pose: prediction.pose, information };
        let fit = align(cloud, guess, references.clone(), Some(prior), &config.alignment);
        let without_prior = contradicts_odometry(&fit, prediction)
            .then(|| align(cloud, fit.frame_from_cloud, references.clone(), None, &config.alignment))
            .filter(|free| {
                free.overlap >= SLIP_OVERLAP_MIN
                    && largest_sigma_m(&free.information).is_some_and(|m| m < SLIP_SIGMA_MAX_M)
            });
        let slipped = without_prior.is_some();
        let fit = without_prior.unwrap_or(fit);
        if fit.overlap < config.tracking.overlap_min {
            return None;
        }
        let floor = Matrix3::from_diagonal(&Vector3::from(COVARIANCE_FLOOR));
        let covariance = (fit.information_without_noise + information).try_inverse()? + floor;
        let worst_position_sigma_m = largest_sigma_m(&fit.information_without_noise)?;
        let degenerate = worst_position_sigma_m > config.tracking.degenerate_sigma_m;
        let state = if degenerate { TrackingState::Degenerate } else { TrackingState::Tracking };
        let local_from_base = fit.frame_from_cloud;
        Some(TrackedPose {
            local_from_base,
            covariance,
            state,
            is_tracked: true,
            slipped,
            worst_position_sigma_m,
        })
    }

    /// Whether a scan placed here and the reference scans see through what the other one saw, so that the
    /// robot is elsewhere. Where they only look at different things, odometry may well be right.
    pub fn contradicts(&self, cloud: &Cloud, local_from_base: Pose2) -> bool {
        self.agreement(cloud, local_from_base).is_contradicted(BREAK_SHARE, BREAK_POINTS_MIN)
    }

    /// Points of a scan placed here and of the reference scans, compared with each other.
    fn agreement(&self, cloud: &Cloud, local_from_base: Pose2) -> Agreement {
        let mut agreement = Agreement::default();
        for node in &self.references {
            let node_from_base = node.local_from_base.between(local_from_base);
            agreement += Agreement::both_ways(&node.cloud, cloud, node_from_base);
        }
        agreement
    }

    /// Share of a scan's compared points that the references contradict, 0 to 1.
    pub fn contradicted_share(&self, cloud: &Cloud, pose: &TrackedPose) -> f32 {
        let found = self.agreement(cloud, pose.local_from_base);
        found.contradict as f32 / (found.agree + found.contradict).max(1) as f32
    }

    /// Whether the newest reference saw nothing, so that its pose is one by odometry.
    pub fn newest_saw_nothing(&self, config: &TrackingConfig) -> bool {
        self.references.back().is_some_and(|newest| newest.cloud.points().len() < config.points_min)
    }

    /// Adds a scan to the references and to the local maps; with `restart` the local maps begin again with it.
    pub fn add_reference(&mut self, node: Node, restart: bool, config: &TrackingConfig) {
        if restart {
            self.references.clear();
        }
        self.extend_local_maps(&node, restart, config.local_map_nodes);
        if self.references.len() == config.references {
            self.references.pop_front();
        }
        self.references.push_back(node);
    }

    /// Two local maps overlap: the older one is matched against, the younger one grows to replace it.
    fn extend_local_maps(&mut self, node: &Node, restart: bool, size: usize) {
        let centre = [node.local_from_base.x_m, node.local_from_base.y_m];
        let [older, younger] = &mut self.local_maps;
        if older.nodes == 0 || restart {
            older.field.clear(centre);
            older.nodes = 0;
            younger.nodes = 0;
        } else if older.nodes >= size {
            core::mem::swap(older, younger);
            younger.nodes = 0;
        }
        older.field.insert(&node.cloud, node.local_from_base);
        older.nodes += 1;
        if older.nodes > size / 2 {
            if younger.nodes == 0 {
                younger.field.clear(centre);
            }
            younger.field.insert(&node.cloud, node.local_from_base);
            younger.nodes += 1;
        }
    }

    /// Rebuilds references and local maps from the newest nodes of a session: as many as each had.
    pub fn restore(
        &mut self,
        newest: &[Node],
        references: u32,
        local_maps: [u32; 2],
        config: &TrackingConfig,
    ) {
        let last_of = |count: u32| &newest[newest.len().saturating_sub(count as usize)..];
        for (map, count) in self.local_maps.iter_mut().zip(local_maps) {
            let nodes = last_of(count);
            if let Some(first) = nodes.first() {
                map.field.clear([first.local_from_base.x_m, first.local_from_base.y_m]);
            }
            nodes.iter().for_each(|node| map.field.insert(&node.cloud, node.local_from_base));
            map.nodes = nodes.len();
        }
        self.references.extend(last_of(references.min(config.references as u32)).iter().cloned());
    }
}

/// Whether a scan that was matched where odometry says, and without odometry, shows that odometry has jumped. Each match has the
/// share of the scan that the references contradict there.
pub(super) fn has_jumped(
    step: OdometryStep,
    (moved, by_odometry): (&TrackedPose, f32),
    (stood, without): (&TrackedPose, f32),
) -> bool {
    match step {
        OdometryStep::Motion => false,
        // Odometry is right only if the scan says so.
        OdometryStep::Jump => {
            let fits = moved.is_tracked && by_odometry < FITS_SHARE_MAX;
            !fits || (stood.is_tracked && by_odometry + CLEARLY_SHARE > without)
        }
        // Odometry is wrong only if the scan contradicts it. One that shows what it showed before proves nothing: a robot that
        // has turned by 90 degrees sees the same of a square room.
        OdometryStep::Unclear => {
            stood.is_tracked && without < FITS_SHARE_MAX && without + CLEARLY_SHARE < by_odometry
        }
    }
}

/// State of a scan that sees nothing, as on open floor, or nothing known: odometry tells the pose for a while, the scan no
/// direction of it.
fn state_by_odometry(prediction: &PosePrediction) -> TrackingState {
    let covariance = prediction.covariance();
    let position = covariance.fixed_view::<2, 2>(0, 0).into_owned();
    let sigma_m = position.symmetric_eigenvalues().max().sqrt();
    if prediction.allows_dead_reckoning && sigma_m < OPEN_FLOOR_SIGMA_MAX_M {
        TrackingState::Degenerate
    } else {
        TrackingState::Lost
    }
}

fn contradicts_odometry(fit: &ScanAlignment, prediction: &PosePrediction) -> bool {
    let off = prediction.pose.between(fit.frame_from_cloud);
    off.x_m.hypot(off.y_m) > SLIP_SIGMAS * prediction.sigma_m
        || off.yaw_rad.abs() > SLIP_SIGMAS * prediction.sigma_rad
}

/// Standard deviation of the position in its least certain direction, from the points alone, metres.
fn largest_sigma_m(information: &Matrix3<f64>) -> Option<f64> {
    let covariance = (information + Matrix3::identity() * REGULARISATION).try_inverse()?;
    Some(covariance.fixed_view::<2, 2>(0, 0).into_owned().symmetric_eigenvalues().max().sqrt())
}
