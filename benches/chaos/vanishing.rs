//! The operator is killed just after a process of the fleet was: how soon the robot that it drove is at rest.

use crate::fleet::{Fleet, LOOK_PERIOD, PATIENCE, send};
use crate::kills::median_and_largest;
use crate::operator::Operator;
use crate::watch::Watch;
use crate::{Args, Row, Rows};
use mr_slam::clock::now;
use msg::RobotId;
use rand_xoshiro::SplitMix64;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use rustix::process::Signal;
use serde_json::json;
use std::error::Error;
use std::time::{Duration, Instant};

/// Number of operators that vanish.
const TRIALS: usize = 12;
/// Longest time until the robot is at rest.
const REST_WITHIN_S: f64 = 0.3;
/// Longest time between the death of a process and the operator's: some die while the other is replaced.
const APART_MAX_S: f64 = 0.4;
/// Time in which a robot that is at rest must stay so.
const STAYS: Duration = Duration::from_millis(700);

/// Lets operators vanish, each in a fleet of its own: a robot that drives on meets a wall.
pub fn run(args: &Args) -> Rows {
    let mut random = SplitMix64::seed_from_u64(args.seed);
    let mut uniform = move || f64::from(random.next_u32()) / f64::from(u32::MAX);
    let mut trials = Vec::new();
    for _ in 0..TRIALS {
        trials.push(vanish(args.robots, &mut uniform)?);
    }
    let times: Vec<f64> = trials.iter().map(|(_, rest_s)| *rest_s).collect();
    let (median, largest) = median_and_largest(&times);
    let figures: Vec<_> = trials.iter().map(|(killed, s)| json!({ "killed": killed, "rest_s": s })).collect();
    Ok(vec![
        Row::new(
            "operator",
            &format!("robot at rest after, median and longest of {TRIALS}"),
            format!("{median:.3} s, {largest:.3} s"),
            "<= 0.3 s",
            largest <= REST_WITHIN_S,
        )
        .with(json!(figures)),
    ])
}

/// Returns the process that was killed, and the time from the operator's death until the robot was at rest, seconds.
fn vanish(robots: usize, uniform: &mut impl FnMut() -> f64) -> Result<(String, f64), Box<dyn Error>> {
    let fleet = Fleet::start("up", robots, &[])?;
    let watch = Watch::start(&fleet.run)?;
    let robot = RobotId::new(1).ok_or("no robot")?;
    let operator = Operator::start("tcp", &format!("127.0.0.1:{}", fleet.port), None)?;
    wait("a robot that moves", || watch.moves(robot))?;
    // The simulator of the robot would take its velocity with it.
    let others: Vec<_> =
        fleet.processes().into_iter().filter(|process| process.name != format!("sim of {robot}")).collect();
    let victim =
        others.get((uniform() * others.len() as f64) as usize).ok_or("the fleet has no processes")?;
    send(victim.pid, Signal::KILL);
    std::thread::sleep(Duration::from_secs_f64(APART_MAX_S * uniform()));
    let killed = now();
    operator.signal(Signal::KILL);
    std::thread::sleep(STAYS);
    wait("a robot at rest", || watch.at_rest_since(robot).is_some())?;
    let rest = watch.at_rest_since(robot).ok_or("the robot moves")?;
    Ok((victim.name.clone(), rest.since(killed) as f64 * 1e-9))
}

fn wait(what: &str, mut condition: impl FnMut() -> bool) -> Result<(), Box<dyn Error>> {
    let begun = Instant::now();
    while !condition() {
        if begun.elapsed() > PATIENCE {
            return Err(format!("no {what} within {PATIENCE:?}").into());
        }
        std::thread::sleep(LOOK_PERIOD);
    }
    Ok(())
}
