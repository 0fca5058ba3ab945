//! Tests of the leases, the former drivers and the counted interruptions.

use super::*;

fn client(serial: u64) -> DriveClient {
    let client = ClientId { slot: serial as usize, serial };
    DriveClient { client: Some(client), address: Some([10, 0, 0, serial as u8].into()) }
}

fn at_ms(ms: u64) -> Monotonic {
    Monotonic(ms * 1_000_000)
}

#[test]
fn one_client_drives_a_robot_until_its_lease_ends() {
    let (one, two) = (client(1), client(2));
    let robot = RobotId::new(1).unwrap();
    let mut drive = DriveArbiter::new(2, robot, Duration::from_secs(1));
    assert_eq!(
        drive.decide(two, robot, false, at_ms(0)),
        DriveDecision::Pass,
        "anybody may send zero to a robot that nobody drives"
    );
    assert_eq!(drive.decide(one, robot, true, at_ms(0)), DriveDecision::Pass);
    assert_eq!(drive.decide(two, robot, true, at_ms(900)), DriveDecision::DrivenBy(one));
    assert_eq!(drive.decide(two, robot, false, at_ms(900)), DriveDecision::Ignore);
    assert_eq!(drive.decide(one, robot, false, at_ms(950)), DriveDecision::Pass);
    assert_eq!(
        drive.decide(two, robot, true, at_ms(1001)),
        DriveDecision::Pass,
        "a zero velocity renews no lease"
    );
    assert_eq!(drive.take_control(one, robot, at_ms(1100)), Some(two));
    assert_eq!(drive.decide(two, robot, true, at_ms(1200)), DriveDecision::DrivenBy(one));
    assert_eq!(drive.decide(one, robot, true, at_ms(1300)), DriveDecision::Pass);
    assert_eq!(drive.release_client(one.client.unwrap()), [robot]);
    assert_eq!(
        drive.decide(two, robot, true, at_ms(1400)),
        DriveDecision::Pass,
        "the lease ends with its client"
    );
}

#[test]
fn the_emergency_stop_refuses_every_client() {
    let robot = RobotId::new(1).unwrap();
    let mut drive = DriveArbiter::new(1, robot, Duration::from_secs(1));
    drive.set_stopped(true);
    assert_eq!(drive.decide(client(1), robot, true, at_ms(0)), DriveDecision::Stopped);
    assert_eq!(drive.decide(client(1), robot, false, at_ms(0)), DriveDecision::Ignore);
    drive.set_stopped(false);
    assert_eq!(drive.decide(client(1), robot, true, at_ms(0)), DriveDecision::Pass);
    assert_eq!(drive.robot(1), Some(robot));
    assert_eq!((drive.robot(0), drive.robot(2), drive.robot(-1)), (None, None, None));
}

#[test]
fn the_base_drives_before_the_navigator_and_after_every_client() {
    let robot = RobotId::new(1).unwrap();
    let mut drive = DriveArbiter::new(1, robot, Duration::from_secs(1));
    drive.set_navigated(robot, true);
    assert_eq!(drive.decide_base(robot, false, at_ms(0)), DriveDecision::Ignore, "a zero stops no goal");
    assert_eq!(drive.decide_navigation(robot, at_ms(0)), DriveDecision::Pass);
    assert_eq!(drive.decide_base(robot, true, at_ms(0)), DriveDecision::Pass);
    assert_eq!(drive.decide_navigation(robot, at_ms(900)), DriveDecision::DrivenByBase);
    assert_eq!(drive.decide(client(1), robot, false, at_ms(900)), DriveDecision::Ignore);
    assert_eq!(drive.interruptions(), 0);
    assert_eq!(drive.decide(client(1), robot, true, at_ms(900)), DriveDecision::Pass);
    assert_eq!(drive.decide_base(robot, true, at_ms(1000)), DriveDecision::DrivenBy(client(1)));
    assert!(drive.is_driven_by_client(at_ms(1000)) && !drive.is_driven_by_client(at_ms(2000)));
    assert_eq!(drive.interruptions(), 1);
    drive.set_stopped(true);
    assert_eq!(drive.decide_base(robot, true, at_ms(2000)), DriveDecision::Stopped);
    assert_eq!(drive.interruptions(), 2);
}

#[test]
fn a_client_that_leaves_stops_only_what_it_drove_and_nobody_took_over() {
    let robot = RobotId::new(1).unwrap();
    let (one, two) = (client(1), client(2));
    let driven = || {
        let mut drive = DriveArbiter::new(1, robot, Duration::from_secs(1));
        assert_eq!(drive.decide(one, robot, true, at_ms(0)), DriveDecision::Pass);
        drive
    };
    let leave = |mut drive: DriveArbiter| drive.release_client(one.client.unwrap());
    let mut drive = driven();
    assert_eq!(drive.decide(two, robot, false, at_ms(2000)), DriveDecision::Pass);
    assert_eq!(drive.release_client(two.client.unwrap()), [], "a zero makes nobody the driver");
    assert_eq!(leave(drive), [robot], "nor does it relieve who drove");
    let mut drive = driven();
    assert!(matches!(drive.decide_navigation(robot, at_ms(500)), DriveDecision::DrivenBy(_)));
    assert_eq!(leave(drive), [robot], "the navigator has not taken over yet");
    let mut drive = driven();
    assert_eq!(drive.decide_navigation(robot, at_ms(2000)), DriveDecision::Pass);
    assert_eq!(leave(drive), [], "the navigator drives");
    let mut drive = driven();
    assert_eq!(drive.decide_base(robot, true, at_ms(2000)), DriveDecision::Pass);
    assert_eq!(leave(drive), [], "the base drives");
    let mut drive = driven();
    drive.take_control(two, robot, at_ms(500));
    assert_eq!(leave(drive), [], "another client drives");
    let mut drive = driven();
    drive.take_control(one, robot, at_ms(500));
    assert_eq!(leave(drive), [robot], "it took over from itself");
}

#[test]
fn a_takeover_is_an_interruption_unless_the_client_drives_already() {
    let robot = RobotId::new(1).unwrap();
    let mut drive = DriveArbiter::new(1, robot, Duration::from_secs(1));
    drive.take_control(client(1), robot, at_ms(0));
    assert_eq!(drive.interruptions(), 1);
    drive.take_control(client(1), robot, at_ms(100));
    assert_eq!(drive.interruptions(), 1, "it drives already");
    drive.take_control(client(2), robot, at_ms(200));
    assert_eq!(drive.interruptions(), 2, "another client drove");
    assert_eq!(drive.decide(client(2), robot, true, at_ms(300)), DriveDecision::Pass);
    assert_eq!(drive.interruptions(), 2, "it drives already");
}

#[test]
fn after_a_restart_the_former_driver_alone_gets_its_robot() {
    let robot = RobotId::new(1).unwrap();
    let (former, stranger) = (client(1), client(2));
    let mut drive = DriveArbiter::new(1, robot, Duration::from_secs(1));
    drive.restore_lease(robot, former.address, at_ms(4000));
    let before = DriveClient { client: None, ..former };
    assert_eq!(drive.decide(stranger, robot, true, at_ms(100)), DriveDecision::DrivenBy(before));
    assert_eq!(drive.decide(stranger, robot, false, at_ms(100)), DriveDecision::Ignore);
    assert_eq!(drive.decide(former, robot, true, at_ms(200)), DriveDecision::Pass);
    assert_eq!(drive.decide(stranger, robot, true, at_ms(300)), DriveDecision::DrivenBy(former));
    drive.restore_lease(robot, former.address, at_ms(4000));
    assert_eq!(drive.decide(stranger, robot, true, at_ms(4000)), DriveDecision::Pass, "it never came back");
}
