//! Transfer of a map between processes, as patches of the tiles that changed.
//!
//! A version of the map is sent as one or several messages, so that no message is large. A reader shows
//! the version after the last of them. A reader that started late or lost a message requests a snapshot.
//! The writer then sends the whole map again, which changes nothing for the other readers.

use super::{MAP_TILES_MAX, MapHeader, MapTile, TileMap};
use crate::rect::IndexRect;
use crate::{Header, Message};
use bytemuck::{Pod, Zeroable};
use std::sync::Arc;

/// Largest number of tiles in one message: 262 kB.
pub const PATCH_TILES_MAX: usize = 64;

/// Header of a message with changed tiles.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct PatchHeader {
    /// Header of the map after the last message of this version.
    pub map: MapHeader,
    /// 1 if a snapshot begins with this message, so that no earlier message is needed; else 0.
    pub begins_snapshot: u32,
    /// 1 if this message completes the version, else 0.
    pub completes_version: u32,
}

impl Message for PatchHeader {
    const NAME: &'static str = "msg::PatchHeader";
    fn header(&self) -> &Header {
        &self.map.header
    }
    fn header_mut(&mut self) -> &mut Header {
        &mut self.map.header
    }
}

/// One message of a map's transfer.
#[derive(Clone, Debug)]
pub struct Patch {
    /// Header of the message, which the channel numbers and times.
    pub header: PatchHeader,
    /// Changed tiles, at most [`PATCH_TILES_MAX`].
    pub tiles: Vec<Arc<MapTile>>,
}

/// Writer's side of a map's transfer: the version that readers have, and the next message to send.
#[derive(Clone, Debug, Default)]
pub struct PatchSender {
    sent: TileMap,
    /// A snapshot was sent, or its first message was.
    snapshot_begun: bool,
    /// The last message did not complete its version.
    version_open: bool,
    /// A reader requested a snapshot, even of an empty map.
    snapshot_requested: bool,
}

impl PatchSender {
    /// Sends the whole map as the next version. A version that is open is completed first.
    pub fn request_snapshot(&mut self) {
        self.snapshot_requested = true;
    }

    /// Starts again with a snapshot, after a message could not be sent.
    pub fn restart(&mut self) {
        (self.snapshot_begun, self.version_open) = (false, false);
    }

    /// Returns whether further messages should be sent at once.
    pub fn has_pending(&self, map: &TileMap) -> bool {
        self.version_open || self.snapshot_requested || (!self.snapshot_begun && map.tiles().next().is_some())
    }

    /// Returns the next message towards `map`; `None` if the readers have it.
    pub fn next_patch(&mut self, map: &TileMap) -> Option<Patch> {
        let answers_request = self.snapshot_requested && !self.version_open;
        if answers_request || !self.snapshot_begun || !self.sent.header.same_lattice(&map.header) {
            if map.tiles().next().is_none() && !answers_request && !self.snapshot_begun {
                return None;
            }
            let snapshot_requested = self.snapshot_requested && !answers_request;
            *self = Self { snapshot_requested, ..Self::default() };
            self.sent.header = map.header;
        }
        let mut changed = map.changed_since(&self.sent);
        let places: Vec<(i64, i64)> = changed.by_ref().take(PATCH_TILES_MAX).collect();
        let complete = changed.next().is_none();
        drop(changed);
        let differs = !places.is_empty() || self.version_open || self.sent.header != map.header;
        if self.snapshot_begun && !differs {
            return None;
        }
        let header = PatchHeader {
            map: map.header,
            begins_snapshot: (!self.snapshot_begun).into(),
            completes_version: complete.into(),
        };
        (self.snapshot_begun, self.version_open) = (true, !complete);
        self.sent.header = map.header;
        self.sent.grow_to(map.extent(), MAP_TILES_MAX);
        let tiles = places.into_iter().map(|(x, y)| {
            let tile = map.get(x, y).cloned();
            self.sent.set(x, y, tile.clone());
            tile.unwrap_or_else(|| Arc::new(MapTile::unknown(x, y)))
        });
        Some(Patch { header, tiles: tiles.collect() })
    }
}

/// Reader's side of a map's transfer: the newest complete version, and the received part of the next.
#[derive(Clone, Debug, Default)]
pub struct PatchReceiver {
    /// Newest complete version.
    complete: TileMap,
    /// Received part of the next version.
    next: TileMap,
    /// Incarnation and `seq` of the next message, if none was lost since the snapshot began.
    expected: Option<(u64, u64)>,
    /// Any message was received.
    received_any: bool,
}

impl PatchReceiver {
    /// Returns the newest complete version; a map without tiles before the first.
    pub fn map(&self) -> &TileMap {
        &self.complete
    }

    /// Returns whether messages arrive that cannot be applied without a snapshot.
    pub fn needs_snapshot(&self) -> bool {
        self.received_any && self.expected.is_none()
    }

    /// Applies the next message. Returns whether it completes a version.
    pub fn receive(&mut self, header: &PatchHeader, tiles: &[MapTile]) -> bool {
        self.received_any = true;
        let Header { incarnation, seq, .. } = header.map.header;
        let valid = header.map.is_valid() && tiles.len() <= PATCH_TILES_MAX;
        let continues =
            self.expected == Some((incarnation, seq)) && header.map.same_lattice(&self.next.header);
        if !valid || !(continues || header.begins_snapshot == 1) {
            self.expected = None;
            return false;
        }
        if !continues {
            self.next = TileMap::new(header.map);
        }
        self.next.header = header.map;
        self.expected = Some((incarnation, seq.saturating_add(1)));
        if !tiles.iter().all(|tile| self.set_tile(tile)) {
            self.expected = None;
            return false;
        }
        let completes = header.completes_version == 1;
        if completes {
            self.complete = self.next.clone();
        }
        completes
    }

    /// Stores a tile. A tile with unchanged cells stays shared with the earlier version.
    fn set_tile(&mut self, tile: &MapTile) -> bool {
        let (x, y) = (i64::from(tile.x), i64::from(tile.y));
        if tile.is_unknown() {
            self.next.set(x, y, None);
            return true;
        }
        let shown = self.complete.get(x, y).filter(|_| self.complete.header.same_lattice(&self.next.header));
        let kept = [self.next.get(x, y), shown].into_iter().flatten().find(|old| ***old == *tile).cloned();
        let fits = self.next.grow_to(IndexRect::single(x, y), MAP_TILES_MAX);
        self.next.set(x, y, Some(kept.unwrap_or_else(|| Arc::new(*tile))));
        fits
    }
}

#[cfg(test)]
mod tests;
