//! Feeds of a transport: each passes the messages of one group of channels on to ros_tcp clients or to DDS.

use crate::channel::{self, Channel};
use crate::config::RobotSource;
use crate::ports::{ChannelError, Clock as _, Ports, ReadMapPort, ReadPort};
use crate::process::ProcessLoop;
use crate::process::scan_demand::ScanDemandSender;
use crate::run::Run;
use ::bridge::silence::{SILENT, report_of_silent_exploration, report_of_silent_navigation};
use ::bridge::{FleetMessage, FleetTopic, Transport};
use msg::{
    DenseMap, GridView, MapTransforms, Message, Monotonic, Odometry, PatchHeader, RobotId, ScanPurpose,
    Transforms,
};
use reports::edges_json;
use std::rc::Rc;
use std::time::Duration;

/// Shortest time between two whole grids of one map.
const GRID_PERIOD: Duration = Duration::from_millis(200);
/// Time added to [`GRID_PERIOD`] for each cell of the map.
///
/// ROS has whole grids only, and a client's transforms wait behind one. At this rate a map takes at most 5 MB/s of a
/// headset's Wi-Fi: 1 MB every 0.4 s, 16 MB every 3.4 s.
const GRID_CELL_TIME: Duration = Duration::from_nanos(200);
/// Period at which a map's channel is polled without a notification: a request for the whole map may be due again.
const MAP_POLL_PERIOD: Duration = Duration::from_millis(500);
/// Period at which a channel with a history is polled without a notification.
const HISTORY_POLL_PERIOD: Duration = Duration::from_millis(500);
/// Period at which subscriptions to scans are looked at, where the robots are on other machines.
const DEMAND_PERIOD: Duration = Duration::from_millis(100);
/// Due moment of a feed that runs when its channel is written, and at no other time.
const WHEN_WRITTEN: Monotonic = Monotonic(u64::MAX);

/// Passes the messages of one group of channels on.
pub struct Feed<L> {
    /// Listener that wakes the feed.
    pub listener: L,
    pub(super) step: Box<dyn FnMut() -> Monotonic>,
}

impl<L> ProcessLoop for Feed<L> {
    fn step(&mut self) -> Monotonic {
        (self.step)()
    }
}

/// A feed of a process with these ports, or the reason why a channel cannot be opened.
pub type FeedResult<P> = Result<Feed<<P as Ports>::Listener>, ChannelError>;

/// Opens a feed for each channel that has topics.
pub fn open_feeds<P: Ports + 'static, T: Transport + 'static>(
    ports: &P,
    run: &Run,
    transport: &Rc<T>,
) -> Result<Vec<Feed<P::Listener>>, ChannelError> {
    let mut feeds = vec![
        forward(ports, transport, &channel::clock(), |to, clock| to.publish(FleetMessage::Clock(clock)))?,
        forward(ports, transport, &channel::stats(), |to, stats| to.publish(FleetMessage::Stats(stats)))?,
        forward(ports, transport, &channel::merge_edges(), |to, edges| {
            to.publish(FleetMessage::MergeEdges(&edges_json(edges)));
        })?,
        forward_repeated(
            ports,
            transport,
            &channel::exploration_state(),
            report_of_silent_exploration,
            |to, report| {
                to.publish(FleetMessage::ExplorationState(report));
            },
        )?,
        forward(ports, transport, &channel::exclusion_zones(), |to, zones| {
            to.publish(FleetMessage::ExclusionZones(zones));
        })?,
        publish_merged_map(ports, transport)?,
    ];
    if run.config.world == RobotSource::Robots {
        feeds.push(demand_scans(ports, run, transport)?);
    }
    for robot in run.robots() {
        feeds.push(publish_motion(ports, transport, robot)?);
        feeds.push(forward(ports, transport, &channel::scan(robot), move |to, scan| {
            to.publish(FleetMessage::Scan(robot, scan));
        })?);
        feeds.push(forward(ports, transport, &channel::battery(robot), move |to, battery| {
            to.publish(FleetMessage::Battery(robot, battery));
        })?);
        feeds.push(forward(ports, transport, &channel::pose_estimate(robot), move |to, pose_estimate| {
            to.publish(FleetMessage::PoseEstimate(robot, pose_estimate));
        })?);
        let state = channel::navigation_state(robot);
        feeds.push(forward_repeated(
            ports,
            transport,
            &state,
            report_of_silent_navigation,
            move |to, report| {
                to.publish(FleetMessage::NavigationState(robot, report));
            },
        )?);
        feeds.push(forward(ports, transport, &channel::plan(robot), move |to, plan| {
            to.publish(FleetMessage::Plan(robot, plan));
        })?);
        feeds.push(publish_map(ports, transport, &channel::map(robot), move |to, map| {
            to.publish(FleetMessage::Map(robot, map));
        })?);
    }
    Ok(feeds)
}

/// Asks the link for the scans that somebody receives on this transport.
fn demand_scans<P: Ports + 'static, T: Transport + 'static>(
    ports: &P,
    run: &Run,
    transport: &Rc<T>,
) -> FeedResult<P> {
    let mut demand = ScanDemandSender::open(ports, run, ScanPurpose::Viewing)?;
    let (transport, clock, robots) = (transport.clone(), ports.clock(), run.config.fleet.robots);
    let step = Box::new(move || {
        let now = clock.now();
        let has_subscriber = |robot: &RobotId| transport.has_subscriber(FleetTopic::Scan, *robot);
        demand.update(RobotId::first(robots).filter(has_subscriber), now);
        now.next_multiple(DEMAND_PERIOD)
    });
    // Nobody notifies of a subscription: any channel that is rarely written will do.
    Ok(Feed { listener: ports.listener(&channel::stats())?, step })
}

/// Passes each message of a channel on.
pub fn forward<P: Ports, M: Message, T: 'static>(
    ports: &P,
    to: &Rc<T>,
    channel: &Channel<M>,
    handle: impl Fn(&T, &M) + 'static,
) -> FeedResult<P> {
    let mut reader = ports.reader(channel)?;
    let to = to.clone();
    when_written(ports, channel, move || {
        while let Some(message) = reader.receive() {
            handle(&to, &message);
        }
    })
}

/// Passes each message of a channel on whose writer repeats some states; what is `silent` of such a state follows when it has not been
/// repeated for [`SILENT`].
fn forward_repeated<P: Ports, M: Message, T: 'static>(
    ports: &P,
    to: &Rc<T>,
    channel: &Channel<M>,
    silent: fn(&M) -> Option<M>,
    handle: impl Fn(&T, &M) + 'static,
) -> FeedResult<P> {
    let mut reader = ports.reader(channel)?;
    let (to, clock) = (to.clone(), ports.clock());
    let mut newest: Option<(M, Monotonic)> = None;
    let step = Box::new(move || {
        let now = clock.now();
        while let Some(message) = reader.receive() {
            handle(&to, &message);
            newest = silent(&message).map(|silent| (silent, now));
        }
        if let Some((silent, _)) = newest.take_if(|(_, since)| now >= *since + SILENT) {
            handle(&to, &silent);
        }
        let poll = now.next_multiple(HISTORY_POLL_PERIOD);
        newest.map_or(poll, |(_, since)| poll.min(since + SILENT))
    });
    Ok(Feed { listener: ports.listener(channel)?, step })
}

/// Calls `handle` at the start, whenever the channel is written, and every `HISTORY_POLL_PERIOD` if the channel has a
/// history: a reader that was opened later gets it without a notification.
pub fn when_written<P: Ports, M: Message>(
    ports: &P,
    channel: &Channel<M>,
    mut handle: impl FnMut() + 'static,
) -> FeedResult<P> {
    let (clock, has_history) = (ports.clock(), channel.row.history > 0);
    let step = Box::new(move || {
        handle();
        if has_history { clock.now().next_multiple(HISTORY_POLL_PERIOD) } else { WHEN_WRITTEN }
    });
    Ok(Feed { listener: ports.listener(channel)?, step })
}

/// Publishes a robot's transforms and odometry. Transforms are written after the odometry of the same stamp, and notify.
fn publish_motion<P: Ports, T: Transport + 'static>(
    ports: &P,
    transport: &Rc<T>,
    robot: RobotId,
) -> FeedResult<P> {
    let mut transforms: P::Reader<Transforms> = ports.reader(&channel::transforms(robot))?;
    let mut odometry: P::Reader<Odometry> = ports.reader(&channel::odometry(robot))?;
    let transport = transport.clone();
    when_written(ports, &channel::transforms(robot), move || {
        while let Some(transforms) = transforms.receive() {
            transport.publish(FleetMessage::Transforms(robot, &transforms));
        }
        while let Some(odometry) = odometry.receive() {
            transport.publish(FleetMessage::Odometry(robot, &odometry));
        }
    })
}

/// Publishes the merged map and the map transforms, which are written before it.
fn publish_merged_map<P: Ports, T: Transport + 'static>(ports: &P, transport: &Rc<T>) -> FeedResult<P> {
    let mut map_transforms: P::Reader<MapTransforms> = ports.reader(&channel::map_transforms())?;
    publish_map(ports, transport, &channel::merged_map(), move |to, map| {
        if let Some(map_transforms) = map_transforms.newest() {
            to.publish(FleetMessage::MapTransforms(&map_transforms));
        }
        to.publish(FleetMessage::MergedMap(map));
    })
}

/// Publishes the newest version of a map as one grid: at once if the last grid was long enough ago, otherwise then.
fn publish_map<P: Ports, T: Transport + 'static>(
    ports: &P,
    transport: &Rc<T>,
    channel: &Channel<PatchHeader>,
    mut publish: impl FnMut(&T, GridView<'_>) + 'static,
) -> FeedResult<P> {
    let mut reader = ports.map_reader(channel)?;
    let (transport, clock) = (transport.clone(), ports.clock());
    let mut grid = DenseMap::default();
    let (mut has_changed, mut due) = (false, Monotonic(0));
    let step = Box::new(move || {
        has_changed |= reader.poll();
        let now = clock.now();
        if has_changed && now >= due {
            let map = grid.update(reader.map());
            publish(&transport, map);
            let cells = map.cells.len() as u32;
            (has_changed, due) = (false, clock.now() + (GRID_PERIOD + GRID_CELL_TIME * cells));
        }
        if has_changed { due } else { now.next_multiple(MAP_POLL_PERIOD) }
    });
    Ok(Feed { listener: ports.listener(channel)?, step })
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
