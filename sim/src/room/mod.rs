//! Rooms as triangle meshes in frame `world`, z up, with the floor at z = 0.

mod builder;
mod furniture;
mod generated;
mod gltf;
mod gltf_error;
mod ground;
mod laboratory;
mod map;
mod mesh;
mod mruk;
mod obj;
mod plan;
mod polygon;
mod raster;
mod read;
mod scene;

use crate::config::ConfigError;
pub use furniture::Furniture;
pub use generated::RoomKind;
use glam::Vec3;
pub use gltf_error::{AccessorError, GltfError, MeshError};
pub(crate) use ground::Ground;
use ground::{FLOOR_RELIEF_M, slab};
pub use map::MapError;
use mesh::Mesh;
pub use mruk::{AnchorError, MrukError};
pub use obj::ObjError;
use parry3d::shape::{SharedShape, TriMesh};
use plan::ROOM_MIN_M2;
pub use polygon::PolygonError;
pub use scene::{EntityError, SceneError};
use std::sync::Arc;

/// Largest number of triangles of a room.
pub const TRIANGLES_MAX: usize = 2_000_000;
/// Largest number of vertices of a room.
pub const VERTICES_MAX: usize = 3 * TRIANGLES_MAX;
/// Largest extent of a room in any direction, metres. A floor plan at 0.05 m still fits into a grid.
pub const EXTENT_MAX_M: f32 = 200.0;
/// Largest size of a room's file after decompression, bytes.
pub const BYTES_MAX: usize = 256 << 20;
/// Largest number of objects in a room's JSON document. Each takes up to 100 times its text in memory.
pub const JSON_OBJECTS_MAX: usize = 500_000;

/// Walls, furniture and floor of a place that robots drive in. It is cheap to clone.
#[derive(Clone)]
pub struct Room {
    name: String,
    /// Triangles of walls and furniture, without the floor.
    mesh: Arc<TriMesh>,
    ground: Arc<Ground>,
    furniture: Arc<[Furniture]>,
    /// Length of the border between floor and unknown cells of a map, metres.
    open_edge_m: f64,
}

/// Reason why a file is not a usable room.
#[derive(Debug, thiserror::Error)]
pub enum RoomError {
    /// Neither the content nor the name tells a known format.
    #[error(
        "{name}: is neither a scene (.json, .json.gz), nor glTF (.glb, .gltf), nor OBJ (.obj); a map is named by its .yaml"
    )]
    UnknownFormat {
        /// Name of the file as given.
        name: String,
    },
    /// The content begins as JSON, and is none.
    #[error("not readable as JSON, neither as glTF nor as a scene: {0}; expected the whole file")]
    Json(#[source] serde_json::Error),
    /// The content is no usable glTF.
    #[error("not a readable glTF room: {0}")]
    Gltf(#[from] GltfError),
    /// The content is no usable scene.
    #[error("not a readable scene JSON room: {0}")]
    Scene(#[from] SceneError),
    /// The content is no usable scene of MRUK.
    #[error("not a readable MRUK room: {0}")]
    Mruk(#[from] MrukError),
    /// The content is no usable OBJ.
    #[error("not a readable OBJ room: {0}")]
    Obj(#[from] ObjError),
    /// The occupancy grid is no usable room.
    #[error(transparent)]
    Map(#[from] MapError),
    /// The compressed content is damaged.
    #[error("not a readable gzip room: {0}")]
    Gzip(#[source] std::io::Error),
    /// The file has more bytes than `BYTES_MAX`.
    #[error("the room has over {max} bytes")]
    TooManyBytes {
        /// Largest supported size, `BYTES_MAX`.
        max: usize,
    },
    /// The file has more vertices, triangles or JSON objects than are supported.
    #[error("the room has {count} {what}, at most {max} are supported: simplify the mesh")]
    TooMany {
        /// Name of the elements that are too many.
        what: &'static str,
        /// Number of elements found.
        count: usize,
        /// Largest supported number of elements.
        max: usize,
    },
    /// The mesh has no triangles.
    #[error("the room has no triangles")]
    Empty,
    /// A vertex is NaN or infinite.
    #[error("vertex {vertex} is not finite")]
    NotFinite {
        /// Number of the vertex, from 0.
        vertex: usize,
    },
    /// A triangle uses a vertex that does not exist.
    #[error("triangle {triangle} uses vertex {index}, but there are {vertices}")]
    BadIndex {
        /// Number of the triangle, from 0.
        triangle: usize,
        /// Number of the vertex that it uses.
        index: u32,
        /// Number of vertices in the mesh.
        vertices: usize,
    },
    /// The room is larger than `EXTENT_MAX_M`, or lies that far from its origin.
    #[error("the room reaches over {extent_m} m, at most 200 m are supported: is it in metres?")]
    TooLarge {
        /// Extent of the room, metres.
        extent_m: f32,
    },
    /// The room has no level surface to drive on.
    #[error(
        "the room has no floor: its largest low level surface has {area_m2:.2} m²; is its up axis right?"
    )]
    NoFloor {
        /// Area of the largest level surface, square metres.
        area_m2: f64,
    },
    /// The floor has no obstacles, or no space for a robot.
    #[error("the room has a floor, but {reason}")]
    NoPlace {
        /// Description of what is missing.
        reason: &'static str,
    },
}

/// Reason why a robot cannot start.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum StartError {
    /// The configuration is invalid.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The start pose is NaN or infinite.
    #[error("the start pose is not finite")]
    NotFinite,
    /// The start lies outside of the floor.
    #[error("the start ({x_m:.2}, {y_m:.2}) m is off the floor")]
    OffFloor {
        /// Start along x, metres.
        x_m: f64,
        /// Start along y, metres.
        y_m: f64,
    },
    /// The robot's body would touch a wall or furniture.
    #[error("the start ({x_m:.2}, {y_m:.2}) m is in furniture or a wall: the robot would touch it")]
    InObstacle {
        /// Start along x, metres.
        x_m: f64,
        /// Start along y, metres.
        y_m: f64,
    },
    /// The start lies inside of a closed piece of furniture.
    #[error("the start ({x_m:.2}, {y_m:.2}) m is inside furniture: only {area_m2:.2} m² of floor around it")]
    Enclosed {
        /// Start along x, metres.
        x_m: f64,
        /// Start along y, metres.
        y_m: f64,
        /// Area of the enclosed floor, square metres.
        area_m2: f64,
    },
    /// No place of the room has enough space around it.
    #[error(
        "the room has no space for a robot; expected a floor of at least {ROOM_MIN_M2} m² without gaps, whose ways are at least 0.3 m wide"
    )]
    NoSpace,
    /// The room has space for fewer robots.
    #[error("the room has no place for {count} robots, only for {found}")]
    Full {
        /// Number of robots requested.
        count: usize,
        /// Number of robots that fit.
        found: usize,
    },
}

impl Room {
    /// Returns the room's name, for people.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Returns the furniture that the room's file names and a robot could touch, largest first.
    pub fn furniture(&self) -> &[Furniture] {
        &self.furniture
    }

    /// Returns the length of the floor's edge beyond which a map knows nothing, metres; 0 for a room that is no map. Robots see over it.
    pub fn open_edge_m(&self) -> f64 {
        self.open_edge_m
    }

    /// Checks a mesh and finds its floor. `stated_floor_m` is the floor's height if the file states it.
    fn from_mesh(name: &str, mut mesh: Mesh, stated_floor_m: Option<f32>) -> Result<Self, RoomError> {
        mesh.check()?;
        let (floor_m, _) = mesh.find_floor(stated_floor_m)?;
        mesh.move_points(|v| Vec3::new(v.x, v.y, v.z - floor_m));
        let ground = Ground::new(&mesh);
        if !ground.drivable.contains(&true) {
            return Err(RoomError::NoPlace { reason: "a robot fits nowhere on it" });
        }
        let furniture = furniture::outlines(&mesh).into();
        let standing = plan::obstacles_of(&mesh, FLOOR_RELIEF_M);
        let obstacles = TriMesh::new(standing.vertices, standing.triangles)
            .map_err(|_| RoomError::NoPlace { reason: "nothing stands on it that a LiDAR could see" })?;
        Ok(Self {
            name: name.to_owned(),
            mesh: Arc::new(obstacles),
            ground: Arc::new(ground),
            furniture,
            open_edge_m: 0.0,
        })
    }

    /// Returns the walls and furniture, without the floor.
    pub(crate) fn obstacles(&self) -> SharedShape {
        SharedShape(self.mesh.clone())
    }

    /// Returns the floor in cells.
    pub(crate) fn ground(&self) -> &Ground {
        &self.ground
    }

    /// Computes the distance from the centre of each of the ground's cells to the nearest thing that stands lower than `height_m`, metres.
    pub(crate) fn clearance_below_m(&self, height_m: f32) -> Vec<f32> {
        let raster = &self.ground.raster;
        let mut obstacles = vec![false; raster.len()];
        for triangle in self.mesh.triangles() {
            let corners = [triangle.a, triangle.b, triangle.c];
            raster.mark_polygon(&mut obstacles, &slab(&corners, FLOOR_RELIEF_M, height_m));
        }
        raster.distances_m(&obstacles)
    }

    fn mesh(&self) -> &TriMesh {
        &self.mesh
    }
}
