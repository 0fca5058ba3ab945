//! The bridge process: one thread for ros_tcp clients, and one for ROS 2 that the first never waits for.
//!
//! A message on a channel wakes the thread through the channel's file descriptor, is encoded once, and is written to
//! the sockets before the thread waits again.

use super::control::{self, Control};
use super::heartbeat::{HealthCounters, Heartbeat};
use super::{Error, outside, ros2};
use crate::channel::{self, Channel};
use crate::clock::now;
use crate::config::World;
use crate::ports::{ChannelError, ReadMapPort};
use crate::run::Run;
use crate::shared_memory::{Listener, MapReader, Participant, Reader, Writer};
use crate::stop::Stop;
use crate::supervisor::progress::{ProgressCounter, WatchedThread};
use crate::view::edges_json;
use ::bridge::{Bridge, FleetMessage, Transport, serve};
use msg::{
    DenseMap, GridView, Message, Odometry, PatchHeader, RobotId, Role, SlamRequest, Transforms,
    VelocityCommand,
};
use std::cell::RefCell;
use std::os::fd::AsFd;
use std::rc::Rc;
use std::time::Duration;
use tokio::io::unix::AsyncFd;
use tokio::net::TcpListener;
use tokio::task::{JoinHandle, LocalSet, spawn_local};
use tokio::time::Instant;

/// Period at which the process checks whether it is to stop, and whether its health is due.
const POLL_PERIOD: Duration = Duration::from_millis(100);
/// Shortest time between two whole grids of one map.
const GRID_PERIOD: Duration = Duration::from_millis(200);
/// Time added to [`GRID_PERIOD`] for each cell of the map.
///
/// ROS has whole grids only, and a client's transforms wait behind one. At this rate a map takes at most 5 MB/s of a
/// headset's Wi-Fi: 1 MB every 0.4 s, 16 MB every 3.4 s.
const GRID_CELL_TIME: Duration = Duration::from_nanos(200);
/// Kind of requester that marks this process's requests to SLAM.
const REQUESTER_KIND: u64 = 1;
/// Period at which a map's channel is polled without a notification: a request for the whole map may be due again.
const MAP_POLL_PERIOD: Duration = Duration::from_millis(500);
/// Bits of a requester's number that hold its process id; its kind is above them.
const PID_BITS: u32 = 32;

/// Runs the bridge process until it is asked to stop.
pub fn run(run: &Run, stop: &Stop) -> Result<(), Error> {
    let participant = run.attach(Role::Bridge, None)?;
    let heartbeat = Heartbeat::new(&participant, run, Role::Bridge, None)?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    LocalSet::new().block_on(&runtime, async {
        let bridge = open_bridge(&participant, run)?;
        let control = Rc::new(RefCell::new(Control::new(bridge.clone(), run)));
        let mut tasks = publish_channels(&participant, run, &bridge)?;
        if run.config.bridge.dds.enabled {
            tasks.push(ros2::open(run, stop, &bridge)?);
        }
        tasks.push(spawn_local(report_health(heartbeat, bridge.clone(), control.clone())));
        tasks.push(spawn_local(count_progress(run.progress(Role::Bridge, None, WatchedThread::Main))));
        tasks.push(spawn_local(control::serve(control::listen(run)?, control)));
        serve(bridge, inherited_listener()?, now, stop_requested(stop.clone())).await;
        tasks.iter().for_each(JoinHandle::abort);
        Ok(())
    })
}

/// Returns the socket that the launcher listens on and passes down as standard input.
fn inherited_listener() -> std::io::Result<TcpListener> {
    let listener = std::net::TcpListener::from(std::io::stdin().as_fd().try_clone_to_owned()?);
    listener.local_addr().map_err(|why| {
        std::io::Error::other(format!(
            "standard input is not a listening socket ({why}); start the bridge with `mr-slam up`"
        ))
    })?;
    listener.set_nonblocking(true)?;
    TcpListener::from_std(listener)
}

/// Waits until the process is asked to stop.
pub(super) async fn stop_requested(stop: Stop) {
    while !stop.requested() {
        tokio::time::sleep(POLL_PERIOD).await;
    }
}

/// Says that the calling thread's tasks run.
pub(super) async fn count_progress(mut progress: ProgressCounter) {
    loop {
        progress.advance();
        tokio::time::sleep(POLL_PERIOD).await;
    }
}

async fn report_health(
    mut heartbeat: Heartbeat<Participant>,
    bridge: Rc<Bridge>,
    control: Rc<RefCell<Control>>,
) {
    loop {
        tokio::time::sleep(POLL_PERIOD).await;
        control.borrow_mut().record_stop();
        heartbeat.publish_if_due(|| {
            let counters = bridge.counters();
            let mut account = HealthCounters { clients: counters.clients, ..HealthCounters::default() };
            (account.dropped, account.refused) = (counters.dropped, counters.refused);
            account.gaps.received = counters.received;
            account
        });
    }
}

/// Creates the bridge, which writes the channels of velocities, of commands for merging and of requests to SLAM.
fn open_bridge(participant: &Participant, run: &Run) -> Result<Rc<Bridge>, Error> {
    let writers = run.robots().map(|robot| participant.writer(&channel::command(robot)));
    let mut writers = writers.collect::<Result<Vec<Writer<VelocityCommand>>, _>>()?;
    let send = move |robot: RobotId, command: VelocityCommand| {
        if let Some(writer) = writers.get_mut(robot.index()) {
            writer.send(&command);
        }
    };
    let config = run.config.bridge.clone();
    let bridge = match run.config.world {
        World::Simulator => Bridge::new(config, run.config.fleet.robots, send)?,
        World::Headset | World::Ros => {
            let (world, epoch) = (outside::open_world(participant, run)?, run.epoch);
            Bridge::with_external_world(config, world, move |now| epoch.stamp(now), send)?
        }
    };
    let mut edge_commands = participant.writer(&channel::edge_command())?;
    bridge.on_edge_command(move |command| edge_commands.send(&command));
    let mut requester = SlamRequester::open(participant, run, REQUESTER_KIND)?;
    bridge.on_slam_request(move |robot, request| requester.send(robot, request));
    Ok(Rc::new(bridge))
}

/// Sends requests to the robots' SLAM in the name of one endpoint.
pub(super) struct SlamRequester {
    /// The number that responses to this endpoint carry.
    pub client: u64,
    requests: Vec<Writer<SlamRequest>>,
}

impl SlamRequester {
    /// Opens the robots' request channels. `kind` tells endpoints of one process apart; the command line's is 0.
    pub fn open(participant: &Participant, run: &Run, kind: u64) -> Result<Self, ChannelError> {
        let client = kind << PID_BITS | u64::from(std::process::id());
        let requests = run.robots().map(|robot| participant.writer(&channel::slam_request(robot)));
        Ok(Self { client, requests: requests.collect::<Result<_, _>>()? })
    }

    /// Sends a request to a robot's SLAM.
    pub fn send(&mut self, robot: RobotId, request: SlamRequest) {
        if let Some(writer) = self.requests.get_mut(robot.index()) {
            writer.send(&SlamRequest { client: self.client, ..request });
        }
    }
}

/// Starts a task for each channel that feeds topics; it publishes the channel's messages.
pub(super) fn publish_channels<T: Transport + 'static>(
    participant: &Participant,
    run: &Run,
    transport: &Rc<T>,
) -> Result<Vec<JoinHandle<()>>, Error> {
    let mut tasks = vec![
        forward(participant, transport, &channel::clock(), |to, clock| {
            to.publish(FleetMessage::Clock(clock))
        })?,
        forward(participant, transport, &channel::stats(), |to, stats| {
            to.publish(FleetMessage::Stats(stats))
        })?,
        forward(participant, transport, &channel::merge_edges(), |to, edges| {
            to.publish(FleetMessage::MergeEdges(&edges_json(edges)));
        })?,
        publish_merged_map(participant, transport)?,
    ];
    for robot in run.robots() {
        tasks.push(publish_motion(participant, transport, robot)?);
        tasks.push(forward(participant, transport, &channel::scan(robot), move |to, scan| {
            to.publish(FleetMessage::Scan(robot, scan));
        })?);
        tasks.push(forward(participant, transport, &channel::correction(robot), move |to, correction| {
            to.publish(FleetMessage::Correction(robot, correction));
        })?);
        let maps = participant.map_reader(&channel::map(robot))?;
        tasks.push(publish_map(participant, transport, &channel::map(robot), maps, move |to, map| {
            to.publish(FleetMessage::Map(robot, map));
        })?);
    }
    Ok(tasks)
}

/// Passes each message of a channel on.
pub(super) fn forward<M: Message, T: 'static>(
    participant: &Participant,
    to: &Rc<T>,
    channel: &Channel<M>,
    pass: impl Fn(&T, &M) + 'static,
) -> Result<JoinHandle<()>, Error> {
    let mut reader = participant.reader(channel)?;
    let to = to.clone();
    on_notification(participant.listener(channel)?, move || {
        while let Some(message) = reader.receive() {
            pass(&to, &message);
        }
    })
}

/// Publishes a robot's transforms and odometry. Transforms are written after the odometry of the same stamp, and notify.
fn publish_motion<T: Transport + 'static>(
    participant: &Participant,
    transport: &Rc<T>,
    robot: RobotId,
) -> Result<JoinHandle<()>, Error> {
    let mut transforms: Reader<Transforms> = participant.reader(&channel::transforms(robot))?;
    let mut odometry: Reader<Odometry> = participant.reader(&channel::odometry(robot))?;
    let transport = transport.clone();
    on_notification(participant.listener(&channel::transforms(robot))?, move || {
        while let Some(transforms) = transforms.receive() {
            transport.publish(FleetMessage::Transforms(robot, &transforms));
        }
        while let Some(odometry) = odometry.receive() {
            transport.publish(FleetMessage::Odometry(robot, &odometry));
        }
    })
}

/// Publishes the merged map and the map transforms, which are written before it.
fn publish_merged_map<T: Transport + 'static>(
    participant: &Participant,
    transport: &Rc<T>,
) -> Result<JoinHandle<()>, Error> {
    let maps = participant.map_reader(&channel::merged_map())?;
    let mut map_transforms = participant.reader(&channel::map_transforms())?;
    publish_map(participant, transport, &channel::merged_map(), maps, move |to, map| {
        if let Some(map_transforms) = map_transforms.newest() {
            to.publish(FleetMessage::MapTransforms(&map_transforms));
        }
        to.publish(FleetMessage::MergedMap(map));
    })
}

/// Publishes the newest version of a map as one grid: at once if the last grid was long enough ago, otherwise then.
fn publish_map<T: Transport + 'static>(
    participant: &Participant,
    transport: &Rc<T>,
    channel: &Channel<PatchHeader>,
    mut reader: MapReader,
    mut publish: impl FnMut(&T, GridView<'_>) + 'static,
) -> Result<JoinHandle<()>, Error> {
    let listener = async_listener(participant.listener(channel)?)?;
    let transport = transport.clone();
    let mut grid = DenseMap::default();
    Ok(spawn_local(async move {
        let (mut has_changed, mut due) = (false, Instant::now());
        loop {
            has_changed |= reader.poll();
            if has_changed && Instant::now() >= due {
                let map = grid.update(reader.map());
                publish(&transport, map);
                let cells = map.cells.len() as u32;
                (has_changed, due) = (false, Instant::now() + GRID_PERIOD + GRID_CELL_TIME * cells);
            }
            let deadline = if has_changed { due } else { Instant::now() + MAP_POLL_PERIOD };
            if let Ok(ready) = tokio::time::timeout_at(deadline, listener.readable()).await {
                let Ok(mut ready) = ready else { return };
                listener.get_ref().drain();
                ready.clear_ready();
            }
        }
    }))
}

/// Returns a listener that a task can wait for.
fn async_listener(listener: Listener) -> Result<AsyncFd<Listener>, Error> {
    Ok(listener.into_async().map_err(|why| format!("cannot wait for a channel's notifications: {why}"))?)
}

/// Calls `act` now and at each notification.
pub(super) fn on_notification(
    listener: Listener,
    mut act: impl FnMut() + 'static,
) -> Result<JoinHandle<()>, Error> {
    let listener = async_listener(listener)?;
    Ok(spawn_local(async move {
        loop {
            act();
            let Ok(mut ready) = listener.readable().await else { return };
            listener.get_ref().drain();
            ready.clear_ready();
        }
    }))
}

#[cfg(test)]
mod tests {
    use crate::channel::{CHANNELS, Scope};
    use bridge::OUTGOING_TOPICS;

    #[test]
    fn every_outgoing_topic_names_a_channel_of_the_table() {
        for row in OUTGOING_TOPICS.iter().filter(|row| !row.channel.is_empty()) {
            let (scope, name) = match row.channel.strip_prefix("robotN/") {
                Some(name) => (Scope::Robot, name),
                None => (Scope::Fleet, row.channel),
            };
            let is_there = CHANNELS.iter().any(|channel| channel.name == name && channel.scope == scope);
            assert!(is_there, "{} is fed by {}, which is no channel", row.name, row.channel);
        }
    }
}
