//! Model of a wireless link as TCP sees it: delay, jitter, throughput, stalls for lost segments, outages.
//!
//! It is pure: a seed and the times of segments in, their arrivals out. [`proxy`] puts it between sockets, lockstep between
//! connections in memory.

pub mod proxy;

use clap::ValueEnum;
use rand_pcg::Pcg32;
use rand_pcg::rand_core::Rng;
use std::time::Duration;

/// Bytes of a TCP segment on Ethernet and Wi-Fi.
pub const SEGMENT_BYTES: usize = 1448;

/// How a link behaves in one direction; the other is the same.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Link {
    /// Smallest delay, milliseconds.
    pub delay_ms: f64,
    /// Mean of the exponentially distributed delay that comes on top, milliseconds.
    pub jitter_ms: f64,
    /// Throughput of the link, Mbit/s.
    pub mbit_s: f64,
    /// Share of segments that are lost, 0 to 1.
    pub loss: f64,
    /// Stall that a lost segment costs until it is sent again, milliseconds.
    pub stall_ms: f64,
    /// Period of outages, seconds.
    pub outage_period_s: f64,
    /// Length of the outage at the end of each period, seconds; 0: there are none.
    pub outage_s: f64,
}

impl Link {
    /// A link that passes everything at once; the others change what they name.
    pub const LOOPBACK: Self = Self {
        delay_ms: 0.0,
        jitter_ms: 0.0,
        mbit_s: 1e4,
        loss: 0.0,
        stall_ms: 0.0,
        outage_period_s: 15.0,
        outage_s: 0.0,
    };
    /// A 5 GHz network with nobody else on it. The table in docs/experiment.md names the sources of these values.
    pub const QUIET_WIFI: Self =
        Self { delay_ms: 2.0, jitter_ms: 1.5, mbit_s: 100.0, loss: 0.001, stall_ms: 12.0, ..Self::LOOPBACK };
    /// A network that others use as well.
    pub const BUSY_WIFI: Self =
        Self { delay_ms: 4.0, jitter_ms: 8.0, mbit_s: 10.0, loss: 0.02, stall_ms: 40.0, ..Self::LOOPBACK };
    /// The same with outages, as where a headset changes its access point.
    pub const OUTAGES: Self = Self { outage_s: 1.0, ..Self::BUSY_WIFI };

    /// Returns whether everything passes at once, so that no proxy is needed.
    pub fn is_transparent(&self) -> bool {
        let delays = self.delay_ms + self.jitter_ms + self.loss * self.stall_ms + self.outage_s;
        delays == 0.0 && self.mbit_s >= Self::LOOPBACK.mbit_s
    }

    /// Checks the ranges of all values.
    ///
    /// # Errors
    /// The first value that is out of its range, with the range.
    pub fn check(&self) -> Result<(), LinkError> {
        let ranges = [
            ("delay, ms", self.delay_ms, 0.0, 10_000.0),
            ("jitter, ms", self.jitter_ms, 0.0, 10_000.0),
            ("throughput, Mbit/s", self.mbit_s, 0.01, 1e5),
            ("loss", self.loss, 0.0, 1.0),
            ("stall, ms", self.stall_ms, 0.0, 10_000.0),
            ("period of outages, s", self.outage_period_s, 0.1, 86_400.0),
            ("outage, s", self.outage_s, 0.0, 0.9 * self.outage_period_s),
        ];
        let wrong = ranges.into_iter().find(|(_, value, low, high)| !(low..=high).contains(&value));
        wrong.map_or(Ok(()), |(name, value, low, high)| Err(LinkError { name, value, low, high }))
    }
}

/// A value of a link that is out of its range.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("link: {name} is {value}; expected {low} to {high}")]
pub struct LinkError {
    name: &'static str,
    value: f64,
    low: f64,
    high: f64,
}

/// One of the links that have names.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum LinkChoice {
    /// No proxy: everything is on this machine
    #[default]
    Loopback,
    /// A 5 GHz network with nobody else on it
    QuietWifi,
    /// A network that others use as well
    BusyWifi,
    /// The same, with an outage of 1 s every 15 s
    Outages,
}

impl LinkChoice {
    /// All of them, from the best to the worst.
    pub const ALL: [Self; 4] = [Self::Loopback, Self::QuietWifi, Self::BusyWifi, Self::Outages];

    /// Returns how the link behaves.
    pub fn link(self) -> Link {
        match self {
            Self::Loopback => Link::LOOPBACK,
            Self::QuietWifi => Link::QUIET_WIFI,
            Self::BusyWifi => Link::BUSY_WIFI,
            Self::Outages => Link::OUTAGES,
        }
    }

    /// Returns the name for people.
    pub fn name(self) -> &'static str {
        match self {
            Self::Loopback => "loopback",
            Self::QuietWifi => "quiet Wi-Fi",
            Self::BusyWifi => "busy Wi-Fi",
            Self::Outages => "Wi-Fi with outages",
        }
    }
}

/// Draws when the segments of one direction of a TCP connection arrive. The same seed and times give the same arrivals.
#[derive(Clone, Debug)]
pub struct LinkModel {
    link: Link,
    random: Pcg32,
    last: Duration,
}

impl LinkModel {
    /// Creates the model of one direction of one connection. `seed` is a session's; each `stream`, the number of a direction in
    /// the session, draws numbers of its own.
    pub fn new(link: Link, seed: u64, stream: u64) -> Self {
        Self { link, random: Pcg32::new(seed, stream), last: Duration::ZERO }
    }

    /// Returns when a segment arrives that is sent at `now`, not before those that were sent earlier.
    ///
    /// Both are times since the link's start, which decides when its outages are.
    pub fn arrival(&mut self, now: Duration, bytes: usize) -> Duration {
        let link = self.link;
        let mut delay_ms = link.delay_ms - link.jitter_ms * (1.0 - self.uniform()).ln();
        if self.uniform() < link.loss {
            delay_ms += link.stall_ms;
        }
        let sent_ms = bytes as f64 * 8e-3 / link.mbit_s;
        // Bytes arrive in order, so that a stalled segment holds up those behind it.
        let in_order = self.last + ms(sent_ms);
        // What is sent in an outage leaves at its end; what would arrive in one arrives after it.
        let arrival = (outage_end(&link, now) + ms(delay_ms)).max(in_order);
        self.last = outage_end(&link, arrival);
        self.last
    }

    /// Draws a number from 0 to below 1.
    fn uniform(&mut self) -> f64 {
        (self.random.next_u64() >> 11) as f64 / (1_u64 << 53) as f64
    }
}

/// Returns the end of the outage of now, or now.
fn outage_end(link: &Link, now: Duration) -> Duration {
    let phase_s = now.as_secs_f64() % link.outage_period_s;
    // The outage is the end of each period.
    let is_out = link.outage_s > 0.0 && phase_s >= link.outage_period_s - link.outage_s;
    now + Duration::from_secs_f64(if is_out { link.outage_period_s - phase_s } else { 0.0 })
}

fn ms(milliseconds: f64) -> Duration {
    Duration::from_secs_f64(milliseconds * 1e-3)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn arrivals(link: Link, seed: u64) -> Vec<f64> {
        let mut model = LinkModel::new(link, seed, 0);
        let sent = (0..20_000).map(|index| Duration::from_millis(20) * index);
        sent.map(|now| (model.arrival(now, 100) - now).as_secs_f64() * 1e3).collect()
    }

    #[test]
    fn a_seed_gives_the_same_delays_and_they_are_those_of_the_link() {
        let link = Link { loss: 0.0, ..Link::BUSY_WIFI };
        let delays = arrivals(link, 1);
        assert_eq!(delays, arrivals(link, 1));
        assert_ne!(delays, arrivals(link, 2));
        let mean = delays.iter().sum::<f64>() / delays.len() as f64;
        // Segments that wait for one before them make the mean a little larger.
        assert!((11.8..13.0).contains(&mean), "{mean} ms");
        assert!(delays.iter().all(|delay| *delay >= link.delay_ms - 1e-6));
    }

    #[test]
    fn segments_arrive_in_order_however_long_one_stalls() {
        let mut model = LinkModel::new(Link { loss: 0.3, stall_ms: 300.0, ..Link::QUIET_WIFI }, 3, 0);
        let arrivals: Vec<_> =
            (0..2000).map(|index| model.arrival(Duration::from_millis(10) * index, 1448)).collect();
        assert!(arrivals.is_sorted());
    }

    #[test]
    fn nothing_arrives_during_an_outage() {
        let mut model = LinkModel::new(Link::OUTAGES, 4, 0);
        for index in 0..6000 {
            let now = Duration::from_millis(10) * index;
            let sent_s = now.as_secs_f64();
            let arrival_s = model.arrival(now, 50).as_secs_f64();
            if sent_s % 15.0 >= 14.0 {
                let end_s = (sent_s / 15.0).ceil() * 15.0;
                assert!(arrival_s >= end_s + 1e-3 * Link::OUTAGES.delay_ms - 1e-6, "{sent_s} {arrival_s}");
            }
            assert!(!(14.0..15.0 - 1e-6).contains(&(arrival_s % 15.0)), "{sent_s} {arrival_s}");
        }
    }

    #[test]
    fn a_slow_link_takes_time_for_each_byte() {
        let mut model = LinkModel::new(Link { mbit_s: 1.0, ..Link::LOOPBACK }, 5, 0);
        let last = (0..100).map(|_| model.arrival(Duration::ZERO, 1250)).last();
        assert_eq!(last, Some(Duration::from_secs(1)), "125 kB at 1 Mbit/s");
    }

    #[test]
    fn values_out_of_range_are_named() {
        assert!(LinkChoice::ALL.iter().all(|choice| choice.link().check().is_ok()));
        let refused = Link { loss: 1.5, ..Link::QUIET_WIFI }.check().unwrap_err().to_string();
        assert_eq!(refused, "link: loss is 1.5; expected 0 to 1");
        assert!(Link { jitter_ms: f64::NAN, ..Link::LOOPBACK }.check().is_err());
        assert!(Link::LOOPBACK.is_transparent() && !Link::QUIET_WIFI.is_transparent());
    }
}
