//! Decides when a tool stops waiting for navigation of a running fleet.
//!
//! It reads no clock and no file: time and whether the launcher is alive come in.

use crate::run::Run;
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// Longest time without a first answer: the start of a process after its death takes less.
const PATIENCE: Duration = Duration::from_secs(10);
/// Longest silence after an answer: navigation reports once a second, and a hung process is started again within 20 s.
const SILENCE_MAX: Duration = Duration::from_secs(30);

/// Silence after an answer that is said: navigation reports once a second.
const REPORT_AFTER: Duration = Duration::from_secs(3);

/// Reason why a tool waits no longer.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
pub enum WaitError {
    /// The launcher has ended, or was killed.
    #[error("run {}: the fleet has ended meanwhile; {unknown}", run.display())]
    FleetEnded {
        /// Folder of the run.
        run: PathBuf,
        /// What is not known.
        unknown: String,
    },
    /// Navigation has not answered at all.
    #[error("run {}: navigation does not answer within {} s; see `mr-slam status`", run.display(), PATIENCE.as_secs_f64())]
    Silent {
        /// Folder of the run.
        run: PathBuf,
    },
    /// Navigation has answered, and then said nothing more.
    #[error("run {}: navigation has said nothing for {} s; {unknown}; see `mr-slam status`", run.display(), SILENCE_MAX.as_secs_f64())]
    FellSilent {
        /// Folder of the run.
        run: PathBuf,
        /// What is not known.
        unknown: String,
    },
}

/// What a tool has heard while it waits.
pub(super) struct Waiting {
    heard: Instant,
    has_answer: bool,
    /// Whether the present silence was said.
    is_reported: bool,
    unknown: String,
}

impl Waiting {
    /// Begins to wait. `unknown` says what is not known if no end comes: `whether robot1 has arrived is not known`.
    pub(super) fn new(now: Instant, unknown: String) -> Self {
        Self { heard: now, has_answer: false, is_reported: false, unknown }
    }

    /// Notes that navigation has said something that belongs to the command.
    pub(super) fn hear(&mut self, now: Instant) {
        (self.heard, self.has_answer, self.is_reported) = (now, true, false);
    }

    /// Returns what to say of a silence, once for each: what was said before may not hold any more.
    pub(super) fn silence_to_report(&mut self, now: Instant) -> Option<String> {
        let is_silent = self.has_answer && now.saturating_duration_since(self.heard) > REPORT_AFTER;
        let is_new = is_silent && !std::mem::replace(&mut self.is_reported, is_silent);
        is_new.then(|| {
            let [silent_s, most_s] = [REPORT_AFTER, SILENCE_MAX].map(|time| time.as_secs_f64());
            format!("navigation has said nothing for {silent_s} s; it is waited for {most_s} s at most")
        })
    }

    /// Returns why the tool stops waiting. `is_alive`: whether the launcher was, before the newest messages were read.
    pub(super) fn check(&self, run: &Run, is_alive: bool, now: Instant) -> Result<(), WaitError> {
        let (silence, dir) = (now.saturating_duration_since(self.heard), run.dir.clone());
        let unknown = || self.unknown.clone();
        if !is_alive {
            return Err(WaitError::FleetEnded { run: dir, unknown: unknown() });
        }
        if self.has_answer && silence > SILENCE_MAX {
            return Err(WaitError::FellSilent { run: dir, unknown: unknown() });
        }
        if !self.has_answer && silence > PATIENCE {
            return Err(WaitError::Silent { run: dir });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::FleetConfig;

    #[test]
    fn waiting_ends_with_the_fleet_and_with_silence() {
        let run = Run::in_memory(FleetConfig::default()).unwrap();
        let begun = Instant::now();
        let mut waiting = Waiting::new(begun, "how it ended is not known".into());
        assert_eq!(waiting.check(&run, true, begun + PATIENCE), Ok(()));
        let late = begun + PATIENCE + Duration::from_millis(1);
        assert!(matches!(waiting.check(&run, true, late), Err(WaitError::Silent { .. })));
        assert_eq!(waiting.silence_to_report(late), None, "it has not answered yet");
        waiting.hear(late);
        assert_eq!(waiting.silence_to_report(late + REPORT_AFTER), None);
        let reported = waiting.silence_to_report(late + REPORT_AFTER + Duration::from_millis(1));
        assert!(reported.is_some_and(|reported| reported.contains("nothing for 3 s")));
        assert_eq!(waiting.silence_to_report(late + SILENCE_MAX), None, "once");
        assert_eq!(waiting.check(&run, true, late + SILENCE_MAX), Ok(()));
        let why = waiting.check(&run, false, late).unwrap_err().to_string();
        assert!(why.contains("ended") && why.contains("not known"), "{why}");
        let why = waiting.check(&run, true, late + SILENCE_MAX + PATIENCE).unwrap_err().to_string();
        assert!(why.contains("said nothing for 30 s") && why.contains("not known"), "{why}");
    }
}
