//! One robot's submaps on their way out of SLAM: to the fleet's joint graph.

use crate::channel;
use crate::ports::ChannelError;
use crate::shared_memory::{Participant, Reader, Writer};
use ::slam::{Back, SlamConfig, Submaps};
use msg::{RobotId, Submap, SubmapPoses, SubmapRequest};
use std::time::{Duration, Instant};

/// The shortest time between two submaps: readers have room for eight.
const PAUSE: Duration = Duration::from_millis(100);
/// How often late readers are let in and questions are looked for.
const LOOK_PERIOD: Duration = Duration::from_millis(500);

/// Draws and sends beside other work: [`SubmapsOut::tend`] draws one submap at most.
pub struct SubmapsOut {
    submaps: Submaps,
    writer: Writer<Submap>,
    poses: Writer<SubmapPoses>,
    asks: Reader<SubmapRequest>,
    /// There may be submaps to send.
    sending: bool,
    sent: Instant,
    looked: Instant,
}

impl SubmapsOut {
    /// The robot's submaps are written by whoever has this.
    pub fn open(node: &Participant, robot: RobotId, config: &SlamConfig) -> Result<Self, ChannelError> {
        let now = Instant::now();
        Ok(Self {
            submaps: Submaps::new(config),
            writer: node.writer(&channel::submap(robot))?,
            poses: node.writer(&channel::submap_poses(robot))?,
            asks: node.reader(&channel::submap_request(robot))?,
            sending: false,
            sent: now,
            looked: now,
        })
    }

    /// The back end is another: none of its nodes has been looked at.
    pub fn begin_again(&mut self) {
        self.submaps.begin_again();
    }

    /// The back end has new nodes, or its graph was bent.
    pub fn news(&mut self, back: &Back) {
        self.submaps.update(back);
        let submaps = &self.submaps;
        self.poses.send_with(|poses| submaps.poses(back, poses));
        self.sending = true;
    }

    /// How long other work may be waited for before the next [`SubmapsOut::tend`].
    pub fn patience(&self) -> Duration {
        if self.sending { PAUSE } else { LOOK_PERIOD }
    }

    /// Sends a submap that has changed, if it is time.
    pub fn tend(&mut self, back: &Back) {
        if self.looked.elapsed() >= LOOK_PERIOD {
            self.looked = Instant::now();
            self.poses.refresh();
            if self.asks.newest().is_some() {
                self.submaps.give_again();
                self.sending = true;
            }
        }
        if !self.sending || self.sent.elapsed() < PAUSE {
            return;
        }
        match self.submaps.next_changed(back) {
            Some(submap) => self.writer.send(submap),
            None => self.sending = false,
        }
        self.sent = Instant::now();
    }
}
