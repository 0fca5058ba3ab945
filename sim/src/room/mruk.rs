//! Rooms in the scene JSON of Meta's Mixed Reality Utility Kit (MRUK): planes, boxes and meshes with labels.
//!
//! Each anchor has a pose: a translation in metres, and Euler angles in degrees, applied about z, then x, then y, as in
//! Unity. A plane lies in its anchor's x and y, with the normal along z. `CoordinateSystem` tells the frame: `Unity` is
//! left-handed with y up; `OpenXR`, or nothing, is right-handed with y up. The geometry cannot tell: a room's mirror
//! image is a room too.

use super::furniture::is_furniture;
use super::mesh::Mesh;
use super::polygon::{self, PolygonError};
use super::{RoomError, TRIANGLES_MAX, VERTICES_MAX};
use glam::{EulerRot, Mat3, Vec2, Vec3};
use serde::Deserialize;

/// Largest tilt of a floor's normal, or of a wall's from the horizontal, as the sine of the angle: 26°.
const TILT_MAX: f32 = 0.44;
/// Labels of planes that a LiDAR sees. Frames of doors and windows lie in walls, and invisible walls are openings.
const SOLID: [&str; 3] = ["WALL_FACE", "INNER_WALL_FACE", "CEILING"];
const FLOOR: &str = "FLOOR";
/// Anchors up to this number are read: a scanned flat has some hundreds.
const ANCHORS_MAX: usize = 10_000;

#[derive(Deserialize)]
struct Scene {
    #[serde(rename = "CoordinateSystem", default)]
    system: Option<String>,
    #[serde(rename = "Rooms")]
    rooms: Vec<MrukRoom>,
}

#[derive(Deserialize)]
struct MrukRoom {
    #[serde(rename = "Anchors", default)]
    anchors: Vec<Anchor>,
}

#[derive(Deserialize)]
#[serde(rename_all = "PascalCase")]
struct Anchor {
    #[serde(default)]
    semantic_classifications: Vec<String>,
    transform: Transform,
    plane_bounds: Option<Bounds<[f32; 2]>>,
    #[serde(rename = "PlaneBoundary2D")]
    boundary: Option<Vec<[f32; 2]>>,
    volume_bounds: Option<Bounds<[f32; 3]>>,
    global_mesh: Option<GlobalMesh>,
}

#[derive(Deserialize)]
#[serde(rename_all = "PascalCase")]
struct Transform {
    translation: [f32; 3],
    /// Euler angles, degrees.
    rotation: [f32; 3],
    scale: Option<[f32; 3]>,
}

#[derive(Deserialize)]
#[serde(rename_all = "PascalCase")]
struct Bounds<T> {
    min: T,
    max: T,
}

#[derive(Deserialize)]
#[serde(rename_all = "PascalCase")]
struct GlobalMesh {
    positions: Vec<[f32; 3]>,
    indices: Vec<u32>,
}

/// Reason why an MRUK scene is not a usable room.
#[derive(Debug, thiserror::Error)]
pub enum MrukError {
    /// The text is no JSON of an MRUK scene.
    #[error(transparent)]
    Json(#[from] serde_json::Error),
    /// The frame is none that is supported.
    #[error("CoordinateSystem is `{found}`; expected Unity or OpenXR: export the scene from Unity")]
    CoordinateSystem {
        /// The frame's name in the file.
        found: String,
    },
    /// Nothing in the scene has a surface.
    #[error("no anchor is a wall, a volume or a mesh: run Space Setup on the headset and export again")]
    NoSurface,
    /// There are too many anchors.
    #[error("{count} anchors, at most {ANCHORS_MAX} are supported")]
    TooManyAnchors {
        /// Number of anchors.
        count: usize,
    },
    /// An anchor cannot be used.
    #[error("Rooms[{room}].Anchors[{anchor}]: {why}")]
    Anchor {
        /// Number of the room, from 0.
        room: usize,
        /// Number of the anchor, from 0.
        anchor: usize,
        /// What is wrong with it.
        why: AnchorError,
    },
}

/// Reason why an anchor of an MRUK scene cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum AnchorError {
    /// A number is no finite one.
    #[error("{what} has a number that is not finite")]
    NotFinite {
        /// Name of the field.
        what: &'static str,
    },
    /// The anchor is scaled, which MRUK never does.
    #[error("Transform.Scale is {0:?}; only [1, 1, 1] is supported")]
    Scale([f32; 3]),
    /// The floor's normal is not up, or a wall's not level.
    #[error("the normal of this {label} points to {normal:?} (x, y up, z): its Rotation is not that of MRUK")]
    Tilted {
        /// The anchor's label.
        label: String,
        /// The plane's normal in the file's frame.
        normal: [f32; 3],
    },
    /// A plane's outline encloses no area in one piece.
    #[error("PlaneBoundary2D: {0}")]
    Boundary(#[from] PolygonError),
    /// A plane has neither an outline nor bounds.
    #[error("this {label} has neither PlaneBoundary2D nor PlaneBounds")]
    NoPlane {
        /// The anchor's label.
        label: String,
    },
    /// The indices are no whole triangles.
    #[error("GlobalMesh.Indices: {0} is no multiple of 3")]
    PartOfTriangle(usize),
    /// A triangle uses a vertex that does not exist.
    #[error("GlobalMesh: index {index} is used, but there are {count} positions")]
    NoVertex {
        /// Number of the vertex.
        index: u32,
        /// Number of vertices.
        count: usize,
    },
    /// A list is too long.
    #[error("{what}: {count}, at most {max} are supported")]
    TooMany {
        /// Name of the list.
        what: &'static str,
        /// Number of elements.
        count: usize,
        /// Largest supported number.
        max: usize,
    },
}

/// Reads the surfaces of all rooms, and the floor's height if an anchor `FLOOR` states it.
///
/// A scene with scanned meshes is these; otherwise it is its walls, and boxes in place of the furniture.
pub(crate) fn read(bytes: &[u8]) -> Result<(Mesh, Option<f32>), RoomError> {
    Ok(read_scene(bytes)?)
}

fn read_scene(bytes: &[u8]) -> Result<(Mesh, Option<f32>), MrukError> {
    let scene: Scene = serde_json::from_slice(bytes)?;
    let is_left_handed = match scene.system.as_deref() {
        Some("Unity") => true,
        Some("OpenXR") | None => false,
        Some(found) => return Err(MrukError::CoordinateSystem { found: found.chars().take(40).collect() }),
    };
    let count = scene.rooms.iter().map(|room| room.anchors.len()).sum();
    if count > ANCHORS_MAX {
        return Err(MrukError::TooManyAnchors { count });
    }
    let anchors = || scene.rooms.iter().flat_map(|room| &room.anchors);
    let has_mesh = anchors().any(|anchor| !anchor.triangle_indices().is_empty());
    let (mut mesh, mut floor_m, mut has_surface) = (Mesh::default(), None, false);
    for (room, MrukRoom { anchors }) in scene.rooms.iter().enumerate() {
        for (number, anchor) in anchors.iter().enumerate() {
            let of_floor = mesh.triangles.len();
            let is_floor = anchor.append(&mut mesh, has_mesh).map_err(|why| MrukError::Anchor {
                room,
                anchor: number,
                why,
            })?;
            if is_floor {
                floor_m = floor_m.or(Some(anchor.transform.translation[1]));
            } else {
                has_surface |= mesh.triangles.len() > of_floor;
            }
        }
    }
    if !has_surface {
        return Err(MrukError::NoSurface);
    }
    if is_left_handed {
        mesh.move_points(|point| Vec3::new(point.x, point.y, -point.z));
    }
    Ok((mesh.with_z_up(), floor_m))
}

impl Anchor {
    fn triangle_indices(&self) -> &[u32] {
        self.global_mesh.as_ref().map_or(&[], |mesh| &mesh.indices)
    }

    fn has_label(&self, label: &str) -> bool {
        self.semantic_classifications.iter().any(|known| known == label)
    }

    /// Adds the anchor's surface to a mesh, and returns whether the anchor is a floor.
    fn append(&self, mesh: &mut Mesh, has_mesh: bool) -> Result<bool, AnchorError> {
        let Transform { translation, rotation, scale } = &self.transform;
        let numbers = translation.iter().chain(rotation);
        check_finite("Transform", numbers)?;
        if let Some(scale) = scale
            && scale.iter().any(|value| (value - 1.0).abs() > 1e-3)
        {
            return Err(AnchorError::Scale(*scale));
        }
        let [x, y, z] = rotation.map(f32::to_radians);
        let turn = Mat3::from_euler(EulerRot::YXZ, y, x, z);
        let origin = Vec3::from(*translation);
        let place = |point: Vec3| turn * point + origin;
        let is_floor = self.has_label(FLOOR);
        let solid = SOLID.into_iter().find(|label| self.has_label(label));
        if has_mesh {
            self.append_mesh(mesh, place)?;
        }
        if let Some(volume) = &self.volume_bounds {
            check_finite("VolumeBounds", volume.min.iter().chain(&volume.max))?;
            self.append_volume(mesh, volume, has_mesh, place);
        }
        // A floor closes the holes of a scanned mesh.
        if let Some(label) = is_floor.then_some(FLOOR).or(solid.filter(|_| !has_mesh)) {
            self.check_normal(turn.z_axis, label)?;
            self.append_plane(mesh, label, place)?;
        }
        Ok(is_floor)
    }

    /// Adds a box, which names furniture. Where there is a scanned mesh, the box is no surface.
    fn append_volume(
        &self,
        mesh: &mut Mesh,
        volume: &Bounds<[f32; 3]>,
        has_mesh: bool,
        place: impl Fn(Vec3) -> Vec3,
    ) {
        let mut faces = Mesh::default();
        append_box(&mut faces, volume, &place);
        if let Some(label) = self.semantic_classifications.iter().find(|label| is_furniture(label)) {
            let corners = faces.triangles.iter().flat_map(|triangle| faces.corners(*triangle)).collect();
            mesh.add_piece(label, corners);
        }
        if !has_mesh {
            append_box(mesh, volume, place);
        }
    }

    /// Checks that a floor faces up and that a wall stands.
    fn check_normal(&self, normal: Vec3, label: &str) -> Result<(), AnchorError> {
        let is_right = match label {
            FLOOR => normal.y > 1.0 - TILT_MAX,
            "CEILING" => normal.y < TILT_MAX - 1.0,
            _ => normal.y.abs() < TILT_MAX,
        };
        let tilted = || AnchorError::Tilted { label: label.to_owned(), normal: normal.to_array() };
        if is_right { Ok(()) } else { Err(tilted()) }
    }

    fn append_plane(
        &self,
        mesh: &mut Mesh,
        label: &str,
        place: impl Fn(Vec3) -> Vec3,
    ) -> Result<(), AnchorError> {
        let outline: Vec<Vec2> = match (&self.boundary, &self.plane_bounds) {
            (Some(corners), _) if !corners.is_empty() => {
                check_finite("PlaneBoundary2D", corners.iter().flatten())?;
                corners.iter().map(|corner| Vec2::from(*corner)).collect()
            }
            (_, Some(Bounds { min: [x0, y0], max: [x1, y1] })) => {
                check_finite("PlaneBounds", [x0, y0, x1, y1].into_iter())?;
                [[x0, y0], [x1, y0], [x1, y1], [x0, y1]].map(|[x, y]| Vec2::new(*x, *y)).to_vec()
            }
            _ => return Err(AnchorError::NoPlane { label: label.to_owned() }),
        };
        let first = mesh.vertices.len() as u32;
        let triangles = polygon::triangulate(&outline)?;
        mesh.vertices.extend(outline.iter().map(|corner| place(corner.extend(0.0))));
        mesh.triangles.extend(triangles.into_iter().map(|t| t.map(|i| i + first)));
        Ok(())
    }

    fn append_mesh(&self, mesh: &mut Mesh, place: impl Fn(Vec3) -> Vec3) -> Result<(), AnchorError> {
        let Some(GlobalMesh { positions, indices }) = &self.global_mesh else { return Ok(()) };
        let lists = [
            ("GlobalMesh.Positions", positions.len(), VERTICES_MAX),
            ("GlobalMesh.Indices", indices.len() / 3, TRIANGLES_MAX),
        ];
        for (what, count, max) in lists {
            if count > max {
                return Err(AnchorError::TooMany { what, count, max });
            }
        }
        let (triangles, rest) = indices.as_chunks::<3>();
        if !rest.is_empty() {
            return Err(AnchorError::PartOfTriangle(indices.len()));
        }
        let count = positions.len();
        if let Some(index) = indices.iter().copied().find(|index| *index as usize >= count) {
            return Err(AnchorError::NoVertex { index, count });
        }
        let first = mesh.vertices.len() as u32;
        mesh.vertices.extend(positions.iter().map(|position| place(Vec3::from(*position))));
        mesh.triangles.extend(triangles.iter().map(|t| t.map(|i| i + first)));
        Ok(())
    }
}

/// Adds the faces of a box.
fn append_box(mesh: &mut Mesh, Bounds { min, max }: &Bounds<[f32; 3]>, place: impl Fn(Vec3) -> Vec3) {
    let first = mesh.vertices.len() as u32;
    let choose = |corner: u32, axis: usize| if corner >> axis & 1 == 0 { min[axis] } else { max[axis] };
    mesh.vertices.extend(
        (0..8).map(|corner| place(Vec3::new(choose(corner, 0), choose(corner, 1), choose(corner, 2)))),
    );
    // The corners' numbers have a bit for each axis.
    let faces = [[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]];
    let halves = faces.into_iter().flat_map(|[a, b, c, d]| [[a, b, c], [a, c, d]]);
    mesh.triangles.extend(halves.map(|t: [u32; 3]| t.map(|i| i + first)));
}

fn check_finite<'a>(
    what: &'static str,
    mut numbers: impl Iterator<Item = &'a f32>,
) -> Result<(), AnchorError> {
    let is_finite = numbers.all(|number| number.is_finite());
    if is_finite { Ok(()) } else { Err(AnchorError::NotFinite { what }) }
}
