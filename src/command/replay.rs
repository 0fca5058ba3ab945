//! Tool `mr-slam replay`, which maps recorded logs and recordings with the fleet's SLAM, as fast as the machine can.
//!
//! Two threads as in the live process: this one runs the front end, the other one the back end. Unlike the live
//! process, the front end waits when the back end is far behind: a log has time.

mod error;
mod feeder;
mod fleet;
mod log_files;
mod options;
mod outputs;
mod player;
mod player_services;
mod recorded_fleet;
mod records;
mod serve;
mod starts;
mod summary;
mod trajectory;

pub use self::fleet::Starts;
pub use error::ReplayError;
pub use summary::{Percentiles, Summary};

use super::output;
use crate::config::Mode;
use crate::config::{FleetConfig, recorded_log_slam};
use crate::session_file;
use crate::sessions::TOLD_SIGMA;
use clap::builder::RangedU64ValueParser;
use feeder::Feeder;
use formats::map_file::{self, write_map_with_reasons};
use merge::MergeConfig;
use msg::grid::{Occupancy, occupancy};
use msg::{Pose2, Stamp};
use options::Replay;
use records::{BagArgs, Log, is_recording};
use slam::{
    BackEnd, FrontEnd, InitialPose, LocalFrameEstimate, MapFrameUpdate, Node, PlaceInMap, SessionIdentity,
    SlamConfig, TrajectoryError,
};
use std::panic::resume_unwind;
use std::path::PathBuf;
use std::sync::mpsc;
use std::time::{Duration, Instant};
use trajectory::write_trajectory;

/// Nodes that may wait for the back end before the log waits: then no node is held back.
const WAITING_MAX: usize = slam::NODES_IN_FLIGHT_MAX - 2;
/// Time between two lines of progress.
const PROGRESS: Duration = Duration::from_secs(1);

/// Map recorded logs and recordings, as fast as the machine can
// More than 12 fields: one field for each option of the command line, which clap derives from the struct.
#[derive(clap::Args, Clone, Debug)]
pub struct ReplayArgs {
    /// CARMEN logs, plain or gzip, or recordings (.mcap); several logs are a fleet, see --merge. The files of one recording
    /// of a fleet are replayed together
    #[arg(value_name = "LOG", required = true)]
    pub logs: Vec<PathBuf>,
    /// Topics and frames of recordings from elsewhere.
    #[command(flatten)]
    pub bag: BagArgs,
    /// Fleet file whose [slam] and [merge] are used [default: those of a fleet's recording; of others, built-in values for
    /// robots whose odometry is not known]
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Merge several logs; starts are `unknown` or `known:FILE` with lines `index time x y theta`
    #[arg(long, value_name = "STARTS")]
    pub merge: Option<Starts>,
    /// File for the final trajectory, one line a scan: `t x y z qx qy qz qw`; for several logs a folder
    #[arg(long, value_name = "FILE")]
    pub trajectory: Option<PathBuf>,
    /// File for the map: FILE.yaml with its PGM, and a PNG
    #[arg(long, value_name = "FILE")]
    pub map: Option<PathBuf>,
    /// Print the summary as JSON
    #[arg(long)]
    pub json: bool,
    /// Field of view of the central beams that are used, degrees
    #[arg(long, value_name = "DEGREES")]
    pub fov_deg: Option<f64>,
    /// Ignore the log's odometry
    #[arg(long)]
    pub no_odometry: bool,
    /// Do not close loops
    #[arg(long)]
    pub no_closures: bool,
    /// Session file to begin with; or a map (.yaml) to localize in
    #[arg(long, value_name = "FILE")]
    pub session: Option<PathBuf>,
    /// File for the session at the end
    #[arg(long, value_name = "FILE")]
    pub save_session: Option<PathBuf>,
    /// Use of the map
    #[arg(long, value_enum, default_value_t)]
    pub mode: Mode,
    /// Approximate pose of the robot in the session's map: metres, metres, radians [default: relocalize]
    #[arg(long, value_name = "X,Y,YAW", value_parser = crate::process::pose, requires = "session")]
    pub at: Option<Pose2>,
    /// Continue where the session ended, as if it had never stopped
    #[arg(long, requires = "session", conflicts_with = "at")]
    pub go_on: bool,
    /// Number of scans to skip at the beginning
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub skip: usize,
    /// Number of scans to use [default: all]
    #[arg(long, value_name = "N", value_parser = RangedU64ValueParser::<usize>::new().range(1..))]
    pub scans: Option<usize>,
    /// Serving of a fleet's recording to clients.
    #[command(flatten)]
    pub serving: serve::ServeArgs,
}

/// Replays the logs, writes the requested files and prints the summary.
pub fn run(args: &ReplayArgs) -> Result<(), ReplayError> {
    if let Some(fov) = args.fov_deg.filter(|fov| !(1.0..=360.0).contains(fov)) {
        return Err(ReplayError::FieldOfView(fov));
    }
    outputs::check(args)?;
    let are_recordings = args.logs.iter().all(|path| is_recording(path));
    let of_fleet = args.merge.is_none() && !args.bag.are_given();
    // A configuration of another version is no obstacle where another one is given.
    let is_needed = are_recordings && (of_fleet || args.config.is_none());
    let recorded = if is_needed { recorded_fleet::configuration(&args.logs[0])? } else { None };
    // Robots that were not simulated are replayed like a recording from elsewhere: their stamps are another machine's.
    if let Some(config) = recorded.as_ref().filter(|config| of_fleet && !config.world.is_external()) {
        options::refuse(Replay::Fleet, args)?;
        return recorded_fleet::run(args, config);
    }
    if args.serving.serve {
        return Err(ReplayError::NotServed);
    }
    if !args.logs.iter().any(|path| is_recording(path)) {
        options::refuse(Replay::Carmen, args)?;
    }
    let given = args.config.as_deref().map(FleetConfig::from_file).transpose()?;
    let (mut config, merging) = match given.or(recorded) {
        Some(config) => (config.slam, config.merge),
        None => (recorded_log_slam(), MergeConfig::default()),
    };
    config.odometry.used &= !args.no_odometry;
    config.closures.enabled &= !args.no_closures;
    let log = match (args.logs.as_slice(), &args.merge) {
        (log @ [_], None) => log,
        (logs, Some(starts)) if (1..=msg::ROBOTS_MAX).contains(&logs.len()) => {
            options::refuse(Replay::MergedLogs, args)?;
            return self::fleet::run(args, starts, &config, &merging);
        }
        // The parts of one recording.
        (logs, None) if are_recordings => logs,
        (logs, _) => return Err(ReplayError::Logs(logs.len())),
    };
    let start = Instant::now();
    let log = Log::read(log, args)?;
    let mut replayed = feed(&log, config, args)?;
    let wall_s = start.elapsed().as_secs_f64();
    replayed.summary.wall_s = Some(wall_s);
    replayed.summary.times_real_time = Some((replayed.ended - replayed.started) / wall_s);
    finish(args, replayed, log.truth())
}

fn finish(args: &ReplayArgs, replayed: Replayed, truth: &[(Stamp, Pose2)]) -> Result<(), ReplayError> {
    let Replayed { front, mut back, mut summary, localized, ended, .. } = replayed;
    let trajectory: Vec<(Stamp, Pose2, PlaceInMap)> = match localized {
        Some(poses) => poses.into_iter().map(|(stamp, pose)| (stamp, pose, PlaceInMap::Known)).collect(),
        None => back.trajectory_with_places(front.samples()).collect(),
    };
    summary.set_end(trajectory.last().filter(|(stamp, _, _)| *stamp == ended));
    summary.error = TrajectoryError::of_placed(&trajectory, truth);
    let placed = trajectory.iter().filter(|(_, _, place)| *place == PlaceInMap::Known).count();
    note_shortcomings(args, &summary, placed);
    if let Some(path) = &args.trajectory {
        write_trajectory(path, trajectory.into_iter())
            .map_err(|source| ReplayError::Write { path: path.clone(), source })?;
    }
    if let Some(path) = &args.save_session {
        let identity = SessionIdentity::new(0, 0, back.config());
        session_file::write(path, &back.session(identity, Some(front.state()), front.samples()))
            .map_err(ReplayError::Session)?;
    }
    let drawing = Instant::now();
    let grid = back.map();
    summary.map_ms = Some(drawing.elapsed().as_secs_f64() * 1e3);
    let has_wall = grid.cells.iter().any(|cell| occupancy(*cell) == Occupancy::Occupied);
    (summary.map_width, summary.map_height) = (Some(grid.header.width), Some(grid.header.height));
    if let Some(path) = &args.map {
        write_map_with_reasons(&map_file::stem(path), grid, &summary.unreliable_reasons)?;
    }
    output::print_either(args.json, &summary, || summary.text())?;
    let (path, scans, all) = (args.logs[0].clone(), summary.scans, summary.scans + summary.rejected());
    if 2 * scans < all {
        return Err(ReplayError::FewScans { path, used: scans, all });
    }
    if !has_wall {
        return Err(ReplayError::NoWall { path, scans });
    }
    if placed == 0 { Err(ReplayError::NothingPlaced { path, scans }) } else { Ok(()) }
}

/// Says what a person may have expected and did not get.
fn note_shortcomings(args: &ReplayArgs, summary: &Summary, placed: usize) {
    let missing = summary.not_located + summary.lost;
    if missing > 0 && placed > 0 {
        let (lost, not_located) = (summary.lost, summary.not_located);
        output::note(&format!(
            "{lost} scans did not match the map, and during {not_located} the robot was not located: the trajectory is not whole"
        ));
    }
    let rejected = summary.rejected();
    if rejected > 0 {
        output::note(&format!(
            "{rejected} scans are left out: the stamps of {} repeat and of {} go back, {} have another geometry than the first",
            summary.rejected_stamp_repeated, summary.rejected_stamp_went_back, summary.rejected_other
        ));
    }
    if let Some(ratio) =
        summary.evidence.odometry_agreement.distance_ratio.filter(|_| summary.has_other_scale())
    {
        output::note(&format!(
            "distances by scans are {ratio:.2} times those of odometry: one of the two measures wrongly, and the map may have a wrong size"
        ));
    }
    if args.bag.truth_topic.is_some() && summary.error.is_none() {
        output::note("no true pose was recorded near a scan: there is no error; do both have one clock?");
    }
}

/// Result of a replay.
struct Replayed {
    front: FrontEnd,
    back: BackEnd,
    /// In localization, the pose in the map of each scan that got one: the map's graph does not have these scans.
    localized: Option<Vec<(Stamp, Pose2)>>,
    summary: Summary,
    /// Stamp of the first scan.
    started: Stamp,
    /// Stamp of the last scan.
    ended: Stamp,
}

fn feed(log: &Log, mut config: SlamConfig, args: &ReplayArgs) -> Result<Replayed, ReplayError> {
    let mut records = log.records();
    let skipped_scans = (0..args.skip).map_while(|_| records.next_laser()).count();
    let Some(first) = records.next_laser() else {
        let (path, skipped, malformed) = (args.logs[0].clone(), records.skipped(), records.malformed);
        return Err(match skipped_scans {
            0 => ReplayError::NoScan { path, skipped, malformed },
            scans => ReplayError::AllSkipped { path, scans, skip: args.skip },
        });
    };
    let on_robot = first.line.base_from_scan;
    config.lidar.base_from_scan = [on_robot.x_m, on_robot.y_m, on_robot.yaw_rad];
    let (mut front, mut back) = begin(args, config)?;
    let (to_back, nodes) = mpsc::sync_channel::<Node>(WAITING_MAX);
    let (to_front, frame_updates) = mpsc::channel::<MapFrameUpdate>();
    let mut summary = Summary { log: args.logs[0].display().to_string(), ..Default::default() };
    let started = first.line.stamp;
    let mut ended = started;
    let mut localized = None;
    let localizes = args.mode == Mode::Localization;
    std::thread::scope(|scope| {
        let back = &mut back;
        let back_end = scope.spawn(move || run_back_end(back, nodes, to_front));
        let mut feeder = Feeder::new(args, log);
        let front = &mut front;
        let mut next = Some(first);
        while let Some(scan) = next {
            ended = scan.line.stamp;
            frame_updates.try_iter().for_each(|frame_update| front.add_frame_update(frame_update));
            if let Some(node) = feeder.scan(front, &scan)
                && to_back.send(node).is_ok()
                && localizes
            {
                // The poses that the scans get depend on the answers' order: wait for each.
                frame_updates
                    .recv()
                    .into_iter()
                    .for_each(|frame_update| front.add_frame_update(frame_update));
            }
            let enough = args.scans.is_some_and(|scans| feeder.seq as usize >= scans);
            next = if enough { None } else { records.next_laser() };
        }
        drop(to_back);
        summary.not_located = feeder.not_located;
        localized = localizes.then(|| core::mem::take(&mut feeder.located));
        summary.scan_ms = Percentiles::of(core::mem::take(&mut feeder.times));
        summary.back_end_ms = Percentiles::of(back_end.join().unwrap_or_else(|why| resume_unwind(why)));
    });
    summary.count_log(log);
    summary.count_records(&records);
    summary.count(&front, &back);
    Ok(Replayed { front, back, localized, summary, started, ended })
}

/// Creates front end and back end, new or from a session.
fn begin(args: &ReplayArgs, config: SlamConfig) -> Result<(FrontEnd, BackEnd), ReplayError> {
    let Some(path) = &args.session else {
        if args.mode == Mode::Localization {
            return Err(ReplayError::NothingToLocalizeIn);
        }
        return Ok(slam::create_or_resume(config, None, args.mode.into(), InitialPose::Unknown));
    };
    if session_file::is_map(path) && args.mode != Mode::Localization {
        return Err(ReplayError::MapOnly(path.clone()));
    }
    let session = session_file::read_any(path, &SessionIdentity::new(0, 0, &config), &config)
        .map_err(ReplayError::Begin)?;
    let [sigma_m, sigma_rad] = TOLD_SIGMA;
    let start = match args.at {
        Some(map_from_local) => InitialPose::Near(LocalFrameEstimate { map_from_local, sigma_m, sigma_rad }),
        None if args.go_on => InitialPose::Continue,
        None => InitialPose::Unknown,
    };
    Ok(slam::create_or_resume(config, Some(session), args.mode.into(), start))
}

/// Adds nodes to the back end until no more come. Returns the duration of each, and of the final work.
fn run_back_end(
    back: &mut BackEnd,
    nodes: mpsc::Receiver<Node>,
    to_front: mpsc::Sender<MapFrameUpdate>,
) -> Vec<Duration> {
    let mut times = Vec::new();
    for node in nodes {
        let start = Instant::now();
        let frame_update = back.add_node(node);
        times.push(start.elapsed());
        // The front end is gone if the log has ended.
        let _ = to_front.send(frame_update);
    }
    let start = Instant::now();
    back.finish();
    times.push(start.elapsed());
    times
}

#[cfg(test)]
mod tests;
