//! Bounds of what action servers keep, and which goals a cancellation means.

use super::*;
use ros_messages::actions::{CancelCode, GoalInfo, GoalStatus, NO_GOAL};

fn server() -> ActionServer {
    ActionServer::new(&RobotNames::from(1), RobotId::new(1).unwrap(), ActionKind::NavigateToPose)
}

fn info(number: u8) -> GoalInfo {
    GoalInfo { id: [number; 16], stamp: Stamp(i64::from(number)) }
}

fn goal(number: u8, now: Monotonic) -> ActionGoal {
    ActionGoal::new(info(number), number.into(), Vec::new(), 0, now)
}

const NOW: Monotonic = Monotonic(1_000_000_000);

#[test]
fn a_cancellation_means_what_action_msgs_says() {
    let anything = GoalInfo { id: NO_GOAL, stamp: Stamp(0) };
    let mut server = server();
    assert_eq!(server.begin_cancel(&anything, NOW), (CancelCode::Accepted, vec![]), "nothing to cancel");
    server.add(goal(1, NOW));
    server.replace(2, NOW);
    server.add(goal(2, NOW));
    let without_stamp = |number| GoalInfo { stamp: Stamp(0), ..info(number) };
    assert_eq!(server.begin_cancel(&without_stamp(9), NOW), (CancelCode::UnknownGoal, vec![]));
    assert_eq!(server.begin_cancel(&without_stamp(1), NOW), (CancelCode::GoalTerminated, vec![]));
    let until = |stamp| GoalInfo { id: NO_GOAL, stamp: Stamp(stamp) };
    assert_eq!(server.begin_cancel(&until(1), NOW), (CancelCode::Accepted, vec![]), "it is newer");
    assert_eq!(server.active().unwrap().status(), GoalStatus::Accepted);
    for wanted in [until(2), anything, without_stamp(2)] {
        assert_eq!(server.begin_cancel(&wanted, NOW), (CancelCode::Accepted, vec![info(2)]));
        assert_eq!(server.active().unwrap().status(), GoalStatus::Canceling);
    }
}

#[test]
fn goals_and_waiting_requests_are_bounded_and_results_are_forgotten() {
    let mut server = server();
    for number in 1..=100 {
        server.replace(u64::from(number), NOW);
        server.add(goal(number, NOW));
    }
    assert_eq!(server.goals().len(), 16);
    assert!(server.find_mut(&[84; 16]).is_none() && server.find_mut(&[85; 16]).is_some());
    let active = server.active_mut().unwrap();
    for number in 0..100 {
        active.wait(RosRequestId { requester: [1; 16], number, is_in_payload: false });
    }
    let numbers: Vec<i64> = active.take_waiting().map(|request| request.number).collect();
    assert_eq!((numbers.len(), numbers[15]), (16, 99), "the newest");
    server.take_status_due();
    server.forget_results(NOW + Duration::from_secs(59));
    assert_eq!((server.goals().len(), server.take_status_due()), (16, false));
    server.forget_results(NOW + Duration::from_secs(60));
    assert_eq!((server.goals().len(), server.take_status_due()), (1, true), "the present one");
}

#[test]
fn a_navigator_that_does_not_answer_ends_the_goal_also_in_a_pause() {
    let report = |status: NavigationStatus| NavigationReport {
        number: 1,
        status: status as u32,
        remaining_m: 2.0,
        ..NavigationReport::default()
    };
    let later = |seconds| NOW + Duration::from_secs(seconds);
    let mut unconfirmed = goal(1, NOW);
    assert!(!unconfirmed.end_if_silent(later(4)) && unconfirmed.end_if_silent(later(5)));
    assert_eq!(unconfirmed.status(), GoalStatus::Aborted);
    let mut driving = goal(1, NOW);
    driving.apply_report(&report(NavigationStatus::Driving), later(1));
    assert_eq!(driving.status(), GoalStatus::Executing);
    assert!(!driving.end_if_silent(later(30)));
    for second in 30..3000 {
        driving.apply_report(&report(NavigationStatus::Paused), later(second));
        assert!(!driving.end_if_silent(later(second + 1)), "a person may take the time");
    }
    let mut gone = goal(1, NOW);
    gone.apply_report(&report(NavigationStatus::Paused), later(2999));
    assert!(!gone.end_if_silent(later(3028)) && gone.end_if_silent(later(3029)));
    assert_eq!(gone.status(), GoalStatus::Aborted);
    driving.begin_cancel(later(3000));
    assert!(driving.end_if_silent(later(3005)));
    driving.apply_report(&report(NavigationStatus::Reached), later(3006));
    assert_eq!(driving.status(), GoalStatus::Aborted, "what has ended stays so");
}

#[test]
fn time_to_the_goal_is_estimated_from_progress_alone() {
    let mut goal = goal(1, NOW);
    let mut report = |remaining_m, status: NavigationStatus, seconds| {
        let report = NavigationReport { number: 1, remaining_m, status: status as u32, ..Default::default() };
        goal.apply_report(&report, NOW + Duration::from_secs(seconds));
        goal.time_remaining(NOW + Duration::from_secs(seconds))
    };
    assert_eq!(report(f64::NAN, NavigationStatus::Planning, 0), Duration::ZERO);
    assert_eq!(report(4.0, NavigationStatus::Driving, 1), Duration::ZERO);
    assert_eq!(report(3.0, NavigationStatus::Recovering, 5), Duration::from_secs(15));
    assert_eq!(report(3.0, NavigationStatus::Recovering, 5), Duration::from_secs(15));
    assert_eq!(goal.recoveries(), 1, "counted once");
}
