//! Lists of parts in a message, with how much of each has arrived.

use crate::error::WireError;
use crate::part::PartKey;
use crate::reader::Reader;
use crate::wire::{RECEIPT_BYTES, Receipt};

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
