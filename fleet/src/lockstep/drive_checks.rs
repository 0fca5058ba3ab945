//! Invariants of the velocities that the bridge sends to one robot: limits, lease, permission, emergency stop.

use super::drivers::{CONTENDER_VELOCITY, INTRUDER_VELOCITY};
use crate::config::FleetConfig;
use bridge::velocity_gate::RobotLimits;
use msg::{Monotonic, RobotId, VelocityCommand};
use std::time::Duration;

/// Client whose velocity a command is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Source {
    Operator,
    Contender,
    Intruder,
}

impl Source {
    /// Returns the source as messages name it.
    fn name(self) -> &'static str {
        match self {
            Self::Operator => "the operator",
            Self::Contender => "the second operator",
            Self::Intruder => "a client without permission",
        }
    }

    /// Returns the source of a moving command.
    fn of(command: &VelocityCommand) -> Self {
        let velocity = [command.linear_m_s, command.angular_rad_s];
        match velocity {
            _ if velocity == CONTENDER_VELOCITY => Self::Contender,
            _ if velocity == INTRUDER_VELOCITY => Self::Intruder,
            _ => Self::Operator,
        }
    }
}

/// Longest time after the end of the dead man's timeout until the gate sends the zero.
pub const GATE_PERIOD: Duration = Duration::from_millis(50);
/// Longest time from a moving command to the zero that follows it, when nobody drives: the gate's 0.3 s and its period.
const ZERO_MAX: Duration = Duration::from_millis(300).saturating_add(GATE_PERIOD);

/// Longest time until the bridge hears that a client left: the longest faults in a row that keep it from that.
const LEAVE_HEARD_MAX: Duration = Duration::from_secs(6);

/// Checks the commands of one robot.
pub struct DriveChecks {
    robot: RobotId,
    limits: RobotLimits,
    lease: Duration,
    /// The client that moved the robot last, and when its command was sent.
    driver: Option<(Source, Monotonic)>,
    /// When a client or the bridge left last.
    left: Option<Monotonic>,
    /// Whether the last command was a moving one, which a zero must follow.
    moving: bool,
    /// Whether the emergency stop is set.
    stopped: bool,
    /// Whether the emergency stop is lost with the bridge, because the disk was full.
    unsaved: bool,
}

impl DriveChecks {
    /// Creates the checks of a robot that was not commanded yet.
    pub fn new(config: &FleetConfig, robot: RobotId) -> Self {
        let velocity = config.bridge_config().velocity;
        let (limits, lease) = (RobotLimits::new(&velocity, robot), config.bridge.lease());
        Self { robot, limits, lease, driver: None, left: None, moving: false, stopped: false, unsaved: false }
    }

    /// Returns when the robot was last told to move.
    pub fn driven(&self) -> Option<Monotonic> {
        self.driver.map(|(_, sent)| sent)
    }

    /// Checks that a zero has followed the last moving command in time. A bridge that is disturbed may miss one.
    pub fn check_zero(&mut self, now: Monotonic, is_bridge_disturbed: bool) -> Option<String> {
        self.moving &= !is_bridge_disturbed;
        let sent = self.driven().filter(|sent| self.moving && now > *sent + ZERO_MAX)?;
        self.moving = false;
        Some(format!(
            "{} is sent no zero until {:.3} s after a command at {:.3} s",
            self.robot,
            now.seconds(),
            sent.seconds()
        ))
    }

    /// Receives an event of the injection of faults.
    pub fn on_event(&mut self, event: &str, at: Monotonic) {
        if matches!(event, "bridge_died" | "operator_left" | "contender_left") {
            self.left = Some(at);
        }
        match event {
            "stop_set" => (self.stopped, self.unsaved) = (true, false),
            "stop_set_unsaved" => (self.stopped, self.unsaved) = (true, true),
            "stop_released" => self.stopped = false,
            "bridge_died" => self.stopped &= !self.unsaved,
            _ => {}
        }
    }

    /// Receives a command.
    pub fn command(&mut self, command: &VelocityCommand) -> Option<String> {
        let VelocityCommand { linear_m_s, angular_rad_s, .. } = *command;
        let (robot, sent, sent_s) = (self.robot, command.header.sent, command.header.sent.seconds());
        let RobotLimits { linear_m_s: linear_max, angular_rad_s: angular_max } = self.limits;
        if !(linear_m_s.abs() <= linear_max && angular_rad_s.abs() <= angular_max) {
            return Some(format!("{robot} is sent {linear_m_s} m/s, {angular_rad_s} rad/s at {sent_s:.3} s"));
        }
        self.moving = linear_m_s != 0.0 || angular_rad_s != 0.0;
        if !self.moving {
            return None;
        }
        let source = Source::of(command);
        let before = self.driver.replace((source, sent));
        if source == Source::Intruder {
            return Some(format!("{robot} is driven by a client without permission at {sent_s:.3} s"));
        }
        if self.stopped {
            return Some(format!("{robot} is driven at {sent_s:.3} s although the emergency stop is set"));
        }
        let (holder, held) = before.filter(|(holder, _)| *holder != source)?;
        // The lease of a client that left ends with it. The bridge hears of it late if it was stopped or cut off.
        if self.left.is_some_and(|left| sent < left + LEAVE_HEARD_MAX) {
            return None;
        }
        (sent < held + self.lease).then(|| {
            format!(
                "{robot}: {} drives at {sent_s:.3} s, within the lease of {}",
                source.name(),
                holder.name()
            )
        })
    }
}
