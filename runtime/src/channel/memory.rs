//! Shared memory that a fleet's channels need, computed from the table of channels.

use super::{CHANNELS, ChannelRow, Endpoint, Scope};
use crate::processes;
use msg::tiles::PATCH_TILES_MAX;
use msg::{MapTile, Message, PatchHeader};

/// Messages that a writer keeps beside those of its readers: one that is being filled, and one that is spare.
const WRITER_MESSAGES: usize = 2;
/// Descriptions, queues and indices of one channel, bytes: they are in files of whole pages.
const CHANNEL_BYTES: usize = 64 << 10;

/// Need of a fleet, bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SharedMemoryNeed {
    /// Need while every reader keeps up: a fleet does not start with less.
    pub least: u64,
    /// Need when every reader is as far behind as its queue allows, and every map changes as a whole.
    pub most: u64,
}

/// Computes what the channels of a fleet need. `external`: the robots are not simulated here.
pub fn shared_memory_need(robots: usize, external: bool) -> SharedMemoryNeed {
    let processes = processes::of_fleet(robots, external, true, true).count();
    let mut need = SharedMemoryNeed { least: 0, most: 0 };
    for row in CHANNELS {
        let channels = match row.scope {
            Scope::Fleet => 1,
            Scope::Robot => robots,
            Scope::Process => processes,
        };
        let readers = reader_count(row, robots);
        let writers = row.writers.iter().filter(|end| !is_of_other_machines(end)).count();
        let writers = if row.scope == Scope::Process { 1 } else { writers };
        let message = message_bytes(row);
        let at = |depth: usize| (writers * (readers * depth + row.history + WRITER_MESSAGES)) * message;
        need.least += (channels * (at(1) + CHANNEL_BYTES)) as u64;
        need.most += (channels * (at(row.depth) + CHANNEL_BYTES)) as u64;
    }
    need
}

/// Number of processes that read one channel of a row.
fn reader_count(row: &ChannelRow, robots: usize) -> usize {
    let of = |end: &Endpoint| match end {
        Endpoint::OfOthers(_) => robots.saturating_sub(1),
        Endpoint::Of(program) if program.is_per_robot() && row.scope == Scope::Fleet => robots,
        _ => 1,
    };
    row.readers.iter().filter(|end| !is_of_other_machines(end)).map(of).sum()
}

/// Returns whether an end exists only where robots and base are on several machines: it takes the place of another, or reads
/// at their pace.
fn is_of_other_machines(end: &Endpoint) -> bool {
    matches!(end, Endpoint::OtherMachines(_))
}

/// Size of a message; a map's is that of the largest.
fn message_bytes(row: &ChannelRow) -> usize {
    let tiles = if row.message == PatchHeader::NAME { PATCH_TILES_MAX * size_of::<MapTile>() } else { 0 };
    row.message_bytes + tiles
}

#[cfg(test)]
mod tests {
    use super::*;

    fn need(robots: usize) -> SharedMemoryNeed {
        shared_memory_need(robots, false)
    }

    #[test]
    fn the_need_grows_with_the_fleet() {
        let [one, eight] = [need(1), need(8)];
        assert!(one.least < one.most && eight.least < eight.most);
        assert!(eight.least > 4 * one.least && eight.least < 9 * one.least, "{one:?} {eight:?}");
        // Eight robots were seen to use 9 MB.
        assert!(eight.least > 9 << 20, "{eight:?}");
    }
}
