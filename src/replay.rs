//! `mr-slam replay`: a recorded log through the same SLAM, as fast as it goes.
//!
//! Two threads as in the live process: this one is the scan path, the other one does the work
//! beside it. Unlike the live one, this one waits when the other is far behind: a log has time.

mod fleet;
mod summary;

pub use fleet::Starts;
pub use summary::{Percentiles, Summary};

use crate::session_file::{self, SessionFileError};
use crate::sessions::{Mode, TOLD_SIGMA};
use formats::carmen::{LaserLine, Reader, Record};
use formats::gzip;
use formats::map_file::{MapFileError, write_map};
use msg::{Odometry, Pose2, Scan, Stamp};
use slam::{BackEnd, FrontEnd, Identity, InitialPose, Node, PoseEstimate, Revision, SlamConfig};
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::mpsc;
use std::time::{Duration, Instant};

/// A log may be this large when unpacked, bytes.
const LOG_MAX: u64 = 1 << 30;
/// Malformed lines that are shown; the others are counted.
const ERRORS_SHOWN: usize = 5;
/// Nodes that may wait for the back end: the log waits then, and no node is held back.
const WAITING_MAX: usize = slam::NODES_IN_FLIGHT_MAX - 2;
/// Between two lines of progress.
const PROGRESS: Duration = Duration::from_secs(1);

/// `mr-slam replay LOG`.
#[derive(clap::Args, Clone, Debug)]
pub struct ReplayArgs {
    /// CARMEN logs, plain or gzip; more than one: a fleet, see --merge
    #[arg(value_name = "LOG", required = true)]
    pub logs: Vec<PathBuf>,
    /// Merge the robots of several logs: `known:FILE` (a line each robot: index, time, x, y, theta) or `unknown`
    #[arg(long, value_name = "STARTS")]
    pub merge: Option<Starts>,
    /// Write the final trajectory: one line a scan, `t x y z qx qy qz qw`; of several logs, a folder of them
    #[arg(long, value_name = "FILE")]
    pub trajectory: Option<PathBuf>,
    /// Write the map: FILE.yaml with its PGM, and a PNG
    #[arg(long, value_name = "FILE")]
    pub map: Option<PathBuf>,
    /// Print the summary as JSON
    #[arg(long)]
    pub json: bool,
    /// Keep only the central beams of every scan, degrees
    #[arg(long, value_name = "DEGREES")]
    pub fov_deg: Option<f64>,
    /// Use the scans alone
    #[arg(long)]
    pub no_odometry: bool,
    /// Never close a loop
    #[arg(long)]
    pub no_closures: bool,
    /// Begin with this session file; or with a map (.yaml), to localize in it
    #[arg(long, value_name = "FILE")]
    pub session: Option<PathBuf>,
    /// Keep the session in this file
    #[arg(long, value_name = "FILE")]
    pub save_session: Option<PathBuf>,
    /// What to do with the map: let it grow, stay as it is, or forget what is no longer so
    #[arg(long, value_enum, default_value_t)]
    pub mode: Mode,
    /// The robot stands here in the session's map, about; without it, it is looked for
    #[arg(long, value_name = "X,Y,YAW", value_parser = crate::process::pose, allow_hyphen_values = true, requires = "session")]
    pub at: Option<Pose2>,
    /// The robot goes on where the session's ended, as if it had never stopped
    #[arg(long, requires = "session", conflicts_with = "at")]
    pub go_on: bool,
    /// Leave out the log's first scans
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub skip: usize,
    /// End after so many scans
    #[arg(long, value_name = "N")]
    pub scans: Option<usize>,
}

/// What stops a replay.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// The log cannot be read.
    #[error("cannot read {path}: {source}")]
    Read {
        /// Which file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A result cannot be written.
    #[error("cannot write {path}: {source}")]
    Write {
        /// Which file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The map cannot be written.
    #[error(transparent)]
    Map(#[from] MapFileError),
    /// Nothing to do.
    #[error(
        "{path} has no usable scan: expected FLASER or ROBOTLASER1 lines ({skipped} other lines, {malformed} malformed)"
    )]
    NoScan {
        /// Which file.
        path: PathBuf,
        /// Lines of other kinds.
        skipped: u64,
        /// Malformed lines.
        malformed: u64,
    },
    /// A session cannot be read or written.
    #[error(transparent)]
    Session(#[from] SessionFileError),
    /// A map has no graph.
    #[error("--session {0} is a map: nothing but --mode localize can be done with it")]
    MapOnly(PathBuf),
    /// An option makes no sense.
    #[error("--fov-deg is {0}, expected 1 to 360")]
    FieldOfView(f64),
    /// Several logs, and nobody said what to do with them; or too many.
    #[error("{0} logs: expected one, or 2 to {max} with --merge", max = msg::ROBOTS_MAX)]
    Logs(usize),
    /// A line of the file with the starts.
    #[error(
        "{path}:{line}: `{found}`: expected `index time x y theta`, a robot of the fleet and finite numbers"
    )]
    Starts {
        /// The file.
        path: PathBuf,
        /// From 1.
        line: usize,
        /// What it says.
        found: String,
    },
}

/// Replays a log, writes what was asked for, prints the summary.
pub fn run(args: &ReplayArgs) -> Result<(), ReplayError> {
    if let Some(fov) = args.fov_deg.filter(|fov| !(1.0..=360.0).contains(fov)) {
        return Err(ReplayError::FieldOfView(fov));
    }
    let mut config = SlamConfig::default();
    config.odometry.used = !args.no_odometry;
    config.closures.enabled = !args.no_closures;
    let log = match (args.logs.as_slice(), &args.merge) {
        ([log], None) => log,
        (logs, Some(starts)) if (2..=msg::ROBOTS_MAX).contains(&logs.len()) => {
            return fleet::run(args, starts, &config);
        }
        (logs, _) => return Err(ReplayError::Logs(logs.len())),
    };
    let start = Instant::now();
    let log = read_log(log)?;
    let mut replayed = feed(&log, config, args)?;
    replayed.summary.wall_s = start.elapsed().as_secs_f64();
    replayed.summary.times_real_time = replayed.duration_s / replayed.summary.wall_s;
    finish(args, replayed)
}

fn finish(args: &ReplayArgs, replayed: Replayed) -> Result<(), ReplayError> {
    let Replayed { front, mut back, mut summary, .. } = replayed;
    if let Some(path) = &args.trajectory {
        write_trajectory(path, slam::trajectory(&front, &back))
            .map_err(|source| ReplayError::Write { path: path.clone(), source })?;
    }
    if let Some(path) = &args.save_session {
        let identity = Identity::new(0, 0, back.config());
        session_file::write(path, &back.session(identity, Some(front.state()), front.samples()))?;
    }
    let drawing = Instant::now();
    let grid = back.map();
    summary.map_ms = drawing.elapsed().as_secs_f64() * 1e3;
    (summary.map_width, summary.map_height) = (grid.header.width, grid.header.height);
    if let Some(path) = &args.map {
        write_map(&path.with_extension(""), grid)?;
    }
    summary::print(&summary, args.json);
    Ok(())
}

/// The log's bytes, unpacked if they are gzip.
fn read_log(path: &Path) -> Result<Vec<u8>, ReplayError> {
    let fail = |source| ReplayError::Read { path: path.to_owned(), source };
    let bytes = std::fs::read(path).map_err(fail)?;
    gzip::unpack(bytes, LOG_MAX).map_err(fail)
}

/// A log gone through.
struct Replayed {
    front: FrontEnd,
    back: BackEnd,
    summary: Summary,
    duration_s: f64,
}

fn feed(log: &[u8], mut config: SlamConfig, args: &ReplayArgs) -> Result<Replayed, ReplayError> {
    let mut records = Records { reader: Reader::new(log), malformed: 0 };
    let Some(first) = (0..=args.skip).map_while(|_| records.next_laser()).nth(args.skip) else {
        let (skipped, malformed) = (records.reader.skipped(), records.malformed);
        return Err(ReplayError::NoScan { path: args.logs[0].clone(), skipped, malformed });
    };
    let on_robot = first.base_from_scan;
    config.lidar.base_from_scan = [on_robot.x_m, on_robot.y_m, on_robot.yaw_rad];
    let (mut front, mut back) = begin(args, config)?;
    let (to_back, nodes) = mpsc::sync_channel::<Node>(WAITING_MAX);
    let (to_front, revisions) = mpsc::channel::<Revision>();
    let mut summary = Summary { log: args.logs[0].display().to_string(), ..Default::default() };
    let started = first.stamp;
    let mut ended = started;
    std::thread::scope(|scope| {
        let back = &mut back;
        let beside = scope.spawn(move || work_beside(back, nodes, to_front));
        let mut feeder = Feeder::new(args);
        let front = &mut front;
        let mut next = Some(first);
        while let Some(line) = next {
            ended = line.stamp;
            revisions.try_iter().for_each(|revision| front.add_revision(revision));
            if let Some(node) = feeder.scan(front, &line) {
                let _ = to_back.send(node);
            }
            let enough = args.scans.is_some_and(|scans| feeder.seq as usize >= scans);
            next = if enough { None } else { records.next_laser() };
        }
        drop(to_back);
        summary.not_located = feeder.not_located;
        summary.scan_ms = Percentiles::of(core::mem::take(&mut feeder.times));
        summary.beside_ms = Percentiles::of(beside.join().unwrap_or_default());
    });
    (summary.malformed_lines, summary.skipped_lines) = (records.malformed, records.reader.skipped());
    summary.count(&front, &back);
    let Pose2 { x_m, y_m, yaw_rad } = back.latest_revision().map_from_local * front.local_from_base();
    summary.ends_at = [x_m, y_m, yaw_rad];
    Ok(Replayed { front, back, summary, duration_s: ended - started })
}

/// A scan path and a back end, new or from a session.
fn begin(args: &ReplayArgs, config: SlamConfig) -> Result<(FrontEnd, BackEnd), ReplayError> {
    let Some(path) = &args.session else {
        return Ok(slam::begin(config, None, args.mode.into(), InitialPose::Unknown));
    };
    if session_file::is_map(path) && args.mode != Mode::Localization {
        return Err(ReplayError::MapOnly(path.clone()));
    }
    let session = session_file::read_any(path, &Identity::new(0, 0, &config), &config)?;
    let [sigma_m, sigma_rad] = TOLD_SIGMA;
    let start = match args.at {
        Some(map_from_local) => InitialPose::Near(PoseEstimate { map_from_local, sigma_m, sigma_rad }),
        None if args.go_on => InitialPose::Continue,
        None => InitialPose::Unknown,
    };
    Ok(slam::begin(config, Some(session), args.mode.into(), start))
}

/// Works off nodes until there are no more to come. Returns how long each took, and the last word.
fn work_beside(
    back: &mut BackEnd,
    nodes: mpsc::Receiver<Node>,
    to_front: mpsc::Sender<Revision>,
) -> Vec<Duration> {
    let mut times = Vec::new();
    for node in nodes {
        let start = Instant::now();
        let revision = back.add_node(node);
        times.push(start.elapsed());
        // The log may have ended, then nobody listens.
        let _ = to_front.send(revision);
    }
    let start = Instant::now();
    back.finish();
    times.push(start.elapsed());
    times
}

struct Records<'a> {
    reader: Reader<'a>,
    malformed: u64,
}

impl Records<'_> {
    /// Scan lines carry the odometry they were taken at, so ODOM lines add nothing.
    fn next_laser(&mut self) -> Option<LaserLine> {
        loop {
            match self.reader.next()? {
                Ok(Record::Laser(line)) => return Some(line),
                Ok(Record::Odometry(_)) => {}
                Err(error) => {
                    self.malformed += 1;
                    if self.malformed as usize <= ERRORS_SHOWN {
                        eprintln!("{error}; line skipped");
                    }
                }
            }
        }
    }
}

/// Log lines to messages.
struct Feeder {
    scan: Box<Scan>,
    seq: u64,
    fov_rad: Option<f64>,
    times: Vec<Duration>,
    told: Instant,
    not_located: u64,
}

impl Feeder {
    fn new(args: &ReplayArgs) -> Self {
        let scan: Box<Scan> = bytemuck::allocation::zeroed_box();
        let fov_rad = args.fov_deg.map(f64::to_radians);
        Self { scan, seq: 0, fov_rad, times: Vec::new(), told: Instant::now(), not_located: 0 }
    }

    fn scan(&mut self, front: &mut FrontEnd, line: &LaserLine) -> Option<Node> {
        line.write_to(&mut self.scan, self.seq, self.fov_rad);
        self.seq += 1;
        let header = msg::Header { stamp: line.stamp, ..Default::default() };
        let odometry = Odometry { header, odom_from_base: line.odom_from_base, ..Default::default() };
        front.add_odometry(&odometry);
        let start = Instant::now();
        let step = front.process(&self.scan);
        self.times.push(start.elapsed());
        self.not_located += u64::from(!front.is_located());
        if self.told.elapsed() > PROGRESS {
            self.told = Instant::now();
            eprintln!("{} scans, {} nodes", self.seq, step.correction.nodes);
        }
        step.node
    }
}

/// `t x y z qx qy qz qw`, one line a scan.
fn write_trajectory(path: &Path, poses: impl Iterator<Item = (Stamp, Pose2)>) -> std::io::Result<()> {
    let mut file = BufWriter::new(File::create(path)?);
    for (stamp, pose) in poses {
        let microseconds = stamp.0.div_euclid(1000) + i64::from(stamp.0.rem_euclid(1000) >= 500);
        let sign = if microseconds < 0 { "-" } else { "" };
        let (seconds, fraction) = (microseconds.abs() / 1_000_000, microseconds.abs() % 1_000_000);
        let (sin, cos) = (pose.yaw_rad / 2.0).sin_cos();
        writeln!(
            file,
            "{sign}{seconds}.{fraction:06} {:.6} {:.6} 0 0 0 {sin:.9} {cos:.9}",
            pose.x_m, pose.y_m
        )?;
    }
    file.flush()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A robot that drives 2 m through a box of 8 m x 6 m, one scan each 0.25 m.
    fn log() -> String {
        let mut log = String::from("# a box\nPARAM robot none\n");
        for step in 0..9 {
            let x = f64::from(step) * 0.25;
            log += "FLASER 181";
            for beam in 0..181 {
                let (sin, cos) = (f64::from(beam) - 90.0).to_radians().sin_cos();
                let range = ((6.0 - x) / cos.max(1e-9)).min(3.0 / sin.abs().max(1e-9));
                log += &format!(" {range:.3}");
            }
            let odometry = x * 1.02;
            log += &format!(" 0 0 0 {odometry} 0 0 976052890.24411{step} host 0\n");
            log += "FLASER 3 1 2 oops\n";
        }
        log
    }

    fn args(log: &Path) -> ReplayArgs {
        ReplayArgs {
            logs: vec![log.to_owned()],
            merge: None,
            trajectory: None,
            map: None,
            json: false,
            fov_deg: None,
            no_odometry: false,
            no_closures: false,
            session: None,
            save_session: None,
            mode: Mode::Mapping,
            at: None,
            go_on: false,
            skip: 0,
            scans: None,
        }
    }

    #[test]
    fn every_scan_gets_a_pose_at_its_own_stamp() {
        let folder = std::env::temp_dir().join(format!("mr-slam-replay-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let (path, trajectory) = (folder.join("box.log.gz"), folder.join("box.tum"));
        let mut packed = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
        packed.write_all(log().as_bytes()).unwrap();
        std::fs::write(&path, packed.finish().unwrap()).unwrap();
        let map = Some(folder.join("box.yaml"));
        run(&ReplayArgs { trajectory: Some(trajectory.clone()), map, ..args(&path) }).unwrap();

        let text = std::fs::read_to_string(&trajectory).unwrap();
        let rows: Vec<Vec<&str>> = text.lines().map(|l| l.split(' ').collect()).collect();
        assert_eq!(rows.len(), 9);
        for (step, row) in rows.iter().enumerate() {
            assert_eq!(row[0], format!("976052890.24411{step}"));
            let x: f64 = row[1].parse().unwrap();
            assert!((x - 0.25 * step as f64).abs() < 0.02, "{x} at scan {step}");
        }
        assert!(folder.join("box.pgm").exists() && folder.join("box.yaml").exists());
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn malformed_lines_are_counted() {
        let replayed = feed(log().as_bytes(), SlamConfig::default(), &args(Path::new("box.log"))).unwrap();
        let summary = replayed.summary;
        assert_eq!((summary.scans, summary.malformed_lines, summary.skipped_lines), (9, 9, 2));
    }

    #[test]
    fn a_log_without_scans_says_what_was_expected() {
        let error = feed(b"ODOM 1 2\nhello\n", SlamConfig::default(), &args(Path::new("x.log")));
        let message = error.err().unwrap().to_string();
        assert!(message.contains("x.log") && message.contains("FLASER"), "{message}");
        assert!(message.contains("1 other lines, 1 malformed"), "{message}");
    }
}
