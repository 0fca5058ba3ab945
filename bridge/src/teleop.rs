//! Converts a hand controller's thumb stick and grip into a velocity, for headset applications without cmd_vel.

use crate::config::BridgeConfig;
use ros_messages::{HandInputs, Joy};

/// The grip (dead man's switch) counts as held from here on, of 0 to 1.
const GRIP_HELD: f32 = 0.5;
/// Deflection below which the stick counts as centred, of 0 to 1: released sticks do not return to exactly 0.
const DEADZONE: f64 = 0.1;
/// Axes of ETH's unity_ros_teleoperation: right stick x and y, left stick x and y, triggers, left and right grip.
const AXIS_RIGHT_STICK_X: usize = 0;
const AXIS_RIGHT_STICK_Y: usize = 1;
const AXIS_RIGHT_GRIP: usize = 7;

/// The state of one thumb stick and the grip of the same hand.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Stick {
    /// Whether the grip (dead man's switch) is held: otherwise the stick has no effect.
    pub grip_held: bool,
    /// Deflection from -1 (back) to 1 (forward).
    pub forward: f64,
    /// Deflection from -1 (right) to 1 (left), in the direction of positive yaw.
    pub left: f64,
}

impl Stick {
    fn new(grip: f32, horizontal: f32, vertical: f32) -> Option<Self> {
        let all_finite = [grip, horizontal, vertical].iter().all(|axis| axis.is_finite());
        all_finite.then_some(Self {
            grip_held: grip > GRIP_HELD,
            forward: f64::from(vertical),
            left: -f64::from(horizontal),
        })
    }

    /// Reads `/quest/joystick` of ETH's unity_ros_teleoperation. `None` if an axis is missing or not finite.
    pub fn from_joy(joy: &Joy) -> Option<Self> {
        let axis = |number: usize| joy.axes.get(number).copied();
        Self::new(axis(AXIS_RIGHT_GRIP)?, axis(AXIS_RIGHT_STICK_X)?, axis(AXIS_RIGHT_STICK_Y)?)
    }

    /// Reads `q2r_right_hand_inputs` of Quest2ROS. `None` if an axis is not finite.
    pub fn from_hand(hand: &HandInputs) -> Option<Self> {
        Self::new(hand.press_middle, hand.thumb_stick_horizontal, hand.thumb_stick_vertical)
    }

    /// Returns m/s forward and rad/s counter-clockwise; zero unless the grip is held.
    pub fn velocity(&self, config: &BridgeConfig) -> (f64, f64) {
        let fraction = |axis: f64| {
            let beyond = (axis.abs().min(1.0) - DEADZONE).max(0.0) / (1.0 - DEADZONE);
            if self.grip_held && beyond > 0.0 { beyond.copysign(axis) } else { 0.0 }
        };
        (fraction(self.forward) * config.stick_linear_m_s, fraction(self.left) * config.stick_angular_rad_s)
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
        assert_eq!(velocity(&joy(0.05, -0.08, 1.0)), (0.0, 0.0), "inside the dead zone");
        assert_eq!(velocity(&joy(1.0, 1.0, 0.4)), (0.0, 0.0), "the grip is released");
        assert_eq!(Stick::from_joy(&joy(f32::NAN, 0.0, 1.0)), None);
        assert_eq!(Stick::from_joy(&Joy::default()), None);
        let hand = HandInputs { press_middle: 1.0, thumb_stick_vertical: 1.0, ..Default::default() };
        assert_eq!(Stick::from_hand(&hand).unwrap().velocity(&config), (config.stick_linear_m_s, 0.0));
    }
}
