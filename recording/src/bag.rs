//! Scans and odometry of one robot in a bag from anywhere: LaserScan with Odometry, or with transforms.
//!
//! Sizes and numbers of a bag are not trusted: what is no measurement is counted and left out. What could be another robot's,
//! another scanner's or another time's is not used.

mod epochs;
mod error;
mod found;
mod frames;
mod namespace;
mod recorded_time;
mod sources;
mod times;

pub use error::BagError;
pub use recorded_time::RecordedTimes;

use crate::pose_at::pose_at;
use crate::{ReadError, RecordingReader};
use epochs::Timed;
use found::{Edges, Found, Poses, RawScan};
use frames::{mirrored, mount, odometry_transform};
use msg::{Pose2, Scan, Stamp};
use namespace::{namespace, of_same_robot};
use ros_messages::{LaserScan, Message as _};
use serde::Serialize;
use sources::{changes_of_poses, changes_of_scans};
use std::io::Read;
use times::{in_order, with_scans};

/// Name of a robot's topic with its true poses in the frame `world`.
pub const GROUND_TRUTH: &str = "ground_truth";

/// Which topics and frames of a bag are used; what is not named is found.
#[derive(Clone, Debug, Default)]
pub struct BagOptions {
    /// Topic of the scans.
    pub scan_topic: Option<String>,
    /// Topic of the odometry, of type nav_msgs/Odometry.
    pub odometry_topic: Option<String>,
    /// Frame of the odometry in transforms, such as `odom`.
    pub odom_frame: Option<String>,
    /// Pose of the scanner on the robot's base, whatever transforms say.
    pub base_from_scan: Option<Pose2>,
    /// Pose of the scanner on the robot's base, if no transform says it.
    pub recorded_base_from_scan: Option<Pose2>,
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
    /// Time between neighbouring beams, seconds.
    pub time_increment_s: f32,
    /// Time between two scans, seconds.
    pub scan_time_s: f32,
    /// Range below which a reading is no measurement, metres.
    pub range_min_m: f32,
    /// Range from which a reading means no return, metres.
    pub range_max_m: f32,
    /// Range of each beam, metres.
    pub ranges_m: Vec<f32>,
}

/// What a bag has of a robot.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Bag {
    /// Scans in order of time.
    pub scans: Vec<BagScan>,
    /// Odometry in order of time: each message, and the pose at each scan; empty without odometry.
    pub odometry: Vec<(Stamp, Pose2)>,
    /// Pose of the scanner on the robot's base.
    pub base_from_scan: Pose2,
    /// What is left out, and what was not as expected.
    pub left_out: LeftOut,
    /// What of the files is damaged and left out, if anything is.
    pub damage: Option<String>,
    /// What is wrong with the first malformed message, with its topic.
    pub first_fault: Option<String>,
}

/// Numbers of messages of a bag that are left out, and of times when its clock was set back.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct LeftOut {
    /// Messages that could not be decoded, or are no measurement. Not in JSON: they are counted with a log's malformed lines.
    #[serde(skip)]
    pub malformed: u64,
    /// Scans with more beams than [`msg::BEAMS_MAX`].
    pub too_many_beams: u64,
    /// Scans without odometry near them.
    pub without_odometry: u64,
    /// Scans in other frames than most.
    pub other_frames: u64,
    /// Scans with single wrong stamps.
    pub stray_stamps: u64,
    /// Messages and transforms that are more than is kept of a bag.
    pub over_limit: u64,
    /// Times when the stamps went back by more than a second. The stamps after each go on after those before it.
    pub clock_steps: u64,
}

/// Reader of the files of one bag.
pub struct BagReader {
    options: BagOptions,
    found: Found,
    damage: Option<String>,
}

impl BagReader {
    /// Begins without files.
    pub fn new(options: BagOptions) -> Self {
        Self { found: Found::new(options.odom_frame.clone()), options, damage: None }
    }

    /// Reads a file of the bag. `name` is the file's, for what is said of its damage. Files that a recorder wrote one after another
    /// share their `times`, in which they go on where its clock was set back between them; others have times of their own, and any
    /// order. Returns when its first and its last scan were recorded; `None` without a scan.
    ///
    /// # Errors
    /// The file cannot be read, or is no MCAP.
    pub fn add<R: Read>(
        &mut self,
        name: &str,
        reader: &mut RecordingReader<R>,
        times: &mut RecordedTimes,
        scan: &mut Scan,
    ) -> Result<Option<(Stamp, Stamp)>, ReadError> {
        let mut ends: Option<(Stamp, Stamp)> = None;
        while let Some(mut message) = reader.next_message()? {
            message.at = times.next(&message.topic, message.at);
            // Not of other messages: each part of a bag may repeat fixed transforms.
            if &*message.message_type == LaserScan::TYPE {
                let (first, last) = ends.unwrap_or((message.at, message.at));
                ends = Some((first.min(message.at), last.max(message.at)));
            }
            self.found.add(&message, scan);
        }
        let damage = reader.damage().map(|why| format!("{name}: {why}"));
        let damages: Vec<String> = self.damage.take().into_iter().chain(damage).collect();
        self.damage = (!damages.is_empty()).then(|| damages.join("; "));
        Ok(ends)
    }

    /// Returns the scans and the odometry of one robot.
    ///
    /// # Errors
    /// The bag has not what is needed: each error says what there is instead.
    pub fn finish(self) -> Result<Bag, BagError> {
        let (count, first_fault) = (self.found.malformed, self.found.first_fault.clone());
        let (damage, over_limit) = (self.damage, self.found.over_limit);
        let mut error = match self.found.bag(&self.options) {
            Ok(bag) => return Ok(Bag { damage, first_fault, ..bag }),
            Err(error) => error,
        };
        if let Some(first_fault) = first_fault {
            error = BagError::Malformed { error: Box::new(error), count, first_fault };
        }
        if over_limit > 0 {
            error = BagError::OverLimit { error: Box::new(error), count: over_limit };
        }
        Err(match damage {
            Some(why) => BagError::Damaged { error: Box::new(error), why },
            None => error,
        })
    }
}

/// Reads the scans and the odometry of one robot in a bag of one file.
///
/// # Errors
/// The file is no MCAP, or has not what is needed: each error says what there is instead.
pub fn read_bag<R: Read>(
    reader: &mut RecordingReader<R>,
    options: &BagOptions,
    scan: &mut Scan,
) -> Result<Bag, BagError> {
    let mut bag = BagReader::new(options.clone());
    bag.add("the file", reader, &mut RecordedTimes::default(), scan)?;
    bag.finish()
}

/// Returns a frame's name without the slash that ROS 1 began them with.
fn frame(name: &str) -> String {
    name.strip_prefix('/').unwrap_or(name).to_owned()
}

impl Found {
    fn bag(mut self, options: &BagOptions) -> Result<Bag, BagError> {
        let scan_topic = self.scan_topic(options)?;
        let (malformed, too_many_beams, over_limit) = (self.malformed, self.too_many_beams, self.over_limit);
        let mut left_out = LeftOut { malformed, too_many_beams, over_limit, ..LeftOut::default() };
        let transforms = self.robot_transforms(&scan_topic);
        let scans = self.scans.get_mut(&scan_topic).map(std::mem::take).unwrap_or_default();
        let (scan_frame, scans) = self.of_one_frame(scans, &mut left_out);
        let truth = self.truth(&scan_topic, options)?;
        let odometry = if options.without_odometry {
            None
        } else {
            Some(self.poses(&scan_topic, &scan_frame, &transforms, options)?)
        };
        let base_frame = odometry.as_ref().map(|poses| frame(&poses.base_frame));
        let mount = mount(&transforms, (&scan_topic, &scan_frame), base_frame.as_deref(), options)?;
        let odometry = odometry.map(|poses| poses.poses).unwrap_or_default();
        let (scans, odometry, truth) = in_order(&scan_topic, scans, odometry, truth, &mut left_out)?;
        if let Some(changes) = changes_of_scans(scans.iter().map(|scan| &scan.value.1)) {
            return Err(BagError::SeveralScanners { scan_topic, scan_frame, changes });
        }
        if let Some(changes) = changes_of_poses(&odometry) {
            return Err(BagError::SeveralRobots { base_frame: base_frame.unwrap_or_default(), changes });
        }
        let mut bag = Bag { base_from_scan: mount.base_from_scan, ..Bag::default() };
        for Timed { stamp, value: (_, scan), .. } in scans {
            let pose =
                if options.without_odometry { Some(Pose2::IDENTITY) } else { pose_at(&odometry, stamp) };
            let Some(odom_from_base) = pose else {
                left_out.without_odometry += 1;
                continue;
            };
            let scan = BagScan { stamp, odom_from_base, world_from_base: pose_at(&truth, stamp), ..scan };
            bag.scans.push(if mount.is_upside_down { mirrored(scan) } else { scan });
        }
        bag.odometry = with_scans(odometry, &bag.scans);
        bag.left_out = left_out;
        Ok(bag)
    }

    fn scan_topic(&self, options: &BagOptions) -> Result<String, BagError> {
        let no_scan = || match self.compressed {
            0 => BagError::NoScan {
                wished: options.scan_topic.clone(),
                too_many_beams: self.too_many_beams,
                topics: self.topics.iter().cloned().collect(),
            },
            _ => BagError::CompressedMessages,
        };
        match &options.scan_topic {
            Some(topic) if self.scans.contains_key(topic) => Ok(topic.clone()),
            Some(_) => Err(no_scan()),
            None if self.scans.len() > 1 => Err(BagError::SeveralScans(self.scans.keys().cloned().collect())),
            None => self.scans.keys().next().cloned().ok_or_else(no_scan),
        }
    }

    /// Returns the scans of the frame that most of them have, the first of several, and its name.
    fn of_one_frame(&self, mut scans: Vec<RawScan>, left_out: &mut LeftOut) -> (String, Vec<RawScan>) {
        let mut counts = vec![0_u64; self.scan_frames.len()];
        scans.iter().for_each(|scan| counts[scan.value.0] += 1);
        let most = (0..counts.len()).rev().max_by_key(|number| counts[*number]).unwrap_or(0);
        let all = scans.len();
        scans.retain(|scan| scan.value.0 == most);
        left_out.other_frames = (all - scans.len()) as u64;
        (self.scan_frames.get(most).cloned().unwrap_or_default(), scans)
    }

    /// Takes the transforms of the robot of a scan topic: of the nearest topic with fixed ones, and of the nearest with others.
    fn robot_transforms(&mut self, scan_topic: &str) -> Edges {
        let mut transforms = Edges::new();
        let scan_topics: Vec<&str> = self.scans.keys().map(String::as_str).collect();
        for fixed in [true, false] {
            let is_wanted = |topic: &&str| topic.ends_with("tf_static") == fixed;
            let topics: Vec<&str> = self.transforms.keys().map(String::as_str).filter(is_wanted).collect();
            let own: Vec<String> =
                of_same_robot(scan_topic, &scan_topics, &topics).into_iter().map(str::to_owned).collect();
            for edges in own.iter().filter_map(|topic| self.transforms.remove(topic)) {
                edges.into_iter().for_each(|(key, edge)| {
                    transforms.entry(key).or_insert(edge);
                });
            }
        }
        transforms
    }

    /// Takes the true poses: of the named topic, else of `ground_truth` in the scans' namespace, if there is one. They are no
    /// odometry.
    fn truth(&mut self, scan_topic: &str, options: &BagOptions) -> Result<Vec<Timed<Pose2>>, BagError> {
        let in_namespace = || format!("{}/{GROUND_TRUTH}", namespace(scan_topic));
        let topic = options.truth_topic.clone().unwrap_or_else(in_namespace);
        let is_odometry = options.odometry_topic.as_ref() == Some(&topic);
        let found = if is_odometry { None } else { self.odometry.remove(&topic) };
        match (found, &options.truth_topic) {
            (Some(Poses { poses, .. }), _) => Ok(poses),
            (None, None) => Ok(Vec::new()),
            (None, Some(wished)) => Err(BagError::NoTruth {
                wished: wished.clone(),
                topics: self.odometry.keys().cloned().collect(),
            }),
        }
    }

    /// Returns the odometry: of the named topic, else of the topic that is nearest to the scans (of several `odom`), else a
    /// transform's.
    fn poses(
        &mut self,
        scan_topic: &str,
        scan_frame: &str,
        transforms: &Edges,
        options: &BagOptions,
    ) -> Result<Poses, BagError> {
        let topics: Vec<&str> = self.odometry.keys().map(String::as_str).collect();
        let scan_topics: Vec<&str> = self.scans.keys().map(String::as_str).collect();
        let nearest = of_same_robot(scan_topic, &scan_topics, &topics);
        let named_odom = nearest.iter().copied().find(|topic| topic.ends_with("/odom"));
        let chosen = match (&options.odometry_topic, nearest.as_slice()) {
            (Some(wished), _) => Some(wished.as_str()),
            (None, _) if options.odom_frame.is_some() => None,
            (None, [topic]) => Some(*topic),
            (None, _) => named_odom,
        }
        .map(str::to_owned);
        let poses = match &chosen {
            Some(topic) => self.odometry.remove(topic),
            None => odometry_transform(transforms, scan_frame, options),
        };
        poses.ok_or_else(|| BagError::NoOdometry {
            scan_topic: scan_topic.to_owned(),
            topics: self.odometry.keys().cloned().collect(),
            transforms: frames::changing(transforms),
        })
    }
}
