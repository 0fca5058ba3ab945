use super::*;
use crate::config::LimitsOfRobot;
use proptest::prelude::*;

fn client(serial: u64) -> ClientId {
    ClientId { slot: serial as usize, serial }
}

fn driver(serial: u64) -> DriveClient {
    DriveClient { client: Some(client(serial)), address: Some([10, 0, 0, serial as u8].into()) }
}

fn robot(number: usize) -> RobotId {
    RobotId::new(number).unwrap()
}

fn at_ms(ms: u64) -> Monotonic {
    Monotonic(ms * 1_000_000)
}

fn forward(linear_m_s: f64) -> Velocity {
    Velocity { linear_m_s, angular_rad_s: 0.0 }
}

fn gate(robot_count: usize) -> VelocityGate {
    let drive = DriveArbiter::new(robot_count, robot(1), Duration::from_secs(1));
    let robots = vec![LimitsOfRobot { robot: 2, linear_m_s: 1.0, angular_rad_s: 0.5 }];
    VelocityGate::new(&VelocityConfig { robots, ..Default::default() }, robot_count, drive)
}

fn outputs(gate: &mut VelocityGate) -> Vec<(usize, f64)> {
    std::iter::from_fn(|| gate.next_output()).map(|(robot, v)| (robot.number(), v.linear_m_s)).collect()
}

/// Ticks as a caller does that obeys [`VelocityGate::next_due`]; returns the times of the outputs, ms.
fn run_until(gate: &mut VelocityGate, end_ms: u64) -> Vec<(u64, usize, f64)> {
    let mut sent = Vec::new();
    while let Some(due) = gate.next_due().filter(|due| *due <= at_ms(end_ms)) {
        gate.tick(due);
        sent.extend(outputs(gate).into_iter().map(|(robot, m_s)| (due.0 / 1_000_000, robot, m_s)));
    }
    sent
}

#[test]
fn every_robot_gets_zeros_for_a_second_before_anything_else() {
    let mut gate = gate(2);
    assert_eq!(outputs(&mut gate), [(1, 0.0), (2, 0.0)]);
    let sent = run_until(&mut gate, 10_000);
    assert_eq!(
        sent.iter().filter(|(_, robot, _)| *robot == 1).count(),
        21,
        "at 20 Hz, and no longer: {sent:?}"
    );
    assert_eq!(gate.next_due(), None);
}

#[test]
fn velocities_are_clamped_to_the_limits_of_their_robot() {
    let mut gate = gate(2);
    let wish = Velocity { linear_m_s: 5.0, angular_rad_s: -9.0 };
    let want = |linear_m_s, angular_rad_s| GateDecision::Passed(Velocity { linear_m_s, angular_rad_s });
    assert_eq!(gate.request(driver(1), robot(1), wish, at_ms(0)), want(0.22, -2.84));
    assert_eq!(gate.request(driver(1), robot(2), wish, at_ms(0)), want(1.0, -0.5));
    let huge = Velocity { linear_m_s: -1e300, angular_rad_s: 1e300 };
    assert_eq!(gate.request(driver(1), robot(1), huge, at_ms(0)), want(-0.22, 2.84));
    outputs(&mut gate);
    for wrong in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        assert_eq!(gate.request(driver(1), robot(1), forward(wrong), at_ms(0)), GateDecision::NotFinite);
        let turn = Velocity { angular_rad_s: wrong, ..Velocity::ZERO };
        assert_eq!(gate.request(driver(1), robot(1), turn, at_ms(0)), GateDecision::NotFinite);
    }
    assert_eq!(outputs(&mut gate), []);
}

#[test]
fn a_silent_driver_stops_its_robot_after_the_timeout_and_for_a_second() {
    let mut gate = gate(1);
    run_until(&mut gate, 2_000);
    outputs(&mut gate);
    for ms in [2_000, 2_050, 2_100] {
        gate.request(driver(1), robot(1), forward(0.1), at_ms(ms));
    }
    assert_eq!(outputs(&mut gate), [(1, 0.1); 3]);
    let sent = run_until(&mut gate, 10_000);
    assert_eq!(sent[0], (2_400, 1, 0.0), "0.3 s after the last command");
    assert_eq!(sent.last(), Some(&(3_400, 1, 0.0)), "repeated for a second");
    assert_eq!(sent.len(), 21);
}

#[test]
fn zeros_end_when_somebody_drives_and_are_not_added_to_those_of_a_driver() {
    let mut gate = gate(1);
    outputs(&mut gate);
    gate.tick(at_ms(0));
    gate.request(driver(1), robot(1), forward(0.1), at_ms(10));
    outputs(&mut gate);
    assert_eq!(run_until(&mut gate, 309), []);
    for ms in (20..2_000).step_by(40) {
        gate.request(driver(1), robot(1), Velocity::ZERO, at_ms(ms));
        assert_eq!(run_until(&mut gate, ms + 39), []);
    }
}

#[test]
fn zeros_go_out_at_once_when_a_driver_leaves_or_is_relieved() {
    let mut gate = gate(2);
    gate.request(driver(1), robot(1), forward(0.1), at_ms(0));
    gate.request(driver(1), robot(2), forward(0.1), at_ms(0));
    outputs(&mut gate);
    assert_eq!(gate.take_control(driver(2), robot(2), at_ms(10)), Some(client(1)));
    assert_eq!(outputs(&mut gate), [(2, 0.0)]);
    gate.release_client(client(1));
    assert_eq!(outputs(&mut gate)[0], (1, 0.0));
    gate.repeat_stop(robot(1));
    assert_eq!(outputs(&mut gate), [(1, 0.0)]);
    gate.request(driver(2), robot(1), forward(0.2), at_ms(20));
    outputs(&mut gate);
    gate.repeat_stop(robot(1));
    assert_eq!(outputs(&mut gate), [], "it is driven");
}

#[test]
fn the_emergency_stop_sends_zeros_as_long_as_it_is_set() {
    let mut gate = gate(1);
    gate.request(driver(1), robot(1), forward(0.1), at_ms(0));
    outputs(&mut gate);
    gate.set_stopped(true);
    assert_eq!(outputs(&mut gate), [(1, 0.0)]);
    gate.tick(at_ms(10));
    assert_eq!(gate.request(driver(1), robot(1), forward(0.1), at_ms(20)), GateDecision::Stopped);
    let sent = run_until(&mut gate, 11_010);
    assert!(sent.iter().all(|(_, _, m_s)| *m_s == 0.0));
    let late = sent.iter().filter(|(ms, _, _)| *ms > 1_010).count();
    assert_eq!(late, 20, "twice a second");
    gate.set_stopped(false);
    assert_eq!(gate.next_due(), None);
}

/// One thing that happens to the gate.
#[derive(Clone, Debug)]
enum Event {
    Command { driver: u64, robot: usize, linear_m_s: f64, angular_rad_s: f64 },
    TakeControl { driver: u64, robot: usize },
    Leave { driver: u64 },
    SetStopped(bool),
    Listener { robot: usize },
    Restore { driver: u64, robot: usize },
}

fn speeds() -> impl Strategy<Value = f64> {
    prop_oneof![Just(0.0), -10.0..10.0f64, Just(f64::NAN), Just(f64::NEG_INFINITY), Just(1e300), Just(0.1)]
}

fn events() -> impl Strategy<Value = Event> {
    let (drivers, robots) = (1..4u64, 1..3usize);
    prop_oneof![
        8 => (drivers.clone(), robots.clone(), speeds(), speeds()).prop_map(
            |(driver, robot, linear_m_s, angular_rad_s)| {
                Event::Command { driver, robot, linear_m_s, angular_rad_s }
            }
        ),
        1 => (drivers.clone(), robots.clone()).prop_map(|(driver, robot)| Event::TakeControl { driver, robot }),
        1 => drivers.clone().prop_map(|driver| Event::Leave { driver }),
        1 => prop::bool::weighted(0.3).prop_map(Event::SetStopped),
        1 => robots.clone().prop_map(|robot| Event::Listener { robot }),
        1 => (drivers, robots).prop_map(|(driver, robot)| Event::Restore { driver, robot }),
    ]
}

/// What a robot has been sent, and whom it may obey: written down without the gate's state.
#[derive(Clone, Copy, Debug, Default)]
struct Witness {
    velocity: Option<Velocity>,
    /// When the last velocity that is not zero was sent, ms, and by whom.
    moved: Option<(u64, u64)>,
    /// Who took control last, ms; others may not drive for a second.
    taken: Option<(u64, u64)>,
}

fn apply(gate: &mut VelocityGate, event: &Event, now_ms: u64, witnesses: &mut [Witness; 2]) {
    let now = at_ms(now_ms);
    match *event {
        Event::Command { driver: by, robot: number, linear_m_s, angular_rad_s } => {
            let is_stopped = gate.drive().is_stopped();
            let velocity = Velocity { linear_m_s, angular_rad_s };
            let decision = gate.request(driver(by), robot(number), velocity, now);
            let GateDecision::Passed(passed) = decision else { return };
            assert!(!is_stopped, "{event:?} passed the emergency stop");
            let witness = &mut witnesses[number - 1];
            if passed.is_moving() {
                for (since, owner) in witness.moved.into_iter().chain(witness.taken) {
                    let is_held = now_ms < since + 1_000 && owner != by;
                    assert!(!is_held, "{event:?} moved a robot that {owner} holds");
                }
                witness.moved = Some((now_ms, by));
                witness.taken = None;
            }
        }
        Event::TakeControl { driver: by, robot: number } => {
            gate.take_control(driver(by), robot(number), now);
            witnesses[number - 1] =
                Witness { taken: Some((now_ms, by)), moved: None, ..witnesses[number - 1] };
        }
        Event::Leave { driver: by } => {
            gate.release_client(client(by));
            for witness in witnesses {
                witness.moved = witness.moved.filter(|(_, owner)| *owner != by);
                witness.taken = witness.taken.filter(|(_, owner)| *owner != by);
            }
        }
        Event::SetStopped(is_stopped) => gate.set_stopped(is_stopped),
        Event::Listener { robot: number } => gate.repeat_stop(robot(number)),
        Event::Restore { driver: by, robot: number } => {
            gate.drive_mut().restore_lease(robot(number), driver(by).address, now);
            witnesses[number - 1] = Witness { moved: None, taken: None, ..witnesses[number - 1] };
        }
    }
}

proptest! {
    /// Whatever happens: nothing beyond the limits is sent, nobody moves a robot that another holds, nothing passes
    /// the emergency stop, and a robot that gets no command is sent a zero within 0.35 s.
    #[test]
    fn robots_are_safe_in_any_sequence(
        steps in prop::collection::vec((events(), 0..400u64), 1..80),
        tick_ms in 1..20u64,
    ) {
        let mut gate = gate(2);
        let mut witnesses = [Witness::default(); 2];
        let mut sent_ms = [0; 2];
        let mut now_ms = 0;
        for (event, pause_ms) in &steps {
            apply(&mut gate, event, now_ms, &mut witnesses);
            let end_ms = now_ms + pause_ms;
            loop {
                while let Some((robot, velocity)) = gate.next_output() {
                    let limits = [(0.22, 2.84), (1.0, 0.5)][robot.index()];
                    prop_assert!(velocity.linear_m_s.abs() <= limits.0);
                    prop_assert!(velocity.angular_rad_s.abs() <= limits.1);
                    prop_assert!(!(gate.drive().is_stopped() && velocity.is_moving()));
                    witnesses[robot.index()].velocity = Some(velocity);
                    sent_ms[robot.index()] = now_ms;
                }
                for (witness, sent_ms) in witnesses.iter().zip(sent_ms) {
                    let is_moving = witness.velocity.is_none_or(Velocity::is_moving);
                    prop_assert!(!is_moving || now_ms - sent_ms <= 320, "no zero {} ms after a command", now_ms - sent_ms);
                }
                if now_ms >= end_ms {
                    break;
                }
                now_ms = (now_ms + tick_ms).min(end_ms);
                gate.tick(at_ms(now_ms));
            }
        }
    }
}
