//! Files in the run's folder that a restarted bridge continues with: selection, drivers, permissions, emergency stop.
//!
//! They outlive the process; a power cut ends the run too, so nothing waits until the disk has them. A busy disk delays even
//! that: live, they are read and written on a thread of their own, see [`crate::job_thread`].

use crate::emergency_stop_file::LatchedStop;
use crate::run::Run;
use crate::storage::{Storage, keep_unusable};
use ::bridge::Bridge;
use msg::{Monotonic, RobotId};
use serde::{Deserialize, Serialize};
use std::io;
use std::net::IpAddr;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// The name of the file that exists while the emergency stop is set.
const STOP_FILE: &str = "stopped";
/// The name of the file of denied addresses, one a line.
const DENIED_FILE: &str = "denied";
/// The name of the file of everything else.
const STATE_FILE: &str = "bridge.json";
/// Content of [`STOP_FILE`] when the bridge writes it. `mr-slam stop` writes another, by which the bridge sees that the stop
/// was set anew.
const STOPPED_BY_BRIDGE: &[u8] = b"The emergency stop is set.\n";
/// Largest part of a file that is read, bytes.
const BYTES_MAX: u64 = 64 << 10;
/// After a restart a robot is kept for its driver for the lease and this time: Unity's connector returns within it.
const RECONNECTED_WITHIN: Duration = Duration::from_secs(3);

/// What the files are to say: the bridge's state at one moment.
#[derive(Clone, Debug, PartialEq)]
pub struct BridgeSnapshot {
    /// Whether the emergency stop is set.
    pub is_stopped: bool,
    /// Number of stops found in the file that the bridge has set; see [`SavedFiles::stops_found`].
    pub stops_applied: u64,
    state: SavedState,
}

impl BridgeSnapshot {
    /// Takes the state of a bridge of the run that began at `run_begun`.
    pub fn take(bridge: &Bridge, run_begun: Monotonic, stops_applied: u64, now: Monotonic) -> Self {
        let driver =
            |(robot, address): (RobotId, Option<IpAddr>)| SavedDriver { robot: robot.number(), address };
        let (goals, explores) = bridge.navigation_senders();
        let sender = |(robot, address): (RobotId, IpAddr)| (robot.number(), address);
        let state = SavedState {
            run: run_begun.0,
            goals: goals.into_iter().map(sender).collect(),
            explores,
            selected: bridge.selected_robot().number(),
            drivers: bridge.drivers(now).into_iter().map(driver).collect(),
            allowed: bridge.allowed_addresses(),
        };
        Self { is_stopped: bridge.is_stopped(), stops_applied, state }
    }
}

/// Content of [`STATE_FILE`], as JSON.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct SavedState {
    /// Start of the run, which tells it from others in the same folder.
    run: u64,
    /// Number of the robot that `/cmd_vel` drives.
    selected: usize,
    /// Who drives which robot.
    drivers: Vec<SavedDriver>,
    /// Addresses on the allow list.
    allowed: Vec<IpAddr>,
    /// Who gave which robot its newest goal.
    goals: Vec<(usize, IpAddr)>,
    /// Who started the exploration that may go on.
    explores: Option<IpAddr>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct SavedDriver {
    robot: usize,
    /// `None` for ROS 2.
    address: Option<IpAddr>,
}

/// Returns the path of the file that exists while the emergency stop of the run in this folder is set.
pub fn stop_file(run_dir: &Path) -> PathBuf {
    run_dir.join(STOP_FILE)
}

/// Returns the path of the file of the addresses that may not drive a run's robots.
pub fn denied_file(run: &Run) -> PathBuf {
    run.dir.join(DENIED_FILE)
}

/// Keeps the files as the bridge is.
pub struct SavedFiles<S> {
    storage: S,
    state_file: PathBuf,
    saved: SavedState,
    stop_file: PathBuf,
    /// Content of the stop file when it was read or written last, or what tells a file that cannot be read from the next one.
    latch: Option<Vec<u8>>,
    /// Number of stops that were found in the file, set by `mr-slam stop`.
    stops_found: u64,
    /// Whether the person has been told that a file cannot be written.
    has_warned: bool,
}

impl<S: Storage> SavedFiles<S> {
    /// Applies to the bridge what an earlier bridge of this run saved.
    pub fn restore(bridge: &Bridge, run: &Run, storage: S, now: Monotonic) -> Self {
        let mut files = Self {
            storage,
            state_file: run.dir.join(STATE_FILE),
            saved: SavedState { run: run.begun.0, ..SavedState::default() },
            stop_file: stop_file(&run.dir),
            latch: None,
            stops_found: 0,
            has_warned: false,
        };
        match files.read_state() {
            Ok(Some(state)) if state.run == run.begun.0 => {
                for why in state.allowed.iter().filter_map(|address| bridge.allow(*address).err()) {
                    tracing::warn!("{}: {why}", files.state_file.display());
                }
                RobotId::new(state.selected).into_iter().for_each(|robot| bridge.restore_selection(robot));
                let until = now + run.config.bridge.lease() + RECONNECTED_WITHIN;
                for driver in &state.drivers {
                    if let Some(robot) = RobotId::new(driver.robot) {
                        bridge.restore_driver(robot, driver.address, until);
                    }
                }
                let sender = |(robot, address): &(usize, IpAddr)| Some((RobotId::new(*robot)?, *address));
                let goals: Vec<_> = state.goals.iter().filter_map(sender).collect();
                bridge.restore_navigation_senders(&goals, state.explores);
                files.saved = state;
            }
            Ok(_) => {}
            Err(why) => {
                let path = files.state_file.display();
                let kept = keep_unusable(&files.storage, &files.state_file);
                tracing::warn!("{path}: {why}; the selected robot and the drivers are not restored; {kept}");
            }
        }
        match files.read_latch() {
            Ok(None) => {}
            // A file that cannot be read may say that the stop is set.
            latch => {
                let content = latch.ok().flatten();
                // `mr-slam stop` has written it, while no bridge answered: a person stops the robots now.
                if content.as_ref().is_some_and(|content| content != STOPPED_BY_BRIDGE) {
                    bridge.stop_robots();
                } else {
                    bridge.restore_stop();
                }
                files.latch = Some(content.unwrap_or_default());
                tracing::warn!("the emergency stop is set since before this start; see `mr-slam release`");
            }
        }
        files
    }

    /// Returns the number of stops found in the file since the start: a bridge that has set fewer is to set its emergency
    /// stop.
    pub fn stops_found(&self) -> u64 {
        self.stops_found
    }

    fn read_state(&self) -> io::Result<Option<SavedState>> {
        let bytes = self.read_if_present(&self.state_file)?;
        bytes.map(|bytes| Ok(serde_json::from_slice(&bytes)?)).transpose()
    }

    /// Reads the stop's file. One that another user, such as root, has put there counts, though this one may not read it.
    fn read_latch(&self) -> io::Result<Option<Vec<u8>>> {
        match self.read_if_present(&self.stop_file) {
            Err(why) if why.kind() == io::ErrorKind::PermissionDenied => {
                let about = LatchedStop::look(&self.stop_file);
                Ok(Some(format!("{about:?}").into_bytes()))
            }
            read => read,
        }
    }

    fn read_if_present(&self, path: &Path) -> io::Result<Option<Vec<u8>>> {
        match self.storage.read(path, BYTES_MAX) {
            Ok(bytes) => Ok(Some(bytes)),
            Err(why) if why.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(why) => Err(why),
        }
    }

    /// Writes the files anew if the bridge has changed. If it fails, that is said once, and the caller is to try again.
    /// See [`Self::stops_found`] for the stop's file. Call it often.
    ///
    /// Errors: names each file that is not as the bridge is, and what a restarted bridge does then.
    pub fn update(&mut self, snapshot: &BridgeSnapshot) -> io::Result<()> {
        let stop = self.update_stop(snapshot).err().map(|why| {
            let after = match snapshot.is_stopped {
                true => "a restarted bridge may not set the emergency stop",
                false => "a restarted bridge may set the emergency stop again",
            };
            format!("{}: {why}; {after}", self.stop_file.display())
        });
        // One file that cannot be written is no reason to leave the other as it was.
        let state = self.update_state(&snapshot.state).err().map(|why| {
            let after = "a restarted bridge knows the selected robot, who drives and who may drive as they were before";
            format!("{}: {why}; {after}", self.state_file.display())
        });
        let failed: Vec<String> = stop.into_iter().chain(state).collect();
        if failed.is_empty() {
            self.has_warned = false;
            return Ok(());
        }
        let why = failed.join("; ");
        if !std::mem::replace(&mut self.has_warned, true) {
            tracing::warn!("{why}");
        }
        Err(io::Error::other(why))
    }

    fn update_stop(&mut self, snapshot: &BridgeSnapshot) -> io::Result<()> {
        let latch = self.read_latch()?;
        if latch.is_some() && latch != self.latch {
            self.stops_found += 1;
        }
        self.latch = latch;
        // A stop that the bridge has not heard of yet is not to be released.
        let is_stopped = snapshot.is_stopped || snapshot.stops_applied < self.stops_found;
        match (is_stopped, self.latch.is_some()) {
            (true, false) => {
                self.storage.replace(&self.stop_file, STOPPED_BY_BRIDGE)?;
                self.latch = Some(STOPPED_BY_BRIDGE.to_vec());
            }
            (false, true) => {
                self.storage.remove(&self.stop_file)?;
                self.latch = None;
            }
            _ => {}
        }
        Ok(())
    }

    fn update_state(&mut self, state: &SavedState) -> io::Result<()> {
        if *state != self.saved {
            let json = serde_json::to_vec_pretty(state).unwrap_or_default();
            self.storage.replace(&self.state_file, &json)?;
            self.saved.clone_from(state);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
