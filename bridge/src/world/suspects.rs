//! Messages whose stamps are far from what is expected: one of them is an outlier, several that agree are a clock that was set.

use thiserror::Error;

/// So many messages in a row, which arrived one after the other, show that a clock was set, if they agree ...
pub const STEP_MESSAGES: usize = 5;
/// ... to within this, seconds. A network's delay varies less within half a second, or is no step.
const AGREEMENT_S: f64 = 0.25;
/// Messages that agree come within this time, seconds: the slowest topic, scans at 5 Hz, takes 1 s.
const AGREEMENT_SPAN_S: f64 = 2.0;

/// A message's stamp agrees with no other message of its source.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[error(
    "the message is stamped {:.3} s {} than the source's other messages and is dropped: a clock's change is \
     accepted when {STEP_MESSAGES} messages agree",
    .ahead_s.abs(), if *.ahead_s > 0.0 { "later" } else { "earlier" }
)]
pub struct OutlierError {
    /// Seconds that the stamp is later than expected.
    pub ahead_s: f64,
}

/// Messages whose delays are far from the bound, but maybe agree.
#[derive(Clone, Copy, Debug, Default)]
pub struct Suspects {
    /// Their delays, the first `count` of them.
    pub delays: [f64; STEP_MESSAGES],
    /// The number of suspects.
    pub count: usize,
    since: f64,
    last: f64,
}

impl Suspects {
    /// Adds a delay; returns the largest of the delays once enough agree.
    pub fn add(&mut self, at: f64, delay: f64) -> Option<f64> {
        let agrees = self.delays[..self.count].iter().all(|other| (other - delay).abs() <= AGREEMENT_S);
        if self.count == 0 || !agrees || at > self.since + AGREEMENT_SPAN_S {
            *self = Self { count: 1, since: at, last: at, ..Self::default() };
            self.delays[0] = delay;
        } else if at > self.last {
            // What arrives together is one message, or the parts of one.
            self.last = at;
            self.delays[self.count] = delay;
            self.count += 1;
        }
        if self.count < STEP_MESSAGES {
            return None;
        }
        self.count = 0;
        self.delays.into_iter().reduce(f64::max)
    }

    /// Returns how far apart the delays are that agreed last, seconds.
    pub fn spread_s(&self) -> f64 {
        let [low, high] = [f64::min, f64::max].map(|of| self.delays.into_iter().reduce(of).unwrap_or(0.0));
        high - low
    }
}
