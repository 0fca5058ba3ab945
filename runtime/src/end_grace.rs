//! How long the launcher waits for its processes to end before it kills them.

use msg::Monotonic;
use std::time::Duration;

/// How long a process may take to end when asked, before it is killed. The whole fleet ends within
/// 5 s, of which the maps' writing takes some.
pub const END_GRACE: Duration = Duration::from_secs(2);
/// The same for the recorder and SLAM, which write what waits for a slow disk.
pub const WRITER_END_GRACE: Duration = Duration::from_secs(20);

/// The time that processes have which were asked to end together. A further Ctrl-C leaves them [`END_GRACE`] from then on.
#[derive(Clone, Copy, Debug)]
pub struct EndGrace {
    asked: Monotonic,
    /// When a further Ctrl-C was seen first.
    hurried: Option<Monotonic>,
}

impl EndGrace {
    /// Begins when the processes are `asked` to end.
    pub fn new(asked: Monotonic) -> Self {
        Self { asked, hurried: None }
    }

    /// Says that a further Ctrl-C was seen. Only the first call counts.
    pub fn hurry(&mut self, now: Monotonic) {
        self.hurried.get_or_insert(now);
    }

    /// Returns whether somebody asked to kill what does not end.
    pub fn is_hurried(&self) -> bool {
        self.hurried.is_some()
    }

    /// Returns the time since the processes were asked.
    pub fn elapsed(&self, now: Monotonic) -> Duration {
        Duration::from_nanos(now.since(self.asked))
    }

    /// Returns whether a process that has `grace` is to be killed.
    pub fn is_over(&self, grace: Duration, now: Monotonic) -> bool {
        let is_hurry_over = self.hurried.is_some_and(|at| Duration::from_nanos(now.since(at)) >= END_GRACE);
        is_hurry_over || self.elapsed(now) >= grace
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_process_has_its_grace_and_after_a_further_request_some_time_all_the_same() {
        let end_ms = END_GRACE.as_millis() as u64;
        let at = |ms: u64| Monotonic((5 + ms) * 1_000_000);
        let times_ms = || (0..30_000).step_by(499);
        for grace in [END_GRACE, WRITER_END_GRACE] {
            for hurried_ms in times_ms().map(Some).chain([None]) {
                let mut patience = EndGrace::new(at(0));
                if let Some(ms) = hurried_ms {
                    patience.hurry(at(ms));
                    patience.hurry(at(ms + 1));
                }
                let all_ms = (grace.as_millis() as u64).min(hurried_ms.map_or(u64::MAX, |ms| ms + end_ms));
                for elapsed_ms in times_ms().chain([all_ms - 1, all_ms]) {
                    assert_eq!(patience.is_over(grace, at(elapsed_ms)), elapsed_ms >= all_ms);
                }
                assert!(!patience.is_over(grace, at(end_ms - 1)), "nobody is killed at once");
            }
        }
    }
}
