//! Driving of one robot to its goal, the same for all methods.
//!
//! Paths around the other robots, speed limits near walls and robots, backing up, and giving way along the robot's own trail.

use msg::{Pose2, Stamp, pose::wrap_angle};
use nav::clearance_map::CELL_SIZE_MIN_M;
use nav::coordination::GoalProgress;
use nav::geometry::distance_m;
use nav::path::Waypoint;
use nav::{
    BACK_UP, BackingUp, CollisionLimit, FollowerConfig, MapView, Path, PathFollower, PlanError, Planner,
    PlanningInput, RobotBody, ScanView, Twist, back_up_distance_m,
};

/// Distance at which a goal is reached, metres; a little more than the follower's.
const ARRIVED_M: f64 = 0.14;
/// Heading error at which a heading has been looked at, radians.
const FACING_RAD: f64 = 0.12;
/// Time between two plans of a path, seconds; half of that while another robot is near.
const PLAN_PERIOD_S: f64 = 3.0;
/// Distance within which other robots are obstacles of a path, metres.
const NEAR_ROBOT_M: f64 = 1.6;
/// Time without motion after which a robot recovers, and the motion that counts, metres and radians.
const STUCK_S: f64 = 4.0;
const STILL_M: f64 = 0.05;
const STILL_RAD: f64 = 0.3;
/// Times that a robot recovers at one goal before it gives up.
const RECOVERIES_MAX: u32 = 5;
/// Distance and speed of giving way, and time to wait afterwards.
const GIVE_WAY_M: f64 = 1.2;
const WAIT_S: f64 = 4.0;
/// Distance between two centres below which robots approach each other no more, metres; by priority.
const KEEP_APART_M: [f64; 2] = [0.30, 0.38];
/// Distance between two centres below which a robot does not back up, metres.
const APART_BEHIND_M: f64 = 0.32;

/// What a robot shall do.
#[derive(Clone, Debug, PartialEq)]
pub struct Task {
    pub position_m: [f64; 2],
    pub headings_rad: Vec<f64>,
}

/// Another robot: place, and whether it goes first.
#[derive(Clone, Copy, Debug)]
pub struct Other {
    pub position_m: [f64; 2],
    pub goes_first: bool,
}

/// State of the robot's fleet at one control step.
pub struct Scene<'a> {
    pub now: Stamp,
    pub map: MapView<'a>,
    pub pose: Pose2,
    pub scan: Option<ScanView<'a>>,
    pub others: &'a [Other],
}

#[derive(Clone, Copy, Debug)]
enum Behavior {
    Follow,
    BackUp(BackingUp),
    GiveWay,
    Wait { until: Stamp },
}

/// Driver of one robot.
pub struct Driver {
    task: Option<Task>,
    heading: usize,
    has_arrived: bool,
    path: Path,
    follower: PathFollower,
    planner: Planner,
    collision: CollisionLimit,
    planned_at: Option<Stamp>,
    behavior: Behavior,
    still: Option<(Stamp, Pose2)>,
    recoveries: u32,
    trail: Vec<[f64; 2]>,
    pub progress: GoalProgress,
    pub plans: u32,
}

impl Driver {
    pub fn new() -> Self {
        let (body, config) = (RobotBody::default(), FollowerConfig::default());
        Self {
            task: None,
            heading: 0,
            has_arrived: false,
            path: Path::default(),
            follower: PathFollower::new(config),
            planner: Planner::new(body),
            collision: CollisionLimit::new(body, config),
            planned_at: None,
            behavior: Behavior::Follow,
            still: None,
            recoveries: 0,
            trail: Vec::new(),
            progress: GoalProgress::Idle,
            plans: 0,
        }
    }

    /// Sets the task. One with the same place keeps the path; its headings are looked at anew.
    pub fn set_task(&mut self, task: Option<Task>) {
        let is_same_place = match (&self.task, &task) {
            (Some(old), Some(new)) => distance_m(old.position_m, new.position_m) < CELL_SIZE_MIN_M,
            (None, None) => true,
            _ => false,
        };
        if is_same_place && self.task == task && self.progress == GoalProgress::Active {
            return;
        }
        self.progress = if task.is_some() { GoalProgress::Active } else { GoalProgress::Idle };
        self.heading = 0;
        if !is_same_place {
            self.planned_at = None;
            self.has_arrived = false;
            self.recoveries = 0;
            self.follower.reset();
        }
        self.task = task;
    }

    /// One control step.
    pub fn step(&mut self, scene: &Scene) -> Twist {
        let here_m = [scene.pose.x_m, scene.pose.y_m];
        if self.trail.last().is_none_or(|last| distance_m(*last, here_m) > 0.1) {
            self.trail.push(here_m);
            if self.trail.len() > 200 {
                self.trail.remove(0);
            }
        }
        let twist = match self.behavior {
            Behavior::Follow => self.follow(scene),
            Behavior::BackUp(backing_up) => {
                if !backing_up.is_done(scene.now, here_m) {
                    return BACK_UP;
                }
                self.behavior = Behavior::Follow;
                self.planned_at = None;
                Twist::STOP
            }
            Behavior::GiveWay => self.give_way(scene),
            Behavior::Wait { until } => {
                if scene.now >= until {
                    self.behavior = Behavior::Follow;
                    self.planned_at = None;
                }
                Twist::STOP
            }
        };
        self.limit(scene, twist)
    }

    fn follow(&mut self, scene: &Scene) -> Twist {
        let Some(task) = self.task.clone() else { return Twist::STOP };
        if self.progress != GoalProgress::Active {
            return Twist::STOP;
        }
        let here_m = [scene.pose.x_m, scene.pose.y_m];
        if self.has_arrived || distance_m(here_m, task.position_m) < ARRIVED_M {
            self.has_arrived = true;
            return self.look(scene, &task);
        }
        self.plan_if_due(scene, &task);
        if self.is_stuck(scene) {
            self.recover(scene);
            return Twist::STOP;
        }
        match self.follower.follow(&self.path, scene.pose, FollowerConfig::default().cruise_m_s) {
            Some(twist) => twist,
            None => {
                // The end of the path is as near as the robot comes.
                self.has_arrived = !self.path.waypoints.is_empty();
                Twist::STOP
            }
        }
    }

    fn look(&mut self, scene: &Scene, task: &Task) -> Twist {
        while let Some(heading_rad) = task.headings_rad.get(self.heading) {
            let error_rad = wrap_angle(heading_rad - scene.pose.yaw_rad);
            let is_last = self.heading + 1 == task.headings_rad.len();
            // Headings between are passed without a stop.
            let facing_rad = if is_last { FACING_RAD } else { 0.6 };
            if error_rad.abs() < facing_rad {
                self.heading += 1;
                continue;
            }
            let config = FollowerConfig::default();
            let gain = if is_last { config.heading_gain_1_s } else { 10.0 };
            let speed_rad_s = (gain * error_rad).clamp(-config.turn_rad_s, config.turn_rad_s);
            return Twist { linear_m_s: 0.0, angular_rad_s: speed_rad_s };
        }
        self.progress = GoalProgress::Reached;
        Twist::STOP
    }

    fn plan_if_due(&mut self, scene: &Scene, task: &Task) {
        let here_m = [scene.pose.x_m, scene.pose.y_m];
        let near: Vec<[f64; 2]> = scene
            .others
            .iter()
            .map(|other| other.position_m)
            .filter(|at| distance_m(*at, here_m) < NEAR_ROBOT_M)
            .collect();
        let period_s = if near.is_empty() { PLAN_PERIOD_S } else { PLAN_PERIOD_S / 2.0 };
        if self.planned_at.is_some_and(|at| scene.now - at < period_s) {
            return;
        }
        let is_first = self.planned_at.is_none();
        self.planned_at = Some(scene.now);
        self.plans += 1;
        let input = PlanningInput { scan: scene.scan, ..PlanningInput::new(scene.map, scene.pose) };
        let around = PlanningInput { other_robots_m: &near, ..input };
        let mut path = self.planner.plan_path(&around, task.position_m);
        if path.is_err() && !near.is_empty() {
            path = self.planner.plan_path(&input, task.position_m);
        }
        match path {
            Ok(path) => {
                self.path = path;
                if is_first { self.follower.reset() } else { self.follower.on_replanned() }
            }
            Err(PlanError::StartBlocked) => self.recover(scene),
            Err(_) => self.progress = GoalProgress::Failed,
        }
    }

    fn is_stuck(&mut self, scene: &Scene) -> bool {
        let (since, reference) = *self.still.get_or_insert((scene.now, scene.pose));
        let turned_rad = wrap_angle(scene.pose.yaw_rad - reference.yaw_rad).abs();
        if reference.distance_m(scene.pose) > STILL_M || turned_rad > STILL_RAD {
            self.still = Some((scene.now, scene.pose));
            return false;
        }
        scene.now - since > STUCK_S
    }

    /// Gives way to a robot near that goes first, waits for one that does not, or backs up.
    fn recover(&mut self, scene: &Scene) {
        self.still = None;
        self.recoveries += 1;
        if self.recoveries > RECOVERIES_MAX {
            self.progress = GoalProgress::Failed;
            self.recoveries = 0;
            return;
        }
        let here_m = [scene.pose.x_m, scene.pose.y_m];
        let near = scene.others.iter().filter(|other| distance_m(other.position_m, here_m) < 0.9);
        let goes_first = near.clone().any(|other| other.goes_first);
        let is_near = near.count() > 0;
        self.behavior = if goes_first || (is_near && self.recoveries > 2) {
            self.path = self.retreat(here_m);
            self.follower.reset();
            Behavior::GiveWay
        } else if is_near {
            Behavior::Wait { until: after(scene.now, WAIT_S) }
        } else {
            Behavior::BackUp(BackingUp::new(scene.now, here_m, self.back_up_distance_m(scene)))
        };
    }

    /// The way back along the robot's trail.
    fn retreat(&self, here_m: [f64; 2]) -> Path {
        let waypoint = |at: &[f64; 2]| Waypoint { position_m: *at, clearance_m: 0.2 };
        let away = |at: &&[f64; 2]| distance_m(**at, here_m) < GIVE_WAY_M;
        Path { waypoints: self.trail.iter().rev().take_while(away).map(waypoint).collect() }
    }

    fn give_way(&mut self, scene: &Scene) -> Twist {
        let twist = self.follower.follow(&self.path, scene.pose, FollowerConfig::default().cruise_m_s);
        if twist.is_none() || self.is_stuck(scene) {
            self.still = None;
            self.behavior = Behavior::Wait { until: after(scene.now, WAIT_S) };
        }
        twist.unwrap_or(Twist::STOP)
    }

    /// How far the robot may back up, metres; 0 if not at all.
    fn back_up_distance_m(&self, scene: &Scene) -> f64 {
        let is_free_of_robots = |back_m: f64| {
            let behind_m = scene.pose.apply([-back_m, 0.0]);
            scene.others.iter().all(|other| distance_m(other.position_m, behind_m) >= APART_BEHIND_M)
        };
        let map = self.planner.map();
        back_up_distance_m(map, RobotBody::default(), scene.pose, is_free_of_robots).unwrap_or(0.0)
    }

    fn limit(&self, scene: &Scene, twist: Twist) -> Twist {
        let scan_m = scene.scan.map_or(0.0, |scan| self.collision.free_distance_m(&scan));
        let here_m = [scene.pose.x_m, scene.pose.y_m];
        let in_base = scene.others.iter().map(|other| (other, scene.pose.inverse().apply(other.position_m)));
        let mut free_m = scan_m;
        for (other, at) in in_base {
            free_m = free_m.min(self.collision.free_distance_to_robot_m(at));
            let apart_m = distance_m(other.position_m, here_m);
            let least_m = KEEP_APART_M[usize::from(other.goes_first)];
            if at[0] > 0.0 && apart_m < 0.6 {
                free_m = free_m.min((apart_m - least_m).max(0.0) + FollowerConfig::default().stop_distance_m);
            }
        }
        self.collision.limit_speed(twist, free_m)
    }
}

fn after(now: Stamp, seconds: f64) -> Stamp {
    now + core::time::Duration::from_secs_f64(seconds)
}
