//! Rooms: what is loaded, what is refused and why, and that nothing malformed panics.

mod common;

use common::{quiet, robot, scan};
use core::f64::consts::PI;
use msg::grid::{Occupancy, occupancy};
use msg::{Grid, Pose2};
use proptest::prelude::*;
use sim::{LidarConfig, Room, RoomError, SimConfig, Simulator, StartError};

/// A closed box with a block in it, as text or bytes of each format. All have the floor at 0.4 m
/// height, 4 m along x, and 3 m towards the viewer (y up) or to the left (z up).
mod made {
    use base64::Engine;
    use base64::engine::general_purpose::STANDARD;

    /// x, y (to the left), z (up).
    pub fn vertices() -> Vec<[f32; 3]> {
        let block = |x0: f32, y0: f32, z0: f32, x1: f32, y1: f32, z1: f32| {
            [
                [x0, y0, z0],
                [x1, y0, z0],
                [x1, y1, z0],
                [x0, y1, z0],
                [x0, y0, z1],
                [x1, y0, z1],
                [x1, y1, z1],
                [x0, y1, z1],
            ]
        };
        [block(-2.0, -1.5, 0.4, 2.0, 1.5, 2.4), block(1.0, 0.5, 0.4, 1.9, 1.4, 1.4)].concat()
    }

    pub fn triangles() -> Vec<[u32; 3]> {
        let quads = [[0, 1, 2, 3], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]];
        let of = |first: u32| {
            quads
                .into_iter()
                .flat_map(move |[a, b, c, d]| [[a, b, c], [a, c, d]].map(|t| t.map(|i| i + first)))
        };
        of(0).chain(of(8)).collect()
    }

    /// z up to y up.
    pub fn y_up([x, y, z]: [f32; 3]) -> [f32; 3] {
        [x, z, -y]
    }

    fn obj_of(vertices: impl Iterator<Item = [f32; 3]>) -> String {
        let vertices = vertices.map(|[x, y, z]| format!("v {x} {y} {z}\n"));
        let faces = triangles().into_iter().map(|t| {
            let [a, b, c] = t.map(|i| i + 1);
            format!("f {a} {b} {c}\n")
        });
        vertices.chain(faces).collect()
    }

    pub fn obj_z_up() -> String {
        obj_of(vertices().into_iter())
    }

    pub fn obj_y_up() -> String {
        obj_of(vertices().into_iter().map(y_up))
    }

    pub fn vertex_bytes() -> Vec<u8> {
        vertices().into_iter().flat_map(y_up).flat_map(f32::to_le_bytes).collect()
    }

    pub fn index_bytes() -> Vec<u8> {
        triangles().into_iter().flatten().flat_map(u32::to_le_bytes).collect()
    }

    /// The mesh lies half a metre too high and a quarter turn off; its place puts it right.
    pub fn scene() -> String {
        let turned = |[x, y, z]: [f32; 3]| [-z, y - 0.5, x];
        let vertices: Vec<u8> =
            vertices().into_iter().map(y_up).flat_map(turned).flat_map(f32::to_le_bytes).collect();
        scene_of(&STANDARD.encode(vertices), &STANDARD.encode(index_bytes()))
    }

    pub fn scene_of(vertices: &str, indices: &str) -> String {
        let half = core::f64::consts::FRAC_1_SQRT_2;
        format!(
            r#"{{"type": "scene", "version": 1, "spatialEntities": [
            {{"uuid": "a", "semanticLabel_META": "FLOOR", "locatable_META": {{"position": {{"x": 0, "y": 0.37, "z": 0}},
              "orientation": {{"x": 0.7071, "y": 0, "z": 0, "w": 0.7071}}}},
              "bounded2D_META": {{"offset": {{"x": -2, "y": -1.5}}, "extent": {{"width": 4, "height": 3}}}}}},
            {{"uuid": "b", "semanticLabel_META": "UNRECOGNIZED", "locatable_META": {{"position": {{"x": 0, "y": 0.5, "z": 0}},
              "orientation": {{"x": 0, "y": {half}, "z": 0, "w": {half}}}}},
              "triangleMesh_META": {{"vertices": "{vertices}", "indices": "{indices}"}}}}]}}"#
        )
    }

    fn gltf_json(uri: Option<&str>, bytes: usize) -> String {
        let vertex_bytes = vertex_bytes().len();
        let (vertex_count, index_count) = (vertices().len(), triangles().len() * 3);
        let uri = uri.map_or(String::new(), |uri| format!(r#""uri": "{uri}", "#));
        // The inner node's translation and the outer one's scale cancel the vertices' lift and halving.
        format!(
            r#"{{"asset": {{"version": "2.0"}}, "scene": 0, "scenes": [{{"nodes": [0]}}],
            "nodes": [{{"children": [1], "scale": [2, 2, 2]}}, {{"mesh": 0, "scale": [0.5, 0.5, 0.5]}}],
            "meshes": [{{"primitives": [{{"attributes": {{"POSITION": 0}}, "indices": 1}}]}}],
            "buffers": [{{{uri}"byteLength": {bytes}}}],
            "bufferViews": [{{"buffer": 0, "byteLength": {vertex_bytes}}},
              {{"buffer": 0, "byteOffset": {vertex_bytes}, "byteLength": {}}}],
            "accessors": [
              {{"bufferView": 0, "componentType": 5126, "count": {vertex_count}, "type": "VEC3",
                "min": [-2, 0.4, -1.5], "max": [2, 2.4, 1.5]}},
              {{"bufferView": 1, "componentType": 5125, "count": {index_count}, "type": "SCALAR"}}]}}"#,
            bytes - vertex_bytes
        )
    }

    fn buffer() -> Vec<u8> {
        [vertex_bytes(), index_bytes()].concat()
    }

    pub fn gltf() -> String {
        let buffer = buffer();
        let uri = format!("data:application/octet-stream;base64,{}", STANDARD.encode(&buffer));
        gltf_json(Some(&uri), buffer.len())
    }

    pub fn glb() -> Vec<u8> {
        let buffer = buffer();
        let mut json = gltf_json(None, buffer.len()).into_bytes();
        json.resize(json.len().next_multiple_of(4), b' ');
        let chunk =
            |kind: &[u8; 4], data: &[u8]| [&(data.len() as u32).to_le_bytes()[..], &kind[..], data].concat();
        let chunks = [chunk(b"JSON", &json), chunk(b"BIN\0", &buffer)].concat();
        [&b"glTF"[..], &2u32.to_le_bytes(), &(12 + chunks.len() as u32).to_le_bytes(), &chunks].concat()
    }

    pub fn gzip(bytes: &[u8]) -> Vec<u8> {
        use std::io::Write;
        let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
        encoder.write_all(bytes).unwrap();
        encoder.finish().unwrap()
    }

    pub fn all() -> Vec<(&'static str, Vec<u8>)> {
        vec![
            ("a.json", scene().into_bytes()),
            ("a.gltf", gltf().into_bytes()),
            ("a.glb", glb()),
            ("a.obj", obj_z_up().into_bytes()),
            ("b.obj", obj_y_up().into_bytes()),
        ]
    }
}

/// Free and occupied square metres.
fn areas_m2(plan: &Grid) -> (f64, f64) {
    let cell_m2 = plan.header.resolution_m.powi(2);
    let count = |what| plan.cells.iter().filter(|cell| occupancy(**cell) == what).count() as f64 * cell_m2;
    (count(Occupancy::Free), count(Occupancy::Occupied))
}

/// The same box, whatever it was read from: what a LiDAR sees from one place.
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
fn every_format_gives_the_same_room() {
    for (name, bytes) in made::all() {
        let room = Room::from_bytes(name, &bytes).unwrap_or_else(|error| panic!("{name}: {error}"));
        assert_eq!(room.name(), name);
        assert_is_the_box(name, &room);
        let zipped = Room::from_bytes(&format!("{name}.gz"), &made::gzip(&bytes)).unwrap();
        assert_is_the_box(name, &zipped);
    }
}

#[test]
fn plan_shows_what_can_be_seen() {
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
fn plan_keeps_its_size_in_bounds() {
    let room = Room::from_bytes("a.glb", &made::glb()).unwrap();
    for resolution_m in [f64::NAN, -1.0, 0.0, 1e-9, 1e9, f64::INFINITY] {
        let plan = room.floor_plan(resolution_m);
        assert!(msg::GridView::new(&plan.header, &plan.cells).is_some(), "{resolution_m}");
    }
}

#[test]
fn laboratory_is_furnished_and_passable() {
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
    assert_eq!(room.starts(17), Err(StartError::Full { count: 17, found: 16 }));
}

#[test]
fn starts_need_place() {
    // 4 x 3 m hold 16 robots; 1.4 x 1 m do not.
    let room = Room::from_bytes("a.glb", &made::glb()).unwrap();
    assert_eq!(room.starts(16).unwrap().len(), 16);
    let small = "# up z\nv 0 0 0\nv 1.4 0 0\nv 1.4 1 0\nv 0 1 0\nv 0 0 1\nv 1.4 0 1\nv 1.4 1 1\nv 0 1 1\n\
        f 1 2 3 4\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n";
    let room = Room::from_bytes("small.obj", small.as_bytes()).unwrap();
    assert!(matches!(room.starts(16), Err(StartError::Full { count: 16, found: 1..16 })));
}

#[test]
fn bad_starts_are_refused_with_the_reason() {
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
fn meshes_that_are_no_rooms_are_refused_with_the_reason() {
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
    assert!(matches!(obj("v 0 0 0\nv 4 0 0\nv 4 4 0\nf 1 2 9\n"), RoomError::Malformed { .. }));
    assert!(matches!(obj("v 0 0 0\n"), RoomError::Malformed { .. }));
    assert!(matches!(refusal("a.stl", b"solid"), RoomError::UnknownFormat { .. }));
    assert!(matches!(refusal("", b""), RoomError::UnknownFormat { .. }));
}

#[test]
fn scenes_are_refused_with_the_place() {
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
fn gltf_is_refused_with_the_reason() {
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
fn a_bomb_is_not_inflated() {
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
fn truncation_never_panics() {
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

/// Words of OBJ, sound and unsound.
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

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1000))]

    /// Flipped bits are refused or give a room in which a robot stays a robot.
    #[test]
    fn flipped_bits_never_panic(format in 0usize..5, flips in prop::collection::vec((0.0..1.0f64, 0u8..8), 1..6)) {
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

    /// Any words in any order are refused or a room.
    #[test]
    fn obj_words_never_panic(words in prop::collection::vec(0..WORDS.len(), 0..60)) {
        let words: Vec<&str> = words.into_iter().map(|word| WORDS[word]).collect();
        let text = format!("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n{}", words.join(" "));
        let _ = Room::from_bytes("a.obj", text.as_bytes());
    }
}
