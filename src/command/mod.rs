//! Command line of `mr-slam`: one module for each tool, with its arguments and a `run` function.

pub mod clients;
mod confirmation;
mod coordinates;
pub mod demo;
pub mod doctor;
pub mod edges;
mod exit_code;
pub mod experiment;
pub mod explore;
mod first_states;
pub mod fleet_args;
pub mod goto;
pub mod headset;
pub mod keys;
pub mod link;
pub mod lockstep;
pub mod merge;
pub mod output;
pub mod permissions;
pub mod record;
pub mod replay;
mod robot_choice;
pub mod room;
pub mod run_args;
pub mod slam;
pub mod status;
pub mod up;
mod waiting;
pub mod worker;
pub mod zone;

pub use exit_code::exit_code;

use crate::stop::Stop;
use clap::{Parser, Subcommand};
use std::ffi::OsString;

/// Reason why a tool ended without a result.
pub type Error = Box<dyn std::error::Error>;

/// What the help says below the tools.
const FOR_PROGRAMS: &str = "With --json a tool prints JSON to standard output, and messages for people to standard error. \
     If it fails, its exit code is not 0 and the JSON says why: {\"error\": \"...\"}, or the result with \
     its state or alarms.\n\nExit codes: 0 done; 1 failed; 2 the command line, or a file that it names as input, is \
     refused before anything is begun; 3 neither done nor failed: `stop` found no \
     running fleet of this user, or the fleet of `--detach` is still starting.";

/// Multi-robot SLAM for one operator: a fleet, its maps, and a bridge to headset and ROS 2
#[derive(Parser)]
#[command(version, about, after_help = FOR_PROGRAMS)]
pub struct Cli {
    /// Tool to run.
    #[command(subcommand)]
    command: Command,
}

/// Tools, in the order of the help text.
#[derive(Subcommand)]
enum Command {
    /// Launch a fleet that a scripted operator drives, and report: the place to begin
    Demo(up::UpArgs),
    /// Launch a fleet and wait for a headset
    Up(up::UpArgs),
    /// Run one robot on this machine, simulated or over ROS 2, with its SLAM, and join a base
    Robot(Box<link::RobotArgs>),
    /// Run the base: merging, bridge and page for robots on other machines
    Base(Box<link::BaseArgs>),
    /// Run a Zenoh router at which robots and base join, where they cannot reach each other
    Router(link::RouterArgs),
    /// Create the keys with which robots and base of several machines know each other
    Keys(keys::KeysArgs),
    /// Carry a run's channels to another machine; started by `robot` and `base`
    #[command(hide = true)]
    Link(link::LinkArgs),
    /// Show the figures of a running fleet
    Status(status::StatusArgs),
    /// Check what this machine permits: timers, limits, network
    Doctor(doctor::DoctorArgs),
    /// Show how the maps of a running fleet are joined, pin an edge or undo it
    Edges(edges::EdgesArgs),
    /// Send a robot of a running fleet to a place, and wait until it is there
    Goto(goto::GotoArgs),
    /// Let a running fleet explore by itself, and wait until nothing reachable is unknown
    Explore(explore::ExploreArgs),
    /// Show the areas that navigation keeps robots out of, add one or remove it
    Zone(zone::ZoneArgs),
    /// Let an address drive a running fleet, now and in later runs; without one, list who may drive and who waits
    Allow(permissions::AllowArgs),
    /// Forbid an address to drive
    Deny(permissions::DenyArgs),
    /// Stop every robot of all running fleets of this user, or of one, until `release`: the emergency stop. Exit code 3: no such fleet runs
    Stop(permissions::StopArgs),
    /// Release the emergency stop of a running fleet
    Release(permissions::StopArgs),
    /// List the clients of a running fleet, or close connections
    Clients(clients::ClientsArgs),
    /// Let a headset on a USB cable reach the operator's page
    Headset(headset::HeadsetArgs),
    /// Accept or refuse the room that a headset offers as the simulators' world; without either, show it
    Room(room::RoomArgs),
    /// Control a robot's SLAM in a running fleet: pause, save, load, closures, relocalize ...
    Slam(slam::SlamArgs),
    /// Record a running fleet as MCAP with ROS 2 messages
    Record(record::RecordArgs),
    /// Drive a running fleet over TCP, as a headset does
    Operator(operator::OperatorArgs),
    /// Simulate a fleet in one process on virtual time: the same seed gives the same bytes
    Lockstep(lockstep::LockstepArgs),
    /// Run the paper's evaluation: sessions with a scripted operator, and a report with means and deviations
    Experiment(experiment::ExperimentArgs),
    /// Map recorded logs and recordings, as fast as the machine can
    Replay(replay::ReplayArgs),
    /// Merge map files of robots that started anywhere
    Merge(merge::MergeArgs),
    /// Run one process of a fleet; started by `up`
    #[command(hide = true)]
    Worker(worker::WorkerArgs),
}

impl Cli {
    /// Parses the words of a command line, the program's name first. Coordinates may begin with a minus, and options may stand
    /// before or behind them.
    pub fn parse_words(words: impl IntoIterator<Item = OsString>) -> Result<Self, clap::Error> {
        Self::try_parse_from(words.into_iter().map(coordinates::as_value))
    }
}

/// Returns what is wrong with a command line, in one line without the usage.
pub fn usage_error(why: &clap::Error) -> String {
    let text = why.render().to_string();
    let said = text.lines().take_while(|line| !line.starts_with("Usage:") && !line.starts_with("For more"));
    let words: Vec<&str> = said.flat_map(str::split_whitespace).collect();
    words.join(" ").trim_start_matches("error: ").to_owned()
}

/// Runs the tool that the command line names.
pub fn run(cli: Cli) -> Result<(), Error> {
    match cli.command {
        Command::Demo(args) => {
            let mut operator = demo::OperatorProcess::new(args.seconds);
            let mut watch = explore::ExplorationWatch::new(true);
            // Robots that explore have no other operator; the demonstration ends when they are back.
            let hooks: &mut dyn up::FleetHooks = if args.fleet.explore { &mut watch } else { &mut operator };
            up::run_or_detach(&args, hooks)?;
        }
        Command::Up(args) => {
            let mut watch = explore::ExplorationWatch::new(false);
            let hooks: &mut dyn up::FleetHooks =
                if args.fleet.explore { &mut watch } else { &mut up::NoHooks };
            up::run_or_detach(&args, hooks)?;
        }
        Command::Robot(args) => link::run_robot(&args)?,
        Command::Base(args) => link::run_base(&args)?,
        Command::Router(args) => link::run_router(&args)?,
        Command::Keys(args) => keys::run(&args)?,
        Command::Link(args) => link::run(&args)?,
        Command::Status(args) => status::run(&args)?,
        Command::Doctor(args) => doctor::run(&args)?,
        Command::Edges(args) => edges::run(&args)?,
        Command::Goto(args) => goto::run(&args, &Stop::on_signals()?)?,
        Command::Explore(args) => explore::run(&args, &Stop::on_signals()?)?,
        Command::Zone(args) => zone::run(&args)?,
        Command::Allow(args) => permissions::allow(&args)?,
        Command::Deny(args) => permissions::deny(&args)?,
        Command::Stop(args) => permissions::stop(&args)?,
        Command::Release(args) => permissions::release(&args)?,
        Command::Clients(args) => clients::run(&args)?,
        Command::Headset(args) => headset::run(&args)?,
        Command::Room(args) => room::run(&args)?,
        Command::Slam(args) => slam::run(&args)?,
        Command::Record(args) => record::run(&args, &Stop::on_signals()?)?,
        Command::Operator(args) => {
            let stop = args.launcher_pid.map_or_else(Stop::on_signals, Stop::for_child)?;
            let report = operator::run(&args, stop.flag())?;
            output::print_either(args.json, &report, || report.to_string() + "\n")?;
            report.check()?;
        }
        Command::Lockstep(args) => lockstep::run(&args, &Stop::on_signals()?)?,
        Command::Experiment(args) => experiment::run(&args, &Stop::on_signals()?)?,
        Command::Replay(args) => replay::run(&args)?,
        Command::Merge(args) => merge::run(&args)?,
        Command::Worker(args) => worker::run(&args)?,
    }
    Ok(())
}
