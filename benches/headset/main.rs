//! The mode of the paper: the robots live in a headset, and their scans come over a link to SLAM on the laptop.
//!
//! `cargo bench --bench headset [-- --seconds 60 --json FILE]`
//!
//! Three robots send scans at 10 Hz, transforms at 20 Hz and the clock at 100 Hz, over loopback and over links that stand
//! for Wi-Fi (see `LinkChoice`; the paper does not say how its own behaved). Counted is what SLAM received.

#[allow(dead_code, reason = "the jitter bench uses all of it")]
#[path = "../jitter/fleet.rs"]
mod fleet;
#[path = "../../tests/all/headset_app.rs"]
mod headset_app;
#[path = "../launcher.rs"]
mod launcher;
#[allow(dead_code, reason = "the jitter bench uses all of it")]
#[path = "../jitter/measure.rs"]
mod measure;
#[path = "../shared/words.rs"]
mod words;

use headset::wireless::{Link, LinkChoice, proxy};
use headset_app::Headset;
use mr_slam::config::{FleetConfig, RobotSource};
use mr_slam::observer::Observer;
use mr_slam::run::Run;
use reports::{FleetView, RobotView};
use serde_json::json;
use std::error::Error;
use std::io::Write;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use words::Words;

const ROBOTS: usize = 3;
const SEED: u64 = 1;
const WARM_UP: Duration = Duration::from_secs(4);
/// Longest wait for a fleet's figures.
const FIGURES_MAX: Duration = Duration::from_secs(20);
/// Scan rate of the paper's robots, Hz.
const PAPER_HZ: f64 = 8.83;

fn main() -> Result<(), Box<dyn Error>> {
    let words: Vec<String> = std::env::args().collect();
    let words = Words::parse(&words[1..], &["--seconds"], &[])?;
    let length = Duration::from_secs(words.number("--seconds", 60)?);
    println!(
        "{:<20} {:>10} {:>8} {:>16} {:>16}",
        "link", "scans, Hz", "lost", "TF jitter, ms", "scan to pose, ms"
    );
    println!("{:<20} {:>10} {:>8} {:>16} {:>16}", "", "slowest", "", "median   P95", "median   P95");
    let mut rows = Vec::new();
    for link in LinkChoice::ALL {
        let row = measure(link.link(), length)?;
        println!(
            "{:<20} {:>10.2} {:>8} {:>8.2} {:>7.2} {:>8.2} {:>7.2}",
            link.name(),
            row.scan_hz,
            row.lost,
            row.jitter_ms[0],
            row.jitter_ms[1],
            row.pose_ms[0],
            row.pose_ms[1]
        );
        rows.push(json!({
            "link": link.name(), "scan_hz": row.scan_hz, "scans_lost": row.lost,
            "tf_jitter_median_ms": row.jitter_ms[0], "tf_jitter_p95_ms": row.jitter_ms[1],
            "scan_to_pose_median_ms": row.pose_ms[0], "scan_to_pose_p95_ms": row.pose_ms[1],
        }));
    }
    println!("the paper, over its own Wi-Fi: {PAPER_HZ} Hz, TF jitter 6.3 ms (median)");
    words.write_json(&json!({ "robots": ROBOTS, "seconds": length.as_secs(), "rows": rows }))
}

/// Figures of one link.
struct Row {
    /// Rate of the slowest robot's scans at SLAM, Hz.
    scan_hz: f64,
    /// Number of scans that were sent and did not reach SLAM, all robots together.
    lost: u64,
    /// Largest over the robots: median and 95th percentile.
    jitter_ms: [f64; 2],
    pose_ms: [f64; 2],
}

fn measure(link: Link, length: Duration) -> Result<Row, Box<dyn Error>> {
    let (fleet, config) = start_fleet()?;
    let run = fleet.run();
    let headset = Headset::attach(proxy::start(link, run.port, SEED)?, &config);
    let mut reading = headset.stream.try_clone()?;
    // What the bridge sends is discarded, so that its queues do not fill.
    std::thread::spawn(move || std::io::copy(&mut reading, &mut std::io::sink()));
    let stop = Arc::new(AtomicBool::new(false));
    let stopped = stop.clone();
    let player = std::thread::spawn(move || headset.play(false, &stopped));
    std::thread::sleep(WARM_UP);
    let before = view(run)?;
    std::thread::sleep(length);
    let after = view(run)?;
    stop.store(true, Ordering::Relaxed);
    player.join().map_err(|_| "the headset failed")?;
    let seconds = after.time_s - before.time_s;
    let pairs = || before.robots.iter().zip(&after.robots);
    let hz = pairs().map(|(then, now)| (now.scans - then.scans) as f64 / seconds);
    let worst = |of: fn(&RobotView) -> f32| f64::from(after.robots.iter().map(of).fold(0.0, f32::max));
    Ok(Row {
        scan_hz: hz.fold(f64::INFINITY, f64::min),
        lost: pairs().map(|(then, now)| now.scans_lost.unwrap_or(0) - then.scans_lost.unwrap_or(0)).sum(),
        jitter_ms: [
            worst(|robot| robot.tf_jitter_ms.p50.unwrap_or(f32::INFINITY)),
            worst(|robot| robot.tf_jitter_ms.p95.unwrap_or(f32::INFINITY)),
        ],
        pose_ms: [
            worst(|robot| robot.scan_to_pose_ms.p50.unwrap_or(f32::INFINITY)),
            worst(|robot| robot.scan_to_pose_ms.p95.unwrap_or(f32::INFINITY)),
        ],
    })
}

/// Starts a fleet whose robots live in a headset; returns it with its configuration.
fn start_fleet() -> Result<(fleet::Fleet, FleetConfig), Box<dyn Error>> {
    let mut config = FleetConfig { world: RobotSource::Headset, ..FleetConfig::default() };
    let starts = mr_slam::world::room(&config)?.starts(ROBOTS)?;
    config.fleet.starts = starts.iter().map(|start| [start.x_m, start.y_m, start.yaw_rad]).collect();
    config.fleet.robots = ROBOTS;
    let starts = &config.fleet.starts;
    let mut file = tempfile::NamedTempFile::with_suffix(".toml")?;
    write!(file, "world = \"headset\"\n[fleet]\nrobots = {ROBOTS}\nstarts = {starts:?}\n")?;
    let path = file.path().to_str().ok_or("the temporary folder's name is not UTF-8")?;
    Ok((fleet::Fleet::start_with(ROBOTS, &["--config", path])?, config))
}

/// Returns a fleet's newest figures.
fn view(run: &Run) -> Result<FleetView, Box<dyn Error>> {
    let mut observer = Observer::attach(run, "headset")?;
    let begun = Instant::now();
    while begun.elapsed() < FIGURES_MAX {
        observer.wait(Duration::from_secs(2));
        observer.poll();
        if let Some(stats) = observer.stats() {
            return Ok(FleetView::new(stats));
        }
    }
    Err("no figures came".into())
}
