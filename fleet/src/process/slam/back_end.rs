//! The back-end thread: closes loops, solves the graph, draws the map, answers requests and saves sessions.

use super::autosave::Autosave;
use super::commands::CommandSender;
use super::file_jobs::FileJobs;
use super::files::{FileJobOutcome, FileOperation, Loaded, SlamFileJob};
use super::map_frame::MapFrame;
use super::services::{PendingRequest, Services};
use super::session_log::{LogEnd, SessionLog};
use super::{BackEndInput, FrontCommand, FrontEvent, TrajectoryStart};
use crate::ports::{ChannelError, Clock, Ports};
use crate::process::map_publisher::MapPublisher;
use crate::process::submap_publisher::SubmapPublisher;
use crate::run::Run;
use crate::sessions;
use ::slam::{BackEnd, FrontEnd, FrontEndState, LocalFrameEstimate, Node, Session, SessionIdentity};
use msg::{Monotonic, RobotId, SlamMode, SlamRequest};
use std::path::PathBuf;
use std::sync::mpsc::SyncSender;
use std::time::Duration;

/// Longest time between two polls of the requests.
const REQUEST_PERIOD: Duration = Duration::from_millis(100);
/// Time without an answer after which the scan path's state is requested again: its queue may have been full.
const STATE_PATIENCE: Duration = Duration::from_secs(1);
/// Requests that may wait for the scan path's state when the session log adds one.
const PENDING_LOG_MAX: usize = 32;
/// Standard deviation of the position with which SLAM continues after a restart or a replacement, metres.
const RESTART_SIGMA_M: f64 = 0.1;
/// Standard deviation of the heading then, radians.
const RESTART_SIGMA_RAD: f64 = 0.05;

/// The back end with which a process begins.
pub struct InitialBackEnd {
    /// The back end itself.
    pub back: BackEnd,
    /// End of the log with its nodes.
    pub log_end: LogEnd,
    /// Whether SLAM is paused.
    pub is_paused: bool,
    /// Frame of the map.
    pub frame: MapFrame,
}

/// The back end with its channels. A step handles one event of the scan path and about a millisecond of other work.
pub struct BackEndWorker<P: Ports> {
    state: WorkerState,
    services: Services<P>,
    map: MapPublisher<P>,
    submaps: SubmapPublisher<P>,
    clock: P::Clock,
    robot: RobotId,
    /// Number of the front end whose submaps are published, and of their map's frame.
    published: [u32; 2],
    /// Reasons why the map may be wrong that a person was told.
    reported_reasons: Vec<&'static str>,
    ended: bool,
}

impl<P: Ports> BackEndWorker<P> {
    /// Opens the channels.
    pub fn open(
        ports: &P,
        run: &Run,
        robot: RobotId,
        InitialBackEnd { back, log_end, is_paused, frame }: InitialBackEnd,
        commands: SyncSender<FrontCommand>,
        jobs: SyncSender<SlamFileJob>,
    ) -> Result<Self, ChannelError> {
        let clock = ports.clock();
        let now = clock.now();
        let published = [0, frame.number];
        Ok(Self {
            map: MapPublisher::open(ports, robot)?,
            submaps: SubmapPublisher::open(ports, robot, &run.config.slam, frame.number)?,
            services: Services::open(ports, run, robot, is_paused)?,
            state: WorkerState {
                back,
                identity: sessions::identity(run, robot),
                commands: CommandSender::new(commands),
                jobs: FileJobs::new(jobs),
                autosave: Autosave::new(run, robot, now),
                log: SessionLog::new(run, robot, log_end),
                frame,
                front_number: 0,
                map_changed: true,
                pending: Vec::new(),
                asked_at: now,
                now,
            },
            clock,
            robot,
            published,
            reported_reasons: Vec::new(),
            ended: false,
        })
    }

    /// Handles an input, if there is one, and does what is due. Returns when the next step is due.
    pub fn step(&mut self, input: Option<BackEndInput>) -> Monotonic {
        let Self { state, services, map, submaps, .. } = self;
        state.now = self.clock.now();
        state.commands.flush();
        if let Some(BackEndInput::File(_)) = &input {
            state.jobs.finish(state.now);
        }
        match input {
            Some(BackEndInput::FrontEnd(number, FrontEvent::Ended(front))) => {
                self.ended = true;
                state.end(number, &front);
                return state.now;
            }
            Some(BackEndInput::FrontEnd(number, event)) => state.apply_event(number, event, services),
            Some(BackEndInput::File(outcome)) if outcome.request.is_some() => {
                services.finish_job(state, *outcome);
            }
            Some(BackEndInput::File(outcome)) => state.finish_write(&outcome),
            None => {}
        }
        services.serve(state);
        services.answer_held(state);
        state.autosave_if_due();
        state.request_log_record();
        state.ask_again();
        state.follow_frame(self.robot);
        let current = [state.front_number, state.frame.number];
        if std::mem::replace(&mut self.published, current) != current {
            submaps.restart(state.frame.number);
        }
        if std::mem::take(&mut state.map_changed) {
            map.mark_changed();
            submaps.update(&state.back);
            for reason in state.back.reliability_evidence().reasons() {
                if !self.reported_reasons.contains(&reason) {
                    self.reported_reasons.push(reason);
                    tracing::warn!("slam of {}: the map may be wrong: {reason}", self.robot);
                }
            }
        }
        let now = state.now;
        let map_due = map.step(&mut state.back, now);
        let submaps_due = submaps.step(&state.back, now);
        let log_due = state.log.due().unwrap_or(map_due);
        map_due.min(submaps_due).min(log_due).min(Monotonic(now.0 + REQUEST_PERIOD.as_nanos() as u64))
    }

    /// Returns whether the scan path has ended, and this thread with it.
    pub fn has_ended(&self) -> bool {
        self.ended
    }

    /// Returns the back end.
    pub fn back(&self) -> &BackEnd {
        &self.state.back
    }

    /// Returns how many commands wait for room in the queue to the scan path, and how many requests wait for its state.
    pub fn backlog(&self) -> [usize; 2] {
        [self.state.commands.waiting(), self.state.pending.len()]
    }

    /// Returns the session to continue from, with the scan path at `front`.
    pub fn session(&self, front: &FrontEndState) -> Session {
        self.state.session(front)
    }
}

/// The back end, its queues, and the requests that wait.
pub struct WorkerState {
    /// The back end itself.
    pub back: BackEnd,
    /// Robot, run and configuration to which a session belongs.
    pub identity: SessionIdentity,
    /// Sender of commands to the scan path.
    pub commands: CommandSender,
    pub(super) jobs: FileJobs,
    pub(super) autosave: Autosave,
    log: SessionLog,
    /// Frame of the map.
    pub(super) frame: MapFrame,
    /// Number of the current or next front end: events of earlier ones are ignored.
    front_number: u32,
    /// The map has changed since it was drawn.
    map_changed: bool,
    /// Requests that wait for the scan path's state.
    pending: Vec<PendingRequest>,
    /// Moment at which the state was requested.
    asked_at: Monotonic,
    pub(super) now: Monotonic,
}

impl WorkerState {
    fn apply_event<P: Ports>(&mut self, number: u32, event: FrontEvent, services: &mut Services<P>) {
        if number != self.front_number {
            // The event is from a replaced front end: a node of another map, or the front end itself, to be dropped.
            return;
        }
        match event {
            FrontEvent::Node(node, start) => self.add_node(node, start),
            FrontEvent::State(state) => {
                for pending in std::mem::take(&mut self.pending) {
                    services.resume(self, pending, &state);
                }
            }
            FrontEvent::Replaced(_) | FrontEvent::Ended(_) => {}
        }
    }

    fn add_node(&mut self, node: Node, start: Option<TrajectoryStart>) {
        let estimate = match start {
            Some(TrajectoryStart::At { map_from_local }) => Some(LocalFrameEstimate {
                map_from_local,
                sigma_m: RESTART_SIGMA_M,
                sigma_rad: RESTART_SIGMA_RAD,
            }),
            Some(TrajectoryStart::Unknown) | None => None,
        };
        let is_first = self.back.nodes().is_empty();
        let is_repeatable = self.back.grows_map() && (is_first || start.is_none());
        self.log.add(&node, estimate, is_repeatable, self.now);
        if start.is_some() {
            self.back.start_relocalization(estimate);
        }
        let was_found = self.back.map_from_base().is_some();
        let failed_before = self.back.failed_solutions();
        let frame_update = self.back.add_node(node);
        if self.back.failed_solutions() > failed_before {
            tracing::warn!("slam: the pose graph was not solved; the map stays as it was");
        }
        self.commands.send_or_drop(FrontCommand::QueueFrameUpdate(frame_update));
        if self.back.mode() != SlamMode::Localization {
            (self.map_changed, self.autosave.changed) = (true, true);
        }
        // A found pose is worth saving even if the map is unchanged.
        self.autosave.changed |= !was_found && self.back.map_from_base().is_some();
    }

    /// Marks the map as changed by something else than nodes: to be drawn, published and saved.
    pub fn mark_changed(&mut self) {
        self.log.suspend();
        self.map_changed = true;
        self.autosave.changed = true;
    }

    /// Continues with another map.
    pub fn replace(&mut self, front: FrontEnd, back: BackEnd, keeps_pose: bool) {
        // Its scans may have older stamps, but readers need maps in order of time.
        let before = self.back.tiles().header;
        self.back = back;
        self.frame.follow_anew();
        self.back.set_map_header(before.header, before.scan_sent);
        self.front_number += 1;
        self.mark_changed();
        let (number, front) = (self.front_number, Box::new(front));
        self.commands.send(FrontCommand::Replace { number, front, keeps_pose });
        if !self.pending.is_empty() {
            // An earlier request would be answered by the replaced front end.
            self.ask_for_state();
        }
    }

    /// Numbers the frame anew if the map has become one of another frame, and saves at once: a process that is started again goes on in
    /// that frame.
    fn follow_frame(&mut self, robot: RobotId) {
        if self.frame.follow(self.back.map_frame_changes()) {
            self.autosave.save_soon();
            tracing::warn!(
                "slam of {robot}: the robot was not found in its map, and what it has mapped since is its map now; its frame is a new one"
            );
        }
    }

    /// Continues with a loaded session.
    ///
    /// It is saved at once: a process that is started again goes on with it, and not with the map of before.
    pub fn load(&mut self, loaded: Loaded) {
        self.frame = loaded.frame;
        self.replace(loaded.front, loaded.back, false);
        self.autosave.save_soon();
    }

    /// Changes the mode, and saves at once: a process that is started again keeps to it.
    pub fn set_mode(&mut self, mode: SlamMode) {
        self.back.set_mode(mode);
        self.mark_changed();
        self.autosave.save_soon();
    }

    /// Returns how many requests wait for the scan path's state.
    pub fn pending(&self) -> usize {
        self.pending.len()
    }

    /// Defers a request until the scan path's state is known.
    pub fn defer_until_state(&mut self, pending: PendingRequest) {
        self.pending.push(pending);
        self.ask_for_state();
    }

    fn ask_for_state(&mut self) {
        self.asked_at = self.now;
        self.commands.send_or_drop(FrontCommand::ReportState);
    }

    /// Requests the state again if the request or the answer was lost.
    fn ask_again(&mut self) {
        let waited = Duration::from_nanos(self.now.since(self.asked_at));
        if !self.pending.is_empty() && waited >= STATE_PATIENCE {
            self.ask_for_state();
        }
    }

    /// Sends a job to the file worker; returns false if its queue is full.
    pub fn submit_file_job(
        &mut self,
        request: Option<&SlamRequest>,
        path: PathBuf,
        work: FileOperation,
    ) -> bool {
        let request = request.map(|request| Box::new(*request));
        self.jobs.submit(SlamFileJob { request, path, work }, self.now)
    }

    /// Returns the session to save, with the scan path at `state`.
    pub fn session(&self, state: &FrontEndState) -> Session {
        self.back.session(self.identity, Some(state.clone()), &[])
    }

    /// Handles the outcome of a write that no request waits for.
    fn finish_write(&mut self, outcome: &FileJobOutcome) {
        match outcome.appended_at {
            Some(at) => {
                let error = outcome.result.as_ref().err().map(ToString::to_string);
                self.log.finish_record(&outcome.path, at, error.as_deref());
            }
            None => {
                self.log.finish_session(outcome.result.is_ok());
                self.autosave.finish(outcome, self.now);
            }
        }
    }

    /// Requests the scan path's state for a record of the session log, if one is due.
    fn request_log_record(&mut self) {
        if self.log.is_due(self.now) && self.pending.len() < PENDING_LOG_MAX {
            self.log.is_requested = true;
            self.defer_until_state(PendingRequest::LogRecord);
        }
    }

    /// Writes the nodes that wait to the session log, with the scan path at `state`.
    pub fn write_log(&mut self, state: &FrontEndState) {
        self.log.write(&self.identity, state, &mut self.jobs, self.now);
    }

    fn autosave_if_due(&mut self) {
        self.autosave.watch(self.now);
        if self.log.needs_session() && self.back.grows_map() {
            self.autosave.save_soon();
        }
        // A map that was reset is saved without nodes, too: the one of before must not come back.
        if self.autosave.is_due(self.now) {
            self.autosave.begin(self.now);
            self.defer_until_state(PendingRequest::Autosave);
        }
    }

    /// Starts a save on the file worker.
    pub fn save(&mut self, state: &FrontEndState) {
        let session = self.session_after_log(state);
        if !self.submit_file_job(
            None,
            self.autosave.path.clone(),
            FileOperation::Save(session, self.frame.to_save()),
        ) {
            self.log.finish_session(false);
            self.autosave.postpone(self.now);
        }
    }

    /// Returns the session to save, after the nodes that wait were written to the log.
    fn session_after_log(&mut self, state: &FrontEndState) -> Box<Session> {
        self.write_log(state);
        let log = self.log.begin_session();
        Box::new(Session { log, ..self.session(state) })
    }

    /// Saves at the end of the process, with the front end of this number at `state`.
    fn end(&mut self, number: u32, state: &FrontEndState) {
        let same_front = number == self.front_number;
        if self.autosave.is_wanted_at_end() && same_front {
            let work = FileOperation::Save(self.session_after_log(state), self.frame.to_save());
            // The running save must end first, or the older session would replace the newer one.
            self.jobs.submit_last(SlamFileJob { request: None, path: self.autosave.path.clone(), work });
        }
    }
}
