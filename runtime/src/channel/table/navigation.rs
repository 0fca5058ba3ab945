//! The channels of navigation and exploration.

use super::{BRIDGE, NAV, RECORD, REQUEST_WRITERS_MAX, STATE, STREAM};
use crate::channel::Endpoint::{Of, OtherMachines};
use crate::channel::Program::{ExploreTool, GotoTool, Launcher, LinkTool, RecordTool, ZoneTool};
use crate::channel::{Channel, ChannelRow, Scope, TypedRow};
use msg::{
    ExclusionZones, ExplorationCommand, ExplorationReport, NavigationCommand, NavigationPlan,
    NavigationReport, RobotHold, RobotId, VelocityCommand, ZONES_MAX, ZoneCommand,
};

/// Newest commands of each writer that wait for a reader that is started again; as many as a reader's queue takes.
const COMMANDS_KEPT: usize = 16;
/// As many for zones, which programs add all at once: as many as may wait in the bridge.
const ZONE_COMMANDS_KEPT: usize = 2 * ZONES_MAX;

// Several writers: the bridge for its clients, and commands of people.
pub(super) static GOAL: TypedRow<NavigationCommand> = TypedRow::new(ChannelRow {
    name: "goal",
    content: "a goal of the robot, or a cancellation, pause or resumption, on demand",
    writers: &[Of(BRIDGE), Of(GotoTool)],
    readers: &[Of(NAV), Of(RECORD), Of(RecordTool)],
    depth: COMMANDS_KEPT,
    history: COMMANDS_KEPT,
    writers_max: REQUEST_WRITERS_MAX,
    ..STREAM
});
pub(super) static NAVIGATION_VELOCITY: TypedRow<VelocityCommand> = TypedRow::new(ChannelRow {
    name: "navigation_velocity",
    content: "velocity towards the robot's goal, 20 Hz while it has one",
    writers: &[Of(NAV)],
    readers: &[Of(BRIDGE)],
    ..STREAM
});
pub(super) static BASE_VELOCITY: TypedRow<VelocityCommand> = TypedRow::new(ChannelRow {
    name: "base_velocity",
    content: "on a robot's machine: the base's velocity, 20 Hz while the base drives the robot",
    writers: &[OtherMachines(LinkTool)],
    readers: &[OtherMachines(BRIDGE)],
    ..STREAM
});
pub(super) static HOLD: TypedRow<RobotHold> = TypedRow::new(ChannelRow {
    name: "hold",
    content: "at the base: why a robot on another machine does not follow it, on change",
    scope: Scope::Robot,
    writers: &[OtherMachines(LinkTool)],
    readers: &[OtherMachines(NAV)],
    // Navigation looks in each step.
    wakes: false,
    ..STATE
});
pub(super) static NAVIGATION_STATE: TypedRow<NavigationReport> = TypedRow::new(ChannelRow {
    name: "navigation_state",
    content: "what navigation does with the robot and why, on change and 1 Hz while it has a goal",
    scope: Scope::Robot,
    writers: &[Of(NAV)],
    readers: &[Of(BRIDGE), Of(GotoTool), Of(Launcher), Of(RECORD), Of(RecordTool)],
    depth: 16,
    ..STATE
});
pub(super) static PLAN: TypedRow<NavigationPlan> = TypedRow::new(ChannelRow {
    name: "plan",
    content: "the robot's planned path, on change, at most 1 Hz",
    scope: Scope::Robot,
    writers: &[Of(NAV)],
    readers: &[Of(BRIDGE), Of(RECORD), Of(RecordTool)],
    ..STATE
});
pub(super) static EXPLORE: TypedRow<ExplorationCommand> = TypedRow::new(ChannelRow {
    name: "explore",
    content: "start or stop of the fleet's exploration, on demand",
    scope: Scope::Fleet,
    writers: &[Of(BRIDGE), Of(ExploreTool)],
    readers: &[Of(NAV)],
    depth: COMMANDS_KEPT,
    history: COMMANDS_KEPT,
    writers_max: REQUEST_WRITERS_MAX,
    ..STREAM
});
pub(super) static EXPLORATION_STATE: TypedRow<ExplorationReport> = TypedRow::new(ChannelRow {
    name: "exploration_state",
    content: "how far the exploration is and what is left, on change and 1 Hz while it goes on",
    writers: &[Of(NAV)],
    readers: &[Of(BRIDGE), Of(ExploreTool), Of(Launcher), Of(RECORD), Of(RecordTool)],
    depth: 16,
    ..STATE
});
pub(super) static ZONE_COMMAND: TypedRow<ZoneCommand> = TypedRow::new(ChannelRow {
    name: "zone_command",
    content: "an exclusion zone to add or to remove, on demand",
    scope: Scope::Fleet,
    writers: &[Of(BRIDGE), Of(ZoneTool)],
    readers: &[Of(NAV)],
    depth: ZONE_COMMANDS_KEPT,
    history: ZONE_COMMANDS_KEPT,
    writers_max: REQUEST_WRITERS_MAX,
    ..STREAM
});
pub(super) static EXCLUSION_ZONES: TypedRow<ExclusionZones> = TypedRow::new(ChannelRow {
    name: "exclusion_zones",
    content: "all exclusion zones, on change",
    writers: &[Of(NAV)],
    readers: &[Of(BRIDGE), Of(ZoneTool), Of(RECORD), Of(RecordTool)],
    depth: 4,
    ..STATE
});

/// `robotK/goal`: goals and other commands of people and programs to the navigator.
pub fn goal(robot: RobotId) -> Channel<NavigationCommand> {
    GOAL.of_robot(robot)
}

/// `robotK/navigation_velocity`: the navigator's velocities, which pass the bridge's gate as all others.
pub fn navigation_velocity(robot: RobotId) -> Channel<VelocityCommand> {
    NAVIGATION_VELOCITY.of_robot(robot)
}

/// `robotK/base_velocity`: on a robot's machine the velocities of the base, which pass the bridge's gate as all others.
pub fn base_velocity(robot: RobotId) -> Channel<VelocityCommand> {
    BASE_VELOCITY.of_robot(robot)
}

/// `robotK/hold`: at the base, why a robot on another machine does not follow it.
pub fn hold(robot: RobotId) -> Channel<RobotHold> {
    HOLD.of_robot(robot)
}

/// `robotK/navigation_state`: what the navigator does with the robot, and why it stands.
pub fn navigation_state(robot: RobotId) -> Channel<NavigationReport> {
    NAVIGATION_STATE.of_robot(robot)
}

/// `robotK/plan`: the robot's planned path.
pub fn plan(robot: RobotId) -> Channel<NavigationPlan> {
    PLAN.of_robot(robot)
}

/// `explore`: start and stop of the fleet's exploration.
pub fn explore() -> Channel<ExplorationCommand> {
    EXPLORE.of_fleet()
}

/// `exploration_state`: how far the fleet's exploration is, and what is left.
pub fn exploration_state() -> Channel<ExplorationReport> {
    EXPLORATION_STATE.of_fleet()
}

/// `zone_command`: exclusion zones to add or to remove.
pub fn zone_command() -> Channel<ZoneCommand> {
    ZONE_COMMAND.of_fleet()
}

/// `exclusion_zones`: all exclusion zones, as navigation keeps to them.
pub fn exclusion_zones() -> Channel<ExclusionZones> {
    EXCLUSION_ZONES.of_fleet()
}
