//! Invariants of a fleet under faults: robots stand when nobody drives, poses are in the right frame, no map is lost,
//! queues are bounded, and every process works again after the last fault.

use super::Lockstep;
use super::drive_checks::{DriveChecks, GATE_PERIOD};
use super::faults::FaultPlan;
use super::members::Member;
use super::merged_map_check::MergedMapCheck;
use crate::config::FleetConfig;
use crate::ports::ReadMapPort;
use crate::process::Error;
use crate::sessions;
use crate::storage::Storage;
use crate::world;
use msg::grid::known_count;
use msg::{GroundTruth, Monotonic, Pose2, PoseEstimate, RobotId, Stamp, TrackingState};
use sha2::{Digest, Sha256};
use std::collections::VecDeque;

/// Time that a fleet has to recover after the last fault, seconds: back-off after two deaths, and a pause.
pub const RECOVERY_S: u32 = 7;
/// Time in which a robot comes to rest after a zero, seconds: what its motors take from full speed, a tick included.
const BRAKING_S: f64 = 0.14;
/// Velocity below which a robot counts as standing, m/s and rad/s: one that stops in a turn against an obstacle rocks by 0.06 rad/s.
const REST_SPEED: [f64; 2] = [0.01, 0.1];
/// Pose error above which a pose is in a wrong frame; a correct one errs by 0.05 m and 2 degrees.
const POSE_ERROR_MAX: [f64; 2] = [0.5, 0.35];
/// Number of scans in a row with that error: one bad match is no wrong frame.
const WRONG_SCANS: u32 = 10;
/// Share of the cells known before that must be known again; poses move a little as the graph is solved.
pub(super) const KNOWN_SHARE_MIN: f64 = 0.9;
/// Largest number of commands and requests that may wait in a back end.
const BACKLOG_MAX: usize = 24;
/// Violations after which no more is looked for: one is enough.
const VIOLATIONS_MAX: usize = 32;
/// Number of true poses kept for late pose estimates: five seconds.
const TRUTHS_MAX: usize = 500;
/// Time without a pose estimate after which a robot's SLAM counts as not working, seconds.
const SILENT_MAX_S: f64 = 1.5;

/// Checks the invariants on the messages of a fleet.
pub struct Checker {
    robots: Vec<RobotChecker>,
    dead_man_s: f64,
    merged: MergedMapCheck,
    violations: Vec<String>,
}

/// Observations of one robot.
struct RobotChecker {
    robot: RobotId,
    world_from_start: Option<Pose2>,
    truths: VecDeque<(Stamp, Pose2)>,
    drive: DriveChecks,
    /// Pose estimates in a row that are far from the truth.
    wrong: u32,
    corrected: Option<Stamp>,
}

impl Checker {
    /// Creates the checks of a fleet from which no message was received yet.
    ///
    /// # Errors
    /// The configuration's room or starts cannot be used.
    pub fn new(config: &FleetConfig) -> Result<Self, Error> {
        let starts = world::true_starts(config)?;
        let robots = RobotId::first(config.fleet.robots).zip(starts);
        let robots = robots.map(|(robot, world_from_start)| RobotChecker {
            robot,
            world_from_start,
            truths: VecDeque::new(),
            drive: DriveChecks::new(config, robot),
            wrong: 0,
            corrected: None,
        });
        let dead_man_s = config.sim.limits.command_timeout_s;
        let merged = MergedMapCheck::default();
        Ok(Self { robots: robots.collect(), dead_man_s, merged, violations: Vec::new() })
    }

    /// Receives a message of the fleet.
    pub fn receive(&mut self, channel: &str, bytes: &[u8]) {
        let rest_after_s = self.dead_man_s + GATE_PERIOD.as_secs_f64() + BRAKING_S;
        let Some((robot, name)) = channel.split_once('/') else { return };
        if robot == "fault" {
            let at = Monotonic(bytemuck::pod_read_unaligned(bytes));
            self.robots.iter_mut().for_each(|robot| robot.drive.on_event(name, at));
            return;
        }
        let Some(robot) = self.robots.iter_mut().find(|known| known.robot.to_string() == robot) else {
            return;
        };
        let violation = match name {
            "command" => robot.drive.command(&bytemuck::pod_read_unaligned(bytes)),
            "truth" => robot.truth(&bytemuck::pod_read_unaligned(bytes), rest_after_s),
            "pose_estimate" => robot.pose_estimate(&bytemuck::pod_read_unaligned(bytes)),
            _ => None,
        };
        self.violations.extend(violation);
    }

    /// Checks that what waits in the fleet's processes is bounded, and that no robot waits for its zero. Call it after each tick.
    pub fn check_bounds(&mut self, fleet: &Lockstep) {
        if self.violations.len() < VIOLATIONS_MAX {
            self.violations.extend(fleet.backlog_violations());
            let (now, is_disturbed) = (fleet.time(), fleet.is_bridge_disturbed());
            let late = self.robots.iter_mut().filter_map(|robot| robot.drive.check_zero(now, is_disturbed));
            self.violations.extend(late);
            self.violations.extend(self.merged.check(fleet));
        }
    }

    /// Checks the fleet's state at the end. Returns all violations.
    pub fn finish(mut self, fleet: &Lockstep) -> Vec<String> {
        let now = fleet.now();
        for robot in &self.robots {
            if robot.corrected.is_none_or(|corrected| now - corrected > SILENT_MAX_S) {
                let last = robot
                    .corrected
                    .map_or_else(|| "the start".to_owned(), |stamp| format!("{:.3} s", stamp.seconds()));
                self.violations.push(format!(
                    "{}: no pose estimate since {last}, now {:.3} s",
                    robot.robot,
                    now.seconds()
                ));
            }
        }
        self.violations.extend(fleet.state_violations());
        self.violations
    }
}

impl RobotChecker {
    fn truth(&mut self, truth: &GroundTruth, rest_after_s: f64) -> Option<String> {
        let stamp = truth.header.stamp;
        self.truths.push_back((stamp, truth.world_from_base));
        if self.truths.len() > TRUTHS_MAX {
            self.truths.pop_front();
        }
        let moves = truth.linear_m_s.abs() > REST_SPEED[0] || truth.angular_rad_s.abs() > REST_SPEED[1];
        let since_s = self.drive.driven().map(|sent| stamp.seconds() - sent.0 as f64 * 1e-9);
        let may_move = since_s.is_some_and(|since| since <= rest_after_s);
        (moves && !may_move).then(|| {
            let since = since_s
                .map_or_else(|| "without a".to_owned(), |since_s| format!("{since_s:.2} s after the last"));
            format!("{} moves at {:.2} s, {since} command", self.robot, stamp.seconds())
        })
    }

    fn pose_estimate(&mut self, pose_estimate: &PoseEstimate) -> Option<String> {
        let stamp = pose_estimate.header.stamp;
        self.corrected = self.corrected.max(Some(stamp));
        let at = self.truths.iter().rev().find(|(at, _)| *at == stamp);
        let (Some((_, world_from_base)), Some(world_from_start)) = (at, self.world_from_start) else {
            return None;
        };
        let error = (world_from_start * pose_estimate.map_from_base).between(*world_from_base);
        let [m, rad] = [error.x_m.hypot(error.y_m), error.yaw_rad.abs()];
        let is_wrong = m > POSE_ERROR_MAX[0] || rad > POSE_ERROR_MAX[1];
        let sure = pose_estimate.state() != TrackingState::Lost;
        self.wrong = if is_wrong && sure { self.wrong + 1 } else { 0 };
        (self.wrong == WRONG_SCANS).then(|| {
            format!(
                "{} is sure of a wrong pose at {:.2} s: {m:.2} m, {rad:.2} rad",
                self.robot,
                stamp.seconds()
            )
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
            let (_, mut back) = slam::create_or_resume(
                run.config.slam.clone(),
                Some(session),
                mode,
                slam::InitialPose::Continue,
            );
            known_count(back.map().cells)
        })
    }

    /// Returns whether the bridge cannot send: it does not run, is stopped, or its channels are full.
    fn is_bridge_disturbed(&self) -> bool {
        let now = self.time();
        let runs = |member: &Member| member.bridge().is_some() && member.frozen_until <= now;
        !self.members.iter().any(runs) || self.world.network.faults().is_full(now)
    }

    /// Returns the processes in which more waits than may.
    fn backlog_violations(&self) -> Vec<String> {
        let mut violations = Vec::new();
        for member in &self.members {
            let title = member.row.title(member.robot);
            if let Some(slam) = member.slam() {
                let backlog = slam.process.back_end.backlog();
                if backlog.iter().any(|waiting| *waiting > BACKLOG_MAX) {
                    violations.push(format!(
                        "{} commands and {} requests wait in the {title}",
                        backlog[0], backlog[1]
                    ));
                }
            }
            if let Some(process) = member.bridge() {
                let bytes_max = self.world.run.config.bridge.outbox_bytes_max;
                let clients = process.bridge.clients(self.time());
                let fullest = clients.iter().map(|client| client.waiting_bytes).max().unwrap_or(0);
                if fullest > bytes_max {
                    violations.push(format!("the {title} keeps {fullest} bytes for a client"));
                }
            }
        }
        violations
    }

    /// Returns the violations in the fleet's state.
    fn state_violations(&self) -> Vec<String> {
        let mut violations = self.violations.clone();
        for member in &self.members {
            let title = member.row.title(member.robot);
            if !member.is_running() {
                violations.push(format!("the {title} does not run"));
            }
            let (Some(_), Some(robot)) = (member.slam(), member.robot) else { continue };
            let saved = self.saved[robot.index()];
            let (_, reader, _) = &self.observer.maps[robot.index()];
            let known: usize = reader.map().tiles().map(|tile| known_count(&tile.cells)).sum();
            if (known as f64) < KNOWN_SHARE_MIN * saved as f64 {
                violations.push(format!("{robot}'s map has {known} known cells; {saved} were saved"));
            }
        }
        violations
    }
}

/// Result of a run with faults.
#[derive(Debug, PartialEq, Eq)]
pub struct FaultReport {
    /// Hash of all messages.
    pub sha256: String,
    /// Violations of the invariants.
    pub violations: Vec<String>,
}

/// Runs a fleet for `seconds` of virtual time with these faults, and checks the invariants. `together`: the operator
/// drives all robots at once.
///
/// # Errors
/// The fleet cannot be built.
pub fn check(
    config: &FleetConfig,
    together: bool,
    faults: FaultPlan,
    seconds: u32,
) -> Result<FaultReport, Error> {
    let mut fleet = Lockstep::with_faults(config, together, faults)?;
    let mut checker = Checker::new(config)?;
    let mut hash = Sha256::new();
    while fleet.now().seconds() < f64::from(seconds) {
        fleet.tick(&mut |channel, message| {
            hash.update(channel);
            hash.update(message);
            checker.receive(channel, message);
        });
        checker.check_bounds(&fleet);
    }
    let sha256 = format!("{:x}", hash.finalize());
    Ok(FaultReport { sha256, violations: checker.finish(&fleet) })
}

/// Returns the moment after which no fault is injected, in a run of this many seconds.
pub fn quiet_from(seconds: u32) -> Monotonic {
    Monotonic(u64::from(seconds.saturating_sub(RECOVERY_S)) * 1_000_000_000)
}
