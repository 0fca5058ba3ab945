//! Published maps: their values, the names of the merged map, and updates of parts of it.

use crate::local::LocalClient;
use bridge::ros::{MapTiles, OccupancyGrid, OccupancyGridUpdate};
use bridge::{Bridge, BridgeConfig, FleetMessage};
use msg::grid::{FREE_MAX, OCCUPIED_MIN, UNKNOWN};
use msg::{GridHeader, GridView, Pose2, RobotId};

fn bridge() -> Bridge {
    Bridge::new(BridgeConfig::default(), 2, |_, _| {}).unwrap()
}

fn header(width: u32, height: u32) -> GridHeader {
    GridHeader { width, height, resolution_m: 0.05, ..GridHeader::default() }
}

fn publish_merged(bridge: &Bridge, width: u32, cells: &[i8]) {
    let header = header(width, cells.len() as u32 / width);
    bridge.publish(FleetMessage::MergedMap(GridView::new(&header, cells).unwrap()));
}

const CELLS: [i8; 6] = [UNKNOWN, FREE_MAX, FREE_MAX + 1, 0, OCCUPIED_MIN - 1, OCCUPIED_MIN];
const TRINARY: [i8; 6] = [-1, 0, -1, -1, -1, 100];

#[test]
fn maps_are_trinary_and_the_probabilities_have_a_topic_of_their_own() {
    let bridge = bridge();
    let client = LocalClient::connect(&bridge);
    let maps = ["/robot1/map", "/merged_map", "/map"];
    maps.iter().for_each(|topic| client.subscribe::<OccupancyGrid>(topic));
    client.subscribe::<OccupancyGrid>("/merged_map_probability");
    let header = header(6, 1);
    let grid = GridView::new(&header, &CELLS).unwrap();
    bridge.publish(FleetMessage::Map(RobotId::new(1).unwrap(), grid));
    bridge.publish(FleetMessage::MergedMap(grid));
    let frames = client.take_frames();
    for topic in maps {
        let (_, payload) = frames.iter().find(|(name, _)| name == topic).unwrap();
        let map: OccupancyGrid = bridge::ros::decode(payload).unwrap();
        assert_eq!(map.data, TRINARY, "{topic}");
    }
    let (_, payload) = frames.iter().find(|(name, _)| name == "/merged_map_probability").unwrap();
    let graded: OccupancyGrid = bridge::ros::decode(payload).unwrap();
    assert_eq!(graded.data, [-1, 25, 26, 50, 65, 66]);
}

#[test]
fn a_late_subscriber_of_map_gets_the_newest_merged_map_under_that_name() {
    let bridge = bridge();
    let client = LocalClient::connect(&bridge);
    client.subscribe::<OccupancyGrid>("/map");
    assert!(client.take::<OccupancyGrid>("/map").is_empty(), "no map yet");
    publish_merged(&bridge, 6, &CELLS);
    publish_merged(&bridge, 3, &CELLS);
    let late = LocalClient::connect(&bridge);
    late.subscribe::<OccupancyGrid>("/map");
    let maps: Vec<OccupancyGrid> = late.take("/map");
    assert_eq!(maps.len(), 1);
    assert_eq!((maps[0].width, maps[0].frame_id.as_str()), (3, "map"));
    assert_eq!(client.take::<OccupancyGrid>("/map").last().map(|map| map.width), Some(3));
}

#[test]
fn updates_carry_the_cells_that_changed() {
    let bridge = bridge();
    let client = LocalClient::connect(&bridge);
    client.subscribe::<OccupancyGridUpdate>("/map_updates");
    let mut cells = [UNKNOWN; 12];
    publish_merged(&bridge, 4, &cells);
    let first: Vec<OccupancyGridUpdate> = client.take("/map_updates");
    assert_eq!((first[0].width, first[0].height), (4, 3), "a subscriber's first update has every cell");
    (cells[5], cells[10]) = (OCCUPIED_MIN, FREE_MAX);
    publish_merged(&bridge, 4, &cells);
    let update = client.take::<OccupancyGridUpdate>("/map_updates").remove(0);
    assert_eq!((update.x, update.y, update.width, update.height), (1, 1, 2, 2));
    assert_eq!((update.data.as_slice(), update.frame_id.as_str()), (&[100, -1, -1, 0][..], "map"));
    publish_merged(&bridge, 4, &cells);
    publish_merged(&bridge, 6, &cells);
    let none: Vec<OccupancyGridUpdate> = client.take("/map_updates");
    assert!(none.is_empty(), "nothing changed, then the size did");
}

/// The map of a client that keeps it up to date with tiles: trinary cells by their place, metres / 0.05.
struct KeptMap {
    last: Option<u32>,
    origin: (i64, i64),
    size: (u32, u32),
    cells: Vec<i8>,
}

impl KeptMap {
    fn new(origin: (i64, i64), size: (u32, u32), cells: Vec<i8>) -> Self {
        Self { last: None, origin, size, cells }
    }

    fn at(&self, x: i64, y: i64) -> i8 {
        let (x, y) = (x - self.origin.0, y - self.origin.1);
        let inside = (0..i64::from(self.size.0)).contains(&x) && (0..i64::from(self.size.1)).contains(&y);
        if inside { self.cells[(y * i64::from(self.size.0) + x) as usize] } else { -1 }
    }

    /// Applies an update; returns whether the whole map is needed instead.
    fn apply(&mut self, update: &MapTiles) -> bool {
        let has_gap = update.base == 0 || self.last.is_some_and(|last| last != update.base);
        self.last = Some(update.number);
        if has_gap {
            return true;
        }
        let origin = [0, 1].map(|axis| (update.position[axis] / 0.05).round() as i64);
        let (width, height) = (i64::from(update.size.0), i64::from(update.size.1));
        let places = (0..height).flat_map(|y| (0..width).map(move |x| (x + origin[0], y + origin[1])));
        self.cells = places.map(|(x, y)| self.at(x, y)).collect();
        (self.origin, self.size) = (origin.into(), update.size);
        for tile in &update.tiles {
            for (i, cell) in (0..).zip(&tile.data) {
                let (x, y) = (i64::from(tile.x + i % tile.width), i64::from(tile.y + i / tile.width));
                self.cells[(y * width + x) as usize] = *cell;
            }
        }
        false
    }
}

/// Publishes a merged map whose origin is this many cells from the frame's.
fn publish_at(bridge: &Bridge, (x, y): (i64, i64), width: u32, cells: &[i8]) {
    let mut header = header(width, cells.len() as u32 / width);
    header.origin = Pose2::new(x as f64 * 0.05, y as f64 * 0.05, 0.0);
    bridge.publish(FleetMessage::MergedMap(GridView::new(&header, cells).unwrap()));
}

fn trinary(cells: &[i8]) -> Vec<i8> {
    let values = msg::grid::trinary_table();
    cells.iter().map(|cell| values[*cell as u8 as usize]).collect()
}

#[test]
fn a_map_of_4000_by_4000_cells_costs_its_changed_tiles() {
    const WIDTH: usize = 4000;
    let bridge = bridge();
    let client = LocalClient::connect(&bridge);
    client.subscribe::<MapTiles>("/merged_map_tiles");
    let mut cells = vec![UNKNOWN; WIDTH * WIDTH];
    publish_merged(&bridge, WIDTH as u32, &cells);
    let first: Vec<MapTiles> = client.take("/merged_map_tiles");
    assert_eq!((first[0].base, first[0].tiles.len()), (0, 0), "the whole map is on another topic");
    // Two robots at opposite corners see a cell each; a third one is surer of what it knew.
    (cells[5], cells[WIDTH * WIDTH - 1]) = (OCCUPIED_MIN, FREE_MAX);
    cells[WIDTH * 2000 + 7] = UNKNOWN;
    publish_merged(&bridge, WIDTH as u32, &cells);
    let frames = client.take_frames();
    let bytes: usize = frames.iter().map(|(_, payload)| payload.len()).sum();
    assert!(bytes < 2 * (32 * 32 + 20) + 200, "{bytes} bytes for two tiles of 32 x 32 cells");
    let update: MapTiles = bridge::ros::decode(&frames[0].1).unwrap();
    let places: Vec<_> = update.tiles.iter().map(|tile| (tile.x, tile.y, tile.width, tile.height)).collect();
    assert_eq!(places, [(0, 0, 32, 32), (3968, 3968, 32, 32)]);
    assert_eq!((update.base, update.number), (1, 2));
    // Evidence that changes no published cell costs nothing.
    cells[5] = OCCUPIED_MIN + 1;
    publish_merged(&bridge, WIDTH as u32, &cells);
    assert!(client.take_frames().is_empty());
}

#[test]
fn a_client_that_applies_tiles_has_the_whole_map_however_it_grows() {
    let bridge = bridge();
    let client = LocalClient::connect(&bridge);
    client.subscribe::<MapTiles>("/merged_map_tiles");
    // A fixed sequence of pseudo-random numbers: sizes, origins and cells.
    let mut state = 12345_u32;
    let mut random = move |below: u32| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) % below
    };
    let (mut origin, mut size) = ((0, 0), (40, 30));
    let mut cells = vec![UNKNOWN; 1200];
    let mut kept = KeptMap::new(origin, size, trinary(&cells));
    publish_at(&bridge, origin, size.0, &cells);
    for round in 0..60 {
        if round % 4 == 3 {
            let moved = KeptMap::new(origin, size, std::mem::take(&mut cells));
            let shift = (i64::from(random(70)) - 35, i64::from(random(70)) - 35);
            (origin, size) = ((origin.0 + shift.0, origin.1 + shift.1), (1 + random(90), 1 + random(90)));
            let (width, height) = (i64::from(size.0), i64::from(size.1));
            let places = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
            // Outside of the map before, cells are new.
            cells = places.map(|(x, y)| moved.at(x + origin.0, y + origin.1)).collect();
        }
        for _ in 0..random(5) {
            let (place, value) = (random(cells.len() as u32), random(3));
            cells[place as usize] = [UNKNOWN, FREE_MAX, OCCUPIED_MIN][value as usize];
        }
        publish_at(&bridge, origin, size.0, &cells);
        for update in client.take::<MapTiles>("/merged_map_tiles") {
            // The first update has no base: the client has the whole map by then.
            assert_eq!(kept.apply(&update), update.number == 1);
        }
        assert_eq!((kept.origin, kept.size), (origin, size), "round {round}");
        assert!(kept.cells == trinary(&cells), "round {round}");
    }
    // A map with other cells cannot be told by tiles.
    publish_at(&bridge, origin, size.0, &cells);
    let mut header = header(2, 2);
    header.resolution_m = 0.1;
    bridge.publish(FleetMessage::MergedMap(GridView::new(&header, &[0; 4]).unwrap()));
    let other = client.take::<MapTiles>("/merged_map_tiles").remove(0);
    assert_eq!(other.base, 0);
    assert!(kept.apply(&other));
}

#[test]
fn a_client_that_misses_updates_sees_it_from_their_numbers() {
    let bridge = bridge();
    let client = LocalClient::connect(&bridge);
    client.subscribe::<MapTiles>("/merged_map_tiles");
    let mut cells = [UNKNOWN; 12];
    publish_merged(&bridge, 4, &cells);
    let mut last = client.take::<MapTiles>("/merged_map_tiles").remove(0).number;
    // More than wait for a client that does not read.
    for round in 0..200 {
        cells[5] = if round % 2 == 0 { FREE_MAX } else { OCCUPIED_MIN };
        publish_merged(&bridge, 4, &cells);
    }
    let updates: Vec<MapTiles> = client.take("/merged_map_tiles");
    assert!(updates.len() < 200 && updates[0].base != last, "the oldest are dropped");
    for update in &updates[1..] {
        last = update.base;
        assert!(updates.iter().any(|known| known.number == last), "the others follow each other");
    }
}
