//! Draws a room: its floor plan, start poses, and one scan of each robot.
//!
//! `cargo run -p sim --example look -- OUT.png [ROOM_FILE] [ROBOTS] [LIDAR]`

use msg::grid::{Occupancy, occupancy};
use msg::{Pose2, RobotId, Scan};
use sim::{LidarConfig, NoiseConfig, Room, SimConfig, Simulator};

const RESOLUTION_M: f64 = 0.02;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let out = arguments.next().ok_or("usage: look OUT.png [ROOM_FILE] [ROBOTS] [LIDAR]")?;
    let room = match arguments.next().filter(|path| path != "-") {
        Some(path) => Room::from_bytes(&path, &std::fs::read(&path)?)?,
        None => Room::laboratory(),
    };
    let robots = arguments.next().map_or(Ok(3), |n| n.parse())?;
    let lidar = LidarConfig::preset(&arguments.next().unwrap_or("lds01".into())).ok_or("no such LiDAR")?;
    let config = SimConfig { lidar, noise: NoiseConfig::default(), ..SimConfig::default() };
    let mut picture = Picture::of(&room);
    for (robot, start) in RobotId::first(robots).zip(room.starts(robots)?) {
        println!("{robot}: {start:.3?}");
        let mut simulator = Simulator::new(&room, &config, robot, start, 1)?;
        simulator.step();
        let mut scan: Box<Scan> = Box::new(bytemuck_zeroed());
        simulator.scan_into(&mut scan);
        picture.draw(start, &scan);
    }
    picture.write(&out)
}

fn bytemuck_zeroed() -> Scan {
    bytemuck::Zeroable::zeroed()
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

    fn draw(&mut self, base: Pose2, scan: &Scan) {
        let scan_from_base = Pose2::new(-0.032, 0.0, 0.0);
        for (angle, range) in scan.hits() {
            let (sin, cos) = f64::from(angle).sin_cos();
            let range = f64::from(range);
            self.dot((base * scan_from_base).apply([range * cos, range * sin]), 0, [220, 30, 30]);
        }
        self.dot([base.x_m, base.y_m], 5, [30, 90, 220]);
        for i in 0..20 {
            self.dot(base.apply([f64::from(i) * 0.015, 0.0]), 0, [30, 90, 220]);
        }
    }

    fn write(&self, path: &str) -> Result<(), Box<dyn std::error::Error>> {
        let (width, height) = (self.plan.header.width, self.plan.header.height);
        let mut encoder = png::Encoder::new(std::fs::File::create(path)?, width, height);
        encoder.set_color(png::ColorType::Rgb);
        // Pictures begin at the top, grids at the lowest y.
        let rows = self.pixels.chunks(width as usize).rev();
        let data: Vec<u8> = rows.flatten().flatten().copied().collect();
        encoder.write_header()?.write_image_data(&data)?;
        Ok(())
    }
}
