//! 2D SLAM of one robot: computes its poses and its map from laser scans and odometry.
//!
//! ```text
//!   scan, odometry                                     map
//!        │                                              ▲
//!        ▼            Node ───────────────▶             │
//!  FrontEnd (in bounded time)               BackEnd (links, closures, solver, map)
//!        │            ◀─────────────── MapFrameUpdate
//!        ▼
//!   ScanResult: pose estimate, covariance, state
//! ```
//!
//! [`FrontEnd`] answers every scan in bounded time and never waits for [`BackEnd`]. Both are plain values
//! that may live on different threads; [`Slam`] has both on one. What `BackEnd` computes depends on the
//! nodes alone, so the final trajectory and map are the same, bit for bit, wherever it runs.

pub mod align;
mod back_end;
mod beam_poses;
mod clock_reset;
mod closure;
mod cloud;
mod config;
mod encoding;
mod front_end;
mod graph;
mod likelihood_field;
mod limits;
mod localizer;
mod mapper;
mod node;
mod odometry;
mod odometry_agreement;
mod point_transform;
mod reliability;
mod relocalize;
mod scan_buffers;
pub mod session;
mod stages;
mod submap;
#[cfg(test)]
mod testing;
mod trajectory_error;

#[cfg(test)]
#[path = "../tests/common/mod.rs"]
mod common;

pub use back_end::{BackEnd, BackEndCounts, BackEndState, ClosureReport, InitialPose, PlaceInMap};
pub use beam_poses::BeamPoses;
pub use closure::ClosureSearchCounts;
pub use cloud::{Cloud, CloudScratch, SurfacePoint};
pub use config::*;
pub use front_end::{FrontEnd, FrontEndCounts, FrontEndState, ScanRejection, ScanResult, TrajectorySample};
pub use graph::{Edge, EdgeKind, Graph, PoseVariances, RelativeUncertainty, SystematicError};
pub use localizer::LocalizerCounts;
pub use mapper::OccupancyMapper;
pub use node::{FrameUncertainty, MapFrameUpdate, Node, Rays, SweptPath};
pub use odometry_agreement::OdometryAgreement;
pub use point_transform::PointTransform;
pub use reliability::ReliabilityEvidence;
pub use relocalize::{LocalFrameEstimate, RelocalizationCounts};
pub use scan_buffers::NODES_IN_FLIGHT_MAX;
pub use session::{Session, SessionError, SessionIdentity};
pub use stages::{Stage, StageObserver};
pub use submap::Submaps;
pub use trajectory_error::TrajectoryError;

use msg::{GridView, Odometry, Pose2, Scan, SlamMode, Stamp, TileMap};
use std::collections::VecDeque;

/// Nodes that wait for [`Slam::work`]; when they are more, [`Slam::process`] does the work itself.
const WAITING_MAX: usize = NODES_IN_FLIGHT_MAX - 2;

/// One robot's SLAM on one thread: a front end, and a back end that runs when asked to.
///
/// ```
/// use msg::{Pose2, Scan, Stamp};
/// use slam::{Slam, SlamConfig};
///
/// let mut slam = Slam::new(SlamConfig::default());
/// // A robot stands in the middle of a square room of 4 m and turns a LiDAR of 1°.
/// let mut scan: Box<Scan> = bytemuck::allocation::zeroed_box();
/// (scan.range_min_m, scan.range_max_m, scan.len) = (0.1, 10.0, 360);
/// scan.angle_increment_rad = 1_f32.to_radians();
/// for beam in 0..360 {
///     let (sin, cos) = scan.angle_rad(beam).sin_cos();
///     scan.ranges_m[beam] = 2.0 / sin.abs().max(cos.abs());
/// }
/// for tick in 1..=3 {
///     scan.header.stamp = Stamp::from_seconds(0.1 * f64::from(tick));
///     let result = slam.process(&scan);
///     assert!(result.pose_estimate.map_from_base.distance_m(Pose2::IDENTITY) < 0.01);
/// }
/// slam.finish();
/// assert_eq!(slam.trajectory().count(), 3);
/// assert!(slam.map().header.width >= 80);
/// ```
pub struct Slam {
    front: FrontEnd,
    back: BackEnd,
    waiting: VecDeque<Node>,
}

impl Slam {
    /// Ready for the first scan. The map's frame is where the robot then stands.
    pub fn new(config: SlamConfig) -> Self {
        let waiting = VecDeque::with_capacity(WAITING_MAX);
        Self { front: FrontEnd::new(config.clone()), back: BackEnd::new(config), waiting }
    }

    /// SLAM that resumes a session, or creates a map in a mode.
    pub fn create_or_resume(
        config: SlamConfig,
        session: Option<Session>,
        mode: SlamMode,
        initial_pose: InitialPose,
    ) -> Self {
        let (front, back) = create_or_resume(config, session, mode, initial_pose);
        Self { front, back, waiting: VecDeque::with_capacity(WAITING_MAX) }
    }

    /// A session to continue from later, after the waiting nodes were processed.
    pub fn session(&mut self, identity: SessionIdentity) -> Session {
        self.work();
        self.back.session(identity, Some(self.front.state()), self.front.samples())
    }

    /// Adds one odometry message.
    pub fn add_odometry(&mut self, odometry: &Odometry) {
        self.front.add_odometry(odometry);
        if self.front.take_unknown_motion() {
            self.back.start_relocalization(None);
        }
    }

    /// Processes one scan in the front end and returns the robot's pose. [`Slam::work`] updates earlier poses.
    pub fn process(&mut self, scan: &Scan) -> ScanResult {
        let mut result = self.front.process(scan);
        if let Some(node) = result.node.take() {
            if self.waiting.len() == WAITING_MAX {
                self.work();
            }
            self.waiting.push_back(node);
        }
        result
    }

    /// Processes all waiting nodes in the back end: links, closures, solutions. Returns their number.
    pub fn work(&mut self) -> usize {
        let count = self.waiting.len();
        while let Some(node) = self.waiting.pop_front() {
            let frame_update = self.back.add_node(node);
            self.front.add_frame_update(frame_update);
        }
        count
    }

    /// Processes all waiting nodes and solves with all that is known.
    pub fn finish(&mut self) {
        self.work();
        self.back.finish();
    }

    /// The map of all processed nodes as a grid, in frame `robotK/map`.
    pub fn map(&mut self) -> GridView<'_> {
        self.back.map()
    }

    /// The same map as tiles; nodes that moved by less than `map.redraw_m` are not drawn again.
    pub fn tiles(&mut self) -> &TileMap {
        while self.back.draw(usize::MAX) {}
        self.back.tiles()
    }

    /// Every accepted scan's stamp and `map_from_base`, as the graph has it now.
    pub fn trajectory(&self) -> impl Iterator<Item = (Stamp, Pose2)> + '_ {
        trajectory(&self.front, &self.back)
    }

    /// The same, with what is known of each place.
    pub fn trajectory_with_places(&self) -> impl Iterator<Item = (Stamp, Pose2, PlaceInMap)> + '_ {
        self.back.trajectory_with_places(self.front.samples())
    }

    /// Counts of scans by what became of them.
    pub fn counts(&self) -> FrontEndCounts {
        self.front.counts()
    }

    /// Counts of what the back end has done.
    pub fn back_counts(&self) -> BackEndCounts {
        self.back.counts()
    }

    /// The back end.
    pub fn back(&self) -> &BackEnd {
        &self.back
    }

    /// The back end, for changes such as undoing closures.
    pub fn back_mut(&mut self) -> &mut BackEnd {
        &mut self.back
    }

    /// The two halves, to be run on different threads.
    pub fn split(self) -> (FrontEnd, BackEnd) {
        (self.front, self.back)
    }
}

/// Every accepted scan's stamp and `map_from_base`: scans between nodes move with their node.
pub fn trajectory<'a>(front: &'a FrontEnd, back: &'a BackEnd) -> impl Iterator<Item = (Stamp, Pose2)> + 'a {
    back.trajectory(front.samples())
}

/// A front end and a back end that resume a session, or create a map.
pub fn create_or_resume(
    config: SlamConfig,
    session: Option<Session>,
    mode: SlamMode,
    initial_pose: InitialPose,
) -> (FrontEnd, BackEnd) {
    let Some(session) = session else {
        let mut back = BackEnd::new(config.clone());
        back.set_mode(mode);
        return (FrontEnd::new(config), back);
    };
    match (initial_pose, session.front) {
        (InitialPose::Continue, Some(state)) => {
            let mut front = FrontEnd::resume(config.clone(), state, &session.back.nodes);
            let back = BackEnd::resume(config, session.back, session.samples, mode, initial_pose);
            // A session does not keep it; the pose of the front end's frame is the session's, to the last bit.
            front.restore_quality(back.latest_frame_update());
            (front, back)
        }
        (initial_pose, _) => {
            let empty = session.back.nodes.is_empty().then_some(Pose2::IDENTITY);
            let mut front = FrontEnd::new(config.clone());
            match initial_pose {
                InitialPose::Near(estimate) if empty.is_none() => front.set_initial_estimate(estimate),
                InitialPose::Near(estimate) => front.set_map_from_local(Some(estimate.map_from_local)),
                InitialPose::Continue | InitialPose::Unknown => front.set_map_from_local(empty),
            }
            let initial_pose = match initial_pose {
                InitialPose::Continue => InitialPose::Unknown,
                initial_pose => initial_pose,
            };
            (front, BackEnd::resume(config, session.back, session.samples, mode, initial_pose))
        }
    }
}
