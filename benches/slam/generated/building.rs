//! Buildings drawn from a seed: walls as segments, and a route that touches none of them.

use crate::noise::Noise;

/// Half the width of a door, metres.
const DOOR_HALF_M: f64 = 0.6;
/// Free space around the route, metres: no furniture stands there.
const ROUTE_CLEARANCE_M: f64 = 0.7;

/// What kind of building.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A corridor with rooms on both sides.
    Office,
    /// A hall with two rows of equal pillars.
    EqualBays,
    /// Corridors around a courtyard.
    RingOfCorridors,
    /// One corridor without features.
    Corridor,
    /// Rooms in a grid, joined by doors, with exhibits.
    Museum,
    /// A few small rooms with much furniture.
    Flat,
    /// Rows of shelves.
    Warehouse,
    /// Open ground with a few buildings.
    Campus,
}

impl Kind {
    /// All kinds.
    pub const ALL: [Self; 8] = [
        Self::Office,
        Self::EqualBays,
        Self::RingOfCorridors,
        Self::Corridor,
        Self::Museum,
        Self::Flat,
        Self::Warehouse,
        Self::Campus,
    ];

    /// Returns the name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Office => "office",
            Self::EqualBays => "equal bays",
            Self::RingOfCorridors => "ring of corridors",
            Self::Corridor => "corridor",
            Self::Museum => "museum",
            Self::Flat => "flat",
            Self::Warehouse => "warehouse",
            Self::Campus => "campus",
        }
    }
}

/// A point, metres.
pub type Point = [f64; 2];

/// A wall: a segment, and whether it is glass, which a LiDAR hardly sees.
#[derive(Clone, Copy, Debug)]
pub struct Wall {
    /// One end, metres.
    pub from: Point,
    /// The other end, metres.
    pub to: Point,
    /// Whether most beams pass through it.
    pub is_glass: bool,
}

/// A building and a route through it.
#[derive(Clone)]
pub struct Building {
    /// The walls.
    pub walls: Vec<Wall>,
    /// Corners of the route, metres; it is driven from the first to the last.
    pub route: Vec<Point>,
    /// Rooms that furniture stands in: lower left and upper right corners, metres.
    pub rooms: Vec<[Point; 2]>,
    /// Number of walls before the first of the furniture in rooms.
    pub fixed_walls: usize,
}

impl Building {
    /// Draws a building of this kind.
    pub fn draw(kind: Kind, noise: &mut Noise) -> Self {
        let mut building = Self { walls: Vec::new(), route: Vec::new(), rooms: Vec::new(), fixed_walls: 0 };
        match kind {
            Kind::Office => building.add_office(noise),
            Kind::EqualBays => building.add_equal_bays(noise),
            Kind::RingOfCorridors => building.add_ring(noise),
            Kind::Corridor => building.add_corridor(noise),
            Kind::Museum => building.add_rooms(noise, [3, 4], [5.0, 8.0], 3),
            Kind::Flat => building.add_rooms(noise, [2, 3], [2.8, 4.5], 4),
            Kind::Warehouse => building.add_warehouse(noise),
            Kind::Campus => building.add_campus(noise),
        }
        if building.rooms.is_empty() {
            building.fixed_walls = building.walls.len();
        }
        building
    }

    fn add_wall(&mut self, from: Point, to: Point) {
        self.walls.push(Wall { from, to, is_glass: false });
    }

    /// Adds the four walls of a rectangle.
    pub fn add_box(&mut self, low: Point, high: Point) {
        let corners = [low, [high[0], low[1]], high, [low[0], high[1]]];
        (0..4).for_each(|index| self.add_wall(corners[index], corners[(index + 1) % 4]));
    }

    /// Adds a wall with a gap around each of the points that lie on it.
    fn add_wall_with_doors(&mut self, from: Point, to: Point, doors_m: &[f64]) {
        let length_m = distance(from, to);
        let at = |along_m: f64| {
            let share = along_m / length_m;
            [from[0] + share * (to[0] - from[0]), from[1] + share * (to[1] - from[1])]
        };
        let mut begin_m = 0.0;
        for door_m in doors_m {
            self.add_wall(at(begin_m), at(door_m - DOOR_HALF_M));
            begin_m = door_m + DOOR_HALF_M;
        }
        self.add_wall(at(begin_m), to);
    }

    /// Tries to put so many pieces of furniture into each room.
    pub fn furnish(&mut self, pieces: usize, noise: &mut Noise) {
        self.fixed_walls = self.walls.len();
        for [low, high] in self.rooms.clone() {
            self.add_furniture(low, high, pieces, noise);
        }
    }

    /// Adds boxes at random places within a rectangle, but not near the route.
    pub fn add_furniture(&mut self, low: Point, high: Point, count: usize, noise: &mut Noise) {
        for _ in 0..count {
            let size = [noise.between(0.3, 1.2), noise.between(0.3, 1.2)];
            let place =
                [0, 1].map(|axis| noise.between(low[axis], (high[axis] - size[axis]).max(low[axis] + 0.01)));
            let end = [place[0] + size[0], place[1] + size[1]];
            let centre = [(place[0] + end[0]) / 2.0, (place[1] + end[1]) / 2.0];
            let reach_m = size[0].hypot(size[1]) / 2.0 + ROUTE_CLEARANCE_M;
            let is_clear =
                self.route.windows(2).all(|leg| distance_to_segment(centre, leg[0], leg[1]) > reach_m);
            if is_clear && end[0] < high[0] && end[1] < high[1] {
                self.add_box(place, end);
            }
        }
    }

    fn add_office(&mut self, noise: &mut Noise) {
        let (length_m, half_m) = (noise.between(18.0, 45.0), noise.between(0.9, 1.3));
        let mut route = vec![[1.0, 0.0]];
        let mut visits: Vec<(f64, f64, f64)> = Vec::new();
        for side in [-1.0, 1.0] {
            let depth_m = noise.between(3.5, 6.0);
            let (mut x_m, mut doors) = (0.0, Vec::new());
            while x_m < length_m - 2.5 {
                let width_m = noise.between(2.8, 5.0).min(length_m - x_m);
                let door_m = x_m + noise.between(0.9, width_m - 0.9);
                doors.push(door_m);
                let (near, far) = (side * half_m, side * (half_m + depth_m));
                self.add_wall([x_m, near], [x_m, far]);
                self.add_wall([x_m, far], [x_m + width_m, far]);
                self.add_wall([x_m + width_m, near], [x_m + width_m, far]);
                self.rooms.push([[x_m, near.min(far)], [x_m + width_m, near.max(far)]]);
                if noise.uniform() < 0.5 {
                    visits.push((door_m, side, depth_m * noise.between(0.4, 0.7)));
                }
                x_m += width_m;
            }
            self.add_wall_with_doors([0.0, side * half_m], [length_m, side * half_m], &doors);
        }
        self.add_wall([0.0, -half_m], [0.0, half_m]);
        self.add_wall([length_m, -half_m], [length_m, half_m]);
        visits.sort_by(|a, b| a.0.total_cmp(&b.0));
        for (door_m, side, depth_m) in visits {
            route.extend([[door_m, 0.0], [door_m, side * (half_m + depth_m)], [door_m, 0.0]]);
        }
        route.extend([[length_m - 1.0, 0.0], [1.0, 0.0]]);
        self.route = route;
        self.furnish(3, noise);
    }

    fn add_equal_bays(&mut self, noise: &mut Noise) {
        let (bay_m, bays) = (noise.between(4.0, 6.0), 5 + noise.below(6));
        let (width_m, pillar_m) = (noise.between(10.0, 20.0), noise.between(0.3, 0.6));
        let length_m = bay_m * bays as f64;
        self.add_box([0.0, 0.0], [length_m, width_m]);
        for bay in 1..bays {
            for y_m in [width_m / 3.0, 2.0 * width_m / 3.0] {
                let x_m = bay as f64 * bay_m;
                self.add_box(
                    [x_m - pillar_m / 2.0, y_m - pillar_m / 2.0],
                    [x_m + pillar_m / 2.0, y_m + pillar_m / 2.0],
                );
            }
        }
        let lanes = [width_m / 6.0, width_m / 2.0, 5.0 * width_m / 6.0];
        let (begin, end) = (bay_m / 2.0, length_m - bay_m / 2.0);
        self.route = vec![
            [begin, lanes[0]],
            [end, lanes[0]],
            [end, lanes[1]],
            [begin, lanes[1]],
            [begin, lanes[2]],
            [end, lanes[2]],
            [end, lanes[0]],
            [begin, lanes[0]],
        ];
    }

    fn add_ring(&mut self, noise: &mut Noise) {
        let (length_m, width_m, corridor_m) =
            (noise.between(18.0, 60.0), noise.between(14.0, 40.0), noise.between(1.8, 2.6));
        let inner = [length_m - corridor_m, width_m - corridor_m];
        self.add_box([0.0, 0.0], [length_m, width_m]);
        self.add_box([corridor_m, corridor_m], inner);
        let middle_m = corridor_m / 2.0;
        let corners = [
            [middle_m, middle_m],
            [length_m - middle_m, middle_m],
            [length_m - middle_m, width_m - middle_m],
            [middle_m, width_m - middle_m],
        ];
        self.route = corners.into_iter().chain(corners).chain([corners[0]]).collect();
        // Recesses and radiators stand a little into the corridor.
        for _ in 0..(length_m + width_m) as usize / 3 {
            let depth_m = noise.between(0.1, 0.25);
            let x_m = noise.between(0.0, length_m - 1.0);
            let y_m = if noise.uniform() < 0.5 { 0.0 } else { width_m - depth_m };
            self.add_box([x_m, y_m], [x_m + noise.between(0.3, 1.0), y_m + depth_m]);
        }
    }

    fn add_corridor(&mut self, noise: &mut Noise) {
        let (length_m, width_m) = (noise.between(25.0, 60.0), noise.between(1.8, 2.6));
        self.add_box([0.0, -width_m / 2.0], [length_m, width_m / 2.0]);
        self.route = vec![[1.0, 0.0], [length_m - 1.0, 0.0], [1.0, 0.0]];
    }

    /// Adds rooms in a grid; the route goes through all of them in turns, and back to the first.
    fn add_rooms(&mut self, noise: &mut Noise, rooms: [usize; 2], size_m: [f64; 2], furniture: usize) {
        let mut edges = [vec![0.0], vec![0.0]];
        for (axis, places) in edges.iter_mut().enumerate() {
            for _ in 0..rooms[axis] {
                let last = places[places.len() - 1];
                places.push(last + noise.between(size_m[0], size_m[1]));
            }
        }
        let [xs, ys] = edges;
        let centre =
            |column: usize, row: usize| [(xs[column] + xs[column + 1]) / 2.0, (ys[row] + ys[row + 1]) / 2.0];
        self.add_box([0.0, 0.0], [xs[rooms[0]], ys[rooms[1]]]);
        for column in 0..rooms[0] {
            for row in 0..rooms[1] {
                if column > 0 {
                    let door_m = centre(column, row)[1] - ys[row];
                    self.add_wall_with_doors([xs[column], ys[row]], [xs[column], ys[row + 1]], &[door_m]);
                }
                if row > 0 {
                    let door_m = centre(column, row)[0] - xs[column];
                    self.add_wall_with_doors([xs[column], ys[row]], [xs[column + 1], ys[row]], &[door_m]);
                }
            }
        }
        for row in 0..rooms[1] {
            let columns: Vec<usize> =
                if row % 2 == 0 { (0..rooms[0]).collect() } else { (0..rooms[0]).rev().collect() };
            self.route.extend(columns.into_iter().map(|column| centre(column, row)));
        }
        let last = if rooms[1] % 2 == 1 { rooms[0] - 1 } else { 0 };
        self.route.extend((0..rooms[1]).rev().map(|row| centre(last, row)));
        self.route.extend((0..last).rev().map(|column| centre(column, 0)));
        for column in 0..rooms[0] {
            for row in 0..rooms[1] {
                self.rooms.push([[xs[column], ys[row]], [xs[column + 1], ys[row + 1]]]);
            }
        }
        self.furnish(furniture, noise);
    }

    fn add_warehouse(&mut self, noise: &mut Noise) {
        let (shelves, aisle_m, shelf_m) = (3 + noise.below(4), noise.between(2.0, 3.0), 1.0);
        let (length_m, margin_m) = (noise.between(12.0, 30.0), 2.5);
        let pitch_m = aisle_m + shelf_m;
        let width_m = shelves as f64 * pitch_m + aisle_m;
        self.add_box([0.0, 0.0], [length_m + 2.0 * margin_m, width_m]);
        for shelf in 0..shelves {
            let y_m = aisle_m + shelf as f64 * pitch_m;
            self.add_box([margin_m, y_m], [margin_m + length_m, y_m + shelf_m]);
        }
        let ends = [margin_m / 2.0, length_m + 1.5 * margin_m];
        for aisle in 0..=shelves {
            let y_m = aisle_m / 2.0 + aisle as f64 * pitch_m;
            let [from, to] = if aisle % 2 == 0 { ends } else { [ends[1], ends[0]] };
            self.route.extend([[from, y_m], [to, y_m]]);
        }
        let last_x = self.route[self.route.len() - 1][0];
        self.route.extend([[last_x, aisle_m / 2.0], [ends[0], aisle_m / 2.0]]);
    }

    fn add_campus(&mut self, noise: &mut Noise) {
        let (blocks, block_m, street_m) =
            (2 + noise.below(2), noise.between(10.0, 18.0), noise.between(8.0, 16.0));
        let pitch_m = block_m + street_m;
        let size_m = blocks as f64 * pitch_m + street_m;
        for column in 0..blocks {
            for row in 0..blocks {
                let low = [street_m + column as f64 * pitch_m, street_m + row as f64 * pitch_m];
                let size = [block_m * noise.between(0.6, 1.0), block_m * noise.between(0.6, 1.0)];
                self.add_box(low, [low[0] + size[0], low[1] + size[1]]);
            }
        }
        let (near, far) = (street_m / 2.0, size_m - street_m / 2.0);
        let middle = street_m / 2.0 + pitch_m;
        let loop_around = [[near, near], [far, near], [far, far], [near, far], [near, near]];
        self.route.extend(loop_around);
        self.route.extend([[middle, near], [middle, far], [near, far], [near, near]]);
        for _ in 0..blocks * 6 {
            // Trees and posts.
            let place = [noise.between(0.0, size_m), noise.between(0.0, size_m)];
            if self.route.windows(2).all(|leg| distance_to_segment(place, leg[0], leg[1]) > 1.5) {
                self.add_box(place, [place[0] + 0.3, place[1] + 0.3]);
            }
        }
    }
}

/// Returns the distance between two points, metres.
pub fn distance(a: Point, b: Point) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

fn distance_to_segment(point: Point, from: Point, to: Point) -> f64 {
    let (dx, dy) = (to[0] - from[0], to[1] - from[1]);
    let length2 = (dx * dx + dy * dy).max(1e-12);
    let share = (((point[0] - from[0]) * dx + (point[1] - from[1]) * dy) / length2).clamp(0.0, 1.0);
    distance(point, [from[0] + share * dx, from[1] + share * dy])
}
