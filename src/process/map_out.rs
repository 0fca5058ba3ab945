//! One robot's map on its way out of SLAM: drawn in slices, sent when it has changed.

use super::MAP_PERIOD;
use crate::channel;
use crate::shared_memory::{ChannelError, MapWriter, Node};
use ::slam::Back;
use msg::RobotId;
use std::time::{Duration, Instant};

/// Cells of beams drawn before the next node is looked for: a millisecond or so.
const SLICE_CELLS: usize = 400_000;
/// How often a map at rest is looked after: somebody may have come who needs the whole.
const LOOK_PERIOD: Duration = Duration::from_millis(200);

/// Draws and sends beside other work: [`MapOut::tend`] takes about a millisecond at a time.
pub struct MapOut {
    writer: MapWriter,
    drawing: bool,
    sending: bool,
    sent: Option<Instant>,
}

impl MapOut {
    /// The robot's map is written by whoever has this.
    pub fn open(node: &Node, robot: RobotId) -> Result<Self, ChannelError> {
        let writer = node.map_writer(&channel::map(robot))?;
        Ok(Self { writer, drawing: false, sending: false, sent: None })
    }

    /// How long other work may be waited for before the next [`MapOut::tend`].
    pub fn patience(&self) -> Duration {
        match (self.drawing, self.sending) {
            (true, _) => Duration::ZERO,
            (false, true) => MapWriter::PAUSE,
            (false, false) => LOOK_PERIOD,
        }
    }

    /// There is something new to draw.
    pub fn news(&mut self) {
        self.drawing = true;
    }

    /// Draws a slice, and sends what has changed if it is time.
    pub fn tend(&mut self, back: &mut Back) {
        self.drawing = self.drawing && back.draw(SLICE_CELLS);
        let pause = if self.sending { MapWriter::PAUSE } else { MAP_PERIOD };
        if self.sent.is_none_or(|sent| sent.elapsed() >= pause) {
            self.sending = !self.writer.send(back.tiles());
            self.sent = Some(Instant::now());
        }
    }
}
