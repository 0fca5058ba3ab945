//! CDR as ROS 2 puts it on the wire: XCDR1, little-endian, behind a 4-byte encapsulation header
//! (OMG DDS-XTypes 1.3, 7.4.1 and 7.6.2.1.2). Primitives of 2, 4 and 8 bytes are aligned to their size,
//! counted from the first byte after that header.
//!
//! ROS 1's serialisation differs in little ([`Dialect::Ros1`]): no header, no alignment, strings without NUL.

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Representation "CDR, little-endian", no options.
pub const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];

/// A message without fields has one byte in ROS 2 all the same.
const EMPTY_MESSAGE: [u8; 5] = [0, 1, 0, 0, 0];

/// A payload as ROS 2 wants it: Unity's connector writes nothing behind the header of a message without fields, and
/// Fast CDR refuses that. All other payloads stay as they are.
pub fn with_dummy_byte(dialect: Dialect, payload: &[u8]) -> &[u8] {
    match payload {
        [0, 1, _, _] if dialect == Dialect::Ros2 => &EMPTY_MESSAGE,
        _ => payload,
    }
}

/// Which ROS the clients were built for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Dialect {
    /// CDR behind its encapsulation header.
    #[default]
    Ros2,
    /// Packed; std_msgs/Header begins with `seq`.
    Ros1,
}

/// Why bytes are not the message they should be.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum DecodeError {
    /// The encapsulation header is missing or names another representation.
    #[error("the payload must begin with 00 01 00 00 (little-endian CDR), not with {0:02x?}")]
    Encapsulation(Vec<u8>),
    /// The payload ends inside a field.
    #[error("{field} needs {need} bytes at offset {at}, {left} are left")]
    Short {
        /// The field being read.
        field: &'static str,
        /// Offset in the payload behind the encapsulation header.
        at: usize,
        /// Bytes the field needs.
        need: u64,
        /// Bytes that are there.
        left: usize,
    },
    /// A string that is not UTF-8 or does not end in NUL.
    #[error("{field} is not a NUL-terminated UTF-8 string")]
    Text {
        /// The field being read.
        field: &'static str,
    },
    /// NaN or infinity where a number is needed.
    #[error("{field} is {value}: a finite number is needed")]
    NotFinite {
        /// The field being read.
        field: &'static str,
        /// As text.
        value: String,
    },
    /// Numbers that contradict each other.
    #[error("{what}")]
    Inconsistent {
        /// Which, and how.
        what: String,
    },
}

/// Appends a CDR message to a buffer that may already hold other bytes.
pub struct Writer<'a> {
    out: &'a mut Vec<u8>,
    origin: usize,
    dialect: Dialect,
}

impl<'a> Writer<'a> {
    /// Writes the encapsulation header; what follows is aligned to the byte after it.
    pub fn new(out: &'a mut Vec<u8>) -> Self {
        Self::with(Dialect::Ros2, out)
    }

    /// The same in either dialect; ROS 1 has no such header.
    pub fn with(dialect: Dialect, out: &'a mut Vec<u8>) -> Self {
        if dialect == Dialect::Ros2 {
            out.extend_from_slice(&ENCAPSULATION);
        }
        let origin = out.len();
        Self { out, origin, dialect }
    }

    /// For the few messages whose fields differ.
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

    /// One byte.
    pub fn u8(&mut self, value: u8) {
        self.out.push(value);
    }

    /// 1 or 0 in one byte.
    pub fn bool(&mut self, value: bool) {
        self.out.push(u8::from(value));
    }

    /// Aligned to 4.
    pub fn i32(&mut self, value: i32) {
        self.align(4);
        self.out.extend_from_slice(&value.to_le_bytes());
    }

    /// Aligned to 4.
    pub fn u32(&mut self, value: u32) {
        self.align(4);
        self.out.extend_from_slice(&value.to_le_bytes());
    }

    /// Aligned to 4.
    pub fn f32(&mut self, value: f32) {
        self.align(4);
        self.out.extend_from_slice(&value.to_le_bytes());
    }

    /// Aligned to 8.
    pub fn f64(&mut self, value: f64) {
        self.align(8);
        self.out.extend_from_slice(&value.to_le_bytes());
    }

    /// A fixed array of doubles: elements only.
    pub fn f64s(&mut self, values: &[f64]) {
        values.iter().for_each(|value| self.f64(*value));
    }

    /// Length with the NUL, bytes, NUL (ROS 1: without). A NUL inside ends the string, as in C.
    pub fn string(&mut self, text: &str) {
        let text = text.split('\0').next().unwrap_or_default();
        let nul: &[u8] = if self.dialect == Dialect::Ros2 { b"\0" } else { b"" };
        self.count(text.len() + nul.len());
        self.out.extend_from_slice(text.as_bytes());
        self.out.extend_from_slice(nul);
    }

    /// The element count of a sequence. All of ours are bounded far below `u32::MAX`.
    pub fn count(&mut self, elements: usize) {
        self.u32(u32::try_from(elements).unwrap_or(u32::MAX));
    }

    /// A sequence of floats.
    pub fn f32_seq(&mut self, values: &[f32]) {
        self.count(values.len());
        let begin = self.out.len();
        self.out.resize(begin + 4 * values.len(), 0);
        for (place, value) in self.out[begin..].chunks_exact_mut(4).zip(values) {
            place.copy_from_slice(&value.to_le_bytes());
        }
    }

    /// A sequence of bytes that `fill` writes in place.
    pub fn byte_seq_with(&mut self, length: usize, fill: impl FnOnce(&mut [u8])) {
        self.count(length);
        let begin = self.out.len();
        self.out.resize(begin + length, 0);
        fill(&mut self.out[begin..]);
    }
}

/// Reads a CDR message. Never panics; a length is believed only if that many bytes are there.
#[derive(Clone, Debug)]
pub struct Reader<'a> {
    body: &'a [u8],
    at: usize,
    dialect: Dialect,
}

impl<'a> Reader<'a> {
    /// Checks the encapsulation header.
    pub fn new(payload: &'a [u8]) -> Result<Self, DecodeError> {
        match payload {
            // The options (last two bytes) tell of padding at the end; there is nothing to obey.
            [0, 1, _, _, body @ ..] => Ok(Self { body, at: 0, dialect: Dialect::Ros2 }),
            _ => Err(DecodeError::Encapsulation(payload[..payload.len().min(4)].to_vec())),
        }
    }

    /// The same in either dialect; ROS 1 has no header to check.
    pub fn with(dialect: Dialect, payload: &'a [u8]) -> Result<Self, DecodeError> {
        match dialect {
            Dialect::Ros2 => Self::new(payload),
            Dialect::Ros1 => Ok(Self { body: payload, at: 0, dialect }),
        }
    }

    /// For the few messages whose fields differ.
    pub fn dialect(&self) -> Dialect {
        self.dialect
    }

    /// Bytes not read yet. Up to 3 may remain behind a whole message: padding.
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

    /// One byte.
    pub fn u8(&mut self, field: &'static str) -> Result<u8, DecodeError> {
        self.array(field).map(u8::from_le_bytes)
    }

    /// Any byte but 0 is true.
    pub fn bool(&mut self, field: &'static str) -> Result<bool, DecodeError> {
        self.u8(field).map(|byte| byte != 0)
    }

    /// Aligned to 4.
    pub fn i32(&mut self, field: &'static str) -> Result<i32, DecodeError> {
        self.array(field).map(i32::from_le_bytes)
    }

    /// Aligned to 4.
    pub fn u32(&mut self, field: &'static str) -> Result<u32, DecodeError> {
        self.array(field).map(u32::from_le_bytes)
    }

    /// Aligned to 4.
    pub fn f32(&mut self, field: &'static str) -> Result<f32, DecodeError> {
        self.array(field).map(f32::from_le_bytes)
    }

    /// Aligned to 8.
    pub fn f64(&mut self, field: &'static str) -> Result<f64, DecodeError> {
        self.array(field).map(f64::from_le_bytes)
    }

    /// A double that is a number.
    pub fn finite(&mut self, field: &'static str) -> Result<f64, DecodeError> {
        let value = self.f64(field)?;
        if value.is_finite() {
            Ok(value)
        } else {
            Err(DecodeError::NotFinite { field, value: value.to_string() })
        }
    }

    /// A fixed array of doubles.
    pub fn f64s<const N: usize>(&mut self, field: &'static str) -> Result<[f64; N], DecodeError> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = self.f64(field)?;
        }
        Ok(values)
    }

    /// The text without its NUL. A length of 0 is an empty string, too.
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

    /// The count of a sequence whose elements take at least `element` bytes each, all of them there.
    pub fn count(&mut self, field: &'static str, element: usize) -> Result<usize, DecodeError> {
        let count = self.u32(field)?;
        let need = u64::from(count) * element as u64;
        if need > self.left() as u64 {
            return Err(DecodeError::Short { field, at: self.at, need, left: self.left() });
        }
        Ok(count as usize)
    }

    /// A sequence of floats, read as they are taken.
    pub fn f32s(
        &mut self,
        field: &'static str,
    ) -> Result<impl ExactSizeIterator<Item = f32> + use<'a>, DecodeError> {
        let count = self.count(field, 4)?;
        let bytes = self.take(field, 1, 4 * count as u64)?;
        Ok(bytes.as_chunks::<4>().0.iter().map(|chunk| f32::from_le_bytes(*chunk)))
    }

    /// A sequence of floats.
    pub fn f32_seq(&mut self, field: &'static str) -> Result<Vec<f32>, DecodeError> {
        self.f32s(field).map(Iterator::collect)
    }

    /// A sequence of bytes, borrowed.
    pub fn byte_seq(&mut self, field: &'static str) -> Result<&'a [u8], DecodeError> {
        let count = self.u32(field)?;
        self.take(field, 1, u64::from(count))
    }
}
