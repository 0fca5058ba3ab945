//! Tools `mr-slam robot` and `mr-slam base`: a fleet on several machines. Each launches its processes and one `link` process.

use super::Error;
use super::up::{FleetHooks, UpArgs, run_or_detach};
use crate::clock::now;
use crate::config::World;
use crate::restarts::{DEATHS_MAX, RestartPolicy, State};
use crate::run::Run;
use link_transport::Endpoint;
use link_transport::keys::{KeyFiles, KeyOwner};
use std::io;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

/// Log of the link's process: warnings, and from whom connections come.
const LOG: &str = "warn,zenoh=error,zenoh_link_tls::unicast=debug";
/// Endpoint at which a base listens if nothing else is given.
const LISTEN_DEFAULT: &str = "tls/0.0.0.0:7447";

/// Reason why a machine cannot take part in a fleet on several machines.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LinkArgsError {
    /// The binary has no Zenoh.
    #[error(
        "this mr-slam was built without the link between machines; build one that has it with `cargo build --release \
         --features link`"
    )]
    NotBuilt,
    /// An option of `up` makes no sense here.
    #[error("{0} has no meaning here: `--name` names the robot of this machine, and there is one")]
    RobotOption(&'static str),
    /// The base has no world of its own.
    #[error(
        "--world has no meaning here: the base's robots are on other machines; give it to `mr-slam robot`"
    )]
    BaseWorld,
    /// The base must know its robots.
    #[error("which robots may join? Give --names, such as --names alice,bob, or `names` in the fleet file")]
    NoNames,
}

/// Run one robot on this machine, simulated or over ROS 2, with its SLAM, and join a base
#[derive(Clone, Debug, clap::Args)]
pub struct RobotArgs {
    /// Name of the robot, as the base has it in its --names
    #[arg(long)]
    pub name: String,
    /// Endpoint of the base, such as tls/192.168.1.10:7447
    #[arg(long, value_name = "tls/HOST:PORT")]
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
    /// Endpoint at which robots join
    #[arg(long, value_name = "tls/HOST:PORT", default_value = LISTEN_DEFAULT)]
    pub listen: Endpoint,
    /// How the link is protected.
    #[command(flatten)]
    pub protection: ProtectionArgs,
    /// Options of the fleet; `--names` are the robots that may join.
    #[command(flatten)]
    pub up: UpArgs,
}

/// How the link is protected.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct ProtectionArgs {
    /// Folder of this machine's key [default: below ~/.local/state/mr-slam/keys: robots/NAME, or base]
    #[arg(long, value_name = "DIR")]
    pub keys: Option<PathBuf>,
    /// Accept tcp/ to other machines: whoever reaches the port can drive the robots
    #[arg(long)]
    pub unencrypted: bool,
}

impl ProtectionArgs {
    /// Checks the endpoint, and returns the folder of the key that it needs.
    fn check(&self, endpoint: &Endpoint, owner: &KeyOwner) -> Result<Option<PathBuf>, Error> {
        endpoint.check(self.unencrypted)?;
        if !endpoint.is_tls {
            return Ok(None);
        }
        let folder = match &self.keys {
            Some(folder) => folder.clone(),
            None => owner.folder(&super::keys::default_folder()?),
        };
        KeyFiles::find(&folder)?;
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
    /// Endpoint of the base.
    #[arg(long)]
    pub endpoint: Endpoint,
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
    Ok(run_or_detach(&up, &mut LinkProcess::new(args.base.clone(), Some(args.name.clone()), keys))?)
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
    let keys = args.protection.check(&args.listen, &KeyOwner::Base)?;
    up.fleet.world = Some(World::Robots);
    Ok(run_or_detach(&up, &mut LinkProcess::new(args.listen.clone(), None, keys))?)
}

fn check_built() -> Result<(), LinkArgsError> {
    if cfg!(feature = "link") { Ok(()) } else { Err(LinkArgsError::NotBuilt) }
}

/// Runs the link's process until its launcher ends it.
#[cfg(feature = "link")]
pub fn run(args: &LinkArgs) -> Result<(), Error> {
    use crate::process::link::{self, BaseLink, RobotLink, RunStop};
    use link_transport::{SessionConfig, ZenohTransport};
    use std::hash::{BuildHasher, Hasher, RandomState};

    let run = Run::open(&args.run_dir)?;
    let stop = crate::stop::Stop::for_child(run.pid)?;
    let session = RandomState::new().build_hasher().finish().max(1);
    let config = SessionConfig {
        endpoint: args.endpoint.clone(),
        is_base: args.name.is_none(),
        robots: match &args.name {
            Some(name) => vec![name.clone()],
            None => run.robots().map(|robot| run.config.robot_name(robot)).collect(),
        },
        keys: args.keys.as_deref().map(KeyFiles::find).transpose()?,
    };
    let (ports, run_stop) = (link::attach(&run)?, RunStop::start(&run)?);
    let transport = ZenohTransport::open(&config)?;
    let over = || stop.requested();
    if config.is_base {
        link::serve_link(&run, &mut BaseLink::open(&ports, &run, transport, run_stop, session)?, &over);
    } else {
        link::serve_link(&run, &mut RobotLink::open(&ports, &run, transport, run_stop, session)?, &over);
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
    keys: Option<PathBuf>,
    run: Option<Run>,
    child: Option<Child>,
    policy: RestartPolicy,
}

impl LinkProcess {
    fn new(endpoint: Endpoint, name: Option<String>, keys: Option<PathBuf>) -> Self {
        Self { endpoint, name, keys, run: None, child: None, policy: RestartPolicy::new(now()) }
    }

    fn start(&mut self) -> io::Result<()> {
        let Some(run) = &self.run else { return Ok(()) };
        let mut command = Command::new(std::env::current_exe()?);
        command.arg("link").arg("--run-dir").arg(&run.dir);
        command.args(["--endpoint", &self.endpoint.to_string()]);
        if let Some(name) = &self.name {
            command.args(["--name", name]);
        }
        if let Some(keys) = &self.keys {
            command.arg("--keys").arg::<&Path>(keys);
        }
        if std::env::var_os("RUST_LOG").is_none() {
            command.env("RUST_LOG", LOG);
        }
        // A process group of its own: Ctrl-C reaches the launcher alone.
        self.child = Some(command.stdin(Stdio::null()).process_group(0).spawn()?);
        self.policy.on_started(now());
        Ok(())
    }

    fn record_death(&mut self, tell: &mut dyn FnMut(String)) {
        if self.policy.on_death(now()) == State::Held {
            tell(format!("the link died {DEATHS_MAX} times in a row and is not started again"));
        }
    }
}

impl FleetHooks for LinkProcess {
    fn on_start(&mut self, run: &Run) -> io::Result<()> {
        self.run = Some(run.clone());
        self.start()
    }

    fn poll(&mut self, tell: &mut dyn FnMut(String)) -> bool {
        if let Some(Ok(Some(status))) = self.child.as_mut().map(Child::try_wait) {
            self.child = None;
            tell(format!("the link ended ({status})"));
            self.record_death(tell);
        }
        if self.child.is_none()
            && self.policy.is_due(now())
            && let Err(why) = self.start()
        {
            tell(format!("cannot start the link: {why}"));
            self.record_death(tell);
        }
        true
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
