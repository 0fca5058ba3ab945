//! Starts the fleet's processes and restarts each that ends, while the others keep running.
//!
//! What a dead child left in shared memory is removed before its restart.

pub mod restarts;

use crate::clock::now;
use crate::processes::{self, ProcessRow};
use crate::run::Run;
use msg::{Pose2, RobotId, Role};
use restarts::{DEATHS_MAX, RestartPolicy, State};
use rustix::process::{Pid, Signal, kill_process};
use std::io;
use std::net::TcpListener;
use std::os::fd::OwnedFd;
use std::os::unix::process::CommandExt;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

/// How long a child may take to end when asked, before it is killed. The whole fleet ends within
/// 5 s, of which the maps' writing takes some.
const END_GRACE: Duration = Duration::from_secs(2);

/// One process of the fleet.
struct Member {
    row: &'static ProcessRow,
    robot: Option<RobotId>,
    policy: RestartPolicy,
    /// The child process, while it runs.
    child: Option<Child>,
}

impl Member {
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
}

impl Supervisor {
    /// Starts all processes. The bridge inherits `listener`, so that a headset's attempts queue
    /// while it restarts.
    pub fn start(run: &Run, listener: TcpListener) -> io::Result<Self> {
        let now = now();
        let member = |(row, robot)| Member { row, robot, policy: RestartPolicy::new(now), child: None };
        let members = processes::of_fleet(&run.config).map(member).collect();
        let mut supervisor = Self { run: run.clone(), listener, members };
        supervisor.tend(&mut |_, _| None, &mut |_| {});
        match supervisor.members.iter().find(|member| member.child.is_none()) {
            Some(member) => Err(io::Error::other(format!("cannot start the {}", member.name()))),
            None => Ok(supervisor),
        }
    }

    /// Detects children that ended, and starts again those that are due. Never blocks. A robot's process gets the pose
    /// where it was `last_seen`. `tell` is called with each event.
    pub fn tend(&mut self, last_seen: LastSeen<'_>, tell: &mut dyn FnMut(String)) {
        let mut died = false;
        for member in &mut self.members {
            died |= notice_death(member, tell);
        }
        if died {
            self.run.domain.clean_up_after_the_dead();
        }
        for index in 0..self.members.len() {
            self.start_if_due(index, last_seen, tell);
        }
    }

    fn start_if_due(&mut self, index: usize, last_seen: LastSeen<'_>, tell: &mut dyn FnMut(String)) {
        let Member { row, robot, ref policy, .. } = self.members[index];
        if !policy.is_due(now()) {
            return;
        }
        let place = robot.and_then(|robot| last_seen(row.role, robot));
        let started = self.spawn(row, robot, place);
        let member = &mut self.members[index];
        match started {
            Ok(child) => {
                member.policy.on_started(now());
                member.child = Some(child);
            }
            Err(why) => {
                tell(format!("cannot start the {}: {why}", member.name()));
                record_death(member, tell);
            }
        }
    }

    fn spawn(&self, row: &ProcessRow, robot: Option<RobotId>, place: Option<Pose2>) -> io::Result<Child> {
        let mut command = Command::new(std::env::current_exe()?);
        command.args(["worker", row.role.name()]);
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
        // A process group of its own: Ctrl-C reaches the launcher only, which then ends the children.
        command.stdin(stdin).process_group(0).spawn()
    }

    /// Asks every child to end, kills those that do not, and removes the run's shared memory.
    pub fn end(&mut self) {
        let children = || self.members.iter().filter_map(|member| member.child.as_ref());
        children().for_each(|child| signal(child, Signal::TERM));
        let deadline = Instant::now() + END_GRACE;
        for child in self.members.iter_mut().filter_map(|member| member.child.as_mut()) {
            while matches!(child.try_wait(), Ok(None)) && Instant::now() < deadline {
                std::thread::sleep(Duration::from_millis(5));
            }
            let _ = child.kill();
            let _ = child.wait();
        }
        self.run.domain.remove();
    }
}

fn notice_death(member: &mut Member, tell: &mut dyn FnMut(String)) -> bool {
    let Some(child) = &mut member.child else { return false };
    let Ok(Some(status)) = child.try_wait() else { return false };
    member.child = None;
    tell(format!("the {} ended ({})", member.name(), describe(status)));
    record_death(member, tell);
    true
}

fn record_death(member: &mut Member, tell: &mut dyn FnMut(String)) {
    if member.policy.on_death(now()) == State::Held {
        tell(format!("the {} died {DEATHS_MAX} times in a row and is not started again", member.name()));
    }
}

fn describe(status: ExitStatus) -> String {
    use std::os::unix::process::ExitStatusExt;
    match (status.code(), status.signal()) {
        (Some(code), _) => format!("exit code {code}"),
        (None, Some(signal)) => format!("signal {signal}"),
        (None, None) => "no reason given".into(),
    }
}

fn signal(child: &Child, signal: Signal) {
    if let Some(pid) = Pid::from_raw(child.id() as i32) {
        let _ = kill_process(pid, signal);
    }
}
