//! Tool `mr-slam goto`, which sends a robot of a running fleet to a place and waits until it is there.

use super::confirmation::confirmation;
use super::first_states::FirstStates;
use super::output;
use super::robot_choice::{RobotChoice, RobotChoiceError};
use super::run_args::RunArgs;
use super::waiting::{WaitError, Waiting};
use crate::channel::{self, Opener, Program};
use crate::control;
use crate::ports::ChannelError;
use crate::run::{Run, RunError};
use crate::shared_memory::{Participant, Reader, Writer, let_readers_look, wait};
use crate::stop::Stop;
use msg::pose::{COORDINATE_MAX_M, YAW_MAX_RAD};
use msg::{
    CommandSource, Monotonic, NavigationAction, NavigationCommand, NavigationFrame, NavigationPose,
    NavigationReport, NavigationStatus, RobotId,
};
use serde::Serialize;
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// Longest time without an answer to a cancellation after Ctrl-C.
const CANCEL_PATIENCE: Duration = Duration::from_secs(1);
/// Period at which the state is looked at, nanoseconds.
const POLL_NS: u64 = 50_000_000;

/// Send a robot of a running fleet to a place, and wait until it is there
#[derive(Clone, Debug, clap::Args)]
pub struct GotoArgs {
    /// Robot to send: robot2, 2, or its name
    #[arg(value_name = "ROBOT")]
    pub robot: RobotChoice,
    /// Place in the frame `map`: metres, metres and, if the heading matters, radians
    #[arg(value_name = "X,Y[,YAW]", value_parser = pose, required_unless_present = "cancel")]
    pub pose: Option<NavigationPose>,
    /// The place is in the robot's own map (frame `map_N`)
    #[arg(long)]
    pub own_map: bool,
    /// Cancel the robot's goal instead
    #[arg(long, conflicts_with_all = ["pose", "own_map", "no_wait"])]
    pub cancel: bool,
    /// Return half a second after the robot has taken the goal; an error if it is refused, paused or blocked
    #[arg(long)]
    pub no_wait: bool,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
    /// Choice of the running fleet.
    #[command(flatten)]
    pub run: RunArgs,
}

/// Text that is no goal.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "expected X,Y or X,Y,YAW: metres within 100 km of the origin, and radians from -6.29 to 6.29 (90 degrees are 1.57)"
)]
pub struct PoseError;

/// Parses a goal from `X,Y` or `X,Y,YAW`.
fn pose(text: &str) -> Result<NavigationPose, PoseError> {
    let is_near = |v: &f64| v.abs() <= COORDINATE_MAX_M;
    let numbers: Option<Vec<f64>> =
        text.split(',').map(|number| number.trim().parse().ok().filter(is_near)).collect();
    match numbers.as_deref() {
        Some([x_m, y_m]) => Ok(NavigationPose { x_m: *x_m, y_m: *y_m, yaw_rad: f64::NAN }),
        Some([x_m, y_m, yaw_rad]) if yaw_rad.abs() <= YAW_MAX_RAD => {
            Ok(NavigationPose { x_m: *x_m, y_m: *y_m, yaw_rad: *yaw_rad })
        }
        _ => Err(PoseError),
    }
}

/// Reason why the robot is not where it was sent.
#[derive(Debug, thiserror::Error)]
pub enum GotoError {
    /// No run, or several and none was named.
    #[error(transparent)]
    Run(#[from] RunError),
    /// Shared memory of the run.
    #[error(transparent)]
    Channel(#[from] ChannelError),
    /// A robot that the fleet does not have.
    #[error(transparent)]
    Robot(#[from] RobotChoiceError),
    /// The fleet has ended, or navigation does not answer.
    #[error(transparent)]
    Wait(#[from] WaitError),
    /// The robot did not arrive.
    #[error("{robot} {state}{}{reason}", if reason.is_empty() { "" } else { ": " })]
    NotReached {
        /// The robot that was sent.
        robot: RobotId,
        /// Its last state: failed, cancelled or paused.
        state: &'static str,
        /// Why it did not arrive.
        reason: String,
    },
    /// The emergency stop is set: the goal would not be driven to after its release either.
    #[error("run {}: the emergency stop is set; `mr-slam release` first, then send the goal", run.display())]
    EmergencyStop {
        /// Folder of the run.
        run: PathBuf,
    },
    /// Another goal came before the robot arrived.
    #[error("{0} has got another goal meanwhile")]
    Replaced(RobotId),
    /// The result cannot be written to standard output.
    #[error(transparent)]
    Print(#[from] std::io::Error),
}

/// Result as JSON.
#[derive(Serialize)]
struct Answer {
    robot: String,
    state: &'static str,
    reason: String,
    seconds: f64,
    /// Where the robot has arrived, its distance to the goal, metres.
    distance_m: Option<f64>,
}

/// Sends the goal and waits.
pub fn run(args: &GotoArgs, stop: &Stop) -> Result<(), GotoError> {
    let run = args.run.open_to_change()?;
    let robot = args.robot.find(&run)?;
    if !args.cancel && control::is_stop_set(&run) {
        return Err(GotoError::EmergencyStop { run: run.dir });
    }
    let begun = Instant::now();
    let report = send(&run, args, robot, stop)?;
    let state = report.status();
    let answer = Answer {
        robot: robot.to_string(),
        state: state.name(),
        reason: report.reason().to_owned(),
        seconds: begun.elapsed().as_secs_f64(),
        distance_m: (state == NavigationStatus::Reached && report.remaining_m.is_finite())
            .then_some(report.remaining_m),
    };
    // Blocked at once is no robot on its way: a script that goes on would rely on it.
    let stands = state.is_final() || matches!(state, NavigationStatus::Paused | NavigationStatus::Blocked);
    let is_on_its_way = !stands;
    let is_wanted = args.cancel || state == NavigationStatus::Reached || (args.no_wait && is_on_its_way);
    output::print_either(args.json, &answer, || {
        // An error says the reason itself.
        let says_why =
            is_wanted && (!args.cancel || state == NavigationStatus::Idle) && !answer.reason.is_empty();
        let why = if says_why { format!(" ({})", answer.reason) } else { String::new() };
        let at = answer.distance_m.map_or_else(String::new, |m| format!(", {m:.2} m from the goal"));
        format!("{}: {} after {:.1} s{at}{why}\n", answer.robot, answer.state, answer.seconds)
    })?;
    let mut reason = answer.reason;
    if state == NavigationStatus::Blocked {
        reason += "; it keeps the goal, and gives it up if that lasts";
    }
    if is_wanted { Ok(()) } else { Err(GotoError::NotReached { robot, state: state.name(), reason }) }
}

/// Sends the command; returns the last state of the goal, or its first if nobody waits for the last.
fn send(run: &Run, args: &GotoArgs, robot: RobotId, stop: &Stop) -> Result<NavigationReport, GotoError> {
    let node = Participant::open(&run.domain, Opener::of_fleet(Program::GotoTool), "goto")?;
    let mut states = node.reader(&channel::navigation_state(robot))?;
    let mut commands = node.writer(&channel::goal(robot))?;
    let outcome = exchange(run, args, robot, stop, &mut states, &mut commands);
    // The navigator has it, and answers at once. A recorder may not have looked yet.
    let_readers_look();
    outcome
}

/// Returns the command with this number: the goal, or its cancellation.
fn command(args: &GotoArgs, robot: RobotId, number: u64) -> NavigationCommand {
    let command = match args.pose {
        None => NavigationCommand::new(number, NavigationAction::Cancel),
        Some(pose) => {
            let frame = if args.own_map { NavigationFrame::RobotMap } else { NavigationFrame::MergedMap };
            NavigationCommand::goal(number, (frame, args.own_map.then_some(robot)), &[pose])
        }
    };
    NavigationCommand { sender: CommandSource::LAPTOP, ..command }
}

/// Sends the command and waits for its outcome.
fn exchange(
    run: &Run,
    args: &GotoArgs,
    robot: RobotId,
    stop: &Stop,
    states: &mut Reader<NavigationReport>,
    commands: &mut Writer<NavigationCommand>,
) -> Result<NavigationReport, GotoError> {
    let number = crate::clock::now().0;
    commands.send(&command(args, robot, number));
    let what = if args.cancel { "its goal is cancelled" } else { "it has arrived" };
    let mut had_goal = false;
    let mut waiting = Waiting::new(Instant::now(), format!("{robot}: whether {what} is not known"));
    let (mut first, mut shown) = (FirstStates::new(), String::new());
    loop {
        // A navigator that starts again needs the command once more.
        commands.refresh();
        // Asked first: what a fleet says before it ends counts.
        let is_alive = run.is_alive();
        while let Some(report) = states.receive().map(|report| *report) {
            if report.number >= number {
                waiting.hear(Instant::now());
            }
            let is_over = report.status().is_final();
            had_goal |= shows_goal(&report, number);
            if args.cancel && (is_over || report.status() == NavigationStatus::Idle) {
                return Ok(if had_goal { report } else { without_goal(&report) });
            }
            if report.number > number {
                return Err(GotoError::Replaced(robot));
            }
            if report.number < number || args.cancel {
                continue;
            }
            if is_over || report.status() == NavigationStatus::Paused {
                return Ok(report);
            }
            first.add(report);
            if !args.no_wait {
                show(robot, &report, &mut shown);
            }
        }
        if args.no_wait
            && let Some(report) = first.outcome()
        {
            return Ok(report);
        }
        waiting.silence_to_report(Instant::now()).iter().for_each(|text| output::note(text));
        waiting.check(run, is_alive, Instant::now())?;
        if stop.requested() {
            let goal = if args.cancel { 0 } else { number };
            let reason = cancel(goal, states, commands).into();
            return Err(GotoError::NotReached { robot, state: "was stopped", reason });
        }
        wait([], Monotonic(crate::clock::now().0 + POLL_NS));
    }
}

/// Whether a state shows that the robot had a goal when the command with this number was sent.
fn shows_goal(report: &NavigationReport, number: u64) -> bool {
    let status = report.status();
    let is_cancelled_now = status == NavigationStatus::Cancelled && report.header.sent.0 >= number;
    is_cancelled_now || (!status.is_final() && status != NavigationStatus::Idle)
}

/// Returns the state of a robot that had no goal to cancel: what became of the last one is no result of this.
fn without_goal(last: &NavigationReport) -> NavigationReport {
    let mut report = NavigationReport { status: NavigationStatus::Idle as u32, ..*last };
    report.set_reason("it had no goal to cancel");
    report
}

/// Cancels the goal after Ctrl-C; returns what became of it.
fn cancel(
    goal: u64,
    states: &mut Reader<NavigationReport>,
    commands: &mut Writer<NavigationCommand>,
) -> &'static str {
    let command = NavigationCommand::cancel(crate::clock::now().0, goal);
    commands.send(&NavigationCommand { sender: CommandSource::LAPTOP, ..command });
    let is_over =
        |report: &NavigationReport| report.status().is_final() || report.status() == NavigationStatus::Idle;
    match confirmation(commands, states, CANCEL_PATIENCE, is_over) {
        Some(_) => "interrupted here, its goal is cancelled",
        None => {
            "interrupted here; navigation does not confirm that its goal is cancelled, so the robot may drive on: see `mr-slam status`"
        }
    }
}

/// Prints a state to standard error when it has changed.
fn show(robot: RobotId, report: &NavigationReport, shown: &mut String) {
    let mut line = format!("{robot}: {}", report.status().name());
    if let Some(other) = RobotId::new(report.other_robot as usize) {
        line += &format!(" for {other}");
    }
    if !report.reason().is_empty() {
        line += &format!(" ({})", report.reason());
    }
    if report.remaining_m.is_finite() && !report.status().is_final() {
        line += &format!(", {:.0} m to go", report.remaining_m.ceil());
    }
    if line != *shown {
        output::note(&line);
        *shown = line;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_goal_has_two_or_three_finite_numbers() {
        let goal = pose("1.5, -2").unwrap();
        assert!(goal.x_m == 1.5 && goal.y_m == -2.0 && goal.yaw_rad.is_nan());
        assert_eq!(pose("0,0,1.57").unwrap().yaw_rad, 1.57);
        for text in ["", "1", "1,2,3,4", "1,x", "inf,0", "1,2,90"] {
            assert_eq!(pose(text), Err(PoseError), "{text}");
        }
    }
}
