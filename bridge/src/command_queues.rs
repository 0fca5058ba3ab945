//! Bounded queues of clients' commands to the rest of the fleet.

use msg::{EdgeCommand, ROBOTS_MAX, RobotId, SlamRequest, VelocityCommand};
use std::collections::VecDeque;

/// Velocities that may wait: those of one client frame are taken before the next frame is handled.
const VELOCITIES_MAX: usize = 4 * ROBOTS_MAX;
/// Edge commands that may wait; people send them one at a time.
const EDGE_COMMANDS_MAX: usize = 16;
/// SLAM requests that may wait; people send them one at a time.
const SLAM_REQUESTS_MAX: usize = 16;

/// Commands for robots, merging and SLAM that wait until the caller of the bridge takes them.
#[derive(Debug)]
pub struct CommandQueues {
    velocities: VecDeque<(RobotId, VelocityCommand)>,
    edge_commands: VecDeque<EdgeCommand>,
    slam_requests: VecDeque<(RobotId, SlamRequest)>,
    velocities_taken: u64,
}

impl Default for CommandQueues {
    fn default() -> Self {
        Self {
            velocities: VecDeque::with_capacity(VELOCITIES_MAX),
            edge_commands: VecDeque::with_capacity(EDGE_COMMANDS_MAX),
            slam_requests: VecDeque::with_capacity(SLAM_REQUESTS_MAX),
            velocities_taken: 0,
        }
    }
}

impl CommandQueues {
    /// Queues a velocity; the oldest is dropped if the queue is full.
    pub fn push_velocity(&mut self, robot: RobotId, command: VelocityCommand) {
        if self.velocities.len() == VELOCITIES_MAX {
            self.velocities.pop_front();
        }
        self.velocities.push_back((robot, command));
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
            self.edge_commands.push_back(command);
        }
        has_room
    }

    /// Takes the oldest command for merging.
    pub fn next_edge_command(&mut self) -> Option<EdgeCommand> {
        self.edge_commands.pop_front()
    }

    /// Queues a request to a robot's SLAM; the oldest is dropped if the queue is full.
    pub fn push_slam_request(&mut self, robot: RobotId, request: SlamRequest) {
        if self.slam_requests.len() == SLAM_REQUESTS_MAX {
            self.slam_requests.pop_front();
        }
        self.slam_requests.push_back((robot, request));
    }

    /// Takes the oldest request to SLAM.
    pub fn next_slam_request(&mut self) -> Option<(RobotId, SlamRequest)> {
        self.slam_requests.pop_front()
    }
}
