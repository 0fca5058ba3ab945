//! Simulated joystick, with the deflection of a headset's stick by a thumb and the velocity that it commands.

use msg::{ROBOTS_MAX, Stamp};
use nav::{DriveCommand, Twist};

/// Time from the centre to full deflection, seconds, for a human thumb.
const FULL_DEFLECTION_S: f64 = 0.25;
/// Time that the first deflection of a stick is given, seconds: one period of the headset's 20 Hz.
const FIRST_STEP_S: f64 = 0.05;

/// Deflection of a stick; each axis is in -1..=1.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Stick {
    /// Deflection forward; backward is negative.
    pub forward: f64,
    /// Deflection to the left: counter-clockwise turning (REP-103).
    pub left: f64,
}

impl Stick {
    /// The stick is released.
    pub const CENTRED: Self = Self { forward: 0.0, left: 0.0 };
}

/// Mapping between deflection and velocity.
///
/// On each axis the velocity is 0 inside the deadzone and grows linearly from its edge to the limit at full
/// deflection, so that it has no step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JoystickProfile {
    deadzone: f64,
    linear_max_m_s: f64,
    angular_max_rad_s: f64,
}

impl Default for JoystickProfile {
    /// A deadzone of a tenth; 0.15 m/s and 1.5 rad/s, the fleet's default limits.
    fn default() -> Self {
        Self { deadzone: 0.1, linear_max_m_s: 0.15, angular_max_rad_s: 1.5 }
    }
}

impl JoystickProfile {
    /// `None` unless the deadzone is in 0..0.9 and both limits are finite and not negative.
    pub fn new(deadzone: f64, linear_max_m_s: f64, angular_max_rad_s: f64) -> Option<Self> {
        let is_limit = |v: f64| v.is_finite() && v >= 0.0;
        let is_valid =
            (0.0..0.9).contains(&deadzone) && is_limit(linear_max_m_s) && is_limit(angular_max_rad_s);
        is_valid.then_some(Self { deadzone, linear_max_m_s, angular_max_rad_s })
    }

    /// Forward speed at full deflection, m/s.
    pub fn linear_max_m_s(&self) -> f64 {
        self.linear_max_m_s
    }

    /// Turning speed at full deflection, rad/s.
    pub fn angular_max_rad_s(&self) -> f64 {
        self.angular_max_rad_s
    }

    /// Velocity that a deflection commands, within the limits. A deflection that is NaN commands none.
    pub fn twist(&self, stick: Stick) -> Twist {
        Twist {
            linear_m_s: self.share_of_limit(stick.forward) * self.linear_max_m_s,
            angular_rad_s: self.share_of_limit(stick.left) * self.angular_max_rad_s,
        }
    }

    /// Deflection that commands a velocity, or as much of it as the limits allow.
    pub fn stick(&self, twist: Twist) -> Stick {
        Stick {
            forward: self.deflection(twist.linear_m_s, self.linear_max_m_s),
            left: self.deflection(twist.angular_rad_s, self.angular_max_rad_s),
        }
    }

    /// Share of the limit that a deflection commands, -1 to 1.
    fn share_of_limit(&self, axis: f64) -> f64 {
        if axis.is_nan() {
            return 0.0;
        }
        let beyond = (axis.abs().min(1.0) - self.deadzone).max(0.0);
        (beyond / (1.0 - self.deadzone)).min(1.0).copysign(axis)
    }

    fn deflection(&self, wanted: f64, limit: f64) -> f64 {
        let share = (wanted / limit).clamp(-1.0, 1.0);
        if share.is_nan() || share == 0.0 {
            return 0.0;
        }
        (self.deadzone + share.abs() * (1.0 - self.deadzone)).copysign(share)
    }
}

/// Limit on how fast a stick moves away from its centre; back to it, it moves at once.
#[derive(Clone, Copy, Debug, Default)]
pub struct StickFilter {
    last: Option<(Stamp, Stick)>,
}

impl StickFilter {
    /// Moves the stick towards the deflection wanted and returns where it is now.
    pub fn apply(&mut self, now: Stamp, wanted: Stick) -> Stick {
        let (elapsed_s, from) = match self.last {
            Some((before, stick)) => ((now - before).clamp(0.0, FULL_DEFLECTION_S), stick),
            None => (FIRST_STEP_S, Stick::CENTRED),
        };
        let step = elapsed_s / FULL_DEFLECTION_S;
        let axis = |from: f64, to: f64| {
            let start = if from * to > 0.0 { from } else { 0.0 };
            to.abs().min(start.abs() + step).copysign(to)
        };
        let stick = Stick { forward: axis(from.forward, wanted.forward), left: axis(from.left, wanted.left) };
        self.last = Some((now, stick));
        stick
    }
}

/// One stick for each robot, moved as a thumb would to drive what navigation asks for.
#[derive(Clone, Debug)]
pub struct SimulatedJoystick {
    profile: JoystickProfile,
    filters: [StickFilter; ROBOTS_MAX],
}

impl Default for SimulatedJoystick {
    fn default() -> Self {
        Self { profile: JoystickProfile::default(), filters: [StickFilter::default(); ROBOTS_MAX] }
    }
}

impl SimulatedJoystick {
    /// Sticks with this profile, all centred.
    pub fn new(profile: JoystickProfile) -> Self {
        Self { profile, ..Self::default() }
    }

    /// Moves the robot's stick towards a command and returns the velocity that the stick gives.
    pub fn drive(&mut self, now: Stamp, command: &DriveCommand) -> Twist {
        let wanted = self.profile.stick(command.twist);
        self.profile.twist(self.filters[command.robot.index()].apply(now, wanted))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn profile() -> impl Strategy<Value = JoystickProfile> {
        (0.0..0.5, 0.01..2.0, 0.01..3.0).prop_map(|(d, v, w)| JoystickProfile::new(d, v, w).unwrap())
    }

    proptest! {
        #[test]
        fn velocities_stay_within_the_limits(j in profile(), forward in any::<f64>(), left in any::<f64>()) {
            let twist = j.twist(Stick { forward, left });
            prop_assert!(twist.linear_m_s.abs() <= j.linear_max_m_s);
            prop_assert!(twist.angular_rad_s.abs() <= j.angular_max_rad_s);
        }

        #[test]
        fn the_deadzone_gives_no_velocity(j in profile(), share in -1.0..1.0) {
            let axis = share * j.deadzone;
            prop_assert_eq!(j.twist(Stick { forward: axis, left: axis }), Twist::STOP);
        }

        #[test]
        fn velocity_is_continuous_odd_and_rising(j in profile(), a in -1.2..1.2, step in 0.0..1e-6) {
            let at = |axis: f64| j.twist(Stick { forward: axis, left: axis });
            let (low, high) = (at(a), at(a + step));
            prop_assert!(high.linear_m_s >= low.linear_m_s);
            prop_assert!(high.linear_m_s - low.linear_m_s <= step * j.linear_max_m_s / (1.0 - j.deadzone) + 1e-12);
            prop_assert_eq!(at(-a).angular_rad_s, -low.angular_rad_s);
        }

        #[test]
        fn stick_is_the_inverse_of_twist(j in profile(), v in -1.0..1.0, w in -1.0..1.0) {
            let wanted = Twist { linear_m_s: v * j.linear_max_m_s, angular_rad_s: w * j.angular_max_rad_s };
            let got = j.twist(j.stick(wanted));
            prop_assert!((got.linear_m_s - wanted.linear_m_s).abs() < 1e-9);
            prop_assert!((got.angular_rad_s - wanted.angular_rad_s).abs() < 1e-9);
        }

        #[test]
        fn any_velocity_gives_a_deflection_in_range(j in profile(), v in any::<f64>(), w in any::<f64>()) {
            let stick = j.stick(Twist { linear_m_s: v, angular_rad_s: w });
            prop_assert!(stick.forward.abs() <= 1.0 && stick.left.abs() <= 1.0);
        }
    }

    #[test]
    fn full_deflection_gives_the_limit() {
        let j = JoystickProfile::default();
        assert_eq!(
            j.twist(Stick { forward: 1.0, left: -1.0 }),
            Twist { linear_m_s: 0.15, angular_rad_s: -1.5 }
        );
        assert_eq!(j.twist(Stick { forward: f64::NAN, left: f64::INFINITY }).angular_rad_s, 1.5);
        assert!(JoystickProfile::new(1.0, 0.15, 1.5).is_none());
        assert!(JoystickProfile::new(f64::NAN, 0.15, 1.5).is_none());
    }

    #[test]
    fn a_stick_moves_out_slowly_and_lets_go_at_once() {
        let mut filter = StickFilter::default();
        let full = Stick { forward: 1.0, left: -1.0 };
        let at = Stamp::from_seconds;
        let near = |stick: Stick, forward: f64, left: f64| {
            (stick.forward - forward).abs() < 1e-9 && (stick.left - left).abs() < 1e-9
        };
        assert!(near(filter.apply(at(0.0), full), 0.2, -0.2));
        assert!(near(filter.apply(at(0.05), full), 0.4, -0.4));
        assert!(near(filter.apply(at(0.1), Stick { forward: -1.0, left: -0.1 }), -0.2, -0.1));
        assert_eq!(filter.apply(at(0.15), Stick::CENTRED), Stick::CENTRED);
        // After a long pause the stick moves no further than to full deflection.
        assert_eq!(filter.apply(at(60.0), full), full);
    }
}
