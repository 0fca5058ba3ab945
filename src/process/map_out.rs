//! One robot's map on its way out of SLAM: drawn in slices, sent when it has changed.

use super::MAP_PERIOD;
use crate::channel;
use crate::ports::{ChannelError, MAP_PAUSE, WriteMapPort};
use crate::shared_memory::{MapWriter, Participant};
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
    /// Something new was drawn, or is being sent.
    unsent: bool,
    sending: bool,
    /// When something went out last.
    sent: Option<Instant>,
}

impl MapOut {
    /// The robot's map is written by whoever has this.
    pub fn open(node: &Participant, robot: RobotId) -> Result<Self, ChannelError> {
        let writer = node.map_writer(&channel::map(robot))?;
        Ok(Self { writer, drawing: false, unsent: false, sending: false, sent: None })
    }

    /// How long other work may be waited for before the next [`MapOut::tend`].
    pub fn patience(&self) -> Duration {
        match (self.drawing, self.unsent) {
            (true, _) => Duration::ZERO,
            (false, true) => self.pause_left(),
            (false, false) => LOOK_PERIOD,
        }
    }

    /// There is something new to draw.
    pub fn news(&mut self) {
        (self.drawing, self.unsent) = (true, true);
    }

    /// Draws a slice, and sends what has changed if it is time.
    pub fn tend(&mut self, back: &mut Back) {
        self.drawing = self.drawing && back.draw(SLICE_CELLS);
        if !self.pause_left().is_zero() {
            return;
        }
        let before = self.writer.bytes();
        self.sending = !self.writer.send(back.tiles());
        self.unsent = self.drawing || self.sending;
        // Looking whether somebody needs the whole holds up nothing that comes meanwhile.
        if self.sending || self.writer.bytes() != before {
            self.sent = Some(Instant::now());
        }
    }

    fn pause_left(&self) -> Duration {
        let pause = if self.sending { MAP_PAUSE } else { MAP_PERIOD };
        self.sent.map_or(Duration::ZERO, |sent| pause.saturating_sub(sent.elapsed()))
    }
}
