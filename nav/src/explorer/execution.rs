//! Execution of one goal, and detection of goals that take too long or of robots that do not move.

use crate::command::Twist;
use crate::config::FollowerConfig;
use crate::exploration::{ExplorationGoal, GoalKind};
use crate::follower::PathFollower;
use core::time::Duration;
use msg::{Pose2, Stamp, pose::wrap_angle};

/// Time that a frontier is faced, seconds: the map needs some scans and some time to show what is behind it.
const LOOK_S: f64 = 0.8;
/// Heading error within which a point counts as faced, radians.
const FACING_RAD: f64 = 0.25;
/// A goal is given up after this multiple of its expected time ...
const OVERDUE_FACTOR: f64 = 2.0;
/// ... and this many seconds more, for goals close by.
const OVERDUE_EXTRA_S: f64 = 15.0;
/// Longest time that a goal may take, seconds: keeps expected times of any size within a stamp.
const GOAL_TIME_MAX_S: f64 = 1e6;
const NEVER: Stamp = Stamp(i64::MAX);

/// The robot is stuck if it moves less than this ...
const STILL_M: f64 = 0.06;
/// ... and turns less than this, radians ...
const STILL_RAD: f64 = 0.35;
/// ... for this long, seconds: longer than a look at a frontier.
const STUCK_S: f64 = 4.0;

/// Distance between two poses from which the map has moved and not the robot, metres: it drives 0.15 m/s and is
/// observed several times a second.
const POSE_JUMP_M: f64 = 1.0;

/// The goal has been reached, or looked at.
#[derive(Clone, Copy, Debug)]
pub(super) struct Arrival {
    pub(super) kind: GoalKind,
    pub(super) goal_m: [f64; 2],
}

/// Current goal of a robot and how far it has come.
#[derive(Clone, Debug)]
pub(super) struct GoalExecution {
    goal: Option<ExplorationGoal>,
    follower: PathFollower,
    give_up_at: Stamp,
    facing_since: Option<Stamp>,
    planned_at: Option<Stamp>,
}

impl GoalExecution {
    pub(super) fn new(config: FollowerConfig) -> Self {
        let follower = PathFollower::new(config);
        Self { goal: None, follower, give_up_at: NEVER, facing_since: None, planned_at: None }
    }

    pub(super) fn has_goal(&self) -> bool {
        self.goal.is_some()
    }

    pub(super) fn goal_m(&self) -> Option<[f64; 2]> {
        self.goal.as_ref().map(|goal| goal.look_at_m)
    }

    pub(super) fn goal_kind(&self) -> Option<GoalKind> {
        self.goal.as_ref().map(|goal| goal.kind)
    }

    /// Time of the newest plan, unless the next one is due at once.
    pub(super) fn planned_at(&self) -> Option<Stamp> {
        self.planned_at
    }

    pub(super) fn set_planned(&mut self, now: Stamp) {
        self.planned_at = Some(now);
    }

    /// Makes the next plan due at once.
    pub(super) fn clear_planned(&mut self) {
        self.planned_at = None;
    }

    /// Starts to drive to a goal.
    pub(super) fn start(&mut self, now: Stamp, goal: ExplorationGoal) {
        let limit_s = (OVERDUE_FACTOR * goal.expected_s + OVERDUE_EXTRA_S).clamp(0.0, GOAL_TIME_MAX_S);
        self.give_up_at = now + Duration::from_secs_f64(limit_s);
        self.goal = Some(goal);
        self.follower.reset();
        self.facing_since = None;
    }

    /// Replaces the path to the same goal; the time limit stays.
    pub(super) fn replace_path(&mut self, goal: ExplorationGoal) {
        self.goal = Some(goal);
        self.follower.on_replanned();
    }

    pub(super) fn drop_goal(&mut self) {
        self.goal = None;
    }

    /// Stops all timers; the goal stays.
    pub(super) fn pause(&mut self) {
        (self.facing_since, self.planned_at, self.give_up_at) = (None, None, NEVER);
    }

    /// Whether a goal was started since the last pause.
    pub(super) fn is_timed(&self) -> bool {
        self.give_up_at != NEVER
    }

    pub(super) fn is_overdue(&self, now: Stamp) -> bool {
        now > self.give_up_at
    }

    /// Velocity along the path and then towards the point to look at. The goal is dropped on arrival.
    pub(super) fn follow(&mut self, now: Stamp, pose: Pose2, speed_m_s: f64) -> (Twist, Option<Arrival>) {
        let Some(goal) = &self.goal else { return (Twist::STOP, None) };
        if let Some(twist) = self.follower.follow(&goal.path, pose, speed_m_s) {
            self.facing_since = None;
            return (twist, None);
        }
        let arrival = Arrival { kind: goal.kind, goal_m: goal.look_at_m };
        match goal.kind {
            GoalKind::Patrol => {
                self.goal = None;
                (Twist::STOP, Some(arrival))
            }
            GoalKind::Explore => {
                let (twist, error_rad) = self.follower.turn_to_face(pose, goal.look_at_m);
                let is_facing = error_rad.abs() < FACING_RAD;
                if !is_facing || now - *self.facing_since.get_or_insert(now) < LOOK_S {
                    return (twist, None);
                }
                self.goal = None;
                (twist, Some(arrival))
            }
        }
    }
}

/// Detects a robot that makes no progress (as Nav2's progress checker).
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ProgressChecker {
    /// Time and pose of the last progress.
    last: Option<(Stamp, Pose2)>,
}

impl ProgressChecker {
    pub(super) fn reset(&mut self) {
        self.last = None;
    }

    /// Whether there has been no progress for 4 s. A robot without a goal always progresses.
    pub(super) fn is_stuck(&mut self, now: Stamp, pose: Pose2, has_goal: bool) -> bool {
        let (since, reference) = *self.last.get_or_insert((now, pose));
        let turned_rad = wrap_angle(pose.yaw_rad - reference.yaw_rad).abs();
        if reference.distance_m(pose) > STILL_M || turned_rad > STILL_RAD || !has_goal {
            self.last = Some((now, pose));
            return false;
        }
        now - since > STUCK_S
    }
}

/// The robot's last pose and the map that it refers to.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct PoseTracking {
    last_pose: Option<Pose2>,
    in_merged_map: bool,
}

impl PoseTracking {
    /// Whether poses refer to another map than before.
    pub(super) fn map_changed(&mut self, in_merged_map: bool) -> bool {
        let has_changed = self.in_merged_map != in_merged_map;
        if has_changed {
            *self = Self { last_pose: None, in_merged_map };
        }
        has_changed
    }

    /// Distance driven since the last pose, metres; 0 if the pose jumped with the map.
    pub(super) fn distance_to_m(&mut self, pose: Pose2) -> f64 {
        let step_m = self.last_pose.map_or(0.0, |last| last.distance_m(pose));
        self.last_pose = Some(pose);
        if step_m < POSE_JUMP_M { step_m } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_robot_that_moves_again_is_not_stuck() {
        let mut progress = ProgressChecker::default();
        let at = Stamp::from_seconds;
        assert!(!progress.is_stuck(at(0.0), Pose2::IDENTITY, true));
        assert!(!progress.is_stuck(at(3.9), Pose2::IDENTITY, true));
        assert!(!progress.is_stuck(at(4.5), Pose2::new(0.1, 0.0, 0.0), true), "it has moved 0.1 m");
        assert!(!progress.is_stuck(at(8.0), Pose2::new(0.1, 0.0, 0.0), true));
        assert!(progress.is_stuck(at(8.6), Pose2::new(0.1, 0.0, 0.0), true), "still for 4.1 s");
        assert!(!progress.is_stuck(at(8.7), Pose2::new(0.1, 0.0, 0.0), false), "it has no goal");
    }

    #[test]
    fn a_jump_of_the_map_is_not_driving() {
        let mut tracking = PoseTracking::default();
        assert_eq!(tracking.distance_to_m(Pose2::IDENTITY), 0.0);
        assert_eq!(tracking.distance_to_m(Pose2::new(0.5, 0.0, 0.0)), 0.5);
        assert_eq!(tracking.distance_to_m(Pose2::new(3.0, 0.0, 0.0)), 0.0);
        assert!(tracking.map_changed(true) && !tracking.map_changed(true));
        assert_eq!(tracking.distance_to_m(Pose2::IDENTITY), 0.0);
    }
}
