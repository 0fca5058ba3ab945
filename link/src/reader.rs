//! Reads little-endian numbers from a message, and never beyond its end.

use crate::error::WireError;
use msg::Pose2;

/// Reads numbers from the front of a message.
pub struct Reader<'a> {
    /// What is left of the message.
    pub bytes: &'a [u8],
    /// Length of the whole message, for errors.
    pub whole: usize,
}

impl Reader<'_> {
    pub fn array<const N: usize>(&mut self) -> Result<[u8; N], WireError> {
        let (first, rest) = self.bytes.split_first_chunk().ok_or(WireError::Length(self.whole))?;
        self.bytes = rest;
        Ok(*first)
    }

    pub fn u16(&mut self) -> Result<u16, WireError> {
        self.array().map(u16::from_le_bytes)
    }

    pub fn u32(&mut self) -> Result<u32, WireError> {
        self.array().map(u32::from_le_bytes)
    }

    pub fn u64(&mut self) -> Result<u64, WireError> {
        self.array().map(u64::from_le_bytes)
    }

    pub fn i64(&mut self) -> Result<i64, WireError> {
        self.array().map(i64::from_le_bytes)
    }

    pub fn f32(&mut self) -> Result<f32, WireError> {
        self.array().map(f32::from_le_bytes)
    }

    pub fn f64(&mut self) -> Result<f64, WireError> {
        self.array().map(f64::from_le_bytes)
    }

    pub fn pose(&mut self) -> Result<Pose2, WireError> {
        Ok(Pose2 { x_m: self.f64()?, y_m: self.f64()?, yaw_rad: self.f64()? })
    }

    /// Reads a byte that is 0 or 1; `None` for any other, or at the end.
    pub fn flag(&mut self) -> Option<bool> {
        match self.array() {
            Ok([0]) => Some(false),
            Ok([1]) => Some(true),
            _ => None,
        }
    }
}
