//! A small flat world for tests: walls and furniture as line segments, robots as discs, and a mapper that knows
//! every robot's pose.
//!
//! No physics, SLAM or transport: a test with it is a test of exploration alone, and 300 s pass within a second.

use crate::command::Twist;
use crate::observation::BURGER_BASE_FROM_SCAN;
use msg::grid::{LOG_ODDS_MIN, Occupancy, UNKNOWN, occupancy};
use msg::pose::wrap_angle;
use msg::{Grid, GridHeader, Pose2, RobotId};

/// Radius of a robot, metres.
const ROBOT_RADIUS_M: f64 = 0.105;
/// Longest range of the LiDAR, metres.
pub const RANGE_MAX_M: f64 = 3.5;
/// Shortest range of the LiDAR, metres.
pub const RANGE_MIN_M: f64 = 0.12;
/// Beams of a scan, over a quarter of a turn ahead.
const BEAMS: usize = 180;
/// Length of a step, seconds.
pub const STEP_S: f64 = 0.05;
/// Side of a cell of the map, metres.
const CELL_M: f64 = 0.05;
/// Cells of the map outside the room, so that it shows the outer walls.
const MARGIN_CELLS: usize = 10;
const MARGIN_M: f64 = MARGIN_CELLS as f64 * CELL_M;
/// Log-odds of one beam that ends in a cell, and of one that passes through it.
const HIT: i8 = 17;
const MISS: i8 = -8;

type Segment = [[f64; 2]; 2];

/// A furnished room of 6 m by 8 m with robots in it.
#[derive(Clone, Debug)]
pub struct TestWorld {
    room: Room,
    robots: Vec<TestRobot>,
    map: Grid,
    bumps: u32,
}

#[derive(Clone, Debug)]
struct TestRobot {
    pose: Pose2,
    start: Pose2,
    twist: Twist,
    ranges_m: Vec<f32>,
}

impl TestWorld {
    /// A world with up to three robots side by side; the seed selects one of four places.
    pub fn new(robots: usize, seed: u64) -> Self {
        let starts = [
            Pose2::new(0.6, 0.6, 0.5),
            Pose2::new(5.0, 7.0, -2.5),
            Pose2::new(3.4, 1.6, 1.6),
            Pose2::new(1.0, 6.0, 3.0),
        ];
        let first = starts[(seed % 4) as usize];
        let robot = |y_m: &f64| {
            let start = first * Pose2::new(0.0, *y_m, 0.0);
            TestRobot { pose: start, start, twist: Twist::STOP, ranges_m: Vec::new() }
        };
        let robots = [0.0, 0.45, -0.45][..robots].iter().map(robot).collect();
        let room = Room::furnished();
        let (width, height) = room.size_cells();
        let (width, height) = (width + 2 * MARGIN_CELLS, height + 2 * MARGIN_CELLS);
        let header = GridHeader {
            resolution_m: CELL_M,
            width: width as u32,
            height: height as u32,
            origin: Pose2::new(-MARGIN_M, -MARGIN_M, 0.0),
            ..Default::default()
        };
        let map = Grid { header, cells: vec![UNKNOWN; width * height] };
        Self { room, robots, map, bumps: 0 }
    }

    /// Sets the velocity that a robot drives from now on.
    pub fn set_velocity(&mut self, robot: RobotId, twist: Twist) {
        self.robots[robot.index()].twist = twist;
    }

    /// Stops all robots.
    pub fn stop_all(&mut self) {
        self.robots.iter_mut().for_each(|robot| robot.twist = Twist::STOP);
    }

    /// Number of robots.
    pub fn robot_count(&self) -> usize {
        self.robots.len()
    }

    /// True pose of a robot in the frame of the map.
    pub fn pose(&self, index: usize) -> Pose2 {
        self.robots[index].pose
    }

    /// Newest scan of a robot, metres; empty before the first.
    pub fn ranges_m(&self, index: usize) -> &[f32] {
        &self.robots[index].ranges_m
    }

    /// Angle by which a robot has turned since the start, radians in -pi..=pi.
    pub fn turned_rad(&self, index: usize) -> f64 {
        wrap_angle(self.robots[index].pose.yaw_rad - self.robots[index].start.yaw_rad)
    }

    /// Map of what all robots have seen.
    pub fn map(&self) -> &Grid {
        &self.map
    }

    /// Number of steps in which a wall or a robot stopped a robot.
    pub fn bumps(&self) -> u32 {
        self.bumps
    }

    /// Moves all robots by one step of 0.05 s.
    pub fn move_robots(&mut self) {
        for i in 0..self.robots.len() {
            let robot = &self.robots[i];
            let Twist { linear_m_s, angular_rad_s } = robot.twist;
            let half_turn = Pose2::new(0.0, 0.0, angular_rad_s * STEP_S / 2.0);
            let next = robot.pose * half_turn * Pose2::new(linear_m_s * STEP_S, 0.0, 0.0) * half_turn;
            let touches = |other: &TestRobot| other.pose.distance_m(next) < 2.0 * ROBOT_RADIUS_M;
            let is_blocked = self.room.clearance_m([next.x_m, next.y_m]) < ROBOT_RADIUS_M
                || self.robots.iter().enumerate().any(|(k, other)| k != i && touches(other));
            let turned = Pose2::new(robot.pose.x_m, robot.pose.y_m, next.yaw_rad);
            self.bumps += u32::from(is_blocked && linear_m_s != 0.0);
            self.robots[i].pose = if is_blocked { turned } else { next };
        }
    }

    /// Takes a scan of each robot and draws it into the map.
    pub fn scan_and_map(&mut self) {
        for i in 0..self.robots.len() {
            let sensor = self.robots[i].pose * BURGER_BASE_FROM_SCAN;
            let from = [sensor.x_m, sensor.y_m];
            let mut ranges_m = Vec::with_capacity(BEAMS);
            for beam in 0..BEAMS {
                let angle_rad = sensor.yaw_rad + beam_angle_rad(beam);
                let direction = [angle_rad.cos(), angle_rad.sin()];
                let others = self.robots.iter().enumerate().filter(|(k, _)| *k != i);
                let to_others =
                    others.filter_map(|(_, o)| ray_disc_m(from, direction, [o.pose.x_m, o.pose.y_m]));
                let range_m = to_others.fold(self.room.range_m(from, direction), f64::min);
                self.draw_beam(from, direction, range_m);
                ranges_m.push(if range_m < RANGE_MAX_M { range_m as f32 } else { f32::INFINITY });
            }
            self.robots[i].ranges_m = ranges_m;
        }
    }

    fn draw_beam(&mut self, from: [f64; 2], direction: [f64; 2], range_m: f64) {
        let width = self.map.header.width as i64;
        let cell_at = |t: f64| {
            let [x, y] = [0, 1].map(|k| ((from[k] + t * direction[k] + MARGIN_M) / CELL_M) as i64);
            (y * width + x) as usize
        };
        // A little behind the surface, so that rounding does not put the hit before it.
        let hit = (range_m < RANGE_MAX_M).then(|| cell_at(range_m + CELL_M / 10.0));
        let mut last = usize::MAX;
        for i in 0..(range_m.min(RANGE_MAX_M) / (CELL_M / 2.0)) as usize {
            let cell = cell_at(i as f64 * CELL_M / 2.0);
            if cell != last && Some(cell) != hit {
                add_evidence(&mut self.map.cells[cell], MISS);
            }
            last = cell;
        }
        if let Some(hit) = hit {
            add_evidence(&mut self.map.cells[hit], HIT);
        }
    }

    /// Cells of the room's floor that are connected with the first robot's start, row-major without margin.
    pub fn floor_cells(&self) -> Vec<bool> {
        let start = self.robots[0].start;
        self.room.floor_cells([start.x_m, start.y_m])
    }

    /// Share of these floor cells that the map shows as free, 0 to 1.
    pub fn coverage(&self, floor: &[bool]) -> f64 {
        let (width, _) = self.room.size_cells();
        let is_free = |i: usize| {
            let (x, y) = (i % width + MARGIN_CELLS, i / width + MARGIN_CELLS);
            occupancy(self.map.cells[y * self.map.header.width as usize + x]) == Occupancy::Free
        };
        let cells = || (0..floor.len()).filter(|i| floor[*i]);
        cells().filter(|i| is_free(*i)).count() as f64 / cells().count() as f64
    }
}

/// Direction of a beam in the sensor's frame, radians.
pub fn beam_angle_rad(beam: usize) -> f64 {
    ((beam as f64 + 0.5) / BEAMS as f64 - 0.5) * core::f64::consts::FRAC_PI_2
}

fn add_evidence(cell: &mut i8, evidence: i8) {
    let before = if *cell == UNKNOWN { 0 } else { *cell };
    *cell = before.saturating_add(evidence).max(LOG_ODDS_MIN);
}

#[derive(Clone, Debug)]
struct Room {
    segments: Vec<Segment>,
    size_m: [f64; 2],
}

impl Room {
    /// Tables by their legs, shelves, a sofa, a partition with a door, and a column at an angle to the grid.
    fn furnished() -> Self {
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

    fn block(&mut self, [x, y]: [f64; 2], [width, depth]: [f64; 2], yaw_rad: f64) {
        let pose = Pose2::new(x, y, yaw_rad);
        let corners = [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]];
        let corners = corners.map(|[u, v]| pose.apply([u * width, v * depth]));
        self.segments.extend((0..4).map(|i| [corners[i], corners[(i + 1) % 4]]));
    }

    fn clearance_m(&self, point: [f64; 2]) -> f64 {
        self.segments.iter().map(|segment| point_to_segment_m(point, segment)).fold(f64::INFINITY, f64::min)
    }

    fn range_m(&self, from: [f64; 2], direction: [f64; 2]) -> f64 {
        self.segments.iter().filter_map(|s| ray_segment_m(from, direction, s)).fold(f64::INFINITY, f64::min)
    }

    fn floor_cells(&self, start: [f64; 2]) -> Vec<bool> {
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

    fn size_cells(&self) -> (usize, usize) {
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

fn ray_disc_m(o: [f64; 2], d: [f64; 2], centre: [f64; 2]) -> Option<f64> {
    let (cx, cy) = (centre[0] - o[0], centre[1] - o[1]);
    let along = cx * d[0] + cy * d[1];
    let off2 = cx * cx + cy * cy - along * along;
    let half = (ROBOT_RADIUS_M * ROBOT_RADIUS_M - off2).sqrt();
    (half.is_finite() && along - half > 0.0).then_some(along - half)
}
