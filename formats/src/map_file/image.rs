//! Reader of a map's image: PGM (binary and plain) and PNG. Sizes are checked before memory is allocated.

use super::{MAP_CELLS_MAX, MapFileError, Path, Read};
use crate::regular;
use std::io::{BufRead, BufReader, Seek};

/// Longest PGM header that is read, comments included, bytes.
const HEADER_BYTES_MAX: u64 = 16 * 1024;
/// Bytes that a plain PGM may spend on a pixel. Three digits and white space take four.
const PLAIN_BYTES_PER_PIXEL_MAX: u64 = 8;

/// Greys of an image, 0 to 255, first row on top; `None` where it is transparent.
pub(super) struct Pixels {
    pub width: u32,
    pub height: u32,
    pub greys: Vec<Option<u8>>,
}

/// Reads a PNG or PGM file.
pub(super) fn read_image(path: &Path) -> Result<Pixels, MapFileError> {
    decode_image(path, BufReader::new(regular::open(path).map_err(MapFileError::io(path))?))
}

/// Decodes a PNG or PGM, told apart by their first bytes; `path` is for errors.
pub(super) fn decode_image(path: &Path, mut file: impl BufRead + Seek) -> Result<Pixels, MapFileError> {
    let mut magic = Vec::with_capacity(8);
    file.by_ref().take(8).read_to_end(&mut magic).map_err(MapFileError::io(path))?;
    file.rewind().map_err(MapFileError::io(path))?;
    match &magic[..] {
        b"\x89PNG\r\n\x1a\n" => read_png(path, file),
        [b'P', b'5' | b'2', ..] => read_pgm(path, file),
        other => {
            let start = String::from_utf8_lossy(other).into_owned();
            Err(MapFileError::content(path, format!("starts with {start:?}"), "a PGM (P5 or P2) or a PNG"))
        }
    }
}

fn check_size(path: &Path, width: u64, height: u64) -> Result<(u32, u32), MapFileError> {
    let sound =
        width > 0 && height > 0 && width.checked_mul(height).is_some_and(|n| n <= MAP_CELLS_MAX as u64);
    if sound {
        return Ok((width as u32, height as u32)); // both are at most MAP_CELLS_MAX
    }
    let expected = format!("1 to {MAP_CELLS_MAX} cells in all");
    Err(MapFileError::content(path, format!("{width} x {height} cells"), expected))
}

fn read_pgm(path: &Path, mut file: impl BufRead) -> Result<Pixels, MapFileError> {
    let mut header = file.by_ref().take(HEADER_BYTES_MAX).bytes();
    let mut next = || header.next().and_then(Result::ok);
    let plain = (next(), next()).1 == Some(b'2');
    let mut number = |what: &str| {
        let missing = || format!("no {what} in the header");
        pgm_number(&mut next).ok_or_else(|| MapFileError::content(path, missing(), "P5, width, height, 255"))
    };
    let (width, height, depth) = (number("width")?, number("height")?, number("maximum grey")?);
    let (width, height) = check_size(path, width, height)?;
    if !(1..=u64::from(u16::MAX)).contains(&depth) {
        return Err(MapFileError::content(path, format!("maximum grey {depth}"), "1 to 65535"));
    }
    let size = width as usize * height as usize;
    // Above 255, netpbm's binary greys are two bytes, the more significant one first.
    let bytes_per_pixel = if plain || depth <= 255 { 1 } else { 2 };
    let bytes_max = if plain { PLAIN_BYTES_PER_PIXEL_MAX } else { bytes_per_pixel as u64 } * size as u64;
    let mut raw = Vec::new();
    file.take(bytes_max).read_to_end(&mut raw).map_err(MapFileError::io(path))?;
    let mut greys = Vec::with_capacity(size.min(raw.len()));
    let mut bytes = raw.iter().copied();
    let mut next = || bytes.next();
    let mut next_grey = || match (plain, bytes_per_pixel) {
        (true, _) => pgm_number(&mut next),
        (false, 1) => next().map(u64::from),
        (false, _) => Some(u64::from(u16::from_be_bytes([next()?, next()?]))),
    };
    while greys.len() < size {
        let Some(grey) = next_grey() else {
            let expected = format!("{size} for {width} x {height} cells");
            return Err(MapFileError::content(path, format!("truncated: {} pixels", greys.len()), expected));
        };
        if grey > depth {
            let what = format!("pixel {} is {grey} over the maximum grey {depth}", greys.len());
            return Err(MapFileError::content(path, what, "greys up to the maximum"));
        }
        greys.push(Some(((grey * 255 + depth / 2) / depth) as u8));
    }
    Ok(Pixels { width, height, greys })
}

/// Reads the next number past white space and comments, and the one white space that ends it.
fn pgm_number(next: &mut impl FnMut() -> Option<u8>) -> Option<u64> {
    let mut byte = next()?;
    loop {
        match byte {
            b'#' => while next()? != b'\n' {},
            b' ' | b'\t' | b'\r' | b'\n' => {}
            _ => break,
        }
        byte = next()?;
    }
    let mut value = 0_u64;
    let mut digits = false;
    let mut ended_by = Some(byte);
    while let Some(digit @ b'0'..=b'9') = ended_by {
        value = value.checked_mul(10)?.checked_add(u64::from(digit - b'0'))?;
        digits = true;
        ended_by = next();
    }
    let clean_end = ended_by.is_none_or(|byte| byte.is_ascii_whitespace());
    (digits && clean_end).then_some(value)
}

fn read_png(path: &Path, file: impl BufRead + Seek) -> Result<Pixels, MapFileError> {
    let refuse = |error: png::DecodingError| MapFileError::content(path, error.to_string(), "a sound PNG");
    let mut decoder = png::Decoder::new_with_limits(file, png::Limits { bytes: 8 * MAP_CELLS_MAX });
    decoder.set_transformations(png::Transformations::normalize_to_color8());
    let mut reader = decoder.read_info().map_err(refuse)?;
    let (width, height) = check_size(path, reader.info().width.into(), reader.info().height.into())?;
    let bytes = reader.output_buffer_size().filter(|bytes| *bytes <= 4 * MAP_CELLS_MAX).ok_or_else(|| {
        MapFileError::content(path, "too many bytes a pixel", "8 bits of grey, colour and transparency")
    })?;
    let mut raw = vec![0; bytes];
    let info = reader.next_frame(&mut raw).map_err(refuse)?;
    let channels = info.color_type.samples();
    let (colours, opaque) = match channels {
        2 | 4 => (channels - 1, false),
        _ => (channels, true),
    };
    let grey = |pixel: &[u8]| {
        let sum: u32 = pixel[..colours].iter().map(|c| u32::from(*c)).sum();
        (opaque || pixel[colours] == u8::MAX).then_some((sum / colours as u32) as u8)
    };
    Ok(Pixels { width, height, greys: raw[..info.buffer_size()].chunks_exact(channels).map(grey).collect() })
}
