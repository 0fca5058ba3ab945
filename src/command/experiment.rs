//! Tool `mr-slam experiment`, which repeats the evaluation of the paper: sessions, a table with means, a report.

mod link;
mod live;
mod room;
mod session;
mod summary;
mod virtual_time;

use super::exit_code::UsageError;
use super::fleet_args::{FleetArgs, Starts};
use super::{Error, output};
use crate::config::{FleetConfig, RobotSource, room as room_files};
use crate::run::{check_output, lock_folder};
use crate::stop::Stop;
use crate::world;
use headset::wireless::{Link, LinkChoice};
use link::LinkArgs;
use session::{Session, Settings};
use std::path::PathBuf;

/// How often a session is begun before the next one's turn.
const ATTEMPTS: u32 = 2;

/// Run the paper's evaluation: sessions with a scripted operator, and a report with means and deviations
// More than 12 fields: each is an option of the command line.
#[derive(Clone, Debug, clap::Args)]
pub struct ExperimentArgs {
    /// Fleet file; other options override it
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Number of robots, 1 to 64 [default: 3]
    #[arg(long, value_name = "N")]
    pub robots: Option<usize>,
    /// Seed of the first session; each session has the next [default: 1]
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Room, as of `up` [default: laboratory]
    #[arg(long, value_name = "FILE")]
    pub room: Option<String>,
    /// Where the robots live: `simulator`, or `headset`: simulated in a headset's application behind the link
    /// [default: simulator]
    #[arg(long, value_name = "WORLD", value_enum)]
    pub world: Option<RobotSource>,
    /// Whether merging knows where the robots start [default: known]
    #[arg(long, value_name = "HOW", value_enum)]
    pub starts: Option<Starts>,
    /// Number of sessions
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub sessions: u32,
    /// Duration of a session, seconds
    #[arg(long, value_name = "S", default_value_t = 540, value_parser = clap::value_parser!(u32).range(1..=86_400))]
    pub seconds: u32,
    /// Run one more session after the others; it has a column of its own and does not count in the means
    #[arg(long)]
    pub additional_session: bool,
    /// Options of the link.
    #[command(flatten)]
    pub link: LinkArgs,
    /// Virtual time: as fast as the machine can, without figures of time but for those that a link makes
    #[arg(long)]
    pub fast: bool,
    /// Folder of another experiment, whose means stand beside this one's in the table; may be given several times
    #[arg(long, value_name = "DIR")]
    pub beside: Vec<PathBuf>,
    /// Folder of the results; sessions that it has already are not run again [default: runs/TIME-experiment]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Print the figures as JSON
    #[arg(long)]
    pub json: bool,
}

impl ExperimentArgs {
    fn fleet(&self) -> FleetArgs {
        FleetArgs {
            config: self.config.clone(),
            robots: self.robots,
            seed: self.seed,
            room: self.room.clone(),
            world: self.world,
            starts: self.starts,
            ..FleetArgs::default()
        }
    }

    /// Number of sessions, with the additional one.
    fn session_count(&self) -> u32 {
        self.sessions + u32::from(self.additional_session)
    }
}

/// What all sessions have in common.
struct Experiment {
    args: ExperimentArgs,
    /// Configuration of the first session; the others differ in their seeds.
    config: FleetConfig,
    link: Link,
    /// The link for people.
    link_name: String,
    /// Digest of the room's files at the start; `None`: the room has none.
    room_sha256: Option<String>,
    out: PathBuf,
}

impl Experiment {
    /// Checks the arguments.
    fn new(args: &ExperimentArgs) -> Result<Self, Error> {
        let mut config = args.fleet().config()?;
        let default_link = match config.world {
            RobotSource::Simulator => LinkChoice::Loopback,
            RobotSource::Headset => LinkChoice::BusyWifi,
            RobotSource::Ros | RobotSource::Robots => {
                let why =
                    "an experiment simulates its own world; expected world = \"simulator\" or \"headset\"";
                return Err(UsageError(why.into()).into());
            }
        };
        if config.world == RobotSource::Headset && config.fleet.starts.is_empty() {
            // A headset's robots start where the simulators' would.
            let starts = world::starts(&config, &world::room(&config)?)?;
            config.fleet.starts = starts.iter().map(|start| [start.x_m, start.y_m, start.yaw_rad]).collect();
        }
        let link = args.link.link(default_link)?;
        let out = args.out.clone().unwrap_or_else(|| {
            PathBuf::from("runs").join(format!("{}-experiment", crate::run::folder_name_now()))
        });
        let link_name = args.link.describe(default_link, &link);
        let room_sha256 = room_files::sha256(&config.fleet.room)?;
        Ok(Self { args: args.clone(), config, link, link_name, room_sha256, out })
    }

    /// Returns the configuration of a session, whose numbers begin at 1.
    fn config(&self, number: u32) -> FleetConfig {
        let mut config = self.config.clone();
        config.fleet.seed = config.fleet.seed.wrapping_add(u64::from(number - 1));
        config
    }
}

/// Runs the sessions that the folder has not yet, and writes report.html, experiment.json and sessions.csv after each.
///
/// # Errors
/// A session failed twice, the folder has sessions with other settings, or the results cannot be written.
pub fn run(args: &ExperimentArgs, stop: &Stop) -> Result<(), Error> {
    let experiment = Experiment::new(args)?;
    let out = &experiment.out;
    if out.join("run.json").exists() {
        let why = format!("{}: has a run; choose another folder with --out", out.display());
        return Err(UsageError(why).into());
    }
    let beside =
        args.beside.iter().map(|folder| summary::Results::read(folder)).collect::<Result<Vec<_>, _>>()?;
    formats::folder::create(out)?;
    // Two experiments in one folder would set each other's sessions aside.
    let _lock = lock_folder(out)?;
    let (mut sessions, mut failed) = (Vec::new(), Vec::new());
    for number in 1..=args.session_count() {
        let Some(session) = run_session(&experiment, number, stop, &mut failed)? else { continue };
        sessions.push(session);
        summary::Results::new(&experiment, &sessions).write(out, &sessions, &beside)?;
    }
    let results = summary::Results::new(&experiment, &sessions);
    results.write(out, &sessions, &beside)?;
    output::note(&format!("{}", out.join("report.html").display()));
    output::print_either(args.json, &results, || results.text(&beside))?;
    // A folder that was deleted after its session is missing, too: the report names its files.
    let is_there = |session: &&Session| session::folder(out, session.number).exists();
    let missing = args.session_count() as usize - sessions.iter().filter(is_there).count();
    if missing == 0 {
        return Ok(());
    }
    failed.insert(0, format!("{missing} of {} sessions are missing in the folder", args.session_count()));
    Err(format!("{}; the same command with --out {} runs them", failed.join("; "), out.display()).into())
}

/// Returns a session: the folder's, or one that is run now. `None`: it failed [`ATTEMPTS`] times, or was interrupted.
fn run_session(
    experiment: &Experiment,
    number: u32,
    stop: &Stop,
    failed: &mut Vec<String>,
) -> Result<Option<Session>, Error> {
    let (args, config) = (&experiment.args, experiment.config(number));
    let folder = session::folder(&experiment.out, number);
    let of = args.session_count();
    for attempt in 1..=ATTEMPTS {
        let settings = Settings::new(experiment, &config);
        if let Some(session) = Session::read(&folder, number, &settings)? {
            output::note(&format!("session {number} of {of}: is there already"));
            return Ok(Some(session));
        }
        if stop.requested() {
            return Ok(None);
        }
        check_output(&folder)?;
        let room = &config.fleet.room;
        if room_files::sha256(room)? != experiment.room_sha256 {
            return Err(format!(
                "room {room}: its files changed during the experiment; expected one room for all sessions"
            )
            .into());
        }
        session::set_aside(&folder)?;
        let seed = config.fleet.seed;
        let left_min = f64::from((of - number + 1) * args.seconds) / 60.0;
        let left =
            if args.fast { String::new() } else { format!(", {left_min:.0} min to the end of the last") };
        output::note(&format!("session {number} of {of}: seed {seed}{left}"));
        let report = if args.fast {
            virtual_time::run(experiment, &config, &folder, stop)
        } else {
            live::run(experiment, &config, folder.clone(), stop)
        };
        match report {
            Ok(_) if stop.requested() => return Ok(None),
            Ok(report) if report.fleet.is_some() => {
                let session = Session::new(number, settings, &report);
                session.write(&folder)?;
                return Ok(Some(session));
            }
            Ok(_) => failed.push(format!("session {number}, attempt {attempt}: telemetry sent no figures")),
            Err(why) => failed.push(format!("session {number}, attempt {attempt}: {why}")),
        }
        output::note(failed.last().map_or("", String::as_str));
    }
    Ok(None)
}
