//! The base's side of the transfer of a robot's map: what has arrived, as a whole or in part.

use crate::content::decode;
use crate::part::{ABSENT, PartContent, PartKey};
use crate::wire::{COMPLETE, Chunk, HeldPage, PAGES_MAX, RECEIPTS_MAX, Receipt};
use std::collections::BTreeMap;

/// Parts that may be incomplete at a time: what a robot has on its way.
const INCOMPLETE_MAX: usize = 128;
/// Bytes of all incomplete parts of a robot together.
const INCOMPLETE_BYTES_MAX: usize = 2 << 20;
/// Parts of one robot: tiles of its map, submaps, and two more.
const PARTS_MAX: usize = RECEIPTS_MAX * PAGES_MAX as usize;

/// Part of which the first bytes have arrived.
#[derive(Debug)]
struct Incomplete {
    hash: u64,
    total: usize,
    bytes: Vec<u8>,
}

/// Receives the parts of a robot's map.
#[derive(Debug, Default)]
pub struct PartReceiver {
    /// Hashes of the parts that have arrived.
    complete: BTreeMap<PartKey, u64>,
    incomplete: BTreeMap<PartKey, Incomplete>,
    acknowledgements: BTreeMap<PartKey, (u64, u32)>,
    lists: u32,
    /// Pieces and parts that were refused.
    refused: u64,
}

/// Change of a robot's map.
#[derive(Debug)]
pub enum PartChange {
    /// The part has this content now.
    Replaced(PartContent),
    /// The part does not exist any more.
    Removed,
}

impl PartReceiver {
    /// Takes a piece. Returns the part's change when the part is complete.
    pub fn receive(&mut self, chunk: &Chunk) -> Option<(PartKey, PartChange)> {
        let Chunk { key, hash, total, offset, ref bytes } = *chunk;
        let total = total as usize;
        if total == 0 {
            self.incomplete.remove(&key);
            self.acknowledgements.insert(key, (ABSENT, COMPLETE));
            return self.complete.remove(&key).map(|_| (key, PartChange::Removed));
        }
        if self.complete.get(&key) == Some(&hash) {
            self.acknowledgements.insert(key, (hash, COMPLETE));
            return None;
        }
        if !self.begin(key, hash, total) {
            self.refused += 1;
            return None;
        }
        let part = self.incomplete.get_mut(&key)?;
        if part.bytes.len() == offset as usize {
            part.bytes.extend_from_slice(bytes);
        }
        if part.bytes.len() < part.total {
            self.acknowledgements.insert(key, (hash, part.bytes.len() as u32));
            return None;
        }
        let part = self.incomplete.remove(&key)?;
        match decode(key, hash, &part.bytes) {
            Ok(content) => {
                self.complete.insert(key, hash);
                self.acknowledgements.insert(key, (hash, COMPLETE));
                Some((key, PartChange::Replaced(content)))
            }
            Err(_) => {
                self.refused += 1;
                None
            }
        }
    }

    /// Forgets all parts. Counters and the number of the list go on.
    pub fn forget_parts(&mut self) {
        self.complete.clear();
        self.incomplete.clear();
        self.acknowledgements.clear();
    }

    /// Makes room for a part; returns whether it may arrive.
    fn begin(&mut self, key: PartKey, hash: u64, total: usize) -> bool {
        if self.incomplete.get(&key).is_some_and(|part| (part.hash, part.total) == (hash, total)) {
            return true;
        }
        self.incomplete.remove(&key);
        let is_new = !self.complete.contains_key(&key);
        let bytes: usize = self.incomplete.values().map(|part| part.total).sum();
        if self.incomplete.len() >= INCOMPLETE_MAX
            || bytes + total > INCOMPLETE_BYTES_MAX
            || (is_new && self.complete.len() + self.incomplete.len() >= PARTS_MAX)
        {
            return false;
        }
        self.incomplete.insert(key, Incomplete { hash, total, bytes: Vec::new() });
        true
    }

    /// Returns the acknowledgements that are due, at most as many as a message holds.
    pub fn take_acknowledgements(&mut self) -> Vec<Receipt> {
        let mut receipts = Vec::new();
        while receipts.len() < RECEIPTS_MAX
            && let Some((key, (hash, received))) = self.acknowledgements.pop_first()
        {
            receipts.push(Receipt { key, hash, received });
        }
        receipts
    }

    /// Returns the list of all parts that have arrived, in pages.
    pub fn list(&mut self) -> Vec<HeldPage> {
        self.lists = self.lists.wrapping_add(1);
        let complete = self.complete.iter().map(|(key, hash)| (*key, *hash, COMPLETE));
        let begun = self.incomplete.iter().map(|(key, part)| (*key, part.hash, part.bytes.len() as u32));
        // A part of which a new version has begun counts as the old one; the new one begins again.
        let begun = begun.filter(|(key, ..)| !self.complete.contains_key(key));
        let parts: Vec<Receipt> =
            complete.chain(begun).map(|(key, hash, received)| Receipt { key, hash, received }).collect();
        let mut chunks: Vec<Vec<Receipt>> = parts.chunks(RECEIPTS_MAX).map(<[Receipt]>::to_vec).collect();
        if chunks.is_empty() {
            chunks.push(Vec::new());
        }
        let pages = chunks.len() as u16;
        let page = |(page, parts)| HeldPage { page: page as u16, pages, list: self.lists, parts };
        chunks.into_iter().enumerate().map(page).collect()
    }

    /// Returns the number of parts that have arrived.
    pub fn len(&self) -> usize {
        self.complete.len()
    }

    /// Returns whether no part has arrived.
    pub fn is_empty(&self) -> bool {
        self.complete.is_empty()
    }

    /// Returns the number of pieces and parts that were refused.
    pub fn refused(&self) -> u64 {
        self.refused
    }
}
