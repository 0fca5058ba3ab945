//! One robot of the fleet: its submaps, where they lie, and its map redrawn from them.

use super::draw_submaps::{PlacedSubmap, draw_submaps};
use super::estimate::{RobotEstimate, TOLERANCE_M, distance_at_m};
use super::submaps::{SubmapSource, SubmapStore};
use msg::{Grid, Pose2};
use std::sync::Arc;

/// One robot of the fleet's pose graph: its submaps and the estimate of where its map lies.
#[derive(Clone, Debug, Default)]
pub(crate) struct Robot {
    /// Submaps that its SLAM sent.
    pub submaps: SubmapStore,
    /// Estimate of its map's transform by the fleet's pose graph.
    pub estimate: RobotEstimate,
    /// Number of the frame of its map, once its poses have said it.
    pub map_frame: Option<u32>,
    /// Whether the maps contradicted its given start, which is not used any more.
    pub is_start_contradicted: bool,
    /// The map redrawn from submaps; `None` while a single transform aligns all of the robot's own map.
    redrawn: Option<RedrawnMap>,
}

/// A map redrawn from submaps, and the transforms that it was drawn with.
#[derive(Clone, Debug)]
struct RedrawnMap {
    /// Frame `robotK/map`. Without cells if it could not be drawn.
    grid: Arc<Grid>,
    version: u64,
    map_from_robot_map: Pose2,
    map_from_robot_map_at_submaps: Vec<Pose2>,
}

/// Work: draw a robot's map from its submaps.
#[derive(Debug)]
pub(crate) struct RedrawJob {
    robot: usize,
    version: u64,
    map_from_robot_map: Pose2,
    map_from_robot_map_at_submaps: Vec<Pose2>,
    placed: Vec<PlacedSubmap>,
}

/// A robot's map drawn from its submaps.
#[derive(Debug)]
pub(crate) struct Redrawn {
    robot: usize,
    map: RedrawnMap,
}

impl Robot {
    /// Creates a robot with a given start, if there is one.
    pub fn new(start: Option<Pose2>) -> Self {
        Self { estimate: RobotEstimate::new(start), ..Self::default() }
    }

    /// Removes everything but the versions of its submaps and of its run, after the robot has left or starts at another place.
    /// Where it started is not known any more.
    pub fn remove(&mut self) {
        self.submaps.restart(None);
        (self.estimate, self.redrawn) = (RobotEstimate::default(), None);
        self.is_start_contradicted = false;
    }

    /// Uses the given start no more: the robot's place is unknown until an edge gives it.
    pub fn withdraw_start(&mut self) {
        (self.estimate, self.redrawn) = (RobotEstimate::default(), None);
        self.is_start_contradicted = true;
    }

    /// Uses the given start no more, where edges to other robots say where the robot is.
    pub fn forget_start(&mut self) {
        self.estimate.forget_start();
        self.is_start_contradicted = true;
    }

    /// Empties the submaps for those of a restarted SLAM, which continues in the same frame.
    pub fn restart(&mut self, source: SubmapSource) {
        self.submaps.restart(Some(source));
        self.estimate.reset_to(self.estimate.map_from_robot_map());
        self.redrawn = None;
    }

    /// Sets one transform for the whole map, or none, and drops a redrawn map.
    pub fn reset_estimate(&mut self, transform: Option<Pose2>) {
        self.estimate.reset_to(transform);
        self.redrawn = None;
    }

    /// Applies a solution of the joint graph: frame `map` from frame `robotK/map` at each submap.
    pub fn apply_solution(&mut self, map_from_robot_map_at_submaps: Vec<Pose2>) {
        self.estimate.apply(map_from_robot_map_at_submaps, &self.submaps);
        if !self.estimate.is_deformed() {
            self.redrawn = None;
        }
    }

    /// Frame `map` from the frame of a submap.
    pub fn map_from_submap(&self, id: usize) -> Option<Pose2> {
        Some(self.estimate.at_submap(id)? * *self.submaps.poses().get(id)?)
    }

    /// All submaps as the joint graph places them, in a frame given from `map`.
    pub fn placed_in(&self, frame_from_map: Pose2) -> Vec<PlacedSubmap> {
        let placed = |id| {
            let (submap, _) = self.submaps.get(id)?;
            let frame_from_submap = frame_from_map * self.map_from_submap(id)?;
            Some(PlacedSubmap { grid: submap.grid.clone(), frame_from_submap })
        };
        (0..self.submaps.poses().len()).filter_map(placed).collect()
    }

    /// Returns the redrawn map in frame `robotK/map`, if it is in use.
    pub fn redrawn_map(&self) -> Option<&Arc<Grid>> {
        self.redrawn.as_ref().map(|redrawn| &redrawn.grid).filter(|grid| !grid.cells.is_empty())
    }

    /// Whether the robot's map is deformed, and the redrawn one is missing or off by more than [`TOLERANCE_M`].
    fn needs_redraw(&self) -> bool {
        let estimate = &self.estimate;
        let Some(map_from_robot_map) = estimate.map_from_robot_map().filter(|_| estimate.is_deformed())
        else {
            return false;
        };
        let Some(drawn) = &self.redrawn else { return true };
        if drawn.version != self.submaps.version() || drawn.map_from_robot_map != map_from_robot_map {
            return true;
        }
        let moved_m = |id: usize| {
            let centre = self.submaps.centre_m(id)?;
            let before =
                drawn.map_from_robot_map_at_submaps.get(id).or(drawn.map_from_robot_map_at_submaps.last())?;
            Some(distance_at_m(*before, estimate.at_submap(id)?, centre))
        };
        (0..self.submaps.poses().len()).filter_map(moved_m).any(|m| m > TOLERANCE_M)
    }
}

/// Returns the next redraw that is due.
pub(crate) fn next_redraw(robots: &[Robot]) -> Option<RedrawJob> {
    let (index, robot) = robots.iter().enumerate().find(|(_, robot)| robot.needs_redraw())?;
    let map_from_robot_map = robot.estimate.map_from_robot_map()?;
    Some(RedrawJob {
        robot: index,
        version: robot.submaps.version(),
        map_from_robot_map,
        map_from_robot_map_at_submaps: robot.estimate.map_from_robot_map_at_submaps().to_vec(),
        placed: robot.placed_in(map_from_robot_map.inverse()),
    })
}

impl RedrawJob {
    /// Draws the map.
    pub fn run(self) -> Redrawn {
        let Self { robot, version, map_from_robot_map, map_from_robot_map_at_submaps, placed } = self;
        // A map that cannot be drawn is empty: the robot then keeps the one it draws itself.
        let grid = Arc::new(draw_submaps(&placed).unwrap_or_default());
        Redrawn {
            robot,
            map: RedrawnMap { grid, version, map_from_robot_map, map_from_robot_map_at_submaps },
        }
    }
}

impl Redrawn {
    /// Replaces the robot's redrawn map by this one.
    pub fn apply(self, robots: &mut [Robot]) {
        robots[self.robot].redrawn = Some(self.map);
    }
}
