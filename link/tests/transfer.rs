//! A robot's map reaches the base over links that lose, delay and cut, and nothing is sent twice without need.

use link::part::hash;
use link::wire::{Chunk, HeldPage, Receipt};
use link::{PartChange, PartContent, PartKey, PartReceiver, PartSender, SenderConfig};
use msg::{MapTile, Monotonic};
use rand_xoshiro::SplitMix64;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

/// Session of the base in these tests.
const BASE: u64 = 7;

fn at(ms: u64) -> Monotonic {
    Monotonic(ms * 1_000_000)
}

/// A tile with `noise` random cells.
fn tile(x: i32, y: i32, noise: usize, random: &mut SplitMix64) -> MapTile {
    let mut tile = MapTile::unknown(x.into(), y.into());
    for cell in tile.cells.iter_mut().take(noise.max(1)) {
        *cell = (random.next_u64() % 100) as i8;
    }
    tile
}

/// A robot and a base joined by a link that loses messages.
struct Pair {
    sender: PartSender,
    receiver: PartReceiver,
    random: SplitMix64,
    loss_percent: u64,
    is_cut: bool,
    map: BTreeMap<PartKey, Arc<MapTile>>,
    sent: Vec<Chunk>,
    now_ms: u64,
}

impl Pair {
    fn new(loss_percent: u64) -> Self {
        let mut pair = Self {
            sender: PartSender::new(SenderConfig::default()),
            receiver: PartReceiver::default(),
            random: SplitMix64::seed_from_u64(1),
            loss_percent,
            is_cut: false,
            map: BTreeMap::new(),
            sent: Vec::new(),
            now_ms: 10_000,
        };
        pair.exchange_list();
        pair
    }

    fn exchange_list(&mut self) {
        for page in self.receiver.list() {
            self.sender.receive_list(page, BASE);
        }
    }

    fn put(&mut self, tile: &MapTile) {
        let content = PartContent::Tile(Arc::new(*tile));
        self.sender.put(PartKey::Tile(tile.x, tile.y), &content, at(self.now_ms));
    }

    fn is_lost(&mut self) -> bool {
        self.is_cut || self.random.next_u64() % 100 < self.loss_percent
    }

    /// Lets time pass in steps of 20 ms.
    fn run(&mut self, ms: u64) {
        for _ in 0..ms / 20 {
            self.now_ms += 20;
            while let Some(chunk) = self.sender.next_chunk(at(self.now_ms)) {
                self.sent.push(chunk.clone());
                if self.is_lost() {
                    continue;
                }
                match self.receiver.receive(&chunk) {
                    Some((key, PartChange::Replaced(PartContent::Tile(tile)))) => {
                        self.map.insert(key, tile);
                    }
                    Some((key, _)) => drop(self.map.remove(&key)),
                    None => {}
                }
            }
            let receipts = self.receiver.take_acknowledgements();
            if !receipts.is_empty() && !self.is_lost() {
                self.sender.acknowledge(&receipts, at(self.now_ms));
            }
        }
    }

    fn sent_bytes(&self) -> usize {
        self.sent.iter().map(|chunk| chunk.bytes.len()).sum()
    }
}

#[test]
fn every_part_arrives_over_a_link_that_loses_a_fifth() {
    let mut pair = Pair::new(20);
    let tiles: Vec<MapTile> =
        (0..40).map(|x| tile(x, -x, 4096, &mut SplitMix64::seed_from_u64(x as u64))).collect();
    tiles.iter().for_each(|tile| pair.put(tile));
    pair.run(120_000);
    assert_eq!(pair.sender.waiting(), 0);
    for tile in &tiles {
        assert_eq!(pair.map[&PartKey::Tile(tile.x, tile.y)].cells, tile.cells);
    }
}

#[test]
fn the_smallest_part_comes_first_and_a_large_one_in_pieces() {
    let mut pair = Pair::new(0);
    let mut random = SplitMix64::seed_from_u64(2);
    let (large, small) = (tile(0, 0, 4096, &mut random), tile(1, 0, 1, &mut random));
    pair.put(&large);
    pair.put(&small);
    pair.run(2_900);
    assert!(pair.sent.is_empty(), "changes are collected first");
    pair.run(1_000);
    assert_eq!(pair.sent[0].key, PartKey::Tile(1, 0));
    assert!(pair.sent.iter().all(|chunk| chunk.bytes.len() <= link::wire::CHUNK_BYTES_MAX));
    assert_eq!(pair.map.len(), 2);
}

#[test]
fn after_an_outage_only_what_has_changed_is_sent() {
    let mut pair = Pair::new(0);
    let mut random = SplitMix64::seed_from_u64(3);
    for x in 0..100 {
        pair.put(&tile(x, 0, 1000, &mut random));
    }
    pair.run(20_000);
    let whole = pair.sent_bytes();
    pair.is_cut = true;
    pair.sent.clear();
    let changed = tile(5, 0, 1000, &mut random);
    pair.put(&changed);
    pair.run(60_000);
    let during = pair.sent_bytes();
    assert!(
        during <= 64 * whole / 100,
        "{during} bytes were sent into a link that was cut, the map has {whole}"
    );
    pair.is_cut = false;
    pair.sent.clear();
    pair.run(5_000);
    assert_eq!(pair.map[&PartKey::Tile(5, 0)].cells, changed.cells);
    assert!(pair.sent.iter().all(|chunk| chunk.key == PartKey::Tile(5, 0)), "{:?}", pair.sent);
    assert!(pair.sent.len() <= 2, "{:?}", pair.sent);
}

#[test]
fn a_new_base_gets_everything_and_a_robot_that_restarts_sends_nothing_again() {
    let mut pair = Pair::new(0);
    let tiles: Vec<MapTile> =
        (0..30).map(|x| tile(x, 0, 500, &mut SplitMix64::seed_from_u64(x as u64))).collect();
    tiles.iter().for_each(|tile| pair.put(tile));
    pair.run(10_000);
    let sent = pair.sent.len();
    // The robot's process is started again and learns what the base holds.
    pair.sender = PartSender::new(SenderConfig::default());
    tiles.iter().for_each(|tile| pair.put(tile));
    pair.run(10_000);
    assert_eq!(pair.sent.len(), sent, "nothing is sent before the list is known");
    pair.exchange_list();
    pair.run(10_000);
    assert_eq!((pair.sent.len(), pair.sender.waiting()), (sent, 0));
    // Another base holds nothing.
    (pair.receiver, pair.map) = (PartReceiver::default(), BTreeMap::new());
    pair.exchange_list();
    pair.run(10_000);
    assert_eq!(pair.map.len(), 30);
}

#[test]
fn a_part_that_is_gone_is_removed_from_the_base() {
    let mut pair = Pair::new(0);
    let mut random = SplitMix64::seed_from_u64(4);
    pair.put(&tile(0, 0, 10, &mut random));
    pair.put(&tile(1, 0, 10, &mut random));
    pair.run(10_000);
    // A robot that begins anew knows nothing of the tile that the base holds of its earlier map.
    pair.sender = PartSender::new(SenderConfig::default());
    pair.exchange_list();
    pair.sender.remove_unless(|key| key == PartKey::Tile(1, 0), at(pair.now_ms));
    pair.run(10_000);
    assert_eq!(pair.map.keys().collect::<Vec<_>>(), [&PartKey::Tile(1, 0)]);
    assert_eq!(pair.receiver.len(), 1);
}

#[test]
fn a_part_that_keeps_changing_is_sent_once_a_period() {
    let mut pair = Pair::new(0);
    let mut random = SplitMix64::seed_from_u64(5);
    for _ in 0..300 {
        pair.put(&tile(0, 0, 100, &mut random));
        pair.run(100);
    }
    let period = SenderConfig::default().period;
    let most = Duration::from_secs(30).div_duration_f64(period) as usize + 1;
    assert!((5..=most).contains(&pair.sent.len()), "{} in 30 s", pair.sent.len());
}

#[test]
fn the_window_bounds_what_is_on_its_way() {
    let mut pair = Pair::new(0);
    let mut random = SplitMix64::seed_from_u64(6);
    for x in 0..50 {
        pair.put(&tile(x, 0, 4096, &mut random));
    }
    let mut bytes = 0;
    while let Some(chunk) = pair.sender.next_chunk(at(pair.now_ms + 3_500)) {
        bytes += chunk.bytes.len();
    }
    assert!(bytes > 0 && bytes <= SenderConfig::default().window_bytes, "{bytes}");
}

#[test]
fn a_part_whose_first_pieces_the_base_has_dropped_begins_anew() {
    let mut pair = Pair::new(0);
    let mut random = SplitMix64::seed_from_u64(7);
    // More than one window: the base acknowledges a first piece, then loses it, as when its list named a piece of a part
    // that it refuses later.
    let large = tile(0, 0, 4096, &mut random);
    let content = PartContent::Tile(Arc::new(large));
    let plain = link::content::encode(&content);
    let total = link::content::compress(&plain).len() as u32;
    assert!(total > 2_000, "{total} bytes");
    let begun = Receipt { key: PartKey::Tile(0, 0), hash: hash(&plain), received: 1_000 };
    pair.sender.receive_list(HeldPage { page: 0, pages: 1, list: 99, parts: vec![begun] }, BASE);
    pair.put(&large);
    pair.run(10_000);
    assert_eq!(pair.map[&PartKey::Tile(0, 0)].cells, large.cells);
    assert_eq!(pair.sender.waiting(), 0);
}

#[test]
fn a_damaged_part_is_refused_and_sent_again() {
    let mut receiver = PartReceiver::default();
    let content = PartContent::Tile(Arc::new(MapTile::unknown(0, 0)));
    let plain = link::content::encode(&content);
    let bytes = link::content::compress(&plain);
    let total = bytes.len() as u32;
    let good = Chunk { key: PartKey::Tile(0, 0), hash: hash(&plain), total, offset: 0, bytes };
    let damaged = Chunk { hash: 1, ..good.clone() };
    assert!(receiver.receive(&damaged).is_none());
    assert_eq!((receiver.refused(), receiver.take_acknowledgements()), (1, Vec::new()));
    let elsewhere = Chunk { key: PartKey::Tile(1, 0), ..good.clone() };
    assert!(receiver.receive(&elsewhere).is_none(), "the content is of another tile");
    assert!(receiver.receive(&good).is_some());
}
