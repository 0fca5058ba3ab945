//! What an exploration in lockstep came to.

use crate::channel;
use msg::{ExplorationReport, ExplorerState, GroundTruth, RobotId};
use reports::ExplorationSummary;
use serde::Serialize;

/// An exploration, followed by the fleet's messages.
pub(super) struct WatchedExploration {
    channel: String,
    newest: Box<ExplorationReport>,
    /// Seconds in which each robot was lost.
    lost_s: Vec<u32>,
    /// Names of the channels of the robots' true states.
    truths: Vec<String>,
    /// How often each robot touched something.
    contacts: Vec<u64>,
}

/// Result of an exploration, as JSON.
#[derive(Serialize)]
pub(super) struct ExplorationOutcome {
    #[serde(flatten)]
    answer: ExplorationSummary,
    /// Whether the exploration ended by itself, and not with the time of the run.
    is_over: bool,
    /// Time in which each robot did not know its place, seconds.
    lost_s: Vec<u32>,
    /// How often each robot touched something: a wall, another robot, or what moves in the room.
    contacts: Vec<u64>,
}

impl WatchedExploration {
    pub(super) fn new(robots: usize) -> Self {
        let channel = channel::exploration_state().name;
        let truths = RobotId::first(robots).map(|robot| channel::truth(robot).name).collect();
        Self { channel, newest: Box::default(), lost_s: vec![0; robots], truths, contacts: vec![0; robots] }
    }

    /// Keeps a message that is a state of the exploration, and the contacts of one with a robot's true state.
    pub(super) fn receive(&mut self, channel: &str, bytes: &[u8]) {
        if channel == self.channel {
            *self.newest = bytemuck::pod_read_unaligned(bytes);
        } else if let Some(index) = self.truths.iter().position(|truth| truth == channel) {
            self.contacts[index] = bytemuck::pod_read_unaligned::<GroundTruth>(bytes).contacts;
        }
    }

    /// Counts a second of the run.
    pub(super) fn end_second(&mut self) {
        if self.has_ended() {
            return;
        }
        for (index, lost_s) in self.lost_s.iter_mut().enumerate() {
            *lost_s += u32::from(self.newest.robot(index) == ExplorerState::Lost);
        }
    }

    /// Whether the exploration has ended.
    pub(super) fn has_ended(&self) -> bool {
        self.newest.status().is_final()
    }

    /// What the exploration came to until now.
    pub(super) fn outcome(self) -> ExplorationOutcome {
        let is_over = self.has_ended();
        let answer = ExplorationSummary::new(&self.newest, self.lost_s.len());
        ExplorationOutcome { answer, is_over, lost_s: self.lost_s, contacts: self.contacts }
    }
}

impl ExplorationOutcome {
    /// The result for people.
    pub(super) fn text(&self) -> String {
        let robots = RobotId::first(self.lost_s.len()).zip(&self.lost_s).filter(|(_, lost_s)| **lost_s > 0);
        let lost: String =
            robots.map(|(robot, lost_s)| format!("{robot} was lost for {lost_s} s\n")).collect();
        let touched =
            RobotId::first(self.contacts.len()).zip(&self.contacts).filter(|(_, count)| **count > 0);
        let touched: String =
            touched.map(|(robot, count)| format!("{robot} touched something {count} times\n")).collect();
        let end = if self.is_over {
            ""
        } else {
            "the run ended before the exploration was over: give more --seconds\n"
        };
        format!("exploration {}{end}{lost}{touched}", self.answer.text())
    }
}
