//! glTF 2.0, binary or JSON, with its buffers inside. Right-handed, y up, metres.

use super::mesh::Mesh;
use super::{RoomError, TRIANGLES_MAX, VERTICES_MAX};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use glam::{Mat4, Vec3};
use gltf::accessor::{DataType, Dimensions};
use gltf::buffer::Source;
use gltf::mesh::Mode;
use gltf::{Accessor, Gltf, Node, Semantic};

/// The deepest nesting of nodes.
const DEPTH_MAX: usize = 64;

/// The triangles of the default scene, or of the first, with their nodes' transforms.
pub(crate) fn read(bytes: &[u8]) -> Result<Mesh, RoomError> {
    read_scene(bytes).map(Mesh::from_y_up).map_err(|reason| RoomError::Malformed { format: "glTF", reason })
}

fn read_scene(bytes: &[u8]) -> Result<Mesh, String> {
    let Gltf { document, mut blob } = Gltf::from_slice(bytes).map_err(|error| error.to_string())?;
    let buffers = document
        .buffers()
        .map(|buffer| match buffer.source() {
            Source::Bin => blob.take().ok_or_else(|| "the binary chunk is missing".to_owned()),
            Source::Uri(uri) => embedded(uri),
        })
        .collect::<Result<Vec<_>, _>>()?;
    let scene = document.default_scene().or_else(|| document.scenes().next()).ok_or("it has no scene")?;
    let nodes_left = document.nodes().len();
    let mut walk = Walk { buffers, mesh: Mesh::default(), nodes_left };
    scene.nodes().try_for_each(|node| walk.visit(&node, Mat4::IDENTITY, 0))?;
    Ok(walk.mesh)
}

/// A buffer that is a data URI.
fn embedded(uri: &str) -> Result<Vec<u8>, String> {
    let data = uri.strip_prefix("data:").and_then(|rest| rest.split_once(";base64,"));
    let (_, text) = data.ok_or("a buffer is in another file: pack the model into one .glb")?;
    STANDARD.decode(text).map_err(|error| format!("a buffer's data URI: {error}"))
}

struct Walk {
    buffers: Vec<Vec<u8>>,
    mesh: Mesh,
    /// A tree visits each node once at most; anything else is a loop.
    nodes_left: usize,
}

impl Walk {
    fn visit(&mut self, node: &Node, world_from_parent: Mat4, depth: usize) -> Result<(), String> {
        let number = node.index();
        self.nodes_left =
            self.nodes_left.checked_sub(1).ok_or(format!("nodes[{number}] is its own ancestor"))?;
        if depth > DEPTH_MAX {
            return Err(format!("nodes[{number}] is nested deeper than {DEPTH_MAX}"));
        }
        let world_from_node = world_from_parent * Mat4::from_cols_array_2d(&node.transform().matrix());
        for primitive in node.mesh().iter().flat_map(|mesh| mesh.primitives()) {
            self.append(&primitive, world_from_node)
                .map_err(|reason| format!("nodes[{number}]: {reason}"))?;
        }
        node.children().try_for_each(|child| self.visit(&child, world_from_node, depth + 1))
    }

    fn append(&mut self, primitive: &gltf::Primitive, world_from_node: Mat4) -> Result<(), String> {
        match primitive.mode() {
            Mode::Triangles => {}
            Mode::TriangleStrip | Mode::TriangleFan => {
                return Err("export triangles, no strips or fans".into());
            }
            _ => return Ok(()), // Points and lines stop nobody.
        }
        let Some(positions) = primitive.get(&Semantic::Positions) else { return Ok(()) };
        let positions = self.positions(&positions)?;
        let count = positions.len();
        let corners = match primitive.indices() {
            Some(indices) => self.indices(&indices)?,
            None => (0..count as u32).collect(),
        };
        if let Some(wrong) = corners.iter().find(|index| **index as usize >= count) {
            return Err(format!("an index is {wrong}, but there are {count} vertices"));
        }
        // Nodes may share a mesh: the sum counts.
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

    fn positions(&self, accessor: &Accessor) -> Result<Vec<Vec3>, String> {
        if (accessor.data_type(), accessor.dimensions()) != (DataType::F32, Dimensions::Vec3) {
            return Err("positions are not three f32: export without quantisation".into());
        }
        let number = |bytes: &[u8]| f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
        let records = self.records(accessor, 12, VERTICES_MAX)?;
        Ok(records.map(|b| Vec3::new(number(&b[0..4]), number(&b[4..8]), number(&b[8..12]))).collect())
    }

    fn indices(&self, accessor: &Accessor) -> Result<Vec<u32>, String> {
        if accessor.dimensions() != Dimensions::Scalar {
            return Err("indices are not scalars".into());
        }
        let max = 3 * TRIANGLES_MAX;
        Ok(match accessor.data_type() {
            DataType::U8 => self.records(accessor, 1, max)?.map(|b| u32::from(b[0])).collect(),
            DataType::U16 => {
                self.records(accessor, 2, max)?.map(|b| u32::from(u16::from_le_bytes([b[0], b[1]]))).collect()
            }
            DataType::U32 => self
                .records(accessor, 4, max)?
                .map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]))
                .collect(),
            other => return Err(format!("indices are {other:?}")),
        })
    }

    /// The accessor's records of `size` bytes each; all of them are inside their buffer.
    fn records(
        &self,
        accessor: &Accessor,
        size: usize,
        max: usize,
    ) -> Result<impl Iterator<Item = &[u8]>, String> {
        let number = accessor.index();
        let wrong = |what: &str| format!("accessors[{number}] {what}");
        if accessor.sparse().is_some() {
            return Err(wrong("is sparse, which is not supported"));
        }
        let view = accessor.view().ok_or_else(|| wrong("has no buffer view; is the mesh compressed?"))?;
        let (count, stride) = (accessor.count(), view.stride().unwrap_or(size));
        if count > max {
            return Err(wrong(&format!("has {count} elements, at most {max} are supported")));
        }
        if stride < size {
            return Err(wrong("overlaps itself"));
        }
        let buffer = self.buffers.get(view.buffer().index()).map_or(&[][..], Vec::as_slice);
        let end = view.offset().checked_add(view.length());
        let bytes = end.and_then(|end| buffer.get(view.offset()..end));
        let bytes = bytes.and_then(|bytes| bytes.get(accessor.offset()..));
        let bytes = bytes.ok_or_else(|| wrong("reaches over the end of its buffer"))?;
        let needed = count.checked_sub(1).map_or(Some(0), |last| last.checked_mul(stride)?.checked_add(size));
        if needed.is_none_or(|needed| needed > bytes.len()) {
            return Err(wrong("reaches over the end of its buffer"));
        }
        Ok((0..count).map(move |i| &bytes[i * stride..i * stride + size]))
    }
}
