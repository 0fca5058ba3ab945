//! Tool `mr-slam explore`, which lets a running fleet explore by itself and waits until it is done.

use super::confirmation::confirmation;
use super::first_states::FirstStates;
use super::output;
use super::run_args::RunArgs;
use super::up::FleetHooks;
use super::waiting::{WaitError, Waiting};
use crate::channel::{self, Opener, Program};
use crate::control;
use crate::ports::ChannelError;
use crate::run::{Run, RunError};
use crate::shared_memory::{Participant, Reader, Writer, wait};
use crate::stop::Stop;
use msg::{
    ExplorationAction, ExplorationCommand, ExplorationReport, ExplorationStatus, ExplorerState, Monotonic,
    ROBOTS_MAX, RobotId,
};
use reports::{ExplorationSummary, known_area};
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// Longest time without an answer to the stop after Ctrl-C.
const STOP_PATIENCE: Duration = Duration::from_secs(1);
/// Period at which the state is looked at, nanoseconds.
const POLL_NS: u64 = 50_000_000;
/// Shortest time between two lines of progress.
const PROGRESS_PERIOD: Duration = Duration::from_secs(10);

/// Let a running fleet explore by itself, and wait until nothing reachable is unknown
#[derive(Clone, Debug, clap::Args)]
pub struct ExploreArgs {
    /// What to do
    #[arg(value_enum, default_value_t = ExploreAction::Start)]
    pub action: ExploreAction,
    /// Return half a second after a robot explores; an error if it is paused, or if no robot can explore for 5 s
    #[arg(long)]
    pub no_wait: bool,
    /// Print the result as JSON
    #[arg(long)]
    pub json: bool,
    /// Choice of the running fleet.
    #[command(flatten)]
    pub run: RunArgs,
}

/// What `mr-slam explore` does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum ExploreAction {
    /// Explore with all robots but those that drive to a person's goal
    Start,
    /// Stop the robots that explore
    Stop,
    /// Print how far the exploration is
    Status,
}

/// Reason why the fleet has not explored to the end.
#[derive(Debug, thiserror::Error)]
pub enum ExploreError {
    /// No run, or several and none was named.
    #[error(transparent)]
    Run(#[from] RunError),
    /// Shared memory of the run.
    #[error(transparent)]
    Channel(#[from] ChannelError),
    /// The fleet has ended, or navigation does not answer.
    #[error(transparent)]
    Wait(#[from] WaitError),
    /// The emergency stop is set: the robots would not set off after its release either.
    #[error("run {}: the emergency stop is set; `mr-slam release` first, then explore", run.display())]
    EmergencyStop {
        /// Folder of the run.
        run: PathBuf,
    },
    /// Ctrl-C before navigation has answered.
    #[error("interrupted before navigation has answered")]
    Interrupted,
    /// The exploration is not completed.
    #[error("the exploration is {state}{}{reason}", if reason.is_empty() { "" } else { ": " })]
    NotCompleted {
        /// Its last state: paused, stopped or failed.
        state: &'static str,
        /// Why it is not completed.
        reason: String,
    },
    /// The result cannot be written to standard output.
    #[error(transparent)]
    Print(#[from] std::io::Error),
}

/// Does what the arguments say.
pub fn run(args: &ExploreArgs, stop: &Stop) -> Result<(), ExploreError> {
    let is_change = args.action != ExploreAction::Status;
    let run = if is_change { args.run.open_to_change()? } else { args.run.open()? };
    let is_start = args.action == ExploreAction::Start;
    if is_start && control::is_stop_set(&run) {
        return Err(ExploreError::EmergencyStop { run: run.dir });
    }
    let report = exchange(&run, args, stop)?;
    let answer = ExplorationSummary::new(&report, run.config.fleet.robots);
    output::print_either(args.json, &answer, || answer.text())?;
    if args.action == ExploreAction::Stop && !taken_out(&report).is_empty() {
        output::note(&format!("the robots that explored stand{}", taken_out(&report)));
    }
    let is_on_its_way =
        matches!(report.status(), ExplorationStatus::Exploring | ExplorationStatus::Returning);
    if !is_start || report.status() == ExplorationStatus::Completed || (args.no_wait && is_on_its_way) {
        return Ok(());
    }
    Err(ExploreError::NotCompleted { state: answer.state, reason: answer.reason })
}

/// Sends the command; returns the last state, or the first if nobody waits for the last.
fn exchange(run: &Run, args: &ExploreArgs, stop: &Stop) -> Result<ExplorationReport, ExploreError> {
    let node = Participant::open(&run.domain, Opener::of_fleet(Program::ExploreTool), "explore")?;
    let mut states = node.reader(&channel::exploration_state())?;
    let mut commands = node.writer(&channel::explore())?;
    let number = match args.action {
        ExploreAction::Status => 0,
        _ => crate::clock::now().0,
    };
    match args.action {
        ExploreAction::Start => commands.send(&ExplorationCommand::new(number, ExplorationAction::Start)),
        ExploreAction::Stop => commands.send(&ExplorationCommand::new(number, ExplorationAction::Stop)),
        ExploreAction::Status => {}
    }
    let is_start = args.action == ExploreAction::Start;
    let mut progress = Progress::default();
    let mut first = FirstStates::new();
    let mut waiting = Waiting::new(Instant::now(), "how far the exploration came is not known".into());
    loop {
        // Asked first: what a fleet says before it ends counts.
        let is_alive = run.is_alive();
        if args.action != ExploreAction::Status {
            // A navigator that starts again needs the command once more.
            commands.refresh();
        }
        while let Some(report) = states.receive() {
            let report = *report;
            if report.number < number {
                continue;
            }
            first.add(report);
            waiting.hear(Instant::now());
            let status = report.status();
            if !is_start || status.is_final() || status == ExplorationStatus::Paused {
                return Ok(report);
            }
            if !args.no_wait
                && let Some(line) = progress.line(&report, run.config.fleet.robots)
            {
                output::note(&line);
            }
        }
        if args.no_wait
            && let Some(report) = first.outcome()
            && !may_begin(&report)
        {
            return Ok(report);
        }
        waiting.silence_to_report(Instant::now()).iter().for_each(|text| output::note(text));
        waiting.check(run, is_alive, Instant::now())?;
        if stop.requested() {
            return Err(match args.action {
                ExploreAction::Start => interrupt(&mut states, &mut commands),
                ExploreAction::Stop | ExploreAction::Status => ExploreError::Interrupted,
            });
        }
        wait([], Monotonic(crate::clock::now().0 + POLL_NS));
    }
}

/// Whether no robot explores yet, and the exploration does not yet say that it waits for one, which it does after 5 s.
fn may_begin(report: &ExplorationReport) -> bool {
    let explores =
        |index| matches!(report.robot(index), ExplorerState::Exploring | ExplorerState::Revisiting);
    let is_begun = (0..ROBOTS_MAX).any(explores);
    report.status() == ExplorationStatus::Exploring && !is_begun
}

/// Says which robots the end of an exploration does not stop, because they were taken out of it before; empty if there are none.
fn taken_out(report: &ExplorationReport) -> String {
    let is_manual = |robot: &RobotId| report.robot(robot.index()) == ExplorerState::Manual;
    let robots: Vec<String> =
        RobotId::first(ROBOTS_MAX).filter(is_manual).map(|robot| robot.to_string()).collect();
    match robots.as_slice() {
        [] => String::new(),
        _ => format!("; {}: taken out of it before, and not stopped by this", robots.join(", ")),
    }
}

/// Stops the exploration after Ctrl-C; returns what became of it.
fn interrupt(
    states: &mut Reader<ExplorationReport>,
    commands: &mut Writer<ExplorationCommand>,
) -> ExploreError {
    let number = crate::clock::now().0;
    commands.send(&ExplorationCommand::new(number, ExplorationAction::Stop));
    let answer =
        confirmation(commands, states, STOP_PATIENCE, |report: &ExplorationReport| report.number >= number);
    if let Some(report) = answer {
        let reason = format!("interrupted here, the robots that explored stand{}", taken_out(&report));
        return ExploreError::NotCompleted { state: report.status().name(), reason };
    }
    let reason = "interrupted here; navigation does not confirm the stop, so robots may drive on: see `mr-slam status`";
    ExploreError::NotCompleted { state: "not known to be stopped", reason: reason.into() }
}

/// Lines of progress: on a change of state or of a robot's part, and each 10 s while the exploration goes on. Its end is said once.
#[derive(Default)]
struct Progress {
    shown: Option<(ExplorationStatus, Vec<ExplorerState>, Instant)>,
}

impl Progress {
    fn line(&mut self, report: &ExplorationReport, robots: usize) -> Option<String> {
        let states: Vec<ExplorerState> = (0..robots).map(|index| report.robot(index)).collect();
        let is_shown = self.shown.as_ref().is_some_and(|(status, shown, at)| {
            let is_same = *shown == states && at.elapsed() < PROGRESS_PERIOD;
            *status == report.status() && (status.is_final() || is_same)
        });
        if is_shown {
            return None;
        }
        let mut line = format!(
            "{}{}",
            report.status().name(),
            known_area(Some(report.known_m2).filter(|known_m2| known_m2.is_finite()))
        );
        if report.least_s.is_finite() && report.most_s.is_finite() {
            line += &format!(", done in {:.0} to {:.0} s", report.least_s, report.most_s);
        }
        if !report.reason().is_empty() {
            line += &format!(" ({})", report.reason());
        }
        for (robot, state) in RobotId::first(robots).zip(&states) {
            if *state != ExplorerState::Exploring && *state != ExplorerState::None {
                line += &format!("; {robot} {}", state.name());
            }
        }
        self.shown = Some((report.status(), states, Instant::now()));
        Some(line)
    }
}

/// Watches the exploration of a fleet that was started with `--explore`.
#[derive(Default)]
pub struct ExplorationWatch {
    /// Whether the fleet ends when the exploration is over.
    ends: bool,
    states: Option<(Participant, Reader<ExplorationReport>)>,
    progress: Progress,
    newest: Option<ExplorationReport>,
    robots: usize,
}

impl ExplorationWatch {
    /// Creates a watch. `ends`: the fleet ends when its exploration is over.
    pub fn new(ends: bool) -> Self {
        Self { ends, ..Self::default() }
    }
}

impl FleetHooks for ExplorationWatch {
    fn on_start(&mut self, run: &Run) -> std::io::Result<()> {
        let node = Participant::open(&run.domain, Opener::of_fleet(Program::Launcher), "exploration")
            .map_err(std::io::Error::other)?;
        let states = node.reader(&channel::exploration_state()).map_err(std::io::Error::other)?;
        self.states = Some((node, states));
        self.robots = run.config.fleet.robots;
        Ok(())
    }

    fn poll(&mut self, notify: &mut dyn FnMut(String)) -> bool {
        let was_over = self.newest.is_some_and(|report| report.status().is_final());
        while let Some(report) = self.states.as_mut().and_then(|(_, states)| states.receive()) {
            self.newest = Some(*report);
        }
        let Some(report) = &self.newest else { return true };
        if let Some(line) = self.progress.line(report, self.robots) {
            notify(format!("exploration: {line}"));
        }
        let is_over = report.status().is_final();
        if is_over && !was_over {
            notify(format!("exploration: {} places left", report.leftovers_count));
        }
        !(self.ends && is_over)
    }

    fn on_stop(&mut self) -> Option<serde_json::Value> {
        serde_json::to_value(ExplorationSummary::new(self.newest.as_ref()?, self.robots)).ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_end_of_an_exploration_is_said_once() {
        let mut report =
            ExplorationReport { status: ExplorationStatus::Exploring as u32, ..ExplorationReport::default() };
        report.robots[0] = ExplorerState::Exploring as u8;
        let mut progress = Progress::default();
        assert!(progress.line(&report, 1).is_some_and(|line| line.contains("exploring")));
        report.status = ExplorationStatus::Stopped as u32;
        report.set_reason("stopped on demand");
        assert!(progress.line(&report, 1).is_some_and(|line| line.contains("stopped on demand")));
        // The robots' parts end after it, and the report is sent again and again.
        report.robots[0] = ExplorerState::None as u8;
        assert_eq!(progress.line(&report, 1), None);
        progress.shown.as_mut().unwrap().2 = Instant::now() - PROGRESS_PERIOD;
        assert_eq!(progress.line(&report, 1), None, "nothing has changed");
        report.status = ExplorationStatus::Exploring as u32;
        assert!(progress.line(&report, 1).is_some(), "it goes on");
    }

    #[test]
    fn a_start_is_judged_when_a_robot_explores_or_the_exploration_waits_for_one() {
        let mut report =
            ExplorationReport { status: ExplorationStatus::Exploring as u32, ..ExplorationReport::default() };
        report.robots[0] = ExplorerState::Silent as u8;
        assert!(may_begin(&report));
        report.status = ExplorationStatus::Waiting as u32;
        assert!(!may_begin(&report));
        report.status = ExplorationStatus::Exploring as u32;
        report.robots[1] = ExplorerState::Exploring as u8;
        assert!(!may_begin(&report));
    }
}
