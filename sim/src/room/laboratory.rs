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
use super::builder::{Builder, WALL_HEIGHT_M};

/// Thickness of the outer walls, metres.
const WALL_THICKNESS_M: f32 = 0.12;

impl Room {
    /// Creates the built-in laboratory: 8 m along x, 6 m along y, with the origin in its centre.
    pub fn laboratory() -> Room {
        let mut lab = Builder::default();
        walls(&mut lab);
        west(&mut lab);
        east(&mut lab);
        Room::from_mesh("laboratory", lab.into_mesh(), Some(0.0))
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
