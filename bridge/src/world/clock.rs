//! How far another machine's clock is from ours, from nothing but what it sends.
//!
//! A message stamped `s` there that arrives here at `a` has been `d = a - s` under way, less the clocks' offset:
//! `d` is at least minus the offset, and comes near it whenever a message meets no queue. The floor under all `d`
//! is therefore the offset (plus the shortest journey, a fraction of a millisecond on a LAN, which one direction
//! cannot tell from it). Clocks drift, so the floor is a line: of the least `d` of each second of the last minute,
//! the edge of the lower convex hull below their middle, which is the line under all points that lies nearest to
//! them in sum (Zhang, Liu and Xia, "Clock synchronization algorithms for network measurements", INFOCOM 2002).

use msg::Stamp;
use serde::{Deserialize, Serialize};

/// Seconds that are remembered, one least delay each.
const SECONDS_MAX: usize = 60;
/// Shorter memories give no drift that is worth the name: until then the floor is level.
const DRIFT_SPAN_S: f64 = 20.0;
/// Two quartz clocks differ by less than this; a steeper edge is a queue that grows.
const DRIFT_MAX: f64 = 200e-6;
/// A delay this far below the floor is another clock, not a better one.
const STEP_S: f64 = 1.0;
/// As many whole seconds this far above it are, too: a clock that was set back.
const STEP_SECONDS: u32 = 3;
/// The offset in use follows the estimate at most so fast (seconds a second), so that stamps stay in order ...
const SLEW: f64 = 0.01;
/// ... unless it is further off than this, or as young as [`SETTLE_S`].
const SLEW_FROM_S: f64 = 0.05;
/// The first seconds bring the floor down fast.
const SETTLE_S: f64 = 2.0;
/// Journeys remembered for their spread.
const DELAYS_MAX: usize = 512;

/// How a source's stamps become the run's.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum ClockOffset {
    /// `"measured"`: from when messages arrive.
    #[default]
    #[serde(with = "measured")]
    Measured,
    /// Seconds that the source's clock is ahead of ours; 0 takes stamps as they come.
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

/// What is known of a source's clock.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ClockEstimate {
    /// Seconds that it is ahead of ours, as applied.
    pub offset_s: f64,
    /// Its rate, parts per million more than ours.
    pub drift_ppm: f64,
    /// How much longer than the shortest the journeys of late were, milliseconds: median.
    pub spread_p50_ms: f64,
    /// The same, 95th percentile.
    pub spread_p95_ms: f64,
    /// Messages it was measured from.
    pub messages: u64,
    /// How often the clock was set anew.
    pub steps: u64,
}

/// The clock of one source: of a client, or of a machine on the network.
#[derive(Debug)]
pub struct SourceClock {
    setting: ClockOffset,
    /// Stamp and arrival of the first message: both are counted from there.
    origin: Option<(Stamp, Stamp)>,
    /// (second, least delay in it), both in seconds since the origin, oldest first.
    seconds: Vec<(f64, f64)>,
    /// The second under way: its end, its least delay and when that was.
    open: (f64, f64, f64),
    /// The line under the delays: its height at the time `at`, and its slope.
    floor: f64,
    slope: f64,
    at: f64,
    /// The floor as applied.
    applied: f64,
    /// When this clock was first heard, or set anew.
    since: f64,
    /// Whole seconds in a row that were far above the floor.
    far: u32,
    delays: Vec<f32>,
    next_delay: usize,
    messages: u64,
    steps: u64,
}

impl SourceClock {
    /// Nothing heard yet.
    pub fn new(setting: ClockOffset) -> Self {
        Self {
            setting,
            origin: None,
            seconds: Vec::with_capacity(SECONDS_MAX),
            open: (0.0, 0.0, 0.0),
            floor: 0.0,
            slope: 0.0,
            at: 0.0,
            applied: 0.0,
            since: 0.0,
            far: 0,
            delays: Vec::with_capacity(DELAYS_MAX),
            next_delay: 0,
            messages: 0,
            steps: 0,
        }
    }

    /// The run's stamp of a message that its source stamped `stamp` and that arrived at `received` (the run's time).
    pub fn take(&mut self, stamp: Stamp, received: Stamp) -> Stamp {
        self.messages += 1;
        if self.setting == ClockOffset::Measured {
            let (first_stamp, first_received) = *self.origin.get_or_insert((stamp, received));
            let (at, sent) = (received - first_received, stamp - first_stamp);
            self.note(at, at - sent);
        }
        self.translate(stamp)
    }

    /// The run's stamp of one of the source's, by what is known now.
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

    /// What is known by now; `None` before the first message.
    pub fn estimate(&self) -> Option<ClockEstimate> {
        if self.messages == 0 {
            return None;
        }
        let offset_s = match (self.setting, self.origin) {
            (ClockOffset::Fixed(offset_s), _) => offset_s,
            (ClockOffset::Measured, Some((stamp, received))) => (stamp - received) - self.applied,
            (ClockOffset::Measured, None) => 0.0,
        };
        let mut delays = self.delays.clone();
        delays.sort_unstable_by(f32::total_cmp);
        let quantile = |share: f64| {
            let index = (share * delays.len() as f64) as usize;
            delays.get(index).or(delays.last()).map_or(0.0, |delay| f64::from(*delay) * 1e3)
        };
        Some(ClockEstimate {
            offset_s,
            drift_ppm: -self.slope * 1e6,
            spread_p50_ms: quantile(0.5),
            spread_p95_ms: quantile(0.95),
            messages: self.messages,
            steps: self.steps,
        })
    }

    /// A message arrived `at` seconds after the first, delayed by so much more than it.
    fn note(&mut self, at: f64, delay: f64) {
        if self.messages == 1 {
            (self.open, self.at) = ((at + 1.0, at, delay), at);
            return self.remember(0.0);
        }
        if delay < self.floor_at(at) - STEP_S || self.far >= STEP_SECONDS {
            return self.begin_anew(at, delay);
        }
        let slew = SLEW * (at - self.at).clamp(0.0, 1.0);
        let (end, _, least) = self.open;
        if at >= end {
            self.close_second();
            self.open = (at + 1.0, at, delay);
        } else if delay < least {
            (self.open.1, self.open.2) = (at, delay);
        }
        let floor = self.floor_at(at).min(delay);
        (self.floor, self.at) = (floor, at);
        self.remember(delay - floor);
        let error = floor - self.applied;
        self.applied = if at < self.since + SETTLE_S || error.abs() > SLEW_FROM_S {
            floor
        } else {
            self.applied + error.clamp(-slew, slew)
        };
    }

    fn floor_at(&self, at: f64) -> f64 {
        self.floor + self.slope * (at - self.at)
    }

    fn remember(&mut self, above: f64) {
        if self.delays.len() < DELAYS_MAX {
            self.delays.push(above as f32);
        } else {
            self.delays[self.next_delay] = above as f32;
            self.next_delay = (self.next_delay + 1) % DELAYS_MAX;
        }
    }

    /// The source's clock was set: what was measured before means nothing any more.
    fn begin_anew(&mut self, at: f64, delay: f64) {
        self.seconds.clear();
        self.delays.clear();
        (self.next_delay, self.far) = (0, 0);
        (self.floor, self.slope, self.at, self.applied) = (delay, 0.0, at, delay);
        (self.open, self.since) = ((at + 1.0, at, delay), at);
        self.steps += 1;
    }

    /// A second is over: its least delay joins the others, and the line is drawn anew under all of them.
    fn close_second(&mut self) {
        let (_, at, least) = self.open;
        self.far = if least > self.floor_at(at) + STEP_S { self.far + 1 } else { 0 };
        if self.seconds.len() == SECONDS_MAX {
            self.seconds.remove(0);
        }
        self.seconds.push((at, least));
        let (first, last) = (self.seconds[0].0, at);
        let lowest = self.seconds.iter().map(|(_, delay)| *delay).fold(f64::INFINITY, f64::min);
        let edge = hull_edge(&self.seconds).filter(|(_, _, slope)| slope.abs() <= DRIFT_MAX);
        (self.at, self.floor, self.slope) = match edge {
            Some((x, height, slope)) if last - first >= DRIFT_SPAN_S => {
                (at, height + slope * (at - x), slope)
            }
            _ => (at, lowest, 0.0),
        };
    }
}

/// Of the lower convex hull of points sorted by x, the edge below their mean x: a point of it and its slope.
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
    let middle = points.iter().map(|(x, _)| x).sum::<f64>() / points.len().max(1) as f64;
    let edge = hull[..count].windows(2).find(|edge| edge[0].0 <= middle && middle <= edge[1].0)?;
    let (from, to) = (edge[0], edge[1]);
    (to.0 > from.0).then(|| (from.0, from.1, (to.1 - from.1) / (to.0 - from.0)))
}

fn turns_left(a: (f64, f64), b: (f64, f64), c: (f64, f64)) -> bool {
    (b.0 - a.0) * (c.1 - a.1) - (b.1 - a.1) * (c.0 - a.0) > 0.0
}
