//! Files of rooms are loaded or refused with the reason, and malformed ones never panic.

#[path = "../common/mod.rs"]
mod common;
mod made;
mod map;

use common::{quiet, robot, scan};
use core::f64::consts::PI;
use msg::grid::{Occupancy, occupancy};
use msg::{Grid, Pose2};
use proptest::prelude::*;
use sim::{LidarConfig, Room, RoomError, SimConfig, Simulator, StartError};

/// Returns the free and the occupied area, square metres.
fn areas_m2(plan: &Grid) -> (f64, f64) {
    let cell_m2 = plan.header.resolution_m.powi(2);
    let count = |what| plan.cells.iter().filter(|cell| occupancy(**cell) == what).count() as f64 * cell_m2;
    (count(Occupancy::Free), count(Occupancy::Occupied))
}

/// Checks the ranges of a LiDAR in the box, which are the same for every format.
fn assert_is_the_box(name: &str, room: &Room) {
    let config = SimConfig { lidar: LidarConfig::LDS_02, ..quiet() };
    let mut simulator = Simulator::new(room, &config, robot(1), Pose2::new(0.032, 0.0, 0.0), 1).unwrap();
    let scan = scan(&mut simulator);
    let range = |degrees: usize| scan.ranges_m()[degrees];
    // Walls ahead, left, behind, right; the block's corner ahead on the left.
    for (degrees, expected) in
        [(0, 2.0), (90, 1.5), (180, 2.0), (270, 1.5), (45, 2f32.sqrt()), (315, 1.5 * 2f32.sqrt())]
    {
        assert!((range(degrees) - expected).abs() < 0.01, "{name} {degrees}°: {}", range(degrees));
    }
}

#[test]
fn every_format_reads_as_the_same_room() {
    for (name, bytes) in made::all() {
        let room = Room::from_bytes(name, &bytes).unwrap_or_else(|error| panic!("{name}: {error}"));
        assert_eq!(room.name(), name);
        assert_is_the_box(name, &room);
        let zipped = Room::from_bytes(&format!("{name}.gz"), &made::gzip(&bytes)).unwrap();
        assert_is_the_box(name, &zipped);
    }
}

#[test]
fn a_floor_plan_shows_the_visible_cells() {
    let room = Room::from_bytes("a.glb", &made::glb()).unwrap();
    let plan = room.floor_plan(0.05);
    let (free, occupied) = areas_m2(&plan);
    let expected = 4.0 * 3.0 - 0.9 * 0.9;
    // Walls take the half of their cells that lie inside.
    assert!((expected - 0.7..expected).contains(&free), "{free}");
    assert!((occupied - (14.0 + 3.6) * 0.05).abs() < 0.15, "{occupied}");
    let at = |x, y| {
        let (column, row) = plan.view().cell_of([x, y]);
        occupancy(plan.view().cell(column, row))
    };
    assert_eq!(at(0.0, 0.0), Occupancy::Free);
    assert_eq!(at(1.45, 0.95), Occupancy::Unknown, "inside the block");
    assert_eq!(at(2.2, 0.0), Occupancy::Unknown, "outside");
    // Behind the block a strip of 0.1 m is free: rays graze along it.
    assert_eq!(at(1.0, 0.95), Occupancy::Occupied);
}

#[test]
fn a_floor_plan_shows_the_floors_on_which_robots_start() {
    // Two rooms without a door: 4 m x 3 m, and 3 m x 3 m behind a wall at x = 4 m.
    let mut text = String::from("# up z\nv 0 0 0\nv 7 0 0\nv 7 3 0\nv 0 3 0\nf 1 2 3 4\n");
    let walls = [[0, 0, 7, 0], [7, 0, 7, 3], [7, 3, 0, 3], [0, 3, 0, 0], [4, 0, 4, 3]];
    for (wall, [x, y, u, v]) in walls.into_iter().enumerate() {
        let first = 5 + 4 * wall;
        text += &format!("v {x} {y} 0\nv {u} {v} 0\nv {u} {v} 1\nv {x} {y} 1\n");
        text += &format!("f {first} {} {} {}\n", first + 1, first + 2, first + 3);
    }
    let room = Room::from_bytes("rooms.obj", text.as_bytes()).unwrap();
    let free_m2 = |starts_m: &[[f64; 2]]| areas_m2(&room.floor_plan_from(0.05, starts_m)).0;
    let is_near = |area_m2: f64, expected: f64| (expected - 1.0..=expected).contains(&area_m2);
    for (starts_m, expected) in [
        (&[][..], 12.0),
        (&[[1.0, 1.0]], 12.0),
        (&[[5.5, 1.5]], 21.0),
        (&[[1.0, 1.0], [6.85, 0.15]], 21.0),
        (&[[f64::NAN, 1.0], [1e9, -1e9], [4.0, 1.5]], 12.0),
    ] {
        let area_m2 = free_m2(starts_m);
        assert!(is_near(area_m2, expected), "{starts_m:?}: {area_m2} m²");
    }
}

#[test]
fn a_floor_plan_is_bounded_in_size() {
    let room = Room::from_bytes("a.glb", &made::glb()).unwrap();
    for resolution_m in [f64::NAN, -1.0, 0.0, 1e-9, 1e9, f64::INFINITY] {
        let plan = room.floor_plan(resolution_m);
        assert!(msg::GridView::new(&plan.header, &plan.cells).is_some(), "{resolution_m}");
    }
}

#[test]
fn the_laboratory_is_furnished_and_passable() {
    let room = Room::laboratory();
    let (free, occupied) = areas_m2(&room.floor_plan(0.05));
    assert!((35.0..45.0).contains(&free), "{free} of 48 m²");
    assert!(occupied > 1.5, "{occupied}");
    for count in 0..=16 {
        let starts = room.starts(count).unwrap();
        assert_eq!(starts.len(), count);
        for (i, start) in starts.iter().enumerate() {
            Simulator::new(&room, &quiet(), robot(i + 1), *start, 1).unwrap();
            assert!(starts[..i].iter().all(|other| other.distance_m(*start) >= 0.5));
        }
        assert_eq!(starts, room.starts(count).unwrap());
    }
    let count = msg::ROBOTS_MAX + 1;
    assert_eq!(room.starts(count), Err(StartError::Full { count, found: msg::ROBOTS_MAX }));
}

#[test]
fn starts_are_refused_in_a_small_room() {
    // 4 x 3 m hold 16 robots; 1.4 x 1 m do not.
    let room = Room::from_bytes("a.glb", &made::glb()).unwrap();
    assert_eq!(room.starts(16).unwrap().len(), 16);
    let small = "# up z\nv 0 0 0\nv 1.4 0 0\nv 1.4 1 0\nv 0 1 0\nv 0 0 1\nv 1.4 0 1\nv 1.4 1 1\nv 0 1 1\n\
        f 1 2 3 4\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n";
    let room = Room::from_bytes("small.obj", small.as_bytes()).unwrap();
    assert!(matches!(room.starts(16), Err(StartError::Full { count: 16, found: 1..16 })));
}

#[test]
fn invalid_starts_are_refused_with_the_reason() {
    let room = Room::laboratory();
    let start = |x, y, yaw| {
        Simulator::new(&room, &quiet(), robot(1), Pose2::new(x, y, yaw), 1).map(|_| ()).unwrap_err()
    };
    assert_eq!(start(f64::NAN, 0.0, 0.0), StartError::NotFinite);
    assert_eq!(start(0.0, 0.0, f64::INFINITY), StartError::NotFinite);
    assert!(matches!(start(50.0, 0.0, 0.0), StartError::OffFloor { .. }));
    assert!(matches!(start(1e300, -1e300, 0.0), StartError::OffFloor { .. }));
    // In the wall, in the column, on the edge of the machine.
    assert!(matches!(start(-3.98, 1.6, 0.0), StartError::InObstacle { .. }));
    assert!(matches!(start(-0.35, 1.15 + 0.2, 0.0), StartError::InObstacle { .. }));
    // Inside the couch and inside the rack: nothing touches, nothing leads out.
    assert!(matches!(start(-2.6, -2.6, 0.0), StartError::Enclosed { .. }));
    assert!(matches!(start(-3.65, -1.1, PI), StartError::Enclosed { .. }));
    // Under the table is place between the legs.
    assert!(Simulator::new(&room, &quiet(), robot(1), Pose2::new(2.35, 1.75, 0.3), 1).is_ok());
    let words = start(-2.6, -2.6, 0.0).to_string();
    assert!(words.contains("inside furniture") && words.contains("-2.60"), "{words}");
}

fn refusal(name: &str, bytes: &[u8]) -> RoomError {
    Room::from_bytes(name, bytes).map(|_| ()).unwrap_err()
}

fn obj(lines: &str) -> RoomError {
    refusal("a.obj", format!("# up z\n{lines}").as_bytes())
}

#[test]
fn invalid_meshes_are_refused_with_the_reason() {
    let walls = "v 0 0 0\nv 4 0 0\nv 4 0 2\nv 0 0 2\nf 1 2 3 4\n";
    assert!(matches!(obj(walls), RoomError::NoFloor { .. }));
    let floor = "v 0 0 0\nv 4 0 0\nv 4 4 0\nv 0 4 0\nf 1 2 3 4\n";
    assert!(matches!(obj(floor), RoomError::NoPlace { .. }));
    let narrow = "v 0 0 0\nv 9 0 0\nv 9 0.2 0\nv 0 0.2 0\nv 0 0 1\nv 9 0 1\nv 9 0.2 1\nv 0 0.2 1\n\
        f 1 2 3 4\nf 1 2 6 5\nf 3 4 8 7\n";
    assert!(matches!(obj(narrow), RoomError::NoPlace { .. }));
    let huge = "v 0 0 0\nv 4000 0 0\nv 4000 3000 0\nv 0 3000 0\nf 1 2 3 4\n";
    assert!(matches!(obj(huge), RoomError::TooLarge { .. }));
    assert!(matches!(obj("v 0 0 nan\nv 4 0 0\nv 4 4 0\nf 1 2 3\n"), RoomError::NotFinite { vertex: 0 }));
    assert!(matches!(obj("v 0 0 0\nv 4 inf 0\nv 4 4 0\nf 1 2 3\n"), RoomError::NotFinite { vertex: 1 }));
    assert!(matches!(obj("v 0 0 0\nv 4 0 0\nv 4 4 0\nf 1 2 9\n"), RoomError::Obj(_)));
    assert!(matches!(obj("v 0 0 0\n"), RoomError::Obj(_)));
    assert!(matches!(refusal("a.stl", b"solid"), RoomError::UnknownFormat { .. }));
    assert!(matches!(refusal("", b""), RoomError::UnknownFormat { .. }));
}

#[test]
fn invalid_scenes_are_refused_with_the_position() {
    use base64::Engine;
    let encode = |bytes: &[u8]| base64::engine::general_purpose::STANDARD.encode(bytes);
    let (vertices, indices) = (made::vertex_bytes(), made::index_bytes());
    let scene = |vertices: &[u8], indices: &[u8]| {
        refusal("a.json", made::scene_of(&encode(vertices), &encode(indices)).as_bytes()).to_string()
    };
    let mut wild = indices.clone();
    wild[0..4].copy_from_slice(&77u32.to_le_bytes());
    assert!(
        scene(&vertices, &wild).contains("spatialEntities[1]: triangle 0 uses vertex 77"),
        "{}",
        scene(&vertices, &wild)
    );
    assert!(scene(&vertices[1..], &indices).contains("no multiple of 12"));
    assert!(scene(&vertices, &[]).contains("triangleMesh_META"));
    let mut nan = vertices.clone();
    nan[12..16].copy_from_slice(&f32::NAN.to_le_bytes());
    assert!(scene(&nan, &indices).contains("vertex 1 is not finite"));
    let text = made::scene().replace("\"spatialEntities\"", "\"entities\"");
    assert!(refusal("a.json", text.as_bytes()).to_string().contains("spatialEntities"));
    let text = made::scene_of("%%%%", &encode(&indices));
    assert!(refusal("a.json", text.as_bytes()).to_string().contains("vertices"));
}

#[test]
fn invalid_mruk_scenes_are_refused_with_the_anchor() {
    let with = |from: &str, to: &str| {
        let text = made::mruk(made::Handedness::Left);
        assert!(text.contains(from), "{from}");
        refusal("a.json", text.replacen(from, to, 1).as_bytes()).to_string()
    };
    let words = with(r#""Unity""#, r#""Unreal""#);
    assert!(words.contains(r#"CoordinateSystem is `Unreal`; expected Unity or OpenXR"#), "{words}");
    let words = with("[270, 90, 0]", "[90, 90, 0]");
    assert!(words.contains("Rooms[0].Anchors[0]: the normal of this FLOOR"), "{words}");
    let words = with("[0, 270, 0]", "[45, 270, 0]");
    assert!(words.contains("Anchors[2]: the normal of this WALL_FACE"), "{words}");
    assert!(with(r#""Scale": [1, 1, 1]"#, r#""Scale": [100, 1, 1]"#).contains("Transform.Scale"));
    assert!(with("[[-1.5, -2], [1.5, -2],", "[").contains("PlaneBoundary2D: the corners enclose"));
    assert!(with("[0, 2]", "[-3, -1]").contains("PlaneBoundary2D: the outline crosses itself"));
    assert!(with(r#""PlaneBounds""#, r#""Bounds""#).contains("has neither PlaneBoundary2D nor PlaneBounds"));
    assert!(with("[2, 1.4, 0]", "[1e39, 1.4, 0]").contains("number out of range"));
    assert!(refusal("a.json", br#"{"Rooms": []}"#).to_string().contains("no anchor is a wall"));
    let mesh = |from: &str, to: &str| {
        let text = made::mruk_mesh();
        assert!(text.contains(from), "{from}");
        refusal("a.json", text.replacen(from, to, 1).as_bytes()).to_string()
    };
    let words = mesh(r#""Indices": [0"#, r#""Indices": [99"#);
    assert!(words.contains("index 99 is used, but there are 16 positions"), "{words}");
    assert!(mesh(r#""Indices": [0, "#, r#""Indices": ["#).contains("is no multiple of 3"));
}

#[test]
fn a_left_handed_scene_is_not_its_mirror_image() {
    let text = made::mruk(made::Handedness::Left).replace("Unity", "OpenXR");
    let room = Room::from_bytes("a.json", text.as_bytes()).unwrap();
    let config = SimConfig { lidar: LidarConfig::LDS_02, ..quiet() };
    let mut simulator = Simulator::new(&room, &config, robot(1), Pose2::new(0.032, 0.0, 0.0), 1).unwrap();
    let ranges = scan(&mut simulator);
    // The block is ahead on the right now, not on the left.
    assert!((ranges.ranges_m()[315] - 2f32.sqrt()).abs() < 0.01);
}

#[test]
fn invalid_gltf_is_refused_with_the_reason() {
    let with = |from: &str, to: &str| {
        let text = made::gltf();
        assert!(text.contains(from));
        refusal("a.gltf", text.replacen(from, to, 1).as_bytes()).to_string()
    };
    // A node that is its own child; one child of two parents; a file outside; counts beyond the buffer.
    assert!(with(r#""children": [1]"#, r#""children": [0]"#).contains("ancestor"));
    assert!(
        with(r#""uri": "data:application/octet-stream;base64,"#, r#""uri": "room.bin?"#)
            .contains("another file")
    );
    assert!(with(r#""count": 16"#, r#""count": 1600000"#).contains("over the end"));
    assert!(with(r#""count": 16"#, r#""count": 4000000000"#).contains("at most"));
    assert!(with(r#""componentType": 5126"#, r#""componentType": 5123"#).contains("f32"));
    assert!(with(r#""nodes": [0]"#, r#""nodes": [7]"#).contains("nodes[7] is not there"));
    assert!(with(r#""mesh": 0"#, r#""mesh": 3"#).contains("meshes[3]"));
    assert!(with(r#""indices": 1"#, r#""indices": 9"#).contains("accessors[9] is not there"));
    assert!(with(r#""byteOffset": "#, r#""byteOffset": 9"#).contains("over the end"));
    let draco = r#""asset": {"version": "2.0"}, "extensionsRequired": ["KHR_draco_mesh_compression"]"#;
    assert!(with(r#""asset": {"version": "2.0"}"#, draco).contains("requires KHR_draco_mesh_compression"));
    let unlit = r#""asset": {"version": "2.0"}, "extensionsRequired": ["KHR_materials_unlit"]"#;
    let text = made::gltf().replacen(r#""asset": {"version": "2.0"}"#, unlit, 1);
    assert!(Room::from_bytes("a.gltf", text.as_bytes()).is_ok());
    // A .glb whose header says less than the header's own size.
    let mut glb = made::glb();
    glb[8..12].copy_from_slice(&3u32.to_le_bytes());
    assert!(refusal("a.glb", &glb).to_string().contains("header says 3 bytes"));
}

#[test]
fn a_gzip_bomb_is_not_decompressed() {
    // 300 MB of spaces in 300 kB.
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    let megabyte = vec![b' '; 1 << 20];
    for _ in 0..300 {
        std::io::Write::write_all(&mut encoder, &megabyte).unwrap();
    }
    let bomb = encoder.finish().unwrap();
    assert!(matches!(refusal("a.json.gz", &bomb), RoomError::TooManyBytes { .. }));
}

#[test]
fn truncated_files_never_panic() {
    for (name, bytes) in made::all() {
        for end in (0..bytes.len()).step_by(bytes.len() / 97 + 1) {
            let _ = Room::from_bytes(name, &bytes[..end]);
        }
        let zipped = made::gzip(&bytes);
        for end in (0..zipped.len()).step_by(zipped.len() / 17 + 1) {
            assert!(Room::from_bytes(name, &zipped[..end]).is_err(), "{name} {end}");
        }
    }
}

/// Valid and invalid words of OBJ.
const WORDS: [&str; 30] = [
    "v",
    "vn",
    "vt",
    "f",
    "o",
    "g",
    "s",
    "usemtl",
    "mtllib",
    "#",
    "up",
    "z",
    "1",
    "2",
    "3",
    "-1",
    "-9",
    "0",
    "1.5",
    "1/1",
    "1//1",
    "1/1/1",
    "-1/-1/-1",
    "4294967296",
    "18446744073709551615",
    "nan",
    "1e39",
    "/",
    "\n",
    "\\\n",
];

/// Files of `made::all`.
const FORMATS: usize = 8;

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1000))]

    /// A file with flipped bits is refused, or gives a room in which the robot's pose stays finite.
    #[test]
    fn flipped_bits_never_panic(format in 0..FORMATS, flips in prop::collection::vec((0.0..1.0f64, 0u8..8), 1..6)) {
        let (name, mut bytes) = made::all().swap_remove(format);
        for (place, bit) in flips {
            let at = (place * bytes.len() as f64) as usize;
            bytes[at] ^= 1 << bit;
        }
        if let Ok(room) = Room::from_bytes(name, &bytes) {
            for start in room.starts(1).unwrap_or_default() {
                if let Ok(mut simulator) = Simulator::new(&room, &quiet(), robot(1), start, 1) {
                    prop_assert!(simulator.step().truth.world_from_base.is_finite());
                    scan(&mut simulator);
                }
            }
        }
    }

    /// Any words in any order are refused or give a room.
    #[test]
    fn obj_words_never_panic(words in prop::collection::vec(0..WORDS.len(), 0..60)) {
        let words: Vec<&str> = words.into_iter().map(|word| WORDS[word]).collect();
        let text = format!("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n{}", words.join(" "));
        let _ = Room::from_bytes("a.obj", text.as_bytes());
    }
}

#[test]
fn labelled_furniture_has_its_outline_in_the_room() {
    for handedness in [made::Handedness::Left, made::Handedness::Right] {
        let room = Room::from_bytes("a.json", made::mruk(handedness).as_bytes()).unwrap();
        let [storage] = room.furniture() else { panic!("{:?}", room.furniture()) };
        assert_eq!(storage.label, "STORAGE");
        assert!((storage.area_m2() - 0.81).abs() < 1e-3, "{storage:?}");
        assert!(storage.is_near([1.45, 0.95], 0.0) && !storage.is_near([0.9, 0.95], 0.05), "{storage:?}");
    }
    for (name, bytes) in made::all() {
        let room = Room::from_bytes(name, &bytes).unwrap();
        assert!(room.furniture().iter().all(|piece| piece.label == "STORAGE"), "{name}");
    }
    let named = made::gltf().replace(r#"{"mesh": 0,"#, r#"{"name": "Table.001", "mesh": 0,"#);
    let room = Room::from_bytes("a.gltf", named.as_bytes()).unwrap();
    let [table] = room.furniture() else { panic!("{:?}", room.furniture()) };
    assert_eq!(table.label, "Table.001");
}
