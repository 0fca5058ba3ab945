//! Reasons why a glTF file is not a usable room.

use super::{TRIANGLES_MAX, VERTICES_MAX};
use gltf::json::accessor::{ComponentType, Type};

/// Reason why a glTF file is not a usable room.
#[derive(Debug, thiserror::Error)]
pub enum GltfError {
    /// The container of a .glb is damaged.
    #[error(transparent)]
    Container(#[from] gltf::Error),
    /// The length in the header of a .glb is wrong.
    #[error("its header says {stated} bytes, but there are {found}")]
    Length {
        /// Bytes that the header says.
        stated: usize,
        /// Bytes of the file.
        found: usize,
    },
    /// The document is no JSON of a glTF.
    #[error(transparent)]
    Document(#[from] gltf::json::Error),
    /// The file needs an extension that changes its geometry.
    #[error("it requires {0}, which is not supported: export without it")]
    Extension(String),
    /// A buffer should be in the container, which has none.
    #[error("the binary chunk is missing")]
    NoBinaryChunk,
    /// A buffer is not in the file.
    #[error("a buffer is in another file: pack the model into one .glb")]
    OtherFile,
    /// A buffer in the document is no base64.
    #[error("a buffer's data URI: {0}")]
    DataUri(base64::DecodeError),
    /// The scene does not exist.
    #[error("scenes[{0}] is not there")]
    NoScene(usize),
    /// A node does not exist.
    #[error("nodes[{0}] is not there")]
    NoNode(usize),
    /// The nodes are no tree.
    #[error("nodes[{0}] is its own ancestor, or has two parents")]
    NodeTwice(usize),
    /// The tree of nodes is too deep.
    #[error("nodes[{node}] is nested deeper than {max}")]
    TooDeep {
        /// Number of the node.
        node: usize,
        /// Largest depth of nested nodes.
        max: usize,
    },
    /// The mesh of a node does not exist.
    #[error("nodes[{node}] has no meshes[{mesh}]")]
    NoMesh {
        /// Number of the node.
        node: usize,
        /// Number of the mesh.
        mesh: usize,
    },
    /// The mesh of a node cannot be used.
    #[error("nodes[{node}] has a bad mesh: {why}")]
    Mesh {
        /// Number of the node.
        node: usize,
        /// What is wrong with the mesh.
        why: MeshError,
    },
}

/// Reason why a mesh of a glTF file cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum MeshError {
    /// The mesh is no list of triangles.
    #[error("export triangles, no strips or fans")]
    NoTriangles,
    /// A triangle uses a vertex that does not exist.
    #[error("an index is {index}, but there are {count} vertices")]
    NoVertex {
        /// Number of the vertex.
        index: u32,
        /// Number of vertices.
        count: usize,
    },
    /// All meshes together are too large.
    #[error("over {VERTICES_MAX} vertices or {TRIANGLES_MAX} triangles")]
    TooLarge,
    /// Positions are integers.
    #[error("positions are not f32: export without quantisation")]
    Quantised,
    /// Indices are not unsigned integers.
    #[error("indices are {}; expected u8, u16 or u32", number_name(*.0))]
    IndexType(ComponentType),
    /// The numbers of the mesh cannot be read.
    #[error("accessors[{accessor}] {why}")]
    Accessor {
        /// Number of the accessor.
        accessor: usize,
        /// What is wrong with it.
        why: AccessorError,
    },
}

/// Reason why an accessor, a list of numbers in a glTF file, cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum AccessorError {
    /// It does not exist.
    #[error("is not there")]
    Missing,
    /// Its type is none of glTF 2.0.
    #[error("has an unknown type")]
    UnknownType,
    /// Its type does not fit its use.
    #[error("is {}, not {}", type_name(*found), type_name(*expected))]
    Type {
        /// Type that was found.
        found: Type,
        /// Type that fits.
        expected: Type,
    },
    /// It replaces elements of another list.
    #[error("is sparse, which is not supported")]
    Sparse,
    /// It is too long.
    #[error("has {count} elements, at most {max} are supported")]
    TooLong {
        /// Number of elements.
        count: usize,
        /// Largest supported number.
        max: usize,
    },
    /// It has no bytes.
    #[error("has no buffer view; is the mesh compressed?")]
    NoView,
    /// Its part of the buffer is longer than the buffer.
    #[error("has a buffer view over the end of its buffer")]
    ViewOverEnd,
    /// It is longer than its part of the buffer.
    #[error("reaches over the end of its buffer")]
    OverEnd,
    /// Its elements share bytes.
    #[error("overlaps itself")]
    Overlap,
}

/// Returns the name of a number's type.
fn number_name(number: ComponentType) -> &'static str {
    match number {
        ComponentType::I8 => "i8",
        ComponentType::U8 => "u8",
        ComponentType::I16 => "i16",
        ComponentType::U16 => "u16",
        ComponentType::U32 => "u32",
        ComponentType::F32 => "f32",
    }
}

/// Returns the name of an element's type, as glTF 2.0 has it.
fn type_name(element: Type) -> &'static str {
    match element {
        Type::Scalar => "SCALAR",
        Type::Vec2 => "VEC2",
        Type::Vec3 => "VEC3",
        Type::Vec4 => "VEC4",
        Type::Mat2 => "MAT2",
        Type::Mat3 => "MAT3",
        Type::Mat4 => "MAT4",
    }
}
