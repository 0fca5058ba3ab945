//! Rooms in Wavefront OBJ files.

use super::mesh::Mesh;
use super::{RoomError, TRIANGLES_MAX, VERTICES_MAX};
use glam::Vec3;
use tobj::{LoadError, LoadOptions};

/// Number of lines at the beginning of a file that may state the up axis.
const HEAD_LINES: usize = 32;

/// Reason why an OBJ file is not a usable room.
#[derive(Debug, thiserror::Error)]
pub enum ObjError {
    /// The file is no text in UTF-8.
    #[error("byte {byte} is not text")]
    NoText {
        /// Number of the first such byte, from 0.
        byte: usize,
    },
    /// The reader refuses a line.
    #[error(transparent)]
    Content(LoadError),
    /// There is nothing to see or to stand on.
    #[error("it has no vertices (v) or no faces (f)")]
    Empty,
}

/// Reads the triangles of all objects.
///
/// OBJ does not define the up axis. A comment `# up y` or `# up z` among the first lines states it. Without
/// one it is the axis, y or z, with the larger floor, because a room is wider than it is high.
pub(crate) fn read(bytes: &[u8]) -> Result<Mesh, RoomError> {
    let text = core::str::from_utf8(bytes).map_err(|why| ObjError::NoText { byte: why.valid_up_to() })?;
    check_counts(text)?;
    let options =
        LoadOptions { triangulate: true, ignore_points: true, ignore_lines: true, ..Default::default() };
    // Colours have no effect, so no material is loaded.
    let no_materials = |_: &std::path::Path| Err(LoadError::GenericFailure);
    let (models, _) = tobj::load_obj_buf(&mut &*bytes, &options, no_materials).map_err(ObjError::Content)?;
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
    let is_y_up = stated_up_axis(text).map_or_else(|| floor_m2(&y_up) > floor_m2(&mesh), |up| up == "y");
    Ok(if is_y_up { y_up } else { mesh })
}

/// Counts vertices and triangles before the library allocates memory for them.
fn check_counts(text: &str) -> Result<(), RoomError> {
    let (mut vertices, mut triangles) = (0, 0);
    for mut words in text.lines().map(str::split_whitespace) {
        match words.next() {
            Some("v") => vertices += 1,
            // A face of n corners becomes n - 2 triangles.
            Some("f") => triangles += words.count().saturating_sub(2),
            _ => {}
        }
    }
    if vertices == 0 || triangles == 0 {
        return Err(ObjError::Empty.into());
    }
    let counts = [("vertices", vertices, VERTICES_MAX), ("triangles", triangles, TRIANGLES_MAX)];
    match counts.into_iter().find(|(_, count, max)| count > max) {
        Some((what, count, max)) => Err(RoomError::TooMany { what, count, max }),
        None => Ok(()),
    }
}

/// Returns the axis of a comment `# up y` or `# up z`, if there is one.
fn stated_up_axis(text: &str) -> Option<&str> {
    let lines = text.lines().take(HEAD_LINES);
    let mut stated = lines.filter_map(|line| line.trim_start().strip_prefix('#')?.trim().strip_prefix("up "));
    stated.find_map(|axis| Some(axis.trim()).filter(|axis| ["y", "z"].contains(axis)))
}
