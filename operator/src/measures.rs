//! What arrives at a headset: how much of each topic, how regularly, and what is missing.

use bridge::cdr::DecodeError;
use bridge::ros::{self, LaserScan, TfMessage};
use msg::{RobotId, Stamp};
use serde::Serialize;
use std::collections::BTreeMap;
use std::time::Instant;

/// Topics counted one by one; what comes on others is counted together.
const TOPICS_MAX: usize = 256;
/// Streams timed: the links of 16 robots and their scans, and some to spare.
const STREAMS_MAX: usize = 256;
/// Newest arrivals kept of each stream: seven minutes of a link at 20 Hz.
const ARRIVALS_MAX: usize = 8192;

/// Median and tail of some values.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Spread {
    /// How many.
    pub count: usize,
    /// Half are smaller.
    pub median: f64,
    /// 95 % are smaller.
    pub p95: f64,
    /// 99 % are smaller.
    pub p99: f64,
    /// The largest.
    pub max: f64,
}

impl Spread {
    /// Nearest-rank percentiles. Zero of nothing.
    pub fn of(mut values: Vec<f64>) -> Self {
        values.sort_by(f64::total_cmp);
        let rank = |share: f64| {
            let rank = (share * values.len() as f64).ceil() as usize;
            values.get(rank.saturating_sub(1)).copied().unwrap_or(0.0)
        };
        Self { count: values.len(), median: rank(0.5), p95: rank(0.95), p99: rank(0.99), max: rank(1.0) }
    }
}

/// What came on one topic.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TopicReport {
    /// Its name.
    pub topic: String,
    /// Messages.
    pub messages: u64,
    /// Payload.
    pub bytes: u64,
    /// Messages a second while connected.
    pub rate_hz: f64,
    /// The longest pause while connected, seconds.
    pub longest_pause_s: f64,
}

/// What came of streams with stamps at a steady rate.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct StreamReport {
    /// How many streams.
    pub streams: usize,
    /// Messages.
    pub received: u64,
    /// Missing by the stamps of the newest arrivals: where two are further apart than usual.
    pub lost: u64,
    /// Stamps that went back.
    pub disordered: u64,
    /// Messages a second of one stream while connected.
    pub rate_hz: f64,
    /// |(receive - stamp) - its mean over the stream|, all streams together, of the newest arrivals, milliseconds.
    pub jitter_ms: Spread,
}

/// One robot's scans.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ScanReport {
    /// 1 for `robot1`.
    pub robot: usize,
    /// Its stream.
    pub scans: StreamReport,
}

/// All of it.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct LinkReport {
    /// Connections made.
    pub connections: u64,
    /// Every topic on which something came, by name.
    pub topics: Vec<TopicReport>,
    /// Messages on more topics than are counted one by one.
    pub other_messages: u64,
    /// Messages that could not be read.
    pub undecodable: u64,
    /// Each robot's scans.
    pub scans: Vec<ScanReport>,
    /// The robots' own links on /tf: what the simulators or robots send.
    pub tf: StreamReport,
    /// The links on /tf that SLAM and merging send: `map` from `map_K` from `odom_K`.
    pub slam_tf: StreamReport,
}

#[derive(Clone, Copy, Debug)]
struct Arrival {
    stamp_ns: i64,
    received_ns: i64,
    connection: u64,
}

/// Arrivals of one stream: a ring of the newest, and counts of all.
#[derive(Clone, Debug, Default)]
struct Stream {
    newest: Vec<Arrival>,
    next: usize,
    received: u64,
    disordered: u64,
    pace: Pace,
}

/// How fast something comes.
#[derive(Clone, Copy, Debug, Default)]
struct Pace {
    last: Option<(u64, i64)>,
    steps: u64,
    steps_ns: i64,
    longest_ns: i64,
}

impl Pace {
    fn note(&mut self, connection: u64, received_ns: i64) {
        if let Some((_, last_ns)) = self.last.filter(|(of, _)| *of == connection) {
            let step_ns = received_ns - last_ns;
            self.steps += 1;
            self.steps_ns += step_ns;
            self.longest_ns = self.longest_ns.max(step_ns);
        }
        self.last = Some((connection, received_ns));
    }

    fn rate_hz(&self) -> f64 {
        if self.steps_ns > 0 { self.steps as f64 / (self.steps_ns as f64 * 1e-9) } else { 0.0 }
    }
}

impl Stream {
    fn note(&mut self, arrival: Arrival) {
        self.received += 1;
        self.pace.note(arrival.connection, arrival.received_ns);
        let last = self.newest.get(self.next.wrapping_sub(1)).or(self.newest.last());
        self.disordered += u64::from(last.is_some_and(|last| arrival.stamp_ns < last.stamp_ns));
        if self.newest.len() < ARRIVALS_MAX {
            self.newest.push(arrival);
        } else {
            self.newest[self.next] = arrival;
        }
        self.next = (self.next + 1) % ARRIVALS_MAX;
    }

    /// Deviations of the delay from its mean, milliseconds.
    fn jitter_ms(&self) -> impl Iterator<Item = f64> + '_ {
        let first_ns = self.newest.first().map_or(0, |a| a.received_ns.wrapping_sub(a.stamp_ns));
        let delay_ms =
            move |a: &Arrival| (a.received_ns.wrapping_sub(a.stamp_ns).wrapping_sub(first_ns)) as f64 * 1e-6;
        let mean_ms = self.newest.iter().map(delay_ms).sum::<f64>() / self.newest.len().max(1) as f64;
        self.newest.iter().map(move |a| (delay_ms(a) - mean_ms).abs())
    }

    /// Stamps missing between the first and the last of each connection, at the median distance of two.
    fn lost(&self) -> u64 {
        let mut by_stamp = self.newest.clone();
        by_stamp.sort_by_key(|a| (a.connection, a.stamp_ns));
        let pairs = by_stamp.windows(2).filter(|pair| pair[0].connection == pair[1].connection);
        let gaps: Vec<i64> = pairs.map(|p| p[1].stamp_ns - p[0].stamp_ns).filter(|gap| *gap > 0).collect();
        let mut sorted = gaps.clone();
        sorted.sort_unstable();
        let Some(period_ns) = sorted.get(sorted.len() / 2) else { return 0 };
        gaps.iter().map(|gap| ((*gap as f64 / *period_ns as f64).round() as u64).saturating_sub(1)).sum()
    }
}

fn report<'a>(streams: impl Iterator<Item = &'a Stream>) -> StreamReport {
    let mut sum = StreamReport::default();
    let mut jitter_ms = Vec::new();
    for stream in streams {
        sum.streams += 1;
        sum.received += stream.received;
        sum.lost += stream.lost();
        sum.disordered += stream.disordered;
        sum.rate_hz += stream.pace.rate_hz();
        jitter_ms.extend(stream.jitter_ms());
    }
    sum.rate_hz /= sum.streams.max(1) as f64;
    StreamReport { jitter_ms: Spread::of(jitter_ms), ..sum }
}

/// What a message turned out to be, for those who need its content too.
#[derive(Debug)]
pub enum Seen {
    /// A robot's scan.
    Scan(RobotId, LaserScan),
    /// Part of /tf.
    Transforms(TfMessage),
    /// Something that was only counted.
    Other,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Kind {
    Scan(RobotId),
    Body,
    Slam,
}

/// Counts and times arrivals. Bounded; allocates while streams are new only.
#[derive(Clone, Debug)]
pub struct Measures {
    epoch: Instant,
    connection: u64,
    topics: BTreeMap<String, (u64, u64, Pace)>,
    other_messages: u64,
    undecodable: u64,
    streams: BTreeMap<(Kind, String), Stream>,
}

impl Default for Measures {
    fn default() -> Self {
        Self::new()
    }
}

impl Measures {
    /// Nothing came yet.
    pub fn new() -> Self {
        Self {
            epoch: Instant::now(),
            connection: 0,
            topics: BTreeMap::new(),
            other_messages: 0,
            undecodable: 0,
            streams: BTreeMap::new(),
        }
    }

    /// A new connection: what was missed between two is no loss.
    pub fn connected(&mut self) {
        self.connection += 1;
    }

    /// Takes in one message.
    pub fn note(&mut self, topic: &str, payload: &[u8], received: Instant) -> Result<Seen, DecodeError> {
        let received_ns = received.saturating_duration_since(self.epoch).as_nanos() as i64;
        self.count(topic, payload.len(), received_ns);
        let seen = self.read(topic, payload, received_ns);
        self.undecodable += u64::from(seen.is_err());
        seen
    }

    fn read(&mut self, topic: &str, payload: &[u8], received_ns: i64) -> Result<Seen, DecodeError> {
        if topic == "/tf" {
            let message: TfMessage = ros::decode(payload)?;
            for transform in &message.transforms {
                let child = transform.child_frame_id.as_str();
                let kind = if is_slams(child) { Kind::Slam } else { Kind::Body };
                self.time(kind, child, transform.stamp, received_ns);
            }
            return Ok(Seen::Transforms(message));
        }
        let Some((robot, "scan")) = robot_topic(topic) else { return Ok(Seen::Other) };
        let scan: LaserScan = ros::decode(payload)?;
        self.time(Kind::Scan(robot), "", scan.stamp, received_ns);
        Ok(Seen::Scan(robot, scan))
    }

    fn count(&mut self, topic: &str, bytes: usize, received_ns: i64) {
        if !self.topics.contains_key(topic) {
            if self.topics.len() == TOPICS_MAX {
                self.other_messages += 1;
                return;
            }
            self.topics.insert(topic.to_owned(), Default::default());
        }
        if let Some((messages, total, pace)) = self.topics.get_mut(topic) {
            *messages += 1;
            *total += bytes as u64;
            pace.note(self.connection, received_ns);
        }
    }

    fn time(&mut self, kind: Kind, name: &str, stamp: Stamp, received_ns: i64) {
        let arrival = Arrival { stamp_ns: stamp.0, received_ns, connection: self.connection };
        let key = (kind, name.to_owned());
        if let Some(stream) = self.streams.get_mut(&key) {
            stream.note(arrival);
        } else if self.streams.len() < STREAMS_MAX {
            self.streams.entry(key).or_default().note(arrival);
        }
    }

    /// The figures so far.
    pub fn report(&self) -> LinkReport {
        let topics = self.topics.iter().map(|(topic, (messages, bytes, pace))| TopicReport {
            topic: topic.clone(),
            messages: *messages,
            bytes: *bytes,
            rate_hz: pace.rate_hz(),
            longest_pause_s: pace.longest_ns as f64 * 1e-9,
        });
        let of = |wanted: Kind| {
            self.streams.iter().filter(move |((kind, _), _)| *kind == wanted).map(|(_, stream)| stream)
        };
        let robots = self.streams.keys().filter_map(|(kind, _)| match kind {
            Kind::Scan(robot) => Some(*robot),
            _ => None,
        });
        let scans =
            robots.map(|robot| ScanReport { robot: robot.number(), scans: report(of(Kind::Scan(robot))) });
        LinkReport {
            connections: self.connection,
            topics: topics.collect(),
            other_messages: self.other_messages,
            undecodable: self.undecodable,
            scans: scans.collect(),
            tf: report(of(Kind::Body)),
            slam_tf: report(of(Kind::Slam)),
        }
    }
}

/// `/robot2/scan` is robot 2's `scan`.
pub fn robot_topic(topic: &str) -> Option<(RobotId, &str)> {
    let (number, rest) = topic.strip_prefix("/robot")?.split_once('/')?;
    Some((RobotId::new(number.parse().ok()?)?, rest))
}

/// `map_2` and `odom_2` (or `robot2/map`, `robot2/odom`): placed by merging and by SLAM.
fn is_slams(child: &str) -> bool {
    let last = child.rsplit('/').next().unwrap_or(child);
    matches!(last.split('_').next(), Some("map" | "odom"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use bridge::ros::TransformStamped;
    use std::time::Duration;

    fn tf(child: &str, stamp_s: f64) -> Vec<u8> {
        let transform = TransformStamped {
            stamp: Stamp::from_seconds(stamp_s),
            frame_id: "odom_1".into(),
            child_frame_id: child.into(),
            translation: [0.0; 3],
            rotation: [0.0, 0.0, 0.0, 1.0],
        };
        let mut payload = Vec::new();
        ros::encode(&TfMessage { transforms: vec![transform] }, &mut payload);
        payload
    }

    #[test]
    fn jitter_and_losses_are_told() {
        let mut measures = Measures::new();
        let epoch = measures.epoch;
        measures.connected();
        for i in 0..1000 {
            let stamp_s = f64::from(i) * 0.05;
            // Every tenth comes 2 ms late; two are lost; the clocks differ by 7 s.
            let late_s = if i % 10 == 0 { 0.002 } else { 0.0 };
            let received = epoch + Duration::from_secs_f64(7.0 + stamp_s + late_s);
            if i != 500 && i != 501 {
                measures.note("/tf", &tf("base_link_1", stamp_s), received).unwrap();
            }
        }
        let LinkReport { tf, slam_tf, topics, .. } = measures.report();
        assert_eq!((tf.streams, tf.received, tf.lost, tf.disordered), (1, 998, 2, 0));
        assert!((tf.rate_hz - 19.96).abs() < 0.05, "{}", tf.rate_hz);
        assert!((tf.jitter_ms.median - 0.2).abs() < 0.01, "{:?}", tf.jitter_ms);
        assert!((tf.jitter_ms.p95 - 1.8).abs() < 0.01 && (tf.jitter_ms.max - 1.8).abs() < 0.01);
        assert_eq!(slam_tf.streams, 0);
        assert!((topics[0].longest_pause_s - 0.15).abs() < 0.003, "{topics:?}");
    }

    #[test]
    fn a_reconnect_is_no_loss() {
        let mut measures = Measures::new();
        let epoch = measures.epoch;
        for connection in 0..2 {
            measures.connected();
            for i in 0..100 {
                let stamp_s = f64::from(connection) * 60.0 + f64::from(i) * 0.1;
                measures
                    .note("/tf", &tf("odom_3", stamp_s), epoch + Duration::from_secs_f64(stamp_s))
                    .unwrap();
            }
        }
        let report = measures.report();
        assert_eq!((report.slam_tf.received, report.slam_tf.lost, report.connections), (200, 0, 2));
        assert!((report.slam_tf.rate_hz - 10.0).abs() < 0.01);
    }

    #[test]
    fn bounded_whatever_comes() {
        let mut measures = Measures::new();
        let now = Instant::now();
        for i in 0..(2 * STREAMS_MAX) {
            measures.note("/tf", &tf(&format!("frame{i}"), 0.0), now).unwrap();
            measures.note(&format!("/topic{i}"), &[], now).unwrap();
        }
        for _ in 0..(2 * ARRIVALS_MAX) {
            measures.note("/tf", &tf("frame0", 1.0), now).unwrap();
        }
        assert!(measures.note("/robot1/scan", &[0, 1], now).is_err());
        let report = measures.report();
        assert_eq!(report.topics.len(), TOPICS_MAX);
        assert!(report.other_messages > 0);
        assert_eq!((report.tf.streams, report.undecodable), (STREAMS_MAX, 1));
        assert_eq!(report.tf.jitter_ms.count, ARRIVALS_MAX + STREAMS_MAX - 1);
    }

    #[test]
    fn robots_by_their_topics() {
        let robot = |n| RobotId::new(n).unwrap();
        assert_eq!(robot_topic("/robot2/scan"), Some((robot(2), "scan")));
        assert_eq!(robot_topic("/robot16/map"), Some((robot(16), "map")));
        assert_eq!(robot_topic("/robot17/map"), None);
        assert_eq!(robot_topic("/robot/map"), None);
        assert_eq!(robot_topic("/merged_map"), None);
    }
}
