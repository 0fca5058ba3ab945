//! Tool `mr-slam experiment`, which repeats the evaluation of the paper: sessions, a table with means, a report.

mod summary;

use super::demo::OperatorProcess;
use super::fleet_args::{FleetArgs, Starts};
use super::up::{self, Pictures, Report, ScanRates, UpArgs};
use super::{Error, output};
use crate::config::FleetConfig;
use crate::lockstep::Lockstep;
use crate::report::Series;
use crate::stop::Stop;
use crate::view::FleetView;
use msg::{MapTransforms, RobotId, VelocityCommand};
use sim::Simulator;
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Ticks of the simulators in a second.
const TICKS_PER_S: u32 = (1_000_000_000 / Simulator::TICK.as_nanos()) as u32;

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
    /// Virtual time: as fast as the machine can, without figures of time such as jitter
    #[arg(long)]
    pub fast: bool,
    /// Folder of the results, which must be new [default: runs/TIME-experiment]
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

/// Runs all sessions, and writes report.html, experiment.json and sessions.csv.
pub fn run(args: &ExperimentArgs, stop: &Stop) -> Result<(), Error> {
    let config = args.fleet().config()?;
    if config.world.is_outside() {
        return Err("an experiment simulates its own world; expected world = \"simulator\"".into());
    }
    let out = args
        .out
        .clone()
        .unwrap_or_else(|| PathBuf::from("runs").join(format!("{}-experiment", up::folder_name_now())));
    if out.join("report.html").exists() {
        return Err(
            format!("{}: has a report already; choose another folder with --out", out.display()).into()
        );
    }
    std::fs::create_dir_all(&out)?;
    let mut reports = Vec::new();
    for session in 0..args.sessions {
        if stop.requested() {
            break;
        }
        let mut config = config.clone();
        config.fleet.seed = config.fleet.seed.wrapping_add(session.into());
        let folder = out.join(format!("session_{}", session + 1));
        output::note(&format!("session {} of {}: seed {}", session + 1, args.sessions, config.fleet.seed));
        let report = if args.fast {
            run_in_lockstep(&config, args.seconds, &folder, stop)?
        } else {
            run_live(args, config.fleet.seed, folder, stop)?
        };
        reports.push(report);
    }
    let results = summary::Results::new(args, &reports);
    results.write(&out, &reports)?;
    output::note(&format!("{}", out.join("report.html").display()));
    Ok(output::print_either(args.json, &results, || results.text())?)
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
    Ok(up::run(&session, &mut OperatorProcess::new(seconds), stop)?)
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
        let mut figures = FleetView::new(fleet.stats()).without_given_transforms(config);
        rates.add(&figures);
        rates.fill(&mut figures);
        let now_s = fleet.now().seconds();
        series.add(&figures, |robot| seen.command(robot, now_s));
        // Virtual time has no jitter: a figure of it would say nothing.
        figures.robots.iter_mut().for_each(crate::view::RobotView::forget_latencies);
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
    let mut pictures = Pictures::default();
    for (name, map) in fleet.maps() {
        pictures.add(name, map, &series);
    }
    let elapsed = Duration::from_secs_f64(fleet.now().seconds());
    let report = Report { series, pictures, ..Report::of_figures(config, elapsed, view, None) };
    std::fs::create_dir_all(folder)?;
    report.write(folder)?;
    Ok(report)
}
