//! Tools `mr-slam robot`, `mr-slam base` and `mr-slam router`: a fleet on several machines. The first two launch their
//! processes and one `link` process.

mod error;

pub use error::LinkArgsError;

use super::Error;
use super::exit_code::UsageError;
use super::up::{FleetHooks, UpArgs, run_or_detach};
use crate::child_process::{own_program, spawn};
use crate::clock::now;
use crate::config::RobotSource;
use crate::progress::{self, ProgressBoard, WatchedThread};
use crate::restarts::{RestartPolicy, failing_text};
use crate::run::Run;
use crate::supervisor::START_MAX;
use crate::watchdog::{Finding, Watchdog};
use link_transport::Endpoint;
use link_transport::keys::{KeyFiles, KeyOwner};
#[cfg(feature = "link")]
use link_transport::{SessionConfig, SessionRole};
use std::io;
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};
use std::time::Duration;

/// Endpoint at which a base listens if nothing else is given.
const LISTEN_DEFAULT: &str = "quic/0.0.0.0:7447";
/// Period at which a router, or a link that is not connected yet, looks whether it is to end.
#[cfg(feature = "link")]
const SESSION_POLL: Duration = Duration::from_millis(20);

/// Longest time without a pass of the link's loop; then it is judged whether the process hangs.
const SILENCE_MAX: Duration = Duration::from_secs(3);

/// Run one robot on this machine, simulated or over ROS 2, with its SLAM, and join a base
#[derive(Clone, Debug, clap::Args)]
pub struct RobotArgs {
    /// Name of the robot, as the base has it in its --names
    #[arg(long)]
    pub name: String,
    /// Endpoint of the base, or of a router before it, such as quic/192.168.1.10:7447; tls/ where UDP is not let through
    #[arg(long, value_name = "quic/HOST:PORT")]
    pub base: Endpoint,
    /// Serve the robot in ROS under plain names such as /scan, instead of /NAME/scan
    #[arg(long)]
    pub plain_names: bool,
    /// How the link is protected.
    #[command(flatten)]
    pub protection: ProtectionArgs,
    /// Options of the robot's fleet of one.
    #[command(flatten)]
    pub up: UpArgs,
}

/// Run the base: merging, bridge and page for robots on other machines
#[derive(Clone, Debug, clap::Args)]
pub struct BaseArgs {
    /// Endpoint at which robots join, by quic/ also by tls/ at the same port [default: quic/0.0.0.0:7447]
    #[arg(long, value_name = "quic/HOST:PORT")]
    pub listen: Option<Endpoint>,
    /// Endpoint of a router at which the robots join, too; then the base listens nowhere
    #[arg(long, value_name = "quic/HOST:PORT")]
    pub router: Option<Endpoint>,
    /// How the link is protected.
    #[command(flatten)]
    pub protection: ProtectionArgs,
    /// Options of the fleet; `--names` are the robots that may join.
    #[command(flatten)]
    pub up: UpArgs,
}

/// Run a Zenoh router at which robots and base join, where they cannot reach each other
#[derive(Clone, Debug, clap::Args)]
pub struct RouterArgs {
    /// Names of the robots that may join, separated by commas
    #[arg(long, value_name = "NAMES", value_delimiter = ',', required = true)]
    pub names: Vec<String>,
    /// Endpoint at which robots and base join, by quic/ also by tls/ at the same port
    #[arg(long, value_name = "quic/HOST:PORT", default_value = LISTEN_DEFAULT)]
    pub listen: Endpoint,
    /// How the link is protected.
    #[command(flatten)]
    pub protection: ProtectionArgs,
    /// Print these settings as a configuration file of `zenohd`, which does the same, and end
    #[arg(long)]
    pub print_config: bool,
}

/// How the link is protected.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct ProtectionArgs {
    /// Folder of this machine's key [default: below ~/.local/state/mr-slam/keys: robots/NAME, base, or router]
    #[arg(long, value_name = "DIR")]
    pub keys: Option<PathBuf>,
    /// Accept tcp/ to other machines: anyone who reaches the port can drive the robots
    #[arg(long)]
    pub unencrypted: bool,
}

impl ProtectionArgs {
    /// Checks the endpoint, and returns the folder of the key that it needs.
    fn check(&self, endpoint: &Endpoint, owner: &KeyOwner) -> Result<Option<PathBuf>, Error> {
        endpoint.check(self.unencrypted)?;
        if !endpoint.protocol.is_encrypted() {
            return Ok(None);
        }
        let folder = match &self.keys {
            Some(folder) => folder.clone(),
            None => owner.folder(&super::keys::default_folder()?),
        };
        let found = KeyFiles::find(&folder);
        if let (Some(_), Err(why)) = (&self.keys, &found) {
            return Err(UsageError(format!("--keys: {why}")).into());
        }
        found?;
        Ok(Some(std::path::absolute(&folder)?))
    }
}

/// Carry a run's channels to another machine; started by `robot` and `base`
#[derive(Clone, Debug, clap::Args)]
pub struct LinkArgs {
    /// Folder of the run.
    #[arg(long, value_name = "DIR")]
    pub run_dir: PathBuf,
    /// Name of the robot, on a robot's machine.
    #[arg(long)]
    pub name: Option<String>,
    /// Endpoint of the base, or of a router.
    #[arg(long)]
    pub endpoint: Endpoint,
    /// At the base: the endpoint is a router's.
    #[arg(long)]
    pub behind_router: bool,
    /// Folder of this machine's key, if the endpoint is encrypted.
    #[arg(long, value_name = "DIR")]
    pub keys: Option<PathBuf>,
}

/// Launches a robot's processes.
pub fn run_robot(args: &RobotArgs) -> Result<(), Error> {
    check_built()?;
    let mut up = args.up.clone();
    let given = [("--robots", up.fleet.robots.is_some()), ("--names", up.fleet.names.is_some())];
    if let Some((option, _)) = given.into_iter().find(|(_, is_given)| *is_given) {
        return Err(LinkArgsError::RobotOption(option).into());
    }
    let keys = args.protection.check(&args.base, &KeyOwner::Robot(args.name.clone()))?;
    let ros_name = if args.plain_names { String::new() } else { args.name.clone() };
    (up.fleet.robots, up.fleet.names) = (Some(1), Some(vec![ros_name]));
    let name = Some(args.name.clone());
    let mut link = LinkProcess { name, keys, ..LinkProcess::new(args.base.clone()) };
    Ok(run_or_detach(&up, &mut link)?)
}

/// Launches the base's processes.
pub fn run_base(args: &BaseArgs) -> Result<(), Error> {
    check_built()?;
    let mut up = args.up.clone();
    if up.fleet.world.is_some() {
        return Err(LinkArgsError::BaseWorld.into());
    }
    let names = up.fleet.config()?.fleet.names;
    if names.is_empty() || names.iter().any(String::is_empty) {
        return Err(LinkArgsError::NoNames.into());
    }
    let endpoint = match (&args.listen, &args.router) {
        (Some(_), Some(_)) => return Err(LinkArgsError::ListenAndRouter.into()),
        (Some(endpoint), None) | (None, Some(endpoint)) => endpoint.clone(),
        (None, None) => LISTEN_DEFAULT.parse()?,
    };
    let keys = args.protection.check(&endpoint, &KeyOwner::Base)?;
    up.fleet.world = Some(RobotSource::Robots);
    let behind_router = args.router.is_some();
    Ok(run_or_detach(&up, &mut LinkProcess { behind_router, keys, ..LinkProcess::new(endpoint) })?)
}

/// Runs a router until it is ended.
#[cfg(feature = "link")]
pub fn run_router(args: &RouterArgs) -> Result<(), Error> {
    if args.names.iter().any(String::is_empty) {
        return Err(LinkArgsError::NoNames.into());
    }
    let keys = args.protection.check(&args.listen, &KeyOwner::Router)?;
    let config = SessionConfig {
        endpoint: args.listen.clone(),
        role: SessionRole::Router,
        robots: args.names.clone(),
        keys: keys.as_deref().map(KeyFiles::find).transpose()?,
    };
    if args.print_config {
        return Ok(super::output::print(&config.to_json())?);
    }
    let stop = crate::stop::Stop::on_signals()?;
    let _router = link_transport::Router::open(&config)?;
    while !stop.requested() {
        std::thread::sleep(SESSION_POLL);
    }
    Ok(())
}

/// Says that this binary has no link.
#[cfg(not(feature = "link"))]
pub fn run_router(_: &RouterArgs) -> Result<(), Error> {
    Ok(check_built()?)
}

fn check_built() -> Result<(), LinkArgsError> {
    if cfg!(feature = "link") { Ok(()) } else { Err(LinkArgsError::NotBuilt) }
}

/// Runs the link's process until its launcher ends it.
#[cfg(feature = "link")]
pub fn run(args: &LinkArgs) -> Result<(), Error> {
    super::worker::abort_on_panic();
    use crate::process::link::{self, BaseLink, RobotLink, RunStop};
    use link_transport::ZenohTransport;
    use std::hash::{BuildHasher, Hasher, RandomState};

    let run = Run::open(&args.run_dir)?;
    let stop = crate::stop::Stop::for_child(run.pid)?;
    let session = RandomState::new().build_hasher().finish().max(1);
    let config = SessionConfig {
        endpoint: args.endpoint.clone(),
        role: match (&args.name, args.behind_router) {
            (Some(_), _) => SessionRole::Robot,
            (None, false) => SessionRole::Base,
            (None, true) => SessionRole::BaseBehindRouter,
        },
        robots: match &args.name {
            Some(name) => vec![name.clone()],
            None => run.robots().map(|robot| run.config.robot_name(robot)).collect(),
        },
        keys: args.keys.as_deref().map(KeyFiles::find).transpose()?,
    };
    let base = args.name.as_deref().map(|name| (name, args.endpoint.to_string()));
    let period = if args.name.is_none() { link::BASE_STATE_PERIOD } else { link::ROBOT_STATE_PERIOD };
    let (ports, run_stop) = (link::attach(&run, base)?, RunStop::start(&run, period)?);
    let over = || stop.requested();
    // It waits for the other machine, maybe for ever, and cannot be asked to end.
    let opening = std::thread::spawn(move || ZenohTransport::open(&config));
    let mut progress = run.link_progress();
    while !opening.is_finished() {
        if over() {
            return Ok(());
        }
        progress.advance();
        std::thread::sleep(SESSION_POLL);
    }
    let transport = opening.join().map_err(|_| LinkArgsError::Panic)??;
    if args.name.is_none() {
        let mut end = BaseLink::open(&ports, &run, transport, run_stop, session)?;
        link::serve_link(&run, &mut end, progress, &over)?;
    } else {
        let mut end = RobotLink::open(&ports, &run, transport, run_stop, session)?;
        link::serve_link(&run, &mut end, progress, &over)?;
    }
    Ok(())
}

/// Says that this binary has no link.
#[cfg(not(feature = "link"))]
pub fn run(_: &LinkArgs) -> Result<(), Error> {
    Ok(check_built()?)
}

/// The link's process, which is started again when it dies.
struct LinkProcess {
    endpoint: Endpoint,
    /// Name of the robot, on a robot's machine.
    name: Option<String>,
    /// The endpoint is a router's, at the base.
    behind_router: bool,
    keys: Option<PathBuf>,
    run: Option<Run>,
    child: Option<Child>,
    policy: RestartPolicy,
    watchdog: Watchdog,
    /// Counters of the fleet's threads, of which the last is the link's.
    progress: Option<ProgressBoard>,
}

impl LinkProcess {
    /// Creates a base's process without a key, which is not started yet.
    fn new(endpoint: Endpoint) -> Self {
        let policy = RestartPolicy::new(now());
        Self {
            endpoint,
            name: None,
            behind_router: false,
            keys: None,
            run: None,
            child: None,
            policy,
            watchdog: Watchdog::new(START_MAX, SILENCE_MAX, now()),
            progress: None,
        }
    }

    fn start(&mut self) -> io::Result<()> {
        let Some(run) = &self.run else { return Ok(()) };
        let mut command = own_program();
        command.arg("link").arg("--run-dir").arg(&run.dir);
        command.args(["--endpoint", &self.endpoint.to_string()]);
        command.args(self.name.iter().flat_map(|name| ["--name", name]));
        command.args(self.behind_router.then_some("--behind-router"));
        if let Some(keys) = &self.keys {
            command.arg("--keys").arg::<&Path>(keys);
        }
        self.child = Some(spawn(command.stdin(Stdio::null()))?);
        self.policy.on_started(now());
        self.watchdog = Watchdog::new(START_MAX, SILENCE_MAX, now());
        Ok(())
    }

    /// Kills the process if it hangs, so that it is started again.
    fn end_if_hung(&mut self, notify: &mut dyn FnMut(String)) {
        let (Some(run), Some(child), Some(board)) = (&self.run, &mut self.child, &mut self.progress) else {
            return;
        };
        // Without the counters nobody can be judged. The next poll reads them again.
        let Ok(()) = board.read() else { return };
        let (id, entry) = (child.id(), board.entry(run.link_slot(), WatchedThread::Main));
        // What the process before counted says nothing of this one.
        let count = if entry.thread == id { entry.count } else { 0 };
        let finding = self.watchdog.poll(now(), count, || progress::sample(id, id));
        let Some(finding) = finding else { return };
        notify(format!("the link {finding}"));
        if matches!(finding, Finding::Hung { .. }) {
            // Its end is noticed as any other.
            let _ = child.kill();
        }
    }

    fn record_death(&mut self, notify: &mut dyn FnMut(String)) {
        if self.policy.on_death(now()) {
            notify(format!("the link {}", failing_text()));
        }
    }
}

impl FleetHooks for LinkProcess {
    fn on_start(&mut self, run: &Run) -> io::Result<()> {
        self.progress = Some(ProgressBoard::open(&run.domain, run.progress_slots())?);
        self.run = Some(run.clone());
        self.start()
    }

    fn poll(&mut self, notify: &mut dyn FnMut(String)) -> bool {
        if let Some(Ok(Some(status))) = self.child.as_mut().map(Child::try_wait) {
            self.child = None;
            notify(format!("the link ended ({status})"));
            self.record_death(notify);
        }
        self.end_if_hung(notify);
        if self.child.is_none()
            && self.policy.is_due(now())
            && let Err(why) = self.start()
        {
            notify(format!("cannot start the link: {why}"));
            self.record_death(notify);
        }
        true
    }

    fn retry_failing(&mut self) {
        self.policy.retry_if_failing(now());
    }

    fn on_stop(&mut self) -> Option<serde_json::Value> {
        // It leaves nothing behind but what the launcher removes.
        if let Some(mut child) = self.child.take() {
            let _ = child.kill();
            let _ = child.wait();
        }
        None
    }
}
