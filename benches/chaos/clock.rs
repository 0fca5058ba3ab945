//! Time jumps. A step of the machine's clock would hit all its programs, so this is checked on virtual time.

use crate::{Args, Row, Rows};
use serde_json::json;
use std::process::Command;

/// Number of seeds from which faults are drawn, time jumps among them.
const SEEDS: u64 = 8;
/// Simulated time of each, seconds.
const SECONDS: &str = "40";

/// Runs fleets in lockstep with faults.
pub fn run(args: &Args) -> Rows {
    let mut failures = Vec::new();
    for seed in args.seed..args.seed + SEEDS {
        let ended = Command::new(env!("CARGO_BIN_EXE_mr-slam"))
            .args(["lockstep", "--json", "--seconds", SECONDS, "--faults", &seed.to_string()])
            .output()?;
        if !ended.status.success() {
            let words = String::from_utf8_lossy(&ended.stderr);
            failures.push(format!("seed {seed}: {}", words.lines().last().unwrap_or_default()));
        }
    }
    let row = Row::new(
        "clock",
        "time jumps and other faults in lockstep: seeds that hold",
        format!("{} of {SEEDS}", SEEDS as usize - failures.len()),
        "all",
        failures.is_empty(),
    );
    Ok(vec![row.with(json!({ "failures": failures }))])
}
