//! Injection of faults into a fleet in lockstep, and the supervisor's decisions about what comes of them.

use super::Lockstep;
use super::faults::{BRIDGE, Fault};
use super::members::Member;
use crate::control::Request;
use crate::ports::WritePort;
use crate::process::control::answer;
use msg::{Monotonic, RobotId, SlamRequest, SlamRequestKind};
use std::future::Future;
use std::pin::pin;
use std::task::{Context, Poll, Waker};
use std::time::Duration;

/// Period at which the launcher looks whether a process hangs.
const WATCH_PERIOD: Duration = Duration::from_millis(50);

impl Lockstep {
    /// Replaces the processes that hang and starts those that are due, as the live supervisor does.
    pub(super) fn supervise(&mut self) {
        let now = self.time();
        if now >= self.watch_due {
            self.watch_due = now + WATCH_PERIOD;
            for index in 0..self.members.len() {
                if self.members[index].is_hung(now) {
                    self.kill(index);
                }
            }
        }
        for member in &mut self.members {
            if member.start_due().is_none_or(|due| now < due) {
                continue;
            }
            let at = member.robot.and_then(|robot| self.observer.last_seen(member.row.role, robot));
            if let Err(why) = member.start(&self.world, at) {
                tracing::warn!("cannot start the {}: {why}", member.row.title(member.robot));
                member.policy.on_death(now);
            }
            let selected = member.bridge().map(|process| process.bridge.selected_robot());
            if let (Some(before), Some(after)) = (self.selected, selected)
                && before != after
            {
                self.violations.push(format!("{before} was selected, {after} is after the bridge's restart"));
            }
        }
    }

    /// Returns when the supervisor has something to do next.
    pub(super) fn supervisor_due(&self) -> Monotonic {
        let restart = self.members.iter().filter_map(Member::start_due);
        restart.min().unwrap_or(self.watch_due).min(self.watch_due)
    }

    /// Injects the faults that are due, and applies the requests that follow them.
    pub(super) fn apply_faults(&mut self) {
        let now = self.time();
        while let Some(position) = self.people.resume_at.iter().position(|(at, _)| *at <= now) {
            let (_, robot) = self.people.resume_at.remove(position);
            self.request(robot, SlamRequestKind::Resume);
        }
        if self.people.release_at.is_some_and(|at| at <= now) {
            self.release_stop();
        }
        while let Some(fault) = { self.world.network.faults().take_due(now) } {
            self.inject(fault, now);
        }
    }

    fn inject(&mut self, fault: Fault, now: Monotonic) {
        let robots = self.world.run.config.fleet.robots;
        let robot = |chosen: usize| RobotId::first(robots).nth(chosen % robots);
        match fault {
            Fault::Kill(chosen) => self.kill(self.member_index(chosen)),
            Fault::Freeze(chosen, duration) => {
                let index = self.member_index(chosen);
                self.members[index].frozen_until = now + duration;
            }
            Fault::ClockStep(duration) => self.world.network.clock().set(now + duration),
            Fault::LetGo(duration) => self.people.operator.idle_until = now + duration,
            Fault::OperatorLeaves(duration) => {
                self.world.network.record_event("operator_left");
                self.people.operator.disconnect(now + duration);
            }
            Fault::OperatorFrozen(duration) => self.people.operator.due = now + duration,
            Fault::Contend(chosen, duration) => {
                if let Some(robot) = robot(chosen) {
                    self.people.contender.drive(robot, now, duration);
                }
            }
            Fault::EmergencyStop(duration) => self.set_stop(now + duration),
            Fault::ResetMap(chosen) => {
                let Some(robot) = robot(chosen) else { return };
                self.saved[robot.index()] = 0;
                self.reset_at = Some(now);
                self.request(robot, SlamRequestKind::Reset);
            }
            Fault::Pause(chosen, duration) => {
                let Some(robot) = robot(chosen) else { return };
                self.request(robot, SlamRequestKind::Pause);
                self.people.resume_at.push((now + duration, robot));
            }
        }
    }

    /// Returns the member that a fault's number chooses. The bridge is the last.
    fn member_index(&self, chosen: usize) -> usize {
        if chosen == BRIDGE { self.members.len() - 1 } else { chosen % self.members.len() }
    }

    fn kill(&mut self, index: usize) {
        let now = self.time();
        self.observer.poll();
        self.record_saved_map(index);
        if let Some(process) = self.members[index].bridge() {
            // A disk that was full when the bridge took its last step keeps the selection from outliving it.
            let is_full = self.world.network.faults().is_disk_full(self.members[index].stepped_at);
            self.selected = (!is_full).then(|| process.bridge.selected_robot());
            self.world.network.record_event("bridge_died");
        }
        self.members[index].kill(now);
    }

    /// Sets the emergency stop by the control socket. While the bridge does not answer, nothing is set.
    fn set_stop(&mut self, release_at: Monotonic) {
        if self.ask_bridge(Request::Stop) {
            self.people.release_at = Some(release_at);
            // A full disk keeps the stop from outliving the bridge, which says so.
            let is_full = self.world.network.faults().is_disk_full(self.time());
            let event = if is_full { "stop_set_unsaved" } else { "stop_set" };
            self.world.network.record_event(event);
        }
    }

    /// Releases the emergency stop, or tries again while the bridge does not answer.
    fn release_stop(&mut self) {
        let is_released = self.ask_bridge(Request::Release);
        self.people.release_at = (!is_released).then(|| self.time() + WATCH_PERIOD);
        if is_released {
            self.world.network.record_event("stop_released");
        }
    }

    /// Sends a request of the person at the laptop; returns false if the bridge does not answer.
    fn ask_bridge(&mut self, request: Request) -> bool {
        let now = self.time();
        let bridge = self.members.iter().filter(|member| member.frozen_until <= now);
        let Some(process) = bridge.filter_map(|member| member.bridge()).next() else { return false };
        // The files are in memory: the answer is there at once.
        let answer = pin!(answer(&process.periodic_tasks.control, request, || now));
        matches!(answer.poll(&mut Context::from_waker(Waker::noop())), Poll::Ready(Ok(_)))
    }

    /// Records, before a SLAM process is killed, how much of its map the restarted one must know again.
    fn record_saved_map(&mut self, index: usize) {
        let member = &self.members[index];
        if let Some(robot) = member.robot.filter(|_| member.slam().is_some()) {
            self.saved[robot.index()] = self.saved_cells(robot);
        }
    }

    fn request(&mut self, robot: RobotId, kind: SlamRequestKind) {
        let request = SlamRequest { kind: kind as u32, ..SlamRequest::default() };
        self.requests[robot.index()].send(&request);
    }
}
