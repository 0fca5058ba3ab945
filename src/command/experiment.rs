//! Tool `mr-slam experiment`, which repeats the evaluation of the paper: sessions, a table with means, a report.

pub mod link;
mod session;
mod summary;

use super::demo::OperatorProcess;
use super::fleet_args::{FleetArgs, Starts};
use super::up::{self, Pictures, Report, ScanRates, UpArgs};
use super::{Error, output};
use crate::config::FleetConfig;
use crate::lockstep::Lockstep;
use crate::stop::Stop;
use link::LinkChoice;
use msg::{MapTransforms, RobotId, VelocityCommand};
use reports::FleetView;
use reports::Series;
use session::{Session, Settings};
use sim::Simulator;
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Ticks of the simulators in a second.
const TICKS_PER_S: u32 = (1_000_000_000 / Simulator::TICK.as_nanos()) as u32;

/// How often a session is begun before the next one's turn.
const ATTEMPTS: u32 = 2;

/// Run the paper's evaluation: sessions with a scripted operator, and a report with means and deviations
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
    /// Whether merging knows where the robots start [default: known]
    #[arg(long, value_name = "HOW", value_enum)]
    pub starts: Option<Starts>,
    /// Number of sessions
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub sessions: u32,
    /// Duration of a session, seconds
    #[arg(long, value_name = "S", default_value_t = 540, value_parser = clap::value_parser!(u32).range(1..=86_400))]
    pub seconds: u32,
    /// Link between the operator and the fleet, through a proxy that delays, stalls and interrupts
    #[arg(long, value_name = "LINK", value_enum, default_value_t, conflicts_with = "fast")]
    pub link: LinkChoice,
    /// Virtual time: as fast as the machine can, without figures of time such as jitter
    #[arg(long)]
    pub fast: bool,
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
            starts: self.starts,
            ..FleetArgs::default()
        }
    }
}

/// Runs the sessions that the folder has not yet, and writes report.html, experiment.json and sessions.csv after each.
///
/// # Errors
/// A session failed twice, the folder has sessions with other settings, or the results cannot be written.
pub fn run(args: &ExperimentArgs, stop: &Stop) -> Result<(), Error> {
    let config = args.fleet().config()?;
    if config.world.is_outside() {
        return Err("an experiment simulates its own world; expected world = \"simulator\"".into());
    }
    let out = args
        .out
        .clone()
        .unwrap_or_else(|| PathBuf::from("runs").join(format!("{}-experiment", up::folder_name_now())));
    if out.join("run.json").exists() {
        return Err(format!("{}: has a run; choose another folder with --out", out.display()).into());
    }
    std::fs::create_dir_all(&out)?;
    let (mut sessions, mut failed) = (Vec::new(), Vec::new());
    let first = config.fleet.seed;
    for number in 1..=args.sessions {
        let mut config = config.clone();
        config.fleet.seed = first.wrapping_add(u64::from(number - 1));
        let Some(session) = run_session(args, number, &config, &out, stop, &mut failed)? else { continue };
        sessions.push(session);
        summary::Results::new(args, &sessions).write(&out, &sessions)?;
    }
    let results = summary::Results::new(args, &sessions);
    results.write(&out, &sessions)?;
    output::note(&format!("{}", out.join("report.html").display()));
    output::print_either(args.json, &results, || results.text())?;
    let missing = args.sessions as usize - sessions.len();
    if missing == 0 {
        return Ok(());
    }
    failed.insert(0, format!("{missing} of {} sessions are missing", args.sessions));
    Err(format!("{}; the same command with --out {} runs them", failed.join("; "), out.display()).into())
}

/// Returns a session: the folder's, or one that is run now. `None`: it failed [`ATTEMPTS`] times, or was interrupted.
fn run_session(
    args: &ExperimentArgs,
    number: u32,
    config: &FleetConfig,
    out: &Path,
    stop: &Stop,
    failed: &mut Vec<String>,
) -> Result<Option<Session>, Error> {
    let folder = out.join(format!("session_{number}"));
    let of = args.sessions;
    for attempt in 1..=ATTEMPTS {
        if let Some(session) = Session::read(&folder, number, &Settings::new(args, config))? {
            output::note(&format!("session {number} of {of}: is there already"));
            return Ok(Some(session));
        }
        if stop.requested() {
            return Ok(None);
        }
        session::set_aside(&folder)?;
        let seed = config.fleet.seed;
        let left_min = f64::from((of - number + 1) * args.seconds) / 60.0;
        let left =
            if args.fast { String::new() } else { format!(", {left_min:.0} min to the end of the last") };
        output::note(&format!("session {number} of {of}: seed {seed}{left}"));
        let report = if args.fast {
            run_in_lockstep(config, args.seconds, &folder, stop)
        } else {
            run_live(args, seed, folder.clone(), stop)
        };
        match report {
            Ok(_) if stop.requested() => return Ok(None),
            Ok(report) if report.fleet.is_some() => {
                let session = Session::new(number, Settings::new(args, config), &report);
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

/// Runs a session in real time, as `mr-slam demo` does.
fn run_live(args: &ExperimentArgs, seed: u64, folder: PathBuf, stop: &Stop) -> Result<Report, Error> {
    let seconds = Some(f64::from(args.seconds));
    let session = UpArgs {
        fleet: FleetArgs { seed: Some(seed), ..args.fleet() },
        port: Some(0),
        seconds,
        run_dir: Some(folder),
        ..UpArgs::default()
    };
    let mut operator = OperatorProcess::new(seconds).behind(args.link.link());
    Ok(up::run(&session, &mut operator, stop)?)
}

/// What is seen of the messages of a fleet in lockstep.
#[derive(Default)]
struct Seen {
    /// Newest velocity of each robot, by the name of its channel.
    commands: HashMap<String, VelocityCommand>,
    map_transforms: Option<Box<MapTransforms>>,
}

impl Seen {
    fn receive(&mut self, channel: &str, message: &[u8]) {
        if channel.ends_with("/command") {
            if let Ok(command) = bytemuck::try_pod_read_unaligned::<VelocityCommand>(message) {
                self.commands.insert(channel.to_owned(), command);
            }
        } else if channel == "map_transforms" {
            self.map_transforms = bytemuck::try_pod_read_unaligned(message).ok().map(Box::new);
        }
    }

    fn command(&self, robot: usize, now_s: f64) -> Option<(VelocityCommand, f64)> {
        let command = *self.commands.get(&format!("{}/command", RobotId::new(robot + 1)?))?;
        Some((command, now_s - command.header.sent.0 as f64 * 1e-9))
    }
}

/// Runs a session on virtual time, with the operator of lockstep, who drives one robot after the other.
fn run_in_lockstep(config: &FleetConfig, seconds: u32, folder: &Path, stop: &Stop) -> Result<Report, Error> {
    let mut fleet = Lockstep::new(config, false)?;
    let (mut seen, mut series, mut rates) = (Seen::default(), Series::default(), ScanRates::default());
    let mut view = None;
    for second in 0..seconds {
        for _ in 0..TICKS_PER_S {
            fleet.tick(&mut |channel, message| seen.receive(channel, message));
        }
        let mut figures = FleetView::new(fleet.stats()).without_given_transforms(config.fleet.starts_known);
        rates.add(&figures);
        rates.fill(&mut figures);
        let now_s = fleet.now().seconds();
        series.add(&figures, |robot| seen.command(robot, now_s));
        // Virtual time has no jitter: a figure of it would say nothing.
        figures.robots.iter_mut().for_each(reports::RobotView::forget_latencies);
        view = Some(figures);
        if second % 60 == 59 {
            output::note(&format!("{} of {seconds} s", second + 1));
        }
        if stop.requested() {
            break;
        }
    }
    if let Some(transforms) = &seen.map_transforms {
        series.set_map_transforms(transforms);
    }
    let mut pictures = Pictures::new(config);
    for (name, map) in fleet.maps() {
        pictures.add(name, map, &series);
    }
    let elapsed = Duration::from_secs_f64(fleet.now().seconds());
    let report = Report { series, pictures, ..Report::of_figures(config, elapsed, view, None) };
    std::fs::create_dir_all(folder)?;
    report.write(folder)?;
    Ok(report)
}
