//! Maps of map_server as rooms: what is refused, and a fleet whose map is like the file.

use crate::harness::Folder;
use mr_slam::config::{FleetConfig, room};
use mr_slam::lockstep::Lockstep;
use msg::grid::{LOG_ODDS_MAX, Occupancy, UNKNOWN, occupancy};
use msg::{Grid, GridHeader, Pose2};

/// A YAML file of a sound map, `map.pgm`.
const SOUND: [(&str, &str); 7] = [
    ("image", "map.pgm"),
    ("mode", "trinary"),
    ("resolution", "0.1"),
    ("origin", "[0.0, 0.0, 0.0]"),
    ("negate", "0"),
    ("occupied_thresh", "0.65"),
    ("free_thresh", "0.196"),
];

/// A map of 5 by 5 cells: walls around a floor of 3 by 3 cells.
fn sound_image() -> Vec<u8> {
    let greys = (0..25).map(|i| if (1..4).contains(&(i % 5)) && (1..4).contains(&(i / 5)) { 254 } else { 0 });
    b"P5\n5 5\n255\n".iter().copied().chain(greys).collect()
}

#[test]
fn maps_that_are_no_rooms_are_refused_by_name() {
    let folder = Folder::new();
    folder.file("map.pgm", sound_image());
    folder.file("short.pgm", &sound_image()[..20]);
    folder.file("huge.pgm", "P5\n4000000000 4000000000\n255\n");
    folder.file("white.pgm", [&b"P5\n5 5\n255\n"[..], &[254; 25]].concat());
    folder.file("black.pgm", [&b"P5\n5 5\n255\n"[..], &[0; 25]].concat());
    for (key, value, expected) in [
        ("image", "missing.pgm", "missing.pgm"),
        ("image", "short.pgm", "truncated"),
        ("image", "huge.pgm", "4000000000 x 4000000000 cells; expected 1 to"),
        ("image", "white.pgm", "no occupied cell; expected walls"),
        ("image", "black.pgm", "no free cell; expected a floor"),
        ("origin", "[.nan, 0.0, 0.0]", "`origin`"),
        ("origin", "[500.0, 0.0, 0.0]", "at most 200 m"),
        ("origin", "[0.0, 0.0]", "expected image, resolution, origin"),
        ("resolution", ".nan", "`resolution`"),
        ("resolution", "-0.05", "`resolution`"),
        ("resolution", "0.05", "a robot fits nowhere"),
        ("free_thresh", "0.9", "0 <= free_thresh <= occupied_thresh <= 1"),
        ("mode", "colour", "colour"),
    ] {
        let lines =
            SOUND.map(|(known, sound)| format!("{known}: {}\n", if known == key { value } else { sound }));
        let path = folder.file("map.yaml", lines.concat()).display().to_string();
        let said = room::load(&path).map(|_| ()).unwrap_err().to_string();
        assert!(
            said.starts_with(&format!("room {path}: ")) && said.contains(expected),
            "{key}: {value}: {said}"
        );
    }
    let path = folder.file("map.yaml", SOUND.map(|(key, value)| format!("{key}: {value}\n")).concat());
    assert_eq!(room::load(&path.display().to_string()).unwrap().name(), "map.yaml");
    let image = folder.path().join("map.pgm").display().to_string();
    let said = room::load(&image).map(|_| ()).unwrap_err().to_string();
    assert!(said.contains("a map is named by its .yaml"), "{said}");
}

/// A room of 4 m by 3 m around the origin of `world`, with a box.
fn building() -> Grid {
    let (width, height, resolution_m) = (84, 64, 0.05);
    let cell = |column: u32, row: u32| {
        let is_rim = column < 2 || row < 2 || column >= width - 2 || row >= height - 2;
        let is_box = (50..60).contains(&column) && (40..48).contains(&row);
        if is_rim || is_box { LOG_ODDS_MAX } else { -LOG_ODDS_MAX }
    };
    let cells = (0..height).flat_map(|row| (0..width).map(move |column| cell(column, row))).collect();
    let header =
        GridHeader { width, height, resolution_m, origin: Pose2::new(-2.1, -1.6, 0.0), ..Default::default() };
    Grid { header, cells }
}

#[test]
fn a_fleet_in_a_map_maps_its_walls() {
    let folder = Folder::new();
    let building = building();
    formats::map_file::write_map(&folder.path().join("building"), building.view()).unwrap();
    let mut config = FleetConfig::default();
    config.fleet.room = folder.path().join("building.yaml").display().to_string();
    (config.fleet.robots, config.fleet.starts) = (1, vec![[0.0; 3]]);
    let mut fleet = Lockstep::new(&config, true).unwrap();
    (0..2000).for_each(|_| fleet.tick(&mut |_, _| {}));
    let map = fleet.maps().map(|(_, map)| map.to_owned()).next().unwrap();
    let (mut walls, mut near) = (0, 0);
    for row in 0..i64::from(map.header.height) {
        for column in 0..i64::from(map.header.width) {
            let cell = map.view().cell(column, row);
            if cell == UNKNOWN || occupancy(cell) != Occupancy::Occupied {
                continue;
            }
            let (x, y) = building.view().cell_of(map.view().centre_m(column, row));
            let around = (-1..=1).flat_map(|dx| (-1..=1).map(move |dy| (x + dx, y + dy)));
            let is_wall = |(x, y)| occupancy(building.view().cell(x, y)) == Occupancy::Occupied;
            walls += 1;
            near += usize::from(around.into_iter().any(is_wall));
        }
    }
    assert!(
        walls > 50 && near * 100 >= walls * 95,
        "{near} of {walls} occupied cells are at walls of the file"
    );
}
