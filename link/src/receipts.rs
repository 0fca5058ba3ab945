//! Lists of parts in a message, with how much of each has arrived.

use crate::error::WireError;
use crate::part::{KEY_BYTES, PartKey};
use crate::reader::Reader;

/// Number of bytes of one entry in a list of parts.
pub const RECEIPT_BYTES: usize = KEY_BYTES + 12;

/// How much of a part has arrived.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Receipt {
    /// Key of the part.
    pub key: PartKey,
    /// Hash of its uncompressed content.
    pub hash: u64,
    /// Number of bytes of the compressed part that have arrived; [`COMPLETE`]: all.
    pub received: u32,
}

/// Value of [`Receipt::received`] of a part that has arrived as a whole.
pub const COMPLETE: u32 = u32::MAX;

pub fn write_receipts(to: &mut Vec<u8>, parts: &[Receipt]) {
    for part in parts {
        to.extend(part.key.to_bytes());
        to.extend(part.hash.to_le_bytes());
        to.extend(part.received.to_le_bytes());
    }
}

pub fn read_receipts(from: &mut Reader<'_>) -> Result<Option<Vec<Receipt>>, WireError> {
    let mut parts = Vec::with_capacity(from.bytes.len() / RECEIPT_BYTES);
    while !from.bytes.is_empty() {
        let Some(key) = PartKey::from_bytes(from.array()?) else { return Ok(None) };
        parts.push(Receipt { key, hash: from.u64()?, received: from.u32()? });
    }
    Ok(Some(parts))
}
