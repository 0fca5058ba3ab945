//! Numbers in frames, headers of WebSocket frames, and the writing of long payloads.

use super::{COPIED_MAX, ENCODED_MAX};
use std::io::{self, IoSlice};

/// Writes a part of a payload behind what is encoded; returns how much of the part is taken.
pub(super) fn pass_on(
    encoded: &mut Vec<u8>,
    part: &[u8],
    write: &mut impl FnMut(&[IoSlice<'_>]) -> io::Result<usize>,
) -> io::Result<usize> {
    let waiting = encoded.len();
    if part.len() <= COPIED_MAX && waiting + part.len() <= ENCODED_MAX {
        encoded.extend_from_slice(part);
        return Ok(part.len());
    }
    let slices = [IoSlice::new(encoded), IoSlice::new(part)];
    let written = write(if waiting > 0 { &slices } else { &slices[1..] })?;
    if written == 0 {
        return Err(io::ErrorKind::WriteZero.into());
    }
    encoded.drain(..written.min(waiting));
    match written.saturating_sub(waiting) {
        0 => Err(io::ErrorKind::WouldBlock.into()),
        taken => Ok(taken),
    }
}

/// Appends the header of an unmasked WebSocket frame (RFC 6455, 5.2).
pub(super) fn push_frame_header(out: &mut Vec<u8>, first: u8, bytes: usize) {
    out.push(first);
    match (u8::try_from(bytes), u16::try_from(bytes)) {
        (Ok(short), _) if short < 126 => out.push(short),
        (_, Ok(medium)) => {
            out.push(126);
            out.extend_from_slice(&medium.to_be_bytes());
        }
        _ => {
            out.push(127);
            out.extend_from_slice(&(bytes as u64).to_be_bytes());
        }
    }
}

pub(super) fn length_at(bytes: &[u8], offset: usize) -> Option<usize> {
    let bytes = bytes.get(offset..offset + 4)?.try_into().ok()?;
    Some(u32::from_le_bytes(bytes) as usize)
}

/// Returns a ROS stamp (seconds, nanoseconds) in nanoseconds; a negative one is none.
pub(super) fn stamp_at(bytes: &[u8], offset: usize) -> Option<u64> {
    let seconds = i32::from_le_bytes(bytes.get(offset..offset + 4)?.try_into().ok()?);
    let nanoseconds = u32::from_le_bytes(bytes.get(offset + 4..offset + 8)?.try_into().ok()?);
    Some(u64::try_from(seconds).ok()? * 1_000_000_000 + u64::from(nanoseconds))
}
