//! Buildings of rooms behind doors: office, school, museum and flat.

use super::draw::{Draw, Piece, Rect};

/// Widths of ordinary doors, metres: from the narrowest to the widest that is drawn.
const DOOR_M: [f32; 2] = [0.9, 1.1];
/// Distance of a door from the corners of its room, metres.
const DOOR_INSET_M: f32 = 0.9;

const CABINET: Piece = Piece::Block { min: [0.8, 0.4], max: [1.4, 0.5], height_m: 1.8 };
const DESK: Piece = Piece::Block { min: [1.2, 0.6], max: [1.6, 0.8], height_m: 0.74 };
const BOX: Piece = Piece::Block { min: [0.3, 0.3], max: [0.6, 0.6], height_m: 0.5 };
const SOFA: Piece = Piece::Block { min: [1.5, 0.8], max: [2.0, 0.9], height_m: 0.8 };
const BED: Piece = Piece::Block { min: [1.9, 0.9], max: [2.0, 1.4], height_m: 0.5 };
const POT: Piece = Piece::Column { radius_m: 0.2, height_m: 1.0 };

/// A row of rooms along a corridor.
struct Row {
    /// First and last x, metres.
    along: [f32; 2],
    /// y of the corridor's wall and of the wall opposite, metres.
    across: [f32; 2],
    /// Smallest and largest width of a room, metres.
    width: [f32; 2],
}

impl Draw {
    /// Adds rooms in a row, each with a door to the corridor. Returns the rooms.
    fn add_row(&mut self, row: &Row) -> Vec<Rect> {
        let [near, far] = row.across;
        let borders = self.divide(row.along[0], row.along[1], row.width[0], row.width[1]);
        let mut doors = Vec::new();
        let mut rooms = Vec::new();
        for pair in borders.windows(2) {
            let width = self.between(DOOR_M[0], DOOR_M[1]);
            let centre = self.between(pair[0] + DOOR_INSET_M, pair[1] - DOOR_INSET_M);
            doors.push((centre, width));
            rooms.push(Rect::new([pair[0], near.min(far)], [pair[1], near.max(far)]));
        }
        for border in &borders[1..borders.len() - 1] {
            self.wall([*border, near.min(far)], [*border, near.max(far)], &[]);
        }
        self.wall([row.along[0], near], [row.along[1], near], &doors);
        rooms
    }
}

/// Adds an office floor: corridors around a core of rooms, and rooms outside of them.
pub(super) fn add_office(draw: &mut Draw) {
    let (half_x, half_y) = (15.0, 10.0);
    draw.shell(Rect::new([-half_x, -half_y], [half_x, half_y]));
    let corridor = draw.between(1.6, 2.0);
    let depth = draw.between(4.2, 5.0);
    let (inner, outer) = (half_y - depth - corridor, half_y - depth);
    let core = half_x - draw.between(2.0, 3.0);
    let middle = draw.between(-0.5, 0.5);
    let width = [3.0, 5.5];
    let mut rooms = Vec::new();
    for side in [-1.0, 1.0] {
        let across = [side * outer, side * half_y];
        rooms.extend(draw.add_row(&Row { along: [-half_x, half_x], across, width }));
        let across = [side * inner, middle];
        rooms.extend(draw.add_row(&Row { along: [-core, core], across, width }));
        draw.wall([side * core, -inner], [side * core, inner], &[]);
    }
    draw.wall([-core, middle], [core, middle], &[]);
    for room in rooms {
        let chairs = [Piece::Chair, Piece::Chair];
        draw.furnish(room, &[DESK, CABINET, DESK, POT]);
        if draw.chance(0.4) {
            draw.furnish(room, &[Piece::Table]);
        }
        draw.furnish(room, &chairs);
    }
    // Copiers and cabinets in the wide ends of the corridors.
    for side in [-1.0, 1.0] {
        let end =
            Rect::new([(side * core).min(side * half_x), -inner], [(side * core).max(side * half_x), inner]);
        draw.furnish(end, &[CABINET, BOX]);
    }
}

/// Adds a school: a corridor with classrooms at both sides.
pub(super) fn add_school(draw: &mut Draw) {
    let (half_x, half_y) = (15.0, 7.5);
    draw.shell(Rect::new([-half_x, -half_y], [half_x, half_y]));
    let half_corridor = draw.between(1.1, 1.4);
    for side in [-1.0, 1.0] {
        let across = [side * half_corridor, side * half_y];
        for room in draw.add_row(&Row { along: [-half_x, half_x], across, width: [5.5, 8.0] }) {
            add_classroom(draw, room);
        }
    }
    // Lockers along the corridor's ends.
    for side in [-1.0, 1.0] {
        let x = side * (half_x - 0.3);
        draw.block(Rect::new([x - 0.24, -0.4], [x + 0.24, 0.4]), 1.8);
    }
}

/// Adds rows of double desks, and a few chairs and cabinets.
fn add_classroom(draw: &mut Draw, room: Rect) {
    let [width, depth] = room.size();
    let (desk, lane) = ([1.3, 0.5], draw.between(0.8, 1.0));
    let columns = ((width - 1.8 + lane) / (desk[0] + lane)) as usize;
    let rows = ((depth - 2.6 + lane) / (desk[1] + lane)) as usize;
    let first = [
        room.centre()[0] - (columns as f32 * (desk[0] + lane) - lane) / 2.0,
        room.centre()[1] - (rows as f32 * (desk[1] + lane) - lane) / 2.0,
    ];
    for (column, row) in (0..columns).flat_map(|column| (0..rows).map(move |row| (column, row))) {
        if draw.chance(0.15) {
            continue;
        }
        let x = first[0] + column as f32 * (desk[0] + lane);
        let y = first[1] + row as f32 * (desk[1] + lane);
        draw.block(Rect::new([x, y], [x + desk[0], y + desk[1]]), 0.74);
    }
    draw.furnish(room, &[CABINET, Piece::Chair, Piece::Chair, BOX]);
}

/// Adds a museum: halls in a grid with wide doors, so that there are loops, and exhibits.
pub(super) fn add_museum(draw: &mut Draw) {
    let xs: Vec<f32> = draw.divide(-12.0, 12.0, 5.0, 7.5);
    let ys: Vec<f32> = draw.divide(-9.0, 9.0, 5.0, 7.0);
    draw.shell(Rect::new([-12.0, -9.0], [12.0, 9.0]));
    for pair in ys.windows(2) {
        for x in &xs[1..xs.len() - 1] {
            // Most walls have a door; those of the first row all have, so that no hall is cut off.
            let is_open = pair[0] == ys[0] || draw.chance(0.8);
            let door = (draw.between(pair[0] + 1.2, pair[1] - 1.2), draw.between(1.2, 1.8));
            draw.wall([*x, pair[0]], [*x, pair[1]], if is_open { core::slice::from_ref(&door) } else { &[] });
        }
    }
    for pair in xs.windows(2) {
        for y in &ys[1..ys.len() - 1] {
            let door = (draw.between(pair[0] + 1.2, pair[1] - 1.2), draw.between(1.2, 1.8));
            draw.wall([pair[0], *y], [pair[1], *y], &[door]);
        }
    }
    for x in xs.windows(2) {
        for y in ys.windows(2) {
            let hall = Rect::new([x[0], y[0]], [x[1], y[1]]);
            let radius_m = draw.between(0.25, 0.5);
            let panel = Piece::Block { min: [1.5, 0.15], max: [2.5, 0.2], height_m: 2.2 };
            let plinth = Piece::Block { min: [0.5, 0.5], max: [1.2, 1.2], height_m: 1.0 };
            let column = Piece::Column { radius_m, height_m: 1.1 };
            draw.furnish(hall, &[plinth, panel, column, plinth]);
        }
    }
}

/// Adds a flat of five rooms around a hallway, with much furniture.
pub(super) fn add_flat(draw: &mut Draw) {
    let (half_x, half_y) = (5.5, 4.5);
    draw.shell(Rect::new([-half_x, -half_y], [half_x, half_y]));
    let south = draw.between(-0.9, -0.4);
    let north = south + draw.between(1.3, 1.5);
    let living = draw.between(-0.5, 0.8);
    let split = draw.between(-1.6, -0.9);
    let width = [3.0, 5.4];
    let lower = draw.add_row(&Row { along: [-half_x, half_x], across: [south, -half_y], width });
    let mut rooms = draw.add_row(&Row { along: [-half_x, living], across: [north, half_y], width });
    // The living room reaches over the hallway's end.
    draw.wall([living, north], [living, half_y], &[]);
    draw.keep_free(Rect::new([living - 0.3, south], [living + 0.9, north]));
    rooms.push(Rect::new([living, south], [half_x, half_y]));
    draw.keep_free(Rect::new([split - 0.4, south], [split + 0.4, north]));
    rooms.extend(lower);
    for (i, room) in rooms.into_iter().enumerate() {
        let large = if i % 2 == 0 { BED } else { SOFA };
        draw.furnish(room, &[large, CABINET, Piece::Table, Piece::Chair, Piece::Chair, BOX, POT, BOX]);
    }
}
