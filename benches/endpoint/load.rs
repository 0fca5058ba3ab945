//! The clients on TCP, and what is computed from their samples.

use crate::measure::{Spread, Streams};
use crate::peer::PeerReport;
use bridge::command::name;
use bridge::frame::{KEEPALIVE, Parser, Side};
use bridge::ros::{Message, Twist, TwistStamped, encode};
use mr_slam::clock::now;
use msg::Stamp;
use std::collections::BTreeMap;
use std::io::{ErrorKind, Read, Write};
use std::net::TcpStream;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Larger than any frame here, bytes.
const FRAME_MAX: usize = 16 << 20;
const COMMAND_TOPIC: &str = "/compared/command";
/// Period of commands, as a headset at 50 Hz.
const COMMAND_PERIOD: Duration = Duration::from_millis(20);
/// Period of the peer's transforms.
const TRANSFORM_PERIOD_NS: i64 = 50_000_000;
/// Time for the last messages to arrive.
const TAIL: Duration = Duration::from_secs(1);
const READ_TIMEOUT: Duration = Duration::from_millis(200);
/// Bytes of a stamp and of a string's length after the encapsulation's four: seconds, nanoseconds, length.
const HEADER_BYTES: usize = 16;

/// An error that crosses threads.
type Failure = Box<dyn std::error::Error + Send + Sync>;

/// Stamp and arrival of the messages of each topic, nanoseconds.
pub type Received = BTreeMap<String, Vec<(i64, u64)>>;

/// What the client asks for: command, topic, type. It is one connection: ROS-TCP-Endpoint serves one at a time.
const WISHES: [(&str, &str, &str); 10] = [
    (name::SUBSCRIBE, "/compared/robot1/transform", "geometry_msgs/TransformStamped"),
    (name::SUBSCRIBE, "/compared/robot2/transform", "geometry_msgs/TransformStamped"),
    (name::SUBSCRIBE, "/compared/robot3/transform", "geometry_msgs/TransformStamped"),
    (name::SUBSCRIBE, "/compared/robot1/scan", "sensor_msgs/LaserScan"),
    (name::SUBSCRIBE, "/compared/robot2/scan", "sensor_msgs/LaserScan"),
    (name::SUBSCRIBE, "/compared/robot3/scan", "sensor_msgs/LaserScan"),
    (name::SUBSCRIBE, "/compared/robot1/map", "nav_msgs/OccupancyGrid"),
    (name::SUBSCRIBE, "/compared/robot2/map", "nav_msgs/OccupancyGrid"),
    (name::SUBSCRIBE, "/compared/robot3/map", "nav_msgs/OccupancyGrid"),
    (name::PUBLISH, COMMAND_TOPIC, TwistStamped::TYPE),
];

/// A connected client that reads on one thread and sends commands on another.
pub struct Load {
    listening: JoinHandle<Result<Received, Failure>>,
    commanding: JoinHandle<Result<u64, Failure>>,
}

impl Load {
    /// Connects, registers, reads from now on, and sends commands for `length` after `delay`.
    pub fn start(port: u16, delay: Duration, length: Duration) -> Result<Self, Box<dyn std::error::Error>> {
        let mut stream = TcpStream::connect(("127.0.0.1", port))?;
        stream.set_read_timeout(Some(READ_TIMEOUT))?;
        stream.write_all(&registrations())?;
        let received = stream.try_clone()?;
        let listening = std::thread::spawn(move || listen(received, delay + length + TAIL));
        let commanding = std::thread::spawn(move || command(stream, delay, length));
        Ok(Self { listening, commanding })
    }

    /// Waits for the end; returns the delays by topic and the number of commands sent.
    pub fn join(self) -> Result<(Received, u64), Failure> {
        let commands_sent = self.commanding.join().map_err(|_| "the commanding thread failed")??;
        Ok((self.listening.join().map_err(|_| "the listening thread failed")??, commands_sent))
    }
}

/// Returns the client's first frames. ROS-TCP-Endpoint for ROS 2 takes no other fields than these.
fn registrations() -> Vec<u8> {
    let mut out = KEEPALIVE.to_vec();
    for (command, topic, class) in WISHES {
        let body = serde_json::json!({ "topic": topic, "message_name": class });
        Side::Client.write_command(&mut out, command, &body);
    }
    out
}

/// Notes each message's delay for this time.
fn listen(mut stream: TcpStream, length: Duration) -> Result<Received, Failure> {
    let mut received = Received::new();
    let mut parser = Parser::new(FRAME_MAX);
    let begun = Instant::now();
    while begun.elapsed() < length {
        match stream.read(parser.space()) {
            Ok(0) => return Err("the endpoint closed the connection".into()),
            Ok(count) => parser.filled(count),
            Err(why) if matches!(why.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => continue,
            Err(why) => return Err(why.into()),
        }
        let received_ns = now().0;
        while let Some(frame) = parser.next_frame()? {
            let topic = std::str::from_utf8(frame.name).ok().filter(|name| name.starts_with("/compared/"));
            let Some((topic, stamp_ns)) = topic.zip(stamp_ns(frame.payload)) else { continue };
            received.entry(topic.to_owned()).or_default().push((stamp_ns, received_ns));
        }
    }
    Ok(received)
}

/// Returns the stamp of a message that begins with a header, nanoseconds.
fn stamp_ns(payload: &[u8]) -> Option<i64> {
    let bytes = payload.get(..HEADER_BYTES)?;
    let word = |at: usize| <[u8; 4]>::try_from(&bytes[at..at + 4]).map(u32::from_le_bytes).ok();
    Some(i64::from(word(4)?) * 1_000_000_000 + i64::from(word(8)?))
}

/// Sends commands as Unity's connector writes them: each field by itself, with Nagle's algorithm on.
fn command(mut stream: TcpStream, delay: Duration, length: Duration) -> Result<u64, Failure> {
    std::thread::sleep(delay);
    let (begun, mut sent) = (Instant::now(), 0);
    while begun.elapsed() < length {
        send_command(&mut stream)?;
        sent += 1;
        std::thread::sleep(COMMAND_PERIOD);
    }
    Ok(sent)
}

fn send_command(stream: &mut TcpStream) -> std::io::Result<()> {
    let mut frame = Vec::new();
    let twist = Twist { linear: [0.1, 0.0, 0.0], angular: [0.0; 3] };
    let command = TwistStamped { stamp: Stamp(now().0 as i64), frame_id: String::new(), twist };
    Side::Client.write_with(&mut frame, COMMAND_TOPIC, |out| encode(&command, out));
    // A client's name ends in a NUL. Then: length, encapsulation, seconds, nanoseconds, string, padding, six numbers.
    let mut at = 0;
    for bytes in [4, COMMAND_TOPIC.len() + 1, 4, 4, 4, 4, 4, 1, 3, 8, 8, 8, 8, 8, 8] {
        let end = (at + bytes).min(frame.len());
        stream.write_all(&frame[at..end])?;
        at = end;
    }
    stream.write_all(&frame[at..])
}

/// What one endpoint did in all its rounds.
#[derive(Default)]
pub struct Sample {
    delays_ns: BTreeMap<&'static str, Vec<i64>>,
    /// Jitter of each link in each round.
    jitter: Vec<Spread>,
    command_delays_ns: Vec<i64>,
    sent: u64,
    received: u64,
    commands_sent: u64,
    cpu_percents: Vec<f64>,
}

impl Sample {
    /// Creates the sample of one round.
    pub fn new(received: Received, peer: &PeerReport, commands_sent: u64, cpu_percent: f64) -> Self {
        let mut sample = Self {
            sent: peer.sent.values().sum(),
            commands_sent,
            cpu_percents: vec![cpu_percent],
            command_delays_ns: peer.command_delays_ns.clone(),
            ..Self::default()
        };
        for (topic, messages) in received {
            sample.received += messages.len() as u64;
            let kind = ["transform", "scan", "map"].into_iter().find(|kind| topic.ends_with(kind));
            let delays = messages.iter().map(|(stamp_ns, received_ns)| *received_ns as i64 - stamp_ns);
            sample.delays_ns.entry(kind.unwrap_or("other")).or_default().extend(delays);
            if kind == Some("transform") {
                let mut stream = Streams::new(TRANSFORM_PERIOD_NS);
                messages
                    .iter()
                    .for_each(|(stamp_ns, received_ns)| stream.record(&topic, *stamp_ns, *received_ns));
                sample.jitter.push(stream.spread());
            }
        }
        sample
    }

    /// Adds another round.
    pub fn extend(&mut self, other: Self) {
        for (kind, delays) in other.delays_ns {
            self.delays_ns.entry(kind).or_default().extend(delays);
        }
        self.jitter.extend(other.jitter);
        self.command_delays_ns.extend(other.command_delays_ns);
        self.sent += other.sent;
        self.received += other.received;
        self.commands_sent += other.commands_sent;
        self.cpu_percents.extend(other.cpu_percents);
    }

    /// Returns the table's rows: what, and the figure.
    pub fn rows(&self) -> Vec<(String, f64)> {
        let mut rows = Vec::new();
        for (kind, label) in [("transform", "transform"), ("scan", "scan"), ("map", "map of 147 kB")] {
            let delays = self.delays_ns.get(kind).map_or(&[][..], Vec::as_slice);
            for (part, share) in [("median", 0.5), ("95 %", 0.95), ("99 %", 0.99)] {
                rows.push((format!("{label}, ROS to TCP: delay, {part}, ms"), percentile_ms(delays, share)));
            }
            if kind == "transform" {
                let worst = |of: fn(&Spread) -> f64| self.jitter.iter().map(of).fold(f64::NAN, f64::max);
                rows.push((
                    format!("{label}: jitter of the worst link, median, ms"),
                    worst(|link| link.p50_ms),
                ));
                rows.push((
                    format!("{label}: jitter of the worst link, 95 %, ms"),
                    worst(|link| link.p95_ms),
                ));
            }
        }
        let lost = 100.0 * self.sent.saturating_sub(self.received) as f64 / self.sent.max(1) as f64;
        rows.push((format!("ROS to TCP: lost of {}, %", self.sent), lost));
        for (part, share) in [("median", 0.5), ("95 %", 0.95), ("99 %", 0.99)] {
            let delay = percentile_ms(&self.command_delays_ns, share);
            rows.push((format!("command, TCP to ROS: delay, {part}, ms"), delay));
        }
        let arrived = self.command_delays_ns.len() as f64;
        let lost = 100.0 * (1.0 - arrived / self.commands_sent.max(1) as f64).max(0.0);
        rows.push((format!("command, TCP to ROS: lost of {}, %", self.commands_sent), lost));
        let mean = self.cpu_percents.iter().sum::<f64>() / self.cpu_percents.len().max(1) as f64;
        rows.push(("the endpoint's process, % of a core".into(), mean));
        rows
    }
}

/// Returns a percentile of delays in milliseconds; NaN without delays.
fn percentile_ms(delays_ns: &[i64], share: f64) -> f64 {
    let mut sorted = delays_ns.to_vec();
    sorted.sort_unstable();
    let index = ((sorted.len().max(1) - 1) as f64 * share) as usize;
    sorted.get(index).map_or(f64::NAN, |delay| *delay as f64 * 1e-6)
}
