//! Exploration tour that drives several robots, one after the other or all at once.
//!
//! Deterministic: the same observations and seed give the same commands.

use crate::command::{DriveCommand, Twist};
use crate::config::NavConfig;
use crate::exploration::ExplorationPlanner;
use crate::explorer::{ExplorationStats, Explorer, OtherRobots};
use crate::observation::{FleetObservation, RobotObservation};
use msg::{ROBOTS_MAX, RobotId, Stamp};

/// Longest time that a robot which cannot be driven keeps its turn, seconds.
const IDLE_MAX_S: f64 = 2.0;
/// Longest step that counts as time of a turn, seconds: a pause of the operator is none.
const STEP_MAX_S: f64 = 1.0;

/// Parameters of a tour.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TourConfig {
    /// Length of a robot's turn, seconds, above 0. 20 s is time for two or three goals.
    pub time_slice_s: f64,
    /// Parameters of each robot's navigation.
    pub nav: NavConfig,
    /// Random seed of the tour.
    pub seed: u64,
}

impl Default for TourConfig {
    fn default() -> Self {
        Self { time_slice_s: 20.0, nav: NavConfig::default(), seed: 1 }
    }
}

/// What the tour has done with one robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RobotTourStats {
    /// The robot described.
    pub robot: RobotId,
    /// Number of turns that the robot had; 0 if all robots were driven at once.
    pub turns: u32,
    /// Length of all its turns, seconds.
    pub held_s: f64,
    /// What its explorer has done.
    pub exploration: ExplorationStats,
}

/// Exploration of a fleet.
///
/// ```
/// use msg::{RobotId, Stamp};
/// use nav::{ExplorationTour, FleetObservation, RobotObservation, TourConfig, Twist};
///
/// let mut tour = ExplorationTour::new(TourConfig::default(), RobotId::first(2)).unwrap();
/// let robots: Vec<_> = RobotId::first(2).map(RobotObservation::unknown).collect();
/// let mut commands = Vec::new();
/// tour.step_all(&FleetObservation { stamp: Stamp(0), robots: &robots }, &mut commands);
/// // Nothing is known of the robots yet, so both stand still.
/// assert_eq!(commands.len(), 2);
/// assert!(commands.iter().all(|command| command.twist == Twist::STOP));
/// ```
#[derive(Clone, Debug)]
pub struct ExplorationTour {
    config: TourConfig,
    planner: ExplorationPlanner,
    explorers: Vec<Explorer>,
    /// Index of the robot whose turn it is; if all are driven at once, of the one that may plan.
    active: usize,
    turn_started: Option<Stamp>,
    turns: [u32; ROBOTS_MAX],
    held_s: [f64; ROBOTS_MAX],
    last_step: Option<Stamp>,
}

impl ExplorationTour {
    /// A tour with these robots in this order. `None` without any.
    pub fn new(config: TourConfig, robots: impl IntoIterator<Item = RobotId>) -> Option<Self> {
        let mut tour = Self {
            config,
            planner: ExplorationPlanner::new(&config.nav),
            explorers: Vec::new(),
            active: 0,
            turn_started: None,
            turns: [0; ROBOTS_MAX],
            held_s: [0.0; ROBOTS_MAX],
            last_step: None,
        };
        robots.into_iter().for_each(|robot| tour.add(robot));
        (!tour.explorers.is_empty()).then_some(tour)
    }

    /// Adds a robot after all others, unless it is part of the tour already.
    pub fn add(&mut self, robot: RobotId) {
        if self.explorers.iter().all(|explorer| explorer.robot() != robot) {
            self.explorers.push(Explorer::new(robot, self.config.nav, self.config.seed));
        }
    }

    /// Sets the length of a turn, seconds.
    pub fn set_time_slice_s(&mut self, time_slice_s: f64) {
        self.config.time_slice_s = time_slice_s;
    }

    /// Drives the robot whose turn it is: one control step.
    ///
    /// The last command of a turn stops the robot, so that it stands still during the others' turns.
    pub fn step_in_turn(&mut self, observation: &FleetObservation) -> DriveCommand {
        let now = observation.stamp;
        let elapsed_s = self.last_step.map_or(0.0, |last| now - last);
        self.last_step = Some(now);
        let explorer = &mut self.explorers[self.active];
        let robot = explorer.robot();
        self.held_s[robot.index()] += elapsed_s.clamp(0.0, STEP_MAX_S);
        let started = *self.turn_started.get_or_insert_with(|| {
            self.turns[robot.index()] += 1;
            now
        });
        let is_idle = explorer.idle_since().is_some_and(|since| now - since > IDLE_MAX_S);
        if self.explorers.len() > 1 && (is_idle || now - started >= self.config.time_slice_s) {
            self.explorers[self.active].pause();
            self.active = (self.active + 1) % self.explorers.len();
            self.turn_started = None;
            return DriveCommand { robot, twist: Twist::STOP };
        }
        DriveCommand { robot, twist: self.step_robot(self.active, observation, true) }
    }

    /// Drives all robots: one control step, one command for each.
    ///
    /// At most one robot plans in a step, in rotation, so that a step takes no longer than one plan.
    pub fn step_all(&mut self, observation: &FleetObservation, commands: &mut Vec<DriveCommand>) {
        commands.clear();
        self.last_step = Some(observation.stamp);
        let count = self.explorers.len();
        let mut rotation = (1..=count).map(|i| (self.active + i) % count);
        let is_due = |i: &usize| self.explorers[*i].next_plan_at() <= observation.stamp;
        self.active = rotation.find(is_due).unwrap_or(self.active);
        for i in 0..count {
            let twist = self.step_robot(i, observation, self.active == i);
            commands.push(DriveCommand { robot: self.explorers[i].robot(), twist });
        }
    }

    /// The robot whose turn it is; if all are driven at once, the one that planned last.
    pub fn active_robot(&self) -> RobotId {
        self.explorers[self.active].robot()
    }

    /// What the tour has done with each robot.
    pub fn stats(&self) -> impl Iterator<Item = RobotTourStats> + '_ {
        self.explorers.iter().map(|explorer| {
            let robot = explorer.robot();
            let (turns, held_s) = (self.turns[robot.index()], self.held_s[robot.index()]);
            RobotTourStats { robot, turns, held_s, exploration: explorer.stats() }
        })
    }

    /// Explorers of the robots, with their goals.
    pub fn explorers(&self) -> &[Explorer] {
        &self.explorers
    }

    fn step_robot(&mut self, index: usize, observation: &FleetObservation, may_plan: bool) -> Twist {
        let robot = self.explorers[index].robot();
        let unknown = RobotObservation::unknown(robot);
        let own = observation.robots.iter().find(|seen| seen.robot == robot).unwrap_or(&unknown);
        let mut positions_m = Vec::with_capacity(ROBOTS_MAX);
        let mut goals_m = Vec::with_capacity(ROBOTS_MAX);
        // Only poses in the merged map can be compared.
        let is_comparable =
            |other: &&RobotObservation| other.robot != robot && other.in_merged_map && own.in_merged_map;
        for other in observation.robots.iter().filter(is_comparable) {
            positions_m.extend(other.map_from_base.filter(|p| p.is_finite()).map(|p| [p.x_m, p.y_m]));
            let explorer = self.explorers.iter().find(|explorer| explorer.robot() == other.robot);
            goals_m.extend(explorer.and_then(Explorer::goal_m));
        }
        let others = OtherRobots { positions_m: &positions_m, goals_m: &goals_m };
        self.explorers[index].step(observation.stamp, own, &others, &mut self.planner, may_plan)
    }
}

#[cfg(test)]
mod drive_tests;
#[cfg(test)]
mod tests;
