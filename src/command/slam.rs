//! Tool `mr-slam slam ROBOT`, which controls a robot's SLAM in a running fleet, as SLAM Toolbox's services do.

use super::output;
use super::robot_choice::{RobotChoice, RobotChoiceError};
use super::run_args::RunArgs;
use crate::channel::{self, Opener, Program};
use crate::clock::now;
use crate::config::{Mode, RobotSource};
use crate::ports::ChannelError;
use crate::process::pose;
use crate::run::{Run, RunError};
use crate::shared_memory::{Listener, Participant, Reader, Writer, let_readers_look, wait};
use msg::{
    ClosureInfo, CommandSource, InitialPoseKind, Monotonic, Pose2, RobotId, SlamMode, SlamOutcome,
    SlamRequest, SlamRequestKind, SlamResponse, Text,
};
use reports::SlamView;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// How long SLAM may take to report its state: a worker that died is back by then.
const STATE_PATIENCE: Duration = Duration::from_secs(5);
/// Period at which the request is repeated: a worker that is not there yet does not receive it.
const ASK_AGAIN: Duration = Duration::from_millis(500);
/// How long a request may take: the longest one writes a large map to a slow disk.
const WORK_PATIENCE: Duration = Duration::from_secs(60);
/// How long the tool waits for a robot to be relocalized.
const FOUND_PATIENCE: Duration = Duration::from_secs(3);

/// Control a robot's SLAM in a running fleet
#[derive(Clone, Debug, clap::Args)]
pub struct SlamArgs {
    /// Robot: `robot1`, 1, or its name
    #[arg(value_name = "ROBOT")]
    pub robot: RobotChoice,
    /// Request to the robot's SLAM
    #[command(subcommand)]
    pub action: SlamAction,
    /// Folder of the run; needed if several fleets run and something is to be changed [default: the newest run]
    #[arg(long, value_name = "DIR", global = true)]
    pub run_dir: Option<PathBuf>,
    /// Print the answer as JSON
    #[arg(long, global = true)]
    pub json: bool,
}

/// Request to a robot's SLAM.
#[derive(Clone, Debug, clap::Subcommand)]
pub enum SlamAction {
    /// Show mode, graph, closures and the robot's pose
    State,
    /// Ignore scans until `resume`
    Pause,
    /// Use scans again
    Resume,
    /// Delete the map and begin a new one where the robot is
    Reset,
    /// Save the session in a file (.slam is added unless the name ends with it)
    Save {
        /// File, relative to the current folder
        #[arg(value_name = "FILE")]
        file: PathBuf,
    },
    /// Load a session, or with --localize a map (.yaml), and relocalize the robot in it
    Load {
        /// File, relative to the current folder; .slam may be left out
        #[arg(value_name = "FILE")]
        file: PathBuf,
        /// Leave the map unchanged
        #[arg(long, conflicts_with = "mode")]
        localize: bool,
        /// Use of the map
        #[arg(long, value_enum, default_value_t)]
        mode: Mode,
        /// Approximate pose of the robot in the map: metres, metres, radians
        #[arg(long, value_name = "X,Y,YAW", value_parser = pose)]
        at: Option<Pose2>,
        /// Place the robot at the session's first scan
        #[arg(long, conflicts_with_all = ["at", "at_last"])]
        at_first: bool,
        /// Place the robot at the session's last scan
        #[arg(long, conflicts_with = "at")]
        at_last: bool,
    },
    /// Write the map: FILE.pgm and .yaml for map_server, .png for people
    Map {
        /// File, relative to the current folder
        #[arg(value_name = "FILE")]
        file: PathBuf,
    },
    /// List the loop closures
    Closures,
    /// Remove a loop closure and never accept it again
    Undo {
        /// Number in the list of closures
        #[arg(value_name = "N")]
        number: u32,
    },
    /// Remove all loop closures
    Clear,
    /// Search for the robot in its whole map
    Relocalize,
    /// Set the robot's approximate pose
    Pose {
        /// Pose in `robotK/map`: metres, metres, radians
        #[arg(value_name = "X,Y,YAW", value_parser = pose)]
        pose: Pose2,
    },
    /// Change the use of the map
    Mode {
        /// Use of the map
        #[arg(value_name = "MODE", value_enum)]
        mode: Mode,
    },
}

/// Reason why a request was not done.
#[derive(Debug, thiserror::Error)]
pub enum SlamCommandError {
    /// SLAM did not answer at all.
    #[error("{0}'s SLAM does not answer; it may be restarting: see `mr-slam status`, then try again")]
    Silent(RobotId),
    /// The robot is on another machine, with its SLAM.
    #[error(
        "{0}'s SLAM runs on the robot's own machine, not at the base: run the same command there, as `mr-slam slam 1 ...`"
    )]
    OtherMachine(String),
    /// SLAM was there and did not finish the request.
    #[error(
        "{0}'s SLAM has not finished within {wait} s; it may have died, or the disk does not answer: `mr-slam slam {0} state` says what holds",
        wait = WORK_PATIENCE.as_secs_f64()
    )]
    Unfinished(RobotId),
    /// SLAM has done it, but could not save it.
    #[error("{robot}'s SLAM has done it: {why}")]
    NotSaved {
        /// Robot that was asked.
        robot: RobotId,
        /// Answer of SLAM, with the reason.
        why: String,
    },
    /// SLAM refused the request.
    #[error("{robot}'s SLAM refuses: {why}")]
    Refused {
        /// Robot that was asked.
        robot: RobotId,
        /// Reason of SLAM.
        why: String,
    },
    /// The fleet does not have this robot.
    #[error(transparent)]
    NoRobot(#[from] RobotChoiceError),
    /// The path is too long for a message, or not UTF-8.
    #[error("{0}: expected a path in UTF-8 of at most {max} bytes", max = msg::TEXT_MAX)]
    Path(String),
    /// The path names a folder.
    #[error("{0} names a folder; expected a file")]
    Folder(String),
    /// Shared memory of the run.
    #[error(transparent)]
    Channel(#[from] ChannelError),
    /// No run, or several and none was named.
    #[error(transparent)]
    Run(#[from] RunError),
    /// The answer cannot be written to standard output.
    #[error(transparent)]
    Print(#[from] std::io::Error),
}

/// Client of one robot's SLAM; one request at a time.
pub struct SlamClient {
    robot: RobotId,
    client: u64,
    asked: u64,
    answers: Reader<SlamResponse>,
    listener: Listener,
    requests: Writer<SlamRequest>,
    // The ports' presence in the run; dropped after them.
    _participant: Participant,
}

impl SlamClient {
    /// Attaches to the SLAM of one of a run's robots.
    pub fn attach(run: &Run, robot: RobotId) -> Result<Self, SlamCommandError> {
        let client = u64::from(std::process::id());
        let node =
            Participant::open(&run.domain, Opener::of_fleet(Program::SlamTool), &format!("ask {robot}"))?;
        Ok(Self {
            robot,
            client,
            // Not what an earlier one of the same process has counted.
            asked: now().0,
            answers: node.reader(&channel::slam_response(robot))?,
            listener: node.listener(&channel::slam_response(robot))?,
            requests: node.writer(&channel::slam_request(robot))?,
            _participant: node,
        })
    }

    /// Returns the state of SLAM.
    pub fn state(&mut self) -> Result<SlamResponse, SlamCommandError> {
        let begun = Instant::now();
        while begun.elapsed() < STATE_PATIENCE {
            let asked = self.send(
                &SlamRequest { kind: SlamRequestKind::State as u32, ..SlamRequest::default() },
                ASK_AGAIN,
            );
            if let Some(answer) = asked {
                return Ok(answer);
            }
        }
        Err(SlamCommandError::Silent(self.robot))
    }

    /// Sends a request once SLAM is known to be there, and waits for the response.
    pub fn request(&mut self, request: &SlamRequest) -> Result<SlamResponse, SlamCommandError> {
        self.state()?;
        let answer = self.send(request, WORK_PATIENCE).ok_or(SlamCommandError::Unfinished(self.robot))?;
        match answer.outcome() {
            SlamOutcome::Done => Ok(answer),
            SlamOutcome::NotSaved => {
                Err(SlamCommandError::NotSaved { robot: self.robot, why: answer.text.as_str().into() })
            }
            SlamOutcome::Refused => {
                Err(SlamCommandError::Refused { robot: self.robot, why: answer.text.as_str().into() })
            }
        }
    }

    fn send(&mut self, request: &SlamRequest, patience: Duration) -> Option<SlamResponse> {
        self.asked += 1;
        let sender = CommandSource::LAPTOP;
        self.requests.send(&SlamRequest { client: self.client, id: self.asked, sender, ..*request });
        let until = Monotonic(now().0 + patience.as_nanos() as u64);
        while now() < until {
            wait([&self.listener], until);
            while let Some(answer) = self.answers.receive() {
                if (answer.client, answer.id) == (self.client, self.asked) {
                    return Some(*answer);
                }
            }
        }
        None
    }

    /// Returns all closures; one response holds a part of them.
    fn closures(&mut self) -> Result<Vec<ClosureInfo>, SlamCommandError> {
        let mut all: Vec<ClosureInfo> = Vec::new();
        loop {
            let request = SlamRequest {
                kind: SlamRequestKind::ListClosures as u32,
                number: all.len() as u32,
                ..SlamRequest::default()
            };
            let answer = self.request(&request)?;
            all.extend(answer.closures());
            if answer.listed == 0 || all.len() >= answer.listable as usize {
                return Ok(all);
            }
        }
    }

    /// Waits for a while until the robot is relocalized; returns the newest state.
    fn wait_until_located(&mut self, mut answer: SlamResponse) -> Result<SlamResponse, SlamCommandError> {
        let begun = Instant::now();
        // Until it has looked once, it may not know that it has to.
        while begun.elapsed() < FOUND_PATIENCE {
            std::thread::sleep(ASK_AGAIN);
            answer = SlamResponse { text: answer.text, ..self.state()? };
            if answer.located == 1 {
                break;
            }
        }
        Ok(answer)
    }
}

impl SlamAction {
    fn request(&self) -> Result<SlamRequest, SlamCommandError> {
        let ask = |kind: SlamRequestKind| SlamRequest { kind: kind as u32, ..SlamRequest::default() };
        let mode_code = |mode: Mode| SlamMode::from(mode) as u32;
        Ok(match self {
            Self::State => ask(SlamRequestKind::State),
            Self::Pause => ask(SlamRequestKind::Pause),
            Self::Resume => ask(SlamRequestKind::Resume),
            Self::Reset => ask(SlamRequestKind::Reset),
            Self::Save { file } => SlamRequest { text: text(file)?, ..ask(SlamRequestKind::SaveSession) },
            Self::Map { file } => SlamRequest { text: text(file)?, ..ask(SlamRequestKind::SaveMap) },
            Self::Load { file, localize, mode, at, at_first, at_last } => {
                let kind = match (at, at_first, at_last) {
                    (Some(_), _, _) => InitialPoseKind::Given,
                    (None, true, _) => InitialPoseKind::FirstNode,
                    (None, _, true) => InitialPoseKind::LastNode,
                    _ => InitialPoseKind::Unknown,
                };
                SlamRequest {
                    text: text(file)?,
                    mode: mode_code(if *localize { Mode::Localization } else { *mode }),
                    initial_pose_kind: kind as u32,
                    pose: at.unwrap_or_default(),
                    ..ask(SlamRequestKind::LoadSession)
                }
            }
            Self::Closures => ask(SlamRequestKind::ListClosures),
            Self::Undo { number } => SlamRequest { number: *number, ..ask(SlamRequestKind::UndoClosure) },
            Self::Clear => ask(SlamRequestKind::ClearClosures),
            Self::Relocalize => ask(SlamRequestKind::Relocalize),
            Self::Pose { pose } => SlamRequest { pose: *pose, ..ask(SlamRequestKind::SetPose) },
            Self::Mode { mode } => SlamRequest { mode: mode_code(*mode), ..ask(SlamRequestKind::SetMode) },
        })
    }

    /// Returns whether the request changes the robot's SLAM, or a file that depends on which fleet is meant.
    fn changes(&self) -> bool {
        !matches!(self, Self::State | Self::Closures)
    }

    /// Formats the response for people. A change names the run.
    fn text(&self, view: &SlamView<'_>) -> String {
        let mut text = String::new();
        if !view.text.is_empty() {
            text += &format!("{}\n", view.text);
        }
        match self {
            Self::State => text += &view.table(),
            Self::Closures => text += &view.closure_table(),
            action if action.relocalizes() => text += &view.pose_sentence(),
            _ => {}
        }
        if self.changes() {
            text += &format!("{} of run {}\n", view.robot, view.run.display());
        }
        text
    }

    /// Returns whether the robot is relocalized after the request.
    fn relocalizes(&self) -> bool {
        matches!(self, Self::Load { .. } | Self::Relocalize | Self::Pose { .. })
    }
}

/// Converts a path for SLAM, which may run in another folder.
fn text(file: &Path) -> Result<Text, SlamCommandError> {
    if file.file_name().is_none() || file.as_os_str().as_encoded_bytes().ends_with(b"/") {
        return Err(SlamCommandError::Folder(file.display().to_string()));
    }
    let whole = std::path::absolute(file).unwrap_or(file.to_owned());
    let text = whole.to_str().and_then(Text::new);
    text.ok_or_else(|| SlamCommandError::Path(whole.display().to_string()))
}

/// Checks that the robot's SLAM runs on this machine: at a base none does.
fn check_is_here(run: &Run, robot: RobotId) -> Result<(), SlamCommandError> {
    if run.config.world == RobotSource::Robots {
        return Err(SlamCommandError::OtherMachine(run.config.robot_name(robot)));
    }
    Ok(())
}

/// Sends the request and prints the response.
pub fn run(args: &SlamArgs) -> Result<(), SlamCommandError> {
    let request = args.action.request()?;
    let run = RunArgs { run_dir: args.run_dir.clone() };
    let run = if args.action.changes() { run.open_to_change()? } else { run.open()? };
    let robot = args.robot.find(&run)?;
    check_is_here(&run, robot)?;
    let mut client = SlamClient::attach(&run, robot)?;
    let answer = client.request(&request);
    if !matches!(args.action, SlamAction::State) {
        // A recorder, which records all but questions for the state, may not have looked yet.
        let_readers_look();
    }
    let mut response = answer?;
    let closures = match args.action {
        SlamAction::Closures => Some(client.closures()?),
        _ => None,
    };
    if args.action.relocalizes() {
        response = client.wait_until_located(response)?;
    }
    let view = SlamView::new(&run.dir, robot, &response, closures.as_deref());
    Ok(output::print_either(args.json, &view, || args.action.text(&view))?)
}

#[cfg(test)]
mod tests;
