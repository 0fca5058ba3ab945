//! A small flat world for tests: walls and furniture as line segments, robots as discs, and a mapper that knows
//! every robot's pose.
//!
//! No physics, SLAM or transport: a test with it is a test of exploration alone, and 300 s pass within a second.

mod room;

pub use room::Room;

use crate::command::Twist;
use crate::observation::BURGER_BASE_FROM_SCAN;
use msg::grid::{LOG_ODDS_MIN, Occupancy, UNKNOWN, occupancy};
use msg::pose::wrap_angle;
use msg::{Grid, GridHeader, Pose2, RobotId};

/// Radius of a robot, metres.
const ROBOT_RADIUS_M: f64 = 0.105;
/// Radius of a person as the LiDAR sees one, metres.
const PERSON_RADIUS_M: f64 = 0.2;
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

/// A room with robots and people in it.
#[derive(Clone, Debug)]
pub struct TestWorld {
    room: Room,
    robots: Vec<TestRobot>,
    people_m: Vec<[f64; 2]>,
    map: Grid,
    known_map: Grid,
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
    /// A furnished room of 6 m by 8 m with up to three robots side by side; the seed selects one of four places.
    pub fn new(robots: usize, seed: u64) -> Self {
        let starts = [
            Pose2::new(0.6, 0.6, 0.5),
            Pose2::new(5.0, 7.0, -2.5),
            Pose2::new(3.4, 1.6, 1.6),
            Pose2::new(1.0, 6.0, 3.0),
        ];
        let first = starts[(seed % 4) as usize];
        let start = |y_m: &f64| first * Pose2::new(0.0, *y_m, 0.0);
        let starts: Vec<Pose2> = [0.0, 0.45, -0.45][..robots].iter().map(start).collect();
        Self::with_room(Room::furnished(), &starts)
    }

    /// A room with robots at these poses.
    pub fn with_room(room: Room, starts: &[Pose2]) -> Self {
        let robot = |start: &Pose2| TestRobot {
            pose: *start,
            start: *start,
            twist: Twist::STOP,
            ranges_m: Vec::new(),
        };
        let robots: Vec<TestRobot> = starts.iter().map(robot).collect();
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
        let known_map = Grid { header, cells: known_cells(&room, (width, height), starts) };
        Self { room, robots, people_m: Vec::new(), map, known_map, bumps: 0 }
    }

    /// Sets where people stand: obstacles that scans show and the known map does not.
    pub fn set_people(&mut self, people_m: Vec<[f64; 2]>) {
        self.people_m = people_m;
    }

    /// Map of the room as it is known from an earlier visit: without robots and people.
    pub fn known_map(&self) -> &Grid {
        &self.known_map
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

    /// Sets a robot down at a pose, as a person who has driven it there.
    pub fn place(&mut self, index: usize, pose: Pose2) {
        self.robots[index].pose = pose;
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

    /// Distance from a point to the nearest wall or piece of furniture, metres.
    pub fn clearance_m(&self, point_m: [f64; 2]) -> f64 {
        self.room.clearance_m(point_m)
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
            let touches_person =
                |at: &[f64; 2]| (at[0] - next.x_m).hypot(at[1] - next.y_m) < ROBOT_RADIUS_M + PERSON_RADIUS_M;
            let is_blocked = self.room.clearance_m([next.x_m, next.y_m]) < ROBOT_RADIUS_M
                || self.people_m.iter().any(touches_person)
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
                let to_others = others.filter_map(|(_, o)| {
                    ray_disc_m(from, direction, [o.pose.x_m, o.pose.y_m], ROBOT_RADIUS_M)
                });
                let to_people =
                    self.people_m.iter().filter_map(|at| ray_disc_m(from, direction, *at, PERSON_RADIUS_M));
                let range_m = to_others.chain(to_people).fold(self.room.range_m(from, direction), f64::min);
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

/// Cells of a map that shows the room's walls and the floor that the first robot can get to.
fn known_cells(room: &Room, (width, height): (usize, usize), starts: &[Pose2]) -> Vec<i8> {
    let floor = starts.first().map_or(Vec::new(), |start| room.floor_cells([start.x_m, start.y_m]));
    let (room_width, room_height) = room.size_cells();
    let cell = |i: usize| {
        let (x, y) = ((i % width) as f64 + 0.5, (i / width) as f64 + 0.5);
        let point = [x * CELL_M - MARGIN_M, y * CELL_M - MARGIN_M];
        // A wall between two cells is part of both.
        if room.clearance_m(point) < CELL_M * 0.6 {
            return i8::MAX;
        }
        let column = (i % width).checked_sub(MARGIN_CELLS).filter(|x| *x < room_width);
        let row = (i / width).checked_sub(MARGIN_CELLS).filter(|y| *y < room_height);
        match column.zip(row) {
            Some((x, y)) if floor.get(y * room_width + x) == Some(&true) => LOG_ODDS_MIN,
            _ => UNKNOWN,
        }
    };
    (0..width * height).map(cell).collect()
}

fn add_evidence(cell: &mut i8, evidence: i8) {
    let before = if *cell == UNKNOWN { 0 } else { *cell };
    *cell = before.saturating_add(evidence).max(LOG_ODDS_MIN);
}

fn ray_disc_m(o: [f64; 2], d: [f64; 2], centre: [f64; 2], radius_m: f64) -> Option<f64> {
    let (cx, cy) = (centre[0] - o[0], centre[1] - o[1]);
    let along = cx * d[0] + cy * d[1];
    let off2 = cx * cx + cy * cy - along * along;
    let half = (radius_m * radius_m - off2).sqrt();
    (half.is_finite() && along - half > 0.0).then_some(along - half)
}
