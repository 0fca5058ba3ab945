//! Time jumps. A step of the machine's clock would hit all its programs, so this is checked on virtual time.

use crate::{Args, Row, Rows};
use serde_json::json;
use std::process::Command;

/// Number of fleets whose time jumps.
const FLEETS: usize = 8;
/// Seeds that are tried at most: two of three draw a jump among their faults.
const SEEDS_MAX: u64 = 4 * FLEETS as u64;
/// Simulated time of each fleet, seconds.
const SECONDS: &str = "40";
/// Name of a jump in the list of faults that `mr-slam lockstep` prints.
const JUMP: &str = "ClockStep";

/// Runs fleets in lockstep with faults until enough of them had a jump; those without one must hold, too.
pub fn run(args: &Args) -> Rows {
    let (mut failures, mut jumps, mut fleets) = (Vec::new(), 0, 0);
    for seed in args.seed..args.seed + SEEDS_MAX {
        let ended = Command::new(env!("CARGO_BIN_EXE_mr-slam"))
            .args(["lockstep", "--json", "--seconds", SECONDS, "--faults", &seed.to_string()])
            .output()?;
        let words = String::from_utf8_lossy(&ended.stderr);
        fleets += 1;
        jumps += usize::from(words.contains(JUMP));
        if !ended.status.success() {
            failures.push(format!("seed {seed}: {}", words.lines().last().unwrap_or_default()));
        }
        if jumps == FLEETS {
            break;
        }
    }
    let row = Row::new(
        "clock",
        "faults in lockstep: fleets that hold; with jumps of time",
        format!("{} of {fleets}; {jumps}", fleets - failures.len()),
        &format!("all; {FLEETS}"),
        failures.is_empty() && jumps == FLEETS,
    );
    Ok(vec![row.with(json!({ "failures": failures, "jumps": jumps, "fleets": fleets }))])
}
