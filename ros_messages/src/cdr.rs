//! Reads and writes CDR, the encoding of ROS 2 messages.
//!
//! It is XCDR1, little-endian, behind a 4-byte encapsulation header (OMG DDS-XTypes 1.3, 7.4.1 and 7.6.2.1.2).
//! Primitives of 2, 4 and 8 bytes are aligned to their size, counted from the first byte after the header. ROS 1's
//! encoding ([`Dialect::Ros1`]) has no header, no alignment, and strings without NUL.

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Encapsulation header: CDR, little-endian, no options.
pub const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];

/// A message without fields, which has one byte in ROS 2.
const EMPTY_MESSAGE: [u8; 5] = [0, 1, 0, 0, 0];

/// Returns a payload as ROS 2 expects it.
///
/// Unity's connector writes nothing behind the header of a message without fields, which Fast CDR refuses: such a
/// payload gets one zero byte. All others stay as they are.
pub fn with_dummy_byte(dialect: Dialect, payload: &[u8]) -> &[u8] {
    match payload {
        [0, 1, _, _] if dialect == Dialect::Ros2 => &EMPTY_MESSAGE,
        _ => payload,
    }
}

/// The ROS version whose encoding a payload has.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Dialect {
    /// CDR behind an encapsulation header.
    #[default]
    Ros2,
    /// Packed fields; std_msgs/Header begins with `seq`.
    Ros1,
}

/// Why bytes are not the expected message.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum DecodeError {
    /// The encapsulation header is missing or names another representation.
    #[error("the payload must begin with 00 01 00 00 (little-endian CDR), not with {0:02x?}")]
    Encapsulation(Vec<u8>),
    /// The payload ends within a field.
    #[error("{field} needs {need} bytes at offset {at}, {left} are left")]
    Short {
        /// The field being read.
        field: &'static str,
        /// Offset in the payload behind the encapsulation header.
        at: usize,
        /// Bytes the field needs.
        need: u64,
        /// Bytes that are left.
        left: usize,
    },
    /// A string that is not UTF-8 or does not end in NUL.
    #[error("{field} is not a NUL-terminated UTF-8 string")]
    Text {
        /// The field being read.
        field: &'static str,
    },
    /// The number is NaN or infinite.
    #[error("{field} is {value}: a finite number is needed")]
    NotFinite {
        /// The field being read.
        field: &'static str,
        /// The value as text.
        value: String,
    },
    /// A grid's size and its number of cells differ.
    #[error("a grid of {width} x {height} cells comes with {cells} cells")]
    GridSize {
        /// Cells along x.
        width: u32,
        /// Cells along y.
        height: u32,
        /// Cells in the message.
        cells: usize,
    },
    /// A scan has too many beams.
    #[error("a scan has {beams} beams; at most {limit} can be used")]
    TooManyBeams {
        /// Beams in the message.
        beams: usize,
        /// Most beams that a scan of the fleet can hold.
        limit: usize,
    },
}

/// Appends a CDR message to a buffer that may already hold other bytes.
///
/// ```
/// use ros_messages::cdr::{Reader, Writer};
/// let mut bytes = Vec::new();
/// let mut writer = Writer::new(&mut bytes);
/// writer.string("map");
/// writer.f64(2.5);
/// let mut reader = Reader::new(&bytes)?;
/// assert_eq!((reader.string("frame")?, reader.f64("x")?), ("map", 2.5));
/// # Ok::<(), ros_messages::cdr::DecodeError>(())
/// ```
pub struct Writer<'a> {
    out: &'a mut Vec<u8>,
    origin: usize,
    dialect: Dialect,
}

impl<'a> Writer<'a> {
    /// Writes ROS 2's encapsulation header, and aligns what follows to the byte after it.
    pub fn new(out: &'a mut Vec<u8>) -> Self {
        Self::with(Dialect::Ros2, out)
    }

    /// Begins a message in either encoding; ROS 1's has no header.
    pub fn with(dialect: Dialect, out: &'a mut Vec<u8>) -> Self {
        if dialect == Dialect::Ros2 {
            out.extend_from_slice(&ENCAPSULATION);
        }
        let origin = out.len();
        Self { out, origin, dialect }
    }

    /// Returns the encoding, for the few messages whose fields differ.
    pub fn dialect(&self) -> Dialect {
        self.dialect
    }

    fn align(&mut self, size: usize) {
        if self.dialect == Dialect::Ros1 {
            return;
        }
        let past = (self.out.len() - self.origin) % size;
        if past != 0 {
            self.out.resize(self.out.len() + size - past, 0);
        }
    }

    /// Writes one byte.
    pub fn u8(&mut self, value: u8) {
        self.out.push(value);
    }

    /// Writes 1 or 0 in one byte.
    pub fn bool(&mut self, value: bool) {
        self.out.push(u8::from(value));
    }

    /// Writes a signed integer, aligned to 2 bytes.
    pub fn i16(&mut self, value: i16) {
        self.align(2);
        self.out.extend_from_slice(&value.to_le_bytes());
    }

    /// Writes an unsigned integer, aligned to 2 bytes.
    pub fn u16(&mut self, value: u16) {
        self.align(2);
        self.out.extend_from_slice(&value.to_le_bytes());
    }

    /// Writes a signed integer, aligned to 4 bytes.
    pub fn i32(&mut self, value: i32) {
        self.align(4);
        self.out.extend_from_slice(&value.to_le_bytes());
    }

    /// Writes an unsigned integer, aligned to 4 bytes.
    pub fn u32(&mut self, value: u32) {
        self.align(4);
        self.out.extend_from_slice(&value.to_le_bytes());
    }

    /// Writes a float, aligned to 4 bytes.
    pub fn f32(&mut self, value: f32) {
        self.align(4);
        self.out.extend_from_slice(&value.to_le_bytes());
    }

    /// Writes a double, aligned to 8 bytes.
    pub fn f64(&mut self, value: f64) {
        self.align(8);
        self.out.extend_from_slice(&value.to_le_bytes());
    }

    /// Writes a fixed array of doubles: elements without a count.
    pub fn f64s(&mut self, values: &[f64]) {
        values.iter().for_each(|value| self.f64(*value));
    }

    /// Writes a string: length with the NUL, bytes, NUL (ROS 1: without). A NUL inside ends the string, as in C.
    pub fn string(&mut self, text: &str) {
        let text = text.split('\0').next().unwrap_or_default();
        let nul: &[u8] = if self.dialect == Dialect::Ros2 { b"\0" } else { b"" };
        self.count(text.len() + nul.len());
        self.out.extend_from_slice(text.as_bytes());
        self.out.extend_from_slice(nul);
    }

    /// Writes the element count of a sequence; the fleet's sequences are far shorter than `u32::MAX`.
    pub fn count(&mut self, elements: usize) {
        self.u32(u32::try_from(elements).unwrap_or(u32::MAX));
    }

    /// Writes a sequence of floats.
    pub fn f32_seq(&mut self, values: &[f32]) {
        self.count(values.len());
        let begin = self.out.len();
        self.out.resize(begin + 4 * values.len(), 0);
        for (place, value) in self.out[begin..].chunks_exact_mut(4).zip(values) {
            place.copy_from_slice(&value.to_le_bytes());
        }
    }

    /// Writes a sequence of bytes that `fill` fills in place.
    pub fn byte_seq_with(&mut self, length: usize, fill: impl FnOnce(&mut [u8])) {
        self.count(length);
        let begin = self.out.len();
        self.out.resize(begin + length, 0);
        fill(&mut self.out[begin..]);
    }
}

/// Reads a CDR message. It never panics, and checks each length against the bytes that are left.
#[derive(Clone, Debug)]
pub struct Reader<'a> {
    body: &'a [u8],
    at: usize,
    dialect: Dialect,
}

impl<'a> Reader<'a> {
    /// Checks ROS 2's encapsulation header, and reads what follows.
    pub fn new(payload: &'a [u8]) -> Result<Self, DecodeError> {
        match payload {
            // The options (last two bytes) give the padding at the end, which needs no treatment.
            [0, 1, _, _, body @ ..] => Ok(Self { body, at: 0, dialect: Dialect::Ros2 }),
            _ => Err(DecodeError::Encapsulation(payload[..payload.len().min(4)].to_vec())),
        }
    }

    /// Begins a message in either encoding; ROS 1's has no header to check.
    pub fn with(dialect: Dialect, payload: &'a [u8]) -> Result<Self, DecodeError> {
        match dialect {
            Dialect::Ros2 => Self::new(payload),
            Dialect::Ros1 => Ok(Self { body: payload, at: 0, dialect }),
        }
    }

    /// Returns the encoding, for the few messages whose fields differ.
    pub fn dialect(&self) -> Dialect {
        self.dialect
    }

    /// Returns the number of bytes that are not read yet. Up to 3 bytes of padding may follow a whole message.
    pub fn left(&self) -> usize {
        self.body.len().saturating_sub(self.at)
    }

    fn take(&mut self, field: &'static str, align: usize, size: u64) -> Result<&'a [u8], DecodeError> {
        let begin = if self.dialect == Dialect::Ros2 { self.at.next_multiple_of(align) } else { self.at };
        let rest = self.body.get(begin..).unwrap_or_default();
        let short = DecodeError::Short { field, at: begin, need: size, left: rest.len() };
        let size = usize::try_from(size).map_err(|_| short.clone())?;
        let bytes = rest.get(..size).ok_or(short)?;
        self.at = begin + size;
        Ok(bytes)
    }

    fn array<const N: usize>(&mut self, field: &'static str) -> Result<[u8; N], DecodeError> {
        let mut array = [0; N];
        array.copy_from_slice(self.take(field, N, N as u64)?);
        Ok(array)
    }

    /// Reads one byte.
    pub fn u8(&mut self, field: &'static str) -> Result<u8, DecodeError> {
        self.array(field).map(u8::from_le_bytes)
    }

    /// Reads a boolean: any byte but 0 is true.
    pub fn bool(&mut self, field: &'static str) -> Result<bool, DecodeError> {
        self.u8(field).map(|byte| byte != 0)
    }

    /// Reads a signed integer, aligned to 4 bytes.
    pub fn i32(&mut self, field: &'static str) -> Result<i32, DecodeError> {
        self.array(field).map(i32::from_le_bytes)
    }

    /// Reads an unsigned integer, aligned to 4 bytes.
    pub fn u32(&mut self, field: &'static str) -> Result<u32, DecodeError> {
        self.array(field).map(u32::from_le_bytes)
    }

    /// Reads a float, aligned to 4 bytes.
    pub fn f32(&mut self, field: &'static str) -> Result<f32, DecodeError> {
        self.array(field).map(f32::from_le_bytes)
    }

    /// Reads a double, aligned to 8 bytes.
    pub fn f64(&mut self, field: &'static str) -> Result<f64, DecodeError> {
        self.array(field).map(f64::from_le_bytes)
    }

    /// Reads a double and refuses NaN and infinities.
    pub fn finite(&mut self, field: &'static str) -> Result<f64, DecodeError> {
        let value = self.f64(field)?;
        if value.is_finite() {
            Ok(value)
        } else {
            Err(DecodeError::NotFinite { field, value: value.to_string() })
        }
    }

    /// Reads a fixed array of doubles.
    pub fn f64s<const N: usize>(&mut self, field: &'static str) -> Result<[f64; N], DecodeError> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = self.f64(field)?;
        }
        Ok(values)
    }

    /// Reads a string without its NUL. A length of 0 is an empty string too.
    pub fn string(&mut self, field: &'static str) -> Result<&'a str, DecodeError> {
        let length = self.u32(field)?;
        let bytes = self.take(field, 1, u64::from(length))?;
        let text = match (self.dialect, bytes) {
            (Dialect::Ros1, _) | (_, []) => bytes,
            (_, [text @ .., 0]) => text,
            _ => return Err(DecodeError::Text { field }),
        };
        core::str::from_utf8(text).map_err(|_| DecodeError::Text { field })
    }

    /// Reads the count of a sequence whose elements take at least `element` bytes each, and checks that so many are
    /// left.
    pub fn count(&mut self, field: &'static str, element: usize) -> Result<usize, DecodeError> {
        let count = self.u32(field)?;
        let need = u64::from(count) * element as u64;
        if need > self.left() as u64 {
            return Err(DecodeError::Short { field, at: self.at, need, left: self.left() });
        }
        Ok(count as usize)
    }

    /// Reads a sequence of floats as an iterator.
    pub fn f32s(
        &mut self,
        field: &'static str,
    ) -> Result<impl ExactSizeIterator<Item = f32> + use<'a>, DecodeError> {
        let count = self.count(field, 4)?;
        let bytes = self.take(field, 1, 4 * count as u64)?;
        Ok(bytes.as_chunks::<4>().0.iter().map(|chunk| f32::from_le_bytes(*chunk)))
    }

    /// Reads a sequence of floats.
    pub fn f32_seq(&mut self, field: &'static str) -> Result<Vec<f32>, DecodeError> {
        self.f32s(field).map(Iterator::collect)
    }

    /// Reads a sequence of bytes, borrowed.
    pub fn byte_seq(&mut self, field: &'static str) -> Result<&'a [u8], DecodeError> {
        let count = self.u32(field)?;
        self.take(field, 1, u64::from(count))
    }
}
