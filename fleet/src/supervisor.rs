//! Starts the fleet's processes and restarts each that ends, while the others keep running.
//!
//! What a dead child left in shared memory is removed before its restart. A child that hangs is killed, and started again
//! like one that died.

use crate::child_process::{describe_end, own_program, signal, spawn};
use crate::clock::{RESTARTS_VARIABLE, now};
use crate::emergency_stop_file::latch_stop;
use crate::end_grace::{END_GRACE, EndGrace, WRITER_END_GRACE};
use crate::process::control::saved_state::stop_file;
use crate::processes::ProcessRow;
use crate::progress::{self, ProgressBoard, WatchedThread};
use crate::restarts::{CleaningWait, RestartPolicy, failing_text};
use crate::run::{Run, restore_folder};
use crate::runtime_folder::Lock;
use crate::sessions;
use crate::stop::Stop;
use crate::storage::DiskStorage;
use crate::watchdog::{Finding, Watchdog};
use crate::world;
use msg::{Monotonic, Pose2, RobotId, Role};
use rustix::process::Signal;
use std::io;
use std::net::TcpListener;
use std::os::fd::OwnedFd;
use std::os::unix::process::ExitStatusExt;
use std::process::{Child, ExitStatus, Stdio};
use std::time::Duration;

/// Longest time until a process's first pass of its loop: it reads its room and its session.
pub const START_MAX: Duration = Duration::from_secs(10);
/// Longest time without a pass of a process's second thread, which computes for long.
const SECOND_SILENCE_MAX: Duration = Duration::from_secs(10);

/// One process of the fleet.
struct Member {
    row: &'static ProcessRow,
    robot: Option<RobotId>,
    policy: RestartPolicy,
    /// The child process, while it runs.
    child: Option<Child>,
    /// Watchdogs of the child's main and second thread.
    watchdogs: [Watchdog; WatchedThread::COUNT],
}

impl Member {
    fn new(row: &'static ProcessRow, robot: Option<RobotId>, now: Monotonic) -> Self {
        let (policy, watchdogs) = (RestartPolicy::new(now), watchdogs(row, now));
        Self { row, robot, policy, child: None, watchdogs }
    }

    fn name(&self) -> String {
        self.row.title(self.robot)
    }
}

/// Newest poses of a robot, for processes that are started again: see `--at`.
pub type LastSeen<'a> = &'a mut dyn FnMut(Role, RobotId) -> Option<Pose2>;

/// The fleet's processes.
pub struct Supervisor {
    run: Run,
    listener: TcpListener,
    members: Vec<Member>,
    progress: ProgressBoard,
    /// Wait for what dead children left in shared memory.
    cleaning: CleaningWait,
    folder: RunFolder,
    /// Why the run's folder, without which no process starts, cannot be used at present.
    folder_error: Option<String>,
    /// Where each robot's map begins, to be written again if the file is gone.
    starts: Vec<Option<Pose2>>,
    /// Why the robots' starts, which were gone, could not be written again.
    starts_error: Option<String>,
}

/// What has become of the run's folder.
enum RunFolder {
    /// It is the one that the launcher has made.
    Original,
    /// It was moved or deleted, and made anew.
    Restored {
        /// Lock of the new folder.
        _lock: Lock,
    },
}

impl Supervisor {
    /// Starts all processes. The bridge inherits `listener`, so that a headset's attempts queue
    /// while it restarts. `starts`: where each robot's map begins, as the run's file says.
    pub fn start(run: &Run, listener: TcpListener, starts: Vec<Option<Pose2>>) -> io::Result<Self> {
        let now = now();
        let members = run.config.processes().map(|(row, robot)| Member::new(row, robot, now));
        let members: Vec<Member> = members.collect();
        let mut supervisor = Self {
            run: run.clone(),
            listener,
            progress: ProgressBoard::create(&run.domain, run.progress_slots())?,
            members,
            cleaning: CleaningWait::default(),
            folder: RunFolder::Original,
            folder_error: None,
            starts,
            starts_error: None,
        };
        supervisor.tend(&mut |_, _| None, &mut |_| {});
        let missing = supervisor.members.iter().find(|member| member.child.is_none()).map(Member::name);
        match missing {
            Some(name) => {
                supervisor.end(&Stop::default(), &mut |_| {});
                Err(io::Error::other(format!("cannot start the {name}")))
            }
            None => Ok(supervisor),
        }
    }

    /// Detects children that ended or hang, and starts again those that are due. Never blocks. A robot's process gets the pose
    /// where it was `last_seen`. `notify` is called with each event.
    pub fn tend(&mut self, last_seen: LastSeen<'_>, notify: &mut dyn FnMut(String)) {
        self.keep_folder(notify);
        if self.folder_error.is_none() {
            self.keep_starts(notify);
        }
        let mut died = false;
        for member in &mut self.members {
            died |= notice_death(member, notify);
        }
        let clean_up = || self.run.domain.clean_up_after_the_dead();
        let may_start = self.cleaning.may_start(died, now(), clean_up);
        self.replace_hung(notify);
        let mut order: Vec<usize> = (0..self.members.len()).collect();
        order.sort_by_key(|index| start_rank(self.members[*index].row.role));
        for index in order {
            // The bridge waits itself for its places in channels: real robots drive on until it stops them.
            if may_start || self.members[index].row.role == Role::Bridge {
                self.start_if_due(index, last_seen, notify);
            }
            // The next poll says it again if this one cannot.
            let _ = self.progress.set_failing(index, self.members[index].policy.is_failing(now()));
        }
    }

    /// Starts failing processes at once: what they lacked may be there again.
    pub fn retry_failing(&mut self) {
        self.members.iter_mut().for_each(|member| member.policy.retry_if_failing(now()));
    }

    /// Makes the run's folder anew if it is gone: the children that are started again read it.
    fn keep_folder(&mut self, notify: &mut dyn FnMut(String)) {
        let dir = self.run.dir.display();
        let error_before = self.folder_error.take();
        match restore_folder(&self.run) {
            Ok(None) if error_before.is_some() => {
                notify(format!("the run's folder {dir} can be used again"));
                self.retry_failing();
            }
            Ok(None) => {}
            Ok(Some(lock)) => {
                notify(format!(
                    "the run's folder {dir} was moved or deleted and is made anew, without what was saved there; \
                     a bridge that is started again stops the robots"
                ));
                self.folder = RunFolder::Restored { _lock: lock };
                self.retry_failing();
            }
            Err(why) => {
                if error_before.is_none() {
                    notify(format!(
                        "no process can be started again until the run's folder can be used: {why}"
                    ));
                }
                self.folder_error = Some(why.to_string());
            }
        }
    }

    /// Writes the robots' starts again if they are gone, with the folder for sessions: without them a later run does not know how the
    /// maps lie to each other.
    fn keep_starts(&mut self, notify: &mut dyn FnMut(String)) {
        let folder = sessions::folder(&self.run);
        if sessions::has_starts(&folder) {
            self.starts_error = None;
            return;
        }
        let is_own_frame = world::has_own_frame(&self.run.config);
        let written = sessions::write_starts(&folder, &self.starts, is_own_frame);
        let dir = folder.display();
        match written {
            Ok(()) => notify(format!(
                "the robots' starts in {dir} were moved or deleted and are written again; sessions that are gone, too, \
                 come back with the next change of their map, or at the end"
            )),
            Err(why) => {
                let why = why.to_string();
                if self.starts_error.as_ref() != Some(&why) {
                    notify(format!("sessions in {dir} are not complete: {why}; it is tried again"));
                }
                self.starts_error = Some(why);
            }
        }
    }

    /// Sets the emergency stop for a bridge that is started again, if what the bridge before has saved is gone: the robots may have been
    /// stopped, and addresses denied.
    fn stop_if_unknown(&self, role: Role) -> io::Result<()> {
        if role != Role::Bridge || matches!(self.folder, RunFolder::Original) {
            return Ok(());
        }
        latch_stop(&DiskStorage, &stop_file(&self.run.dir), now())
    }

    /// Kills children that hang, so that they are started again, and reports those that are slow.
    fn replace_hung(&mut self, notify: &mut dyn FnMut(String)) {
        // Without the counters nobody can be judged. The next poll reads them again.
        if self.progress.read().is_err() {
            return;
        }
        for (index, member) in self.members.iter_mut().enumerate() {
            let Some(child) = &mut member.child else { continue };
            for thread in [WatchedThread::Main, WatchedThread::Second] {
                let entry = self.progress.entry(index, thread);
                // The main thread is watched from its start, whose id is the process's.
                let id = match (entry.thread, thread) {
                    (0, WatchedThread::Second) => continue,
                    (0, WatchedThread::Main) => child.id(),
                    (id, _) => id,
                };
                let watchdog = &mut member.watchdogs[thread as usize];
                let finding = watchdog.poll(now(), entry.count, || progress::sample(child.id(), id));
                let Some(finding) = finding else { continue };
                let of_thread = member.row.second_thread.filter(|_| thread == WatchedThread::Second);
                let who = match of_thread {
                    Some(name) => format!("the {name} thread of the {}", member.row.title(member.robot)),
                    None => format!("the {}", member.row.title(member.robot)),
                };
                notify(format!("{who} {finding}"));
                if matches!(finding, Finding::Hung { .. }) {
                    let _ = child.kill();
                    break;
                }
            }
        }
    }

    fn start_if_due(&mut self, index: usize, last_seen: LastSeen<'_>, notify: &mut dyn FnMut(String)) {
        let Member { row, robot, ref policy, .. } = self.members[index];
        // A child reads the run's folder. Without it, its death would say nothing of the child.
        if self.folder_error.is_some() || !policy.is_due(now()) {
            return;
        }
        let starts_before = policy.starts();
        let place = robot.and_then(|robot| last_seen(row.role, robot));
        let cleared = self.progress.clear(index).and_then(|()| self.stop_if_unknown(row.role));
        let started = cleared.and_then(|()| self.spawn(row, robot, place, starts_before));
        let member = &mut self.members[index];
        match started {
            Ok(child) => {
                member.policy.on_started(now());
                member.watchdogs = watchdogs(row, now());
                member.child = Some(child);
            }
            Err(why) => {
                notify(format!("cannot start the {}: {why}", member.name()));
                record_death(member, notify);
            }
        }
    }

    fn spawn(
        &self,
        row: &ProcessRow,
        robot: Option<RobotId>,
        place: Option<Pose2>,
        starts_before: u64,
    ) -> io::Result<Child> {
        let mut command = own_program();
        command.args(["worker", row.role.name()]).env(RESTARTS_VARIABLE, starts_before.to_string());
        if let Some(robot) = robot {
            command.arg("--robot").arg(robot.number().to_string());
        }
        if let Some(Pose2 { x_m, y_m, yaw_rad }) = place {
            command.arg(format!("--at={x_m},{y_m},{yaw_rad}"));
        }
        command.arg("--run-dir").arg(&self.run.dir);
        let stdin = match row.role {
            Role::Bridge => Stdio::from(OwnedFd::from(self.listener.try_clone()?)),
            _ => Stdio::null(),
        };
        if row.role == Role::Bridge {
            command.envs(bridge::ALLOCATOR_SETTINGS);
        }
        spawn(command.stdin(stdin))
    }

    /// Returns the names of the processes that die again and again.
    pub fn failing(&self) -> Vec<String> {
        self.members.iter().filter(|member| member.policy.is_failing(now())).map(Member::name).collect()
    }

    /// Asks every child to end, kills those that do not, and removes the run's shared memory. A further request of `stop` leaves them
    /// a short time. `notify` is called with what is waited for. Returns what is not saved.
    pub fn end(&mut self, stop: &Stop, notify: &mut dyn FnMut(String)) -> Vec<String> {
        let children = || self.members.iter().filter_map(|member| member.child.as_ref());
        children().for_each(|child| signal(child, Signal::TERM));
        let (mut patience, mut lost) = (EndGrace::new(now()), Vec::new());
        for member in &mut self.members {
            let unsaved = unsaved_without_end(member.row.role);
            let grace = if unsaved.is_some() { WRITER_END_GRACE } else { END_GRACE };
            let name = member.name();
            let Some(child) = member.child.as_mut() else { continue };
            let mut is_reported = false;
            while matches!(child.try_wait(), Ok(None)) && !patience.is_over(grace, now()) {
                if stop.is_requested_again() {
                    patience.hurry(now());
                }
                if patience.elapsed(now()) >= END_GRACE && !std::mem::replace(&mut is_reported, true) {
                    let short_s = END_GRACE.as_secs();
                    notify(format!(
                        "ending: waiting for the {name}; Ctrl-C again kills it after {short_s} s"
                    ));
                }
                std::thread::sleep(Duration::from_millis(5));
            }
            let is_killed = matches!(child.try_wait(), Ok(None));
            if is_killed {
                let why = if patience.is_hurried() { ", as a second request asked" } else { "" };
                let elapsed_s = patience.elapsed(now()).as_secs();
                let text = format!("the {name} had not ended after {elapsed_s} s and was killed{why}");
                notify(text.clone());
                lost.extend(unsaved.map(|unsaved| format!("{text}: {unsaved}")));
            }
            let _ = child.kill();
            // It was asked to end: by that it may end before it can handle it.
            let is_asked = |status: ExitStatus| status.signal() == Some(Signal::TERM.as_raw());
            let has_ended_well = child.wait().is_ok_and(|status| status.success() || is_asked(status));
            let has_failed = !is_killed && !has_ended_well;
            let unsaved = unsaved.filter(|_| has_failed);
            lost.extend(unsaved.map(|unsaved| format!("the {name} failed: {unsaved}")));
        }
        self.run.domain.remove();
        lost
    }
}

/// Returns what is not saved if a process of this role does not end by itself.
fn unsaved_without_end(role: Role) -> Option<&'static str> {
    match role {
        Role::Record => Some("the end of the recording is missing"),
        Role::Slam => Some("its last map is not saved"),
        _ => None,
    }
}

/// Returns a role's place in the order of starts: the bridge first, which stops the robots; then what the first map needs; then
/// the rest, which would take the processor from it.
fn start_rank(role: Role) -> u8 {
    match role {
        Role::Bridge => 0,
        Role::Sim | Role::Objects | Role::Slam | Role::Merge | Role::Record => 1,
        Role::Nav | Role::Telemetry => 2,
    }
}

fn watchdogs(row: &ProcessRow, now: Monotonic) -> [Watchdog; WatchedThread::COUNT] {
    [row.silence_max, SECOND_SILENCE_MAX].map(|silence_max| Watchdog::new(START_MAX, silence_max, now))
}

fn notice_death(member: &mut Member, notify: &mut dyn FnMut(String)) -> bool {
    let Some(child) = &mut member.child else { return false };
    let Ok(Some(status)) = child.try_wait() else { return false };
    member.child = None;
    notify(format!("the {} ended ({})", member.name(), describe_end(status)));
    record_death(member, notify);
    true
}

fn record_death(member: &mut Member, notify: &mut dyn FnMut(String)) {
    if member.policy.on_death(now()) {
        notify(format!("the {} {}", member.name(), failing_text()));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_packaged_services_wait_until_all_is_saved() {
        // After the slowest process the launcher writes maps and report.
        let least = WRITER_END_GRACE * 2;
        for unit in [
            include_str!("../../packaging/mr-slam-base.service"),
            include_str!("../../packaging/mr-slam-robot.service"),
        ] {
            let line = unit.lines().find_map(|line| line.strip_prefix("TimeoutStopSec="));
            let seconds = Duration::from_secs(line.unwrap().parse().unwrap());
            assert!(seconds >= least, "systemd kills the launcher after {seconds:?}: {unit}");
        }
    }
}
