//! The built-in room, a furnished laboratory of 8 m x 6 m.
//!
//! ```text
//!   y ▲   ┌──────────────────────────────────────────────┐  3
//!     │  ╱  workbench      door            cupboards │    │
//!     │ ╱                     ○ column   table, chairs    │
//!     │ │ cabinet                                         │
//!     │ │           machine           ┬───┐               │
//!     │ │ rack                        │ partition   desk  │
//!     │ │          boxes                                  │
//!     │ │  couch                      │ shelf       chair │
//!     │ └──────────────────────────────────────────────────┘ -3
//!       -4                           0.9                  4  ▶ x
//! ```
//! No two corners look alike, and every passage is at least 0.6 m wide.

use super::Room;
use super::mesh::Mesh;
use glam::{Quat, Vec2, Vec3};

/// Height of the outer walls, metres.
const WALL_HEIGHT_M: f32 = 2.5;
/// Thickness of the outer walls, metres.
const WALL_THICKNESS_M: f32 = 0.12;

impl Room {
    /// Creates the built-in laboratory: 8 m along x, 6 m along y, with the origin in its centre.
    pub fn laboratory() -> Room {
        let mut lab = Builder::default();
        walls(&mut lab);
        west(&mut lab);
        east(&mut lab);
        Room::from_mesh("laboratory", lab.0, Some(0.0))
            .unwrap_or_else(|error| unreachable!("the built-in laboratory is valid: {error}"))
    }
}

fn walls(lab: &mut Builder) {
    let t = WALL_THICKNESS_M;
    lab.floor([-4.0, -3.0], [4.0, 3.0]);
    lab.wall([-4.0, -3.0 - t], [4.0, -3.0]);
    lab.wall([4.0, -3.0 - t], [4.0 + t, 3.0 + t]);
    lab.wall([-4.0 - t, -3.0 - t], [-4.0, 3.0 + t]);
    // The north wall has a door, set back by the wall's thickness.
    lab.wall([-4.0, 3.0], [-0.9, 3.0 + t]);
    lab.wall([-0.9, 3.0 + t], [0.0, 3.0 + 2.0 * t]);
    lab.wall([0.0, 3.0], [4.0, 3.0 + t]);
    // The north-west corner is cut off.
    lab.block([-3.85, 2.85], [1.7, 0.12], 45.0, 0.0, WALL_HEIGHT_M);
    // A half-height partition with a doorway of 0.9 m, and its arm.
    lab.block([0.93, -2.3], [0.06, 1.4], 0.0, 0.0, 1.2);
    lab.block([0.93, -0.05], [0.06, 1.3], 0.0, 0.0, 1.2);
    lab.block([1.4, 0.57], [0.88, 0.06], 0.0, 0.0, 1.2);
    lab.column([-0.35, 1.15], 0.2, WALL_HEIGHT_M);
}

/// Furniture of the workshop in the west.
fn west(lab: &mut Builder) {
    lab.table([-1.95, 2.63], [1.7, 0.7], 0.0, 0.9, 0.07);
    lab.block([-1.35, 2.7], [0.4, 0.5], 0.0, 0.0, 0.6);
    // Tall cabinet, server rack, couch.
    lab.block([-3.72, 0.75], [0.5, 1.1], 0.0, 0.0, 1.9);
    lab.block([-3.65, -1.1], [0.6, 0.8], 0.0, 0.0, 1.8);
    lab.couch([-2.6, -2.6], 1.7, 0.8);
    // A machine on its plinth, not square to the walls.
    lab.block([-1.95, 0.15], [1.1, 0.75], 14.0, 0.0, 1.1);
    // Stacked boxes.
    lab.block([-0.75, -2.55], [0.5, 0.42], 24.0, 0.0, 0.45);
    lab.block([-0.28, -2.72], [0.36, 0.36], -8.0, 0.0, 0.35);
    lab.block([-0.7, -2.55], [0.34, 0.3], 40.0, 0.45, 0.7);
    lab.stool([-0.55, -0.95]);
}

/// Furniture of the office behind the partition, and of the meeting corner.
fn east(lab: &mut Builder) {
    lab.table([3.6, -1.7], [0.75, 1.6], 0.0, 0.74, 0.05);
    lab.block([3.68, -2.2], [0.55, 0.42], 0.0, 0.0, 0.6);
    lab.chair([3.0, -1.5], 165.0);
    lab.shelf([1.75, -2.83], 1.3, 0.34);
    lab.block([2.75, -2.8], [0.32, 0.32], 0.0, 0.0, 0.5);
    lab.table([2.35, 1.75], [1.5, 0.8], 20.0, 0.74, 0.06);
    lab.chair([1.65, 2.3], -60.0);
    lab.chair([2.85, 1.1], 115.0);
    lab.chair([3.25, 2.2], -150.0);
    // Cupboards of two depths in the north-east corner, a bin on the east wall.
    lab.block([3.78, 0.45], [0.44, 0.9], 0.0, 0.0, 1.0);
    lab.block([0.65, 2.8], [0.9, 0.4], 0.0, 0.0, 2.0);
    lab.block([3.7, 2.75], [0.6, 0.5], 0.0, 0.0, 0.8);
    lab.column([3.82, -0.45], 0.14, 0.45);
}

/// Builds a mesh of closed bodies. Positions of centres and sizes are in metres, angles in degrees.
#[derive(Default)]
struct Builder(Mesh);

impl Builder {
    fn floor(&mut self, [x0, y0]: [f32; 2], [x1, y1]: [f32; 2]) {
        let first = self.0.vertices.len() as u32;
        self.0.vertices.extend([[x0, y0], [x1, y0], [x1, y1], [x0, y1]].map(|[x, y]| Vec3::new(x, y, 0.0)));
        self.0.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
    }

    fn wall(&mut self, min: [f32; 2], max: [f32; 2]) {
        let middle = [(min[0] + max[0]) / 2.0, (min[1] + max[1]) / 2.0];
        self.block(middle, [max[0] - min[0], max[1] - min[1]], 0.0, 0.0, WALL_HEIGHT_M);
    }

    /// Adds a cuboid between two heights.
    fn block(&mut self, middle: [f32; 2], size: [f32; 2], yaw_deg: f32, bottom: f32, top: f32) {
        let half = Vec2::from(size) / 2.0;
        let base = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]].map(|s| Vec2::from(s) * half);
        self.prism(&base, middle, yaw_deg, bottom, top);
    }

    /// Adds a round column of 16 sides.
    fn column(&mut self, middle: [f32; 2], radius: f32, top: f32) {
        let base: [Vec2; 16] =
            core::array::from_fn(|i| Vec2::from_angle(i as f32 * core::f32::consts::TAU / 16.0) * radius);
        self.prism(&base, middle, 0.0, 0.0, top);
    }

    /// Adds a prism over a convex, counter-clockwise base. All faces point outwards.
    fn prism(&mut self, base: &[Vec2], [x, y]: [f32; 2], yaw_deg: f32, bottom: f32, top: f32) {
        let Mesh { vertices, triangles } = &mut self.0;
        let first = vertices.len() as u32;
        let sides = base.len() as u32;
        let turn = Quat::from_rotation_z(yaw_deg.to_radians());
        for z in [bottom, top] {
            vertices.extend(base.iter().map(|p| turn * p.extend(0.0) + Vec3::new(x, y, z)));
        }
        for i in 0..sides {
            let j = (i + 1) % sides;
            let (a, b, c, d) = (first + i, first + j, first + sides + j, first + sides + i);
            triangles.extend([[a, b, c], [a, c, d]]);
        }
        for i in 1..sides - 1 {
            let (low, high) = (first, first + sides);
            triangles.extend([[low, low + i + 1, low + i], [high, high + i, high + i + 1]]);
        }
    }

    /// Adds a table: a top on four legs.
    fn table(&mut self, middle: [f32; 2], size: [f32; 2], yaw_deg: f32, height: f32, leg: f32) {
        self.block(middle, size, yaw_deg, height - 0.04, height);
        self.legs(middle, size, yaw_deg, height - 0.04, leg);
    }

    fn legs(&mut self, middle: [f32; 2], size: [f32; 2], yaw_deg: f32, height: f32, leg: f32) {
        for corner in [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]] {
            let local = Vec2::from(corner) * (Vec2::from(size) - leg) / 2.0;
            let at = Vec2::from(middle) + Vec2::from_angle(yaw_deg.to_radians()).rotate(local);
            self.block(at.into(), [leg, leg], yaw_deg, 0.0, height);
        }
    }

    /// Adds a chair: four legs, a seat and a back. `yaw_deg` is the viewing direction of a sitting person.
    fn chair(&mut self, middle: [f32; 2], yaw_deg: f32) {
        self.legs(middle, [0.42, 0.42], yaw_deg, 0.42, 0.04);
        self.block(middle, [0.42, 0.42], yaw_deg, 0.42, 0.46);
        let behind = Vec2::from(middle) + Vec2::from_angle(yaw_deg.to_radians()) * -0.19;
        self.block(behind.into(), [0.04, 0.42], yaw_deg, 0.46, 0.9);
    }

    /// Adds a stool on one round foot.
    fn stool(&mut self, middle: [f32; 2]) {
        self.column(middle, 0.12, 0.5);
    }

    /// Adds a couch with its back to the south. Its seat and arms reach the floor.
    fn couch(&mut self, [x, y]: [f32; 2], width: f32, depth: f32) {
        self.block([x, y], [width, depth], 0.0, 0.0, 0.4);
        self.block([x, y - depth / 2.0 + 0.1], [width, 0.2], 0.0, 0.4, 0.8);
        for side in [-1.0, 1.0] {
            // The arms reach farther forward than the seat.
            self.block([x + side * (width / 2.0 - 0.08), y + 0.06], [0.16, depth], 0.0, 0.0, 0.6);
        }
    }

    /// Adds a shelf that is open to the north, with one box in it. Its back and sides stand on the floor; its
    /// boards are above the LiDAR's plane.
    fn shelf(&mut self, [x, y]: [f32; 2], width: f32, depth: f32) {
        self.block([x, y - depth / 2.0 + 0.01], [width, 0.02], 0.0, 0.0, 1.8);
        for side in [-1.0, 0.2, 1.0] {
            self.block([x + side * (width / 2.0 - 0.015), y], [0.03, depth], 0.0, 0.0, 1.8);
        }
        for board in [0.45, 0.9, 1.35, 1.77] {
            self.block([x, y], [width, depth], 0.0, board, board + 0.03);
        }
        self.block([x + 0.36, y], [0.3, 0.22], 0.0, 0.0, 0.3);
    }
}
