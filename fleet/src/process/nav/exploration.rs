//! Exploration of the fleet: commands, the coordinator, and the state that goes out.

use super::state_file::SavedExploration;
use crate::channel;
use crate::ports::{ChannelError, Ports, ReadPort, WritePort};
use crate::run::Run;
use ::nav::coordination::{CoordinationPhase, ExplorationEnd, FoundLeftover, RobotAvailability, absent};
use ::nav::{CoordinationConfig, FleetExploration, FleetNavigator, NavigationInput, NavigatorConfig};
use msg::{
    ExplorationAction, ExplorationCommand, ExplorationLeftover, ExplorationReport, ExplorationStatus,
    ExplorerState, Monotonic, Pose2, RobotId, Stamp,
};

/// Period of the states while the exploration goes on, nanoseconds.
const REPORT_PERIOD_NS: u64 = 1_000_000_000;
/// Why it stands while persons have all robots.
const ALL_TAKEN: &str = "people, the base or the emergency stop have all robots; release the stop, cancel goals or let them end, then explore again";
const MAP_TOO_LARGE: &str =
    "the map is larger than the 51 m on which exploration plans; what lies farther away was not looked at";
const TOOK_TOO_LONG: &str = "something within reach is left: robots drove for a long time and saw nothing more; see what is left, and explore again";
const STOPPED: &str = "stopped on demand";

/// Exploration of the fleet, with its channels.
pub(super) struct Exploration<P: Ports> {
    commands: P::Reader<ExplorationCommand>,
    state: P::Writer<ExplorationReport>,
    config: CoordinationConfig,
    robots: Vec<RobotId>,
    active: Option<FleetExploration>,
    /// The state that goes out; its number is that of the newest command.
    report: ExplorationReport,
    reported_at: Option<Monotonic>,
    /// When the exploration began.
    begun: Option<Stamp>,
    has_changed: bool,
}

impl<P: Ports> Exploration<P> {
    pub(super) fn open(ports: &P, run: &Run) -> Result<Self, ChannelError> {
        let view_angle_rad = run.config.sim.lidar.fov_deg.to_radians();
        let body = NavigatorConfig::of_robots(run.config.slam.map.robot_radius_m).body;
        Ok(Self {
            commands: ports.reader(&channel::explore())?,
            state: ports.writer(&channel::exploration_state())?,
            config: CoordinationConfig { body, view_angle_rad, ..CoordinationConfig::default() },
            robots: run.robots().collect(),
            active: None,
            report: ExplorationReport::default(),
            reported_at: None,
            begun: None,
            // The first state says that nobody explores.
            has_changed: true,
        })
    }

    pub(super) fn is_active(&self) -> bool {
        self.active.is_some()
    }

    /// Whether a robot takes part in an exploration, and no person has it.
    pub(super) fn includes(&self, robot: RobotId) -> bool {
        self.active.as_ref().is_some_and(|exploration| !exploration.is_manual(robot))
    }

    /// Number of the newest command.
    pub(super) fn number(&self) -> u64 {
        self.report.number
    }

    /// Whether the navigator's goal of a robot is the exploration's.
    pub(super) fn is_driving(&self, robot: RobotId) -> bool {
        self.active.as_ref().is_some_and(|exploration| exploration.is_driving(robot))
    }

    /// Takes the oldest command that has not been applied.
    pub(super) fn receive(&mut self) -> Option<ExplorationCommand> {
        while let Some(command) = self.commands.receive() {
            if command.number > self.report.number {
                return Some(*command);
            }
        }
        None
    }

    /// Applies no command up to a number.
    pub(super) fn ignore_commands_until(&mut self, number: u64) {
        self.report.number = number;
    }

    /// Applies a command; returns whether it is known.
    pub(super) fn apply(
        &mut self,
        navigator: &mut FleetNavigator,
        command: &ExplorationCommand,
        stamp: Stamp,
    ) -> bool {
        let Some(action) = command.action() else { return false };
        match action {
            ExplorationAction::Start => self.start(navigator, command.number, stamp),
            ExplorationAction::Stop => {
                self.report.number = command.number;
                if self.is_active() {
                    self.end(navigator, ExplorationStatus::Stopped, STOPPED.into());
                }
                self.has_changed = true;
            }
        }
        true
    }

    /// Starts it, or goes on with all robots but those that drive to a person's goal.
    pub(super) fn start(&mut self, navigator: &mut FleetNavigator, number: u64, stamp: Stamp) {
        let config = self.config;
        if self.active.is_none() {
            self.begun = Some(stamp);
        }
        let exploration = self.active.get_or_insert_with(|| FleetExploration::new(config));
        for robot in &self.robots {
            let state = navigator.robots().find(|navigation| navigation.robot == *robot).map(|n| n.state);
            let is_persons = !exploration.is_driving(*robot) && navigator.goal(*robot).is_some();
            match state {
                Some(state) if is_persons && state.is_active() => exploration.set_manual(*robot, true),
                _ => {
                    exploration.release_manual(*robot);
                    if is_persons {
                        navigator.cancel(*robot);
                    }
                    navigator.resume(stamp, *robot);
                }
            }
        }
        self.report = ExplorationReport { number, ..ExplorationReport::default() };
        self.has_changed = true;
    }

    /// Takes a robot out, because a person drives it, has stopped it or gives it a goal.
    pub(super) fn set_manual(&mut self, robot: RobotId, has_new_goal: bool) {
        if let Some(exploration) = &mut self.active {
            exploration.set_manual(robot, has_new_goal);
        }
    }

    /// Gives a robot back, unless it is to drive on to a person's goal.
    pub(super) fn release_manual(&mut self, navigator: &FleetNavigator, robot: RobotId) {
        if let Some(exploration) = &mut self.active
            && (exploration.is_driving(robot) || navigator.goal(robot).is_none())
        {
            exploration.release_manual(robot);
        }
    }

    /// Sets the robots' goals; call it before each step of the navigator.
    pub(super) fn step(
        &mut self,
        navigator: &mut FleetNavigator,
        input: &NavigationInput,
        is_silent: &dyn Fn(RobotId) -> bool,
    ) {
        let Some(exploration) = &mut self.active else { return };
        self.report.elapsed_s = self.begun.map_or(f64::NAN, |begun| input.stamp - begun);
        exploration.step(navigator, input, is_silent);
        match exploration.end() {
            Some(ExplorationEnd::Completed) => {
                let reason = absent::completion(&self.parts());
                self.end(navigator, ExplorationStatus::Completed, reason);
            }
            Some(ExplorationEnd::MapTooLarge) => {
                self.end(navigator, ExplorationStatus::Failed, MAP_TOO_LARGE.into());
            }
            Some(ExplorationEnd::TookTooLong) => {
                self.end(navigator, ExplorationStatus::Failed, TOOK_TOO_LONG.into());
            }
            Some(ExplorationEnd::NoRobot) => {
                let reason = absent::no_robot(&self.parts());
                self.end(navigator, ExplorationStatus::Failed, reason);
            }
            None => {}
        }
    }

    /// Ends it: robots that drive for it stop.
    fn end(&mut self, navigator: &mut FleetNavigator, status: ExplorationStatus, reason: String) {
        self.describe(true);
        if let Some(mut exploration) = self.active.take() {
            exploration.stop(navigator);
        }
        self.report.status = status as u32;
        self.report.set_reason(&reason);
        (self.report.least_s, self.report.most_s) = (f64::NAN, f64::NAN);
        for index in 0..self.report.robots.len() {
            // Who had no part, and why, is of interest as long as the result is.
            if self.report.robot(index).absence().is_none() {
                self.report.robots[index] = ExplorerState::None as u8;
            }
        }
        self.has_changed = true;
    }

    /// The part of each robot at the last step.
    fn parts(&self) -> Vec<(RobotId, ExplorerState)> {
        let Some(exploration) = &self.active else { return Vec::new() };
        self.robots.iter().map(|robot| (*robot, part(exploration.availability(*robot)))).collect()
    }

    /// Publishes the state if it has changed, and once a second while the exploration goes on.
    pub(super) fn publish(&mut self, stamp: Stamp, now: Monotonic) {
        let before = (self.report.status, self.report.robots);
        let is_due = self.reported_at.is_none_or(|at| now.since(at) >= REPORT_PERIOD_NS);
        self.describe(is_due);
        self.has_changed |= before != (self.report.status, self.report.robots);
        if self.has_changed || (self.is_active() && is_due) {
            self.reported_at = Some(now);
            self.has_changed = false;
            self.report.header.stamp = stamp;
            self.state.send(&self.report);
        }
    }

    /// Delivers the newest state to late readers.
    pub(super) fn refresh(&self) {
        self.state.refresh();
    }

    /// Describes a running exploration; what costs a pass over the maps only if `is_full` is set.
    fn describe(&mut self, is_full: bool) {
        let Some(exploration) = &self.active else { return };
        let report = &mut self.report;
        for robot in &self.robots {
            report.robots[robot.index()] = part(exploration.availability(*robot)) as u8;
        }
        let is_manual = |robot: &RobotId| report.robot(robot.index()) == ExplorerState::Manual;
        let is_paused = self.robots.iter().all(is_manual);
        let status = match exploration.phase() {
            _ if is_paused => ExplorationStatus::Paused,
            CoordinationPhase::Waiting => ExplorationStatus::Waiting,
            CoordinationPhase::Exploring => ExplorationStatus::Exploring,
            CoordinationPhase::Returning | CoordinationPhase::Done => ExplorationStatus::Returning,
        };
        report.status = status as u32;
        match status {
            ExplorationStatus::Paused => report.set_reason(ALL_TAKEN),
            ExplorationStatus::Waiting => {
                let part = |robot: &RobotId| (*robot, report.robot(robot.index()));
                let parts: Vec<_> = self.robots.iter().map(part).collect();
                report.set_reason(&absent::waiting(&parts));
            }
            _ => report.set_reason(""),
        }
        let estimate = exploration.estimate().filter(|_| status == ExplorationStatus::Exploring);
        report.least_s = estimate.map_or(f64::NAN, |estimate| estimate.least_s);
        report.most_s = estimate.map_or(f64::NAN, |estimate| estimate.most_s);
        report.known_m2 = exploration.known_m2().unwrap_or(f64::NAN);
        if is_full && exploration.phase() > CoordinationPhase::Exploring {
            let left: Vec<ExplorationLeftover> = exploration.leftovers().iter().map(leftover).collect();
            report.set_leftovers(&left);
        }
    }

    /// What a restarted process goes on with.
    pub(super) fn saved(&self) -> SavedExploration {
        let of_robots = |robot: &RobotId| {
            let exploration = self.active.as_ref()?;
            let home = exploration.home(*robot).map(|home| [home.x_m, home.y_m, home.yaw_rad]);
            Some((robot.number(), exploration.is_manual(*robot), home))
        };
        // What an exploration came to is of interest until the next one.
        let report = if self.is_active() { &[][..] } else { bytemuck::bytes_of(&self.report) };
        SavedExploration {
            number: self.number(),
            is_active: self.is_active(),
            begun_ns: self.begun.map(|begun| begun.0),
            robots: self.robots.iter().filter_map(of_robots).collect(),
            report: report.to_vec(),
        }
    }

    /// Goes on with the exploration of an earlier process of this run.
    pub(super) fn restore(&mut self, saved: &SavedExploration) {
        self.begun = saved.begun_ns.map(Stamp);
        if let Ok(report) = bytemuck::try_pod_read_unaligned::<ExplorationReport>(&saved.report) {
            self.report = report;
        }
        self.report.number = saved.number;
        if !saved.is_active {
            return;
        }
        let mut exploration = FleetExploration::new(self.config);
        for (number, is_manual, home) in &saved.robots {
            let Some(robot) = RobotId::new(*number) else { continue };
            if *is_manual {
                exploration.set_manual(robot, true);
            }
            let home = home.map(|[x_m, y_m, yaw_rad]| Pose2::new(x_m, y_m, yaw_rad));
            if let Some(home) = home.filter(|home| home.is_finite()) {
                exploration.set_home(robot, home);
            }
        }
        self.active = Some(exploration);
        self.has_changed = true;
    }
}

/// The part of a robot, as reports have it.
fn part(availability: Option<RobotAvailability>) -> ExplorerState {
    match availability {
        None | Some(RobotAvailability::Lost) => ExplorerState::Lost,
        Some(RobotAvailability::Free) => ExplorerState::Exploring,
        Some(RobotAvailability::Revisiting) => ExplorerState::Revisiting,
        Some(RobotAvailability::Manual) => ExplorerState::Manual,
        Some(RobotAvailability::Silent) => ExplorerState::Silent,
        Some(RobotAvailability::Excluded) => ExplorerState::Excluded,
        Some(RobotAvailability::Enclosed) => ExplorerState::Enclosed,
    }
}

fn leftover(found: &FoundLeftover) -> ExplorationLeftover {
    let left = found.leftover;
    ExplorationLeftover {
        position_m: left.position_m,
        length_m: left.length_m,
        area_m2: left.area_m2.unwrap_or(f64::NAN),
        map_robot: found.robot.map_or(0, |robot| robot.number() as u32),
        reason: left.reason as u32,
    }
}
