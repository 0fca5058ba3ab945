//! Schedule by which SLAM saves its session.

use super::files::FileJobOutcome;
use crate::run::Run;
use crate::sessions;
use msg::{Monotonic, RobotId};
use std::path::PathBuf;
use std::time::Duration;

/// Largest share of the time that saving may take: a large map is saved less often.
const SAVING_SHARE_MAX: u32 = 20;
/// Time after a failed save until one that the session log needs.
const RETRY_PERIOD: Duration = Duration::from_secs(2);
/// Longest time from the start to the first save: a process that dies earlier has the log alone.
const FIRST_SAVE: Duration = Duration::from_secs(1);

/// Time after which a save that has not ended is told: the disk, or the server that has it, does not answer.
const SLOW_SAVE: Duration = Duration::from_secs(5);

/// Times of the saves, and whether the map has changed since the last.
pub(super) struct Autosave {
    pub path: PathBuf,
    /// Time between two saves; `None` switches autosave off.
    every: Option<Duration>,
    due: Monotonic,
    /// Earliest moment of the next save, whatever needs it.
    not_before: Monotonic,
    /// The map has changed since it was saved.
    pub changed: bool,
    /// When the save that goes on began.
    busy_since: Option<Monotonic>,
    /// Whether it was told that the save takes long.
    is_slow_reported: bool,
    /// Pause after the first save, different for each robot so that a fleet does not save all at once.
    turn: Duration,
    saved: bool,
    /// The error that was reported last: it is not reported again.
    reported: Option<String>,
    /// Number of saves that were begun.
    begun: u64,
    /// Number of the newest save that has ended.
    ended: u64,
}

impl Autosave {
    pub fn new(run: &Run, robot: RobotId, now: Monotonic) -> Self {
        let seconds = run.config.sessions.autosave_s;
        let every = (seconds > 0.0).then(|| Duration::from_secs_f64(seconds));
        let turn = every.unwrap_or_default() * robot.number() as u32 / run.config.fleet.robots as u32;
        Self {
            path: sessions::file(&sessions::folder(run), robot),
            every,
            due: now + FIRST_SAVE.min(turn),
            not_before: now,
            changed: false,
            busy_since: None,
            is_slow_reported: false,
            turn,
            saved: false,
            reported: None,
            begun: 0,
            ended: 0,
        }
    }

    pub fn is_wanted(&self) -> bool {
        self.changed && self.every.is_some()
    }

    /// Whether the session is to be saved at the end: also if nothing has changed since it was saved, as the file may have been
    /// moved or deleted.
    pub fn is_wanted_at_end(&self) -> bool {
        (self.changed || self.saved) && self.every.is_some()
    }

    pub fn is_due(&self, now: Monotonic) -> bool {
        self.is_wanted() && self.busy_since.is_none() && now >= self.due
    }

    /// Saves as soon as may be, because the session log goes on from there only.
    pub fn save_soon(&mut self) {
        self.changed = true;
        self.due = self.due.min(self.not_before);
    }

    /// Saves at once, for a person who waits for it. Returns the number of the save that has all that was changed until now; `None`:
    /// autosave is off, or nothing is to be saved.
    pub fn save_now(&mut self, now: Monotonic) -> Option<u64> {
        if !self.is_wanted() {
            return None;
        }
        self.due = self.due.min(now);
        Some(self.begun + 1)
    }

    /// Returns whether this save succeeded, or why it failed; `None`: it has not ended.
    pub fn outcome(&self, save: u64) -> Option<Result<(), &str>> {
        (self.ended >= save).then(|| self.error().map_or(Ok(()), Err))
    }

    /// Why the last save failed, if it did.
    pub fn error(&self) -> Option<&str> {
        self.reported.as_deref()
    }

    pub fn begin(&mut self, now: Monotonic) {
        self.begun += 1;
        (self.busy_since, self.changed) = (Some(now), false);
    }

    /// Tells once of a save that does not end. SLAM goes on meanwhile, and saves nothing else.
    pub fn watch(&mut self, now: Monotonic) {
        let is_slow = self.busy_since.is_some_and(|since| now >= since + SLOW_SAVE);
        if is_slow && !std::mem::replace(&mut self.is_slow_reported, true) {
            let path = self.path.display();
            tracing::warn!("slam: {path}: not saved for {} s: the disk does not answer", SLOW_SAVE.as_secs());
        }
    }

    /// Records that the file worker had no room for the save.
    pub fn postpone(&mut self, now: Monotonic) {
        (self.busy_since, self.changed) = (None, true);
        self.due = now + self.every.unwrap_or_default();
        self.not_before = now + RETRY_PERIOD;
    }

    pub fn finish(&mut self, outcome: &FileJobOutcome, now: Monotonic) {
        self.busy_since = None;
        self.ended = self.begun;
        if std::mem::take(&mut self.is_slow_reported) {
            tracing::warn!("slam: the disk answers again, after {:.0} s", outcome.took.as_secs_f64());
        }
        let first = !std::mem::replace(&mut self.saved, true);
        let pause = if first { self.turn } else { self.every.unwrap_or_default() };
        self.due = now + pause.max(outcome.took * SAVING_SHARE_MAX);
        let why = outcome.result.as_ref().err().map(ToString::to_string);
        let rest = outcome.took * SAVING_SHARE_MAX;
        self.not_before = now + if why.is_some() { rest.max(RETRY_PERIOD) } else { rest };
        if let Some(why) = why.as_ref().filter(|why| self.reported.as_ref() != Some(why)) {
            tracing::warn!("slam: the session is not saved: {why}; it is tried again later");
        }
        self.changed |= why.is_some();
        self.reported = why;
    }
}
