//! Published maps: their values, the names of the merged map, and updates of parts of it.

use crate::local::LocalClient;
use bridge::ros::{OccupancyGrid, OccupancyGridUpdate};
use bridge::{Bridge, BridgeConfig, FleetMessage};
use msg::grid::{FREE_MAX, OCCUPIED_MIN, UNKNOWN};
use msg::{GridHeader, GridView, RobotId};

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
