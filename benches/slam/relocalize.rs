//! A robot that is looked for in a map without a guess: how often it is found, how soon, how long a
//! search takes, and how often the answer is wrong, in its own building and in others.
//!
//! The map is a log's first half. In its second half the robot is put down every so many scans and
//! drives on until it is found, or for [`SCANS`] scans. Where it truly was is what the whole log says.
//! Scans of another log must be refused.

use crate::drive::{Spread, thread_cpu_ns, unpack};
use crate::settings::slam_config;
use formats::carmen::{LaserLine, Reader, Record};
use msg::{Odometry, Pose2, Scan, SlamMode, pose::wrap_angle};
use serde::{Deserialize, Serialize};
use slam::{InitialPose, Session, SessionIdentity, Slam, SlamConfig};
use std::path::PathBuf;

/// Scans after which a robot counts as not found.
const SCANS: usize = 24;
/// An answer this far off is wrong: metres, radians.
const RIGHT_M: f64 = 0.5;
const RIGHT_RAD: f64 = 0.15;
/// A place is in the map if a scan was taken this near to it, metres, ...
const KNOWN_M: f64 = 1.0;
/// ... looking about there, radians: a narrow view of the same place is another one.
const KNOWN_RAD: f64 = 0.8;

/// What to run.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Task {
    /// The log whose first half is the map.
    pub map: PathBuf,
    /// The log whose second half is driven in it.
    pub robot: PathBuf,
    /// Only the central beams.
    pub fov_deg: Option<f64>,
    /// How often it is put down.
    pub places: usize,
}

/// What came of it.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Outcome {
    /// How often it was put down.
    pub places: usize,
    /// Of them, where the map has been seen before.
    pub known: usize,
    /// Found where it was.
    pub right: usize,
    /// Of the known places.
    pub right_of_known: usize,
    /// Said to be found where it was not.
    pub wrong: usize,
    /// Not found.
    pub rejected: usize,
    /// Way until found, metres.
    pub way_m: Vec<f64>,
    /// The searches, processor time.
    pub search_ms: Spread,
    /// Making the pyramid of the map, processor time.
    pub prepare_ms: Spread,
}

/// Does a task.
pub fn drive(task: &Task) -> Result<Outcome, String> {
    let lines = lines(&task.map)?;
    let half = lines.len() / 2;
    let same = task.map == task.robot;
    let (mut slam, config) = begin(&lines)?;
    let feed = |slam: &mut Slam, lines: &[LaserLine]| {
        for line in lines {
            step(slam, line, task.fov_deg);
            slam.work();
        }
    };
    feed(&mut slam, &lines[..half]);
    slam.finish();
    let session = slam.session(SessionIdentity::new(0, 0, &config));
    let map_poses = session.back.poses.clone();
    let robot_lines = if same { Vec::new() } else { self::lines(&task.robot)? };
    let (driven, truth) = if same {
        feed(&mut slam, &lines[half..]);
        slam.finish();
        let truth: Vec<Pose2> = slam.trajectory().map(|(_, pose)| pose).collect();
        // The map may have moved a little since: truth is told as seen from its first half.
        (&lines[half..], truth[half..].to_vec())
    } else {
        (&robot_lines[..], Vec::new())
    };
    let mut outcome = Outcome::default();
    let (mut searches, mut prepared) = (Vec::new(), Vec::new());
    let stride = (driven.len().saturating_sub(SCANS) / task.places).max(1);
    for at in (0..driven.len().saturating_sub(SCANS)).step_by(stride) {
        let known = truth.get(at).is_some_and(|truth| {
            let near = |pose: &Pose2| {
                pose.distance_m(*truth) < KNOWN_M
                    && wrap_angle(pose.yaw_rad - truth.yaw_rad).abs() < KNOWN_RAD
            };
            map_poses.iter().any(near)
        });
        let found =
            put_down(&session, &config, &driven[at..at + SCANS], task, (&mut searches, &mut prepared));
        outcome.places += 1;
        outcome.known += usize::from(known);
        let Some((after, pose, way_m)) = found else {
            outcome.rejected += 1;
            continue;
        };
        let right = truth.get(at + after).is_some_and(|truth| {
            truth.distance_m(pose) < RIGHT_M && wrap_angle(truth.yaw_rad - pose.yaw_rad).abs() < RIGHT_RAD
        });
        outcome.right += usize::from(right);
        outcome.right_of_known += usize::from(right && known);
        outcome.wrong += usize::from(!right);
        outcome.way_m.push(way_m);
    }
    outcome.search_ms = Spread::of(searches.into_iter());
    outcome.prepare_ms = Spread::of(prepared.into_iter());
    Ok(outcome)
}

/// Puts a robot down: after which scan it was found, where, and the way until then, metres.
fn put_down(
    session: &Session,
    config: &SlamConfig,
    lines: &[LaserLine],
    task: &Task,
    (searches, prepared): (&mut Vec<u64>, &mut Vec<u64>),
) -> Option<(usize, Pose2, f64)> {
    let session = Session { front: None, ..session.clone() };
    let begun = thread_cpu_ns();
    let mut slam =
        Slam::create_or_resume(config.clone(), Some(session), SlamMode::Localization, InitialPose::Unknown);
    prepared.push(thread_cpu_ns() - begun);
    let mut way_m = 0.0;
    for (i, line) in lines.iter().enumerate() {
        way_m += i.checked_sub(1).map_or(0.0, |b| lines[b].odom_from_base.distance_m(line.odom_from_base));
        step(&mut slam, line, task.fov_deg);
        let (before, begun) = (slam.back_counts().relocalization.searches, thread_cpu_ns());
        slam.work();
        if slam.back_counts().relocalization.searches > before {
            searches.push(thread_cpu_ns() - begun);
        }
        if slam.back().is_located() {
            return slam.back().map_from_base().map(|pose| (i, pose, way_m));
        }
    }
    None
}

fn lines(path: &std::path::Path) -> Result<Vec<LaserLine>, String> {
    let log = unpack(path)?;
    let lasers = Reader::new(&log).filter_map(|record| match record {
        Ok(Record::Laser(line)) => Some(line),
        _ => None,
    });
    Ok(lasers.collect())
}

fn begin(lines: &[LaserLine]) -> Result<(Slam, SlamConfig), String> {
    let on_robot = lines.first().ok_or("no scan")?.base_from_scan;
    let mut config = slam_config();
    config.lidar.base_from_scan = [on_robot.x_m, on_robot.y_m, on_robot.yaw_rad];
    Ok((Slam::new(config.clone()), config))
}

fn step(slam: &mut Slam, line: &LaserLine, fov_deg: Option<f64>) {
    let mut scan: Box<Scan> = bytemuck::allocation::zeroed_box();
    line.write_to(&mut scan, 0, fov_deg.map(f64::to_radians));
    let header = msg::Header { stamp: line.stamp, ..Default::default() };
    slam.add_odometry(&Odometry { header, odom_from_base: line.odom_from_base, ..Default::default() });
    slam.process(&scan);
}
