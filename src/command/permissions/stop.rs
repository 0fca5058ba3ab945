//! Tools `mr-slam stop` and `mr-slam release`: the emergency stop is set on the disk first, then in the bridge.

use super::{PermissionError, StopArgs};
use crate::command::output;
use crate::config::RobotSource;
use crate::control::{self, AskError, Request};
use crate::emergency_stop_file::latch_while;
use crate::lossy_path;
use crate::other_fleets::OtherFleet;
use crate::process::control::saved_state::stop_file;
use crate::process::link::{LinkReport, PeerReport};
use crate::run::{LostFleet, Run, RunError, RunningFleets, has_remote_robots, runtime_folder_of};
use crate::runtime_folder::{TrustError, has_launcher};
use crate::storage::{DiskStorage, Storage};
use msg::{Monotonic, PauseReason};
use reports::BridgeState;
use serde::Serialize;
use std::panic::resume_unwind;
use std::path::{Path, PathBuf};
use std::thread::ScopedJoinHandle;
use std::time::{Duration, Instant};

/// How long the command asks a bridge that does not answer: one that is killed or frozen is replaced by then.
const PATIENCE: Duration = Duration::from_secs(5);
/// Largest part of the stop's file that is compared, bytes.
const LATCH_BYTES_MAX: u64 = 4096;
/// Why a release did not release.
const SET_ANEW: &str = "the emergency stop was set anew meanwhile and holds";
/// Longest wait until robots on other machines say that they are stopped: their states and the file come once a second.
const ROBOTS_PATIENCE: Duration = Duration::from_secs(5);
/// Period at which the file is read.
const ROBOTS_POLL: Duration = Duration::from_millis(100);

/// What `mr-slam stop` has achieved with one fleet.
#[derive(Debug, Serialize)]
struct StoppedFleet {
    /// Folder of the run.
    #[serde(serialize_with = "lossy_path::serialize")]
    run: PathBuf,
    /// Whether the bridge has confirmed the stop: every robot has been sent a zero.
    confirmed: bool,
    /// Whether the stop is on the disk, where the bridge finds it when it goes on or starts.
    latched: bool,
    /// Why the bridge has not confirmed it, or why it is not latched.
    why: Option<String>,
    /// Robots on other machines that have not said that they are stopped.
    unconfirmed: Vec<String>,
    /// Robots of which this base has heard nothing yet.
    unheard: Vec<String>,
    /// Number of the user whose run it is, if that is another one: this user's trust ends there, and its bridge is not asked.
    #[serde(skip_serializing_if = "Option::is_none")]
    owner: Option<u32>,
    /// The fleet, if its run's folder cannot be read.
    #[serde(skip_serializing_if = "Option::is_none")]
    lost: Option<LostFleet>,
    /// The fleet, if it is not found from here and was not asked.
    #[serde(skip_serializing_if = "Option::is_none")]
    other: Option<OtherFleet>,
}

impl From<OtherFleet> for StoppedFleet {
    /// Describes a fleet that was not asked.
    fn from(other: OtherFleet) -> Self {
        Self {
            run: other.run_dir.clone().unwrap_or_default(),
            confirmed: false,
            latched: false,
            why: Some(other.to_string()),
            unconfirmed: Vec::new(),
            unheard: Vec::new(),
            owner: None,
            lost: None,
            other: Some(other),
        }
    }
}

impl StoppedFleet {
    /// Whether a robot of the fleet may still drive: nobody has confirmed that it is stopped.
    fn may_drive(&self) -> bool {
        !self.confirmed || !self.unconfirmed.is_empty()
    }

    /// Whether the fleet is another user's, whom this one cannot stop.
    fn is_of_another_user(&self) -> bool {
        self.other.as_ref().is_some_and(|other| !other.is_own)
    }

    fn line(&self) -> String {
        if let Some(other) = &self.other {
            return format!("NOT STOPPED: {other}\n");
        }
        let why = self.why.as_deref().unwrap_or_default();
        let unconfirmed = self.unconfirmed.join(", ");
        let owner = self.owner.unwrap_or_default();
        let (all, unheard) = match self.unheard.as_slice() {
            [] => ("every robot", String::new()),
            names => (
                "every robot that was heard of",
                format!(
                    "; whether {} drive is not known, as nothing was heard of them yet",
                    names.join(", ")
                ),
            ),
        };
        let state = match (self.confirmed, self.latched) {
            (true, _) if !unconfirmed.is_empty() => format!(
                "NOT CONFIRMED by {unconfirmed}: it stops when the link brings the stop; what it does by itself goes on until \
                 then, unless somebody stops it there"
            ),
            (true, true) => format!("{all} is stopped until `mr-slam release`"),
            (true, false) => format!("{all} is stopped, but not across a restart: {why}"),
            (false, true) if self.owner.is_some() => format!(
                "NOT CONFIRMED: the run is of user {owner}, whose bridge is not asked; the stop is in its folder, and the bridge sets \
                 it within a second if it runs and answers. Whether it has, only that user sees: `mr-slam status` as user {owner}, \
                 e.g. by sudo -u '#{owner}'"
            ),
            (false, true) => {
                format!(
                    "NOT CONFIRMED: the stop is latched, and the bridge sets it as soon as it goes on or is replaced; until then it \
                     is not known whether robots drive ({why})"
                )
            }
            (false, false) => format!("NOT STOPPED: {why}"),
        };
        let lost = self.lost.as_ref().map_or_else(String::new, |fleet| format!("; {fleet}"));
        format!("{state}{unheard} (run {}){lost}\n", self.run.display())
    }
}

/// Sets the emergency stop of the named fleet, or of all fleets of this user. Those of other users are listed, and do not change
/// the exit code.
pub fn stop(args: &StopArgs) -> Result<(), PermissionError> {
    let RunningFleets { runs, lost, others } = match &args.run.run_dir {
        Some(dir) => named(dir).map_err(|why| match why {
            RunError::Ended(_) => PermissionError::Ended(why),
            why => why.into(),
        })?,
        None => RunningFleets::find(),
    };
    let mut fleets = stop_all(runs, lost);
    fleets.extend(others.into_iter().map(StoppedFleet::from));
    if !fleets.is_empty() {
        output::print_either(args.json, &fleets, || fleets.iter().map(StoppedFleet::line).collect())?;
    }
    outcome(&fleets)
}

/// Returns what came of a stop, by the fleets of this user.
fn outcome(fleets: &[StoppedFleet]) -> Result<(), PermissionError> {
    let own = || fleets.iter().filter(|fleet| !fleet.is_of_another_user());
    match (own().filter(|fleet| fleet.may_drive()).count(), own().count()) {
        (_, 0) => Err(PermissionError::NothingToStop { others: fleets.len() }),
        (0, _) => Ok(()),
        (failed, all) => Err(PermissionError::NotStopped { failed, all }),
    }
}

/// Returns the fleet in a folder.
///
/// Errors: it has ended, or is another user's, or the folder has none.
fn named(dir: &Path) -> Result<RunningFleets, RunError> {
    match runtime_folder_of(dir) {
        // A stop of a fleet that has ended stops nothing, and the next one in this folder would begin with it.
        Ok(root) if !has_launcher(&root)? => Err(RunError::Ended(dir.into())),
        Err(why) if !dir.join("run.json").exists() => {
            let mut lost = RunningFleets::find().lost;
            lost.retain(|fleet| fleet.folder.as_deref() == Some(&absolute(dir)));
            // The error names the file that is missing.
            if lost.is_empty() { Err(why) } else { Ok(RunningFleets { lost, ..RunningFleets::default() }) }
        }
        // A run whose other files cannot be read is stopped all the same.
        Ok(_) | Err(_) => Ok(RunningFleets { runs: vec![dir.into()], ..RunningFleets::default() }),
    }
}

/// Returns the path that a folder had, which may be missing, without links above it.
fn absolute(dir: &Path) -> PathBuf {
    let path = std::path::absolute(dir).unwrap_or_else(|_| dir.into());
    let parent = path.parent().and_then(|parent| parent.canonicalize().ok());
    parent.zip(path.file_name()).map_or_else(|| path.clone(), |(parent, name)| parent.join(name))
}

/// Asks all bridges at once, and writes to the disk meanwhile: the robots of one fleet do not drive on while another bridge does not
/// answer, or while a disk is slow.
fn stop_all(runs: Vec<PathBuf>, lost: Vec<LostFleet>) -> Vec<StoppedFleet> {
    std::thread::scope(|scope| {
        let confirmed = runs.into_iter().map(|dir| scope.spawn(move || confirm(dir)));
        let mut asked: Vec<_> = confirmed.collect();
        asked.extend(lost.into_iter().map(|fleet| scope.spawn(move || stop_lost(fleet))));
        let answer = |thread: ScopedJoinHandle<'_, _>| thread.join().unwrap_or_else(|why| resume_unwind(why));
        asked.into_iter().map(answer).collect()
    })
}

/// Returns why a bridge's answer does not confirm the stop; `None` if it does.
fn why_unconfirmed(answer: Result<BridgeState, AskError>) -> Option<String> {
    match answer {
        Ok(state) if state.stopped => None,
        Ok(_) => Some("the bridge has released it again".into()),
        Err(why) => Some(why.to_string()),
    }
}

/// Returns a name for the robots on other machines of a fleet whose run cannot be read: so what they say of themselves is not known.
fn remote_robots(root: &Path) -> Vec<String> {
    if has_remote_robots(root) { vec!["its robots on other machines".into()] } else { vec![] }
}

/// Stops a fleet whose run's folder cannot be read: its bridge still listens in its runtime folder.
fn stop_lost(fleet: LostFleet) -> StoppedFleet {
    let why_not = why_unconfirmed(control::ask_again_in(&fleet.runtime, Request::Stop, PATIENCE));
    let confirmed = why_not.is_none();
    let unconfirmed = remote_robots(&fleet.runtime);
    StoppedFleet {
        run: fleet.folder.clone().unwrap_or_else(|| fleet.runtime.clone()),
        confirmed,
        latched: false,
        why: Some(why_not.unwrap_or_else(|| "its run's folder cannot be read".into())),
        unconfirmed,
        unheard: Vec::new(),
        owner: None,
        lost: Some(fleet),
        other: None,
    }
}

/// Stops the fleet of a folder in its bridge and on the disk.
fn confirm(dir: PathBuf) -> StoppedFleet {
    let begun = crate::clock::now();
    let ask = || {
        let root = runtime_folder_of(&dir).map_err(|why| why.to_string())?;
        if !has_launcher(&root).map_err(|why| why.to_string())? {
            return Err(RunError::Ended(dir.clone()).to_string());
        }
        match (why_unconfirmed(control::ask_again_in(&root, Request::Stop, PATIENCE)), Run::open(&dir)) {
            (Some(why), _) => Err(why),
            (None, Ok(run)) => Ok(unconfirmed_robots(&run, begun)),
            // The configuration may be another build's, which names the robots in another way.
            (None, Err(_)) => Ok([remote_robots(&root), Vec::new()]),
        }
    };
    // A bridge that does not answer now sets the stop when it goes on or is replaced.
    let path = stop_file(&dir);
    let (asked, written) = if dir.join("run.json").exists() {
        let (asked, written) = latch_while(&path, ask);
        (asked, written.map_err(|why| format!("{}: {why}", path.display())))
    } else {
        (ask(), Err(RunError::NoneRunning.to_string()))
    };
    let (confirmed, latched) = (asked.is_ok(), written.is_ok());
    let [unconfirmed, unheard] = asked.as_ref().ok().cloned().unwrap_or_default();
    let why = written.err().or(asked.err());
    let owner = match runtime_folder_of(&dir) {
        Err(RunError::Trust(TrustError::Owner { owner, .. })) => Some(owner),
        _ => None,
    };
    StoppedFleet { run: dir, confirmed, latched, why, unconfirmed, unheard, owner, lost: None, other: None }
}

/// Returns the names of the robots on other machines that do not say in time that they are stopped, and of those that the base
/// has not heard of yet. What a robot said before the stop was asked for, at `asked`, says nothing of it.
fn unconfirmed_robots(run: &Run, asked: Monotonic) -> [Vec<String>; 2] {
    if run.config.world != RobotSource::Robots {
        return Default::default();
    }
    let begun = Instant::now();
    loop {
        let peers = LinkReport::read(&run.dir).unwrap_or_default().peers;
        let has_stopped = |name: &String| {
            peers.iter().any(|peer: &PeerReport| {
                peer.robot == *name && peer.state_ns > asked.0 && peer.is_stopped == Some(true)
            })
        };
        let was_heard = |name: &String| peers.iter().any(|peer| peer.robot == *name && peer.was_heard);
        let names = run.robots().map(|robot| run.config.robot_name(robot));
        let (heard, unheard): (Vec<String>, Vec<String>) = names.partition(was_heard);
        let left: Vec<String> = heard.into_iter().filter(|name| !has_stopped(name)).collect();
        if left.is_empty() || begun.elapsed() >= ROBOTS_PATIENCE {
            return [left, unheard];
        }
        std::thread::sleep(ROBOTS_POLL);
    }
}

/// Returns the names of the robots on other machines that are still stopped by their own machine's stop, which this base
/// cannot release, and of those that have not said in time that they are released.
fn robots_after_release(run: &Run, asked: Monotonic) -> [Vec<String>; 2] {
    if run.config.world != RobotSource::Robots {
        return Default::default();
    }
    let begun = Instant::now();
    loop {
        let peers = LinkReport::read(&run.dir).unwrap_or_default().peers;
        let heard = || peers.iter().filter(|peer| peer.was_heard);
        let is_own = |peer: &PeerReport| peer.hold.as_deref() == Some(PauseReason::StoppedAtRobot.text());
        let is_fresh = |peer: &PeerReport| peer.state_ns > asked.0;
        let is_open =
            |peer: &PeerReport| !is_fresh(peer) || (peer.is_stopped != Some(false) && !is_own(peer));
        let names = |is_of: &dyn Fn(&PeerReport) -> bool| {
            heard().filter(|peer| is_of(peer)).map(|peer| peer.robot.clone()).collect::<Vec<_>>()
        };
        let open = names(&is_open);
        if open.is_empty() || begun.elapsed() >= ROBOTS_PATIENCE {
            return [names(&|peer| is_fresh(peer) && is_own(peer)), open];
        }
        std::thread::sleep(ROBOTS_POLL);
    }
}

/// Releases the emergency stop of one fleet, in the bridge or, while there is none, on the disk.
pub fn release(args: &StopArgs) -> Result<(), PermissionError> {
    let run = args.run.open_to_change()?;
    let fail = |why: String| PermissionError::NotReleased { run: run.dir.display().to_string(), why };
    let asked = crate::clock::now();
    let mut not_saved = None;
    let state = match ask_for_release(&run).map_err(fail)? {
        Ok(state) if state.stopped => return Err(fail(SET_ANEW.into())),
        Ok(state) => {
            not_saved = state.not_saved;
            "the robots may be driven again"
        }
        Err(AskError::NoAnswer { source, is_listening: false }) => {
            DiskStorage.remove(&stop_file(&run.dir)).map_err(|why| {
                fail(format!("the bridge does not run ({source}), and the stop stays on the disk: {why}"))
            })?;
            "the bridge does not run; the stop is removed from the disk, and the next bridge lets robots be driven. A stop that \
             was not confirmed may have paused nobody"
        }
        // It may have done so before the answer was lost.
        Err(why @ AskError::NoAnswer { .. }) => {
            return Err(fail(format!("{why}; whether the emergency stop is released is not known")));
        }
        Err(why) => return Err(fail(format!("{why}; the emergency stop holds, try again"))),
    };
    let [still_stopped, unconfirmed] = robots_after_release(&run, asked);
    let released = Released { run: &run.dir, state, not_saved, still_stopped, unconfirmed };
    Ok(output::print_either(args.json, &released, || released.text())?)
}

/// Asks the bridge for a release, and again while none listens: a bridge that starts sets the stop first, which pauses the robots.
///
/// Errors: the stop's file was written anew meanwhile. That stop is not the one that is to be released.
fn ask_for_release(run: &Run) -> Result<Result<BridgeState, AskError>, String> {
    let latch = || DiskStorage.read(&stop_file(&run.dir), LATCH_BYTES_MAX).ok();
    let (begun, released) = (Instant::now(), latch());
    loop {
        let present = latch();
        if present.is_some() && present != released {
            return Err(SET_ANEW.into());
        }
        match control::ask(run, Request::Release, PATIENCE) {
            Err(AskError::NoAnswer { is_listening: false, .. }) if begun.elapsed() < PATIENCE => {
                std::thread::sleep(control::RETRY_PERIOD);
            }
            answer => return Ok(answer),
        }
    }
}

/// Result of `mr-slam release`.
#[derive(Serialize)]
struct Released<'a> {
    #[serde(serialize_with = "lossy_path::serialize")]
    run: &'a Path,
    state: &'a str,
    /// What of it is not on the disk, why, and what follows from it at a restart.
    #[serde(skip_serializing_if = "Option::is_none")]
    not_saved: Option<String>,
    /// Robots on other machines whose own machine's stop is still set.
    still_stopped: Vec<String>,
    /// Robots on other machines that have not said that they are released.
    unconfirmed: Vec<String>,
}

impl Released<'_> {
    fn text(&self) -> String {
        let mut text = self.state.to_owned();
        if let Some(why) = &self.not_saved {
            text += &format!("; but it is NOT SAVED: {why}");
        }
        if !self.still_stopped.is_empty() {
            let names = self.still_stopped.join(", ");
            text += &format!(
                "; but STILL STOPPED at its own machine: {names}; this base cannot release it, `mr-slam release` there does"
            );
        }
        if !self.unconfirmed.is_empty() {
            text += &format!("; not confirmed by {}", self.unconfirmed.join(", "));
        }
        format!("{text} (run {})\n", self.run.display())
    }
}

#[cfg(test)]
mod tests;
