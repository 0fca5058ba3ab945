//! Bench of map merging: speed with known starts; alignment of pairs of maps with exact truth, as they are and varied;
//! recorded logs of several robots with unknown starts.
//!
//! `cargo bench --bench merge [-- --pairs DIR] [--logs DIR|generated] [--seeds FROM..TO] [--maps DIR] [--only speed,pairs,varied,logs,starts,halves] [--json FILE]
//! [--results FILE.jsonl] [--check]`
//!
//! `--pairs DIR` holds one folder a pair: `a.yaml`, `b.yaml` and `truth.json` (`T_A_B` = [x, y, theta], p_a = R p_b + t, or null
//! where the two are of different buildings); an archive `merge-pairs.tar.xz` has to be unpacked first. `--logs DIR` holds
//! `intel_2`, `intel_3`, `aces_2`, and logs of one robot, which are cut into halves. `--results FILE` gets one JSON line a
//! pair. `--check` fails if a limit is missed or if pairs or logs are missing. The last line
//! names what is missing. `--logs generated` prints the pairs drawn from seeds alone (`generated/`).

mod generated;
mod logs;
#[path = "../slam/noise.rs"]
mod noise;
mod pairs;
#[allow(dead_code, reason = "shared with the slam bench, which uses more of it")]
#[path = "../slam/relations.rs"]
mod relations;
#[allow(dead_code, reason = "shared with the slam bench, which uses more of it")]
#[path = "../slam/seeds.rs"]
mod seeds;
mod speed;
mod table;
mod varied;

use seeds::{Seeds, parse_seeds};
use std::path::{Path, PathBuf};
use table::Table;

/// Number of generated pairs unless `--seeds` is given.
const SEEDS_DEFAULT: u64 = 400;

struct Args {
    pairs: PathBuf,
    logs: PathBuf,
    only: Option<Vec<String>>,
    json: Option<PathBuf>,
    results: Option<PathBuf>,
    seeds: Seeds,
    maps: Option<PathBuf>,
    check: bool,
}

fn args() -> Result<Args, String> {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data");
    let (pairs, logs) = (data.join("merge-pairs"), data.join("lidar"));
    let seeds = Seeds { range: 0..SEEDS_DEFAULT, step: 1 };
    let mut args =
        Args { pairs, logs, only: None, json: None, results: None, seeds, maps: None, check: false };
    let mut given = std::env::args().skip(1);
    while let Some(name) = given.next() {
        let mut value = || given.next().ok_or(format!("{name} needs a value"));
        match name.as_str() {
            "--pairs" => args.pairs = value()?.into(),
            "--logs" => args.logs = value()?.into(),
            "--only" => args.only = Some(value()?.split(',').map(str::to_owned).collect()),
            "--json" => args.json = Some(value()?.into()),
            "--results" => args.results = Some(value()?.into()),
            "--seeds" => args.seeds = parse_seeds(&value()?)?,
            "--maps" => args.maps = Some(value()?.into()),
            "--check" => args.check = true,
            // cargo bench passes this to every bench.
            "--bench" => {}
            other => {
                return Err(format!(
                    "{other}: expected --pairs, --logs, --seeds, --maps, --only, --json, --results or --check"
                ));
            }
        }
    }
    Ok(args)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args = args()?;
    let wanted = |part: &str| args.only.as_ref().is_none_or(|only| only.iter().any(|name| name == part));
    let mut table = Table::default();
    if args.logs.as_os_str() == "generated" {
        return run_generated(table, &args);
    }
    if wanted("speed") {
        speed::rows(&mut table);
    }
    let pairs = pairs::read(&args.pairs)?;
    if pairs.is_empty() && (wanted("pairs") || wanted("varied")) {
        table.not_checked(format!("pairs of maps (none in {})", args.pairs.display()));
    }
    if wanted("pairs") && !pairs.is_empty() {
        pairs::rows(&mut table, &pairs, args.results.as_deref())?;
    }
    if wanted("varied") && !pairs.is_empty() {
        varied::rows(&mut table, &pairs);
    }
    if wanted("logs") {
        logs::rows(&mut table, &args.logs)?;
    }
    if wanted("starts") {
        logs::wrong_starts(&mut table, &args.logs)?;
    }
    if wanted("halves") {
        logs::halves(&mut table, &args.logs)?;
    }
    if let Some(path) = &args.json {
        std::fs::write(path, serde_json::to_string_pretty(&table.json())?)?;
    }
    if let Some(absent) = table.absent() {
        if args.check {
            return Err(absent.into());
        }
        println!("{absent}");
    }
    if args.check && !table.met() { Err("a limit is missed".into()) } else { Ok(()) }
}

/// Prints the pairs drawn from seeds; the JSON file gets the table and every pair.
fn run_generated(mut table: Table, args: &Args) -> Result<(), Box<dyn std::error::Error>> {
    if let Some(folder) = &args.maps {
        std::fs::create_dir_all(folder)?;
    }
    let pairs = generated::rows(&mut table, &args.seeds, args.maps.as_deref())?;
    if let Some(path) = &args.json {
        let mut json = table.json();
        json["pairs"] = pairs.into();
        std::fs::write(path, serde_json::to_string(&json)?)?;
    }
    if args.check && !table.met() { Err("a limit is missed".into()) } else { Ok(()) }
}
