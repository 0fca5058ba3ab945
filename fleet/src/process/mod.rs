//! One main loop for each process of the fleet: it reads channels, calls a crate and writes channels.
//!
//! Each loop is a [`ProcessLoop`] over [`crate::ports`]: live it runs on shared memory, in lockstep on queues and virtual
//! time. Decisions about robots and maps are in the crates, not here.

pub mod bridge;
pub mod control;
mod external;
pub mod graph_worker;
pub mod heartbeat;
pub mod link;
mod map_publisher;
pub mod merge;
pub mod nav;
pub mod objects;
pub mod record;
mod ros2;
pub mod scan_demand;
pub mod sim;
pub mod slam;
mod submap_publisher;
pub mod telemetry;

use crate::progress::ProgressCounter;
use crate::realtime::SettingError;
use crate::run::{Run, RunError};
use crate::shared_memory::{Listener, wait};
use crate::stop::Stop;
use msg::pose::{COORDINATE_MAX_M, YAW_MAX_RAD};
use msg::{Monotonic, Pose2, RobotId, Role};
use std::path::PathBuf;
use std::time::Duration;

/// Shortest time between two maps of a robot.
pub const MAP_PERIOD: Duration = Duration::from_millis(100);
/// Side of a cell of the room's plan, metres; the same as the maps'.
pub const PLAN_RESOLUTION_M: f64 = 0.05;

/// The body of a process's loop, written once for live processes and for lockstep.
pub trait ProcessLoop {
    /// Reads the ports, does the work that is due, writes the ports, and never waits. Returns the moment at which it
    /// wants to run again, if nothing wakes it before.
    fn step(&mut self) -> Monotonic;
}

/// Listeners that wake a loop before its next due moment.
pub trait Listens<L: 'static> {
    /// The listeners of its inputs.
    fn listeners(&self) -> impl Iterator<Item = &L>;
}

/// Runs a loop on shared memory until `over` returns true.
fn serve(
    body: &mut (impl ProcessLoop + Listens<Listener>),
    mut progress: ProgressCounter,
    over: &dyn Fn() -> bool,
) {
    while !over() {
        progress.advance();
        let due = body.step();
        wait(body.listeners(), due);
    }
}

/// What the launcher tells each child.
#[derive(Clone, Debug, clap::Args)]
pub struct ProcessArgs {
    /// The folder of the run to take part in.
    #[arg(long, value_name = "DIR")]
    pub run_dir: PathBuf,
}

/// Text that is no pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "expected X,Y,YAW: metres within 100 km of the origin, and radians from -6.29 to 6.29 (90 degrees are 1.57)"
)]
pub struct PoseError;

/// Parses a pose from `X,Y,YAW`: metres, metres, radians.
pub fn pose(text: &str) -> Result<Pose2, PoseError> {
    let numbers =
        text.split(',').map(|number| number.trim().parse::<f64>().ok()).collect::<Option<Vec<f64>>>();
    match numbers.as_deref() {
        Some([x_m, y_m, yaw_rad])
            if yaw_rad.abs() <= YAW_MAX_RAD && [x_m, y_m].iter().all(|v| v.abs() <= COORDINATE_MAX_M) =>
        {
            Ok(Pose2::new(*x_m, *y_m, *yaw_rad))
        }
        _ => Err(PoseError),
    }
}

/// What the launcher tells a child that belongs to one robot.
#[derive(Clone, Debug, clap::Args)]
pub struct RobotArgs {
    /// Which robot: 1 is robot1.
    #[arg(long, value_name = "K")]
    pub robot: usize,
    /// Pose to continue from, when the process is started again: `world_from_base` for sim, `map_from_odom` for slam; metres and
    /// radians
    #[arg(long, value_name = "X,Y,YAW", value_parser = pose)]
    pub at: Option<Pose2>,
    /// What every child is told.
    #[command(flatten)]
    pub process: ProcessArgs,
}

/// Any error that ends a process.
pub type Error = Box<dyn std::error::Error>;

/// A process of the fleet with its arguments: the subcommands of `mr-slam worker`, named as in `mr-slam status`.
#[derive(Clone, Debug, clap::Subcommand)]
pub enum Process {
    /// Simulate one robot
    Sim(RobotArgs),
    /// Run the SLAM of one robot
    Slam(RobotArgs),
    /// Merge the robots' maps
    Merge(ProcessArgs),
    /// Measure the fleet
    Telemetry(ProcessArgs),
    /// Serve headsets and ROS 2
    Bridge(ProcessArgs),
    /// Drive robots to goals
    Nav(ProcessArgs),
    /// Record the fleet's messages
    Record(ProcessArgs),
    /// Move people, doors and boxes of the simulated room
    Objects(ProcessArgs),
}

/// Runs one process of the fleet until it is asked to stop.
pub fn run(process: &Process) -> Result<(), Error> {
    match process {
        Process::Sim(args) => {
            let (run, stop) = join(&args.process, Role::Sim)?;
            sim::run(&run, member(&run, args.robot)?, args.at, &stop)
        }
        Process::Slam(args) => {
            let (run, stop) = join(&args.process, Role::Slam)?;
            slam::run(&run, member(&run, args.robot)?, args.at, &stop)
        }
        Process::Merge(args) => join(args, Role::Merge).and_then(|(run, stop)| merge::run(&run, &stop)),
        Process::Telemetry(args) => {
            join(args, Role::Telemetry).and_then(|(run, stop)| telemetry::run(&run, &stop))
        }
        Process::Nav(args) => join(args, Role::Nav).and_then(|(run, stop)| nav::run(&run, &stop)),
        Process::Bridge(args) => join(args, Role::Bridge).and_then(|(run, stop)| bridge::run(&run, &stop)),
        Process::Record(args) => join(args, Role::Record).and_then(|(run, stop)| record::run(&run, &stop)),
        Process::Objects(args) => join(args, Role::Objects).and_then(|(run, stop)| objects::run(&run, &stop)),
    }
}

fn join(args: &ProcessArgs, role: Role) -> Result<(Run, Stop), Error> {
    let run = Run::open(&args.run_dir)?;
    let stop = Stop::for_child(run.pid)?;
    // Timers fire when they are due, not up to 50 us later to save power.
    let _ = rustix::thread::set_current_timer_slack(std::num::NonZeroU64::new(1));
    for outcome in run.config.realtime.apply(role) {
        match outcome.result {
            Ok(()) => {}
            // `mr-slam doctor` says what that costs.
            Err(why @ SettingError::Slice(_)) => tracing::debug!("{}: {why}", outcome.setting),
            Err(why) => tracing::warn!("{}: continues without {}: {why}", role.name(), outcome.setting),
        }
    }
    Ok((run, stop))
}

fn member(run: &Run, number: usize) -> Result<RobotId, RunError> {
    run.robots().find(|robot| robot.number() == number).ok_or_else(|| RunError::NoRobot {
        path: run.dir.join("fleet.toml"),
        robots: run.config.fleet.robots,
        number,
    })
}
