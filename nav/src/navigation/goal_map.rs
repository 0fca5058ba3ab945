//! Cheapest routes from everywhere around a robot to its goal, on the map with recent obstacles and zones.

use super::config::{NavigatorConfig, UnknownSpace};
use super::input::RobotPoses;
use super::state::NavigationFailure;
use crate::clearance_map::ClearanceMap;
use crate::observation::MapView;
use crate::obstacles::RecentObstacles;
use crate::path::{Path, Waypoint};
use crate::route_search::RouteSearch;
use msg::grid::Occupancy;
use msg::{ExclusionZone, Stamp};

/// Space around a robot's body that is marked with it where it stands, metres: scans draw a robot somewhat larger than its body.
const ROBOT_MARK_SPACE_M: f64 = 0.035;
/// Routes are searched this much farther than the robot's, metres: room to step aside.
const SEARCH_BEYOND_M: f64 = 6.0;
/// Farthest that a robot may stand from the nearest cell with a route, metres.
pub(crate) const START_SNAP_MAX_M: f64 = 0.4;
/// A goal is moved at most this far to where the robot fits, metres: the tolerance of an arrival.
const GOAL_SNAP_MAX_M: f64 = 0.15;

/// Everything that a route depends on.
pub(super) struct GoalMapInput<'a> {
    pub(super) stamp: Stamp,
    pub(super) map: MapView<'a>,
    pub(super) poses: RobotPoses,
    pub(super) goal_m: [f64; 2],
    pub(super) obstacles: &'a RecentObstacles,
    pub(super) zones: &'a [ExclusionZone],
    /// Robots that stand, in the frame of the map, metres.
    pub(super) standing_robots_m: &'a [[f64; 2]],
}

/// Routes to one goal.
#[derive(Clone, Debug, Default)]
pub(super) struct GoalMap {
    map: ClearanceMap,
    routes: RouteSearch,
    cells: Vec<usize>,
}

impl GoalMap {
    /// Frees the memory of the last search.
    pub(super) fn clear(&mut self) {
        *self = Self::default();
    }

    pub(super) fn map(&self) -> &ClearanceMap {
        &self.map
    }

    pub(super) fn routes(&self) -> &RouteSearch {
        &self.routes
    }

    pub(super) fn waypoint(&self, cell: usize) -> Waypoint {
        Waypoint { position_m: self.map.cell_centre_m(cell), clearance_m: self.map.clearance_m(cell) }
    }

    /// Searches all routes to the goal, up to some way beyond the robot.
    pub(super) fn search(
        &mut self,
        config: &NavigatorConfig,
        input: &GoalMapInput,
    ) -> Result<(), NavigationFailure> {
        self.draw(config, input)?;
        let clearance_min_m = config.body.clearance_min_m(self.map.cell_size_m());
        let at_m = input.poses.position_m();
        let start = self.map.cell_at(at_m).ok_or(NavigationFailure::NoPose)?;
        let goal_m = self.nearest_fitting(input.goal_m, clearance_min_m, GOAL_SNAP_MAX_M);
        let goal_m = goal_m.ok_or(NavigationFailure::GoalOccupied)?;
        let is_started =
            self.routes.search_until(&self.map, goal_m, clearance_min_m, (start, SEARCH_BEYOND_M));
        if !is_started {
            return Err(NavigationFailure::GoalOccupied);
        }
        match self.start_cell(at_m) {
            Some(_) => Ok(()),
            None if self.nearest_fitting(at_m, clearance_min_m, START_SNAP_MAX_M).is_none() => {
                Err(NavigationFailure::StartBlocked)
            }
            None => Err(NavigationFailure::GoalUnreachable),
        }
    }

    fn draw(&mut self, config: &NavigatorConfig, input: &GoalMapInput) -> Result<(), NavigationFailure> {
        self.map.copy_window(&input.map, input.poses.position_m());
        let goal = self.map.cell_at(input.goal_m).ok_or(match self.map.covers_map() {
            true => NavigationFailure::GoalOutsideMap,
            false => NavigationFailure::GoalTooFar,
        })?;
        let is_unknown = self.map.occupancy(goal) == Occupancy::Unknown;
        match config.unknown_space {
            UnknownSpace::Avoid if is_unknown => return Err(NavigationFailure::GoalUnreachable),
            UnknownSpace::Avoid => {}
            UnknownSpace::Cross => self.map.mark_unknown_free(),
        }
        // The robot's own place is free, whatever other robots' scans drew there.
        let mark_m = config.body.radius_m + ROBOT_MARK_SPACE_M;
        self.map.mark_disc(input.poses.position_m(), mark_m, Occupancy::Free);
        input.obstacles.mark(input.stamp, input.poses.odom_from_map().inverse(), &mut self.map);
        input.zones.iter().for_each(|zone| self.map.mark_polygon_occupied(zone.corners_m()));
        for robot_m in input.standing_robots_m {
            self.map.mark_disc(*robot_m, mark_m, Occupancy::Occupied);
        }
        self.map.compute_clearance();
        Ok(())
    }

    /// The point nearest to another, at most `reach_m` away, at which the robot fits.
    fn nearest_fitting(&self, point_m: [f64; 2], clearance_min_m: f64, reach_m: f64) -> Option<[f64; 2]> {
        let fits = |cell: usize| {
            self.map.occupancy(cell) == Occupancy::Free && self.map.clearance_m(cell) >= clearance_min_m
        };
        let cell = self.map.nearest_cell(point_m, reach_m, fits)?;
        Some(self.map.cell_centre_m(cell))
    }

    /// The cell with a route that is nearest to a robot; it may stand a little inside an obstacle's surroundings.
    pub(super) fn start_cell(&self, at_m: [f64; 2]) -> Option<usize> {
        self.map.nearest_cell(at_m, START_SNAP_MAX_M, |cell| self.routes.cost(cell).is_some())
    }

    /// Cost of the route from a point, metres of driving in open space.
    pub(super) fn cost_m(&self, at_m: [f64; 2]) -> Option<f64> {
        self.routes.cost_m(&self.map, self.start_cell(at_m)?)
    }

    /// Appends the waypoints from a cell with a route to the goal, both included.
    pub(super) fn append_route(&mut self, from: usize, path: &mut Path) {
        self.routes.route_to(&self.map, from, &mut self.cells);
        path.waypoints.extend(self.cells.iter().rev().map(|cell| self.waypoint(*cell)));
    }
}
