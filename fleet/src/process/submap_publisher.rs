//! Publishes a robot's submaps and their poses for the fleet's pose graph.

use crate::channel;
use crate::ports::{ChannelError, Clock, Ports, ReadPort, WritePort};
use ::slam::{BackEnd, SlamConfig, Submaps};
use msg::{Monotonic, RobotId, Submap, SubmapPoses, SubmapRequest};
use std::time::Duration;

/// Shortest time between two submaps: readers have room for eight.
const PAUSE: Duration = Duration::from_millis(100);
/// Period at which late readers get the history and requests are polled.
const POLL_PERIOD: Duration = Duration::from_millis(500);

/// Draws and sends submaps between other work: a step draws one at most.
pub struct SubmapPublisher<P: Ports> {
    submaps: Submaps,
    writer: P::Writer<Submap>,
    poses: P::Writer<SubmapPoses>,
    requests: P::Reader<SubmapRequest>,
    /// There may be submaps to send.
    sending: bool,
    sent: Monotonic,
    polled: Monotonic,
    /// Most nodes of the robot's map.
    nodes_max: usize,
    robot: RobotId,
    /// Number of the map's frame.
    frame: u32,
    /// Whether it was reported that the map is full, and that submaps are left out.
    is_warned: [bool; 2],
}

impl<P: Ports> SubmapPublisher<P> {
    /// Opens the channels.
    pub fn open(ports: &P, robot: RobotId, config: &SlamConfig, frame: u32) -> Result<Self, ChannelError> {
        let now = ports.clock().now();
        Ok(Self {
            submaps: Submaps::new(config),
            writer: ports.writer(&channel::submap(robot))?,
            poses: ports.writer(&channel::submap_poses(robot))?,
            requests: ports.reader(&channel::submap_request(robot))?,
            sending: false,
            sent: now,
            polled: now,
            nodes_max: config.graph.nodes_max,
            robot,
            frame,
            is_warned: [false; 2],
        })
    }

    /// Starts again with the nodes of a replaced back end, whose map has the frame of this number.
    pub fn restart(&mut self, frame: u32) {
        self.frame = frame;
        self.submaps.restart();
        self.is_warned = [false; 2];
    }

    /// Records that the back end has new nodes or a changed graph.
    pub fn update(&mut self, back: &BackEnd) {
        self.submaps.update(back);
        let (submaps, frame) = (&self.submaps, self.frame);
        self.poses.send_with(|poses| {
            submaps.poses(back, poses);
            poses.map_frame = frame;
        });
        self.sending = true;
        self.warn_about_limits(back);
    }

    /// Says once when a limit is reached: what comes later is missing.
    fn warn_about_limits(&mut self, back: &BackEnd) {
        let (robot, nodes) = (self.robot, back.nodes().len());
        let reached = [nodes >= self.nodes_max && back.grows_map(), self.submaps.nodes_without_submap() > 0];
        if reached[0] && !self.is_warned[0] {
            tracing::warn!(
                "{robot}: its map has {nodes} nodes (slam.graph.nodes_max) and grows no more; localize in it, or begin another"
            );
        }
        if reached[1] && !self.is_warned[1] {
            tracing::warn!(
                "{robot}: its map has as many submaps as merging keeps; later ones are missing where merging bends the map"
            );
        }
        self.is_warned = [0, 1].map(|limit| self.is_warned[limit] || reached[limit]);
    }

    /// Sends a submap that has changed, if it is time. Returns when the next step is due.
    pub fn step(&mut self, back: &BackEnd, now: Monotonic) -> Monotonic {
        if now.since(self.polled) >= POLL_PERIOD.as_nanos() as u64 {
            self.polled = now;
            self.poses.refresh();
            if self.requests.newest().is_some() {
                self.submaps.resend_all();
                self.sending = true;
            }
        }
        if self.sending && now.since(self.sent) >= PAUSE.as_nanos() as u64 {
            match self.submaps.next_changed(back) {
                Some(submap) => self.writer.send(submap),
                None => self.sending = false,
            }
            self.sent = now;
        }
        let patience = if self.sending { PAUSE } else { POLL_PERIOD };
        Monotonic(now.0 + patience.as_nanos() as u64)
    }
}
