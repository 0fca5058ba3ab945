//! Builder of furnished rooms from walls, blocks, columns and pieces of furniture.

use super::mesh::Mesh;
use glam::{Quat, Vec2, Vec3};

/// Height of walls, metres.
pub(crate) const WALL_HEIGHT_M: f32 = 2.5;

/// Builds a mesh of closed bodies. Positions of centres and sizes are in metres, angles in degrees.
#[derive(Default)]
pub(crate) struct Builder(Mesh);

impl Builder {
    /// Returns the mesh of all bodies added.
    pub(crate) fn into_mesh(self) -> Mesh {
        self.0
    }

    /// Adds a rectangle of floor at z = 0 between two corners.
    pub(crate) fn floor(&mut self, [x0, y0]: [f32; 2], [x1, y1]: [f32; 2]) {
        let first = self.0.vertices.len() as u32;
        self.0.vertices.extend([[x0, y0], [x1, y0], [x1, y1], [x0, y1]].map(|[x, y]| Vec3::new(x, y, 0.0)));
        self.0.triangles.extend([[first, first + 1, first + 2], [first, first + 2, first + 3]]);
    }

    /// Adds a wall of full height between two corners.
    pub(crate) fn wall(&mut self, min: [f32; 2], max: [f32; 2]) {
        let middle = [(min[0] + max[0]) / 2.0, (min[1] + max[1]) / 2.0];
        self.block(middle, [max[0] - min[0], max[1] - min[1]], 0.0, 0.0, WALL_HEIGHT_M);
    }

    /// Adds a cuboid between two heights.
    pub(crate) fn block(&mut self, middle: [f32; 2], size: [f32; 2], yaw_deg: f32, bottom: f32, top: f32) {
        let half = Vec2::from(size) / 2.0;
        let base = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]].map(|s| Vec2::from(s) * half);
        self.prism(&base, middle, yaw_deg, bottom, top);
    }

    /// Adds a round column of 16 sides.
    pub(crate) fn column(&mut self, middle: [f32; 2], radius: f32, top: f32) {
        let base: [Vec2; 16] =
            core::array::from_fn(|i| Vec2::from_angle(i as f32 * core::f32::consts::TAU / 16.0) * radius);
        self.prism(&base, middle, 0.0, 0.0, top);
    }

    /// Adds a prism over a convex, counter-clockwise base. All faces point outwards.
    fn prism(&mut self, base: &[Vec2], [x, y]: [f32; 2], yaw_deg: f32, bottom: f32, top: f32) {
        let Mesh { vertices, triangles, .. } = &mut self.0;
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
    pub(crate) fn table(&mut self, middle: [f32; 2], size: [f32; 2], yaw_deg: f32, height: f32, leg: f32) {
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
    pub(crate) fn chair(&mut self, middle: [f32; 2], yaw_deg: f32) {
        self.legs(middle, [0.42, 0.42], yaw_deg, 0.42, 0.04);
        self.block(middle, [0.42, 0.42], yaw_deg, 0.42, 0.46);
        let behind = Vec2::from(middle) + Vec2::from_angle(yaw_deg.to_radians()) * -0.19;
        self.block(behind.into(), [0.04, 0.42], yaw_deg, 0.46, 0.9);
    }

    /// Adds a stool on one round foot.
    pub(crate) fn stool(&mut self, middle: [f32; 2]) {
        self.column(middle, 0.12, 0.5);
    }

    /// Adds a couch with its back to the south. Its seat and arms reach the floor.
    pub(crate) fn couch(&mut self, [x, y]: [f32; 2], width: f32, depth: f32) {
        self.block([x, y], [width, depth], 0.0, 0.0, 0.4);
        self.block([x, y - depth / 2.0 + 0.1], [width, 0.2], 0.0, 0.4, 0.8);
        for side in [-1.0, 1.0] {
            // The arms reach farther forward than the seat.
            self.block([x + side * (width / 2.0 - 0.08), y + 0.06], [0.16, depth], 0.0, 0.0, 0.6);
        }
    }

    /// Adds a shelf that is open to the north, with one box in it. Its back and sides stand on the floor; its
    /// boards are above the LiDAR's plane.
    pub(crate) fn shelf(&mut self, [x, y]: [f32; 2], width: f32, depth: f32) {
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
