//! Pictures: coverage over time per method, and the map and the trails of one run.

use crate::methods::Kind;
use crate::run::{CURVE_PERIOD_S, Outcome};
use crate::world::World;
use msg::grid::{Occupancy, occupancy};
use std::io;
use std::path::Path;

const WHITE: [u8; 3] = [255; 3];
const GREY: [u8; 3] = [225; 3];
const DARK: [u8; 3] = [60; 3];
/// Reachable floor that was not seen.
const MISSED: [u8; 3] = [255, 120, 120];
const COLOURS: [[u8; 3]; 8] = [
    [20, 90, 200],
    [220, 120, 20],
    [30, 150, 60],
    [170, 60, 170],
    [0, 160, 170],
    [130, 90, 50],
    [200, 60, 90],
    [110, 120, 30],
];
/// Size of the plot and of its frame, pixels.
const PLOT: [usize; 2] = [900, 500];
const MARGIN: usize = 30;

struct Picture {
    width: usize,
    height: usize,
    pixels: Vec<u8>,
}

impl Picture {
    fn new(width: usize, height: usize) -> Self {
        Self { width, height, pixels: WHITE.repeat(width * height) }
    }

    fn set(&mut self, x: usize, y: usize, colour: [u8; 3]) {
        if x < self.width && y < self.height {
            let at = 3 * (y * self.width + x);
            self.pixels[at..at + 3].copy_from_slice(&colour);
        }
    }

    fn line(&mut self, from: [f64; 2], to: [f64; 2], colour: [u8; 3], thickness: usize) {
        let steps = (to[0] - from[0]).abs().max((to[1] - from[1]).abs()).ceil().max(1.0);
        for i in 0..=steps as usize {
            let t = i as f64 / steps;
            let at = |axis: usize| (from[axis] + t * (to[axis] - from[axis])).max(0.0) as usize;
            for (dx, dy) in (0..thickness).flat_map(|dy| (0..thickness).map(move |dx| (dx, dy))) {
                self.set(at(0) + dx, at(1) + dy, colour);
            }
        }
    }

    fn write(&self, path: &Path) -> io::Result<()> {
        let mut encoder = png::Encoder::new(
            io::BufWriter::new(std::fs::File::create(path)?),
            self.width as u32,
            self.height as u32,
        );
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.write_header()?.write_image_data(&self.pixels)?;
        Ok(())
    }
}

/// Colour of a method's curve: coordinated blue, Burgard orange, greedy green, tour violet.
fn colour(kind: Kind) -> [u8; 3] {
    COLOURS[Kind::ALL.iter().position(|other| *other == kind).unwrap_or(0)]
}

/// Draws the mean coverage over time of each method. Grid lines are 10 % of the floor and 200 s apart.
pub fn write_curves(path: &Path, outcomes: &[Outcome]) -> io::Result<()> {
    let points = outcomes.iter().map(|o| o.curve.len()).max().unwrap_or(0).max(2);
    let mut picture = Picture::new(PLOT[0] + 2 * MARGIN, PLOT[1] + 2 * MARGIN);
    let place = |point: usize, coverage: f64| {
        let x = MARGIN as f64 + point as f64 / (points - 1) as f64 * PLOT[0] as f64;
        [x, MARGIN as f64 + (1.0 - coverage) * PLOT[1] as f64]
    };
    for tenth in 0..=10 {
        let coverage = f64::from(tenth) / 10.0;
        picture.line(
            place(0, coverage),
            place(points - 1, coverage),
            if tenth % 10 == 0 { DARK } else { GREY },
            1,
        );
    }
    for point in (0..points).step_by(200 / CURVE_PERIOD_S) {
        picture.line(place(point, 0.0), place(point, 1.0), if point == 0 { DARK } else { GREY }, 1);
    }
    for kind in Kind::ALL {
        let curves: Vec<&Vec<f32>> = outcomes
            .iter()
            .filter(|o| o.case.method == kind)
            .map(|o| &o.curve)
            .filter(|c| !c.is_empty())
            .collect();
        if curves.is_empty() {
            continue;
        }
        // A run that has ended keeps its last coverage.
        let at = |curve: &Vec<f32>, point: usize| f64::from(curve[point.min(curve.len() - 1)]);
        let mean = |point: usize| curves.iter().map(|c| at(c, point)).sum::<f64>() / curves.len() as f64;
        for point in 1..points {
            let (from, to) = (place(point - 1, mean(point - 1)), place(point, mean(point)));
            picture.line(from, to, colour(kind), 3);
        }
    }
    picture.write(path)
}

/// Draws the map of a run, the reachable floor that was not seen (red), and the robots' trails.
pub fn write_run(path: &Path, world: &World) -> io::Result<()> {
    let header = &world.map.header;
    let (width, height) = (header.width as usize, header.height as usize);
    let scale = 3;
    let mut picture = Picture::new(width * scale, height * scale);
    for (cell, value) in world.map.cells.iter().enumerate() {
        let is_wall = occupancy(world.plan.cells[cell]) == Occupancy::Occupied;
        let colour = match occupancy(*value) {
            Occupancy::Occupied => DARK,
            Occupancy::Free => WHITE,
            Occupancy::Unknown if world.reachable[cell] => MISSED,
            Occupancy::Unknown if is_wall => [150; 3],
            Occupancy::Unknown => GREY,
        };
        let (x, y) = (cell % width * scale, (height - 1 - cell / width) * scale);
        for (dx, dy) in (0..scale).flat_map(|dy| (0..scale).map(move |dx| (dx, dy))) {
            picture.set(x + dx, y + dy, colour);
        }
    }
    let pixel = |at: &[f64; 2]| {
        let x = (at[0] - header.origin.x_m) / header.resolution_m * scale as f64;
        [x, (height * scale) as f64 - (at[1] - header.origin.y_m) / header.resolution_m * scale as f64]
    };
    for (index, robot) in world.robots.iter().enumerate() {
        let colour = COLOURS[index % COLOURS.len()];
        for pair in robot.trail.windows(2) {
            picture.line(pixel(&pair[0]), pixel(&pair[1]), colour, 2);
        }
        let [x, y] = pixel(&robot.trail[0]);
        picture.line([x - 4.0, y], [x + 4.0, y], colour, 4);
    }
    picture.write(path)
}
