//! SLAM on real logs: accuracy, time and memory of each, in one table, with one configuration.
//!
//! `cargo bench --bench slam [-- --data DIR] [--logs intel,csail@90] [--json FILE] [--check]`
//!
//! DIR (default `../shared/data/lidar`) holds a folder a log: `NAME.log.gz` (CARMEN),
//! `official.relations` or `substitute.relations`, and `dense_odom.traj.gz` where there is one.
//! `name@90` crops the scans to their central 90°. Every log runs in a process of its own.
//! Errors are mean translation errors of the relation metric (Kümmerle et al. 2009). `--check`
//! fails if an error is above its limit, if a robot was found at a wrong place, or if a log to be
//! checked is missing. The last line names the logs that are missing.
//!
//! `--logs relocalize`: a robot is looked for without a guess in the map of the first
//! half of intel, put down in its second half, and in other buildings, where it must not be found.
//!
//! `--logs varied` (10 to 20 minutes, mostly a few rows; `varied/csail`: one log): the logs as other robots would have made
//! them (`varied.rs`), to find where the default configuration generalises badly. `--logs generated [--seeds 0..400[/8]]`: buildings, robots and accidents drawn from
//! seeds, with known truth (`generated/`); seeds from 10000 on are held back from tuning. `--logs wrong-sensors [--seeds 0..96]`: the
//! same logs with sensors that are not as described (`generated/wrong_sensor.rs`), and whether SLAM says so. `--logs carried`, `--logs stood`: the same logs, and
//! every robot is carried some metres, or stands, while nothing is recorded. `--maps DIR` writes
//! every log's map there, as YAML, PGM and PNG. `--scale links.sigma_min_rad=1.3` multiplies a number of SLAM's configuration, and can
//! be given more than once (`scripts/slam-sensitivity` does so with all numbers in turn).

mod drive;
mod generated;
mod noise;
mod relations;
mod relocalize;
mod seeds;
mod settings;
mod table;
mod varied;

use drive::{Outcome, Task};
use generated::Event;
use seeds::Seeds;
use std::path::{Path, PathBuf};
use std::process::Command;
use varied::{VARIATIONS, Varied};

/// A log and what others, and we, want of it.
pub struct Row {
    /// The folder's name, and `@` with the field of view where it is cropped.
    pub name: &'static str,
    /// SLAM Toolbox's core on it, metres: all relations, revisits (where known).
    pub toolbox_m: [Option<f64>; 2],
    /// What must be reached: all, revisits, both kept.
    pub limits_m: [Option<f64>; 3],
}

const fn row(name: &'static str, toolbox_m: [Option<f64>; 2], limits_m: [Option<f64>; 3]) -> Row {
    Row { name, toolbox_m, limits_m }
}

const ROWS: [Row; 12] = [
    row("intel", [Some(0.173), Some(0.324)], [Some(0.072), Some(0.072), Some(0.041)]),
    row("csail", [Some(0.175), Some(1.97)], [Some(0.05), Some(0.10), None]),
    row("aces", [Some(0.047), Some(0.076)], [Some(0.047), Some(0.076), None]),
    row("freiburg-101", [Some(0.060), Some(0.125)], [Some(0.055), Some(0.10), None]),
    row("edmonton", [Some(0.094), Some(0.487)], [Some(0.06), Some(0.12), None]),
    row("acapulco", [Some(0.151), Some(5.65)], [Some(0.07), Some(0.20), None]),
    row("belgioioso", [Some(0.033), Some(0.055)], [Some(0.033), Some(0.055), None]),
    row("fhw", [Some(0.121), Some(0.25)], [Some(0.06), Some(0.08), None]),
    row("intel@90", [Some(0.546), None], [Some(0.15), None, None]),
    row("aces@90", [Some(0.282), None], [None; 3]),
    row("freiburg-101@90", [Some(0.089), None], [None; 3]),
    row("csail@90", [Some(0.265), None], [Some(0.10), Some(0.30), None]),
];

/// Looked for in the first half of intel's map: the log it drives in, its field of view, how often.
const SOUGHT: [(&str, Option<f64>, usize); 6] = [
    ("intel", None, 16),
    ("intel", Some(90.0), 16),
    ("csail", None, 6),
    ("aces", None, 6),
    ("freiburg-101", None, 6),
    ("csail", Some(90.0), 6),
];

/// Number of generated logs unless `--seeds` is given.
const SEEDS_DEFAULT: u64 = 96;

struct Args {
    data: PathBuf,
    json: Option<PathBuf>,
    logs: Option<Vec<String>>,
    maps: Option<PathBuf>,
    seeds: Seeds,
    /// Changes of the configuration.
    scale: Vec<String>,
    check: bool,
}

fn args() -> Result<Args, String> {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data/lidar");
    let mut args = Args {
        data,
        json: None,
        logs: None,
        maps: None,
        seeds: Seeds { range: 0..SEEDS_DEFAULT, step: 1 },
        scale: Vec::new(),
        check: false,
    };
    let mut given = std::env::args().skip(1);
    while let Some(name) = given.next() {
        let mut value = || given.next().ok_or(format!("{name} wants a value"));
        match name.as_str() {
            "--data" => args.data = value()?.into(),
            "--json" => args.json = Some(value()?.into()),
            "--logs" => args.logs = Some(value()?.split(',').map(str::to_owned).collect()),
            "--maps" => args.maps = Some(value()?.into()),
            "--seeds" => args.seeds = seeds::parse_seeds(&value()?)?,
            "--scale" => args.scale.push(value()?),
            "--check" => args.check = true,
            // cargo bench says this to every bench.
            "--bench" => {}
            other => {
                return Err(format!(
                    "{other}: expected --data DIR, --logs A,B, --json FILE, --maps DIR, --scale KEY=FACTOR or --check"
                ));
            }
        }
    }
    let known = |log: &String| {
        ["relocalize", "varied", "generated", "wrong-sensors", "carried", "stood"].contains(&log.as_str())
            || log.starts_with("varied/")
            || ROWS.iter().any(|row| row.name == log)
    };
    match args.logs.iter().flatten().find(|log| !known(log)) {
        Some(log) => Err(format!("--logs: {log} is none of {}", ROWS.map(|row| row.name).join(", "))),
        None => Ok(args),
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    // This program is also the process that one log runs in.
    let words: Vec<String> = std::env::args().collect();
    if words.get(1).is_some_and(|word| word == "drive") {
        settings::scale(&words[3..])?;
        println!("{}", serde_json::to_string(&drive::drive(&serde_json::from_str(&words[2])?)?)?);
        return Ok(());
    }
    if words.get(1).is_some_and(|word| word == "relocalize") {
        settings::scale(&words[3..])?;
        println!("{}", serde_json::to_string(&relocalize::drive(&serde_json::from_str(&words[2])?)?)?);
        return Ok(());
    }
    let args = args()?;
    settings::scale(&args.scale)?;
    if let Some(maps) = &args.maps {
        std::fs::create_dir_all(maps)?;
    }
    let wanted = |row: &&Row| args.logs.as_ref().is_none_or(|logs| logs.iter().any(|log| log == row.name));
    let mut done: Vec<(&Row, Outcome)> = Vec::new();
    let mut not_checked: Vec<&str> = Vec::new();
    for row in ROWS.iter().filter(wanted) {
        match task(&args, row.name) {
            Some(task) => done.push((row, in_a_process(("drive", &args.scale[..]), &task, &task.log)?)),
            None => not_checked.push(row.name),
        }
    }
    let mut relocalization = Vec::new();
    let all = |name: &str| args.data.join(name).join(format!("{name}.log.gz"));
    if args.logs.as_ref().is_some_and(|logs| logs.iter().any(|log| log == "relocalize")) {
        for (name, fov_deg, places) in SOUGHT {
            let task = relocalize::Task { map: all("intel"), robot: all(name), fov_deg, places };
            if task.map.is_file() && task.robot.is_file() {
                relocalization
                    .push((task.clone(), in_a_process(("relocalize", &args.scale[..]), &task, &task.robot)?));
            } else {
                not_checked.push(name);
            }
        }
    }
    let varied = vary(&args)?;
    let generate = |name: &str, draw: fn(u64) -> generated::Case| match &args.logs {
        Some(logs) if logs.iter().any(|log| log == name) => {
            generated::run_all(args.seeds.clone(), args.maps.as_deref(), draw)
        }
        _ => Ok(Vec::new()),
    };
    let generated = generate("generated", generated::Case::draw)?;
    let wrong_sensors = generate("wrong-sensors", generated::Case::draw_with_wrong_sensor)?;
    let carried = generate("carried", |seed| generated::Case::draw_with_event(seed, Event::Carried))?;
    let stood = generate("stood", |seed| generated::Case::draw_with_event(seed, Event::Stood))?;
    if !done.is_empty() {
        table::print(&done);
    }
    table::relocalized(&relocalization);
    table::varied(&varied);
    for (name, outcomes) in [("generated", &generated), ("carried", &carried), ("stood", &stood)] {
        generated::print(name, outcomes);
    }
    if !wrong_sensors.is_empty() {
        generated::print_wrong_sensors(&wrong_sensors);
    }
    if let Some(path) = args.json {
        let mut report = table::json(&done, &relocalization, &varied);
        report["generated"] = generated::json(&generated);
        report["wrong_sensors"] = generated::json(&wrong_sensors);
        report["carried"] = generated::json(&carried);
        report["stood"] = generated::json(&stood);
        std::fs::write(path, serde_json::to_string_pretty(&report)?)?;
    }
    let wrong = |(_, outcome): &(relocalize::Task, relocalize::Outcome)| outcome.wrong > 0;
    let missed =
        done.iter().any(|(row, outcome)| !table::met(row, outcome)) || relocalization.iter().any(wrong);
    if !not_checked.is_empty() {
        let absent = format!(
            "not checked: {}: no such logs in {} (scripts/fetch-logs says where they come from)",
            not_checked.join(", "),
            args.data.display()
        );
        if args.check {
            return Err(absent.into());
        }
        println!("{absent}");
    }
    if args.check && missed { Err("an error is above its limit, or a place is wrong".into()) } else { Ok(()) }
}

/// A log, how it was varied, and what came of it.
type VariedLog = (String, &'static str, Outcome);

/// Every log in every variation that was asked for.
fn vary(args: &Args) -> Result<Vec<VariedLog>, Box<dyn std::error::Error>> {
    let asked = |name: &str| {
        let by_name = format!("varied/{name}");
        args.logs.iter().flatten().any(|log| log == "varied" || *log == by_name)
    };
    let folder = std::env::temp_dir().join(format!("mr-slam-varied-{}", std::process::id()));
    std::fs::create_dir_all(&folder)?;
    let mut outcomes = Vec::new();
    for row in ROWS.iter().filter(|row| !row.name.contains('@') && asked(row.name)) {
        let Some(task) = task(args, row.name) else { continue };
        for (number, (label, varied)) in VARIATIONS.into_iter().enumerate() {
            let map = args.maps.as_ref().map(|maps| maps.join(format!("{}-{number:02}", row.name)));
            // The log as it is comes first; its trajectory tells which edges of the others are wrong.
            let way = Some(folder.join(format!("{}.traj", row.name)));
            let (trajectory, truth) = if number == 0 { (way, None) } else { (None, way) };
            let task = Task { varied, map, truth, trajectory, ..task.clone() };
            outcomes.push((
                row.name.to_owned(),
                label,
                in_a_process(("drive", &args.scale[..]), &task, &task.log)?,
            ));
        }
    }
    std::fs::remove_dir_all(&folder)?;
    Ok(outcomes)
}

/// Where the log's files are, if they are there.
fn task(args: &Args, row: &str) -> Option<Task> {
    let (name, fov_deg) = match row.split_once('@') {
        Some((name, degrees)) => (name, degrees.parse().ok()),
        None => (row, None),
    };
    let folder = args.data.join(name);
    let present = |file: &str| Some(folder.join(file)).filter(|path| path.is_file());
    Some(Task {
        log: present(&format!("{name}.log.gz"))?,
        varied: Varied { fov_deg, ..Varied::default() },
        relations: present("official.relations").or_else(|| present("substitute.relations"))?,
        odometry: present("dense_odom.traj.gz"),
        truth: None,
        trajectory: None,
        map: args.maps.as_ref().map(|maps| maps.join(row)),
    })
}

fn in_a_process<O: serde::de::DeserializeOwned>(
    (what, scale): (&str, &[String]),
    task: &impl serde::Serialize,
    log: &Path,
) -> Result<O, Box<dyn std::error::Error>> {
    let output = Command::new(std::env::current_exe()?)
        .arg(what)
        .arg(serde_json::to_string(task)?)
        .args(scale)
        .output()?;
    if !output.status.success() {
        let said = String::from_utf8_lossy(&output.stderr);
        return Err(format!("{}: {said}", log.display()).into());
    }
    Ok(serde_json::from_slice(&output.stdout)?)
}
