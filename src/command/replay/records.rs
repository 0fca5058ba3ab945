//! Scans of a log: a CARMEN log, or a recording in MCAP.

use super::{ReplayArgs, ReplayError};
use crate::command::output;
use formats::carmen::{LaserLine, Reader, Record};
use formats::gzip;
use msg::{Pose2, Scan, Stamp};
use recording::RecordingReader;
use recording::bag::{BagOptions, BagScan, read_bag};
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

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
    #[arg(long, value_name = "X,Y,YAW", value_parser = crate::process::pose, allow_hyphen_values = true)]
    pub scanner: Option<Pose2>,
}

impl BagArgs {
    /// Returns whether topics or frames are named.
    pub fn are_given(&self) -> bool {
        let Self { scan_topic, odom_topic, odom_frame, truth_topic, scanner: _ } = self;
        [scan_topic, odom_topic, odom_frame, truth_topic].iter().any(|given| given.is_some())
    }
}

/// Returns whether a file is named as a recording in MCAP.
pub fn is_recording(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("mcap"))
}

/// Scans of a recording.
pub struct RecordedScans {
    lines: Vec<LaserLine>,
    /// Stamps of the scans of which the recording has the true pose of the base, and these poses, in order of time.
    world_from_base: Vec<(Stamp, Pose2)>,
    /// Number of malformed messages.
    malformed: u64,
}

/// A log that was read.
pub enum Log {
    /// Text of a CARMEN log.
    Carmen(Vec<u8>),
    /// Scans of a recording.
    Recording(RecordedScans),
}

impl Log {
    /// Reads a log, unpacked if it is gzip, or the scans of a recording.
    pub fn read(path: &Path, args: &ReplayArgs) -> Result<Self, ReplayError> {
        let fail = |source| ReplayError::Read { path: path.to_owned(), source };
        if !is_recording(path) {
            let bytes = formats::limited::read(path, LOG_MAX).map_err(fail)?;
            return gzip::unpack(bytes, LOG_MAX).map(Self::Carmen).map_err(fail);
        }
        let options = BagOptions {
            scan_topic: args.bag.scan_topic.clone(),
            odometry_topic: args.bag.odom_topic.clone(),
            odom_frame: args.bag.odom_frame.clone(),
            base_from_scan: args.bag.scanner,
            without_odometry: args.no_odometry,
            truth_topic: args.bag.truth_topic.clone(),
        };
        let mut reader = RecordingReader::new(BufReader::new(File::open(path).map_err(fail)?));
        let mut scan: Box<Scan> = bytemuck::allocation::zeroed_box();
        let bag = read_bag(&mut reader, &options, &mut scan)
            .map_err(|why| ReplayError::Bag { path: path.to_owned(), why })?;
        if let Some(why) = &bag.broken {
            output::note(&format!("{}: {why}; used up to there", path.display()));
        }
        if bag.without_odometry > 0 {
            let (path, count) = (path.display(), bag.without_odometry);
            output::note(&format!(
                "{path}: {count} scans have no odometry within 0.5 s and are left out; do both have one clock?"
            ));
        }
        if bag.scans.is_empty() {
            return Err(ReplayError::NoScanOfBag {
                path: path.to_owned(),
                malformed: bag.malformed,
                without_odometry: bag.without_odometry,
            });
        }
        let (base_from_scan, malformed) = (bag.base_from_scan, bag.malformed);
        let truth = bag.scans.iter().filter_map(|scan| Some((scan.stamp, scan.world_from_base?)));
        let world_from_base = truth.collect();
        let lines = bag.scans.into_iter().map(|scan| laser_line(scan, base_from_scan)).collect();
        Ok(Self::Recording(RecordedScans { lines, world_from_base, malformed }))
    }

    /// Returns the scans.
    pub fn records(&self) -> Records<'_> {
        match self {
            Self::Carmen(bytes) => Records { source: Source::Carmen(Reader::new(bytes)), malformed: 0 },
            Self::Recording(scans) => {
                Records { source: Source::Scans(scans.lines.iter()), malformed: scans.malformed }
            }
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

fn laser_line(scan: BagScan, base_from_scan: Pose2) -> LaserLine {
    let BagScan {
        stamp,
        odom_from_base,
        world_from_base: _,
        angle_min_rad,
        angle_increment_rad,
        range_max_m,
        ranges_m,
    } = scan;
    LaserLine {
        stamp,
        odom_from_base,
        base_from_scan,
        angle_min_rad,
        angle_increment_rad,
        range_max_m,
        ranges_m,
    }
}

/// Laser scans of a log.
pub struct Records<'a> {
    source: Source<'a>,
    /// Number of malformed lines or messages so far.
    pub malformed: u64,
}

enum Source<'a> {
    Carmen(Reader<'a>),
    Scans(std::slice::Iter<'a, LaserLine>),
}

impl Records<'_> {
    /// Returns the next scan. Scan lines carry the odometry at which they were taken, so ODOM lines add nothing.
    pub fn next_laser(&mut self) -> Option<LaserLine> {
        let reader = match &mut self.source {
            Source::Scans(lines) => return lines.next().cloned(),
            Source::Carmen(reader) => reader,
        };
        loop {
            match reader.next()? {
                Ok(Record::Laser(line)) => return Some(line),
                Ok(Record::Odometry(_)) => {}
                Err(error) => {
                    self.malformed += 1;
                    if self.malformed as usize <= ERRORS_SHOWN {
                        output::note(&format!("{error}; line skipped"));
                    }
                }
            }
        }
    }

    /// Returns the number of lines of other kinds so far.
    pub fn skipped(&self) -> u64 {
        match &self.source {
            Source::Carmen(reader) => reader.skipped(),
            Source::Scans(_) => 0,
        }
    }
}
