//! The scan path: one scan in, one pose out, in bounded time. It matches against local maps of
//! the newest nodes in a frame of its own that never jumps; what the back end finds out about the
//! past only moves that frame in the map.

mod deskew;

use crate::align::{Alignment, Prior, Reference, align};
use crate::cloud::Cloud;
use crate::config::SlamConfig;
use crate::field::{Field, Limits, Scratch, Window};
use crate::node::{Node, Revision};
use crate::odometry::OdometryBuffer;
use crate::pool::Pool;
use crate::stage::{Stage, StageWatch};
use crate::sweep::{Sweep, part};
use msg::{Correction, Odometry, Pose2, Scan, Stamp, TrackingState};
use nalgebra::{Matrix3, Vector3};
use std::collections::VecDeque;
use std::sync::Arc;

/// Revisions that wait for their node.
const REVISIONS_MAX: usize = 64;
/// A window smaller than this needs no search: the alignment finds the way.
const SEARCH_MIN_M: f64 = 0.12;
const SEARCH_MIN_RAD: f64 = 0.06;
/// Field values under a good match; less is not worth aligning.
const RESPONSE_MIN: f32 = 0.25;
/// Evaluations one search of the scan path may cost.
const EVALUATIONS_MAX: usize = 12_000;
/// The last motion says nothing after more than this, seconds.
const CARRIED_MAX_S: f64 = 0.5;
/// Nor over more than so many times the interval it was seen in.
const CARRIED_TIMES_MAX: f64 = 3.0;
/// How strongly the search prefers what odometry says.
const PULL: f32 = 0.1;

/// Why a scan was not used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// Its stamp is that of the scan before.
    #[error("the scan has the stamp of the one before")]
    StampRepeated,
    /// Its stamp is before that of the scan before.
    #[error("the scan is stamped before the one before it")]
    StampWentBack,
    /// It has no beam, or more than [`msg::BEAMS_MAX`].
    #[error("the scan has no beams or too many")]
    BeamCount,
    /// Its angles or range limits are not usable numbers.
    #[error("the scan's angles or range limits are not usable numbers")]
    Geometry,
}

/// How many scans went which way.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Scans that got a pose.
    pub accepted: u64,
    /// See [`Refusal::StampRepeated`].
    pub stamp_repeated: u64,
    /// See [`Refusal::StampWentBack`].
    pub stamp_went_back: u64,
    /// See [`Refusal::BeamCount`].
    pub beam_count: u64,
    /// See [`Refusal::Geometry`].
    pub geometry: u64,
    /// Scans that did not fit the map, or saw too little to tell.
    pub lost: u64,
    /// Odometry messages that were no numbers or not newer than the last.
    pub odometry_refused: u64,
    /// Scans that contradicted odometry so clearly that they were believed alone.
    pub slips: u64,
    /// Poses not remembered because the trajectory was full.
    pub trajectory_dropped: u64,
    /// Scans that should have become nodes while too many were under way: they served the scan path alone.
    pub nodes_held_back: u64,
    /// Scans whose beams' times could not be made good: the times cannot be, or the motion is not known.
    pub not_deskewed: u64,
}

/// A pose this many standard deviations from where odometry has it is strained.
const SLIP_SIGMAS: f64 = 3.0;
/// To be believed against odometry, so much of a scan must fit ...
const SLIP_OVERLAP_MIN: f32 = 0.7;
/// ... and leave no direction more unsure than this by itself, metres.
const SLIP_WIDEST_M: f64 = 0.03;

/// Goes on for `ahead_s` as in the `motion` that took `before_s`; not far beyond it.
fn carried(motion: Pose2, before_s: f64, ahead_s: f64) -> Pose2 {
    part(motion, (ahead_s / before_s).min(CARRIED_TIMES_MAX))
}

fn strained(fit: &Alignment, expected: &Expected) -> bool {
    let off = expected.pose.between(fit.frame_from_cloud);
    off.x_m.hypot(off.y_m) > SLIP_SIGMAS * expected.sigma_m
        || off.yaw_rad.abs() > SLIP_SIGMAS * expected.sigma_rad
}

/// The answer to one scan.
#[derive(Clone, Debug)]
pub struct Step {
    /// Where the robot is. Of a refused scan: the last pose.
    pub correction: Correction,
    /// Set if the scan was not used.
    pub refused: Option<Refusal>,
    /// Set if the scan entered the pose graph: for the back end. ([`crate::Slam`] keeps it.)
    pub node: Option<Node>,
    /// The id of the node that the scan became.
    pub made_node: Option<u32>,
}

/// An accepted scan rides on the newest node.
#[derive(Clone, Copy, Debug)]
pub struct Ride {
    /// The scan's.
    pub stamp: Stamp,
    /// Which node.
    pub node: u32,
    /// The robot as seen from its node.
    pub node_from_base: Pose2,
}

/// The scan before.
#[derive(Clone, Copy, Debug)]
pub struct Last {
    /// Its stamp.
    pub stamp: Stamp,
    /// The robot's pose.
    pub local_from_base: Pose2,
    /// Odometry's, if it was known.
    pub odom_from_base: Option<Pose2>,
    /// Motion over the last interval, and its length in seconds, for logs without odometry.
    pub motion: Option<(Pose2, f64)>,
    /// Of the pose.
    pub covariance: Matrix3<f64>,
}

/// Where the scan path is, to be kept. Its local maps are not in it: they are drawn again from the
/// newest nodes, which the map keeps anyway.
#[derive(Clone, Debug)]
pub struct FrontState {
    /// The next node's number.
    pub next_node: u32,
    /// How many of the newest nodes refine poses.
    pub recent: u32,
    /// How many of the newest nodes are in the older and in the younger local map.
    pub local_maps: [u32; 2],
    /// Scans in a row that did not fit.
    pub lost_in_row: u32,
    /// Closures in force, as last heard.
    pub closures: u32,
    /// Whether `map_from_local` is known.
    pub located: bool,
    /// The loop-closed map from the scan path's frame.
    pub map_from_local: Pose2,
    /// Odometry from the newest node handed over to the newest scan matched against.
    pub handed_from_recent: Option<Pose2>,
    /// Odometry at the newest node.
    pub node_odom_from_base: Option<Pose2>,
    /// The scan before.
    pub last: Option<Last>,
    /// How many scans went which way.
    pub counts: Counts,
    /// Revisions that wait for their node.
    pub waiting: Vec<Revision>,
    /// The newest odometry.
    pub odometry: Vec<Odometry>,
    /// Its frame, see [`crate::odometry`].
    pub continuous_from_odom: Pose2,
    /// Messages refused.
    pub odometry_refused: u64,
}

/// What the scan path knows before it looks at a scan.
struct Expected {
    pose: Pose2,
    sigma_m: f64,
    sigma_rad: f64,
}

struct Found {
    local_from_base: Pose2,
    covariance: Matrix3<f64>,
    state: TrackingState,
    /// The scan says, clearly, that the wheels did not do what they counted.
    slipped: bool,
}

/// See the module.
pub struct Front {
    config: SlamConfig,
    odometry: OdometryBuffer,
    last: Option<Last>,
    /// Odometry at the newest node, if it has not jumped since.
    node_odom_from_base: Option<Pose2>,
    /// Newest scans to match against, newest at the back: the newest nodes, and scans held back.
    recent: VecDeque<Node>,
    next_node: u32,
    /// The newest node handed over, and where it is.
    handed: Option<(u32, Pose2)>,
    /// Odometry from it to the newest of `recent`.
    handed_from_recent: Option<Pose2>,
    pool: Pool,
    local_maps: [LocalMap; 2],
    lost_in_row: u32,
    node_wanted: bool,
    scratch: Scratch,
    points: Vec<[f32; 2]>,
    map_from_local: Pose2,
    /// Whether `map_from_local` is known: where the robot is in its map.
    located: bool,
    closures: u32,
    waiting: VecDeque<Revision>,
    rides: Vec<Ride>,
    counts: Counts,
    watch: Box<dyn StageWatch>,
}

/// Surfaces of some newest nodes as a field to search in.
struct LocalMap {
    field: Field,
    nodes: usize,
}

impl Front {
    /// Ready for the first scan.
    pub fn new(config: SlamConfig) -> Self {
        let t = &config.tracking;
        let local_map = || LocalMap { field: Field::new(t.cell_m, t.local_map_reach_m, t.blur_m), nodes: 0 };
        Self {
            odometry: OdometryBuffer::new(config.odometry.clone()),
            last: None,
            node_odom_from_base: None,
            recent: VecDeque::with_capacity(t.references + 1),
            next_node: 0,
            handed: None,
            handed_from_recent: Some(Pose2::IDENTITY),
            pool: Pool::new(&config),
            local_maps: [local_map(), local_map()],
            lost_in_row: 0,
            node_wanted: false,
            scratch: Scratch::with_room(t.search_points_max, t.window_max_m, t.window_max_rad, t.cell_m),
            points: Vec::with_capacity(t.search_points_max),
            map_from_local: Pose2::IDENTITY,
            located: true,
            closures: 0,
            waiting: VecDeque::with_capacity(REVISIONS_MAX),
            // The system gives the memory as it is used.
            rides: Vec::with_capacity(config.graph.trajectory_max),
            counts: Counts::default(),
            watch: Box::new(()),
            config,
        }
    }

    /// Goes on where a scan path was when it gave [`Front::state`]. `newest` are the map's newest
    /// nodes, in order: as many as the state speaks of.
    pub fn resume(config: SlamConfig, state: FrontState, newest: &[Node]) -> Self {
        let mut front = Self::new(config);
        let last_of = |count: u32| &newest[newest.len().saturating_sub(count as usize)..];
        for (map, count) in front.local_maps.iter_mut().zip(state.local_maps) {
            let nodes = last_of(count);
            if let Some(first) = nodes.first() {
                map.field.clear([first.local_from_base.x_m, first.local_from_base.y_m]);
            }
            nodes.iter().for_each(|node| map.field.insert(&node.cloud, node.local_from_base));
            map.nodes = nodes.len();
        }
        let references = front.config.tracking.references as u32;
        front.recent.extend(last_of(state.recent.min(references)).iter().cloned());
        let odometry = front.config.odometry.clone();
        front.odometry = OdometryBuffer::from_parts(
            odometry,
            &state.odometry,
            state.continuous_from_odom,
            state.odometry_refused,
        );
        front.waiting.extend(state.waiting.into_iter().take(REVISIONS_MAX));
        (front.next_node, front.lost_in_row) = (state.next_node, state.lost_in_row);
        (front.map_from_local, front.located) = (state.map_from_local, state.located);
        front.handed = newest.last().map(|node| (state.next_node.saturating_sub(1), node.local_from_base));
        front.handed_from_recent = state.handed_from_recent;
        (front.node_odom_from_base, front.last) = (state.node_odom_from_base, state.last);
        (front.counts, front.closures) = (state.counts, state.closures);
        front
    }

    /// Where the scan path is. It costs a copy of the odometry buffer.
    pub fn state(&self) -> FrontState {
        let (odometry, continuous_from_odom, odometry_refused) = self.odometry.parts();
        FrontState {
            next_node: self.next_node,
            recent: self.recent.len() as u32,
            local_maps: [0, 1].map(|k: usize| self.local_maps[k].nodes as u32),
            lost_in_row: self.lost_in_row,
            closures: self.closures,
            located: self.located,
            map_from_local: self.map_from_local,
            handed_from_recent: self.handed_from_recent,
            node_odom_from_base: self.node_odom_from_base,
            last: self.last,
            counts: self.counts,
            waiting: self.waiting.iter().copied().collect(),
            odometry,
            continuous_from_odom,
            odometry_refused,
        }
    }

    /// The robot in the scan path's own frame, at the last scan.
    pub fn local_from_base(&self) -> Pose2 {
        self.last.map_or(Pose2::IDENTITY, |last| last.local_from_base)
    }

    /// Whether it is known where the robot is in its map.
    pub fn located(&self) -> bool {
        self.located
    }

    /// Says where the scan path's frame lies in the map, or that it is not known; revisions say it later.
    pub fn place(&mut self, map_from_local: Option<Pose2>) {
        self.located = map_from_local.is_some();
        self.map_from_local = map_from_local.unwrap_or(self.map_from_local);
        self.waiting.clear();
    }

    /// The next scan that fits becomes a node, even if the robot stands: somebody waits for one.
    pub fn want_node(&mut self) {
        self.node_wanted = true;
    }

    /// From now on this watch hears of every stage.
    pub fn watch(&mut self, watch: Box<dyn StageWatch>) {
        self.watch = watch;
    }

    /// Takes one odometry message.
    pub fn odometry(&mut self, odometry: &Odometry) {
        self.odometry.push(odometry);
        self.counts.odometry_refused = self.odometry.refused();
    }

    /// Takes the back end's answer to an earlier node.
    pub fn revise(&mut self, revision: Revision) {
        if self.waiting.len() == REVISIONS_MAX {
            self.waiting.pop_front();
        }
        self.waiting.push_back(revision);
    }

    /// Every accepted scan, in order.
    pub fn rides(&self) -> &[Ride] {
        &self.rides
    }

    /// How many scans went which way.
    pub fn counts(&self) -> Counts {
        self.counts
    }

    /// One scan in, one pose out.
    pub fn process(&mut self, scan: &Scan) -> Step {
        if let Some(refusal) = self.refuse(scan) {
            return self.refused(scan, refusal);
        }
        let odom_from_base = self.odometry.at(scan.header.stamp);
        let expected = self.expect(scan.header.stamp, odom_from_base);
        let (sweep, cloud, found) = self.look(scan, &expected, odom_from_base);
        self.forget_slip(&found, odom_from_base);
        self.watch.begins(Stage::Node);
        let due = self.node_due(&found, &cloud);
        let node = if due { self.make_node((scan, &sweep), &found, odom_from_base, cloud) } else { None };
        self.remember(scan.header.stamp, &found, odom_from_base);
        let correction = self.correction(scan, &found, odom_from_base);
        self.watch.begins(Stage::Idle);
        Step { correction, refused: None, made_node: node.as_ref().map(|n| n.id), node }
    }

    fn refuse(&self, scan: &Scan) -> Option<Refusal> {
        let len = scan.len as usize;
        let usable = scan.angle_min_rad.is_finite()
            && scan.angle_increment_rad.is_finite()
            && scan.angle_increment_rad.abs() <= 7.0
            && scan.angle_min_rad.abs() <= 100.0
            && scan.range_min_m >= 0.0
            && scan.range_max_m > scan.range_min_m;
        match self.last {
            _ if len == 0 || len > msg::BEAMS_MAX => Some(Refusal::BeamCount),
            _ if !usable => Some(Refusal::Geometry),
            Some(last) if scan.header.stamp == last.stamp => Some(Refusal::StampRepeated),
            Some(last) if scan.header.stamp < last.stamp => Some(Refusal::StampWentBack),
            _ => None,
        }
    }

    fn refused(&mut self, scan: &Scan, refusal: Refusal) -> Step {
        *match refusal {
            Refusal::StampRepeated => &mut self.counts.stamp_repeated,
            Refusal::StampWentBack => &mut self.counts.stamp_went_back,
            Refusal::BeamCount => &mut self.counts.beam_count,
            Refusal::Geometry => &mut self.counts.geometry,
        } += 1;
        let last = self.last;
        let found = Found {
            local_from_base: last.map_or(Pose2::IDENTITY, |l| l.local_from_base),
            covariance: last.map_or(Matrix3::zeros(), |l| l.covariance),
            state: if last.is_some() { TrackingState::Lost } else { TrackingState::Starting },
            slipped: false,
        };
        let correction = self.correction(scan, &found, last.and_then(|l| l.odom_from_base));
        Step { correction, refused: Some(refusal), node: None, made_node: None }
    }

    /// Where the robot should be by odometry, or by its last motion, and how sure that is.
    fn expect(&mut self, stamp: Stamp, odom_from_base: Option<Pose2>) -> Expected {
        let Some(last) = &self.last else {
            return Expected { pose: Pose2::IDENTITY, sigma_m: 0.0, sigma_rad: 0.0 };
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
            return Expected { pose: node.local_from_base * moved, sigma_m, sigma_rad };
        }
        let moving = last.motion.filter(|_| interval_s < CARRIED_MAX_S);
        let step = moving.map_or(Pose2::IDENTITY, |(motion, before_s)| carried(motion, before_s, interval_s));
        Expected {
            pose: last.local_from_base * step,
            sigma_m: 0.3 * c.speed_max_m_s * interval_s + c.sigma_m,
            sigma_rad: 0.3 * c.turn_max_rad_s * interval_s + c.sigma_rad,
        }
    }

    /// Matches the scan against the local map: search, then alignment.
    fn locate(&mut self, cloud: &Cloud, expected: &Expected) -> Found {
        let t = &self.config.tracking;
        let believed = Matrix3::from_diagonal(&Vector3::new(
            expected.sigma_m.powi(2),
            expected.sigma_m.powi(2),
            expected.sigma_rad.powi(2),
        ));
        let dead_reckoned = Found {
            local_from_base: expected.pose,
            covariance: self.last.map_or(Matrix3::zeros(), |l| l.covariance) + believed,
            state: TrackingState::Lost,
            slipped: false,
        };
        if self.recent.is_empty() {
            return Found { state: TrackingState::Starting, ..dead_reckoned };
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
        found.unwrap_or(dead_reckoned)
    }

    fn search(&mut self, cloud: &Cloud, expected: &Expected, half_m: f64, half_rad: f64) -> Option<Pose2> {
        self.watch.begins(Stage::Search);
        let t = &self.config.tracking;
        let stride = cloud.points().len().div_ceil(t.search_points_max).max(1);
        self.points.clear();
        self.points.extend(cloud.points().iter().step_by(stride).map(|p| p.at));
        let window = Window {
            centre: expected.pose,
            half_m: half_m.clamp(SEARCH_MIN_M, t.window_max_m),
            half_rad: half_rad.clamp(SEARCH_MIN_RAD, t.window_max_rad),
            pull: PULL,
        };
        let limits = Limits { score_min: RESPONSE_MIN, evaluations_max: EVALUATIONS_MAX, except: None };
        let older = &self.local_maps[0].field;
        older.search(&self.points, &window, &limits, &mut self.scratch).map(|peak| peak.pose)
    }

    fn refine(&mut self, cloud: &Cloud, guess: Pose2, expected: &Expected) -> Option<Found> {
        self.watch.begins(Stage::Align);
        let references =
            self.recent.iter().map(|n| Reference { cloud: &n.cloud, frame_from_cloud: n.local_from_base });
        let inverse = |sigma: f64| 1.0 / (sigma * sigma);
        let (m, rad) = (inverse(expected.sigma_m), inverse(expected.sigma_rad));
        let believed = Matrix3::from_diagonal(&Vector3::new(m, m, rad));
        let prior = Prior { pose: expected.pose, information: believed };
        let fit = align(cloud, guess, references.clone(), Some(prior), &self.config.links);
        let free = strained(&fit, expected)
            .then(|| align(cloud, fit.frame_from_cloud, references.clone(), None, &self.config.links))
            .filter(|free| {
                free.overlap >= SLIP_OVERLAP_MIN && self.widest_m(free).is_some_and(|m| m < SLIP_WIDEST_M)
            });
        let slipped = free.is_some();
        let fit = free.unwrap_or(fit);
        if fit.overlap < self.config.tracking.overlap_min {
            return None;
        }
        let floor = Matrix3::from_diagonal(&Vector3::new(1e-4, 1e-4, 1e-5));
        let covariance = (fit.information + believed).try_inverse()? + floor;
        let degenerate = self.widest_m(&fit)? > self.config.tracking.degenerate_sigma_m;
        let state = if degenerate { TrackingState::Degenerate } else { TrackingState::Tracking };
        Some(Found { local_from_base: fit.frame_from_cloud, covariance, state, slipped })
    }

    /// How unsure the scan alone leaves the worst known direction, one standard deviation, metres.
    fn widest_m(&self, fit: &Alignment) -> Option<f64> {
        let seen = (fit.information + Matrix3::identity() * 1e-3).try_inverse()?;
        Some(seen.fixed_view::<2, 2>(0, 0).into_owned().symmetric_eigenvalues().max().sqrt())
    }

    /// After wheels have slipped, odometry counts from where the scan says the robot is: what they
    /// counted in vain pulls no longer.
    fn forget_slip(&mut self, found: &Found, odom_from_base: Option<Pose2>) {
        let (true, Some(node), Some(now)) = (found.slipped, self.recent.back(), odom_from_base) else {
            return;
        };
        let moved = node.local_from_base.between(found.local_from_base);
        self.node_odom_from_base = Some(now * moved.inverse());
        self.counts.slips += 1;
    }

    fn node_due(&mut self, found: &Found, cloud: &Cloud) -> bool {
        let t = &self.config.tracking;
        if found.state == TrackingState::Lost {
            self.counts.lost += 1;
            // A scan that sees nothing is no reason to give up the local map.
            let blind = cloud.points().len() < t.points_min;
            self.lost_in_row += u32::from(!blind);
            if blind || self.lost_in_row < t.lost_scans_max {
                return false;
            }
        } else {
            self.lost_in_row = 0;
        }
        let Some(newest) = self.recent.back() else { return true };
        let moved = newest.local_from_base.between(found.local_from_base);
        let far = moved.x_m.hypot(moved.y_m) >= t.node_distance_m || moved.yaw_rad.abs() >= t.node_turn_rad;
        core::mem::take(&mut self.node_wanted) || far
    }

    /// The scan is matched against from now on, and handed over as a node if there is room.
    fn make_node(
        &mut self,
        (scan, sweep): (&Scan, &Sweep),
        found: &Found,
        odom: Option<Pose2>,
        cloud: Arc<Cloud>,
    ) -> Option<Node> {
        let fits = found.state != TrackingState::Lost;
        let moved = self.node_odom_from_base.zip(odom).map(|(before, now)| before.between(now));
        self.node_odom_from_base = odom;
        let node = Node {
            id: self.next_node,
            header: scan.header,
            local_from_base: found.local_from_base,
            previous_from_this: self.handed_from_recent.zip(moved).map(|(a, b)| a * b),
            fits,
            cloud,
            rays: self.pool.rays(scan, sweep, &self.config),
        };
        let has_room = self.pool.has_room(self.recent.len() + 1);
        if !fits {
            self.recent.clear();
            self.lost_in_row = 0;
        }
        self.extend_local_maps(&node, !fits);
        if self.recent.len() == self.config.tracking.references {
            self.recent.pop_front();
        }
        self.recent.push_back(node.clone());
        if !has_room {
            self.handed_from_recent = node.previous_from_this;
            self.counts.nodes_held_back += 1;
            return None;
        }
        self.next_node += 1;
        self.handed = Some((node.id, node.local_from_base));
        self.handed_from_recent = Some(Pose2::IDENTITY);
        self.apply_revisions(node.id);
        Some(node)
    }

    /// Two local maps overlap: the older one is matched against, the younger one grows to replace it.
    fn extend_local_maps(&mut self, node: &Node, anew: bool) {
        let size = self.config.tracking.local_map_nodes;
        let centre = [node.local_from_base.x_m, node.local_from_base.y_m];
        let [older, younger] = &mut self.local_maps;
        if older.nodes == 0 || anew {
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

    fn apply_revisions(&mut self, node: u32) {
        // The newest that is due; those before it are out of date.
        let Some(due) = self.waiting.iter().rposition(|r| r.effective_from <= node) else { return };
        for revision in self.waiting.drain(..=due) {
            self.map_from_local = revision.map_from_local;
            self.located = revision.located;
            self.closures = revision.closures;
        }
    }

    fn remember(&mut self, stamp: Stamp, found: &Found, odom_from_base: Option<Pose2>) {
        self.counts.accepted += 1;
        if let Some((node, local_from_node)) = self.handed {
            let node_from_base = local_from_node.between(found.local_from_base);
            if self.rides.len() < self.config.graph.trajectory_max {
                self.rides.push(Ride { stamp, node, node_from_base });
            } else {
                self.counts.trajectory_dropped += 1;
            }
        }
        let motion = self.last.map(|l| (l.local_from_base.between(found.local_from_base), stamp - l.stamp));
        self.last = Some(Last {
            stamp,
            local_from_base: found.local_from_base,
            odom_from_base,
            motion,
            covariance: found.covariance,
        });
    }

    fn correction(&self, scan: &Scan, found: &Found, odom_from_base: Option<Pose2>) -> Correction {
        let map_from_base = self.map_from_local * found.local_from_base;
        let (sin, cos) = self.map_from_local.yaw_rad.sin_cos();
        let turn = Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0);
        let c = turn * found.covariance * turn.transpose();
        let base_from_odom =
            odom_from_base.unwrap_or(Pose2::IDENTITY).inverse() * self.odometry.continuous_from_odom();
        Correction {
            header: msg::Header { stamp: scan.header.stamp, ..Default::default() },
            scan_seq: scan.header.seq,
            scan_sent: scan.header.sent,
            map_from_odom: map_from_base * base_from_odom,
            map_from_base,
            covariance: [c[(0, 0)], c[(0, 1)], c[(0, 2)], c[(1, 1)], c[(1, 2)], c[(2, 2)]],
            state: if self.located { found.state } else { TrackingState::Lost } as u32,
            nodes: self.next_node,
            closures: self.closures,
            reserved: 0,
        }
    }
}
