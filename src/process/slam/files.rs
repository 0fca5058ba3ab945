//! The thread that reads and writes files for SLAM: a slow disk holds up nobody else.
//!
//! Its priority is the others'. With a lower one (nice 10) it was kept waiting on a loaded machine while it held what
//! the scan path needed (a process has one lock on its memory): scan to pose p99 200 to 390 ms instead of 3 to 60.

use super::News;
use crate::session_file;
use crate::sessions::TOLD_SIGMA;
use ::slam::{Back, Front, Hint, Identity, Session, SlamConfig, Start};
use formats::map_file::write_map;
use msg::{Grid, Pose2, SlamMode, SlamRequest, StartPose};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SendError, SyncSender};
use std::time::{Duration, Instant};

/// Jobs that wait; who brings more is refused.
pub const JOBS_WAITING_MAX: usize = 4;

/// What there is to do.
pub struct Job {
    /// Who asked; none: SLAM itself, now and then.
    pub request: Option<Box<SlamRequest>>,
    /// Which file.
    pub path: PathBuf,
    /// What with it.
    pub work: Work,
}

/// What to do with a file.
pub enum Work {
    /// Write a session.
    Save(Box<Session>),
    /// Write a map's pictures.
    Draw(Grid),
    /// Read a session or a map for this robot.
    Load(Identity, SlamMode),
}

/// What became of a job.
pub struct Done {
    /// The job's.
    pub request: Option<Box<SlamRequest>>,
    /// The job's.
    pub path: PathBuf,
    /// What was loaded, if that was the job; or why it was not done.
    pub result: Result<Option<Box<Loaded>>, String>,
    /// How long it took.
    pub took: Duration,
}

/// A session that can be gone on with.
pub struct Loaded {
    pub front: Front,
    pub back: Back,
}

/// Works until all is done and nobody can bring more.
pub fn serve(config: &SlamConfig, jobs: Receiver<Job>, done: SyncSender<News>) {
    for Job { request, path, work } in jobs {
        let begun = Instant::now();
        let result = match work {
            Work::Save(session) => save(&path, &session).map(|()| None),
            Work::Draw(grid) => draw(&path, &grid).map(|()| None),
            Work::Load(identity, mode) => {
                let request = request.as_deref().copied().unwrap_or_default();
                load(config, &path, &identity, mode, &request).map(|loaded| Some(Box::new(loaded)))
            }
        };
        let took = begun.elapsed();
        let unheard = done.send(News::Done(Box::new(Done { request, path, result, took })));
        if let Err(SendError(News::Done(done))) = unheard
            && let Err(why) = done.result
        {
            eprintln!("slam: {why}");
        }
    }
}

fn save(path: &Path, session: &Session) -> Result<(), String> {
    make_folder(path)?;
    session_file::write(path, session).map_err(|why| why.to_string())
}

fn draw(stem: &Path, grid: &Grid) -> Result<(), String> {
    make_folder(stem)?;
    write_map(stem, grid.view()).map_err(|why| why.to_string())
}

/// Makes the folder that a file is to lie in, if need be.
fn make_folder(path: &Path) -> Result<(), String> {
    let Some(folder) = path.parent() else { return Ok(()) };
    std::fs::create_dir_all(folder).map_err(|why| format!("{}: {why}", folder.display()))
}

fn load(
    config: &SlamConfig,
    path: &Path,
    identity: &Identity,
    mode: SlamMode,
    request: &SlamRequest,
) -> Result<Loaded, String> {
    if session_file::is_map(path) && mode != SlamMode::Localization {
        return Err(format!(
            "{} is a map and no session: it can be localized in, but not gone on with (load FILE --localize)",
            path.display()
        ));
    }
    let session = session_file::read_any(path, identity, config).map_err(|why| why.to_string())?;
    if session.back.nodes.is_empty() {
        return Err(format!("{} has no map in it", path.display()));
    }
    let [m, rad] = TOLD_SIGMA;
    let or = |told: f64, otherwise: f64| if told > 0.0 { told } else { otherwise };
    let (sigma_m, sigma_rad) = (or(request.sigma_m, m), or(request.sigma_rad, rad));
    let at = |map_from_local: Pose2| Start::At(Hint { map_from_local, sigma_m, sigma_rad });
    let start = match StartPose::from_code(request.start) {
        Some(StartPose::Given) => at(request.pose),
        Some(StartPose::FirstNode) => session.back.poses.first().copied().map_or(Start::Unknown, at),
        Some(StartPose::LastNode) => session.back.poses.last().copied().map_or(Start::Unknown, at),
        Some(StartPose::Unknown) | None => Start::Unknown,
    };
    let (front, back) = ::slam::begin(config.clone(), Some(session), mode, start);
    Ok(Loaded { front, back })
}
