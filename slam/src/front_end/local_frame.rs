//! Pose of the front end's frame in the map, updated by the back end's revisions.

use crate::graph::{carry_covariance, turn_covariance};
use crate::node::{FrameUncertainty, Revision};
use msg::Pose2;
use nalgebra::Matrix3;
use std::collections::VecDeque;

/// Revisions that may wait for their node; beyond them the oldest is dropped, which a newer one replaces anyway.
const REVISIONS_MAX: usize = 64;

/// Pose of the front end's frame in the map, and the revisions that will change it.
pub(super) struct LocalFrameInMap {
    pub map_from_local: Pose2,
    /// How well it is known.
    pub uncertainty: FrameUncertainty,
    /// Whether `map_from_local` is known: whether the robot is located in its map.
    pub is_located: bool,
    /// The newest node whose odometry edge is broken: revisions caused by older nodes do not locate the robot.
    pub last_break: Option<u32>,
    /// Whether there is evidence that the map is wrong, as last reported.
    pub is_unreliable: bool,
    /// Number of active closures, as last reported.
    pub closures: u32,
    /// Revisions that take effect with a later node, oldest first.
    pub revisions: VecDeque<Revision>,
}

impl LocalFrameInMap {
    pub fn new() -> Self {
        Self {
            map_from_local: Pose2::IDENTITY,
            uncertainty: FrameUncertainty::default(),
            is_located: true,
            last_break: None,
            is_unreliable: false,
            closures: 0,
            revisions: VecDeque::with_capacity(REVISIONS_MAX),
        }
    }

    /// Sets the pose at once; `None` marks the robot as not located.
    pub fn set(&mut self, map_from_local: Option<Pose2>) {
        self.is_located = map_from_local.is_some();
        self.last_break = None;
        self.map_from_local = map_from_local.unwrap_or(self.map_from_local);
        self.uncertainty = FrameUncertainty::default();
        self.revisions.clear();
    }

    /// Records an odometry break at a node: from there on the robot is not located in its map.
    pub fn break_at(&mut self, node: u32) {
        self.last_break = Some(node);
        self.is_located = false;
    }

    /// Covariance of a pose in the map, `local` being that in the front end's frame.
    pub fn covariance_in_map(&self, local: Matrix3<f64>, map_from_base: Pose2) -> Matrix3<f64> {
        let FrameUncertainty { covariance: [xx, xy, xt, yy, yt, tt], at } = self.uncertainty;
        let covariance = Matrix3::new(xx, xy, xt, xy, yy, yt, xt, yt, tt);
        let moved = [map_from_base.x_m - at[0], map_from_base.y_m - at[1]];
        carry_covariance(covariance, moved) + turn_covariance(local, self.map_from_local.yaw_rad)
    }

    pub fn add_revision(&mut self, revision: Revision) {
        if self.revisions.len() == REVISIONS_MAX {
            self.revisions.pop_front();
        }
        self.revisions.push_back(revision);
    }

    /// Applies the newest revision that is due with this node; those before it are out of date.
    pub fn apply_revisions(&mut self, node: u32) {
        let Some(due) = self.revisions.iter().rposition(|r| r.effective_from <= node) else { return };
        let due = self.revisions.drain(..=due).next_back();
        due.into_iter().for_each(|revision| self.apply(revision));
    }

    /// Applies a revision at once, in the place of those that wait.
    pub fn replace_revisions(&mut self, revision: Revision) {
        self.revisions.clear();
        self.apply(revision);
    }

    fn apply(&mut self, revision: Revision) {
        self.map_from_local = revision.map_from_local;
        self.is_located = revision.located && self.last_break.is_none_or(|at| revision.cause >= at);
        self.apply_quality(revision);
    }

    /// Takes over how good a revision's map and its pose are, and not where the robot is.
    pub fn apply_quality(&mut self, revision: Revision) {
        self.uncertainty = revision.uncertainty;
        self.is_unreliable = revision.unreliable;
        self.closures = revision.closures;
    }

    pub fn restore_revisions(&mut self, revisions: Vec<Revision>) {
        self.revisions.extend(revisions.into_iter().take(REVISIONS_MAX));
    }
}
