//! One plan of the coordinator: viewpoints, tours, and the goals that follow.

use super::coarse::{CoarseMap, UNREACHED};
use super::floor::Floor;
use super::growth::Exhaustion;
use super::types::{
    CoordinationInput, CoordinationPhase, GoalPurpose, RobotAvailability, RobotGoal, TimeEstimate,
};
use super::views::{Viewpoint, ViewpointSearch};
use super::{FleetCoordinator, RobotRecord};
use crate::geometry::distance_m;
use crate::navigation::START_SNAP_MAX_M;
use msg::grid::Occupancy;
use msg::{ROBOTS_MAX, RobotId};

/// Space around a robot's body that is taken as free where it stands, whatever the map says, metres.
const OWN_SPACE_M: f64 = 0.095;
/// Space around the body of a robot that does not get goals which is marked as occupied, metres.
const STANDING_SPACE_M: f64 = 0.055;
/// Distance within which a robot is at its goal, metres.
pub(super) const AT_GOAL_M: f64 = 0.25;
/// Distances from the viewpoint of another robot within which a robot without one waits, metres.
const FOLLOW_M: [f64; 2] = [1.0, 2.5];
/// Smallest area for which a second robot follows, square metres: about what a door may lead to.
const FOLLOW_GAIN_MIN_M2: f64 = 1.5;
/// Every so many cells are looked at as a place to follow to: enough of those within [`FOLLOW_M`], and no row is left out.
const FOLLOW_CELL_STEP: usize = 7;

/// Buffers of a plan, kept for the next one.
#[derive(Clone, Debug, Default)]
pub(super) struct PlanBuffers {
    pub(super) views: ViewpointSearch,
    pub(super) coarse: CoarseMap,
    pub(super) floor: Floor,
    /// Route costs of each robot that gets goals, by square; in the order of [`PlanBuffers::robots`].
    pub(super) robot_costs: Vec<Vec<u32>>,
    /// Indices of robots in the input.
    pub(super) robots: Vec<usize>,
    /// Robots that would get goals, but reach no floor.
    enclosed: Vec<RobotId>,
    pub(super) viewpoints: Vec<Viewpoint>,
    /// Places of each robot's tour of the last plan, in the map, metres; in the order of the robots' numbers.
    pub(super) tours_m: Vec<Vec<[f64; 2]>>,
    pub(super) costs: Vec<u32>,
    /// Cells that were looked at in vain.
    given_up: Vec<bool>,
    /// Cells from which robots are kept out, with the clearance that they need from them.
    is_excluded: Vec<bool>,
}

impl PlanBuffers {
    /// Whether some robot could be given goals.
    pub(super) fn has_robots(&self) -> bool {
        !self.robots.is_empty()
    }

    /// Whether a robot would get goals, but reaches no floor.
    pub(super) fn is_enclosed(&self, robot: RobotId) -> bool {
        self.enclosed.contains(&robot)
    }

    /// Whether a robot reaches the square of a cell.
    pub(super) fn is_reached(&self, cell: usize) -> bool {
        let square = self.coarse.square_of(cell);
        self.robot_costs.iter().any(|costs| costs[square] != UNREACHED)
    }
}

impl FleetCoordinator {
    /// Copies the map, and marks robots.
    pub(super) fn update_map(&mut self, input: &CoordinationInput) {
        let places = input.robots.iter().filter_map(|robot| robot.map_from_base.filter(|p| p.is_finite()));
        let (mut sum, mut count) = ([0.0, 0.0], 0.0);
        for place in places {
            sum = [sum[0] + place.x_m, sum[1] + place.y_m];
            count += 1.0;
        }
        let centre_m = if count > 0.0 { sum.map(|v| v / count) } else { [0.0, 0.0] };
        self.map.copy_window(&input.map, centre_m);
        for robot in input.robots {
            let Some(pose) = robot.map_from_base.filter(|pose| pose.is_finite()) else { continue };
            let (space_m, occupancy) = if robot.availability.explores() {
                (OWN_SPACE_M, Occupancy::Free)
            } else {
                (STANDING_SPACE_M, Occupancy::Occupied)
            };
            let radius_m = self.config.body.radius_m + space_m;
            self.map.mark_disc([pose.x_m, pose.y_m], radius_m, occupancy);
        }
        self.map.compute_clearance();
    }

    /// Plans all goals anew.
    pub(super) fn plan(&mut self, input: &CoordinationInput) {
        self.update_map(input);
        self.search_robot_routes(input);
        let known_m2 = input.map.known_m2();
        self.known_area.record(input.stamp, known_m2);
        // Without a robot that can drive, nobody knows what is reachable: persons may give theirs back.
        if self.buffers.robots.is_empty() {
            self.known_area.record_no_robot(input.stamp);
            return;
        }
        // A map that is merged late, or a robot that is given back, may open what was unreachable.
        let is_exploring = self.phase == CoordinationPhase::Exploring;
        self.find_viewpoints(input, is_exploring.then_some(known_m2));
        let exhaustion = self.known_area.exhaustion();
        if is_exploring {
            self.took_too_long = !self.buffers.viewpoints.is_empty() && exhaustion == Some(Exhaustion::Time);
        }
        if !self.buffers.viewpoints.is_empty() && exhaustion.is_none() {
            self.phase = CoordinationPhase::Exploring;
            return self.assign(input);
        }
        if is_exploring {
            self.phase = CoordinationPhase::Returning;
            self.estimate = Some(TimeEstimate { least_s: 0.0, most_s: 0.0 });
            self.goals = [const { None }; ROBOTS_MAX];
        }
        self.send_home(input);
    }

    /// Computes what each free robot reaches.
    fn search_robot_routes(&mut self, input: &CoordinationInput) {
        let clearance_min_m = self.clearance_min_m();
        let Self { map, buffers, config, .. } = self;
        // As navigation has it: a zone is an obstacle, from which routes keep their clearance.
        map.mark_near_polygons(input.excluded, clearance_min_m, &mut buffers.is_excluded);
        let is_excluded = |cell: usize| buffers.is_excluded[cell];
        let free = input.robots.iter().filter(|robot| robot.availability == RobotAvailability::Free);
        let poses = free.filter_map(|robot| robot.map_from_base.filter(|pose| pose.is_finite()));
        let places_m = poses.map(|pose| [pose.x_m, pose.y_m]);
        buffers.floor.update(map, (config.body, clearance_min_m), places_m, is_excluded);
        buffers.coarse.update(map, |cell| buffers.floor.is_reached(cell));
        buffers.robots.clear();
        buffers.enclosed.clear();
        for (index, robot) in input.robots.iter().enumerate() {
            let pose = robot.map_from_base.filter(|pose| pose.is_finite());
            let is_free = robot.availability == RobotAvailability::Free;
            let Some(pose) = pose.filter(|_| is_free) else { continue };
            let at_m = [pose.x_m, pose.y_m];
            // Navigation gets a robot out of a zone, or off an obstacle, from no farther away.
            let floor = map.nearest_cell(at_m, START_SNAP_MAX_M, |cell| buffers.floor.is_reached(cell));
            let cell = floor.and_then(|_| map.cell_at(at_m));
            let start = cell.and_then(|cell| buffers.coarse.nearest_passable(buffers.coarse.square_of(cell)));
            let Some(start) = start else {
                buffers.enclosed.push(robot.robot);
                continue;
            };
            let slot = buffers.robots.len();
            if buffers.robot_costs.len() == slot {
                buffers.robot_costs.push(Vec::new());
            }
            buffers.coarse.search_from(start, &mut buffers.robot_costs[slot]);
            buffers.robots.push(index);
        }
        buffers.robot_costs.truncate(buffers.robots.len());
    }

    /// Finds viewpoints: with much to see, or if there are none, with little compared with what is known. Without `known_m2` only those with much.
    ///
    /// Each component of the floor that robots reach gets its own: what robots see from one of them, those in another one may need to see to
    /// get out.
    fn find_viewpoints(&mut self, input: &CoordinationInput, known_m2: Option<f64>) {
        let Self { map, buffers, config, unseen, goals, .. } = self;
        let mut views = core::mem::take(&mut buffers.views);
        let mut found = core::mem::take(&mut buffers.viewpoints);
        let mut given_up = core::mem::take(&mut buffers.given_up);
        let floor = &buffers.floor;
        unseen.mark_given_up(map, &mut given_up);
        let is_opaque = |cell: usize| given_up[cell] || !floor.is_possible(cell);
        // Where robots stand and where they go now are candidates too.
        let places = buffers.robots.iter().flat_map(|index| {
            let robot = &input.robots[*index];
            let here = robot.map_from_base.map(|pose| [pose.x_m, pose.y_m]);
            let goal =
                goals[robot.robot.index()].as_ref().filter(|goal| goal.purpose == GoalPurpose::Explore);
            let is_out = |cell: &usize| buffers.is_excluded[*cell];
            let here = here.and_then(|at_m| map.cell_at(at_m)).filter(|cell| !is_out(cell));
            let goal =
                goal.and_then(|goal| map.cell_at(goal.position_m)).filter(|cell| floor.is_reached(*cell));
            [here, goal]
        });
        let with_component = |cell| Some((cell, floor.component_near(map, map.cell_centre_m(cell))?));
        let reached = places.flatten().filter(|cell| buffers.is_reached(*cell));
        let extra: Vec<(usize, u8)> = reached.filter_map(with_component).collect();
        let gains_m2 = [Some(config.gain_min_m2), known_m2.map(|known_m2| config.gain_last_m2(known_m2))];
        found.clear();
        views.count_frontiers(map);
        for component in 1..=floor.components() {
            let is_candidate = |cell: usize| floor.component(cell) == component;
            let extra: Vec<usize> =
                extra.iter().filter(|(_, of)| *of == component).map(|(cell, _)| *cell).collect();
            // What the components before leave over is for the others.
            let still_to_come = usize::from(floor.components() - component) + 1;
            let share = config.viewpoints_max.saturating_sub(found.len()).div_ceil(still_to_come);
            let (before, most) = (found.len(), found.len() + share);
            for gain_min_m2 in gains_m2.into_iter().flatten() {
                views.find(map, config, &is_candidate, &is_opaque, &extra, gain_min_m2, most, &mut found);
                if found.len() > before {
                    break;
                }
            }
        }
        (buffers.views, buffers.viewpoints, buffers.given_up) = (views, found, given_up);
    }

    /// Lets a robot without a viewpoint wait near the one that promises most for each robot there.
    pub(super) fn follow(&mut self, input: &CoordinationInput, slot: usize, assigned: &mut [u32]) {
        let robot = input.robots[self.buffers.robots[slot]];
        let index = robot.robot.index();
        let pose = robot.map_from_base.unwrap_or_default();
        let buffers = &self.buffers;
        let worth = |i: usize| buffers.viewpoints[i].gain_m2 / f64::from(assigned[i] + 1);
        let best = (0..assigned.len())
            .filter(|i| buffers.viewpoints[*i].gain_m2 >= FOLLOW_GAIN_MIN_M2)
            .filter(|i| {
                let square = buffers.coarse.square_of(buffers.viewpoints[*i].cell);
                buffers.coarse.length_m(buffers.robot_costs[slot][square]).is_some()
            })
            .max_by(|a, b| worth(*a).total_cmp(&worth(*b)).then(b.cmp(a)));
        let Some(best) = best else {
            self.goals[index] = None;
            return;
        };
        assigned[best] += 1;
        let beside_m = self.map.cell_centre_m(buffers.viewpoints[best].cell);
        let is_near = |at_m: [f64; 2]| (FOLLOW_M[0]..FOLLOW_M[1]).contains(&distance_m(at_m, beside_m));
        if is_near([pose.x_m, pose.y_m]) {
            self.goals[index] = None;
            return;
        }
        let kept = self.goals[index].as_ref().filter(|goal| goal.purpose == GoalPurpose::Follow);
        if kept.is_some_and(|goal| is_near(goal.position_m)) {
            return;
        }
        let cost = |cell: &usize| buffers.robot_costs[slot][buffers.coarse.square_of(*cell)];
        let clearance_min_m = self.clearance_min_m();
        let place = (0..self.map.cell_count())
            .step_by(FOLLOW_CELL_STEP)
            .filter(|cell| {
                self.map.clearance_m(*cell) >= clearance_min_m && is_near(self.map.cell_centre_m(*cell))
            })
            .filter(|cell| self.map.occupancy(*cell) == Occupancy::Free && cost(cell) != UNREACHED)
            .filter(|cell| !self.records[index].failed.is_avoided(input.stamp, self.map.cell_centre_m(*cell)))
            .min_by_key(|cell| (cost(cell), *cell));
        self.goals[index] = place.map(|cell| RobotGoal {
            purpose: GoalPurpose::Follow,
            position_m: self.map.cell_centre_m(cell),
            headings_rad: Vec::new(),
            expected_s: buffers.coarse.length_m(cost(&cell)).unwrap_or(0.0) / self.speeds().0,
            gain_m2: 0.0,
        });
    }

    /// Sends robots that are not home yet to where they began.
    fn send_home(&mut self, input: &CoordinationInput) {
        let mut is_anyone_away = false;
        for robot in input.robots.iter().filter(|robot| robot.availability == RobotAvailability::Free) {
            let index = robot.robot.index();
            let &RobotRecord { home, has_returned, .. } = &self.records[index];
            let Some(home) = home.filter(|_| !has_returned) else { continue };
            is_anyone_away = true;
            self.goals[index].get_or_insert(RobotGoal {
                purpose: GoalPurpose::Home,
                position_m: [home.x_m, home.y_m],
                headings_rad: vec![home.yaw_rad],
                expected_s: 0.0,
                gain_m2: 0.0,
            });
        }
        self.phase = if is_anyone_away { CoordinationPhase::Returning } else { CoordinationPhase::Done };
        if !is_anyone_away {
            self.goals = [const { None }; ROBOTS_MAX];
        }
    }
}
