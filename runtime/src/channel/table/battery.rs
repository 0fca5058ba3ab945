//! The channel of a robot's battery.

use super::{BRIDGE, RECORD, STREAM};
use crate::channel::Endpoint::{External, Of, OtherMachines};
use crate::channel::Program::{LinkTool, RecordTool};
use crate::channel::{Channel, ChannelRow, TypedRow};
use msg::{Battery, RobotId};

// No history: what a late reader got would look like the battery's state of now.
pub(super) static BATTERY: TypedRow<Battery> = TypedRow::new(ChannelRow {
    name: "battery",
    content: "the state of the robot's battery, at most 1 Hz, if the robot sends it",
    writers: &[External(BRIDGE), OtherMachines(LinkTool)],
    readers: &[Of(BRIDGE), Of(RECORD), Of(RecordTool), OtherMachines(LinkTool)],
    depth: 4,
    ..STREAM
});

/// `robotK/battery`: the state of the robot's battery.
pub fn battery(robot: RobotId) -> Channel<Battery> {
    BATTERY.of_robot(robot)
}
