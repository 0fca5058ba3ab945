//! The merge process: receives the robots' maps, and publishes the merged map and the map transforms.
//!
//! One thread draws the map. The fleet's pose graph, which estimates the transforms and redraws deformed maps, is on a
//! second thread ([`graph_worker`]).

use super::graph_worker::{self, FleetEstimate, FleetEstimateSlot, GraphWorkerParts, RobotMapEstimate};
use super::heartbeat::{HealthCounters, Heartbeat};
use super::{Error, Listens, ProcessLoop, serve};
use crate::channel;
use crate::merge_maps::{HeldMap, MapFiles, MapSlot, RestoredMaps};
use crate::merge_state_file::MergeStateFile;
use crate::ports::{
    ChannelError, Clock as _, MAP_PAUSE, Ports, ReadMapPort, ReadPort, ReceiveCounts, WriteMapPort, WritePort,
};
use crate::progress::WatchedThread;
use crate::run::Run;
use crate::stop::Stop;
use crate::storage::{DiskStorage, Storage};
use crate::world;
use ::merge::{FleetPoseGraph, Merger};
use msg::{MAP_OLD_AFTER_S, MapTransforms, Monotonic, Pose2, PoseEstimate, ROBOTS_MAX, RobotId, Role};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Runs the process until it is asked to stop.
pub fn run(run: &Run, stop: &Stop) -> Result<(), Error> {
    let done = AtomicBool::new(false);
    let (state, restored) = begin(run, DiskStorage)?;
    let participant = run.attach(Role::Merge, None)?;
    let mut process = MergeProcess::open(&participant, run, &state, &restored)?;
    std::thread::scope(|scope| {
        let graph_thread = scope.spawn(|| graph_worker::run(run, state, &done));
        let progress = run.progress(Role::Merge, None, WatchedThread::Main);
        serve(&mut process, progress, &|| stop.requested() || graph_thread.is_finished());
        done.store(true, Ordering::Relaxed);
        graph_thread.join().map_err(|_| "the thread of the fleet's pose graph panicked")??;
        Ok(())
    })
}

/// Restores the state of an earlier process of this run, and the robots' maps that it held: the transforms hold from the
/// first map on.
pub fn begin<S: Storage>(run: &Run, storage: S) -> Result<(GraphWorkerParts<S>, RestoredMaps), Error> {
    let starts = world::known_starts_of_run(run)?;
    let mut graph = FleetPoseGraph::new(&run.config.merge, &starts);
    let state_file = MergeStateFile::restore(run, storage.clone(), &mut graph);
    let files = MapFiles::new(run, storage);
    let restored = files.restore(run.robots());
    Ok((
        GraphWorkerParts { graph, state_file, files, estimates: Arc::default(), maps: Arc::default() },
        restored,
    ))
}

/// Longest time for which a restarted process sends no map. SLAM sends its whole map within 0.2 s of the request; one that
/// died at the same time is back within about 1 s.
const RESTART_HOLD_MAX: Duration = Duration::from_secs(2);

/// Holds back the merged map of a restarted process until each robot whose map was restored has sent it anew: readers keep
/// the map that they have, which is newer than the restored one.
struct RestartHold {
    /// Robots whose maps have not come yet.
    missing: Vec<RobotId>,
    until: Monotonic,
}

impl RestartHold {
    /// Records a whole map of a robot.
    fn record_map(&mut self, robot: RobotId) {
        self.missing.retain(|missing| *missing != robot);
    }

    fn is_over(&self, now: Monotonic) -> bool {
        self.missing.is_empty() || now >= self.until
    }
}

/// Period at which the ages of the robots' maps are published, if nothing else changes.
const AGES_PERIOD: Duration = Duration::from_millis(500);

/// Channels of the robots' SLAM, and what the other thread hands over.
struct Inputs<P: Ports> {
    maps: Vec<(RobotId, P::MapReader)>,
    pose_estimates: Vec<(RobotId, P::Reader<PoseEstimate>)>,
    /// Time of the newest pose estimate of each robot, by [`RobotId::index`]; zero: none yet.
    pose_estimate_received: [Monotonic; ROBOTS_MAX],
    /// Numbers of the frames `robotK/map`, by [`RobotId::index`].
    map_frames: [u32; ROBOTS_MAX],
    estimates: Arc<FleetEstimateSlot>,
    /// The robots' newest maps, to be kept in files.
    held_maps: Arc<MapSlot>,
}

/// When the ages of the robots' maps are published, and which maps are old.
struct AgesPublisher {
    due: Monotonic,
    sent: Option<[Monotonic; ROBOTS_MAX]>,
    /// Robots whose part of the map is old, by [`RobotId::index`].
    old: [bool; ROBOTS_MAX],
}

impl AgesPublisher {
    /// Returns whether a period has passed.
    fn is_due(&mut self, now: Monotonic) -> bool {
        let is_due = now >= self.due;
        if is_due {
            self.due = now + AGES_PERIOD;
        }
        is_due
    }

    /// Returns whether a robot's part of the map has become old since the last call.
    fn becomes_old(&mut self, robot: RobotId, received: Monotonic, now: Monotonic) -> bool {
        let is_old = received != Monotonic::default() && now.since(received) as f64 * 1e-9 > MAP_OLD_AFTER_S;
        let was_old = std::mem::replace(&mut self.old[robot.index()], is_old);
        is_old && !was_old
    }
}

/// Draws the merged map, and never waits for anything else.
pub struct MergeProcess<P: Ports> {
    merger: Merger,
    inputs: Inputs<P>,
    restart: Option<RestartHold>,
    has_changed: bool,
    ages: AgesPublisher,
    merged: P::MapWriter,
    transforms: P::Writer<MapTransforms>,
    heartbeat: Heartbeat<P>,
    clock: P::Clock,
    listeners: Vec<P::Listener>,
    robot_radius_m: f64,
    refused: u64,
}

impl<P: Ports> MergeProcess<P> {
    /// Opens the channels; the robots' maps have the transforms of `state`, and are `restored` until SLAM sends them.
    pub fn open<S>(
        ports: &P,
        run: &Run,
        state: &GraphWorkerParts<S>,
        restored: &[(RobotId, HeldMap)],
    ) -> Result<Self, ChannelError> {
        let robots = run.robots();
        let starts: Vec<Option<Pose2>> =
            robots.clone().map(|robot| state.graph.map_from_robot_map(robot)).collect();
        let maps = robots.clone().map(|robot| Ok((robot, ports.map_reader(&channel::map(robot))?)));
        let pose_estimates =
            robots.clone().map(|robot| Ok((robot, ports.reader(&channel::pose_estimate(robot))?)));
        let listeners = robots.clone().map(|robot| ports.listener(&channel::map(robot)));
        let listeners = listeners.chain([ports.listener(&channel::merge_edges())]);
        let clock = ports.clock();
        let until = clock.now() + RESTART_HOLD_MAX;
        let missing: Vec<RobotId> = restored.iter().map(|(robot, _)| *robot).collect();
        let mut pose_estimate_received = [Monotonic::default(); ROBOTS_MAX];
        for (robot, held) in restored {
            pose_estimate_received[robot.index()] = held.pose_estimate_received;
        }
        let mut process = Self {
            merger: Merger::new(&run.config.merge, &starts),
            inputs: Inputs {
                maps: maps.collect::<Result<_, ChannelError>>()?,
                pose_estimates: pose_estimates.collect::<Result<_, ChannelError>>()?,
                pose_estimate_received,
                map_frames: [0; ROBOTS_MAX],
                estimates: state.estimates.clone(),
                held_maps: state.maps.clone(),
            },
            restart: (!missing.is_empty()).then_some(RestartHold { missing, until }),
            has_changed: false,
            ages: AgesPublisher { due: Monotonic::default(), sent: None, old: [false; ROBOTS_MAX] },
            merged: ports.map_writer(&channel::merged_map())?,
            transforms: ports.writer(&channel::map_transforms())?,
            heartbeat: Heartbeat::new(ports, run, Role::Merge, None)?,
            clock,
            listeners: listeners.collect::<Result<_, _>>()?,
            robot_radius_m: run.config.slam.map.robot_radius_m,
            refused: 0,
        };
        for (robot, held) in restored {
            process.refused += u64::from(process.merger.update_tiles(*robot, &held.map).is_err());
        }
        process.send_transforms();
        Ok(process)
    }

    /// Receives all waiting messages; returns true if the merged map changes.
    fn receive(&mut self) -> bool {
        let mut changed = false;
        for (robot, reader) in &mut self.inputs.maps {
            if reader.poll() {
                let merger = &mut self.merger;
                let taken = self.heartbeat.measure(|| merger.update_tiles(*robot, reader.map())).is_ok();
                if taken {
                    let pose_estimate_received = self.inputs.pose_estimate_received[robot.index()];
                    self.inputs
                        .held_maps
                        .put(*robot, HeldMap { map: reader.map().clone(), pose_estimate_received });
                }
                self.restart.iter_mut().for_each(|restart| restart.record_map(*robot));
                self.refused += u64::from(!taken);
                changed |= taken;
            }
        }
        for (robot, reader) in &mut self.inputs.pose_estimates {
            let received = reader.receive_counts().received;
            changed |= receive_robot_poses::<P>(&mut self.merger, *robot, reader, self.robot_radius_m);
            if reader.receive_counts().received != received {
                self.inputs.pose_estimate_received[robot.index()] = self.clock.now();
            }
        }
        if let Some(estimate) = self.inputs.estimates.take() {
            let merger = &mut self.merger;
            self.refused += self.heartbeat.measure(|| apply_estimate(merger, &estimate));
            for (frame, robot) in self.inputs.map_frames.iter_mut().zip(&estimate) {
                *frame = robot.map_frame;
            }
            changed = true;
        }
        changed
    }

    /// Sends where the robots' maps lie, and how old they are.
    fn send_transforms(&mut self) {
        let pose_estimate_received = self.inputs.pose_estimate_received;
        let mut transforms = MapTransforms { pose_estimate_received, ..self.merger.map_transforms() };
        for (transform, frame) in transforms.robots.iter_mut().zip(self.inputs.map_frames) {
            transform.map_frame = frame;
        }
        self.transforms.send(&transforms);
        self.ages.sent = Some(pose_estimate_received);
    }

    /// Sends the robots' ages if they are due, and keeps the time from which a robot's part of the map is old.
    fn publish_ages(&mut self, now: Monotonic) {
        if !self.ages.is_due(now) {
            return;
        }
        if self.ages.sent != Some(self.inputs.pose_estimate_received) {
            self.send_transforms();
        }
        for (robot, reader) in &self.inputs.maps {
            let pose_estimate_received = self.inputs.pose_estimate_received[robot.index()];
            if self.ages.becomes_old(*robot, pose_estimate_received, now)
                && reader.map().tiles().next().is_some()
            {
                self.inputs
                    .held_maps
                    .put(*robot, HeldMap { map: reader.map().clone(), pose_estimate_received });
            }
        }
    }

    /// Sends the merged map if it has changed; returns whether readers have all of it.
    fn publish(&mut self) -> bool {
        if std::mem::take(&mut self.has_changed) {
            // The transforms notify nobody. The merged map does, and its readers then find the transforms.
            self.send_transforms();
            let merger = &mut self.merger;
            self.heartbeat.measure(|| merger.update_stale_tiles());
        }
        self.merged.send(self.merger.merged_tiles())
    }

    fn receive_counts(&self) -> ReceiveCounts {
        self.inputs.maps.iter().fold(ReceiveCounts::default(), |mut sum, (_, reader)| {
            sum.received += reader.receive_counts().received;
            sum.lost += reader.receive_counts().lost;
            sum
        })
    }
}

impl<P: Ports> ProcessLoop for MergeProcess<P> {
    fn step(&mut self) -> Monotonic {
        self.has_changed |= self.receive();
        let now = self.clock.now();
        if self.restart.as_ref().is_some_and(|restart| restart.is_over(now)) {
            (self.restart, self.has_changed) = (None, true);
        }
        let due = match self.restart.as_ref().map(|restart| restart.until) {
            Some(until) => until,
            None if self.publish() => self.heartbeat.due(),
            None => now + MAP_PAUSE,
        };
        self.publish_ages(now);
        self.transforms.refresh();
        let counters = HealthCounters {
            receive_counts: self.receive_counts(),
            refused: self.refused,
            ..HealthCounters::default()
        };
        self.heartbeat.publish_if_due(|| counters);
        due.min(self.ages.due).min(self.heartbeat.due())
    }
}

impl<P: Ports> Listens<P::Listener> for MergeProcess<P> {
    fn listeners(&self) -> impl Iterator<Item = &P::Listener> {
        self.listeners.iter().chain([self.merged.requests()])
    }
}

/// Applies the estimate of the fleet's pose graph to every robot; returns how many maps could not be used.
fn apply_estimate(merger: &mut Merger, estimate: &FleetEstimate) -> u64 {
    let robots = RobotId::first(estimate.len()).zip(estimate);
    let refused = |(robot, estimate): (RobotId, &RobotMapEstimate)| -> u64 {
        merger
            .apply_fleet_estimate(robot, estimate.map_from_robot_map, estimate.redrawn.as_ref())
            .is_err()
            .into()
    };
    robots.map(refused).sum()
}

/// Passes the robot's poses to the merger, after its maps. Poses of robots that are not localized are skipped. They wake
/// nobody: a peer's map is what shows a robot where it stands.
fn receive_robot_poses<P: Ports>(
    merger: &mut Merger,
    robot: RobotId,
    reader: &mut P::Reader<PoseEstimate>,
    radius_m: f64,
) -> bool {
    let mut changed = false;
    while let Some(at) = reader.receive() {
        if at.is_located() {
            changed |= merger.add_robot_pose(robot, at.map_from_base, radius_m);
        }
    }
    changed
}
