//! `mr-slam up`: launches the fleet, shows how it does, and leaves its maps and a report behind.

use crate::config::{ConfigError, FleetConfig, World};
use crate::control::{self, Doors, Request};
use crate::fleet::{self, FleetError};
use crate::keys::Keys;
use crate::observer::Observer;
use crate::report::Report;
use crate::run::{Run, RunError};
use crate::screen::Screen;
use crate::sessions::{self, Mode};
use crate::stop::Stop;
use crate::supervisor::Supervisor;
use crate::view::FleetView;
use std::net::{IpAddr, TcpListener};
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// How often children are looked after: a dead one is noticed within this.
const TEND_PERIOD: Duration = Duration::from_millis(50);
/// How long the launcher waits for the bridge's answer, once a second and at a key; it has children to look after.
const DESK_PATIENCE: Duration = Duration::from_millis(200);
/// How long after the last figures the final maps may still come.
const LAST_LOOK: Duration = Duration::from_millis(200);

/// Which fleet.
#[derive(Clone, Debug, clap::Args)]
pub struct FleetArgs {
    /// Fleet file; the options below override it
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// How many robots, 1 to 16 [default: 3]
    #[arg(long, value_name = "N")]
    pub robots: Option<usize>,
    /// Seed of all noise [default: 1]
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// The room: `laboratory`, or a scanned room (.json, .json.gz), .glb, .gltf, .obj [default: laboratory]
    #[arg(long, value_name = "FILE")]
    pub room: Option<String>,
    /// Where robots, scans and time come from [default: simulator]
    #[arg(long, value_name = "WORLD", value_enum)]
    pub world: Option<World>,
    /// Whether merging is told where robots start, or has to find out [default: known]
    #[arg(long, value_name = "HOW", value_enum)]
    pub starts: Option<Starts>,
    /// Begin with the robots' sessions in this folder, such as runs/TIME/sessions; each robot is looked for in its map
    #[arg(long, value_name = "DIR")]
    pub sessions: Option<PathBuf>,
    /// Leave the sessions' maps as they are: only the robots' poses in them are wanted
    #[arg(long)]
    pub localize: bool,
}

/// What merging is told of where robots start.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Starts {
    /// Where each robot's map begins.
    Known,
    /// Nothing: the maps must show it.
    Unknown,
}

/// Launch a fleet: for each robot a simulator and SLAM, then merging, telemetry and the bridge.
#[derive(Clone, Debug, clap::Args)]
pub struct UpArgs {
    /// Which fleet.
    #[command(flatten)]
    pub fleet: FleetArgs,
    /// TCP port for headsets; 0: any that is free [default: 10000]
    #[arg(long, value_name = "P")]
    pub port: Option<u16>,
    /// Let this address drive, such as the headset's; may be given several times
    #[arg(long, value_name = "ADDRESS")]
    pub allow: Vec<IpAddr>,
    /// Let everybody who reaches the port drive
    #[arg(long)]
    pub trust_lan: bool,
    /// Open the ROS 2 door on this domain (ROS_DOMAIN_ID), for this machine's ROS 2
    #[arg(long, value_name = "ID")]
    pub ros_domain: Option<u16>,
    /// End after this many seconds; without it, Ctrl-C ends the fleet
    #[arg(long, value_name = "S", value_parser = seconds)]
    pub seconds: Option<f64>,
    /// Folder for the maps and the report [default: runs/TIME]
    #[arg(long, value_name = "DIR")]
    pub run_dir: Option<PathBuf>,
}

fn seconds(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|s: &f64| s.is_finite() && *s > 0.0).ok_or("expected a number above 0".into())
}

/// Why a fleet did not come up.
#[derive(Debug, thiserror::Error)]
pub enum UpError {
    /// The fleet file or an option.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The room or the starts.
    #[error(transparent)]
    Fleet(#[from] FleetError),
    /// The folder or shared memory.
    #[error(transparent)]
    Run(#[from] RunError),
    /// The port.
    #[error("cannot listen on {address}:{port}: {why}; choose another with --port, or 0 for any")]
    Port {
        /// Where.
        address: String,
        /// Which.
        port: u16,
        /// What the system says.
        why: std::io::Error,
    },
    /// A process.
    #[error("cannot start the fleet: {0}")]
    Start(#[from] std::io::Error),
    /// The maps.
    #[error(transparent)]
    Map(#[from] formats::map_file::MapFileError),
}

impl FleetArgs {
    /// The configuration in force: the file's, or the default, with the options on top.
    pub fn config(&self) -> Result<FleetConfig, ConfigError> {
        let mut config = match &self.config {
            Some(path) => FleetConfig::from_file(path)?,
            None => FleetConfig::default(),
        };
        let fleet = &mut config.fleet;
        if let Some(robots) = self.robots {
            if robots != fleet.robots {
                // Poses for another number of robots mean nothing.
                fleet.starts.clear();
            }
            fleet.robots = robots;
        }
        config.world = self.world.unwrap_or(config.world);
        // Asking for it on the command line opens the door.
        config.bridge.dds.enabled |= self.world == Some(World::Ros);
        fleet.seed = self.seed.unwrap_or(fleet.seed);
        fleet.starts_known = self.starts.map_or(fleet.starts_known, |starts| starts == Starts::Known);
        fleet.room = self.room.clone().unwrap_or(std::mem::take(&mut fleet.room));
        if let Some(folder) = &self.sessions {
            config.sessions.begin_with = std::path::absolute(folder).unwrap_or(folder.clone());
        }
        if self.localize {
            config.sessions.mode = Mode::Localization;
        }
        config.check()?;
        Ok(config)
    }
}

impl UpArgs {
    fn config(&self) -> Result<FleetConfig, ConfigError> {
        let mut config = self.fleet.config()?;
        config.fleet.port = self.port.unwrap_or(config.fleet.port);
        config.bridge.allow.extend(&self.allow);
        if self.trust_lan {
            config.bridge.drive = bridge::Permission::Anyone;
        }
        if let Some(domain) = self.ros_domain {
            (config.bridge.dds.enabled, config.bridge.dds.domain) = (true, domain);
            config.check()?;
        }
        Ok(config)
    }

    fn folder(&self) -> PathBuf {
        self.run_dir.clone().unwrap_or_else(|| PathBuf::from("runs").join(time_of_day()))
    }
}

/// Hooks of a fleet's run: none for `up`, the scripted operator for `demo`.
pub trait FleetHooks {
    /// Called once, when the fleet's processes have been started.
    fn on_start(&mut self, run: &Run) -> std::io::Result<()>;
    /// Called several times a second; the fleet ends once it returns false.
    fn poll(&mut self) -> bool;
    /// Called once, before the fleet's processes end. The value becomes the operator's part of the report.
    fn on_stop(&mut self) -> Option<serde_json::Value>;
}

/// Hooks that do nothing.
pub struct NoHooks;

impl FleetHooks for NoHooks {
    fn on_start(&mut self, _: &Run) -> std::io::Result<()> {
        Ok(())
    }
    fn poll(&mut self) -> bool {
        true
    }
    fn on_stop(&mut self) -> Option<serde_json::Value> {
        None
    }
}

/// Runs a fleet from start to end.
pub fn up(args: &UpArgs, hooks: &mut dyn FleetHooks, stop: &Stop) -> Result<Report, UpError> {
    let config = args.config()?;
    fleet::check(&config)?;
    let (address, port) = (config.fleet.address.clone(), config.fleet.port);
    let listener = TcpListener::bind((address.as_str(), port)).map_err(|why| UpError::Port {
        address: address.clone(),
        port,
        why,
    })?;
    let port = listener.local_addr()?.port();
    let run = Run::create(&args.folder(), config, port)?;
    sessions::create_folder(&sessions::folder(&run), &fleet::known_starts(&run.config)?)
        .map_err(FleetError::from)?;
    let mut screen = Screen::new(&run);
    let mut supervisor = Supervisor::start(&run, listener)?;
    let result = watch(&run, args.seconds, &mut supervisor, hooks, &mut screen, stop);
    supervisor.end();
    let report = result?;
    report.write(&run.dir)?;
    screen.end(&report);
    Ok(report)
}

/// From the start of the fleet to the moment it is to end.
fn watch(
    run: &Run,
    seconds: Option<f64>,
    supervisor: &mut Supervisor,
    hooks: &mut dyn FleetHooks,
    screen: &mut Screen,
    stop: &Stop,
) -> Result<Report, UpError> {
    let mut observer = Observer::attach(run, "launcher").map_err(RunError::from)?;
    let mut desk = Desk::new(run);
    hooks.on_start(run)?;
    let begun = Instant::now();
    let over = |begun: Instant| seconds.is_some_and(|s| begun.elapsed().as_secs_f64() >= s);
    let mut events = Vec::new();
    while !stop.requested() && !over(begun) && hooks.poll() {
        supervisor.tend(&|role, robot| observer.last_seen(role, robot), &mut |event| {
            screen.tell(&event);
            events.push(event);
        });
        let looked = observer.look();
        for edge in observer.edge_news() {
            let event = format!("{edge}");
            screen.tell(&event);
            events.push(event);
        }
        if looked && let Some(stats) = observer.stats() {
            let mut fleet = FleetView::new(stats);
            (fleet.doors, fleet.merge_edges) = (desk.doors(), observer.merge_edges());
            screen.show(&fleet, desk.help(), begun.elapsed(), seconds);
        }
        if let Some(done) = desk.pressed() {
            screen.tell(&done);
        }
        std::thread::sleep(TEND_PERIOD);
    }
    let operator_report = hooks.on_stop();
    std::thread::sleep(LAST_LOOK);
    observer.look();
    let maps = observer.write_maps(&run.dir)?;
    observer.edge_news();
    let fleet = observer.stats().map(|stats| {
        let mut fleet = FleetView::new(stats);
        (fleet.doors, fleet.merge_edges) = (desk.last, observer.merge_edges());
        fleet
    });
    Ok(Report::new(run, begun.elapsed(), fleet, operator_report, maps, events))
}

/// The person at the laptop: what they see of the doors, and their keys.
struct Desk<'a> {
    run: &'a Run,
    keys: Keys,
    last: Option<Doors>,
}

impl<'a> Desk<'a> {
    fn new(run: &'a Run) -> Self {
        Self { run, keys: Keys::new(), last: None }
    }

    /// Who is at the doors now; what was known last, if the bridge does not say.
    fn doors(&mut self) -> Option<Doors> {
        if let Ok(doors) = control::ask(self.run, Request::State, DESK_PATIENCE) {
            self.last = Some(doors);
        }
        self.last.clone()
    }

    fn help(&self) -> &'static str {
        match self.keys.available() {
            true => "a lets in who asks, d refuses; s stops all robots, r releases; Ctrl-C ends",
            false => "Ctrl-C ends",
        }
    }

    /// What a key has done, if one was pressed that means something.
    fn pressed(&mut self) -> Option<String> {
        let who = || self.last.as_ref().and_then(|doors| doors.waiting.first().copied());
        let (request, done) = match self.keys.next_key()? {
            'a' => (Request::Allow(who()?), format!("{} may drive, now and in later runs", who()?)),
            'd' => (Request::Deny(who()?), format!("{} may not drive", who()?)),
            's' => (Request::Stop, "every robot stands until r is pressed".into()),
            'r' => (Request::Release, "the robots may be driven again".into()),
            _ => return None,
        };
        Some(match control::ask(self.run, request, DESK_PATIENCE) {
            Ok(doors) => {
                self.last = Some(doors);
                done
            }
            Err(why) => why,
        })
    }
}

/// A name for a folder that sorts by time, UTC.
fn time_of_day() -> String {
    jiff::Timestamp::now().strftime("%Y-%m-%dT%H-%M-%S").to_string()
}
