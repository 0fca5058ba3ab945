//! A robot that explores and a base, joined by slow and lossy links: bytes by kind, the base's map against the robot's, times of
//! the emergency stop, and how long the base needs after an outage and after it was replaced.
//!
//! `cargo bench --features link --bench links [-- --seconds 60 --outage 60 --stops 20 --rates 54,6,1 --losses 0,5,20]`
//!
//! Real processes in two network namespaces, with keys. It needs the rights of the system's administrator, and `ip`, `tc` and
//! `nft`; without them it says so and ends well.

// Its tests use more of it.
#[allow(dead_code)]
#[path = "../../tests/link/fleets.rs"]
mod fleets;
mod network;

use fleets::{Cells, Fleet, LIMIT, until};
use link_transport::keys::{KeyOwner, create_authority, create_key};
use mr_slam::control::{self, Request};
use mr_slam::process::link::LinkReport;
use network::{Network, Side};
use std::path::Path;
use std::time::{Duration, Instant};

/// Cells with this probability of an obstacle, percent, or more are occupied.
const OCCUPIED: i8 = 65;
/// Longest time in which a base must have caught up, and a stop must be on the robot.
const PATIENCE: Duration = Duration::from_secs(120);
/// Time until the map of a robot that stands changes no more.
const STANDING: Duration = Duration::from_secs(3);
/// Period at which a stop is looked for on the robot.
const STOP_POLL: Duration = Duration::from_millis(5);

/// What is measured on which links.
struct Options {
    seconds: f64,
    outage_s: f64,
    stops: usize,
    rates: Vec<f64>,
    losses: Vec<u32>,
}

impl Options {
    fn parse() -> Self {
        let mut options = Self {
            seconds: 60.0,
            outage_s: 60.0,
            stops: 20,
            rates: vec![54.0, 6.0, 1.0],
            losses: vec![0, 5, 20],
        };
        let args: Vec<String> = std::env::args().skip(1).filter(|arg| arg != "--bench").collect();
        for pair in args.chunks(2) {
            let [name, value] = pair else { panic!("{} needs a value", pair[0]) };
            let number = || value.parse::<f64>().unwrap_or_else(|_| panic!("{name}: `{value}` is no number"));
            let list = || {
                value
                    .split(',')
                    .map(|item| item.parse::<f64>().unwrap_or_else(|_| panic!("{name}: `{item}`")))
            };
            match name.as_str() {
                "--seconds" => options.seconds = number(),
                "--outage" => options.outage_s = number(),
                "--stops" => options.stops = number() as usize,
                "--rates" => options.rates = list().collect(),
                "--losses" => options.losses = list().map(|loss| loss as u32).collect(),
                _ => panic!("{name} is no option; see the head of benches/links/main.rs"),
            }
        }
        options
    }
}

/// Figures of one link.
struct Row {
    bytes_s: f64,
    wire_bytes_s: f64,
    kinds: Vec<(String, f64)>,
    f1: f64,
    stop_s: Vec<f64>,
    outage_s: f64,
    replaced_s: f64,
}

fn main() {
    let options = Options::parse();
    if let Err(why) = Network::open(54.0, 5) {
        println!("links: skipped, because network namespaces are not permitted here: {why}");
        return;
    }
    println!(
        "| rate Mbit/s | loss % | sent kB/s | on the wire kB/s | F1 | stop P50 s | P99 s | caught up after {} s outage s | after another base s | by kind kB/s |",
        options.outage_s
    );
    println!("|---|---|---|---|---|---|---|---|---|---|");
    for rate in &options.rates {
        for loss in &options.losses {
            let row = measure(*rate, *loss, &options);
            let kinds: Vec<String> =
                row.kinds.iter().map(|(name, bytes_s)| format!("{name} {:.2}", bytes_s / 1e3)).collect();
            println!(
                "| {rate} | {loss} | {:.2} | {:.2} | {:.3} | {:.3} | {:.3} | {:.1} | {:.1} | {} |",
                row.bytes_s / 1e3,
                row.wire_bytes_s / 1e3,
                row.f1,
                quantile(&row.stop_s, 0.5),
                quantile(&row.stop_s, 0.99),
                row.outage_s,
                row.replaced_s,
                kinds.join(", ")
            );
        }
    }
}

fn measure(rate: f64, loss: u32, options: &Options) -> Row {
    let network = Network::open(rate, loss).expect("it was permitted before");
    let folder = tempfile::tempdir().expect("a folder");
    let keys = folder.path().join("keys");
    create_authority(&keys).expect("an authority");
    let base_key = create_key(&keys, &KeyOwner::Base).expect("a key").display().to_string();
    let robot_key = create_key(&keys, &KeyOwner::Robot("alice".into())).expect("a key").display().to_string();
    let endpoint = format!("tls/{}:7447", Network::address(Side::Base));
    let start_base = |name: &str| {
        let args = ["base", "--names", "alice", "--listen", &endpoint, "--keys", &base_key];
        start(&network, Side::Base, folder.path(), name, &endpoint, &args)
    };
    let mut base = start_base("base");
    let args = ["robot", "--name", "alice", "--base", &endpoint, "--keys", &robot_key, "--explore"];
    let mut robot = start(&network, Side::Robot, folder.path(), "robot", &endpoint, &args);
    until("the base has a map", LIMIT, || (base.cells("robot1_map").len() > 100).then_some(()));

    let (begun, bytes_before) = (Instant::now(), network.robot_bytes());
    let kinds_before = kinds(&robot);
    std::thread::sleep(Duration::from_secs_f64(options.seconds));
    let seconds = begun.elapsed().as_secs_f64();
    let wire_bytes_s = (network.robot_bytes() - bytes_before) as f64 / seconds;
    let per_second = |(name, bytes): (String, u64)| {
        let before = kinds_before.iter().find(|(other, _)| *other == name).map_or(0, |(_, bytes)| *bytes);
        (name, bytes.saturating_sub(before) as f64 / seconds)
    };
    let kinds: Vec<(String, f64)> = kinds(&robot).into_iter().map(per_second).collect();

    let outage_s = outage(&network, &mut base, &mut robot, options.outage_s);
    control::ask(&robot.run, Request::Release, PATIENCE).expect("a release");
    let stop_s: Vec<f64> = (0..options.stops).map(|_| time_of_stop(&base, &robot)).collect();
    // At the base the first robot's map is the reference of the merged one.
    let f1 = f1(&base.cells("merged_map"), &robot.cells("robot1_map"));
    drop(base);
    let begun = Instant::now();
    let mut base = start_base("base2");
    until("another base has the map", PATIENCE, || has_map(&mut base, &mut robot));
    let replaced_s = begun.elapsed().as_secs_f64();
    let bytes_s = kinds.iter().map(|(_, bytes_s)| bytes_s).sum();
    Row { bytes_s, wire_bytes_s, kinds, f1, stop_s, outage_s, replaced_s }
}

fn start(network: &Network, side: Side, folder: &Path, name: &str, endpoint: &str, args: &[&str]) -> Fleet {
    let command = network.command(side, env!("CARGO_BIN_EXE_mr-slam"));
    Fleet::start_command(command, folder, name, endpoint, args)
}

/// Returns the bytes that the robot has sent, by kind.
fn kinds(robot: &Fleet) -> Vec<(String, u64)> {
    let report = LinkReport::read(&robot.run.dir).unwrap_or_default();
    report.peers.into_iter().flat_map(|peer| peer.bytes).collect()
}

/// Returns whether the base has the robot's map as it is, but for what the robot drew in the last moment.
fn has_map(base: &mut Fleet, robot: &mut Fleet) -> Option<()> {
    let own = robot.cells("robot1_map");
    (own.len() > 100 && base.cells("robot1_map") == own).then_some(())
}

/// Sets the base's stop, and returns how long the robot's took; releases both.
fn time_of_stop(base: &Fleet, robot: &Fleet) -> f64 {
    let begun = Instant::now();
    control::ask(&base.run, Request::Stop, PATIENCE).expect("a stop");
    wait_for_stop(robot, true);
    let seconds = begun.elapsed().as_secs_f64();
    control::ask(&base.run, Request::Release, PATIENCE).expect("a release");
    wait_for_stop(robot, false);
    seconds
}

fn wait_for_stop(robot: &Fleet, is_stopped: bool) {
    let begun = Instant::now();
    while robot.is_stopped() != Some(is_stopped) {
        assert!(begun.elapsed() < PATIENCE, "the robot's stop is not {is_stopped} within {PATIENCE:?}");
        std::thread::sleep(STOP_POLL);
    }
}

/// Cuts the link while the robot explores, stops the robot, and returns how long the base needs after the link is back.
fn outage(network: &Network, base: &mut Fleet, robot: &mut Fleet, seconds: f64) -> f64 {
    network.set_up(false).expect("the link can be cut");
    std::thread::sleep(Duration::from_secs_f64(seconds));
    control::ask(&robot.run, Request::Stop, PATIENCE).expect("a stop");
    std::thread::sleep(STANDING);
    network.set_up(true).expect("the link can be mended");
    let begun = Instant::now();
    until("the base has caught up", PATIENCE, || has_map(base, robot));
    begun.elapsed().as_secs_f64()
}

/// Returns the F1 of the occupied cells of one map against another's, cell by cell.
fn f1(map: &Cells, reference: &Cells) -> f64 {
    let is_occupied = |cells: &Cells, at: &(i64, i64)| cells.get(at).is_some_and(|cell| *cell >= OCCUPIED);
    let count = |cells: &Cells| cells.keys().filter(|at| is_occupied(cells, at)).count() as f64;
    let both = map.keys().filter(|at| is_occupied(map, at) && is_occupied(reference, at)).count() as f64;
    2.0 * both / (count(map) + count(reference)).max(1.0)
}

fn quantile(values: &[f64], fraction: f64) -> f64 {
    let mut values = values.to_vec();
    values.sort_by(f64::total_cmp);
    let index = (fraction * values.len() as f64) as usize;
    values.get(index).or(values.last()).copied().unwrap_or(f64::NAN)
}
