//! How far a replay has come, and what its listeners want: pause, speed, another place.

use std::ops::Range;
use std::time::Duration;

/// Slowest and fastest speed that may be chosen, in times real time.
const SPEED_MIN: f64 = 0.01;
const SPEED_MAX: f64 = 1000.0;
/// Longest time that a replay catches up on, seconds: one that is slower than it should be does not hurry later.
const BEHIND_MAX_S: f64 = 0.2;
/// Error of sums of seconds that counts for nothing, seconds.
const ROUNDING_S: f64 = 1e-9;

/// How fast a recording is played.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Speed {
    /// So many times real time.
    Times(f64),
    /// As fast as the machine can.
    Unlimited,
}

/// A speed that cannot be played.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("expected `max`, or a number of times real time from {SPEED_MIN} to {SPEED_MAX}")]
pub struct SpeedError;

impl Speed {
    /// Returns a speed in times real time.
    ///
    /// # Errors
    /// It is out of range.
    pub fn times(times: f64) -> Result<Self, SpeedError> {
        if (SPEED_MIN..=SPEED_MAX).contains(&times) { Ok(Self::Times(times)) } else { Err(SpeedError) }
    }

    /// Returns the number of times real time; 0 stands for as fast as the machine can.
    pub fn number(self) -> f64 {
        match self {
            Self::Times(times) => times,
            Self::Unlimited => 0.0,
        }
    }
}

impl std::str::FromStr for Speed {
    type Err = SpeedError;

    fn from_str(text: &str) -> Result<Self, SpeedError> {
        match text {
            "max" => Ok(Self::Unlimited),
            text => Self::times(text.parse().map_err(|_| SpeedError)?),
        }
    }
}

impl std::fmt::Display for Speed {
    fn fmt(&self, to: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Times(times) => write!(to, "{times} times real time"),
            Self::Unlimited => to.write_str("as fast as possible"),
        }
    }
}

/// A place outside of the recording.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("{wished_s:.2} s is not in the recording, which has {begins_s:.2} to {ends_s:.2} s")]
pub struct SeekError {
    /// Place that was asked for, seconds.
    pub wished_s: f64,
    /// Beginning of the recording, seconds.
    pub begins_s: f64,
    /// End of the recording, seconds.
    pub ends_s: f64,
}

/// State of a replay: a place, counted in ticks from the beginning of the run, and how it changes.
#[derive(Clone, Debug)]
pub struct Playback {
    /// Duration of a tick, seconds.
    tick_s: f64,
    /// Tick at which the recording begins, and the one at which it ends.
    first: u64,
    last: u64,
    /// Tick up to which it was played.
    done: u64,
    speed: Speed,
    is_paused: bool,
    /// Tick to which it goes without a pause and as fast as it can.
    seeking: Option<u64>,
    /// Time that is to be played, seconds.
    credit_s: f64,
}

impl Playback {
    /// Begins at the beginning of a recording of these ticks of the run.
    pub fn new(ticks: Range<u64>, tick: Duration, speed: Speed) -> Self {
        let (first, last) = (ticks.start, ticks.end.max(ticks.start));
        let tick_s = tick.as_secs_f64();
        Self { tick_s, first, last, done: first, speed, is_paused: false, seeking: None, credit_s: 0.0 }
    }

    /// Returns the place, seconds of the run.
    pub fn position_s(&self) -> f64 {
        self.done as f64 * self.tick_s
    }

    /// Returns the beginning of the recording, seconds of the run.
    pub fn begins_s(&self) -> f64 {
        self.first as f64 * self.tick_s
    }

    /// Returns the end of the recording, seconds of the run.
    pub fn ends_s(&self) -> f64 {
        self.last as f64 * self.tick_s
    }

    /// Returns the chosen speed.
    pub fn speed(&self) -> Speed {
        self.speed
    }

    /// Chooses the speed from now on.
    pub fn set_speed(&mut self, speed: Speed) {
        self.speed = speed;
    }

    /// Returns whether the replay is paused.
    pub fn is_paused(&self) -> bool {
        self.is_paused
    }

    /// Pauses or goes on.
    pub fn set_paused(&mut self, is_paused: bool) {
        self.is_paused = is_paused;
        self.credit_s = 0.0;
    }

    /// Returns whether all was played.
    pub fn is_over(&self) -> bool {
        self.done >= self.last && self.seeking.is_none()
    }

    /// Returns whether it is on its way to another place.
    pub fn is_seeking(&self) -> bool {
        self.seeking.is_some()
    }

    /// Goes to another place. Returns whether the replay must begin anew to come there: what SLAM has done is not undone.
    ///
    /// # Errors
    /// The recording does not reach there.
    pub fn seek(&mut self, to_s: f64) -> Result<bool, SeekError> {
        let (begins_s, ends_s) = (self.begins_s(), self.ends_s());
        if !(begins_s..=ends_s).contains(&to_s) {
            return Err(SeekError { wished_s: to_s, begins_s, ends_s });
        }
        let to = ((to_s / self.tick_s).round() as u64).clamp(self.first, self.last);
        let is_back = to < self.done;
        if is_back {
            self.done = self.first;
        }
        (self.seeking, self.credit_s) = (Some(to), 0.0);
        Ok(is_back)
    }

    /// Adds time that has passed since the last call.
    pub fn pass_time(&mut self, elapsed: Duration) {
        if let (Speed::Times(times), false) = (self.speed, self.is_paused) {
            let most = BEHIND_MAX_S * times.max(1.0);
            self.credit_s = (self.credit_s + elapsed.as_secs_f64() * times).min(most);
        }
    }

    /// Takes the next tick; `None`: none is due now.
    pub fn take_tick(&mut self) -> Option<()> {
        if self.seeking.is_some_and(|to| self.done >= to) {
            self.seeking = None;
        }
        if self.done >= self.last {
            return None;
        }
        if self.seeking.is_none() {
            match (self.is_paused, self.speed) {
                (true, _) => return None,
                (false, Speed::Times(_)) if self.credit_s + ROUNDING_S < self.tick_s => return None,
                (false, Speed::Times(_)) => self.credit_s -= self.tick_s,
                (false, Speed::Unlimited) => {}
            }
        }
        self.done += 1;
        Some(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TICK: Duration = Duration::from_millis(10);

    fn play(playback: &mut Playback, elapsed_ms: u64) -> usize {
        playback.pass_time(Duration::from_millis(elapsed_ms));
        std::iter::from_fn(|| playback.take_tick()).count()
    }

    #[test]
    fn time_passes_at_the_chosen_speed_and_not_while_paused() {
        let mut playback = Playback::new(0..1000, TICK, Speed::Times(1.0));
        assert_eq!(play(&mut playback, 100), 10);
        playback.set_speed(Speed::times(2.0).unwrap());
        assert_eq!(play(&mut playback, 100), 20);
        playback.set_paused(true);
        assert_eq!(play(&mut playback, 100), 0);
        playback.set_paused(false);
        assert_eq!(play(&mut playback, 10), 2, "what passed while it was paused is not caught up on");
        assert_eq!(play(&mut playback, 60_000), 40, "nor is more than a moment of a machine that was busy");
        playback.set_speed(Speed::Unlimited);
        assert_eq!(play(&mut playback, 0), 1000 - 72);
        assert!(playback.is_over());
    }

    #[test]
    fn a_seek_reaches_its_place_while_paused_and_begins_anew_to_go_back() {
        let mut playback = Playback::new(0..1000, TICK, Speed::Times(1.0));
        playback.set_paused(true);
        assert_eq!(playback.seek(5.0), Ok(false));
        assert_eq!(play(&mut playback, 0), 500);
        assert!(!playback.is_seeking() && playback.is_paused());
        assert_eq!(playback.seek(1.0), Ok(true));
        assert_eq!(play(&mut playback, 0), 100);
        assert!((playback.position_s() - 1.0).abs() < 1e-9);
        for wrong in [-0.1, 10.1, f64::NAN] {
            let why = playback.seek(wrong).unwrap_err().to_string();
            assert!(why.contains("0 to 10.00 s"), "{why}");
        }
        assert!((playback.position_s() - 1.0).abs() < 1e-9, "a refused place changes nothing");
    }

    #[test]
    fn a_recording_of_a_later_part_of_the_run_begins_with_its_first_message() {
        let mut playback = Playback::new(360_000..360_500, TICK, Speed::Times(1.0));
        assert_eq!((playback.begins_s(), playback.position_s(), playback.ends_s()), (3600.0, 3600.0, 3605.0));
        assert_eq!(play(&mut playback, 100), 10);
        assert_eq!(playback.seek(3601.0), Ok(false));
        assert_eq!(play(&mut playback, 0), 90);
        assert_eq!(playback.seek(3600.5), Ok(true));
        assert_eq!(play(&mut playback, 0), 50, "from its beginning again, and not from that of the run");
        let why = playback.seek(0.0).unwrap_err().to_string();
        assert!(why.contains("3600.00 to 3605.00 s"), "{why}");
        playback.set_speed(Speed::Unlimited);
        assert_eq!(play(&mut playback, 0), 450);
        assert!(playback.is_over());
    }

    #[test]
    fn speeds_are_bounded() {
        assert_eq!("max".parse(), Ok(Speed::Unlimited));
        assert_eq!("2.5".parse(), Ok(Speed::Times(2.5)));
        for wrong in ["0", "-1", "1001", "nan", "fast", ""] {
            assert_eq!(wrong.parse::<Speed>(), Err(SpeedError), "{wrong}");
        }
    }
}
