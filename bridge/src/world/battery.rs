//! Batteries of an external world's robots: the newest state of each goes on once a second.

use super::{ExternalWorld, MessageContext, RobotTopic, WorldError, WorldMessage};
use msg::{Battery, Header, RobotId, Stamp};
use ros_messages::battery::read_battery;
use ros_messages::cdr::Reader;

/// Shortest time between two states of one battery that are passed on, seconds. Drivers send up to 20 a second.
const PERIOD_S: f64 = 1.0;

/// States of one battery: when the last one was passed on, and the newest that came too early after it.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct BatteryRate {
    /// By the run's time.
    sent: Option<Stamp>,
    held: Option<Battery>,
}

impl BatteryRate {
    /// Returns whether the last state was passed on less than a period ago. After the clock was set back it was not.
    fn is_early(&self, now: Stamp) -> bool {
        self.sent.is_some_and(|sent| (0.0..PERIOD_S).contains(&(now - sent)))
    }
}

impl ExternalWorld {
    /// Takes the state of a battery. It makes nobody the robot's source: what watches the battery may be another program than
    /// the one that sends scans.
    pub(super) fn receive_battery(
        &mut self,
        context: &MessageContext<'_>,
        robot: RobotId,
        mut from: Reader<'_>,
    ) -> Result<(), WorldError> {
        self.check_source(context, robot)?;
        if !self.is_of_one_publisher(context, robot, RobotTopic::Battery)? {
            return Ok(());
        }
        let mut battery = read_battery(&mut from)?;
        // Its driver's clock does not matter: the state is as old as its arrival.
        battery.header = Header { stamp: context.received, ..Header::default() };
        self.robots[robot.index()].battery.held = Some(battery);
        self.send_batteries(context.received);
        Ok(())
    }

    /// Passes on the newest states that came too early, as soon as they may go. Call it often: the last state of a driver that ends
    /// goes on, too.
    pub fn send_batteries(&mut self, now: Stamp) {
        for robot in self.names.robots() {
            let rate = &mut self.robots[robot.index()].battery;
            if rate.is_early(now) {
                continue;
            }
            if let Some(battery) = rate.held.take() {
                rate.sent = Some(now);
                (self.sink)(WorldMessage::Battery(robot, &battery));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::world::{ClockOffset, ExternalWorld, Incoming, Sender, SourceClock, WorldError, WorldMessage};
    use msg::{Battery, RobotId, Stamp};
    use proptest::prelude::*;
    use ros_messages::cdr::Reader;
    use ros_messages::{BatteryState, LaserScan, Message, encode};
    use std::cell::RefCell;
    use std::rc::Rc;

    const ROBOT: RobotId = RobotId::new(2).unwrap();

    type Passed = Rc<RefCell<Vec<(RobotId, Battery)>>>;

    fn world() -> (ExternalWorld, Passed) {
        let passed = Passed::default();
        let sink = passed.clone();
        let world = ExternalWorld::new(2, move |message| {
            if let WorldMessage::Battery(robot, battery) = message {
                sink.borrow_mut().push((robot, *battery));
            }
        });
        (world, passed)
    }

    fn payload(message: &impl Message) -> Vec<u8> {
        let mut payload = Vec::new();
        encode(message, &mut payload);
        payload
    }

    fn state(percentage: f32) -> Vec<u8> {
        payload(&BatteryState { battery: Battery { percentage, ..Battery::default() }, ..Default::default() })
    }

    fn receive(
        world: &mut ExternalWorld,
        sender: impl Into<Sender>,
        message: Incoming<'_>,
        at_s: f64,
    ) -> Result<(), WorldError> {
        let mut clock = SourceClock::new(ClockOffset::Fixed(0.0));
        world.receive(sender, &mut clock, message, Stamp::from_seconds(at_s))
    }

    proptest! {
        /// However fast a driver sends, a robot's state goes on once a second at most, and its newest one within a second.
        #[test]
        fn the_newest_state_goes_on_once_a_second(steps_ms in prop::collection::vec(1_u32..3000, 1..200)) {
            let (mut world, passed) = world();
            let (mut at_ms, mut sent_ms) = (0, vec![]);
            for (index, step_ms) in steps_ms.iter().enumerate() {
                at_ms += step_ms;
                let (at_s, payload) = (f64::from(at_ms) * 1e-3, state(index as f32));
                let message = Incoming::Battery(ROBOT, Reader::new(&payload).unwrap());
                receive(&mut world, 7, message, at_s).unwrap();
                sent_ms.extend((sent_ms.len()..passed.borrow().len()).map(|_| at_ms));
                let (robot, newest) = *passed.borrow().last().unwrap();
                prop_assert_eq!(robot, ROBOT);
                prop_assert!(at_s - newest.header.stamp.seconds() < 1.0);
            }
            prop_assert!(sent_ms.windows(2).all(|two| two[1] - two[0] >= 1000));
            world.send_batteries(Stamp::from_seconds(f64::from(at_ms + 1000) * 1e-3));
            let newest = passed.borrow().last().unwrap().1;
            prop_assert_eq!(newest.percentage, (steps_ms.len() - 1) as f32);
            prop_assert_eq!(newest.header.stamp, Stamp::from_seconds(f64::from(at_ms) * 1e-3), "its arrival");
            let count = passed.borrow().len();
            world.send_batteries(Stamp::from_seconds(f64::from(at_ms + 9000) * 1e-3));
            prop_assert_eq!(passed.borrow().len(), count, "nothing is sent twice");
        }
    }

    #[test]
    fn a_battery_has_the_source_of_its_robot_and_makes_nobody_that() {
        let (mut world, passed) = world();
        let of_battery = state(0.5);
        let battery = || Incoming::Battery(ROBOT, Reader::new(&of_battery).unwrap());
        receive(&mut world, 1, battery(), 0.0).unwrap();
        let scan = LaserScan {
            stamp: Stamp::from_seconds(0.1),
            angle_increment: 0.1,
            range_min: 0.1,
            range_max: 3.0,
            ranges: vec![1.0; 8],
            ..LaserScan::default()
        };
        let scan = payload(&scan);
        receive(&mut world, 2, Incoming::Scan(ROBOT, Reader::new(&scan).unwrap()), 0.1).unwrap();
        let refused = receive(&mut world, 1, battery(), 1.5).unwrap_err();
        assert!(refused.to_string().contains("robot2 has another source"), "{refused}");
        receive(&mut world, 2, battery(), 1.5).unwrap();
        receive(&mut world, 1, battery(), 9.0).unwrap();
        assert_eq!(passed.borrow().len(), 3, "the source of the scans is gone");
        let absent = Incoming::Battery(RobotId::new(3).unwrap(), Reader::new(&of_battery).unwrap());
        assert!(receive(&mut world, 1, absent, 20.0).unwrap_err().to_string().contains("robots 1 to 2"));
        let cut = Incoming::Battery(ROBOT, Reader::new(&of_battery[..30]).unwrap());
        assert!(receive(&mut world, 1, cut, 20.0).unwrap_err().to_string().contains("needs"));
    }

    #[test]
    fn two_publishers_of_one_battery_are_refused() {
        let (mut world, passed) = world();
        let of_battery = state(0.5);
        let results: Vec<_> = (0..20_u8)
            .map(|tenth| {
                let sender = Sender { source: 9, publisher: Some([tenth % 2; 16]) };
                let message = Incoming::Battery(ROBOT, Reader::new(&of_battery).unwrap());
                receive(&mut world, sender, message, f64::from(tenth) * 0.1)
            })
            .collect();
        assert_eq!(passed.borrow().len(), 1);
        let refused = results.last().unwrap().as_ref().unwrap_err().to_string();
        assert!(refused.contains("robot2: its battery's states come from two publishers"), "{refused}");
    }
}
