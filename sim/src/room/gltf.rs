//! Rooms in glTF 2.0 files, binary or JSON, with embedded buffers. Right-handed, y up, metres.
//!
//! The library splits the container and has the document's types. Its validation and its iterators panic
//! at some malformed documents. This module therefore checks every index itself.

use super::furniture::is_furniture;
use super::gltf_error::{AccessorError, GltfError, MeshError};
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
    Ok(read_scene(bytes)?.with_z_up())
}

fn read_scene(bytes: &[u8]) -> Result<Mesh, GltfError> {
    let (json, mut blob) = if bytes.starts_with(b"glTF") {
        let Glb { json, bin, .. } = split(bytes)?;
        (json, bin.map(|bin| bin.into_owned()))
    } else {
        (bytes.into(), None)
    };
    let root = Root::from_slice(&json)?;
    let unknown =
        root.extensions_required.iter().find(|name| !HARMLESS.iter().any(|known| name.starts_with(known)));
    if let Some(name) = unknown {
        return Err(GltfError::Extension(name.clone()));
    }
    let mut buffers = Vec::new();
    for buffer in &root.buffers {
        buffers.push(match &buffer.uri {
            Some(uri) => embedded(uri)?,
            None => blob.take().ok_or(GltfError::NoBinaryChunk)?,
        });
    }
    let scene = root.scene.unwrap_or(Index::new(0));
    let scene = root.get(scene).ok_or(GltfError::NoScene(scene.value()))?;
    let mut walk = Walk { root: &root, buffers, mesh: Mesh::default(), nodes_left: root.nodes.len() };
    scene.nodes.iter().try_for_each(|node| walk.visit(*node, Mat4::IDENTITY, 0))?;
    Ok(walk.mesh)
}

/// Splits a .glb into its chunks.
fn split(bytes: &[u8]) -> Result<Glb<'_>, GltfError> {
    // The library subtracts the header's size from this length without a check.
    let stated = bytes.get(8..12).map_or(0, |b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as usize);
    if stated < 12 || stated > bytes.len() {
        return Err(GltfError::Length { stated, found: bytes.len() });
    }
    Ok(Glb::from_slice(bytes)?)
}

/// Decodes a buffer that is a data URI.
fn embedded(uri: &str) -> Result<Vec<u8>, GltfError> {
    let data = uri.strip_prefix("data:").and_then(|rest| rest.split_once(";base64,"));
    let (_, text) = data.ok_or(GltfError::OtherFile)?;
    STANDARD.decode(text).map_err(GltfError::DataUri)
}

struct Walk<'a> {
    root: &'a Root,
    buffers: Vec<Vec<u8>>,
    mesh: Mesh,
    /// Number of nodes that may still be visited. A tree visits each node once; more visits mean a cycle.
    nodes_left: usize,
}

impl Walk<'_> {
    fn visit(&mut self, index: Index<Node>, world_from_parent: Mat4, depth: usize) -> Result<(), GltfError> {
        let number = index.value();
        let node = self.root.get(index).ok_or(GltfError::NoNode(number))?;
        self.nodes_left = self.nodes_left.checked_sub(1).ok_or(GltfError::NodeTwice(number))?;
        if depth > DEPTH_MAX {
            return Err(GltfError::TooDeep { node: number, max: DEPTH_MAX });
        }
        let first = self.mesh.triangles.len();
        let world_from_node = world_from_parent * parent_from(node);
        if let Some(index) = node.mesh {
            let no_mesh = GltfError::NoMesh { node: number, mesh: index.value() };
            let mesh = self.root.get(index).ok_or(no_mesh)?;
            for primitive in &mesh.primitives {
                let in_node = |why| GltfError::Mesh { node: number, why };
                self.append(primitive, world_from_node).map_err(in_node)?;
            }
        }
        let name = node.name.as_deref().filter(|name| is_furniture(name));
        let pieces = self.mesh.furniture.len();
        let mut children = node.children.iter().flatten().peekable();
        // Beside its children the node's own surface is one part of it.
        if let Some(name) = name.filter(|_| children.peek().is_some()) {
            self.mesh.name_triangles(name, first);
        }
        children.try_for_each(|child| self.visit(*child, world_from_node, depth + 1))?;
        if let Some(name) = name {
            let parts = self.mesh.furniture.len() - pieces;
            self.mesh.name_whole(name, first, parts);
        }
        Ok(())
    }

    fn append(&mut self, primitive: &Primitive, world_from_node: Mat4) -> Result<(), MeshError> {
        match primitive.mode {
            Checked::Valid(Mode::Triangles) => {}
            Checked::Valid(Mode::Points | Mode::Lines | Mode::LineLoop | Mode::LineStrip) => return Ok(()),
            _ => return Err(MeshError::NoTriangles),
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
            return Err(MeshError::NoVertex { index: *wrong, count });
        }
        // Nodes may share a mesh, so the sum over all nodes is limited.
        if self.mesh.vertices.len() + count > VERTICES_MAX
            || self.mesh.triangles.len() + corners.len() / 3 > TRIANGLES_MAX
        {
            return Err(MeshError::TooLarge);
        }
        let first = self.mesh.vertices.len() as u32;
        self.mesh.vertices.extend(positions.iter().map(|p| world_from_node.transform_point3(*p)));
        let (triangles, _) = corners.as_chunks::<3>();
        self.mesh.triangles.extend(triangles.iter().map(|t| t.map(|i| i + first)));
        Ok(())
    }

    fn positions(&self, index: Index<Accessor>) -> Result<Vec<Vec3>, MeshError> {
        let records = self.records(index, Type::Vec3, VERTICES_MAX)?;
        if records.component != ComponentType::F32 {
            return Err(MeshError::Quantised);
        }
        let number = |bytes: &[u8]| f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
        let point = |b: &[u8]| Vec3::new(number(&b[0..4]), number(&b[4..8]), number(&b[8..12]));
        Ok(records.iter().map(point).collect())
    }

    fn indices(&self, index: Index<Accessor>) -> Result<Vec<u32>, MeshError> {
        let records = self.records(index, Type::Scalar, 3 * TRIANGLES_MAX)?;
        let numbers = records.iter();
        Ok(match records.component {
            ComponentType::U8 => numbers.map(|b| u32::from(b[0])).collect(),
            ComponentType::U16 => numbers.map(|b| u32::from(u16::from_le_bytes([b[0], b[1]]))).collect(),
            ComponentType::U32 => numbers.map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect(),
            other => return Err(MeshError::IndexType(other)),
        })
    }

    fn records(&self, index: Index<Accessor>, kind: Type, max: usize) -> Result<Records<'_>, MeshError> {
        let wrong = |why| MeshError::Accessor { accessor: index.value(), why };
        let accessor = self.root.get(index).ok_or_else(|| wrong(AccessorError::Missing))?;
        let (Checked::Valid(component), Checked::Valid(found)) = (accessor.component_type, accessor.type_)
        else {
            return Err(wrong(AccessorError::UnknownType));
        };
        if found != kind {
            return Err(wrong(AccessorError::Type { found, expected: kind }));
        }
        if accessor.sparse.is_some() {
            return Err(wrong(AccessorError::Sparse));
        }
        let count = usize::try_from(accessor.count.0).unwrap_or(usize::MAX);
        if count > max {
            return Err(wrong(AccessorError::TooLong { count, max }));
        }
        let view = accessor.buffer_view.ok_or_else(|| wrong(AccessorError::NoView))?;
        let bytes = self.view(view).ok_or_else(|| wrong(AccessorError::ViewOverEnd))?;
        let offset = accessor.byte_offset.map_or(Some(0), |offset| usize::try_from(offset.0).ok());
        let bytes = offset.and_then(|offset| bytes.get(offset..));
        let bytes = bytes.ok_or_else(|| wrong(AccessorError::OverEnd))?;
        let size = component.0.size() * kind.multiplicity();
        let stride = self.root.get(view).and_then(|view| view.byte_stride).map_or(size, |stride| stride.0);
        if stride < size {
            return Err(wrong(AccessorError::Overlap));
        }
        let needed = count.checked_sub(1).map_or(Some(0), |last| last.checked_mul(stride)?.checked_add(size));
        if needed.is_none_or(|needed| needed > bytes.len()) {
            return Err(wrong(AccessorError::OverEnd));
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
