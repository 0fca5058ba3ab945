//! One main loop for each process of the fleet: read the channels, call the room, write the channels.
//! The rooms do the work; nothing here decides anything about robots or maps.

mod bridge;
mod merge;
mod pulse;
mod sim;
mod slam;
mod telemetry;

use crate::run::{Run, RunError};
use crate::stop::Stop;
use msg::{RobotId, Role};
use std::path::PathBuf;
use std::time::Duration;

/// The shortest time between two maps of a robot.
pub const MAP_PERIOD: Duration = Duration::from_millis(500);
/// Side of a cell of the room's plan, metres: the maps'.
pub const PLAN_RESOLUTION_M: f64 = 0.05;

/// What the launcher tells each child.
#[derive(Clone, Debug, clap::Args)]
pub struct ProcessArgs {
    /// The folder of the run to take part in.
    #[arg(long, value_name = "DIR")]
    pub run_dir: PathBuf,
}

/// What the launcher tells a child that belongs to one robot.
#[derive(Clone, Debug, clap::Args)]
pub struct RobotArgs {
    /// Which robot: 1 is robot1.
    #[arg(long, value_name = "K")]
    pub robot: usize,
    /// What every child is told.
    #[command(flatten)]
    pub process: ProcessArgs,
}

/// Anything that ends a process.
pub type Error = Box<dyn std::error::Error>;

/// Runs one process of the fleet until it is asked to stop.
pub fn run(role: Role, robot: Option<usize>, args: &ProcessArgs) -> Result<(), Error> {
    let run = Run::open(&args.run_dir)?;
    let stop = Stop::for_child(run.pid)?;
    // Timers fire when they are due, not up to 50 us later to save power.
    let _ = rustix::thread::set_current_timer_slack(std::num::NonZeroU64::new(1));
    match role {
        Role::Sim => sim::run(&run, member(&run, robot)?, &stop),
        Role::Slam => slam::run(&run, member(&run, robot)?, &stop),
        Role::Merge => merge::run(&run, &stop),
        Role::Telemetry => telemetry::run(&run, &stop),
        Role::Bridge => bridge::run(&run, &stop),
    }
}

fn member(run: &Run, robot: Option<usize>) -> Result<RobotId, RunError> {
    let number = robot.unwrap_or(0);
    run.robots().find(|robot| robot.number() == number).ok_or(RunError::File {
        path: run.dir.join("fleet.toml"),
        why: format!("this fleet has robots 1 to {}, not {number}", run.config.fleet.robots),
    })
}
