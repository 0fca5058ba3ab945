//! A room: triangles, z up, in frame `world`, the floor at z = 0.

mod cells;
mod gltf;
mod ground;
mod laboratory;
mod mesh;
mod obj;
mod plan;
mod read;
mod scene;

use crate::config::ConfigError;
use ground::{FLOOR_RELIEF_M, Ground};
use mesh::Mesh;
use parry3d::shape::{SharedShape, TriMesh};
use std::sync::Arc;

/// The most triangles of a room.
pub const TRIANGLES_MAX: usize = 2_000_000;
/// The most vertices of a room.
pub const VERTICES_MAX: usize = 3 * TRIANGLES_MAX;
/// The farthest that a room reaches in any direction, metres: a floor plan at 0.05 m still fits a grid.
pub const EXTENT_MAX_M: f32 = 200.0;
/// The largest file of a room, after decompression, bytes.
pub const BYTES_MAX: usize = 256 << 20;

/// Walls, furniture and floor. Cheap to clone.
#[derive(Clone)]
pub struct Room {
    name: String,
    /// Without the floor.
    mesh: Arc<TriMesh>,
    ground: Arc<Ground>,
}

/// Why a room cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum RoomError {
    /// Nothing known: neither content nor name says what it is.
    #[error("{name}: is neither a scene (.json, .json.gz), nor glTF (.glb, .gltf), nor OBJ (.obj)")]
    UnknownFormat {
        /// As given.
        name: String,
    },
    /// The format's own reader says why.
    #[error("not a readable {format} room: {reason}")]
    Malformed {
        /// Which format.
        format: &'static str,
        /// What is wrong, and where.
        reason: String,
    },
    /// More bytes than `BYTES_MAX`.
    #[error("the room has over {max} bytes")]
    TooManyBytes {
        /// `BYTES_MAX`.
        max: usize,
    },
    /// More vertices or triangles than a room may have.
    #[error("the room has {count} {what}, at most {max} are supported: simplify the mesh")]
    TooMany {
        /// Of what.
        what: &'static str,
        /// How many.
        count: usize,
        /// How many are supported.
        max: usize,
    },
    /// No triangles.
    #[error("the room has no triangles")]
    Empty,
    /// A vertex is NaN or infinite.
    #[error("vertex {vertex} is not finite")]
    NotFinite {
        /// Counted from 0.
        vertex: usize,
    },
    /// A triangle of a vertex that is not there.
    #[error("triangle {triangle} uses vertex {index}, but there are {vertices}")]
    BadIndex {
        /// Counted from 0.
        triangle: usize,
        /// What it uses.
        index: u32,
        /// How many there are.
        vertices: usize,
    },
    /// Larger than `EXTENT_MAX_M`, or that far from its origin.
    #[error("the room reaches over {extent_m} m, at most 200 m are supported: is it in metres?")]
    TooLarge {
        /// How far, metres.
        extent_m: f32,
    },
    /// No level surface to drive on.
    #[error(
        "the room has no floor: its largest low level surface has {area_m2:.2} m²; is its up axis right?"
    )]
    NoFloor {
        /// Square metres.
        area_m2: f64,
    },
    /// A floor alone, or a floor that is full.
    #[error("the room has a floor, but {reason}")]
    NoPlace {
        /// What is missing.
        reason: &'static str,
    },
}

/// Why a robot cannot start.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum StartError {
    /// The configuration makes no sense.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// NaN or infinite.
    #[error("the start pose is not finite")]
    NotFinite,
    /// No floor there.
    #[error("the start ({x_m:.2}, {y_m:.2}) m is off the floor")]
    OffFloor {
        /// Metres.
        x_m: f64,
        /// Metres.
        y_m: f64,
    },
    /// The robot's body would touch a wall or furniture.
    #[error("the start ({x_m:.2}, {y_m:.2}) m is in furniture or a wall: the robot would touch it")]
    InObstacle {
        /// Metres.
        x_m: f64,
        /// Metres.
        y_m: f64,
    },
    /// Inside a closed piece of furniture.
    #[error("the start ({x_m:.2}, {y_m:.2}) m is inside furniture: only {area_m2:.2} m² of floor around it")]
    Enclosed {
        /// Metres.
        x_m: f64,
        /// Metres.
        y_m: f64,
        /// Square metres.
        area_m2: f64,
    },
    /// More robots than find a place.
    #[error("the room has no place for {count} robots, only for {found}")]
    Full {
        /// How many were wished.
        count: usize,
        /// How many there is place for.
        found: usize,
    },
}

impl Room {
    /// A room's name, for people.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// `stated_floor_m`: height of the floor if a file says so.
    fn from_mesh(name: &str, mut mesh: Mesh, stated_floor_m: Option<f32>) -> Result<Self, RoomError> {
        mesh.check()?;
        let (floor_m, _) = mesh.find_floor(stated_floor_m)?;
        mesh.vertices.iter_mut().for_each(|v| v.z -= floor_m);
        let ground = Ground::of(&mesh);
        if !ground.drivable.contains(&true) {
            return Err(RoomError::NoPlace { reason: "a robot fits nowhere on it" });
        }
        let standing = plan::obstacles_of(&mesh, FLOOR_RELIEF_M);
        let obstacles = TriMesh::new(standing.vertices, standing.triangles)
            .map_err(|_| RoomError::NoPlace { reason: "nothing stands on it that a LiDAR could see" })?;
        Ok(Self { name: name.to_owned(), mesh: Arc::new(obstacles), ground: Arc::new(ground) })
    }

    /// The room without its floor.
    pub(crate) fn obstacles(&self) -> SharedShape {
        SharedShape(self.mesh.clone())
    }

    fn mesh(&self) -> &TriMesh {
        &self.mesh
    }
}
