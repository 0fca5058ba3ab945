//! Coordinated exploration: goals for all robots of a fleet that share one map.
//!
//! ```text
//!   CoordinationInput ─▶ ClearanceMap ─▶ viewpoints ─▶ tours ─▶ one RobotGoal per free robot
//!   (map, robots)        (obstacles)     (new area)    (who, in which order)
//! ```
//!
//! A goal is a viewpoint: a place, and the headings to look at there, from which unknown space is expected to be seen.
//! Each plan assigns all viewpoints to the robots that are free, as tours, and each robot drives to the first of its
//! own. What a robot sees on its way counts: a viewpoint that shows nothing new any more is dropped at the next plan.
//! The baseline to beat is the coordination of Burgard, Moors, Stachniss and Schneider (2005).

pub mod absent;
mod assign;
mod coarse;
mod config;
mod excluded;
mod failed;
mod fleet_exploration;
mod floor;
mod growth;
mod leftovers;
mod lost_robots;
mod plan;
mod revisits;
mod seen;
mod sensor;
mod sent_goal;
mod tours;
mod types;
mod views;

pub use config::CoordinationConfig;
pub use fleet_exploration::FleetExploration;
pub use leftovers::Leftover;
pub use msg::LeftoverReason;
pub use types::{
    CoordinatedRobot, CoordinationInput, CoordinationPhase, ExplorationEnd, FoundLeftover, GoalProgress,
    GoalPurpose, RobotAvailability, RobotGoal, TimeEstimate,
};

use crate::clearance_map::ClearanceMap;
use crate::config::FollowerConfig;
use crate::geometry::distance_m;
use crate::observation::ScanView;
use core::time::Duration;
use failed::FailedGoals;
use growth::KnownArea;
use msg::{Pose2, ROBOTS_MAX, RobotId, Stamp};
use plan::{AT_GOAL_M, PlanBuffers};
use seen::UnseenCells;
use views::Directions;

/// Longest look around that is one attempt, seconds: a whole turn at the follower's speed takes less.
const LOOK_MAX_S: f64 = 12.0;
/// Shortest look around that counts as an attempt if the robot leaves, seconds: less is driving past.
const LOOK_MIN_S: f64 = 2.0;
/// Time without leaving its place after which a robot gives up the goal that it has just then, seconds. Navigation gives up
/// earlier, but a goal that changes all the time never gets that old. And the distance from a place at which it is left, metres.
const STAND_MAX_S: f64 = 90.0;
const LEFT_PLACE_M: f64 = 0.5;
/// Looks of a robot from one place in a row of which each is judged by where the robot pointed.
const LOOKS_MAX: u32 = 3;

/// Coordinator of one fleet in one map.
///
/// Deterministic: the same inputs give the same goals. A plan takes some tens of milliseconds at most.
///
/// ```
/// use msg::{Pose2, RobotId, Stamp};
/// use nav::coordination::*;
/// use nav::{CoordinationConfig, FleetCoordinator, MapView};
///
/// // 4 m by 4 m: the left half is free, the right half is unknown.
/// let cells: Vec<i8> = (0..6400).map(|i| if i % 80 < 40 { 0 } else { -1 }).collect();
/// let map = MapView::from_percent(Pose2::IDENTITY, 0.05, (80, 80), &cells).unwrap();
/// let robot = CoordinatedRobot {
///     robot: RobotId::new(1).unwrap(),
///     map_from_base: Some(Pose2::new(1.0, 2.0, 0.0)),
///     home: None,
///     availability: RobotAvailability::Free,
///     progress: GoalProgress::Idle,
/// };
///
/// let mut coordinator = FleetCoordinator::new(CoordinationConfig::default());
/// let input = CoordinationInput { stamp: Stamp(0), map, robots: &[robot], excluded: &[] };
/// assert_eq!(coordinator.update(&input), CoordinationPhase::Exploring);
/// let goal = coordinator.goal(robot.robot).unwrap();
/// assert_eq!(goal.purpose, GoalPurpose::Explore);
/// ```
// More than 12 fields: the settings, what the fleet has seen and done, and the last plan.
#[derive(Clone, Debug)]
pub struct FleetCoordinator {
    config: CoordinationConfig,
    follower: FollowerConfig,
    map: ClearanceMap,
    buffers: PlanBuffers,
    unseen: UnseenCells,
    known_area: KnownArea,
    goals: [Option<RobotGoal>; ROBOTS_MAX],
    records: Vec<RobotRecord>,
    phase: CoordinationPhase,
    planned_at: Option<Stamp>,
    plans: u32,
    estimate: Option<TimeEstimate>,
    /// Whether the last plan left viewpoints because robots drove for a long time in vain.
    took_too_long: bool,
}

/// Look around of a robot at its goal.
#[derive(Clone, Copy, Debug)]
struct Look {
    place_m: [f64; 2],
    since: Stamp,
    /// Directions that the sensor has seen since then.
    seen: Directions,
}

/// What is remembered of a robot.
#[derive(Clone, Debug, Default)]
struct RobotRecord {
    /// Where it returns to in the end.
    home: Option<Pose2>,
    /// Whether it has returned since it explored last.
    has_returned: bool,
    /// Its look around at its goal.
    look: Option<Look>,
    /// Where it looked last, and how often in a row.
    looked: ([f64; 2], u32),
    /// Places that it gave up to drive to.
    failed: FailedGoals,
    /// Where it has been since when, while its goal is elsewhere.
    stand: Option<([f64; 2], Stamp)>,
}

impl FleetCoordinator {
    /// A coordinator that has planned nothing yet.
    pub fn new(config: CoordinationConfig) -> Self {
        Self {
            config,
            follower: FollowerConfig::default(),
            map: ClearanceMap::default(),
            buffers: PlanBuffers::default(),
            unseen: UnseenCells::default(),
            known_area: KnownArea::default(),
            goals: [const { None }; ROBOTS_MAX],
            records: vec![RobotRecord::default(); ROBOTS_MAX],
            phase: CoordinationPhase::Exploring,
            planned_at: None,
            plans: 0,
            estimate: None,
            took_too_long: false,
        }
    }

    /// Current goal of a robot; `None` if it shall stand.
    pub fn goal(&self, robot: RobotId) -> Option<&RobotGoal> {
        self.goals[robot.index()].as_ref()
    }

    /// What the fleet does now.
    pub fn phase(&self) -> CoordinationPhase {
        self.phase
    }

    /// Number of plans made.
    pub fn plans(&self) -> u32 {
        self.plans
    }

    /// Expected time until nothing reachable is unknown; `None` before the first plan.
    pub fn estimate(&self) -> Option<TimeEstimate> {
        self.estimate
    }

    /// Expects of unknown space what the weakest of the robots' LiDARs sees, up to 6 m. The newest scan of each tells it.
    pub fn set_sensors<'a>(&mut self, scans: impl Iterator<Item = ScanView<'a>>) {
        self.config.set_sensors(scans);
    }

    /// Plans if it is time to, or if a robot has arrived or failed, and returns what the fleet does.
    pub fn update(&mut self, input: &CoordinationInput) -> CoordinationPhase {
        self.record_progress(input);
        let period = Duration::from_secs_f64(self.config.replan_period_s);
        let is_due = self.planned_at.is_none_or(|at| input.stamp >= at + period);
        let needs_goal = |robot: &CoordinatedRobot| {
            robot.availability == RobotAvailability::Free && robot.progress.has_ended()
        };
        if is_due || input.robots.iter().any(needs_goal) {
            self.planned_at = Some(input.stamp);
            self.plans += 1;
            self.plan(input);
        }
        self.phase
    }

    /// Whether some robot could be given goals at the last plan.
    pub fn has_explorers(&self) -> bool {
        self.buffers.has_robots()
    }

    /// Whether a robot that would get goals reached no floor at the last plan: it stands in an excluded area, or surrounded by
    /// obstacles.
    pub fn is_enclosed(&self, robot: RobotId) -> bool {
        self.buffers.is_enclosed(robot)
    }

    /// Parts of the map that are unknown beside known free space, and why no robot goes there.
    ///
    /// Refers to the map of the last plan.
    pub fn leftovers(&self) -> Vec<Leftover> {
        let exhaustion = self.known_area.exhaustion();
        leftovers::find(&self.map, &self.buffers, &self.unseen, exhaustion, self.clearance_min_m())
    }

    /// Whether the last plan left what robots could reach because they drove for a long time and have seen nothing more.
    pub fn took_too_long(&self) -> bool {
        self.took_too_long
    }

    /// Whether the last plan was made on the whole map, and not on the part around the robots.
    pub fn covers_map(&self) -> bool {
        self.map.covers_map()
    }

    /// Clearance that a robot needs, metres.
    fn clearance_min_m(&self) -> f64 {
        self.config.body.clearance_min_m(self.map.cell_size_m())
    }

    /// Remembers where robots began, and what was not seen from where they arrived.
    fn record_progress(&mut self, input: &CoordinationInput) {
        for robot in input.robots {
            let index = robot.robot.index();
            let pose = robot.map_from_base.filter(|pose| pose.is_finite());
            let home = &mut self.records[index].home;
            *home = robot.home.or(*home).or(pose);
            if robot.availability != RobotAvailability::Free {
                self.goals[index] = None;
                (self.records[index].look, self.records[index].stand) = (None, None);
                continue;
            }
            let progress = if self.stands_too_long(input.stamp, index, pose) {
                GoalProgress::Failed
            } else {
                robot.progress
            };
            if !progress.has_ended() {
                self.record_look(input, index, pose);
                continue;
            }
            let look = self.records[index].look.take();
            let Some(goal) = self.goals[index].take() else { continue };
            let (stamp, place_m, failed) = (input.stamp, goal.position_m, &mut self.records[index].failed);
            let failures = match progress {
                GoalProgress::Failed => Some(failed.record(stamp, place_m)),
                GoalProgress::Occupied => Some(failed.record_occupied(stamp, place_m)),
                _ => None,
            };
            // What a robot gave up once, others may reach.
            if goal.purpose == GoalPurpose::Explore && failures.is_none_or(|failures| failures > 1) {
                let looked = failures.is_none().then(|| self.directions_seen(index, place_m, look, pose));
                self.record_attempt(input, goal.position_m, looked);
            }
            if goal.purpose == GoalPurpose::Home {
                self.records[index].has_returned = true;
            }
        }
    }

    /// Whether a robot has not left its place for long although its goals to explore are elsewhere. Begins anew then.
    fn stands_too_long(&mut self, now: Stamp, index: usize, pose: Option<Pose2>) -> bool {
        let goal = self.goals[index].as_ref().filter(|goal| goal.purpose == GoalPurpose::Explore);
        let stand = &mut self.records[index].stand;
        let Some((goal, pose)) = goal.zip(pose) else {
            *stand = None;
            return false;
        };
        let here_m = [pose.x_m, pose.y_m];
        let is_there = distance_m(here_m, goal.position_m) < AT_GOAL_M;
        let kept = stand.filter(|(place_m, _)| !is_there && distance_m(here_m, *place_m) < LEFT_PLACE_M);
        let (_, since) = *stand.insert(kept.unwrap_or((here_m, now)));
        let is_long = now - since > STAND_MAX_S;
        if is_long {
            *stand = None;
        }
        is_long
    }

    /// Counts a look around as an attempt when it takes long or the robot leaves: new plans may turn it again and again.
    fn record_look(&mut self, input: &CoordinationInput, index: usize, pose: Option<Pose2>) {
        let goal = self.goals[index].as_ref().filter(|goal| goal.purpose == GoalPurpose::Explore);
        let is_there = |place_m: [f64; 2]| {
            pose.is_some_and(|pose| distance_m([pose.x_m, pose.y_m], place_m) < AT_GOAL_M)
        };
        let place_m = goal.map(|goal| goal.position_m).filter(|place_m| is_there(*place_m));
        let new = || place_m.map(|place_m| Look { place_m, since: input.stamp, seen: Directions::default() });
        let Some(mut look) = self.records[index].look.or_else(new) else { return };
        self.add_view(&mut look.seen, pose);
        self.records[index].look = Some(look);
        let looked_s = input.stamp - look.since;
        let has_left = !is_there(look.place_m);
        if looked_s >= LOOK_MAX_S || (has_left && looked_s >= LOOK_MIN_S) {
            self.record_attempt(input, look.place_m, Some(look.seen));
        }
        if has_left || looked_s >= LOOK_MAX_S {
            self.records[index].look = None;
        }
    }

    /// Directions that a robot has seen which ends its look at a place. Who looks at one place again and again, and does not turn
    /// to what is left there, counts as having looked at all.
    fn directions_seen(
        &mut self,
        index: usize,
        place_m: [f64; 2],
        look: Option<Look>,
        pose: Option<Pose2>,
    ) -> Directions {
        let (last_m, count) = &mut self.records[index].looked;
        *count = if distance_m(*last_m, place_m) < AT_GOAL_M { *count + 1 } else { 1 };
        *last_m = place_m;
        if *count > LOOKS_MAX {
            return Directions::ALL;
        }
        let mut seen = look.map(|look| look.seen).unwrap_or_default();
        self.add_view(&mut seen, pose);
        seen
    }

    /// Adds the directions that a robot sees.
    fn add_view(&self, seen: &mut Directions, pose: Option<Pose2>) {
        if let Some(pose) = pose {
            seen.add_view(pose.yaw_rad - self.map.yaw_rad(), self.config.view_angle_rad);
        }
    }

    /// Counts an attempt at the unknown cells that should be seen from a place by now, in the directions looked at; or, without
    /// them, at those that would be seen from a place that a robot gave up to go to.
    fn record_attempt(&mut self, input: &CoordinationInput, place_m: [f64; 2], looked: Option<Directions>) {
        // Who was not there has shown nothing of the map.
        if looked.is_some() {
            self.known_area.record_attempt(input.stamp, input.map.known_m2());
        }
        self.update_map(input);
        let Some(cell) = self.map.cell_at(place_m) else { return };
        let Self { map, buffers, config, unseen, .. } = self;
        let directions = looked.unwrap_or(Directions::ALL);
        buffers.views.for_each_visible_frontier(map, config, cell, directions, |seen| {
            unseen.add_attempt(map.cell_centre_m(seen), looked.is_some());
        });
        unseen.end_attempt();
    }
}

#[cfg(test)]
mod tests;
