//! Scans of a log: a CARMEN log, or a recording in MCAP.

use super::{ReplayArgs, ReplayError, log_files, recorded_fleet};
use crate::command::output;
use formats::bag_folder::{refuse_file_of_other_formats, refuse_other_formats};
use formats::carmen::{LaserLine, Reader, Record, StrayFilter};
use formats::gzip;
use msg::{Pose2, Scan, Stamp};
use recording::ScanGaps;
use recording::bag::{Bag, BagOptions, BagScan, LeftOut};
use std::path::{Path, PathBuf};

/// Largest CARMEN log when unpacked, bytes.
const LOG_MAX: u64 = 1 << 30;
/// Number of malformed lines that are shown; the others are counted.
const ERRORS_SHOWN: usize = 5;

/// Topics and frames of a recording from elsewhere
#[derive(clap::Args, Clone, Debug, Default)]
pub struct BagArgs {
    /// Topic of the scans in a recording (.mcap) [default: the only one with sensor_msgs/LaserScan]
    #[arg(long, value_name = "TOPIC")]
    pub scan_topic: Option<String>,
    /// Topic of nav_msgs/Odometry in a recording [default: the scans' namespace, the only one, or transforms]
    #[arg(long, value_name = "TOPIC")]
    pub odom_topic: Option<String>,
    /// Take the odometry from the transforms of this frame of a recording, such as `odom`
    #[arg(long, value_name = "FRAME", conflicts_with = "odom_topic")]
    pub odom_frame: Option<String>,
    /// Topic of the true poses in a recording, nav_msgs/Odometry, to which the trajectory is compared [default: ground_truth in
    /// the scans' namespace, if there is one]
    #[arg(long, value_name = "TOPIC")]
    pub truth_topic: Option<String>,
    /// Pose of the scanner on the robot: metres, metres, radians [default: the transforms of the recording]
    #[arg(long, value_name = "X,Y,YAW", value_parser = crate::process::pose)]
    pub scanner: Option<Pose2>,
}

impl BagArgs {
    /// Returns whether topics or frames are named.
    pub fn are_given(&self) -> bool {
        let Self { scan_topic, odom_topic, odom_frame, truth_topic, scanner: _ } = self;
        [scan_topic, odom_topic, odom_frame, truth_topic].iter().any(|given| given.is_some())
    }
}

/// Returns whether a file is named as a recording in MCAP, or is a folder, as rosbag2 writes it.
pub fn is_recording(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("mcap")) || path.is_dir()
}

/// Scans of a recording.
pub struct RecordedScans {
    bag: Bag,
    /// Stamps of the scans of which the recording has the true pose of the base, and these poses, in order of time.
    world_from_base: Vec<(Stamp, Pose2)>,
    /// Pauses in the scans.
    gaps: Option<ScanGaps>,
    /// Files of its folder that are not read.
    not_read: Vec<String>,
}

/// A log that was read.
pub enum Log {
    /// Text of a CARMEN log.
    Carmen(Vec<u8>),
    /// Scans of a recording.
    Recording(Box<RecordedScans>),
}

/// A scan of a log, and what a line of a CARMEN log does not say.
#[derive(Clone, Debug, PartialEq)]
pub struct LogScan {
    /// The scan, with the odometry at its stamp.
    pub line: LaserLine,
    /// Times and limits of a recording's scan; `None`: those of a CARMEN log.
    pub details: Option<ScanDetails>,
}

/// Times and limits of a scan that lines of a CARMEN log do not have.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScanDetails {
    /// Time between neighbouring beams, seconds.
    pub time_increment_s: f32,
    /// Time between two scans, seconds.
    pub scan_time_s: f32,
    /// Range below which a reading is no measurement, metres.
    pub range_min_m: f32,
}

impl LogScan {
    /// Fills a scan message with sequence number `seq`; `fov_rad` keeps the central beams only.
    pub fn write_to(&self, scan: &mut Scan, seq: u64, fov_rad: Option<f64>) {
        self.line.write_to(scan, seq, fov_rad);
        let Some(details) = &self.details else { return };
        (scan.time_increment_s, scan.scan_time_s) = (details.time_increment_s, details.scan_time_s);
        scan.range_min_m = details.range_min_m;
        // The stamp is the time of the first beam, of those that are kept.
        let before =
            (f64::from(scan.angle_min_rad) - self.line.angle_min_rad) / self.line.angle_increment_rad;
        let late_ns = before.round() * f64::from(details.time_increment_s) * 1e9;
        scan.header.stamp = Stamp(scan.header.stamp.0.saturating_add(late_ns as i64));
    }
}

impl Log {
    /// Reads a log, unpacked if it is gzip, or the scans of a recording, whose files may be several.
    pub fn read(paths: &[PathBuf], args: &ReplayArgs) -> Result<Self, ReplayError> {
        let path = &paths[0];
        if !is_recording(path) {
            let fail = |source| ReplayError::Read { path: path.clone(), source };
            // Before the whole is read: bags are often longer than any log.
            refuse_file_of_other_formats(path)?;
            let bytes = formats::limited::read(path, LOG_MAX).map_err(fail)?;
            let unpacked = gzip::unpack(bytes, LOG_MAX).map_err(fail)?;
            refuse_other_formats(path, &unpacked)?;
            return Ok(Self::Carmen(unpacked));
        }
        Self::of_topic(paths, args, args.bag.scan_topic.as_deref())
    }

    /// Reads the scans of a recording on one topic, which may be the only one.
    fn of_topic(paths: &[PathBuf], args: &ReplayArgs, scan_topic: Option<&str>) -> Result<Self, ReplayError> {
        let path = &paths[0];
        let options = BagOptions {
            scan_topic: scan_topic.map(str::to_owned),
            odometry_topic: args.bag.odom_topic.clone(),
            odom_frame: args.bag.odom_frame.clone(),
            base_from_scan: args.bag.scanner,
            recorded_base_from_scan: recorded_mount(path),
            without_odometry: args.no_odometry,
            truth_topic: args.bag.truth_topic.clone(),
        };
        let (bag, not_read) = log_files::read_bag(paths, &options)?;
        note_left_out(path, &bag);
        if bag.scans.is_empty() {
            let LeftOut { malformed, without_odometry, .. } = bag.left_out;
            return Err(ReplayError::NoScanOfBag { path: path.clone(), malformed, without_odometry });
        }
        let log = Self::of_bag(bag, not_read);
        if let Some(gaps) = log.gaps() {
            output::note(&format!("{}: {gaps}", path.display()));
        }
        Ok(log)
    }

    /// Reads the logs of several robots, each with its name: a log each, or a recording in which each robot has its topic of scans.
    pub fn read_robots(args: &ReplayArgs) -> Result<Vec<(String, Self)>, ReplayError> {
        let mut robots = Vec::new();
        for path in args.logs.chunks(1) {
            let name = path[0].display();
            match Self::read(path, args) {
                Ok(log) => robots.push((name.to_string(), log)),
                Err(ReplayError::Bag { why, .. }) if args.logs.len() == 1 && why.scan_topics().is_some() => {
                    let topics = why.scan_topics().unwrap_or_default();
                    refuse_one_robots_options(args)?;
                    if topics.len() > msg::ROBOTS_MAX {
                        return Err(ReplayError::Robots(topics.len()));
                    }
                    for topic in topics {
                        robots.push((format!("{name} {topic}"), Self::of_topic(path, args, Some(topic))?));
                    }
                }
                Err(why) => return Err(why),
            }
        }
        match robots.len() {
            2..=msg::ROBOTS_MAX => Ok(robots),
            count => Err(ReplayError::Robots(count)),
        }
    }

    /// Returns the log of a recording that was read, but for some files of its folder.
    pub fn of_bag(bag: Bag, not_read: Vec<String>) -> Self {
        let truth = bag.scans.iter().filter_map(|scan| Some((scan.stamp, scan.world_from_base?)));
        let world_from_base = truth.collect();
        let gaps = ScanGaps::find(bag.scans.iter().map(|scan| scan.stamp));
        Self::Recording(Box::new(RecordedScans { bag, world_from_base, gaps, not_read }))
    }

    /// Returns the scans.
    pub fn records(&self) -> Records<'_> {
        match self {
            Self::Carmen(bytes) => {
                Records { source: Source::Carmen(Reader::new(bytes), StrayFilter::default()), malformed: 0 }
            }
            Self::Recording(scans) => Records {
                source: Source::Scans(scans.bag.scans.iter(), scans.bag.base_from_scan),
                malformed: scans.bag.left_out.malformed,
            },
        }
    }

    /// Returns the odometry of a recording in order of time; empty where each scan has its own.
    pub fn odometry(&self) -> &[(Stamp, Pose2)] {
        match self {
            Self::Carmen(_) => &[],
            Self::Recording(scans) => &scans.bag.odometry,
        }
    }

    /// Returns what is left out of a recording.
    pub fn left_out(&self) -> LeftOut {
        match self {
            Self::Carmen(_) => LeftOut::default(),
            Self::Recording(scans) => scans.bag.left_out,
        }
    }

    /// Returns the pauses in a recording's scans, if it has any.
    pub fn gaps(&self) -> Option<ScanGaps> {
        match self {
            Self::Carmen(_) => None,
            Self::Recording(scans) => scans.gaps,
        }
    }

    /// Returns the files of a recording's folder that are not read.
    pub fn not_read(&self) -> &[String] {
        match self {
            Self::Carmen(_) => &[],
            Self::Recording(scans) => &scans.not_read,
        }
    }

    /// Returns why a recording is used in part, if it was cut off or damaged.
    pub fn damage(&self) -> Option<&str> {
        match self {
            Self::Carmen(_) => None,
            Self::Recording(scans) => scans.bag.damage.as_deref(),
        }
    }

    /// Returns stamps and true poses of the scans, in order of time; empty if they are not known.
    pub fn truth(&self) -> &[(Stamp, Pose2)] {
        match self {
            Self::Carmen(_) => &[],
            Self::Recording(scans) => &scans.world_from_base,
        }
    }
}

/// Returns the scanner's pose on the robot by the configuration of a fleet's recording; `None`: it is one from elsewhere, or of
/// another version.
fn recorded_mount(path: &Path) -> Option<Pose2> {
    let [x_m, y_m, yaw_rad] = recorded_fleet::configuration(path).ok()??.slam.lidar.base_from_scan;
    Some(Pose2::new(x_m, y_m, yaw_rad))
}

/// Refuses options that name one robot's topics, where a recording has several robots.
fn refuse_one_robots_options(args: &ReplayArgs) -> Result<(), ReplayError> {
    let BagArgs { odom_topic, odom_frame, truth_topic, .. } = &args.bag;
    let given = [("--odom-topic", odom_topic), ("--odom-frame", odom_frame), ("--truth-topic", truth_topic)];
    match given.iter().find(|(_, value)| value.is_some()) {
        Some((option, _)) => Err(ReplayError::WithoutEffect {
            options: (*option).into(),
            replay: "several robots of one recording",
        }),
        None => Ok(()),
    }
}

/// Says what is left out of a recording, and why.
fn note_left_out(path: &Path, bag: &Bag) {
    let path = path.display();
    if let Some(why) = &bag.damage {
        output::note(why);
    }
    if let Some(fault) = &bag.first_fault {
        output::note(&format!("{path}: what is wrong with the first malformed message, on {fault}"));
    }
    let LeftOut {
        malformed,
        too_many_beams,
        without_odometry,
        other_frames,
        stray_stamps,
        over_limit,
        clock_steps,
    } = bag.left_out;
    let has_no_beam_times = |scan: &&BagScan| scan.time_increment_s == 0.0 && scan.scan_time_s > 0.0;
    let without_beam_times = bag.scans.iter().filter(has_no_beam_times).count() as u64;
    let reasons = [
        (malformed, "messages cannot be decoded or are no measurement, and are left out"),
        (
            without_beam_times,
            "scans have time_increment 0 and are taken as measured at one moment; of a LiDAR that turns meanwhile the walls bend while the \
             robot turns",
        ),
        (without_odometry, "scans have no odometry within 0.5 s and are left out; do both have one clock?"),
        (too_many_beams, "scans have more than 4096 beams, which is the limit, and are left out"),
        (other_frames, "scans are of another scanner (frame_id) than most on this topic and are left out"),
        (stray_stamps, "scans have single stamps that are wrong by more than a second and are left out"),
        (over_limit, "messages and transforms are more than is kept of a bag, and are left out; cut the bag"),
        (
            clock_steps,
            "times the clock of the stamps was set back by more than a second; the stamps after that go on after those before it",
        ),
    ];
    for (count, reason) in reasons.into_iter().filter(|(count, _)| *count > 0) {
        output::note(&format!("{path}: {count} {reason}"));
    }
}

fn log_scan(scan: &BagScan, base_from_scan: Pose2) -> LogScan {
    let line = LaserLine {
        stamp: scan.stamp,
        odom_from_base: scan.odom_from_base,
        base_from_scan,
        angle_min_rad: scan.angle_min_rad,
        angle_increment_rad: scan.angle_increment_rad,
        range_max_m: f64::from(scan.range_max_m),
        ranges_m: scan.ranges_m.clone(),
    };
    let details = ScanDetails {
        time_increment_s: scan.time_increment_s,
        scan_time_s: scan.scan_time_s,
        range_min_m: scan.range_min_m,
    };
    LogScan { line, details: Some(details) }
}

/// Laser scans of a log.
pub struct Records<'a> {
    source: Source<'a>,
    /// Number of malformed lines or messages so far.
    pub malformed: u64,
}

enum Source<'a> {
    Carmen(Reader<'a>, StrayFilter<LaserLine>),
    Scans(std::slice::Iter<'a, BagScan>, Pose2),
}

impl Records<'_> {
    /// Returns the next scan. Scan lines carry the odometry at which they were taken, so ODOM lines add nothing.
    pub fn next_laser(&mut self) -> Option<LogScan> {
        match &mut self.source {
            Source::Scans(scans, base_from_scan) => scans.next().map(|scan| log_scan(scan, *base_from_scan)),
            Source::Carmen(reader, filter) => {
                let line = filter.next(|| next_line(reader, &mut self.malformed), |line| line.stamp)?;
                Some(LogScan { line, details: None })
            }
        }
    }

    /// Returns the number of scans of a CARMEN log so far whose stamps are in the far future of those after them.
    pub fn stray_stamps(&self) -> u64 {
        match &self.source {
            Source::Carmen(_, filter) => filter.left_out(),
            // Reading a bag leaves them out.
            Source::Scans(..) => 0,
        }
    }

    /// Returns the number of lines of other kinds so far.
    pub fn skipped(&self) -> u64 {
        match &self.source {
            Source::Carmen(reader, _) => reader.skipped(),
            Source::Scans(..) => 0,
        }
    }
}

/// Returns the next scan line, and counts malformed lines before it.
fn next_line(reader: &mut Reader<'_>, malformed: &mut u64) -> Option<LaserLine> {
    loop {
        match reader.next()? {
            Ok(Record::Laser(line)) => return Some(line),
            Ok(Record::Odometry(_)) => {}
            Err(error) => {
                *malformed += 1;
                if *malformed as usize <= ERRORS_SHOWN {
                    output::note(&format!("{error}; line skipped"));
                }
            }
        }
    }
}
