//! Parts of a robot's map: their keys, hashes and contents.

use msg::{MapHeader, MapTile, Submap, SubmapPoses};
use std::sync::Arc;

/// Largest compressed part, bytes: a submap of noise does not compress.
pub const PART_BYTES_MAX: usize = 300 << 10;
/// Number of bytes of an encoded key.
pub const KEY_BYTES: usize = 9;
/// Hash of a part that does not exist.
pub const ABSENT: u64 = 0;

/// Key of a part of a robot's map.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum PartKey {
    /// Lattice and stamp of the map.
    MapHeader,
    /// Poses of the submaps and the relations between them.
    SubmapPoses,
    /// Tile of the map, by its column and row.
    Tile(i32, i32),
    /// Submap, by its id.
    Submap(u32),
}

impl PartKey {
    /// Encodes the key.
    pub fn to_bytes(self) -> [u8; KEY_BYTES] {
        let (kind, a, b) = match self {
            Self::MapHeader => (0, 0, 0),
            Self::SubmapPoses => (1, 0, 0),
            Self::Tile(x, y) => (2, x, y),
            Self::Submap(id) => (3, id as i32, 0),
        };
        let mut bytes = [kind; KEY_BYTES];
        bytes[1..5].copy_from_slice(&a.to_le_bytes());
        bytes[5..].copy_from_slice(&b.to_le_bytes());
        bytes
    }

    /// Decodes a key; `None` for an unknown kind.
    pub fn from_bytes(bytes: [u8; KEY_BYTES]) -> Option<Self> {
        let [kind, a @ .., b0, b1, b2, b3] = bytes;
        let (a, b) = (i32::from_le_bytes(a), i32::from_le_bytes([b0, b1, b2, b3]));
        match kind {
            0 => Some(Self::MapHeader),
            1 => Some(Self::SubmapPoses),
            2 => Some(Self::Tile(a, b)),
            3 => Some(Self::Submap(a as u32)),
            _ => None,
        }
    }
}

/// Content of a part.
#[derive(Clone, Debug)]
pub enum PartContent {
    /// Lattice and stamp of the map.
    MapHeader(MapHeader),
    /// Poses of the submaps.
    SubmapPoses(Box<SubmapPoses>),
    /// Tile of the map.
    Tile(Arc<MapTile>),
    /// One of the robot's submaps.
    Submap(Box<Submap>),
}

/// Reason why a part's content is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PartError {
    /// The bytes do not decompress, or to more than such a part can have.
    #[error("a part does not decompress to at most {limit} bytes")]
    Compression {
        /// Largest size of such a part.
        limit: usize,
    },
    /// The content has another length than its counts say.
    #[error("a part has {found} bytes where {expected} are expected")]
    Length {
        /// Length of the content.
        found: usize,
        /// Length that the content's own counts ask for.
        expected: usize,
    },
    /// The content does not have the hash that its sender named.
    #[error("the content of a part does not have the hash that its sender named")]
    Hash,
    /// A number is out of its range.
    #[error("a part is for another place than its key says, or one of its counts is out of range")]
    Range,
}

/// Returns the hash of a part's uncompressed content: FNV-1a with 64 bits, never [`ABSENT`].
pub fn hash(bytes: &[u8]) -> u64 {
    const OFFSET_BASIS: u64 = 0xcbf2_9ce4_8422_2325;
    const PRIME: u64 = 0x0100_0000_01b3;
    let hash = bytes.iter().fold(OFFSET_BASIS, |hash, byte| (hash ^ u64::from(*byte)).wrapping_mul(PRIME));
    hash.max(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_survive_the_wire() {
        let keys =
            [PartKey::MapHeader, PartKey::SubmapPoses, PartKey::Tile(-3, i32::MAX), PartKey::Submap(255)];
        for key in keys {
            assert_eq!(PartKey::from_bytes(key.to_bytes()), Some(key));
        }
        assert_eq!(PartKey::from_bytes([9; KEY_BYTES]), None);
    }
}
