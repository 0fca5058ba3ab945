//! Maps of map_server as rooms: what is refused, and a fleet whose map is like the file.

use crate::harness::{Folder, mr_slam, output_of};
use mr_slam::config::{FleetConfig, room};
use mr_slam::lockstep::Lockstep;
use msg::grid::{LOG_ODDS_MAX, Occupancy, UNKNOWN, occupancy};
use msg::{Grid, GridHeader, Pose2};
use std::path::PathBuf;

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

/// Writes the building, with a wall more if it is to be another room, and returns its YAML file.
fn write_building(folder: &Folder, is_other: bool) -> PathBuf {
    let mut building = building();
    let width = building.header.width as usize;
    (0..20).filter(|_| is_other).for_each(|row| building.cells[(row + 2) * width + 20] = LOG_ODDS_MAX);
    formats::map_file::write_map(&folder.path().join("building"), building.view()).unwrap();
    folder.path().join("building.yaml")
}

/// Runs the program in a folder; returns whether it succeeded, its figures, and what it said.
fn run_in(folder: &Folder, args: &[&str]) -> (bool, serde_json::Value, String) {
    let ended = output_of(mr_slam().current_dir(folder.path()).args(args));
    let figures = serde_json::from_slice(&ended.stdout).unwrap_or_default();
    (ended.status.success(), figures, String::from_utf8_lossy(&ended.stderr).into_owned())
}

#[test]
fn a_replay_says_whether_the_room_is_the_recorded_one_and_gives_the_same_maps() {
    let folder = Folder::new();
    write_building(&folder, false);
    let fleet = ["lockstep", "--room", "building.yaml", "--robots", "2", "--seconds", "6", "--json"];
    let (is_done, run, said) = run_in(&folder, &[&fleet[..], &["--record", "b.mcap"]].concat());
    assert!(is_done && !said.contains("is open"), "{said}");
    let replay = || run_in(&folder, &["replay", "b.mcap", "--json"]);
    let (is_done, same, said) = replay();
    assert!(is_done && !said.contains("building.yaml"), "{said}");
    assert_eq!((&same["room"], &same["maps_sha256"]), (&"same".into(), &run["maps_sha256"]));
    assert!(same["fleet"]["against_room"].is_object(), "{same}");

    let yaml = write_building(&folder, true);
    let changed = replay();
    std::fs::remove_file(yaml).unwrap();
    for ((is_done, figures, said), room, expected) in
        [(changed, "changed", "have changed since the recording"), (replay(), "missing", "cannot be read")]
    {
        assert!(is_done && said.contains(expected), "{room}: {said}");
        assert_eq!((&figures["room"], &figures["maps_sha256"]), (&room.into(), &run["maps_sha256"]));
        let against = [&figures["fleet"]["against_room"], &figures["fleet"]["room_coverage"]];
        assert!(against.iter().all(|figure| figure.is_null()), "{room}: {against:?}");
    }
}

#[test]
fn a_run_does_not_replace_its_room() {
    let folder = Folder::new();
    write_building(&folder, false);
    let path = |name: &str| folder.path().join(name);
    std::fs::create_dir(path("r")).unwrap();
    formats::map_file::write_map(&path("r/merged_map"), building().view()).unwrap();
    let before = std::fs::read(path("r/merged_map.pgm")).unwrap();
    let lockstep = ["lockstep", "--room", "r/merged_map.yaml", "--robots", "1", "--seconds", "1"];
    let (is_done, _, said) = run_in(&folder, &[&lockstep[..], &["--run-dir", "r"]].concat());
    assert!(!is_done && said.contains("r/merged_map") && said.contains("another --run-dir"), "{said}");
    assert_eq!(std::fs::read(path("r/merged_map.pgm")).unwrap(), before);
    let (is_done, _, said) = run_in(&folder, &[&lockstep[..], &["--run-dir", "other"]].concat());
    assert!(is_done, "{said}");
}

#[test]
fn an_open_edge_of_the_floor_is_said_with_its_length_once() {
    let folder = Folder::new();
    let mut building = building();
    let width = building.header.width as usize;
    // 2 m of the wall at the right are unknown; the border ends within the walls.
    (10..50).for_each(|row| building.cells[row * width + width - 2..(row + 1) * width].fill(UNKNOWN));
    formats::map_file::write_map(&folder.path().join("open"), building.view()).unwrap();
    let of_fleet = ["--fast", "--sessions", "2", "--room", "open.yaml", "--robots", "1", "--seconds", "1"];
    for command in [&["lockstep"][..], &["experiment", "--out", "e"]] {
        let options = if command[0] == "lockstep" { &of_fleet[3..] } else { &of_fleet[..] };
        let (is_done, _, said) = run_in(&folder, &[command, options].concat());
        assert!(is_done && said.matches("2.1 m of the floor's edge is open").count() == 1, "{said}");
    }
}

#[test]
fn an_exploration_that_ends_with_the_time_of_the_run_says_so() {
    let folder = Folder::new();
    write_building(&folder, false);
    let explore = ["lockstep", "--explore", "--room", "building.yaml", "--robots", "1", "--seconds", "3"];
    let ended = output_of(mr_slam().current_dir(folder.path()).args(explore));
    let text = String::from_utf8_lossy(&ended.stdout);
    assert!(ended.status.success() && text.contains("before the exploration was over"), "{text}");
    let (_, figures, said) = run_in(&folder, &[&explore[..], &["--json"]].concat());
    assert_eq!(figures["exploration"]["is_over"], false, "{said}");
}

#[test]
fn an_experiment_does_not_go_on_in_another_room_of_the_same_name() {
    let folder = Folder::new();
    write_building(&folder, false);
    let experiment = |sessions| {
        let of_fleet = ["--fast", "--room", "building.yaml", "--robots", "1", "--seconds", "2", "--out", "e"];
        run_in(&folder, &[&["experiment", "--sessions", sessions][..], &of_fleet].concat())
    };
    let (is_done, _, said) = experiment("1");
    assert!(is_done, "{said}");
    let (is_done, _, said) = experiment("2");
    assert!(is_done && said.contains("session 1 of 2: is there already"), "{said}");
    write_building(&folder, true);
    let (is_done, _, said) = experiment("3");
    assert!(!is_done && said.contains("files had another content") && said.contains("--out"), "{said}");
}
