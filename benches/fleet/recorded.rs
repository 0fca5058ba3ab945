//! What recording costs: jitter and losses of a fleet with and without a recorder, measured in turns.

use crate::row::Row;
use serde::Serialize;
use std::error::Error;
use std::time::Duration;

/// Number of fleets with and without a recorder; one after the other, so that a slow minute of the machine hits both.
const TURNS: usize = 3;
/// How much larger the 99th percentile of jitter may become.
const COST_MAX: f64 = 1.05;

/// Figures with and without a recorder.
#[derive(Debug, Serialize)]
pub struct Comparison {
    /// Fleets without a recorder.
    pub without: Vec<Row>,
    /// Fleets with one.
    pub with: Vec<Row>,
    /// Median of the 99th percentiles of jitter: without, with; milliseconds.
    pub p99_ms: [f64; 2],
    /// Scans missed by SLAM and messages missed by the client: without, with.
    pub lost: [u64; 2],
    /// Messages that the recorders missed or dropped.
    pub unrecorded: u64,
}

impl Comparison {
    /// Returns whether recording costs at most 5 % and loses nothing.
    pub fn holds(&self) -> bool {
        self.p99_ms[1] <= COST_MAX * self.p99_ms[0] && self.lost[1] == 0 && self.unrecorded == 0
    }
}

/// Compares fleets of this size.
pub fn compare(robots: usize, length: Duration) -> Result<Comparison, Box<dyn Error>> {
    let (mut without, mut with) = (Vec::new(), Vec::new());
    for _ in 0..TURNS {
        without.push(Row::measure(robots, length, &[])?);
        with.push(Row::measure(robots, length, &["--record"])?);
    }
    let p99 = |rows: &[Row]| {
        let mut values: Vec<f64> = rows.iter().map(|row| row.tf.p99_ms).collect();
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    };
    let lost = |rows: &[Row]| rows.iter().map(|row| row.missed + row.tf.lost).sum();
    let comparison = Comparison {
        p99_ms: [p99(&without), p99(&with)],
        lost: [lost(&without), lost(&with)],
        unrecorded: with.iter().map(|row| row.unrecorded).sum(),
        without,
        with,
    };
    println!("{robots} robots, recorded or not, {TURNS} fleets each");
    for (name, at) in [("without a recorder", 0), ("recorded", 1)] {
        let (p99_ms, lost) = (comparison.p99_ms[at], comparison.lost[at]);
        println!("{name:<20} TF jitter P99 {p99_ms:.3} ms (median of the fleets), {lost} lost");
    }
    let holds = if comparison.holds() { "holds" } else { "MISSED" };
    let cost = 100.0 * (comparison.p99_ms[1] / comparison.p99_ms[0] - 1.0);
    println!("cost {cost:+.1} %, {} messages not recorded: {holds}", comparison.unrecorded);
    Ok(comparison)
}
