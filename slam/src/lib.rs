//! Scans in, one robot's poses and map out.
//!
//! ```text
//!   scan, odometry                                     map
//!        │                                              ▲
//!        ▼            Node ───────────────▶             │
//!  Front (scan path)                        Back (beside it: links, closures, solver, canvas)
//!        │            ◀─────────────── Revision
//!        ▼
//!   Step: correction, covariance, state
//! ```
//!
//! [`Front`] answers every scan in bounded time and never waits for [`Back`]. Both are plain values
//! that may live on different threads; [`Slam`] has both on one. What `Back` computes depends on the
//! nodes alone, so the final trajectory and map are the same, bit for bit, wherever it runs.

pub mod align;
mod back;
mod backward;
mod canvas;
mod closure;
mod cloud;
mod config;
mod field;
mod front;
mod graph;
mod localize;
mod node;
mod odometry;
mod pool;
mod relocalize;
pub mod session;
mod stage;
mod submap;
mod sweep;

pub use back::{Back, BackCounts, BackState, ClosureReport, Start};
pub use canvas::Canvas;
pub use closure::SearchCounts;
pub use cloud::{Cloud, CloudScratch, Placement, SurfacePoint};
pub use config::*;
pub use front::{Counts, Front, FrontState, Refusal, Ride, Step};
pub use graph::{Edge, EdgeKind, Graph, Relative};
pub use localize::LocalizerCounts;
pub use node::{Node, Rays, Revision, Way};
pub use pool::NODES_UNDER_WAY_MAX;
pub use relocalize::{Hint, SeekCounts};
pub use session::{Identity, Session, SessionError};
pub use stage::{Stage, StageWatch};
pub use submap::Submaps;
pub use sweep::Sweep;

use msg::{GridView, Odometry, Pose2, Scan, SlamMode, Stamp, TileMap};
use std::collections::VecDeque;

/// Nodes that wait for [`Slam::work`]; when they are more, [`Slam::process`] does the work itself.
const WAITING_MAX: usize = NODES_UNDER_WAY_MAX - 2;

/// One robot's SLAM on one thread: the scan path and, when asked to, the work beside it.
pub struct Slam {
    front: Front,
    back: Back,
    waiting: VecDeque<Node>,
}

impl Slam {
    /// Ready for the first scan. The map's frame is where the robot then stands.
    pub fn new(config: SlamConfig) -> Self {
        let waiting = VecDeque::with_capacity(WAITING_MAX);
        Self { front: Front::new(config.clone()), back: Back::new(config), waiting }
    }

    /// Goes on with what was kept, or begins in a mode.
    pub fn begin(config: SlamConfig, session: Option<Session>, mode: SlamMode, start: Start) -> Self {
        let (front, back) = begin(config, session, mode, start);
        Self { front, back, waiting: VecDeque::with_capacity(WAITING_MAX) }
    }

    /// All that must be kept to go on later, after working off what waits.
    pub fn session(&mut self, identity: Identity) -> Session {
        self.work();
        self.back.session(identity, Some(self.front.state()), self.front.rides())
    }

    /// Takes one odometry message.
    pub fn odometry(&mut self, odometry: &Odometry) {
        self.front.odometry(odometry);
    }

    /// The scan path: one scan in, one pose out. What the scan means for the past is left to
    /// [`Slam::work`].
    pub fn process(&mut self, scan: &Scan) -> Step {
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
            let revision = self.back.add(node);
            self.front.revise(revision);
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
    pub fn counts(&self) -> Counts {
        self.front.counts()
    }

    /// What the work beside the scan path has done.
    pub fn back_counts(&self) -> BackCounts {
        self.back.counts()
    }

    /// The work beside the scan path.
    pub fn back(&self) -> &Back {
        &self.back
    }

    /// The same, to undo closures.
    pub fn back_mut(&mut self) -> &mut Back {
        &mut self.back
    }

    /// The two halves, to be run on different threads.
    pub fn split(self) -> (Front, Back) {
        (self.front, self.back)
    }
}

/// Every accepted scan's stamp and `map_from_base`: scans between nodes ride on their node.
pub fn trajectory<'a>(front: &'a Front, back: &'a Back) -> impl Iterator<Item = (Stamp, Pose2)> + 'a {
    back.trajectory(front.rides())
}

/// A scan path and a back end that begin a map, or go on with one that was kept.
pub fn begin(config: SlamConfig, session: Option<Session>, mode: SlamMode, start: Start) -> (Front, Back) {
    let Some(session) = session else {
        let mut back = Back::new(config.clone());
        back.set_mode(mode);
        return (Front::new(config), back);
    };
    let front = match (start, session.front) {
        (Start::GoOn, Some(state)) => Front::resume(config.clone(), state, &session.back.nodes),
        (start, _) => {
            let empty = session.back.nodes.is_empty().then_some(Pose2::IDENTITY);
            let mut front = Front::new(config.clone());
            front.place(if let Start::At(hint) = start { Some(hint.map_from_local) } else { empty });
            let start = if start == Start::GoOn { Start::Unknown } else { start };
            return (front, Back::resume(config, session.back, session.rides, mode, start));
        }
    };
    (front, Back::resume(config, session.back, session.rides, mode, start))
}
