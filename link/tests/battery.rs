//! The state of a robot's battery crosses to the base, and none that is old.

use link::{BaseEnd, BaseEvent, RobotEnd, ScanRate, SenderConfig};
use msg::{Battery, Monotonic};

/// A robot and its base, which hear each other unless the link is cut.
struct Machines {
    robot: RobotEnd,
    base: BaseEnd,
    now_ms: u64,
    is_cut: bool,
    /// Charges that the base has got.
    received: Vec<f32>,
}

impl Machines {
    fn now(&self) -> Monotonic {
        Monotonic(self.now_ms * 1_000_000)
    }

    fn put(&mut self, percentage: f32) {
        let now = self.now();
        self.robot.put_battery(&Battery { percentage, ..Battery::default() }, now);
    }

    fn run(&mut self, ms: u64) {
        for _ in 0..ms / 20 {
            self.now_ms += 20;
            let (now, mut up, mut down) = (self.now(), Vec::new(), Vec::new());
            self.robot.poll(now, &mut |_, bytes: &[u8]| up.push(bytes.to_vec()));
            self.base.poll(now, &mut |_, bytes: &[u8]| down.push(bytes.to_vec()));
            if self.is_cut {
                continue;
            }
            for bytes in down {
                self.robot.receive(&bytes, now).unwrap();
            }
            for bytes in up {
                let events = self.base.receive(&bytes, now).unwrap().into_iter();
                self.received.extend(events.filter_map(|event| match event {
                    BaseEvent::Battery(battery) => Some(battery.percentage),
                    _ => None,
                }));
            }
        }
    }
}

#[test]
fn the_newest_state_of_a_battery_crosses_and_none_that_is_old() {
    let robot = RobotEnd::new(1, 1, SenderConfig::default(), ScanRate::new(1.0, 90));
    let mut machines =
        Machines { robot, base: BaseEnd::new(2, 2), now_ms: 1_000, is_cut: false, received: Vec::new() };
    machines.run(1_000);
    [0.9, 0.8].into_iter().for_each(|percentage| machines.put(percentage));
    machines.run(1_000);
    assert_eq!(machines.received, [0.8], "once, and the newest");
    machines.is_cut = true;
    machines.run(20_000);
    machines.put(0.7);
    machines.run(6_000);
    machines.is_cut = false;
    machines.run(2_000);
    assert_eq!(machines.received, [0.8], "what it was before the end of the outage is not what it is");
    machines.put(0.6);
    machines.run(1_000);
    assert_eq!(machines.received, [0.8, 0.6]);
}
