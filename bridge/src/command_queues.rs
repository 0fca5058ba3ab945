//! Bounded queues of clients' commands to the rest of the fleet.

use msg::{
    CommandSource, EdgeCommand, ExplorationAction, ExplorationCommand, Monotonic, NavigationAction,
    NavigationCommand, OperatorAction, OperatorEvent, ROBOTS_MAX, RobotId, SlamRequest, VelocityCommand,
    ZONES_MAX, ZoneCommand,
};
use std::collections::VecDeque;

/// Velocities that may wait: those of one client frame are taken before the next frame is handled.
const VELOCITIES_MAX: usize = 4 * ROBOTS_MAX;
/// Edge commands that may wait; people send them one at a time.
const EDGE_COMMANDS_MAX: usize = 16;
/// SLAM requests that may wait; people send them one at a time.
const SLAM_REQUESTS_MAX: usize = 16;

/// Commands to the navigator that may wait: a stop pauses all robots at once.
const NAVIGATION_MAX: usize = 2 * ROBOTS_MAX;
/// Commands about exclusion zones that may wait: people draw them one at a time, programs all at once.
const ZONE_COMMANDS_MAX: usize = 2 * ZONES_MAX;
/// Actions of operators that may wait: those of one client frame are taken before the next frame is handled.
const OPERATOR_EVENTS_MAX: usize = 2 * ROBOTS_MAX;

/// Commands for robots, merging, SLAM and navigation that wait until the caller of the bridge takes them.
// More than 12 fields: a queue for each kind of command, and who sent what is not over.
#[derive(Debug)]
pub struct CommandQueues {
    velocities: VecDeque<(RobotId, VelocityCommand)>,
    edge_commands: VecDeque<EdgeCommand>,
    slam_requests: VecDeque<(RobotId, SlamRequest)>,
    navigation: VecDeque<(RobotId, NavigationCommand)>,
    /// Number of the newest command to the navigator: the newest time, nanoseconds, or above it.
    navigation_number: u64,
    /// The newest command about the exploration.
    exploration: Option<ExplorationCommand>,
    zones: VecDeque<ZoneCommand>,
    operator_events: VecDeque<OperatorEvent>,
    /// Who gave each robot its newest goal, or had it go on to it.
    goal_senders: [CommandSource; ROBOTS_MAX],
    /// Who started the exploration that may go on.
    exploration_sender: CommandSource,
    /// Number of that command while the navigator has not answered it.
    unanswered_exploration: Option<u64>,
    /// Who sends what is queued now.
    sender: CommandSource,
    velocities_taken: u64,
}

impl Default for CommandQueues {
    fn default() -> Self {
        Self {
            velocities: VecDeque::with_capacity(VELOCITIES_MAX),
            edge_commands: VecDeque::with_capacity(EDGE_COMMANDS_MAX),
            slam_requests: VecDeque::with_capacity(SLAM_REQUESTS_MAX),
            navigation: VecDeque::new(),
            navigation_number: 0,
            exploration: None,
            zones: VecDeque::new(),
            operator_events: VecDeque::new(),
            goal_senders: [CommandSource::default(); ROBOTS_MAX],
            exploration_sender: CommandSource::default(),
            unanswered_exploration: None,
            sender: CommandSource::BRIDGE,
            velocities_taken: 0,
        }
    }
}

impl CommandQueues {
    /// Sets who sends what is queued from now on.
    pub fn set_sender(&mut self, sender: CommandSource) {
        self.sender = sender;
    }

    /// Returns who sends what is queued now.
    pub fn sender(&self) -> CommandSource {
        self.sender
    }

    /// Queues an action of the sender, for the record; the oldest is dropped if the queue is full. The bridge is no operator:
    /// what it does by itself, as after a restart, is none.
    pub fn push_operator_event(&mut self, action: OperatorAction, robot: Option<RobotId>) {
        if self.sender == CommandSource::BRIDGE {
            return;
        }
        if self.operator_events.len() == OPERATOR_EVENTS_MAX {
            self.operator_events.pop_front();
        }
        self.operator_events.push_back(OperatorEvent::new(self.sender, action, robot));
    }

    /// Takes the oldest action of an operator.
    pub fn next_operator_event(&mut self) -> Option<OperatorEvent> {
        self.operator_events.pop_front()
    }

    /// Queues a velocity; the oldest is dropped if the queue is full.
    pub fn push_velocity(&mut self, robot: RobotId, command: VelocityCommand) {
        if self.velocities.len() == VELOCITIES_MAX {
            self.velocities.pop_front();
        }
        self.velocities.push_back((robot, VelocityCommand { sender: self.sender, ..command }));
    }

    /// Returns whether no command waits.
    pub fn is_empty(&self) -> bool {
        self.velocities.is_empty()
            && self.edge_commands.is_empty()
            && self.slam_requests.is_empty()
            && self.navigation.is_empty()
            && self.exploration.is_none()
            && self.zones.is_empty()
            && self.operator_events.is_empty()
    }

    /// Takes the oldest velocity.
    pub fn next_velocity(&mut self) -> Option<(RobotId, VelocityCommand)> {
        let next = self.velocities.pop_front()?;
        self.velocities_taken += 1;
        Some(next)
    }

    /// Returns how many velocities were taken since the start.
    pub fn velocities_taken(&self) -> u64 {
        self.velocities_taken
    }

    /// Queues a command for merging; `false` if the queue is full.
    pub fn push_edge_command(&mut self, command: EdgeCommand) -> bool {
        let has_room = self.edge_commands.len() < EDGE_COMMANDS_MAX;
        if has_room {
            self.edge_commands.push_back(EdgeCommand { sender: self.sender, ..command });
        }
        has_room
    }

    /// Takes the oldest command for merging.
    pub fn next_edge_command(&mut self) -> Option<EdgeCommand> {
        self.edge_commands.pop_front()
    }

    /// Records the time: commands to the navigator are numbered by it, so that those of other programs compare.
    pub fn record_time(&mut self, now: Monotonic) {
        self.navigation_number = self.navigation_number.max(now.0);
    }

    /// Returns the newest time that was recorded.
    pub fn newest_time(&self) -> Monotonic {
        Monotonic(self.navigation_number)
    }

    /// Returns the number of a new command to the navigator, larger than all before.
    pub fn next_navigation_number(&mut self) -> u64 {
        self.navigation_number += 1;
        self.navigation_number
    }

    /// Queues a command to the navigator; the oldest is dropped if the queue is full.
    pub fn push_navigation(&mut self, robot: RobotId, command: NavigationCommand) {
        if self.navigation.len() == NAVIGATION_MAX {
            self.navigation.pop_front();
        }
        if matches!(command.action(), Some(NavigationAction::Goal | NavigationAction::Resume)) {
            self.goal_senders[robot.index()] = self.sender;
        }
        self.navigation.push_back((robot, NavigationCommand { sender: self.sender, ..command }));
    }

    /// Sets who gave a robot its newest goal, and who started the exploration, before this bridge began.
    pub fn restore_senders(&mut self, goals: &[(RobotId, CommandSource)], exploration: CommandSource) {
        goals.iter().for_each(|(robot, sender)| self.goal_senders[robot.index()] = *sender);
        (self.exploration_sender, self.unanswered_exploration) = (exploration, Some(0));
    }

    /// Records that the navigator has answered the commands about the exploration up to this number, and whether it is over.
    pub fn confirm_exploration(&mut self, number: u64, is_over: bool) {
        if self.unanswered_exploration.is_none_or(|unanswered| unanswered <= number) {
            self.unanswered_exploration = None;
            if is_over {
                self.exploration_sender = CommandSource::default();
            }
        }
    }

    /// Returns whether the navigator may not have read yet that the exploration was started.
    pub fn is_exploration_unanswered(&self) -> bool {
        self.unanswered_exploration.is_some()
    }

    /// Returns who gave a robot its newest goal, or had it go on to it.
    pub fn goal_sender(&self, robot: RobotId) -> CommandSource {
        self.goal_senders[robot.index()]
    }

    /// Returns who started the exploration that may go on.
    pub fn exploration_sender(&self) -> CommandSource {
        self.exploration_sender
    }

    /// Takes the oldest command to the navigator.
    pub fn next_navigation(&mut self) -> Option<(RobotId, NavigationCommand)> {
        self.navigation.pop_front()
    }

    /// Sets the command about the exploration that is taken next; it replaces one that has not been taken.
    pub fn set_exploration(&mut self, command: ExplorationCommand) {
        let starts = command.action() == Some(ExplorationAction::Start);
        self.exploration_sender = if starts { self.sender } else { CommandSource::default() };
        self.unanswered_exploration = starts.then_some(command.number);
        self.exploration = Some(command);
    }

    /// Takes the newest command about the exploration.
    pub fn next_exploration(&mut self) -> Option<ExplorationCommand> {
        self.exploration.take()
    }

    /// Queues a command about the exclusion zones; `false` if the queue is full.
    pub fn push_zone(&mut self, command: ZoneCommand) -> bool {
        let has_space = self.zones.len() < ZONE_COMMANDS_MAX;
        if has_space {
            self.zones.push_back(command);
        }
        has_space
    }

    /// Takes the oldest command about the exclusion zones.
    pub fn next_zone(&mut self) -> Option<ZoneCommand> {
        self.zones.pop_front()
    }

    /// Queues a request to a robot's SLAM; the oldest is dropped if the queue is full.
    pub fn push_slam_request(&mut self, robot: RobotId, request: SlamRequest) {
        if self.slam_requests.len() == SLAM_REQUESTS_MAX {
            self.slam_requests.pop_front();
        }
        // The second request of a call is queued after an answer, in its caller's name.
        let sender = if request.sender == CommandSource::default() { self.sender } else { request.sender };
        self.slam_requests.push_back((robot, SlamRequest { sender, ..request }));
    }

    /// Takes the oldest request to SLAM.
    pub fn next_slam_request(&mut self) -> Option<(RobotId, SlamRequest)> {
        self.slam_requests.pop_front()
    }
}
