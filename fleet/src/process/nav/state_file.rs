//! Goals, exploration and zones, with which a restarted navigation process of the same run goes on.
//!
//! The file is in the run's runtime folder, as a rule in memory: a full, slow or read-only disk loses no goal that was cancelled, and no zone.

use crate::job_thread::{JobRunner, JobWorker};
use crate::run::Run;
use crate::storage::Storage;
use ::nav::{GoalFrame, GoalPose, NavigationGoal};
use msg::{Monotonic, PauseReason, RobotId};
use serde::{Deserialize, Serialize};
use std::io;
use std::path::PathBuf;
use std::time::Duration;
use tokio::sync::oneshot::{self, error::TryRecvError};

/// Name of the file.
const FILE: &str = "navigation.json";
/// Time after which a state that could not be written is written again.
const RETRY_PERIOD: Duration = Duration::from_secs(1);
/// Largest file that is read, bytes: 64 poses of 64 robots have 0.4 MB.
const BYTES_MAX: u64 = 1 << 20;

/// Content of the file.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Saved {
    /// Start of the run, which tells it from others in the same folder.
    run: u64,
    state: SavedState,
}

/// What a restarted navigation process goes on with.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SavedState {
    /// Number of each robot's newest command, by robot: older ones are not applied again.
    pub(super) commands: Vec<(usize, u64)>,
    pub(super) goals: Vec<SavedGoal>,
    pub(super) exploration: SavedExploration,
    pub(super) zones: SavedZones,
    /// Each robot on another machine, and what its machine had said of stops and drives by hand.
    pub(super) holds: Vec<(usize, u64)>,
}

/// Exclusion zones of the fleet.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SavedZones {
    /// Number of each of the newest commands and the code of its refusal, oldest first.
    pub(super) answers: Vec<(u64, u32)>,
    /// Number of the zone that was added last.
    pub(super) last_number: u32,
    /// Each zone's number, the furniture that it stands for, and its corners in the merged map, metres.
    pub(super) zones: Vec<(u32, String, Vec<[f64; 2]>)>,
}

/// Exploration of the fleet.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SavedExploration {
    /// Number of the newest command.
    pub(super) number: u64,
    pub(super) is_active: bool,
    /// Stamp at which it began, nanoseconds.
    pub(super) begun_ns: Option<i64>,
    /// The state that went out last, as its channel has it; empty while an exploration goes on.
    pub(super) report: Vec<u8>,
    /// Each robot, whether a person has it, and where it began, in its own map.
    pub(super) robots: Vec<(usize, bool, Option<[f64; 3]>)>,
}

/// Goal of one robot that is not over.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SavedGoal {
    pub(super) robot: usize,
    /// Number of the goal's command.
    pub(super) goal: u64,
    /// Code of the reason of its pause; `None`: it is driven to.
    pub(super) paused: Option<u32>,
    in_merged_map: bool,
    /// Index of the pose that is driven to.
    pub(super) next_pose: usize,
    /// Its poses: x, y, and the heading if it matters.
    poses: Vec<(f64, f64, Option<f64>)>,
}

impl SavedGoal {
    pub(super) fn new(
        (robot, number): (RobotId, u64),
        goal: &NavigationGoal,
        next_pose: usize,
        paused: Option<PauseReason>,
    ) -> Self {
        let pose = |pose: &GoalPose| (pose.position_m[0], pose.position_m[1], pose.yaw_rad);
        Self {
            robot: robot.number(),
            goal: number,
            paused: paused.map(|reason| reason as u32),
            in_merged_map: goal.frame() == GoalFrame::MergedMap,
            next_pose,
            poses: goal.poses().iter().map(pose).collect(),
        }
    }

    pub(super) fn frame(&self) -> GoalFrame {
        if self.in_merged_map { GoalFrame::MergedMap } else { GoalFrame::RobotMap }
    }

    pub(super) fn poses(&self) -> Vec<GoalPose> {
        let pose =
            |(x, y, yaw_rad): &(f64, f64, Option<f64>)| GoalPose { position_m: [*x, *y], yaw_rad: *yaw_rad };
        self.poses.iter().map(pose).collect()
    }
}

/// What is found at the start of a navigation process.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Found {
    /// It is the first of its run.
    Nothing,
    /// The state of an earlier one.
    State(Box<SavedState>),
    /// There was an earlier one, whose state could not be written or is damaged: its commands must not be carried out again.
    Lost,
}

/// The file of a run.
pub struct NavigationFile<S> {
    storage: S,
    path: PathBuf,
    run_begun: u64,
    /// Whether the person has been told that the file cannot be written.
    has_warned: bool,
}

impl<S: Storage> NavigationFile<S> {
    pub(super) fn new(run: &Run, storage: S) -> Self {
        Self { storage, path: run.domain.root().join(FILE), run_begun: run.begun.0, has_warned: false }
    }

    /// Reads what an earlier process of this run has left.
    pub(super) fn read(&self) -> Found {
        let bytes = match self.storage.read(&self.path, BYTES_MAX) {
            Err(why) if why.kind() == io::ErrorKind::NotFound => return Found::Nothing,
            result => result,
        };
        let is_emptied = bytes.as_ref().is_ok_and(Vec::is_empty);
        match bytes.and_then(|bytes| Ok(serde_json::from_slice::<Saved>(&bytes)?)) {
            Ok(saved) if saved.run == self.run_begun => Found::State(Box::new(saved.state)),
            Ok(_) => Found::Nothing,
            Err(why) => {
                // The file stays until the next state takes its place: without one, the process after this would begin as the first.
                let why = if is_emptied { "the state could not be written".into() } else { why.to_string() };
                tracing::warn!(
                    "{}: navigation begins without goals, exploration and zones, and the robots stand: {why}",
                    self.path.display()
                );
                Found::Lost
            }
        }
    }
}

impl<S: Storage> JobRunner for NavigationFile<S> {
    type Job = SavedState;
    /// Whether the state was written.
    type Report = bool;

    /// Writes the state.
    fn run(&mut self, state: &SavedState) -> bool {
        let saved = Saved { run: self.run_begun, state: state.clone() };
        let written = serde_json::to_vec(&saved)
            .map_err(io::Error::from)
            .and_then(|bytes| self.storage.replace(&self.path, &bytes));
        let Err(why) = written else {
            self.has_warned = false;
            return true;
        };
        // What the file has is out of date: a restarted process would drive to goals that were cancelled, and through zones.
        let emptied = self.storage.append(&self.path, 0, b"");
        if !std::mem::replace(&mut self.has_warned, true) {
            let path = self.path.display();
            match emptied {
                Ok(()) => tracing::warn!(
                    "{path}: {why}; until it can be written, a restarted navigation begins without goals, exploration and zones"
                ),
                Err(_) => tracing::warn!(
                    "{path}: {why}; until it can be written, a restarted navigation goes on with the goals of the last state that was written, which may be cancelled since"
                ),
            }
        }
        false
    }
}

/// Writes the state whenever it has changed; never waits for the disk.
pub(super) struct StateWriter<W> {
    worker: W,
    /// The state that the file has or gets; `None`: it has not what it should.
    submitted: Option<SavedState>,
    /// The job that is under way; a newer state waits for its end.
    job: Option<oneshot::Receiver<bool>>,
    /// Time before which a job that failed is not repeated.
    retry_at: Monotonic,
}

impl<W: JobWorker<SavedState, bool>> StateWriter<W> {
    /// A writer of the file that has the state `saved`, or none yet.
    pub(super) fn new(worker: W, saved: Option<SavedState>) -> Self {
        Self { worker, submitted: saved, job: None, retry_at: Monotonic(0) }
    }

    /// Has the state written if it has changed, or could not be written before, and the file is free. Call it often.
    pub(super) fn write(&mut self, state: SavedState, now: Monotonic) {
        match self.job.as_mut().map(oneshot::Receiver::try_recv) {
            Some(Err(TryRecvError::Empty)) => return,
            None | Some(Ok(true)) => {}
            // Refused, or the disk is full.
            Some(Ok(false) | Err(TryRecvError::Closed)) => {
                (self.submitted, self.retry_at) = (None, now + RETRY_PERIOD);
            }
        }
        self.job = None;
        if now >= self.retry_at && self.submitted.as_ref() != Some(&state) {
            self.submitted = Some(state.clone());
            self.job = Some(self.worker.submit(state));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::storage::DiskStorage;

    #[test]
    fn a_state_that_cannot_be_read_is_lost_until_the_next_one_is_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(FILE);
        let mut file = NavigationFile { storage: DiskStorage, path, run_begun: 7, has_warned: false };
        assert_eq!(file.read(), Found::Nothing);
        for damaged in ["", "{", "[]", r#"{"run": 7}"#] {
            std::fs::write(&file.path, damaged).unwrap();
            assert_eq!(file.read(), Found::Lost);
            assert_eq!(file.read(), Found::Lost, "the first process was killed before it wrote a state");
            assert!(file.run(&SavedState::default()));
            assert_eq!(file.read(), Found::State(Box::default()));
        }
    }

    /// A disk that takes one job and does not answer.
    #[derive(Default)]
    struct StalledDisk {
        jobs: Vec<(SavedState, oneshot::Sender<bool>)>,
    }

    impl JobWorker<SavedState, bool> for StalledDisk {
        fn submit(&mut self, job: SavedState) -> oneshot::Receiver<bool> {
            let (sender, receiver) = oneshot::channel();
            self.jobs.push((job, sender));
            receiver
        }
    }

    #[test]
    fn the_newest_state_is_written_when_a_slow_disk_answers() {
        let state = |number| SavedState { commands: vec![(1, number)], ..SavedState::default() };
        let mut writer = StateWriter::new(StalledDisk::default(), Some(SavedState::default()));
        (1..=3).for_each(|number| writer.write(state(number), Monotonic(0)));
        assert_eq!(writer.worker.jobs.len(), 1, "one job is under way");
        let (first, answer) = writer.worker.jobs.remove(0);
        answer.send(true).unwrap();
        writer.write(state(3), Monotonic(0));
        assert_eq!((first, &writer.worker.jobs[0].0), (state(1), &state(3)));
    }

    #[test]
    fn a_state_that_a_full_disk_refused_is_written_again() {
        let cancelled = SavedState { commands: vec![(1, 7)], ..SavedState::default() };
        let mut writer = StateWriter::new(StalledDisk::default(), Some(SavedState::default()));
        writer.write(cancelled.clone(), Monotonic(0));
        writer.worker.jobs.remove(0).1.send(false).unwrap();
        writer.write(cancelled.clone(), Monotonic(1));
        assert!(writer.worker.jobs.is_empty(), "not at once");
        writer.write(cancelled.clone(), Monotonic(0) + 2 * RETRY_PERIOD);
        assert_eq!(writer.worker.jobs.remove(0).0, cancelled);
    }
}
