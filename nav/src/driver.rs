//! One robot in the operator's hand: look around, drive where something new is to be seen, look at it, and
//! get out again where it does not go on. Pure: what the operator sees goes in, the stick's deflection comes out.

use crate::joystick::{Joystick, Stick, Twist};
use crate::memory::{Memory, distance_m};
use crate::plan::{Answer, Plan, Planner, Purpose, Question, SAME_GOAL_M};
use crate::rng::Rng;
use crate::sight::{MapView, RobotSight, ScanView};
use crate::steering::{self, Pursuit, TURN_RAD_S, Wander};
use core::f64::consts::TAU;
use core::time::Duration;
use msg::{Pose2, RobotId, Stamp, pose::wrap_angle};
use serde::Serialize;

/// Nobody drives by a scan older than this, seconds.
const SCAN_AGE_MAX_S: f64 = 0.5;
/// The operator thinks again this often, seconds.
const THINK_EVERY_S: f64 = 1.0;
/// A turn on the spot that has not come round after this long is given up, seconds.
const LOOK_AROUND_MAX_S: f64 = 15.0;
/// Looks this long at a frontier: the map needs some scans and some time to show it, seconds.
const LOOK_S: f64 = 0.8;
/// Faces a point when it is off by less than this, radians.
const FACING_RAD: f64 = 0.25;
/// With so little movement ...
const STILL_M: f64 = 0.06;
/// ... and so little turning ...
const STILL_RAD: f64 = 0.35;
/// ... for this long, the robot is stuck, seconds.
const STUCK_S: f64 = 4.0;
/// A goal may take this much longer than planned before it is given up: a factor and seconds.
const PATIENCE: (f64, f64) = (2.0, 15.0);
/// Backing off: how fast, how far, how long at most.
const BACK_M_S: f64 = 0.08;
const BACK_M: f64 = 0.15;
const BACK_MAX_S: f64 = 3.0;
/// A thumb takes this long from the middle to full deflection, seconds; it lets go at once.
const THUMB_S: f64 = 0.25;

/// What a driver did so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct DriverFigures {
    /// Way driven by the map's account, metres.
    pub driven_m: f64,
    /// Turns on the spot to look around.
    pub looks_around: u32,
    /// Frontiers looked at or past.
    pub frontiers: u32,
    /// Places gone back to.
    pub patrols: u32,
    /// Times it was stuck and had to be freed.
    pub recoveries: u32,
    /// Plans made.
    pub plans: u32,
}

#[derive(Clone, Copy, Debug)]
enum Phase {
    LookAround { turned_rad: f64, last_yaw_rad: f64, until: Stamp },
    Pursue,
    BackOff { from_m: [f64; 2], until: Stamp },
    TurnAway { side: f64, until: Stamp },
}

/// Where it was when it last got anywhere.
#[derive(Clone, Copy, Debug)]
struct Watch {
    since: Stamp,
    pose: Pose2,
}

/// What surrounds a robot beside its own sight, in its map's frame.
#[derive(Clone, Copy, Debug, Default)]
pub struct Company<'a> {
    /// Where the other robots stand, metres.
    pub others_m: &'a [[f64; 2]],
    /// What they are on their way to, metres.
    pub held_m: &'a [[f64; 2]],
}

/// What there is to think about.
struct Scene<'a> {
    map: MapView<'a>,
    pose: Pose2,
    scan: ScanView<'a>,
    company: &'a Company<'a>,
}

impl<'a> Scene<'a> {
    fn question(&self, stamp: Stamp, memory: &'a Memory, goal_m: Option<[f64; 2]>) -> Question<'a> {
        let Company { others_m, held_m } = *self.company;
        Question {
            stamp,
            map: self.map,
            map_from_base: self.pose,
            scan: self.scan,
            memory,
            others_m,
            held_m,
            goal_m,
        }
    }
}

/// The policy for one robot.
#[derive(Clone, Debug)]
pub struct Driver {
    robot: RobotId,
    joystick: Joystick,
    rng: Rng,
    memory: Memory,
    phase: Option<Phase>,
    plan: Option<Plan>,
    /// When the goal is given up.
    patience: Stamp,
    pursuit: Pursuit,
    wander: Wander,
    facing_since: Option<Stamp>,
    thought: Option<Stamp>,
    watch: Option<Watch>,
    last_pose: Option<Pose2>,
    merged: bool,
    thumb: (Stamp, Stick),
    idle_since: Option<Stamp>,
    figures: DriverFigures,
}

impl Driver {
    /// A robot nobody has driven yet.
    pub fn new(robot: RobotId, joystick: Joystick, seed: u64) -> Self {
        let mut rng = Rng::new(seed ^ (robot.number() as u64).wrapping_mul(0xA24B_AED4_963E_E407));
        rng.bits();
        Self {
            robot,
            joystick,
            rng,
            memory: Memory::default(),
            phase: None,
            plan: None,
            patience: Stamp(i64::MAX),
            pursuit: Pursuit::default(),
            wander: Wander::default(),
            facing_since: None,
            thought: None,
            watch: None,
            last_pose: None,
            merged: false,
            thumb: (Stamp(i64::MIN), Stick::CENTRED),
            idle_since: None,
            figures: DriverFigures::default(),
        }
    }

    /// Which robot.
    pub fn robot(&self) -> RobotId {
        self.robot
    }

    /// What it did so far.
    pub fn figures(&self) -> DriverFigures {
        self.figures
    }

    /// What it is on its way to, in its map's frame, metres.
    pub fn goal_m(&self) -> Option<[f64; 2]> {
        self.plan.as_ref().map(|plan| plan.look_at_m)
    }

    /// What the plan is for, if there is one.
    pub fn purpose(&self) -> Option<Purpose> {
        self.plan.as_ref().map(|plan| plan.purpose)
    }

    /// Whether the robot shows neither map and pose nor scan to drive by, or nowhere to go, since when.
    pub fn idle_since(&self) -> Option<Stamp> {
        self.idle_since
    }

    /// When the driver would like to think next.
    pub fn thinks_at(&self) -> Stamp {
        self.thought.map_or(Stamp(i64::MIN), |at| at + Duration::from_secs_f64(THINK_EVERY_S))
    }

    /// The robot is out of the hand: what was timed starts anew next time.
    pub fn release(&mut self) {
        self.thumb.1 = Stick::CENTRED;
        (self.watch, self.facing_since, self.thought, self.idle_since) = (None, None, None, None);
        self.patience = Stamp(i64::MAX);
        if !matches!(self.phase, None | Some(Phase::LookAround { .. })) {
            self.phase = Some(Phase::Pursue);
        }
    }

    /// One look at the robot, one deflection. Only if `may_think` it may plan anew, which takes a while.
    pub fn step(
        &mut self,
        now: Stamp,
        sight: &RobotSight,
        company: &Company,
        planner: &mut Planner,
        may_think: bool,
    ) -> Stick {
        let fresh = |scan: &ScanView| now - scan.seen <= SCAN_AGE_MAX_S;
        let Some(scan) = sight.scan.filter(fresh) else {
            self.idle_since.get_or_insert(now);
            return self.let_go(now);
        };
        let mut gap_m = steering::gap_ahead_m(&scan);
        let wish = match sight.map.zip(sight.map_from_base.filter(|pose| pose.is_finite())) {
            Some((map, pose)) => {
                self.note(now, sight, pose, &scan);
                if may_think {
                    self.think(now, &Scene { map, pose, scan, company }, planner);
                }
                let others = company.others_m.iter().map(|at_m| pose.inverse().apply(*at_m));
                gap_m = others.map(steering::gap_to_robot_m).fold(gap_m, f64::min);
                self.act(now, pose, &scan)
            }
            None => self.drive_blindly(&scan),
        };
        self.move_thumb(now, steering::guard(wish, gap_m))
    }

    /// Plans if it is time to, and finds a way out if the robot is stuck.
    fn think(&mut self, now: Stamp, scene: &Scene, planner: &mut Planner) {
        if !matches!(self.phase, Some(Phase::Pursue)) {
            return;
        }
        if now >= self.thinks_at() {
            let answer = planner.plan(&scene.question(now, &self.memory, self.goal_m()), &mut self.rng);
            self.adopt(now, answer);
        }
        if self.is_stuck(now, scene.pose) {
            planner.look(&scene.question(now, &self.memory, None));
            self.recover(now, scene.pose, planner);
        }
    }

    /// By the scan alone, while nobody knows where the robot is.
    fn drive_blindly(&mut self, scan: &ScanView) -> Twist {
        self.idle_since = None;
        self.plan = None;
        self.wander.steer(scan, self.cruise_m_s(), &mut self.rng)
    }

    fn cruise_m_s(&self) -> f64 {
        self.joystick.linear_max_m_s()
    }

    fn note(&mut self, now: Stamp, sight: &RobotSight, pose: Pose2, scan: &ScanView) {
        if self.merged != sight.merged {
            // Another map, other coordinates.
            self.merged = sight.merged;
            self.memory.forget();
            (self.plan, self.last_pose, self.watch) = (None, None, None);
        }
        self.memory.note(now, pose, scan);
        // A metre between two looks is no driving, but the map shifted.
        let step_m = self.last_pose.map_or(0.0, |last| last.distance_m(pose));
        self.figures.driven_m += if step_m < 1.0 { step_m } else { 0.0 };
        self.last_pose = Some(pose);
        self.phase.get_or_insert_with(|| look_around(now, pose));
    }

    fn adopt(&mut self, now: Stamp, answer: Answer) {
        self.thought = Some(now);
        self.figures.plans += 1;
        let Answer::Go(plan) = answer else {
            self.plan = None;
            self.idle_since.get_or_insert(now);
            return;
        };
        self.idle_since = None;
        let under_way = self.patience != Stamp(i64::MAX);
        match self.purpose().zip(self.goal_m()) {
            // A patrol keeps its way: another draw would be another place.
            Some((Purpose::Patrol, _)) if plan.purpose == Purpose::Patrol && under_way => return,
            Some((Purpose::Explore, goal_m)) if plan.goal_gone => {
                // If it comes back, the robot has to look closer.
                self.figures.frontiers += 1;
                self.memory.doubt(now, goal_m, 1);
            }
            Some((Purpose::Explore, goal_m))
                if distance_m(goal_m, plan.look_at_m) < SAME_GOAL_M && under_way =>
            {
                self.plan = Some(plan);
                self.pursuit.replanned();
                return;
            }
            _ => {}
        }
        let (factor, extra_s) = PATIENCE;
        self.patience = now + Duration::from_secs_f64((factor * plan.cost_s + extra_s).clamp(0.0, 1e6));
        self.plan = Some(plan);
        self.pursuit = Pursuit::default();
        self.facing_since = None;
    }

    /// The phase's wish.
    fn act(&mut self, now: Stamp, pose: Pose2, scan: &ScanView) -> Twist {
        match self.phase.unwrap_or(Phase::Pursue) {
            Phase::LookAround { turned_rad, last_yaw_rad, until } => {
                let turned_rad = turned_rad + wrap_angle(pose.yaw_rad - last_yaw_rad);
                if turned_rad >= TAU * 0.97 || now >= until {
                    self.figures.looks_around += 1;
                    self.think_at_once();
                    return Twist::STOP;
                }
                self.phase = Some(Phase::LookAround { turned_rad, last_yaw_rad: pose.yaw_rad, until });
                Twist { linear_m_s: 0.0, angular_rad_s: TURN_RAD_S }
            }
            Phase::Pursue => self.pursue(now, pose),
            Phase::BackOff { from_m, until } => {
                if now >= until || distance_m(from_m, [pose.x_m, pose.y_m]) >= BACK_M {
                    self.think_at_once();
                }
                Twist { linear_m_s: -BACK_M_S, angular_rad_s: 0.0 }
            }
            Phase::TurnAway { side, until } => {
                if now >= until || steering::gap_ahead_m(scan) > 1.0 {
                    self.think_at_once();
                }
                Twist { linear_m_s: 0.0, angular_rad_s: side * TURN_RAD_S }
            }
        }
    }

    fn pursue(&mut self, now: Stamp, pose: Pose2) -> Twist {
        let cruise_m_s = self.cruise_m_s();
        let Some(plan) = &self.plan else { return Twist::STOP };
        if let Some(twist) = self.pursuit.steer(&plan.way, pose, cruise_m_s) {
            self.facing_since = None;
            return twist;
        }
        let goal_m = plan.look_at_m;
        match plan.purpose {
            Purpose::Patrol => {
                self.figures.patrols += 1;
                self.memory.doubt(now, goal_m, 1);
                self.plan = None;
                self.phase = Some(look_around(now, pose));
                Twist::STOP
            }
            Purpose::Explore => {
                let (twist, error_rad) = steering::face(pose, goal_m);
                if error_rad.abs() < FACING_RAD && now - *self.facing_since.get_or_insert(now) >= LOOK_S {
                    self.figures.frontiers += 1;
                    self.memory.doubt(now, goal_m, 1);
                    self.plan = None;
                    self.think_at_once();
                }
                twist
            }
        }
    }

    fn think_at_once(&mut self) {
        self.phase = Some(Phase::Pursue);
        self.thought = None;
        self.watch = None;
    }

    /// Whether it got nowhere for long, or the goal takes longer than it is worth.
    fn is_stuck(&mut self, now: Stamp, pose: Pose2) -> bool {
        let watch = *self.watch.get_or_insert(Watch { since: now, pose });
        let turned_rad = wrap_angle(pose.yaw_rad - watch.pose.yaw_rad).abs();
        if watch.pose.distance_m(pose) > STILL_M || turned_rad > STILL_RAD || self.plan.is_none() {
            self.watch = Some(Watch { since: now, pose });
        }
        let pursuing = matches!(self.phase, Some(Phase::Pursue)) && self.plan.is_some();
        pursuing && (now - watch.since > STUCK_S || now > self.patience)
    }

    /// Lets the goal be, and backs off if there is room behind, else turns away.
    fn recover(&mut self, now: Stamp, pose: Pose2, planner: &Planner) {
        self.figures.recoveries += 1;
        if let Some(goal_m) = self.goal_m() {
            self.memory.doubt(now, goal_m, 2);
        }
        self.plan = None;
        self.watch = None;
        let behind = [0.05, 0.1, BACK_M].map(|back_m| pose.apply([-back_m, 0.0]));
        let after = |seconds| now + Duration::from_secs_f64(seconds);
        self.phase = Some(if behind.iter().all(|point| planner.has_room(*point)) {
            Phase::BackOff { from_m: [pose.x_m, pose.y_m], until: after(BACK_MAX_S) }
        } else {
            let side = if self.rng.below(2) == 0 { 1.0 } else { -1.0 };
            Phase::TurnAway { side, until: after(2.0) }
        });
    }

    fn let_go(&mut self, now: Stamp) -> Stick {
        self.thumb = (now, Stick::CENTRED);
        Stick::CENTRED
    }

    /// The thumb follows the wish: outwards with its own speed, inwards at once.
    fn move_thumb(&mut self, now: Stamp, wish: Twist) -> Stick {
        let wanted = self.joystick.stick(wish);
        let (before, from) = self.thumb;
        let elapsed_s = if before == Stamp(i64::MIN) { 0.05 } else { (now - before).clamp(0.0, THUMB_S) };
        let push = elapsed_s / THUMB_S;
        let axis = |from: f64, to: f64| {
            let start = if from * to > 0.0 { from } else { 0.0 };
            let outwards = to.abs().min(start.abs() + push);
            outwards.copysign(to)
        };
        let stick = Stick { forward: axis(from.forward, wanted.forward), left: axis(from.left, wanted.left) };
        self.thumb = (now, stick);
        stick
    }
}

fn look_around(now: Stamp, pose: Pose2) -> Phase {
    let until = now + Duration::from_secs_f64(LOOK_AROUND_MAX_S);
    Phase::LookAround { turned_rad: 0.0, last_yaw_rad: pose.yaw_rad, until }
}
