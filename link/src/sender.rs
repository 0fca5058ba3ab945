//! The robot's side of the transfer of its map: what the base holds, what is on its way, and what comes next.

use crate::content::{compress, encode};
use crate::part::{ABSENT, PART_BYTES_MAX, PartContent, PartKey, hash};
use crate::wire::{CHUNK_BYTES_MAX, COMPLETE, Chunk, HeldPage, Receipt};
use msg::Monotonic;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

/// Parts on their way at a time.
const IN_FLIGHT_MAX: usize = 64;
/// Parts compressed in one call, so that a call takes milliseconds.
const COMPRESSED_MAX: usize = 32;

/// When and how much a robot sends of its map.
#[derive(Clone, Copy, Debug)]
pub struct SenderConfig {
    /// Time for which a part's changes are collected before it is sent.
    pub period: Duration,
    /// Time without an acknowledgement after which a piece is sent again.
    pub retry: Duration,
    /// Largest number of bytes on their way: what waits in the network before a stop.
    pub window_bytes: usize,
}

impl Default for SenderConfig {
    /// 16 kB are 0.13 s at 1 Mbit/s.
    fn default() -> Self {
        let (period, retry) = (Duration::from_secs(3), Duration::from_secs(1));
        Self { period, retry, window_bytes: 16 << 10 }
    }
}

/// Part of the robot's map.
#[derive(Debug)]
struct Part {
    /// Uncompressed content; `None` if the part does not exist any more.
    plain: Option<Arc<[u8]>>,
    hash: u64,
    /// Compressed content, once it was needed.
    compressed: Option<Arc<[u8]>>,
    /// When the part first differed from what the base holds or is sent.
    changed: Monotonic,
}

/// Part that is on its way.
#[derive(Debug)]
struct InFlight {
    hash: u64,
    bytes: Arc<[u8]>,
    /// Number of bytes sent, and acknowledged.
    sent: usize,
    acknowledged: usize,
    /// A part without bytes was sent, too.
    has_begun: bool,
    /// Last time at which a piece was sent or acknowledged.
    progress: Monotonic,
}

impl InFlight {
    fn outstanding(&self) -> usize {
        self.sent - self.acknowledged
    }
    fn has_more(&self) -> bool {
        !self.has_begun || self.sent < self.bytes.len()
    }
}

/// Pages of a list that is not complete yet.
#[derive(Debug, Default)]
struct OpenList {
    list: u32,
    pages: BTreeMap<u16, Vec<Receipt>>,
}

/// Sends the parts of a robot's map that the base does not hold.
#[derive(Debug)]
pub struct PartSender {
    config: SenderConfig,
    parts: BTreeMap<PartKey, Part>,
    /// Hashes of the parts that the base holds.
    held: BTreeMap<PartKey, u64>,
    in_flight: BTreeMap<PartKey, InFlight>,
    /// Pieces of parts that an earlier link delivered: hash and number of bytes.
    begun: BTreeMap<PartKey, (u64, usize)>,
    open_list: OpenList,
    /// Session of the base whose list is known; 0: none.
    list_of: u64,
}

impl PartSender {
    /// Creates a sender of a map without parts, which does not know what the base holds.
    pub fn new(config: SenderConfig) -> Self {
        Self {
            config,
            parts: BTreeMap::new(),
            held: BTreeMap::new(),
            in_flight: BTreeMap::new(),
            begun: BTreeMap::new(),
            open_list: OpenList::default(),
            list_of: 0,
        }
    }

    /// Returns the session of the base whose list is known; 0: none.
    pub fn list_of(&self) -> u64 {
        self.list_of
    }

    /// Replaces the content of a part.
    pub fn put(&mut self, key: PartKey, content: &PartContent, now: Monotonic) {
        let plain = encode(content);
        let hash = hash(&plain);
        self.replace(key, hash, Some(plain.into()), now);
    }

    /// Removes a part, also from the base.
    pub fn remove(&mut self, key: PartKey, now: Monotonic) {
        self.replace(key, ABSENT, None, now);
    }

    /// Removes the parts that the base holds or will get and `exists` denies.
    pub fn remove_unless(&mut self, exists: impl Fn(PartKey) -> bool, now: Monotonic) {
        let keys = self.held.keys().chain(self.parts.keys()).copied();
        let gone: Vec<PartKey> = keys.filter(|key| !exists(*key)).collect();
        gone.into_iter().for_each(|key| self.remove(key, now));
    }

    fn replace(&mut self, key: PartKey, hash: u64, plain: Option<Arc<[u8]>>, now: Monotonic) {
        let before = self.parts.get(&key);
        if before.map_or(ABSENT, |part| part.hash) == hash
            && (before.is_some() || !self.held.contains_key(&key))
        {
            return;
        }
        let on_its_way = self.in_flight.get(&key).map(|sent| sent.hash);
        let waited = before
            .filter(|part| self.held_hash(key) != part.hash && on_its_way != Some(part.hash))
            .map(|part| part.changed);
        self.parts.insert(key, Part { plain, hash, compressed: None, changed: waited.unwrap_or(now) });
    }

    fn held_hash(&self, key: PartKey) -> u64 {
        self.held.get(&key).copied().unwrap_or(ABSENT)
    }

    /// Forgets what the base holds: another base leads, or its list is needed anew.
    pub fn forget_list(&mut self) {
        self.held.clear();
        self.in_flight.clear();
        self.begun.clear();
        self.open_list = OpenList::default();
        self.list_of = 0;
    }

    /// Takes a page of the list of parts that the base of this session holds. Returns whether the list is complete.
    pub fn receive_list(&mut self, page: HeldPage, base: u64) -> bool {
        if page.list != self.open_list.list {
            self.open_list = OpenList { list: page.list, pages: BTreeMap::new() };
        }
        self.open_list.pages.insert(page.page, page.parts);
        if self.open_list.pages.len() < usize::from(page.pages) {
            return false;
        }
        let receipts: Vec<Receipt> =
            std::mem::take(&mut self.open_list).pages.into_values().flatten().collect();
        self.forget_list();
        for Receipt { key, hash, received } in receipts {
            if received == COMPLETE {
                self.held.insert(key, hash);
            } else {
                self.begun.insert(key, (hash, received as usize));
            }
        }
        self.list_of = base;
        true
    }

    /// Takes acknowledgements of the base: parts, or first pieces of them, that have arrived.
    pub fn acknowledge(&mut self, receipts: &[Receipt], now: Monotonic) {
        for receipt in receipts {
            let Some(sent) = self.in_flight.get_mut(&receipt.key) else { continue };
            if sent.hash != receipt.hash {
                continue;
            }
            if receipt.received == COMPLETE {
                self.in_flight.remove(&receipt.key);
                match receipt.hash {
                    ABSENT => drop(self.held.remove(&receipt.key)),
                    hash => drop(self.held.insert(receipt.key, hash)),
                }
                let is_gone = |part: &Part| part.hash == ABSENT;
                if receipt.hash == ABSENT && self.parts.get(&receipt.key).is_some_and(is_gone) {
                    self.parts.remove(&receipt.key);
                }
                continue;
            }
            let received = (receipt.received as usize).min(sent.bytes.len());
            if received < sent.acknowledged {
                // The base has dropped what it had, such as a part that did not decompress: the rest alone is of no use.
                (sent.acknowledged, sent.sent, sent.progress) = (received, received, now);
            } else if received > sent.acknowledged {
                (sent.acknowledged, sent.progress) = (received, now);
                sent.sent = sent.sent.max(received);
            }
        }
    }

    /// Returns the number of parts that the base does not hold as they are.
    pub fn waiting(&self) -> usize {
        self.parts.iter().filter(|(key, part)| self.held_hash(**key) != part.hash).count()
    }

    /// Returns the next piece to send, if one is due and fits into the window.
    pub fn next_chunk(&mut self, now: Monotonic) -> Option<Chunk> {
        if self.list_of == 0 {
            return None;
        }
        let retry_ns = self.config.retry.as_nanos() as u64;
        for sent in self.in_flight.values_mut().filter(|sent| now.since(sent.progress) >= retry_ns) {
            (sent.sent, sent.has_begun, sent.progress) = (sent.acknowledged, false, now);
        }
        let outstanding: usize = self.in_flight.values().map(InFlight::outstanding).sum();
        if outstanding + CHUNK_BYTES_MAX > self.config.window_bytes {
            return None;
        }
        if !self.in_flight.values().any(InFlight::has_more) && !self.begin_part(now) {
            return None;
        }
        let (key, sent) = self.in_flight.iter_mut().find(|(_, sent)| sent.has_more())?;
        let end = sent.bytes.len().min(sent.sent + CHUNK_BYTES_MAX);
        let bytes = sent.bytes[sent.sent..end].to_vec();
        let (offset, total) = (sent.sent as u32, sent.bytes.len() as u32);
        (sent.sent, sent.has_begun, sent.progress) = (end, true, now);
        Some(Chunk { key: *key, hash: sent.hash, total, offset, bytes })
    }

    /// Puts the smallest part that is due on its way. Returns whether there was one.
    fn begin_part(&mut self, now: Monotonic) -> bool {
        if self.in_flight.len() >= IN_FLIGHT_MAX {
            return false;
        }
        let period_ns = self.config.period.as_nanos() as u64;
        let mut smallest: Option<(PartKey, Arc<[u8]>)> = None;
        let mut compressed = 0;
        for (key, part) in &mut self.parts {
            let is_held = self.held.get(key).copied().unwrap_or(ABSENT) == part.hash;
            if is_held || self.in_flight.contains_key(key) || now.since(part.changed) < period_ns {
                continue;
            }
            if part.compressed.is_none() && compressed == COMPRESSED_MAX {
                continue;
            }
            let bytes = part.compressed.get_or_insert_with(|| {
                compressed += 1;
                part.plain.as_ref().map_or_else(|| [].into(), |plain| compress(plain).into())
            });
            // The receiver refuses a larger one; no content of the table's sizes compresses to that.
            let fits = bytes.len() <= PART_BYTES_MAX;
            if fits && smallest.as_ref().is_none_or(|(_, least)| bytes.len() < least.len()) {
                smallest = Some((*key, bytes.clone()));
            }
        }
        let Some((key, bytes)) = smallest else { return false };
        let hash = self.parts[&key].hash;
        let resumed = self.begun.remove(&key).filter(|(begun, _)| *begun == hash);
        let acknowledged = resumed.map_or(0, |(_, received)| received.min(bytes.len()));
        let flight =
            InFlight { hash, bytes, sent: acknowledged, acknowledged, has_begun: false, progress: now };
        self.in_flight.insert(key, flight);
        true
    }
}
