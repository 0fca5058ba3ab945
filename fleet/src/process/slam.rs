//! One robot's SLAM process. One thread answers scans and waits for nothing else ([`front_end_loop`]); the back-end thread
//! closes loops, solves, draws the map and answers requests ([`back_end`]); a third reads and writes files ([`files`]).
//!
//! ```text
//!  scans ─▶ scan path ── FrontEvent: nodes, state ────────▶ back end ── SlamFileJob ───▶ files
//!               ▲                                            │    ▲                  │
//!               └─ FrontCommand: frame updates, pause, map ──┘    └── FileJobOutcome ┘
//! ```

mod autosave;
pub mod back_end;
pub mod commands;
mod file_jobs;
pub mod files;
pub mod front_end_loop;
mod held_answers;
pub mod map_frame;
mod pausing;
pub mod refused;
mod services;
pub mod session_log;

use super::{Error, serve};
use crate::ports::{ChannelError, Clock, Ports};
use crate::progress::{ProgressCounter, WatchedThread};
use crate::run::Run;
use crate::session_file::SessionFileError;
use crate::session_records;
use crate::sessions;
use crate::shared_memory::Participant;
use crate::stop::Stop;
use crate::storage::{DiskStorage, Storage, keep_unusable};
use crate::time_slice;
use ::slam::{
    FrontEnd, FrontEndState, InitialPose, LocalFrameEstimate, MapFrameUpdate, NODES_IN_FLIGHT_MAX, Node,
    Session, SlamConfig,
};
use back_end::{BackEndWorker, InitialBackEnd};
use files::{FileJobOutcome, SlamFileJob, SlamFileWorker};
use front_end_loop::{BeginningFrontEnd, FrontEndLoop};
use map_frame::MapFrame;
use msg::{Header, Pose2, RobotId, Role, SlamMode};
use std::path::Path;
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::time::Duration;

/// Capacity of the queue of commands to the scan path, which empties it at each scan.
const COMMANDS_MAX: usize = 256;
/// Capacity of the queue of events: nodes of a front end and of the one it replaced, and a few other events.
const EVENTS_MAX: usize = 2 * NODES_IN_FLIGHT_MAX + 16;

/// Input of the back-end thread.
#[expect(clippy::large_enum_variant, reason = "a node goes by value: the scan path does not allocate")]
pub enum BackEndInput {
    /// An event of the front end with this number; the numbers count the front ends that were put in place.
    FrontEnd(u32, FrontEvent),
    /// A file was read or written.
    File(Box<FileJobOutcome>),
}

/// Event from the scan path to the back end.
#[expect(clippy::large_enum_variant, reason = "a node goes by value: the scan path does not allocate")]
pub enum FrontEvent {
    /// A scan that enters the graph, and where its robot is if the node does not follow from the one before.
    Node(Node, Option<TrajectoryStart>),
    /// State of the front end after the nodes reported before; answers [`FrontCommand::ReportState`].
    State(Box<FrontEndState>),
    /// A front end that was replaced and may be dropped.
    Replaced(Box<FrontEnd>),
    /// Last state of the front end; the process ends.
    Ended(Box<FrontEndState>),
}

/// Where a new trajectory of the front end starts in the map.
#[derive(Clone, Copy, Debug)]
pub enum TrajectoryStart {
    /// The frame `odom` is where it was before the restart; the pose follows from odometry.
    At {
        /// Pose of the front end's frame in the map.
        map_from_local: Pose2,
    },
    /// The robot has moved in an unknown way.
    Unknown,
}

/// Command from the back end to the front end.
pub enum FrontCommand {
    /// Reports what a node changed in the map; it takes effect with the node that it names.
    QueueFrameUpdate(MapFrameUpdate),
    /// Sets whether scans are ignored.
    Pause(bool),
    /// Requests the front end's state, which comes as [`FrontEvent::State`].
    ReportState,
    /// Replaces the front end by another with a number of its own.
    Replace {
        /// The number of the new front end.
        number: u32,
        /// The new front end.
        front: Box<FrontEnd>,
        /// Whether the robot's pose stays valid, because the frame of the map is the same.
        keeps_pose: bool,
    },
    /// Sets where the front end's frame lies in the map, as a person said, at once and not with the next node; `None`: unknown.
    SetInitialEstimate(Option<LocalFrameEstimate>),
    /// Applies the back end's newest state at once: its graph has changed without a node.
    ApplyFrameUpdateNow(MapFrameUpdate),
    /// Makes a node of the next scan, because a request waits for one.
    RequestNode,
}

/// The three components of a SLAM process, and the ends of the queues between them.
pub struct SlamProcess<P: Ports, S> {
    /// Matches each scan and publishes the robot's pose.
    pub front_end_loop: FrontEndLoop<P>,
    /// Closes loops, solves the graph, draws the map, answers requests.
    pub back_end: BackEndWorker<P>,
    /// Reads and writes files of sessions and maps.
    pub files: SlamFileWorker<P::Clock, S>,
    /// Queue to the back end.
    pub inputs: Receiver<BackEndInput>,
    /// Queue to the file worker.
    pub jobs: Receiver<SlamFileJob>,
}

impl<P: Ports, S: Storage> SlamProcess<P, S> {
    /// Begins with what an earlier process of this run saved, with the session that the fleet begins with, or with
    /// nothing. `map_from_odom` is the pose of `odom` in the map before a restart. The scan path and the back end have ports
    /// of their own, as they run on different threads.
    pub fn open(
        [scan_ports, map_ports]: [&P; 2],
        run: &Run,
        robot: RobotId,
        map_from_odom: Option<Pose2>,
        storage: S,
    ) -> Result<Self, Error> {
        let InitialSlam { beginning, back } =
            restore_or_create(run, robot, map_from_odom, &storage, &scan_ports.clock())?;
        let (events, inputs) = sync_channel::<BackEndInput>(EVENTS_MAX);
        let (commands, commands_in) = sync_channel::<FrontCommand>(COMMANDS_MAX);
        let (job_sender, jobs) = sync_channel::<SlamFileJob>(files::JOBS_MAX);
        let outcomes = events.clone();
        let front_end_loop = FrontEndLoop::open(scan_ports, run, robot, beginning, events, commands_in)?;
        let back_end = BackEndWorker::open(map_ports, run, robot, back, commands, job_sender)?;
        let files = SlamFileWorker::new(live_config(run), &run.dir, storage, scan_ports.clock(), outcomes);
        Ok(Self { front_end_loop, back_end, files, inputs, jobs })
    }
}

/// Runs the process until it is asked to stop.
pub fn run(run: &Run, robot: RobotId, map_from_odom: Option<Pose2>, stop: &Stop) -> Result<(), Error> {
    let scan_ports = run.attach(Role::Slam, Some(robot))?;
    let initial = restore_or_create(run, robot, map_from_odom, &DiskStorage, &scan_ports.clock())?;
    let (events, inputs) = sync_channel::<BackEndInput>(EVENTS_MAX);
    let (commands, commands_in) = sync_channel::<FrontCommand>(COMMANDS_MAX);
    let (job_sender, jobs) = sync_channel::<SlamFileJob>(files::JOBS_MAX);
    let mut files =
        SlamFileWorker::new(live_config(run), &run.dir, DiskStorage, scan_ports.clock(), events.clone());
    let InitialSlam { beginning, back } = initial;
    let mut front_end_loop = FrontEndLoop::open(&scan_ports, run, robot, beginning, events, commands_in)?;
    std::thread::scope(|scope| {
        let files = scope.spawn(move || {
            time_slice::request_default();
            jobs.into_iter().for_each(|job| files.run(job));
            files.unsaved().map(str::to_owned)
        });
        // Shared memory's ports stay on the thread that made them.
        let back_end = scope.spawn(move || -> Result<(), ChannelError> {
            // It computes for long; nobody waits for it.
            time_slice::request_default();
            let map_ports = run.attach_thread(Role::Slam, Some(robot), "map")?;
            let back_end = BackEndWorker::open(&map_ports, run, robot, back, commands, job_sender)?;
            let progress = run.progress(Role::Slam, Some(robot), WatchedThread::Second);
            serve_back_end(back_end, &map_ports, &inputs, progress);
            Ok(())
        });
        let progress = run.progress(Role::Slam, Some(robot), WatchedThread::Main);
        serve(&mut front_end_loop, progress, &|| stop.requested() || back_end.is_finished());
        front_end_loop.end();
        back_end.join().map_err(|_| "the back-end thread panicked")?.map_err(Error::from)?;
        match files.join().map_err(|_| "the thread of the files panicked")? {
            Some(why) => Err(format!("its last map is not saved: {why}").into()),
            None => Ok(()),
        }
    })
}

/// Runs the back end until the scan path has ended.
fn serve_back_end(
    mut back_end: BackEndWorker<Participant>,
    ports: &Participant,
    inputs: &Receiver<BackEndInput>,
    mut progress: ProgressCounter,
) {
    let mut input = None;
    loop {
        progress.advance();
        let due = back_end.step(input.take());
        if back_end.has_ended() {
            return;
        }
        match inputs.recv_timeout(Duration::from_nanos(due.since(ports.clock().now()))) {
            Ok(next) => input = Some(next),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return,
        }
    }
}

/// Front end and back end with which SLAM starts.
struct InitialSlam {
    beginning: BeginningFrontEnd,
    back: InitialBackEnd,
}

/// Loads what an earlier process of this run saved and logged, else the fleet's initial session, else an empty map.
fn restore_or_create(
    run: &Run,
    robot: RobotId,
    map_from_odom: Option<Pose2>,
    storage: &impl Storage,
    clock: &impl Clock,
) -> Result<InitialSlam, Error> {
    let config = live_config(run);
    let is_paused = pausing::was_paused(storage, run, robot);
    let frame = MapFrame::read(storage, run, robot, clock);
    let identity = sessions::identity(run, robot);
    let saved = read_own_session(run, robot, storage)?;
    let position = saved.as_ref().map(|session| session.log).unwrap_or_default();
    let (records, log_end) = session_log::read(storage, run, robot, position);
    let (session, mode, has_session) = match saved {
        Some(saved) => {
            let (mode, has_nodes) = (saved.mode, !saved.back.nodes.is_empty());
            (Some(saved).filter(|_| has_nodes), mode, has_nodes)
        }
        None => {
            let first = sessions::first(&run.config, robot)?;
            let mode = sessions::first_mode(&run.config, first.is_some());
            (first, mode, false)
        }
    };
    if !has_session && records.is_empty() {
        let (front, mut back) = ::slam::create_or_resume(config, session, mode, InitialPose::Unknown);
        // No scan of this run is in it yet.
        back.set_map_header(Header::default(), clock.now());
        // Whether the robot had been found in a session's map is not known.
        let restart_map_from_odom = map_from_odom.filter(|_| back.nodes().is_empty());
        let beginning =
            BeginningFrontEnd { front, restart_map_from_odom, given_map_from_odom: map_from_odom, is_paused };
        return Ok(InitialSlam { beginning, back: InitialBackEnd { back, log_end, is_paused, frame } });
    }
    let kept = match (session, records.is_empty()) {
        (Some(session), true) => session,
        (session, _) => {
            let start = if has_session { InitialPose::Continue } else { InitialPose::Unknown };
            session_records::replayed(config.clone(), (session, mode, start), records, identity)
        }
    };
    // A robot that was localized is looked for where it was; one that was looked for, everywhere.
    let restart_map_from_odom =
        map_from_odom.filter(|_| kept.front.is_none() && mode == SlamMode::Localization);
    let (mut front, back) = ::slam::create_or_resume(config, Some(kept), mode, InitialPose::Continue);
    if restart_map_from_odom.is_some() {
        // The first scan says where the front end's frame lies in `odom`; then the pose is set.
        front.set_map_from_local(Some(Pose2::IDENTITY));
    }
    let beginning =
        BeginningFrontEnd { front, restart_map_from_odom, given_map_from_odom: map_from_odom, is_paused };
    Ok(InitialSlam { beginning, back: InitialBackEnd { back, log_end, is_paused, frame } })
}

/// Reads what an earlier process of this run saved.
///
/// Errors: the file may be the session with which the fleet begins, and cannot be read. A further start may be able to.
fn read_own_session(
    run: &Run,
    robot: RobotId,
    storage: &impl Storage,
) -> Result<Option<Session>, SessionFileError> {
    let folder = sessions::folder(run);
    let own = sessions::file(&folder, robot);
    let identity = sessions::identity(run, robot);
    match sessions::read(storage, &own, &identity) {
        // Else the file is from another run in the same folder.
        Ok(kept) => Ok(Some(kept).filter(|kept| kept.identity.run == identity.run)),
        Err(why) if why.is_missing() => Ok(None),
        Err(why) if sessions::is_continued(&folder, run.config.sessions.folder()) => Err(why),
        Err(why) => {
            let kept = keep_written(run, storage, &own);
            // The log is of no use without the session. It comes second: a process that dies in between leaves no session without it.
            for log in session_records::files(&own) {
                keep_written(run, storage, &log);
            }
            tracing::warn!("slam of {robot}: {why}; it begins without the session; {kept}");
            Ok(None)
        }
    }
}

/// Keeps a file that cannot be used, if the run writes such files: it would be overwritten. Returns what came of it.
fn keep_written(run: &Run, storage: &impl Storage, path: &Path) -> String {
    match run.config.sessions.autosave_s > 0.0 {
        true => keep_unusable(storage, path),
        false => "it stays as it is, as nothing is saved".into(),
    }
}

/// Returns the fleet's configuration of SLAM for a live process, which needs no trajectory of all scans.
fn live_config(run: &Run) -> SlamConfig {
    let mut config = run.config.slam.clone();
    config.graph.trajectory_max = 0;
    config
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::FleetConfig;

    /// Has a path be one that cannot be read: no file can be read from a folder.
    fn unreadable(path: &Path) {
        std::fs::create_dir_all(path.join("content")).unwrap();
    }

    fn run_in(folder: &Path) -> Run {
        let mut run = Run::in_memory(FleetConfig::default()).unwrap();
        run.dir = folder.into();
        run
    }

    #[test]
    fn a_session_with_which_the_fleet_begins_is_not_given_up_for_one_error() {
        let folder = tempfile::tempdir().unwrap();
        let mut run = run_in(folder.path());
        let sessions = sessions::folder(&run);
        run.config.sessions.begin_with.clone_from(&sessions);
        let robot = RobotId::new(1).unwrap();
        let session = sessions::file(&sessions, robot);
        let [log, _] = session_records::files(&session);
        [&session, &log].into_iter().for_each(|path| unreadable(path));
        assert!(read_own_session(&run, robot, &DiskStorage).is_err());
        assert!(session.exists() && log.exists(), "a further start reads them");
    }

    #[test]
    fn files_that_nothing_overwrites_keep_their_names() {
        let folder = tempfile::tempdir().unwrap();
        let mut run = run_in(folder.path());
        run.config.sessions.autosave_s = 0.0;
        let robot = RobotId::new(1).unwrap();
        let session = sessions::file(&sessions::folder(&run), robot);
        let [log, _] = session_records::files(&session);
        [&session, &log].into_iter().for_each(|path| unreadable(path));
        assert!(read_own_session(&run, robot, &DiskStorage).unwrap().is_none());
        session_log::read(&DiskStorage, &run, robot, Default::default());
        assert!(session.exists() && log.exists());
    }

    #[test]
    fn files_that_cannot_be_read_are_not_overwritten() {
        let folder = tempfile::tempdir().unwrap();
        let run = run_in(folder.path());
        let robot = RobotId::new(1).unwrap();
        let session = sessions::file(&sessions::folder(&run), robot);
        let [log, other_log] = session_records::files(&session);
        [&session, &log].into_iter().for_each(|path| unreadable(path));
        std::fs::write(&other_log, "nodes").unwrap();
        assert!(read_own_session(&run, robot, &DiskStorage).unwrap().is_none());
        for path in [&session, &log, &other_log] {
            let kept = format!("{}.unreadable", path.display());
            assert!(!path.exists() && Path::new(&kept).exists(), "{kept}");
        }
        // A log alone that cannot be read is kept, too.
        unreadable(&log);
        session_log::read(&DiskStorage, &run, robot, Default::default());
        assert!(!log.exists() && log.with_extension("log0.unreadable2").join("content").exists());
        // Nobody knows whether it was paused.
        assert!(!pausing::was_paused(&DiskStorage, &run, robot));
        unreadable(&sessions::pause_marker(&sessions::folder(&run), robot));
        assert!(pausing::was_paused(&DiskStorage, &run, robot));
    }
}
