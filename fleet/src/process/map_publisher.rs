//! Draws a robot's map in slices and publishes its changed tiles.

use super::MAP_PERIOD;
use crate::channel;
use crate::ports::{ChannelError, MAP_PAUSE, Ports, WriteMapPort};
use ::slam::BackEnd;
use msg::{Monotonic, RobotId};
use std::time::Duration;

/// Largest number of cells of beams that one step draws, about a millisecond of work.
const SLICE_CELLS: usize = 400_000;
/// Period at which an unchanged map is checked for new readers, which need the whole map.
const POLL_PERIOD: Duration = Duration::from_millis(200);

/// Draws and sends a map between other work: a step takes about a millisecond.
pub struct MapPublisher<P: Ports> {
    writer: P::MapWriter,
    drawing: bool,
    /// The whole map has been drawn once: before that, readers keep what the process before this one sent.
    has_drawn: bool,
    /// The map has changes that readers do not have yet.
    unsent: bool,
    sending: bool,
    /// Moment of the last transmission.
    sent: Option<Monotonic>,
}

impl<P: Ports> MapPublisher<P> {
    /// Opens the channel of the robot's map.
    pub fn open(ports: &P, robot: RobotId) -> Result<Self, ChannelError> {
        let writer = ports.map_writer(&channel::map(robot))?;
        Ok(Self { writer, drawing: false, has_drawn: false, unsent: false, sending: false, sent: None })
    }

    /// Marks the map as changed, so that it is drawn and sent.
    pub fn mark_changed(&mut self) {
        (self.drawing, self.unsent) = (true, true);
    }

    /// Draws a slice, and sends changed tiles if they are due. Returns when the next step is due.
    pub fn step(&mut self, back: &mut BackEnd, now: Monotonic) -> Monotonic {
        self.drawing = self.drawing && back.draw(SLICE_CELLS);
        self.has_drawn |= !self.drawing;
        if self.has_drawn && self.pause_left(now).is_zero() {
            let before = self.writer.bytes();
            self.sending = !self.writer.send(back.tiles());
            self.unsent = self.drawing || self.sending;
            // A check for new readers that sent nothing must not delay the next changes.
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
