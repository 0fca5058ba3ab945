//! The doors. One thread for headsets: a message wakes it through the channel's descriptor, is encoded and
//! written to the sockets, and that was all the way. One for ROS 2, which the first never waits for.

use super::control::{self, Control};
use super::pulse::{Account, Pulse};
use super::{Error, outside, ros2};
use crate::channel::{self, Channel};
use crate::config::World;
use crate::fleet;
use crate::merge_edges;
use crate::ports::{ChannelError, ReadMapPort};
use crate::run::Run;
use crate::shared_memory::{Listener, MapReader, Participant, Reader, Writer};
use crate::stop::Stop;
use ::bridge::{Bridge, Outlet, serve};
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

/// How often the process looks whether it is to end, and whether its account is due.
const LOOK_PERIOD: Duration = Duration::from_millis(100);
/// The shortest time between two grids of one map, for the smallest map,
const GRID_PERIOD: Duration = Duration::from_millis(200);
/// and so much more for each of its cells: ROS knows whole grids only, and while one is under way, a client's
/// transforms wait behind it. This way a map takes at most 5 MB/s of a headset's Wi-Fi: 1 MB every 0.4 s, 16 MB
/// every 3.4 s.
const GRID_CELL_TIME: Duration = Duration::from_nanos(200);
/// What tells this door's questions to SLAM from others'.
const ASKER_KIND: u64 = 1;
/// How often a map's channel is looked at when it does not ring.
const MAP_LOOK_PERIOD: Duration = Duration::from_millis(500);

pub fn run(run: &Run, stop: &Stop) -> Result<(), Error> {
    let node = run.attach(Role::Bridge, None)?;
    let pulse = Pulse::new(&node, run, Role::Bridge, None)?;
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    LocalSet::new().block_on(&runtime, async {
        let bridge = open_bridge(&node, run)?;
        let mut edge_commands = node.writer(&channel::edge_command())?;
        bridge.on_edge_command(move |command| edge_commands.send(&command));
        let control = Rc::new(RefCell::new(Control::new(bridge.clone(), run)));
        let mut tasks = fleet_tasks(&node, run, &bridge)?;
        if run.config.bridge.dds.enabled {
            tasks.push(ros2::open(run, stop, &bridge)?);
        }
        tasks.push(spawn_local(beat(pulse, bridge.clone(), control.clone())));
        tasks.push(spawn_local(control::serve(control::listen(run)?, control)));
        serve(bridge, inherited_listener()?, stopped(stop.clone())).await;
        tasks.iter().for_each(JoinHandle::abort);
        Ok(())
    })
}

/// The launcher listens already, and hands its socket down as standard input.
fn inherited_listener() -> std::io::Result<TcpListener> {
    let listener = std::net::TcpListener::from(std::io::stdin().as_fd().try_clone_to_owned()?);
    listener.local_addr().map_err(|why| {
        std::io::Error::other(format!(
            "standard input is no listening socket ({why}); `mr-slam up` starts the bridge"
        ))
    })?;
    listener.set_nonblocking(true)?;
    TcpListener::from_std(listener)
}

pub(super) async fn stopped(stop: Stop) {
    while !stop.requested() {
        tokio::time::sleep(LOOK_PERIOD).await;
    }
}

async fn beat(mut pulse: Pulse, bridge: Rc<Bridge>, control: Rc<RefCell<Control>>) {
    loop {
        tokio::time::sleep(LOOK_PERIOD).await;
        control.borrow_mut().look();
        pulse.beat(|| {
            let counters = bridge.counters();
            let mut account = Account { clients: counters.clients, ..Account::default() };
            (account.dropped, account.refused) = (counters.dropped, counters.refused);
            account.gaps.received = counters.received;
            account
        });
    }
}

/// The hub, with a channel for each robot's commands.
fn open_bridge(node: &Participant, run: &Run) -> Result<Rc<Bridge>, Error> {
    let writers = run.robots().map(|robot| node.writer(&channel::command(robot)));
    let mut writers = writers.collect::<Result<Vec<Writer<VelocityCommand>>, _>>()?;
    let send = move |robot: RobotId, command: VelocityCommand| {
        if let Some(writer) = writers.get_mut(robot.index()) {
            writer.send(&command);
        }
    };
    let config = run.config.bridge.clone();
    let bridge = Rc::new(match run.config.world {
        World::Simulator => Bridge::new(config, run.config.fleet.robots, send)?,
        World::Headset | World::Ros => {
            let epoch = run.epoch;
            Bridge::outside(config, outside::world(node, run)?, move || fleet::stamp_now(epoch), send)?
        }
    });
    let mut asker = Asker::open(node, run, ASKER_KIND)?;
    bridge.on_ask(move |robot, request| asker.ask(robot, request));
    Ok(bridge)
}

/// Asks SLAM in the name of a door.
pub(super) struct Asker {
    /// Whose answers are ours.
    pub client: u64,
    requests: Vec<Writer<SlamRequest>>,
}

impl Asker {
    /// A process id, and a kind of connection above it: the command line's is 0.
    pub fn open(node: &Participant, run: &Run, kind: u64) -> Result<Self, ChannelError> {
        let client = kind << 32 | u64::from(std::process::id());
        let requests = run.robots().map(|robot| node.writer(&channel::slam_request(robot)));
        Ok(Self { client, requests: requests.collect::<Result<_, _>>()? })
    }

    pub fn ask(&mut self, robot: RobotId, request: SlamRequest) {
        if let Some(writer) = self.requests.get_mut(robot.index()) {
            writer.send(&SlamRequest { client: self.client, ..request });
        }
    }
}

/// A task for each channel that wakes.
pub(super) fn fleet_tasks<D: Outlet + 'static>(
    node: &Participant,
    run: &Run,
    bridge: &Rc<D>,
) -> Result<Vec<JoinHandle<()>>, Error> {
    let mut tasks = vec![
        forward(node, bridge, &channel::clock(), |bridge, clock| bridge.clock(clock))?,
        forward(node, bridge, &channel::stats(), |bridge, stats| bridge.stats(stats))?,
        forward(node, bridge, &channel::merge_edges(), |bridge, edges| {
            bridge.merge_edges(&merge_edges::json(edges));
        })?,
        merged_maps(node, bridge)?,
    ];
    for robot in run.robots() {
        tasks.push(robot_motion(node, bridge, robot)?);
        tasks.push(forward(node, bridge, &channel::scan(robot), move |bridge, scan| {
            bridge.scan(robot, scan)
        })?);
        tasks.push(forward(node, bridge, &channel::correction(robot), move |bridge, correction| {
            bridge.correction(robot, correction);
        })?);
        let maps = node.map_reader(&channel::map(robot))?;
        tasks.push(whole_maps(node, bridge, &channel::map(robot), maps, move |bridge, map| {
            bridge.map(robot, map)
        })?);
    }
    Ok(tasks)
}

/// Passes a channel on, message by message.
pub(super) fn forward<T: Message, D: 'static>(
    node: &Participant,
    bridge: &Rc<D>,
    channel: &Channel<T>,
    pass: impl Fn(&D, &T) + 'static,
) -> Result<JoinHandle<()>, Error> {
    let mut reader = node.reader(channel)?;
    let bridge = bridge.clone();
    on_ring(node.listener(channel)?, move || {
        while let Some(message) = reader.receive() {
            pass(&bridge, &message);
        }
    })
}

/// Odometry comes with the transforms of the same stamp, which ring.
fn robot_motion<D: Outlet + 'static>(
    node: &Participant,
    bridge: &Rc<D>,
    robot: RobotId,
) -> Result<JoinHandle<()>, Error> {
    let mut transforms: Reader<Transforms> = node.reader(&channel::transforms(robot))?;
    let mut odometry: Reader<Odometry> = node.reader(&channel::odometry(robot))?;
    let bridge = bridge.clone();
    on_ring(node.listener(&channel::transforms(robot))?, move || {
        while let Some(transforms) = transforms.receive() {
            bridge.transforms(robot, &transforms);
        }
        while let Some(odometry) = odometry.receive() {
            bridge.odometry(robot, &odometry);
        }
    })
}

/// The map transforms come with the merged map, which rings.
fn merged_maps<D: Outlet + 'static>(node: &Participant, bridge: &Rc<D>) -> Result<JoinHandle<()>, Error> {
    let maps = node.map_reader(&channel::merged_map())?;
    let mut map_transforms = node.reader(&channel::map_transforms())?;
    whole_maps(node, bridge, &channel::merged_map(), maps, move |bridge, map| {
        if let Some(map_transforms) = map_transforms.newest() {
            bridge.map_transforms(&map_transforms);
        }
        bridge.merged_map(map);
    })
}

/// Passes the newest version of a channel's map on, as the one grid that ROS knows: at once if the
/// last was sent long enough ago, else when it is.
fn whole_maps<D: Outlet + 'static>(
    node: &Participant,
    bridge: &Rc<D>,
    channel: &Channel<PatchHeader>,
    mut reader: MapReader,
    mut pass: impl FnMut(&D, GridView<'_>) + 'static,
) -> Result<JoinHandle<()>, Error> {
    let bell = watched(node.listener(channel)?)?;
    let bridge = bridge.clone();
    let mut grid = DenseMap::default();
    Ok(spawn_local(async move {
        let (mut waits, mut due) = (false, Instant::now());
        loop {
            waits |= reader.poll();
            if waits && Instant::now() >= due {
                let map = grid.update(reader.map());
                pass(&bridge, map);
                (waits, due) =
                    (false, Instant::now() + GRID_PERIOD + GRID_CELL_TIME * map.cells.len() as u32);
            }
            // Without news, too, it is looked now and then: a question for the whole may be due again.
            let patience = if waits { due } else { Instant::now() + MAP_LOOK_PERIOD };
            if let Ok(rung) = tokio::time::timeout_at(patience, bell.readable()).await {
                let Ok(mut rung) = rung else { return };
                bell.get_ref().drain();
                rung.clear_ready();
            }
        }
    }))
}

/// A bell that a task can wait for.
fn watched(bell: Listener) -> Result<AsyncFd<Listener>, Error> {
    Ok(bell.into_async().map_err(|why| format!("cannot watch a bell: {why}"))?)
}

/// Calls `act` now, and whenever the bell rings.
pub(super) fn on_ring(bell: Listener, mut act: impl FnMut() + 'static) -> Result<JoinHandle<()>, Error> {
    let bell = watched(bell)?;
    Ok(spawn_local(async move {
        loop {
            act();
            let Ok(mut rung) = bell.readable().await else { return };
            bell.get_ref().drain();
            rung.clear_ready();
        }
    }))
}
