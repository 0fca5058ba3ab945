//! Requests of people and programs to SLAM, and the responses: see [`msg::SlamRequestKind`].

use super::FrontCommand;
use super::back_end::WorkerState;
use super::file_jobs::DISK_PATIENCE;
use super::files::{FileJobOutcome, FileOperation};
use super::held_answers::HeldAnswers;
use super::pausing;
use super::refused::RequestRefused;
use crate::channel;
use crate::ports::{ChannelError, Ports, ReadPort, WritePort};
use crate::run::Run;
use crate::saved_files;
use crate::sessions::TOLD_SIGMA;
use ::slam::{ClosureReport, FrontEndState, InitialPose, LocalFrameEstimate};
use msg::{
    CLOSURES_MAX, ClosureInfo, InitialPoseKind, Pose2, RobotId, SlamMode, SlamOutcome, SlamRequest,
    SlamRequestKind, SlamResponse, Text,
};
use std::path::PathBuf;

/// Largest number of requests answered in one step, so that other work is not delayed.
const REQUESTS_MAX: usize = 16;
/// Requests that may wait for the scan path's state.
const PENDING_MAX: usize = 16;

/// Operation that waits for the scan path's state.
pub enum PendingRequest {
    /// Save what has changed.
    Autosave,
    /// Write the nodes that wait to the session log.
    LogRecord,
    /// Save a session to a file.
    Save(Box<SlamRequest>, PathBuf),
    /// Relocalize the robot at the given pose.
    SetPose(Box<SlamRequest>),
}

/// Outcome of a request that was accepted.
pub(super) enum RequestOutcome {
    /// It was done; the text is for people.
    Done(String),
    /// It was done, but is not saved; the text says why.
    NotSaved(String),
    /// It will be answered later.
    Deferred,
}

/// Outcome of a request, or the reason why it is refused.
pub(super) type RequestResult = Result<RequestOutcome, RequestRefused>;

fn done(text: &str) -> RequestResult {
    Ok(RequestOutcome::Done(text.to_owned()))
}

/// The channels of requests and responses.
pub struct Services<P: Ports> {
    dir: PathBuf,
    requests: P::Reader<SlamRequest>,
    responses: P::Writer<SlamResponse>,
    pub(super) paused: bool,
    /// The file that says that SLAM is paused.
    pub(super) pause_marker: PathBuf,
    pub(super) loading: bool,
    /// Answers that wait for the disk.
    pub(super) held: HeldAnswers,
}

impl<P: Ports> Services<P> {
    /// Opens the channels of a robot, whose SLAM may be paused.
    pub fn open(ports: &P, run: &Run, robot: RobotId, paused: bool) -> Result<Self, ChannelError> {
        Ok(Self {
            dir: run.dir.clone(),
            requests: ports.reader(&channel::slam_request(robot))?,
            responses: ports.writer(&channel::slam_response(robot))?,
            paused,
            pause_marker: pausing::marker(run, robot),
            loading: false,
            held: HeldAnswers::default(),
        })
    }

    /// Answers the requests that were received.
    pub fn serve(&mut self, state: &mut WorkerState) {
        for _ in 0..REQUESTS_MAX {
            let Some(request) = self.requests.receive().map(|request| *request) else { return };
            let outcome = match state.commands.is_full() {
                true => Err(RequestRefused::FrontEndBusy),
                false => self.apply(&request, state),
            };
            self.respond(&request, outcome, state);
        }
    }

    fn apply(&mut self, request: &SlamRequest, state: &mut WorkerState) -> RequestResult {
        let ask =
            SlamRequestKind::from_code(request.kind).ok_or(RequestRefused::UnknownRequest(request.kind))?;
        if self.loading && ask.changes_map() {
            return Err(RequestRefused::Loading);
        }
        match ask {
            SlamRequestKind::State => match state.disk_silence() {
                silence if silence < DISK_PATIENCE => done(""),
                silence => done(&format!(
                    "the disk has not answered for {} s; nothing is saved meanwhile",
                    silence.as_secs()
                )),
            },
            SlamRequestKind::Pause => self.pause(true, request, state),
            SlamRequestKind::Resume => self.pause(false, request, state),
            SlamRequestKind::Reset => self.reset(state),
            SlamRequestKind::SaveMap => self.save_map(request, state),
            SlamRequestKind::SaveSession => {
                has_map(state)?;
                let path = saved_files::session_to_save(&self.dir, request.text.as_str())?;
                defer_until_state(state, PendingRequest::Save(Box::new(*request), path))
            }
            SlamRequestKind::LoadSession => self.load_session(request, state),
            SlamRequestKind::SetPose => {
                has_map(state)?;
                pose_of(request)?;
                defer_until_state(state, PendingRequest::SetPose(Box::new(*request)))
            }
            SlamRequestKind::Relocalize => {
                has_map(state)?;
                state.back.start_relocalization(None);
                state.commands.send(FrontCommand::SetInitialEstimate(None));
                state.commands.send(FrontCommand::RequestNode);
                done("the robot is looked for in the whole map: from where it stands, and as it moves")
            }
            SlamRequestKind::ListClosures => done(""),
            SlamRequestKind::UndoClosure => self.undo_closure(request, state),
            SlamRequestKind::ClearClosures => self.clear_closures(state),
            SlamRequestKind::SetMode => {
                let mode = mode_of(request)?;
                if mode == SlamMode::Localization {
                    has_map(state)?;
                }
                state.set_mode(mode);
                done(&format!("mode is {}", mode.name()))
            }
        }
    }

    fn reset(&mut self, state: &mut WorkerState) -> RequestResult {
        let is_place_known = state.back.nodes().is_empty() || state.back.is_located();
        let mode = match state.back.mode() {
            // After a reset there is no map to localize in.
            SlamMode::Localization => SlamMode::Mapping,
            mode => mode,
        };
        let config = state.back.config().clone();
        let (front, back) = ::slam::create_or_resume(config, None, mode, InitialPose::Unknown);
        if !is_place_known {
            state.frame = state.frame.next();
        }
        state.replace(front, back, true);
        done(match is_place_known {
            true => "the map begins anew",
            false => {
                "the map begins anew, in a frame of its own, as nobody knew where the robot was: merging finds anew where it lies in the fleet's map"
            }
        })
    }

    fn save_map(&mut self, request: &SlamRequest, state: &mut WorkerState) -> RequestResult {
        has_map(state)?;
        let stem = saved_files::map_to_save(&self.dir, request.text.as_str())?;
        let grid = state.back.map().to_owned();
        let reasons = state.back.reliability_evidence().reasons().collect();
        self.submit(state, request, stem, FileOperation::Draw { grid, reasons })
    }

    fn load_session(&mut self, request: &SlamRequest, state: &mut WorkerState) -> RequestResult {
        let mode = mode_of(request)?;
        if InitialPoseKind::from_code(request.initial_pose_kind) == Some(InitialPoseKind::Given) {
            pose_of(request)?;
        }
        let mut files = saved_files::files_to_load(&self.dir, request.text.as_str())?;
        let work = FileOperation::Load {
            files: files.clone(),
            session: state.identity,
            mode,
            frame: state.frame.clone(),
        };
        let given = self.submit(state, request, files.swap_remove(0), work);
        self.loading = given.is_ok();
        given
    }

    fn undo_closure(&mut self, request: &SlamRequest, state: &mut WorkerState) -> RequestResult {
        may_change(state)?;
        if !state.back.undo_closure(request.number) {
            let count = state.back.closures().count();
            return Err(RequestRefused::NoClosure { number: request.number, count });
        }
        publish_changed_graph(state);
        done(&format!("closure {} is removed, and not accepted again", request.number))
    }

    fn clear_closures(&mut self, state: &mut WorkerState) -> RequestResult {
        may_change(state)?;
        let count = state.back.clear_closures();
        if count == 0 {
            return done("the graph has no closures");
        }
        publish_changed_graph(state);
        done(&format!("{count} removed, and not accepted again"))
    }

    /// Continues a request that waited for the scan path's state.
    pub fn resume(&mut self, state: &mut WorkerState, pending: PendingRequest, front: &FrontEndState) {
        match pending {
            PendingRequest::Autosave => state.save(front),
            PendingRequest::LogRecord => state.write_log(front),
            PendingRequest::Save(request, path) => {
                let session = Box::new(state.session(front));
                let outcome = self.submit(state, &request, path, FileOperation::Save(session, None));
                self.respond(&request, outcome, state);
            }
            PendingRequest::SetPose(request) => {
                let [m, rad] = TOLD_SIGMA;
                let or = |reported: f64, otherwise: f64| if reported > 0.0 { reported } else { otherwise };
                let local_from_base = front.last.map_or(Pose2::IDENTITY, |last| last.local_from_base);
                let map_from_local = request.pose * local_from_base.inverse();
                let estimate = LocalFrameEstimate {
                    map_from_local,
                    sigma_m: or(request.sigma_m, m),
                    sigma_rad: or(request.sigma_rad, rad),
                };
                state.back.start_relocalization(Some(estimate));
                state.commands.send(FrontCommand::SetInitialEstimate(Some(estimate)));
                state.commands.send(FrontCommand::RequestNode);
                self.respond(&request, done("the robot is looked for around there"), state);
            }
        }
    }

    /// Answers a request whose file was read or written.
    pub fn finish_job(&mut self, state: &mut WorkerState, outcome: FileJobOutcome) {
        let FileJobOutcome { request: Some(request), path, result, .. } = outcome else { return };
        if !self.held.finish_file() {
            // It was answered that the disk does not answer: a session that is loaded too late is not used.
            return;
        }
        let loads = request.kind == SlamRequestKind::LoadSession as u32;
        self.loading &= !loads;
        if let Some(answer) = pausing::answer(&request, result.as_ref().map(|_| ())) {
            return self.respond(&request, Ok(answer), state);
        }
        let outcome = result.map(|loaded| {
            let text = match &loaded {
                Some(loaded) => {
                    let (nodes, note) = (loaded.back.nodes().len(), loaded.note);
                    format!("{}: {nodes} nodes; the robot is looked for{note}", path.display())
                }
                None => path.display().to_string(),
            };
            if let Some(loaded) = loaded {
                state.load(*loaded);
            }
            RequestOutcome::Done(text)
        });
        let outcome = outcome.map_err(RequestRefused::File);
        self.respond(&request, outcome, state);
    }

    /// Answers a request; of one that changes the map, when the session with the change is saved.
    fn respond(&mut self, request: &SlamRequest, outcome: RequestResult, state: &mut WorkerState) {
        let outcome = match outcome {
            Ok(RequestOutcome::Done(text)) => match self.held.hold(request, text, state) {
                Some(text) => Ok(state.with_unsaved_note(request, text)),
                None => return,
            },
            outcome => outcome,
        };
        self.send_response(request, outcome, state);
    }

    /// Sends the response to a request.
    pub(super) fn send_response(
        &mut self,
        request: &SlamRequest,
        outcome: RequestResult,
        state: &WorkerState,
    ) {
        let (outcome, text) = match outcome {
            Ok(RequestOutcome::Deferred) => return,
            Ok(RequestOutcome::Done(text)) => (SlamOutcome::Done, text),
            Ok(RequestOutcome::NotSaved(text)) => (SlamOutcome::NotSaved, text),
            Err(why) => (SlamOutcome::Refused, why.to_string()),
        };
        let (back, counts) = (&state.back, state.back.counts());
        let mut answer = SlamResponse {
            client: request.client,
            id: request.id,
            outcome: outcome as u32,
            mode: back.mode() as u32,
            paused: self.paused.into(),
            located: match back.is_located() && back.map_from_base().is_some() {
                true if back.is_unconfirmed() => SlamResponse::UNCONFIRMED,
                is_located => is_located.into(),
            },
            nodes: counts.nodes as u32,
            links: counts.links as u32,
            closures: counts.closures as u32,
            retracted: counts.retracted as u32,
            listable: back.closures().count() as u32,
            map_from_base: back.map_from_base().unwrap_or_default(),
            text: Text::shortened(&text),
            ..SlamResponse::default()
        };
        answer.header.stamp = back.nodes().last().map(|node| node.header.stamp).unwrap_or_default();
        if request.kind == SlamRequestKind::ListClosures as u32 {
            let asked_for = back.closures().skip(request.number as usize).take(CLOSURES_MAX);
            for (place, closure) in answer.list.iter_mut().zip(asked_for) {
                *place = info(&closure);
                answer.listed += 1;
            }
        }
        self.responses.send(&answer);
    }
}

fn defer_until_state(state: &mut WorkerState, pending: PendingRequest) -> RequestResult {
    if state.pending() >= PENDING_MAX {
        return Err(RequestRefused::TooManyRequests);
    }
    state.defer_until_state(pending);
    Ok(RequestOutcome::Deferred)
}

fn has_map(state: &WorkerState) -> Result<(), RequestRefused> {
    let empty = state.back.nodes().is_empty();
    if empty { Err(RequestRefused::EmptyMap) } else { Ok(()) }
}

/// Refuses to remove closures in localization, where the map is fixed.
fn may_change(state: &WorkerState) -> Result<(), RequestRefused> {
    if state.back.mode() == SlamMode::Localization {
        return Err(RequestRefused::MapIsFixed);
    }
    if state.back.map_from_base().is_none() {
        return Err(RequestRefused::Relocalizing);
    }
    Ok(())
}

/// Sends the scan path its new pose, and how good it is, after the graph has changed.
fn publish_changed_graph(state: &mut WorkerState) {
    state.mark_changed();
    state.commands.send(FrontCommand::ApplyFrameUpdateNow(state.back.latest_frame_update()));
}

fn mode_of(request: &SlamRequest) -> Result<SlamMode, RequestRefused> {
    SlamMode::from_code(request.mode).ok_or(RequestRefused::UnknownMode(request.mode))
}

fn pose_of(request: &SlamRequest) -> Result<Pose2, RequestRefused> {
    let sound = request.pose.is_finite() && request.sigma_m.is_finite() && request.sigma_rad.is_finite();
    sound.then_some(request.pose).ok_or(RequestRefused::PoseNotFinite)
}

fn info(closure: &ClosureReport) -> ClosureInfo {
    ClosureInfo {
        number: closure.number,
        older: closure.older,
        newer: closure.newer,
        is_active: closure.is_active.into(),
        older_from_newer: closure.older_from_newer,
        map_from_older: closure.poses[0],
        map_from_newer: closure.poses[1],
        response: closure.response,
        chi_squared: closure.chi_squared as f32,
    }
}

#[cfg(test)]
mod tests;
