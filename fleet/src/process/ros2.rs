//! The ROS 2 endpoint of the bridge process, on a thread of its own, so that DDS never delays a headset on TCP.

use super::Error;
use super::bridge::feeds::{forward, open_feeds};
use super::bridge::live::{start_feeds, stop_requested};
use crate::channel;
use crate::clock::now;
use crate::config::RobotSource;
use crate::event_loop;
use crate::progress::WatchedThread;
use crate::run::Run;
use crate::stop::Stop;
use crate::world;
use ::bridge::dds::{DdsEndpoint, DdsQueues};
use ::bridge::{Bridge, FleetMessage};
use msg::{Clock, Role, VelocityCommand};
use std::cell::Cell;
use std::rc::Rc;
use std::sync::Arc;
use std::time::Duration;
use tokio::task::{JoinHandle, spawn_local};

/// Period of the clock messages to clients on TCP if ROS publishes none: 50 Hz, as a simulator would.
const CLOCK_PERIOD: Duration = Duration::from_millis(20);

/// Longest time in which the endpoint leaves the domain at the end. It takes 0.3 s, or 0.8 s where a participant is silent.
const LEAVE_MAX: Duration = Duration::from_millis(1500);
/// Period at which it is checked whether it has left.
const LEAVE_POLL_PERIOD: Duration = Duration::from_millis(10);

/// The running endpoint.
pub struct Ros2Endpoint {
    /// The task that passes its messages to the bridge.
    pub task: JoinHandle<()>,
    thread: std::thread::JoinHandle<()>,
}

impl Ros2Endpoint {
    /// Waits until the endpoint, which was asked to stop, has told the others that it leaves.
    ///
    /// A process that ends before stays in ROS's graph until DDS's lease runs out, 50 s later.
    pub async fn leave(self) {
        let deadline = tokio::time::Instant::now() + LEAVE_MAX;
        while !self.thread.is_finished() && tokio::time::Instant::now() < deadline {
            tokio::time::sleep(LEAVE_POLL_PERIOD).await;
        }
    }
}

/// Starts the endpoint on a thread of its own.
pub fn open(run: &Run, stop: &Stop, bridge: &Rc<Bridge>) -> Result<Ros2Endpoint, Error> {
    let queues = Arc::new(DdsQueues::default());
    let commands = queues.clone();
    bridge.on_ros_command(move |command| commands.send_command(command));
    let task = spawn_local(pass_to_bridge(run.clone(), bridge.clone(), queues.clone()));
    let (run, stop) = (run.clone(), stop.clone());
    let thread = std::thread::Builder::new().name("ros2".into()).spawn(move || {
        if let Err(why) = serve(&run, &stop, queues) {
            tracing::error!("bridge: {why}; ROS 2 is not served");
        }
    })?;
    Ok(Ros2Endpoint { task, thread })
}

/// Passes received messages to the bridge, and publishes the time until ROS does.
async fn pass_to_bridge(run: Run, bridge: Rc<Bridge>, queues: Arc<DdsQueues>) {
    // A simulator such as Gazebo publishes /clock; real robots use the time of day.
    let has_clock = Cell::new(run.config.world != RobotSource::Ros);
    let receive = async {
        loop {
            let event = queues.next_event().await;
            has_clock.set(has_clock.get() || event.is_clock());
            bridge.receive_ros(event, now());
        }
    };
    let publish_time = async {
        while !has_clock.get() {
            let mut clock = Clock::default();
            clock.header.stamp = world::stamp_now(run.epoch);
            bridge.publish(FleetMessage::Clock(&clock));
            tokio::time::sleep(CLOCK_PERIOD).await;
        }
    };
    tokio::join!(receive, publish_time);
}

/// Runs the endpoint until it is asked to stop.
fn serve(run: &Run, stop: &Stop, queues: Arc<DdsQueues>) -> Result<(), Error> {
    let mut result = Ok(());
    event_loop::run(Box::pin(async { result = serve_feeds(run, stop, queues).await }))?;
    result
}

async fn serve_feeds(run: &Run, stop: &Stop, queues: Arc<DdsQueues>) -> Result<(), Error> {
    // A participant of its own: ports of shared memory stay on the thread that opened them.
    let participant = run.attach_thread(Role::Bridge, None, "ros2")?;
    let is_external = run.config.world == RobotSource::Ros;
    let robots = run.config.robot_names();
    let endpoint = Rc::new(DdsEndpoint::open(&run.config.bridge_config(), robots, is_external, queues)?);
    let mut feeds = open_feeds(&participant, run, &endpoint)?;
    for robot in run.robots().filter(|_| is_external) {
        let publish = move |endpoint: &DdsEndpoint, command: &VelocityCommand| {
            endpoint.publish_velocity(robot, command);
        };
        feeds.push(forward(&participant, &endpoint, &channel::command(robot), publish)?);
    }
    let mut tasks = start_feeds(feeds)?;
    tasks.push(spawn_local(endpoint.clone().serve()));
    stop_requested(stop.clone(), run.progress(Role::Bridge, None, WatchedThread::Second)).await;
    tasks.iter().for_each(JoinHandle::abort);
    endpoint.leave().await;
    Ok(())
}
