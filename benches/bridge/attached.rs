//! What a console costs the other clients of the bridge: figures of one fleet's bridge with a console and without it, in turns.

use crate::fleet::Fleet;
use crate::fleet::browser::wait_for_readers;
use crate::measure::Spread;
use crate::pairs::{Figure, PAIRS, Pairs, in_turns};
use crate::{ROBOTS, at, commands, console, percent_of_bridge, scenes};
use serde::Serialize;
use serde_json::{Value, json};
use std::error::Error;
use std::time::Duration;

/// Duration of the fleet's mix in a window, and the time before it in which client and console get what is there already.
const MIX: Duration = Duration::from_secs(4);
const SETTLES: Duration = Duration::from_secs(1);
/// Time until a fleet has maps.
const FLEET_SETTLES: Duration = Duration::from_secs(10);
/// Number of commands in a window.
const COMMANDS: usize = 100;
/// How much larger a figure may become.
const COST_MAX: f64 = 1.10;

/// Most processor time of the bridge with a console: it has one client more.
const BRIDGE_MAX_PERCENT: f64 = 8.0;

/// What other clients notice: each figure is better if it is less.
const FIGURES: [(&str, Figure<Window>); 6] = [
    ("TF jitter, 18 links at 20 Hz: median, ms", |window| window.tf.p50_ms),
    ("  P95", |window| window.tf.p95_ms),
    ("  P99", |window| window.tf.p99_ms),
    ("cmd_vel field by field to the simulator: median, ms", |window| window.command_ms[0]),
    ("  P95", |window| window.command_ms[1]),
    ("52-byte messages, as fast as they go in: time of one, us", |window| window.message_us),
];

/// Figures of one window.
#[derive(Debug, Serialize)]
struct Window {
    tf: Spread,
    /// Median and 95th percentile.
    command_ms: [f64; 2],
    message_us: f64,
    bridge_percent: f64,
}

impl Window {
    fn measure(fleet: &mut Fleet) -> Result<Self, Box<dyn Error>> {
        let tf = fleet.measure(SETTLES, MIX)?.tf;
        let bridge_percent = percent_of_bridge(fleet);
        let commands = commands::measure(fleet.run(), COMMANDS)?.fleet;
        let (_, _, per_second) = scenes::rate(fleet.run().port, 0, 1)?;
        let command_ms = [at(&commands, 0.5), at(&commands, 0.95)];
        Ok(Self { tf, command_ms, message_us: 1e6 / per_second, bridge_percent })
    }
}

/// Compares windows with a console and without.
pub fn compare() -> Result<Value, Box<dyn Error>> {
    let mut fleet = Fleet::start(ROBOTS)?;
    std::thread::sleep(FLEET_SETTLES);
    let mut pairs = Pairs::<Window>::default();
    in_turns(PAIRS, |has_console| {
        wait_for_readers(fleet.run(), 0)?;
        let console = has_console.then(|| console::Console::start(fleet.run())).transpose()?;
        wait_for_readers(fleet.run(), usize::from(has_console))?;
        let window = Window::measure(&mut fleet)?;
        drop(console);
        pairs.push(has_console, window);
        Ok(())
    })?;
    println!(
        "{ROBOTS} robots, one fleet, {PAIRS} pairs of windows with and without a console; medians of the windows"
    );
    for (what, of) in FIGURES {
        let ([without, with], ratio) = (pairs.medians(of), pairs.ratio(of));
        let holds = if ratio.mean <= COST_MAX { "holds" } else { "MISSED" };
        println!("{what:<58} {without:>8.3} without {with:>8.3} with  {ratio}: {holds}");
    }
    let [without, with] = pairs.medians(|window| window.bridge_percent);
    let holds = if with <= BRIDGE_MAX_PERCENT { "holds" } else { "MISSED" };
    println!(
        "{:<58} {without:>8.3} without {with:>8.3} with  at most {BRIDGE_MAX_PERCENT}: {holds}",
        "bridge's processor time in the mix, % of a core"
    );
    let lost = pairs.sums(|window| window.tf.lost);
    println!("lost transforms: {} without, {} with", lost[0], lost[1]);
    let ratios = FIGURES.map(|(what, of)| json!({"what": what.trim(), "ratio": pairs.ratio(of)}));
    Ok(json!({"attached": "console", "robots": ROBOTS, "windows": pairs, "ratios": ratios, "lost": lost}))
}
