//! One goal of an action: its state, and who waits for its result.

use super::{CONFIRMATION_MAX, SILENCE_MAX, reports_regularly};
use crate::relay::RosRequestId;
use msg::{Monotonic, NavigationReport, NavigationStatus};
use ros_messages::PoseStamped;
use ros_messages::actions::{GoalInfo, GoalStatus};
use std::time::Duration;

/// Requests for the result of one goal that wait for its end; of more the oldest gets no answer.
const WAITING_MAX: usize = 16;
/// Way that a robot must have come until the rest of its time is estimated, metres: less says little of its speed.
const PROGRESS_MIN_M: f64 = 0.2;

/// Why a goal is over.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum GoalEnd {
    /// The robot has arrived.
    Reached,
    /// A client of the action has cancelled it.
    Cancelled,
    /// It was cancelled by other means than the action.
    CancelledElsewhere,
    /// Another goal has taken its place.
    Replaced,
    /// The navigator has given up, for this reason.
    Failed(String),
    /// The navigator does not answer.
    Silent,
    /// A ROS 2 node offers the action now.
    Withdrawn,
}

impl GoalEnd {
    /// Returns the status of a goal that ends so.
    fn status(&self) -> GoalStatus {
        match self {
            Self::Reached => GoalStatus::Succeeded,
            Self::Cancelled => GoalStatus::Canceled,
            _ => GoalStatus::Aborted,
        }
    }

    /// Returns the reason, for a person; empty if there is nothing to say.
    pub fn message(&self) -> &str {
        match self {
            Self::Reached | Self::Cancelled => "",
            Self::CancelledElsewhere => "the goal was cancelled, but not by this action's cancel_goal",
            Self::Replaced => "another goal has taken its place",
            Self::Failed(reason) => reason,
            Self::Silent => "the navigation process does not answer",
            Self::Withdrawn => "another ROS 2 node offers this action now",
        }
    }
}

/// How far the robot has come.
#[derive(Clone, Copy, Debug, Default)]
struct Progress {
    /// Way that was left at the first report with one, metres.
    first_m: Option<f64>,
    /// Way that is left, metres; `None` while it is not known.
    remaining_m: Option<f64>,
    next_pose: u32,
    recoveries: u16,
}

/// One goal of an action.
#[derive(Debug)]
pub struct ActionGoal {
    /// Identifier and time of acceptance.
    pub info: GoalInfo,
    /// Index in the client's goal of the first pose that is driven to.
    pub first_index: u32,
    /// The poses that are driven to.
    pub poses: Vec<PoseStamped>,
    /// Number of the navigator's command.
    number: u64,
    status: GoalStatus,
    accepted: Monotonic,
    /// Status and time of the navigator's newest report; `None` until the first.
    reported: Option<(NavigationStatus, Monotonic)>,
    progress: Progress,
    /// When a client asked to cancel it.
    canceling: Option<Monotonic>,
    end: Option<(GoalEnd, Monotonic)>,
    waiting: Vec<RosRequestId>,
}

impl ActionGoal {
    /// Creates a goal that is accepted now. `number`: of the navigator's command.
    pub fn new(
        info: GoalInfo,
        number: u64,
        poses: Vec<PoseStamped>,
        first_index: u32,
        now: Monotonic,
    ) -> Self {
        Self {
            info,
            first_index,
            poses,
            number,
            status: GoalStatus::Accepted,
            accepted: now,
            reported: None,
            progress: Progress::default(),
            canceling: None,
            end: None,
            waiting: Vec::new(),
        }
    }

    /// Returns the number of the navigator's command.
    pub fn number(&self) -> u64 {
        self.number
    }

    /// Returns what has become of the goal.
    pub fn status(&self) -> GoalStatus {
        self.status
    }

    /// Returns why the goal is over.
    pub fn end_reason(&self) -> Option<&GoalEnd> {
        self.end.as_ref().map(|(end, _)| end)
    }

    /// Returns whether the goal has been over for this time.
    pub fn has_ended_before(&self, now: Monotonic, age: Duration) -> bool {
        self.end.as_ref().is_some_and(|(_, at)| now >= *at + age)
    }

    /// Ends the goal, unless it is over.
    pub fn end(&mut self, end: GoalEnd, now: Monotonic) {
        if self.end.is_none() {
            self.status = end.status();
            self.end = Some((end, now));
        }
    }

    /// Records that a client wants to cancel the goal.
    pub fn begin_cancel(&mut self, now: Monotonic) {
        self.status = GoalStatus::Canceling;
        self.canceling.get_or_insert(now);
    }

    /// Applies a report of the navigator about this goal.
    pub fn apply_report(&mut self, report: &NavigationReport, now: Monotonic) {
        let status = report.status();
        let before = self.reported.replace((status, now)).map(|(status, _)| status);
        if status == NavigationStatus::Recovering && before != Some(status) {
            self.progress.recoveries = self.progress.recoveries.saturating_add(1);
        }
        self.progress.remaining_m = Some(report.remaining_m).filter(|m| m.is_finite());
        self.progress.first_m = self.progress.first_m.or(self.progress.remaining_m);
        if !status.is_final() {
            self.progress.next_pose = report.next_pose;
        }
        match status {
            NavigationStatus::Reached => self.end(GoalEnd::Reached, now),
            NavigationStatus::Cancelled if self.canceling.is_some() => self.end(GoalEnd::Cancelled, now),
            NavigationStatus::Cancelled => self.end(GoalEnd::CancelledElsewhere, now),
            NavigationStatus::Failed => self.end(GoalEnd::Failed(report.reason().to_owned()), now),
            _ if self.status == GoalStatus::Accepted => self.status = GoalStatus::Executing,
            _ => {}
        }
    }

    /// Ends the goal if the navigator has not answered for too long; returns whether it did.
    pub fn end_if_silent(&mut self, now: Monotonic) -> bool {
        let is_unconfirmed = self.reported.is_none() && now >= self.accepted + CONFIRMATION_MAX;
        let is_uncancelled = self.canceling.is_some_and(|since| now >= since + CONFIRMATION_MAX);
        let is_silent =
            self.reported.is_some_and(|(status, at)| reports_regularly(status) && now >= at + SILENCE_MAX);
        let ends = is_unconfirmed || is_uncancelled || is_silent;
        if ends {
            self.end(GoalEnd::Silent, now);
        }
        ends
    }

    /// Lets a request wait for the result.
    pub fn wait(&mut self, request: RosRequestId) {
        if self.waiting.len() >= WAITING_MAX {
            self.waiting.remove(0);
        }
        self.waiting.push(request);
    }

    /// Takes the requests that wait for the result.
    pub fn take_waiting(&mut self) -> std::vec::IntoIter<RosRequestId> {
        std::mem::take(&mut self.waiting).into_iter()
    }

    /// Returns the time since the goal was accepted.
    pub fn age(&self, now: Monotonic) -> Duration {
        Duration::from_nanos(now.since(self.accepted))
    }

    /// Returns the way that is left, metres; `None` while it is not known.
    pub fn remaining_m(&self) -> Option<f64> {
        self.progress.remaining_m
    }

    /// Returns how often the robot has backed up or turned to get free.
    pub fn recoveries(&self) -> u16 {
        self.progress.recoveries
    }

    /// Returns the index in the client's goal of the pose that is driven to.
    pub fn current_index(&self) -> u32 {
        self.first_index.saturating_add(self.progress.next_pose)
    }

    /// Returns the pose that is driven to.
    pub fn current_pose(&self) -> Option<&PoseStamped> {
        self.poses.get(self.progress.next_pose as usize)
    }

    /// Estimates the time to the goal by the robot's mean speed towards it; zero while that is not known.
    pub fn time_remaining(&self, now: Monotonic) -> Duration {
        let Progress { first_m: Some(first_m), remaining_m: Some(remaining_m), .. } = self.progress else {
            return Duration::ZERO;
        };
        let progress_m = first_m - remaining_m;
        if progress_m < PROGRESS_MIN_M {
            return Duration::ZERO;
        }
        let seconds = self.age(now).as_secs_f64() * remaining_m / progress_m;
        Duration::try_from_secs_f64(seconds).unwrap_or(Duration::ZERO)
    }
}
