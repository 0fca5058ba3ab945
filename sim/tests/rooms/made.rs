//! A closed box with a block in it, in each format of rooms.
//!
//! The floor is at a height of 0.4 m. The box has 4 m along x, and 3 m towards the viewer (y up) or to the left
//! (z up).

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
        quads.into_iter().flat_map(move |[a, b, c, d]| [[a, b, c], [a, c, d]].map(|t| t.map(|i| i + first)))
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

/// Frame of a scene of MRUK.
#[derive(Clone, Copy, PartialEq)]
pub enum Handedness {
    Left,
    Right,
}

fn anchor(label: &str, [x, y, z]: [f32; 3], turn: [f32; 3], shape: &str) -> String {
    let [rx, ry, rz] = turn;
    format!(
        r#"{{"UUID": "0", "SemanticClassifications": ["{label}"], {shape},
        "Transform": {{"Translation": [{x}, {y}, {z}], "Rotation": [{rx}, {ry}, {rz}], "Scale": [1, 1, 1]}}}}"#
    )
}

fn scene_of_mruk(system: &str, anchors: &[String]) -> String {
    let anchors = anchors.join(",\n");
    format!(
        r#"{{{system} "Rooms": [{{"UUID": "0", "RoomLayout": {{"FloorUuid": "0", "WallsUuid": []}},
        "Anchors": [{anchors}]}}]}}"#
    )
}

/// The box as planes, and the block as a volume, as MRUK without a scanned mesh has them.
pub fn mruk(handedness: Handedness) -> String {
    let side = if handedness == Handedness::Left { -1.0 } else { 1.0 };
    let bounds = |x: f32, y: f32| format!(r#""PlaneBounds": {{"Min": [-{x}, -{y}], "Max": [{x}, {y}]}}"#);
    let wall = |place, heading, half| anchor("WALL_FACE", place, [0.0, heading, 0.0], &bounds(half, 1.0));
    let outline = r#""PlaneBoundary2D": [[-1.5, -2], [1.5, -2], [1.5, 2], [0, 2], [-1.5, 2]]"#;
    let volume = r#""VolumeBounds": {"Min": [-0.45, -0.45, -1], "Max": [0.45, 0.45, 0]}"#;
    let anchors = [
        anchor("FLOOR", [0.0, 0.4, 0.0], [270.0, 90.0, 0.0], outline),
        anchor("CEILING", [0.0, 2.4, 0.0], [90.0, 0.0, 0.0], &bounds(2.0, 1.5)),
        wall([2.0, 1.4, 0.0], 270.0, 1.5),
        wall([-2.0, 1.4, 0.0], 90.0, 1.5),
        wall([0.0, 1.4, -1.5], 0.0, 2.0),
        wall([0.0, 1.4, 1.5], 180.0, 2.0),
        anchor("DOOR_FRAME", [0.0, 1.4, 0.0], [0.0, 0.0, 0.0], &bounds(0.5, 1.0)),
        anchor("STORAGE", [1.45, 1.4, -0.95 * side], [270.0, 0.0, 0.0], volume),
    ];
    let system = if handedness == Handedness::Left {
        r#""CoordinateSystem": "Unity","#
    } else {
        r#""CoordinateSystem": "OpenXR","#
    };
    scene_of_mruk(system, &anchors)
}

/// The box as a scanned mesh, half a metre too low and a quarter turn off; the anchor's pose puts it right.
pub fn mruk_mesh() -> String {
    let turned = |[x, y, z]: [f32; 3]| [-z, y + 0.5, x];
    let positions: Vec<[f32; 3]> = vertices().into_iter().map(y_up).map(turned).collect();
    let indices: Vec<u32> = triangles().into_iter().flatten().collect();
    let shape = format!(r#""GlobalMesh": {{"Positions": {positions:?}, "Indices": {indices:?}}}"#);
    let bounds = r#""PlaneBounds": {"Min": [-2, -1.5], "Max": [2, 1.5]}"#;
    let anchors = [
        anchor("GLOBAL_MESH", [0.0, -0.5, 0.0], [0.0, 90.0, 0.0], &shape),
        anchor("FLOOR", [0.0, 0.4, 0.0], [270.0, 0.0, 0.0], bounds),
        anchor("WALL_FACE", [0.5, 1.4, 0.0], [0.0, 270.0, 0.0], bounds),
    ];
    scene_of_mruk("", &anchors)
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
        ("mruk-unity.json", mruk(Handedness::Left).into_bytes()),
        ("mruk-openxr.json", mruk(Handedness::Right).into_bytes()),
        ("mruk-mesh.json", mruk_mesh().into_bytes()),
    ]
}
