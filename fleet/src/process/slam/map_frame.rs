//! The number of the robot's map frame. It changes when the map becomes one of another frame, and merging forgets then where the robot's
//! map lay. A file beside the session keeps it across restarts of the process.

use crate::ports::Clock;
use crate::run::Run;
use crate::sessions;
use crate::storage::Storage;
use msg::RobotId;
use std::io;
use std::path::{Path, PathBuf};

/// Number of a map frame, and the file that keeps it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MapFrame {
    /// The number; 0 is the frame in which the robot began.
    pub number: u32,
    /// Changes that the back end counted and the number has.
    changes: u32,
    file: PathBuf,
}

impl MapFrame {
    /// Reads the number of a robot's frame, of the session that is saved. One that cannot be read is another one than all before: merging looks for the map's place.
    pub fn read(storage: &impl Storage, run: &Run, robot: RobotId, clock: &impl Clock) -> Self {
        let file = sessions::frame_file(&sessions::folder(run), robot);
        let unknown = |why: &dyn std::fmt::Display| {
            tracing::warn!(
                "slam of {robot}: {}: {why}; merging looks for the place of its map",
                file.display()
            );
            // The top bit marks a number that is made up: it differs from each counted one.
            clock.now().0 as u32 | 1 << 31
        };
        let number = sessions::read_frame(storage, &file).unwrap_or_else(|why| unknown(&why));
        Self { number, changes: 0, file }
    }

    /// Returns the frame of a map that was loaded. `is_of_run`: a process of this run has saved it. Its frame is the same only while no
    /// map of another frame was loaded in this run.
    pub fn after_load(&self, is_of_run: bool) -> Self {
        match (is_of_run, self.number) {
            (true, 0) => self.clone(),
            _ => self.next(),
        }
    }

    /// Returns the frame of a map that has another frame than before: nothing is known of where it lies in that one.
    pub fn next(&self) -> Self {
        Self { number: self.number.wrapping_add(1).max(1), ..self.clone() }
    }

    /// Numbers the frame anew if the back end has counted a change since; returns whether it has.
    pub fn follow(&mut self, changes: u32) -> bool {
        let has_changed = std::mem::replace(&mut self.changes, changes) != changes;
        if has_changed {
            *self = self.next();
        }
        has_changed
    }

    /// Begins to follow another back end, which has counted no change.
    pub fn follow_anew(&mut self) {
        self.changes = 0;
    }

    /// Returns the frame if its number must be saved with the session: it is not the one in which the robot began.
    pub fn to_save(&self) -> Option<Self> {
        (self.number != 0).then(|| self.clone())
    }

    /// Returns the path of the file that keeps the number.
    pub fn file(&self) -> &Path {
        &self.file
    }

    /// Writes the number to its file, durably as the session that follows it.
    ///
    /// # Errors
    /// The file cannot be written: the session must not be saved either.
    pub fn write(&self, storage: &impl Storage) -> io::Result<()> {
        storage.write(&self.file, self.number.to_string().as_bytes())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::FleetConfig;
    use crate::lockstep::faults::FaultPlan;
    use crate::lockstep::queues::Network;
    use crate::storage::DiskStorage;

    #[test]
    fn a_map_of_another_frame_has_another_number_also_after_a_restart() {
        let folder = tempfile::tempdir().unwrap();
        let mut run = Run::in_memory(FleetConfig::default()).unwrap();
        run.dir = folder.path().into();
        let network = Network::new(FaultPlan::none());
        let read = || MapFrame::read(&DiskStorage, &run, RobotId::new(1).unwrap(), network.clock());
        let begun = read();
        assert_eq!((begun.number, begun.after_load(true).number), (0, 0));
        let other = begun.after_load(false);
        assert_ne!(other.number, 0);
        other.write(&DiskStorage).unwrap();
        assert_eq!(read(), other, "a restarted process goes on in the same frame");
        // A session of this run may have been saved before or after the other map was loaded.
        assert!(![0, other.number].contains(&other.after_load(true).number));
        std::fs::write(&other.file, "?").unwrap();
        assert!(![0, other.number].contains(&read().number));
    }
}
