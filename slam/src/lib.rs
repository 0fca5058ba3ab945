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
mod canvas;
mod closure;
mod cloud;
mod config;
mod field;
mod front;
mod graph;
mod node;
mod odometry;
mod pool;
mod stage;
mod sweep;

pub use back::{Back, BackCounts};
pub use closure::SearchCounts;
pub use cloud::{Cloud, CloudScratch, Placement, SurfacePoint};
pub use config::*;
pub use front::{Counts, Front, Refusal, Ride, Step};
pub use graph::{Edge, EdgeKind, Graph, Relative};
pub use node::{Node, Rays, Revision};
pub use pool::NODES_UNDER_WAY_MAX;
pub use stage::{Stage, StageWatch};
pub use sweep::Sweep;

use msg::{GridView, Odometry, Pose2, Scan, Stamp, TileMap};
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

    /// The two halves, to be run on different threads.
    pub fn split(self) -> (Front, Back) {
        (self.front, self.back)
    }
}

/// Every accepted scan's stamp and `map_from_base`: scans between nodes ride on their node.
pub fn trajectory<'a>(front: &'a Front, back: &'a Back) -> impl Iterator<Item = (Stamp, Pose2)> + 'a {
    let poses = back.graph().poses();
    let known = front.rides().iter().filter(|ride| (ride.node as usize) < poses.len());
    known.map(|ride| (ride.stamp, poses[ride.node as usize] * ride.node_from_base))
}
