//! Whether a robot gets a zero in time however its operator vanishes: for each world and each way, the zeros that arrived,
//! and the longest time from the last command to the zero at the robot. Where the bridge dies just after an emergency stop, the zero
//! counts if the stop is kept.
//!
//! `cargo bench --bench safety [-- --trials 100 --world ros --json FILE --check]`. Without `--world` it takes all three.
//!
//! Real processes: a fleet with its bridge; an operator in a process of its own, over TCP or DDS; a robot that listens to
//! `/robot1/cmd_vel`, over DDS in `--world ros` and over TCP otherwise. The operator wishes for 5 m/s.

mod fleet;
mod link;
mod operator;
mod robot;
#[path = "../shared/words.rs"]
mod words;

use fleet::Fleet;
use link::CutLink;
use operator::{Operator, StopButton};
use robot::{Heard, Robot};
use rustix::process::Signal;
use serde_json::json;
use std::error::Error;
use std::time::{Duration, Instant};
use words::Words;

/// Longest time from the last command to a zero at the robot.
const ZERO_WITHIN: Duration = Duration::from_millis(350);
/// The same if the bridge was killed: another process replaces it.
const ZERO_WITHIN_KILLED: Duration = Duration::from_secs(1);
/// The same if the bridge was stopped: the supervisor must find that it hangs first.
const ZERO_WITHIN_STOPPED: Duration = Duration::from_secs(3);
/// Time from an emergency stop to the death of the bridge: it has saved the stop by then.
const KILLED_AFTER_STOP: Duration = Duration::from_millis(5);
/// Limit of every wait for something that a trial needs.
const PATIENCE: Duration = Duration::from_secs(30);
/// How long the operator drives before it vanishes; each trial adds a part of a command's period.
const DRIVEN: Duration = Duration::from_millis(300);
/// The worlds of a fleet.
const WORLDS: [&str; 3] = ["simulator", "headset", "ros"];
/// Largest speed of the default configuration, m/s.
const LINEAR_MAX_M_S: f64 = 0.22;

/// How an operator, or the bridge, vanishes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Vanishing {
    TcpClose,
    TcpSilence,
    TcpFrozen,
    CutLink,
    DdsKilled,
    BridgeKilled,
    BridgeStopped,
    KilledAfterStop,
}

impl Vanishing {
    const ALL: [Self; 8] = [
        Self::TcpClose,
        Self::TcpSilence,
        Self::TcpFrozen,
        Self::CutLink,
        Self::DdsKilled,
        Self::BridgeKilled,
        Self::BridgeStopped,
        Self::KilledAfterStop,
    ];

    fn name(self) -> &'static str {
        match self {
            Self::TcpClose => "TCP connection closed",
            Self::TcpSilence => "TCP client silent",
            Self::TcpFrozen => "TCP client stopped (SIGSTOP)",
            Self::CutLink => "TCP client's link cut",
            Self::DdsKilled => "DDS writer killed (SIGKILL)",
            Self::BridgeKilled => "bridge killed (SIGKILL)",
            Self::BridgeStopped => "bridge stopped (SIGSTOP)",
            Self::KilledAfterStop => "bridge killed 5 ms after stop",
        }
    }

    fn ends_bridge(self) -> bool {
        matches!(self, Self::BridgeKilled | Self::BridgeStopped | Self::KilledAfterStop)
    }

    fn limit(self) -> Duration {
        match self {
            Self::BridgeKilled | Self::KilledAfterStop => ZERO_WITHIN_KILLED,
            Self::BridgeStopped => ZERO_WITHIN_STOPPED,
            _ => ZERO_WITHIN,
        }
    }
}

/// One row of the table.
struct Row {
    zeros: usize,
    trials: usize,
    worst: Duration,
    fastest_m_s: f64,
}

fn main() -> Result<(), Box<dyn Error>> {
    let words: Vec<String> = std::env::args().collect();
    if words.get(1).map(String::as_str) == Some("operator") {
        return operator::run(&words[2], &words[3]);
    }
    let words = Words::parse(&words[1..], &["--trials", "--world"], &["--check"])?;
    let trials = words.number("--trials", 3_usize)?;
    let world = words.value("--world");
    if let Some(world) = world.filter(|world| !WORLDS.contains(world)) {
        return Err(format!("--world {world}: expected one of {}", WORLDS.join(", ")).into());
    }
    let (mut rows, mut missed) = (Vec::new(), 0);
    println!("{:<10} {:<30} {:>9} {:>10} {:>8}", "world", "what vanishes", "zeros", "worst s", "limit s");
    for world in WORLDS.into_iter().filter(|each| world.is_none_or(|world| world == *each)) {
        let mut fleet = None;
        let link = CutLink::open();
        for way in Vanishing::ALL {
            if let (Vanishing::CutLink, Err(why)) = (way, &link) {
                println!("{world:<10} {:<30} not checked: {why}", way.name());
                rows.push(json!({ "world": world, "way": way.name(), "not_checked": why.to_string() }));
                continue;
            }
            let row = measure(world, &mut fleet, way, link.as_ref().ok(), trials)?;
            let limit = way.limit().as_secs_f64();
            let holds = row.zeros == row.trials && row.fastest_m_s <= LINEAR_MAX_M_S;
            missed += usize::from(!holds);
            println!(
                "{world:<10} {:<30} {:>4}/{:<4} {:>10.3} {limit:>8.2} {}",
                way.name(),
                row.zeros,
                row.trials,
                row.worst.as_secs_f64(),
                if holds { "holds" } else { "MISSED" }
            );
            rows.push(json!({
                "world": world, "way": way.name(), "zeros": row.zeros, "trials": row.trials,
                "worst_s": row.worst.as_secs_f64(), "limit_s": limit, "fastest_m_s": row.fastest_m_s, "holds": holds,
            }));
        }
    }
    words.write_json(&rows)?;
    if missed > 0 && words.has("--check") {
        return Err(format!("{missed} rows missed their limit").into());
    }
    Ok(())
}

fn measure(
    world: &str,
    fleet: &mut Option<Fleet>,
    way: Vanishing,
    link: Option<&CutLink>,
    trials: usize,
) -> Result<Row, Box<dyn Error>> {
    let mut row = Row { zeros: 0, trials, worst: Duration::ZERO, fastest_m_s: 0.0 };
    for trial in 0..trials {
        // The supervisor waits longer before each restart of a process that dies again and again.
        if way.ends_bridge() || fleet.is_none() {
            drop(fleet.take());
            *fleet = Some(Fleet::start(world)?);
        }
        let fleet = fleet.as_ref().ok_or("no fleet")?;
        let robot = Robot::listen(fleet)?;
        let phase = operator::PERIOD.mul_f64(trial as f64 / trials as f64);
        let vanished = vanish(fleet, way, link, &robot, DRIVEN + phase)?;
        let heard = robot.heard();
        row.fastest_m_s = heard.iter().map(|heard| heard.linear_m_s.abs()).fold(row.fastest_m_s, f64::max);
        // A robot whose zero never came counts with the time that was waited for it.
        let zero_at = stopped_at(&heard).unwrap_or_else(mr_slam::clock::now);
        let took = Duration::from_nanos(zero_at.since(vanished));
        row.worst = row.worst.max(took);
        // A stop that is forgotten is worse than a late zero.
        let is_kept = way != Vanishing::KilledAfterStop || fleet.is_stopped();
        row.zeros += usize::from(took <= way.limit() && is_kept);
    }
    Ok(row)
}

/// Returns when the robot got the first zero after its last velocity.
fn stopped_at(heard: &[Heard]) -> Option<msg::Monotonic> {
    let last_moving = heard.iter().rposition(|heard| heard.linear_m_s != 0.0)?;
    heard.get(last_moving + 1).map(|heard| heard.at)
}

/// Drives, vanishes, and waits as long as a zero may take; returns the time of the last command.
fn vanish(
    fleet: &Fleet,
    way: Vanishing,
    link: Option<&CutLink>,
    robot: &Robot,
    driven: Duration,
) -> Result<msg::Monotonic, Box<dyn Error>> {
    let tcp = fleet.address();
    let mut operator = match (way, link) {
        (Vanishing::DdsKilled, _) => Operator::start("dds", &fleet.domain.to_string(), None)?,
        (Vanishing::CutLink, Some(link)) => {
            link.connect()?;
            Operator::start("tcp", &link.address(fleet), Some(link))?
        }
        _ => Operator::start("tcp", &tcp, None)?,
    };
    let is_pressed = way == Vanishing::KilledAfterStop;
    let mut button = is_pressed.then(|| StopButton::connect(&tcp)).transpose()?;
    wait("a robot that is driven", || robot.heard().iter().any(|heard| heard.linear_m_s != 0.0))?;
    std::thread::sleep(driven);
    let bridge = fleet.bridge()?;
    let mut last = None;
    match way {
        Vanishing::TcpClose => operator.notify("close")?,
        Vanishing::TcpSilence => operator.notify("silence")?,
        Vanishing::TcpFrozen => operator.signal(Signal::STOP),
        Vanishing::DdsKilled => operator.signal(Signal::KILL),
        Vanishing::CutLink => {
            // What the operator sends from now on reaches nobody.
            link.ok_or("no link")?.cut()?;
            last = Some(mr_slam::clock::now());
        }
        Vanishing::BridgeKilled | Vanishing::BridgeStopped | Vanishing::KilledAfterStop => {
            if let Some(button) = &mut button {
                button.press()?;
                std::thread::sleep(KILLED_AFTER_STOP);
            }
            // The operator's link ends with the bridge; it does not come back.
            last = Some(operator.last_command());
            fleet::send(bridge, if way == Vanishing::BridgeStopped { Signal::STOP } else { Signal::KILL });
            operator.signal(Signal::STOP);
        }
    }
    let begun = Instant::now();
    // A robot that got its zero does not wait longer; later velocities would show that it was none.
    while begun.elapsed() < way.limit() * 2 && (stopped_at(&robot.heard()).is_none() || operator.is_sending())
    {
        std::thread::sleep(Duration::from_millis(5));
    }
    let last = last.unwrap_or_else(|| operator.last_command());
    Ok(last)
}

/// Waits for a condition, at most [`PATIENCE`].
fn wait(what: &str, mut condition: impl FnMut() -> bool) -> Result<(), Box<dyn Error>> {
    let begun = Instant::now();
    while !condition() {
        if begun.elapsed() > PATIENCE {
            return Err(format!("no {what} within {PATIENCE:?}").into());
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    Ok(())
}
