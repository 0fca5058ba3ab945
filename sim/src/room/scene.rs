//! Scanned rooms as scene JSON with spatial entities, as Quest headsets and WebXR's emulators record it.
//!
//! The frame is right-handed with y up, in metres.

use super::furniture::is_furniture;
use super::mesh::Mesh;
use super::{RoomError, TRIANGLES_MAX, VERTICES_MAX};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use glam::{Quat, Vec3};
use serde::Deserialize;

#[derive(Deserialize)]
struct Scene {
    #[serde(rename = "spatialEntities")]
    entities: Vec<Entity>,
}

#[derive(Deserialize)]
struct Entity {
    #[serde(rename = "semanticLabel_META")]
    label: Option<String>,
    #[serde(rename = "locatable_META")]
    place: Option<Place>,
    #[serde(rename = "triangleMesh_META")]
    mesh: Option<Triangles>,
}

#[derive(Deserialize)]
struct Place {
    position: Xyz,
    orientation: Xyzw,
}

#[derive(Deserialize)]
struct Xyz {
    x: f32,
    y: f32,
    z: f32,
}

#[derive(Deserialize)]
struct Xyzw {
    x: f32,
    y: f32,
    z: f32,
    w: f32,
}

/// Mesh of an entity, as base64 of little-endian numbers: f32 x, y, z, and u32 indices.
#[derive(Deserialize)]
struct Triangles {
    vertices: String,
    indices: String,
}

/// Reason why a scene is not a usable room.
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    /// The text is no JSON of a scene.
    #[error(transparent)]
    Json(#[from] serde_json::Error),
    /// No entity has triangles.
    #[error("no entity has a triangleMesh_META: scan the room's mesh, not its walls alone")]
    NoMesh,
    /// An entity cannot be used.
    #[error("spatialEntities[{number}]: {why}")]
    Entity {
        /// Number of the entity, from 0.
        number: usize,
        /// What is wrong with it.
        why: EntityError,
    },
}

/// Reason why an entity of a scene cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum EntityError {
    /// Its position or orientation is no finite pose.
    #[error("locatable_META is no pose (its orientation has length {norm})")]
    Pose {
        /// Length of the quaternion, which should be 1.
        norm: f32,
    },
    /// A triangle uses a vertex that does not exist.
    #[error("triangle {triangle} uses vertex {index}, but there are {count}")]
    NoVertex {
        /// Number of the triangle, from 0.
        triangle: usize,
        /// Number of the vertex.
        index: u32,
        /// Number of vertices.
        count: usize,
    },
    /// A list of numbers is no base64.
    #[error("{what}: {why}")]
    Encoding {
        /// Name of the list.
        what: &'static str,
        /// What is wrong with it.
        why: base64::DecodeError,
    },
    /// A list is too long.
    #[error("{what}: {count} records, at most {max} are supported")]
    TooMany {
        /// Name of the list.
        what: &'static str,
        /// Number of records.
        count: usize,
        /// Largest supported number.
        max: usize,
    },
    /// A list ends within a record.
    #[error("{what}: {bytes} bytes are no multiple of {record}")]
    PartOfRecord {
        /// Name of the list.
        what: &'static str,
        /// Bytes of the list.
        bytes: usize,
        /// Bytes of a record.
        record: usize,
    },
}

/// Reads the triangles of all entities, and the floor's height if an entity `FLOOR` states it.
pub(crate) fn read(bytes: &[u8]) -> Result<(Mesh, Option<f32>), RoomError> {
    Ok(read_scene(bytes)?)
}

fn read_scene(bytes: &[u8]) -> Result<(Mesh, Option<f32>), SceneError> {
    let scene: Scene = serde_json::from_slice(bytes)?;
    let mut mesh = Mesh::default();
    for (number, entity) in scene.entities.iter().enumerate() {
        if let Some(triangles) = &entity.mesh {
            let first = mesh.triangles.len();
            append(&mut mesh, entity, triangles).map_err(|why| SceneError::Entity { number, why })?;
            if let Some(label) = entity.label.as_deref().filter(|label| is_furniture(label)) {
                mesh.name_triangles(label, first);
            }
        }
    }
    if mesh.triangles.is_empty() {
        return Err(SceneError::NoMesh);
    }
    let floor = scene.entities.iter().find(|entity| entity.label.as_deref() == Some("FLOOR"));
    let floor_m = floor.and_then(|entity| entity.place.as_ref()).map(|place| place.position.y);
    Ok((mesh.with_z_up(), floor_m.filter(|height| height.is_finite())))
}

fn append(mesh: &mut Mesh, entity: &Entity, triangles: &Triangles) -> Result<(), EntityError> {
    let vertices = decode::<12>("vertices", &triangles.vertices, VERTICES_MAX)?;
    let indices = decode::<12>("indices", &triangles.indices, TRIANGLES_MAX)?;
    let (rotation, position) = match &entity.place {
        Some(Place { position: p, orientation: q }) => {
            (Quat::from_xyzw(q.x, q.y, q.z, q.w), Vec3::new(p.x, p.y, p.z))
        }
        None => (Quat::IDENTITY, Vec3::ZERO),
    };
    let norm = rotation.length();
    if !(0.9..=1.1).contains(&norm) || !position.is_finite() {
        return Err(EntityError::Pose { norm });
    }
    let rotation = rotation.normalize();
    let first = mesh.vertices.len();
    let count = vertices.len();
    mesh.vertices.extend(vertices.iter().map(|v| {
        let number = |i: usize| f32::from_le_bytes([v[i], v[i + 1], v[i + 2], v[i + 3]]);
        rotation * Vec3::new(number(0), number(4), number(8)) + position
    }));
    for (number, t) in indices.iter().enumerate() {
        let corner = |i: usize| u32::from_le_bytes([t[i], t[i + 1], t[i + 2], t[i + 3]]);
        let corners = [corner(0), corner(4), corner(8)];
        if let Some(wrong) = corners.iter().find(|i| **i as usize >= count) {
            return Err(EntityError::NoVertex { triangle: number, index: *wrong, count });
        }
        mesh.triangles.push(corners.map(|i| i + first as u32));
    }
    Ok(())
}

/// Decodes records of `N` bytes from base64.
fn decode<const N: usize>(what: &'static str, text: &str, max: usize) -> Result<Vec<[u8; N]>, EntityError> {
    let bytes = STANDARD.decode(text).map_err(|why| EntityError::Encoding { what, why })?;
    let (records, rest) = bytes.as_chunks::<N>();
    match rest.len() {
        0 if records.len() <= max => Ok(records.to_vec()),
        0 => Err(EntityError::TooMany { what, count: records.len(), max }),
        _ => Err(EntityError::PartOfRecord { what, bytes: bytes.len(), record: N }),
    }
}
