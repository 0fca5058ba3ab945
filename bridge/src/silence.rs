//! What is published of navigation while its process has died or hangs: what it said last would stay on the topics for ever.

use msg::{ExplorationReport, ExplorationStatus, NavigationReport, NavigationStatus};
use std::time::Duration;

/// Navigation repeats states each second while it drives. After so long without one it has died or hangs.
pub const SILENT: Duration = Duration::from_secs(3);
/// What clients read then.
const REASON: &str =
    "navigation has not answered for 3 s: its process has ended or hangs, and the robots stand";

/// Returns the state to publish in place of one that navigation has not repeated; `None` for states that it does not repeat.
pub fn report_of_silent_navigation(newest: &NavigationReport) -> Option<NavigationReport> {
    use NavigationStatus::{Blocked, Driving, Planning, Recovering, Waiting};
    if !matches!(newest.status(), Planning | Driving | Waiting | Blocked | Recovering) {
        return None;
    }
    let mut report =
        NavigationReport { status: Blocked as u32, remaining_m: f64::NAN, other_robot: 0, ..*newest };
    report.set_reason(REASON);
    Some(report)
}

/// Returns the state of the exploration to publish in place of one that navigation has not repeated; `None` for states that it does
/// not repeat.
pub fn report_of_silent_exploration(newest: &ExplorationReport) -> Option<ExplorationReport> {
    if !matches!(
        newest.status(),
        ExplorationStatus::Exploring | ExplorationStatus::Returning | ExplorationStatus::Waiting
    ) {
        return None;
    }
    let mut report = ExplorationReport { least_s: f64::NAN, most_s: f64::NAN, ..*newest };
    report.set_reason(REASON);
    Some(report)
}
