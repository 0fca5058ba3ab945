//! One robot's SLAM. One thread answers scans and waits for nothing else; the other closes loops,
//! solves, and draws the map beside it.

use super::Error;
use super::map_out::MapOut;
use super::pulse::{Account, Pulse};
use super::submaps_out::SubmapsOut;
use crate::channel;
use crate::run::Run;
use crate::shared_memory::{ChannelError, wait};
use crate::stop::Stop;
use ::slam::{Back, NODES_UNDER_WAY_MAX, Node, Revision, Slam};
use msg::{Correction, Pose2, RobotId, Role, TileMap};
use std::sync::OnceLock;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};

/// Revisions the scan path may fall behind; at each scan it takes all there are.
const REVISIONS_WAITING_MAX: usize = 256;

pub fn run(run: &Run, robot: RobotId, at: Option<Pose2>, stop: &Stop) -> Result<(), Error> {
    let (mut front, back) = Slam::new(run.config.slam.clone()).split();
    let (nodes, nodes_in) = sync_channel::<Node>(NODES_UNDER_WAY_MAX);
    let (revisions, revisions_in) = sync_channel::<Revision>(REVISIONS_WAITING_MAX);

    let node = run.attach(Role::Slam, Some(robot))?;
    let mut pulse = Pulse::new(&node, run, Role::Slam, Some(robot))?;
    let mut scans = node.reader(&channel::scan(robot))?;
    let scan_bell = node.bell(&channel::scan(robot))?;
    let mut odometry = node.reader(&channel::odometry(robot))?;
    let mut corrections = node.writer(&channel::correction(robot))?;
    let mut refused = 0;
    let shift = Shift::new(at);
    std::thread::scope(|scope| {
        let beside = scope.spawn(|| beside(run, robot, &shift, back, nodes_in, revisions));
        while !stop.requested() && !beside.is_finished() {
            wait(&[&scan_bell], pulse.due());
            while let Some(scan) = scans.receive() {
                while let Some(odometry) = odometry.receive() {
                    front.odometry(&odometry);
                }
                revisions_in.try_iter().for_each(|revision| front.revise(revision));
                let step = pulse.work(|| front.process(&scan));
                corrections.send(&shift.correction(&step.correction));
                refused += u64::from(step.refused.is_some());
                // There is room for all that the scan path hands over: it never waits here.
                let _ = step.node.map(|node| nodes.try_send(node));
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
    shift: &Shift,
    mut back: Back,
    nodes: Receiver<Node>,
    revisions: SyncSender<Revision>,
) -> Result<(), ChannelError> {
    // A presence of its own: shared memory's ports stay on the thread that made them.
    let presence = crate::shared_memory::Node::open(&run.domain, &format!("{robot}/map"))?;
    let mut map = MapOut::open(&presence, robot)?;
    let mut submaps = SubmapsOut::open(&presence, robot, &run.config.slam)?;
    loop {
        match nodes.recv_timeout(map.patience().min(submaps.patience())) {
            Ok(node) => {
                // The scan path takes revisions at each scan, and has room for one for each node that waits.
                let _ = revisions.try_send(back.add(node));
                map.news();
                submaps.news(&back, shift.before_from_map());
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return Ok(()),
        }
        map.tend(&mut back, |map| shift.map(map));
        submaps.tend(&back);
    }
}

/// SLAM begins its map where the robot then stands. A worker that is started again goes on in its
/// predecessor's frame instead, so that the fleet's map need not move: `map_from_odom` continues.
struct Shift {
    before_from_odom: Option<Pose2>,
    before_from_map: OnceLock<Pose2>,
}

impl Shift {
    fn new(before_from_odom: Option<Pose2>) -> Self {
        Self { before_from_odom, before_from_map: OnceLock::new() }
    }

    /// The first correction settles where the new map lies in the old one.
    fn correction(&self, correction: &Correction) -> Correction {
        let settle =
            || self.before_from_odom.map_or(Pose2::IDENTITY, |at| at * correction.map_from_odom.inverse());
        let shift = *self.before_from_map.get_or_init(settle);
        Correction {
            map_from_odom: shift * correction.map_from_odom,
            map_from_base: shift * correction.map_from_base,
            ..*correction
        }
    }

    fn before_from_map(&self) -> Pose2 {
        self.before_from_map.get().copied().unwrap_or(Pose2::IDENTITY)
    }

    fn map(&self, map: &TileMap) -> TileMap {
        let mut map = map.clone();
        map.header.origin = self.before_from_map() * map.header.origin;
        map
    }
}
