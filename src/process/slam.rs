//! One robot's SLAM. One thread answers scans and waits for nothing else; the other closes loops,
//! solves, and draws the map beside it.

use super::pulse::{Account, Pulse};
use super::{Error, MAP_PERIOD};
use crate::channel;
use crate::run::Run;
use crate::shared_memory::{ChannelError, MapWriter, wait};
use crate::stop::Stop;
use ::slam::{Back, NODES_UNDER_WAY_MAX, Node, Revision, Slam};
use msg::{Correction, Pose2, RobotId, Role, TileMap};
use std::sync::OnceLock;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::time::{Duration, Instant};

/// Revisions the scan path may fall behind; at each scan it takes all there are.
const REVISIONS_WAITING_MAX: usize = 256;
/// Cells of beams drawn before the next node is looked for: a millisecond or so.
const SLICE_CELLS: usize = 400_000;
/// How often a map at rest is looked after: somebody may have come who needs the whole.
const LOOK_PERIOD: Duration = Duration::from_millis(200);

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
    let mut maps = presence.map_writer(&channel::map(robot))?;
    let mut sent: Option<Instant> = None;
    let (mut drawing, mut sending) = (false, false);
    loop {
        let patience = match (drawing, sending) {
            (true, _) => Duration::ZERO,
            (false, true) => MapWriter::PAUSE,
            (false, false) => LOOK_PERIOD,
        };
        match nodes.recv_timeout(patience) {
            Ok(node) => {
                // The scan path takes revisions at each scan, and has room for one for each node that waits.
                let _ = revisions.try_send(back.add(node));
                drawing = true;
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return Ok(()),
        }
        drawing = drawing && back.draw(SLICE_CELLS);
        let pause = if sending { MapWriter::PAUSE } else { MAP_PERIOD };
        if sent.is_none_or(|sent| sent.elapsed() >= pause) {
            sending = !maps.send(&shift.map(back.tiles()));
            sent = Some(Instant::now());
        }
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
            covariance: turned(correction.covariance, shift.yaw_rad),
            ..*correction
        }
    }

    fn map(&self, map: &TileMap) -> TileMap {
        let shift = self.before_from_map.get().copied().unwrap_or(Pose2::IDENTITY);
        let mut map = map.clone();
        map.header.origin = shift * map.header.origin;
        map
    }
}

/// A pose's covariance (row-major upper triangle over x, y, yaw) as seen from a frame turned by `yaw_rad`.
fn turned([xx, xy, xa, yy, ya, aa]: [f64; 6], yaw_rad: f64) -> [f64; 6] {
    let (s, c) = yaw_rad.sin_cos();
    let across = s * c * (xx - yy) + (c * c - s * s) * xy;
    [
        c * c * xx - 2.0 * s * c * xy + s * s * yy,
        across,
        c * xa - s * ya,
        s * s * xx + 2.0 * s * c * xy + c * c * yy,
        s * xa + c * ya,
        aa,
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::f64::consts::FRAC_PI_2;

    #[test]
    fn a_worker_started_again_tells_its_doubt_in_the_old_frame() {
        // Sure along x, unsure along y; the new map lies a quarter turn to the left in the old one.
        let shift = Shift::new(Some(Pose2::new(1.0, 2.0, FRAC_PI_2)));
        let covariance = [0.01, 0.002, 0.003, 0.25, -0.004, 0.05];
        let found = shift.correction(&Correction { covariance, ..Correction::default() });
        let wanted = [0.25, -0.002, 0.004, 0.01, 0.003, 0.05];
        for (found, wanted) in found.covariance.iter().zip(wanted) {
            assert!((found - wanted).abs() < 1e-12, "{:?}", found);
        }
        assert_eq!(found.map_from_base, Pose2::new(1.0, 2.0, FRAC_PI_2));
    }
}
