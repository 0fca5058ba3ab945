//! The methods compared: who goes where next.

use crate::driver::Task;
use crate::world::World;
use msg::Stamp;
use nav::coordination::{
    CoordinatedRobot, CoordinationInput, CoordinationPhase, GoalProgress, RobotAvailability,
};
use nav::geometry::{bearing_rad, distance_m};
use nav::{ClearanceMap, CoordinationConfig, FleetCoordinator, RobotBody, RouteSearch};

/// Name of a method.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// `nav::FleetCoordinator`.
    Coordinated,
    /// The same, driven by `nav::FleetNavigator` instead of the bench's driver.
    Navigated,
    /// Each robot by itself with the cost function and the parameters of explore_lite.
    Greedy,
    /// Burgard, Moors, Stachniss and Schneider (2005).
    Burgard,
    /// `nav::ExplorationTour`, all robots at once: drives by itself.
    Tour,
}

impl Kind {
    pub const ALL: [Self; 5] = [Self::Coordinated, Self::Burgard, Self::Greedy, Self::Tour, Self::Navigated];

    pub fn name(self) -> &'static str {
        match self {
            Self::Coordinated => "coordinated",
            Self::Navigated => "navigated",
            Self::Greedy => "greedy",
            Self::Burgard => "burgard",
            Self::Tour => "tour",
        }
    }
}

/// Chooses the robots' tasks.
pub trait Method {
    /// Changes the tasks where it wants to. `None`: the robot stands.
    fn choose(&mut self, world: &World, progress: &[GoalProgress], tasks: &mut [Option<Task>]);
    /// Whether the method has ended.
    fn is_done(&self) -> bool;
    /// What is left and why, for people.
    fn leftovers(&self) -> Vec<String> {
        Vec::new()
    }
    fn plans(&self) -> u32;
}

/// `nav::FleetCoordinator`.
pub struct Coordinated(FleetCoordinator);

impl Coordinated {
    pub fn new(config: CoordinationConfig) -> Self {
        Self(FleetCoordinator::new(config))
    }
}

impl Method for Coordinated {
    fn choose(&mut self, world: &World, progress: &[GoalProgress], tasks: &mut [Option<Task>]) {
        let robot = |(robot, progress): (&crate::world::Robot, &GoalProgress)| CoordinatedRobot {
            robot: robot.id,
            map_from_base: Some(robot.pose()),
            home: None,
            availability: RobotAvailability::Free,
            progress: *progress,
        };
        let robots: Vec<CoordinatedRobot> = world.robots.iter().zip(progress).map(robot).collect();
        let plans = self.0.plans();
        self.0.update(&CoordinationInput {
            stamp: world.now,
            map: world.map_view(),
            robots: &robots,
            excluded: &[],
        });
        if self.0.plans() == plans {
            return;
        }
        for (robot, task) in world.robots.iter().zip(tasks) {
            let goal = self.0.goal(robot.id);
            *task = goal.map(|g| Task { position_m: g.position_m, headings_rad: g.headings_rad.clone() });
        }
    }

    fn is_done(&self) -> bool {
        self.0.phase() != CoordinationPhase::Exploring
    }

    fn leftovers(&self) -> Vec<String> {
        let left = self.0.leftovers();
        let text = left.iter().take(5).map(|left| {
            let [x, y] = left.position_m;
            format!("{:.1} m of frontier at ({x:.1}, {y:.1}): {}", left.length_m, left.reason)
        });
        text.collect()
    }

    fn plans(&self) -> u32 {
        self.0.plans()
    }
}

/// Clearance that a robot needs on the map, metres.
pub fn clearance_m(map: &ClearanceMap) -> f64 {
    RobotBody::default().clearance_min_m(map.cell_size_m())
}

/// Copies the map as one window around its middle.
pub fn copy_map(world: &World, map: &mut ClearanceMap) {
    let header = &world.map.header;
    let view = world.map.view();
    map.copy_window(
        &world.map_view(),
        view.centre_m(i64::from(header.width) / 2, i64::from(header.height) / 2),
    );
    for robot in &world.robots {
        map.mark_disc([robot.pose().x_m, robot.pose().y_m], 0.2, msg::grid::Occupancy::Free);
    }
    map.compute_clearance();
}

/// The last passable cell on the route to a cell, in the map.
pub fn approach_m(map: &ClearanceMap, routes: &RouteSearch, cell: usize, route: &mut Vec<usize>) -> [f64; 2] {
    routes.route_to(map, cell, route);
    let last = route.iter().take_while(|cell| routes.is_passable(map, **cell)).last();
    map.cell_centre_m(*last.unwrap_or(&cell))
}

/// explore_lite's parameters (m-explore-ros2, config/params.yaml).
const PLANNER_PERIOD_S: f64 = 1.0 / 0.15;
const POTENTIAL_SCALE: f64 = 3.0;
const GAIN_SCALE: f64 = 1.0;
const FRONTIER_MIN_M: f64 = 0.75;
const PROGRESS_TIMEOUT_S: f64 = 30.0;
/// Distance within which a goal is the same as one that was given up, metres: explore_lite's five cells.
const BLACKLIST_M: f64 = 0.25;

/// Independent greedy exploration.
pub struct Greedy {
    map: ClearanceMap,
    routes: RouteSearch,
    robots: Vec<GreedyRobot>,
    plans: u32,
}

#[derive(Clone, Default)]
struct GreedyRobot {
    planned_at: Option<Stamp>,
    blacklist: Vec<[f64; 2]>,
    /// Centroid that it drives to, smallest distance to it so far, and the time of the last progress.
    goal: Option<([f64; 2], f64, Stamp)>,
    is_done: bool,
}

/// Unknown cells beside free ones that a robot reaches, connected.
struct OpenFrontier {
    centroid_m: [f64; 2],
    nearest_m: f64,
    cells: usize,
}

impl Greedy {
    pub fn new(robots: usize) -> Self {
        let robots = vec![GreedyRobot::default(); robots];
        Self { map: ClearanceMap::default(), routes: RouteSearch::default(), robots, plans: 0 }
    }

    fn frontiers(&self, here_m: [f64; 2]) -> Vec<OpenFrontier> {
        use msg::grid::Occupancy;
        let map = &self.map;
        let is_unknown = |cell: usize| map.occupancy(cell) == Occupancy::Unknown;
        let mut is_open = vec![false; map.cell_count()];
        for cell in self.routes.reached_cells() {
            for side in [0, 2, 4, 6].into_iter().filter_map(|d| map.neighbour(*cell, d)) {
                is_open[side] |= is_unknown(side);
            }
        }
        let mut found = Vec::new();
        for seed in 0..map.cell_count() {
            if !core::mem::take(&mut is_open[seed]) {
                continue;
            }
            let (mut cells, mut next) = (vec![seed], 0);
            while next < cells.len() {
                for side in (0..8).filter_map(|d| map.neighbour(cells[next], d)).collect::<Vec<_>>() {
                    if core::mem::take(&mut is_open[side]) {
                        cells.push(side);
                    }
                }
                next += 1;
            }
            let count = cells.len() as f64;
            if count * map.cell_size_m() < FRONTIER_MIN_M {
                continue;
            }
            let centres = || cells.iter().map(|cell| map.cell_centre_m(*cell));
            let sum = centres().fold([0.0, 0.0], |s, c| [s[0] + c[0], s[1] + c[1]]);
            let nearest_m = centres().map(|c| distance_m(c, here_m)).fold(f64::INFINITY, f64::min);
            found.push(OpenFrontier { centroid_m: sum.map(|v| v / count), nearest_m, cells: cells.len() });
        }
        found
    }

    /// The goal of one robot: place to drive to, and centroid.
    fn plan(&mut self, world: &World, index: usize) -> Option<([f64; 2], [f64; 2])> {
        let pose = world.robots[index].pose();
        let here_m = [pose.x_m, pose.y_m];
        if !self.routes.search_from(&self.map, here_m, clearance_m(&self.map)) {
            return None;
        }
        let cell_m = self.map.cell_size_m();
        let cost =
            |f: &OpenFrontier| POTENTIAL_SCALE * f.nearest_m * cell_m - GAIN_SCALE * f.cells as f64 * cell_m;
        let blacklist = &self.robots[index].blacklist;
        let mut frontiers = self.frontiers(here_m);
        frontiers
            .retain(|f| blacklist.iter().all(|given_up| distance_m(*given_up, f.centroid_m) > BLACKLIST_M));
        let best = frontiers.iter().min_by(|a, b| cost(a).total_cmp(&cost(b)))?;
        // Nav2 drives to the nearest place where the robot fits.
        let is_passable = |cell: &&usize| self.routes.is_passable(&self.map, **cell);
        let place = self.routes.reached_cells().iter().filter(is_passable).min_by(|a, b| {
            let away = |cell: usize| distance_m(self.map.cell_centre_m(cell), best.centroid_m);
            away(**a).total_cmp(&away(**b))
        })?;
        Some((self.map.cell_centre_m(*place), best.centroid_m))
    }
}

impl Method for Greedy {
    fn choose(&mut self, world: &World, progress: &[GoalProgress], tasks: &mut [Option<Task>]) {
        let mut is_map_copied = false;
        for index in 0..world.robots.len() {
            let now = world.now;
            let pose = world.robots[index].pose();
            let robot = &mut self.robots[index];
            if let Some((goal_m, nearest_m, at)) = &mut robot.goal {
                let apart_m = distance_m([pose.x_m, pose.y_m], *goal_m);
                if apart_m < *nearest_m - 0.02 {
                    (*nearest_m, *at) = (apart_m, now);
                }
                if now - *at > PROGRESS_TIMEOUT_S || progress[index] == GoalProgress::Failed {
                    robot.blacklist.push(*goal_m);
                    (robot.goal, robot.planned_at) = (None, None);
                }
            }
            // explore_lite plans at once when Nav2 has arrived; a second between two plans bounds the work.
            let has_ended = matches!(progress[index], GoalProgress::Reached)
                && robot.planned_at.is_none_or(|at| now - at >= 1.0);
            let is_due = robot.planned_at.is_none_or(|at| now - at >= PLANNER_PERIOD_S);
            if !(is_due || has_ended) {
                continue;
            }
            if !core::mem::replace(&mut is_map_copied, true) {
                copy_map(world, &mut self.map);
            }
            self.plans += 1;
            let plan = self.plan(world, index);
            let robot = &mut self.robots[index];
            robot.planned_at = Some(now);
            robot.is_done = plan.is_none();
            tasks[index] = plan.map(|(place_m, centroid_m)| {
                let is_same = robot.goal.is_some_and(|(old, ..)| distance_m(old, centroid_m) < 0.1);
                if !is_same {
                    robot.goal = Some((centroid_m, f64::INFINITY, now));
                }
                Task { position_m: place_m, headings_rad: vec![bearing_rad(place_m, centroid_m)] }
            });
        }
    }

    fn is_done(&self) -> bool {
        self.robots.iter().all(|robot| robot.is_done)
    }

    fn plans(&self) -> u32 {
        self.plans
    }
}
