//! Rooms in glTF 2.0 files, binary or JSON, with embedded buffers. Right-handed, y up, metres.
//!
//! The library splits the container and has the document's types. Its validation and its iterators panic
//! at some malformed documents. This module therefore checks every index itself.

use super::mesh::Mesh;
use super::{RoomError, TRIANGLES_MAX, VERTICES_MAX};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use glam::{Mat4, Quat, Vec3};
use gltf::Glb;
use gltf::json::accessor::{ComponentType, Type};
use gltf::json::mesh::{Mode, Primitive, Semantic};
use gltf::json::validation::Checked;
use gltf::json::{Accessor, Index, Node, Root};

/// Largest depth of nested nodes.
const DEPTH_MAX: usize = 64;
/// Prefixes of extensions that change the looks of a mesh but not its geometry.
const HARMLESS: [&str; 4] = ["KHR_materials_", "KHR_texture_", "KHR_lights_", "EXT_texture_"];

/// Reads the triangles of the default scene, or of the first one, with their nodes' transforms.
pub(crate) fn read(bytes: &[u8]) -> Result<Mesh, RoomError> {
    read_scene(bytes).map(Mesh::with_z_up).map_err(|reason| RoomError::Malformed { format: "glTF", reason })
}

fn read_scene(bytes: &[u8]) -> Result<Mesh, String> {
    let (json, mut blob) = if bytes.starts_with(b"glTF") {
        let Glb { json, bin, .. } = split(bytes)?;
        (json, bin.map(|bin| bin.into_owned()))
    } else {
        (bytes.into(), None)
    };
    let root = Root::from_slice(&json).map_err(|error| error.to_string())?;
    let unknown =
        root.extensions_required.iter().find(|name| !HARMLESS.iter().any(|known| name.starts_with(known)));
    if let Some(name) = unknown {
        return Err(format!("it requires {name}, which is not supported: export without it"));
    }
    let mut buffers = Vec::new();
    for buffer in &root.buffers {
        buffers.push(match &buffer.uri {
            Some(uri) => embedded(uri)?,
            None => blob.take().ok_or("the binary chunk is missing")?,
        });
    }
    let scene = root.scene.unwrap_or(Index::new(0));
    let scene = root.get(scene).ok_or_else(|| format!("scenes[{}] is not there", scene.value()))?;
    let mut walk = Walk { root: &root, buffers, mesh: Mesh::default(), nodes_left: root.nodes.len() };
    scene.nodes.iter().try_for_each(|node| walk.visit(*node, Mat4::IDENTITY, 0))?;
    Ok(walk.mesh)
}

/// Splits a .glb into its chunks.
fn split(bytes: &[u8]) -> Result<Glb<'_>, String> {
    // The library subtracts the header's size from this length without a check.
    let stated = bytes.get(8..12).map_or(0, |b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as usize);
    if stated < 12 || stated > bytes.len() {
        return Err(format!("its header says {stated} bytes, but there are {}", bytes.len()));
    }
    Glb::from_slice(bytes).map_err(|error| error.to_string())
}

/// Decodes a buffer that is a data URI.
fn embedded(uri: &str) -> Result<Vec<u8>, String> {
    let data = uri.strip_prefix("data:").and_then(|rest| rest.split_once(";base64,"));
    let (_, text) = data.ok_or("a buffer is in another file: pack the model into one .glb")?;
    STANDARD.decode(text).map_err(|error| format!("a buffer's data URI: {error}"))
}

struct Walk<'a> {
    root: &'a Root,
    buffers: Vec<Vec<u8>>,
    mesh: Mesh,
    /// Number of nodes that may still be visited. A tree visits each node once; more visits mean a cycle.
    nodes_left: usize,
}

impl Walk<'_> {
    fn visit(&mut self, index: Index<Node>, world_from_parent: Mat4, depth: usize) -> Result<(), String> {
        let number = index.value();
        let at = |reason: String| format!("nodes[{number}] {reason}");
        let node = self.root.get(index).ok_or_else(|| at("is not there".into()))?;
        self.nodes_left = self
            .nodes_left
            .checked_sub(1)
            .ok_or_else(|| at("is its own ancestor, or has two parents".into()))?;
        if depth > DEPTH_MAX {
            return Err(at(format!("is nested deeper than {DEPTH_MAX}")));
        }
        let world_from_node = world_from_parent * parent_from(node);
        if let Some(index) = node.mesh {
            let mesh = self.root.get(index).ok_or_else(|| at(format!("has no meshes[{}]", index.value())))?;
            for primitive in &mesh.primitives {
                self.append(primitive, world_from_node)
                    .map_err(|reason| at(format!("has a bad mesh: {reason}")))?;
            }
        }
        let mut children = node.children.iter().flatten();
        children.try_for_each(|child| self.visit(*child, world_from_node, depth + 1))
    }

    fn append(&mut self, primitive: &Primitive, world_from_node: Mat4) -> Result<(), String> {
        match primitive.mode {
            Checked::Valid(Mode::Triangles) => {}
            Checked::Valid(Mode::Points | Mode::Lines | Mode::LineLoop | Mode::LineStrip) => return Ok(()),
            _ => return Err("export triangles, no strips or fans".into()),
        }
        let Some(positions) = primitive.attributes.get(&Checked::Valid(Semantic::Positions)) else {
            return Ok(());
        };
        let positions = self.positions(*positions)?;
        let count = positions.len();
        let corners = match primitive.indices {
            Some(indices) => self.indices(indices)?,
            None => (0..count as u32).collect(),
        };
        if let Some(wrong) = corners.iter().find(|index| **index as usize >= count) {
            return Err(format!("an index is {wrong}, but there are {count} vertices"));
        }
        // Nodes may share a mesh, so the sum over all nodes is limited.
        if self.mesh.vertices.len() + count > VERTICES_MAX
            || self.mesh.triangles.len() + corners.len() / 3 > TRIANGLES_MAX
        {
            return Err(format!("over {VERTICES_MAX} vertices or {TRIANGLES_MAX} triangles"));
        }
        let first = self.mesh.vertices.len() as u32;
        self.mesh.vertices.extend(positions.iter().map(|p| world_from_node.transform_point3(*p)));
        let (triangles, _) = corners.as_chunks::<3>();
        self.mesh.triangles.extend(triangles.iter().map(|t| t.map(|i| i + first)));
        Ok(())
    }

    fn positions(&self, index: Index<Accessor>) -> Result<Vec<Vec3>, String> {
        let records = self.records(index, Type::Vec3, VERTICES_MAX)?;
        if records.component != ComponentType::F32 {
            return Err("positions are not f32: export without quantisation".into());
        }
        let number = |bytes: &[u8]| f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
        let point = |b: &[u8]| Vec3::new(number(&b[0..4]), number(&b[4..8]), number(&b[8..12]));
        Ok(records.iter().map(point).collect())
    }

    fn indices(&self, index: Index<Accessor>) -> Result<Vec<u32>, String> {
        let records = self.records(index, Type::Scalar, 3 * TRIANGLES_MAX)?;
        let numbers = records.iter();
        Ok(match records.component {
            ComponentType::U8 => numbers.map(|b| u32::from(b[0])).collect(),
            ComponentType::U16 => numbers.map(|b| u32::from(u16::from_le_bytes([b[0], b[1]]))).collect(),
            ComponentType::U32 => numbers.map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect(),
            other => return Err(format!("indices are {other:?}")),
        })
    }

    fn records(&self, index: Index<Accessor>, kind: Type, max: usize) -> Result<Records<'_>, String> {
        let wrong = |what: &str| format!("accessors[{}] {what}", index.value());
        let accessor = self.root.get(index).ok_or_else(|| wrong("is not there"))?;
        let (Checked::Valid(component), Checked::Valid(found)) = (accessor.component_type, accessor.type_)
        else {
            return Err(wrong("has an unknown type"));
        };
        if found != kind {
            return Err(wrong(&format!("is {found:?}, not {kind:?}")));
        }
        if accessor.sparse.is_some() {
            return Err(wrong("is sparse, which is not supported"));
        }
        let count = usize::try_from(accessor.count.0).unwrap_or(usize::MAX);
        if count > max {
            return Err(wrong(&format!("has {count} elements, at most {max} are supported")));
        }
        let view =
            accessor.buffer_view.ok_or_else(|| wrong("has no buffer view; is the mesh compressed?"))?;
        let bytes = self.view(view).ok_or_else(|| wrong("has a buffer view over the end of its buffer"))?;
        let offset = accessor.byte_offset.map_or(Some(0), |offset| usize::try_from(offset.0).ok());
        let bytes = offset.and_then(|offset| bytes.get(offset..));
        let bytes = bytes.ok_or_else(|| wrong("reaches over the end of its buffer"))?;
        let size = component.0.size() * kind.multiplicity();
        let stride = self.root.get(view).and_then(|view| view.byte_stride).map_or(size, |stride| stride.0);
        if stride < size {
            return Err(wrong("overlaps itself"));
        }
        let needed = count.checked_sub(1).map_or(Some(0), |last| last.checked_mul(stride)?.checked_add(size));
        if needed.is_none_or(|needed| needed > bytes.len()) {
            return Err(wrong("reaches over the end of its buffer"));
        }
        Ok(Records { bytes, component: component.0, count, size, stride })
    }

    fn view(&self, index: Index<gltf::json::buffer::View>) -> Option<&[u8]> {
        let view = self.root.get(index)?;
        let offset = view.byte_offset.map_or(Some(0), |offset| usize::try_from(offset.0).ok())?;
        let end = offset.checked_add(usize::try_from(view.byte_length.0).ok()?)?;
        self.buffers.get(view.buffer.value())?.get(offset..end)
    }
}

/// `count` records of `size` bytes at distances of `stride`. All lie inside `bytes`.
struct Records<'a> {
    bytes: &'a [u8],
    component: ComponentType,
    count: usize,
    size: usize,
    stride: usize,
}

impl<'a> Records<'a> {
    fn iter(&self) -> impl Iterator<Item = &'a [u8]> + use<'a> {
        let Self { bytes, count, size, stride, .. } = *self;
        (0..count).map(move |i| &bytes[i * stride..i * stride + size])
    }
}

/// Returns the transform from a node to its parent.
fn parent_from(node: &Node) -> Mat4 {
    if let Some(matrix) = node.matrix {
        return Mat4::from_cols_array(&matrix);
    }
    let scale = node.scale.map_or(Vec3::ONE, Vec3::from);
    let rotation = node.rotation.map_or(Quat::IDENTITY, |q| Quat::from_array(q.0).normalize());
    let translation = node.translation.map_or(Vec3::ZERO, Vec3::from);
    Mat4::from_scale_rotation_translation(scale, rotation, translation)
}
