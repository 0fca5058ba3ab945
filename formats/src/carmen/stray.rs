//! Leaves out messages with single wrong stamps: a stamp in the far future would make all that follow look old.

use msg::Stamp;
use std::collections::VecDeque;

/// A stamp that is later than the one before by more than this is in doubt, seconds: as the bridge and bags have it.
const STEP_S: f64 = 1.0;
/// So many messages in a row that are later show a pause of the log; fewer, after which the time goes on as before, are wrong.
const STEP_MESSAGES: usize = 5;

/// Messages in the order of a log, with a few that are held back until the next ones show whether their stamps are right.
#[derive(Debug)]
pub struct StrayFilter<T> {
    /// Messages that were read ahead at the beginning.
    ahead: VecDeque<T>,
    /// Messages whose stamps are in doubt.
    doubtful: VecDeque<T>,
    /// Messages whose stamps are right.
    ready: VecDeque<T>,
    /// Stamp of the newest message whose stamp is right.
    newest: Option<Stamp>,
    left_out: u64,
}

impl<T> Default for StrayFilter<T> {
    fn default() -> Self {
        Self {
            ahead: VecDeque::new(),
            doubtful: VecDeque::new(),
            ready: VecDeque::new(),
            newest: None,
            left_out: 0,
        }
    }
}

impl<T> StrayFilter<T> {
    /// Returns the next message of `source` whose stamp is not in the far future of those after it.
    pub fn next(&mut self, mut source: impl FnMut() -> Option<T>, stamp: impl Fn(&T) -> Stamp) -> Option<T> {
        if self.newest.is_none() {
            self.begin(&mut source, &stamp);
        }
        loop {
            if let Some(message) = self.ready.pop_front() {
                self.newest = Some(stamp(&message));
                return Some(message);
            }
            let Some(message) = self.ahead.pop_front().or_else(&mut source) else {
                // Nothing after them says that they are wrong.
                self.ready = std::mem::take(&mut self.doubtful);
                if self.ready.is_empty() {
                    return None;
                }
                continue;
            };
            if self.newest.is_none_or(|newest| stamp(&message) - newest <= STEP_S) {
                self.left_out += self.doubtful.len() as u64;
                self.doubtful.clear();
                self.ready.push_back(message);
            } else {
                self.doubtful.push_back(message);
                if self.doubtful.len() == STEP_MESSAGES {
                    self.ready = std::mem::take(&mut self.doubtful);
                }
            }
        }
    }

    /// Reads the first messages, and leaves out those at the very beginning that are in the far future of the others.
    fn begin(&mut self, source: &mut impl FnMut() -> Option<T>, stamp: &impl Fn(&T) -> Stamp) {
        self.ahead.extend(std::iter::from_fn(source).take(STEP_MESSAGES));
        while let Some(first) = self.ahead.front().map(stamp)
            && let Some(earliest) = self.ahead.iter().skip(1).map(stamp).min()
            && first - earliest > STEP_S
        {
            self.ahead.pop_front();
            self.left_out += 1;
        }
    }

    /// Number of messages that were left out so far.
    pub fn left_out(&self) -> u64 {
        self.left_out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Filters messages with these stamps, seconds. Returns what is left, and how many are left out.
    fn filtered(stamps_s: &[f64]) -> (Vec<f64>, u64) {
        let mut filter = StrayFilter::default();
        let mut source = stamps_s.iter().copied();
        let kept =
            std::iter::from_fn(|| filter.next(|| source.next(), |s| Stamp::from_seconds(*s))).collect();
        (kept, filter.left_out())
    }

    #[test]
    fn stamps_in_the_far_future_are_left_out_wherever_they_are_and_nothing_else() {
        let regular: Vec<f64> = (0..30).map(|step| 100.0 + 0.2 * f64::from(step)).collect();
        assert_eq!(filtered(&regular), (regular.clone(), 0));
        for at in 0..29 {
            for count in 1..STEP_MESSAGES {
                let mut stamps = regular.clone();
                (0..count).for_each(|k| stamps.insert(at, 1100.0 + k as f64));
                assert_eq!(filtered(&stamps), (regular.clone(), count as u64), "{count} at {at}");
            }
        }
    }

    #[test]
    fn pauses_and_clocks_that_are_set_back_lose_nothing() {
        let pause = [1.0, 1.2, 1.4, 60.0, 60.2, 60.4, 60.6, 60.8, 61.0, 200.0, 200.1];
        assert_eq!(filtered(&pause), (pause.to_vec(), 0));
        let back: Vec<f64> = (0..10).map(|k| 100.0 + f64::from(k)).chain((0..10).map(f64::from)).collect();
        assert_eq!(filtered(&back), (back.clone(), 0));
        for few in [&[][..], &[5.0], &[5.0, 900.0]] {
            assert_eq!(filtered(few), (few.to_vec(), 0));
        }
    }
}
