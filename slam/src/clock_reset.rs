//! Detects a clock that was set back. One stamp that goes back, or a stamp again and again, is a mistake of
//! its sender; stamps that have gone back and then go on, one after the other, are a new time.

use msg::Stamp;

/// So many stamps in order make a new time.
const IN_ORDER: u32 = 5;
/// If none is farther from the one before than this, seconds.
const STEP_MAX_S: f64 = 10.0;

/// The newest stamps that were refused because they were before the last one taken.
#[derive(Clone, Copy, Debug, Default)]
pub struct ClockResetDetector {
    first: Stamp,
    newest: Stamp,
    in_order: u32,
}

impl ClockResetDetector {
    /// Notes a stamp from before the last one taken. Once enough of them are in order: the first of
    /// these, where the new time begins.
    pub fn observe(&mut self, stamp: Stamp) -> Option<Stamp> {
        if self.in_order > 0 && stamp > self.newest && stamp - self.newest <= STEP_MAX_S {
            (self.newest, self.in_order) = (stamp, self.in_order + 1);
        } else if self.in_order == 0 || stamp != self.newest {
            *self = Self { first: stamp, newest: stamp, in_order: 1 };
        }
        (self.in_order >= IN_ORDER).then_some(self.first)
    }
}
