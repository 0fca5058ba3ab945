//! Pauses in the scans of a recording: what the robot did meanwhile, nobody saw.

use msg::Stamp;
use serde::Serialize;
use std::fmt;

/// A pause is as many times longer than the time between two scans as a rule, and ...
const PERIODS: f64 = 10.0;
/// ... so long, seconds.
const GAP_MIN_S: f64 = 1.0;

/// Pauses in a robot's scans.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ScanGaps {
    /// Number of pauses.
    pub count: usize,
    /// Length of the longest, seconds.
    pub longest_s: f64,
    /// Time from the first scan to the beginning of the longest, seconds.
    pub longest_at_s: f64,
}

impl ScanGaps {
    /// Finds the pauses; `None` without any. The stamps are in order.
    pub fn find(stamps: impl Iterator<Item = Stamp>) -> Option<Self> {
        let stamps: Vec<Stamp> = stamps.collect();
        let mut steps_s: Vec<f64> = stamps.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let spans = steps_s.clone();
        steps_s.sort_unstable_by(f64::total_cmp);
        let median_s = *steps_s.get(steps_s.len() / 2)?;
        let is_gap = |span_s: f64| span_s >= GAP_MIN_S.max(PERIODS * median_s);
        let gaps = spans.iter().zip(&stamps).filter(|(span_s, _)| is_gap(**span_s));
        let (longest_s, begin) = gaps.clone().max_by(|a, b| a.0.total_cmp(b.0))?;
        Some(Self { count: gaps.count(), longest_s: *longest_s, longest_at_s: *begin - stamps[0] })
    }
}

impl fmt::Display for ScanGaps {
    fn fmt(&self, to: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { count, longest_s, longest_at_s } = self;
        let pauses = if *count == 1 {
            "the scans pause once".into()
        } else {
            format!("the scans pause {count} times")
        };
        write!(to, "{pauses}; {longest_s:.1} s from {longest_at_s:.1} s after the first one on")?;
        if *count > 1 { write!(to, " is the longest pause") } else { Ok(()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gaps(seconds: impl IntoIterator<Item = f64>) -> Option<ScanGaps> {
        ScanGaps::find(seconds.into_iter().map(Stamp::from_seconds))
    }

    #[test]
    fn a_pause_is_long_by_the_usual_time_between_scans() {
        let at_10_hz = |from_s: f64| (0..50).map(move |tenth| from_s + 0.1 * f64::from(tenth));
        assert_eq!(gaps(at_10_hz(3.0)), None);
        let found = gaps(at_10_hz(3.0).chain(at_10_hz(28.0)).chain(at_10_hz(35.0))).unwrap();
        assert_eq!(found.count, 2);
        assert!(
            (found.longest_s - 20.1).abs() < 1e-6 && (found.longest_at_s - 4.9).abs() < 1e-6,
            "{found:?}"
        );
        assert!(found.to_string().contains("pause 2 times; 20.1 s from 4.9 s"), "{found}");
        assert_eq!(gaps((0..50).map(|n| 1.5 * f64::from(n))), None, "a scan each half metre");
        assert_eq!((gaps([]), gaps([1.0])), (None, None));
    }
}
