//! A thread that records when each robot's poses came and how fast it really moved.

use crate::fleet::PATIENCE;
use mr_slam::channel::{self, Opener, Program};
use mr_slam::clock::now;
use mr_slam::run::Run;
use mr_slam::shared_memory::Participant;
use msg::{Monotonic, RobotId};
use std::error::Error;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Time between two looks: the shortest queue, of the true poses, holds 40 ms.
const LOOK: Duration = Duration::from_millis(5);
/// Period of scans, nanoseconds.
const SCAN_PERIOD_NS: f64 = 1e8;
/// Time before a gap in which a hit on the robot explains it, nanoseconds: SLAM reads its session and catches up.
const HIT_EXPLAINS_NS: u64 = 3_000_000_000;
/// Speeds below which a robot is at rest, m/s and rad/s: those of lockstep's invariants. The motors' torque falls with the error of the
/// speed, so that the last millimetres per second take 0.25 s more.
const REST_SPEED: [f64; 2] = [0.01, 0.05];

/// What was seen of one robot.
#[derive(Clone, Debug, Default)]
struct RobotRecord {
    /// When a pose came, and the stamp of its scan in nanoseconds. SLAM publishes one for each scan.
    poses: Vec<(Monotonic, i64)>,
    /// When the true velocity came, and whether the robot moved.
    moving: Vec<(Monotonic, bool)>,
}

#[derive(Default)]
struct Shared {
    robots: Mutex<Vec<RobotRecord>>,
    is_over: AtomicBool,
}

/// The thread, until it is dropped.
pub struct Watch {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

impl Watch {
    /// Begins to watch all robots of a fleet; returns when each has sent a pose.
    pub fn start(run: &Run) -> Result<Self, Box<dyn Error>> {
        let shared = Arc::new(Shared::default());
        let (to, run) = (shared.clone(), run.clone());
        let thread = std::thread::spawn(move || {
            if let Err(why) = record(&run, &to) {
                eprintln!("watch: {why}");
            }
        });
        let watch = Self { shared, thread: Some(thread) };
        let begun = Instant::now();
        let is_complete =
            |robots: &[RobotRecord]| !robots.is_empty() && robots.iter().all(|robot| !robot.poses.is_empty());
        while !watch.with(is_complete) {
            if begun.elapsed() > PATIENCE {
                return Err("not every robot sent a pose".into());
            }
            std::thread::sleep(LOOK);
        }
        Ok(watch)
    }

    fn with<T>(&self, look: impl FnOnce(&[RobotRecord]) -> T) -> T {
        look(&self.shared.robots.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Counts scans of all robots without a pose since `from`. Those of a robot that was hit are not counted.
    pub fn missed(&self, from: Monotonic, hits: &[(RobotId, Monotonic)]) -> u64 {
        self.with(|robots| {
            let of_robot = |(index, robot): (usize, &RobotRecord)| {
                let explained = |before: Monotonic, after: Monotonic| {
                    let mut own = hits.iter().filter(|(hit, _)| hit.index() == index);
                    own.any(|(_, at)| at.0 <= after.0 && at.0 + HIT_EXPLAINS_NS >= before.0)
                };
                let pairs = robot.poses.windows(2).filter(|pair| pair[0].0 >= from);
                let gaps = pairs.filter(|pair| !explained(pair[0].0, pair[1].0));
                let missing = |pair: &[(Monotonic, i64)]| {
                    ((pair[1].1 - pair[0].1) as f64 / SCAN_PERIOD_NS - 1.0).round().max(0.0) as u64
                };
                gaps.map(missing).sum::<u64>()
            };
            robots.iter().enumerate().map(of_robot).sum()
        })
    }

    /// Counts the poses of all robots since `from`.
    pub fn poses(&self, from: Monotonic) -> usize {
        self.with(|robots| robots.iter().flat_map(|robot| &robot.poses).filter(|(at, _)| *at >= from).count())
    }

    /// Returns whether a robot moves.
    pub fn moves(&self, robot: RobotId) -> bool {
        self.with(|robots| robots.get(robot.index()).and_then(|of| of.moving.last()).is_some_and(|(_, m)| *m))
    }

    /// Returns since when a robot has been at rest; `None`: it moves.
    pub fn at_rest_since(&self, robot: RobotId) -> Option<Monotonic> {
        self.with(|robots| {
            let moving = &robots.get(robot.index())?.moving;
            let last = moving.iter().rposition(|(_, moves)| *moves)?;
            moving.get(last + 1).map(|(at, _)| *at)
        })
    }
}

impl Drop for Watch {
    fn drop(&mut self) {
        self.shared.is_over.store(true, Ordering::Relaxed);
        // A thread that panicked has said so.
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

fn record(run: &Run, to: &Shared) -> Result<(), Box<dyn Error>> {
    let node = Participant::open(&run.domain, Opener::of_fleet(Program::Launcher), "bench-watch")?;
    let mut readers = Vec::new();
    for robot in run.robots() {
        readers.push((node.reader(&channel::pose_estimate(robot))?, node.reader(&channel::truth(robot))?));
    }
    while !to.is_over.load(Ordering::Relaxed) {
        {
            let mut robots = to.robots.lock().unwrap_or_else(PoisonError::into_inner);
            robots.resize_with(readers.len(), RobotRecord::default);
            for ((pose_estimates, truths), robot) in readers.iter_mut().zip(robots.iter_mut()) {
                while let Some(pose_estimate) = pose_estimates.receive() {
                    robot.poses.push((now(), pose_estimate.header.stamp.0));
                }
                while let Some(truth) = truths.receive() {
                    let moves =
                        truth.linear_m_s.abs() > REST_SPEED[0] || truth.angular_rad_s.abs() > REST_SPEED[1];
                    // Only changes count: minutes at 100 Hz would be many.
                    if robot.moving.last().is_none_or(|(_, before)| *before != moves) {
                        robot.moving.push((now(), moves));
                    }
                }
            }
        }
        std::thread::sleep(LOOK);
    }
    Ok(())
}
