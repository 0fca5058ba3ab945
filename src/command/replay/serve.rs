//! Serves a replay to clients on TCP, to browsers with the page or Foxglove, and to ROS 2 nodes such as RViz.

use super::player::{Player, Transports};
use super::player_services::{self, PlayerServices};
use super::{ReplayArgs, ReplayError};
use crate::clock::now;
use crate::command::output::note;
use crate::command::up::page::{PageChoice, choose_ports, url};
use crate::config::FleetConfig;
use crate::keys::Keys;
use crate::process::bridge::page;
use crate::stop::Stop;
use bridge::dds::{DdsEndpoint, DdsQueues};
use bridge::{Bridge, BridgeConfig};
use recording::fleet::FleetRecording;
use recording::playback::Speed;
use std::io;
use std::rc::Rc;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::net::TcpListener;
use tokio::task::{LocalSet, spawn_local};

/// Pause after a turn with nothing more to play.
const TURN_PAUSE: Duration = Duration::from_millis(5);
/// Period at which the place is told.
const PLACE_PERIOD: Duration = Duration::from_secs(10);

/// Serving of a replay
#[derive(clap::Args, Clone, Debug)]
pub struct ServeArgs {
    /// Play a fleet's recording for clients: page, Foxglove, RViz; until Ctrl-C
    #[arg(long)]
    pub serve: bool,
    /// Speed, in times real time, or `max`
    #[arg(long, value_name = "N", default_value = "1", requires = "serve")]
    pub speed: Speed,
    /// TCP port for clients; 0: any free port [default: 10000]
    #[arg(long, value_name = "P", requires = "serve")]
    pub port: Option<u16>,
    /// TCP port of the operator's page, 0 for any free port, or `off`
    #[arg(long, value_name = "P", requires = "serve")]
    pub page: Option<PageChoice>,
    /// Serve ROS 2 in this domain
    #[arg(long, value_name = "ID", requires = "serve")]
    pub ros_domain: Option<u16>,
}

impl Default for ServeArgs {
    fn default() -> Self {
        Self { serve: false, speed: Speed::Times(1.0), port: None, page: None, ros_domain: None }
    }
}

/// Returns the configuration of the transports: this machine's defaults, and not what the recording's fleet opened.
fn serving_config(args: &ServeArgs, recorded: &FleetConfig) -> Result<FleetConfig, ReplayError> {
    let mut config = FleetConfig { bridge: BridgeConfig::default(), ..recorded.clone() };
    config.fleet.address = FleetConfig::default().fleet.address;
    config.fleet.port = args.port.unwrap_or(FleetConfig::default().fleet.port);
    if let Some(choice) = args.page {
        choice.apply(&mut config);
    }
    // The recorded room is not to be replaced, and a certificate of its own is for a fleet.
    config.bridge.page.https.enabled = false;
    choose_ports(&mut config).map_err(|why| ReplayError::Replay(why.to_string()))?;
    if let Some(domain) = args.ros_domain {
        (config.bridge.dds.enabled, config.bridge.dds.domain) = (true, domain.into());
    }
    Ok(config)
}

/// Plays a recording until the process is asked to stop, and returns the player as it is then.
///
/// # Errors
/// A port cannot be opened, or the recording cannot be played.
pub fn run(
    args: &ReplayArgs,
    recorded: &FleetConfig,
    recording: FleetRecording,
    stop: &Stop,
) -> Result<Player, ReplayError> {
    let config = serving_config(&args.serving, recorded)?;
    let failed = |why: io::Error| ReplayError::Replay(why.to_string());
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(failed)?;
    LocalSet::new().block_on(&runtime, async {
        let (address, port) = (config.fleet.address.as_str(), config.fleet.port);
        let cannot_listen = |why| {
            ReplayError::Replay(format!(
                "cannot listen on {address}:{port}: {why}; choose another with --port"
            ))
        };
        let listener = TcpListener::bind((address, port)).await.map_err(cannot_listen)?;
        let port = listener.local_addr().map_err(failed)?.port();
        let transports = open_transports(&config)?;
        let bridge = transports.bridge.clone();
        let mut player = Player::new(recorded.clone(), recording, transports, args.serving.speed)?;
        let services = PlayerServices::open(&bridge, now())
            .map_err(|why| ReplayError::Replay(format!("the services of the replay: {why}")))?;
        let (begins_s, ends_s) = (player.playback().begins_s(), player.playback().ends_s());
        note(&format!("replay of {begins_s:.2} to {ends_s:.2} s of the run; clients connect to port {port}"));
        if let Some(url) = url(&config) {
            note(&format!("page: {url}"));
            let config = config.bridge.page.clone();
            let listeners = bridge::PageListeners::open(&config);
            let run_id = page::run_id(std::process::id(), now());
            spawn_local(page::serve(bridge.clone(), config, run_id, None, None, listeners));
        }
        let clients = spawn_local(bridge::serve(bridge.clone(), listener, now, std::future::pending()));
        play(&mut player, services, &bridge, stop).await;
        clients.abort();
        if let Some(endpoint) = player.take_ros2_endpoint() {
            endpoint.leave().await;
        }
        Ok(player)
    })
}

/// Opens the bridge, and the endpoint of ROS 2 if it is served.
fn open_transports(config: &FleetConfig) -> Result<Transports, ReplayError> {
    let refused = |why: String| ReplayError::Replay(why);
    // What is recorded does not move: velocities go nowhere.
    let bridge = Bridge::new(config.bridge_config(), config.robot_names(), |_, _| {})
        .map_err(|why| refused(why.to_string()))?;
    bridge.mark_replay();
    let bridge = Rc::new(bridge);
    if !config.bridge.dds.enabled {
        return Ok(Transports { bridge, dds: None });
    }
    let queues = Arc::new(DdsQueues::default());
    let commands = queues.clone();
    bridge.on_ros_command(move |command| commands.send_command(command));
    let (events, to) = (queues.clone(), bridge.clone());
    spawn_local(async move {
        loop {
            to.receive_ros(events.next_event().await, now());
        }
    });
    let endpoint = DdsEndpoint::open(&config.bridge_config(), config.robot_names(), false, queues)
        .map_err(|why| refused(why.to_string()))?;
    let endpoint = Rc::new(endpoint);
    spawn_local(endpoint.clone().serve());
    Ok(Transports { bridge, dds: Some(endpoint) })
}

/// Plays until the process is asked to stop.
async fn play(player: &mut Player, mut services: PlayerServices, bridge: &Bridge, stop: &Stop) {
    let keys = Keys::new();
    if keys.available() {
        note("keys: space pauses and goes on   + - speed   , . 10 s back and on   Ctrl-C ends");
    }
    let (mut reported, mut was_over) = (Instant::now(), false);
    while !stop.requested() {
        let has_more = player.turn();
        let apply = |service, request: &[u8], response: &mut Vec<u8>| {
            player_services::apply(service, request, player, response)
        };
        services.answer(bridge, now(), apply).iter().for_each(|done| note(done));
        if let Some(done) = keys.next_key().and_then(|key| player.apply_key(key)) {
            note(&done);
        }
        let playback = player.playback();
        if playback.is_over() && !was_over {
            note(&format!("the recording is over at {:.2} s; seek, or end with Ctrl-C", playback.ends_s()));
        } else if reported.elapsed() > PLACE_PERIOD && !playback.is_over() && !playback.is_paused() {
            note(&format!(
                "{:.0} of {:.0} s, {}",
                playback.position_s(),
                playback.ends_s(),
                playback.speed()
            ));
            reported = Instant::now();
        }
        was_over = playback.is_over();
        if has_more {
            tokio::task::yield_now().await;
        } else {
            tokio::time::sleep(TURN_PAUSE).await;
        }
    }
}
