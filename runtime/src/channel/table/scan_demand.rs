//! The channel of the robots whose scans a base wants from other machines.

use super::{BRIDGE, NAV, RECORD, REQUEST_WRITERS_MAX, STREAM};
use crate::channel::Endpoint::OtherMachines;
use crate::channel::Program::{LinkTool, RecordTool};
use crate::channel::{Channel, ChannelRow, Scope, TypedRow};
use msg::ScanDemand;

pub(super) static SCAN_DEMAND: TypedRow<ScanDemand> = TypedRow::new(ChannelRow {
    name: "scan_demand",
    content: "at the base: whose scans somebody looks at, records or drives by, 2 Hz meanwhile",
    scope: Scope::Fleet,
    writers: &[OtherMachines(BRIDGE), OtherMachines(NAV), OtherMachines(RECORD), OtherMachines(RecordTool)],
    readers: &[OtherMachines(LinkTool)],
    depth: 16,
    writers_max: REQUEST_WRITERS_MAX,
    // The link polls fifty times a second.
    wakes: false,
    ..STREAM
});

/// `scan_demand`: robots on other machines whose scans are wanted at the base.
pub fn scan_demand() -> Channel<ScanDemand> {
    SCAN_DEMAND.of_fleet()
}
