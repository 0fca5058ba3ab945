//! Maps through shared memory: readers that start late, sleep, or lose their writer get its map in the end. And what
//! the statistics, published maps and map files call free, occupied and unknown is the same.

use crate::harness::WATCHDOG;
use bridge::cdr::Writer;
use bridge::ros::{OccupancyGrid, write};
use mr_slam::channel::{self, Opener, Program};
use mr_slam::ports::{ReadMapPort, WriteMapPort};
use mr_slam::shared_memory::{Domain, MapReader, MapWriter, Participant};
use msg::grid::occupancy;
use msg::tiles::{MAP_TILES_MAX, TILE, TILE_CELLS};
use msg::{GridHeader, GridView, IndexRect, MapHeader, Monotonic, Role, Stamp, TileMap};
use std::time::Instant;

/// Shared memory of one test, removed at its end.
struct Memory(Domain);

impl Memory {
    fn new(name: &str) -> Self {
        Self({
            let name = format!("test{}_{name}", std::process::id());
            Domain::new(&name, &std::env::temp_dir().join(format!("mr-slam-{name}"))).unwrap()
        })
    }

    fn participant(&self, program: Program) -> Participant {
        Participant::open(&self.0, Opener::of_fleet(program), "test").unwrap()
    }

    fn writer(&self) -> MapWriter {
        self.participant(Program::Worker(Role::Merge)).map_writer(&channel::merged_map()).unwrap()
    }

    fn reader(&self) -> MapReader {
        self.participant(Program::Worker(Role::Bridge)).map_reader(&channel::merged_map()).unwrap()
    }
}

impl Drop for Memory {
    fn drop(&mut self) {
        self.0.remove();
    }
}

/// Creates a map with one known cell in each tile.
fn map(columns: i64, rows: i64) -> TileMap {
    let mut map = TileMap::new(MapHeader { resolution_m: 0.05, ..Default::default() });
    assert!(map.grow_to(IndexRect { x0: 0, y0: 0, x1: columns, y1: rows }, MAP_TILES_MAX));
    (0..columns * rows).for_each(|i| draw(&mut map, i % columns, i / columns, i as usize));
    map
}

fn draw(map: &mut TileMap, x: i64, y: i64, place: usize) {
    let cell = &mut map.get_mut(x, y).unwrap().cells[place % TILE_CELLS];
    *cell = if *cell == 100 { -100 } else { 100 };
    map.header.header.stamp.0 += 1;
}

fn same(a: &TileMap, b: &TileMap) -> bool {
    let all = a.extent().union(b.extent());
    let tile = |map: &TileMap, (x, y)| map.get(x, y).map(|tile| **tile);
    a.header.header.stamp == b.header.header.stamp && all.points().all(|at| tile(a, at) == tile(b, at))
}

/// Lets writer and readers take turns until all readers have the map.
fn settle(writer: &mut MapWriter, map: &TileMap, readers: &mut [&mut MapReader]) {
    let begun = Instant::now();
    loop {
        let all_sent = writer.send(map);
        for reader in readers.iter_mut() {
            reader.poll();
        }
        if all_sent && readers.iter().all(|reader| same(reader.map(), map)) {
            return;
        }
        assert!(begun.elapsed() < WATCHDOG, "the readers never get the map");
    }
}

#[test]
fn only_changed_tiles_are_sent() {
    let memory = Memory::new("changes");
    let (mut writer, mut reader, mut map) = (memory.writer(), memory.reader(), map(9, 9));
    settle(&mut writer, &map, &mut [&mut reader]);
    let (whole, before) = (writer.bytes(), reader.map().clone());
    assert!(whole > 81 * TILE_CELLS as u64);
    draw(&mut map, 3, 4, 7);
    assert!(writer.send(&map) && reader.poll());
    assert!(writer.bytes() - whole < 2 * TILE_CELLS as u64);
    assert_eq!(reader.map().changed_since(&before).collect::<Vec<_>>(), [(3, 4)]);
    assert!(writer.send(&map) && !reader.poll(), "nothing is new");
    assert_eq!(reader.receive_counts().lost, 0);
}

#[test]
fn a_late_or_restarted_reader_gets_the_whole_map() {
    let memory = Memory::new("late");
    let (mut writer, mut early, mut map) = (memory.writer(), memory.reader(), map(20, 20));
    settle(&mut writer, &map, &mut [&mut early]);
    for round in 0..3 {
        draw(&mut map, round, 2, 5);
        settle(&mut writer, &map, &mut [&mut early]);
        let before = early.map().clone();
        let mut late = memory.reader();
        settle(&mut writer, &map, &mut [&mut early, &mut late]);
        assert_eq!(early.map().changed_since(&before).count(), 0, "who had it sees no change");
    }
    assert_eq!((early.receive_counts().lost, early.receive_counts().restarts), (0, 0));
}

#[test]
fn a_reader_that_lost_messages_catches_up() {
    let memory = Memory::new("lapped");
    let (mut writer, mut reader, mut map) = (memory.writer(), memory.reader(), map(12, 12));
    settle(&mut writer, &map, &mut [&mut reader]);
    for round in 0..10 * channel::merged_map().row.depth {
        draw(&mut map, round as i64 % 12, round as i64 / 12 % 12, round);
        assert!(writer.send(&map));
    }
    let kept = reader.map().clone();
    reader.poll();
    assert!(reader.receive_counts().lost > 0);
    assert!(same(reader.map(), &kept), "nothing shows until the whole has come");
    settle(&mut writer, &map, &mut [&mut reader]);
}

#[test]
fn a_restarted_writer_replaces_its_map() {
    let memory = Memory::new("writer");
    let (old, new) = (map(12, 9), map(2, 17));
    let mut reader = memory.reader();
    let mut writer = memory.writer();
    settle(&mut writer, &old, &mut [&mut reader]);
    drop(writer);
    assert!(!reader.poll() && same(reader.map(), &old));
    let mut writer = memory.writer();
    settle(&mut writer, &new, &mut [&mut reader]);
    assert_eq!(reader.receive_counts().restarts, 1);
    let mut late = memory.reader();
    settle(&mut writer, &new, &mut [&mut reader, &mut late]);
}

#[test]
fn a_map_of_the_largest_size_is_sent_in_bounded_parts() {
    let memory = Memory::new("large");
    let (mut writer, mut reader) = (memory.writer(), memory.reader());
    let map = map(64, 64);
    let mut lots = 1;
    let mut sent = writer.bytes();
    while !writer.send(&map) {
        assert!(writer.bytes() - sent <= 300_000 * channel::MAP_MESSAGES_MAX as u64);
        sent = writer.bytes();
        assert!(!reader.poll(), "half a map");
        lots += 1;
    }
    assert!(reader.poll() && same(reader.map(), &map));
    assert_eq!(lots, 64 * 64 / 64 / channel::MAP_MESSAGES_MAX);
    assert_eq!(map.extent().area(), Some(TILE as usize * TILE as usize));
}

/// One definition of known cells: the paper's coverage and areas, computed from `/merged_map`, are those of
/// `/robotN/slam_stats`, and a saved map has the same cells.
#[test]
fn statistics_published_maps_and_files_count_the_same_cells() {
    let cells: Vec<i8> = (0..=255_u8).flat_map(|bits| [bits as i8; 3]).collect();
    let header = GridHeader { width: 32, height: 24, resolution_m: 0.05, ..GridHeader::default() };
    let map = GridView::new(&header, &cells).unwrap();

    let mut metrics = telemetry::MapMetrics::new(1, None, &[]);
    metrics.update_merged_map(map);
    let mut telemetry = telemetry::Telemetry::new(1, &[], Monotonic(0));
    telemetry.set_map_figures(metrics.compute(), Monotonic(0));
    let merged = telemetry.compute_stats(Stamp(0), Monotonic(1)).merged_map;
    let counted =
        [merged.unknown_cells, merged.free_cells, merged.occupied_cells].map(|count| count as usize);

    let mut payload = Vec::new();
    write::occupancy_grid(&mut Writer::new(&mut payload), "map", &msg::grid::trinary_table(), map);
    let published: OccupancyGrid = bridge::ros::decode(&payload).unwrap();
    let of_value = |value: i8| published.data.iter().filter(|cell| **cell == value).count();
    assert_eq!([-1, 0, 100].map(of_value), counted);
    assert_eq!(counted.iter().sum::<usize>(), cells.len(), "no other values");

    let folder = tempfile::tempdir().unwrap();
    formats::map_file::write_map(&folder.path().join("map"), map).unwrap();
    let saved = formats::map_file::read_map(&folder.path().join("map.yaml")).unwrap();
    let readings = |cells: &[i8]| cells.iter().map(|cell| occupancy(*cell)).collect::<Vec<_>>();
    assert_eq!(readings(&saved.cells), readings(&cells), "as map_server reads it");
}
