//! The robots' maps as the merge process holds them, kept for its next process: it continues with them at once, also where
//! a robot's SLAM process does not answer. Files in the run's folder, one for each robot.

use crate::run::Run;
use crate::storage::{Storage, keep_unusable};
use bytemuck::{Pod, Zeroable};
use formats::gzip;
use msg::tiles::{MAP_TILES_MAX, ROBOT_TILES_MAX};
use msg::{IndexRect, MapHeader, MapTile, Monotonic, RobotId, TileMap};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

/// The format this program reads and writes.
const VERSION: u32 = 1;
/// Time between two writes of one robot's map: what a death at the same moment as that of the robot's SLAM may cost.
const PERIOD: Duration = Duration::from_secs(1);
/// The longest content of a file, bytes.
const BYTES_MAX: u64 = (size_of::<Prefix>() + ROBOT_TILES_MAX * size_of::<MapTile>()) as u64;

/// First bytes of a file, before its tiles. The fields leave no padding.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
struct Prefix {
    version: u32,
    /// Padding, always zero.
    reserved: u32,
    /// Start of the run, which tells it from others in the same folder.
    run: u64,
    pose_estimate_received: Monotonic,
    map: MapHeader,
}

/// A robot's map as merging holds it.
#[derive(Clone, Debug)]
pub struct HeldMap {
    /// The newest map that its SLAM sent.
    pub map: TileMap,
    /// Time of the newest answer of its SLAM to a scan.
    pub pose_estimate_received: Monotonic,
}

/// Reason why a file cannot be used.
#[derive(Debug, thiserror::Error)]
enum Unusable {
    /// The file cannot be read or unpacked.
    #[error(transparent)]
    Read(#[from] io::Error),
    /// It has another format, or is cut.
    #[error("is no map of format version {VERSION}")]
    Format,
    /// Another run left it in this folder.
    #[error("is of another run")]
    Run,
    /// Its header or a tile's place is invalid.
    #[error("has an invalid map")]
    Map,
}

/// The newest maps that are not written yet, from the thread that draws to the one that writes.
#[derive(Default)]
pub struct MapSlot(Mutex<Vec<(RobotId, HeldMap)>>);

impl MapSlot {
    /// Stores a robot's newest map in place of an older one.
    pub fn put(&self, robot: RobotId, map: HeldMap) {
        let mut maps = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        match maps.iter_mut().find(|(other, _)| *other == robot) {
            Some((_, older)) => *older = map,
            None => maps.push((robot, map)),
        }
    }

    fn take(&self) -> RestoredMaps {
        std::mem::take(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

/// Writes and reads the files of a run.
pub struct MapFiles<S> {
    storage: S,
    folder: PathBuf,
    run: u64,
    due: Monotonic,
    /// Whether the last write failed, which was said then.
    has_failed: bool,
}

impl<S: Storage> MapFiles<S> {
    /// Creates the files' reader and writer; nothing is read or written yet.
    pub fn new(run: &Run, storage: S) -> Self {
        let (folder, run) = (run.dir.clone(), run.begun.0);
        Self { storage, folder, run, due: Monotonic::default(), has_failed: false }
    }

    /// Reads what an earlier process of this run wrote. A file that cannot be used is reported and ignored.
    pub fn restore(&self, robots: impl Iterator<Item = RobotId>) -> RestoredMaps {
        let restore = |robot| {
            let path = path(&self.folder, robot);
            match self.read(&path) {
                Ok(map) => Some((robot, map)),
                Err(Unusable::Read(why)) if why.kind() == io::ErrorKind::NotFound => None,
                Err(why) => {
                    let kept = match why {
                        Unusable::Run => "it is written anew".into(),
                        _ => keep_unusable(&self.storage, &path),
                    };
                    tracing::warn!(
                        "merge: {}: {why}; {robot}'s map comes from its SLAM alone; {kept}",
                        path.display()
                    );
                    None
                }
            }
        };
        robots.filter_map(restore).collect()
    }

    /// Writes the maps that have changed, at most once a second.
    pub fn save(&mut self, maps: &MapSlot, now: Monotonic) {
        if now < self.due {
            return;
        }
        self.due = now + PERIOD;
        let had_failed = std::mem::take(&mut self.has_failed);
        for (robot, map) in maps.take() {
            let path = path(&self.folder, robot);
            let written =
                gzip::pack(&self.encode(&map)).and_then(|bytes| self.storage.replace(&path, &bytes));
            if let Err(why) = &written
                && !had_failed
            {
                tracing::warn!("merge: {}: {why}; the next change is tried again", path.display());
            }
            self.has_failed |= written.is_err();
        }
    }

    fn encode(&self, HeldMap { map, pose_estimate_received }: &HeldMap) -> Vec<u8> {
        let (run, pose_estimate_received) = (self.run, *pose_estimate_received);
        let prefix = Prefix { version: VERSION, reserved: 0, run, pose_estimate_received, map: map.header };
        let mut bytes = bytemuck::bytes_of(&prefix).to_vec();
        map.tiles().for_each(|tile| bytes.extend_from_slice(bytemuck::bytes_of(&**tile)));
        bytes
    }

    fn read(&self, path: &Path) -> Result<HeldMap, Unusable> {
        let bytes = gzip::unpack(self.storage.read(path, BYTES_MAX)?, BYTES_MAX)?;
        let (prefix, tiles) = bytes.split_at_checked(size_of::<Prefix>()).ok_or(Unusable::Format)?;
        let prefix: Prefix = bytemuck::pod_read_unaligned(prefix);
        let tiles = tiles.chunks_exact(size_of::<MapTile>());
        if prefix.version != VERSION || !tiles.remainder().is_empty() {
            return Err(Unusable::Format);
        }
        if prefix.run != self.run {
            return Err(Unusable::Run);
        }
        let mut map = TileMap::new(prefix.map);
        for tile in tiles {
            let tile: MapTile = bytemuck::pod_read_unaligned(tile);
            let (x, y) = (i64::from(tile.x), i64::from(tile.y));
            if !map.grow_to(IndexRect::single(x, y), MAP_TILES_MAX) {
                return Err(Unusable::Map);
            }
            map.set(x, y, Some(tile.into()));
        }
        let held = HeldMap { map, pose_estimate_received: prefix.pose_estimate_received };
        if held.map.header.is_valid() { Ok(held) } else { Err(Unusable::Map) }
    }
}

/// Robots' maps, such as an earlier process of this run held.
pub type RestoredMaps = Vec<(RobotId, HeldMap)>;

/// Returns the path of a robot's file.
pub fn path(folder: &Path, robot: RobotId) -> PathBuf {
    folder.join(format!("merge_{robot}.map.gz"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::storage::DiskStorage;
    use msg::{Header, Stamp};

    fn robot() -> RobotId {
        RobotId::new(3).unwrap()
    }

    fn files(folder: &Path, run: u64) -> MapFiles<DiskStorage> {
        let folder = folder.to_owned();
        MapFiles { storage: DiskStorage, folder, run, due: Monotonic::default(), has_failed: false }
    }

    /// A map with two tiles far apart.
    fn map() -> HeldMap {
        let header = Header { stamp: Stamp(5), seq: 7, incarnation: 2, ..Header::default() };
        let mut map = TileMap::new(MapHeader { header, resolution_m: 0.05, ..MapHeader::default() });
        for (x, y, cell) in [(-3, 2, 60), (4, -1, -60)] {
            assert!(map.grow_to(IndexRect::single(x, y), MAP_TILES_MAX));
            map.get_mut(x, y).unwrap().cells[9] = cell;
        }
        HeldMap { map, pose_estimate_received: Monotonic(11) }
    }

    #[test]
    fn a_map_comes_back_with_its_header_and_every_cell() {
        let folder = tempfile::tempdir().unwrap();
        let slot = MapSlot::default();
        let mut files = files(folder.path(), 7);
        assert!(files.restore([robot()].into_iter()).is_empty());
        slot.put(robot(), HeldMap { map: TileMap::default(), ..map() });
        slot.put(robot(), map());
        files.save(&slot, Monotonic(1));
        let restored = files.restore([robot()].into_iter());
        let (of, read) = &restored[0];
        assert_eq!(
            (*of, read.map.header, read.pose_estimate_received),
            (robot(), map().map.header, Monotonic(11))
        );
        assert!(read.map.tiles().eq(map().map.tiles()));
        // Nothing is written between the periods, and nothing that did not change.
        slot.put(robot(), HeldMap { map: TileMap::default(), ..map() });
        files.save(&slot, Monotonic(2));
        assert_eq!(files.restore([robot()].into_iter()).len(), 1);
        files.save(&slot, Monotonic(1) + PERIOD);
        std::fs::remove_file(path(folder.path(), robot())).unwrap();
        files.save(&slot, Monotonic(1) + 2 * PERIOD);
        assert!(files.restore([robot()].into_iter()).is_empty());
    }

    #[test]
    fn what_cannot_be_used_is_refused_with_the_reason() {
        let folder = tempfile::tempdir().unwrap();
        let files = files(folder.path(), 7);
        let whole = files.encode(&map());
        let refused = |bytes: &[u8]| {
            std::fs::write(path(folder.path(), robot()), bytes).unwrap();
            files.read(&path(folder.path(), robot())).unwrap_err().to_string()
        };
        let with = |at: usize, byte: u8| {
            let mut bytes = whole.clone();
            bytes[at] = byte;
            bytes
        };
        assert!(refused(&[]).contains("no map"));
        assert!(refused(&whole[..whole.len() - 1]).contains("no map"));
        assert!(refused(&with(0, 9)).contains("no map"));
        assert!(refused(&with(8, 9)).contains("another run"));
        assert!(refused(&with(size_of::<Prefix>() + 3, 0x7f)).contains("invalid map"));
        let packed = gzip::pack(&whole).unwrap();
        refused(&packed[..packed.len() / 2]);
    }
}
