//! Draws a room's floor plan, and the paths and last scans of a fleet that drives in it by a simple rule.
//!
//! `cargo run -p sim --example look -- OUT.png [ROOM_FILE|KIND:SEED|-] [ROBOTS] [LIDAR] [SECONDS]`

use bytemuck::Zeroable;
use msg::grid::{Occupancy, occupancy};
use msg::{GroundTruth, Pose2, RobotId, Scan, VelocityCommand};
use sim::{LidarConfig, Room, SimConfig, Simulator};

const RESOLUTION_M: f64 = 0.025;
/// Number of pixels along a cell.
const SCALE: usize = 2;
const TICKS_PER_SECOND: usize = 100;
const BLUE: [u8; 3] = [30, 90, 220];
const RED: [u8; 3] = [220, 30, 30];
const COLOURS: [[u8; 3]; 4] = [[120, 170, 255], [120, 210, 120], [240, 180, 90], [210, 150, 230]];

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let out =
        arguments.next().ok_or("usage: look OUT.png [ROOM_FILE|KIND:SEED|-] [ROBOTS] [LIDAR] [SECONDS]")?;
    let room = match arguments.next().filter(|path| path != "-") {
        Some(path) => match Room::parse_generated(&path) {
            Some((kind, seed)) => Room::generate(kind, seed),
            None => Room::from_bytes(&path, &std::fs::read(&path)?)?,
        },
        None => Room::laboratory(),
    };
    let robots = arguments.next().map_or(Ok(3), |n| n.parse())?;
    let lidar = LidarConfig::preset(&arguments.next().unwrap_or("lds01".into())).ok_or("no such LiDAR")?;
    let seconds: usize = arguments.next().map_or(Ok(0), |n| n.parse())?;
    let config = SimConfig { lidar, ..SimConfig::default() };

    let mut picture = Picture::of(&room);
    let mut fleet = Vec::new();
    for (robot, start) in RobotId::first(robots).zip(room.starts(robots)?) {
        fleet.push(Driver::new(robot, Simulator::new(&room, &config, robot, start, 1)?));
    }
    for tick in 0..=seconds * TICKS_PER_SECOND {
        let truths: Vec<(RobotId, GroundTruth)> =
            fleet.iter().map(|driver| (driver.robot, driver.truth)).collect();
        for driver in &mut fleet {
            if tick > 0 && tick % 5 == 0 {
                let peers = truths.iter().filter(|(robot, _)| *robot != driver.robot);
                peers.for_each(|(robot, truth)| driver.simulator.update_peer(*robot, truth));
            }
            driver.step();
            let Pose2 { x_m, y_m, .. } = driver.truth.world_from_base;
            picture.dot([x_m, y_m], 1, COLOURS[driver.robot.index() % COLOURS.len()]);
        }
    }
    for driver in &mut fleet {
        driver.simulator.scan_into(&mut driver.scan);
        picture.draw(driver.truth.world_from_base, &driver.scan);
        let Driver { robot, truth, way_m, believed, .. } = driver;
        let refused = driver.simulator.refused();
        println!("{robot}: {way_m:.1} m, {} contacts, {refused} refused, {truth:.2?}", truth.contacts);
        println!("    odometry says {believed:.2?}");
    }
    picture.write(&out)
}

/// Drives ahead, turns near obstacles, and drives back after a contact.
struct Driver {
    robot: RobotId,
    simulator: Simulator,
    scan: Box<Scan>,
    truth: GroundTruth,
    believed: Pose2,
    way_m: f64,
    turning: f64,
    backing_ticks: usize,
}

impl Driver {
    fn new(robot: RobotId, mut simulator: Simulator) -> Self {
        let mut scan = Box::new(Scan::zeroed());
        simulator.scan_into(&mut scan);
        let truth = simulator.step().truth;
        let believed = truth.world_from_base;
        Self { robot, simulator, scan, truth, believed, way_m: 0.0, turning: 0.0, backing_ticks: 0 }
    }

    fn step(&mut self) {
        let ahead = |sign: f32| {
            let near = self.scan.hits().map(|(angle, range)| (angle.sin() * range, angle.cos() * range));
            near.filter(move |(y, x)| *x > 0.0 && *x < 0.35 && *y * sign > -0.02 && y.abs() < 0.15).count()
        };
        let (left, right) = (ahead(1.0), ahead(-1.0));
        if left + right == 0 {
            self.turning = 0.0;
        } else if self.turning == 0.0 {
            self.turning = if left > right { -0.8 } else { 0.8 };
        }
        let (linear_m_s, angular_rad_s) = match self.backing_ticks {
            0 if self.turning == 0.0 => (0.15, 0.0),
            0 => (0.0, self.turning),
            1..=200 => (0.0, 0.8),
            _ => (-0.1, 0.0),
        };
        self.simulator.set_velocity_command(&VelocityCommand {
            linear_m_s,
            angular_rad_s,
            ..VelocityCommand::default()
        });
        let tick = self.simulator.step();
        self.backing_ticks = self.backing_ticks.saturating_sub(1);
        if tick.truth.contacts > self.truth.contacts {
            // The LiDAR may not see the touched obstacle, so the robot turns away.
            self.backing_ticks = 3 * TICKS_PER_SECOND;
        }
        self.way_m += tick.truth.world_from_base.distance_m(self.truth.world_from_base);
        self.truth = tick.truth;
        if let Some(odometry) = tick.odometry {
            self.believed = odometry.odom_from_base;
        }
        if tick.scan_due {
            self.simulator.scan_into(&mut self.scan);
        }
    }
}

struct Picture {
    plan: msg::Grid,
    pixels: Vec<[u8; 3]>,
}

impl Picture {
    fn of(room: &Room) -> Self {
        let plan = room.floor_plan(RESOLUTION_M);
        let shade = |cell: &i8| match occupancy(*cell) {
            Occupancy::Unknown => [128; 3],
            Occupancy::Free => [255; 3],
            Occupancy::Occupied => [0; 3],
        };
        let pixels = plan.cells.iter().map(shade).collect();
        Self { plan, pixels }
    }

    fn dot(&mut self, [x, y]: [f64; 2], radius: i64, colour: [u8; 3]) {
        let (width, height) = (i64::from(self.plan.header.width), i64::from(self.plan.header.height));
        let (column, row) = self.plan.view().cell_of([x, y]);
        for (dx, dy) in (-radius..=radius).flat_map(|dx| (-radius..=radius).map(move |dy| (dx, dy))) {
            let (c, r) = (column + dx, row + dy);
            if dx * dx + dy * dy <= radius * radius && (0..width).contains(&c) && (0..height).contains(&r) {
                self.pixels[(r * width + c) as usize] = colour;
            }
        }
    }

    fn draw(&mut self, world_from_base: Pose2, scan: &Scan) {
        let world_from_scan = world_from_base * Pose2::new(-0.032, 0.0, 0.0);
        for (angle, range) in scan.hits() {
            let (sin, cos) = f64::from(angle).sin_cos();
            let range = f64::from(range);
            self.dot(world_from_scan.apply([range * cos, range * sin]), 0, RED);
        }
        self.dot([world_from_base.x_m, world_from_base.y_m], 4, BLUE);
        for i in 0..16 {
            self.dot(world_from_base.apply([f64::from(i) * 0.02, 0.0]), 0, BLUE);
        }
    }

    fn write(&self, path: &str) -> Result<(), Box<dyn std::error::Error>> {
        let (width, height) = (self.plan.header.width, self.plan.header.height);
        let file = std::fs::File::create(path)?;
        let mut encoder = png::Encoder::new(file, width * SCALE as u32, height * SCALE as u32);
        encoder.set_color(png::ColorType::Rgb);
        // Rows of a picture start at the top, rows of a grid at the lowest y.
        let rows = self.pixels.chunks(width as usize).rev().flat_map(|row| [row; SCALE]);
        let data: Vec<u8> = rows.flatten().flat_map(|pixel| [*pixel; SCALE]).flatten().collect();
        encoder.write_header()?.write_image_data(&data)?;
        Ok(())
    }
}
