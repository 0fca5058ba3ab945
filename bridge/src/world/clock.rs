//! Estimates how far another machine's clock is from the run's, from nothing but its stamped messages.
//!
//! A message stamped `s` there that arrives here at `a` has the apparent delay `d = a - s`: its transit time less the
//! clocks' offset. `d` is close to its minimum whenever a message meets no queue. The lower bound of all `d` is
//! therefore the negative offset plus the shortest transit time, a fraction of a millisecond on a LAN, which
//! one-way messages cannot tell from the offset.
//!
//! Clocks drift, so that the bound is a line. It is fitted to the smallest delay of each second of the last minute: of
//! their lower convex hull, the edge below their mean time, which is the line under all points with the least sum of
//! distances (Zhang, Liu and Xia, "Clock synchronization algorithms for network measurements", INFOCOM 2002).

use super::suspects::{OutlierError, STEP_MESSAGES, Suspects};
use msg::Stamp;
use serde::{Deserialize, Serialize};

/// Seconds that are remembered, one smallest delay each.
const SECONDS_MAX: usize = 60;
/// A shorter memory determines no drift: until then the bound is level, seconds.
const DRIFT_SPAN_S: f64 = 20.0;
/// Two quartz clocks drift apart less than this, seconds per second; a steeper edge is a growing queue.
const DRIFT_MAX: f64 = 200e-6;
/// Messages this far from the bound mean that the source's clock was set, if [`STEP_MESSAGES`] agree, seconds.
const STEP_S: f64 = 1.0;
/// As many whole seconds far above the bound mean that the clock was set back: networks stall for shorter.
const STEP_SECONDS: u32 = 3;
/// A message this far below the bound is accepted only if others agree, seconds: no network delivers so early.
const OUTLIER_S: f64 = 0.05;
/// The offset in use follows the estimate at most at this rate, seconds per second, so that stamps stay in order ...
const SLEW_RATE: f64 = 0.01;
/// ... unless it is farther off than this, seconds, or the clock is younger than [`SETTLE_S`].
const SLEW_FROM_S: f64 = 0.05;
/// In its first seconds the estimate is used without slewing: the bound falls fast.
const SETTLE_S: f64 = 2.0;
/// Delays that are remembered for their spread.
const DELAYS_MAX: usize = 512;

/// How a source's stamps become the run's.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(untagged, expecting = "expected \"measured\", or seconds without quotes")]
pub enum ClockOffset {
    /// `"measured"`: estimated from when messages arrive.
    #[default]
    #[serde(with = "measured")]
    Measured,
    /// Seconds that the source's clock is ahead of ours; 0 takes stamps as they are.
    Fixed(f64),
}

/// The word for [`ClockOffset::Measured`] in a file.
mod measured {
    use serde::{Deserialize, Deserializer, Serializer, de::Error};

    const WORD: &str = "measured";

    pub fn serialize<S: Serializer>(to: S) -> Result<S::Ok, S::Error> {
        to.serialize_str(WORD)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<(), D::Error> {
        let word = String::deserialize(from)?;
        if word == WORD { Ok(()) } else { Err(D::Error::custom("expected \"measured\" or seconds")) }
    }
}

/// The estimate of a source's clock.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ClockEstimate {
    /// Seconds that the clock is ahead of ours, as applied.
    pub offset_s: f64,
    /// Parts per million that the clock is faster than ours.
    pub drift_ppm: f64,
    /// Median of how much longer than the shortest the recent transit times were, milliseconds.
    pub spread_p50_ms: f64,
    /// The 95th percentile of the same, milliseconds.
    pub spread_p95_ms: f64,
    /// Messages that the estimate is from.
    pub messages: u64,
    /// How often the clock was found to be set anew.
    pub steps: u64,
    /// Messages that were dropped because their stamp agrees with no other message's.
    #[serde(default)]
    pub outliers: u64,
}

/// The lower bound of the delays: a line over time. All in seconds since the first message.
#[derive(Clone, Copy, Debug, Default)]
struct LowerBound {
    at: f64,
    /// Height at the time `at`.
    height: f64,
    slope: f64,
}

impl LowerBound {
    fn height_at(&self, at: f64) -> f64 {
        self.height + self.slope * (at - self.at)
    }
}

/// The second under way. All in seconds since the first message.
#[derive(Clone, Copy, Debug, Default)]
struct OpenSecond {
    end: f64,
    /// When the smallest delay was.
    at: f64,
    smallest_delay: f64,
}

/// The newest delays above the bound, in a ring.
#[derive(Debug)]
struct DelayHistory {
    delays: Vec<f32>,
    next: usize,
}

impl DelayHistory {
    fn push(&mut self, delay: f64) {
        if self.delays.len() < DELAYS_MAX {
            self.delays.push(delay as f32);
        } else {
            self.delays[self.next] = delay as f32;
            self.next = (self.next + 1) % DELAYS_MAX;
        }
    }

    fn clear(&mut self) {
        self.delays.clear();
        self.next = 0;
    }

    /// Returns the delays at these fractions of the sorted history, milliseconds.
    fn quantiles_ms<const N: usize>(&self, fractions: [f64; N]) -> [f64; N] {
        let mut delays = self.delays.clone();
        delays.sort_unstable_by(f32::total_cmp);
        fractions.map(|fraction| {
            let index = (fraction * delays.len() as f64) as usize;
            delays.get(index).or(delays.last()).map_or(0.0, |delay| f64::from(*delay) * 1e3)
        })
    }
}

/// The clock of one source: of a client, or of a machine on the network.
// More than 12 fields: the estimate, and what is remembered until it is accepted as changed.
#[derive(Debug)]
pub struct SourceClock {
    setting: ClockOffset,
    /// Stamp and arrival of the first message: times count from there.
    origin: Option<(Stamp, Stamp)>,
    /// (time, smallest delay) of each whole second, oldest first.
    seconds: Vec<(f64, f64)>,
    open: OpenSecond,
    bound: LowerBound,
    /// The bound's height as applied to stamps.
    applied: f64,
    /// When the clock was first used, or found to be set anew.
    since: f64,
    /// Whole seconds in a row that were far above the bound.
    far_seconds: u32,
    suspects: Suspects,
    /// Messages that arrived one after the other and support the bound, up to [`STEP_MESSAGES`].
    support: usize,
    history: DelayHistory,
    messages: u64,
    steps: u64,
    outliers: u64,
    /// Seconds by which the clock was set, until [`SourceClock::take_step`].
    step_s: Option<f64>,
}

impl SourceClock {
    /// Creates the clock of a source that has sent nothing yet.
    pub fn new(setting: ClockOffset) -> Self {
        Self {
            setting,
            origin: None,
            seconds: Vec::with_capacity(SECONDS_MAX),
            open: OpenSecond::default(),
            bound: LowerBound::default(),
            applied: 0.0,
            since: 0.0,
            far_seconds: 0,
            suspects: Suspects::default(),
            support: 0,
            history: DelayHistory { delays: Vec::with_capacity(DELAYS_MAX), next: 0 },
            messages: 0,
            steps: 0,
            outliers: 0,
            step_s: None,
        }
    }

    /// Measures a message that its source stamped `stamp` and that arrived at `received`; returns its stamp by the
    /// run's time.
    ///
    /// Fails if the stamp is far from what the source's other messages lead to expect. If several messages in a row
    /// agree, the source's clock was set, and they are right.
    pub fn convert(&mut self, stamp: Stamp, received: Stamp) -> Result<Stamp, OutlierError> {
        self.messages += 1;
        if self.setting == ClockOffset::Measured {
            let (first_stamp, first_received) = *self.origin.get_or_insert((stamp, received));
            let (at, sent) = (received - first_received, stamp - first_stamp);
            if let Err(outlier) = self.add_delay(at, at - sent) {
                self.outliers += 1;
                return Err(outlier);
            }
        }
        Ok(self.translate(stamp))
    }

    /// Returns by how many seconds the source's clock was found to be set since the last call.
    pub fn take_step(&mut self) -> Option<f64> {
        self.step_s.take()
    }

    /// Converts a stamp of the source into the run's time, by what is known now.
    pub fn translate(&self, stamp: Stamp) -> Stamp {
        match (self.setting, self.origin) {
            (ClockOffset::Fixed(offset_s), _) => Stamp(stamp.0.saturating_sub((offset_s * 1e9) as i64)),
            (ClockOffset::Measured, None) => stamp,
            (ClockOffset::Measured, Some((first_stamp, first_received))) => {
                let shift = first_received.0.wrapping_sub(first_stamp.0);
                Stamp(stamp.0.wrapping_add(shift).wrapping_add((self.applied * 1e9) as i64))
            }
        }
    }

    /// Returns the estimate; `None` before the first message.
    pub fn estimate(&self) -> Option<ClockEstimate> {
        if self.messages == 0 {
            return None;
        }
        let offset_s = match (self.setting, self.origin) {
            (ClockOffset::Fixed(offset_s), _) => offset_s,
            (ClockOffset::Measured, Some((stamp, received))) => (stamp - received) - self.applied,
            (ClockOffset::Measured, None) => 0.0,
        };
        let [spread_p50_ms, spread_p95_ms] = self.history.quantiles_ms([0.5, 0.95]);
        Some(ClockEstimate {
            offset_s,
            drift_ppm: -self.bound.slope * 1e6,
            spread_p50_ms,
            spread_p95_ms,
            messages: self.messages,
            steps: self.steps,
            outliers: self.outliers,
        })
    }

    /// Adds a message that arrived `at` seconds after the first, with this much more delay than it.
    fn add_delay(&mut self, at: f64, delay: f64) -> Result<(), OutlierError> {
        if self.messages == 1 {
            self.open = OpenSecond { end: at + 1.0, at, smallest_delay: delay };
            self.bound.at = at;
            self.support = 1;
            self.history.push(0.0);
            return Ok(());
        }
        let ahead_s = self.bound.height_at(at) - delay;
        let is_established = self.support >= STEP_MESSAGES;
        let mut delay = delay;
        if ahead_s > OUTLIER_S || (!is_established && ahead_s < -STEP_S) {
            delay = self.suspects.add(at, delay).ok_or(OutlierError { ahead_s })?;
        } else if !is_established && ahead_s < -OUTLIER_S {
            // If several messages agree closely, they are not late, but the first one was too early.
            if let Some(agreed) = self.suspects.add(at, delay)
                && self.suspects.spread_s() <= OUTLIER_S
            {
                self.restart(at, agreed, false);
                return Ok(());
            }
        } else if ahead_s > -STEP_S {
            // A clock that was set sends no message of its old time any more.
            let last = self.suspects.delays[0];
            if self.suspects.count > 0 && (last - self.bound.height_at(at)).abs() > STEP_S {
                self.suspects.count = 0;
            }
            self.support = STEP_MESSAGES.min(self.support + usize::from(at > self.bound.at));
        }
        let change_s = self.bound.height_at(at) - delay;
        if change_s > STEP_S || (!is_established && change_s < -STEP_S) || self.far_seconds >= STEP_SECONDS {
            self.restart(at, delay, is_established);
            return Ok(());
        }
        let slew = SLEW_RATE * (at - self.bound.at).clamp(0.0, 1.0);
        if at >= self.open.end {
            self.close_second();
            self.open = OpenSecond { end: at + 1.0, at, smallest_delay: delay };
        } else if delay < self.open.smallest_delay {
            (self.open.at, self.open.smallest_delay) = (at, delay);
        }
        let height = self.bound.height_at(at).min(delay);
        (self.bound.height, self.bound.at) = (height, at);
        self.history.push(delay - height);
        let error = height - self.applied;
        self.applied = if at < self.since + SETTLE_S || error.abs() > SLEW_FROM_S {
            height
        } else {
            self.applied + error.clamp(-slew, slew)
        };
        Ok(())
    }

    /// Starts the estimate anew, because the source's clock was set: earlier measurements are void.
    ///
    /// Before several messages have agreed, it was not set: the first messages were wrong.
    fn restart(&mut self, at: f64, delay: f64, was_set: bool) {
        if was_set {
            self.steps += 1;
            self.step_s = Some(self.step_s.unwrap_or(0.0) + self.applied - delay);
        }
        self.support = STEP_MESSAGES;
        self.seconds.clear();
        self.history.clear();
        self.far_seconds = 0;
        self.bound = LowerBound { at, height: delay, slope: 0.0 };
        self.applied = delay;
        self.open = OpenSecond { end: at + 1.0, at, smallest_delay: delay };
        self.since = at;
    }

    /// Adds the smallest delay of the second that is over, and fits the bound to all seconds.
    fn close_second(&mut self) {
        let OpenSecond { at, smallest_delay, .. } = self.open;
        let is_far = smallest_delay > self.bound.height_at(at) + STEP_S;
        self.far_seconds = if is_far { self.far_seconds + 1 } else { 0 };
        if is_far {
            return;
        }
        if self.seconds.len() == SECONDS_MAX {
            self.seconds.remove(0);
        }
        self.seconds.push((at, smallest_delay));
        let first = self.seconds[0].0;
        let lowest = self.seconds.iter().map(|(_, delay)| *delay).fold(f64::INFINITY, f64::min);
        let edge = hull_edge(&self.seconds).filter(|(_, _, slope)| slope.abs() <= DRIFT_MAX);
        self.bound = match edge {
            Some((x, height, slope)) if at - first >= DRIFT_SPAN_S => {
                LowerBound { at, height: height + slope * (at - x), slope }
            }
            _ => LowerBound { at, height: lowest, slope: 0.0 },
        };
    }
}

/// Returns a point and the slope of the lower convex hull's edge below the mean x of points sorted by x.
fn hull_edge(points: &[(f64, f64)]) -> Option<(f64, f64, f64)> {
    let mut hull = [(0.0, 0.0); SECONDS_MAX];
    let mut count = 0;
    for point in points.iter().take(SECONDS_MAX) {
        while count >= 2 && !turns_left(hull[count - 2], hull[count - 1], *point) {
            count -= 1;
        }
        hull[count] = *point;
        count += 1;
    }
    let mean = points.iter().map(|(x, _)| x).sum::<f64>() / points.len().max(1) as f64;
    let edge = hull[..count].windows(2).find(|edge| edge[0].0 <= mean && mean <= edge[1].0)?;
    let (from, to) = (edge[0], edge[1]);
    (to.0 > from.0).then(|| (from.0, from.1, (to.1 - from.1) / (to.0 - from.0)))
}

fn turns_left(a: (f64, f64), b: (f64, f64), c: (f64, f64)) -> bool {
    (b.0 - a.0) * (c.1 - a.1) - (b.1 - a.1) * (c.0 - a.0) > 0.0
}

#[cfg(test)]
mod tests;
