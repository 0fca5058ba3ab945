//! Clocks that were set back while a bag was recorded: messages keep the order in which they were recorded.

use msg::Stamp;

/// Step back of a stamp that is a clock set back and no late message, seconds.
pub const STEP_MIN_S: f64 = 1.0;
/// Stamps in order that make a new time, as for a live robot: fewer are single wrong stamps.
const IN_ORDER: usize = 5;
/// Newest messages of a time that are searched for single wrong stamps.
const SEARCHED: usize = 4 * IN_ORDER;
/// Longest pause between two times of a clock that is kept, nanoseconds: one hour.
const PAUSE_MAX_NS: i64 = 3_600_000_000_000;
/// Shortest pause between two times of a clock, nanoseconds.
pub const PAUSE_MIN_NS: i64 = 1_000_000;

/// A message with its times.
#[derive(Clone, Debug, PartialEq)]
pub struct Timed<T> {
    /// When it was recorded.
    pub at: Stamp,
    /// Its own stamp.
    pub stamp: Stamp,
    /// What it says.
    pub value: T,
}

/// Messages of one topic, split where the clock of their stamps was set back.
#[derive(Debug)]
pub struct Epochs<T> {
    /// Messages between two steps of the clock, in the order in which they were recorded.
    pub epochs: Vec<Vec<Timed<T>>>,
    /// Messages with single wrong stamps, which are left out.
    pub stray: u64,
}

impl<T> Epochs<T> {
    /// Splits messages, which are brought into the order in which they were recorded.
    pub fn new(mut messages: Vec<Timed<T>>) -> Self {
        messages.sort_by_key(|message| message.at);
        let (mut epochs, mut stray) = (vec![Vec::new()], 0);
        let mut series: Vec<Timed<T>> = Vec::new();
        let mut newest: Option<Stamp> = None;
        for message in messages {
            let current = epochs.last_mut().expect("there is always an epoch");
            if newest.is_none_or(|newest| newest - message.stamp <= STEP_MIN_S) {
                stray += series.len() as u64;
                series.clear();
                newest = newest.max(Some(message.stamp));
                current.push(message);
                continue;
            }
            if series.last().is_some_and(|last| message.stamp < last.stamp) {
                stray += series.len() as u64;
                series.clear();
            }
            newest = if series.len() + 1 == IN_ORDER { Some(message.stamp) } else { newest };
            series.push(message);
            if series.len() < IN_ORDER {
                continue;
            }
            // What goes back may be a few messages with wrong stamps ahead of all others.
            let begins = series[0].stamp;
            let searched = current.len().saturating_sub(SEARCHED);
            let ahead = current[searched..].iter().filter(|message| message.stamp > begins).count();
            if ahead < IN_ORDER {
                stray += ahead as u64;
                let mut recent = current.split_off(searched);
                recent.retain(|message| message.stamp <= begins);
                current.append(&mut recent);
                current.append(&mut series);
            } else {
                epochs.push(std::mem::take(&mut series));
            }
        }
        stray += series.len() as u64;
        Self { epochs, stray }
    }

    /// Returns how often the clock was set back.
    pub fn steps(&self) -> usize {
        self.epochs.len() - 1
    }

    /// Returns first and last message of each time, as when recorded and by stamp.
    pub fn ends(&self) -> Vec<Option<Ends>> {
        let ends = |epoch: &Vec<Timed<T>>| {
            let times = || epoch.iter().map(|message| (message.stamp, message.at));
            Some(Ends { first: times().min()?, last: times().max()? })
        };
        self.epochs.iter().map(ends).collect()
    }

    /// Returns the messages in order of their stamps, after the shift of each time in nanoseconds.
    pub fn joined(self, shifts_ns: &[i64]) -> Vec<Timed<T>> {
        let shift = shifts_ns.iter().copied().chain(std::iter::repeat(0));
        let mut joined = Vec::new();
        for (epoch, shift_ns) in self.epochs.into_iter().zip(shift) {
            joined.extend(epoch.into_iter().map(|mut message| {
                message.stamp = Stamp(message.stamp.0.saturating_add(shift_ns));
                message
            }));
        }
        joined.sort_by_key(|message| message.stamp);
        joined
    }
}

/// First and last message of one time: stamp, and when it was recorded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ends {
    first: (Stamp, Stamp),
    last: (Stamp, Stamp),
}

impl Ends {
    /// Returns the ends of the messages of two topics.
    pub fn union(self, other: Self) -> Self {
        Self { first: self.first.min(other.first), last: self.last.max(other.last) }
    }
}

/// Returns the shift of each time in nanoseconds, with which each begins after the one before, by the pause with which they
/// were recorded.
pub fn shifts_ns(ends: &[Option<Ends>]) -> Vec<i64> {
    let mut shifts = Vec::with_capacity(ends.len());
    let mut before: Option<(Stamp, Stamp)> = None;
    for ends in ends {
        let Some(Ends { first, last }) = ends else {
            shifts.push(0);
            continue;
        };
        let shift = before.map_or(0, |(stamp, at)| {
            let pause = first.1.0.saturating_sub(at.0).clamp(PAUSE_MIN_NS, PAUSE_MAX_NS);
            stamp.0.saturating_add(pause).saturating_sub(first.0.0)
        });
        before = Some((Stamp(last.0.0.saturating_add(shift)), last.1));
        shifts.push(shift);
    }
    shifts
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(stamps_s: &[f64]) -> Epochs<()> {
        let message = |(index, stamp_s): (usize, &f64)| Timed {
            at: Stamp::from_seconds(1000.0 + 0.1 * index as f64),
            stamp: Stamp::from_seconds(*stamp_s),
            value: (),
        };
        Epochs::new(stamps_s.iter().enumerate().map(message).collect())
    }

    fn series(from_s: f64, count: usize) -> Vec<f64> {
        (0..count).map(|index| from_s + 0.1 * index as f64).collect()
    }

    #[test]
    fn a_clock_that_was_set_back_goes_on_with_the_pause_of_the_recording() {
        let epochs = at(&[series(50.0, 20), series(20.0, 20)].concat());
        assert_eq!((epochs.steps(), epochs.stray), (1, 0));
        let shifts = shifts_ns(&epochs.ends());
        let joined = epochs.joined(&shifts);
        for (index, message) in joined.iter().enumerate() {
            let expected_s = 50.0 + 0.1 * index as f64;
            assert!((message.stamp.seconds() - expected_s).abs() < 1e-6, "{index}: {:?}", message.stamp);
        }
    }

    #[test]
    fn single_wrong_stamps_are_left_out_and_counted() {
        for wrong_s in [20.0, 4000.0] {
            let stamps = [series(50.0, 20), vec![wrong_s], series(52.0, 20)].concat();
            let epochs = at(&stamps);
            assert_eq!((epochs.steps(), epochs.stray, epochs.epochs[0].len()), (0, 1, 40), "{wrong_s}");
        }
        let short = at(&[series(50.0, 20), series(20.0, 4)].concat());
        assert_eq!((short.steps(), short.stray), (0, 4));
    }

    #[test]
    fn late_messages_are_sorted() {
        let mut stamps = series(50.0, 20);
        stamps.swap(3, 9);
        let epochs = at(&stamps);
        assert_eq!((epochs.steps(), epochs.stray), (0, 0));
        assert!(epochs.joined(&[]).is_sorted_by_key(|message| message.stamp));
    }
}
