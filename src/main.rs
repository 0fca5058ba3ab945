//! The one binary of MR-SLAM.

use clap::{Parser, Subcommand};
use mr_slam::control::{self, Request};
use mr_slam::process::{Process, ProcessArgs, RobotArgs};
use mr_slam::{
    ask_slam, demo, doctor, lockstep, merge_edges, merge_maps, process, replay, status, stop::Stop, up,
};
use std::process::ExitCode;

/// Multi-robot SLAM for one operator: a fleet, its maps, and a bridge to headset and ROS 2.
#[derive(Parser)]
#[command(version, about)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Launch a fleet with an operator who drives it, and report: the place to begin
    Demo(up::UpArgs),
    /// Launch a fleet and wait for a headset
    Up(up::UpArgs),
    /// Describe a running fleet
    Status(status::StatusArgs),
    /// Look at what this machine permits: timers, limits, network
    Doctor(doctor::DoctorArgs),
    /// Show what holds the robots' maps of a running fleet together, pin it or take it back
    Edges(merge_edges::EdgesArgs),
    /// Let an address drive a running fleet, now and in later runs; without one, show who may and who waits
    Allow(control::AllowArgs),
    /// Let an address drive no longer
    Deny(control::DenyArgs),
    /// Stop every robot of a running fleet until `release`: the emergency stop
    Stop(control::RunArgs),
    /// Release the emergency stop
    Release(control::RunArgs),
    /// Ask a robot's SLAM in a running fleet: pause, save, load, closures, relocalize ...
    Slam(ask_slam::SlamArgs),
    /// Drive a running fleet over TCP, as a headset does
    Operator(operator::OperatorArgs),
    /// The same fleet in one process on virtual time: the same seed, the same bytes
    Lockstep(lockstep::LockstepArgs),
    /// Map a recorded CARMEN log, as fast as it goes
    Replay(replay::ReplayArgs),
    /// One process of a fleet, started by `up`: a robot in its room
    #[command(display_order = 100)]
    Sim(RobotArgs),
    /// One process of a fleet, started by `up`: a robot's SLAM
    #[command(display_order = 100)]
    SlamWorker(RobotArgs),
    /// Put map files together whose robots started anywhere; or, started by `up`, be the fleet's map
    Merge(merge_maps::MergeArgs),
    /// One process of a fleet, started by `up`: the fleet's figures
    #[command(display_order = 100)]
    Telemetry(ProcessArgs),
    /// One process of a fleet, started by `up`: the door for headsets
    #[command(display_order = 100)]
    Bridge(ProcessArgs),
}

fn main() -> ExitCode {
    match run(Cli::parse().command) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("mr-slam: {error}");
            ExitCode::FAILURE
        }
    }
}

fn run(command: Command) -> Result<(), process::Error> {
    match command {
        Command::Demo(args) => {
            drop(up::up(&args, &mut demo::OperatorProcess::new(args.seconds), &Stop::on_signals()?)?)
        }
        Command::Up(args) => drop(up::up(&args, &mut up::NoHooks, &Stop::on_signals()?)?),
        Command::Status(args) => status::status(&args)?,
        Command::Doctor(args) => doctor::run(&args)?,
        Command::Edges(args) => merge_edges::run(&args)?,
        Command::Allow(args) => args.run.tell(args.address.map_or(Request::State, Request::Allow))?,
        Command::Deny(args) => args.run.tell(Request::Deny(args.address))?,
        Command::Stop(args) => args.tell(Request::Stop)?,
        Command::Release(args) => args.tell(Request::Release)?,
        Command::Operator(args) => {
            let stop = args.launcher_pid.map_or_else(Stop::on_signals, Stop::for_child)?;
            let report = operator::run(&args, stop.flag())?;
            let json = args.json.then(|| serde_json::to_string_pretty(&report)).transpose()?;
            println!("{}", json.unwrap_or_else(|| report.to_string()));
        }
        Command::Lockstep(args) => lockstep::run(&args, &Stop::on_signals()?)?,
        Command::Replay(args) => replay::run(&args)?,
        Command::Sim(args) => process::run(&Process::Sim(args))?,
        Command::Slam(args) => ask_slam::run(&args)?,
        Command::SlamWorker(args) => process::run(&Process::Slam(args))?,
        Command::Merge(args) => merge_maps::run(&args)?,
        Command::Telemetry(args) => process::run(&Process::Telemetry(args))?,
        Command::Bridge(args) => process::run(&Process::Bridge(args))?,
    }
    Ok(())
}
