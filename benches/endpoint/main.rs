//! Our bridge beside Unity's ROS-TCP-Endpoint (Python): the same ROS 2 peer, the same client, the same topics, one run.
//!
//! `cargo bench --bench endpoint -- --checkout FOLDER --python PROGRAM [--seconds 20 --rounds 3 --json FILE]`
//!
//! `FOLDER` is a checkout of ROS-TCP-Endpoint, branch `main-ros2`. `PROGRAM` is a Python with `rclpy` and the packages of
//! `tests/interop/requirements.txt`. Both endpoints stand between a client on TCP and an rclpy node on DDS, so
//! each message has one hop on DDS and one on TCP. The rounds take turns, so that both meet the same machine.

mod endpoints;
#[allow(dead_code, reason = "the jitter bench uses all of it")]
#[path = "../jitter/fleet.rs"]
mod fleet;
#[path = "../launcher.rs"]
mod launcher;
mod load;
#[allow(dead_code, reason = "the jitter bench uses all of it")]
#[path = "../jitter/measure.rs"]
mod measure;
mod peer;

use endpoints::{Endpoint, Kind};
use load::Sample;
use serde_json::{Value, json};
use std::error::Error;
use std::path::PathBuf;
use std::time::Duration;

/// Time until each side has discovered the other on DDS.
const DISCOVERY: Duration = Duration::from_secs(4);

struct Args {
    checkout: PathBuf,
    python: PathBuf,
    seconds: u64,
    rounds: usize,
    json: Option<PathBuf>,
}

fn args() -> Result<Args, Box<dyn Error>> {
    let (mut checkout, mut python, mut json) = (None, None, None);
    let (mut seconds, mut rounds) = (20, 3);
    let mut given = std::env::args().skip(1);
    while let Some(name) = given.next() {
        let mut value = || given.next().ok_or(format!("{name} needs a value"));
        match name.as_str() {
            "--checkout" => checkout = Some(value()?.into()),
            "--python" => python = Some(value()?.into()),
            "--json" => json = Some(value()?.into()),
            "--seconds" => seconds = value()?.parse()?,
            "--rounds" => rounds = value()?.parse()?,
            // `cargo bench` passes this argument to every bench.
            "--bench" => {}
            other => {
                return Err(
                    format!("{other}: expected --checkout, --python, --seconds, --rounds or --json").into()
                );
            }
        }
    }
    let checkout =
        checkout.ok_or("--checkout FOLDER is missing: a checkout of ROS-TCP-Endpoint, branch main-ros2")?;
    let python = python.ok_or("--python PROGRAM is missing: a Python that has rclpy")?;
    Ok(Args { checkout, python, seconds, rounds, json })
}

fn main() -> Result<(), Box<dyn Error>> {
    let args = args()?;
    let length = Duration::from_secs(args.seconds);
    let mut samples = [(Kind::Python, Sample::default()), (Kind::Ours, Sample::default())];
    for round in 1..=args.rounds {
        for (kind, sample) in &mut samples {
            eprintln!("round {round} of {}: {}, {} s", args.rounds, kind.name(), args.seconds);
            sample.extend(measure(*kind, &args, length)?);
        }
    }
    println!("{:<50} {:>22} {:>12}", "", Kind::Python.name(), Kind::Ours.name());
    let [(_, python), (_, ours)] = &samples;
    let mut rows = Vec::new();
    for ((what, theirs), (_, mine)) in python.rows().into_iter().zip(ours.rows()) {
        println!("{what:<50} {theirs:>22.3} {mine:>12.3}");
        rows.push(json!({ "what": what, "python_endpoint": finite(theirs), "mr_slam": finite(mine) }));
    }
    if let Some(path) = args.json {
        let report = json!({ "seconds": args.seconds, "rounds": args.rounds, "rows": rows });
        std::fs::write(path, serde_json::to_string_pretty(&report)?)?;
    }
    Ok(())
}

fn finite(value: f64) -> Value {
    if value.is_finite() { json!(value) } else { Value::Null }
}

/// Runs one endpoint between the peer and the clients.
fn measure(kind: Kind, args: &Args, length: Duration) -> Result<Sample, Box<dyn Error>> {
    let domain = peer::domain();
    let endpoint = Endpoint::start(kind, domain, &args.checkout, &args.python)?;
    let mut peer = peer::Peer::start(&args.python, domain, length)?;
    let load = load::Load::start(endpoint.port, DISCOVERY, length)?;
    std::thread::sleep(DISCOVERY);
    let cpu_before_s = endpoint.cpu_s()?;
    peer.begin()?;
    let (received, commands_sent) = load.join().map_err(|why| why.to_string())?;
    let cpu_percent = 100.0 * (endpoint.cpu_s()? - cpu_before_s) / length.as_secs_f64();
    let said = peer.end()?;
    Ok(Sample::new(received, &said, commands_sent, cpu_percent))
}
