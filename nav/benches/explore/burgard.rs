//! Coordination by Burgard, Moors, Stachniss and Schneider (2005): utility of frontiers less the cost of the way.

use crate::driver::Task;
use crate::methods::{Method, approach_m, clearance_m, copy_map};
use crate::world::World;
use msg::Stamp;
use nav::coordination::GoalProgress;
use nav::geometry::{bearing_rad, distance_m};
use nav::{ClearanceMap, FrontierSearch, RouteSearch};

/// Time between two assignments by Burgard, seconds. The paper assigns when a robot needs a target; more often is better.
const ASSIGN_PERIOD_S: f64 = 2.0;
/// Weight of a metre of way against the utility of a frontier, 1/m: `beta` of the paper, for its utilities of 0 to 1.
const BETA_PER_M: f64 = 0.06;
/// Range within which a frontier's utility is reduced by an assigned one, metres: the sensor's.
const REDUCE_RANGE_M: f64 = 3.5;
/// Attempts after which a frontier is left alone, and the distance within which it is the same, metres.
const ATTEMPTS_MAX: u32 = 3;
const SAME_FRONTIER_M: f64 = 0.3;

/// Coordination by Burgard and others (2005).
pub struct Burgard {
    map: ClearanceMap,
    routes: Vec<RouteSearch>,
    search: FrontierSearch,
    assigned_at: Option<Stamp>,
    /// Frontier of each robot's task.
    targets: Vec<Option<[f64; 2]>>,
    attempts: Vec<([f64; 2], u32)>,
    is_done: bool,
    plans: u32,
}

impl Burgard {
    pub fn new(robots: usize) -> Self {
        let routes = vec![RouteSearch::default(); robots];
        Self {
            map: ClearanceMap::default(),
            routes,
            search: FrontierSearch::default(),
            assigned_at: None,
            targets: vec![None; robots],
            attempts: Vec::new(),
            is_done: false,
            plans: 0,
        }
    }

    fn assign(&mut self, world: &World, tasks: &mut [Option<Task>]) {
        copy_map(world, &mut self.map);
        let clearance_m = clearance_m(&self.map);
        let mut frontiers = Vec::new();
        for (robot, routes) in world.robots.iter().zip(&mut self.routes) {
            let pose = robot.pose();
            if !routes.search_from(&self.map, [pose.x_m, pose.y_m], clearance_m) {
                continue;
            }
            for frontier in self.search.find_frontiers(&self.map, routes) {
                let at_m = self.map.cell_centre_m(frontier.unknown_cell);
                let is_known = |(_, other): &(usize, [f64; 2])| distance_m(*other, at_m) < SAME_FRONTIER_M;
                let tried =
                    self.attempts.iter().find(|(other, _)| distance_m(*other, at_m) < SAME_FRONTIER_M);
                if tried.is_none_or(|(_, count)| *count < ATTEMPTS_MAX) && !frontiers.iter().any(is_known) {
                    frontiers.push((frontier.free_cell, at_m));
                }
            }
        }
        self.is_done = frontiers.is_empty();
        let mut utility = vec![1.0_f64; frontiers.len()];
        let mut free: Vec<usize> = (0..world.robots.len()).collect();
        tasks.iter_mut().for_each(|task| *task = None);
        self.targets.iter_mut().for_each(|target| *target = None);
        let mut route = Vec::new();
        while !free.is_empty() && !frontiers.is_empty() {
            let mut best: Option<(f64, usize, usize)> = None;
            for (slot, robot) in free.iter().enumerate() {
                for (target, (cell, _)) in frontiers.iter().enumerate() {
                    let Some(cost_m) = self.routes[*robot].cost_m(&self.map, *cell) else { continue };
                    let value = utility[target] - BETA_PER_M * cost_m;
                    if best.is_none_or(|(most, ..)| value > most) {
                        best = Some((value, slot, target));
                    }
                }
            }
            let Some((_, slot, target)) = best else { break };
            let robot = free.remove(slot);
            let (cell, at_m) = frontiers[target];
            let place_m = approach_m(&self.map, &self.routes[robot], cell, &mut route);
            tasks[robot] = Some(Task { position_m: place_m, headings_rad: vec![bearing_rad(place_m, at_m)] });
            self.targets[robot] = Some(at_m);
            for ((_, other_m), utility) in frontiers.iter().zip(&mut utility) {
                *utility -= (1.0 - distance_m(*other_m, at_m) / REDUCE_RANGE_M).max(0.0);
            }
        }
    }
}

impl Method for Burgard {
    fn choose(&mut self, world: &World, progress: &[GoalProgress], tasks: &mut [Option<Task>]) {
        let mut has_ended = false;
        for (progress, target) in progress.iter().zip(&mut self.targets) {
            let weight = match progress {
                GoalProgress::Reached => 1,
                GoalProgress::Failed => ATTEMPTS_MAX,
                _ => continue,
            };
            let Some(at_m) = target.take() else { continue };
            has_ended = true;
            match self.attempts.iter_mut().find(|(other, _)| distance_m(*other, at_m) < SAME_FRONTIER_M) {
                Some((_, count)) => *count += weight,
                None => self.attempts.push((at_m, weight)),
            }
        }
        let is_due = self.assigned_at.is_none_or(|at| world.now - at >= ASSIGN_PERIOD_S);
        if is_due || has_ended {
            self.assigned_at = Some(world.now);
            self.plans += 1;
            self.assign(world, tasks);
        }
    }

    fn is_done(&self) -> bool {
        self.is_done
    }

    fn plans(&self) -> u32 {
        self.plans
    }
}
