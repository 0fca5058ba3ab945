//! Which of several peers counts: a robot obeys one base, and a base accepts one machine that bears a robot's name.

use crate::series::Series;
use msg::Monotonic;
use std::time::Duration;

/// Silence after which another peer takes the place of the one that led.
pub const SILENCE_MAX: Duration = Duration::from_secs(3);
/// Oldest message of ours that a peer may answer when it gives a velocity: the round trip and the longest pause between
/// two signs of life. An older answer waited in a queue.
pub const ANSWER_AGE_MAX: Duration = Duration::from_millis(500);

/// Time for which another peer is refused while the one that leads is heard after which there are two: one that takes the place
/// of another is accepted sooner.
const CONTESTED_AFTER: Duration = Duration::from_secs(5);

/// Whether a message counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PeerDecision {
    /// It is from the peer that leads.
    Accepted,
    /// It is from a peer that leads from now on; another session led before, or none.
    TakenOver {
        /// Session that led before.
        before: Option<u64>,
    },
    /// It is from another peer than the one that leads.
    Refused,
}

/// Keeps the session of the peer that leads.
#[derive(Clone, Copy, Debug, Default)]
pub struct Leadership {
    leader: Option<(u64, Monotonic)>,
    /// Refusals of other peers since this one leads, without a long pause.
    contest: Option<Series>,
    /// Messages of other peers that were refused.
    pub refused: u64,
}

impl Leadership {
    /// Decides about a message of the peer `session` that arrived `now`.
    pub fn admit(&mut self, session: u64, now: Monotonic) -> PeerDecision {
        match self.leader {
            Some((leader, _)) if leader == session => {
                self.leader = Some((session, now));
                PeerDecision::Accepted
            }
            Some((_, heard)) if now.since(heard) < SILENCE_MAX.as_nanos() as u64 => {
                self.refused += 1;
                self.contest = Some(Series::with(self.contest_series(now), now));
                PeerDecision::Refused
            }
            before => {
                (self.leader, self.contest) = (Some((session, now)), None);
                PeerDecision::TakenOver { before: before.map(|(session, _)| session) }
            }
        }
    }

    /// Returns the session that leads, silent or not.
    pub fn session(&self) -> Option<u64> {
        self.leader.map(|(session, _)| session)
    }

    /// Returns whether two peers are there: one that leads, and one that is refused all the time.
    pub fn is_contested(&self, now: Monotonic) -> bool {
        self.contest_series(now).is_some_and(|series| series.lasts(CONTESTED_AFTER))
    }

    /// The refusals that go on now.
    fn contest_series(&self, now: Monotonic) -> Option<Series> {
        self.contest.filter(|series| !is_silence(series.newest, now))
    }

    /// Returns whether the peer that leads was heard lately.
    pub fn is_heard(&self, now: Monotonic) -> bool {
        self.leader.is_some_and(|(_, heard)| now.since(heard) < SILENCE_MAX.as_nanos() as u64)
    }
}

fn is_silence(since: Monotonic, now: Monotonic) -> bool {
    now.since(since) >= SILENCE_MAX.as_nanos() as u64
}

/// Returns whether a message that answers ours of the time `answers` is recent. Only our own clock is read.
pub fn is_recent(answers: Monotonic, now: Monotonic) -> bool {
    answers.0 > 0 && answers <= now && now.since(answers) <= ANSWER_AGE_MAX.as_nanos() as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(ms: u64) -> Monotonic {
        Monotonic(1 + ms * 1_000_000)
    }

    #[test]
    fn a_second_base_is_refused_until_the_first_is_silent() {
        let mut leadership = Leadership::default();
        assert_eq!(leadership.admit(7, at(0)), PeerDecision::TakenOver { before: None });
        assert_eq!(leadership.admit(8, at(100)), PeerDecision::Refused);
        assert_eq!(leadership.admit(7, at(200)), PeerDecision::Accepted);
        assert_eq!(leadership.admit(8, at(3_100)), PeerDecision::Refused);
        assert_eq!(leadership.admit(8, at(3_200)), PeerDecision::TakenOver { before: Some(7) });
        assert_eq!(leadership.admit(7, at(3_300)), PeerDecision::Refused);
        assert_eq!((leadership.session(), leadership.refused), (Some(8), 3));
    }

    #[test]
    fn what_waited_in_a_queue_is_not_obeyed() {
        assert!(is_recent(at(1_000), at(1_500)));
        assert!(!is_recent(at(1_000), at(1_501)), "it waited");
        assert!(!is_recent(at(1_000), at(900)), "we never said that");
        assert!(!is_recent(Monotonic(0), at(100)), "it answers nothing");
    }
}
