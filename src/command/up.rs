//! Tool `mr-slam up`, which launches a fleet, shows its figures, and writes maps and a report.

mod console;
mod detach;
mod error;
pub(super) mod page;
mod pictures;
mod report;
mod screen;
pub(super) mod system;

pub use error::UpError;
pub use pictures::{Pictures, write_html};
pub use report::{Paper, Report, Spread};

use super::fleet_args::FleetArgs;
use crate::child_messages::ChildMessages;
use crate::config::{ConfigError, FleetConfig, ValueError};
use crate::observer::Observer;
use crate::offered_room;
use crate::resources::{self, ResourceMonitor};
use crate::run::{Run, RunError, create_new_folder, folder_name_now, keep_earlier_results};
use crate::sessions;
use crate::shared_memory::DomainGuard;
use crate::stop::Stop;
use crate::supervisor::Supervisor;
use crate::world;
use bridge::dds::{Discovery, DiscoveryVariables};
use console::OperatorConsole;
pub use pictures::add_plots;
use reports::{Events, FleetView, ScanRates, Series};
use screen::Screen;
use std::net::{IpAddr, TcpListener};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Period at which the processes are tended: a death is noticed within this.
const TEND_PERIOD: Duration = Duration::from_millis(50);
/// How long after the last figures the final maps may still come: twice the shortest time between two maps.
const LAST_MAPS: Duration = Duration::from_millis(200);

/// Launch a fleet: a simulator and SLAM for each robot, merging, telemetry and the bridge
// More than 12 fields: one field for each option of the command line, which clap derives from the struct.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct UpArgs {
    /// Options that describe the fleet.
    #[command(flatten)]
    pub fleet: FleetArgs,
    /// TCP port for headsets; 0: any free port [default: 10000]
    #[arg(long, value_name = "P")]
    pub port: Option<u16>,
    /// TCP port of the operator's page, 0 for any free port, or `off`; overrides the configuration
    #[arg(long, value_name = "P")]
    pub page: Option<page::PageChoice>,
    /// Address that may drive, such as the headset's; may be given several times
    #[arg(long, value_name = "ADDRESS", value_parser = bridge::parse_peer_address)]
    pub allow: Vec<IpAddr>,
    /// Let everybody who reaches the port drive the robots
    #[arg(long)]
    pub trust_lan: bool,
    /// Serve ROS 2 in this domain [default with --world ros: ROS_DOMAIN_ID, or 0]
    #[arg(long, value_name = "ID")]
    pub ros_domain: Option<u16>,
    /// Seconds until the fleet ends [default: until Ctrl-C]
    #[arg(long, value_name = "S", value_parser = seconds)]
    pub seconds: Option<f64>,
    /// Folder for the maps and the report [default: runs/TIME]
    #[arg(long, value_name = "DIR", overrides_with = "run_dir")]
    pub run_dir: Option<PathBuf>,
    /// Record the fleet's messages into recording/ below the run's folder, as MCAP with ROS 2 messages
    #[arg(long)]
    pub record: bool,
    /// Size at which a recording's next file begins, megabytes [default: 2000]
    #[arg(long, value_name = "MB")]
    pub split_mb: Option<u64>,
    /// Go on in the background, also after logging out; the output goes to launcher.log in the run's folder. Exit code 3: after 60 s
    /// the fleet is still starting, and goes on; `mr-slam status` says when it works
    #[arg(long)]
    pub detach: bool,
    /// Process that started this one, whose end ends the fleet; for programs that measure it.
    #[arg(long, hide = true)]
    pub parent_pid: Option<u32>,
    /// Set by `--detach` for the process in the background.
    #[arg(long, hide = true)]
    pub in_background: bool,
}

/// Text that is no duration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("expected a number of seconds above 0")]
pub(super) struct SecondsError;

pub(super) fn seconds(text: &str) -> Result<f64, SecondsError> {
    text.parse().ok().filter(|s: &f64| s.is_finite() && *s > 0.0).ok_or(SecondsError)
}

impl UpArgs {
    fn config(&self) -> Result<FleetConfig, ConfigError> {
        let mut discovery = Ok(None);
        let config = self.fleet.config_with(|config| {
            config.fleet.port = self.port.unwrap_or(config.fleet.port);
            config.bridge.allow.extend(&self.allow);
            if let Some(choice) = self.page {
                choice.apply(config);
            }
            let recording = &mut config.recording;
            recording.enabled |= self.record;
            recording.split_mb = self.split_mb.unwrap_or(recording.split_mb);
            if self.trust_lan {
                config.bridge.drive = bridge::Permission::Anyone;
            }
            if let Some(domain) = self.ros_domain {
                (config.bridge.dds.enabled, config.bridge.dds.domain) = (true, domain.into());
            }
            let dds = &mut config.bridge.dds;
            if dds.enabled {
                discovery = Discovery::new(dds, &ros_variables()).map(Some);
            }
            if let Ok(Some(discovery)) = &discovery {
                dds.set_discovery(discovery);
            }
        })?;
        if let Some(warning) = discovery.map_err(ValueError::from)?.and_then(|discovery| discovery.warning) {
            tracing::warn!("{warning}");
        }
        let unused = self.fleet.unused_in(config.world);
        if !unused.is_empty() {
            tracing::warn!("{} without effect: only simulated robots have a room", unused.join(", "));
        }
        Ok(config)
    }

    /// Returns the folder that was asked for, or creates one that no other fleet uses.
    fn folder(&self) -> Result<PathBuf, RunError> {
        match &self.run_dir {
            Some(dir) => Ok(dir.clone()),
            None => create_new_folder(Path::new("runs"), &folder_name_now()),
        }
    }
}

/// Returns ROS 2's environment variables for discovery.
pub(super) fn ros_variables() -> DiscoveryVariables {
    DiscoveryVariables::new(|name| std::env::var(name).ok())
}

/// Additions to a running fleet: none for `up`, the scripted operator for `demo`.
pub trait FleetHooks {
    /// Called once when all processes have been started.
    fn on_start(&mut self, run: &Run) -> std::io::Result<()>;
    /// Called every 50 ms; must not block. `notify` is called with each event. Returning false ends the fleet.
    fn poll(&mut self, notify: &mut dyn FnMut(String)) -> bool;
    /// Called when a file system that was full has room again: processes that died for it are started at once.
    fn retry_failing(&mut self) {}
    /// Called once before the fleet ends. The returned value becomes `operator` in the report.
    fn on_stop(&mut self) -> Option<serde_json::Value>;
}

/// Hooks that do nothing.
pub struct NoHooks;

impl FleetHooks for NoHooks {
    fn on_start(&mut self, _: &Run) -> std::io::Result<()> {
        Ok(())
    }
    fn poll(&mut self, _: &mut dyn FnMut(String)) -> bool {
        true
    }
    fn on_stop(&mut self) -> Option<serde_json::Value> {
        None
    }
}

/// Runs a fleet to its end, or starts it in the background if `--detach` is given.
pub fn run_or_detach(args: &UpArgs, hooks: &mut dyn FleetHooks) -> Result<(), UpError> {
    if args.detach && !args.in_background {
        return detach::start(&args.folder()?);
    }
    if args.in_background {
        // A session of its own: the end of the terminal does not reach it.
        rustix::process::setsid().map_err(std::io::Error::from)?;
    }
    let stop = args.parent_pid.map_or_else(Stop::on_signals, Stop::on_death_of)?;
    run(args, hooks, &stop).map(drop)
}

/// Runs a fleet from start to end, writes its maps and report into the run's folder, and returns the report.
///
/// When the operator accepts a headset's room, the run ends and another one begins in it: on the same ports, with a folder
/// of its own. The report is the last run's.
pub fn run(args: &UpArgs, hooks: &mut dyn FleetHooks, stop: &Stop) -> Result<Report, UpError> {
    let mut config = args.config()?;
    world::check(&config)?;
    page::choose_ports(&mut config)?;
    let (address, port) = (config.fleet.address.clone(), config.fleet.port);
    let listener = TcpListener::bind((address.as_str(), port)).map_err(|why| UpError::Port {
        address: address.clone(),
        port,
        why,
    })?;
    let port = listener.local_addr()?.port();
    let folder = args.folder()?;
    let mut count = 0;
    loop {
        let run = Run::create(&offered_room::folder(&folder, count), config, port, args.in_background)?;
        // A fleet that did not start leaves nothing either.
        let _guard = DomainGuard::new(run.domain.clone());
        offered_room::remove_old(&run)?;
        let report = run_created(&run, listener.try_clone()?, args, hooks, stop)?;
        match offered_room::accepted(&run).filter(|_| !stop.requested()) {
            Some(room) => config = offered_room::fleet_in(&run.config, &room),
            None => return Ok(report),
        }
        count += 1;
    }
}

/// Runs the fleet of a run that was created.
fn run_created(
    run: &Run,
    listener: TcpListener,
    args: &UpArgs,
    hooks: &mut dyn FleetHooks,
    stop: &Stop,
) -> Result<Report, UpError> {
    let known = world::known_starts(&run.config).map_err(UpError::Begin)?;
    let (folder, begin_with) = (sessions::folder(run), run.config.sessions.folder());
    sessions::create_folder(&folder, &known, begin_with, world::has_own_frame(&run.config))
        .map_err(|why| UpError::Begin(why.into()))?;
    keep_earlier_results(&run.dir)?;
    let mut screen = Screen::new(run, args.in_background);
    check_resources(run, &mut screen)?;
    // In the background children write into the log themselves: standard error is the log.
    let collect = || ChildMessages::collect(run.dir.join("launcher.log"));
    let messages = (!args.in_background).then(collect).transpose()?;
    let supervisor = Supervisor::start(run, listener, known);
    let mut supervisor = match supervisor {
        Ok(supervisor) => supervisor,
        Err(why) => {
            messages.into_iter().for_each(|messages| screen.show_lines(&messages.end()));
            return Err(why.into());
        }
    };
    let mut shown = (&mut screen, messages.as_ref());
    let result = watch(run, args.seconds, &mut supervisor, hooks, &mut shown, stop);
    let failing = supervisor.failing();
    let lost = supervisor.end(stop, &mut |text| screen.show_event(&text));
    messages.into_iter().for_each(|messages| screen.show_lines(&messages.end()));
    let mut report = result?;
    report.not_written.extend(lost);
    let written = report.write(&run.dir);
    screen.end(&report);
    let mut missing = report.not_written.clone();
    missing.extend(written.err().map(|why| why.to_string()));
    match (missing.is_empty(), failing.is_empty()) {
        (false, _) => Err(UpError::NotWritten(missing)),
        (true, false) => Err(UpError::Failing(failing)),
        (true, true) => Ok(report),
    }
}

/// Tends the processes and shows the figures until the fleet is to end.
fn watch(
    run: &Run,
    seconds: Option<f64>,
    supervisor: &mut Supervisor,
    hooks: &mut dyn FleetHooks,
    (screen, messages): &mut (&mut Screen, Option<&ChildMessages>),
    stop: &Stop,
) -> Result<Report, UpError> {
    let mut observer = Observer::attach(run, "launcher").map_err(RunError::from)?;
    let mut console = OperatorConsole::new(run);
    let mut resources = ResourceMonitor::new(&run.dir);
    let (mut events, mut rates, mut series) = (Events::default(), ScanRates::default(), Series::default());
    hooks.on_start(run)?;
    let begun = Instant::now();
    let over = || seconds.is_some_and(|s| begun.elapsed().as_secs_f64() >= s);
    loop {
        let mut notify = |event: String| {
            screen.show_event(&event);
            events.push(begun.elapsed(), event);
        };
        if stop.requested() || over() || !hooks.poll(&mut notify) || offered_room::accepted(run).is_some() {
            break;
        }
        supervisor.tend(&mut |role, robot| observer.last_seen(role, robot), &mut notify);
        let has_new_stats = observer.poll();
        if resources.poll(&mut notify) {
            supervisor.retry_failing();
            hooks.retry_failing();
        }
        observer.changed_edges().iter().for_each(|edge| notify(edge.to_string()));
        if has_new_stats && let Some(mut fleet) = fleet_view(run, &observer, console.refreshed()) {
            rates.add(&fleet);
            rates.fill(&mut fleet);
            series.add(&fleet, |robot| observer.command(robot));
            screen.show(&fleet, console.help(), begun.elapsed(), seconds);
        }
        screen.show_lines(&messages.map(ChildMessages::received).unwrap_or_default());
        screen.show_age();
        if let Some(done) = console.handle_key() {
            screen.show_event(&done);
        }
        std::thread::sleep(TEND_PERIOD);
    }
    stop.acknowledge();
    let operator = hooks.on_stop();
    std::thread::sleep(LAST_MAPS);
    observer.poll();
    let (maps, errors) = observer.write_maps(&run.dir);
    observer.changed_edges();
    let mut fleet = fleet_view(run, &observer, &console);
    if let Some(fleet) = &mut fleet {
        rates.add(fleet);
        rates.fill(fleet);
    }
    let pictures = Pictures::of_maps(&run.config, &observer, &mut series);
    let report = Report::new(run, begun.elapsed(), fleet, operator, maps, events);
    let mut report = Report { series, pictures, ..report };
    report.not_written.extend(errors.iter().map(ToString::to_string));
    Ok(report)
}

/// Compares the machine's resources with what the fleet needs. What is short but not too short is shown.
fn check_resources(run: &Run, screen: &mut Screen) -> Result<(), UpError> {
    let checks = [
        resources::check_shared_memory(&run.config),
        resources::check_descriptors(&run.config),
        resources::check_disk(&run.dir, &run.config),
    ];
    for resources::Finding { shortage, is_fatal } in checks.into_iter().flatten() {
        if is_fatal {
            return Err(shortage.into());
        }
        screen.show_event(&shortage.to_string());
    }
    Ok(())
}

fn fleet_view(run: &Run, observer: &Observer, console: &OperatorConsole) -> Option<FleetView> {
    let view = observer.fleet_view(run)?;
    Some(console.fill(view.with_edges(observer.merge_edges())))
}
