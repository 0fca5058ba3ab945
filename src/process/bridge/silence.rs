//! What is published of navigation while its process has died or hangs: what it said last would stay on the topics for ever.

use msg::{ExplorationReport, ExplorationStatus, NavigationReport, NavigationStatus};
use std::time::Duration;

/// Navigation repeats states each second while it drives. After so long without one it has died or hangs.
pub(super) const SILENT: Duration = Duration::from_secs(3);
/// What clients read then.
const REASON: &str =
    "navigation has not answered for 3 s: its process has ended or hangs, and the robots stand";

/// Returns what a robot's state is if it is not repeated; `None` for states that are not.
pub(super) fn silent_navigation(newest: &NavigationReport) -> Option<NavigationReport> {
    use NavigationStatus::{Blocked, Driving, Planning, Recovering, Waiting};
    if !matches!(newest.status(), Planning | Driving | Waiting | Blocked | Recovering) {
        return None;
    }
    let mut report =
        NavigationReport { status: Blocked as u32, remaining_m: f64::NAN, other_robot: 0, ..*newest };
    report.set_reason(REASON);
    Some(report)
}

/// Returns what the exploration's state is if it is not repeated; `None` for states that are not.
pub(super) fn silent_exploration(newest: &ExplorationReport) -> Option<ExplorationReport> {
    if !matches!(newest.status(), ExplorationStatus::Exploring | ExplorationStatus::Returning) {
        return None;
    }
    let mut report = ExplorationReport { least_s: f64::NAN, most_s: f64::NAN, ..*newest };
    report.set_reason(REASON);
    Some(report)
}
