//! Large open places: warehouse and hall.

use super::draw::{Draw, Piece, Rect};

const PALLET: Piece = Piece::Block { min: [0.8, 0.8], max: [1.2, 1.2], height_m: 1.2 };
const CRATE: Piece = Piece::Block { min: [0.4, 0.4], max: [0.9, 0.9], height_m: 0.8 };
const PILLAR: Piece = Piece::Column { radius_m: 0.25, height_m: 2.5 };

/// Adds a warehouse: rows of racks with aisles and a cross aisle, and pallets before the gates.
pub(super) fn add_warehouse(draw: &mut Draw) {
    let (half_x, half_y) = (12.0, 8.0);
    draw.shell(Rect::new([-half_x, -half_y], [half_x, half_y]));
    let (aisle, rack) = (draw.between(1.5, 2.0), draw.between(0.9, 1.1));
    let begin = -half_x + draw.between(1.5, 2.0);
    let end = half_x - draw.between(4.5, 6.0);
    let cross = draw.between(begin + 5.0, end - 5.0);
    let mut y = -half_y + aisle;
    while y + rack + aisle <= half_y {
        for (from, to) in [(begin, cross - 0.9), (cross + 0.9, end)] {
            // Some racks are shorter.
            let to = to - if draw.chance(0.3) { draw.between(1.0, 2.5) } else { 0.0 };
            draw.block(Rect::new([from, y], [to, y + rack]), 2.4);
        }
        y += rack + aisle;
    }
    let gates = Rect::new([end + 0.5, -half_y], [half_x, half_y]);
    draw.furnish(gates, &[PALLET, CRATE, PALLET, PALLET, CRATE, PALLET]);
}

/// Adds an open hall in the shape of an L with columns and crates.
pub(super) fn add_hall(draw: &mut Draw) {
    let (half_x, half_y) = (11.0, 9.0);
    let corner = [draw.between(-1.0, 3.0), draw.between(-2.0, 1.0)];
    let outer = Rect::new([-half_x, -half_y], [half_x, half_y]);
    // Floor of two rectangles, so that the corner cut off is no floor.
    let arms =
        [Rect::new(outer.min, [half_x, corner[1]]), Rect::new([-half_x, corner[1]], [corner[0], half_y])];
    arms.iter().for_each(|arm| draw.build.floor(arm.min, arm.max));
    for (from, to) in [
        ([-half_x, -half_y], [half_x, -half_y]),
        ([-half_x, -half_y], [-half_x, half_y]),
        ([half_x, -half_y], [half_x, corner[1]]),
        ([corner[0], corner[1]], [half_x, corner[1]]),
        ([corner[0], corner[1]], [corner[0], half_y]),
        ([-half_x, half_y], [corner[0], half_y]),
    ] {
        draw.wall(from, to, &[]);
    }
    for arm in arms {
        draw.furnish(arm, &[PILLAR, CRATE, PILLAR, CRATE, PILLAR, CRATE, PALLET]);
    }
}
