//! Seeds of generated data on the command line.

use std::ops::Range;

/// The first seed on which nothing may be tuned.
pub const HELD_BACK: u64 = 10_000;
/// Seeds to run: a range, and each how many of it.
#[derive(Clone)]
pub struct Seeds {
    /// From the first to before the last.
    pub range: Range<u64>,
    /// 1: all. 8: one kind of building.
    pub step: u64,
}

/// Reads `FROM..TO` or `FROM..TO/STEP`.
pub fn parse_seeds(text: &str) -> Result<Seeds, String> {
    let (range, step) = text.split_once('/').unwrap_or((text, "1"));
    let range = range.split_once("..").and_then(|(from, to)| Some(from.parse().ok()?..to.parse().ok()?));
    let step = step.parse().ok().filter(|step| *step > 0);
    let seeds = range.filter(|range: &Range<u64>| !range.is_empty()).zip(step);
    seeds
        .map(|(range, step)| Seeds { range, step })
        .ok_or_else(|| format!("--seeds {text}: expected FROM..TO or FROM..TO/STEP, as 0..400"))
}
