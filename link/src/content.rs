//! Encoding of parts: plain data without unused places, compressed with DEFLATE.

use crate::part::{PART_BYTES_MAX, PartContent, PartError, PartKey};
use bytemuck::{Pod, bytes_of, cast_slice, pod_read_unaligned};
use flate2::Compression;
use flate2::read::DeflateDecoder;
use flate2::write::DeflateEncoder;
use msg::{
    MapHeader, MapTile, Pose2, SUBMAP_CELLS_MAX, SUBMAP_EDGES_MAX, SUBMAPS_MAX, Submap, SubmapEdge,
    SubmapPoses,
};
use std::io::{Read, Write};
use std::mem::offset_of;
use std::sync::Arc;

// The format is little-endian, and so are all machines that it is read on.
const _: () = assert!(cfg!(target_endian = "little"));

/// Number of bytes of a submap before its cells.
const SUBMAP_HEAD: usize = offset_of!(Submap, cells);
/// Number of bytes of submap poses before the poses.
const POSES_HEAD: usize = offset_of!(SubmapPoses, robot_map_from_submap);

/// Largest uncompressed content of a part, bytes.
fn limit(key: PartKey) -> usize {
    match key {
        PartKey::MapHeader => size_of::<MapHeader>(),
        PartKey::SubmapPoses => size_of::<SubmapPoses>(),
        PartKey::Tile(..) => size_of::<MapTile>(),
        PartKey::Submap(_) => SUBMAP_HEAD + SUBMAP_CELLS_MAX,
    }
}

/// Encodes the content without compression. Unused places at the ends of arrays are left out.
pub fn encode(content: &PartContent) -> Vec<u8> {
    match content {
        PartContent::MapHeader(header) => bytes_of(header).to_vec(),
        PartContent::Tile(tile) => bytes_of(&**tile).to_vec(),
        PartContent::Submap(submap) => {
            let cells = submap.view().map_or(0, |view| view.cells.len());
            bytes_of(&**submap)[..SUBMAP_HEAD + cells].to_vec()
        }
        PartContent::SubmapPoses(poses) => {
            let head = &bytes_of(&**poses)[..POSES_HEAD];
            [head, cast_slice(poses.poses()), cast_slice(poses.edges())].concat()
        }
    }
}

/// Compresses an encoded content.
pub fn compress(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = DeflateEncoder::new(Vec::new(), Compression::best());
    // Writing to memory does not fail.
    let _ = encoder.write_all(bytes);
    encoder.finish().unwrap_or_default()
}

/// Decompresses and decodes the content of a part, and checks it against its key and its hash.
pub fn decode(key: PartKey, hash: u64, compressed: &[u8]) -> Result<PartContent, PartError> {
    let limit = limit(key);
    let mut bytes = Vec::new();
    let read = DeflateDecoder::new(compressed).take(limit as u64 + 1).read_to_end(&mut bytes);
    if read.is_err() || bytes.len() > limit || compressed.len() > PART_BYTES_MAX {
        return Err(PartError::Compression { limit });
    }
    if crate::part::hash(&bytes) != hash {
        return Err(PartError::Hash);
    }
    decode_plain(key, &bytes)
}

fn decode_plain(key: PartKey, bytes: &[u8]) -> Result<PartContent, PartError> {
    match key {
        PartKey::MapHeader => {
            let header: MapHeader = read_whole(bytes)?;
            if header.is_valid() { Ok(PartContent::MapHeader(header)) } else { Err(PartError::Range) }
        }
        PartKey::Tile(x, y) => {
            let tile: MapTile = read_whole(bytes)?;
            if (tile.x, tile.y) == (x, y) {
                Ok(PartContent::Tile(Arc::new(tile)))
            } else {
                Err(PartError::Range)
            }
        }
        PartKey::Submap(id) => decode_submap(id, bytes),
        PartKey::SubmapPoses => decode_poses(bytes),
    }
}

fn decode_submap(id: u32, bytes: &[u8]) -> Result<PartContent, PartError> {
    let mut submap: Box<Submap> = bytemuck::allocation::zeroed_box();
    copy_start(bytemuck::bytes_of_mut(&mut *submap), bytes, SUBMAP_HEAD)?;
    let cells = submap.view().ok_or(PartError::Range)?.cells.len();
    if submap.id != id || id as usize >= SUBMAPS_MAX {
        return Err(PartError::Range);
    }
    check_length(bytes, SUBMAP_HEAD + cells)?;
    Ok(PartContent::Submap(submap))
}

fn decode_poses(bytes: &[u8]) -> Result<PartContent, PartError> {
    let mut poses: Box<SubmapPoses> = bytemuck::allocation::zeroed_box();
    let head =
        bytes.get(..POSES_HEAD).ok_or(PartError::Length { found: bytes.len(), expected: POSES_HEAD })?;
    bytemuck::bytes_of_mut(&mut *poses)[..POSES_HEAD].copy_from_slice(head);
    let (len, edges_len) = (poses.len as usize, poses.edges_len as usize);
    if len > SUBMAPS_MAX || edges_len > SUBMAP_EDGES_MAX {
        return Err(PartError::Range);
    }
    let edges_at = POSES_HEAD + len * size_of::<Pose2>();
    check_length(bytes, edges_at + edges_len * size_of::<SubmapEdge>())?;
    let to = bytemuck::cast_slice_mut(&mut poses.robot_map_from_submap[..len]);
    to.copy_from_slice(&bytes[POSES_HEAD..edges_at]);
    bytemuck::cast_slice_mut(&mut poses.edges[..edges_len]).copy_from_slice(&bytes[edges_at..]);
    let is_finite = poses.poses().iter().all(|pose| pose.is_finite());
    if is_finite { Ok(PartContent::SubmapPoses(poses)) } else { Err(PartError::Range) }
}

fn read_whole<T: Pod>(bytes: &[u8]) -> Result<T, PartError> {
    check_length(bytes, size_of::<T>())?;
    Ok(pod_read_unaligned(bytes))
}

/// Copies `bytes`, which must have at least `least`, to the start of a larger place.
fn copy_start(place: &mut [u8], bytes: &[u8], least: usize) -> Result<(), PartError> {
    let wrong = PartError::Length { found: bytes.len(), expected: least };
    if bytes.len() < least {
        return Err(wrong);
    }
    place.get_mut(..bytes.len()).ok_or(wrong)?.copy_from_slice(bytes);
    Ok(())
}

fn check_length(bytes: &[u8], expected: usize) -> Result<(), PartError> {
    let found = bytes.len();
    if found == expected { Ok(()) } else { Err(PartError::Length { found, expected }) }
}
