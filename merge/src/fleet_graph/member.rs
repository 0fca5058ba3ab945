//! One robot of the fleet: its submaps, and where the fleet's graph has put them.

use super::compose::Placed;
use crate::merger::is_near;
use msg::{Grid, Pose2, SUBMAPS_MAX, Submap, SubmapPoses};
use nalgebra::Matrix3;
use posegraph::{Edge, Kernel};
use std::sync::Arc;

/// What ties two submaps in a row that SLAM says nothing about, metres and radians.
const LOOSE: [f64; 2] = [0.5, 0.2];

/// An incarnation of a robot's SLAM, and its generation of submaps.
pub(crate) type SubmapRun = (u64, u32);

/// A submap as it came last.
#[derive(Clone, Debug)]
pub(crate) struct Piece {
    pub grid: Arc<Grid>,
    pub nodes: u32,
    pub finished: bool,
    /// Middle of the grid in the submap's frame, and how far its corners are from there, metres.
    pub centre_m: [f64; 2],
    pub radius_m: f64,
}

/// See the module.
#[derive(Clone, Debug, Default)]
pub(crate) struct Member {
    /// Whose submaps these are.
    pub run: Option<SubmapRun>,
    pub pieces: Vec<Option<Piece>>,
    /// Counts the submaps that came.
    pub version: u64,
    /// `robotK/map` from each submap, as its own graph has it.
    pub poses: Vec<Pose2>,
    /// Metres driven up to each submap.
    pub ways_m: Vec<f64>,
    pub edges: Vec<(usize, usize, Matrix3<f64>)>,
    /// `map` from `robotK/map`, if it was given.
    pub start: Option<Pose2>,
    /// `map` from `robotK/map` as it is published: right where the robot is now.
    pub anchor: Option<Pose2>,
    /// `map` from `robotK/map` at each submap: the same for all while the robot's map is not bent.
    pub corrections: Vec<Pose2>,
    /// The map redrawn from its submaps, if the anchor alone does not put them right.
    pub straightened: Option<Straightened>,
    pub bent: bool,
}

/// A robot's map as the fleet's graph has it, frame `robotK/map`.
#[derive(Clone, Debug)]
pub(crate) struct Straightened {
    pub grid: Arc<Grid>,
    /// What it was drawn from.
    pub version: u64,
    pub anchor: Pose2,
    pub corrections: Vec<Pose2>,
}

impl Member {
    /// Takes a submap; false if it makes no sense.
    pub fn submap(&mut self, submap: &Submap) -> bool {
        let id = submap.id as usize;
        let Some(view) = submap.view() else { return false };
        let header = view.header;
        if id >= SUBMAPS_MAX
            || !crate::merger::RESOLUTION_M.contains(&header.resolution_m)
            || !is_near(header.origin)
        {
            return false;
        }
        let half = [header.width, header.height].map(|cells| f64::from(cells) * header.resolution_m / 2.0);
        let piece = Piece {
            centre_m: header.origin.apply(half),
            radius_m: half[0].hypot(half[1]),
            grid: Arc::new(view.to_owned()),
            nodes: submap.nodes,
            finished: submap.finished != 0,
        };
        if self.pieces.len() <= id {
            self.pieces.resize(id + 1, None);
        }
        self.pieces[id] = Some(piece);
        self.version += 1;
        true
    }

    /// Takes the submaps' poses; `None` if they make no sense, else whether anything is new.
    pub fn take_poses(&mut self, message: &SubmapPoses) -> Option<bool> {
        let poses = message.poses();
        let sound = |e: &&msg::SubmapEdge| {
            e.information.iter().all(|v| v.is_finite()) && e.a < e.b && (e.b as usize) < poses.len()
        };
        if !poses.iter().all(|pose| is_near(*pose)) || !message.edges().iter().all(|e| sound(&e)) {
            return None;
        }
        if poses == self.poses && message.edges().len() == self.edges.len() {
            return Some(false);
        }
        self.poses = poses.to_vec();
        self.ways_m = ways_m(poses);
        let matrix = |[xx, xy, xt, yy, yt, tt]: [f64; 6]| Matrix3::new(xx, xy, xt, xy, yy, yt, xt, yt, tt);
        let edges = message.edges().iter();
        self.edges = edges.map(|e| (e.a as usize, e.b as usize, matrix(e.information))).collect();
        Some(true)
    }

    /// Whether a submap is missing that the poses speak of.
    pub fn missing_submaps(&self) -> usize {
        self.poses.len().saturating_sub(self.pieces.iter().flatten().count())
    }

    /// All nodes in submaps.
    pub fn nodes(&self) -> u32 {
        self.pieces.iter().flatten().map(|piece| piece.nodes).sum()
    }

    /// A submap that is there, with its pose in the robot's map.
    pub fn piece(&self, id: usize) -> Option<(&Piece, Pose2)> {
        Some((self.pieces.get(id)?.as_ref()?, *self.poses.get(id)?))
    }

    /// `map` from `robotK/map` at a submap.
    pub fn correction(&self, id: usize) -> Option<Pose2> {
        self.corrections.get(id).or(self.corrections.last()).copied()
    }

    /// `map` from a submap.
    pub fn map_from_submap(&self, id: usize) -> Option<Pose2> {
        Some(self.correction(id)? * *self.poses.get(id)?)
    }

    /// The middle of a submap in the robot's map, or its frame's origin if it has not come.
    pub fn centre_m(&self, id: usize) -> Option<[f64; 2]> {
        let pose = *self.poses.get(id)?;
        let piece = self.pieces.get(id).and_then(Option::as_ref);
        Some(pose.apply(piece.map_or([0.0; 2], |piece| piece.centre_m)))
    }

    /// Metres that the robot drove from one submap to another.
    pub fn way_m(&self, i: usize, k: usize) -> f64 {
        let at = |id: usize| self.ways_m.get(id).or(self.ways_m.last()).copied().unwrap_or(0.0);
        (at(i) - at(k)).abs()
    }

    /// The submaps of a range in the robot's own frame.
    pub fn placed(&self, ids: core::ops::Range<usize>) -> Vec<Placed> {
        let pieces = ids.filter_map(|id| self.piece(id));
        pieces.map(|(piece, pose)| Placed { grid: piece.grid.clone(), frame_from_submap: pose }).collect()
    }

    /// All submaps where the fleet's graph has them; `frame_from_map` takes them from there.
    pub fn placed_in(&self, frame_from_map: Pose2) -> Vec<Placed> {
        let place = |id| {
            let (piece, _) = self.piece(id)?;
            Some(Placed {
                grid: piece.grid.clone(),
                frame_from_submap: frame_from_map * self.map_from_submap(id)?,
            })
        };
        (0..self.poses.len()).filter_map(place).collect()
    }

    /// What SLAM knows, for a graph in which this robot's submaps begin at `first`.
    pub fn constraints(&self, first: usize) -> Vec<Edge> {
        let between = |a: usize, b: usize, information| Edge {
            a: first + a,
            b: first + b,
            a_from_b: self.poses[a].between(self.poses[b]),
            information,
            kernel: Kernel::Quadratic,
        };
        let known = self.edges.iter().filter(|(_, b, _)| *b < self.poses.len());
        let mut constraints: Vec<_> =
            known.map(|(a, b, information)| between(*a, *b, *information)).collect();
        let mut tied = vec![false; self.poses.len()];
        let in_a_row = self.edges.iter().filter(|(a, b, _)| a + 1 == *b);
        for (_, b, _) in in_a_row {
            if let Some(tied) = tied.get_mut(*b) {
                *tied = true;
            }
        }
        let loose = posegraph::information_from_sigmas(LOOSE[0], LOOSE[1]);
        constraints.extend((1..self.poses.len()).filter(|b| !tied[*b]).map(|b| between(b - 1, b, loose)));
        constraints
    }

    /// SLAM was started again and goes on in the same frame: what it had mapped is gone.
    pub fn begin_again(&mut self) {
        let (start, anchor) = (self.start, self.anchor);
        *self = Self {
            start,
            anchor,
            corrections: anchor.into_iter().collect(),
            version: self.version + 1,
            ..Self::default()
        };
    }

    /// Takes a solution over. The anchor moves only if it has to: by more than `tolerance_m` anywhere.
    pub fn settle(&mut self, corrections: Vec<Pose2>, tolerance_m: f64) {
        self.corrections = corrections;
        let Some(newest) = self.corrections.last().copied() else { return };
        let apart = |member: &Self, anchor: Pose2| {
            let off = |id: usize| {
                let centre = member.centre_m(id)?;
                let ([x, y], [u, v]) = (anchor.apply(centre), member.correction(id)?.apply(centre));
                Some((x - u).hypot(y - v))
            };
            let all = (0..member.poses.len()).filter_map(off).fold(0.0, f64::max);
            let last = member.poses.len().checked_sub(1).and_then(off).unwrap_or(0.0);
            [all, last]
        };
        let current = self.anchor.map(|anchor| apart(self, anchor));
        match current {
            Some([all, _]) if all <= tolerance_m => self.bent = false,
            Some([_, last]) if last <= tolerance_m && apart(self, newest)[0] > tolerance_m => {
                self.bent = true
            }
            _ => {
                self.anchor = Some(newest);
                self.bent = apart(self, newest)[0] > tolerance_m;
            }
        }
        if !self.bent {
            self.straightened = None;
        }
    }

    /// Whether the redrawn map is missing or no longer what the graph says, by more than `tolerance_m`.
    pub fn wants_straightening(&self, tolerance_m: f64) -> bool {
        let Some(anchor) = self.anchor.filter(|_| self.bent) else { return false };
        let Some(drawn) = &self.straightened else { return true };
        if drawn.version != self.version || drawn.anchor != anchor {
            return true;
        }
        let moved = |id: usize| {
            let centre = self.centre_m(id)?;
            let was = drawn.corrections.get(id).or(drawn.corrections.last())?;
            let ([x, y], [u, v]) = (was.apply(centre), self.correction(id)?.apply(centre));
            Some((x - u).hypot(y - v))
        };
        (0..self.poses.len()).filter_map(moved).any(|m| m > tolerance_m)
    }
}

/// Metres along a chain of poses up to each.
pub(crate) fn ways_m(poses: &[Pose2]) -> Vec<f64> {
    let mut way_m = 0.0;
    let steps = poses.iter().zip(poses.first().into_iter().chain(poses));
    steps
        .map(|(pose, before)| {
            way_m += before.distance_m(*pose);
            way_m
        })
        .collect()
}
