//! `mr-slam slam ROBOT ...`: asks a robot's SLAM in a running fleet, as SLAM Toolbox's services are asked.

use crate::channel::{self, Opener, Program};
use crate::clock::now;
use crate::control::RunArgs;
use crate::ports::ChannelError;
use crate::process::{Error, pose};
use crate::run::Run;
use crate::sessions::Mode;
use crate::shared_memory::{Listener, Participant, Reader, Writer, wait};
use msg::{
    ClosureInfo, Monotonic, Pose2, RobotId, SlamMode, SlamOutcome, SlamRequest, SlamRequestKind,
    SlamResponse, StartPose, Text,
};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// How long SLAM may take to say how it stands: a worker that died is back by then.
const STATE_PATIENCE: Duration = Duration::from_secs(5);
/// It is asked again after this: who is not there yet hears nothing.
const ASK_AGAIN: Duration = Duration::from_millis(500);
/// How long it may take to do what is asked: to write a large map to a slow disk.
const WORK_PATIENCE: Duration = Duration::from_secs(60);
/// How long a robot is watched that is looked for.
const FOUND_PATIENCE: Duration = Duration::from_secs(3);

/// Ask a robot's SLAM in a running fleet
#[derive(Clone, Debug, clap::Args)]
pub struct SlamArgs {
    /// Which: `robot1`, or 1
    #[arg(value_name = "ROBOT", value_parser = robot)]
    pub robot: RobotId,
    /// What is asked
    #[command(subcommand)]
    pub ask: Ask,
    /// The run's folder; without it, the fleet started last
    #[arg(long, value_name = "DIR", global = true)]
    pub run_dir: Option<PathBuf>,
    /// Print the answer as JSON
    #[arg(long, global = true)]
    pub json: bool,
}

/// What is asked.
#[derive(Clone, Debug, clap::Subcommand)]
pub enum Ask {
    /// How it stands: mode, map, closures, where the robot is
    State,
    /// Look at no more scans
    Pause,
    /// Look at scans again
    Resume,
    /// Forget the map; it begins anew where the robot is
    Reset,
    /// Keep the session in a file (.slam if it has no ending)
    Save {
        /// Which; relative to the present folder
        #[arg(value_name = "FILE")]
        file: PathBuf,
    },
    /// Take a session, or with --localize a map (.yaml); the robot is looked for in it
    Load {
        /// Which; relative to the present folder
        #[arg(value_name = "FILE")]
        file: PathBuf,
        /// Leave the map as it is
        #[arg(long, conflicts_with = "mode")]
        localize: bool,
        /// What to do with the map
        #[arg(long, value_enum, default_value_t)]
        mode: Mode,
        /// The robot stands here in the map, about
        #[arg(long, value_name = "X,Y,YAW", value_parser = pose, allow_hyphen_values = true)]
        at: Option<Pose2>,
        /// The robot stands where the session's first scan was taken
        #[arg(long, conflicts_with_all = ["at", "at_last"])]
        at_first: bool,
        /// The robot stands where its last scan was taken
        #[arg(long, conflicts_with = "at")]
        at_last: bool,
    },
    /// Write the map: FILE.pgm and .yaml for map_server, .png for people
    Map {
        /// Where; relative to the present folder
        #[arg(value_name = "FILE")]
        file: PathBuf,
    },
    /// List the closures
    Closures,
    /// Take a closure back, and believe it no more
    Undo {
        /// Its number in the list
        #[arg(value_name = "N")]
        number: u32,
    },
    /// Take all closures back
    Clear,
    /// Look for the robot in its whole map
    Relocalize,
    /// Say where the robot is, about
    Pose {
        /// In `robotK/map`, metres and radians
        #[arg(value_name = "X,Y,YAW", value_parser = pose, allow_hyphen_values = true)]
        pose: Pose2,
    },
    /// Go on with the map in another mode
    Mode {
        /// Which
        #[arg(value_name = "MODE", value_enum)]
        mode: Mode,
    },
}

fn robot(text: &str) -> Result<RobotId, String> {
    let number = text.strip_prefix("robot").unwrap_or(text).parse().ok();
    number.and_then(RobotId::new).ok_or_else(|| "expected robot1, robot2 ... or the number alone".into())
}

/// Why there is no answer.
#[derive(Debug, thiserror::Error)]
pub enum AskError {
    /// It is not there.
    #[error(
        "{0}'s SLAM does not answer; `mr-slam status` shows whether it is up, and a dead one is started again: try again"
    )]
    Silent(RobotId),
    /// It was there, and then said no more.
    #[error(
        "{0}'s SLAM has not finished within {WORK_PATIENCE:?}; it may have died meanwhile: `mr-slam slam {0} state` says how it stands"
    )]
    Unfinished(RobotId),
    /// It said no.
    #[error("{robot}'s SLAM refuses: {why}")]
    Refused {
        /// Which.
        robot: RobotId,
        /// Its reason.
        why: String,
    },
    /// The fleet has no such robot.
    #[error("this fleet has robots 1 to {robots}, not {number}")]
    NoRobot {
        /// How many it has.
        robots: usize,
        /// Which was meant.
        number: usize,
    },
    /// A path that is too long.
    #[error("{0}: longer than {max} bytes", max = msg::TEXT_MAX)]
    Path(String),
    /// Shared memory.
    #[error(transparent)]
    Channel(#[from] ChannelError),
}

/// Asks one robot's SLAM, one thing after the other.
pub struct Asker {
    robot: RobotId,
    client: u64,
    asked: u64,
    answers: Reader<SlamResponse>,
    bell: Listener,
    requests: Writer<SlamRequest>,
    // The ports' presence in the run; dropped after them.
    _node: Participant,
}

impl Asker {
    /// Attaches to a run.
    pub fn attach(run: &Run, robot: RobotId) -> Result<Self, AskError> {
        let robots = run.config.fleet.robots;
        if robot.number() > robots {
            return Err(AskError::NoRobot { robots, number: robot.number() });
        }
        let client = u64::from(std::process::id());
        let node =
            Participant::open(&run.domain, Opener::of_fleet(Program::AskSlam), &format!("ask {robot}"))?;
        Ok(Self {
            robot,
            client,
            // Not what an earlier one of the same process has counted.
            asked: now().0,
            answers: node.reader(&channel::slam_response(robot))?,
            bell: node.listener(&channel::slam_response(robot))?,
            requests: node.writer(&channel::slam_request(robot))?,
            _node: node,
        })
    }

    /// How it stands.
    pub fn state(&mut self) -> Result<SlamResponse, AskError> {
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
        Err(AskError::Silent(self.robot))
    }

    /// Asks once it is known to be there, and waits for the answer.
    pub fn ask(&mut self, request: &SlamRequest) -> Result<SlamResponse, AskError> {
        self.state()?;
        let answer = self.send(request, WORK_PATIENCE).ok_or(AskError::Unfinished(self.robot))?;
        match answer.outcome() {
            SlamOutcome::Done => Ok(answer),
            SlamOutcome::Refused => {
                Err(AskError::Refused { robot: self.robot, why: answer.text.as_str().into() })
            }
        }
    }

    fn send(&mut self, request: &SlamRequest, patience: Duration) -> Option<SlamResponse> {
        self.asked += 1;
        self.requests.send(&SlamRequest { client: self.client, id: self.asked, ..*request });
        let until = Monotonic(now().0 + patience.as_nanos() as u64);
        while now() < until {
            wait([&self.bell], until);
            while let Some(answer) = self.answers.receive() {
                if (answer.client, answer.id) == (self.client, self.asked) {
                    return Some(*answer);
                }
            }
        }
        None
    }

    /// All closures, however many.
    fn closures(&mut self) -> Result<Vec<ClosureInfo>, AskError> {
        let mut all: Vec<ClosureInfo> = Vec::new();
        loop {
            let request = SlamRequest {
                kind: SlamRequestKind::ListClosures as u32,
                number: all.len() as u32,
                ..SlamRequest::default()
            };
            let answer = self.ask(&request)?;
            all.extend(answer.closures());
            if answer.listed == 0 || all.len() >= answer.listable as usize {
                return Ok(all);
            }
        }
    }

    /// Watches a robot that is looked for, for a while.
    fn found(&mut self, mut answer: SlamResponse) -> Result<SlamResponse, AskError> {
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

impl Ask {
    fn request(&self) -> Result<SlamRequest, AskError> {
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
                let start = match (at, at_first, at_last) {
                    (Some(_), _, _) => StartPose::Given,
                    (None, true, _) => StartPose::FirstNode,
                    (None, _, true) => StartPose::LastNode,
                    _ => StartPose::Unknown,
                };
                SlamRequest {
                    text: text(file)?,
                    mode: mode_code(if *localize { Mode::Localization } else { *mode }),
                    start: start as u32,
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

    /// The robot is looked for after it.
    fn seeks(&self) -> bool {
        matches!(self, Self::Load { .. } | Self::Relocalize | Self::Pose { .. })
    }
}

/// A path as SLAM is told it: it may have been started elsewhere.
fn text(file: &Path) -> Result<Text, AskError> {
    let whole = std::path::absolute(file).unwrap_or(file.to_owned());
    let text = whole.to_str().and_then(Text::new);
    text.ok_or_else(|| AskError::Path(whole.display().to_string()))
}

/// Asks, and prints the answer.
pub fn run(args: &SlamArgs) -> Result<(), Error> {
    let request = args.ask.request()?;
    let run = RunArgs { run_dir: args.run_dir.clone() }.open()?;
    let mut asker = Asker::attach(&run, args.robot)?;
    let mut answer = asker.ask(&request)?;
    let closures = match args.ask {
        Ask::Closures => Some(asker.closures()?),
        _ => None,
    };
    if args.ask.seeks() {
        answer = asker.found(answer)?;
    }
    if args.json {
        println!("{}", serde_json::to_string_pretty(&view(args.robot, &answer, closures.as_deref()))?);
        return Ok(());
    }
    if !answer.text.as_str().is_empty() {
        println!("{}", answer.text.as_str());
    }
    match (&args.ask, closures) {
        (Ask::State, _) => print!("{}", table(&answer)),
        (_, Some(closures)) => print!("{}", list(&closures)),
        (ask, None) if ask.seeks() => println!("{}", whereabouts(args.robot, &answer)),
        _ => {}
    }
    Ok(())
}

fn mode_name(answer: &SlamResponse) -> &'static str {
    SlamMode::from_code(answer.mode).map_or("unknown", SlamMode::name)
}

fn whereabouts(robot: RobotId, answer: &SlamResponse) -> String {
    let Pose2 { x_m, y_m, yaw_rad } = answer.map_from_base;
    match answer.located {
        1 => format!("{robot} is at {x_m:.2} {y_m:.2} m, {yaw_rad:.2} rad in its map"),
        _ => {
            format!("{robot} is not found yet: it is looked for while it moves; drive it two or three metres")
        }
    }
}

fn table(answer: &SlamResponse) -> String {
    let Pose2 { x_m, y_m, yaw_rad } = answer.map_from_base;
    let place = match answer.located {
        1 => format!("{x_m:.2} {y_m:.2} m, {yaw_rad:.2} rad"),
        _ => "not found yet".into(),
    };
    let paused = if answer.paused == 1 { ", paused" } else { "" };
    format!(
        "mode      {}{paused}\nrobot     {place}\ngraph     {} nodes, {} links\nclosures  {} in force, {} taken back\n",
        mode_name(answer),
        answer.nodes,
        answer.links,
        answer.closures,
        answer.retracted
    )
}

fn list(closures: &[ClosureInfo]) -> String {
    if closures.is_empty() {
        return "no closures\n".into();
    }
    let mut text = String::from("   N  nodes          at (m)            response  sigmas\n");
    for c in closures {
        let state = if c.in_force == 1 { "" } else { "  taken back" };
        let Pose2 { x_m, y_m, .. } = c.map_from_newer;
        text += &format!(
            "{:4}  {:5} - {:5}  {x_m:7.2} {y_m:7.2}   {:8.2}  {:6.2}{state}\n",
            c.number,
            c.older,
            c.newer,
            c.response,
            c.chi_squared.max(0.0).sqrt()
        );
    }
    text
}

fn numbers(pose: Pose2) -> [f64; 3] {
    [pose.x_m, pose.y_m, pose.yaw_rad]
}

fn view(robot: RobotId, answer: &SlamResponse, closures: Option<&[ClosureInfo]>) -> Value {
    let mut view = json!({
        "robot": robot.to_string(),
        "text": answer.text.as_str(),
        "mode": mode_name(answer),
        "paused": answer.paused == 1,
        "located": answer.located == 1,
        "map_from_base": numbers(answer.map_from_base),
        "nodes": answer.nodes,
        "links": answer.links,
        "closures": answer.closures,
        "retracted": answer.retracted,
    });
    if let Some(closures) = closures {
        let one = |c: &ClosureInfo| {
            json!({
                "number": c.number,
                "older": c.older,
                "newer": c.newer,
                "in_force": c.in_force == 1,
                "older_from_newer": numbers(c.older_from_newer),
                "map_from_older": numbers(c.map_from_older),
                "map_from_newer": numbers(c.map_from_newer),
                "response": c.response,
                "chi_squared": c.chi_squared,
            })
        };
        view["list"] = closures.iter().map(one).collect();
    }
    view
}
