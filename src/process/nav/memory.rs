//! Goals in the run's folder, with which a restarted navigation process goes on.

use crate::run::Run;
use crate::storage::Storage;
use ::nav::{GoalFrame, GoalPose, NavigationGoal};
use msg::RobotId;
use serde::{Deserialize, Serialize};
use std::io;
use std::path::PathBuf;

/// Name of the file.
const FILE: &str = "navigation.json";
/// Largest file that is read, bytes: 64 poses of 64 robots have 0.4 MB.
const BYTES_MAX: u64 = 1 << 20;

/// Content of the file.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Saved {
    /// Start of the run, which tells it from others in the same folder.
    run: u64,
    goals: Vec<SavedGoal>,
}

/// Goal of one robot that is not over.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SavedGoal {
    pub(super) robot: usize,
    /// Number of the newest command.
    pub(super) newest: u64,
    /// Number of the goal's command.
    pub(super) goal: u64,
    pub(super) is_paused: bool,
    in_merged_map: bool,
    /// The poses that are left: x, y, and the heading if it matters.
    poses: Vec<(f64, f64, Option<f64>)>,
}

impl SavedGoal {
    pub(super) fn new(
        (robot, newest, number): (RobotId, u64, u64),
        goal: &NavigationGoal,
        next_pose: usize,
        is_paused: bool,
    ) -> Self {
        let pose = |pose: &GoalPose| (pose.position_m[0], pose.position_m[1], pose.yaw_rad);
        Self {
            robot: robot.number(),
            newest,
            goal: number,
            is_paused,
            in_merged_map: goal.frame() == GoalFrame::MergedMap,
            poses: goal.poses().iter().skip(next_pose).map(pose).collect(),
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

/// The file, and what it says.
pub(super) struct SavedGoals<S> {
    storage: S,
    file: PathBuf,
    saved: Saved,
    /// Whether the person has been told that the file cannot be written.
    has_warned: bool,
}

impl<S: Storage> SavedGoals<S> {
    pub(super) fn new(run: &Run, storage: S) -> Self {
        let saved = Saved { run: run.begun.0, goals: Vec::new() };
        Self { storage, file: run.dir.join(FILE), saved, has_warned: false }
    }

    /// Reads the goals of an earlier process of this run.
    pub(super) fn read(&mut self) -> Vec<SavedGoal> {
        let bytes = match self.storage.read(&self.file, BYTES_MAX) {
            Err(why) if why.kind() == io::ErrorKind::NotFound => return Vec::new(),
            result => result,
        };
        let read = bytes.and_then(|bytes| Ok(serde_json::from_slice::<Saved>(&bytes)?));
        match read {
            Ok(saved) if saved.run == self.saved.run => {
                self.saved.goals = saved.goals.clone();
                saved.goals
            }
            Ok(_) => Vec::new(),
            Err(why) => {
                tracing::warn!("{}: {why}; no goal is taken from it", self.file.display());
                Vec::new()
            }
        }
    }

    /// Writes the goals if they have changed.
    pub(super) fn write(&mut self, goals: Vec<SavedGoal>) {
        if goals == self.saved.goals {
            return;
        }
        self.saved.goals = goals;
        let written = serde_json::to_vec(&self.saved)
            .map_err(io::Error::from)
            .and_then(|bytes| self.storage.replace(&self.file, &bytes));
        if let Err(why) = written
            && !std::mem::replace(&mut self.has_warned, true)
        {
            tracing::warn!("{}: {why}; a restarted navigation forgets its goals", self.file.display());
        }
    }
}
