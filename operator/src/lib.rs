//! Scripted operator, a client that drives a fleet over ros_tcp as a person with a headset does.
//!
//! It sees only what the bridge sends, drives with a simulated joystick, and measures what arrives.
//!
//! ```text
//!   TCP ──▶ Client ──▶ LinkStatistics ──▶ WorldState ──▶ ExplorationTour ──▶ SimulatedJoystick ──▶ ClientHandle ──▶ TCP
//!           └──────────── receiving thread ──────────┘   └───────────────── control loop, 20 Hz ─────────────────┘
//! ```

pub mod client;
mod control_loop;
pub mod joystick;
pub mod link_statistics;
mod report;
pub mod robot_topics;
pub mod world_state;

pub use report::{ExplorationReport, MapReport, OperatorReport, RobotReport};

use bridge::command::TopicList;
use bridge::{RobotNameError, RobotNames};
use client::{Client, ClientHandle, Event};
use control_loop::ControlLoop;
use link_statistics::LinkStatistics;
use msg::{ROBOTS_MAX, RobotId, Stamp};
use robot_topics::RobotTopics;
use std::collections::{BTreeSet, VecDeque};
use std::panic::resume_unwind;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use thiserror::Error;
use world_state::WorldState;

/// Longest wait for messages before the receiving thread looks whether to stop.
const RECEIVE_WAIT_MAX: Duration = Duration::from_millis(100);
/// Most texts of the bridge that are kept; the oldest goes first.
const SERVER_TEXTS_MAX: usize = 16;

/// What the operator does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum OperatorMode {
    /// Explore until the building is mapped, then patrol.
    Tour,
}

/// Command line of `mr-slam operator`.
#[derive(Clone, Debug, PartialEq, clap::Args)]
pub struct OperatorArgs {
    /// What to do
    #[arg(value_enum)]
    pub mode: OperatorMode,
    /// Host of the bridge
    #[arg(long, default_value = "127.0.0.1")]
    pub host: String,
    /// TCP port of the bridge
    #[arg(long, default_value_t = 10_000)]
    pub port: u16,
    /// Number of robots to drive [default: all in the topic list]
    #[arg(long, value_parser = clap::value_parser!(u8).range(1..=ROBOTS_MAX as i64))]
    pub robots: Option<u8>,
    /// Names of the robots in ROS, separated by commas, as the fleet has them [default: robot1,robot2,...]
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    pub names: Option<Vec<String>>,
    /// End after this time, seconds [default: when stopped]
    #[arg(long)]
    pub seconds: Option<f64>,
    /// Length of each robot's turn, seconds [default: three turns for each robot, 8 to 20]
    #[arg(long)]
    pub turn_seconds: Option<f64>,
    /// Drive all robots at once, each by its own topic, instead of one after the other
    #[arg(long)]
    pub all_at_once: bool,
    /// Random seed of the tour
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Print the report as JSON
    #[arg(long)]
    pub json: bool,
    /// Process whose end also ends the operator: the launcher of a demo
    #[arg(long, hide = true)]
    pub launcher_pid: Option<u32>,
}

/// An operator could not work.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum OperatorError {
    /// A time is not a positive number.
    #[error("--{name} is {value}, expected a number of seconds greater than 0")]
    Argument {
        /// Name of the argument.
        name: &'static str,
        /// Value of the argument, seconds.
        value: f64,
    },
    /// The robots cannot have these names.
    #[error("--names: {0}")]
    Names(#[from] RobotNameError),
    /// There was no connection during the whole run.
    #[error(
        "no connection to the bridge: {why}. Start a fleet first (mr-slam up --port {port}), or name its port (--port)"
    )]
    NoConnection {
        /// Error of the last attempt.
        why: String,
        /// Port that was tried.
        port: u16,
    },
    /// No robot's scan came during the whole run.
    #[error("{address} sent no scan of any robot in {seconds:.0} s: do the robots measure (mr-slam status)?")]
    NoScans {
        /// Address of the bridge.
        address: String,
        /// Time from the first attempt to connect to the end, seconds.
        seconds: f64,
    },
    /// The bridge refused to let this operator drive, until the end.
    #[error("the operator could not drive until the end: {0}")]
    NotPermitted(String),
    /// The bridge listed no robot during the whole run.
    #[error(
        "{address} lists {topics} topics but no /robotN/scan: are the fleet's simulators running (mr-slam status)? Robots \
         with other names are found by --names"
    )]
    NoRobots {
        /// Address of the bridge.
        address: String,
        /// Number of topics listed.
        topics: usize,
    },
}

/// What the receiving thread shares with the control loop.
pub(crate) struct Received {
    robots: RobotTopics,
    world: WorldState,
    listed_robots: BTreeSet<RobotId>,
    listed_topics: usize,
    /// Newest text of the bridge that this client may not drive; `None` if it may.
    not_permitted: Option<String>,
    last_error: Option<String>,
    server_texts: VecDeque<String>,
}

pub(crate) type SharedReceived = Mutex<Received>;

pub(crate) fn lock(received: &SharedReceived) -> MutexGuard<'_, Received> {
    received.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Connects and drives until `stop` or the end of the run, then stops the robots and reports.
///
/// If the connection is lost, the bridge stops the robots and the operator reconnects.
pub fn run(args: &OperatorArgs, stop: &AtomicBool) -> Result<OperatorReport, OperatorError> {
    for (name, value) in [("seconds", args.seconds), ("turn-seconds", args.turn_seconds)] {
        if let Some(value) = value.filter(|value| !(*value > 0.0 && value.is_finite())) {
            return Err(OperatorError::Argument { name, value });
        }
    }
    let address = format!("{}:{}", args.host, args.port);
    let client = Client::new(address.clone());
    let handle = client.handle();
    register_topics(&handle);
    let robots = match &args.names {
        Some(names) => RobotTopics::new(RobotNames::new(names.clone())?),
        None => RobotTopics::default(),
    };
    let received = SharedReceived::new(Received::new(robots.clone()));
    let (epoch, done) = (Instant::now(), AtomicBool::new(false));
    let mut control_loop = ControlLoop::new(args, handle, robots.names(), &received, epoch);
    let statistics = std::thread::scope(|scope| {
        let receiver =
            scope.spawn(|| receive(client, &received, LinkStatistics::new(robots.clone()), epoch, &done));
        control_loop.run(stop);
        done.store(true, Ordering::Relaxed);
        receiver.join().unwrap_or_else(|why| resume_unwind(why))
    });
    let link = statistics.report();
    if link.connections == 0 {
        let no_answer = || format!("{address}: no answer yet");
        let why = lock(&received).last_error.take().unwrap_or_else(no_answer);
        return Err(OperatorError::NoConnection { why, port: args.port });
    }
    control_loop.report(address, link)
}

/// Registers what the headset of MR-SLAM (Aryan et al.) subscribes to and publishes, except the robots' own topics.
fn register_topics(handle: &ClientHandle) {
    handle.subscribe("/tf", "tf2_msgs/TFMessage");
    handle.subscribe("/clock", "rosgraph_msgs/Clock");
    handle.subscribe("/merged_map", "nav_msgs/OccupancyGrid");
    handle.subscribe("/emergency_stop", "std_msgs/Bool");
    handle.subscribe("/selected_robot", "std_msgs/Int32");
    handle.advertise::<bridge::ros::Int32>("/selected_robot");
}

/// The receiving thread: records each message in the statistics at once, then stores its content.
fn receive(
    mut client: Client,
    received: &SharedReceived,
    mut statistics: LinkStatistics,
    epoch: Instant,
    done: &AtomicBool,
) -> LinkStatistics {
    let mut outage = Outage::begin();
    while !done.load(Ordering::Relaxed) {
        outage.notify(received);
        client.poll(Instant::now() + RECEIVE_WAIT_MAX, &mut |event| match event {
            Event::Message { topic, payload, received: at } => {
                // The statistics count what cannot be decoded.
                let Ok(content) = statistics.record(topic, payload, at) else { return };
                let _ = lock(received).world.store(stamp_at(epoch, at), topic, payload, content);
            }
            Event::Connected => {
                statistics.on_connected();
                outage.end();
            }
            Event::Disconnected(why) => {
                outage.since.get_or_insert_with(Instant::now);
                let mut received = lock(received);
                received.world.on_disconnected();
                received.last_error = Some(why);
            }
            Event::Topics(list) => lock(received).store_topics(&list),
            Event::ServerText(_, text) => lock(received).store_server_text(text),
        });
    }
    statistics
}

/// Time without a connection after which it is told.
const OUTAGE_TOLD: Duration = Duration::from_secs(3);

/// The time since when there is no connection to the bridge.
struct Outage {
    since: Option<Instant>,
    is_reported: bool,
}

impl Outage {
    /// Begins before the first connection.
    fn begin() -> Self {
        Self { since: Some(Instant::now()), is_reported: false }
    }

    /// Says once why there is no connection, when it lasts.
    fn notify(&mut self, received: &SharedReceived) {
        let lasts = self.since.is_some_and(|since| since.elapsed() > OUTAGE_TOLD);
        if lasts && !std::mem::replace(&mut self.is_reported, lasts) {
            let why = lock(received).last_error.clone().unwrap_or_else(|| "no answer".into());
            tracing::warn!("no connection to the bridge: {why}; it is tried again, Ctrl-C ends");
        }
    }

    fn end(&mut self) {
        if std::mem::take(&mut self.is_reported) {
            tracing::warn!("connected to the bridge");
        }
        self.since = None;
    }
}

impl Received {
    fn new(robots: RobotTopics) -> Self {
        Self {
            world: WorldState::new(robots.clone()),
            robots,
            listed_robots: BTreeSet::new(),
            listed_topics: 0,
            not_permitted: None,
            last_error: None,
            server_texts: VecDeque::new(),
        }
    }

    fn store_topics(&mut self, list: &TopicList) {
        self.listed_topics = list.topics.len();
        let robot_topics = list.topics.iter().filter_map(|topic| self.robots.split(topic));
        let scans = robot_topics.filter(|(_, rest)| *rest == "scan");
        self.listed_robots.extend(scans.map(|(robot, _)| robot));
    }

    fn store_server_text(&mut self, text: String) {
        match bridge::drive_permission(&text) {
            Some(true) => self.not_permitted = None,
            Some(false) => self.not_permitted = Some(text.clone()),
            None => {}
        }
        if self.server_texts.back() == Some(&text) {
            return;
        }
        if self.server_texts.len() == SERVER_TEXTS_MAX {
            self.server_texts.pop_front();
        }
        self.server_texts.push_back(text);
    }
}

/// A moment on the operator's clock: time since the start of the run.
pub(crate) fn stamp_at(epoch: Instant, at: Instant) -> Stamp {
    Stamp(at.saturating_duration_since(epoch).as_nanos() as i64)
}

#[cfg(test)]
mod tests;
