//! Path planner, which finds the cheapest path on the layered clearance map.

use crate::clearance_map::ClearanceMap;
use crate::config::RobotBody;
use crate::memory::RobotMemory;
use crate::observation::{MapView, ScanView};
use crate::path::{Path, Waypoint};
use crate::route_search::RouteSearch;
use msg::Pose2;
use msg::grid::Occupancy;
use thiserror::Error;

/// Radius of the disc marked where a robot stands, metres. Other robots' scans draw a robot somewhat larger than its
/// body, and the cells around it have to be free again once it has left.
const ROBOT_MARK_RADIUS_M: f64 = 0.14;
/// Farthest hit of the newest scan that is marked, metres: errors of the heading misplace farther ones.
const FRESH_HIT_MAX_M: f64 = 1.0;

/// Input of a planner at one moment.
#[derive(Clone, Copy, Debug)]
pub struct PlanningInput<'a> {
    /// Map to plan on.
    pub map: MapView<'a>,
    /// Pose of the robot in the map.
    pub map_from_base: Pose2,
    /// Newest scan of the robot: obstacles near it that the map may not show yet.
    pub scan: Option<ScanView<'a>>,
    /// What the robot's scans of the last seconds show and the map may not: free space and obstacles.
    pub memory: Option<&'a RobotMemory>,
    /// Positions of the other robots in the map, metres.
    pub other_robots_m: &'a [[f64; 2]],
}

impl<'a> PlanningInput<'a> {
    /// A map and a pose, without scans and other robots.
    pub fn new(map: MapView<'a>, map_from_base: Pose2) -> Self {
        Self { map, map_from_base, scan: None, memory: None, other_robots_m: &[] }
    }

    pub(crate) fn robot_m(&self) -> [f64; 2] {
        [self.map_from_base.x_m, self.map_from_base.y_m]
    }
}

/// There is no path.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum PlanError {
    /// The robot does not fit anywhere near its pose.
    #[error("no free space for the robot within 0.4 m of its pose")]
    StartBlocked,
    /// The goal is outside the part of the map that plans cover.
    #[error(
        "the goal lies outside the map, or farther away than the planner's window of 25 m: go there in steps"
    )]
    GoalOutsideMap,
    /// The robot fits nowhere on a route to the goal, or not at the goal itself.
    #[error("the goal cannot be reached: it is unknown, occupied, too narrow for the robot, or cut off")]
    GoalUnreachable,
}

/// Plans paths for a round robot, in buffers that it keeps.
///
/// Time and memory are linear in the window's cells, at most
/// [`WINDOW_CELLS_MAX`](crate::clearance_map::WINDOW_CELLS_MAX) squared, whatever the map's size.
///
/// ```
/// use msg::Pose2;
/// use nav::{MapView, Planner, PlanningInput, RobotBody};
///
/// // 2 m by 2 m of free space with a wall from the lower edge up to 1.5 m.
/// let is_wall = |i: usize| i % 40 == 20 && i / 40 < 30;
/// let cells: Vec<i8> = (0..1600).map(|i| if is_wall(i) { 100 } else { 0 }).collect();
/// let map = MapView::from_percent(Pose2::IDENTITY, 0.05, (40, 40), &cells).unwrap();
///
/// let mut planner = Planner::new(RobotBody::default());
/// let input = PlanningInput::new(map, Pose2::new(0.5, 0.5, 0.0));
/// let path = planner.plan_path(&input, [1.5, 0.5]).unwrap();
///
/// let highest_m = path.waypoints.iter().map(|w| w.position_m[1]).fold(0.0, f64::max);
/// assert!(highest_m > 1.5, "the path leads around the wall");
/// assert!(path.waypoints.iter().all(|w| w.clearance_m > 0.16), "and keeps away from it");
/// ```
#[derive(Clone, Debug, Default)]
pub struct Planner {
    body: RobotBody,
    map: ClearanceMap,
    routes: RouteSearch,
    cells: Vec<usize>,
}

impl Planner {
    /// A planner for robots of this size.
    pub fn new(body: RobotBody) -> Self {
        Self { body, ..Self::default() }
    }

    /// Plans the cheapest path to a goal in the frame of the map.
    pub fn plan_path(&mut self, input: &PlanningInput, goal_m: [f64; 2]) -> Result<Path, PlanError> {
        self.update_map(input);
        self.search_routes(input)?;
        let goal = self.map.cell_at(goal_m).ok_or(PlanError::GoalOutsideMap)?;
        let is_reached = self.routes.cost_m(&self.map, goal).is_some();
        if !is_reached || !self.routes.is_passable(&self.map, goal) {
            return Err(PlanError::GoalUnreachable);
        }
        self.routes.route_to(&self.map, goal, &mut self.cells);
        Ok(path_of_cells(&self.map, &self.cells))
    }

    /// Copies the map around the robot, adds what scans show and where robots stand, and computes clearances.
    pub fn update_map(&mut self, input: &PlanningInput) {
        let robot_m = input.robot_m();
        self.map.copy_window(&input.map, robot_m);
        if let Some(memory) = input.memory {
            memory.mark(&mut self.map);
        }
        // The robot's own place is free, whatever other robots' scans drew there.
        self.map.mark_disc(robot_m, ROBOT_MARK_RADIUS_M, Occupancy::Free);
        for hit in input.scan.iter().flat_map(ScanView::hits_in_base_m) {
            if hit[0].hypot(hit[1]) < FRESH_HIT_MAX_M {
                self.map.mark_occupied(input.map_from_base.apply(hit));
            }
        }
        for other_m in input.other_robots_m {
            self.map.mark_disc(*other_m, ROBOT_MARK_RADIUS_M, Occupancy::Occupied);
        }
        self.map.compute_clearance();
    }

    /// The map of the last [`Planner::update_map`].
    pub fn map(&self) -> &ClearanceMap {
        &self.map
    }

    /// Searches the routes from the robot on the map of the last [`Planner::update_map`].
    pub(crate) fn search_routes(&mut self, input: &PlanningInput) -> Result<(), PlanError> {
        let clearance_min_m = self.body.clearance_min_m(self.map.cell_size_m());
        let is_started = self.routes.search_from(&self.map, input.robot_m(), clearance_min_m);
        if is_started { Ok(()) } else { Err(PlanError::StartBlocked) }
    }

    pub(crate) fn map_and_routes(&self) -> (&ClearanceMap, &RouteSearch) {
        (&self.map, &self.routes)
    }
}

pub(crate) fn path_of_cells(map: &ClearanceMap, cells: &[usize]) -> Path {
    let waypoint =
        |cell: &usize| Waypoint { position_m: map.cell_centre_m(*cell), clearance_m: map.clearance_m(*cell) };
    Path { waypoints: cells.iter().map(waypoint).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::distance_m;

    /// A room of 2 m by 2 m, walled in, with a wall down its middle.
    fn divided_room() -> Vec<i8> {
        let is_wall = |x: usize, y: usize| x == 0 || y == 0 || x == 39 || y == 39 || x == 20;
        (0..1600).map(|i| if is_wall(i % 40, i / 40) { 100 } else { 0 }).collect()
    }

    fn plan(cells: &[i8], start: Pose2, goal_m: [f64; 2]) -> Result<Path, PlanError> {
        let map = MapView::from_percent(Pose2::IDENTITY, 0.05, (40, 40), cells).unwrap();
        Planner::new(RobotBody::default()).plan_path(&PlanningInput::new(map, start), goal_m)
    }

    #[test]
    fn a_path_ends_at_its_goal() {
        let path = plan(&divided_room(), Pose2::new(0.5, 0.5, 0.0), [0.5, 1.5]).unwrap();
        assert!(distance_m(path.waypoints[0].position_m, [0.5, 0.5]) < 0.05);
        assert!(distance_m(path.end_m().unwrap(), [0.5, 1.5]) < 0.05);
    }

    #[test]
    fn errors_say_why_there_is_no_path() {
        let cells = divided_room();
        let start = Pose2::new(0.5, 0.5, 0.0);
        assert_eq!(plan(&cells, start, [1.5, 0.5]), Err(PlanError::GoalUnreachable));
        assert_eq!(plan(&cells, start, [0.5, 9.0]), Err(PlanError::GoalOutsideMap));
        assert_eq!(plan(&cells, start, [0.5, f64::NAN]), Err(PlanError::GoalOutsideMap));
        let occupied = vec![100; 1600];
        assert_eq!(plan(&occupied, start, [0.5, 1.5]), Err(PlanError::StartBlocked));
    }

    #[test]
    fn other_robots_and_fresh_hits_are_obstacles() {
        let occupancies = |planner: &Planner| {
            [[0.7, 0.5], [0.5, 1.4]].map(|at_m| planner.map().occupancy(planner.map().cell_at(at_m).unwrap()))
        };
        let cells = divided_room();
        let map = MapView::from_percent(Pose2::IDENTITY, 0.05, (40, 40), &cells).unwrap();
        let mut planner = Planner::new(RobotBody::default());
        let input = PlanningInput::new(map, Pose2::new(0.5, 0.5, 0.0));
        planner.update_map(&input);
        assert_eq!(occupancies(&planner), [Occupancy::Free; 2]);
        let scan = ScanView {
            received: msg::Stamp(0),
            base_from_scan: Pose2::IDENTITY,
            angle_min_rad: 0.0,
            angle_increment_rad: 0.01,
            range_min_m: 0.1,
            range_max_m: 3.5,
            ranges_m: &[0.2],
        };
        planner.update_map(&PlanningInput { scan: Some(scan), other_robots_m: &[[0.5, 1.4]], ..input });
        assert_eq!(occupancies(&planner), [Occupancy::Occupied; 2]);
    }
}
