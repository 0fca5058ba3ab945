//! Navigation of one robot: its goal, its routes, its path, and the velocity that follows it.

mod arrival;
mod place_search;
mod routes;
mod safety;

use super::config::NavigatorConfig;
use super::goal::NavigationGoal;
use super::goal_map::GoalMap;
use super::input::{NavigatedRobot, RobotPoses};
use super::progress::{Progress, Recovery};
use super::standstill::Standstill;
use super::state::{NavigationFailure, NavigationState};
use crate::collision::CollisionLimit;
use crate::command::Twist;
use crate::follower::PathFollower;
use crate::observation::ScanView;
use crate::obstacles::RecentObstacles;
use crate::path::Path;
use msg::{Pose2, RobotId, Stamp};
use place_search::PlaceSearch;

/// Waypoints after a wait to which a waiting robot turns: 0.2 m on maps of 0.05 m.
const FACED_WAYPOINTS: usize = 3;
/// Waypoints of a plan among which the nearest is looked for: it is less than a second old.
const INTENDED_WAYPOINTS: usize = 8;
/// Movement of `odom` in the map from which the path is planned anew at once, metres and radians.
const MAP_MOVED_M: f64 = 0.05;
const MAP_MOVED_RAD: f64 = 0.03;

/// Distance from where it arrived at a position within which a robot is there, metres: turns on the spot move it by less.
const ARRIVED_M: f64 = 0.1;

/// Another robot as seen by one that drives.
#[derive(Clone, Copy, Debug)]
pub(super) struct OtherRobot {
    pub(super) robot: RobotId,
    pub(super) in_base_m: [f64; 2],
    pub(super) is_active: bool,
}

/// Path that is being followed.
#[derive(Clone, Debug, Default)]
struct FollowedPath {
    in_odom: Path,
    odom_from_map: Pose2,
    /// Whether it ends where the robot waits for another one, before the goal.
    waits_for: Option<RobotId>,
    /// Where it goes on after a wait, in `odom`: the robot turns there meanwhile.
    goes_on_at_m: Option<[f64; 2]>,
}

#[derive(Clone, Debug)]
struct ActiveGoal {
    goal: NavigationGoal,
    /// Index of the pose that is driven to.
    next: usize,
    progress: Progress,
    /// Where the robot arrived at this pose's position, as `odom_from_base`; `None` on its way there.
    arrived_at: Option<Pose2>,
}

impl ActiveGoal {
    /// Whether the robot is still where it arrived: a person may have driven it elsewhere, or something pushed it.
    fn is_at_position(&self, odom_from_base: Pose2) -> bool {
        self.arrived_at.is_some_and(|at| at.distance_m(odom_from_base) < ARRIVED_M)
    }

    /// Goes on with the pose that comes next, at the same place or elsewhere.
    fn take_next_pose(&mut self, now: Stamp, is_elsewhere: bool) {
        self.next += 1;
        self.progress.restart(now);
        if is_elsewhere {
            self.arrived_at = None;
        }
    }
}

/// Navigation of one robot.
// More than 12 fields: each is a part of its own, and all belong to one goal.
#[derive(Clone, Debug)]
pub(super) struct RobotNavigator {
    pub(super) robot: RobotId,
    config: NavigatorConfig,
    collision: CollisionLimit,
    follower: PathFollower,
    obstacles: RecentObstacles,
    goal: Option<ActiveGoal>,
    state: NavigationState,
    goal_map: GoalMap,
    /// Result of the last search; `None` before the first.
    searched: Option<(Stamp, Result<(), NavigationFailure>)>,
    followed: Option<FollowedPath>,
    plan: Path,
    plans: u32,
    remaining_m: Option<f64>,
    recovery: Option<Recovery>,
    place_search: Option<PlaceSearch>,
    is_stop_due: bool,
    /// The robot that it waited for last, since it made progress or something else stopped it.
    waited_for: Option<RobotId>,
    /// Outlasts goals that are replaced.
    pub(super) standstill: Standstill,
}

impl RobotNavigator {
    pub(super) fn new(robot: RobotId, config: NavigatorConfig) -> Self {
        Self {
            robot,
            config,
            collision: CollisionLimit::new(config.body, config.follower),
            follower: PathFollower::new(config.follower),
            obstacles: RecentObstacles::default(),
            goal: None,
            state: NavigationState::Idle,
            goal_map: GoalMap::default(),
            searched: None,
            followed: None,
            plan: Path::default(),
            plans: 0,
            remaining_m: None,
            recovery: None,
            place_search: None,
            is_stop_due: false,
            waited_for: None,
            standstill: Standstill::default(),
        }
    }

    pub(super) fn state(&self) -> NavigationState {
        self.state
    }

    pub(super) fn plan(&self) -> (&Path, u32) {
        (&self.plan, self.plans)
    }

    /// Where the plan leads next, in the frame of the map; `None` at its end.
    pub(super) fn intended_m(&self, poses: RobotPoses) -> Option<[f64; 2]> {
        let waypoints = &self.plan.waypoints;
        let off_m = |i: &usize| crate::geometry::distance_m(waypoints[*i].position_m, poses.position_m());
        let near =
            (0..waypoints.len().min(INTENDED_WAYPOINTS)).min_by(|a, b| off_m(a).total_cmp(&off_m(b)))?;
        waypoints.get(near + FACED_WAYPOINTS).map(|waypoint| waypoint.position_m)
    }

    pub(super) fn remaining_m(&self) -> Option<f64> {
        self.remaining_m
    }

    pub(super) fn goal(&self) -> Option<&NavigationGoal> {
        self.goal.as_ref().map(|active| &active.goal)
    }

    pub(super) fn next_pose(&self) -> Option<usize> {
        self.goal.as_ref().map(|active| active.next)
    }

    pub(super) fn goal_map_mut(&mut self) -> &mut GoalMap {
        &mut self.goal_map
    }

    pub(super) fn goal_map(&self) -> &GoalMap {
        &self.goal_map
    }

    pub(super) fn set_goal(&mut self, now: Stamp, goal: NavigationGoal) {
        self.drop_path();
        self.place_search = None;
        let progress = match &self.goal {
            // A robot that cannot get away is helped, however often its goal changes.
            Some(replaced) if self.state.is_active() => {
                replaced.progress.to_new_goal(now, self.standstill.since(now))
            }
            _ => {
                self.standstill = Standstill::default();
                Progress::new(now)
            }
        };
        self.waited_for = None;
        self.goal = Some(ActiveGoal { goal, next: 0, progress, arrived_at: None });
        self.state = NavigationState::Planning;
    }

    /// Leaves out the goal's poses before the one with this index, but not the last.
    pub(super) fn skip_to(&mut self, next_pose: usize) {
        if let Some(active) = &mut self.goal {
            active.next = next_pose.min(active.goal.poses().len() - 1);
        }
    }

    /// Ends the goal in this state.
    pub(super) fn end(&mut self, state: NavigationState) {
        self.end_place_search(state);
        if self.goal.take().is_some() {
            self.drop_path();
            self.goal_map.clear();
            self.state = state;
        }
    }

    pub(super) fn pause(&mut self) {
        self.end_place_search(NavigationState::Idle);
        if self.state.is_active() {
            self.drop_path();
            self.state = NavigationState::Paused;
        }
    }

    pub(super) fn resume(&mut self, now: Stamp) {
        if let Some(active) = self.goal.as_mut().filter(|_| self.state == NavigationState::Paused) {
            active.progress.restart(now);
            self.waited_for = None;
            self.state = NavigationState::Planning;
        }
    }

    fn drop_path(&mut self) {
        self.is_stop_due |= self.state.is_active();
        (self.searched, self.followed, self.recovery, self.remaining_m) = (None, None, None, None);
        if !self.plan.waypoints.is_empty() {
            self.plan.waypoints.clear();
            self.plans = self.plans.wrapping_add(1);
        }
    }

    /// Time of the last search; the next one is due after a period, or at once when the map has moved.
    pub(super) fn is_search_due(&self, now: Stamp, poses: RobotPoses) -> bool {
        let has_moved = self.followed.as_ref().is_some_and(|path| {
            let moved = path.odom_from_map.between(poses.odom_from_map());
            moved.x_m.hypot(moved.y_m) > MAP_MOVED_M || moved.yaw_rad.abs() > MAP_MOVED_RAD
        });
        let is_old = |(at, _): &(Stamp, _)| now - *at >= self.config.replan_period_s;
        self.searched.as_ref().is_none_or(is_old) || has_moved
    }

    /// Forgets the routes: the robot stands until others are found.
    pub(super) fn forget_routes(&mut self) {
        (self.searched, self.followed) = (None, None);
    }

    pub(super) fn searched_at(&self) -> Option<Stamp> {
        self.searched.map(|(at, _)| at)
    }

    /// Whether routes to the goal are known.
    pub(super) fn has_routes(&self) -> bool {
        matches!(self.searched, Some((_, Ok(()))))
    }

    pub(super) fn has_path(&self) -> bool {
        self.followed.is_some()
    }

    /// Whether it waits for a robot, or has until it got another goal.
    pub(super) fn waits_for(&self, robot: RobotId) -> bool {
        self.state.is_active() && self.waited_for == Some(robot)
    }

    pub(super) fn is_recovering(&self) -> bool {
        self.recovery.is_some()
    }

    /// Records what the newest scan shows.
    pub(super) fn observe(&mut self, now: Stamp, robot: &NavigatedRobot, others: &[OtherRobot]) {
        let Some((odom_from_base, scan)) = robot.odom_from_base.zip(robot.fresh_scan(now)) else { return };
        let robots_m: Vec<[f64; 2]> =
            others.iter().map(|other| odom_from_base.apply(other.in_base_m)).collect();
        self.obstacles.record(now, odom_from_base, &scan, &robots_m, self.config.body.radius_m);
    }

    /// Follows a path in the frame of the robot's map from now on.
    ///
    /// `followed` of its waypoints are driven, up to where the robot waits for another one, or all.
    pub(super) fn set_path(
        &mut self,
        poses: RobotPoses,
        path: Path,
        followed: usize,
        waits_for: Option<RobotId>,
    ) {
        let odom_from_map = poses.odom_from_map();
        let mut in_odom = Path { waypoints: path.waypoints[..followed.min(path.waypoints.len())].to_vec() };
        for waypoint in &mut in_odom.waypoints {
            waypoint.position_m = odom_from_map.apply(waypoint.position_m);
        }
        let goes_on = path.waypoints.get(followed + FACED_WAYPOINTS).or(path.waypoints.last());
        let goes_on_at_m = goes_on.map(|waypoint| odom_from_map.apply(waypoint.position_m));
        self.followed = Some(FollowedPath { in_odom, odom_from_map, waits_for, goes_on_at_m });
        self.follower.on_replanned();
        (self.plan, self.plans) = (path, self.plans.wrapping_add(1));
    }

    /// Velocity of one control step; `None` if the robot is not to be driven.
    pub(super) fn control(
        &mut self,
        now: Stamp,
        robot: &NavigatedRobot,
        others: &[OtherRobot],
    ) -> Option<Twist> {
        if let Some(twist) = self.search_place(now, robot) {
            return Some(twist);
        }
        if !self.state.is_active() {
            return std::mem::take(&mut self.is_stop_due).then_some(Twist::STOP);
        }
        let Some(scan) = robot.fresh_scan(now) else {
            self.set_blocked(now, NavigationFailure::NoScan);
            return Some(Twist::STOP);
        };
        let Some(poses) = robot.poses().filter(|_| robot.observation.map.is_some()) else {
            self.set_blocked(now, NavigationFailure::NoPose);
            return Some(Twist::STOP);
        };
        self.standstill.observe(now, poses.odom_from_base);
        let wanted = self.wanted_velocity(now, (robot, poses), &scan, others);
        if !self.state.is_active() {
            self.is_stop_due = false;
            return Some(Twist::STOP);
        }
        let limited = self.limit(now, wanted, (&scan, Some(poses.odom_from_base)), others);
        self.give_up_if_hopeless(now);
        Some(if self.state.is_active() { limited } else { Twist::STOP })
    }

    fn wanted_velocity(
        &mut self,
        now: Stamp,
        (robot, poses): (&NavigatedRobot, RobotPoses),
        scan: &ScanView,
        others: &[OtherRobot],
    ) -> Twist {
        if let Some(twist) = self.recover(now, poses, scan, others) {
            return twist;
        }
        let Some(path) = &self.followed else {
            if let Some((_, Err(failure))) = self.searched {
                self.state = NavigationState::Blocked(failure);
            }
            return Twist::STOP;
        };
        let cruise_m_s = self.config.follower.cruise_m_s;
        let is_at_position =
            self.goal.as_ref().is_some_and(|active| active.is_at_position(poses.odom_from_base));
        let followed = if is_at_position {
            None
        } else {
            self.follower.follow(&path.in_odom, poses.odom_from_base, cruise_m_s)
        };
        match (followed, path.waits_for) {
            (Some(twist), _) => {
                self.state = NavigationState::Driving;
                twist
            }
            (None, Some(other)) => {
                self.state = NavigationState::WaitingForRobot(other);
                self.waited_for = Some(other);
                self.face_the_way_on(poses)
            }
            (None, None) => self.arrive(now, robot, poses),
        }
    }

    fn set_blocked(&mut self, now: Stamp, failure: NavigationFailure) {
        self.state = NavigationState::Blocked(failure);
        self.give_up_if_hopeless(now);
    }

    fn give_up_if_hopeless(&mut self, now: Stamp) {
        let Some(active) = &self.goal else { return };
        if !active.progress.is_hopeless(now, &self.config, self.waited_for.is_some()) {
            return;
        }
        let failure = match (self.state, self.searched) {
            _ if self.waited_for.is_some() => {
                self.waited_for.map_or(NavigationFailure::Obstacle, NavigationFailure::Robot)
            }
            (NavigationState::Blocked(failure), _) | (_, Some((_, Err(failure)))) => failure,
            _ => NavigationFailure::Obstacle,
        };
        self.end(NavigationState::Failed(failure));
    }
}
