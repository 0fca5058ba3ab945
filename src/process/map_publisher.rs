//! A robot's map on its way out of SLAM: drawn in slices, sent when it has changed.

use super::MAP_PERIOD;
use crate::channel;
use crate::ports::{ChannelError, MAP_PAUSE, Ports, WriteMapPort};
use ::slam::BackEnd;
use msg::{Monotonic, RobotId};
use std::time::Duration;

/// Cells of beams drawn before the next node is looked for: a millisecond or so.
const SLICE_CELLS: usize = 400_000;
/// How often a map at rest is looked after: a reader may have come that needs the whole.
const POLL_PERIOD: Duration = Duration::from_millis(200);

/// Draws and sends a map beside other work: a step takes about a millisecond.
pub struct MapPublisher<P: Ports> {
    writer: P::MapWriter,
    drawing: bool,
    /// Something new was drawn, or is being sent.
    unsent: bool,
    sending: bool,
    /// When something was sent last.
    sent: Option<Monotonic>,
}

impl<P: Ports> MapPublisher<P> {
    /// Opens the channel of the robot's map.
    pub fn open(ports: &P, robot: RobotId) -> Result<Self, ChannelError> {
        let writer = ports.map_writer(&channel::map(robot))?;
        Ok(Self { writer, drawing: false, unsent: false, sending: false, sent: None })
    }

    /// There is something new to draw.
    pub fn redraw(&mut self) {
        (self.drawing, self.unsent) = (true, true);
    }

    /// Draws a slice, and sends what has changed if it is time. Returns when the next step is due.
    pub fn step(&mut self, back: &mut BackEnd, now: Monotonic) -> Monotonic {
        self.drawing = self.drawing && back.draw(SLICE_CELLS);
        if self.pause_left(now).is_zero() {
            let before = self.writer.bytes();
            self.sending = !self.writer.send(back.tiles());
            self.unsent = self.drawing || self.sending;
            // Looking whether a reader needs the whole holds up nothing that comes meanwhile.
            if self.sending || self.writer.bytes() != before {
                self.sent = Some(now);
            }
        }
        let patience = match (self.drawing, self.unsent) {
            (true, _) => Duration::ZERO,
            (false, true) => self.pause_left(now),
            (false, false) => POLL_PERIOD,
        };
        Monotonic(now.0 + patience.as_nanos() as u64)
    }

    fn pause_left(&self, now: Monotonic) -> Duration {
        let pause = if self.sending { MAP_PAUSE } else { MAP_PERIOD };
        let elapsed = |sent| Duration::from_nanos(now.since(sent));
        self.sent.map_or(Duration::ZERO, |sent| pause.saturating_sub(elapsed(sent)))
    }
}
