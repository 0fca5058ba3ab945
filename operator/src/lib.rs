//! `mr-slam operator`: an operator without a headset. Attaches over ros_tcp exactly as a headset does, sees what it
//! would see, and drives with a simulated joystick. On the way it measures what arrives.
//!
//! ```text
//!   TCP ──▶ Client ──▶ Measures ──▶ Picture ──▶ Tour ──▶ Joystick ──▶ Voice ──▶ TCP
//!           └───────── ears ─────────┘           └───────── hands ──────┘
//! ```

pub mod client;
mod hands;
pub mod measures;
pub mod picture;
#[cfg(test)]
mod rehearsal;
mod report;

pub use report::{MapReport, OperatorReport, RobotReport};

use bridge::command::TopicList;
use client::{Client, Event, Voice};
use hands::Hands;
use measures::{Measures, robot_topic};
use msg::{ROBOTS_MAX, RobotId, Stamp};
use picture::Picture;
use std::collections::{BTreeSet, VecDeque};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use thiserror::Error;

/// How long the ears wait at most before they look whether to stop.
const EARS_WAIT: Duration = Duration::from_millis(100);
/// The newest words of the server that are kept.
const NOTICES_MAX: usize = 16;

/// What the operator does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum OperatorMode {
    /// Drives the robots one after the other until the room is mapped, then on patrol.
    Tour,
}

/// The command line of `mr-slam operator`.
#[derive(Clone, Debug, PartialEq, clap::Args)]
pub struct OperatorArgs {
    /// What to do.
    #[arg(value_enum)]
    pub mode: OperatorMode,
    /// Where the bridge is.
    #[arg(long, default_value = "127.0.0.1")]
    pub host: String,
    /// The bridge's TCP port.
    #[arg(long, default_value_t = 10_000)]
    pub port: u16,
    /// How many robots to drive [default: all in the topic list].
    #[arg(long, value_parser = clap::value_parser!(u8).range(1..=ROBOTS_MAX as i64))]
    pub robots: Option<u8>,
    /// Ends after this long [default: when stopped].
    #[arg(long)]
    pub seconds: Option<f64>,
    /// How long a robot stays in the hand [default: three turns for each robot, 8 s to 20 s].
    #[arg(long)]
    pub turn_seconds: Option<f64>,
    /// Drives all robots at once, each by its own topic, instead of one after the other.
    #[arg(long)]
    pub all_at_once: bool,
    /// Where whims come from: the same seed and the same sights make the same tour.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Prints the report as JSON.
    #[arg(long)]
    pub json: bool,
    /// The process that started it and whose end it does not outlive: a demo's launcher.
    #[arg(long, hide = true)]
    pub launcher_pid: Option<u32>,
}

/// Why an operator could not work.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum OperatorError {
    /// An argument makes no sense.
    #[error("--{name} is {value}, expected a number of seconds greater than 0")]
    Argument {
        /// Which.
        name: &'static str,
        /// What was given.
        value: f64,
    },
    /// There was never a link.
    #[error(
        "no link to the bridge: {why}. Start the fleet first (mr-slam up --port {port}), or name its port (--port)"
    )]
    NoLink {
        /// The last attempt's end.
        why: String,
        /// The port tried.
        port: u16,
    },
    /// There was never a robot.
    #[error(
        "{address} lists {topics} topics but no /robotN/scan: are the fleet's simulators running (mr-slam status)?"
    )]
    NoRobots {
        /// Where.
        address: String,
        /// How many topics it listed.
        topics: usize,
    },
}

/// What ears and hands share.
#[derive(Default)]
pub(crate) struct Heard {
    picture: Picture,
    robots: BTreeSet<RobotId>,
    topics: usize,
    connected: bool,
    lost: Option<String>,
    notices: VecDeque<String>,
}

pub(crate) type SharedHeard = Mutex<Heard>;

pub(crate) fn lock(heard: &SharedHeard) -> MutexGuard<'_, Heard> {
    heard.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Attaches and drives until `stop` or the time is over, then lets go of the stick and reports.
///
/// Robots stop by themselves when the link is lost; the operator keeps trying to come back.
pub fn run(args: &OperatorArgs, stop: &AtomicBool) -> Result<OperatorReport, OperatorError> {
    for (name, value) in [("seconds", args.seconds), ("turn-seconds", args.turn_seconds)] {
        if let Some(value) = value.filter(|value| !(*value > 0.0 && value.is_finite())) {
            return Err(OperatorError::Argument { name, value });
        }
    }
    let address = format!("{}:{}", args.host, args.port);
    let client = Client::new(address.clone());
    let voice = client.voice();
    register(&voice);
    let heard = SharedHeard::default();
    let (epoch, done) = (Instant::now(), AtomicBool::new(false));
    let mut hands = Hands::new(args, voice, &heard, epoch);
    let measures = std::thread::scope(|scope| {
        let ears = scope.spawn(|| listen(client, &heard, epoch, &done));
        hands.work(stop);
        done.store(true, Ordering::Relaxed);
        ears.join().unwrap_or_default()
    });
    let link = measures.report();
    if link.connections == 0 {
        let why = lock(&heard).lost.take().unwrap_or_else(|| format!("{address}: no answer yet"));
        return Err(OperatorError::NoLink { why, port: args.port });
    }
    hands.report(address, link)
}

/// What the paper's headset subscribes to and publishes, but for the robots' own topics.
fn register(voice: &Voice) {
    voice.subscribe("/tf", "tf2_msgs/TFMessage");
    voice.subscribe("/clock", "rosgraph_msgs/Clock");
    voice.subscribe("/merged_map", "nav_msgs/OccupancyGrid");
    voice.subscribe("/emergency_stop", "std_msgs/Bool");
    voice.subscribe("/selected_robot", "std_msgs/Int32");
    voice.advertise::<bridge::ros::Int32>("/selected_robot");
    voice.advertise::<bridge::ros::Twist>("/cmd_vel");
}

/// The ears: every message is measured at once, then its content kept for the hands.
fn listen(mut client: Client, heard: &SharedHeard, epoch: Instant, done: &AtomicBool) -> Measures {
    let mut measures = Measures::new();
    while !done.load(Ordering::Relaxed) {
        client.poll(Instant::now() + EARS_WAIT, &mut |event| match event {
            Event::Message { topic, payload, received } => {
                // What cannot be read is counted by the measures.
                let Ok(seen) = measures.note(topic, payload, received) else { return };
                let now = stamp(epoch, received);
                let _ = lock(heard).picture.take(now, topic, payload, seen);
            }
            Event::Connected => {
                measures.connected();
                lock(heard).connected = true;
            }
            Event::Lost(why) => {
                let mut heard = lock(heard);
                heard.picture.disconnected();
                (heard.connected, heard.lost) = (false, Some(why));
            }
            Event::Topics(list) => lock(heard).learn(&list),
            Event::Notice(_, text) => lock(heard).notice(text),
        });
    }
    measures
}

impl Heard {
    fn learn(&mut self, list: &TopicList) {
        self.topics = list.topics.len();
        let scans =
            list.topics.iter().filter_map(|topic| robot_topic(topic).filter(|(_, rest)| *rest == "scan"));
        self.robots.extend(scans.map(|(robot, _)| robot));
    }

    fn notice(&mut self, text: String) {
        if self.notices.back() == Some(&text) {
            return;
        }
        if self.notices.len() == NOTICES_MAX {
            self.notices.pop_front();
        }
        self.notices.push_back(text);
    }
}

/// The operator's clock: time since the run began.
pub(crate) fn stamp(epoch: Instant, at: Instant) -> Stamp {
    Stamp(at.saturating_duration_since(epoch).as_nanos() as i64)
}

#[cfg(test)]
mod tests;
