//! Invariants of a fleet under faults: robots stand when nobody drives, poses are in the right frame, no map is lost,
//! queues are bounded, and every process works again after the last fault.

use super::Lockstep;
use super::faults::FaultPlan;
use crate::config::FleetConfig;
use crate::fleet;
use crate::ports::ReadMapPort;
use crate::process::Error;
use crate::sessions;
use crate::storage::Storage;
use msg::{
    Correction, GridView, GroundTruth, Monotonic, Pose2, RobotId, Stamp, TrackingState, VelocityCommand,
};
use sha2::{Digest, Sha256};
use std::collections::VecDeque;

/// Time that a fleet has to recover after the last fault, seconds: back-off after two deaths, and a pause.
pub const RECOVERY_S: u32 = 7;
/// Longest time from the last command until a robot stands, in units of the simulator's dead-man time: a command
/// is valid that long, and may have waited as long.
const DEAD_MAN_TIMES: f64 = 2.0;
/// Tolerance of that time, seconds: one tick of the simulator and one of the operator.
const REST_MARGIN_S: f64 = 0.1;
/// Velocity below which a robot counts as standing, m/s and rad/s.
const REST_SPEED: [f64; 2] = [0.01, 0.05];
/// Step of a simulator's time that counts as a jump, seconds.
const JUMP_MIN_S: f64 = 0.05;
/// Ticks of its own time within which a robot comes to rest.
const STOPPING_TICKS: u32 = 20;
/// Pose error above which a pose is in a wrong frame; a correct one errs by 0.05 m and 2 degrees.
const POSE_ERROR_MAX: [f64; 2] = [0.5, 0.35];
/// Number of scans in a row with that error: one bad match is no wrong frame.
const WRONG_SCANS: u32 = 10;
/// Message about a robot in a wrong frame.
pub const WRONG_POSE: &str = "is sure of a wrong pose";
/// Share of the saved cells that must be known again; poses move a little as the graph is solved.
const KNOWN_SHARE_MIN: f64 = 0.9;
/// Largest number of commands and requests that may wait in a back end.
const BACKLOG_MAX: usize = 24;
/// Number of true poses kept for late corrections: five seconds.
const TRUTHS_MAX: usize = 500;
/// Time without a correction after which a robot's SLAM counts as not working, seconds.
const SILENT_MAX_S: f64 = 1.5;

/// Checks the invariants on the messages of a fleet.
pub struct Checker {
    robots: Vec<RobotChecker>,
    dead_man_s: f64,
    violations: Vec<String>,
}

/// Observations of one robot.
struct RobotChecker {
    robot: RobotId,
    world_from_start: Option<Pose2>,
    truths: VecDeque<(Stamp, Pose2)>,
    /// When it was last told to move.
    driven: Option<Monotonic>,
    /// Ticks since its time jumped: a robot needs some of them to come to rest.
    ticks: u32,
    /// Corrections in a row that are far from the truth.
    wrong: u32,
    corrected: Option<Stamp>,
}

impl Checker {
    /// Creates the checks of a fleet from which no message was received yet.
    ///
    /// # Errors
    /// The configuration's room or starts cannot be used.
    pub fn new(config: &FleetConfig) -> Result<Self, Error> {
        let starts = fleet::true_starts(config)?;
        let robots = RobotId::first(config.fleet.robots).zip(starts);
        let robots = robots.map(|(robot, world_from_start)| RobotChecker {
            robot,
            world_from_start,
            truths: VecDeque::new(),
            driven: None,
            ticks: 0,
            wrong: 0,
            corrected: None,
        });
        let dead_man_s = config.sim.limits.command_timeout_s;
        Ok(Self { robots: robots.collect(), dead_man_s, violations: Vec::new() })
    }

    /// Receives a message of the fleet.
    pub fn receive(&mut self, channel: &str, bytes: &[u8]) {
        let rest_after_s = DEAD_MAN_TIMES * self.dead_man_s + REST_MARGIN_S;
        let Some((robot, name)) = channel.split_once('/') else { return };
        let Some(robot) = self.robots.iter_mut().find(|known| known.robot.to_string() == robot) else {
            return;
        };
        let violation = match name {
            "command" => robot.command(&bytemuck::pod_read_unaligned(bytes)),
            "truth" => robot.truth(&bytemuck::pod_read_unaligned(bytes), rest_after_s),
            "correction" => robot.correction(&bytemuck::pod_read_unaligned(bytes)),
            _ => None,
        };
        self.violations.extend(violation);
    }

    /// Checks the fleet's state at the end. Returns all violations.
    pub fn finish(mut self, fleet: &Lockstep) -> Vec<String> {
        let now = fleet.now();
        for robot in &self.robots {
            if robot.corrected.is_none_or(|corrected| now - corrected > SILENT_MAX_S) {
                let last = robot.corrected;
                self.violations.push(format!("{}: no correction since {last:?}, now {now:?}", robot.robot));
            }
        }
        self.violations.extend(fleet.state_violations());
        self.violations
    }
}

impl RobotChecker {
    fn command(&mut self, command: &VelocityCommand) -> Option<String> {
        if command.linear_m_s != 0.0 || command.angular_rad_s != 0.0 {
            self.driven = Some(command.header.sent);
        }
        None
    }

    fn truth(&mut self, truth: &GroundTruth, rest_after_s: f64) -> Option<String> {
        let stamp = truth.header.stamp;
        let jumped = self.truths.back().is_none_or(|(before, _)| stamp - *before > JUMP_MIN_S);
        self.ticks = if jumped { 0 } else { self.ticks.saturating_add(1) };
        self.truths.push_back((stamp, truth.world_from_base));
        if self.truths.len() > TRUTHS_MAX {
            self.truths.pop_front();
        }
        let moves = truth.linear_m_s.abs() > REST_SPEED[0] || truth.angular_rad_s.abs() > REST_SPEED[1];
        let since_s = self.driven.map(|sent| stamp.seconds() - sent.0 as f64 * 1e-9);
        let may_move = since_s.is_some_and(|since| since <= rest_after_s) || self.ticks < STOPPING_TICKS;
        (moves && !may_move).then(|| format!("{} moves {since_s:?} s after the last command", self.robot))
    }

    fn correction(&mut self, correction: &Correction) -> Option<String> {
        let stamp = correction.header.stamp;
        self.corrected = self.corrected.max(Some(stamp));
        let at = self.truths.iter().rev().find(|(at, _)| *at == stamp);
        let (Some((_, world_from_base)), Some(world_from_start)) = (at, self.world_from_start) else {
            return None;
        };
        let error = (world_from_start * correction.map_from_base).between(*world_from_base);
        let [m, rad] = [error.x_m.hypot(error.y_m), error.yaw_rad.abs()];
        let is_wrong = m > POSE_ERROR_MAX[0] || rad > POSE_ERROR_MAX[1];
        let sure = correction.state() != TrackingState::Lost;
        self.wrong = if is_wrong && sure { self.wrong + 1 } else { 0 };
        (self.wrong == WRONG_SCANS).then(|| {
            format!("{} {WRONG_POSE} at {:.2} s: {m:.2} m, {rad:.2} rad", self.robot, stamp.seconds())
        })
    }
}

impl Lockstep {
    /// Returns how many known cells a robot's session file has.
    pub(super) fn saved_cells(&self, robot: RobotId) -> usize {
        let run = &self.world.run;
        let path = sessions::file(&sessions::folder(run), robot);
        let session = self.world.storage.read(&path, u64::MAX);
        let identity = sessions::identity(run, robot);
        let session = session.ok().and_then(|bytes| slam::Session::decode(&bytes, &identity).ok());
        session.map_or(0, |session| {
            let mode = session.mode;
            let (_, mut back) =
                slam::begin(run.config.slam.clone(), Some(session), mode, slam::InitialPose::Continue);
            known_cells(back.map())
        })
    }

    /// Returns the violations in the fleet's state.
    fn state_violations(&self) -> Vec<String> {
        let mut violations = Vec::new();
        for member in &self.members {
            let title = member.row.title(member.robot);
            if !member.is_running() {
                violations.push(format!("the {title} does not run: {:?}", member.policy.state()));
            }
            let (Some(slam), Some(robot)) = (member.slam(), member.robot) else { continue };
            let backlog = slam.process.back_end.backlog();
            if backlog.iter().any(|waiting| *waiting > BACKLOG_MAX) {
                violations.push(format!("the {title} has a backlog of {backlog:?}"));
            }
            let saved = self.saved[robot.index()];
            let (_, reader, _) = &self.observer.maps[robot.index()];
            let known: usize = reader.map().tiles().map(|tile| count(&tile.cells)).sum();
            if (known as f64) < KNOWN_SHARE_MIN * saved as f64 {
                violations.push(format!("{robot}'s map has {known} known cells; {saved} were saved"));
            }
        }
        violations
    }
}

fn known_cells(map: GridView<'_>) -> usize {
    count(map.cells)
}

fn count(cells: &[i8]) -> usize {
    cells.iter().filter(|cell| **cell != msg::grid::UNKNOWN).count()
}

/// Result of a run with faults.
#[derive(Debug, PartialEq, Eq)]
pub struct FaultReport {
    /// Hash of all messages.
    pub sha256: String,
    /// Violations of the invariants.
    pub violations: Vec<String>,
}

/// Runs a fleet for `seconds` of virtual time with these faults, and checks the invariants.
///
/// # Errors
/// The fleet cannot be built.
pub fn check(config: &FleetConfig, faults: FaultPlan, seconds: u32) -> Result<FaultReport, Error> {
    let mut fleet = Lockstep::with_faults(config, true, faults)?;
    let mut checker = Checker::new(config)?;
    let mut hash = Sha256::new();
    while fleet.now().seconds() < f64::from(seconds) {
        fleet.tick(&mut |channel, message| {
            hash.update(channel);
            hash.update(message);
            checker.receive(channel, message);
        });
    }
    let sha256 = hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect();
    Ok(FaultReport { sha256, violations: checker.finish(&fleet) })
}

/// Returns the moment after which no fault is injected, in a run of this many seconds.
pub fn quiet_from(seconds: u32) -> Monotonic {
    Monotonic(u64::from(seconds.saturating_sub(RECOVERY_S)) * 1_000_000_000)
}
