//! Statistics of the link, with the rate, regularity and losses of each topic.

use crate::robot_topics::RobotTopics;
use bridge::cdr::DecodeError;
use bridge::ros::{self, LaserScan, TfMessage};
use msg::{RobotId, Stamp};
use serde::Serialize;
use std::collections::BTreeMap;
use std::time::Instant;

/// Most topics counted one by one; messages on further topics are counted together.
const TOPICS_MAX: usize = 1024;
/// Most streams timed: transforms and scans of 64 robots, and some to spare.
const STREAMS_MAX: usize = 1024;
/// Newest arrivals kept of each stream: seven minutes at 20 Hz.
const ARRIVALS_MAX: usize = 8192;

/// Percentiles of a set of values.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Percentiles {
    /// Number of values.
    pub count: usize,
    /// 50th percentile, in the unit of the values; `None` without values, as the others.
    pub median: Option<f64>,
    /// 95th percentile, in the unit of the values.
    pub p95: Option<f64>,
    /// 99th percentile, in the unit of the values.
    pub p99: Option<f64>,
    /// Largest value of the set.
    pub max: Option<f64>,
}

impl Percentiles {
    /// Nearest-rank percentiles; none if there are no values.
    pub fn of(mut values: Vec<f64>) -> Self {
        values.sort_by(f64::total_cmp);
        let rank = |share: f64| {
            let rank = (share * values.len() as f64).ceil() as usize;
            values.get(rank.saturating_sub(1)).copied()
        };
        Self { count: values.len(), median: rank(0.5), p95: rank(0.95), p99: rank(0.99), max: rank(1.0) }
    }
}

/// What arrived on one topic.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TopicReport {
    /// Name of the topic.
    pub topic: String,
    /// Number of messages.
    pub messages: u64,
    /// Size of all payloads, bytes.
    pub bytes: u64,
    /// Mean rate while connected, Hz.
    pub rate_hz: f64,
    /// Longest time between two messages while connected, seconds.
    pub longest_pause_s: f64,
}

/// What arrived of stamped messages that are sent at a steady rate.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct StreamReport {
    /// Number of streams.
    pub streams: usize,
    /// Number of messages.
    pub received: u64,
    /// Messages missing by the stamps of the newest arrivals: where two are farther apart than usual.
    pub lost: u64,
    /// Messages whose stamp is earlier than that of the one before.
    pub disordered: u64,
    /// Mean rate of one stream while connected, Hz.
    pub rate_hz: f64,
    /// Deviation of each delay (reception minus stamp) from its stream's mean, of the newest arrivals, milliseconds.
    pub jitter_ms: Percentiles,
}

/// Scans of one robot.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ScanReport {
    /// Number of the robot: 1 for `robot1`.
    pub robot: usize,
    /// Statistics of its scans.
    pub scans: StreamReport,
}

/// Statistics of all that arrived.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct LinkReport {
    /// Number of connections made.
    pub connections: u64,
    /// Every topic with messages, by name.
    pub topics: Vec<TopicReport>,
    /// Messages on topics beyond those counted one by one.
    pub other_messages: u64,
    /// Messages that could not be decoded.
    pub undecodable: u64,
    /// Scans of each robot.
    pub scans: Vec<ScanReport>,
    /// Transforms on /tf that simulators or robots send.
    pub tf: StreamReport,
    /// Transforms on /tf that SLAM and merging send: `map` from `map_K` from `odom_K`.
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
    rate: ArrivalRate,
}

/// Mean and longest time between arrivals of one connection.
#[derive(Clone, Copy, Debug, Default)]
struct ArrivalRate {
    /// Connection and time of the last arrival.
    last: Option<(u64, i64)>,
    steps: u64,
    steps_ns: i64,
    longest_ns: i64,
}

impl ArrivalRate {
    fn record(&mut self, connection: u64, received_ns: i64) {
        if let Some((_, last_ns)) = self.last.filter(|(last, _)| *last == connection) {
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
    fn record(&mut self, arrival: Arrival) {
        self.received += 1;
        self.rate.record(arrival.connection, arrival.received_ns);
        let last = self.newest.get(self.next.wrapping_sub(1)).or(self.newest.last());
        self.disordered += u64::from(last.is_some_and(|last| arrival.stamp_ns < last.stamp_ns));
        if self.newest.len() < ARRIVALS_MAX {
            self.newest.push(arrival);
        } else {
            self.newest[self.next] = arrival;
        }
        self.next = (self.next + 1) % ARRIVALS_MAX;
    }

    /// Deviations of the delays from their mean, milliseconds.
    fn jitter_ms(&self) -> impl Iterator<Item = f64> + '_ {
        // Relative to the first delay: the two clocks may have any offset.
        let first_ns = self.newest.first().map_or(0, |a| a.received_ns.wrapping_sub(a.stamp_ns));
        let delay_ms =
            move |a: &Arrival| (a.received_ns.wrapping_sub(a.stamp_ns).wrapping_sub(first_ns)) as f64 * 1e-6;
        let mean_ms = self.newest.iter().map(delay_ms).sum::<f64>() / self.newest.len().max(1) as f64;
        self.newest.iter().map(move |a| (delay_ms(a) - mean_ms).abs())
    }

    /// Number of stamps missing within each connection, if they should be the median distance apart.
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
        sum.rate_hz += stream.rate.rate_hz();
        jitter_ms.extend(stream.jitter_ms());
    }
    sum.rate_hz /= sum.streams.max(1) as f64;
    StreamReport { jitter_ms: Percentiles::of(jitter_ms), ..sum }
}

/// Content of a message that the statistics had to decode, passed on so that it is decoded once.
#[derive(Debug)]
pub enum MessageContent {
    /// A robot's scan.
    Scan(RobotId, LaserScan),
    /// Transforms of /tf.
    Transforms(TfMessage),
    /// Content of another topic, which was counted only.
    Encoded,
}

impl MessageContent {
    /// Decodes scans and transforms; messages of other topics are left encoded.
    pub fn decode(robots: &RobotTopics, topic: &str, payload: &[u8]) -> Result<Self, DecodeError> {
        Ok(match robots.split(topic) {
            Some((robot, "scan")) => Self::Scan(robot, ros::decode(payload)?),
            _ if topic == "/tf" => Self::Transforms(ros::decode(payload)?),
            _ => Self::Encoded,
        })
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum StreamKind {
    Scan(RobotId),
    RobotTransform,
    SlamTransform,
}

/// Counts and arrival rate of one topic.
#[derive(Clone, Copy, Debug, Default)]
struct TopicCount {
    messages: u64,
    bytes: u64,
    rate: ArrivalRate,
}

/// Counts and times arrivals, within bounds; it allocates for new topics and streams only.
#[derive(Clone, Debug)]
pub struct LinkStatistics {
    robots: RobotTopics,
    epoch: Instant,
    connection: u64,
    topics: BTreeMap<String, TopicCount>,
    other_messages: u64,
    undecodable: u64,
    streams: BTreeMap<(StreamKind, String), Stream>,
}

impl Default for LinkStatistics {
    fn default() -> Self {
        Self::new(RobotTopics::default())
    }
}

impl LinkStatistics {
    /// Statistics of no arrivals from these robots.
    pub fn new(robots: RobotTopics) -> Self {
        Self {
            robots,
            epoch: Instant::now(),
            connection: 0,
            topics: BTreeMap::new(),
            other_messages: 0,
            undecodable: 0,
            streams: BTreeMap::new(),
        }
    }

    /// Starts a new connection: messages between two connections do not count as lost.
    pub fn on_connected(&mut self) {
        self.connection += 1;
    }

    /// Records a message, and returns its content if it had to be decoded.
    pub fn record(
        &mut self,
        topic: &str,
        payload: &[u8],
        received: Instant,
    ) -> Result<MessageContent, DecodeError> {
        let received_ns = received.saturating_duration_since(self.epoch).as_nanos() as i64;
        self.count(topic, payload.len(), received_ns);
        let content = self.decode_and_time(topic, payload, received_ns);
        self.undecodable += u64::from(content.is_err());
        content
    }

    fn decode_and_time(
        &mut self,
        topic: &str,
        payload: &[u8],
        received_ns: i64,
    ) -> Result<MessageContent, DecodeError> {
        let content = MessageContent::decode(&self.robots, topic, payload)?;
        match &content {
            MessageContent::Transforms(message) => {
                for transform in &message.transforms {
                    let child = transform.child_frame_id.as_str();
                    let kind = match is_slam_frame(child) {
                        true => StreamKind::SlamTransform,
                        false => StreamKind::RobotTransform,
                    };
                    self.time(kind, child, transform.stamp, received_ns);
                }
            }
            MessageContent::Scan(robot, scan) => {
                self.time(StreamKind::Scan(*robot), "", scan.stamp, received_ns);
            }
            MessageContent::Encoded => {}
        }
        Ok(content)
    }

    fn count(&mut self, topic: &str, bytes: usize, received_ns: i64) {
        if !self.topics.contains_key(topic) {
            if self.topics.len() == TOPICS_MAX {
                self.other_messages += 1;
                return;
            }
            self.topics.insert(topic.to_owned(), TopicCount::default());
        }
        if let Some(count) = self.topics.get_mut(topic) {
            count.messages += 1;
            count.bytes += bytes as u64;
            count.rate.record(self.connection, received_ns);
        }
    }

    fn time(&mut self, kind: StreamKind, name: &str, stamp: Stamp, received_ns: i64) {
        let arrival = Arrival { stamp_ns: stamp.0, received_ns, connection: self.connection };
        let key = (kind, name.to_owned());
        if let Some(stream) = self.streams.get_mut(&key) {
            stream.record(arrival);
        } else if self.streams.len() < STREAMS_MAX {
            self.streams.entry(key).or_default().record(arrival);
        }
    }

    /// Statistics of all arrivals so far.
    pub fn report(&self) -> LinkReport {
        let topics = self.topics.iter().map(|(topic, count)| TopicReport {
            topic: topic.clone(),
            messages: count.messages,
            bytes: count.bytes,
            rate_hz: count.rate.rate_hz(),
            longest_pause_s: count.rate.longest_ns as f64 * 1e-9,
        });
        let streams_of = |wanted: StreamKind| {
            self.streams.iter().filter(move |((kind, _), _)| *kind == wanted).map(|(_, stream)| stream)
        };
        let scanning_robots = self.streams.keys().filter_map(|(kind, _)| match kind {
            StreamKind::Scan(robot) => Some(*robot),
            _ => None,
        });
        let scans = scanning_robots.map(|robot| ScanReport {
            robot: robot.number(),
            scans: report(streams_of(StreamKind::Scan(robot))),
        });
        LinkReport {
            connections: self.connection,
            topics: topics.collect(),
            other_messages: self.other_messages,
            undecodable: self.undecodable,
            scans: scans.collect(),
            tf: report(streams_of(StreamKind::RobotTransform)),
            slam_tf: report(streams_of(StreamKind::SlamTransform)),
        }
    }
}

/// Whether SLAM or merging places a frame: `map_2` and `odom_2`, or `robot2/map` and `robot2/odom`.
fn is_slam_frame(child: &str) -> bool {
    let last = child.rsplit('/').next().unwrap_or(child);
    matches!(last.split('_').next(), Some("map" | "odom"))
}

#[cfg(test)]
mod tests;
