//! One robot's SLAM. One thread answers scans and waits for nothing else; the other closes loops,
//! solves, and draws the map beside it.

use super::pulse::{Account, Pulse};
use super::{Error, MAP_PERIOD};
use crate::channel;
use crate::run::Run;
use crate::shared_memory::{ChannelError, wait};
use crate::stop::Stop;
use ::slam::{Back, Node, Revision, Slam};
use msg::{RobotId, Role};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::time::Instant;

/// Nodes the work beside may fall behind the scans: at a node each half metre or so, minutes of driving.
const NODES_WAITING_MAX: usize = 256;

pub fn run(run: &Run, robot: RobotId, stop: &Stop) -> Result<(), Error> {
    let (mut front, back) = Slam::new(run.config.slam.clone()).split();
    let (nodes, nodes_in) = sync_channel::<Node>(NODES_WAITING_MAX);
    let (revisions, revisions_in) = sync_channel::<Revision>(NODES_WAITING_MAX);

    let node = run.attach(Role::Slam, Some(robot))?;
    let mut pulse = Pulse::new(&node, run, Role::Slam, Some(robot))?;
    let mut scans = node.reader(&channel::scan(robot))?;
    let scan_bell = node.bell(&channel::scan(robot))?;
    let mut odometry = node.reader(&channel::odometry(robot))?;
    let mut corrections = node.writer(&channel::correction(robot))?;
    let mut refused = 0;
    std::thread::scope(|scope| {
        let beside = scope.spawn(|| beside(run, robot, back, nodes_in, revisions));
        while !stop.requested() && !beside.is_finished() {
            wait(&[&scan_bell], pulse.due());
            while let Some(scan) = scans.receive() {
                while let Some(odometry) = odometry.receive() {
                    front.odometry(&odometry);
                }
                revisions_in.try_iter().for_each(|revision| front.revise(revision));
                let step = pulse.work(|| front.process(&scan));
                corrections.send(&step.correction);
                refused += u64::from(step.refused.is_some());
                // The scan's own map never waits; only a graph minutes behind would hold it up here.
                step.node.into_iter().for_each(|node| drop(nodes.send(node)));
            }
            pulse.beat(|| Account { gaps: scans.gaps(), refused, ..Account::default() });
        }
        drop(nodes);
        beside.join().map_err(|_| "the work beside the scans failed")?.map_err(Error::from)
    })
}

/// Loops, graph and map, until there are no more nodes to come.
fn beside(
    run: &Run,
    robot: RobotId,
    mut back: Back,
    nodes: Receiver<Node>,
    revisions: SyncSender<Revision>,
) -> Result<(), ChannelError> {
    // A presence of its own: shared memory's ports stay on the thread that made them.
    let presence = crate::shared_memory::Node::open(&run.domain, &format!("{robot}/map"))?;
    let mut maps = presence.grid_writer(&channel::map(robot))?;
    let mut sent: Option<Instant> = None;
    let mut news = false;
    loop {
        match nodes.recv_timeout(MAP_PERIOD) {
            // The scan path takes revisions at each scan, and has room for one for each node that waits.
            Ok(node) => news |= revisions.try_send(back.add(node)).is_ok(),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return Ok(()),
        }
        if news && sent.is_none_or(|sent| sent.elapsed() >= MAP_PERIOD) {
            maps.send(back.map());
            (news, sent) = (false, Some(Instant::now()));
        }
        maps.refresh();
    }
}
