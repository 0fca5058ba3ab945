//! Queue of commands to the scan path: in order, and without waiting for it.

use super::FrontCommand;
use std::collections::VecDeque;
use std::sync::mpsc::{SyncSender, TrySendError};

/// Commands that wait here while the queue to the scan path is full; requests that need more are refused.
const WAITING_MAX: usize = 16;

/// The sending end of the queue to the scan path.
pub struct CommandSender {
    queue: SyncSender<FrontCommand>,
    waiting: VecDeque<FrontCommand>,
}

impl CommandSender {
    /// Creates a sender in which no command waits.
    pub fn new(queue: SyncSender<FrontCommand>) -> Self {
        Self { queue, waiting: VecDeque::new() }
    }

    /// Sends a command after all that wait, now or when there is room.
    pub fn send(&mut self, command: FrontCommand) {
        self.waiting.push_back(command);
        self.flush();
    }

    /// Sends a command that the next of its kind would replace: it is dropped if there is no room.
    pub fn send_or_drop(&mut self, command: FrontCommand) {
        self.flush();
        if self.waiting.is_empty() {
            let _ = self.queue.try_send(command);
        }
    }

    /// Sends the waiting commands, as far as there is room.
    pub fn flush(&mut self) {
        while let Some(command) = self.waiting.pop_front() {
            if let Err(TrySendError::Full(command)) = self.queue.try_send(command) {
                self.waiting.push_front(command);
                return;
            }
        }
    }

    /// Returns whether so many commands wait that requests must be refused.
    pub fn is_full(&self) -> bool {
        self.waiting.len() >= WAITING_MAX
    }

    /// Returns the number of commands that wait for room in the queue.
    pub fn waiting(&self) -> usize {
        self.waiting.len()
    }
}
