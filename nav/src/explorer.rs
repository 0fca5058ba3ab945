//! Explorer that drives one robot to exploration goals.
//!
//! It spins once to see its surroundings, then drives to where a frontier can be looked past, looks, and plans again;
//! when it is stuck it backs up or turns away.

mod execution;

use crate::backing_up::{BACK_UP, BackingUp, back_up_distance_m};
use crate::collision::CollisionLimit;
use crate::command::Twist;
use crate::config::NavConfig;
use crate::exploration::{ExplorationGoal, ExplorationPlanner, GoalKind, GoalRequest};
use crate::geometry::distance_m;
use crate::memory::RobotMemory;
use crate::observation::{MapView, RobotObservation, ScanView};
use crate::planner::PlanningInput;
use crate::random::RandomNumbers;
use crate::wander::Wander;
use core::f64::consts::TAU;
use core::time::Duration;
use execution::{Arrival, GoalExecution, PoseTracking, ProgressChecker};
use msg::{Pose2, RobotId, Stamp, pose::wrap_angle};

/// Oldest scan that a robot is driven by, seconds: five periods of a Burger's LiDAR.
const SCAN_AGE_MAX_S: f64 = 0.5;
/// Longest time for a full spin, seconds: twice what it takes at the turning speed.
const SPIN_MAX_S: f64 = 15.0;
/// Angle after which a spin is complete, radians: a little less than a turn, because the robot turns on.
const SPIN_RAD: f64 = TAU * 0.97;
/// Longest time of turning away, seconds: about 100 degrees.
const TURN_AWAY_MAX_S: f64 = 2.0;
/// Free distance ahead at which turning away ends, metres.
const TURN_AWAY_UNTIL_M: f64 = 1.0;
/// Attempts that a goal costs at which the robot got stuck: after it the goal is left alone.
const STUCK_ATTEMPTS: u32 = 2;
/// Multiplier that gives robots with the same seed different random numbers (any large odd number serves).
const ROBOT_SEED: u64 = 0xA24B_AED4_963E_E407;

/// What an explorer has done so far.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ExplorationStats {
    /// Distance driven by the poses in the map, metres.
    pub driven_m: f64,
    /// Number of spins.
    pub spins: u32,
    /// Number of frontiers looked past.
    pub frontiers: u32,
    /// Number of patrols that arrived.
    pub patrols: u32,
    /// Number of times that the robot was stuck and left its goal.
    pub recoveries: u32,
    /// Number of plans made.
    pub plans: u32,
}

/// The other robots, in the frame of the explorer's map.
#[derive(Clone, Copy, Debug, Default)]
pub struct OtherRobots<'a> {
    /// Positions of the robots, metres.
    pub positions_m: &'a [[f64; 2]],
    /// Goals of the robots, metres.
    pub goals_m: &'a [[f64; 2]],
}

/// What the robot does at the moment; goals are given up and chosen while it follows them only.
#[derive(Clone, Copy, Debug)]
enum Behavior {
    Spin { turned_rad: f64, last_yaw_rad: f64, until: Stamp },
    FollowGoal,
    BackUp(BackingUp),
    TurnAway { side: f64, until: Stamp },
}

impl Behavior {
    fn spin(now: Stamp, pose: Pose2) -> Self {
        Self::Spin { turned_rad: 0.0, last_yaw_rad: pose.yaw_rad, until: after(now, SPIN_MAX_S) }
    }
}

/// Data of a localized robot at one moment.
struct Scene<'a> {
    map: MapView<'a>,
    pose: Pose2,
    scan: ScanView<'a>,
    others: &'a OtherRobots<'a>,
}

impl<'a> Scene<'a> {
    fn planning_input(&self, memory: &'a RobotMemory) -> PlanningInput<'a> {
        PlanningInput {
            map: self.map,
            map_from_base: self.pose,
            scan: Some(self.scan),
            memory: Some(memory),
            other_robots_m: self.others.positions_m,
        }
    }
}

/// Exploration of one robot.
#[derive(Clone, Debug)]
pub struct Explorer {
    robot: RobotId,
    config: NavConfig,
    collision: CollisionLimit,
    random: RandomNumbers,
    memory: RobotMemory,
    tracking: PoseTracking,
    behavior: Option<Behavior>,
    execution: GoalExecution,
    progress: ProgressChecker,
    wander: Wander,
    idle_since: Option<Stamp>,
    stats: ExplorationStats,
}

impl Explorer {
    /// An explorer that has seen nothing yet.
    pub fn new(robot: RobotId, config: NavConfig, seed: u64) -> Self {
        let mut random = RandomNumbers::new(seed ^ (robot.number() as u64).wrapping_mul(ROBOT_SEED));
        // The first number is left out so that known seeds keep their tours.
        random.next_u64();
        Self {
            robot,
            config,
            collision: CollisionLimit::new(config.body, config.follower),
            random,
            memory: RobotMemory::default(),
            tracking: PoseTracking::default(),
            behavior: None,
            execution: GoalExecution::new(config.follower),
            progress: ProgressChecker::default(),
            wander: Wander::default(),
            idle_since: None,
            stats: ExplorationStats::default(),
        }
    }

    /// The robot that is driven.
    pub fn robot(&self) -> RobotId {
        self.robot
    }

    /// What the explorer has done so far.
    pub fn stats(&self) -> ExplorationStats {
        self.stats
    }

    /// Current goal in the frame of the robot's map, metres.
    pub fn goal_m(&self) -> Option<[f64; 2]> {
        self.execution.goal_m()
    }

    /// Purpose of the current goal.
    pub fn goal_kind(&self) -> Option<GoalKind> {
        self.execution.goal_kind()
    }

    /// Time since which the robot has had no fresh scan to drive by, or no goal. `None` while it drives.
    pub fn idle_since(&self) -> Option<Stamp> {
        self.idle_since
    }

    /// Time of the next plan.
    pub fn next_plan_at(&self) -> Stamp {
        let period = Duration::from_secs_f64(self.config.exploration.replan_period_s);
        self.execution.planned_at().map_or(Stamp(i64::MIN), |at| at + period)
    }

    /// Pauses exploration: all timers start again at the next step. The goal stays.
    pub fn pause(&mut self) {
        self.execution.pause();
        self.progress.reset();
        self.idle_since = None;
        if !matches!(self.behavior, None | Some(Behavior::Spin { .. })) {
            self.behavior = Some(Behavior::FollowGoal);
        }
    }

    /// One control step: observes the robot and returns its velocity.
    ///
    /// Plans only if `may_plan`, because a plan takes some milliseconds.
    pub fn step(
        &mut self,
        now: Stamp,
        observation: &RobotObservation,
        others: &OtherRobots,
        planner: &mut ExplorationPlanner,
        may_plan: bool,
    ) -> Twist {
        let is_fresh = |scan: &ScanView| now - scan.received <= SCAN_AGE_MAX_S;
        let Some(scan) = observation.scan.filter(is_fresh) else {
            self.idle_since.get_or_insert(now);
            return Twist::STOP;
        };
        let mut free_distance_m = self.collision.free_distance_m(&scan);
        let localized = observation.map.zip(observation.map_from_base.filter(|pose| pose.is_finite()));
        let wanted = match localized {
            Some((map, pose)) => {
                self.record(now, observation.in_merged_map, pose, &scan, others);
                if may_plan {
                    self.plan_or_recover(now, &Scene { map, pose, scan, others }, planner);
                }
                let others_in_base = others.positions_m.iter().map(|at_m| pose.inverse().apply(*at_m));
                free_distance_m = others_in_base
                    .map(|other| self.collision.free_distance_to_robot_m(other))
                    .fold(free_distance_m, f64::min);
                self.run_behavior(now, pose, &scan)
            }
            None => self.wander(&scan),
        };
        if wanted.linear_m_s < 0.0 {
            return self.collision.limit_speed_back(wanted, &scan);
        }
        self.collision.limit_speed(wanted, free_distance_m)
    }

    /// Drives by the scan alone while the pose is unknown.
    fn wander(&mut self, scan: &ScanView) -> Twist {
        self.idle_since = None;
        self.execution.drop_goal();
        self.wander.drive(scan, &self.collision, &self.config.follower, &mut self.random)
    }

    fn record(
        &mut self,
        now: Stamp,
        in_merged_map: bool,
        pose: Pose2,
        scan: &ScanView,
        others: &OtherRobots,
    ) {
        if self.tracking.map_changed(in_merged_map) {
            // Remembered positions and the goal are in the frame of the old map.
            self.memory.clear();
            self.execution.drop_goal();
            self.progress.reset();
        }
        self.memory.record(now, pose, scan, others.positions_m, self.config.body.radius_m);
        self.stats.driven_m += self.tracking.distance_to_m(pose);
        self.behavior.get_or_insert_with(|| Behavior::spin(now, pose));
    }

    /// Chooses a goal if it is time to, and recovers if the robot is stuck.
    fn plan_or_recover(&mut self, now: Stamp, scene: &Scene, planner: &mut ExplorationPlanner) {
        if !matches!(self.behavior, Some(Behavior::FollowGoal)) {
            return;
        }
        if now >= self.next_plan_at() {
            let request = GoalRequest {
                stamp: now,
                input: scene.planning_input(&self.memory),
                memory: &self.memory,
                assigned_goals_m: scene.others.goals_m,
                current_goal_m: self.goal_m(),
            };
            let goal = planner.choose_goal(&request, &mut self.random);
            self.adopt_goal(now, goal);
        }
        let has_goal = self.execution.has_goal();
        let is_stuck = self.progress.is_stuck(now, scene.pose, has_goal) || self.execution.is_overdue(now);
        if has_goal && is_stuck {
            let planner = planner.planner();
            planner.update_map(&scene.planning_input(&self.memory));
            let back_m = back_up_distance_m(planner.map(), self.config.body, scene.pose, |_| true);
            self.recover(now, scene.pose, back_m);
        }
    }

    /// Takes over the result of a plan, unless the current goal is as good.
    fn adopt_goal(&mut self, now: Stamp, goal: Option<ExplorationGoal>) {
        self.execution.set_planned(now);
        self.stats.plans += 1;
        let Some(goal) = goal else {
            self.execution.drop_goal();
            self.idle_since.get_or_insert(now);
            return;
        };
        self.idle_since = None;
        let is_under_way = self.execution.is_timed();
        match self.goal_kind().zip(self.goal_m()) {
            // Another random draw would be another place.
            Some((GoalKind::Patrol, _)) if goal.kind == GoalKind::Patrol && is_under_way => return,
            Some((GoalKind::Explore, current_m)) if goal.current_goal_explored => {
                // If the frontier comes back, the robot has to look from nearer.
                self.stats.frontiers += 1;
                self.memory.attempts.add(now, current_m, 1);
            }
            Some((GoalKind::Explore, current_m))
                if distance_m(current_m, goal.look_at_m) < self.config.exploration.same_goal_m
                    && is_under_way =>
            {
                self.execution.replace_path(goal);
                return;
            }
            _ => {}
        }
        self.execution.start(now, goal);
    }

    /// Velocity that the current behavior wants.
    fn run_behavior(&mut self, now: Stamp, pose: Pose2, scan: &ScanView) -> Twist {
        let turn_rad_s = self.config.follower.turn_rad_s;
        match self.behavior.unwrap_or(Behavior::FollowGoal) {
            Behavior::Spin { turned_rad, last_yaw_rad, until } => {
                let turned_rad = turned_rad + wrap_angle(pose.yaw_rad - last_yaw_rad);
                if turned_rad >= SPIN_RAD || now >= until {
                    self.stats.spins += 1;
                    self.plan_at_once();
                    return Twist::STOP;
                }
                self.behavior = Some(Behavior::Spin { turned_rad, last_yaw_rad: pose.yaw_rad, until });
                Twist { linear_m_s: 0.0, angular_rad_s: turn_rad_s }
            }
            Behavior::FollowGoal => self.follow_goal(now, pose),
            Behavior::BackUp(backing_up) => {
                if backing_up.is_done(now, [pose.x_m, pose.y_m]) {
                    self.plan_at_once();
                }
                BACK_UP
            }
            Behavior::TurnAway { side, until } => {
                if now >= until || self.collision.free_distance_m(scan) > TURN_AWAY_UNTIL_M {
                    self.plan_at_once();
                }
                Twist { linear_m_s: 0.0, angular_rad_s: side * turn_rad_s }
            }
        }
    }

    fn follow_goal(&mut self, now: Stamp, pose: Pose2) -> Twist {
        let (twist, arrival) = self.execution.follow(now, pose, self.config.follower.cruise_m_s);
        match arrival {
            None => {}
            Some(Arrival { kind: GoalKind::Patrol, goal_m }) => {
                self.stats.patrols += 1;
                self.memory.attempts.add(now, goal_m, 1);
                self.behavior = Some(Behavior::spin(now, pose));
            }
            Some(Arrival { kind: GoalKind::Explore, goal_m }) => {
                self.stats.frontiers += 1;
                self.memory.attempts.add(now, goal_m, 1);
                self.plan_at_once();
            }
        }
        twist
    }

    fn plan_at_once(&mut self) {
        self.behavior = Some(Behavior::FollowGoal);
        self.execution.clear_planned();
        self.progress.reset();
    }

    /// Leaves the goal, and backs up by a distance if there is one that is clear, else turns away.
    fn recover(&mut self, now: Stamp, pose: Pose2, back_m: Option<f64>) {
        self.stats.recoveries += 1;
        if let Some(goal_m) = self.goal_m() {
            self.memory.attempts.add(now, goal_m, STUCK_ATTEMPTS);
        }
        self.execution.drop_goal();
        self.progress.reset();
        self.behavior = Some(match back_m {
            Some(back_m) => Behavior::BackUp(BackingUp::new(now, [pose.x_m, pose.y_m], back_m)),
            None => {
                let side = if self.random.index_below(2) == 0 { 1.0 } else { -1.0 };
                Behavior::TurnAway { side, until: after(now, TURN_AWAY_MAX_S) }
            }
        });
    }
}

fn after(now: Stamp, seconds: f64) -> Stamp {
    now + Duration::from_secs_f64(seconds)
}
