//! The thread that reads and writes files for SLAM: a slow disk delays no other thread.
//!
//! Its priority is the others'. With a lower one (nice 10) it was kept waiting on a loaded machine while it held what
//! the scan path needed (a process has one lock on its memory): scan to pose p99 200 to 390 ms instead of 3 to 60.

use super::BackEndInput;
use super::map_frame::MapFrame;
use super::refused::FileJobError;
use crate::ports::Clock;
use crate::saved_files;
use crate::session_file::{self, SessionFileError};
use crate::sessions::{self, TOLD_SIGMA};
use crate::storage::Storage;
use ::slam::{BackEnd, FrontEnd, InitialPose, LocalFrameEstimate, Session, SessionIdentity, SlamConfig};
use msg::{Grid, InitialPoseKind, Pose2, SlamMode, SlamRequest};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{SyncSender, TrySendError};
use std::time::Duration;

/// Jobs that wait; a request that needs one more is refused.
pub const JOBS_MAX: usize = 8;

/// Job of the file worker: one operation on one file.
pub struct SlamFileJob {
    /// Request that the job belongs to; `None` for an autosave.
    pub request: Option<Box<SlamRequest>>,
    /// File to read or to write.
    pub path: PathBuf,
    /// Operation on the file.
    pub work: FileOperation,
}

/// Operation on a file.
pub enum FileOperation {
    /// Write a session; before it the number of its map's frame, if its file must have one.
    Save(Box<Session>, Option<MapFrame>),
    /// Write bytes at a place in a log, and cut off what follows.
    Append {
        /// Offset in the file, bytes.
        at: u64,
        /// One record of the session log, encoded.
        bytes: Vec<u8>,
    },
    /// Write a small file.
    Replace(Vec<u8>),
    /// Remove a file, if it is there.
    Remove,
    /// Write a map's pictures.
    Draw {
        /// The map to write.
        grid: Grid,
        /// Why it is unreliable; empty if it is not.
        reasons: Vec<&'static str>,
    },
    /// Read a session or a map.
    Load {
        /// The places at which it may be, in the order in which they are looked at; at least one.
        files: Vec<PathBuf>,
        /// The robot for which it is read.
        session: SessionIdentity,
        /// The mode in which it is used.
        mode: SlamMode,
        /// The frame that the robot's map has now.
        frame: MapFrame,
    },
}

/// Outcome of a job.
pub struct FileJobOutcome {
    /// The job's request.
    pub request: Option<Box<SlamRequest>>,
    /// The job's file.
    pub path: PathBuf,
    /// Loaded session, if the job was to load one, or the reason of the failure.
    pub result: Result<Option<Box<Loaded>>, FileJobError>,
    /// Duration of the job.
    pub took: Duration,
    /// Place in the log at which a record was to be written; `None` for other jobs.
    pub appended_at: Option<u64>,
}

/// Front end and back end read from a session file.
pub struct Loaded {
    /// Front end at the session's end.
    pub front: FrontEnd,
    /// Back end with the session's graph.
    pub back: BackEnd,
    /// The frame of the map.
    pub frame: MapFrame,
    /// What a person is to know of the map's frame; empty if it is the one of before.
    pub note: &'static str,
}

/// What is said of a map of another frame: of another run, or of this one where maps of other runs were loaded.
const OTHER_FRAME: &str =
    "; the map is of another run or frame: merging finds anew where it lies in the fleet's map";
/// What is said of a map without a session, whose file does not say of which run it is.
const UNKNOWN_FRAME: &str =
    "; the map's run and frame are not known: merging finds anew where it lies in the fleet's map";

/// Performs jobs, one after the other.
pub struct SlamFileWorker<C, S> {
    config: SlamConfig,
    run_folder: PathBuf,
    storage: S,
    clock: C,
    outcomes: SyncSender<BackEndInput>,
    /// Why the newest session, or a record after it, is not in its file.
    unsaved: Option<String>,
}

impl<C: Clock, S: Storage> SlamFileWorker<C, S> {
    /// Creates a worker whose outcomes go to the back-end thread.
    pub fn new(
        config: SlamConfig,
        run_folder: &Path,
        storage: S,
        clock: C,
        outcomes: SyncSender<BackEndInput>,
    ) -> Self {
        Self { config, run_folder: run_folder.to_owned(), storage, clock, outcomes, unsaved: None }
    }

    /// Returns why what was to be saved last is not in its file, if it is not.
    pub fn unsaved(&self) -> Option<&str> {
        self.unsaved.as_deref()
    }

    /// Does one job; waits while the back-end thread has no room for the outcome.
    pub fn run(&mut self, job: SlamFileJob) {
        let outcome = BackEndInput::File(Box::new(self.perform(job)));
        if let Err(std::sync::mpsc::SendError(BackEndInput::File(outcome))) = self.outcomes.send(outcome)
            && let Err(why) = outcome.result
        {
            tracing::warn!("slam: {why}");
        }
    }

    /// Does one job if the back-end thread has room for the outcome; else gives the outcome back.
    pub fn try_run(&mut self, job: SlamFileJob) -> Option<BackEndInput> {
        let outcome = BackEndInput::File(Box::new(self.perform(job)));
        self.try_send(outcome)
    }

    /// Sends an outcome that had no room.
    pub fn try_send(&mut self, outcome: BackEndInput) -> Option<BackEndInput> {
        match self.outcomes.try_send(outcome) {
            Err(TrySendError::Full(outcome)) => Some(outcome),
            Ok(()) | Err(TrySendError::Disconnected(_)) => None,
        }
    }

    fn perform(&mut self, SlamFileJob { request, mut path, work }: SlamFileJob) -> FileJobOutcome {
        let begun = self.clock.now();
        let appended_at = if let FileOperation::Append { at, .. } = &work { Some(*at) } else { None };
        let written = |result: std::io::Result<()>| {
            result.map(|()| None).map_err(|source| FileJobError::Write { path: path.clone(), source })
        };
        let result = match work {
            FileOperation::Save(session, frame) => self
                .check_room(&path)
                .and_then(|()| self.save(&path, &session, frame.as_ref()))
                .map(|()| None),
            FileOperation::Append { at, bytes } => written(self.storage.append(&path, at, &bytes)),
            FileOperation::Replace(bytes) => written(self.storage.replace(&path, &bytes)),
            FileOperation::Remove => written(self.storage.remove(&path)),
            FileOperation::Draw { grid, reasons } => self.draw(&path, &grid, &reasons).map(|yaml| {
                path = yaml;
                None
            }),
            FileOperation::Load { files, session, mode, frame } => {
                let request = request.as_deref().copied().unwrap_or_default();
                self.load_first(files, &session, (mode, &frame), &request).map(|(used, loaded)| {
                    path = used;
                    Some(Box::new(loaded))
                })
            }
        };
        match &result {
            // What a request saves elsewhere has its own answer.
            _ if request.is_some() => {}
            Err(why) => self.unsaved = Some(why.to_string()),
            // A record alone does not make up for a session before it.
            Ok(_) if appended_at.is_none() => self.unsaved = None,
            Ok(_) => {}
        }
        let took = Duration::from_nanos(self.clock.now().since(begun));
        FileJobOutcome { request, path, result, took, appended_at }
    }

    fn check_room(&self, path: &Path) -> Result<(), FileJobError> {
        Ok(saved_files::check_room(&self.storage, &self.run_folder, path)?)
    }

    /// Writes the files of a map; returns the path of the YAML, which names the picture and is what map_server loads.
    fn draw(&self, stem: &Path, grid: &Grid, reasons: &[&str]) -> Result<PathBuf, FileJobError> {
        self.check_room(stem)?;
        self.storage.write_map(stem, grid.view(), reasons)?;
        let [_, yaml, _] = formats::map_file::written_files(stem);
        Ok(yaml)
    }

    /// Writes the number of the map's frame, then the session: a session of another frame is never without its number.
    fn save(&self, path: &Path, session: &Session, frame: Option<&MapFrame>) -> Result<(), FileJobError> {
        let invalid = |why| SessionFileError::Content { file: path.to_owned(), why };
        let bytes = session.encode().map_err(invalid)?;
        let fail = |path: &Path| {
            let path = path.to_owned();
            |source| FileJobError::Write { path, source }
        };
        if let Some(frame) = frame {
            frame.write(&self.storage).map_err(fail(frame.file()))?;
        }
        self.storage.write(path, &bytes).map_err(fail(path))
    }

    /// Reads the first of the files that is there.
    fn load_first(
        &self,
        files: Vec<PathBuf>,
        identity: &SessionIdentity,
        frame: (SlamMode, &MapFrame),
        request: &SlamRequest,
    ) -> Result<(PathBuf, Loaded), FileJobError> {
        for path in &files {
            match self.load(path, identity, frame, request) {
                Err(why) if why.is_missing() => {}
                result => return result.map(|loaded| (path.clone(), loaded)),
            }
        }
        Err(FileJobError::NoneToLoad(files))
    }

    fn load(
        &self,
        path: &Path,
        identity: &SessionIdentity,
        (mode, frame): (SlamMode, &MapFrame),
        request: &SlamRequest,
    ) -> Result<Loaded, FileJobError> {
        let is_map = session_file::is_map(path);
        if is_map && mode != SlamMode::Localization {
            return Err(FileJobError::MapIsNoSession(path.to_owned()));
        }
        let session = if is_map {
            let grid = self.storage.read_map(path)?;
            Session::from_grid(*identity, grid.view(), &self.config)
        } else {
            sessions::read(&self.storage, path, identity)?
        };
        if session.back.nodes.is_empty() {
            return Err(FileJobError::EmptySession(path.to_owned()));
        }
        let [m, rad] = TOLD_SIGMA;
        let or = |reported: f64, otherwise: f64| if reported > 0.0 { reported } else { otherwise };
        let (sigma_m, sigma_rad) = (or(request.sigma_m, m), or(request.sigma_rad, rad));
        let at = |map_from_local: Pose2| {
            InitialPose::Near(LocalFrameEstimate { map_from_local, sigma_m, sigma_rad })
        };
        let poses = &session.back.poses;
        let start = match InitialPoseKind::from_code(request.initial_pose_kind) {
            Some(InitialPoseKind::Given) => at(request.pose),
            Some(InitialPoseKind::FirstNode) => poses.first().copied().map_or(InitialPose::Unknown, at),
            Some(InitialPoseKind::LastNode) => poses.last().copied().map_or(InitialPose::Unknown, at),
            Some(InitialPoseKind::Unknown) | None => InitialPose::Unknown,
        };
        let is_own = !is_map && session.identity.run == identity.run;
        let before = frame.number;
        let frame = frame.after_load(is_own);
        let note = match (is_map, frame.number == before) {
            (true, _) => UNKNOWN_FRAME,
            (false, false) => OTHER_FRAME,
            (false, true) => "",
        };
        let (front, back) = ::slam::create_or_resume(self.config.clone(), Some(session), mode, start);
        Ok(Loaded { front, back, frame, note })
    }
}
