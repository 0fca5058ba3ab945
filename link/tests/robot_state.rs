//! What a robot's machine says of its emergency stop.

use link::{BaseEnd, LocalControl, RobotEnd, ScanRate, SenderConfig};
use msg::Monotonic;

#[test]
fn a_robot_whose_bridge_does_not_answer_says_neither_that_it_is_stopped_nor_that_it_is_not() {
    let mut robot = RobotEnd::new(1, 1, SenderConfig::default(), ScanRate::new(1.0, 90));
    let mut base = BaseEnd::new(2, 2);
    for (second, is_stopped) in (1..).zip([None, Some(false), None, Some(true), None, Some(false)]) {
        let now = Monotonic(second * 1_000_000_000);
        robot.set_local_control(LocalControl { is_stopped, ..LocalControl::default() });
        let mut sent = Vec::new();
        robot.poll(now, &mut |_, bytes: &[u8]| sent.push(bytes.to_vec()));
        sent.iter().for_each(|bytes| drop(base.receive(bytes, now).unwrap()));
        let state = base.robot_state();
        assert_eq!(state.is_known.then_some(state.is_stopped), is_stopped, "second {second}");
    }
}
