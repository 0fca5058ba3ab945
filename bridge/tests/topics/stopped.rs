//! Robots of the navigator under the emergency stop, and after the permission of who sent them was withdrawn.

use crate::local::LocalClient;
use bridge::ros::{Bool, Int32, PoseStamped, Twist};
use bridge::{Bridge, BridgeConfig, FleetMessage};
use msg::{
    ExplorationReport, ExplorationStatus, ExplorerState, Monotonic, NavigationAction, NavigationReport,
    NavigationStatus, RobotId,
};
use std::cell::RefCell;
use std::rc::Rc;

type Commands = Rc<RefCell<Vec<(RobotId, Option<NavigationAction>)>>>;

/// A bridge of two robots, and the commands that it gives to the navigator.
fn bridge() -> (Bridge, Commands) {
    let (bridge, commands) =
        (Bridge::new(BridgeConfig::default(), 2, |_, _| {}).unwrap(), Commands::default());
    let sent = commands.clone();
    bridge.on_navigation(move |robot, command| sent.borrow_mut().push((robot, command.action())));
    (bridge, commands)
}

fn robot(number: usize) -> RobotId {
    RobotId::new(number).unwrap()
}

fn report(status: NavigationStatus) -> NavigationReport {
    NavigationReport { status: status as u32, ..NavigationReport::default() }
}

/// A goal that a command line gives to the navigator during the stop is seen by its report alone.
#[test]
fn a_robot_that_gets_something_to_do_during_the_stop_is_paused() {
    let (bridge, commands) = bridge();
    bridge.restore_stop();
    let pauses = [robot(1), robot(2)].map(|robot| (robot, Some(NavigationAction::Pause)));
    assert_eq!(commands.take(), pauses, "whoever else may have sent them");
    bridge.restore_stop();
    assert!(commands.borrow().is_empty(), "the stop is set already");
    let blocked = report(NavigationStatus::Blocked);
    bridge.publish(FleetMessage::NavigationState(robot(1), &blocked));
    assert_eq!(commands.take(), [(robot(1), Some(NavigationAction::Pause))]);
    bridge.publish(FleetMessage::NavigationState(robot(1), &report(NavigationStatus::Paused)));
    assert!(commands.borrow().is_empty(), "it is paused");
    let mut exploration = ExplorationReport::default();
    let driven = [ExplorerState::Exploring, ExplorerState::Revisiting];
    // As soon as they can reach a goal, these drive.
    for state in driven.into_iter().chain([ExplorerState::Excluded, ExplorerState::Enclosed]) {
        exploration.robots[1] = state as u8;
        bridge.publish(FleetMessage::ExplorationState(&exploration));
        assert_eq!(commands.take(), [(robot(2), Some(NavigationAction::Pause))]);
    }
    exploration.status = ExplorationStatus::Completed as u32;
    bridge.publish(FleetMessage::ExplorationState(&exploration));
    assert!(commands.borrow().is_empty(), "an exploration that is over drives nobody");
    bridge.release_stop();
    assert!(commands.borrow().is_empty(), "the release sets nobody off");
}

#[test]
fn goals_of_a_client_that_is_denied_are_paused() {
    let (bridge, commands) = bridge();
    let client = LocalClient::connect(&bridge);
    client.publish::<PoseStamped>("/robot1/goal_pose");
    let goal =
        PoseStamped { frame_id: "map".into(), orientation: [0.0, 0.0, 0.0, 1.0], ..Default::default() };
    client.send("/robot1/goal_pose", &goal, Monotonic(1));
    assert_eq!(commands.take(), [(robot(1), Some(NavigationAction::Goal))]);
    for number in [1, 2] {
        bridge.publish(FleetMessage::NavigationState(robot(number), &report(NavigationStatus::Driving)));
    }
    bridge.deny([127, 0, 0, 1].into()).unwrap();
    assert_eq!(commands.take(), [(robot(1), Some(NavigationAction::Pause))], "robot 2 has another's goal");
}

#[test]
fn an_exploration_of_a_client_that_is_denied_is_paused_until_it_is_over() {
    let denied = [127, 0, 0, 1];
    let all = [robot(1), robot(2)].map(|robot| (robot, Some(NavigationAction::Pause)));
    let begin = || {
        let (bridge, commands) = bridge();
        let client = LocalClient::connect(&bridge);
        client.publish::<Bool>("/explore/resume");
        client.send("/explore/resume", &Bool(true), Monotonic(1));
        (bridge, commands)
    };
    // Navigation has not read it.
    let (bridge, commands) = begin();
    bridge.deny(denied.into()).unwrap();
    assert_eq!(commands.take(), all);
    // It is over, and the second robot drives to a goal of somebody else.
    let (bridge, commands) = begin();
    let over = ExplorationReport {
        number: u64::MAX,
        status: ExplorationStatus::Completed as u32,
        ..ExplorationReport::default()
    };
    bridge.publish(FleetMessage::ExplorationState(&over));
    bridge.publish(FleetMessage::NavigationState(robot(2), &report(NavigationStatus::Driving)));
    bridge.deny(denied.into()).unwrap();
    assert!(commands.borrow().is_empty(), "the goal is another's: {commands:?}");
}

/// Navigation hangs, or is starting again: it has not said that it drives, and reads all that waits later.
#[test]
fn what_navigation_has_not_read_yet_is_paused_by_a_stop_and_by_a_person() {
    let goal =
        || PoseStamped { frame_id: "map".into(), orientation: [0.0, 0.0, 0.0, 1.0], ..Default::default() };
    let (taken, driven, stopped) = ("/take_control", "/robot1/cmd_vel", "/emergency_stop");
    for by in [taken, driven, stopped] {
        for explores in [false, true] {
            let (bridge, commands) = bridge();
            let client = LocalClient::connect(&bridge);
            client.publish::<PoseStamped>("/robot1/goal_pose");
            client.publish::<Bool>("/explore/resume");
            client.publish::<Int32>(taken);
            client.publish::<Twist>(driven);
            client.publish::<Bool>(stopped);
            if explores {
                client.send("/explore/resume", &Bool(true), Monotonic(1));
            } else {
                client.send("/robot1/goal_pose", &goal(), Monotonic(1));
            }
            bridge.publish(FleetMessage::NavigationState(robot(1), &report(NavigationStatus::Idle)));
            commands.take();
            match by {
                _ if by == taken => client.send(taken, &Int32(1), Monotonic(2)),
                _ if by == driven => client.send(driven, &moving(), Monotonic(2)),
                _ => client.send(stopped, &Bool(true), Monotonic(2)),
            }
            let paused = commands.take();
            assert!(
                paused.contains(&(robot(1), Some(NavigationAction::Pause))),
                "{by}, {explores}: {paused:?}"
            );
            if by == driven {
                client.send(driven, &moving(), Monotonic(3));
                assert!(commands.borrow().is_empty(), "once is enough");
            }
        }
    }
}

fn moving() -> Twist {
    Twist { linear: [0.1, 0.0, 0.0], angular: [0.0; 3] }
}
