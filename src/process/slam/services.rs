//! What people and other programs ask of SLAM, and what it answers: see [`msg::SlamRequestKind`].

use super::Order;
use super::beside::Beside;
use super::files::{Done, Work};
use crate::channel;
use crate::ports::ChannelError;
use crate::run::Run;
use crate::sessions::TOLD_SIGMA;
use crate::shared_memory::{Participant, Reader, Writer};
use ::slam::{ClosureReport, FrontState, Hint, Start};
use msg::{
    CLOSURES_MAX, ClosureInfo, Pose2, RobotId, SlamMode, SlamOutcome, SlamRequest, SlamRequestKind,
    SlamResponse, StartPose, Text,
};
use std::path::{Component, Path, PathBuf};

/// Requests answered before other work has its turn.
const REQUESTS_MAX: usize = 16;
/// Requests that wait for the scan path, at most.
const WAITING_MAX: usize = 16;
/// The ending of a session's file that was given none.
const SESSION_ENDING: &str = "slam";

/// What is done when it is known where the scan path is.
pub enum Waiting {
    /// Save what has changed.
    Autosave,
    /// Save a session.
    Save(Box<SlamRequest>, PathBuf),
    /// Look for the robot where it is said to be.
    Pose(Box<SlamRequest>),
}

/// Either done, with a word about it, or to be answered later; or why not.
type Outcome = Result<Option<String>, String>;

/// The door for requests.
pub struct Services {
    dir: PathBuf,
    requests: Reader<SlamRequest>,
    answers: Writer<SlamResponse>,
    paused: bool,
    loading: bool,
}

impl Services {
    /// The robot's requests are answered by whoever has this.
    pub fn open(node: &Participant, run: &Run, robot: RobotId) -> Result<Self, ChannelError> {
        Ok(Self {
            dir: run.dir.clone(),
            requests: node.reader(&channel::slam_request(robot))?,
            answers: node.writer(&channel::slam_response(robot))?,
            paused: false,
            loading: false,
        })
    }

    /// Does what is asked for.
    pub fn serve(&mut self, beside: &mut Beside) {
        for _ in 0..REQUESTS_MAX {
            let Some(request) = self.requests.receive().map(|request| *request) else { return };
            let outcome = self.obey(&request, beside);
            self.answer(&request, outcome, beside);
        }
    }

    fn obey(&mut self, request: &SlamRequest, beside: &mut Beside) -> Outcome {
        let ask = SlamRequestKind::from_code(request.kind)
            .ok_or_else(|| format!("request code {} means nothing here", request.kind))?;
        let done = |text: &str| Ok(Some(text.to_owned()));
        match ask {
            SlamRequestKind::State => done(""),
            SlamRequestKind::Pause | SlamRequestKind::Resume => {
                self.paused = ask == SlamRequestKind::Pause;
                beside.order(Order::Pause(self.paused));
                done(if self.paused { "new scans are not looked at" } else { "scans are looked at again" })
            }
            SlamRequestKind::Reset => {
                let mode = match beside.back.mode() {
                    // There is no map left to localize in.
                    SlamMode::Localization => SlamMode::Mapping,
                    mode => mode,
                };
                let config = beside.back.config().clone();
                let (front, back) = ::slam::begin(config, None, mode, Start::Unknown);
                beside.begin(front, back, true);
                done("the map begins anew")
            }
            SlamRequestKind::SaveMap => {
                has_map(beside)?;
                let stem = file_path(&self.dir, request.text.as_str(), None)?;
                let stem = match stem.extension().and_then(|ending| ending.to_str()) {
                    Some("yaml" | "yml" | "pgm" | "png") => stem.with_extension(""),
                    _ => stem,
                };
                let grid = beside.back.map().to_owned();
                give(beside, request, stem, Work::Draw(grid))
            }
            SlamRequestKind::SaveSession => {
                has_map(beside)?;
                let path = self.session_path(request)?;
                wait_for_state(beside, Waiting::Save(Box::new(*request), path))
            }
            SlamRequestKind::LoadSession => {
                if self.loading {
                    return Err("another file is being loaded; try again when it is".into());
                }
                let mode = mode_of(request)?;
                if StartPose::from_code(request.start) == Some(StartPose::Given) {
                    pose_of(request)?;
                }
                let path = self.session_path(request)?;
                let given = give(beside, request, path, Work::Load(beside.identity, mode));
                self.loading = given.is_ok();
                given
            }
            SlamRequestKind::SetPose => {
                has_map(beside)?;
                pose_of(request)?;
                wait_for_state(beside, Waiting::Pose(Box::new(*request)))
            }
            SlamRequestKind::Relocalize => {
                has_map(beside)?;
                beside.back.seek(None);
                beside.order(Order::Place(None));
                beside.order(Order::WantNode);
                done("the robot is looked for in the whole map: from where it stands, and as it moves")
            }
            SlamRequestKind::ListClosures => done(""),
            SlamRequestKind::UndoClosure => {
                may_change(beside)?;
                if !beside.back.undo_closure(request.number) {
                    let count = beside.back.closures().count();
                    let why = format!("there is no closure {} in force; {count} were made", request.number);
                    return Err(why);
                }
                bent(beside);
                done(&format!("closure {} is taken back, and not believed again", request.number))
            }
            SlamRequestKind::ClearClosures => {
                may_change(beside)?;
                let count = beside.back.clear_closures();
                if count == 0 {
                    return done("there was no closure in force");
                }
                bent(beside);
                done(&format!("{count} taken back, and not believed again"))
            }
            SlamRequestKind::SetMode => {
                let mode = mode_of(request)?;
                if mode == SlamMode::Localization {
                    has_map(beside)?;
                }
                beside.back.set_mode(mode);
                beside.changed();
                done(&format!("mode is {}", mode.name()))
            }
        }
    }

    /// The scan path has said where it is.
    pub fn go_on(&mut self, beside: &mut Beside, waiting: Waiting, state: &FrontState) {
        match waiting {
            Waiting::Autosave => beside.autosave(state),
            Waiting::Save(request, path) => {
                let session = Box::new(beside.session(state));
                let outcome = give(beside, &request, path, Work::Save(session));
                self.answer(&request, outcome, beside);
            }
            Waiting::Pose(request) => {
                let [m, rad] = TOLD_SIGMA;
                let or = |told: f64, otherwise: f64| if told > 0.0 { told } else { otherwise };
                let local_from_base = state.last.map_or(Pose2::IDENTITY, |last| last.local_from_base);
                let map_from_local = request.pose * local_from_base.inverse();
                beside.back.seek(Some(Hint {
                    map_from_local,
                    sigma_m: or(request.sigma_m, m),
                    sigma_rad: or(request.sigma_rad, rad),
                }));
                beside.order(Order::Place(Some(map_from_local)));
                beside.order(Order::WantNode);
                self.answer(&request, Ok(Some("the robot is looked for around there".into())), beside);
            }
        }
    }

    /// A file that was asked for is done with.
    pub fn done(&mut self, beside: &mut Beside, done: Done) {
        let Done { request: Some(request), path, result, took: _ } = done else { return };
        let loads = request.kind == SlamRequestKind::LoadSession as u32;
        self.loading &= !loads;
        let outcome = result.map(|loaded| {
            let text = match &loaded {
                Some(loaded) => {
                    format!(
                        "{}: {} nodes; the robot is looked for",
                        path.display(),
                        loaded.back.nodes().len()
                    )
                }
                None => path.display().to_string(),
            };
            if let Some(loaded) = loaded {
                beside.load(*loaded);
            }
            Some(text)
        });
        self.answer(&request, outcome, beside);
    }

    fn session_path(&self, request: &SlamRequest) -> Result<PathBuf, String> {
        file_path(&self.dir, request.text.as_str(), Some(SESSION_ENDING))
    }

    fn answer(&mut self, request: &SlamRequest, outcome: Outcome, beside: &Beside) {
        let (outcome, text) = match outcome {
            Ok(None) => return,
            Ok(Some(text)) => (SlamOutcome::Done, text),
            Err(why) => (SlamOutcome::Refused, why),
        };
        let (back, counts) = (&beside.back, beside.back.counts());
        let mut answer = SlamResponse {
            client: request.client,
            id: request.id,
            outcome: outcome as u32,
            mode: back.mode() as u32,
            paused: self.paused.into(),
            located: (back.located() && back.map_from_base().is_some()).into(),
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
        self.answers.send(&answer);
    }
}

/// The file that is meant: relative names lie below the run's folder.
fn file_path(dir: &Path, name: &str, ending: Option<&str>) -> Result<PathBuf, String> {
    let named = Path::new(name);
    if named.file_name().is_none() || name.contains(char::is_control) {
        return Err(format!("'{}' names no file", name.escape_debug()));
    }
    let inside = named.components().all(|part| matches!(part, Component::Normal(_)));
    if !named.is_absolute() && !inside {
        return Err(format!("'{name}' leads out of the run's folder"));
    }
    let mut path = dir.join(named);
    if let (Some(ending), None) = (ending, path.extension()) {
        path.set_extension(ending);
    }
    Ok(path)
}

fn give(beside: &Beside, request: &SlamRequest, path: PathBuf, work: Work) -> Outcome {
    match beside.give(Some(request), path, work) {
        true => Ok(None),
        false => Err("too many files are being written; try again in a moment".into()),
    }
}

fn wait_for_state(beside: &mut Beside, waiting: Waiting) -> Outcome {
    if beside.waiting() >= WAITING_MAX {
        return Err("too many requests wait; try again in a moment".into());
    }
    beside.wait_for_state(waiting);
    Ok(None)
}

fn has_map(beside: &Beside) -> Result<(), String> {
    let empty = beside.back.nodes().is_empty();
    if empty { Err("there is nothing in the map yet: no scan has come".into()) } else { Ok(()) }
}

/// Whether closures may be taken back now.
fn may_change(beside: &Beside) -> Result<(), String> {
    if beside.back.mode() == SlamMode::Localization {
        return Err("in localization the map stays as it is; set the mode to mapping first".into());
    }
    if beside.back.map_from_base().is_none() {
        return Err("while the robot is looked for, the map stays as it is".into());
    }
    Ok(())
}

/// The graph has changed: the scan path hears where it is now.
fn bent(beside: &mut Beside) {
    beside.changed();
    beside.order(Order::Place(Some(beside.back.newest_revision().map_from_local)));
}

fn mode_of(request: &SlamRequest) -> Result<SlamMode, String> {
    SlamMode::from_code(request.mode).ok_or_else(|| format!("mode code {} means nothing here", request.mode))
}

fn pose_of(request: &SlamRequest) -> Result<Pose2, String> {
    let sound = request.pose.is_finite() && request.sigma_m.is_finite() && request.sigma_rad.is_finite();
    sound.then_some(request.pose).ok_or_else(|| "the pose has numbers that are not finite".into())
}

fn info(closure: &ClosureReport) -> ClosureInfo {
    ClosureInfo {
        number: closure.number,
        older: closure.older,
        newer: closure.newer,
        in_force: closure.in_force.into(),
        older_from_newer: closure.older_from_newer,
        map_from_older: closure.poses[0],
        map_from_newer: closure.poses[1],
        response: closure.response,
        chi_squared: closure.chi_squared as f32,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn files_lie_where_they_are_said_to() {
        let dir = Path::new("/run");
        let path = |name| file_path(dir, name, Some("slam")).map(|path| path.display().to_string());
        assert_eq!(path("monday").unwrap(), "/run/monday.slam");
        assert_eq!(path("maps/monday.yaml").unwrap(), "/run/maps/monday.yaml");
        assert_eq!(path("/elsewhere/a.slam").unwrap(), "/elsewhere/a.slam");
        for (name, reason) in
            [("../a", "leads out"), ("a/../../b", "leads out"), ("", "no file"), ("a\n", "no file")]
        {
            assert!(path(name).unwrap_err().contains(reason), "{name}");
        }
    }

    proptest! {
        #[test]
        fn no_relative_name_leads_out(name in "[a./\\\\-]{0,12}") {
            let dir = Path::new("/run");
            if let Ok(path) = file_path(dir, &name, None)
                && !name.starts_with('/')
            {
                prop_assert!(path.starts_with(dir) && path != dir);
                prop_assert!(!path.components().any(|part| part == Component::ParentDir));
            }
        }
    }
}
