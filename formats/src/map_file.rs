//! Occupancy grids as files, YAML with a PGM or PNG image as map_server reads them, and PNG for people.
//!
//! The format is that of ROS's map_server and Nav2's nav2_map_server. The image's first row is the highest y; the
//! YAML file gives the meaning of its greys and the pose of its lower left corner. A file holds readings, not
//! evidence: a loaded occupied cell has [`LOADED_LOG_ODDS`] steps of log-odds, a free one minus as many.

mod held;
mod image;
mod picture;

pub use held::MapFiles;
pub use picture::{Picture, Rgb, encode_grey_png};

use crate::atomic::Prepared;
use crate::regular;
use image::{Pixels, decode_image, read_image};
use msg::grid::{self, LOG_ODDS_MAX, LOG_ODDS_PER_STEP, MAP_CELLS_MAX, Occupancy, UNKNOWN, occupancy};
use msg::{Grid, GridHeader, GridView, Pose2};
use serde::Deserialize;
use serde::de::IgnoredAny;
use std::fs::File;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};

/// Log-odds steps of an occupied cell that was loaded from a file. They are a probability of 0.95, so that a second
/// map of the same place can still outvote the first.
pub const LOADED_LOG_ODDS: i8 = 60;
/// Longest YAML file that is read, bytes. A map's has about 150.
const YAML_BYTES_MAX: u64 = 64 * 1024;
/// Probability above which a cell is occupied: map_server's default.
const OCCUPIED_THRESH: f64 = 0.65;
/// Probability below which a cell is free. Unknown is written as grey 205, a probability of 0.1961:
/// with the 0.25 that Nav2's map_saver writes, its own map_server reads unknown as free.
const FREE_THRESH: f64 = 0.196;
/// Accepted sides of a cell, metres.
const RESOLUTION_M: core::ops::RangeInclusive<f64> = 1e-3..=100.0;
/// Farthest accepted corner, metres: f64 still resolves micrometres there.
const ORIGIN_M_MAX: f64 = 1e7;

/// Grey of occupied cells, as map_saver writes it.
const GREY_OCCUPIED: u8 = 0;
/// Grey of free cells, as map_saver writes it.
const GREY_FREE: u8 = 254;
/// Grey of unknown cells, as map_saver writes it.
const GREY_UNKNOWN: u8 = 205;

/// Reason why a map could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum MapFileError {
    /// The operating system refused to open, read or write the file.
    #[error("{}: {source}", file.display())]
    Io {
        /// Path of the file.
        file: PathBuf,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// The file's content is malformed or out of range.
    #[error("{}: {what}; expected {expected}", file.display())]
    Content {
        /// Path of the file.
        file: PathBuf,
        /// Text that was found, and where.
        what: String,
        /// Text that was expected.
        expected: String,
    },
}

impl MapFileError {
    fn content(file: &Path, what: impl Into<String>, expected: impl Into<String>) -> Self {
        Self::Content { file: file.to_owned(), what: what.into(), expected: expected.into() }
    }

    fn io(file: &Path) -> impl FnOnce(std::io::Error) -> Self + '_ {
        move |source| Self::Io { file: file.to_owned(), source }
    }
}

/// Writes `STEM.pgm` and `STEM.yaml` for map_server, and the same picture as `STEM.png`.
///
/// The files are written under temporary names and renamed when all of them are on the disk: where one cannot be written, the map of
/// before stays. The YAML is renamed last, so that it never names a missing image.
pub fn write_map(stem: &Path, grid: GridView<'_>) -> Result<(), MapFileError> {
    write_map_with_reasons(stem, grid, &[])
}

/// Writes a map as [`write_map`] does, with the reasons why it is unreliable.
///
/// They are the list `unreliable` of the YAML, which map_server ignores, and the text `Unreliable` of the PNG. A map without
/// reasons has neither.
pub fn write_map_with_reasons(stem: &Path, grid: GridView<'_>, reasons: &[&str]) -> Result<(), MapFileError> {
    let [pgm, yaml, png] = written_files(stem);
    let name = pgm.file_name().and_then(|name| name.to_str());
    let Some(name) = name.filter(|name| !name.contains(['"', '\\', '\n', '\r'])) else {
        return Err(MapFileError::content(
            stem,
            "a name that YAML cannot hold",
            "plain UTF-8 without quotes",
        ));
    };
    let (width, height) = (grid.header.width, grid.header.height);
    if width == 0 || height == 0 {
        return Err(MapFileError::content(
            stem,
            format!("a map of {width} x {height} cells"),
            "at least one cell",
        ));
    }
    let greys = greys_top_down(grid);
    let files = [
        prepare(&pgm, |file| {
            write!(file, "P5\n{width} {height}\n255\n")?;
            file.write_all(&greys)
        })?,
        prepare(&png, |file| picture::encode_with_reasons(file, width, height, &greys, reasons))?,
        prepare(&yaml, |file| file.write_all(describe(name, grid.header, reasons).as_bytes()))?,
    ];
    for (file, path) in files.into_iter().zip([&pgm, &png, &yaml]) {
        file.replace().map_err(MapFileError::io(path))?;
    }
    Ok(())
}

/// Returns the path of a map without its extension, however a person gave it: with that of one of its files, or with none. Other
/// points belong to the name, as in `map.v2`.
pub fn stem(path: &Path) -> PathBuf {
    match path.extension().and_then(|extension| extension.to_str()) {
        Some("yaml" | "yml" | "pgm" | "png") => path.with_extension(""),
        _ => path.into(),
    }
}

/// Returns the files that [`write_map`] writes: PGM, YAML and PNG.
pub fn written_files(stem: &Path) -> [PathBuf; 3] {
    ["pgm", "yaml", "png"].map(|extension| with_extension(stem, extension))
}

/// Returns the files that [`read_map`] reads: the YAML and the image that it names.
pub fn read_files(yaml: &Path) -> Result<[PathBuf; 2], MapFileError> {
    Ok([yaml.into(), image_file(yaml, &read_description(yaml)?)])
}

fn image_file(yaml: &Path, meta: &Description) -> PathBuf {
    yaml.parent().unwrap_or(Path::new("")).join(&meta.image)
}

/// Reads a map by its YAML file. The image is a PGM (P5 or P2) or a PNG, named relative to the YAML's folder or
/// absolutely. No memory is allocated for an image before its size was checked.
pub fn read_map(yaml: &Path) -> Result<Grid, MapFileError> {
    Ok(read_map_with_reasons(yaml)?.0)
}

/// Reads a map as [`read_map`] does, with the reasons why it is unreliable, as [`write_map_with_reasons`] writes them.
pub fn read_map_with_reasons(yaml: &Path) -> Result<(Grid, Vec<String>), MapFileError> {
    let meta = read_description(yaml)?;
    let grid = meta.grid(&read_image(&image_file(yaml, &meta))?);
    Ok((grid, meta.unreliable.into_reasons()))
}

/// Decodes a map from the YAML's text and the image's bytes. `name` is for errors.
pub fn decode_map(name: &Path, yaml: &str, image: &[u8]) -> Result<Grid, MapFileError> {
    let meta = parse_description(name, yaml)?;
    Ok(meta.grid(&decode_image(name, std::io::Cursor::new(image))?))
}

/// Fields of the YAML file. Fields of other programs are ignored.
#[derive(Debug, Deserialize)]
struct Description {
    image: PathBuf,
    resolution: f64,
    origin: [f64; 3],
    negate: Flag,
    occupied_thresh: f64,
    free_thresh: f64,
    #[serde(default)]
    mode: Mode,
    #[serde(default)]
    unreliable: Unreliable,
}

/// Value of `unreliable`: the reasons, or something else that another program has written.
#[derive(Debug, Deserialize)]
#[serde(untagged)]
enum Unreliable {
    Reasons(Vec<String>),
    Other(IgnoredAny),
}

impl Default for Unreliable {
    fn default() -> Self {
        Self::Reasons(Vec::new())
    }
}

impl Unreliable {
    fn into_reasons(self) -> Vec<String> {
        match self {
            Self::Reasons(reasons) => reasons,
            Self::Other(_) => Vec::new(),
        }
    }
}

/// Value of `negate`: some programs write 0 and 1, others a boolean.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq)]
#[serde(untagged)]
enum Flag {
    Number(u8),
    Truth(bool),
}

/// Conversion from greys to cells, as nav2_map_server defines it.
#[derive(Clone, Copy, Debug, Default, Deserialize, PartialEq)]
#[serde(rename_all = "lowercase")]
enum Mode {
    #[default]
    Trinary,
    Scale,
    Raw,
}

fn read_description(yaml: &Path) -> Result<Description, MapFileError> {
    let mut text = String::new();
    let file = regular::open(yaml).map_err(MapFileError::io(yaml))?;
    file.take(YAML_BYTES_MAX + 1).read_to_string(&mut text).map_err(MapFileError::io(yaml))?;
    if text.len() as u64 > YAML_BYTES_MAX {
        return Err(MapFileError::content(
            yaml,
            "too long",
            format!("at most {YAML_BYTES_MAX} bytes of YAML"),
        ));
    }
    parse_description(yaml, &text)
}

fn parse_description(yaml: &Path, text: &str) -> Result<Description, MapFileError> {
    let fields = "image, resolution, origin: [x, y, yaw], negate, occupied_thresh, free_thresh as map_saver writes them";
    let meta: Description = serde_saphyr::from_str(text)
        .map_err(|error| MapFileError::content(yaml, error.to_string().trim_end().to_owned(), fields))?;
    meta.check(yaml)?;
    Ok(meta)
}

impl Description {
    fn check(&self, yaml: &Path) -> Result<(), MapFileError> {
        let refuse = |what: String, expected: &str| Err(MapFileError::content(yaml, what, expected));
        if self.image.as_os_str().is_empty() {
            return refuse("`image` is empty".into(), "the name of a PGM or PNG file");
        }
        if !RESOLUTION_M.contains(&self.resolution) {
            return refuse(format!("`resolution` is {}", self.resolution), "0.001 to 100 metres a cell");
        }
        if !self.origin.iter().all(|value| value.abs() <= ORIGIN_M_MAX) {
            return refuse(format!("`origin` is {:?}", self.origin), "finite metres, metres, radians");
        }
        if let Flag::Number(number @ 2..) = self.negate {
            return refuse(format!("`negate` is {number}"), "0 or 1");
        }
        let (free, occupied) = (self.free_thresh, self.occupied_thresh);
        let sound = (0.0..=1.0).contains(&free) && (0.0..=1.0).contains(&occupied) && free <= occupied;
        if !sound {
            let what = format!("`free_thresh` is {free} and `occupied_thresh` is {occupied}");
            return refuse(what, "0 <= free_thresh <= occupied_thresh <= 1");
        }
        Ok(())
    }

    /// Converts the image to a grid.
    fn grid(&self, pixels: &Pixels) -> Grid {
        let mut table = self.cell_table();
        if self.mode == Mode::Trinary && !self.is_negated() && is_of_map_saver(&pixels.greys) {
            table[usize::from(GREY_UNKNOWN)] = UNKNOWN;
        }
        let (width, height) = (pixels.width as usize, pixels.height as usize);
        let mut cells = Vec::with_capacity(width * height);
        for row in (0..height).rev() {
            let row = row * width..(row + 1) * width;
            cells
                .extend(pixels.greys[row].iter().map(|grey| grey.map_or(UNKNOWN, |g| table[usize::from(g)])));
        }
        let [x_m, y_m, yaw_rad] = self.origin;
        let header = GridHeader {
            origin: Pose2::new(x_m, y_m, yaw_rad),
            resolution_m: self.resolution,
            width: pixels.width,
            height: pixels.height,
            ..Default::default()
        };
        Grid { header, cells }
    }

    fn is_negated(&self) -> bool {
        matches!(self.negate, Flag::Number(1) | Flag::Truth(true))
    }

    /// Returns the cell of each grey, as nav2_map_server's three modes define it.
    fn cell_table(&self) -> [i8; 256] {
        core::array::from_fn(|grey| {
            let shade = grey as f64 / 255.0;
            let p = if self.is_negated() { shade } else { 1.0 - shade };
            match self.mode {
                Mode::Raw if grey <= 100 => cell_of_probability(grey as f64 / 100.0),
                Mode::Raw => UNKNOWN,
                _ if p > self.occupied_thresh => LOADED_LOG_ODDS,
                _ if p < self.free_thresh => -LOADED_LOG_ODDS,
                Mode::Trinary => UNKNOWN,
                Mode::Scale => {
                    let span = (self.occupied_thresh - self.free_thresh).max(f64::MIN_POSITIVE);
                    cell_of_probability(((p - self.free_thresh) / span).clamp(0.01, 0.99))
                }
            }
        })
    }
}

/// Whether an image has map_saver's three greys alone. Then 205 is unknown, whatever `free_thresh` says: Nav2's map_saver
/// writes 0.25, by which what nobody has seen would be free.
fn is_of_map_saver(greys: &[Option<u8>]) -> bool {
    greys.iter().flatten().all(|grey| [GREY_OCCUPIED, GREY_UNKNOWN, GREY_FREE].contains(grey))
}

/// Converts a probability to log-odds steps, at most [`LOADED_LOG_ODDS`] either way.
fn cell_of_probability(p: f64) -> i8 {
    let steps = (p / (1.0 - p)).ln() / LOG_ODDS_PER_STEP;
    steps.clamp(-f64::from(LOADED_LOG_ODDS), f64::from(LOADED_LOG_ODDS)).round() as i8
}

fn describe(image: &str, header: &GridHeader, reasons: &[&str]) -> String {
    let Pose2 { x_m, y_m, yaw_rad } = header.origin;
    let quoted: Vec<String> = reasons.iter().map(|reason| format!("{reason:?}")).collect();
    let unreliable =
        if quoted.is_empty() { String::new() } else { format!("unreliable: [{}]\n", quoted.join(", ")) };
    format!(
        "image: \"{image}\"\nmode: trinary\nresolution: {:?}\norigin: [{x_m:?}, {y_m:?}, {yaw_rad:?}]\n\
         negate: 0\noccupied_thresh: {OCCUPIED_THRESH}\nfree_thresh: {FREE_THRESH}\n{unreliable}",
        header.resolution_m
    )
}

/// Returns map_saver's grey of every cell, first row the highest y.
fn greys_top_down(grid: GridView<'_>) -> Vec<u8> {
    let table: [u8; 256] = core::array::from_fn(|bits| match occupancy(bits as u8 as i8) {
        Occupancy::Occupied => GREY_OCCUPIED,
        Occupancy::Free => GREY_FREE,
        Occupancy::Unknown => GREY_UNKNOWN,
    });
    let rows = grid.cells.chunks_exact(grid.header.width as usize).rev();
    rows.flatten().map(|cell| table[usize::from(*cell as u8)]).collect()
}

/// Appends an extension: `a/map.v1` becomes `a/map.v1.pgm`, since a dot in the stem is not an extension.
fn with_extension(stem: &Path, extension: &str) -> PathBuf {
    let mut path = stem.as_os_str().to_owned();
    path.push(".");
    path.push(extension);
    path.into()
}

/// Writes a file under a temporary name.
fn prepare(
    path: &Path,
    fill: impl FnOnce(&mut std::io::BufWriter<&File>) -> std::io::Result<()>,
) -> Result<Prepared, MapFileError> {
    Prepared::write(path, fill).map_err(MapFileError::io(path))
}

const _: () = assert!(
    LOADED_LOG_ODDS < LOG_ODDS_MAX
        && LOADED_LOG_ODDS >= grid::OCCUPIED_MIN
        && -LOADED_LOG_ODDS <= grid::FREE_MAX
);

#[cfg(test)]
mod tests;
