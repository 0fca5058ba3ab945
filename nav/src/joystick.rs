//! A thumbstick as the headset's controller has it: deflection to velocity, with deadzone and clamp.

/// Deflection of a thumbstick, each axis in -1..1.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Stick {
    /// Away from the thumb's owner: forward.
    pub forward: f64,
    /// To the left: counter-clockwise (REP-103).
    pub left: f64,
}

impl Stick {
    /// The thumb is off.
    pub const CENTRED: Self = Self { forward: 0.0, left: 0.0 };
}

/// A wished velocity of `base_footprint` (geometry_msgs/Twist in the plane).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Twist {
    /// Forward, m/s.
    pub linear_m_s: f64,
    /// Counter-clockwise, rad/s.
    pub angular_rad_s: f64,
}

impl Twist {
    /// Stand still.
    pub const STOP: Self = Self { linear_m_s: 0.0, angular_rad_s: 0.0 };
}

/// How deflection becomes velocity. Each axis on its own: inside the deadzone nothing, from its edge
/// linearly up to the limit at full deflection, so that the velocity has no step anywhere.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Joystick {
    deadzone: f64,
    linear_max_m_s: f64,
    angular_max_rad_s: f64,
}

impl Default for Joystick {
    /// A tenth of deadzone; 0.15 m/s and 1.5 rad/s, the fleet's default limits.
    fn default() -> Self {
        Self { deadzone: 0.1, linear_max_m_s: 0.15, angular_max_rad_s: 1.5 }
    }
}

impl Joystick {
    /// `None` unless the deadzone is in 0..0.9 and the limits are finite and not negative.
    pub fn new(deadzone: f64, linear_max_m_s: f64, angular_max_rad_s: f64) -> Option<Self> {
        let limit = |v: f64| v.is_finite() && v >= 0.0;
        let sound = (0.0..0.9).contains(&deadzone) && limit(linear_max_m_s) && limit(angular_max_rad_s);
        sound.then_some(Self { deadzone, linear_max_m_s, angular_max_rad_s })
    }

    /// Forward speed at full deflection, m/s.
    pub fn linear_max_m_s(&self) -> f64 {
        self.linear_max_m_s
    }

    /// Turning speed at full deflection, rad/s.
    pub fn angular_max_rad_s(&self) -> f64 {
        self.angular_max_rad_s
    }

    /// The velocity a deflection asks for. Never over the limits; a deflection that is not a number asks for none.
    pub fn twist(&self, stick: Stick) -> Twist {
        Twist {
            linear_m_s: self.share(stick.forward) * self.linear_max_m_s,
            angular_rad_s: self.share(stick.left) * self.angular_max_rad_s,
        }
    }

    /// The deflection that asks for a velocity, or for as much of it as the limits allow.
    pub fn stick(&self, twist: Twist) -> Stick {
        Stick {
            forward: self.deflection(twist.linear_m_s, self.linear_max_m_s),
            left: self.deflection(twist.angular_rad_s, self.angular_max_rad_s),
        }
    }

    /// Share of the limit, -1..1.
    fn share(&self, axis: f64) -> f64 {
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

#[cfg(test)]
mod laws {
    use super::*;
    use proptest::prelude::*;

    fn joystick() -> impl Strategy<Value = Joystick> {
        (0.0..0.5, 0.01..2.0, 0.01..3.0).prop_map(|(d, v, w)| Joystick::new(d, v, w).unwrap())
    }

    proptest! {
        #[test]
        fn bounded_and_nan_safe(j in joystick(), forward in any::<f64>(), left in any::<f64>()) {
            let twist = j.twist(Stick { forward, left });
            prop_assert!(twist.linear_m_s.abs() <= j.linear_max_m_s);
            prop_assert!(twist.angular_rad_s.abs() <= j.angular_max_rad_s);
        }

        #[test]
        fn nothing_inside_the_deadzone(j in joystick(), share in -1.0..1.0) {
            let axis = share * j.deadzone;
            prop_assert_eq!(j.twist(Stick { forward: axis, left: axis }), Twist::STOP);
        }

        #[test]
        fn continuous_odd_and_rising(j in joystick(), a in -1.2..1.2, step in 0.0..1e-6) {
            let at = |axis: f64| j.twist(Stick { forward: axis, left: axis });
            let (low, high) = (at(a), at(a + step));
            prop_assert!(high.linear_m_s >= low.linear_m_s);
            prop_assert!(high.linear_m_s - low.linear_m_s <= step * j.linear_max_m_s / (1.0 - j.deadzone) + 1e-12);
            prop_assert_eq!(at(-a).angular_rad_s, -low.angular_rad_s);
        }

        #[test]
        fn deflection_undoes_twist(j in joystick(), v in -1.0..1.0, w in -1.0..1.0) {
            let wanted = Twist { linear_m_s: v * j.linear_max_m_s, angular_rad_s: w * j.angular_max_rad_s };
            let got = j.twist(j.stick(wanted));
            prop_assert!((got.linear_m_s - wanted.linear_m_s).abs() < 1e-9);
            prop_assert!((got.angular_rad_s - wanted.angular_rad_s).abs() < 1e-9);
        }

        #[test]
        fn any_wish_is_a_deflection(j in joystick(), v in any::<f64>(), w in any::<f64>()) {
            let stick = j.stick(Twist { linear_m_s: v, angular_rad_s: w });
            prop_assert!(stick.forward.abs() <= 1.0 && stick.left.abs() <= 1.0);
        }
    }

    #[test]
    fn full_deflection_is_the_limit() {
        let j = Joystick::default();
        assert_eq!(
            j.twist(Stick { forward: 1.0, left: -1.0 }),
            Twist { linear_m_s: 0.15, angular_rad_s: -1.5 }
        );
        assert_eq!(j.twist(Stick { forward: f64::NAN, left: f64::INFINITY }).angular_rad_s, 1.5);
        assert!(Joystick::new(1.0, 0.15, 1.5).is_none());
        assert!(Joystick::new(f64::NAN, 0.15, 1.5).is_none());
    }
}
