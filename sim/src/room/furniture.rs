//! Furniture that a room's file names, such as tables and beds, and its outlines on the floor.
//!
//! A LiDAR sees legs, not the space between them. The outline is that of all surfaces between the floor and the top of a
//! robot: what a robot drives below, such as a lamp or a shelf on a wall, has none.

use super::EXTENT_MAX_M;
use super::ground::{FLOOR_RELIEF_M, HEAD_MARGIN_M, slab};
use super::mesh::Mesh;
use crate::burger;
use core::f64::consts::TAU;
use glam::Vec3;

/// Words that name furniture in labels of MRUK, of scene JSON and of glTF's nodes; plurals too.
const WORDS: [&str; 21] = [
    "armchair", "bed", "bench", "benches", "bookcase", "cabinet", "chair", "couch", "cupboard", "desk",
    "dresser", "lamp", "plant", "screen", "shelf", "shelves", "sofa", "stool", "storage", "table",
    "wardrobe",
];
/// Most pieces of furniture of a file; further ones are left out.
const PIECES_MAX: usize = 1000;
/// Most corners of all pieces: pieces of pieces have theirs again, 72 MB in all.
const CORNERS_MAX: usize = 6_000_000;
/// Most characters of a label that are kept.
const LABEL_CHARS_MAX: usize = 64;
/// Smallest area of an outline, square metres: smaller ones are noise of a scan.
const AREA_MIN_M2: f64 = 0.01;
/// Shortest side of an outline, metres: that of a millimetre's fraction is rounding.
const SIDE_MIN_M: f64 = 1e-4;
/// Area of a piece for each area of its parts, of which it is one: beyond it there is floor between them.
const WHOLE_TO_PARTS_MAX: f64 = 2.0;
/// Corners of the polygon around an outline that has more of them.
const DIRECTIONS: usize = 16;

/// A piece of furniture as a file has it: its label, and the corners of its triangles, three each.
#[derive(Clone, Debug)]
pub(crate) struct Piece {
    pub(crate) label: String,
    pub(crate) corners: Vec<Vec3>,
    /// Number of pieces before it in the list that are parts of it.
    pub(crate) parts: usize,
}

impl Mesh {
    /// Keeps the triangles from number `first` on as a piece of furniture, if there are any.
    pub(crate) fn name_triangles(&mut self, label: &str, first: usize) {
        self.name_whole(label, first, 0);
    }

    /// Keeps the triangles from number `first` on as a piece of furniture, whose `parts` are the newest pieces of the list.
    pub(crate) fn name_whole(&mut self, label: &str, first: usize, parts: usize) {
        let triangles = self.triangles.get(first..).unwrap_or_default();
        let corners: Vec<Vec3> = triangles.iter().flat_map(|triangle| self.corners(*triangle)).collect();
        self.push_piece(label, corners, parts);
    }

    /// Keeps triangles, given by three corners each, as a piece of furniture that is not part of the mesh.
    pub(crate) fn add_piece(&mut self, label: &str, corners: Vec<Vec3>) {
        self.push_piece(label, corners, 0);
    }

    fn push_piece(&mut self, label: &str, corners: Vec<Vec3>, parts: usize) {
        let kept: usize = self.furniture.iter().map(|piece| piece.corners.len()).sum();
        let is_room = self.furniture.len() < PIECES_MAX && kept + corners.len() <= CORNERS_MAX;
        if is_room && !corners.is_empty() {
            // Labels are printed in terminals.
            let label = label.chars().filter(|letter| !letter.is_control()).take(LABEL_CHARS_MAX).collect();
            self.furniture.push(Piece { label, corners, parts });
        }
    }
}

/// Furniture that a room's file names.
#[derive(Clone, Debug, PartialEq)]
pub struct Furniture {
    /// Its label in the file, at most 64 characters.
    pub label: String,
    /// Its convex outline at the heights of a robot's body, 3 to 16 corners counterclockwise in frame `world`, metres.
    pub outline_m: Vec<[f64; 2]>,
}

impl Furniture {
    /// Area of the outline, square metres.
    pub fn area_m2(&self) -> f64 {
        area_m2(&self.outline_m)
    }

    /// Whether a point in frame `world` lies in the outline, or nearer to it than `margin_m`.
    pub fn is_near(&self, point_m: [f64; 2], margin_m: f64) -> bool {
        sides(&self.outline_m).all(|(a, b)| cross(a, b, point_m) >= -margin_m * length_m(a, b))
    }
}

/// Whether a label names furniture. `LivingRoom_Table` does, a room that is named after its furniture (`Bed_Room`) does not.
pub(crate) fn is_furniture(label: &str) -> bool {
    let mut words = vec![String::new()];
    let mut was_lower = false;
    for letter in label.chars().take(LABEL_CHARS_MAX) {
        if !letter.is_alphabetic() || (was_lower && letter.is_uppercase()) {
            words.push(String::new());
        }
        was_lower = letter.is_lowercase();
        if letter.is_alphabetic() {
            words.iter_mut().last().into_iter().for_each(|word| word.extend(letter.to_lowercase()));
        }
    }
    let is_room =
        words.iter().rfind(|word| !word.is_empty()).is_some_and(|word| word == "room" || word == "rooms");
    if is_room {
        return false;
    }
    let is_known = |word: &str| WORDS.contains(&word);
    words.iter().any(|word| is_known(word) || word.strip_suffix('s').is_some_and(is_known))
}

/// Outlines of the furniture of a mesh whose floor is at z = 0, largest first.
pub(crate) fn outlines(mesh: &Mesh) -> Vec<Furniture> {
    let mut groups: Vec<Group> = Vec::new();
    for piece in &mesh.furniture {
        let (mut count, mut corners, mut parts) = (1, 0, Vec::new());
        while count <= piece.parts
            && let Some(part) = groups.pop()
        {
            count += part.pieces;
            corners += part.corners;
            parts.extend(part.outlines);
        }
        // What no part names, such as the top of a desk with a named drawer, has its place in the whole alone.
        if corners < piece.corners.len() {
            parts.clear();
        }
        let outlines = whole_or_parts(outline(piece), parts);
        groups.push(Group { pieces: count, corners: piece.corners.len(), outlines });
    }
    let mut found: Vec<Furniture> = groups.into_iter().flat_map(|group| group.outlines).collect();
    found.sort_by(|a, b| b.area_m2().total_cmp(&a.area_m2()));
    found
}

/// A piece so far that is no part of another one.
struct Group {
    /// Number of pieces of the list that it stands for.
    pieces: usize,
    /// Corners of its triangles.
    corners: usize,
    outlines: Vec<Furniture>,
}

/// A chair is one piece, however many parts its file names. A group of chairs, with floor between them, is its chairs.
fn whole_or_parts(whole: Option<Furniture>, parts: Vec<Furniture>) -> Vec<Furniture> {
    let parts_m2: f64 = parts.iter().map(Furniture::area_m2).sum();
    match whole {
        Some(whole) if parts.is_empty() || whole.area_m2() <= WHOLE_TO_PARTS_MAX * parts_m2 => vec![whole],
        _ => parts,
    }
}

fn outline(piece: &Piece) -> Option<Furniture> {
    let high_m = burger::HEIGHT_M as f32 + HEAD_MARGIN_M;
    let (triangles, _) = piece.corners.as_chunks::<3>();
    let points: Vec<[f64; 2]> =
        triangles.iter().flat_map(|triangle| slab(triangle, FLOOR_RELIEF_M, high_m)).collect();
    let is_in_room = |point: &[f64; 2]| point.iter().all(|v| v.abs() <= f64::from(EXTENT_MAX_M));
    if !points.iter().all(is_in_room) {
        return None;
    }
    let hull = convex_hull(points);
    let outline_m = without_short_sides(if hull.len() > DIRECTIONS { circumscribed(&hull) } else { hull });
    let is_large = outline_m.len() >= 3 && area_m2(&outline_m) >= AREA_MIN_M2;
    is_large.then(|| Furniture { label: piece.label.clone(), outline_m })
}

/// Convex hull, counterclockwise (monotone chain, Andrew 1979).
fn convex_hull(mut points: Vec<[f64; 2]>) -> Vec<[f64; 2]> {
    points.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    points.dedup();
    let mut hull: Vec<[f64; 2]> = Vec::new();
    let mut add = |points: &mut dyn Iterator<Item = [f64; 2]>| {
        let first = hull.len();
        for point in points {
            while hull.len() >= first + 2 && cross(hull[hull.len() - 2], hull[hull.len() - 1], point) <= 0.0 {
                hull.pop();
            }
            hull.push(point);
        }
        // The last point is the first one of the other half.
        hull.pop();
    };
    add(&mut points.iter().copied());
    add(&mut points.iter().rev().copied());
    hull
}

/// Polygon of 16 sides in fixed directions that touch a hull from outside.
fn circumscribed(hull: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let step_rad = TAU / DIRECTIONS as f64;
    let normal = |i: usize| {
        let (sin, cos) = (i as f64 * step_rad).sin_cos();
        [cos, sin]
    };
    let support_m =
        |n: [f64; 2]| hull.iter().map(|p| p[0] * n[0] + p[1] * n[1]).fold(f64::NEG_INFINITY, f64::max);
    let corner = |i: usize| {
        let (a, b) = (normal(i), normal(i + 1));
        let (at_a, at_b) = (support_m(a), support_m(b));
        let sine = a[0] * b[1] - a[1] * b[0];
        [(at_a * b[1] - at_b * a[1]) / sine, (at_b * a[0] - at_a * b[0]) / sine]
    };
    (0..DIRECTIONS).map(corner).collect()
}

/// A polygon without sides that have no direction but that of rounding: where one corner of a hull supports several directions,
/// the corners between them coincide.
fn without_short_sides(polygon: Vec<[f64; 2]>) -> Vec<[f64; 2]> {
    let mut kept: Vec<[f64; 2]> = Vec::with_capacity(polygon.len());
    for corner in polygon {
        if kept.last().is_none_or(|last| length_m(*last, corner) >= SIDE_MIN_M) {
            kept.push(corner);
        }
    }
    while kept.len() > 1 && length_m(kept[0], kept[kept.len() - 1]) < SIDE_MIN_M {
        kept.pop();
    }
    kept
}

fn length_m(a: [f64; 2], b: [f64; 2]) -> f64 {
    (b[0] - a[0]).hypot(b[1] - a[1])
}

/// Twice the area of the triangle of three points; positive if they turn counterclockwise.
fn cross(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
}

fn sides(polygon: &[[f64; 2]]) -> impl Iterator<Item = ([f64; 2], [f64; 2])> + '_ {
    polygon.iter().copied().zip(polygon.iter().copied().cycle().skip(1))
}

fn area_m2(polygon: &[[f64; 2]]) -> f64 {
    sides(polygon).map(|(a, b)| a[0] * b[1] - a[1] * b[0]).sum::<f64>() / 2.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_of_all_formats_name_furniture() {
        for label in [
            "TABLE",
            "Table.001",
            "coffee_table",
            "OfficeChair12",
            "Shelves",
            "BED",
            "two beds",
            "LivingRoom_Table",
        ] {
            assert!(is_furniture(label), "{label}");
        }
        for label in [
            "",
            "WALL_FACE",
            "FLOOR",
            "Tablet",
            "bedroom",
            "GLOBAL_MESH",
            "OTHER",
            "stable",
            "Bed_Room",
            "StorageRoom.002",
        ] {
            assert!(!is_furniture(label), "{label}");
        }
    }

    /// A leg as a triangle that stands on the floor.
    fn leg([x, y]: [f32; 2]) -> [Vec3; 3] {
        [Vec3::new(x, y, 0.0), Vec3::new(x + 0.02, y, 0.0), Vec3::new(x, y, 0.7)]
    }

    fn outline_of(corners: Vec<Vec3>) -> Option<Furniture> {
        outline(&Piece { label: "TABLE".into(), corners, parts: 0 })
    }

    #[test]
    fn a_table_keeps_robots_out_between_its_legs() {
        let legs = [[0.0, 0.0], [1.0, 0.0], [1.0, 0.6], [0.0, 0.6]].map(leg).concat();
        let table = outline_of(legs).unwrap();
        assert!((table.area_m2() - 0.61).abs() < 0.02, "{table:?}");
        assert!(table.is_near([0.5, 0.3], 0.0) && !table.is_near([0.5, 0.8], 0.1));
        assert!(table.is_near([0.5, 0.65], 0.1), "{table:?}");
    }

    #[test]
    fn what_hangs_above_robots_keeps_none_out() {
        let shelf = [Vec3::new(0.0, 0.0, 1.0), Vec3::new(1.0, 0.0, 1.0), Vec3::new(1.0, 1.0, 1.0)];
        assert_eq!(outline_of(shelf.to_vec()), None);
    }

    #[test]
    fn a_round_table_is_inside_its_sixteen_corners() {
        let rim = |i: usize| {
            let (sin, cos) = (TAU as f32 * i as f32 / 100.0).sin_cos();
            leg([cos, sin])
        };
        let table = outline_of((0..100).flat_map(rim).collect()).unwrap();
        assert_eq!(table.outline_m.len(), DIRECTIONS);
        assert!((0..100).all(|i| table.is_near([rim(i)[0].x.into(), rim(i)[0].y.into()], 1e-6)));
        assert!(table.area_m2() < 1.1 * core::f64::consts::PI, "{}", table.area_m2());
    }

    /// Boxes with worn edges, as scanned, at any turn: their corners support several of the directions.
    #[test]
    fn the_middle_of_any_scanned_table_is_in_its_outline() {
        for number in 0..500_u32 {
            let (sin, cos) = (number as f32 * 0.7).sin_cos();
            let worn = |i: u32| 0.004 * (((i * 7919 + number * 104_729) % 1000) as f32 / 1000.0);
            let corner = |i: u32| {
                let (x, y) = (if i & 1 == 0 { -0.6 } else { 0.6 }, if i & 2 == 0 { -0.4 } else { 0.4 });
                let (x, y) = (x + worn(i), y + worn(i + 50));
                leg([cos * x - sin * y, sin * x + cos * y])
            };
            let table = outline_of((0..40).flat_map(corner).collect()).unwrap();
            assert!(table.is_near([0.0, 0.0], 0.2), "{number}: {table:?}");
            assert!(!table.is_near([2.0, 0.0], 0.2), "{number}: {table:?}");
        }
    }

    /// Corners of a box that stands on the floor.
    fn block([x, y]: [f32; 2], side_m: f32) -> Vec<Vec3> {
        [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]
            .iter()
            .flat_map(|[u, v]| leg([x + u * side_m, y + v * side_m]))
            .collect()
    }

    #[test]
    fn chairs_of_a_group_are_pieces_and_parts_of_a_chair_are_not() {
        let mut mesh = Mesh::default();
        let (seat, back) = (block([0.0, 0.0], 0.5), block([0.0, 0.1], 0.4));
        mesh.add_piece("Chair_seat", seat.clone());
        mesh.add_piece("Chair_back", back.clone());
        let first = [seat, back].concat();
        mesh.push_piece("Chair.001", first.clone(), 2);
        let second = block([4.0, 3.0], 0.5);
        mesh.add_piece("Chair.002", second.clone());
        mesh.push_piece("Chairs", [first, second].concat(), 4);
        let mut labels: Vec<String> = outlines(&mesh).into_iter().map(|piece| piece.label).collect();
        labels.sort();
        assert_eq!(labels, ["Chair.001", "Chair.002"]);
    }

    #[test]
    fn a_desk_whose_drawer_alone_has_a_name_is_whole() {
        let mut mesh = Mesh::default();
        let (drawer, top) = (block([0.0, 0.0], 0.3), block([0.0, 0.0], 1.6));
        mesh.add_piece("Desk_drawer", drawer.clone());
        mesh.push_piece("Desk", [top, drawer].concat(), 1);
        let found = outlines(&mesh);
        assert_eq!(found.len(), 1);
        assert!(found[0].label == "Desk" && found[0].area_m2() > 2.5, "{found:?}");
    }

    #[test]
    fn labels_have_no_control_characters() {
        let mut mesh = Mesh::default();
        mesh.add_piece("\u{1b}[2Jtable\0", vec![Vec3::ZERO; 3]);
        assert_eq!(mesh.furniture[0].label, "[2Jtable");
    }
}
