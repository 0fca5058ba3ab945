//! Clock reset detector: tells a clock that was set back from single wrong stamps.
//!
//! A single earlier stamp, or one stamp repeated, is an error of the sender. Earlier stamps that then rise in order
//! are a new time.

use msg::Stamp;

/// Stamps in order that make a new time: fewer may be messages that arrive late.
const IN_ORDER: u32 = 5;
/// Largest step between two stamps in order, seconds: a larger one is another error.
const STEP_MAX_S: f64 = 10.0;

/// Follows stamps that were rejected because they are before the last accepted one.
#[derive(Clone, Copy, Debug, Default)]
pub struct ClockResetDetector {
    /// First stamp of the series in order.
    first: Stamp,
    /// Newest stamp of the series.
    newest: Stamp,
    /// Number of stamps in the series.
    in_order: u32,
}

impl ClockResetDetector {
    /// Records a stamp before the last accepted one. Returns the first stamp of the new time once enough are in order.
    pub fn observe(&mut self, stamp: Stamp) -> Option<Stamp> {
        if self.in_order > 0 && stamp > self.newest && stamp - self.newest <= STEP_MAX_S {
            (self.newest, self.in_order) = (stamp, self.in_order + 1);
        } else if self.in_order == 0 || stamp != self.newest {
            *self = Self { first: stamp, newest: stamp, in_order: 1 };
        }
        (self.in_order >= IN_ORDER).then_some(self.first)
    }
}
