//! The back-end thread: loops, graph, map, requests, and what is saved of them.

use super::autosave::Autosave;
use super::commands::CommandSender;
use super::files::{Job, Loaded, Work};
use super::services::{PendingRequest, Services};
use super::{BackEndInput, FrontCommand, FrontEvent, Restart};
use crate::ports::{ChannelError, Clock, Ports};
use crate::process::map_publisher::MapPublisher;
use crate::process::submap_publisher::SubmapPublisher;
use crate::run::Run;
use crate::sessions;
use ::slam::{BackEnd, FrontEnd, FrontEndState, Identity, Node, PoseEstimate, Session};
use msg::{Monotonic, RobotId, SlamMode, SlamRequest};
use std::path::PathBuf;
use std::sync::mpsc::SyncSender;
use std::time::Duration;

/// How often requests are looked for, at least.
const REQUEST_PERIOD: Duration = Duration::from_millis(100);
/// The scan path's state is asked for again after this, if no answer came: its queue may have been full.
const STATE_PATIENCE: Duration = Duration::from_secs(1);
/// How sure it is where a robot is whose SLAM goes on where another left off: metres, radians.
const CARRIED_SIGMA: [f64; 2] = [0.1, 0.05];

/// The back end with its channels. A step takes one event of the scan path, and does a millisecond or so of the rest.
pub struct BackEndWorker<P: Ports> {
    state: BackEndState,
    services: Services<P>,
    map: MapPublisher<P>,
    submaps: SubmapPublisher<P>,
    clock: P::Clock,
    ended: bool,
}

impl<P: Ports> BackEndWorker<P> {
    /// Opens the channels.
    pub fn open(
        ports: &P,
        run: &Run,
        robot: RobotId,
        back: BackEnd,
        commands: SyncSender<FrontCommand>,
        jobs: SyncSender<Job>,
    ) -> Result<Self, ChannelError> {
        let clock = ports.clock();
        let now = clock.now();
        Ok(Self {
            map: MapPublisher::open(ports, robot)?,
            submaps: SubmapPublisher::open(ports, robot, &run.config.slam)?,
            services: Services::open(ports, run, robot)?,
            state: BackEndState {
                back,
                identity: sessions::identity(run, robot),
                commands: CommandSender::new(commands),
                jobs,
                autosave: Autosave::new(run, robot, now),
                front_number: 0,
                is_new: false,
                redraw: true,
                pending: Vec::new(),
                asked_at: now,
                now,
            },
            clock,
            ended: false,
        })
    }

    /// Takes an input, if there is one, and does what is due. Returns when it wants to run again.
    pub fn step(&mut self, input: Option<BackEndInput>) -> Monotonic {
        let Self { state, services, map, submaps, .. } = self;
        state.now = self.clock.now();
        state.commands.flush();
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
            Some(BackEndInput::File(outcome)) => state.autosave.finish(&outcome, state.now),
            None => {}
        }
        services.serve(state);
        state.autosave_if_due();
        state.ask_again();
        if std::mem::take(&mut state.is_new) {
            submaps.restart();
        }
        if std::mem::take(&mut state.redraw) {
            map.redraw();
            submaps.update(&state.back);
        }
        let now = state.now;
        let map_due = map.step(&mut state.back, now);
        let submaps_due = submaps.step(&state.back, now);
        map_due.min(submaps_due).min(Monotonic(now.0 + REQUEST_PERIOD.as_nanos() as u64))
    }

    /// Whether the scan path has ended, and this thread with it.
    pub fn has_ended(&self) -> bool {
        self.ended
    }

    /// The back end.
    pub fn back(&self) -> &BackEnd {
        &self.state.back
    }

    /// Commands that wait for room in the queue to the scan path, and requests that wait for the scan path's state.
    pub fn backlog(&self) -> [usize; 2] {
        [self.state.commands.waiting(), self.state.pending.len()]
    }

    /// All that must be kept to go on, with the scan path at `front`.
    pub fn session(&self, front: &FrontEndState) -> Session {
        self.state.session(front)
    }
}

/// The back end, and what goes on around it.
pub struct BackEndState {
    /// The back end itself.
    pub back: BackEnd,
    /// The robot, the run and the configuration that a session is for.
    pub identity: Identity,
    /// Commands to the scan path.
    pub commands: CommandSender,
    jobs: SyncSender<Job>,
    autosave: Autosave,
    /// The number of the front end that is in place, or will be: events of those before are ignored.
    front_number: u32,
    /// The back end has been replaced since the last step.
    is_new: bool,
    /// There is something new to draw.
    redraw: bool,
    /// What is to be done when the scan path's state is known.
    pending: Vec<PendingRequest>,
    /// When the state was asked for.
    asked_at: Monotonic,
    now: Monotonic,
}

impl BackEndState {
    fn apply_event<P: Ports>(&mut self, number: u32, event: FrontEvent, services: &mut Services<P>) {
        if number != self.front_number {
            // Of a front end that has been replaced: a node of another map, or the old front end, to be dropped here.
            return;
        }
        match event {
            FrontEvent::Node(node, restart) => self.add_node(node, restart),
            FrontEvent::State(state) => {
                for pending in std::mem::take(&mut self.pending) {
                    services.resume(self, pending, &state);
                }
            }
            FrontEvent::Replaced(_) | FrontEvent::Ended(_) => {}
        }
    }

    fn add_node(&mut self, node: Node, restart: Option<Restart>) {
        match restart {
            Some(Restart::At(map_from_local)) => {
                let [sigma_m, sigma_rad] = CARRIED_SIGMA;
                self.back.start_relocalization(Some(PoseEstimate { map_from_local, sigma_m, sigma_rad }));
            }
            Some(Restart::Unknown) => self.back.start_relocalization(None),
            None => {}
        }
        let was_found = self.back.map_from_base().is_some();
        let revision = self.back.add_node(node);
        self.commands.send_or_drop(FrontCommand::Revise(revision));
        if self.back.mode() != SlamMode::Localization {
            self.mark_changed();
        }
        // That it was found is worth saving, even where the map stays as it is.
        self.autosave.changed |= !was_found && self.back.map_from_base().is_some();
    }

    /// The map is no longer as it was.
    pub fn mark_changed(&mut self) {
        self.redraw = true;
        self.autosave.changed = true;
    }

    /// Goes on with another map.
    pub fn replace(&mut self, front: FrontEnd, back: BackEnd, in_place: bool) {
        // Its scans may be of another time; readers want maps in order.
        let before = self.back.tiles().header;
        self.back = back;
        self.back.set_map_header(before.header, before.scan_sent);
        (self.front_number, self.is_new) = (self.front_number + 1, true);
        self.mark_changed();
        let (number, front) = (self.front_number, Box::new(front));
        self.commands.send(FrontCommand::Replace { number, front, in_place });
        if !self.pending.is_empty() {
            // What was asked before would be answered by the front end that is replaced.
            self.ask_for_state();
        }
    }

    /// Goes on with what was loaded.
    pub fn load(&mut self, loaded: Loaded) {
        self.replace(loaded.front, loaded.back, false);
    }

    /// How many requests wait for the scan path's state.
    pub fn pending(&self) -> usize {
        self.pending.len()
    }

    /// Does it when the scan path's state is known.
    pub fn wait_for_state(&mut self, pending: PendingRequest) {
        self.pending.push(pending);
        self.ask_for_state();
    }

    fn ask_for_state(&mut self) {
        self.asked_at = self.now;
        self.commands.send_or_drop(FrontCommand::ReportState);
    }

    /// Asks once more if the question or the answer was lost.
    fn ask_again(&mut self) {
        let waited = Duration::from_nanos(self.now.since(self.asked_at));
        if !self.pending.is_empty() && waited >= STATE_PATIENCE {
            self.ask_for_state();
        }
    }

    /// Gives the file worker something to do; false if it has too much to do already.
    pub fn give(&self, request: Option<&SlamRequest>, path: PathBuf, work: Work) -> bool {
        let request = request.map(|request| Box::new(*request));
        self.jobs.try_send(Job { request, path, work }).is_ok()
    }

    /// All that must be kept, with the scan path at `state`.
    pub fn session(&self, state: &FrontEndState) -> Session {
        self.back.session(self.identity, Some(state.clone()), &[])
    }

    fn autosave_if_due(&mut self) {
        if self.autosave.is_due(self.now) && !self.back.nodes().is_empty() {
            self.autosave.begin();
            self.wait_for_state(PendingRequest::Autosave);
        }
    }

    /// Saves in the background.
    pub fn save(&mut self, state: &FrontEndState) {
        let session = Box::new(self.session(state));
        if !self.give(None, self.autosave.path.clone(), Work::Save(session)) {
            self.autosave.put_off(self.now);
        }
    }

    /// The process ends, with the front end of this number at `state`.
    fn end(&mut self, number: u32, state: &FrontEndState) {
        let same_front = number == self.front_number;
        if self.autosave.is_wanted() && same_front && !self.back.nodes().is_empty() {
            let work = Work::Save(Box::new(self.session(state)));
            // After what is being saved now, or the older would take the newer one's place.
            let _ = self.jobs.send(Job { request: None, path: self.autosave.path.clone(), work });
        }
    }
}
