//! Watchdog of one thread of a process: tells a hung thread from a slow one. Decisions only, in any clock's time.
//!
//! A thread that works counts on at least once a second (see [`crate::progress`]). When the count stands still, the
//! operating system says why: a thread that is stopped, or that sleeps without using a processor, is hung. One that
//! computes, waits for a processor or for the disk is slow, and is left alone.

use msg::Monotonic;
use std::fmt;
use std::time::Duration;

/// Longest time that one poll adds to a silence. When the watcher itself was stopped, or the whole machine was frozen,
/// the threads get time to count on before they are judged.
const POLL_GAP_MAX: Duration = Duration::from_millis(250);
/// Smallest share of a processor that a thread uses in a silence if it computes. A thread that hangs uses none.
const BUSY_SHARE_MIN: f64 = 0.05;
/// Silence after which a thread that computes counts as hung all the same, in multiples of the silence that is
/// reported: a loop that never ends.
const ENDLESS_FACTOR: u32 = 30;

/// What the operating system says about a thread.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ThreadState {
    /// It runs or waits for a processor.
    Runnable,
    /// It waits for an event.
    Sleeping,
    /// It waits for the disk and cannot be interrupted.
    Disk,
    /// It is stopped by a signal.
    Stopped,
    /// A debugger holds it.
    Traced,
    /// It is ending, or cannot be looked at.
    Gone,
}

/// State of a thread at one moment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ThreadSample {
    /// What it does.
    pub state: ThreadState,
    /// Processor time that it has used since its start.
    pub cpu: Duration,
}

/// Finding about a thread; each is reported once in a silence.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Finding {
    /// It has not counted on, but lives: it is left alone.
    Slow {
        /// Length of the silence.
        silence: Duration,
    },
    /// It counts on again after it was slow.
    Recovered {
        /// Length of the silence.
        silence: Duration,
    },
    /// It does not come back by itself: the process must be replaced.
    Hung {
        /// Length of the silence.
        silence: Duration,
        /// State in which it hangs.
        state: ThreadState,
    },
}

/// What a thread has or has not done, to follow its name.
impl fmt::Display for Finding {
    fn fmt(&self, to: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Slow { silence } => {
                write!(to, "has not answered for {:.1} s but works; left alone", silence.as_secs_f64())
            }
            Self::Recovered { silence } => write!(to, "answers again after {:.1} s", silence.as_secs_f64()),
            Self::Hung { silence, state } => {
                let why = match state {
                    ThreadState::Stopped => "stopped by a signal",
                    ThreadState::Sleeping => "blocked",
                    _ => "computes without end",
                };
                write!(to, "has not answered for {:.1} s ({why}): replaced", silence.as_secs_f64())
            }
        }
    }
}

/// Watches one thread.
#[derive(Clone, Debug)]
pub struct Watchdog {
    /// Silence after which the thread is judged, before its first count and after it.
    limit: Duration,
    silence_max: Duration,
    count: u64,
    polled: Monotonic,
    silence: Duration,
    /// Silence and processor time of the first sample of this silence.
    first_sample: Option<(Duration, Duration)>,
    is_reported: bool,
}

impl Watchdog {
    /// Creates a watchdog that judges a thread when it has not counted on for `silence_max`. Its start may take
    /// `start_max`.
    pub fn new(start_max: Duration, silence_max: Duration, now: Monotonic) -> Self {
        Self {
            limit: start_max,
            silence_max,
            count: 0,
            polled: now,
            silence: Duration::ZERO,
            first_sample: None,
            is_reported: false,
        }
    }

    /// Compares the thread's count with that of the poll before. `sample` is called only in a silence.
    pub fn poll(
        &mut self,
        now: Monotonic,
        count: u64,
        sample: impl FnOnce() -> ThreadSample,
    ) -> Option<Finding> {
        let gap = Duration::from_nanos(now.since(self.polled)).min(POLL_GAP_MAX);
        self.polled = now;
        if count != self.count {
            let recovered = self.is_reported.then_some(Finding::Recovered { silence: self.silence + gap });
            *self = Self { count, ..Self::new(self.silence_max, self.silence_max, now) };
            return recovered;
        }
        self.silence += gap;
        // Half of the silence tells whether the thread uses a processor.
        if self.silence < self.limit / 2 {
            return None;
        }
        let sample = sample();
        let (since, cpu) = *self.first_sample.get_or_insert((self.silence, sample.cpu));
        if self.silence < self.limit {
            return None;
        }
        let span = self.silence.saturating_sub(since).as_secs_f64();
        let is_busy = sample.cpu.saturating_sub(cpu).as_secs_f64() > BUSY_SHARE_MIN * span;
        let hangs = match sample.state {
            ThreadState::Stopped => true,
            ThreadState::Runnable | ThreadState::Sleeping if is_busy => {
                self.silence >= self.limit * ENDLESS_FACTOR
            }
            ThreadState::Sleeping => true,
            // It waits for a processor or the disk, or somebody debugs it.
            ThreadState::Runnable | ThreadState::Disk | ThreadState::Traced | ThreadState::Gone => false,
        };
        let silence = self.silence;
        match hangs {
            true => Some(Finding::Hung { silence, state: sample.state }),
            false if self.is_reported => None,
            false => {
                self.is_reported = true;
                Some(Finding::Slow { silence })
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const START: Duration = Duration::from_secs(10);
    const LIMIT: Duration = Duration::from_secs(2);
    const POLL_MS: u64 = 50;

    /// Polls a thread that counts on at the milliseconds that `counts` accepts, and returns the findings with their
    /// times in milliseconds. A hung thread is not polled any more.
    fn watch(
        until_ms: u64,
        counts: impl Fn(u64) -> bool,
        sample: impl Fn(u64) -> ThreadSample,
    ) -> Vec<(u64, Finding)> {
        let at = |ms: u64| Monotonic(ms * 1_000_000);
        let (mut watchdog, mut count, mut found) = (Watchdog::new(START, LIMIT, at(0)), 0, Vec::new());
        for ms in (POLL_MS..=until_ms).step_by(POLL_MS as usize) {
            count += u64::from(counts(ms));
            if let Some(finding) = watchdog.poll(at(ms), count, || sample(ms)) {
                found.push((ms, finding));
                if matches!(finding, Finding::Hung { .. }) {
                    break;
                }
            }
        }
        found
    }

    fn idle(state: ThreadState) -> impl Fn(u64) -> ThreadSample {
        move |_| ThreadSample { state, cpu: Duration::from_secs(7) }
    }

    fn busy(state: ThreadState) -> impl Fn(u64) -> ThreadSample {
        move |ms| ThreadSample { state, cpu: Duration::from_millis(ms / 2) }
    }

    #[test]
    fn a_thread_that_counts_on_once_a_second_is_never_reported() {
        assert_eq!(watch(60_000, |ms| ms % 1000 == 0, idle(ThreadState::Sleeping)), []);
    }

    #[test]
    fn a_stopped_and_a_blocked_thread_are_hung_after_the_limit() {
        for state in [ThreadState::Stopped, ThreadState::Sleeping] {
            let hung = Finding::Hung { silence: LIMIT, state };
            assert_eq!(watch(60_000, |ms| ms <= 5000, idle(state)), [(7000, hung)]);
        }
        // A stopped thread hangs, whatever it did before.
        let hung = Finding::Hung { silence: LIMIT, state: ThreadState::Stopped };
        assert_eq!(watch(60_000, |ms| ms <= 5000, busy(ThreadState::Stopped)), [(7000, hung)]);
    }

    #[test]
    fn a_thread_that_computes_is_reported_once_and_left_alone() {
        let counts = |ms| ms <= 5000 || ms >= 15_000;
        let expected = [
            (7000, Finding::Slow { silence: LIMIT }),
            (15_000, Finding::Recovered { silence: Duration::from_secs(10) }),
        ];
        assert_eq!(watch(20_000, counts, busy(ThreadState::Runnable)), expected);
        assert_eq!(watch(20_000, counts, busy(ThreadState::Sleeping)), expected);
    }

    #[test]
    fn a_thread_that_computes_for_ever_is_hung_in_the_end() {
        let found = watch(200_000, |ms| ms <= 5000, busy(ThreadState::Runnable));
        let (silence, state) = (LIMIT * ENDLESS_FACTOR, ThreadState::Runnable);
        assert_eq!(found.last(), Some(&(65_000, Finding::Hung { silence, state })));
        assert_eq!(found.len(), 2);
    }

    #[test]
    fn a_thread_without_a_processor_or_disk_and_one_in_a_debugger_are_never_hung() {
        for state in [ThreadState::Runnable, ThreadState::Disk, ThreadState::Traced, ThreadState::Gone] {
            let found = watch(600_000, |ms| ms <= 5000, idle(state));
            assert_eq!(found, [(7000, Finding::Slow { silence: LIMIT })], "{state:?}");
        }
    }

    #[test]
    fn a_start_may_take_longer_than_a_silence_but_not_for_ever() {
        let found = watch(60_000, |ms| ms >= 9000 && ms % 1000 == 0, idle(ThreadState::Sleeping));
        assert_eq!(found, []);
        let hung = Finding::Hung { silence: START, state: ThreadState::Sleeping };
        assert_eq!(watch(60_000, |_| false, idle(ThreadState::Sleeping)), [(10_000, hung)]);
    }

    #[test]
    fn after_a_pause_of_the_watcher_the_threads_get_time_to_count_on() {
        let mut watchdog = Watchdog::new(START, LIMIT, Monotonic(0));
        let sleeping = || ThreadSample { state: ThreadState::Sleeping, cpu: Duration::ZERO };
        assert_eq!(watchdog.poll(Monotonic(1), 1, sleeping), None);
        // Each hour the machine was frozen for an hour: that is one poll's gap of silence.
        let hour = 3_600_000_000_000;
        for count in 1..100 {
            assert_eq!(watchdog.poll(Monotonic(count * hour), count, sleeping), None);
            for ms in (0..1000).step_by(POLL_MS as usize) {
                assert_eq!(watchdog.poll(Monotonic(count * hour + ms * 1_000_000), count, sleeping), None);
            }
        }
    }
}
