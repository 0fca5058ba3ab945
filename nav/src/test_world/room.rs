//! Rooms of the test world: walls and furniture as line segments.

use super::CELL_M;
use msg::Pose2;

type Segment = [[f64; 2]; 2];

/// A room of the test world.
#[derive(Clone, Debug)]
pub struct Room {
    segments: Vec<Segment>,
    size_m: [f64; 2],
}

impl Room {
    /// 6 m by 8 m: tables by their legs, shelves, a sofa, a partition with a door, and a column at an angle to the grid.
    pub(super) fn furnished() -> Self {
        let mut room = Self { segments: Vec::new(), size_m: [6.0, 8.0] };
        room.block([3.0, 4.0], [6.0, 8.0], 0.0);
        room.block([0.9, 7.7], [1.6, 0.4], 0.0);
        room.block([5.7, 5.8], [0.5, 1.8], 0.0);
        room.block([2.2, 1.0], [0.9, 0.5], 0.0);
        room.block([4.6, 0.5], [0.8, 0.8], 0.3);
        room.block([4.2, 2.9], [0.6, 0.6], 0.7);
        // The partition, with a door of 0.9 m.
        room.block([0.9, 4.5], [1.8, 0.1], 0.0);
        room.block([4.1, 4.5], [2.8, 0.1], 0.0);
        // A table's legs.
        for [x, y] in [[1.2, 2.4], [2.2, 2.4], [1.2, 3.2], [2.2, 3.2]] {
            room.block([x, y], [0.06, 0.06], 0.0);
        }
        for [x, y] in [[3.0, 6.0], [4.2, 6.0], [3.0, 6.8], [4.2, 6.8]] {
            room.block([x, y], [0.06, 0.06], 0.0);
        }
        room
    }

    /// Two rooms of 3 m by 4 m side by side, with a door of this width in the wall of 0.1 m between them.
    pub fn with_door(door_m: f64) -> Self {
        let mut room = Self { segments: Vec::new(), size_m: [6.0, 4.0] };
        room.block([3.0, 2.0], [6.0, 4.0], 0.0);
        let wall_m = (4.0 - door_m) / 2.0;
        room.block([3.0, wall_m / 2.0], [0.1, wall_m], 0.0);
        room.block([3.0, 4.0 - wall_m / 2.0], [0.1, wall_m], 0.0);
        room
    }

    /// A corridor of 10 m by this width.
    pub fn corridor(width_m: f64) -> Self {
        let mut room = Self { segments: Vec::new(), size_m: [10.0, width_m] };
        room.block([5.0, width_m / 2.0], [10.0, width_m], 0.0);
        room
    }

    fn block(&mut self, [x, y]: [f64; 2], [width, depth]: [f64; 2], yaw_rad: f64) {
        let pose = Pose2::new(x, y, yaw_rad);
        let corners = [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]];
        let corners = corners.map(|[u, v]| pose.apply([u * width, v * depth]));
        self.segments.extend((0..4).map(|i| [corners[i], corners[(i + 1) % 4]]));
    }

    pub(super) fn clearance_m(&self, point: [f64; 2]) -> f64 {
        self.segments.iter().map(|segment| point_to_segment_m(point, segment)).fold(f64::INFINITY, f64::min)
    }

    pub(super) fn range_m(&self, from: [f64; 2], direction: [f64; 2]) -> f64 {
        self.segments.iter().filter_map(|s| ray_segment_m(from, direction, s)).fold(f64::INFINITY, f64::min)
    }

    pub(super) fn floor_cells(&self, start: [f64; 2]) -> Vec<bool> {
        let (width, height) = self.size_cells();
        let mut floor = vec![false; width * height];
        let cell = |p: [f64; 2]| ((p[0] / CELL_M) as usize, (p[1] / CELL_M) as usize);
        let mut stack = vec![cell(start)];
        while let Some((x, y)) = stack.pop() {
            let centre = [(x as f64 + 0.5) * CELL_M, (y as f64 + 0.5) * CELL_M];
            if floor[y * width + x] || self.clearance_m(centre) < CELL_M * 0.71 {
                continue;
            }
            floor[y * width + x] = true;
            stack.extend([(x + 1, y), (x - 1, y), (x, y + 1), (x, y - 1)]);
        }
        floor
    }

    pub(super) fn size_cells(&self) -> (usize, usize) {
        ((self.size_m[0] / CELL_M) as usize, (self.size_m[1] / CELL_M) as usize)
    }
}

fn point_to_segment_m(p: [f64; 2], [a, b]: &Segment) -> f64 {
    let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
    let t = ((p[0] - a[0]) * dx + (p[1] - a[1]) * dy) / (dx * dx + dy * dy);
    let t = t.clamp(0.0, 1.0);
    (a[0] + t * dx - p[0]).hypot(a[1] + t * dy - p[1])
}

fn ray_segment_m(o: [f64; 2], d: [f64; 2], [a, b]: &Segment) -> Option<f64> {
    let (ex, ey) = (b[0] - a[0], b[1] - a[1]);
    let cross = d[0] * ey - d[1] * ex;
    let (ax, ay) = (a[0] - o[0], a[1] - o[1]);
    let (t, u) = ((ax * ey - ay * ex) / cross, (ax * d[1] - ay * d[0]) / cross);
    (cross.abs() > 1e-12 && t > 0.0 && (0.0..=1.0).contains(&u)).then_some(t)
}
