//! Robots that explore and a base, joined by slow and lossy links: bytes by kind, processor time and memory, the base's map
//! against the robots', times of the emergency stop, and how long the base needs after outages and after it was replaced.
//!
//! One robot on several links:
//! `cargo bench --features link --bench links [-- --seconds 60 --outage 60 --stops 20 --rates 54,6,1 --losses 0,5,20 --protocol quic|tls]`
//!
//! Many robots behind a router, the last two of which come late:
//! `cargo bench --features link --bench links -- --robots 8 [--seconds 60 --outage 60 --rates 6 --losses 0 --starts unknown]`
//!
//! Real processes in network namespaces, with keys. It needs the rights of the system's administrator, and `ip`, `tc` and
//! `nft`; without them it says so and ends well.

mod fleet;
// Its tests use more of it.
#[allow(dead_code)]
#[path = "../../tests/link/fleets.rs"]
mod fleets;
mod machines;
mod network;

use fleets::{Fleet, LIMIT, until};
use machines::{PATIENCE, STANDING, Site, Usage, f1, has_map, time_to_catch_up};
use mr_slam::control::{self, Request};
use network::{Link, Network, Side};
use std::time::{Duration, Instant};

/// Period at which a stop is looked for on the robot.
const STOP_POLL: Duration = Duration::from_millis(5);

/// What is measured on which links.
struct Options {
    seconds: f64,
    outage: Duration,
    stops: usize,
    rates: Vec<f64>,
    losses: Vec<u32>,
    /// Number of robots; 1: one robot on several links.
    robots: usize,
    are_starts_known: bool,
    /// Protocol below Zenoh, `quic` or `tls`.
    protocol: String,
}

impl Options {
    fn parse() -> Self {
        let mut options = Self {
            seconds: 60.0,
            outage: Duration::from_secs(60),
            stops: 20,
            rates: vec![54.0, 6.0, 1.0],
            losses: vec![0, 5, 20],
            robots: 1,
            are_starts_known: true,
            protocol: "quic".into(),
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
                "--outage" => options.outage = Duration::from_secs_f64(number()),
                "--stops" => options.stops = number() as usize,
                "--rates" => options.rates = list().collect(),
                "--losses" => options.losses = list().map(|loss| loss as u32).collect(),
                "--robots" => options.robots = number() as usize,
                "--protocol" => options.protocol = value.clone(),
                "--starts" => options.are_starts_known = value != "unknown",
                _ => panic!("{name} is no option; see the head of benches/links/main.rs"),
            }
        }
        options
    }

    fn links(&self) -> impl Iterator<Item = Link> {
        self.rates.iter().flat_map(|mbit_s| {
            self.losses.iter().map(|loss_percent| Link { mbit_s: *mbit_s, loss_percent: *loss_percent })
        })
    }
}

/// Figures of one link to one robot.
struct Row {
    usage: Usage,
    f1: f64,
    stop_s: Vec<f64>,
    outage_s: f64,
    replaced_s: f64,
}

fn main() {
    let options = Options::parse();
    if let Err(why) = Network::open(Link { mbit_s: 54.0, loss_percent: 5 }, 1, true) {
        println!("links: skipped, because network namespaces are not permitted here: {why}");
        return;
    }
    if options.robots > 1 {
        options.links().for_each(|link| fleet::measure(link, &options));
        return;
    }
    println!(
        "| rate Mbit/s | loss % | sent kB/s | on the wire kB/s | F1 | stop P50 s | P99 s | caught up after {:.0} s outage s | after another base s | CPU % of a core | memory MB | by kind kB/s |",
        options.outage.as_secs_f64()
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|");
    for link in options.links() {
        let row = measure(link, &options);
        println!(
            "| {} | {} | {:.2} | {:.2} | {:.3} | {:.3} | {:.3} | {:.1} | {:.1} | {:.1} | {:.0} | {} |",
            link.mbit_s,
            link.loss_percent,
            row.usage.bytes() / 1e3,
            row.usage.wire_bytes / 1e3,
            row.f1,
            quantile(&row.stop_s, 0.5),
            quantile(&row.stop_s, 0.99),
            row.outage_s,
            row.replaced_s,
            row.usage.cpu_s * 1e2,
            row.usage.memory / 1e6,
            row.usage.kinds()
        );
    }
}

fn measure(link: Link, options: &Options) -> Row {
    let network = Network::open(link, 1, false).expect("it was permitted before");
    let site = Site::new(network, vec!["alice".into()], false, &options.protocol);
    let mut base = site.start_base("base", &[]);
    let mut robot = site.start_robot(0, &[]);
    until("the base has a map", LIMIT, || (base.cells("robot1_map").len() > 100).then_some(()));

    let (begun, before) = (Instant::now(), Usage::read(&site, 0, &robot));
    std::thread::sleep(Duration::from_secs_f64(options.seconds));
    let usage = Usage::read(&site, 0, &robot).since(&before, begun.elapsed().as_secs_f64());

    site.network.set_up(Side::Robot(0), false);
    std::thread::sleep(options.outage);
    control::ask(&robot.run, Request::Stop, PATIENCE).expect("a stop");
    std::thread::sleep(STANDING);
    site.network.set_up(Side::Robot(0), true);
    let outage_s = time_to_catch_up("the base has caught up", &mut base, [(0, &mut robot)]);

    control::ask(&robot.run, Request::Release, PATIENCE).expect("a release");
    let stop_s: Vec<f64> = (0..options.stops).map(|_| time_of_stop(&base, &robot)).collect();
    // At the base the first robot's map is the reference of the merged one.
    let f1 = f1(&base.cells("merged_map"), &robot.cells("robot1_map"));
    base.kill();
    let begun = Instant::now();
    let mut base = site.start_base("base2", &[]);
    until("another base has the map", PATIENCE, || has_map(&mut base, 0, &mut robot).then_some(()));
    let replaced_s = begun.elapsed().as_secs_f64();
    Row { usage, f1, stop_s, outage_s, replaced_s }
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

fn quantile(values: &[f64], fraction: f64) -> f64 {
    let mut values = values.to_vec();
    values.sort_by(f64::total_cmp);
    let index = (fraction * values.len() as f64) as usize;
    values.get(index).or(values.last()).copied().unwrap_or(f64::NAN)
}
