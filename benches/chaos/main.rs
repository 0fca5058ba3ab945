//! Chaos: what a fleet keeps up while its processes are killed or stopped, and resources of the machine run out.
//!
//! `cargo bench --bench chaos [-- --minutes 10 --kills 100 --seconds 30 --seed 1 --robots 3 --parts kills,hogs --json FILE --check]`
//!
//! Parts: `kills` (random processes are killed), `stops` (each kind is stopped for 5 s), `starts` (fleets are stopped while they start), `disk` (full while recording and
//! saving), `shm` (shared memory is full), `hogs` (both cores are busy), `clock` (time jumps, in lockstep), `operator` (it
//! vanishes while another process is killed). What the machine does not permit is not checked, and the table says so.

mod clock;
mod confined;
mod footprint;
mod hogs;
mod kills;
#[path = "../launcher.rs"]
mod launcher;
mod starts;
mod stops;
mod vanishing;
mod watch;
#[path = "../shared/words.rs"]
mod words;

#[allow(dead_code, reason = "the chaos bench needs no signals of it but the operator's")]
#[path = "../shared/fleet.rs"]
mod fleet;
#[allow(dead_code, reason = "the safety bench cuts links")]
#[path = "../safety/link.rs"]
mod link;
#[path = "../shared/map_cells.rs"]
mod map_cells;
#[allow(dead_code, reason = "the jitter bench uses all of it")]
#[path = "../jitter/measure.rs"]
mod measure;
#[allow(dead_code, reason = "the jitter bench uses all of it")]
#[path = "../jitter/fleet.rs"]
mod measured_fleet;
#[allow(dead_code, reason = "the safety bench uses all of it")]
#[path = "../safety/operator.rs"]
mod operator;
#[path = "../bridge/peer.rs"]
mod peer;

use serde::{Deserialize, Serialize};
use std::error::Error;
use std::time::Duration;
use words::Words;

/// Parts in the order in which they are run.
const PARTS: [&str; 8] = ["kills", "stops", "starts", "operator", "disk", "shm", "hogs", "clock"];

/// One row of the table.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Row {
    /// Part of the bench.
    pub part: String,
    /// What was measured.
    pub what: String,
    /// What came out.
    pub measured: String,
    /// What is required.
    pub limit: String,
    /// Whether it holds; `None`: it was not checked, or nothing is required.
    pub holds: Option<bool>,
    /// Figures for programs.
    pub figures: serde_json::Value,
}

impl Row {
    /// Creates a row that has a requirement.
    pub fn new(part: &str, what: &str, measured: String, limit: &str, holds: bool) -> Self {
        Self {
            part: part.into(),
            what: what.into(),
            measured,
            limit: limit.into(),
            holds: Some(holds),
            figures: serde_json::Value::Null,
        }
    }

    /// Creates a row that only tells something.
    pub fn note(part: &str, what: &str, measured: String) -> Self {
        Self { holds: None, ..Self::new(part, what, measured, "", true) }
    }

    /// Adds figures for programs.
    pub fn with(self, figures: serde_json::Value) -> Self {
        Self { figures, ..self }
    }

    fn outcome(&self) -> &'static str {
        match self.holds {
            Some(true) => "holds",
            Some(false) => "MISSED",
            None => "",
        }
    }

    fn print(&self) {
        let Self { part, what, measured, limit, .. } = self;
        println!("{part:<9} {what:<52} {measured:<46} {limit:<14} {}", self.outcome());
    }
}

/// What the command line asks for.
pub struct Args {
    /// Duration of the kills.
    pub minutes: f64,
    /// Number of kills.
    pub kills: u32,
    /// Duration of each measurement under load.
    pub length: Duration,
    /// Seed of the random choices.
    pub seed: u64,
    /// Number of robots.
    pub robots: usize,
    parts: Vec<String>,
}

impl Args {
    fn new(words: &Words) -> Result<Self, Box<dyn Error>> {
        let minutes = words.number("--minutes", 10.0)?;
        let names = words.value("--parts").map_or_else(|| PARTS.join(","), str::to_owned);
        let parts: Vec<String> = names.split(',').map(str::to_owned).collect();
        if let Some(wrong) = parts.iter().find(|part| !PARTS.contains(&part.as_str())) {
            return Err(format!("--parts {wrong}: expected some of {}", PARTS.join(",")).into());
        }
        Ok(Self {
            minutes,
            kills: words.number("--kills", 10.0 * minutes)?.max(1.0) as u32,
            length: Duration::from_secs_f64(words.number("--seconds", 30.0)?),
            seed: words.number("--seed", 1)?,
            robots: words.number("--robots", 3_usize)?.max(2),
            parts,
        })
    }
}

type Rows = Result<Vec<Row>, Box<dyn Error>>;

/// Has this process killed when the one that started it ends. Returns false if that cannot be had.
fn ends_with_parent() -> bool {
    rustix::process::set_parent_process_death_signal(Some(rustix::process::Signal::KILL)).is_ok()
}

/// Reads the words of the command line.
fn options(words: &[String]) -> Result<Words, String> {
    Words::parse(words, &["--minutes", "--kills", "--seconds", "--seed", "--robots", "--parts"], &["--check"])
}

fn main() -> Result<(), Box<dyn Error>> {
    let words: Vec<String> = std::env::args().collect();
    // The bench runs this program again: as operator, as ROS 2 peer, as load, and in a file system of its own.
    match words.get(1).map(String::as_str) {
        Some("operator") => return operator::run(&words[2], &words[3]),
        Some("ros-peer") => return peer::listen(words[2].parse()?, Duration::from_secs(words[3].parse()?)),
        Some("hog") => hogs::spin(),
        // With the bench outside, whose part it is.
        Some(confined::DISK | confined::SHM) if !ends_with_parent() => return Err("the bench is gone".into()),
        Some(confined::DISK) => {
            return confined::print(&confined::disk(&Args::new(&options(&words[2..])?)?)?);
        }
        Some(confined::SHM) => {
            return confined::print(&confined::shared_memory(&Args::new(&options(&words[2..])?)?)?);
        }
        _ => {}
    }
    let options = options(&words[1..])?;
    let args = Args::new(&options)?;
    println!("{:<9} {:<52} {:<46} {:<14}", "part", "what", "measured", "required");
    let mut rows = Vec::new();
    for part in PARTS.iter().filter(|part| args.parts.iter().any(|wished| wished == *part)) {
        let of_part = match *part {
            "kills" => kills::run(&args),
            "stops" => stops::run(&args),
            "starts" => starts::run(&args),
            "disk" => confined::run(confined::DISK, &words),
            "shm" => confined::run(confined::SHM, &words),
            "hogs" => hogs::run(&args),
            "clock" => clock::run(&args),
            _ => vanishing::run(&args),
        };
        // A part that cannot be run is a part that does not hold; the others are run all the same.
        let of_part = of_part
            .unwrap_or_else(|why| vec![Row::new(part, "the part ran", why.to_string(), "runs", false)]);
        of_part.iter().for_each(Row::print);
        rows.extend(of_part);
    }
    let missed = rows.iter().filter(|row| row.holds == Some(false)).count();
    options.write_json(&serde_json::json!({
        "minutes": args.minutes, "kills": args.kills, "seed": args.seed, "robots": args.robots, "rows": rows,
    }))?;
    if missed > 0 && options.has("--check") {
        return Err(format!("{missed} rows do not hold").into());
    }
    Ok(())
}
