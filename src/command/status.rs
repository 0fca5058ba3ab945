//! Tool `mr-slam status`, which shows the newest figures of a running fleet.

use super::output;
use super::run_args::RunArgs;
use crate::channel::{self, Opener, Program};
use crate::config::RobotSource;
use crate::control::{self, Request};
use crate::observer::Observer;
use crate::ports::ChannelError;
use crate::process::control::saved_state::stop_file;
use crate::process::link::{LinkReport, PeerReport, REPORT_AGE_MAX};
use crate::progress::{self, ProgressBoard, WatchedThread};
use crate::run::{Run, RunError};
use crate::shared_memory::{Participant, Reader, wait};
use msg::{ExplorationReport, Monotonic, NavigationReport, RobotId, Role};
use reports::{FleetView, NavigationView};
use serde::Serialize;
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// Show the figures of a running fleet
///
/// If the bridge does not answer, the figures are shown and the exit code is 1: whether the emergency stop is set, who drives and
/// who waits is then not known. What is wrong comes first, in JSON as `alarms`. In JSON `bridge` is null, `bridge_silence` says
/// why, and `stop_latched` whether the run's folder says that the stop is set.
#[derive(Clone, Debug, clap::Args)]
pub struct StatusArgs {
    /// Choice of the running fleet.
    #[command(flatten)]
    pub run: RunArgs,
    /// Print the figures as JSON
    #[arg(long)]
    pub json: bool,
}

/// How long figures may take: they come once a second, and a fleet that starts needs some more.
const PATIENCE: Duration = Duration::from_secs(5);

/// How long navigation may take: it says its states to those who come late once a second.
const NAVIGATION_PATIENCE: Duration = Duration::from_millis(1500);
/// Period at which its state is looked for, nanoseconds.
const POLL_NS: u64 = 20_000_000;
/// What people read where it has said nothing.
const SILENT: &str = "navigation has not answered: goals and exploration are not known\n";

/// Reason why no figures were shown.
#[derive(Debug, thiserror::Error)]
pub enum StatusError {
    /// No run, or not the one that was named.
    #[error(transparent)]
    Run(#[from] RunError),
    /// Shared memory of the run.
    #[error(transparent)]
    Channel(#[from] ChannelError),
    /// Telemetry did not send figures.
    #[error("run {}: no figures came within {} s; telemetry may be restarting, try again", run.display(), PATIENCE.as_secs_f64())]
    NoFigures {
        /// Folder of the run.
        run: PathBuf,
    },
    /// Telemetry has not begun to work.
    #[error(
        "run {}: no figures came within {} s: telemetry is starting, {age_s:.0} s after the fleet; a large room takes longer; try \
         again", run.display(), PATIENCE.as_secs_f64()
    )]
    Starting {
        /// Folder of the run.
        run: PathBuf,
        /// Time since the fleet's start, seconds.
        age_s: f64,
    },
    /// The figures were shown, but the bridge did not answer.
    #[error("run {}: {why}; emergency stop, drivers and clients are not known", run.display())]
    BridgeSilent {
        /// Folder of the run.
        run: PathBuf,
        /// Why there is no answer.
        why: String,
    },
    /// The figures cannot be written to standard output.
    #[error(transparent)]
    Print(#[from] std::io::Error),
}

/// Prints the newest figures of a running fleet.
pub fn run(args: &StatusArgs) -> Result<(), StatusError> {
    let run = args.run.open()?;
    // What goes out once a second comes while the figures are waited for.
    let mut states = NavigationStates::open(&run)?;
    let (fleet, link, of_report) = (newest_figures(&run)?, link_figures(&run), report_lines(&run));
    let navigation = states.newest();
    let of_link: Vec<String> = launcher_line(&run)
        .into_iter()
        .chain(of_report)
        .chain(link.iter().flatten().filter_map(line))
        .collect();
    let stop_latched = stop_file(&run.dir).try_exists().ok();
    let text = || {
        let age_s = crate::clock::now().since(run.begun) as f64 * 1e-9;
        let heading = format!("run {} on port {}, {age_s:.0} s\n", run.dir.display(), run.port);
        let style = reports::terminal::style(&std::io::stdout());
        let of_link: String = of_link.iter().map(|line| format!("! {line}\n")).collect();
        let heading = style.wrap_lines(&(heading + &of_link), 2);
        let doing = navigation.as_ref().map_or_else(|| SILENT.into(), NavigationView::text);
        let doing = style.wrap_lines(&(doing + latch_line(&fleet, stop_latched)), 2);
        format!("{heading}{}{doing}\n{}", fleet.table(&style), fleet.process_table(&style))
    };
    let alarms = of_link.iter().cloned().chain(fleet.alarms()).collect();
    let status = Status {
        fleet: &fleet,
        alarms,
        navigation: navigation.as_ref(),
        stop_latched,
        link: link.as_deref(),
    };
    output::print_either(args.json, &status, text)?;
    match fleet.bridge_silence {
        Some(why) => Err(StatusError::BridgeSilent { run: run.dir, why }),
        None => Ok(()),
    }
}

/// Says that the launcher is stopped, as by Ctrl-Z, if it is.
fn launcher_line(run: &Run) -> Option<String> {
    let pid = run.pid;
    progress::is_stopped(pid).then(|| {
        format!(
            "the launcher (process {pid}) is stopped, and starts no process that ends: `fg` in its terminal, or `kill -CONT {pid}`"
        )
    })
}

/// Says what the run's folder says of the emergency stop, where the bridge says nothing.
fn latch_line(fleet: &FleetView, stop_latched: Option<bool>) -> &'static str {
    match (&fleet.bridge_silence, stop_latched) {
        (None, _) | (Some(_), Some(false)) => "",
        (Some(_), Some(true)) => {
            "EMERGENCY STOP is set in the run's folder: the bridge sets it when it goes on or starts again\n"
        }
        (Some(_), None) => "whether the EMERGENCY STOP is set in the run's folder cannot be read\n",
    }
}

/// Figures of a fleet, at a base with those of the link to each robot.
#[derive(Serialize)]
struct Status<'a> {
    #[serde(flatten)]
    fleet: &'a FleetView,
    /// What is wrong, in sentences.
    alarms: Vec<String>,
    /// Goals and exploration; `None`: navigation has said nothing.
    navigation: Option<&'a NavigationView>,
    /// Whether the run's folder says that the emergency stop is set; `None`: it cannot be read.
    stop_latched: Option<bool>,
    #[serde(skip_serializing_if = "Option::is_none")]
    link: Option<&'a [PeerReport]>,
}

/// The newest states of navigation, which each robot's goal and the exploration have.
struct NavigationStates {
    exploration: Reader<ExplorationReport>,
    robots: Vec<(RobotId, Reader<NavigationReport>)>,
    _participant: Participant,
}

impl NavigationStates {
    fn open(run: &Run) -> Result<Self, ChannelError> {
        let node = Participant::open(&run.domain, Opener::of_fleet(Program::Launcher), "status_navigation")?;
        let reader = |robot| Ok((robot, node.reader(&channel::navigation_state(robot))?));
        Ok(Self {
            exploration: node.reader(&channel::exploration_state())?,
            robots: run.robots().map(reader).collect::<Result<_, ChannelError>>()?,
            _participant: node,
        })
    }

    /// Waits for a while for the state of the exploration, which navigation always has.
    fn newest(&mut self) -> Option<NavigationView> {
        let begun = Instant::now();
        let exploration = loop {
            match self.exploration.newest() {
                Some(report) => break *report,
                None if begun.elapsed() > NAVIGATION_PATIENCE => return None,
                None => {
                    wait([], Monotonic(crate::clock::now().0 + POLL_NS));
                }
            }
        };
        let reports: Vec<(RobotId, NavigationReport)> =
            self.robots.iter_mut().filter_map(|(robot, reader)| Some((*robot, *reader.newest()?))).collect();
        Some(NavigationView::new(reports.iter().map(|(robot, report)| (*robot, report)), &exploration))
    }
}

/// Says what the link's report tells of the machine as a whole: unknown robots at a base, a base that a robot does not hear.
fn report_lines(run: &Run) -> Vec<String> {
    let mut report = LinkReport::read(&run.dir).unwrap_or_default();
    let now = crate::clock::now();
    if Duration::from_nanos(now.0.saturating_sub(report.written_ns)) > REPORT_AGE_MAX {
        report.peers.iter_mut().for_each(|peer| peer.is_heard = false);
        report.unknown_robots.clear();
    }
    let names: Vec<String> = run.robots().map(|robot| run.config.robot_name(robot)).collect();
    let unknown = report.unknown_robots.iter().map(|name| ::link::unknown_robot_text(name, &names));
    unknown.chain(report.base_alarm(Duration::from_nanos(now.since(run.begun)))).collect()
}

/// Returns the figures of the link to each robot; `None` where the robots are on this machine.
fn link_figures(run: &Run) -> Option<Vec<PeerReport>> {
    if run.config.world != RobotSource::Robots {
        return None;
    }
    let report = LinkReport::read(&run.dir).unwrap_or_default();
    let age = Duration::from_nanos(crate::clock::now().0.saturating_sub(report.written_ns));
    let mut peers = report.peers;
    if age > REPORT_AGE_MAX {
        peers.iter_mut().for_each(|peer| peer.is_heard = false);
    }
    Some(peers)
}

/// Says why a robot on another machine does not do what the base wants; `None` if it does.
fn line(peer: &PeerReport) -> Option<String> {
    let mut why = Vec::new();
    if !peer.is_heard {
        why.push(if peer.was_heard { "is not heard" } else { "was not heard yet" });
    }
    why.extend(peer.hold.as_deref());
    if peer.is_contested {
        why.push("another machine bears this name, too, and is refused");
    }
    (!why.is_empty()).then(|| format!("{}: {}", peer.robot, why.join("; ")))
}

/// Returns why there are no figures: telemetry is starting, if its main thread has not worked yet.
fn no_figures(run: &Run) -> StatusError {
    let slots = run.progress_slots();
    let read = |mut board: ProgressBoard| board.read().map(|()| board);
    let board = ProgressBoard::open(&run.domain, slots).and_then(read);
    let telemetry = run.config.processes().position(|(row, _)| row.role == Role::Telemetry);
    match (board, telemetry) {
        (Ok(board), Some(telemetry)) if board.entry(telemetry, WatchedThread::Main).count == 0 => {
            let age_s = crate::clock::now().since(run.begun) as f64 * 1e-9;
            StatusError::Starting { run: run.dir.clone(), age_s }
        }
        _ => StatusError::NoFigures { run: run.dir.clone() },
    }
}

fn newest_figures(run: &Run) -> Result<FleetView, StatusError> {
    let mut observer = Observer::attach(run, "status")?;
    let begun = Instant::now();
    while !observer.poll() && !observer.wait(PATIENCE) && begun.elapsed() <= PATIENCE {}
    let view = observer.fleet_view(run).ok_or_else(|| no_figures(run))?;
    observer.changed_edges();
    // Figures without the bridge's state are still worth having.
    let (bridge, bridge_silence) = match control::ask_again(run, Request::State, PATIENCE) {
        Ok(state) => (Some(state), None),
        Err(why) => (None, Some(why.to_string())),
    };
    Ok(FleetView { bridge_silence, ..view.with_edges(observer.merge_edges()).with_bridge(bridge) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::FleetConfig;
    use crate::shared_memory::DomainGuard;

    #[test]
    fn telemetry_that_has_not_worked_yet_is_starting() {
        let folder = tempfile::tempdir().unwrap();
        let run = Run::create(folder.path(), FleetConfig::default(), 0, false).unwrap();
        let _guard = DomainGuard::new(run.domain.clone());
        let _board = ProgressBoard::create(&run.domain, run.progress_slots()).unwrap();
        let why = no_figures(&run).to_string();
        assert!(why.contains("telemetry is starting"), "{why}");
        run.progress(Role::Telemetry, None, WatchedThread::Main).advance();
        assert!(matches!(no_figures(&run), StatusError::NoFigures { .. }));
    }
}
