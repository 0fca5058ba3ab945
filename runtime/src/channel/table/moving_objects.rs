//! The channel of people, doors and boxes that move in the simulated room.

use super::{OBJECTS, READERS_MAX, RECORD, SIM, STATE};
use crate::channel::Endpoint::Of;
use crate::channel::Program::RecordTool;
use crate::channel::{Channel, ChannelRow, TypedRow};
use msg::{MovingObjects, ROBOTS_MAX};

pub(super) static MOVING_OBJECTS: TypedRow<MovingObjects> = TypedRow::new(ChannelRow {
    name: "moving_objects",
    content: "where people, doors and boxes of the simulated room are, 20 Hz; only where there are any",
    writers: &[Of(OBJECTS)],
    readers: &[Of(SIM), Of(RECORD), Of(RecordTool)],
    readers_max: READERS_MAX + ROBOTS_MAX,
    // Simulators poll once in each of their ticks.
    wakes: false,
    ..STATE
});

/// `moving_objects`: people, doors and boxes of the simulated room.
pub fn moving_objects() -> Channel<MovingObjects> {
    MOVING_OBJECTS.of_fleet()
}
