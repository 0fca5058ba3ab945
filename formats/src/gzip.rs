//! Gzip streams: packed, and unpacked up to a limit, so that a small file cannot fill the memory.

use flate2::Compression;
use flate2::read::MultiGzDecoder;
use flate2::write::GzEncoder;
use std::io::{self, Read, Write};

/// First bytes of a gzip stream (RFC 1952).
const MAGIC: [u8; 2] = [0x1f, 0x8b];

/// Unpacks `bytes` if they are a gzip stream; returns anything else unchanged.
///
/// Errors: a broken stream, or more than `max_bytes` bytes of content.
pub fn unpack(bytes: Vec<u8>, max_bytes: u64) -> io::Result<Vec<u8>> {
    if !bytes.starts_with(&MAGIC) {
        return match bytes.len() as u64 <= max_bytes {
            true => Ok(bytes),
            false => Err(too_long(max_bytes)),
        };
    }
    let mut unpacked = Vec::new();
    MultiGzDecoder::new(bytes.as_slice()).take(max_bytes.saturating_add(1)).read_to_end(&mut unpacked)?;
    if unpacked.len() as u64 > max_bytes {
        return Err(too_long(max_bytes));
    }
    Ok(unpacked)
}

/// Packs `bytes` into a gzip stream, quickly rather than small.
///
/// # Errors
/// None occurs in practice: the stream is written to memory.
pub fn pack(bytes: &[u8]) -> io::Result<Vec<u8>> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::fast());
    encoder.write_all(bytes)?;
    encoder.finish()
}

fn too_long(max_bytes: u64) -> io::Error {
    io::Error::new(
        io::ErrorKind::FileTooLarge,
        format!("more than {max_bytes} bytes; expected at most that many"),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn packed(bytes: &[u8]) -> Vec<u8> {
        pack(bytes).unwrap()
    }

    #[test]
    fn gzip_is_unpacked_and_other_bytes_are_left() {
        assert_eq!(unpack(packed(b"FLASER"), 6).unwrap(), b"FLASER");
        assert_eq!(unpack(b"FLASER".to_vec(), 6).unwrap(), b"FLASER");
        // Several streams, one after the other, are one file.
        assert_eq!(unpack([packed(b"a"), packed(b"b")].concat(), 2).unwrap(), b"ab");
    }

    #[test]
    fn content_beyond_the_limit_is_refused() {
        let bomb = packed(&vec![0; 1 << 20]);
        assert!(bomb.len() < 20_000);
        assert_eq!(unpack(bomb, 1000).unwrap_err().kind(), io::ErrorKind::FileTooLarge);
        assert_eq!(unpack(vec![1; 10], 9).unwrap_err().kind(), io::ErrorKind::FileTooLarge);
    }

    #[test]
    fn a_cut_stream_is_refused() {
        let whole = packed(b"FLASER 180");
        assert!(unpack(whole[..whole.len() - 3].to_vec(), 100).is_err());
    }
}
