//! Who sees what next: viewpoints become tours, and the first of each tour a robot's goal.

use super::FleetCoordinator;
use super::plan::AT_GOAL_M;
use super::tours::TourProblem;
use super::types::{CoordinationInput, GoalPurpose, RobotGoal, TimeEstimate};
use super::views::Viewpoint;
use crate::geometry::distance_m;
use core::f64::consts::{FRAC_PI_2, PI};
use msg::pose::wrap_angle;
use msg::{Pose2, ROBOTS_MAX};

/// Mean speed along a route, and mean turning speed, as shares of the follower's limits: curves, stops, ramps.
const SPEED_SHARE: f64 = 0.9;
/// Time to begin to move and to stop, seconds.
const STOP_S: f64 = 0.7;
/// Distance within which a viewpoint is the current goal of a robot, metres: the lattice moves with the map.
const SAME_GOAL_M: f64 = 0.5;
/// Factor of the most by the least time expected, for a fleet that has just begun.
const ESTIMATE_FACTOR: f64 = 3.0;
/// Time expected at which half of that factor is left, seconds: what is still unknown then is a smaller share.
const ESTIMATE_HALF_S: f64 = 600.0;
/// Headings that differ by less are one, radians.
const SAME_HEADING_RAD: f64 = 1e-3;

impl FleetCoordinator {
    /// Assigns viewpoints to robots as tours, and sets the robots' goals to the first of each.
    pub(super) fn assign(&mut self, input: &CoordinationInput) {
        let problem = self.tour_problem(input);
        let tours = problem.solve();
        self.keep_tours(input, &tours);
        let mut assigned = vec![0_u32; self.buffers.viewpoints.len()];
        let mut latest_s: f64 = 0.0;
        let mut idle = Vec::new();
        for (slot, tour) in tours.iter().enumerate() {
            let robot = input.robots[self.buffers.robots[slot]];
            self.records[robot.robot.index()].has_returned = false;
            let Some(first) = tour.first() else {
                idle.push(slot);
                continue;
            };
            assigned[*first] += 1;
            latest_s = latest_s.max(problem.duration_s(slot, tour));
            let viewpoint = self.buffers.viewpoints[*first];
            let expected_s = problem.from_robot_s[slot][*first] + problem.service_s[*first];
            self.known_area.record_goal(expected_s);
            let pose = robot.map_from_base.unwrap_or_default();
            self.goals[robot.robot.index()] = Some(self.goal_at(&viewpoint, pose, expected_s));
        }
        let factor = 1.0 + (ESTIMATE_FACTOR - 1.0) / (1.0 + latest_s / ESTIMATE_HALF_S);
        self.estimate = Some(TimeEstimate { least_s: latest_s, most_s: latest_s * factor });
        for slot in idle {
            self.follow(input, slot, &mut assigned);
        }
    }

    fn tour_problem(&mut self, input: &CoordinationInput) -> TourProblem {
        let config = self.config;
        let (speed_m_s, turn_rad_s) = self.speeds();
        let Self { map, buffers, goals, records, .. } = self;
        let count = buffers.viewpoints.len();
        let mut problem =
            TourProblem { makespan_weight: config.makespan_weight_m2, ..TourProblem::default() };
        let squares: Vec<Option<usize>> = buffers
            .viewpoints
            .iter()
            .map(|viewpoint| buffers.coarse.nearest_passable(buffers.coarse.square_of(viewpoint.cell)))
            .collect();
        for (slot, index) in buffers.robots.iter().enumerate() {
            let robot = &input.robots[*index];
            let pose = robot.map_from_base.unwrap_or_default();
            let goal_m = goals[robot.robot.index()].as_ref().map(|goal| goal.position_m);
            let time_s = |i: usize| {
                let square = squares[i]?;
                let length_m = buffers.coarse.length_m(buffers.robot_costs[slot][square])?;
                let viewpoint = &buffers.viewpoints[i];
                let at_m = map.cell_centre_m(viewpoint.cell);
                if records[robot.robot.index()].failed.is_avoided(input.stamp, at_m) {
                    return None;
                }
                let switch_s = match goal_m {
                    Some(goal_m) if distance_m(goal_m, at_m) > SAME_GOAL_M => config.switch_cost_s,
                    _ => 0.0,
                };
                let turn_rad = first_turn_rad(pose, at_m, viewpoint, config.sees_all_around());
                let is_here = distance_m([pose.x_m, pose.y_m], at_m) < AT_GOAL_M;
                let length_m = if is_here { 0.0 } else { length_m };
                Some(length_m / speed_m_s + turn_rad / turn_rad_s + switch_s)
            };
            problem.from_robot_s.push((0..count).map(|i| time_s(i).unwrap_or(f64::INFINITY)).collect());
        }
        let mut costs = core::mem::take(&mut buffers.costs);
        for from in &squares {
            let mut row = vec![f64::INFINITY; count];
            if let Some(from) = from {
                buffers.coarse.search_from(*from, &mut costs);
                for (time_s, to) in row.iter_mut().zip(&squares) {
                    let length_m = to.and_then(|to| buffers.coarse.length_m(costs[to]));
                    // Half a turn of a right angle before and after, in the mean.
                    *time_s =
                        length_m.map_or(f64::INFINITY, |m| m / speed_m_s + FRAC_PI_2 / turn_rad_s + STOP_S);
                }
            }
            problem.between_s.push(row);
        }
        buffers.costs = costs;
        problem.service_s = buffers.viewpoints.iter().map(|v| v.sweep_rad / turn_rad_s).collect();
        problem.weight = buffers.viewpoints.iter().map(|v| v.gain_m2 + config.pocket_m2).collect();
        problem.previous = self.previous_tours(input);
        problem
    }

    /// What remains of the robots' tours of the last plan: viewpoints at the places that these went through.
    fn previous_tours(&self, input: &CoordinationInput) -> Vec<Vec<usize>> {
        let Self { map, buffers, .. } = self;
        let at_m = |i: usize| map.cell_centre_m(buffers.viewpoints[i].cell);
        let mut is_taken = vec![false; buffers.viewpoints.len()];
        let mut find = |place_m: &[f64; 2]| {
            let away_m = |i: &usize| distance_m(at_m(*i), *place_m);
            let free = (0..is_taken.len()).filter(|i| !is_taken[*i] && away_m(i) < SAME_GOAL_M);
            let nearest = free.min_by(|a, b| away_m(a).total_cmp(&away_m(b)))?;
            is_taken[nearest] = true;
            Some(nearest)
        };
        let mut tour = |index: &usize| {
            let robot = input.robots[*index].robot;
            buffers.tours_m.get(robot.index()).into_iter().flatten().filter_map(&mut find).collect()
        };
        buffers.robots.iter().map(&mut tour).collect()
    }

    /// Remembers where the tours lead.
    fn keep_tours(&mut self, input: &CoordinationInput, tours: &[Vec<usize>]) {
        let Self { map, buffers, .. } = self;
        buffers.tours_m.resize(ROBOTS_MAX, Vec::new());
        buffers.tours_m.iter_mut().for_each(Vec::clear);
        for (index, tour) in buffers.robots.iter().zip(tours) {
            let places_m = tour.iter().map(|i| map.cell_centre_m(buffers.viewpoints[*i].cell));
            buffers.tours_m[input.robots[*index].robot.index()].extend(places_m);
        }
    }

    /// Mean speeds expected, m/s and rad/s.
    pub(super) fn speeds(&self) -> (f64, f64) {
        (self.follower.cruise_m_s * SPEED_SHARE, self.follower.turn_rad_s * SPEED_SHARE)
    }

    fn goal_at(&self, viewpoint: &Viewpoint, pose: Pose2, expected_s: f64) -> RobotGoal {
        let position_m = self.map.cell_centre_m(viewpoint.cell);
        let is_here = distance_m([pose.x_m, pose.y_m], position_m) < AT_GOAL_M;
        let arrival_rad = if is_here {
            pose.yaw_rad
        } else {
            crate::geometry::bearing_rad([pose.x_m, pose.y_m], position_m)
        };
        let grid_rad = self.map.yaw_rad();
        let (first, last) =
            (grid_rad + viewpoint.look_rad, grid_rad + viewpoint.look_rad + viewpoint.sweep_rad);
        let is_nearer = wrap_angle(first - arrival_rad).abs() <= wrap_angle(last - arrival_rad).abs();
        let (first, last) = if is_nearer { (first, last) } else { (last, first) };
        let steps = ((last - first).abs() / FRAC_PI_2).ceil().max(1.0) as usize;
        let heading = |i: usize| wrap_angle(first + (last - first) * i as f64 / steps as f64);
        let headings_rad = if self.config.sees_all_around() {
            Vec::new()
        } else if (last - first).abs() < SAME_HEADING_RAD {
            vec![wrap_angle(first)]
        } else {
            (0..=steps).map(heading).collect()
        };
        RobotGoal {
            purpose: GoalPurpose::Explore,
            position_m,
            headings_rad,
            expected_s,
            gain_m2: viewpoint.gain_m2,
        }
    }
}

/// Angle that a robot turns before and after it drives straight to a viewpoint, radians.
fn first_turn_rad(pose: Pose2, at_m: [f64; 2], viewpoint: &Viewpoint, sees_all_around: bool) -> f64 {
    let here_m = [pose.x_m, pose.y_m];
    let end_rad = viewpoint.look_rad + viewpoint.sweep_rad;
    let to_look = |from_rad: f64| {
        if sees_all_around {
            return 0.0;
        }
        wrap_angle(viewpoint.look_rad - from_rad).abs().min(wrap_angle(end_rad - from_rad).abs())
    };
    if distance_m(here_m, at_m) < AT_GOAL_M {
        return to_look(pose.yaw_rad);
    }
    let way_rad = crate::geometry::bearing_rad(here_m, at_m);
    (wrap_angle(way_rad - pose.yaw_rad).abs() + to_look(way_rad)).min(2.0 * PI)
}
