//! A session in real time: the fleet's processes, the operator, and with them a headset in which the robots live.

use super::Experiment;
use super::room::{self, MERGED_MAP};
use crate::command::Error;
use crate::command::demo::OperatorProcess;
use crate::command::fleet_args::FleetArgs;
use crate::command::up::{self, FleetHooks, Report, UpArgs};
use crate::config::{FleetConfig, RobotSource};
use crate::run::Run;
use crate::stop::Stop;
use crate::world;
use headset::HeadsetRobots;
use headset::live::Headset;
use headset::wireless::{Link, proxy};
use std::io::{self, Write as _};
use std::path::PathBuf;

/// Runs a session in real time, as `mr-slam demo` does.
///
/// # Errors
/// The fleet did not come up, the session or its operator ended early, or its merged map cannot be read.
pub fn run(
    experiment: &Experiment,
    config: &FleetConfig,
    folder: PathBuf,
    stop: &Stop,
) -> Result<Report, Error> {
    // The robots' starts are no options of a fleet, so that all of the configuration goes through a file.
    let file = folder.with_extension("toml");
    formats::atomic::write(&file, |out| out.write_all(config.to_toml().as_bytes()))?;
    let seconds = Some(f64::from(experiment.args.seconds));
    let session = UpArgs {
        fleet: FleetArgs { config: Some(file), ..FleetArgs::default() },
        port: Some(0),
        seconds,
        run_dir: Some(folder),
        ..UpArgs::default()
    };
    let mut people = OperatorAndHeadset {
        link: experiment.link,
        operator: OperatorProcess::new(seconds),
        robots: None,
        headset: None,
    };
    if config.world == RobotSource::Headset {
        people.robots = Some(world::headset_robots(config)?);
    }
    let mut report = up::run(&session, &mut people, stop)?;
    // Its figures would be those of a part of the session.
    if people.operator.deaths() > 0 {
        let deaths = people.operator.deaths();
        return Err(format!(
            "the operator died or was replaced {deaths} times; see the events in report.json"
        )
        .into());
    }
    if report.seconds < f64::from(experiment.args.seconds) && !stop.requested() {
        return Err(format!("it ended after {:.0} s of {} s", report.seconds, experiment.args.seconds).into());
    }
    let is_merged = |map: &&PathBuf| map.file_name().is_some_and(|name| name == MERGED_MAP);
    if let (Some(view), Some(map)) = (&mut report.fleet, report.maps.iter().find(is_merged)) {
        room::compare(view, formats::map_file::read_map(&map.with_extension("yaml"))?.view(), config)?;
    }
    Ok(report)
}

/// The operator, and the headset if the robots live in one, behind the same link.
struct OperatorAndHeadset {
    link: Link,
    operator: OperatorProcess,
    /// The robots until the headset begins.
    robots: Option<HeadsetRobots>,
    headset: Option<Headset>,
}

impl FleetHooks for OperatorAndHeadset {
    fn retry_failing(&mut self) {
        self.operator.retry_failing();
    }

    fn on_start(&mut self, run: &Run) -> io::Result<()> {
        let mut port = run.port;
        if !self.link.is_transparent() {
            port = proxy::start(self.link, port, run.config.fleet.seed)?;
            self.operator.set_port(port);
        }
        self.headset = self.robots.take().map(|robots| Headset::start(robots, port)).transpose()?;
        self.operator.on_start(run)
    }

    fn poll(&mut self, notify: &mut dyn FnMut(String)) -> bool {
        if self.headset.as_ref().is_some_and(|headset| !headset.is_running()) {
            notify("the headset's application ended; the session ends".into());
            return false;
        }
        self.operator.poll(notify)
    }

    fn on_stop(&mut self) -> Option<serde_json::Value> {
        let report = self.operator.on_stop();
        self.headset = None;
        report
    }
}
