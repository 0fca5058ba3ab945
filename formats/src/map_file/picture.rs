//! Map pictures with coloured paths and robots over an occupancy grid.

use super::{MapFileError, Path, greys_top_down};
use crate::atomic;
use msg::{GridView, Pose2};
use std::io::Write;

/// Colour: red, green, blue, 0 to 255 each.
pub type Rgb = [u8; 3];

/// Longest line that is drawn, pixels: a pose far outside the map must not cost a second.
const LINE_PIXELS_MAX: f64 = 20_000.0;

/// Colour picture of a grid. Coordinates of shapes are in the grid's own frame.
pub struct Picture<'a> {
    grid: GridView<'a>,
    /// Red, green, blue of every pixel, rows from the top.
    pub(super) pixels: Vec<u8>,
}

impl<'a> Picture<'a> {
    /// Colour of each robot, by [`msg::RobotId::index`]. Most eyes can tell them apart.
    pub const ROBOT_COLOURS: [Rgb; 8] = [
        [230, 60, 50],
        [40, 120, 220],
        [30, 160, 70],
        [240, 150, 20],
        [150, 70, 190],
        [0, 170, 180],
        [200, 90, 140],
        [120, 100, 60],
    ];

    /// Draws the grid in map_saver's greys.
    pub fn new(grid: GridView<'a>) -> Self {
        let greys = if grid.cells.is_empty() { Vec::new() } else { greys_top_down(grid) };
        Self { grid, pixels: greys.into_iter().flat_map(|grey| [grey; 3]).collect() }
    }

    /// Returns the colour of the robot with this index; colours repeat after eight.
    pub fn robot_colour(index: usize) -> Rgb {
        Self::ROBOT_COLOURS[index % Self::ROBOT_COLOURS.len()]
    }

    /// Draws a line through points of the grid's frame, [x, y] in metres.
    pub fn path(&mut self, points_m: impl IntoIterator<Item = [f64; 2]>, colour: Rgb) {
        let mut last = None;
        for point in points_m {
            self.line(last.unwrap_or(point), point, colour);
            last = Some(point);
        }
    }

    /// Draws a disc of `radius_m` with a line in the robot's heading, in the grid's frame.
    pub fn robot(&mut self, pose: Pose2, radius_m: f64, colour: Rgb) {
        let [x, y] = self.pixel([pose.x_m, pose.y_m]);
        let radius = (radius_m / self.grid.header.resolution_m).clamp(1.5, 100.0);
        let reach = radius.ceil() as i64;
        for (dx, dy) in (-reach..=reach).flat_map(|dy| (-reach..=reach).map(move |dx| (dx, dy))) {
            if (dx as f64).hypot(dy as f64) <= radius {
                self.set((x as i64).saturating_add(dx), (y as i64).saturating_add(dy), colour);
            }
        }
        self.line([pose.x_m, pose.y_m], pose.apply([2.5 * radius_m, 0.0]), colour);
    }

    /// Writes a PNG file, whole or not at all.
    pub fn write_png(&self, path: &Path) -> Result<(), MapFileError> {
        let (width, height) = (self.grid.header.width, self.grid.header.height);
        atomic::write(path, |file| encode(file, width, height, png::ColorType::Rgb, &self.pixels))
            .map_err(MapFileError::io(path))
    }

    fn line(&mut self, from_m: [f64; 2], to_m: [f64; 2], colour: Rgb) {
        let ([x0, y0], [x1, y1]) = (self.pixel(from_m), self.pixel(to_m));
        let steps = (x1 - x0).abs().max((y1 - y0).abs()).ceil().max(1.0);
        if steps > LINE_PIXELS_MAX || !steps.is_finite() {
            return;
        }
        for step in 0..=steps as u32 {
            let t = f64::from(step) / steps;
            self.set((x0 + t * (x1 - x0)).floor() as i64, (y0 + t * (y1 - y0)).floor() as i64, colour);
        }
    }

    /// Returns column and row, rows counted from the top.
    fn pixel(&self, point_m: [f64; 2]) -> [f64; 2] {
        let [x, y] = self.grid.header.origin.inverse().apply(point_m);
        let resolution = self.grid.header.resolution_m;
        [x / resolution, f64::from(self.grid.header.height) - y / resolution]
    }

    fn set(&mut self, x: i64, y: i64, colour: Rgb) {
        let (width, height) = (i64::from(self.grid.header.width), i64::from(self.grid.header.height));
        if (0..width).contains(&x) && (0..height).contains(&y) {
            let at = 3 * (y * width + x) as usize;
            self.pixels[at..at + 3].copy_from_slice(&colour);
        }
    }
}

/// Encodes grey values, 0 to 255, as a PNG; rows from the top.
///
/// # Errors
/// The number of values is not `width` times `height`.
pub fn encode_grey_png(width: u32, height: u32, greys: &[u8]) -> std::io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    encode(&mut bytes, width, height, png::ColorType::Grayscale, greys)?;
    Ok(bytes)
}

/// Encodes a PNG of 8 bits a sample, rows from the top.
pub(super) fn encode(
    file: impl Write,
    width: u32,
    height: u32,
    colours: png::ColorType,
    samples: &[u8],
) -> std::io::Result<()> {
    let mut encoder = png::Encoder::new(file, width, height);
    encoder.set_color(colours);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(png::Compression::Fast);
    write_samples(encoder, samples)
}

/// Encodes a grey PNG with the reasons why its map is unreliable, if there are any, as text `Unreliable`.
pub(super) fn encode_with_reasons(
    file: impl Write,
    width: u32,
    height: u32,
    greys: &[u8],
    reasons: &[&str],
) -> std::io::Result<()> {
    let mut encoder = png::Encoder::new(file, width, height);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(png::Compression::Fast);
    if !reasons.is_empty() {
        encoder.add_text_chunk("Unreliable".to_owned(), reasons.join("; "))?;
    }
    write_samples(encoder, greys)
}

fn write_samples<W: Write>(encoder: png::Encoder<'_, W>, samples: &[u8]) -> std::io::Result<()> {
    let mut writer = encoder.write_header()?;
    writer.write_image_data(samples)?;
    writer.finish()?;
    Ok(())
}
