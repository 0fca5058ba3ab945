//! A thumb stick with a deadman's grip, as a velocity: headset applications that know no cmd_vel can drive.

use crate::config::BridgeConfig;
use crate::ros::{HandInputs, Joy};

/// A grip pressed further than this is held.
const GRIP_HELD: f32 = 0.5;
/// The stick's middle, where it never rests exactly.
const DEADZONE: f64 = 0.1;

/// One hand on one stick.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Stick {
    /// The grip is held: the stick means something.
    pub held: bool,
    /// -1 back to 1 forward.
    pub forward: f64,
    /// -1 right to 1 left, as yaw counts.
    pub left: f64,
}

impl Stick {
    fn new(grip: f32, horizontal: f32, vertical: f32) -> Option<Self> {
        let sound = [grip, horizontal, vertical].iter().all(|axis| axis.is_finite());
        sound.then_some(Self {
            held: grip > GRIP_HELD,
            forward: f64::from(vertical),
            left: -f64::from(horizontal),
        })
    }

    /// `/quest/joystick` of ETH's unity_ros_teleoperation: axes are right stick x, y, left stick x, y, left and right
    /// trigger, left and right grip. The right hand drives. `None` if an axis is missing or no number.
    pub fn from_joy(joy: &Joy) -> Option<Self> {
        let axis = |number: usize| joy.axes.get(number).copied();
        Self::new(axis(7)?, axis(0)?, axis(1)?)
    }

    /// `q2r_right_hand_inputs` of Quest2ROS. `None` if an axis is no number.
    pub fn from_hand(hand: &HandInputs) -> Option<Self> {
        Self::new(hand.press_middle, hand.thumb_stick_horizontal, hand.thumb_stick_vertical)
    }

    /// m/s forward and rad/s counter-clockwise; nothing unless held.
    pub fn velocity(&self, config: &BridgeConfig) -> (f64, f64) {
        let share = |axis: f64| {
            let beyond = (axis.abs().min(1.0) - DEADZONE).max(0.0) / (1.0 - DEADZONE);
            if self.held && beyond > 0.0 { beyond.copysign(axis) } else { 0.0 }
        };
        (share(self.forward) * config.stick_linear_m_s, share(self.left) * config.stick_angular_rad_s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn joy(x: f32, y: f32, grip: f32) -> Joy {
        Joy { axes: vec![x, y, 0.9, 0.9, 0.9, 0.9, 0.0, grip], ..Default::default() }
    }

    #[test]
    fn the_right_stick_drives_while_the_right_grip_is_held() {
        let config = BridgeConfig::default();
        let velocity = |joy: &Joy| Stick::from_joy(joy).unwrap().velocity(&config);
        assert_eq!(velocity(&joy(0.0, 1.0, 1.0)), (config.stick_linear_m_s, 0.0));
        assert_eq!(velocity(&joy(0.0, -7.0, 1.0)), (-config.stick_linear_m_s, 0.0), "never beyond the limit");
        assert_eq!(velocity(&joy(1.0, 0.0, 1.0)), (0.0, -config.stick_angular_rad_s), "right is clockwise");
        assert_eq!(velocity(&joy(0.05, -0.08, 1.0)), (0.0, 0.0), "the middle is wide");
        assert_eq!(velocity(&joy(1.0, 1.0, 0.4)), (0.0, 0.0), "the grip is let go");
        assert_eq!(Stick::from_joy(&joy(f32::NAN, 0.0, 1.0)), None);
        assert_eq!(Stick::from_joy(&Joy::default()), None);
        let hand = HandInputs { press_middle: 1.0, thumb_stick_vertical: 1.0, ..Default::default() };
        assert_eq!(Stick::from_hand(&hand).unwrap().velocity(&config), (config.stick_linear_m_s, 0.0));
    }
}
