//! The channel of what operators do.

use super::{BRIDGE, RECORD, STREAM};
use crate::channel::Endpoint::Of;
use crate::channel::Program::RecordTool;
use crate::channel::{ChannelRow, Scope, TypedRow};
use msg::OperatorEvent;

pub(super) static OPERATOR_EVENT: TypedRow<OperatorEvent> = TypedRow::new(ChannelRow {
    name: "operator_event",
    content: "emergency stop, its release, selection and takeover of robots, with who did it, on demand",
    scope: Scope::Fleet,
    writers: &[Of(BRIDGE)],
    readers: &[Of(RECORD), Of(RecordTool)],
    depth: 64,
    // The recorder polls.
    wakes: false,
    ..STREAM
});
