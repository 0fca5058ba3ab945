//! Readers that start late, lose messages or outlive their writer get the writer's map in the end.

use super::*;
use crate::grid::UNKNOWN;
use crate::tiles::{TILE, TILE_CELLS};
use crate::{Pose2, Stamp};
use proptest::prelude::*;

fn map(resolution_m: f64) -> TileMap {
    TileMap::new(MapHeader { resolution_m, ..Default::default() })
}

/// Changes a cell of a tile.
fn draw(map: &mut TileMap, x: i64, y: i64, place: usize, cell: i8) {
    assert!(map.grow_to(IndexRect::single(x, y), MAP_TILES_MAX));
    map.get_mut(x, y).unwrap().cells[place % TILE_CELLS] = cell;
    map.header.header.stamp.0 += 1;
}

fn same(a: &TileMap, b: &TileMap) -> bool {
    let all = a.extent().union(b.extent());
    let cells = IndexRect { x0: all.x0 * TILE, y0: all.y0 * TILE, x1: all.x1 * TILE, y1: all.y1 * TILE };
    a.header.header.stamp == b.header.header.stamp
        && a.header.same_lattice(&b.header)
        && cells.points().all(|(x, y)| a.cell(x, y) == b.cell(x, y))
}

/// A sender whose messages are numbered as a channel numbers them.
#[derive(Default)]
struct Writer {
    outgoing: PatchSender,
    incarnation: u64,
    seq: u64,
}

impl Writer {
    fn next(&mut self, map: &TileMap) -> Option<Patch> {
        let mut patch = self.outgoing.next_patch(map)?;
        let header = &mut patch.header.map.header;
        (header.incarnation, header.seq) = (self.incarnation, self.seq);
        self.seq += 1;
        Some(patch)
    }
}

fn receive(reader: &mut PatchReceiver, patch: &Patch) -> bool {
    let tiles: Vec<MapTile> = patch.tiles.iter().map(|tile| **tile).collect();
    reader.receive(&patch.header, &tiles)
}

#[test]
fn only_changed_tiles_are_sent() {
    let (mut writer, mut reader, mut map) = (Writer::default(), PatchReceiver::default(), map(0.05));
    assert!(writer.next(&map).is_none(), "nothing is known yet");
    (0..3).for_each(|x| draw(&mut map, x, 0, 5, 9));
    let whole = writer.next(&map).unwrap();
    assert_eq!((whole.tiles.len(), whole.header.begins_snapshot, whole.header.completes_version), (3, 1, 1));
    assert!(writer.next(&map).is_none());
    assert!(receive(&mut reader, &whole));
    let before = reader.map().clone();
    draw(&mut map, -2, 1, 0, 1);
    draw(&mut map, 1, 0, 5, 10);
    let patch = writer.next(&map).unwrap();
    assert_eq!((patch.tiles.len(), patch.header.begins_snapshot, patch.header.completes_version), (2, 0, 1));
    assert!(receive(&mut reader, &patch));
    assert!(same(reader.map(), &map));
    assert_eq!(reader.map().changed_since(&before).collect::<Vec<_>>(), [(1, 0), (-2, 1)]);
    // A newer stamp is sent even if no cell changed. A removed tile is removed at the reader too.
    map.header.header.stamp = Stamp(99);
    assert!(receive(&mut reader, &writer.next(&map).unwrap()));
    assert_eq!(reader.map().header.header.stamp, Stamp(99));
    map.set(0, 0, None);
    assert!(receive(&mut reader, &writer.next(&map).unwrap()));
    assert!(reader.map().get(0, 0).is_none() && same(reader.map(), &map));
}

#[test]
fn a_large_version_is_shown_after_its_last_message() {
    let (mut writer, mut reader, mut map) = (Writer::default(), PatchReceiver::default(), map(0.05));
    (0..150).for_each(|x| draw(&mut map, x % 15, x / 15, 0, 1));
    let mut shown = Vec::new();
    while let Some(patch) = writer.next(&map) {
        assert!(patch.tiles.len() <= PATCH_TILES_MAX);
        assert!(reader.map().tiles().next().is_none());
        shown.push(receive(&mut reader, &patch));
    }
    assert_eq!(shown, [false, false, true]);
    assert!(same(reader.map(), &map));
}

#[test]
fn a_snapshot_for_a_late_reader_changes_nothing_for_the_others() {
    let (mut writer, mut early, mut late, mut map) =
        (Writer::default(), PatchReceiver::default(), PatchReceiver::default(), map(0.05));
    (0..100).for_each(|x| draw(&mut map, x, 0, 0, 1));
    while let Some(patch) = writer.next(&map) {
        receive(&mut early, &patch);
    }
    draw(&mut map, 3, 0, 0, 2);
    let patch = writer.next(&map).unwrap();
    assert!(receive(&mut early, &patch) && !receive(&mut late, &patch));
    assert!(late.needs_snapshot() && !early.needs_snapshot());
    writer.outgoing.request_snapshot();
    let before = early.map().clone();
    while let Some(patch) = writer.next(&map) {
        receive(&mut early, &patch);
        receive(&mut late, &patch);
    }
    assert!(!late.needs_snapshot() && same(late.map(), &map));
    assert_eq!(early.map().changed_since(&before).count(), 0);
}

#[test]
fn a_restarted_writer_replaces_the_map() {
    let (mut reader, mut old, mut new) = (PatchReceiver::default(), map(0.05), map(0.05));
    (0..4).for_each(|x| draw(&mut old, x, 0, 0, 1));
    let mut writer = Writer { incarnation: 1, ..Default::default() };
    receive(&mut reader, &writer.next(&old).unwrap());
    draw(&mut old, 9, 9, 0, 1);
    receive(&mut reader, &writer.next(&old).unwrap());
    // The next incarnation may send the number that follows the old one's last.
    draw(&mut new, 7, 7, 0, 3);
    let mut writer = Writer { incarnation: 2, ..Default::default() };
    while let Some(patch) = writer.next(&new) {
        assert!(same(reader.map(), &old) || same(reader.map(), &new));
        receive(&mut reader, &patch);
    }
    assert!(same(reader.map(), &new));
    // A moved lattice replaces the map too.
    new.header.origin = Pose2::new(1.0, 0.0, 0.5);
    receive(&mut reader, &writer.next(&new).unwrap());
    assert!(same(reader.map(), &new));
}

#[test]
fn a_snapshot_of_an_empty_map_is_sent_on_request() {
    let (mut writer, mut reader, map) = (Writer::default(), PatchReceiver::default(), map(0.05));
    writer.outgoing.request_snapshot();
    assert!(receive(&mut reader, &writer.next(&map).unwrap()));
    assert!(writer.next(&map).is_none() && !reader.needs_snapshot());
}

#[test]
fn an_invalid_message_leaves_the_map_unchanged() {
    let (mut writer, mut reader, mut map) = (Writer::default(), PatchReceiver::default(), map(0.05));
    draw(&mut map, 0, 0, 0, 1);
    receive(&mut reader, &writer.next(&map).unwrap());
    let kept = reader.map().clone();
    let header = |change: fn(&mut PatchHeader)| {
        let mut header = PatchHeader { map: map.header, begins_snapshot: 1, completes_version: 1 };
        change(&mut header);
        header
    };
    let far = MapTile { x: i32::MIN, y: i32::MAX, cells: [1; TILE_CELLS] };
    let corner = MapTile { x: 300, y: 300, ..far };
    for (header, tiles) in [
        (header(|h| h.map.resolution_m = f64::NAN), vec![]),
        (header(|h| h.map.resolution_m = 0.0), vec![]),
        (header(|h| h.map.origin.x_m = f64::INFINITY), vec![]),
        (header(|_| ()), vec![far]),
        (header(|_| ()), vec![MapTile { x: 0, y: 0, ..far }, corner]),
        (header(|h| h.begins_snapshot = 7), vec![]),
    ] {
        assert!(!reader.receive(&header, &tiles), "{header:?}");
        assert!(reader.needs_snapshot());
        assert_eq!(reader.map().changed_since(&kept).count(), 0);
    }
    writer.outgoing.request_snapshot();
    assert!(receive(&mut reader, &writer.next(&map).unwrap()) && !reader.needs_snapshot());
}

#[derive(Clone, Debug)]
enum Event {
    Draw { x: i64, y: i64, place: usize, cell: i8 },
    Send { lost: bool },
    Restart,
    Return,
}

fn event() -> impl Strategy<Value = Event> {
    let cell = prop_oneof![1 => Just(UNKNOWN), 3 => -127_i8..=127];
    prop_oneof![
        6 => (-12_i64..12, -12_i64..12, 0_usize..9, cell)
            .prop_map(|(x, y, place, cell)| Event::Draw { x, y, place, cell }),
        3 => any::<bool>().prop_map(|lost| Event::Send { lost }),
        1 => Just(Event::Restart),
        1 => Just(Event::Return),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Under losses, restarts of either side and changes within a version, a reader shows only complete
    /// versions. When no more changes come, one snapshot request brings the newest version.
    #[test]
    fn a_reader_gets_the_newest_version_in_the_end(events in prop::collection::vec(event(), 1..120)) {
        let (mut writer, mut reader, mut map) = (Writer::default(), PatchReceiver::default(), map(0.05));
        for event in events {
            match event {
                Event::Draw { x, y, place, cell } => draw(&mut map, x, y, place, cell),
                Event::Send { lost } => {
                    if reader.needs_snapshot() {
                        writer.outgoing.request_snapshot();
                    }
                    if let Some(patch) = writer.next(&map) && !lost && receive(&mut reader, &patch) {
                        prop_assert!(same(reader.map(), &map));
                    }
                }
                Event::Restart => {
                    writer = Writer { incarnation: writer.incarnation + 1, ..Default::default() };
                }
                Event::Return => reader = PatchReceiver::default(),
            }
        }
        draw(&mut map, 0, 0, 0, 1);
        while let Some(patch) = writer.next(&map) {
            receive(&mut reader, &patch);
        }
        if reader.needs_snapshot() {
            writer.outgoing.request_snapshot();
        }
        while let Some(patch) = writer.next(&map) {
            receive(&mut reader, &patch);
        }
        prop_assert!(!reader.needs_snapshot() && same(reader.map(), &map));
    }
}
