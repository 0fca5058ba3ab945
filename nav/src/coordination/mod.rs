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

mod coarse;
mod config;
mod leftovers;
mod plan;
mod seen;
mod tours;
mod types;
mod views;

pub use config::CoordinationConfig;
pub use leftovers::{Leftover, LeftoverReason};
pub use types::{
    CoordinatedRobot, CoordinationInput, CoordinationPhase, GoalProgress, GoalPurpose, RobotAvailability,
    RobotGoal, TimeEstimate,
};

use crate::clearance_map::ClearanceMap;
use crate::config::{FollowerConfig, RobotBody};
use core::time::Duration;
use msg::{Pose2, ROBOTS_MAX, RobotId, Stamp};
use plan::PlanBuffers;
use seen::UnseenCells;

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
#[derive(Clone, Debug)]
pub struct FleetCoordinator {
    config: CoordinationConfig,
    body: RobotBody,
    follower: FollowerConfig,
    map: ClearanceMap,
    buffers: PlanBuffers,
    unseen: UnseenCells,
    goals: [Option<RobotGoal>; ROBOTS_MAX],
    homes: [Option<Pose2>; ROBOTS_MAX],
    phase: CoordinationPhase,
    planned_at: Option<Stamp>,
    plans: u32,
    estimate: Option<TimeEstimate>,
}

impl FleetCoordinator {
    /// A coordinator that has planned nothing yet.
    pub fn new(config: CoordinationConfig) -> Self {
        Self {
            config,
            body: RobotBody::default(),
            follower: FollowerConfig::default(),
            map: ClearanceMap::default(),
            buffers: PlanBuffers::default(),
            unseen: UnseenCells::default(),
            goals: [const { None }; ROBOTS_MAX],
            homes: [None; ROBOTS_MAX],
            phase: CoordinationPhase::Exploring,
            planned_at: None,
            plans: 0,
            estimate: None,
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

    /// Plans if it is time to, or if a robot has arrived or failed, and returns what the fleet does.
    pub fn update(&mut self, input: &CoordinationInput) -> CoordinationPhase {
        self.record_progress(input);
        let period = Duration::from_secs_f64(self.config.replan_period_s);
        let is_due = self.planned_at.is_none_or(|at| input.stamp >= at + period);
        let needs_goal = |robot: &CoordinatedRobot| robot.progress.has_ended();
        if is_due || input.robots.iter().any(needs_goal) {
            self.planned_at = Some(input.stamp);
            self.plans += 1;
            self.plan(input);
        }
        self.phase
    }

    /// Parts of the map that are unknown beside known free space, and why no robot goes there.
    ///
    /// Refers to the map of the last plan.
    pub fn leftovers(&self) -> Vec<Leftover> {
        leftovers::find(&self.map, &self.buffers, &self.unseen, self.clearance_min_m())
    }

    /// Clearance that a robot needs, metres.
    fn clearance_min_m(&self) -> f64 {
        self.body.radius_m + self.body.margin_m + self.map.cell_size_m() / 2.0
    }

    /// Remembers where robots began, and what was not seen from where they arrived.
    fn record_progress(&mut self, input: &CoordinationInput) {
        for robot in input.robots {
            if let Some(pose) = robot.map_from_base.filter(|pose| pose.is_finite()) {
                self.homes[robot.robot.index()].get_or_insert(pose);
            }
            let index = robot.robot.index();
            if robot.availability != RobotAvailability::Free {
                self.goals[index] = None;
                continue;
            }
            if !robot.progress.has_ended() {
                continue;
            }
            let Some(goal) = self.goals[index].take() else { continue };
            if goal.purpose == GoalPurpose::Explore {
                self.record_attempt(input, goal.position_m);
            }
            if goal.purpose == GoalPurpose::Home {
                self.homes[index] = None;
            }
        }
    }

    /// Counts an attempt at the unknown cells that should be seen from a place by now.
    fn record_attempt(&mut self, input: &CoordinationInput, place_m: [f64; 2]) {
        self.update_map(input);
        let Some(cell) = self.map.cell_at(place_m) else { return };
        let Self { map, buffers, config, unseen, .. } = self;
        let is_ignored = |_: usize| false;
        buffers.views.view_from(map, config, cell, &is_ignored);
        buffers.views.for_each_unknown(map, config, cell, |seen| unseen.add_attempt(map.cell_centre_m(seen)));
        unseen.end_attempt();
    }
}

#[cfg(test)]
mod tests;
