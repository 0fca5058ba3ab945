//! Tool `mr-slam worker ROLE`, which runs one process of a fleet, as the supervisor starts it.

use super::Error;
use crate::process::{self, Process, ProcessArgs, RobotArgs};

/// Run one process of a fleet; started by `up`
#[derive(Clone, Debug, clap::Args)]
pub struct WorkerArgs {
    /// Role of the process.
    #[command(subcommand)]
    role: Role,
}

/// Roles, named as in `mr-slam status`.
#[derive(Clone, Debug, clap::Subcommand)]
enum Role {
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

/// Ends the process when any of its threads or tasks panics, after the message. What is left without one of them would look
/// alive: a bridge without its periodic tasks stops no robot. The supervisor starts the process again.
pub(super) fn abort_on_panic() {
    let say = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        say(panic);
        std::process::abort();
    }));
}

/// Runs the process until it is asked to stop.
pub fn run(args: &WorkerArgs) -> Result<(), Error> {
    abort_on_panic();
    process::run(&match args.role.clone() {
        Role::Sim(args) => Process::Sim(args),
        Role::Slam(args) => Process::Slam(args),
        Role::Merge(args) => Process::Merge(args),
        Role::Telemetry(args) => Process::Telemetry(args),
        Role::Nav(args) => Process::Nav(args),
        Role::Bridge(args) => Process::Bridge(args),
        Role::Record(args) => Process::Record(args),
        Role::Objects(args) => Process::Objects(args),
    })
}
