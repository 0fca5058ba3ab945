//! Scans in, one robot's poses and map out.
//!
//! ```text
//!   scan, odometry                                     map
//!        │                                              ▲
//!        ▼            Node ───────────────▶             │
//!  Front (scan path)                        Back (beside it: links, closures, solver, mapper)
//!        │            ◀─────────────── Revision
//!        ▼
//!   Step: correction, covariance, state
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
mod front_end;
mod graph;
mod likelihood_field;
mod localizer;
mod mapper;
mod node;
mod odometry;
mod relocalize;
mod scan_buffers;
pub mod session;
mod stages;
mod submap;

pub use back_end::{BackEnd, BackEndCounts, BackEndState, ClosureReport, InitialPose};
pub use beam_poses::BeamPoses;
pub use closure::ClosureSearchCounts;
pub use cloud::{Cloud, CloudScratch, PointTransform, SurfacePoint};
pub use config::*;
pub use front_end::{FrontEnd, FrontEndCounts, FrontEndState, ScanRejection, ScanResult, TrajectorySample};
pub use graph::{Edge, EdgeKind, Graph, RelativeUncertainty};
pub use localizer::LocalizerCounts;
pub use mapper::OccupancyMapper;
pub use node::{Node, Rays, Revision, SweptPath};
pub use relocalize::{PoseEstimate, RelocalizationCounts};
pub use scan_buffers::NODES_IN_FLIGHT_MAX;
pub use session::{Identity, Session, SessionError};
pub use stages::{Stage, StageObserver};
pub use submap::Submaps;

use msg::{GridView, Odometry, Pose2, Scan, SlamMode, Stamp, TileMap};
use std::collections::VecDeque;

/// Nodes that wait for [`Slam::work`]; when they are more, [`Slam::process`] does the work itself.
const WAITING_MAX: usize = NODES_IN_FLIGHT_MAX - 2;

/// One robot's SLAM on one thread: the scan path and, when asked to, the work beside it.
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

    /// Goes on with what was kept, or begins in a mode.
    pub fn begin(config: SlamConfig, session: Option<Session>, mode: SlamMode, start: InitialPose) -> Self {
        let (front, back) = begin(config, session, mode, start);
        Self { front, back, waiting: VecDeque::with_capacity(WAITING_MAX) }
    }

    /// All that must be kept to go on later, after working off what waits.
    pub fn session(&mut self, identity: Identity) -> Session {
        self.work();
        self.back.session(identity, Some(self.front.state()), self.front.samples())
    }

    /// Takes one odometry message.
    pub fn add_odometry(&mut self, odometry: &Odometry) {
        self.front.add_odometry(odometry);
    }

    /// The scan path: one scan in, one pose out. What the scan means for the past is left to
    /// [`Slam::work`].
    pub fn process(&mut self, scan: &Scan) -> ScanResult {
        let mut step = self.front.process(scan);
        if let Some(node) = step.node.take() {
            if self.waiting.len() == WAITING_MAX {
                self.work();
            }
            self.waiting.push_back(node);
        }
        step
    }

    /// Links, closures, solutions for all nodes that wait. Returns how many there were.
    pub fn work(&mut self) -> usize {
        let count = self.waiting.len();
        while let Some(node) = self.waiting.pop_front() {
            let revision = self.back.add_node(node);
            self.front.add_revision(revision);
        }
        count
    }

    /// Works off all that waits and solves with all that is known.
    pub fn finish(&mut self) {
        self.work();
        self.back.finish();
    }

    /// The map of all nodes that have been worked off, in frame `robotK/map`.
    pub fn map(&mut self) -> GridView<'_> {
        self.back.map()
    }

    /// The same as tiles; where nodes moved by less than shows, they are not drawn again.
    pub fn tiles(&mut self) -> &TileMap {
        while self.back.draw(usize::MAX) {}
        self.back.tiles()
    }

    /// Every accepted scan's stamp and `map_from_base`, as the graph has it now.
    pub fn trajectory(&self) -> impl Iterator<Item = (Stamp, Pose2)> + '_ {
        trajectory(&self.front, &self.back)
    }

    /// How many scans went which way.
    pub fn counts(&self) -> FrontEndCounts {
        self.front.counts()
    }

    /// What the work beside the scan path has done.
    pub fn back_counts(&self) -> BackEndCounts {
        self.back.counts()
    }

    /// The work beside the scan path.
    pub fn back(&self) -> &BackEnd {
        &self.back
    }

    /// The same, to undo closures.
    pub fn back_mut(&mut self) -> &mut BackEnd {
        &mut self.back
    }

    /// The two halves, to be run on different threads.
    pub fn split(self) -> (FrontEnd, BackEnd) {
        (self.front, self.back)
    }
}

/// Every accepted scan's stamp and `map_from_base`: scans between nodes ride on their node.
pub fn trajectory<'a>(front: &'a FrontEnd, back: &'a BackEnd) -> impl Iterator<Item = (Stamp, Pose2)> + 'a {
    back.trajectory(front.samples())
}

/// A scan path and a back end that begin a map, or go on with one that was kept.
pub fn begin(
    config: SlamConfig,
    session: Option<Session>,
    mode: SlamMode,
    start: InitialPose,
) -> (FrontEnd, BackEnd) {
    let Some(session) = session else {
        let mut back = BackEnd::new(config.clone());
        back.set_mode(mode);
        return (FrontEnd::new(config), back);
    };
    let front = match (start, session.front) {
        (InitialPose::Continue, Some(state)) => FrontEnd::resume(config.clone(), state, &session.back.nodes),
        (start, _) => {
            let empty = session.back.nodes.is_empty().then_some(Pose2::IDENTITY);
            let mut front = FrontEnd::new(config.clone());
            front.set_map_from_local(if let InitialPose::Near(hint) = start {
                Some(hint.map_from_local)
            } else {
                empty
            });
            let start = if start == InitialPose::Continue { InitialPose::Unknown } else { start };
            return (front, BackEnd::resume(config, session.back, session.samples, mode, start));
        }
    };
    (front, BackEnd::resume(config, session.back, session.samples, mode, start))
}
