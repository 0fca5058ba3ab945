//! Bytes and messages by kind, for the table of what a robot costs.

use crate::table::{Kind, TABLE};

/// Bytes and messages of each kind that were sent or received, without the overhead of the transport.
#[derive(Clone, Copy, Debug, Default)]
pub struct ByteCounters {
    rows: [(u64, u64); TABLE.len()],
}

impl ByteCounters {
    /// Counts a message of this many bytes.
    pub fn add(&mut self, kind: Kind, bytes: usize) {
        let index = TABLE.iter().position(|row| row.kind == kind).unwrap_or_default();
        self.rows[index].0 += bytes as u64;
        self.rows[index].1 += 1;
    }

    /// Returns the name, the bytes and the messages of each kind.
    pub fn rows(&self) -> impl Iterator<Item = (&'static str, u64, u64)> + '_ {
        TABLE.iter().zip(&self.rows).map(|(row, (bytes, messages))| (row.name, *bytes, *messages))
    }

    /// Returns the bytes of all kinds.
    pub fn bytes(&self) -> u64 {
        self.rows.iter().map(|(bytes, _)| bytes).sum()
    }
}
