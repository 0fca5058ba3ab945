//! A map between processes: messages with the tiles that changed, and a way for a reader that came
//! late or missed one to get the whole.
//!
//! A version of the map is one message or several, so that no message is large; the last of them
//! says so, and only then do readers look. A reader that has not followed from the beginning asks;
//! then the writer sends the whole again, which for those who have it changes nothing.

use super::{MAP_TILES_MAX, MapHeader, MapTile, TileMap};
use crate::rect::Rect;
use crate::{Header, Message};
use bytemuck::{Pod, Zeroable};
use std::sync::Arc;

/// The most tiles in one message: 262 kB.
pub const PATCH_TILES_MAX: usize = 64;

/// Travels with the tiles that changed.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct PatchHeader {
    /// Of the map as it is when all of this version has come.
    pub map: MapHeader,
    /// 1: the whole map begins here, nothing that came before is needed.
    pub begins: u32,
    /// 1: the version is complete with this message.
    pub ends: u32,
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

/// One message.
#[derive(Clone, Debug)]
pub struct Patch {
    /// To be numbered and timed by its channel.
    pub header: PatchHeader,
    /// At most [`PATCH_TILES_MAX`].
    pub tiles: Vec<Arc<MapTile>>,
}

/// The writer's side: what the readers have, and what they are sent next.
#[derive(Clone, Debug, Default)]
pub struct PatchSender {
    sent: TileMap,
    /// The whole has been sent, or its sending has begun.
    begun: bool,
    /// A version is under way.
    busy: bool,
    /// A reader wants the whole, even of an empty map.
    asked: bool,
}

impl PatchSender {
    /// The next version is the whole map. One that is under way is completed first.
    pub fn request_snapshot(&mut self) {
        self.asked = true;
    }

    /// A message was lost before it was sent: all over again.
    pub fn restart(&mut self) {
        (self.begun, self.busy) = (false, false);
    }

    /// More messages are needed at once.
    pub fn has_pending(&self, map: &TileMap) -> bool {
        self.busy || self.asked || (!self.begun && map.tiles().next().is_some())
    }

    /// The next message that brings readers closer to `map`; `None` when they have it.
    pub fn next_patch(&mut self, map: &TileMap) -> Option<Patch> {
        let asked = self.asked && !self.busy;
        if asked || !self.begun || !self.sent.header.same_lattice(&map.header) {
            if map.tiles().next().is_none() && !asked && !self.begun {
                return None;
            }
            *self = Self { asked: self.asked && !asked, ..Self::default() };
            self.sent.header = map.header;
        }
        let mut changed = map.changed_since(&self.sent);
        let places: Vec<(i64, i64)> = changed.by_ref().take(PATCH_TILES_MAX).collect();
        let ends = changed.next().is_none();
        drop(changed);
        let news = !places.is_empty() || self.busy || self.sent.header != map.header;
        if self.begun && !news {
            return None;
        }
        let header = PatchHeader { map: map.header, begins: (!self.begun).into(), ends: ends.into() };
        (self.begun, self.busy) = (true, !ends);
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

/// The reader's side: the newest complete version, and the next one as far as it has come.
#[derive(Clone, Debug, Default)]
pub struct PatchReceiver {
    shown: TileMap,
    next: TileMap,
    /// Messages have come without a gap since the whole began; the number that must come next.
    follows: Option<(u64, u64)>,
    heard: bool,
}

impl PatchReceiver {
    /// The newest complete version; without tiles before the first.
    pub fn map(&self) -> &TileMap {
        &self.shown
    }

    /// Messages come, but the whole is needed before they are of use.
    pub fn needs_snapshot(&self) -> bool {
        self.heard && self.follows.is_none()
    }

    /// Takes the next message. True if it completes a version.
    pub fn receive(&mut self, header: &PatchHeader, tiles: &[MapTile]) -> bool {
        self.heard = true;
        let Header { incarnation, seq, .. } = header.map.header;
        let sound = header.map.is_valid() && tiles.len() <= PATCH_TILES_MAX;
        let continues =
            self.follows == Some((incarnation, seq)) && header.map.same_lattice(&self.next.header);
        if !sound || !(continues || header.begins == 1) {
            self.follows = None;
            return false;
        }
        if !continues {
            self.next = TileMap::new(header.map);
        }
        self.next.header = header.map;
        self.follows = Some((incarnation, seq.saturating_add(1)));
        if !tiles.iter().all(|tile| self.put(tile)) {
            self.follows = None;
            return false;
        }
        let complete = header.ends == 1;
        if complete {
            self.shown = self.next.clone();
        }
        complete
    }

    /// Takes a tile; one that holds the same as before stays the same tile.
    fn put(&mut self, tile: &MapTile) -> bool {
        let (x, y) = (i64::from(tile.x), i64::from(tile.y));
        if tile.is_unknown() {
            self.next.set(x, y, None);
            return true;
        }
        let shown = self.shown.get(x, y).filter(|_| self.shown.header.same_lattice(&self.next.header));
        let kept = [self.next.get(x, y), shown].into_iter().flatten().find(|old| ***old == *tile).cloned();
        let room = self.next.grow_to(Rect::single(x, y), MAP_TILES_MAX);
        self.next.set(x, y, Some(kept.unwrap_or_else(|| Arc::new(*tile))));
        room
    }
}

#[cfg(test)]
mod tests;
