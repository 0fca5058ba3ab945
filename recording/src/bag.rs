//! Scans and odometry of one robot in a bag from anywhere: LaserScan with Odometry, or with transforms.
//!
//! Sizes and numbers of a bag are not trusted: what is no measurement is counted and left out.

use crate::pose_at::pose_at;
use crate::{ReadError, RecordedMessage, RecordingReader, planar};
use msg::{BEAMS_MAX, Pose2, Scan, Stamp};
use ros_messages::cdr::Reader;
use ros_messages::{LaserScan, Message, Odometry, TfMessage, read};
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::io::Read;

/// Most scans of a bag: ten days at 40 Hz.
const SCANS_MAX: usize = 36_000_000;
/// Most bytes of ranges that are kept.
const RANGES_BYTES_MAX: usize = 8 << 30;
/// Most different transforms, and most frames between sensor and base.
const FRAMES_MAX: usize = 4096;
/// Most poses of odometry and transforms.
const POSES_MAX: usize = 50_000_000;
/// Name of a robot's topic with its true poses in the frame `world`.
pub const GROUND_TRUTH: &str = "ground_truth";
/// Fewest beams of a scan.
const BEAMS_MIN: usize = 2;

/// Which topics and frames of a bag are used; what is not named is found.
#[derive(Clone, Debug, Default)]
pub struct BagOptions {
    /// Topic of the scans.
    pub scan_topic: Option<String>,
    /// Topic of the odometry, of type nav_msgs/Odometry.
    pub odometry_topic: Option<String>,
    /// Frame of the odometry in transforms, such as `odom`.
    pub odom_frame: Option<String>,
    /// Pose of the scanner on the robot's base, if no transform says it.
    pub base_from_scan: Option<Pose2>,
    /// Scans are used without odometry.
    pub without_odometry: bool,
    /// Topic of the true poses, of type nav_msgs/Odometry.
    pub truth_topic: Option<String>,
}

/// A scan with the odometry at its time.
#[derive(Clone, Debug, PartialEq)]
pub struct BagScan {
    /// Time of the first beam.
    pub stamp: Stamp,
    /// Pose of the base in the odometry's frame.
    pub odom_from_base: Pose2,
    /// True pose of the base; `None`: the bag does not have it.
    pub world_from_base: Option<Pose2>,
    /// Angle of the first beam, radians.
    pub angle_min_rad: f64,
    /// Angle between neighbouring beams, radians.
    pub angle_increment_rad: f64,
    /// Range from which a reading means no return, metres.
    pub range_max_m: f64,
    /// Range of each beam, metres.
    pub ranges_m: Vec<f32>,
}

/// What a bag has of a robot.
#[derive(Clone, Debug, PartialEq)]
pub struct Bag {
    /// Scans in order of time.
    pub scans: Vec<BagScan>,
    /// Pose of the scanner on the robot's base.
    pub base_from_scan: Pose2,
    /// Messages that could not be decoded, or are no measurement.
    pub malformed: u64,
    /// Scans without odometry near them.
    pub without_odometry: u64,
    /// Why the file ends before its index, if it does.
    pub broken: Option<String>,
}

/// Reason why a bag cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum BagError {
    /// The file cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// What is needed is not in the part before the damage.
    #[error("{error}; the file is damaged ({why}), and was used up to there")]
    Damaged {
        /// What is missing.
        error: Box<BagError>,
        /// Why the file ends before its index.
        why: String,
    },
    /// There is no scan.
    #[error("the bag has no sensor_msgs/LaserScan{} in CDR ({malformed} malformed messages); it has {}", on_topic(.wished), list(.topics))]
    NoScan {
        /// Topic that was named.
        wished: Option<String>,
        /// Number of malformed messages.
        malformed: u64,
        /// Topics of the bag with their types.
        topics: Vec<String>,
    },
    /// Several topics have scans.
    #[error("the bag has scans on {}; name one with --scan-topic", list(.0))]
    SeveralScans(Vec<String>),
    /// There is no odometry.
    #[error(
        "the bag has no odometry for {scan_topic}: expected nav_msgs/Odometry, or a transform from a frame `odom` (--odom-frame); \
         it has odometry on {}; name one with --odom-topic, or use --no-odometry",
        list(.topics)
    )]
    NoOdometry {
        /// Topic of the scans.
        scan_topic: String,
        /// Topics with odometry.
        topics: Vec<String>,
    },
    /// The topic that was named has no true poses.
    #[error("the bag has no nav_msgs/Odometry on {wished}; it has it on {}; name one with --truth-topic", list(.topics))]
    NoTruth {
        /// Topic that was named.
        wished: String,
        /// Topics with odometry.
        topics: Vec<String>,
    },
    /// No transform says where the scanner is.
    #[error(
        "no transform of the bag leads from `{scan_frame}` to `{base_frame}`; give the scanner's pose with --scanner X,Y,YAW"
    )]
    NoScanner {
        /// Frame of the scans.
        scan_frame: String,
        /// Frame of the robot's base.
        base_frame: String,
    },
}

fn on_topic(wished: &Option<String>) -> String {
    wished.as_ref().map_or(String::new(), |topic| format!(" on {topic}"))
}

fn list(names: &[String]) -> String {
    if names.is_empty() { "none".into() } else { names.join(", ") }
}

/// Odometry of one topic or transform.
#[derive(Default)]
struct Poses {
    base_frame: String,
    poses: Vec<(Stamp, Pose2)>,
}

/// A scan before its odometry is known.
struct RawScan {
    scan: BagScan,
    frame: String,
}

/// What is found in a bag, by topic or by parent and child of a transform.
#[derive(Default)]
struct Found {
    scans: BTreeMap<String, Vec<RawScan>>,
    odometry: BTreeMap<String, Poses>,
    transforms: HashMap<(String, String), Vec<(Stamp, Pose2)>>,
    topics: BTreeSet<String>,
    malformed: u64,
    scan_count: usize,
    ranges_bytes: usize,
    pose_count: usize,
}

/// Reads the scans and the odometry of one robot.
///
/// # Errors
/// The file is no MCAP, or has not what is needed: each error says what there is instead.
pub fn read_bag<R: Read>(
    reader: &mut RecordingReader<R>,
    options: &BagOptions,
    scan: &mut Scan,
) -> Result<Bag, BagError> {
    let mut found = Found::default();
    while let Some(message) = reader.next_message()? {
        if found.topics.len() < FRAMES_MAX {
            found.topics.insert(format!("{} ({})", message.topic, message.message_type));
        }
        if &*message.encoding == "cdr" && found.add(&message, scan).is_none() {
            found.malformed += 1;
        }
    }
    match (found.bag(options), reader.broken().map(str::to_owned)) {
        (Ok(bag), broken) => Ok(Bag { broken, ..bag }),
        (Err(error), Some(why)) => Err(BagError::Damaged { error: Box::new(error), why }),
        (Err(error), None) => Err(error),
    }
}

impl Found {
    fn add(&mut self, message: &RecordedMessage, scan: &mut Scan) -> Option<()> {
        let from = || Reader::new(&message.payload).ok();
        match &*message.message_type {
            LaserScan::TYPE => {
                let frame = read::laser_scan(&mut from()?, scan).ok()?.to_owned();
                let bytes = size_of_val(scan.ranges_m());
                if self.scan_count < SCANS_MAX && self.ranges_bytes + bytes <= RANGES_BYTES_MAX {
                    let raw = RawScan { scan: checked(scan)?, frame };
                    (self.scan_count, self.ranges_bytes) = (self.scan_count + 1, self.ranges_bytes + bytes);
                    self.scans.entry(message.topic.to_string()).or_default().push(raw);
                }
            }
            Odometry::TYPE if self.pose_count < POSES_MAX => {
                let mut from = from()?;
                let odometry = read::odometry(&mut from).ok()?;
                let pose = planar::pose(odometry.translation, odometry.rotation)?;
                let poses = self.odometry.entry(message.topic.to_string()).or_default();
                poses.base_frame = odometry.child_frame_id.to_owned();
                poses.poses.push((odometry.stamp, pose));
                self.pose_count += 1;
            }
            TfMessage::TYPE => {
                let mut is_well_formed = true;
                let result = read::transforms(&mut from()?, |transform| {
                    let key = (frame(transform.frame_id), frame(transform.child_frame_id));
                    let is_new = !self.transforms.contains_key(&key);
                    if self.pose_count >= POSES_MAX || (is_new && self.transforms.len() >= FRAMES_MAX) {
                        return;
                    }
                    match planar::pose(transform.translation, transform.rotation) {
                        Some(pose) => self.transforms.entry(key).or_default().push((transform.stamp, pose)),
                        None => is_well_formed = false,
                    }
                    self.pose_count += 1;
                });
                result.ok().filter(|()| is_well_formed)?;
            }
            _ => {}
        }
        Some(())
    }

    fn bag(mut self, options: &BagOptions) -> Result<Bag, BagError> {
        let scan_topic = self.scan_topic(options)?;
        let mut scans = self.scans.remove(&scan_topic).unwrap_or_default();
        scans.sort_by_key(|raw| raw.scan.stamp);
        let scan_frame = scans.first().map_or(String::new(), |raw| frame(&raw.frame));
        let truth = self.truth(&scan_topic, options)?;
        let odometry = if options.without_odometry { None } else { Some(self.poses(&scan_topic, options)?) };
        let base_frame = odometry.as_ref().map_or(String::new(), |poses| frame(&poses.base_frame));
        let base_from_scan = match options.base_from_scan {
            Some(pose) => pose,
            None if options.without_odometry => Pose2::new(0.0, 0.0, 0.0),
            None => self
                .base_from_scan(&scan_frame, &base_frame)
                .ok_or(BagError::NoScanner { scan_frame, base_frame })?,
        };
        let mut bag = Bag {
            scans: Vec::new(),
            base_from_scan,
            malformed: self.malformed,
            without_odometry: 0,
            broken: None,
        };
        for RawScan { scan, .. } in scans {
            let pose = match &odometry {
                None => Some(Pose2::new(0.0, 0.0, 0.0)),
                Some(poses) => pose_at(&poses.poses, scan.stamp),
            };
            match pose {
                Some(odom_from_base) => {
                    let world_from_base = pose_at(&truth, scan.stamp);
                    bag.scans.push(BagScan { odom_from_base, world_from_base, ..scan });
                }
                None => bag.without_odometry += 1,
            }
        }
        Ok(bag)
    }

    fn scan_topic(&self, options: &BagOptions) -> Result<String, BagError> {
        let no_scan = || BagError::NoScan {
            wished: options.scan_topic.clone(),
            malformed: self.malformed,
            topics: self.topics.iter().cloned().collect(),
        };
        match &options.scan_topic {
            Some(topic) if self.scans.contains_key(topic) => Ok(topic.clone()),
            Some(_) => Err(no_scan()),
            None if self.scans.len() > 1 => Err(BagError::SeveralScans(self.scans.keys().cloned().collect())),
            None => self.scans.keys().next().cloned().ok_or_else(no_scan),
        }
    }

    /// Takes the true poses: of the named topic, else of `ground_truth` in the scans' namespace, if there is one. They are no
    /// odometry.
    fn truth(&mut self, scan_topic: &str, options: &BagOptions) -> Result<Vec<(Stamp, Pose2)>, BagError> {
        let in_namespace = || format!("{}/{GROUND_TRUTH}", namespace(scan_topic).unwrap_or_default());
        let topic = options.truth_topic.clone().unwrap_or_else(in_namespace);
        let is_odometry = options.odometry_topic.as_ref() == Some(&topic);
        let found = if is_odometry { None } else { self.odometry.remove(&topic) };
        match (found, &options.truth_topic) {
            (Some(Poses { mut poses, .. }), _) => {
                poses.sort_by_key(|(stamp, _)| *stamp);
                Ok(poses)
            }
            (None, None) => Ok(Vec::new()),
            (None, Some(wished)) => Err(BagError::NoTruth {
                wished: wished.clone(),
                topics: self.odometry.keys().cloned().collect(),
            }),
        }
    }

    /// Returns the odometry: of the named topic, else of the scans' namespace (of several `odom`), else
    /// of the only topic, else a transform's.
    fn poses(&mut self, scan_topic: &str, options: &BagOptions) -> Result<Poses, BagError> {
        let topics: Vec<String> = self.odometry.keys().cloned().collect();
        let of_scans = Some(namespace(scan_topic).unwrap_or_default());
        let in_namespace: Vec<&String> = topics.iter().filter(|topic| namespace(topic) == of_scans).collect();
        let named_odom = in_namespace.iter().copied().find(|topic| topic.ends_with("/odom"));
        let chosen = match (&options.odometry_topic, in_namespace.as_slice(), topics.as_slice()) {
            (Some(wished), ..) => topics.iter().find(|topic| *topic == wished),
            (None, _, _) if options.odom_frame.is_some() => None,
            (None, [topic], _) => Some(*topic),
            (None, [_, ..], _) if named_odom.is_some() => named_odom,
            (None, _, [topic]) => Some(topic),
            _ => None,
        };
        let mut poses = match chosen {
            Some(topic) => self.odometry.remove(topic),
            None if options.odometry_topic.is_some() => None,
            None => self.odometry_transform(options),
        }
        .ok_or_else(|| BagError::NoOdometry { scan_topic: scan_topic.to_owned(), topics: topics.clone() })?;
        poses.poses.sort_by_key(|(stamp, _)| *stamp);
        Ok(poses)
    }

    /// Returns the only transform from the odometry's frame.
    fn odometry_transform(&self, options: &BagOptions) -> Option<Poses> {
        let is_odom = |name: &str| match &options.odom_frame {
            Some(wished) => name == frame(wished),
            None => name == "odom" || name.ends_with("/odom"),
        };
        let mut edges = self.transforms.iter().filter(|((parent, _), _)| is_odom(parent));
        let ((_, child), poses) = edges.next()?;
        edges.next().is_none().then(|| Poses { base_frame: child.clone(), poses: poses.clone() })
    }

    /// Returns the scanner's pose on the base, along the transforms between them.
    fn base_from_scan(&self, scan_frame: &str, base_frame: &str) -> Option<Pose2> {
        let (mut at, mut pose) = (scan_frame.to_owned(), Pose2::new(0.0, 0.0, 0.0));
        for _ in 0..FRAMES_MAX {
            if at == base_frame {
                return Some(pose);
            }
            let ((parent, _), poses) = self.transforms.iter().find(|((_, child), _)| *child == at)?;
            pose = poses.first()?.1 * pose;
            at = parent.clone();
        }
        None
    }
}

/// Returns what stands before the last slash of a topic's name; `None` without a slash.
fn namespace(topic: &str) -> Option<&str> {
    topic.rsplit_once('/').map(|(namespace, _)| namespace)
}

/// Returns a frame's name without the slash that ROS 1 began them with.
fn frame(name: &str) -> String {
    name.strip_prefix('/').unwrap_or(name).to_owned()
}

/// Returns a scan whose numbers are a measurement's.
fn checked(scan: &Scan) -> Option<BagScan> {
    let (first, step) = (f64::from(scan.angle_min_rad), f64::from(scan.angle_increment_rad));
    let range_max_m = f64::from(scan.range_max_m);
    let beams = scan.ranges_m().len();
    let spans_a_turn_at_most = first.is_finite()
        && step != 0.0
        && (step * (beams as f64 - 1.0)).abs() <= std::f64::consts::TAU + step.abs();
    let is_scan = (BEAMS_MIN..=BEAMS_MAX).contains(&beams) && spans_a_turn_at_most && range_max_m > 0.0;
    is_scan.then(|| BagScan {
        stamp: scan.header.stamp,
        odom_from_base: Pose2::new(0.0, 0.0, 0.0),
        world_from_base: None,
        angle_min_rad: first,
        angle_increment_rad: step,
        range_max_m,
        ranges_m: scan.ranges_m().to_vec(),
    })
}
