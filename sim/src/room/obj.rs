//! Wavefront OBJ.

use super::RoomError;
use super::mesh::Mesh;
use glam::Vec3;
use tobj::{LoadError, LoadOptions};

/// How many of the first lines may say which axis is up.
const HEAD_LINES: usize = 32;

/// Triangles of all objects. OBJ does not say which axis is up: a comment `# up y` or `# up z` among
/// the first lines does. Without one it is the axis, y or z, on whose side the larger floor lies; a
/// room is wider than it is high.
pub(crate) fn read(bytes: &[u8]) -> Result<Mesh, RoomError> {
    let malformed = |reason: String| RoomError::Malformed { format: "OBJ", reason };
    check_text(bytes).map_err(malformed)?;
    let options =
        LoadOptions { triangulate: true, ignore_points: true, ignore_lines: true, ..Default::default() };
    // Colours do not matter: no material is ever loaded.
    let no_materials = |_: &std::path::Path| Err(LoadError::GenericFailure);
    let (models, _) = tobj::load_obj_buf(&mut &*bytes, &options, no_materials)
        .map_err(|error| malformed(error.to_string()))?;
    let mut mesh = Mesh::default();
    for model in models {
        let first = mesh.vertices.len() as u32;
        mesh.vertices.extend(model.mesh.positions.chunks_exact(3).map(Vec3::from_slice));
        let triangles = model.mesh.indices.chunks_exact(3);
        mesh.triangles.extend(triangles.map(|t| [t[0], t[1], t[2]].map(|i| i.saturating_add(first))));
    }
    mesh.check()?;
    let y_up = mesh.clone().with_z_up();
    let floor_m2 = |mesh: &Mesh| mesh.find_floor(None).map_or(0.0, |(_, area)| area);
    let is_y_up = stated_up(bytes).map_or_else(|| floor_m2(&y_up) > floor_m2(&mesh), |up| up == "y");
    Ok(if is_y_up { y_up } else { mesh })
}

/// Text, with vertices and faces in it.
fn check_text(bytes: &[u8]) -> Result<(), String> {
    let text =
        core::str::from_utf8(bytes).map_err(|error| format!("byte {} is not text", error.valid_up_to()))?;
    let has = |kind: &str| text.lines().any(|line| line.split_whitespace().next() == Some(kind));
    if has("v") && has("f") { Ok(()) } else { Err("it has no vertices (v) or no faces (f)".to_owned()) }
}

/// `# up y` or `# up z`.
fn stated_up(bytes: &[u8]) -> Option<&str> {
    let lines = core::str::from_utf8(bytes).ok()?.lines().take(HEAD_LINES);
    let mut stated = lines.filter_map(|line| line.trim_start().strip_prefix('#')?.trim().strip_prefix("up "));
    stated.find_map(|axis| Some(axis.trim()).filter(|axis| ["y", "z"].contains(axis)))
}
