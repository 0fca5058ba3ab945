//! A small flat world in which the tour is rehearsed: walls and furniture as line segments, robots as discs, a
//! perfect mapper. No physics, no SLAM, no IPC: what is tested is the operator alone.

use msg::grid::{Occupancy, occupancy};
use msg::pose::wrap_angle;
use msg::{Grid, GridHeader, Link, LinkTransform, Pose2, RobotId, Scan, Stamp, Transforms, VelocityCommand};
use nav::joystick::{Joystick, Twist};
use nav::sight::{BURGER_BASE_FROM_SCAN, MapView, RobotSight, ScanView, Sight};
use nav::tour::{Tour, TourConfig};
use std::collections::VecDeque;
use std::fmt::Write as _;
use std::path::Path;

const RADIUS_M: f64 = 0.105;
const RANGE_MAX_M: f64 = 3.5;
const BEAMS: usize = 180;
const STEP_S: f64 = 0.05;
const CELL_M: f64 = 0.05;

type Segment = [[f64; 2]; 2];

pub(super) struct Room {
    segments: Vec<Segment>,
    size_m: [f64; 2],
}

impl Room {
    /// 6 m x 8 m: tables by their legs, shelves, a sofa, a partition with a door, a column off the grid's axes.
    fn lab() -> Self {
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
        let place = Pose2::new(x, y, yaw_rad);
        let corners = [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]];
        let corners = corners.map(|[u, v]| place.apply([u * width, v * depth]));
        self.segments.extend((0..4).map(|i| [corners[i], corners[(i + 1) % 4]]));
    }

    fn free_radius_m(&self, point: [f64; 2]) -> f64 {
        self.segments.iter().map(|segment| point_to_segment_m(point, segment)).fold(f64::INFINITY, f64::min)
    }

    fn range_m(&self, from: [f64; 2], direction: [f64; 2]) -> f64 {
        self.segments.iter().filter_map(|s| ray_segment_m(from, direction, s)).fold(f64::INFINITY, f64::min)
    }

    /// Cells of floor connected with `start`.
    fn floor_cells(&self, start: [f64; 2]) -> Vec<bool> {
        let (width, height) = self.grid_size();
        let mut floor = vec![false; width * height];
        let cell = |p: [f64; 2]| ((p[0] / CELL_M) as usize, (p[1] / CELL_M) as usize);
        let mut stack = vec![cell(start)];
        while let Some((x, y)) = stack.pop() {
            let centre = [(x as f64 + 0.5) * CELL_M, (y as f64 + 0.5) * CELL_M];
            if floor[y * width + x] || self.free_radius_m(centre) < CELL_M * 0.71 {
                continue;
            }
            floor[y * width + x] = true;
            stack.extend([(x + 1, y), (x - 1, y), (x, y + 1), (x, y - 1)]);
        }
        floor
    }

    fn grid_size(&self) -> (usize, usize) {
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
    let half = (RADIUS_M * RADIUS_M - off2).sqrt();
    (half.is_finite() && along - half > 0.0).then_some(along - half)
}

pub(super) struct Body {
    pose: Pose2,
    twist: Twist,
    ranges_m: Vec<f32>,
    track: Vec<[f64; 2]>,
    first_yaw_rad: f64,
}

/// How one rehearsal goes.
#[derive(Clone, Copy)]
pub(super) struct Script {
    pub robots: usize,
    pub seed: u64,
    pub seconds: f64,
    pub all_at_once: bool,
    /// At this time the map turns and moves under the robots, as when a loop closes.
    pub shift_at_s: f64,
    /// Amplitude of the pose's error, metres.
    pub pose_error_m: f64,
}

impl Default for Script {
    fn default() -> Self {
        Self {
            robots: 1,
            seed: 1,
            seconds: 300.0,
            all_at_once: false,
            shift_at_s: f64::MAX,
            pose_error_m: 0.01,
        }
    }
}

/// What came of it.
pub(super) struct Outcome {
    /// Share of the room's floor in the map, by 10 s.
    pub coverage: Vec<f64>,
    /// Steps in which a robot was stopped by a wall or another robot.
    pub bumps: u32,
    /// Everything said, for comparison.
    pub transcript: Vec<u8>,
    pub tour: Tour,
}

pub(super) struct World {
    room: Room,
    bodies: Vec<Body>,
    grid: Grid,
    /// Maps under way to the operator.
    post: VecDeque<Grid>,
    map_from_world: Pose2,
    bumps: u32,
}

impl World {
    pub(super) fn new(robots: usize, seed: u64) -> Self {
        let room = Room::lab();
        // The fleet starts side by side, at another place for each seed.
        let corners = [
            Pose2::new(0.6, 0.6, 0.5),
            Pose2::new(5.0, 7.0, -2.5),
            Pose2::new(3.4, 1.6, 1.6),
            Pose2::new(1.0, 6.0, 3.0),
        ];
        let first = corners[(seed % 4) as usize];
        let starts = [0.0, 0.45, -0.45].map(|y_m| first * Pose2::new(0.0, y_m, 0.0));
        let body = |pose: &Pose2| Body {
            pose: *pose,
            twist: Twist::STOP,
            ranges_m: Vec::new(),
            track: Vec::new(),
            first_yaw_rad: pose.yaw_rad,
        };
        let (width, height) = room.grid_size();
        // Half a metre of margin, so that the outer walls lie in the grid.
        let (width, height) = (width as u32 + 20, height as u32 + 20);
        let header = GridHeader {
            resolution_m: CELL_M,
            width,
            height,
            origin: Pose2::new(-0.5, -0.5, 0.0),
            ..Default::default()
        };
        let grid = Grid { header, cells: vec![msg::grid::UNKNOWN; (width * height) as usize] };
        let bodies = starts[..robots].iter().map(body).collect();
        Self { room, bodies, grid, post: VecDeque::new(), map_from_world: Pose2::IDENTITY, bumps: 0 }
    }

    /// What a robot is told.
    pub(super) fn obey(&mut self, robot: RobotId, command: &VelocityCommand) {
        let VelocityCommand { linear_m_s, angular_rad_s, .. } = *command;
        self.bodies[robot.index()].twist = Twist { linear_m_s, angular_rad_s };
    }

    /// One step of [`STEP_S`].
    pub(super) fn step(&mut self, step: u64) {
        self.move_bodies();
        if step.is_multiple_of(2) {
            self.scan_and_map();
        }
    }

    /// How far a robot has turned from how it stood at first.
    pub(super) fn turned_rad(&self, index: usize) -> f64 {
        wrap_angle(self.bodies[index].pose.yaw_rad - self.bodies[index].first_yaw_rad)
    }

    /// What simulators, SLAM and merging would send at this step. Odometry is perfect, all frames are one.
    pub(super) fn tell(&self, bridge: &bridge::Bridge, step: u64, now: Stamp) {
        use bridge::FleetMessage;
        let header = msg::Header { stamp: now, ..Default::default() };
        let mut map_transforms = msg::MapTransforms { header, ..Default::default() };
        bridge.publish(FleetMessage::Clock(&msg::Clock { header }));
        for (i, body) in self.bodies.iter().enumerate() {
            let robot = RobotId::new(i + 1).unwrap();
            map_transforms.robots[i].known = 1;
            bridge.publish(FleetMessage::Transforms(robot, &transforms(header, body.pose)));
            if step.is_multiple_of(2) {
                bridge.publish(FleetMessage::Scan(robot, &scan_message(header, &body.ranges_m)));
                bridge.publish(FleetMessage::Correction(
                    robot,
                    &msg::Correction { header, ..Default::default() },
                ));
            }
        }
        bridge.publish(FleetMessage::MapTransforms(&map_transforms));
        if step.is_multiple_of(20) {
            bridge.publish(FleetMessage::MergedMap(self.grid.view()));
        }
    }

    fn move_bodies(&mut self) {
        for i in 0..self.bodies.len() {
            let body = &self.bodies[i];
            let Twist { linear_m_s, angular_rad_s } = body.twist;
            let half = Pose2::new(0.0, 0.0, angular_rad_s * STEP_S / 2.0);
            let next = body.pose * half * Pose2::new(linear_m_s * STEP_S, 0.0, 0.0) * half;
            let place = [next.x_m, next.y_m];
            let meets = |other: &Body| other.pose.distance_m(next) < 2.0 * RADIUS_M;
            let bumped = self.room.free_radius_m(place) < RADIUS_M
                || self.bodies.iter().enumerate().any(|(k, other)| k != i && meets(other));
            let body = &mut self.bodies[i];
            let turned = Pose2::new(body.pose.x_m, body.pose.y_m, next.yaw_rad);
            self.bumps += u32::from(bumped && linear_m_s != 0.0);
            body.pose = if bumped { turned } else { next };
            body.track.push([body.pose.x_m, body.pose.y_m]);
        }
    }

    fn scan_and_map(&mut self) {
        for i in 0..self.bodies.len() {
            let sensor = self.bodies[i].pose * BURGER_BASE_FROM_SCAN;
            let from = [sensor.x_m, sensor.y_m];
            let mut ranges_m = Vec::with_capacity(BEAMS);
            for beam in 0..BEAMS {
                let angle = sensor.yaw_rad + beam_angle_rad(beam);
                let direction = [angle.cos(), angle.sin()];
                let others = self.bodies.iter().enumerate().filter(|(k, _)| *k != i);
                let peers = others.filter_map(|(_, b)| ray_disc_m(from, direction, [b.pose.x_m, b.pose.y_m]));
                let range = peers.fold(self.room.range_m(from, direction), f64::min);
                self.draw(from, direction, range);
                ranges_m.push(if range < RANGE_MAX_M { range as f32 } else { f32::INFINITY });
            }
            self.bodies[i].ranges_m = ranges_m;
        }
    }

    fn draw(&mut self, from: [f64; 2], direction: [f64; 2], range: f64) {
        let width = self.grid.header.width as i64;
        let cell = |t: f64| {
            let p = [from[0] + t * direction[0], from[1] + t * direction[1]];
            ((((p[1] + 0.5) / CELL_M) as i64 * width) + ((p[0] + 0.5) / CELL_M) as i64) as usize
        };
        let hit = (range < RANGE_MAX_M).then(|| cell(range + 0.005));
        let mut last = usize::MAX;
        for i in 0..(range.min(RANGE_MAX_M) / 0.025) as usize {
            let at = cell(i as f64 * 0.025);
            if at != last && Some(at) != hit {
                add(&mut self.grid.cells[at], -8);
            }
            last = at;
        }
        if let Some(hit) = hit {
            add(&mut self.grid.cells[hit], 17);
        }
    }

    fn coverage(&self, floor: &[bool]) -> f64 {
        let (width, _) = self.room.grid_size();
        let seen = |i: usize| {
            let (x, y) = (i % width + 10, i / width + 10);
            occupancy(self.grid.cells[y * self.grid.header.width as usize + x]) == Occupancy::Free
        };
        let cells = floor.iter().enumerate().filter(|(_, is)| **is);
        let (all, known) = cells.fold((0, 0), |(all, known), (i, _)| (all + 1, known + usize::from(seen(i))));
        f64::from(known as u32) / f64::from(all)
    }
}

fn transforms(header: msg::Header, odom_from_base: Pose2) -> Transforms {
    let (translation_m, rotation_xyzw) = bridge::ros::write::spatial(odom_from_base);
    let mut message = Transforms { header, len: 1, ..Default::default() };
    let (parent, child) = (Link::Odom as u32, Link::BaseFootprint as u32);
    message.links[0] = LinkTransform { parent, child, translation_m, rotation_xyzw };
    message
}

fn scan_message(header: msg::Header, ranges_m: &[f32]) -> Scan {
    let mut scan = Scan {
        header,
        angle_min_rad: beam_angle_rad(0) as f32,
        angle_increment_rad: (beam_angle_rad(1) - beam_angle_rad(0)) as f32,
        time_increment_s: 0.0,
        scan_time_s: 0.1,
        range_min_m: 0.12,
        range_max_m: RANGE_MAX_M as f32,
        len: ranges_m.len() as u32,
        reserved: 0,
        ranges_m: [f32::NAN; msg::BEAMS_MAX],
    };
    scan.ranges_m[..ranges_m.len()].copy_from_slice(ranges_m);
    scan
}

fn beam_angle_rad(beam: usize) -> f64 {
    ((beam as f64 + 0.5) / BEAMS as f64 - 0.5) * core::f64::consts::FRAC_PI_2
}

fn add(cell: &mut i8, evidence: i8) {
    let before = if *cell == msg::grid::UNKNOWN { 0 } else { *cell };
    *cell = before.saturating_add(evidence).max(-127);
}

/// Runs a tour in the lab.
pub(super) fn rehearse(script: Script) -> Outcome {
    let mut world = World::new(script.robots, script.seed);
    let config = TourConfig { seed: script.seed, ..Default::default() };
    let mut tour = Tour::new(config, RobotId::first(script.robots)).unwrap();
    let floor = world.room.floor_cells([0.6, 0.6]);
    let mut outcome = (Vec::new(), Vec::new());
    let mut hands = Vec::new();
    for step in 0..(script.seconds / STEP_S) as u64 {
        let now_s = step as f64 * STEP_S;
        if (now_s - script.shift_at_s).abs() < STEP_S / 2.0 {
            world.map_from_world = Pose2::new(0.4, -0.3, 0.12);
        }
        if step.is_multiple_of(2) {
            world.scan_and_map();
        }
        if step.is_multiple_of(20) {
            let mut grid = world.grid.clone();
            grid.header.origin = world.map_from_world * grid.header.origin;
            world.post.push_back(grid);
            if world.post.len() > 2 {
                world.post.pop_front();
            }
        }
        if step.is_multiple_of(200) {
            outcome.0.push(world.coverage(&floor));
        }
        one_step(&mut world, &mut tour, &script, now_s, &mut hands);
        for hand in &hands {
            outcome.1.extend(hand.stick.forward.to_bits().to_le_bytes());
            outcome.1.extend(hand.stick.left.to_bits().to_le_bytes());
        }
    }
    outcome.0.push(world.coverage(&floor));
    draw_picture(&world, &script);
    Outcome { coverage: outcome.0, bumps: world.bumps, transcript: outcome.1, tour }
}

fn one_step(
    world: &mut World,
    tour: &mut Tour,
    script: &Script,
    now_s: f64,
    hands: &mut Vec<nav::tour::Hand>,
) {
    let stamp = Stamp::from_seconds(now_s);
    let map = world.post.front().and_then(|grid| MapView::log_odds(grid.view()));
    let bodies = world.bodies.iter().enumerate();
    let robots: Vec<RobotSight> =
        bodies.map(|(i, body)| see(i, body, map, stamp, script, world.map_from_world)).collect();
    let sight = Sight { stamp, robots: &robots };
    if script.all_at_once {
        tour.step_all(&sight, hands);
    } else {
        hands.clear();
        hands.push(tour.step(&sight));
    }
    drop(robots);
    world.bodies.iter_mut().for_each(|body| body.twist = Twist::STOP);
    for hand in hands.iter() {
        world.bodies[hand.robot.index()].twist = Joystick::default().twist(hand.stick);
    }
    world.move_bodies();
}

fn see<'a>(
    index: usize,
    body: &'a Body,
    map: Option<MapView<'a>>,
    stamp: Stamp,
    script: &Script,
    map_from_world: Pose2,
) -> RobotSight<'a> {
    // An error that swings slowly, as a scan matcher's does.
    let swing = (stamp.seconds() * 0.7 + index as f64 * 2.0).sin() * script.pose_error_m;
    RobotSight {
        robot: RobotId::new(index + 1).unwrap(),
        map,
        merged: true,
        map_from_base: Some(map_from_world * body.pose * Pose2::new(swing, -swing, swing)),
        scan: Some(ScanView {
            seen: stamp,
            base_from_scan: BURGER_BASE_FROM_SCAN,
            angle_min_rad: beam_angle_rad(0),
            angle_increment_rad: beam_angle_rad(1) - beam_angle_rad(0),
            range_min_m: 0.12,
            range_max_m: RANGE_MAX_M,
            ranges_m: &body.ranges_m,
        }),
    }
}

/// Map and tracks as a PNG in the folder that the environment names, for people to look at.
fn draw_picture(world: &World, script: &Script) {
    let Some(folder) = std::env::var_os("OPERATOR_PICTURES") else { return };
    let scale = 5;
    let (width, height) = (world.grid.header.width as usize, world.grid.header.height as usize);
    let mut pixels = vec![[0_u8; 3]; width * height * scale * scale];
    let row = |y: usize| height * scale - 1 - y;
    for (i, pixel) in (0..pixels.len()).map(|i| (i, (i % (width * scale), i / (width * scale)))) {
        let cell = world.grid.cells[(pixel.1 / scale) * width + pixel.0 / scale];
        let grey = match occupancy(cell) {
            Occupancy::Free => 255,
            Occupancy::Occupied => 0,
            Occupancy::Unknown => 160,
        };
        pixels[row(i / (width * scale)) * width * scale + pixel.0] = [grey; 3];
    }
    let colours = [[220, 30, 30], [30, 120, 220], [20, 160, 60], [200, 140, 0]];
    for (body, colour) in world.bodies.iter().zip(colours) {
        for point in &body.track {
            let [x, y] = point.map(|v| ((v + 0.5) / CELL_M * scale as f64) as usize);
            pixels[row(y) * width * scale + x] = colour;
        }
    }
    let mut name = String::new();
    let mode = if script.all_at_once { "all" } else { "turns" };
    write!(name, "tour_{}robots_{mode}_seed{}.png", script.robots, script.seed).unwrap();
    let file = std::fs::File::create(Path::new(&folder).join(name)).unwrap();
    let mut encoder = png::Encoder::new(file, (width * scale) as u32, (height * scale) as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.write_header().unwrap().write_image_data(pixels.as_flattened()).unwrap();
}

mod tests;
