//! A map's files, held as they were read: to compare them with those of another day, and to keep a copy.

use super::{Description, Flag, MapFileError, Mode, image_file, read_description};
use crate::regular;
use std::io::Read as _;
use std::path::Path;

/// The YAML and the image of a map, as they were read. The image is not decoded.
#[derive(Debug)]
pub struct MapFiles {
    meta: Description,
    image: Vec<u8>,
}

impl MapFiles {
    /// Reads a map's YAML, and its image of at most `image_bytes_max` bytes.
    ///
    /// # Errors
    /// A file cannot be read, the YAML is malformed, or the image is longer.
    pub fn read(yaml: &Path, image_bytes_max: u64) -> Result<Self, MapFileError> {
        let meta = read_description(yaml)?;
        let path = image_file(yaml, &meta);
        let file = regular::open(&path).map_err(MapFileError::io(&path))?;
        let mut image = Vec::new();
        let mut bytes = file.take(image_bytes_max.saturating_add(1));
        bytes.read_to_end(&mut image).map_err(MapFileError::io(&path))?;
        if image.len() as u64 > image_bytes_max {
            let expected = format!("at most {image_bytes_max} bytes");
            return Err(MapFileError::content(&path, "too long", expected));
        }
        Ok(Self { meta, image })
    }

    /// Returns the fields of the YAML that say what the image means, in one form: comments, other fields, and the image's name are
    /// left out.
    pub fn meaning(&self) -> String {
        let Description { resolution, origin, negate, occupied_thresh, free_thresh, mode, .. } = &self.meta;
        let [x_m, y_m, yaw_rad] = origin;
        let negate = matches!(negate, Flag::Number(1) | Flag::Truth(true));
        let mode = match mode {
            Mode::Trinary => "trinary",
            Mode::Scale => "scale",
            Mode::Raw => "raw",
        };
        format!(
            "mode: {mode}\nresolution: {resolution:?}\norigin: [{x_m:?}, {y_m:?}, {yaw_rad:?}]\nnegate: {}\n\
             occupied_thresh: {occupied_thresh:?}\nfree_thresh: {free_thresh:?}\n",
            u8::from(negate)
        )
    }

    /// Returns the image's bytes.
    pub fn image(&self) -> &[u8] {
        &self.image
    }
}
